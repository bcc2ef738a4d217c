"""Rows of the study `rates` with closed forms: a coated fibre and bonded tubes, concentric cylinders."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Self

import numpy as np

from forms import LinearElastic
from forms.base import Array
from geometry import fibre, sandwich
from studies.problems import Problem, StructureArguments
from studies.sweeping import Tables, last, layer_of
from thinlayer import Surface
from thinlayer.discretisation.supports import Support
from thinlayer.running.record import Record
from thinlayer.solving.history import Solution

young = LinearElastic.young
MODES = (0, 2)  # radial fields are proportional to cos(mode theta), circumferential fields to sin(mode theta)
Springs = Sequence[tuple[float, float] | None]  # between neighbours: normal and tangential stiffness; None: bonded


@dataclass(frozen=True)
class Cylinders:
    """Closed form of concentric elastic cylinders in plane strain, with u = (a x, b y) on the outermost radius.

    The innermost cylinder is solid. In polar coordinates u_r = u_0 + u_2 cos(2 theta) and u_theta = v_2 sin(2 theta);
    stresses on circles have the same form. In each cylinder mode 0 is u_0 = A r + B / r. Mode 2, with u_2 and v_2,
    follows from Muskhelishvili's potentials, combinations of z^3 and 1/z, and of z and 1/z^3.

    Attributes:
        laws: laws of the cylinders, the innermost first.
        radii: their outer radii, increasing.
        coefficients: number of the mode, 0 or 2 -> (cylinders, 2 or 4) coefficients of its independent solutions.
    """

    laws: tuple[LinearElastic, ...]
    radii: tuple[float, ...]
    coefficients: dict[int, Array]

    @classmethod
    def stretched(
        cls, laws: Sequence[LinearElastic], radii: Sequence[float], springs: Springs, stretch: tuple[float, float]
    ) -> Self:
        """Return the closed form for a displacement (a x, b y) prescribed on the outermost radius.

        It solves for the coefficients of mode 0 (axisymmetric) and mode 2 (radial displacements as cos(2 theta)).

        Args:
            laws: laws of the cylinders, the innermost first.
            radii: their outer radii, increasing.
            springs: for each interface, normal and tangential stiffness, stress per length; None: bonded.
            stretch: a and b in the displacement (a x, b y) on the outermost radius.
        """
        a, b = stretch
        rim = {0: ((a + b) / 2, 0.0), 2: ((a - b) / 2, (b - a) / 2)}
        coefficients = {mode: _solved(mode, laws, radii, springs, radii[-1] * np.array(rim[mode])) for mode in MODES}
        return cls(tuple(laws), tuple(radii), coefficients)

    def fields(self, mode: int, k: int, r: float) -> Array:
        """Amplitudes (4,) of u_r, u_theta and the stresses s_rr, s_rtheta of mode 0 or 2 in cylinder k, at a radius."""
        return np.asarray(_solutions(mode, self.laws[k], r) @ self.coefficients[mode][k])

    def displacement(self, k: int, r: float, theta: float) -> Array:
        """Displacements u_r and u_theta in cylinder k, at polar coordinates."""
        mode_0, mode_2 = (self.fields(mode, k, r)[:2] for mode in MODES)
        return mode_0 + mode_2 * [np.cos(2 * theta), np.sin(2 * theta)]

    def jumps(self, k: int) -> Array:
        """Amplitudes (2, 2), for both modes, of the jumps of u_r and u_theta from cylinder k to the next cylinder."""
        r = self.radii[k]
        return np.array([(self.fields(mode, k + 1, r) - self.fields(mode, k, r))[:2] for mode in MODES])

    @property
    def energy(self) -> float:
        """Elastic energy of all cylinders, per unit of their length."""
        last, R = len(self.laws) - 1, self.radii[-1]
        mode_0, mode_2 = (self.fields(mode, last, R) for mode in MODES)
        return float(pi * R * mode_0[:2] @ mode_0[2:] + pi * R / 2 * mode_2[:2] @ mode_2[2:])


def _solutions(mode: int, law: LinearElastic, r: float) -> Array:
    """Amplitudes (4, n) of u_r, u_theta, s_rr, s_rtheta of the n independent solutions of a mode at a radius.

    The solutions that are regular at r = 0 are first.
    """
    mu, kappa = law.mu, (law.lmbda + 3 * law.mu) / (law.lmbda + law.mu)
    if mode == 0:
        return np.array([[r, 1 / r], [0.0, 0.0], [2 * (law.lmbda + mu), -2 * mu / r**2], [0.0, 0.0]])
    u = [[(kappa - 3) * r**3, -r, (kappa + 1) / r, -(r**-3)], [(kappa + 3) * r**3, r, (1 - kappa) / r, -(r**-3)]]
    s = [[0.0, -1.0, -4 / r**2, 3 / r**4], [6 * r**2, 1.0, -2 / r**2, 3 / r**4]]
    return np.concatenate([np.array(u) / (2 * mu), s])


def _between(mode: int, laws: Sequence[LinearElastic], radii: Sequence[float], springs: Springs) -> Array:
    """Matrix (interfaces, 4, cylinders, n) of the conditions at interfaces, for the n coefficients of each cylinder.

    They say that displacement jumps equal the extensions of the springs, and that tractions are continuous.
    """
    conditions = np.zeros((len(radii), 4, len(laws), _solutions(mode, laws[0], 1.0).shape[1]))
    for k, (spring, r) in enumerate(zip(springs, radii, strict=True)):
        inner, outer = (_solutions(mode, law, r) for law in laws[k : k + 2])
        conditions[k, :, k], conditions[k, :, k + 1] = -inner, outer
        if spring is not None:
            conditions[k, :2, k + 1] -= outer[2:] / np.array(spring)[:, None]
    return conditions


def _solved(mode: int, laws: Sequence[LinearElastic], radii: Sequence[float], springs: Springs, rim: Array) -> Array:
    """Coefficients (cylinders, n) of a mode that meet the conditions at interfaces and are regular at r = 0.

    `rim` are the amplitudes of u_r and u_theta on the outermost radius; other arguments are those of
    `Cylinders.stretched`.
    """
    conditions = _between(mode, laws, radii[:-1], springs)
    n, size = conditions.shape[3], conditions[0, 0].size
    at_rim = np.zeros((2, size))
    at_rim[:, -n:] = _solutions(mode, laws[-1], radii[-1])[:2]
    matrix = np.concatenate([conditions.reshape(-1, size), at_rim])
    unknown = np.setdiff1d(np.arange(size), np.arange(n // 2, n))
    coefficients = np.zeros(size)
    coefficients[unknown] = np.linalg.lstsq(matrix[:, unknown], np.pad(rim, (len(matrix) - 2, 0)), rcond=None)[0]
    return coefficients.reshape(len(laws), n)


@dataclass(frozen=True)
class Lame:
    """Closed form of concentric tubes under inner pressure, without axial strain (Lamé).

    Attributes:
        laws: laws of the tubes, the innermost first.
        coefficients: (tubes, 2) A and B of the radial displacement A r + B/r in each tube.
    """

    laws: tuple[LinearElastic, ...]
    coefficients: Array

    def displacement(self, k: int, r: float) -> float:
        """Radial displacement of tube k, counted from inside, at a radius."""
        return float(self.coefficients[k] @ _solutions(0, self.laws[k], r)[0])

    def stress(self, k: int, r: float) -> float:
        """Radial stress in tube k, counted from inside, at a radius."""
        return float(self.coefficients[k] @ _solutions(0, self.laws[k], r)[2])


def lame(radii: Sequence[float], laws: Sequence[LinearElastic], springs: Sequence[float | None], p: float) -> Lame:
    """Solve for concentric tubes under inner pressure.

    Args:
        radii: increasing radii of the bore, of the interfaces and of the outer side.
        laws: laws of the tubes, the innermost first.
        springs: normal stiffness of each interface, stress per length; None: bonded.
        p: pressure in the bore; the outer side is free.
    """
    between = _between(0, laws, radii[1:-1], [None if k is None else (k, k) for k in springs])[:, ::2]  # radial rows
    end_rows = np.zeros((2, 2 * len(laws)))
    end_rows[0, :2], end_rows[1, -2:] = (_solutions(0, laws[k], radii[k])[2] for k in (0, -1))
    A, b = np.concatenate([between.reshape(-1, end_rows.shape[1]), end_rows]), np.zeros(end_rows.shape[1])
    b[-2] = -p
    return Lame(tuple(laws), np.asarray(np.linalg.solve(A, b).reshape(-1, 2), float))


# ---------------------------------------------------------------- a coated fibre
RADIUS, RIM, STRETCH = 0.4, 1.0, 0.1  # the rim is stretched along x
GLASS, RESIN = young(E=5.0, nu=0.3), young(E=1.0, nu=0.2)
COATING = LinearElastic(lmbda=0.6, mu=0.7)  # at the thickness 1


def coated_fibre(h: float) -> Problem:
    """A fibre in a disc of resin whose rim is stretched; return its joint and the arguments of its `Structure`.

    Lengths and stresses have no units; h is the cell size.
    """
    joint = fibre(RADIUS, RIM, h, cell="quadrilateral", degree=2)
    rim: Support = {"x": lambda x, t: STRETCH * x[0], "y": 0.0}
    return joint, {"body": {"FIBRE": GLASS, "MATRIX": RESIN}, "supports": {"OUTSIDE": rim}}


def against_cylinders(full: Solution, limit: Solution) -> dict[str, float]:
    """Compare with closed forms: relative L2 difference of the jumps of both models, error of the full model's energy.

    The difference is that between the closed forms with a layer and with springs; the error is relative.
    """
    eps = float(layer_of(full).eps)
    springs = (COATING.lmbda + 2 * COATING.mu, COATING.mu)
    jumps = Cylinders.stretched((GLASS, RESIN), (RADIUS, RIM), [springs], (STRETCH, 0.0)).jumps(0)
    radii, laws = (RADIUS - eps / 2, RADIUS + eps / 2, RIM), (GLASS, COATING.scaled(eps), RESIN)
    layer = Cylinders.stretched(laws, radii, [None, None], (STRETCH, 0.0))
    faces = (0, radii[0]), (2, radii[1])
    inner, outer = (np.array([layer.fields(mode, k, r)[:2] for mode in MODES]) for k, r in faces)
    weights = np.array([[2.0], [1.0]])  # of the squares of both modes in integrals over the circle
    error = (weights * (outer - inner - jumps) ** 2).sum() / (weights * jumps**2).sum()
    energies = last(full).energies()
    energy = abs((energies["bodies"] + energies["layer"]) / layer.energy - 1)
    return {"closed_form": float(np.sqrt(error)), "energy": float(energy)}


def as_cylinders(record: Record, tables: Tables) -> None:
    """Check that the jumps of both models differ as in closed form, and check the energy of the full model."""
    ratio = tables["fibre"]["error_jump"] / tables["fibre"]["closed_form"]
    record.check("error of the jump over that of the closed forms, less 1", abs(ratio - 1).max(), high=2e-3)
    record.check("energy of the meshed model, relative error", max(tables["fibre"]["energy"]), high=5e-5)


# ---------------------------------------------------------------- bonded tubes
SHAFT, HUB = young(E=210e3, nu=0.3), young(E=70e3, nu=0.34)  # MPa: steel and aluminium
GLUE, GLUE_EPS = young(E=2e3, nu=0.3), 0.2  # 2 GPa where the layer is 0.2 mm thick
RADII = (6.0, 12.0, 18.0)  # mm: bore, S, rim
HEIGHT = 8.0  # mm
PRESSURE, PUSH_STRESS = 50.0, 40.0  # MPa: in the bore; on the end of the shaft
LAME_ERROR = 5e-5  # relative error of displacements and tractions with Q2 cells of 1 mm; with 2 mm 16 times as large
PLATES: dict[str, Support] = {"LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}}
PRESSURE_LOADS: StructureArguments = {"supports": PLATES, "tractions": {"BOTTOM": (PRESSURE, 0.0)}}
PUSH_LOADS: StructureArguments = {"supports": {"RIGHT/UPPER": 0.0}, "tractions": {"LEFT/LOWER": (0.0, -PUSH_STRESS)}}


def tubes(h: float, loads: StructureArguments) -> Problem:
    """A tube glued into another tube, in section; return its joint and the arguments of its `Structure`.

    The section is axisymmetric: x is the radius, the side "BOTTOM" is the bore, "LEFT" the upper end.

    Args:
        h: cell size, mm.
        loads: supports and tractions.
    """
    bore, on_S, rim = RADII
    section = sandwich(HEIGHT, on_S - bore, rim - on_S, h, cell="quadrilateral", structured=True)
    bodies: StructureArguments = {"body": {"LOWER": SHAFT, "UPPER": HUB}, "plane": "axisymmetric"}
    return section.rotated(-np.pi / 2).moved((on_S, 0.0)), bodies | loads


def against_lame(full: Solution, limit: Solution) -> dict[str, float]:
    """Relative errors of both models against their closed forms: displacement of the bore, mean traction on S."""
    eps, (bore, on_S, rim) = float(layer_of(limit).eps), RADII
    radii, laws = (bore, on_S - eps / 2, on_S + eps / 2, rim), (SHAFT, GLUE.scaled(eps / GLUE_EPS), HUB)
    layer = lame(radii, laws, (None, None), PRESSURE)
    springs = lame(RADII, (SHAFT, HUB), ((GLUE.lmbda + 2 * GLUE.mu) / GLUE_EPS,), PRESSURE)
    surface, row = Surface(last(limit).model), {}
    work = 2 * np.pi * bore * HEIGHT * PRESSURE
    for name, state, exact, width in (("law", last(limit), springs, 0.0), ("meshed", last(full), layer, eps)):
        row[f"{name}_bore"] = abs(state.energies()["loads"] / (work * exact.displacement(0, bore)) - 1)
        force = surface.integral(surface.frame(surface.traction(state))[1]) / (2 * np.pi * HEIGHT)
        forces = [exact.stress(1, r) * r for r in (on_S - width / 2, on_S, on_S + width / 2)]
        mean_force = float(np.dot((1, 4, 1), forces)) / 6  # the mean through a meshed layer, over the area of S
        row[f"{name}_traction"] = abs(force / mean_force - 1)
    return row


def as_lame(record: Record, tables: Tables) -> None:
    """Check both models under inner pressure against their closed forms."""
    high = 16 * LAME_ERROR if record.options.get("quick") else LAME_ERROR
    for name in ("meshed", "law"):
        max_error = max(max(tables["tubes"][f"{name}_{what}"]) for what in ("bore", "traction"))
        record.check(f"relative difference from Lame, {name}", max_error, high=high)
