"""The whole error of a layer's law and of all cells: intervals on given, uniform and adapted cells.

Four structures are solved by interface laws: a lap joint, a rubber bearing, a panel of masonry and an arch. Bounds of
the compliance of the continuum hold for any mesh; cells are refined where they are wide, or everywhere.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from forms import LinearElastic, Rubber
from geometry import read, sandwich, wall
from geometry.joint import Joint
from geometry.refining import refined
from geometry.topology import positions
from thinlayer import RangeWarning, Structure, ThinLayer, estimate, examples, goals, plotting, solve, solve_to
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.supports import Place, Support
from thinlayer.estimating.continuum import ContinuumBounds
from thinlayer.estimating.result import Estimate
from thinlayer.running.record import Record

young = LinearElastic.young
TOLERANCES = (0.05, 0.02, 0.01)  # half of the interval over the change by law and cells
COMPLIANCE = goals.Compliance()


def lap() -> InterfaceModel:
    """Make the lap joint of README, in mm and MPa, with 0.2 mm of glue."""
    joint = sandwich(width=40, lower=4, upper=6, h=1, h_S=0.4)
    supports: dict[Place, Support] = {"RIGHT/LOWER": 0, "LEFT/UPPER": {"y": 0}}
    plates = Structure(joint, body=young(210e3, 0.3), supports=supports, tractions={"LEFT/UPPER": (-60, 0)})
    return plates.interface(ThinLayer(young(2e3, 0.3), eps=0.2))


def bearing() -> InterfaceModel:
    """Make a strip of rubber, 60 mm wide and 6 mm thick, between steel plates, of which the upper one is lifted."""
    supports: dict[Place, Support] = {"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": 0.01}}
    plates = Structure(sandwich(60, 10, 10, h=4), body=young(210e3, 0.3), supports=supports)
    return plates.interface(ThinLayer(Rubber.shear(1.2, 0.49), eps=6, order=1))


def masonry() -> InterfaceModel:
    """Make a panel of two bricks and three courses, in mm and MPa, with 10 mm of elastic mortar in beds and heads."""
    joint = wall(2, 3, brick=(250, 75), h=25, cell="triangle")
    panel = Structure(joint, body=young(12e3, 0.2), supports={"BOTTOM": 0}, tractions={"TOP": (0.1, -0.5)})
    return panel.interface(ThinLayer(young(2e3, 0.2), eps=10))


def arch() -> InterfaceModel:
    """Make an arch of five stones, in m and MPa, with 10 mm of elastic mortar; its sides are polygons."""
    curved = read(examples.arch(), S="JOINTS", upper="EVEN STONES")
    load = (0.0, -0.05)
    stones = Structure(
        with_straight_cells(curved),
        body=young(20e3, 0.2),
        supports={"SPRINGINGS": 0},
        tractions={"EXTRADOS": load, "EXTRADOS/LAYER": load},
    )
    return stones.interface(ThinLayer(young(1e3, 0.2), eps=0.01), bodies="extended")


def with_straight_cells(joint: Joint) -> Joint:
    """Return a joint of curved cells with straight ones on the same vertices."""
    vertices, corners = np.unique(joint.corners, return_inverse=True)
    numbers = positions(vertices, len(joint.points))
    facets = {name: numbers[facets] for name, facets in joint.facets.items()}
    return replace(joint, points=joint.points[vertices], cells=corners.reshape(joint.corners.shape), facets=facets)


STRUCTURES: dict[str, Callable[[], InterfaceModel]] = {
    "lap": lap,
    "bearing": bearing,
    "masonry": masonry,
    "arch": arch,
}


def run(record: Record, *, quick: bool = False) -> None:
    """Bound compliances on given cells, on uniformly refined ones, and on cells adapted to 1 % of the change.

    The change is that of the compliance from the interface law on the given cells to the continuum. table.csv has a row
    for each mesh, and asked.csv the first adapted mesh for each tolerance. A full model of the last adapted cells, all of
    them halved, is the overkill that checks the intervals.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: the bearing alone, to 5 %.
    """
    table, asked = record.new_table("table.csv"), record.new_table("asked.csv")
    tolerances = TOLERANCES[:1] if quick else TOLERANCES
    for name in ["bearing"] if quick else STRUCTURES:
        model = STRUCTURES[name]()
        with warnings.catch_warnings(action="ignore", category=RangeWarning):
            adapted = solve_to(model, tolerance=tolerances[-1], of="change")
            value = overkill(adapted.estimate)
            uniform = uniform_rows(model, 1 if quick else 2)
        bounds = adapted.bounds["compliance"]
        middle, half = (bounds.lower + bounds.upper) / 2, (bounds.upper - bounds.lower) / 2
        columns = {key: adapted.table[key] for key in ("unknowns", "cells", "seconds")}
        columns |= {key: adapted.table[f"compliance {key}"] for key in ("lower", "upper")}
        rows = [dict(zip(columns, map(float, values), strict=True)) for values in zip(*columns.values(), strict=True)]
        change = value - bounds.value
        for kind, kind_rows in (("adapted", rows), ("uniform", uniform)):
            for row in kind_rows:
                row["error"] = (row["upper"] - row["lower"]) / 2 / abs(change)
                table.append({"structure": name, "mesh": kind, **row})
        for tolerance in tolerances:
            first = next(row for row in rows if row["error"] <= 1.02 * tolerance)
            asked.append({"structure": name, "tolerance": tolerance, **first})
        record.check(f"{name}: distance of the overkill from the middle, over half the interval",
                     abs(value - middle) / half, high=1.0)  # fmt: skip
        record.check(f"{name}: true error over the change", abs((value - middle) / change), high=tolerances[-1])
        lower, upper = (np.array([row[key] for row in [*rows, *uniform]]) for key in ("lower", "upper"))
        record.check(f"{name}: intervals intersect", (upper.min() - lower.max()) / abs(change), low=0.0)


def overkill(result: Estimate) -> float:
    """Return the compliance of a full model of an estimate's cells, all of them halved."""
    model, layers = result.better.model, result._subproblem
    assert isinstance(model, InterfaceModel)
    assert not isinstance(layers.cells_through, int)
    heights = {name: np.asarray(levels) for name, levels in layers.cells_through.items()}
    through = {name: np.sort(np.append(h, (h[1:] + h[:-1]) / 2)) for name, h in heights.items()}
    joint = refined(model.joint, np.arange(len(model.joint.cells)), model.joint.surface_rows)
    full = model.structure.with_joint(joint).full(
        model.on_seams, bodies=model._body_shape, cells_through={k: tuple(h) for k, h in through.items()}
    )
    return COMPLIANCE.value(solve(full), full)


def uniform_rows(model: InterfaceModel, n: int) -> list[dict[str, float]]:
    """Return the rows of the given cells, and of n refinements of all of them."""
    rows = []
    for k in range(n + 1):
        start = time.perf_counter()
        result = estimate(solve(model), cells_through=4 * 2**k)
        bounds: ContinuumBounds = result.continuum()["compliance"]
        n_cells = len(bounds.by_cell)
        rows.append({"unknowns": model.unknowns, "cells": n_cells, "seconds": time.perf_counter() - start,
                     "lower": bounds.lower, "upper": bounds.upper})  # fmt: skip
        if k < n:
            model = model.with_joint(refined(model.joint, np.arange(len(model.joint.cells)), model.joint.surface_rows))
    return rows


def draw(record: Record) -> None:
    """Draw half the interval over the change, from table.csv in the folder of `record`, over the unknowns."""
    panels = {}
    for name, part in record.load("table.csv").split("structure").items():
        panels[name] = {kind: (rows["unknowns"], rows["error"]) for kind, rows in part.split("mesh").items()}
    label = "half the interval over the change"
    plotting.curves(panels, "unknowns", label, styles=("o-", "s--"), log="xy", save=record.path("whole_error.svg"))
