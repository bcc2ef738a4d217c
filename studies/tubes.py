"""Axisymmetry: two bonded tubes, S along the axis, under inner pressure (Lame), and pushed through one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from forms import LinearElastic
from forms.base import Array
from geometry import sandwich
from geometry.joint import Joint
from studies.sweeping import Sweep, draw_rates, last, layer_of
from thinlayer import Surface, ThinLayer, plotting
from thinlayer.running.record import Record
from thinlayer.solving.history import Solution

EPS = (0.8, 0.4, 0.2, 0.1)  # mm
SHAFT, HUB = LinearElastic.young(E=210e3, nu=0.3), LinearElastic.young(E=70e3, nu=0.34)  # MPa: steel and aluminium
GLUE, GLUE_EPS = LinearElastic.young(E=2e3, nu=0.3), 0.2  # 2 GPa where the layer is 0.2 mm thick
RADII = (6.0, 12.0, 18.0)  # mm: bore, S, rim
HEIGHT = 8.0  # mm
PRESSURE, PUSH = 50.0, 40.0  # MPa: in the bore; on the end of the shaft
LAME = 5e-5  # relative error of displacements and tractions by Q2 cells of 1 mm; of 2 mm: 16 times as large


@dataclass(frozen=True)
class Lame:
    """Tubes in one another under inner pressure, without strain along the axis: u = A r + B/r in each.

    Attributes:
        radii: bore, interfaces and rim, growing lengths.
        laws: of the tubes, from the innermost one.
        coefficients: (tubes, 2) A and B.
    """

    radii: tuple[float, ...]
    laws: tuple[LinearElastic, ...]
    coefficients: Array

    def displacement(self, k: int, r: float) -> float:
        """Radial displacement of tube k at a radius."""
        return float(self.coefficients[k] @ (r, 1 / r))

    def stress(self, k: int, r: float) -> float:
        """Radial stress in tube k at a radius."""
        return float(self.coefficients[k] @ _radial(self.laws[k], r))


def _radial(law: LinearElastic, r: float) -> Array:
    return np.array([2 * (law.lmbda + law.mu), -2 * law.mu / r**2])


def lame(radii: Sequence[float], laws: Sequence[LinearElastic], springs: Sequence[float | None], p: float) -> Lame:
    """Solve.

    Args:
        radii, laws: see `Lame`.
        springs: normal stiffness between neighbours, stress per length; None: bonded.
        p: pressure in the bore; the rim is free.
    """
    n = len(laws)
    A, b = np.zeros((2 * n, 2 * n)), np.zeros(2 * n)
    A[0, :2], b[0] = _radial(laws[0], radii[0]), -p
    for k, spring in enumerate(springs):
        r, row, inside, outside = radii[k + 1], 1 + 2 * k, slice(2 * k, 2 * k + 2), slice(2 * k + 2, 2 * k + 4)
        stress = _radial(laws[k], r)
        A[row, inside], A[row, outside] = stress, -_radial(laws[k + 1], r)
        A[row + 1, inside], A[row + 1, outside] = (-r, -1 / r), (r, 1 / r)
        if spring is not None:
            A[row + 1, inside] -= stress / spring
    A[-1, -2:] = _radial(laws[-1], radii[-1])
    return Lame(tuple(radii), tuple(laws), np.asarray(np.linalg.solve(A, b).reshape(n, 2), float))


def walls(h: float) -> Joint:
    """The section of both tubes: x is the radius; "BOTTOM" is the bore, "TOP" the rim, "LEFT" the upper end."""
    bore, on_S, rim = RADII
    flat = sandwich(HEIGHT, on_S - bore, rim - on_S, h, cell="quadrilateral", structured=True)
    return flat.rotated(-np.pi / 2).moved((on_S, 0.0))


def run(record: Record, *, eps: Sequence[float] = EPS, quick: bool = False) -> None:
    """Sweep the thickness in both cases; the bodies are extended, because a tube cannot be moved away from its axis.

    Args:
        record: where to write.
        eps: thicknesses (mm).
        quick: coarser mesh.
    """
    joint = walls(2.0 if quick else 1.0)
    bodies = {"body": {"LOWER": SHAFT, "UPPER": HUB}, "plane": "axisymmetric"}
    sweep = Sweep(record, joint, {}, partial(ThinLayer, GLUE, at=GLUE_EPS), bodies="extended")
    pressed = {"supports": {"LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}}, "tractions": {"BOTTOM": (PRESSURE, 0.0)}}
    by_pressure = replace(sweep, setup=bodies | pressed, case="pressure", more=against_lame)
    table = by_pressure.run(eps, (0.93, 1.1), unit="mm", title="inner pressure")
    for name in ("meshed", "law"):
        worst = max(max(table[f"{name}_bore"]), max(table[f"{name}_traction"]))
        record.check(f"relative difference from Lame, {name}", worst, high=16 * LAME if quick else LAME)
    pushed = {"supports": {"RIGHT/UPPER": 0.0}, "tractions": {"LEFT/LOWER": (0.0, -PUSH)}}
    by_push = replace(sweep, setup=bodies | pushed, case="push", where=lambda x: abs(x[1] + HEIGHT / 2) < 0.3 * HEIGHT)
    by_push.run(eps, (0.9, 1.25), unit="mm", title="shaft pushed through its hub")


def with_springs() -> Lame:
    """The closed form of the interface model."""
    return lame(RADII, (SHAFT, HUB), ((GLUE.lmbda + 2 * GLUE.mu) / GLUE_EPS,), PRESSURE)


def with_layer(eps: float) -> Lame:
    """The closed form of the meshed model."""
    bore, on_S, rim = RADII
    laws = SHAFT, GLUE.scaled(eps / GLUE_EPS), HUB
    return lame((bore, on_S - eps / 2, on_S + eps / 2, rim), laws, (None, None), PRESSURE)


def against_lame(full: Solution, limit: Solution) -> dict[str, float]:
    """Relative differences from the closed form: of the bore's displacement, and of the mean traction on S."""
    meshed, by_law = last(full), last(limit)
    eps = float(layer_of(limit).eps)
    closed = {"law": with_springs(), "meshed": with_layer(eps)}
    surface, found = Surface(by_law.model), {}
    work = 2 * np.pi * RADII[0] * HEIGHT * PRESSURE
    for name, state in (("law", by_law), ("meshed", meshed)):
        exact = closed[name]
        found[f"{name}_bore"] = abs(state.energies()["loads"] / (work * exact.displacement(0, RADII[0])) - 1)
        force = surface.integral(surface.frame(surface.traction(state))[1]) / (2 * np.pi * HEIGHT)
        sides = [exact.radii[1], exact.radii[-2]]  # forces on both faces of a meshed layer, over the area of S
        forces = [exact.stress(k, r) * r for k, r in zip((0, len(exact.laws) - 1), sides, strict=True)]
        found[f"{name}_traction"] = abs(force / float(np.mean(forces)) - 1)
    return found


def draw(record: Record) -> None:
    """Draw the rates of both cases, and the displacement along the radius, meshed and by the law, in closed form."""
    draw_rates(record, "bonded tubes", {"pressure": "pressure", "push": "push"})
    curves = {}
    for name, exact in (("interface law", with_springs()), (f"layer of {max(EPS):g} mm", with_layer(max(EPS)))):
        r = [np.linspace(a, b, 30) for a, b in pairwise(exact.radii)]
        u = [1e3 * exact.displacement(k, at) for k, part in enumerate(r) for at in part]
        curves[name] = (np.concatenate(r), np.array(u))
    save = record.path("lame.png")
    plotting.curves(curves, "radius (mm)", "displacement (micrometres)", save=save, title="inner pressure")
