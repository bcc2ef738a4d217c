"""Von Mises' plasticity with isotropic and kinematic hardening, for bodies and layers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from forms.base import is_number
from forms.elastic import LinearElastic, isotropic_stiffness, require_moduli
from forms.fields import Parameter
from forms.kernel import KernelLaw
from forms.law import LawError, positive
from forms.plastic import require_hardening

LEAST_FRACTION, MOST_FRACTION = 1e-6, 1 - 1e-9  # of the stiffness that hardening leaves, in continuation


@dataclass(frozen=True)
class VonMises(KernelLaw):
    """Isotropic elasticity, and plastic flow along the deviator where the equivalent stress reaches the yield stress.

    sqrt(3/2) |s - 2/3 K e^p| <= Y + H p + Q (1 - exp(-p/p_0)), with the deviator s of the stress, the plastic strain e^p,
    which has no trace, and the accumulated plastic strain p, dp/dt = sqrt(2/3) |de^p/dt|. In uniaxial tension it is the
    yield stress, in shear |s_12| <= Y/sqrt(3) at first. Flow is associated, steps are implicit (radial return).

    The work of isotropic hardening is dissipated, that of kinematic hardening (Prager's) is stored.

    As a layer's law, of t = (lmbda + 2 mu/3) w_N n + s n with s the deviator of a strain sym(w (x) n): without hardening
    t_T is at most Y/sqrt(3), reached under lasting shear, and t_N - (lmbda + 2 mu/3) w_N at most 2 Y/3.

    Attributes:
        lmbda, mu: moduli, stress; mu > 0, lmbda + 2 mu/3 > 0.
        strength: Y in the formulas, yield stress in tension, stress, also in a layer; > 0.
        hardening: H, linear isotropic hardening, stress; >= 0.
        kinematic: K, linear kinematic hardening, likewise.
        saturation: Q, largest increase of the yield stress beside H p, stress, also in a layer; >= 0.
        saturation_strain: p_0, strain (in a layer: strain times thickness, a length); > 0 where Q > 0.

    Raises:
        LawError: a parameter out of range.
    """

    lmbda: float
    mu: float
    strength: float
    hardening: float = 0.0
    kinematic: float = 0.0
    saturation: float = 0.0
    saturation_strain: float = 0.0
    powers: ClassVar = {"lmbda": 1, "mu": 1, "hardening": 1, "kinematic": 1, "saturation_strain": -1}
    internal: ClassVar = {"plastic": (3, 3), "accumulated": ()}
    memory: ClassVar = 7
    energetic: ClassVar = True
    isotropic: ClassVar = True
    quadratic: ClassVar = True
    bounded: ClassVar = True
    isochoric: ClassVar = True
    source: ClassVar = Path(__file__).with_name("von_mises.c")
    stiffness = isotropic_stiffness

    @classmethod
    def young(cls, E: Parameter, nu: Parameter, strength: Parameter, **hardening: Any) -> VonMises:
        """The law with Young's modulus and Poisson's ratio, see `LinearElastic.young`."""
        elastic = LinearElastic.young(E, nu)
        return cls(elastic.lmbda, elastic.mu, strength, **hardening)  # type: ignore[arg-type]

    def check(self) -> None:
        require_moduli(self, self.lmbda, self.mu)
        positive(self, "strength")
        require_hardening(self, "hardening", "kinematic", "saturation")

    def eased(self, ease: float) -> VonMises:
        """The law with kinematic hardening between its own (ease = 0) and that of an almost elastic material (1)."""
        if not (is_number(ease) and 0 <= ease <= 1):
            raise LawError(f"{type(self).__name__}: ease is {ease!r}; allowed: 0 to 1")
        if not ease:
            return self
        share = min(LEAST_FRACTION ** (1 - ease), MOST_FRACTION)
        return self.with_parameters({"kinematic": self.kinematic + 3 * self.mu * share / (1 - share)})
