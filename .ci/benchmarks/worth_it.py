"""Is it worth it? Cost and error of meshed layers and of interface laws, in four structures in 2D and 3D."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from forms.base import Array
from geometry import sandwich, wall
from studies.dropped import ignore_range_warnings
from studies.junctions import far_weights
from studies.problems import GLUE, GLUE_EPS, STEEL
from studies.sweeping import Curves
from studies.timing import timed, timed_in_turn
from studies.wall import BRICK_SIZE, CLAY, MORTAR
from thinlayer import Structure, Surface, ThinLayer, estimate, plotting, solve
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Place, Support
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.running.record import Record
from thinlayer.system.progress import track

ROWS = {1: "meshed, 1 row", 2: "meshed, 2 rows", 4: "meshed, 4 rows"}  # number of rows of cells -> label of the model
ORDERS, BETTER, BONDED = ("law, order 0", "law, order 1"), "estimate's better", "bonded"
STYLES = dict(zip((*ROWS.values(), *ORDERS, BETTER, BONDED), "sDPo^vX", strict=True))  # label -> marker in the picture


def lap_joint(fine: bool) -> Structure:
    """Make the two plates of README, mm and MPa, with the cells of the compared models or those of the reference."""
    joint = sandwich(width=40, lower=4, upper=6, h=1, h_S=0.1 if fine else 0.4, h_ends=0.02 if fine else 0.1)
    supports: dict[Place, Support] = {"RIGHT/LOWER": 0.0, "LEFT/UPPER": {"y": 0.0}}
    return Structure(joint, body=STEEL, supports=supports, tractions={"LEFT/UPPER": (-60.0, 0.0)})


def butt_joint(fine: bool) -> Structure:
    """Make two steel blocks in 3D, pulled and sheared, mm and MPa; see `lap_joint` about cells."""
    joint = sandwich(20, 10, 10, 2.5 if fine else 5, depth=10, h_ends=0.5 if fine else 1, cell="hexahedron")
    return Structure(joint, body=STEEL, supports={"BOTTOM": 0.0}, tractions={"TOP": (10.0, 30.0, 5.0)})


def masonry(bricks: int, courses: int, h: tuple[float, float], depth: float | None, fine: bool) -> Structure:
    """Make a wall, pressed and sheared, mm and MPa; `h`: cell sizes of the compared models and of the reference."""
    joint, load = wall(bricks, courses, BRICK_SIZE, h[fine], depth=depth), (0.3, -1.0, 0.1)
    return Structure(joint, body=CLAY, supports={"BOTTOM": 0.0}, tractions={"TOP": load[: joint.dim]})


# name -> structure, as a function of whether its cells are those of the reference; layer; fewest rows of its cells
CASES: Mapping[str, tuple[Callable[[bool], Structure], ThinLayer, int]] = {
    "lap joint": (lap_joint, ThinLayer(GLUE, GLUE_EPS), 1),
    "wall": (partial(masonry, 4, 5, (75 / 4, 75 / 12), None), ThinLayer(MORTAR, 3.0), 2),
    "butt joint in 3D": (butt_joint, ThinLayer(GLUE, 0.5), 1),
    "wall in 3D": (partial(masonry, 2, 2, (75 / 2, 75 / 3), 100.0), ThinLayer(MORTAR, 3.0), 2),
}


def run(record: Record, *, quick: bool = False) -> None:
    """Solve four structures by models with the same cells of the bodies, and compare their costs and errors.

    table.csv has for each model its unknowns, the processor time of making and solving it without compilation, and the
    relative errors of the energy and of the tractions, on all of S and inside. Facets are inside if they are farther
    than 8 thicknesses from ends and junctions. The reference has 8 rows of cells through the layer, and smaller cells
    of the bodies. sweep.csv has the processor time of a sweep over thicknesses, from the mesh of the bodies on: by the
    law of order 0, and by the meshed layer with the fewest rows, with the same bodies ("meshed") or with bodies that
    are meshed for each thickness ("meshed anew").

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: fewer runs, of which the fastest counts, and fewer thicknesses.
    """
    table, sweeps = record.new_table("table.csv"), record.new_table("sweep.csv")
    for name in track(list(CASES), "worth_it", "{}"):
        with ignore_range_warnings():
            rows = compare_models(record, name, 2 if quick else 5)
            table.extend({"structure": name, "model": label, **row} for label, row in rows.items())
            sweeps.append({"structure": name, **sweep_seconds(name, 4 if quick else 20)})


def compare_models(record: Record, name: str, runs: int) -> dict[str, dict[str, float]]:
    """Solve the structure `name` by each model, in some runs, and check the results.

    Returns:
        Label of a model -> numbers in its row of table.csv.
    """
    make, layer, fewest = CASES[name]
    structure, reference = make(False), solve(make(True).full(layer, cells_through=8))
    surface, rows = Surface(structure.bonded()), dict[str, dict[str, float]]()
    parts = {"traction": np.ones_like(surface.weights), "traction inside": far_weights(surface, 8 * layer.eps)}
    tractions = tractions_at(surface, reference)

    def add_row(label: str, seconds: float, bodies: State, layers: State, work: float) -> None:
        row = {"unknowns": bodies.model.unknowns, "seconds": seconds, "work": work}
        rows[label] = row | {"error energy": abs(work / reference.load_work() - 1)}
        difference = surface.traction(layers) - tractions
        for part, where in parts.items():
            rows[label][f"error {part}"] = surface.norm(difference, where) / surface.norm(tractions, where)

    models: dict[str, Callable[[], Model]] = {BONDED: structure.bonded}
    models |= {ROWS[n]: partial(structure.full, layer, cells_through=n) for n in (fewest, 4)}
    for n in (0, 1) if fewest == 1 else (0,):  # where layers meet, there is no law of order 1
        models[ORDERS[n]] = partial(structure.interface, replace(layer, order=n))

    def solved(label: str) -> State:
        return solve(models[label]())

    for label, (seconds, state) in timed_in_turn({label: partial(solved, label) for label in models}, runs).items():
        add_row(label, seconds, state, state, state.load_work())
    ((seconds, estimated),) = timed_in_turn({BETTER: lambda: estimate(solved(ORDERS[0]))}, runs).values()
    goal, law, four = estimated.goals["compliance"], rows[ORDERS[0]], rows[ROWS[4]]
    add_row(BETTER, seconds, estimated.better, estimated.inside, goal.better)
    record.check(f"{name}: work, 4 rows, between bounds", four["work"], low=goal.lower, high=goal.upper)
    record.check(f"{name}: unknowns, 4 rows over law", four["unknowns"] / law["unknowns"], low={1: 1.3, 2: 2.0}[fewest])
    record.check(f"{name}: energy, bonded over law", rows[BONDED]["error energy"] / law["error energy"], low=10.0)
    for error in ("error energy", "error traction inside") if ORDERS[1] in rows else ():
        record.check(f"{name}: {error}, order 1 over order 0", rows[ORDERS[1]][error] / law[error], high=0.5)
    return {label: rows[label] for label in STYLES if label in rows}


def tractions_at(surface: Surface, reference: State) -> Array:
    """Return the tractions of a state with another mesh of S at the quadrature points of `surface`, (d, n, q)."""
    tractions = np.zeros_like(surface.x)
    for name in surface.joint.seams:
        facets, other = surface.seams == name, Surface(reference.model, name)
        places, at = other.at(surface.x[:, facets].reshape(len(surface.x), -1).T)
        nodal = other.nodal(other.traction(reference))[other.nodes[at.rows]]
        values = places.point_means(np.einsum("pqk,pkd->pd", at.shapes, nodal))
        tractions[:, facets] = values.T.reshape(surface.x[:, facets].shape)
    return tractions


def sweep_seconds(name: str, count: int) -> dict[str, float]:
    """Return the seconds of sweeps over `count` thicknesses of the structure `name`, for its row of sweep.csv."""
    make, layer, fewest = CASES[name]

    def sweep(make_model: Callable[[ThinLayer], Model]) -> None:
        for share in np.linspace(0.5, 1.5, count):
            solve(make_model(replace(layer, eps=share * layer.eps)))

    works = {"seconds law": lambda: sweep(make(False).interface(layer).with_layer)}
    works["seconds meshed"] = lambda: sweep(partial(make(False).full, cells_through=fewest))
    works["seconds meshed anew"] = lambda: sweep(lambda thin_layer: make(False).full(thin_layer, cells_through=fewest))
    return {"thicknesses": count} | {way: min(timed(work)[0] for _ in range(2)) for way, work in works.items()}


def draw(record: Record) -> None:
    """Draw the error of the energy over the time of each model, a panel for each structure, from table.csv."""
    panels, (blue, orange, *_) = dict[str, Curves](), COLOURS
    for name, rows in record.load("table.csv").split("structure").items():
        models = rows.split("model")
        unit = models[BONDED]["seconds"]
        panels[name] = {label: (row["seconds"] / unit, row["error energy"]) for label, row in models.items()}
    colours = {label: orange if "meshed" in label else blue for label in STYLES} | {BONDED: "black"}
    look = {"styles": STYLES, "colours": colours, "log": "y", "xlim": (0, 15), "ylim": (5e-6, 1), "columns": 2}
    xlabel, look["save"] = "time over that of bonded bodies", record.path("worth_it.svg")
    plotting.curves(panels, xlabel, "relative error of the energy", **look)
