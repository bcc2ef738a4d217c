"""Coated fibre: its interphase meshed and as a law on S, a circle, both against closed forms; curved cells."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from forms import LinearElastic
from geometry import fibre, periodic
from geometry.parallel import on_root
from studies.concentric import Cylinders
from studies.sweeping import Solution, Sweep, draw_rates, last, layer_of
from thinlayer import State, Structure, Table, ThinLayer, homogenised_stiffness, observed_orders, plotting, solve
from thinlayer.output.grid import gather
from thinlayer.running.record import Record

EPS = (0.08, 0.04, 0.02, 0.01)  # over the radius of the matrix
SIZES = (0.1, 0.05, 0.025)
RADIUS, RIM = 0.4, 1.0
CELL = (1.2, 1.0)  # width and height of the periodic cell
STRETCH = 0.1  # of the rim, along x
GLASS, RESIN = LinearElastic.young(E=5.0, nu=0.3), LinearElastic.young(E=1.0, nu=0.2)
COATING = LinearElastic(lmbda=0.6, mu=0.7)  # at the thickness 1
ORDERS = {1: (1.8, 2.2), 2: (3.3, 5.0)}  # degree of cells -> range of the observed order of the energy in h


def run(record: Record, *, eps: Sequence[float] = EPS, quick: bool = False) -> None:
    """A fibre in a disc of resin whose rim is stretched along x. Without units.

    The interface model's energy against its closed form on finer and finer meshes: order 2 with straight cells, whose S
    is a polygon, 4 with curved ones. The interphase's thickness against the interface law: error O(eps), the same as that
    of the closed forms of three cylinders in one another and of two with springs between. A periodic cell of such fibres as
    a whole: the same rate.

    Args:
        record: where to write.
        eps: thicknesses of the interphase; one half is taken from the fibre, one from the matrix.
        quick: coarser meshes.
    """
    record.parameters = {
        "radii": (RADIUS, RIM), "stretch": STRETCH, "fibre": str(GLASS), "matrix": str(RESIN), "coating": str(COATING)
    }  # fmt: skip
    refine(record, SIZES[:2] if quick else SIZES)
    sweep = Sweep(
        record,
        fibre(RADIUS, RIM, 0.1 if quick else 0.05, cell="quadrilateral", degree=2),
        setup(),
        lambda e: ThinLayer(COATING, e, at=1.0),
        bodies="extended",
        more=against_closed_forms,
    )
    table = sweep.run(eps, (0.9, 1.1), title="a coated fibre, stretched along x")
    ratio = np.array(table["error_jump"]) / np.array(table["closed_form"])
    record.check("error of the jump over that of the closed forms, less 1", abs(ratio - 1).max(), high=2e-3)
    record.check("energy of the meshed model, relative error", max(table["energy"]), high=5e-5)
    along_axis(record, sweep, max(eps))
    homogenise(record, eps, 0.1 if quick else 0.05)


def setup() -> dict[str, Any]:
    """The data of the structure."""
    rim = {"x": lambda x, t: STRETCH * x[0], "y": 0.0}
    return {"body": {"FIBRE": GLASS, "MATRIX": RESIN}, "supports": {"OUTSIDE": rim}}


def with_springs() -> Cylinders:
    """The closed form of the interface model."""
    springs = (COATING.lmbda + 2 * COATING.mu, COATING.mu)
    return Cylinders.stretched((GLASS, RESIN), (RADIUS, RIM), [springs], (STRETCH, 0.0))


def with_layer(eps: float) -> Cylinders:
    """The closed form of the full model."""
    real = LinearElastic(eps * COATING.lmbda, eps * COATING.mu)
    radii = (RADIUS - eps / 2, RADIUS + eps / 2, RIM)
    return Cylinders.stretched((GLASS, real, RESIN), radii, [None, None], (STRETCH, 0.0))


def jump_error(eps: float) -> float:
    """Relative L2 difference of the jump across the coating in closed form from that of the interface law."""
    layer, springs = with_layer(eps), with_springs().jumps(0)
    ends = [[layer.fields(mode, k, r)[:2] for mode in (0, 2)] for k, r in ((0, layer.radii[0]), (2, layer.radii[1]))]
    weights = np.array([[2.0], [1.0]])  # of the squares of both modes in integrals over the circle
    error = (weights * (np.array(ends[1]) - ends[0] - springs) ** 2).sum() / (weights * springs**2).sum()
    return float(np.sqrt(error))


def against_closed_forms(full: Solution, limit: Solution) -> dict[str, float]:
    """Columns of the table: the error of the jump in closed form, the relative error of the full model's energy."""
    eps = float(layer_of(full).eps)
    exact = with_layer(eps).energy
    return {"closed_form": jump_error(eps), "energy": abs(energy(last(full)) / exact - 1)}


def energy(state: State) -> float:
    """Stored energy."""
    found = state.energies()
    return float(found["bodies"] + found["layer"])


def refine(record: Record, sizes: Sequence[float]) -> None:
    """The energy of the interface model on finer and finer meshes."""
    table, exact = record.table("refinement.csv"), with_springs().energy
    for degree, (low, high) in ORDERS.items():
        errors = []
        for h in sizes:
            model = Structure(fibre(RADIUS, RIM, h, degree=degree), **setup()).interface(
                ThinLayer(COATING, 0.01, at=1.0)
            )
            errors.append(abs(energy(record.solved(solve(model))) / exact - 1))
            order = observed_orders(sizes[: len(errors)], errors)[-1]
            row = {"degree": degree, "h": h, "cells": len(model.joint.cells), "error_energy": errors[-1]}
            table.append(row | {"order": order})
        record.check(f"observed order of the energy in h, cells of degree {degree}", order or 0.0, low=low, high=high)
    record.say(table)


def homogenise(record: Record, eps: Sequence[float], h: float) -> None:
    """Stiffness of a periodic cell of coated fibres as a whole, the coating meshed and as a law on S: error O(eps)."""
    cell = periodic(fibre(RADIUS, CELL, h, degree=2), ("LEFT", "RIGHT"), ("BOTTOM", "TOP"))
    structure, table = Structure(cell, body=setup()["body"], supports={}), record.table("homogenised.csv")
    errors: list[float] = []
    for e in eps:
        layer = ThinLayer(COATING, e, at=1.0)
        full, limit = (
            homogenised_stiffness(m) for m in (structure.full(layer, bodies="extended"), structure.interface(layer))
        )
        errors.append(float(np.abs(full - limit).max() / np.abs(limit).max()))
        order = observed_orders(eps[: len(errors)], errors)[-1]
        row = {"eps": e, "C_11": full[0, 0], "C_22": full[1, 1], "C_12": full[0, 1], "C_66": full[2, 2]}
        table.append({name: float(value) for name, value in row.items()} | {"error": errors[-1], "order": order})
    record.say(table)
    record.check("observed order of the homogenised stiffness in eps", order or 0.0, low=0.85, high=1.15)


def along_axis(record: Record, sweep: Sweep, eps: float) -> None:
    """u_x along the x axis, of both models and of both closed forms."""
    table = Table()
    closed = {"meshed interphase": with_layer(eps), "interface law": with_springs()}
    for (name, cylinders), state in zip(closed.items(), sweep.solved(eps), strict=True):
        grid = gather(last(state))
        for x, u in on_root(None, partial(axis_of, grid.points, grid.u)):
            table.append({"model": name, "x": x, "u_x": u, "kind": "nodes"})
        inner = 0.0
        for k, outer in enumerate(cylinders.radii):
            for x in np.linspace(max(inner, 1e-6), outer, 20):
                u = cylinders.displacement(k, x, 0.0)[0]
                table.append({"model": name, "x": float(x), "u_x": float(u), "kind": "closed form"})
            inner = outer
    record.write("axis.csv", table)


def axis_of(points: np.ndarray, u: np.ndarray) -> list[tuple[float, float]]:
    """(x, u_x) of the nodes on the x axis, x > 0, in order."""
    on = (abs(points[:, 1]) < 1e-9) & (points[:, 0] > 1e-9)
    rows = np.column_stack([points[on, 0], u[on, 0]])
    return [(float(x), float(v)) for x, v in rows[np.lexsort(rows.T[::-1])]]


def draw(record: Record) -> None:
    """Draw the rates, the errors over meshes and the displacements along the axis from the tables."""
    draw_rates(record, title="a coated fibre")
    rows = record.load("refinement.csv").rows
    lines: dict[str, Any] = {}
    for degree, name in ((1, "straight cells"), (2, "curved cells")):
        own = np.array(
            [(float(row["h"] or 0), float(row["error_energy"] or 0)) for row in rows if row["degree"] == degree]
        )
        lines[name] = tuple(own.T)
        lines[f"slope {2 * degree}"] = (own[:, 0], 0.6 * own[-1, 1] * (own[:, 0] / own[-1, 0]) ** (2 * degree))
    plotting.curves(
        lines, xlabel="cell size h", ylabel="relative error of the energy", title="interface model of a coated fibre",
        styles=dict(zip(lines, ("o-", ":", "s-", ":"), strict=True)), logarithmic=True,
        save=record.path("refinement.png"),
    )  # fmt: skip
    draw_axis(record)


def draw_axis(record: Record) -> None:
    """Draw u_x along the x axis from axis.csv, near S."""
    lines: dict[str, Any] = {}
    for name in ("meshed interphase", "interface law"):
        for kind in ("closed form", "nodes"):
            own = [
                (float(row["x"] or 0), float(row["u_x"] or 0))
                for row in record.load("axis.csv").rows
                if row["model"] == name and row["kind"] == kind and abs(float(row["x"] or 0) - RADIUS) < RADIUS / 2
            ]
            lines[f"{name}, {kind}"] = tuple(np.array(own).T)
    plotting.curves(
        lines, xlabel="x", ylabel="$u_x$ on the x axis", title=f"across the interphase at r = {RADIUS:g}",
        styles=dict(zip(lines, ("-", "o", "--", "s"), strict=True)), save=record.path("axis.png"),
    )  # fmt: skip
