"""Rows of the study `rates` on concentric cylinders, a coated fibre and bonded tubes, with their closed forms."""

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
from studies.sweeping import Tables, end_state, layer_of
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

    The innermost cylinder is solid. In polar coordinates u_r = u_0(r) + u_2(r) cos(2 theta) and u_theta = v_2(r)
    sin(2 theta); the stresses s_rr and s_rtheta have the same form. Terms without theta are mode 0, with u_0 = A r + B
    / r. Terms with 2 theta are mode 2. They follow from Muskhelishvili's potentials, combinations of z^3 and 1/z, and
    of z and 1/z^3.

    Attributes:
        laws: law of each cylinder, the innermost first.
        radii: outer radius of each cylinder, increasing.
        coefficients: number of the mode, 0 or 2 -> (cylinders, n) factors of its n independent solutions in each
            cylinder; n is 2 for mode 0, 4 for mode 2.
    """

    laws: tuple[LinearElastic, ...]
    radii: tuple[float, ...]
    coefficients: dict[int, Array]

    @classmethod
    def stretched(
        cls, laws: Sequence[LinearElastic], radii: Sequence[float], springs: Springs, stretch: tuple[float, float]
    ) -> Self:
        """Solve for cylinders whose outermost boundary has the displacement (a x, b y).

        Args:
            laws: law of each cylinder, the innermost first.
            radii: outer radius of each cylinder, increasing.
            springs: for each interface between neighbours (normal, tangential) stiffness, stress per length; None:
                bonded.
            stretch: a and b of this displacement.
        """
        a, b = stretch
        rim = {0: ((a + b) / 2, 0.0), 2: ((a - b) / 2, (b - a) / 2)}
        coefficients = {mode: _coeffs(mode, laws, radii, springs, radii[-1] * np.array(rim[mode])) for mode in MODES}
        return cls(tuple(laws), tuple(radii), coefficients)

    def amplitudes(self, mode: int, k: int, r: float) -> Array:
        """Return the amplitudes (4,) of u_r, u_theta, s_rr and s_rtheta at the radius `r`, for one Fourier mode.

        `mode` is the number of the mode in theta, 0 or 2; `k` is the number of the cylinder, 0 for the innermost one.
        """
        return np.asarray(_solutions(mode, self.laws[k], r) @ self.coefficients[mode][k])

    def displacement(self, k: int, r: float, theta: float) -> Array:
        """Return the displacements (2,) u_r and u_theta at the polar coordinates `r` and `theta` (radians).

        `k` is the number of the cylinder, 0 for the innermost one.
        """
        mode_0, mode_2 = (self.amplitudes(mode, k, r)[:2] for mode in MODES)
        return mode_0 + mode_2 * [np.cos(2 * theta), np.sin(2 * theta)]

    def jumps(self, k: int) -> Array:
        """Return the amplitudes (2, 2) of the jumps from cylinder `k` (0: the innermost) to the next cylinder.

        The first index is for the Fourier modes in theta, 0 and 2. The second one is for the components u_r and
        u_theta.
        """
        r = self.radii[k]
        return np.array([(self.amplitudes(mode, k + 1, r) - self.amplitudes(mode, k, r))[:2] for mode in MODES])

    @property
    def energy(self) -> float:
        """Elastic energy of all cylinders, per unit of their length."""
        last, R = len(self.laws) - 1, self.radii[-1]
        mode_0, mode_2 = (self.amplitudes(mode, last, R) for mode in MODES)
        return float(pi * R * mode_0[:2] @ mode_0[2:] + pi * R / 2 * mode_2[:2] @ mode_2[2:])


def _solutions(mode: int, law: LinearElastic, r: float) -> Array:
    """Return the independent solutions for one Fourier mode at the radius `r` of a cylinder with the law `law`.

    `mode` is the number of the mode in theta, 0 or 2. In the array (4, n) each column has the amplitudes of u_r,
    u_theta, s_rr and s_rtheta of a solution; n is 2 for mode 0, 4 for mode 2. The first half of the columns is regular
    at r = 0.
    """
    mu, kappa = law.mu, (law.lmbda + 3 * law.mu) / (law.lmbda + law.mu)
    if mode == 0:
        return np.array([[r, 1 / r], [0.0, 0.0], [2 * (law.lmbda + mu), -2 * mu / r**2], [0.0, 0.0]])
    u = [[(kappa - 3) * r**3, -r, (kappa + 1) / r, -(r**-3)], [(kappa + 3) * r**3, r, (1 - kappa) / r, -(r**-3)]]
    s = [[0.0, -1.0, -4 / r**2, 3 / r**4], [6 * r**2, 1.0, -2 / r**2, 3 / r**4]]
    return np.concatenate([np.array(u) / (2 * mu), s])


def _coupling(mode: int, laws: Sequence[LinearElastic], radii: Sequence[float], springs: Springs) -> Array:
    """Return the matrix of the conditions at interfaces between cylinders, for one Fourier mode.

    The matrix multiplies the coefficients of the cylinders' independent solutions (`_solutions`). The conditions say
    that jumps of u_r and u_theta are the extensions of the springs, and tractions are continuous.

    Args:
        mode: number of the Fourier mode in theta, 0 or 2.
        laws: law of each cylinder, the innermost first.
        radii: radius of each interface, increasing.
        springs: for each interface (normal, tangential) stiffness, stress per length; None: bonded.

    Returns:
        (interfaces, 4, cylinders, n): four conditions at each interface, for n coefficients in each cylinder.
    """
    conditions = np.zeros((len(radii), 4, len(laws), _solutions(mode, laws[0], 1.0).shape[1]))
    for k, (spring, r) in enumerate(zip(springs, radii, strict=True)):
        inner, outer = (_solutions(mode, law, r) for law in laws[k : k + 2])
        conditions[k, :, k], conditions[k, :, k + 1] = -inner, outer
        if spring is not None:
            conditions[k, :2, k + 1] -= outer[2:] / np.array(spring)[:, None]
    return conditions


def _coeffs(mode: int, laws: Sequence[LinearElastic], radii: Sequence[float], springs: Springs, rim: Array) -> Array:
    """Solve for the coefficients of one Fourier mode in cylinders, the innermost of which is solid.

    Args:
        mode: number of the Fourier mode in theta, 0 or 2.
        laws: law of each cylinder, the innermost first.
        radii: outer radius of each cylinder, increasing.
        springs: for each interface (normal, tangential) stiffness, stress per length; None: bonded.
        rim: (2,) prescribed amplitudes of u_r and u_theta on the outermost radius.

    Returns:
        (cylinders, n) coefficients of the n independent solutions in each cylinder.
    """
    conditions = _coupling(mode, laws, radii[:-1], springs)
    n, n_columns = conditions.shape[3], conditions[0, 0].size
    rim_rows = np.zeros((2, n_columns))
    rim_rows[:, -n:] = _solutions(mode, laws[-1], radii[-1])[:2]
    matrix = np.concatenate([conditions.reshape(-1, n_columns), rim_rows])
    unknowns = np.setdiff1d(np.arange(n_columns), np.arange(n // 2, n))
    coefficients = np.zeros(n_columns)
    coefficients[unknowns] = np.linalg.lstsq(matrix[:, unknowns], np.pad(rim, (len(matrix) - 2, 0)), rcond=None)[0]
    return coefficients.reshape(len(laws), n)


@dataclass(frozen=True)
class Lame:
    """Closed form of concentric tubes under inner pressure, without axial strain (Lamé).

    Attributes:
        laws: law of each tube, the innermost first.
        coefficients: (tubes, 2) A and B of the radial displacement A r + B/r in each tube.
    """

    laws: tuple[LinearElastic, ...]
    coefficients: Array

    def displacement(self, k: int, r: float) -> float:
        """Return the radial displacement at the radius `r` in tube `k`, 0 for the innermost one."""
        return float(self.coefficients[k] @ _solutions(0, self.laws[k], r)[0])

    def stress(self, k: int, r: float) -> float:
        """Return the radial stress at the radius `r` in tube `k`, 0 for the innermost one."""
        return float(self.coefficients[k] @ _solutions(0, self.laws[k], r)[2])


def lame(radii: Sequence[float], laws: Sequence[LinearElastic], springs: Sequence[float | None], p: float) -> Lame:
    """Return the closed form of concentric tubes under inner pressure; the outer side is free.

    Args:
        radii: increasing radii of the bore, of the interfaces and of the outer side.
        laws: law of each tube, the innermost first.
        springs: normal stiffness of each interface, stress per length; None: bonded.
        p: pressure in the bore.
    """
    coupling = _coupling(0, laws, radii[1:-1], [None if k is None else (k, k) for k in springs])[:, ::2]  # radial rows
    end_rows = np.zeros((2, 2 * len(laws)))
    end_rows[0, :2], end_rows[1, -2:] = (_solutions(0, laws[k], radii[k])[2] for k in (0, -1))
    A, b = np.concatenate([coupling.reshape(-1, end_rows.shape[1]), end_rows]), np.zeros(end_rows.shape[1])
    b[-2] = -p
    return Lame(tuple(laws), np.asarray(np.linalg.solve(A, b).reshape(-1, 2), float))


# ---------------------------------------------------------------- a coated fibre
RADIUS, RIM, STRETCH = 0.4, 1.0, 0.1  # the rim is stretched along x
GLASS, RESIN = young(E=5.0, nu=0.3), young(E=1.0, nu=0.2)
COATING = LinearElastic(lmbda=0.6, mu=0.7)  # at the thickness 1


def coated_fibre(h: float) -> Problem:
    """A fibre in a disc of resin whose rim is stretched along x; the thin layer is the coating.

    Args:
        h: cell size; lengths and stresses have no units.

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    joint = fibre(RADIUS, RIM, h, cell="quadrilateral", degree=2)
    rim: Support = {"x": lambda x, t: STRETCH * x[0], "y": 0.0}
    return joint, {"body": {"FIBRE": GLASS, "MATRIX": RESIN}, "supports": {"OUTSIDE": rim}}


def fibre_errors(full: Solution, limit: Solution) -> dict[str, float]:
    """Compare the coated fibre with closed forms at one thickness of its coating.

    Args:
        full: solution with the meshed coating.
        limit: solution with the interface law.

    Returns:
        "closed_form" -> relative L2 difference of the jumps in two closed forms, one with a coating, one with springs;
        "energy" -> relative error of the full model's energy.
    """
    eps = float(layer_of(full).eps)
    springs = (COATING.lmbda + 2 * COATING.mu, COATING.mu)
    spring_jumps = Cylinders.stretched((GLASS, RESIN), (RADIUS, RIM), [springs], (STRETCH, 0.0)).jumps(0)
    radii, laws = (RADIUS - eps / 2, RADIUS + eps / 2, RIM), (GLASS, COATING.scaled(eps), RESIN)
    coated = Cylinders.stretched(laws, radii, [None, None], (STRETCH, 0.0))
    faces = (0, radii[0]), (2, radii[1])
    inner, outer = (np.array([coated.amplitudes(mode, k, r)[:2] for mode in MODES]) for k, r in faces)
    mode_weights = np.array([[2.0], [1.0]])  # of the squares of both modes in integrals over the circle
    squared_error = (mode_weights * (outer - inner - spring_jumps) ** 2).sum() / (mode_weights * spring_jumps**2).sum()
    energies = end_state(full).energies()
    energy_error = abs((energies["bodies"] + energies["layer"]) / coated.energy - 1)
    return {"closed_form": float(np.sqrt(squared_error)), "energy": float(energy_error)}


def check_fibre(record: Record, tables: Tables) -> None:
    """Check the error of the interface law's jump, and the energy of the full model, against closed forms.

    The jumps of both models must differ as much as those of the closed forms with springs and with a coating.

    Args:
        record: record of the run, which receives the checks.
        tables: name of a `Sweep` of the study `rates` -> its table, with a line for each thickness.
    """
    error_ratio = tables["fibre"]["error_jump"] / tables["fibre"]["closed_form"]
    record.check("error of the jump over that of the closed forms, less 1", abs(error_ratio - 1).max(), high=2e-3)
    record.check("energy of the meshed model, relative error", max(tables["fibre"]["energy"]), high=5e-5)


# ---------------------------------------------------------------- bonded tubes
SHAFT, HUB = young(E=210e3, nu=0.3), young(E=70e3, nu=0.34)  # MPa: steel and aluminium
GLUE, GLUE_EPS = young(E=2e3, nu=0.3), 0.2  # 2 GPa where the layer is 0.2 mm thick
RADII = (6.0, 12.0, 18.0)  # mm: bore, S, rim
TUBE_LENGTH = 8.0  # mm
PRESSURE, PUSH_STRESS = 50.0, 40.0  # MPa: in the bore; on the end of the shaft
LAME_RTOL = 5e-5  # relative error of displacements and tractions with Q2 cells of 1 mm; with 2 mm 16 times as large
PLATE_SUPPORTS: dict[str, Support] = {"LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}}
PRESSURE_LOADS: StructureArguments = {"supports": PLATE_SUPPORTS, "tractions": {"BOTTOM": (PRESSURE, 0.0)}}
PUSH_LOADS: StructureArguments = {"supports": {"RIGHT/UPPER": 0.0}, "tractions": {"LEFT/LOWER": (0.0, -PUSH_STRESS)}}


def tubes(h: float, loads: StructureArguments) -> Problem:
    """A tube glued into another tube, in an axisymmetric section.

    In the section x is the radius and y the axis. The facet set "BOTTOM" of the joint is the bore (the inner side
    of the inner tube), "LEFT" the upper end of both tubes, where y is largest.

    Args:
        h: cell size, mm.
        loads: supports and tractions.

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    bore, on_S, rim = RADII
    section = sandwich(TUBE_LENGTH, on_S - bore, rim - on_S, h, cell="quadrilateral", structured=True)
    bodies: StructureArguments = {"body": {"LOWER": SHAFT, "UPPER": HUB}, "plane": "axisymmetric"}
    return section.rotated(-np.pi / 2).moved((on_S, 0.0)), bodies | loads


def tube_errors(full: Solution, limit: Solution) -> dict[str, float]:
    """Measure the relative errors of both models of the tubes against their closed forms.

    Args:
        full: solution with the meshed layer ("meshed"), compared with a closed form of three tubes.
        limit: solution with the interface law ("law"), compared with a closed form of two tubes and springs.

    Returns:
        "law_bore", "meshed_bore" -> error of the bore's displacement; "law_traction", "meshed_traction" -> error of the
        mean traction on S.
    """
    eps, (bore, on_S, rim) = float(layer_of(limit).eps), RADII
    radii, laws = (bore, on_S - eps / 2, on_S + eps / 2, rim), (SHAFT, GLUE.scaled(eps / GLUE_EPS), HUB)
    glued = lame(radii, laws, (None, None), PRESSURE)
    sprung = lame(RADII, (SHAFT, HUB), ((GLUE.lmbda + 2 * GLUE.mu) / GLUE_EPS,), PRESSURE)
    surface, row = Surface(end_state(limit).model), {}
    bore_force = 2 * np.pi * bore * TUBE_LENGTH * PRESSURE
    for name, state, exact, width in (("law", end_state(limit), sprung, 0.0), ("meshed", end_state(full), glued, eps)):
        row[f"{name}_bore"] = abs(state.energies()["loads"] / (bore_force * exact.displacement(0, bore)) - 1)
        force = surface.integral(surface.frame(surface.traction(state))[1]) / (2 * np.pi * TUBE_LENGTH)
        forces = [exact.stress(1, r) * r for r in (on_S - width / 2, on_S, on_S + width / 2)]
        mean_force = float(np.dot((1, 4, 1), forces)) / 6  # the mean through a meshed layer, over the area of S
        row[f"{name}_traction"] = abs(force / mean_force - 1)
    return row


def check_tubes(record: Record, tables: Tables) -> None:
    """Check both models of the tubes under inner pressure against their closed forms.

    Args:
        record: record of the run, which receives the checks.
        tables: name of a `Sweep` of the study `rates` -> its table, with a line for each thickness.
    """
    allowed_error = 16 * LAME_RTOL if record.options.get("quick") else LAME_RTOL
    for name in ("meshed", "law"):
        max_error = max(max(tables["tubes"][f"{name}_{what}"]) for what in ("bore", "traction"))
        record.check(f"relative difference from Lame, {name}", max_error, high=allowed_error)
