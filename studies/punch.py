"""Bodies that yield: Prandtl's punch, a thick-walled cylinder, and a joint of mortar between bodies of metal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from forms import LinearElastic, MohrCoulomb, VonMises, limits
from geometry import Joint, block, ring
from studies.problems import FOURIER_BODY, pressed
from studies.sweeping import Sweep, draw_rates
from thinlayer import Model, State, Structure, Surface, Table, ThinLayer, march, plotting
from thinlayer.running.record import Record

K = 1.0  # yield stress in shear; all stresses of the punch and the cylinder are relative to it
STRENGTH = math.sqrt(3) * K
GRADING = 1.5  # cells shrink towards the edge of the punch like this power of the distance over itself
SUNK = (0.004, 0.008, 0.012, 0.016)  # ends of steps, over the half-width of the punch

CYLINDER = limits.PlasticCylinder(a=1.0, b=2.0, mu=300.0, k=K)
CUT = 1.4  # radius of S
PRESSURES = (0.7, 1.0, 1.2, 1.3, 1.35)  # over K; elastic up to 0.75, the limit is 2 ln 2 = 1.386

METAL = VonMises(FOURIER_BODY.lmbda, FOURIER_BODY.mu, strength=1.6, hardening=20.0)
MORTAR = MohrCoulomb(60.0, 40.0, cohesion=0.3, friction_angle=35.0, elastic_fraction=0.02)
LOADS = {0: (0.0, 0.0, 0.0), 0.5: (1.5, 0.6, 0.5), 1: (2.0, 0.8, 1.6), 1.5: (2.0, 0.8, 0.4)}  # as of `pressed`


def run(record: Record, *, eps: Sequence[float] = (1 / 16, 1 / 32, 1 / 64), quick: bool = False) -> None:
    """Three problems in plane strain.

    punch.csv: a rough, rigid punch, half of it, is pushed into a block of ideally plastic metal: its mean pressure against
    (2 + pi) k, by mesh refinement. Triangles of degree 2, whose volumes plastic flow can keep; squares of degree 2 lock.
    cylinder.csv: an incompressible (nu = 0.499) cylinder under pressure from inside, partly plastic, against the closed
    form: displacements inside and outside, and the radial stress on S, a bond that is next to rigid.
    table.csv: two blocks of hardening metal with a Mohr-Coulomb joint, pressed and sheared, forth and part of the way back:
    interface law against meshed layer, error O(eps).

    Args:
        record: where to write.
        eps: thicknesses of the joint; the blocks are 0.5 high.
        quick: coarser meshes.
    """
    cells, h = ((5, 10), 1 / 8) if quick else ((5, 10, 16), 1 / 16)
    record.parameters = {
        "grading": GRADING, "cells": cells, "cylinder": str(CYLINDER), "metal": str(METAL), "mortar": str(MORTAR), "h": h,
    }  # fmt: skip
    punched(record, cells)
    inflated(record, 0.15 if quick else 0.08)
    joint, setup = pressed(h, LOADS)
    setup |= {"body": METAL}
    sweep = Sweep(record, joint, setup, partial(ThinLayer, MORTAR), times=(0.5, 1.0, 1.5))
    found = sweep.run(eps, (0.9, 1.2), pictured=None, title="Mohr-Coulomb joint between bodies that yield")
    record.say(found)


# ---------------------------------------------------------------- punch
def half_space(n: int) -> Joint:
    """Half of a block, 4 wide and 2 high, with n cells over the half-width 1 of the punch, graded towards its edge."""
    grid = block(4.0, 2.0, 1 / n, structured=True, arrangement="AlternateLeft")
    x, y = grid.points.T
    below, beside = 1 - np.abs(1 - x) ** GRADING, 1 + 3 * (np.abs(x - 1) / 3) ** GRADING
    points = np.column_stack([np.where(x < 1, below, beside), 2 - 2 * ((2 - y) / 2) ** GRADING])
    outer = dict(grid.facets)
    top = outer.pop("TOP")
    under = grid.points[top].mean(axis=1)[:, 0] < 1
    return replace(grid, points=points, facets={**outer, "PUNCH": top[under], "FREE": top[~under]})


class PunchPressure:
    """Mean pressure of the punch in a state: the force conjugate to its displacement, over its half-width."""

    def __init__(self, model: Model) -> None:
        self._down = fem.Function(model.V)
        self._down.x.array[model.supports.dofs(model.V, "PUNCH", "y")] = -1.0

    def __call__(self, state: State) -> float:
        return state.integral(state.work(state.bodies, self._down))


def punched(record: Record, cells: Sequence[int]) -> None:
    """Sink the punch on each mesh."""
    table, limit = record.table("punch.csv"), limits.prandtl_pressure(K)
    metal = VonMises.young(E=1000.0, nu=0.45, strength=STRENGTH)
    supports = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}, "PUNCH": {"x": 0.0, "y": lambda x, t: -t}}
    errors = []
    for n in cells:
        model = Structure(half_space(n), body=metal, supports=supports).bonded()
        history = march(model, SUNK, keep="last", observe={"pressure": PunchPressure(model)})
        record.solved(history.last)
        for row in history.table.rows:
            table.append({"n": n, "sunk": row["t"], "pressure": row["pressure"], "over": row["pressure"] / limit})
        errors.append(table.rows[-1]["over"] - 1)
    record.say(table)
    record.check("pressure under the punch on the finest mesh, over (2 + pi) k", 1 + errors[-1], low=0.99, high=1.01)
    record.check("its error there over that on the coarsest mesh", errors[-1] / errors[0], low=0.0, high=0.4)


# ---------------------------------------------------------------- cylinder
def inflated(record: Record, h: float) -> None:
    """Raise the pressure in a quarter of the cylinder."""
    c, table = CYLINDER, record.table("cylinder.csv")
    quarter = ring(c.a, CUT, c.b, h, angle=math.pi / 2, cell="triangle", degree=2)
    nu = 0.499
    metal = VonMises.young(E=2 * c.mu * (1 + nu), nu=nu, strength=STRENGTH)
    bond = ThinLayer(LinearElastic(1e3 * c.mu / h, 1e3 * c.mu / h), 1e-3)
    supports = {"START": {"y": 0.0}, "END": {"x": 0.0}}

    def inside(x: Any, t: Any) -> tuple[Any, Any]:
        r = ufl.sqrt(x[0] ** 2 + x[1] ** 2)
        return t * x[0] / r, t * x[1] / r

    model = Structure(quarter, body=metal, supports=supports, tractions={"INSIDE": inside}).interface(bond)
    surface = Surface(model)
    length = surface.integral(fem.Constant(model.domain.mesh, 1.0))
    history = march(model, PRESSURES)
    for state in list(history)[1:]:
        radial = surface.integral(surface.frame(surface.traction(state))[-1]) / length
        row = {"pressure": state.t, "zone": c.zone(state.t), "stress": radial}
        row["stress_exact"] = float(c.radial_stress(state.t, CUT))
        for name, r in (("INSIDE", c.a), ("OUTSIDE", c.b)):
            exact = float(c.displacement(state.t, r))
            row |= {f"u_{name}": moved(state, name), f"u_{name}_exact": exact}
        table.append(row)
        record.solved(state)
    record.say(table)
    for name in ("stress", "u_INSIDE", "u_OUTSIDE"):
        found, exact = table[name], table[f"{name}_exact"]
        record.check(f"cylinder: largest relative error of {name}", float(np.abs(found / exact - 1).max()), high=0.01)


def moved(state: State, name: str) -> float:
    """Mean outward displacement of a boundary."""
    model = state.model
    x = ufl.SpatialCoordinate(model.domain.mesh)
    there = model.ds(model.domain.values(name))
    outward = ufl.dot(state.u, x) / ufl.sqrt(ufl.dot(x, x))
    return state.integral(outward * there) / state.integral(fem.Constant(model.domain.mesh, 1.0) * there)


def draw(record: Record) -> None:
    """Draw the pressure under the punch, the cylinder, and the rates."""
    punch, limit = record.load("punch.csv"), limits.prandtl_pressure(K)
    curves = {}
    for n in sorted({int(row["n"]) for row in punch.rows}):
        rows = [row for row in punch.rows if row["n"] == n]
        curves[f"{n} cells under the punch"] = tuple(np.array([row[k] for row in rows]) for k in ("sunk", "over"))
    sunk = np.array([0.0, max(SUNK)])
    curves["(2 + pi) k"] = sunk, np.ones(2)
    plotting.curves(
        curves, xlabel="depth / half-width", ylabel=f"mean pressure / {limit:.3f} k", save=record.path("punch.png"),
        title="rough punch on ideally plastic metal",
    )  # fmt: skip
    _draw_cylinder(record, record.load("cylinder.csv"))
    draw_rates(record, title="Mohr-Coulomb joint between bodies that yield")


def _draw_cylinder(record: Record, table: Table) -> None:
    p = np.linspace(0.0, PRESSURES[-1], 100)
    exact = {
        f"closed form, r = {r:g}": (np.array([float(CYLINDER.displacement(one, r)) for one in p]), p)
        for r in (CYLINDER.a, CYLINDER.b)
    }
    found = {f"r = {r:g}": (table[f"u_{name}"], table["pressure"]) for r, name in ((1, "INSIDE"), (2, "OUTSIDE"))}
    plotting.curves(
        found | exact, xlabel="radial displacement", ylabel="pressure / k", save=record.path("cylinder.png"),
        title="thick-walled cylinder, b = 2 a",
    )  # fmt: skip
