"""Laws that a user would write, with every feature of a law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import ufl

from forms.elastic import lame_stress
from forms.flux import FluxLaw
from forms.law import BulkLaw, Law
from forms.plastic import VonMises
from forms.traction import TractionLaw
from forms.viscous import KelvinVoigt, isotropic_energy
from thinlayer.discretisation.layer import Layer, SurfaceLaw, ThinLayer


def layer_of(law: Law, eps: float) -> Layer:
    """A layer of a law: laws on S are layers by themselves, others have a thickness."""
    return law if isinstance(law, SurfaceLaw) else ThinLayer(law, eps, at=1.0)


@dataclass(frozen=True)
class Radiating(FluxLaw):
    """A conductivity that grows with the cube of the value."""

    a: float
    powers: ClassVar = {"a": 1}
    symmetric = False

    def flux(self, step):
        return self.a * step.T**3 * step.g


@dataclass(frozen=True)
class StandardSolid(BulkLaw):
    """Spring parallel to a spring and dashpot in series, which act on the deviator; memory: the dashpot's strain."""

    lmbda: float
    mu: float
    mu_1: float
    t_1: float
    powers: ClassVar = {"lmbda": 1, "mu": 1, "mu_1": 1}
    internal: ClassVar = {"viscous": (3, 3)}
    linear = has_quadratic_energy = True

    def advance(self, step):
        x, old = step.dt / self.t_1, step.q["viscous"]
        return {"viscous": ((1 - (1 - step.theta) * x) * old + x * ufl.dev(step.mid)) / (1 + step.theta * x)}

    def _branch(self, step):
        return ufl.dev(step.mid) - step.between(step.q["viscous"], self.advance(step)["viscous"])

    def stress(self, step):
        return lame_stress(self.lmbda, self.mu, step.mid) + 2 * self.mu_1 * self._branch(step)

    def energy(self, step):
        branch = ufl.dev(step.e) - step.q["viscous"]
        return isotropic_energy(self.lmbda, self.mu, step.e) + self.mu_1 * ufl.inner(branch, branch)

    def dissipation(self, step):
        branch = self._branch(step)
        return 2 * self.mu_1 / self.t_1 * ufl.inner(branch, branch)


@dataclass(frozen=True)
class Hardening(BulkLaw):
    """Memory of all three shapes, no quadratic energy: stiffer with the strain gone through, and in closing."""

    lmbda: float
    mu: float
    powers: ClassVar = {"lmbda": 1, "mu": 1}
    symmetric: ClassVar = False
    internal: ClassVar = {"path": (), "drift": (3,), "mean": (3, 3)}

    def _changed(self, step):
        increment = step.e - step.e_old
        return ufl.inner(increment, increment)

    def advance(self, step):
        q, change = step.q, self._changed(step)
        drift = q["drift"] + ufl.dot(step.e - step.e_old, step.n)
        return {"path": q["path"] + change, "drift": drift, "mean": (q["mean"] + step.e) / 2}

    def stress(self, step):
        pulled = ufl.sym(ufl.outer(step.q["drift"], step.n)) + step.q["mean"]
        closing = self.lmbda * ufl.tr(step.mid) ** 2 * ufl.Identity(3)
        hardened = (1 + step.q["path"] + self._changed(step)) * lame_stress(self.lmbda, self.mu, step.mid)
        return hardened + self.mu * pulled - closing

    def energy(self, step):
        return (1 + step.q["path"]) * isotropic_energy(self.lmbda, self.mu, step.e)


class Mises(VonMises):
    """A user's law in C, which says of itself no more than it must."""

    bounded = isochoric = False
    homotopy = BulkLaw.homotopy


@dataclass(frozen=True)
class Fragile(BulkLaw):
    """A law that is not defined for every strain."""

    mu: float

    def stress(self, step):
        left = 0.5 - step.e[0, 0]
        return self.mu * ufl.sqrt(left) ** 2 / left * step.e


@dataclass(frozen=True)
class Slipping(TractionLaw):
    """Springs, the tangential one in series with a dashpot whose slip is remembered; stiffer when closed."""

    k_N: float
    k_T: float
    viscosity: float
    closed: float
    symmetric: ClassVar = False
    internal: ClassVar = {"slip": (3,), "path": ()}

    def _slip(self, step):
        w_T = step.mid - ufl.dot(step.mid, step.n) * step.n
        x = step.dt * self.k_T / self.viscosity
        return (step.q["slip"] + step.theta * x * w_T) / (1 + step.theta * x)

    def traction(self, step):
        w_N = ufl.dot(step.mid, step.n)
        along = self.k_T * (step.mid - w_N * step.n - self._slip(step))
        return (self.k_N * w_N - self.closed * w_N**2) * step.n + along

    def evolve(self, step):
        slip = step.q["slip"] + (self._slip(step) - step.q["slip"]) / step.theta
        change = step.w - step.w_old
        return {"slip": slip, "path": step.q["path"] + ufl.inner(change, change)}


@dataclass(frozen=True)
class Cubic(BulkLaw):
    """A user's law that is not linear, in forms; without memory it answers at once."""

    k: float
    c: float
    powers: ClassVar = {"k": 1, "c": 3}

    def stress(self, step):
        return 2 * self.k * step.e + self.c * ufl.inner(step.e, step.e) * step.e


@dataclass(frozen=True)
class Skew(BulkLaw):
    """Elastic, with a tangent that is not symmetric."""

    mu: float
    c: float
    powers: ClassVar = {"mu": 1, "c": 1}
    linear: ClassVar = True
    symmetric: ClassVar = False

    def stress(self, step):
        turn = ufl.as_matrix([[0, 1, 0], [-1, 0, 0], [0, 0, 0]])
        return lame_stress(self.mu, self.mu, step.mid) + self.c * ufl.sym(turn * step.mid)


@dataclass(frozen=True)
class Stiffening(BulkLaw):
    """Elastic, stiffer with the size of the strain: C e + a (e:e) e."""

    lmbda: float
    mu: float
    a: float

    def stress(self, step):
        return lame_stress(self.lmbda, self.mu, step.mid) + self.a * ufl.inner(step.mid, step.mid) * step.mid

    def energy(self, step):
        return isotropic_energy(self.lmbda, self.mu, step.e) + self.a * ufl.inner(step.e, step.e) ** 2 / 4


@dataclass(frozen=True)
class Swelling(BulkLaw):
    """Elastic about a strain of its own; its tangent is constant, of which it says nothing."""

    lmbda: float
    mu: float
    swelling: float
    powers: ClassVar = {"lmbda": 1, "mu": 1, "swelling": -1}

    def _elastic(self, e):
        return e - self.swelling * ufl.Identity(3)

    def stress(self, step):
        return lame_stress(self.lmbda, self.mu, self._elastic(step.mid))

    def energy(self, step):
        return isotropic_energy(self.lmbda, self.mu, self._elastic(step.e))


@dataclass(frozen=True)
class Springs(TractionLaw):
    """Along S and across it."""

    K_T: float
    K_N: float
    linear: ClassVar = True

    def traction(self, step):
        return self.K_T * step.mid + (self.K_N - self.K_T) * ufl.dot(step.mid, step.n) * step.n


@dataclass(frozen=True)
class Damaging(BulkLaw):
    """Damage of an isotropic material, whose stress falls linearly from the energy `onset` on; k * onset breaks it."""

    lmbda: float
    mu: float
    onset: float
    k: float
    powers: ClassVar = {"lmbda": 1, "mu": 1, "onset": -1}
    internal: ClassVar = {"d": ()}
    symmetric: ClassVar = False
    softens: ClassVar = True

    def _damage(self, step, e):
        x = ufl.sqrt(ufl.max_value(isotropic_energy(self.lmbda, self.mu, e) / self.onset, 1))
        return ufl.max_value(step.q["d"], ufl.min_value(self.k * (x - 1) / (x * (self.k - 1)), 1.0))

    def stress(self, step):
        return (1 - self._damage(step, step.mid)) * lame_stress(self.lmbda, self.mu, step.mid)

    def advance(self, step):
        return {"d": self._damage(step, step.e)}

    def energy(self, step):
        return (1 - step.q["d"]) * isotropic_energy(self.lmbda, self.mu, step.e)

    def dissipated(self, step):
        spent = lambda d: self.onset * self.k * d / (self.k - d * (self.k - 1))
        return spent(self._damage(step, step.e)) - spent(step.q["d"])


def _aged(value, growth, x, t):
    return value * (1 + growth * t) * np.ones(x.shape[1])


@dataclass(frozen=True)
class AgeingSpring(BulkLaw):
    """A spring without memory that becomes stiffer with time, and along S."""

    mu: float
    growth: float
    along: float = 0.0
    powers: ClassVar = {"mu": 1}
    linear = has_quadratic_energy = varies = True

    def at(self, x, t):
        return {"mu": _aged(self.mu, self.growth, x, t) * (1 + self.along * x[0])}

    def stress(self, step):
        return 2 * self.mu * step.mid

    def energy(self, step):
        return self.mu * ufl.inner(step.e, step.e)


@dataclass(frozen=True)
class AgeingFluid(BulkLaw):
    """A spring and a dashpot in series; the relaxation time grows with the time t, the spring too if it has a growth."""

    mu: float
    tau: float
    growth: float = 0.0
    powers: ClassVar = {"mu": 1}
    linear = has_quadratic_energy = varies = True
    internal: ClassVar = {"flow": (3, 3)}

    def at(self, x, t):
        return {"mu": _aged(self.mu, self.growth, x, t), "tau": _aged(self.tau, 1.0, x, t)}

    def advance(self, step):
        x, old = step.dt / self.tau, step.q["flow"]
        return {"flow": (old + x * (step.mid - (1 - step.theta) * old)) / (1 + step.theta * x)}

    def _elastic(self, step):
        return step.mid - step.between(step.q["flow"], self.advance(step)["flow"])

    def stress(self, step):
        return 2 * self.mu * self._elastic(step)

    def energy(self, step):
        return self.mu * ufl.inner(step.e - step.q["flow"], step.e - step.q["flow"])

    def dissipation(self, step):
        return 2 * self.mu / self.tau * ufl.inner(self._elastic(step), self._elastic(step))


@dataclass(frozen=True)
class AgeingKelvinVoigt(KelvinVoigt):
    """A spring and a dashpot in parallel, both stiffer with time."""

    growth: float = 0.0
    varies: ClassVar = True

    def at(self, x, t):
        return {"mu": _aged(self.mu, self.growth, x, t), "theta_mu": _aged(self.theta_mu, 1.0, x, t)}
