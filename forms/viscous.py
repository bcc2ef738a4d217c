"""Laws with a rate, or with creep: Kelvin-Voigt, Maxwell, Norton, and creep by Norton's power law."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import ufl

from forms.elastic import IsotropicLaw, lame_stress
from forms.law import Step, require_nonnegative, require_positive
from forms.tensors import Expr

# largest tangent of a power-law dashpot in a step, over the modulus of its spring; stiffer dashpots are made linear
MAX_STIFFNESS_RATIO = 1e6
CREEP_NEWTON_STEPS = 6  # Newton steps for the stress of a creep step; relative error 1e-14 for n = 20, 1e-10 for n = 50
RELATIVE_RATE_TOLERANCE = 1e-12  # relaxation rate of the mean stress, over the deviator's, that counts as zero
REST_STRAIN_INCREMENT = 1e-12  # strain increment of a step below which the dashpot may be linear


def isotropic_energy(lmbda: Expr, mu: Expr, e: Expr) -> Expr:
    """Return the elastic energy per volume lmbda (tr e)^2/2 + mu e:e, UFL, at the strain `e` (3, 3)."""
    return lmbda * ufl.tr(e) ** 2 / 2 + mu * ufl.inner(e, e)


class ParallelDashpot(IsotropicLaw):
    """Base of laws with an elastic spring and a dashpot in parallel; subclasses define the dashpot's stress."""

    rate = True
    has_quadratic_energy = True

    def _viscous_stress(self, step: Step) -> Expr:
        raise NotImplementedError

    def stress(self, step: Step) -> Expr:
        return lame_stress(self.lmbda, self.mu, step.mid) + self._viscous_stress(step)

    def energy(self, step: Step) -> Expr:
        return isotropic_energy(self.lmbda, self.mu, step.e)

    def dissipation(self, step: Step) -> Expr:
        return ufl.inner(self._viscous_stress(step), step.rate)


@dataclass(frozen=True)
class KelvinVoigt(ParallelDashpot):
    """Elastic spring parallel to a dashpot, stress = C(lmbda, mu) : e + C(lmbda theta_lmbda, mu theta_mu) : de/dt.

    C(lmbda, mu) is the isotropic stiffness tensor with these moduli.

    As a layer's law with the jump w it is t = K w + K_theta dw/dt, Eqs. (16)-(17) of the paper. Along S, eps K = mu and
    eps K_theta = mu theta_mu. Along n, eps K = lmbda + 2 mu and eps K_theta = lmbda theta_lmbda + 2 mu theta_mu.

    Attributes:
        lmbda, mu: moduli, stress; mu > 0, lmbda + 2 mu/3 > 0.
        theta_lmbda, theta_mu: viscosity divided by modulus, times; theta_mu > 0, lmbda theta_lmbda + 2 mu theta_mu/3 >=
            0.

    Raises:
        InputError: a parameter out of range.

    Example:
        >>> from forms import KelvinVoigt
        >>> from thinlayer import drive
        >>> resin = KelvinVoigt(lmbda=800.0, mu=400.0, theta_lmbda=1.0, theta_mu=2.0)
        >>> held = {"w_T": 0.5, "w_N": 0.0}
        >>> print(drive(resin, [held] * 2, dt=1.0).tractions.round(1))
        [[600.   0.]
         [200.   0.]]
    """

    theta_lmbda: float
    theta_mu: float
    linear: ClassVar = True

    def check(self) -> None:
        super().check()
        require_positive(self, "theta_mu")
        bulk_viscosity = self.lmbda * self.theta_lmbda + 2 / 3 * self.mu * self.theta_mu
        self.require(0 <= bulk_viscosity < math.inf, "theta_lmbda", "lmbda theta_lmbda + 2 mu theta_mu/3 >= 0")

    @property
    def relaxation_times(self) -> tuple[float, ...]:
        """Retardation time of the deviator and, if changes of volume are viscous, that of the mean strain."""
        bulk_viscosity = self.lmbda * self.theta_lmbda + 2 * self.mu * self.theta_mu / 3
        return self.theta_mu, *((bulk_viscosity / (self.lmbda + 2 * self.mu / 3),) if bulk_viscosity > 0 else ())

    def _viscous_stress(self, step: Step) -> Expr:
        return lame_stress(self.lmbda * self.theta_lmbda, self.mu * self.theta_mu, step.rate)

    def complex_moduli(self, omega: float) -> tuple[complex, complex]:
        """Return the complex moduli lmbda and mu of vibrations exp(i omega t); their imaginary parts dissipate."""
        return self.lmbda * (1 + 1j * omega * self.theta_lmbda), self.mu * (1 + 1j * omega * self.theta_mu)


class SeriesDashpot(IsotropicLaw):
    """Base of laws with an elastic spring and dashpots in series; subclasses define the relaxation rates in a step."""

    internal: ClassVar = {"stress": (3, 3)}
    has_quadratic_energy = True

    @property
    def _bulk_modulus(self) -> Expr:
        return self.lmbda + 2 * self.mu / 3

    def _relaxation_rates(self, step: Step) -> tuple[Expr, Expr]:
        """Return the relaxation rates, 1/time, UFL, of the deviator and of the mean of the stress at t + theta dt."""
        raise NotImplementedError

    def advance(self, step: Step) -> dict[str, Expr]:
        old, increment = step.q["stress"], step.e - step.e_old
        deviator_rate, mean_rate = self._relaxation_rates(step)
        deviator = self._relaxed(step, ufl.dev(old), 2 * self.mu * ufl.dev(increment), deviator_rate)
        mean_stress = self._relaxed(step, ufl.tr(old) / 3, self._bulk_modulus * ufl.tr(increment), mean_rate)
        return {"stress": deviator + mean_stress * ufl.Identity(3)}

    @staticmethod
    def _relaxed(step: Step, old: Expr, elastic_increment: Expr, rate: Expr) -> Expr:
        """Return the value, at the end of a step, of a part x of the stress that relaxes: its deviator or its mean.

        The value x_new solves x_new - x_old = elastic - dt rate x(t + theta dt).

        Args:
            step: the step, from t to t + dt.
            old: value x_old at its beginning.
            elastic_increment: increment of x without relaxation.
            rate: relaxation rate, 1/time.
        """
        x = step.dt * rate
        return ((1 - (1 - step.theta) * x) * old + elastic_increment) / (1 + step.theta * x)

    def stress(self, step: Step) -> Expr:
        return step.between(step.q["stress"], self.advance(step)["stress"])

    def _elastic_energies(self, stress: Expr) -> tuple[Expr, Expr]:
        """Return the elastic energies per volume, UFL, of the deviator and of the mean part of a stress (3, 3)."""
        s, mean_stress = ufl.dev(stress), ufl.tr(stress) / 3
        return ufl.inner(s, s) / (4 * self.mu), mean_stress**2 / (2 * self._bulk_modulus)

    def energy(self, step: Step) -> Expr:
        return sum(self._elastic_energies(step.q["stress"]))

    def dissipation(self, step: Step) -> Expr:
        energies = self._elastic_energies(self.stress(step))
        return sum(2 * energy * rate for energy, rate in zip(energies, self._relaxation_rates(step), strict=True))


@dataclass(frozen=True)
class Maxwell(SeriesDashpot):
    """Elastic spring and viscous dashpot in series, E de/dt = (1 + nu)(ds/dt + s/t1) - nu tr(ds/dt + s/t2) I.

    s is the three-dimensional stress, s_33 included, e the strain. For the strain rate de/dt Eq. (18) of the paper
    prints the strain. The deviator of the stress relaxes with the time t1. The mean stress relaxes with the time t_v,
    where 1/t_v = ((1 + nu)/t1 - 3 nu/t2)/(1 - 2 nu).

    As a layer's law with t1 = t2 and the jump w: the rate of the traction, plus the traction divided by t1, is K dw/dt.
    eps K is mu along S and lmbda + 2 mu along n. Equation (19) of the paper prints other coefficients. With t1 != t2
    the normal traction is a sum of two parts that relax differently, for which no single differential equation of first
    order holds.

    Attributes:
        lmbda, mu: moduli, stress; mu > 0, lmbda + 2 mu/3 > 0.
        t1: relaxation time of the deviator of the stress, > 0.
        t2: relaxation time of the trace of the stress in the formula above, > 0 and >= 3 nu t1/(1 + nu). If it equals
            this bound, the mean stress does not relax. Default: t1.

    Raises:
        InputError: a parameter out of range.

    Example:
        >>> from forms import Maxwell
        >>> from thinlayer import drive
        >>> resin = Maxwell(lmbda=800.0, mu=400.0, t1=2.0)
        >>> held = {"w_T": 0.01, "w_N": 0.0}
        >>> relaxing = drive(resin, [held] * 3, dt=[0, 2, 2], theta=0.5)
        >>> print(relaxing.tractions[:, 0].round(3))
        [4.    2.667 0.889]
    """

    t1: float
    t2: float | None = None
    linear: ClassVar = True

    def __post_init__(self) -> None:
        if self.t2 is None:
            object.__setattr__(self, "t2", self.t1)
        super().__post_init__()

    def check(self) -> None:
        super().check()
        require_positive(self, "t1")
        nu = self.lmbda / (2 * (self.lmbda + self.mu))
        min_t2 = 3 * nu * self.t1 / (1 + nu)
        in_range = self.t2 is not None and min_t2 <= self.t2 < math.inf and self.t2 > 0
        self.require(in_range, "t2", f"> 0 and >= 3 nu t1/(1 + nu) = {min_t2:g}")

    def complex_moduli(self, omega: float) -> tuple[complex, complex]:
        """Return the complex moduli lmbda and mu of vibrations exp(i omega t); their imaginary parts dissipate."""
        mu = self.mu * 1j * omega / (1j * omega + 1 / self.t1)
        return self._bulk_modulus * 1j * omega / (1j * omega + self._mean_relaxation_rate) - 2 * mu / 3, mu

    @property
    def _mean_relaxation_rate(self) -> Expr:
        """Relaxation rate 1/t_v of the mean stress, 1/time, by the formula in `Maxwell`, in terms of lmbda and mu."""
        t2: Expr = self.t2
        return ((3 * self.lmbda + 2 * self.mu) / self.t1 - 3 * self.lmbda / t2) / (2 * self.mu)

    @property
    def relaxation_times(self) -> tuple[float, ...]:
        """Relaxation time of the deviator and, if the mean stress relaxes, that of the mean stress."""
        rate = self._mean_relaxation_rate
        return self.t1, *((1 / rate,) if rate > RELATIVE_RATE_TOLERANCE / self.t1 else ())

    def _relaxation_rates(self, step: Step) -> tuple[Expr, Expr]:
        return 1 / self.t1, self._mean_relaxation_rate


@dataclass(frozen=True)
class Norton(ParallelDashpot):
    """Elastic spring parallel to a power-law dashpot, stress = C : e + eta |de/dt|^(p - 2) de/dt.

    This is Eq. (21) of the paper. C is the isotropic stiffness tensor of the moduli. Creep stops when the spring
    carries the load. Data sheets give a steady creep rate A sigma^n at the stress sigma, which is the law
    `NortonCreep`. The dashpot alone has this rate, without a change of volume, for p = 1 + 1/n and eta = (2/3)^((n +
    1)/(2 n)) A^(-1/n).

    As a layer's law with the jump w and v = dw/dt: t = K w + eta eps^(1 - p) q^(p - 2) (v_N n + v_T/2). q is the norm
    of sym(v (x) n), q^2 = v_N^2 + |v_T|^2/2; in Eqs. (22)-(24) of the paper it is the norm of v. For eps -> 0 the law
    is finite if eta is proportional to eps^(p - 1).

    For p < 2 the tangent is infinite at zero rate. The dashpot is therefore linear where its stiffness in a step would
    exceed 1e6 times the spring's, but only at strain increments below 1e-12. For p < 1.2 Newton's method may need a
    larger linear range, which `rest` gives.

    Attributes:
        lmbda, mu: moduli, stress; mu > 0, lmbda + 2 mu/3 > 0.
        eta: viscosity, stress times time^(p - 1) (in a layer: stress (time/length)^(p - 1)); > 0.
        p: exponent > 1. 2: a linear dashpot; near 1: almost rigid below a threshold.
        rest: strain rate below which the dashpot is linear, as a part of the law: |de/dt|^2 + rest^2 replaces
            |de/dt|^2. Unit 1/time (in a layer: length/time); >= 0. For p < 1.2 Newton's method needs at least about
            1e-4 of the actual rates.

    Raises:
        InputError: a parameter out of range.

    Example:
        >>> from forms import Norton
        >>> from thinlayer import drive
        >>> solder = Norton(lmbda=800.0, mu=400.0, eta=300.0, p=1.5)
        >>> held = {"w_T": 0.5, "w_N": 0.0}
        >>> print(drive(solder, [held] * 2, dt=1.0).tractions.round(1))
        [[326.1   0. ]
         [200.    0. ]]
    """

    eta: float
    p: float
    rest: float = 0.0

    @property
    def powers(self) -> Mapping[str, float]:  # type: ignore[override]
        """Name of a parameter -> exponent of the thickness eps with which it scales in a family of layers."""
        return {"lmbda": 1, "mu": 1, "eta": self.p - 1, "rest": -1}

    def check(self) -> None:
        super().check()
        require_positive(self, "eta")
        require_nonnegative(self, "rest")
        self.require(1 < self.p < math.inf, "p", "> 1")

    def _viscous_stress(self, step: Step) -> Expr:
        dt: Expr = step.dt
        # for p < 2, the strain rate at which the dashpot has the largest stiffness
        stiffest_rate = (self.eta / (MAX_STIFFNESS_RATIO * self.mu * dt)) ** (1 / (2 - self.p))
        min_rate = ufl.conditional(ufl.lt(self.p, 2), ufl.min_value(stiffest_rate, REST_STRAIN_INCREMENT / dt), 0)
        q = ufl.inner(step.rate, step.rate) + self.rest**2 + min_rate**2 + 1e-300  # powers have no derivative at 0
        return self.eta * q ** (self.p / 2 - 1) * step.rate


@dataclass(frozen=True)
class NortonCreep(SeriesDashpot):
    """Norton's creep: elastic spring and power-law dashpot in series, de/dt = C^-1 : ds/dt + 3/2 A q^(n - 1) dev s.

    e is the strain, s the stress, C the isotropic stiffness tensor of the moduli, q = sqrt(3/2) |dev s| the equivalent
    stress. In uniaxial tension with the stress sigma, creep continues at the steady rate A sigma^n of data sheets,
    without a change of volume. In `Norton`, the paper's law, the dashpot is parallel to the spring, and creep stops.

    As a layer's law with the jump w: under a constant shear traction t_T the jump grows, after its elastic part, by
    dw_T/dt = eps 3^((n + 1)/2) A |t_T|^(n - 1) t_T.

    Attributes:
        lmbda, mu: moduli, stress; mu > 0, lmbda + 2 mu/3 > 0.
        A: creep rate under unit stress, 1/(time stress^n) (in a layer: length/(time stress^n)); > 0.
        n: exponent >= 1. 1: Maxwell's dashpot with t1 = 1/(3 mu A), for the deviator alone.

    Raises:
        InputError: a parameter out of range.

    Example:
        >>> from forms import NortonCreep
        >>> from thinlayer import drive
        >>> solder = NortonCreep(lmbda=800.0, mu=400.0, A=1e-7, n=3)
        >>> held = {"w_T": 0.5, "w_N": 0.0}
        >>> print(drive(solder, [held] * 3, dt=1.0).tractions.round(1))
        [[71.   0. ]
         [42.8  0. ]
         [31.5  0. ]]
    """

    A: float
    n: float
    powers: ClassVar = {"lmbda": 1, "mu": 1, "A": -1}

    def check(self) -> None:
        super().check()
        require_positive(self, "A")
        self.require(1 <= self.n < math.inf, "n", ">= 1")

    def _relaxation_rates(self, step: Step) -> tuple[Expr, Expr]:
        """Return the relaxation rates, 1/time, UFL, of the deviator and of the mean of the stress at t + theta dt.

        The latter is zero. The former follows from x, the equivalent stress divided by its value without creep in the
        step. x is the root of the convex function x + c x^n - 1. Here c is theta dt times the rate at the equivalent
        stress without creep.
        """
        n: Expr = self.n
        trial_deviator = ufl.dev(step.q["stress"]) + 2 * step.theta * self.mu * ufl.dev(step.e - step.e_old)
        q = ufl.sqrt(1.5 * ufl.inner(trial_deviator, trial_deviator) + 1e-300)  # roots have no derivative at 0
        rate = 3 * self.mu * self.A * q ** (n - 1)
        c = step.theta * step.dt * rate
        x: Expr = (1 + c) ** (-1 / n)  # not less than the root, so that Newton's iterates decrease to it
        for _ in range(CREEP_NEWTON_STEPS):
            x = (1 + (n - 1) * c * x**n) / (1 + n * c * x ** (n - 1))
        return rate * x ** (n - 1), 0
