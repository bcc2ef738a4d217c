"""Networks of layers, meshed against interface models: convergence as eps -> 0, and the effect of junctions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import cos, radians, sin

import numpy as np
from scipy.spatial import cKDTree

from forms import LinearElastic
from forms.base import Array
from forms.tensors import Expr, strain
from forms.viscous import isotropic_energy
from geometry import faults, grains, wall
from geometry.joint import Joint
from geometry.seam import JUNCTIONS, LAYER
from studies.sweeping import difference
from thinlayer import Structure, Surface, Table, ThinLayer, UflPart, plotting, solve
from thinlayer.discretisation.key import LAYER_KIND, Key
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Support
from thinlayer.running.record import Record
from thinlayer.system.progress import track
from thinlayer.system.table import Row

EPS = (0.04, 0.02, 0.01, 0.005, 0.0025)
BODY = LinearElastic.young(E=1.0, nu=0.2)
BED, HEAD = LinearElastic(lmbda=0.6, mu=0.7), LinearElastic(lmbda=0.3, mu=0.45)  # at the thickness 1
MORTAR_LAYERS = {"BED": (BED, 1.0), "HEAD": (HEAD, 0.7)}  # seam -> law, thickness over eps
CELL_SIZE = 1 / 16  # cell size
TOP_SHIFT = (0.01, -0.02, 0.005)  # displacement of the top
RAY_ANGLES = (10, 95, 150, 200, 310)  # degrees, directions of the star's layers
ORDER_RANGE = (0.9, 1.1)  # range of orders away from junctions and free ends
PICTURE_FILES = {"star of five layers": "star.png", "grains": "grains.png"}
ERROR_NAMES = ("jump", "inner_jump", "inner_traction", "energy")


@dataclass(frozen=True)
class JunctionCase:
    """A network of layers between elastic bodies, clamped at the bottom and displaced at the top.

    Attributes:
        make_joint: function of the thickness eps that returns the joint.
        layers: name of a seam -> law of its layer, with the moduli at the thickness 1, and its thickness divided by
            eps.
        bodies: bodies of the full model: "kept" (meshed layers move them apart) or "extended" (layers are cut out of
            them).
        margin: distance from junctions and free ends beyond which a point belongs to the inner part of S.
        stiffen: whether the bodies' stiffness is added to that of the layer in junctions of the full model.
        refined: whether the cells of bodies at junctions are about as small as eps.
        max_eps: largest thickness eps of the study.
        quick: whether the case is run with --quick.
    """

    make_joint: Callable[[float], Joint]
    layers: Mapping[str, tuple[LinearElastic, float]] = field(default_factory=lambda: MORTAR_LAYERS)
    bodies: str = "kept"
    margin: float = 0.15
    stiffen: bool = False
    refined: bool = False
    max_eps: float = EPS[0]
    quick: bool = False

    def thin_layers(self, eps: float) -> dict[str, ThinLayer]:
        """Return the layers of the network for the thickness `eps`, by the names of their seams.

        Each layer is as thick as `eps` times the factor of its seam.
        """
        return {name: ThinLayer(law, share * eps, at=1.0) for name, (law, share) in self.layers.items()}

    def structure(self, joint: Joint, *, meshed: bool) -> Structure:
        """Make the structure of the network on `joint`.

        `meshed` says whether it is for the full model; only then do junctions have additional stiffness, if `stiffen`
        is set.
        """
        supports: dict[str, Support] = {"BOTTOM": 0.0, "TOP": dict(zip("xyz", TOP_SHIFT[: joint.dim], strict=False))}
        parts = [UflPart(energy=stiffening_energy)] if meshed and self.stiffen else []
        return Structure(joint, body=BODY, supports=supports, parts=parts)


def bond_wall(eps: float) -> Joint:
    """Return the joint of a brick wall in running bond, two courses high and two bricks long.

    The thickness `eps` of layers is not used, as the mesh suits all thicknesses.
    """
    return wall(2, 2, (1.0, 0.5), CELL_SIZE, cell="triangle")


def bond_wall_3d(eps: float) -> Joint:
    """Return the joint of the wall of `bond_wall` in 3D, as deep as the bricks are high; junctions are lines.

    The thickness `eps` of layers is not used, as the mesh suits all thicknesses.
    """
    return wall(2, 2, (1.0, 0.5), 1 / 8, depth=0.5, cell="hexahedron")


def refined_wall(eps: float) -> Joint:
    """Return the joint of the wall of `bond_wall`, with cells of the size 2 `eps` at junctions and free ends."""
    heads = {f"HEAD {k}": ((x, y), (x, y + 0.5)) for k, (x, y) in enumerate(((1.0, 0.0), (0.5, 0.5), (1.5, 0.5)), 1)}
    return faults(2.0, 1.0, {"BED": ((0.0, 0.5), (2.0, 0.5)), **heads}, CELL_SIZE, h_ends=min(2 * eps, CELL_SIZE))


def star_joint(eps: float) -> Joint:
    """Return the joint of a square in which five layers run from the centre to the boundary.

    The thickness `eps` of layers is not used, as the mesh suits all thicknesses.
    """
    ray_ends = {f"L{k}": (1 + 2 * cos(radians(a)), 1 + 2 * sin(radians(a))) for k, a in enumerate(RAY_ANGLES)}
    return faults(2.0, 2.0, {name: ((1.0, 1.0), ray_end) for name, ray_end in ray_ends.items()}, h=0.15, h_S=0.1)


def polycrystal(eps: float) -> Joint:
    """Return the joint of a square of seven grains with layers between them.

    The thickness `eps` of layers is not used, as the mesh suits all thicknesses.
    """
    return grains(1.0, 1.0, 7, CELL_SIZE, seed=1)


BOND_LAYERS = {"BED": (BED, 1.0)} | {f"HEAD {k}": (HEAD, 0.7) for k in (1, 2, 3)}
STAR_LAYERS = {f"L{k}": (LinearElastic(0.6 - 0.1 * k, 0.7 - 0.05 * k), 1 + 0.1 * k) for k in range(len(RAY_ANGLES))}
CASES = {
    "bond, kept": JunctionCase(bond_wall, quick=True),
    "bond, extended": JunctionCase(bond_wall, bodies="extended"),
    "star of five layers": JunctionCase(star_joint, STAR_LAYERS, bodies="extended", margin=0.2, quick=True),
    "grains": JunctionCase(polycrystal, {"S": (BED, 1.0)}, bodies="extended", margin=0.1, max_eps=0.02, quick=True),
    "bond, refined": JunctionCase(refined_wall, BOND_LAYERS, refined=True, max_eps=0.02, quick=True),
    "bond in 3D": JunctionCase(bond_wall_3d, bodies="extended", max_eps=0.02),
    "bond, stiff junctions": JunctionCase(bond_wall, stiffen=True, quick=True),
    "bond, stiff junctions, refined": JunctionCase(refined_wall, BOND_LAYERS, stiffen=True, refined=True, max_eps=0.02),
}


def run(record: Record, *, eps: Sequence[float] = EPS, quick: bool = False) -> None:
    """Measure relative differences between meshed layers and interface laws in networks as eps -> 0.

    The differences are O(eps) away from junctions and free ends. They are O(eps) on all of S if cells of the bodies at
    junctions and ends are about as small as eps. On coarser meshes jumps on all of S, and energies, converge at a lower
    rate. If junctions are as stiff as the bodies, they tie the bodies' corners together, and the differences do not
    converge. If cells are also as small as eps, the difference of the energies decreases as 1 / (c - log eps), with a
    constant c.

    Args:
        record: record of the run, with its folder, tables and checks.
        eps: thicknesses; the networks are 1 to 2 wide.
        quick: fewer networks.
    """
    table = record.new_table("table.csv")
    for name in track([name for name, case in CASES.items() if case.quick or not quick], "junctions", "{}"):
        sizes = [e for e in sorted(eps, reverse=True) if e <= CASES[name].max_eps]
        rows = compare_models(record, name, sizes) if sizes else []
        table.extend(rows)
        if len(rows) > 1:
            check_orders(record, name, Table(rows))


def compare_models(record: Record, name: str, sizes: Sequence[float]) -> list[Row]:
    """Solve both models of the network `name` for the thicknesses `sizes`, and return a table row for each.

    The rows have the differences of the models and the observed rates of convergence. `record` keeps the solver's
    reports and gets a picture of some networks.
    """
    case, rows = CASES[name], list[Row]()
    for eps in sizes:
        joint, layers = case.make_joint(eps), case.thin_layers(eps)
        full = record.add_report(solve(case.structure(joint, meshed=True).full(layers, bodies=case.bodies)))
        by_law = record.add_report(solve(case.structure(joint, meshed=False).interface(layers)))
        rows.append({"case": name, "eps": eps, **model_differences(case, full, by_law)})
        if eps == max(sizes) and name in PICTURE_FILES:
            states = {f"meshed layers, eps = {eps:g}": full, "interface laws": by_law}
            plotting.deformed(states, plotting.View(unit="widths"), save=record.path(PICTURE_FILES[name]), title=name)
    orders = {f"order_{error}": Table(rows).orders(error) for error in ERROR_NAMES}
    return [row | {name: values[k] for name, values in orders.items()} for k, row in enumerate(rows)]


def model_differences(case: JunctionCase, full: State, by_law: State) -> dict[str, float]:
    """Compare the states of the full and the interface model of a network.

    Args:
        case: the network.
        full: state with meshed layers.
        by_law: state with interface laws.

    Returns:
        "jump" (on all of S), "inner_jump" and "inner_traction" (far from junctions) -> relative difference in the L2
        norm; "energy" -> relative difference of the stored energies.
    """
    surface = Surface(by_law.model)
    error_of, inner = partial(difference, surface, state=full, reference=by_law), far_weights(surface, case.margin)
    jumps = {"jump": error_of(Surface.jump), "inner_jump": error_of(Surface.jump, where=inner)}
    energy_error = abs(stored_energy(full) / stored_energy(by_law) - 1)
    return jumps | {"inner_traction": error_of(Surface.traction, where=inner), "energy": energy_error}


def stored_energy(state: State) -> float:
    """Return the energy stored in bodies and layers in `state`; the work of the loads is left out."""
    skipped_keys = {"loads", *(str(Key(LAYER_KIND, seam)) for seam in state.model.joint.seams)}
    return sum(energy for key, energy in state.energies().items() if key not in skipped_keys)


def check_orders(record: Record, name: str, rows: Table) -> None:
    """Check the rates of convergence of the network `name`.

    `rows` is its table, with a row for each thickness; `record` receives the checks.
    """
    case, orders = CASES[name], {error: rows[f"order_{error}"][1:] for error in ERROR_NAMES}
    if case.stiffen and case.refined:
        growth = np.diff(1 / rows["energy"]) / -np.diff(np.log(rows["eps"]))
        if len(growth) > 1:
            what = "growth of 1 / error of the energy with -log eps, the last over the one before"
            record.check(f"{name}: {what}", growth[-1] / growth[-2], low=0.8, high=1.25)
        return
    if case.stiffen:
        record.check(f"{name}: last order of the inner jump", orders["inner_jump"][-1], high=0.3)
        record.check(f"{name}: error of the inner jump that is left", rows["inner_jump"][-1], low=0.025)
        return
    for error in ("inner_jump", "inner_traction"):
        what = f"order of the {error.replace('_', ' ')}"
        record.check(f"{name}: least {what}", min(orders[error]), low=ORDER_RANGE[0])
        record.check(f"{name}: largest {what}", max(orders[error]), high=ORDER_RANGE[1])
    min_order = ORDER_RANGE[0] if case.refined else 0.8
    record.check(f"{name}: least order of the jump on all of S", min(orders["jump"]), low=min_order)


def far_weights(surface: Surface, distance: float) -> Array:
    """Return weights (n, q) at q points of n facets of S: 1 far from junctions and ends of S, else 0.

    A facet of `surface` is far if its midpoint is farther than `distance` from all of them.
    """
    joint = surface.joint
    vertices = np.unique(joint.table.vertices[joint.surface_rows])
    outer_vertices = joint.table.vertices[joint.table.cells[:, 1] < 0]
    special_vertices = vertices[(joint.split_mesh.component_counts[vertices] != 2) | np.isin(vertices, outer_vertices)]
    midpoints = joint.points[joint.table.vertices[joint.surface_rows]].mean(axis=1)
    is_far = cKDTree(joint.points[special_vertices]).query(midpoints)[0] > distance
    return np.asarray(is_far[surface.rows, None] * np.ones_like(surface.weights))


def stiffening_energy(u: Expr, model: Model) -> Expr:
    """Return the energy, a UFL form, that is added to the full model `model` so that its junctions are stiff.

    It is the energy of the bodies' material in the junctions at the displacements `u`.
    """
    in_junctions = model.dx(model.domain.region_tags(f"{LAYER}/{JUNCTIONS}"))
    return isotropic_energy(BODY.lmbda, BODY.mu, strain(u)) * in_junctions


def draw(record: Record) -> None:
    """Draw the difference of the jumps far from junctions over the thickness, from table.csv in the folder of `record`."""
    tables = {name: rows for name, rows in record.load("table.csv").split("case").items() if not CASES[name].stiffen}
    title, save = "networks: jump far from junctions and free ends", record.path("rates.svg")
    plotting.rates(tables, errors={"jump": "inner_jump"}, title=title, save=save)
