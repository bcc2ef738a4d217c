"""Bodies that yield: Prandtl's punch and a thick-walled cylinder, against closed forms."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import ufl

from forms import LinearElastic, VonMises, formulas
from forms.tensors import Expr
from geometry import block, ring, sandwich
from geometry.joint import Joint
from studies.problems import StructureArguments, mean_on_side
from studies.sweeping import Curves
from thinlayer import Structure, Surface, Table, ThinLayer, march, plotting
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Support
from thinlayer.running.record import Record

K = 1.0  # yield stress in shear; all stresses of the punch and the cylinder are relative to it
YIELD_STRENGTH = math.sqrt(3) * K
GRADING_EXPONENT = 1.5  # exponent with which cells shrink towards the edge of the punch
PUNCH_DEPTHS = (0.004, 0.008, 0.012, 0.016)  # depths at the ends of steps, over the half-width of the punch

CYLINDER = formulas.PlasticCylinder(a=1.0, b=2.0, mu=300.0, k=K)
R_S = 1.4  # radius of S
BOND_MODULUS = 2e5  # moduli of the bond on S, over its thickness
PRESSURES = (0.7, 1.0, 1.2, 1.3, 1.35)  # over K; elastic up to 0.75, the limit is 2 ln 2 = 1.386


def run(record: Record, *, quick: bool = False) -> None:
    """Solve a punch and a cylinder of ideally plastic metal, and check them against closed forms.

    punch.csv has the mean pressure of a rough, rigid punch on a block, on finer and finer meshes; the closed form is (2
    + pi) k with the shear strength k. By symmetry half of the block is solved. cylinder.csv is of a nearly
    incompressible cylinder (nu = 0.499) under inner pressure, partly plastic, in plane strain and axisymmetric. It has
    the displacements inside and outside, and the radial stress on S, an almost rigid interface.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: coarser meshes.
    """
    solve_punch(record, (5, 10) if quick else (5, 10, 16))
    solve_cylinders(record, 0.15 if quick else 0.08)


# ---------------------------------------------------------------- punch
def half_block_joint(n: int) -> Joint:
    """Return the joint of half of the block below the punch, 4 wide and 2 high.

    There are `n` cells over the half-width 1 of the punch (facet set "PUNCH"); they become smaller towards its edge.
    The rest of the upper side is the facet set "FREE". S is the lower side, on a rigid base.
    """
    grid = block(4.0, 2.0, 1 / n, structured=True, arrangement="AlternateLeft")
    x, y = grid.points.T
    x_under, x_outside = 1 - np.abs(1 - x) ** GRADING_EXPONENT, 1 + 3 * (np.abs(x - 1) / 3) ** GRADING_EXPONENT
    points = np.column_stack([np.where(x < 1, x_under, x_outside), 2 - 2 * ((2 - y) / 2) ** GRADING_EXPONENT])
    facets = dict(grid.facets)
    top_facets = facets.pop("TOP")
    is_under = grid.points[top_facets].mean(axis=1)[:, 0] < 1
    return replace(grid, points=points, facets={**facets, "PUNCH": top_facets[is_under], "FREE": top_facets[~is_under]})


def mean_pressure(state: State) -> float:
    """Return the mean pressure under the punch, whose half-width is 1, in `state`."""
    return -float(state.reaction("PUNCH").force[1])


def solve_punch(record: Record, cells: Sequence[int]) -> None:
    """Push the punch into the block on finer and finer meshes, and check its pressure against Prandtl's.

    `cells` are increasing numbers of cells over its half-width. `record` writes the pressures to punch.csv.
    """
    table, limit = record.new_table("punch.csv"), formulas.prandtl_pressure(K)
    metal = VonMises.young(E=1000.0, nu=0.45, strength=YIELD_STRENGTH)
    supports: dict[str, Support] = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}, "PUNCH": {"x": 0.0, "y": lambda x, t: -t}}
    errors = []
    for n in cells:
        model = Structure(half_block_joint(n), body=metal, supports=supports).bonded()
        history = record.add_report(march(model, PUNCH_DEPTHS, keep="last", observe={"pressure": mean_pressure}))
        pressures = history.table["pressure"]
        table.extend(Table.of({"n": n, "sunk": history.t, "pressure": pressures, "over": pressures / limit}))
        errors.append(float(pressures[-1]) / limit - 1)
    record.check("pressure under the punch on the finest mesh, over (2 + pi) k", 1 + errors[-1], low=0.99, high=1.01)
    record.check("its error there over that on the coarsest mesh", errors[-1] / errors[0], low=0.0, high=0.4)


# ---------------------------------------------------------------- cylinder
def cylinder_problems(h: float) -> dict[str, tuple[Joint, StructureArguments, str, str]]:
    """Return the problems of two models of the cylinder, "plane strain" and "axisymmetric", with cells of the size `h`.

    The first model is a quarter of the cross section. The second one is a section through the axis; its ends do not
    move along the axis. S is the cylinder of radius `R_S` in both.

    Returns:
        Name of the model -> its joint, arguments of its `Structure`, and facet sets of the inner and the outer side.
    """
    c = CYLINDER
    quarter = ring(c.a, R_S, c.b, h, angle=math.pi / 2, cell="triangle", degree=2)
    wall = sandwich(0.5, R_S - c.a, c.b - R_S, h, structured=True).rotated(-math.pi / 2).moved((R_S, 0.0))

    def inner_load(x: Expr, t: Expr) -> tuple[Expr, Expr]:
        r = ufl.sqrt(x[0] ** 2 + x[1] ** 2)
        return t * x[0] / r, t * x[1] / r

    ends, plates = {"START": {"y": 0.0}, "END": {"x": 0.0}}, {"LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}}
    plane_kw: StructureArguments = {"supports": ends, "tractions": {"INSIDE": inner_load}}
    axial_kw: StructureArguments = {"supports": plates, "tractions": {"BOTTOM": lambda x, t: (t, 0.0)}}
    axial_kw["plane"] = "axisymmetric"
    return {"plane strain": (quarter, plane_kw, "INSIDE", "OUTSIDE"), "axisymmetric": (wall, axial_kw, "BOTTOM", "TOP")}


def solve_cylinders(record: Record, h: float) -> None:
    """Raise the inner pressure in both models of the cylinder, and check them against the closed form.

    `h` is the cell size, relative to the inner radius. `record` writes the results to cylinder.csv.
    """
    c, nu, table = CYLINDER, 0.499, record.new_table("cylinder.csv")
    metal = VonMises.young(E=2 * c.mu * (1 + nu), nu=nu, strength=YIELD_STRENGTH)
    bond = ThinLayer(LinearElastic(BOND_MODULUS, BOND_MODULUS), 1e-3, at=1.0)
    for model_name, (joint, setup, inside, outside) in cylinder_problems(h).items():
        model = Structure(joint, **setup | {"body": metal}).interface(bond)
        surface = Surface(model)
        for state in list(march(model, PRESSURES))[1:]:
            radial_stress = surface.integral(surface.frame(surface.traction(state))[-1]) / surface.integral(1.0)
            row = {"model": model_name, "pressure": state.t, "zone": c.zone_radius(state.t), "stress": radial_stress}
            row["stress_exact"] = float(c.radial_stress(state.t, np.array(R_S)))
            for name, facet_set, r in (("inside", inside, c.a), ("outside", outside, c.b)):
                row[f"u_{name}"] = mean_outward_displacement(state, facet_set, r)
                row[f"u_{name}_exact"] = float(c.displacement(state.t, np.array(r)))
            table.append(row)
            record.add_report(state)
    for name in ("stress", "u_inside", "u_outside"):
        error = np.abs(table[name] / table[f"{name}_exact"] - 1).max()
        record.check(f"cylinder: largest relative error of {name}", error, high=0.01)


def mean_outward_displacement(state: State, name: str, r: float) -> float:
    """Return the mean outward displacement of a side of the cylinder in `state`.

    `name` is the facet set of the side, `r` its radius.
    """
    along_radius = ufl.dot(state.u, ufl.SpatialCoordinate(state.model.domain.mesh)) / r
    return mean_on_side(state, name, state.u[0] if state.model.plane == "axisymmetric" else along_radius)


def draw(record: Record) -> None:
    """Draw the pressure under the punch over its depth, and the pressure in the cylinder over its displacements.

    The values are read from punch.csv and cylinder.csv in the folder of `record`.
    """
    limit, depths = formulas.prandtl_pressure(K), np.array([0.0, max(PUNCH_DEPTHS)])
    curves, styles = Curves(), {"(2 + pi) k": ":"}
    for n, part in record.load("punch.csv").split("n").items():
        curves[f"{n:.0f} cells under the punch"] = part["sunk"], part["over"]
    curves["(2 + pi) k"] = depths, np.ones(2)
    title, save = "a rough punch on ideally plastic metal tends to Prandtl's pressure", record.path("punch.svg")
    labels = ("depth over half-width", f"mean pressure over {limit:.3f} k")
    plotting.curves(curves, *labels, save=save, title=title, styles=styles)
    p, curves, styles = np.linspace(0.0, PRESSURES[-1], 100), {}, {}
    for r, name in ((CYLINDER.a, "inside"), (CYLINDER.b, "outside")):
        exact = np.array([float(CYLINDER.displacement(float(pressure), np.array(r))) for pressure in p])
        curves[f"closed form, {name}"] = exact, p
        for kind, part in record.load("cylinder.csv").split("model").items():
            curves[f"{kind}, {name}"] = part[f"u_{name}"], part["pressure"]
            styles[f"{kind}, {name}"] = "o" if "strain" in kind else "x"
    title, save = "a thick-walled cylinder, b = 2 a, yields from the inside", record.path("cylinder.svg")
    plotting.curves(curves, "radial displacement over a", "pressure over k", save=save, title=title, styles=styles)
