"""A layer with many small cracks parallel to S, whose density grows in time: its damage is a measure of these cracks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import ufl

from forms.breaking import CracksAlongS
from forms.law import BulkLaw, Step, require_nonnegative, require_positive
from forms.tensors import Expr


@dataclass(frozen=True)
class Microcracked(CracksAlongS):
    """Isotropic material with penny-shaped cracks parallel to S, of a density rho that grows with the energy released.

    rho is the sum of the cubes of the radii per volume, of cracks that do not interact. With E and nu of the sound
    material, M = lmbda + 2 mu and the traction t of each side (Kachanov, 1994),

        c_N = 16 (1 - nu^2)/(3 E),   c_T = c_N/(1 - nu/2),
        t_N = w_N/(eps/M + eps c_N rho) in opening, M w_N/eps in closing,   t_T = w_T/(eps/mu + eps c_T rho).

    Closed cracks slide without friction. New cracks release Y = (c_N <t_N>+^2 + c_T |t_T|^2)/2 per volume and density, and

        viscosity d(rho)/dt = <Y - Y_0>+.

    At slow rates the traction is bounded, where Y = Y_0. The step is linearised in rho, which is stable for any length.
    The layer stores the elastic energy, and dissipates Y per rho.

    Attributes:
        lmbda, mu: Lame moduli of the sound material, stresses; lmbda > -2 mu/3, mu > 0.
        Y_0: energy per volume and density from which on cracks grow, > 0.
        viscosity: energy times time per volume and density, > 0.
        rho_0: density at the start, >= 0.

    Raises:
        InputError: a parameter out of range.

    Example:
        >>> from forms import Microcracked
        >>> from thinlayer import drive
        >>> data = {"Y_0": 1e-3, "viscosity": 1e-3, "rho_0": 0.3}
        >>> mortar = Microcracked(lmbda=400.0, mu=400.0, **data)
        >>> print(drive(mortar, [{"w_T": 0.0, "w_N": 1e-4}], dt=1.0).tractions.round(4))
        [[0.     0.0429]]
    """

    Y_0: float
    viscosity: float
    rho_0: float = 0.0
    internal: ClassVar = {"rho": ()}
    symmetric: ClassVar = False
    stiffness = BulkLaw.stiffness  # type: ignore[assignment]  # computed from the stress, as it depends on rho_0
    powers: ClassVar[Mapping[str, float]] = {"lmbda": 1, "mu": 1, "Y_0": -1, "viscosity": -1}

    def check(self) -> None:
        super().check()
        require_positive(self, "Y_0", "viscosity")
        require_nonnegative(self, "rho_0")

    @property
    def relaxation_times(self) -> tuple[float, ...]:
        """The time in which the density grows by 1 where Y is 2 Y_0."""
        return (self.viscosity / self.Y_0,)

    def crack_compliances(self) -> tuple[Expr, Expr]:
        """Return c_N and c_T, compliances per density in opening and in shear, 1/stress."""
        M, lmbda, mu = self.lmbda + 2 * self.mu, self.lmbda, self.mu
        return 4 * M / (3 * mu * (lmbda + mu)), 16 * M / (3 * mu * (3 * lmbda + 4 * mu))

    def _opening_and_slip_at(self, step: Step, e: Expr) -> tuple[Expr, Expr, Expr]:
        """Return the opening, the closing, and the shear (3,) at a strain e."""
        w_N, w_T = self.opening_and_slip(e, step.n)
        opening = ufl.conditional(ufl.ge(w_N, 0), w_N, 0.0)
        return opening, w_N - opening, w_T

    def _flexibilities(self, rho: Expr) -> tuple[Expr, Expr]:
        """Return opening and slip per traction at a density rho, of a thickness of 1."""
        c_N, c_T = self.crack_compliances()
        return 1 / (self.lmbda + 2 * self.mu) + c_N * rho, 1 / self.mu + c_T * rho

    def _released(self, step: Step, rho: Expr) -> tuple[Expr, Expr]:
        """Return Y at t + theta dt at a density rho, and minus its derivative by rho."""
        (w_N, _, w_T), (s_N, s_T) = self._opening_and_slip_at(step, step.mid), self._flexibilities(rho)
        c_N, c_T = self.crack_compliances()
        Y_I, Y_II = c_N * w_N**2 / (2 * s_N**2), c_T * ufl.inner(w_T, w_T) / (2 * s_T**2)
        return Y_I + Y_II, 2 * (Y_I * c_N / s_N + Y_II * c_T / s_T)

    def _densities(self, step: Step) -> tuple[Expr, Expr, Expr]:
        """Return rho at the beginning, at t + theta dt, and at the end."""
        dt: Expr = step.dt
        old = ufl.max_value(step.q["rho"], self.rho_0)
        Y, fall = self._released(step, old)
        new = old + dt * ufl.max_value(Y - self.Y_0, 0.0) / (self.viscosity + step.theta * dt * fall)
        return old, step.between(old, new), new

    def _damaged_traction(self, step: Step) -> tuple[Expr, Expr]:
        opening, closing, w_T = self._opening_and_slip_at(step, step.mid)
        s_N, s_T = self._flexibilities(self._densities(step)[1])
        return opening / s_N + (self.lmbda + 2 * self.mu) * closing, w_T / s_T

    def advance(self, step: Step) -> dict[str, Expr]:
        return {"rho": self._densities(step)[2]}

    def energy(self, step: Step) -> Expr:
        opening, closing, w_T = self._opening_and_slip_at(step, step.e)
        s_N, s_T = self._flexibilities(ufl.max_value(step.q["rho"], self.rho_0))
        across = opening**2 / s_N + (self.lmbda + 2 * self.mu) * closing**2 + ufl.inner(w_T, w_T) / s_T
        return (across + ufl.inner(self._along(step)[2], step.e)) / 2

    def dissipated(self, step: Step) -> Expr:
        """Return the energy that new cracks release in the step, UFL; never negative."""
        old, mid, new = self._densities(step)
        return self._released(step, mid)[0] * (new - old)
