"""Structures whose traits are drawn at random, and all that the package tells of them."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import fields as fields_of
from dataclasses import is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyvista
import ufl

from forms import (
    Anisotropic,
    HolonomicCoulomb,
    Incompressible,
    IncrementalCoulomb,
    KelvinVoigt,
    LinearElastic,
    Maxwell,
    MohrCoulomb,
    NonMonotone,
    Norton,
    NortonCreep,
    Rubber,
    Stack,
    VonMises,
)
from geometry import block, bond_cell, ring, sandwich, wall
from tests.own_laws import Skew
from thinlayer import (
    Adaptive,
    Gap,
    PointLoad,
    Pressure,
    Prestress,
    Probe,
    RangeWarning,
    RigidPlate,
    Springs,
    Structure,
    Surface,
    ThermalExpansion,
    ThinLayer,
    Zoom,
    compare,
    estimate,
    fields,
    goals,
    homogenised_stiffness,
    march,
    piecewise,
    solve,
    thin_enough,
)
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.errors import ThinlayerError
from thinlayer.estimating.result import Estimate
from thinlayer.solving.history import History
from thinlayer.system.table import Table

EPS, TIMES = 0.04, (1 / 3, 1.0, 5 / 3)
STEEL, STONE = LinearElastic.young(280.0, 0.2), LinearElastic.young(350.0, 0.31)
GLUE, SOFT = LinearElastic.shear(3.0, 0.35), LinearElastic.shear(1.1, 0.485)
WOOD = Anisotropic(np.diag([5.0, 6.0, 7.0, 2.0, 2.5, 3.0]) + 0.3, "layer")
ELASTIC = (Incompressible(2.0), GLUE, SOFT, WOOD, Skew(2.0, 0.7), Rubber.shear(1.1, 0.485),
    LinearElastic(3.0, lambda x: 2 + 0.5 * x[0]), Stack((0.3, GLUE), (0.7, SOFT)),
    Stack((0.6, LinearElastic.shear(1.5, 0.4995)), (0.4, STEEL)))  # fmt: skip
OTHERS = (NonMonotone(3.0, 2.0, 0.5, 0.08, [[0.2, 0.5], [0.5, 1.0]]), Stack((0.4, GLUE), (0.6, Maxwell(30.0, 20.0, 0.7))),
    KelvinVoigt(3.0, 2.0, 1.5, 0.8), Maxwell(3.0, 2.0, 2.0, 3.0), Norton(3.0, 2.0, 5.0, 1.5),
    NortonCreep(3.0, 2.0, 0.05, 3.0), MohrCoulomb(3.0, 2.0, cohesion=0.4, friction_angle=20.0, dilatancy_angle=5.0),
    VonMises(3.0, 2.0, strength=0.8, hardening=0.5))  # fmt: skip
TOUCHING = (HolonomicCoulomb(200.0, 80.0, 0.4, 0.01), IncrementalCoulomb(200.0, 80.0, 0.5))
quads = {"cell": "quadrilateral", "structured": True}
SHAPES: dict[str, Callable[[], Any]] = {
    "plates": partial(sandwich, 1.5, 0.3, 0.5, 0.25, **quads),
    "leaves": partial(sandwich, 1.5, 0.3, 0.5, 0.25, cell="triangle", structured=True),
    "base": partial(block, 1.5, 0.5, 0.25, **quads),
    "wall": partial(wall, 2, 2, (0.8, 0.5), 0.25),
    "courses": partial(wall, 1, 3, (0.8, 0.4), 0.2, cell="triangle"),
    "arc": partial(ring, 1.0, 1.3, 1.8, 0.3, angle=1.1, cell="quadrilateral"),
    "thick plates": partial(sandwich, 1.5, 0.3, 0.5, 0.5, depth=0.6, cell="hexahedron", structured=True),
    "tetrahedra": partial(sandwich, 1.5, 0.3, 0.5, 0.5, depth=0.6, cell="tetrahedron", structured=True),
    "cell": partial(bond_cell, (0.8, 0.4), 0.2),
}


NOISE = {"imbalance", "residual", "iterations", "seconds", "remainder", "memory"}  # rounding, and costs


def words(text: str) -> str:
    """A text without its numbers."""
    return re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?|inf|nan", "#", text)


def summary(value: Any) -> list[Any]:
    """The numbers and words of an answer; of a large array some sums."""
    match value:
        case None | State() | Model():
            return []
        case History():
            return summary(value.table)
        case Estimate():
            return summary([value.table, value.sentences, value.caveats])
        case str():
            return [words(value)]
        case Table():
            return summary(value.rows)
        case Mapping():
            rows = [summary(item) for key, item in value.items() if not NOISE & {*str(key).split()}]
            return [number for row in rows for number in row]
        case list() | tuple():
            return [number for item in value for number in summary(item)]
        case _ if is_dataclass(value):
            return summary([getattr(value, field.name) for field in fields_of(value)])
    a = np.asarray(value)
    if a.dtype.kind in "OU":
        return summary(sorted({*map(str, a.ravel())}))
    if a.size > 6:
        return [float(number) for number in (a.sum(), (a**2).sum() ** 0.5, a.max(), a.min())]
    return [float(number) for number in a.ravel()]


class Mixture:
    """A structure, its layers, and how it is followed, by the number from which they are drawn."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        rng = np.random.default_rng(seed)
        pick: Any = lambda *of: of[rng.integers(len(of))]
        maybe: Any = lambda share: bool(rng.random() < share)
        self.shape = [*SHAPES][seed % len(SHAPES)]
        joint, bent, cell = SHAPES[self.shape](), self.shape == "arc", self.shape == "cell"
        self.bottom, self.top, side = ("INSIDE", "OUTSIDE", "START") if bent else ("BOTTOM", "TOP", "RIGHT")
        flat, upper, d = joint.dim == 2 and not bent and not cell, joint.regions[-1], joint.dim
        plane = pick("strain", "strain", "stress", *["axisymmetric"] * (len(joint.seams) == 1)) if flat else "strain"
        joint = joint.rotated(0.4) if flat and plane != "axisymmetric" and maybe(0.3) else joint
        order = np.arange(len(joint.points)) if cell else rng.permutation(len(joint.points))
        facets = {name: rng.permuted(np.argsort(order)[rows], axis=1) for name, rows in joint.facets.items()}
        points, cells = joint.points[order], np.argsort(order)[joint.cells]
        self.joint = joint = replace(joint, points=points, cells=cells, facets=facets)
        time = pick(lambda x, t: t, lambda x, t: 1.0, piecewise({0: 0, 0.5: 0.8, 2: 0.3}))
        load = lambda x, t: tuple(c * time(x, t) * (1 + 0.4 * x[0]) for c in (0.3, -1.0, 0.2)[:d])
        supports: dict[str, Any] = (
            {self.bottom: pick(0.0, 0.0, {"n": 0.004} if d == 2 else 0.0)} if not joint.base_seams else {}
        )
        if supports.get(self.bottom) or maybe(0.3):
            supports[pick(side, f"{side}/{upper}")] = {"n": 0.0}
        if maybe(0.1):
            supports["LEFT"] = {"y": 0.002}
        tractions, parts = {self.top: load if maybe(0.7) else Pressure(0.4)}, []
        match pick("load", "load", "plate", "motion"):
            case "plate":
                moment = {"moment": 0.3} if d == 2 and plane != "axisymmetric" else {}
                parts.append(RigidPlate(self.top, force=(0.7 * bool(moment), -0.4, 0.0)[:d], **moment))
                tractions = {}
            case "motion":
                supports[self.top] = {"n" if bent else "y": lambda x, t: -0.01 * time(x, t)}
                tractions = {}
        if maybe(0.2) and supports.get(self.bottom) == 0.0:
            parts.append(Springs(self.bottom, 40.0, lambda x: 10 + 5 * x[0]))
            del supports[self.bottom]
        if maybe(0.3) and flat:
            places = [upper] * 2 + ["LAYER"] * (len(joint.seams) == 1)
            tractions[f"{'LEFT' if plane != 'axisymmetric' else 'RIGHT'}/{pick(*places)}"] = (0.2, -0.1)
        data: dict[str, Any] = {"plane": plane, "parts": parts, "supports": supports, "tractions": tractions}
        if maybe(0.2):
            data["body_force"] = {upper: (0.1, -0.4, 0.2)[:d], next(iter(joint.seams)): (0.0, -3.0, 0.0)[:d]}
        if maybe(0.15) and not cell:
            at = joint.points[joint.facets[self.top][0, 0]]
            data["loads"] = [PointLoad(tuple(at), (0.0, -0.03, 0.0)[:d])]
        if maybe(0.25):
            k = 3 if d == 3 or plane == "axisymmetric" else 2
            hot = ThermalExpansion(1e-5, lambda x, t: 80 * t)
            in_situ = Prestress(np.diag([-0.4, -0.7, -0.3][:k]))
            data["eigenstrain"] = {upper: pick(0.002, lambda x, t: 1e-3 * (1 + x[0]) * t, in_situ, hot)}
        self.low = maybe(0.3)
        if self.low:
            normals = any(isinstance(support, dict) and "n" in support for support in supports.values())
            data["element"] = (
                pick("Q1", "Q1" if normals else "S2") if joint.cell_type in ("quadrilateral", "hexahedron") else "P1"
            )
        if cell:
            strain = lambda x, t: ((0.002 * t, 0.01 * t), (0.01 * t, -0.004))
            data = pick({"strain": strain}, {"stress": ((0.1, 0.02), (0.02, -0.3))}) | {"supports": {}}
        self.structure = Structure(joint, body={name: pick(STEEL, STONE) for name in joint.regions}, **data)
        self.layers = {name: self.layer(pick, maybe, d) for name in joint.seams}
        curves = [
            layer
            for layer in self.layers.values()
            if getattr(layer, "profile", None) or (bent and hasattr(layer, "order"))
        ]
        self.bodies = "extended" if curves else "kept"
        self.answers: dict[str, Any] = {}

    def layer(self, pick: Any, maybe: Any, d: int) -> Any:
        if self.shape in ("plates", "base", "wall") and maybe(0.12):
            return pick(*TOUCHING)
        if self.shape == "wall" and maybe(0.15):
            return Gap(0.03)
        network = self.shape in ("wall", "courses", "cell")
        of = ELASTIC[self.low :] if maybe(0.6) else OTHERS[2 * (d > 2) :]
        law = pick(*of)
        alone = self.low or network or law is OTHERS[1]
        more: dict[str, Any] = {"order": 1} if maybe(0.5) and not alone else {}
        if more and maybe(0.3):
            more["edges"] = pick("plain", "free")
        if maybe(0.2) and self.shape in ("plates", "base", "thick plates"):
            more["profile"] = lambda x: 1 + 0.2 * x[0]
        if maybe(0.25):
            more["eigenstrain"] = pick(0.01, lambda x, t: 0.004 * x[0] * t)
        return ThinLayer(law, EPS * pick(1.0, 0.6), **more)

    # ---------------------------------------------------------------- what is told of it
    def ask(self, name: str, question: Callable[..., Any], *about: Any) -> Any:
        """The answer, whose numbers and words are kept with those of its warnings; None where it is a refusal."""
        with warnings.catch_warnings(record=True, action="always", category=RangeWarning) as heard:
            try:
                answer = question(*about)
                entries = summary(answer)
            except ThinlayerError as refusal:
                answer, entries = None, [f"{type(refusal).__name__}: {words(str(refusal))}"]
        self.answers[name] = [
            *entries,
            *sorted({words(str(warning.message)) for warning in heard if warning.category is RangeWarning}),
        ]
        return answer

    def all(self, folder: Path) -> dict[str, list[Any]]:
        """Answers by question; files are in a folder. Collective."""
        structure, seams, made, reached = self.structure, self.joint.seams, {}, {}
        made["S"] = self.ask("model", lambda: structure.interface(self.layers, bodies=self.bodies))
        made["mesh"] = self.ask("meshed", lambda: structure.full(self.layers, bodies=self.bodies, cells_through=2))
        made["bonds"] = self.ask("bonded", structure.bonded)
        for name, model in made.items():
            if model:
                solved = self.ask(f"solve {name}", solve, model, 1.0)
                if solution := self.ask(f"march {name}", march, model, TIMES) or solved:
                    reached[name] = solved if solved and self.seed % 2 else solution
                    self.of_state(name, getattr(solution, "last", solution))
                    for seam in seams:
                        self.on_seam(f"{seam} {name}", getattr(solution, "last", solution), Surface(model, seam), seam)
                    self.ask(f"file {name}", of_file, getattr(solution, "last", solution), folder / name)
        if made["S"] and not self.seed % 3 and self.joint.dim == 2:
            self.ask("adaptive", march, made["S"], Adaptive(end=1.6, first=0.3, tolerance=0.05))
        if "S" in reached:
            self.of_estimates(reached["S"])
        if {"S", "mesh"} <= {*reached}:
            for seam in seams:
                self.ask(f"compare {seam}", partial(compare, seam=seam), reached["mesh"], reached["S"])
        if structure.joint.periods:
            self.ask("stiffness", homogenised_stiffness, made["S"])
        return self.answers

    def of_state(self, name: str, state: Any) -> None:
        """Balance and values at places."""
        model, joint, probe = state.model, self.joint, Probe(state)
        for part in model.parts:
            if isinstance(part, RigidPlate):
                self.ask(f"plate {name}", part.motion_in, state)
        for question in ("energies", "applied", "reactions_by_place", "mean_stress", "mean_strain"):
            self.ask(f"{question} {name}", getattr(state, question))
        for place in (self.bottom, tuple(map(float, joint.points[0]))):
            self.ask(f"reaction {place} {name}", state.reaction, place)
        self.ask(f"share {name}", lambda: state.elastic_share)
        self.ask(f"u {name}", lambda: [state.integral(u * model.dx) for u in state.u])
        inner = joint.points[joint.cells].mean(axis=1)[[1, -2]]
        self.ask(f"inner {name}", lambda: [probe.displacement(inner), probe.stress(inner)])
        pairs = [(variable, key) for key, names in probe.names.items() for variable in names]
        self.ask(f"internal {name}", lambda: {pair: probe.points(*pair).values for pair in pairs})

    def on_seam(self, name: str, state: Any, surface: Surface, seam: str) -> None:
        """What S does, along it and inside its layer."""
        d, x = self.joint.dim, surface.x
        sums = lambda f: [surface.integral(f), surface.integral(f * x[0]), surface.norm(f)]
        for field in ("traction", "reaction", "jump"):
            self.ask(f"{field} {name}", lambda field=field: sums(getattr(surface, field)(state)))
        for field in ("status", "phase", "table", "contact"):
            self.ask(f"{field} {name}", getattr(surface, field), state)
        plane = {} if d == 2 else {"plane": ((0.0, 0.0, 0.21), (0.0, 0.0, 1.0))}
        opening = (surface.jump(state) * surface.n).sum(axis=0)
        lines = lambda: [
            [line.s @ line.values, sum(line.values), line.x[0], line.length] for line in surface.along(opening, **plane)
        ]
        self.ask(f"along {name}", lines)
        places = np.einsum("qa,sfad->sfqd", surface.shapes, surface.faces)[:, 1, 0]
        for side, at in zip(("lower", "upper"), places, strict=True):
            options = {"side": side, "seam": seam}
            self.ask(f"{side} {name}", lambda at=at, options=options: Probe(state).displacement(at, **options))
            self.ask(f"stress {side} {name}", lambda at=at, options=options: Probe(state).stress(at, **options))
        points = x[:d, [0, -1], 0].T
        self.ask(f"zoom {name}", lambda: [Zoom(state, seam).stress(points, height) for height in (-0.4, 0.2)])

    def of_estimates(self, reached: Any) -> None:
        """Goals, what is told of them, a thickness."""
        axis, seam, places = (0.6, -0.8, 0.3)[: self.joint.dim], next(iter(self.joint.seams)), self.joint.facets
        asked = [goals.Compliance(), goals.MeanTraction(axis, seam)]
        asked.append(goals.Functional("square", lambda u, model: ufl.inner(u, u) * model.dx))
        if self.top in places:
            asked.append(goals.Displacement(tuple(self.joint.points[places[self.top][0, 0]]), axis))
        if self.bottom in getattr(reached, "last", reached).reactions_by_place():
            asked.append(goals.Reaction(self.bottom, axis))
        answer = self.ask("estimate", lambda: estimate(reached, goals=asked))
        for goal in answer.goals if answer else ():
            self.ask(f"seams of {goal}", answer.by_seam, goal)
            self.ask(f"density of {goal}", answer.density, goal)
        if not self.seed % 4:
            options = {"seam": seam, "t": 1.0, "bodies": self.bodies}
            self.ask("thin enough", lambda: thin_enough(self.structure, self.layers, 0.05, **options).eps)


def of_file(state: Any, folder: Path) -> list[Any]:
    """Sums of the fields of a state's file."""
    fields.write(state, folder / "run.pvd")
    blocks = pyvista.read(next(folder.glob("run_pvd/*.vtm")))
    (time,) = re.findall('timestep="(.*?)"', (folder / "run.pvd").read_text())
    return [float(float(time) == state.t)] + [
        [key, name, np.abs(grid[name]).sum(), (grid[name] ** 2).sum()]
        for key, grid in zip(blocks.keys(), blocks, strict=True)
        for name in grid.array_names
        if np.asarray(grid[name]).dtype.kind == "f"
    ]
