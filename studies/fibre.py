"""Coated fibre: its interphase meshed and as a law on S, a circle, both against closed forms; curved cells."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from math import pi
from typing import Any, Self

import numpy as np

from forms import LinearElastic
from forms.base import Array
from geometry import fibre, periodic
from geometry.parallel import on_root
from studies.problems import of
from studies.sweeping import Sweep, draw_rates, last, layer_of
from thinlayer import Structure, Table, ThinLayer, homogenised_stiffness, plotting, solve
from thinlayer.discretisation.state import State
from thinlayer.output.grid import gather
from thinlayer.running.record import Record
from thinlayer.solving.history import Solution

EPS = (0.08, 0.04, 0.02, 0.01)  # over the radius of the matrix
SIZES = (0.1, 0.05, 0.025)
RADIUS, RIM = 0.4, 1.0
CELL = (1.2, 1.0)  # width and height of the periodic cell
STRETCH = 0.1  # of the rim, along x
GLASS, RESIN = LinearElastic.young(E=5.0, nu=0.3), LinearElastic.young(E=1.0, nu=0.2)
COATING = LinearElastic(lmbda=0.6, mu=0.7)  # at the thickness 1
MODES = (0, 2)  # fields are proportional to cos(mode theta), those along the circles to sin(mode theta)
Springs = Sequence[tuple[float, float] | None]  # between neighbours: normal and tangential stiffness, or bonded
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
    refine(record, SIZES[:2] if quick else SIZES)
    joint = fibre(RADIUS, RIM, 0.1 if quick else 0.05, cell="quadrilateral", degree=2)
    sweep = Sweep(record, joint, setup(), of(COATING), bodies="extended", more=against_closed_forms)
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
        found = Table()
        for h in sizes:
            structure = Structure(fibre(RADIUS, RIM, h, degree=degree), **setup())
            model = structure.interface(ThinLayer(COATING, 0.01, at=1.0))
            error = abs(energy(record.solved(solve(model))) / exact - 1)
            found.append({"h": h, "error": error})
            order = found.orders("error", of="h")[-1]
            row = {"degree": degree, "h": h, "cells": len(model.joint.cells), "error_energy": error}
            table.append(row | {"order": order})
        record.check(f"observed order of the energy in h, cells of degree {degree}", order or 0.0, low=low, high=high)


def homogenise(record: Record, eps: Sequence[float], h: float) -> None:
    """Stiffness of a periodic cell of coated fibres as a whole, the coating meshed and as a law on S: error O(eps)."""
    cell = periodic(fibre(RADIUS, CELL, h, degree=2), ("LEFT", "RIGHT"), ("BOTTOM", "TOP"))
    structure, table = Structure(cell, body=setup()["body"], supports={}), record.table("homogenised.csv")
    errors = Table()
    for e in eps:
        layer = ThinLayer(COATING, e, at=1.0)
        models = structure.full(layer, bodies="extended"), structure.interface(layer)
        full, limit = map(homogenised_stiffness, models)
        error = float(np.abs(full - limit).max() / np.abs(limit).max())
        errors.append({"eps": e, "error": error})
        order = errors.orders("error")[-1]
        row = {"eps": e, "C_11": full[0, 0], "C_22": full[1, 1], "C_12": full[0, 1], "C_66": full[2, 2]}
        table.append({name: float(value) for name, value in row.items()} | {"error": error, "order": order})
    record.check("observed order of the homogenised stiffness in eps", order or 0.0, low=0.85, high=1.15)


def along_axis(record: Record, sweep: Sweep, eps: float) -> None:
    """u_x along the x axis, of both models and of both closed forms."""
    table = record.table("axis.csv")
    closed = {"meshed interphase": with_layer(eps), "interface law": with_springs()}
    for (name, cylinders), state in zip(closed.items(), sweep.solved(eps), strict=True):
        nodes = on_root(None, partial(axis_of, gather(last(state))))
        table.extend(Table.of({"model": name, "x": nodes[:, 0], "u_x": nodes[:, 1], "kind": "nodes"}))
        for k, (inner, outer) in enumerate(pairwise((1e-6, *cylinders.radii))):
            x = np.linspace(inner, outer, 20)
            u = [cylinders.displacement(k, float(at), 0.0)[0] for at in x]
            table.extend(Table.of({"model": name, "x": x, "u_x": u, "kind": "closed form"}))


def axis_of(grid: Any) -> Array:
    """(x, u_x) of the nodes on the x axis, x > 0, in order."""
    x, y, _ = grid.points.T
    rows = np.column_stack([x, grid.u[:, 0]])[(abs(y) < 1e-9) & (x > 1e-9)]
    return np.asarray(rows[np.lexsort(rows.T[::-1])])


# ---------------------------------------------------------------- concentric cylinders in plane strain, in closed form
@dataclass(frozen=True)
class Cylinders:
    """Elastic cylinders in one another, the innermost one solid, with u = (a x, b y) on the outermost radius R.

    u_r = u_0 + u_2 cos(2 theta), u_theta = v_2 sin(2 theta), and so are the stresses on circles. In each cylinder mode 0 is
    u_0 = A r + B / r, and mode 2 follows from the complex potentials a z^3 + b / z and c z + d / z^3.

    Attributes:
        laws: from the innermost one.
        radii: their outer radii, growing lengths.
        coefficients: mode -> (cylinders, 2 or 4) of its solutions.
    """

    laws: tuple[LinearElastic, ...]
    radii: tuple[float, ...]
    coefficients: dict[int, Array]

    @classmethod
    def stretched(
        cls, laws: Sequence[LinearElastic], radii: Sequence[float], springs: Springs, stretch: tuple[float, float]
    ) -> Self:
        """Solve.

        Args:
            laws, radii: see above.
            springs: between neighbours, stress per length.
            stretch: a and b.
        """
        a, b = stretch
        rim = {0: ((a + b) / 2, 0.0), 2: ((a - b) / 2, (b - a) / 2)}
        solved = {mode: _solved(mode, laws, radii, springs, radii[-1] * np.array(rim[mode])) for mode in MODES}
        return cls(tuple(laws), tuple(radii), solved)

    def fields(self, mode: int, k: int, r: float) -> Array:
        """Amplitudes of u_r, u_theta, s_rr and s_rtheta of a mode in cylinder k, at a radius."""
        return np.asarray(_solutions(mode, self.laws[k], r) @ self.coefficients[mode][k])

    def displacement(self, k: int, r: float, theta: float) -> Array:
        """u_r and u_theta in cylinder k."""
        zero, two = (self.fields(mode, k, r)[:2] for mode in MODES)
        return zero + two * [np.cos(2 * theta), np.sin(2 * theta)]

    def jumps(self, k: int) -> Array:
        """(2, 2) amplitudes of [u_r] and [u_theta] of both modes, from cylinder k to the next one."""
        r = self.radii[k]
        return np.array([(self.fields(mode, k + 1, r) - self.fields(mode, k, r))[:2] for mode in MODES])

    @property
    def energy(self) -> float:
        """Half the work of the rim, per length of the cylinders."""
        last, R = len(self.laws) - 1, self.radii[-1]
        zero, two = (self.fields(mode, last, R) for mode in MODES)
        return float(pi * R * zero[:2] @ zero[2:] + pi * R / 2 * two[:2] @ two[2:])


def _solutions(mode: int, law: LinearElastic, r: float) -> Array:
    """(4, n) amplitudes of u_r, u_theta, s_rr and s_rtheta of the solutions of a mode at a radius, regular ones first."""
    mu, kappa = law.mu, (law.lmbda + 3 * law.mu) / (law.lmbda + law.mu)
    if mode == 0:
        return np.array([[r, 1 / r], [0.0, 0.0], [2 * (law.lmbda + mu), -2 * mu / r**2], [0.0, 0.0]])
    u = [[(kappa - 3) * r**3, -r, (kappa + 1) / r, -(r**-3)], [(kappa + 3) * r**3, r, (1 - kappa) / r, -(r**-3)]]
    s = [[0.0, -1.0, -4 / r**2, 3 / r**4], [6 * r**2, 1.0, -2 / r**2, 3 / r**4]]
    return np.concatenate([np.array(u) / (2 * mu), s])


def _solved(mode: int, laws: Sequence[LinearElastic], radii: Sequence[float], springs: Springs, rim: Array) -> Array:
    """Coefficients of a mode: regular in the innermost cylinder, continuous stresses, jumps as of springs."""
    n = _solutions(mode, laws[0], 1.0).shape[1]
    rows, right = [], []
    for k, (spring, r) in enumerate(zip(springs, radii[:-1], strict=True)):
        inside, outside = (_solutions(mode, law, r) for law in laws[k : k + 2])
        compliance = np.zeros(2) if spring is None else 1 / np.array(spring)
        block = np.zeros((4, n * len(laws)))
        block[:2, n * k : n * (k + 1)] = -inside[:2]
        block[:2, n * (k + 1) : n * (k + 2)] = outside[:2] - compliance[:, None] * outside[2:]
        block[2:, n * k : n * (k + 1)] = -inside[2:]
        block[2:, n * (k + 1) : n * (k + 2)] = outside[2:]
        rows.append(block)
        right.append(np.zeros(4))
    at_rim = np.zeros((2, n * len(laws)))
    at_rim[:, -n:] = _solutions(mode, laws[-1], radii[-1])[:2]
    matrix = np.concatenate([*rows, at_rim])
    unknown = np.setdiff1d(np.arange(n * len(laws)), np.arange(n // 2, n))
    found = np.zeros(n * len(laws))
    found[unknown] = np.linalg.lstsq(matrix[:, unknown], np.concatenate([*right, rim]), rcond=None)[0]
    return found.reshape(len(laws), n)


# ---------------------------------------------------------------- pictures
def draw(record: Record) -> None:
    """Draw the rates, the errors over meshes and the displacements along the axis from the tables."""
    draw_rates(record, "a coated fibre")
    lines: dict[str, Any] = {}
    for degree, part in record.load("refinement.csv").split("degree").items():
        h, error = part["h"], part["error_energy"]
        lines["straight cells" if degree == 1 else "curved cells"] = h, error
        lines[f"slope {2 * degree:g}"] = h, 0.6 * error[-1] * (h / h[-1]) ** (2 * degree)
    title, dashes, save = "interface model of a coated fibre", ("o-", ":", "s-", ":"), record.path("refinement.png")
    of_energy = "relative error of the energy"
    plotting.curves(lines, "cell size h", of_energy, title=title, styles=dashes, log="xy", save=save)
    along, lines, styles = record.load("axis.csv").split("model"), {}, {}
    for name, style, marker in (("meshed interphase", "-", "o"), ("interface law", "--", "s")):
        for kind, part in along[name].split("kind").items():
            near = abs(part["x"] - RADIUS) < RADIUS / 2
            lines[f"{name}, {kind}"] = part["x"][near], part["u_x"][near]
            styles[f"{name}, {kind}"] = marker if kind == "nodes" else style
    title, save = f"across the interphase at r = {RADIUS:g}", record.path("axis.png")
    plotting.curves(lines, "x", "$u_x$ on the x axis", title=title, styles=styles, save=save)
