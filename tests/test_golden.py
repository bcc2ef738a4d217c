"""Golden numbers: what each capability gave before the house was rebuilt.

They are no truths: other tests compare with closed forms and meshed layers. They hold every number while code moves. Meshes
are structured, so that no mesher changes them. `python3 -m tests.test_golden` writes them anew.

Tolerances are relative to a number, or to 1e-4 of the largest one of its case. CLOSE: Newton's method ends at 1e-10 of the
forces, and a layer is up to a hundred times softer than the bodies. ITERATED: a contact, a limit load or a thickness is
found by an iteration with a tolerance of its own.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from forms import (
    Anisotropic,
    HolonomicCoulomb,
    Incompressible,
    IncrementalCoulomb,
    KelvinVoigt,
    LinearElastic,
    Maxwell,
    MohrCoulomb,
    MohrCoulombMonodirectional,
    NonMonotone,
    NonMonotoneUnrelaxed,
    Norton,
    NortonCreep,
    Rubber,
    Stack,
    Tresca,
    VonMises,
)
from geometry import block, bond_cell, ring, sandwich, wall
from geometry.joint import Joint
from tests.on_ranks import on_ranks
from tests.softening_bars import STEEP
from thinlayer import (
    ArcLength,
    Gap,
    LimitLoad,
    PointLoad,
    Pressure,
    Prestress,
    Probe,
    RigidPlate,
    Springs,
    Structure,
    Surface,
    ThinLayer,
    Zoom,
    compare,
    estimate,
    goals,
    homogenised_stiffness,
    march,
    piecewise,
    solve,
    thin_enough,
)
from thinlayer.discretisation.state import State

NUMBERS = Path(__file__).parent / "golden.json"
CLOSE, ITERATED = 1e-7, 1e-5
EPS = 0.05
STEEL, STONE = LinearElastic.young(E=280.0, nu=0.2), LinearElastic.young(E=350.0, nu=0.31)
GLUE, SOFT = LinearElastic.shear(3.0, 0.35), LinearElastic.shear(1.1, 0.485)
CASES: dict[str, tuple[Callable[[], Any], float]] = {}


def layer(law: Any, eps: float = EPS, **more: Any) -> ThinLayer:
    """A layer of a material."""
    return ThinLayer(law, eps, **more)


def case(close: float = CLOSE) -> Callable[[Callable[[], Any]], Callable[[], Any]]:
    def kept(run: Callable[[], Any]) -> Callable[[], Any]:
        CASES[run.__name__] = cache(run), close
        return run

    return kept


@cache
def plates(dim: int = 2, h: float = 0.25, cell: str | None = "quadrilateral", **more: float) -> Joint:
    depth = {} if dim == 2 else {"depth": 0.5}
    shape = cell if dim == 2 else {"quadrilateral": "hexahedron", "triangle": "tetrahedron"}[cell or "triangle"]
    return sandwich(1.5, 0.25, 0.5, h, cell=shape, structured=True, **depth, **more)


def pushed(joint: Joint | None = None, **overrides: Any) -> Structure:
    """Plates that are pressed and pushed in time."""
    joint = plates() if joint is None else joint
    load = (0.3, -1.0, 0.2)[: joint.dim]
    data: dict[str, Any] = {"body": {"LOWER": STEEL, "UPPER": STONE}, "supports": {"BOTTOM": 0}}
    data["tractions"] = {"TOP": lambda x, t: tuple((1 + 0.5 * x[0]) * t * c for c in load)}
    return Structure(joint, **(data | overrides))


def summary(state: State) -> list[float]:
    """Energies, reaction and norms on S."""
    energies, surface = state.energies(), Surface(state.model)
    force = state.reaction("BOTTOM").force
    values = [energies[name] for name in ("bodies", "layer", "loads") if name in energies]
    return [*values, *np.ravel(force).tolist(), *map(surface.norm, (surface.traction(state), surface.jump(state)))]


TIMES = [0.5, 1.0, 2.0]
CHI = [[0.2, 0.5], [0.5, 1.0]]
LAWS: dict[str, Any] = {
    "elastic": GLUE,
    "anisotropic": Anisotropic(np.diag([5.0, 6.0, 7.0, 2.0, 2.5, 3.0]), "layer"),
    "incompressible": Incompressible(2.0),
    "Kelvin-Voigt": KelvinVoigt(3.0, 2.0, 1.5, 0.8),
    "Maxwell": Maxwell(3.0, 2.0, 2.0, 3.0),
    "Norton": Norton(3.0, 2.0, 5.0, 1.5),
    "creep": NortonCreep(3.0, 2.0, 0.05, 3.0),
    "Mohr-Coulomb": MohrCoulomb(3.0, 2.0, cohesion=0.4, friction_angle=20.0, dilatancy_angle=5.0),
    "slipping": MohrCoulombMonodirectional(3.0, 2.0, cohesion=0.1, friction_angle=20.0),
    "von Mises": VonMises(3.0, 2.0, strength=0.8, hardening=0.5),
    "non-monotone": NonMonotone(3.0, 2.0, 0.5, 0.08, CHI),
    "pure phases": NonMonotoneUnrelaxed(3.0, 2.0, 0.5, 0.08, CHI),
    "stack": Stack((0.4, GLUE), (0.6, Maxwell(30.0, 20.0, 0.7))),
}


def of_law(name: str) -> Callable[[], list[float]]:
    def run() -> list[float]:
        structure, glue = pushed(), layer(LAWS[name])
        models = structure.interface(glue), structure.full(glue, cells_through=2)
        first, second = (march(model, TIMES).last for model in models)
        return [*summary(first), *list(second.energies().values())[:2], *np.ravel(second.reaction("BOTTOM").force)]

    return run


for _name in LAWS:
    CASES[f"law {_name}"] = cache(of_law(_name)), CLOSE


@case()
def orders() -> list[float]:
    """Order 1 between rollers and at free ends, of one law, sublayers, rubber and a pressure; errors against meshes."""
    values = []
    rollers = {"BOTTOM": 0, "LEFT": {"x": 0}, "RIGHT": {"x": 0}}
    steady = {"tractions": {"TOP": lambda x, t: (0.3 * x[0], -1 + x[0])}}
    for supports in (rollers, {"BOTTOM": 0}):
        structure = pushed(supports=supports, **steady)
        for law in (GLUE, Stack((0.4, GLUE), (0.6, SOFT)), Rubber.shear(1.1, 0.485), Incompressible(1.1)):
            for order in (0, 1):
                values += summary(solve(structure.interface(layer(law, order=order))))[:2]
    full = solve(structure.full(layer(GLUE), cells_through=2))
    for edges in ("plain", "free"):
        row = compare(full, solve(structure.interface(layer(GLUE, order=1, edges=edges))))
        values += [row["error_traction"], row["error_jump"]]
    return values


@case()
def kinematics() -> list[float]:
    """Plane stress, bodies of revolution, three dimensions, both shapes of cells, extended bodies, a profile, curves."""
    values = []
    for model in (
        pushed(plane="stress").interface(layer(LAWS["von Mises"])),
        pushed(plane="axisymmetric").interface(layer(GLUE, order=1)),
        pushed(plates(cell="triangle")).interface(layer(GLUE)),
        pushed(plates(3)).interface(layer(LAWS["Mohr-Coulomb"])),
        pushed(plates(3, 0.5, cell="triangle")).interface(layer(GLUE, order=1)),
        pushed().interface(layer(GLUE, order=1), bodies="extended"),
        pushed().interface(layer(GLUE, profile=lambda x: 1 + 0.3 * x[0])),
    ):
        values += summary(march(model, [1.0]).last)
    pressed = {"supports": {"INSIDE": 0}, "tractions": {"OUTSIDE": Pressure(0.3)}}
    shaft = Structure(ring(1.0, 2.0, 3.0, 0.5, cell="quadrilateral"), body=STEEL, **pressed)
    for model in (shaft.interface(layer(GLUE)), shaft.full(layer(GLUE), bodies="extended", cells_through=2)):
        values += list(solve(model).energies().values())[:2]
    return values


@case()
def supports_and_loads() -> list[float]:
    """Rollers on a slope, plates, springs, moved supports, tables, weight, points, heat, stress in situ, loads on sides."""
    slope = {"BOTTOM": {"n": 0.01}, "LEFT/LOWER": {"x": 0}}
    history = piecewise({0: 0, 1: 0.2, 3: 0.8})
    resting = {"supports": {}, "parts": [Springs("BOTTOM", 40.0, lambda x: 10 + 5 * x[0])]}
    moved = {"BOTTOM": 0, "TOP": {"y": -0.013, "x": lambda x, t: 0.004 * x[0] * t}}
    structures = [
        pushed(plates().rotated(0.3), supports=slope),
        pushed(parts=[RigidPlate("TOP", force=(0.7, -0.4), moment=0.3)], tractions={"RIGHT/UPPER": (0.3, -1.0)}),
        pushed(parts=[RigidPlate("TOP", force=(0.7, 0.0), motion={"y": lambda x, t: -0.01 * t})], tractions={}),
        pushed(**resting),
        pushed(supports=moved, tractions={"LEFT/UPPER": (0.3, -1.0)}),
        pushed(tractions={"TOP": lambda x, t: (history(x, t), -0.1)}),
        pushed(tractions={}, body_force={"LOWER": (0, -0.3), "UPPER": (0.1, -0.2), "S": (0, -4.0)}),
        pushed(tractions={}, loads=[PointLoad((1.5, 0.5), (0.3, -0.2))]),
        pushed(eigenstrain={"UPPER": 0.002, "LOWER": lambda x, t: 1e-3 * (1 + x[0] * t)}),
        pushed(eigenstrain={"UPPER": Prestress(((-0.4, 0.1), (0.1, -0.7)))}),
    ]
    states = [march(structure.interface(layer(GLUE)), [1.0, 2.0]).last for structure in structures]
    sides = pushed(tractions={"RIGHT/UPPER": (0.3, -0.1), "RIGHT/LAYER": (0.4, 0.2)})
    states.append(solve(sides.interface(layer(GLUE, order=1))))
    states.append(solve(pushed().interface(layer(GLUE, eigenstrain=0.01))))
    values = []
    for state in states:
        force = (
            next(iter(state.reactions_by_place().values())).force if state.model.held_places else state.applied().force
        )
        energies = state.energies()
        values += [energies["bodies"], energies["layer"], *np.ravel(force)]
    return values


MORTAR = {"BED": layer(LinearElastic(0.008, 0.021)), "HEAD": layer(LinearElastic(0.004, 0.013), 0.7 * EPS)}


def bricks(dim: int = 2, **overrides: Any) -> Structure:
    depth = {} if dim == 2 else {"depth": 0.5}
    supports = {"BOTTOM": 0.0, "TOP": {"x": lambda x, t: 0.01 * t, "y": lambda x, t: -0.02 * t}}
    data = {"body": LinearElastic.young(1.0, 0.2), "supports": supports}
    return Structure(wall(2, 2, (1.0, 0.5), 0.25, **depth), **(data | overrides))


@case()
def networks() -> list[float]:
    """Walls in two dimensions and three, by laws and meshed, open heads, heads that yield, what happens to which layer."""
    heads = {"HEAD": layer(MohrCoulomb(0.02, 0.03, cohesion=2e-5, friction_angle=30.0), 0.7 * EPS)}
    models = [bricks().interface(MORTAR), bricks().full(MORTAR, cells_through=2)]
    models += [bricks().interface(MORTAR | {"HEAD": None}), bricks().full(MORTAR | {"HEAD": Gap(EPS)}, cells_through=2)]
    models += [bricks(3).interface(MORTAR), bricks().interface(MORTAR | heads)]
    states = [march(model, [0.5, 1.0]).last for model in models]
    values = [energy for state in states for energy in list(state.energies().values())[:2]]
    for seam in ("BED", "HEAD"):
        surface = Surface(models[0], seam)
        values += [surface.norm(surface.traction(states[0])), surface.norm(surface.jump(states[0]))]
    return values


@case()
def periodic_cells() -> list[float]:
    """Stiffness of a bond; a cell under a mean strain and a mean stress, with heads that yield."""
    cell = bond_cell((2.0, 1.0), 0.5)
    body = LinearElastic.young(1.0, 0.2)
    strained = Structure(cell, body=body, supports={}, strain=lambda x, t: ((0.0, 0.01 * t), (0.01 * t, -0.002 * t)))
    stressed = Structure(cell, body=body, supports={}, stress=((0.1, 0.02), (0.02, -0.3)))
    heads = {"HEAD": layer(MohrCoulomb(0.02, 0.02, cohesion=2e-5, friction_angle=30.0))}
    state = march(strained.interface(MORTAR | heads), [0.5, 1.0]).last
    other = solve(stressed.interface(MORTAR))
    arrays = [homogenised_stiffness(Structure(cell, body=body, supports={}).interface(MORTAR)), state.mean_stress()]
    return [float(value) for array in (*arrays, other.mean_strain(), other.mean_stress()) for value in np.ravel(array)]


def pressed_block() -> Structure:
    joint = block(3.0, 1.0, 0.25, cell="quadrilateral", structured=True)
    supports = {"TOP": {"x": piecewise({0: 0.0, 2: 0.06, 4: -0.06}), "y": -0.02}}
    return Structure(joint, body=LinearElastic.young(400.0, 0.3), supports=supports, element="Q1")


def to_and_fro(method: str) -> list[float]:
    model = pressed_block().interface(IncrementalCoulomb(300.0, 80.0, 0.4))
    return amounts(march(model, [1.0, 2.0, 3.0], method=method).last)


@case(ITERATED)
def contact_by_multigrid() -> list[float]:
    return to_and_fro("multigrid")


@case(ITERATED)
def contact() -> list[float]:
    """Contact by other methods, two bodies, a wall."""
    values = [number for method in ("condensed", "newton") for number in to_and_fro(method)]
    sliding = pressed_block()
    for law in (HolonomicCoulomb(300.0, 80.0, 0.4, 0.1), Tresca(300.0, 80.0, 2.0)):
        values += amounts(solve(sliding.interface(law), 1.0))
    values += amounts(solve(pushed(element="Q1").interface(IncrementalCoulomb(300.0, 80.0, 0.6)), 1.0))
    dry = {"BED": IncrementalCoulomb(200.0, 80.0, 0.5), "HEAD": IncrementalCoulomb(100.0, 40.0, 0.3)}
    loads = {"TOP": lambda x, t: (0.2 * t, -1.0)}
    stones = bricks(supports={"BOTTOM": 0.0}, tractions=loads, body=LinearElastic.young(50.0, 0.2), element="Q1")
    for method in ("condensed", "newton"):
        state = march(stones.interface(dry), [0.5, 1.0], method=method).last
        values += [state.energies()["bodies"], *state.reaction("BOTTOM").force]
    return values


def amounts(state: State) -> list[float]:
    report = Surface(state.model).contact(state)
    counts = [float(number) for _, number in sorted(report.counts.items())]
    return [report.normal_force, *np.ravel(report.friction_force), *counts]


@case(ITERATED)
def limits_and_paths() -> list[float]:
    """The load at which a layer has yielded everywhere; a bar that snaps, and its path by arc length."""
    yielding = layer(LAWS["Mohr-Coulomb"])
    values = []
    for method in (None, "newton"):
        with pytest.raises(LimitLoad) as stopped:
            march(pushed(tractions={"TOP": lambda x, t: (t, -1.0)}).interface(yielding), [0.2, 0.4, 3.0], method=method)
        values += [stopped.value.history.last.t, *stopped.value.history.last.applied().force]
    pulled = piecewise({0: 0, 1: -2.0, 2: 0})
    rollers = {"BOTTOM": 0, "LEFT": {"x": 0}, "RIGHT": {"x": 0}}
    bar = pushed(supports=rollers, tractions={"TOP": lambda x, t: (0, pulled(x, t))})
    history = march(bar.interface(layer(LAWS["pure phases"])), [0.5, 1.0, 1.5, 2.0])
    values += [*history.t, *(state.energies()["layer"] for state in history), float(len(history.snaps))]
    return values


@case()
def paths_by_arc_length() -> list[float]:
    joint = block(0.5, 1.0, 0.25, cell="quadrilateral", structured=True)
    supports = {"TOP": {"y": lambda x, t: t}, "LEFT": {"x": 0}, "RIGHT": {"x": 0}}
    bar = Structure(joint, body=LinearElastic.young(1.0, 0.0), supports=supports)
    history = march(bar.interface(STEEP), ArcLength(end=1.0, first=0.05, largest=1))
    return [float(len(history)), *history.t[::3], *(state.energies()["layer"] for state in history)]


@case()
def bodies_that_yield() -> list[float]:
    metal = VonMises(120.0, 90.0, strength=1.6, hardening=40.0)
    soil = MohrCoulomb(120.0, 90.0, cohesion=1.1, friction_angle=20.0)
    values = []
    for body in (metal, soil, KelvinVoigt(120.0, 90.0, 1.5, 0.8)):
        values += summary(march(pushed(body=body).interface(layer(LAWS["Mohr-Coulomb"])), [0.5, 0.75]).last)
    varying = LinearElastic(lambda x: 400 + 100 * x[0], 290.0)
    return [*values, *summary(solve(pushed(body=varying).interface(layer(GLUE)), 1.0))]


@case(ITERATED)
def estimates() -> list[float]:
    """Errors and goals of estimates: between plates, rubber, yielding layers, in time, bonded; thicknesses."""
    some = [goals.Compliance(), goals.MeanTraction((0.3, -1.0)), goals.Reaction("BOTTOM", (0.3, -1.0))]
    some.append(goals.Displacement((0.41, 0.25), (0.3, -1.0)))
    steady = pushed(supports={"BOTTOM": 0, "TOP": {"y": -0.02}}, tractions={"RIGHT/UPPER": (0.3, -1.0)})
    states = [solve(steady.interface(layer(law))) for law in (GLUE, SOFT)]
    states.append(march(steady.interface(layer(LAWS["Maxwell"])), [0.5, 1.0]))
    states.append(solve(steady.interface(layer(VonMises(4.0, 3.0, strength=0.15, hardening=2.0)))))
    values = []
    answers = [estimate(state, goals=some) for state in states]
    answers.append(estimate(solve(steady.bonded()), layer(GLUE), goals=some))
    for told_of in answers:
        values += [told_of.traction, told_of.jump]
        values += [number for goal in told_of.goals.values() for number in (goal.value, goal.change)]
    rollers = {"BOTTOM": 0, "LEFT": {"x": 0}, "RIGHT": {"x": 0}}
    confined = pushed(supports=rollers, tractions={"TOP": lambda x, t: (0.3 * x[0], -1 + x[0])})
    values.append(thin_enough(confined, layer(GLUE), tolerance=0.02, goal="traction").eps)
    return [math.nan if value is None else float(value) for value in values]


@case()
def inside() -> list[float]:
    """Stresses inside a layer, strengths of its corners, values at places."""
    state = solve(pushed(plates(h=0.125)).interface(layer(GLUE, order=1, edges="free")), 1.0)
    zoom, probe = Zoom(state), Probe(state)
    arrays = [zoom.stress([[0.7, 0.0], [0.04, 0.0], [1.49, 0.0]], [-0.2, 0.1, 0.4])]
    arrays += [corner.H for corner in zoom.corners]
    arrays += [probe.displacement([[0.4, 0.1], [0.9, 0.6 - 0.4]], side=None), probe.stress([[0.4, 0.1]])]
    return [float(value) for array in arrays for value in np.ravel(array)]


def numbers(name: str) -> list[float]:
    return [float(value) for value in CASES[name][0]()]


ON_RANKS = ["law Mohr-Coulomb", "law pure phases", "periodic_cells", "supports_and_loads", "contact_by_multigrid"]


def on_several_ranks() -> dict[str, list[float]]:
    return {name: numbers(name) for name in ON_RANKS}


def assert_golden(name: str, values: list[float]) -> None:
    golden, close = np.array(json.loads(NUMBERS.read_text())[name], float), CASES[name][1]
    size = np.maximum(np.abs(golden), 1e-4 * np.nanmax(np.abs(golden)))
    assert len(values) == len(golden)
    assert np.isnan(values).tolist() == np.isnan(golden).tolist()
    deviation = np.nan_to_num(np.abs(values - golden) / size)
    assert deviation.max() <= close, f"number {deviation.argmax()} of {name!r}: {values[deviation.argmax()]!r}"


@pytest.mark.few(5)
@pytest.mark.filterwarnings("ignore::thinlayer.RangeWarning")
@pytest.mark.parametrize("name", CASES)
def test_golden(name: str) -> None:
    assert_golden(name, numbers(name))


@on_ranks(on_several_ranks, 2, 3)
def test_golden_on_several_ranks(there: dict[str, list[float]]) -> None:
    for name, values in there.items():
        assert_golden(name, values)


if __name__ == "__main__":
    rows = [f"{json.dumps(name)}: {json.dumps([float(f'{x:.13g}') for x in numbers(name)])}" for name in CASES]
    NUMBERS.write_text("{" + ",\n".join(rows) + "}\n")
