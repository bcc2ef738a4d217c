"""Plasticity with hardening: Mohr-Coulomb on all planes or only on those parallel to S, and von Mises."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import ufl

from forms.elastic import IsotropicLaw, LinearElastic, lame_stress
from forms.kernel import KernelLaw
from forms.law import Step, choice, require_nonnegative, require_positive
from forms.parameter_fields import Parameter
from forms.tensors import Expr
from forms.traits import warn_of_range
from forms.viscous import isotropic_energy

MIN_FRICTION_ANGLE_DEGREES = 1.6  # degrees; smaller friction angles were probably meant in radians (pi/2 = 1.57)
MIN_ELASTIC_FRACTION = 1e-6  # smallest elastic fraction of the stiffness in continuation, as its parameter tends to 0


def require_valid_hardening(law: Plastic | VonMises, *names: str) -> None:
    """Raise InputError unless the hardening parameters `names` and the saturation strain of a law are >= 0.

    With a saturation > 0 the saturation strain must be > 0.
    """
    require_nonnegative(law, *names, "saturation_strain")
    law.require(law.saturation_strain > 0 or law.saturation == 0, "saturation_strain", "> 0 where saturation > 0")


@dataclass(frozen=True)
class Plastic(IsotropicLaw):
    """Base of the Mohr-Coulomb laws: isotropic elasticity, and plastic strain where the shear stress reaches its bound.

    A fraction h, `elastic_fraction`, of the stiffness stays elastic: stress = (1 - h) stress_plastic + h (lmbda tr(e) I
    + 2 mu e). With h > 0 a solution exists even where ideal plasticity has none (a layer without cohesion has no
    strength at its free ends). As a part of the law, h is the same in the meshed layer and on S. With h > 0 there are
    no limit loads; `State.elastic_share` tells how much of a load the fraction h carries.

    The cohesion c grows from its initial value C with the accumulated plastic strain p: c = C + H p + Q p/(p_0 + p).
    The work of this hardening is dissipated. p is defined such that c dp is the plastic work if the flow is associated;
    each law says how p grows.

    Attributes:
        lmbda, mu: moduli, stress; mu > 0, lmbda + 2 mu/3 > 0.
        cohesion: initial cohesion, C in the formulas, stress; >= 0. In a layer it does not scale with the thickness.
        friction_angle: Omega in the formulas, in degrees (30, not 0.52), 0 <= Omega < 90; > 0 if C = 0.
        elastic_fraction: h in the formulas, 0 <= elastic_fraction < 1.
        hardening: H in the formulas, increase of the cohesion per plastic strain, stress; >= 0.
        saturation: Q in the formulas, largest increase of the cohesion in addition to H p, stress; >= 0. In a layer it
            does not scale with the thickness.
        saturation_strain: p_0 in the formulas, at which half of Q is reached, strain (in a layer: strain times
            thickness, a length); > 0 where Q > 0.

    Raises:
        InputError: a parameter out of range.
    """

    cohesion: float
    friction_angle: float
    elastic_fraction: float = 0.0
    hardening: float = field(default=0.0, kw_only=True)
    saturation: float = field(default=0.0, kw_only=True)
    saturation_strain: float = field(default=0.0, kw_only=True)
    powers: ClassVar = {"lmbda": 1, "mu": 1, "hardening": 1, "saturation_strain": -1}
    symmetric: ClassVar = False
    internal: ClassVar = {"plastic": (3, 3), "accumulated": ()}
    has_quadratic_energy: ClassVar = True
    bounded: ClassVar = True

    def check(self) -> None:
        super().check()
        require_nonnegative(self, "cohesion")
        self.require(0 <= self.friction_angle < 90, "friction_angle", "0 <= friction_angle < 90 degrees")
        angle = self.friction_angle
        if 0 < angle < MIN_FRICTION_ANGLE_DEGREES:
            label = f"{type(self).__name__}: friction_angle is {angle:g} degrees, almost no friction"
            warn_of_range("friction angle", f"{label}; if it is in radians, friction_angle = {math.degrees(angle):.4g}")
        allowed = "> 0 where friction_angle = 0: nothing would resist shear"
        self.require(self.cohesion > 0 or angle > 0, "cohesion", allowed)
        self.require(0 <= self.elastic_fraction < 1, "elastic_fraction", "0 <= elastic_fraction < 1")
        require_valid_hardening(self, "hardening", "saturation")

    def homotopy(self, parameter: float) -> Plastic:
        """Return a law for continuation, whose elastic fraction is larger than this law's.

        Args:
            parameter: from 0 (this law) to 1 (an elastic layer, elastic fraction 1).
        """
        h, weight = self.elastic_fraction, MIN_ELASTIC_FRACTION ** (1 - parameter) if parameter else 0.0
        return self.with_parameters({"elastic_fraction": h + weight * (1 - h)})


@dataclass(frozen=True)
class MohrCoulomb(KernelLaw, Plastic):
    """Mohr-Coulomb elasto-plasticity: on every plane |shear stress| <= c - tan(Omega) normal stress.

    c is the cohesion after hardening, C its initial value, Omega the friction angle, psi the dilatancy angle. In
    principal stresses s_1 >= s_2 >= s_3 the condition is (s_1 - s_3)/2 <= c cos(Omega) - (s_1 + s_3)/2 sin(Omega). The
    plastic flow has psi in place of Omega. Where the flow preserves the volume, the accumulated plastic strain grows by
    cos(Omega) times the largest plastic shear strain (engineering). Steps are implicit.

    Equation (30) of the paper prints |s_n|, which is right in compression only. Its flow is on one plane, so that it is
    not coaxial with the stress. There are two such planes; here the flow is the mean of both. In Eqs. (31) and (33) the
    plastic strains lack a factor 2, and the plastic strain has no trace.

    As a layer's law it is not Coulomb's law with tan(Omega). In plane strain let s_m = (lmbda + mu) w_N/eps be the mean
    in-plane stress, and s = (s_N, s_T) the in-plane deviator. While |s| <= R = C cos(Omega) - s_m sin(Omega), an
    increment dw of the jump increases s by mu/eps dw. For psi = 0

        t_N = s_m + s_N, t_T = s_T

    and under lasting shear t_T tends to C cos(Omega) - t_N sin(Omega). Equations (34)-(35) of the paper need a plastic
    strain sym(w^p (x) n)/eps; the plastic strain of this law does not have this form.

    These formulas hold for psi = 0, in plane strain, and for s_33 between the in-plane principal stresses. At yield
    this means |s_m| (1 - 2 nu) <= R. They fail in tension near the apex, and in compression for small nu and Omega.
    With C = 0 they fail in compression for nu < (1 - sin(Omega))/2.

    The law is compiled from a C file: a return mapping to faces, edges and apex of the yield surface in principal
    stresses. On edges and at the apex the accumulated plastic strain grows by 2 cos(Omega) times the sum of the plastic
    multipliers of both planes.

    For psi = 0 the flow does not change the mean stress, so that stresses with a mean above C cot(Omega) cannot return
    to the yield surface. There the stress is set to C cot(Omega) times the identity, with a volumetric plastic strain.
    The material has torn. It closes only when this volume is compressed to zero again. For psi > 0 the flow itself
    returns such stresses.

    The moduli, cohesion, friction_angle, elastic_fraction and the parameters of the hardening are described in the base
    class `Plastic`.

    Attributes:
        dilatancy_angle: psi in the formulas, in degrees, 0 <= psi <= Omega.

    Example:
        >>> from forms import MohrCoulomb
        >>> from thinlayer import drive
        >>> mortar = MohrCoulomb(lmbda=1200.0, mu=800.0, cohesion=0.3, friction_angle=30)
        >>> sheared = [{"w_T": w, "t_N": -1.0} for w in (0, 0.002, 0.004, 0.006, 0.008)]
        >>> print(drive(mortar, sheared).tractions.round(2))
        [[ 0.   -1.  ]
         [ 0.67 -1.  ]
         [ 0.73 -1.  ]
         [ 0.75 -1.  ]
         [ 0.76 -1.  ]]
    """

    dilatancy_angle: float = 0.0
    memory: ClassVar = 7
    energetic: ClassVar = True
    isotropic: ClassVar = True
    source: ClassVar = Path(__file__).with_name("mohr_coulomb.c")

    def check(self) -> None:
        super().check()
        allowed_text = f"0 <= dilatancy_angle <= friction_angle = {self.friction_angle:g} degrees"
        self.require(0 <= self.dilatancy_angle <= self.friction_angle, "dilatancy_angle", allowed_text)


@dataclass(frozen=True)
class MohrCoulombMonodirectional(Plastic):
    """Mohr-Coulomb elasto-plasticity with slip only on planes parallel to S: |t_T| <= c - tan(Omega) t_N.

    t is stress times n, c the cohesion after hardening, C its initial value, Omega the friction angle. The accumulated
    plastic strain grows by the plastic shear strain across S (engineering). In a layer this is the increment |dw^p| of
    the plastic jump divided by the thickness.

    This is the law of Eqs. (37)-(38) and (54)-(55) of the paper. Here the flow has the sign of the shear stress:
    dw^p/dt = k t_T/|t_T|, k >= 0. As a layer's law with the jump w it is t = K (w - w^p): Coulomb's friction with the
    elastic stiffnesses (lmbda + 2 mu)/eps along n and mu/eps along S. Where t_N > C cot(Omega) the shear traction
    vanishes, while the normal traction stays elastic in tension, as in the paper.

    With `unilateral` the layer opens instead of carrying tension: a free strain along n keeps t_N <= 0, and |t_T| <= C
    remains where it is open. With C = 0 its limit is contact with friction tan(Omega), `IncrementalCoulomb.of_layer`.

    The moduli, cohesion, friction_angle, elastic_fraction and the parameters of the hardening are described in the base
    class `Plastic`.

    Attributes:
        unilateral: whether the layer opens instead of carrying tension.
    """

    unilateral: bool = choice(False)

    @property
    def has_quadratic_energy(self) -> bool:  # type: ignore[override]
        return not self.unilateral

    def check(self) -> None:
        super().check()
        self.require(isinstance(self.unilateral, bool), "unilateral", "True or False", repr(self.unilateral))

    def _tension(self, e: Expr, n: Expr) -> Expr:
        """Return the tension across planes with the normal `n` at an elastic strain `e` (3, 3), UFL; 0 in compression.

        A unilateral law removes this tension by a free strain along n.
        """
        return ufl.max_value(self.lmbda * ufl.tr(e) + 2 * self.mu * ufl.dot(n, ufl.dot(e, n)), 0)

    def _trial_stress(self, step: Step) -> Expr:
        """Return the stress (3, 3), UFL, at t + theta dt if the plastic strain did not change in the step.

        It is that of a law without elastic fraction.
        """
        e, n = step.mid - step.q["plastic"], step.n
        stress = lame_stress(self.lmbda, self.mu, e)
        if not self.unilateral:
            return stress
        opening_strain = self._tension(e, n) / (self.lmbda + 2 * self.mu)
        return stress - opening_strain * lame_stress(self.lmbda, self.mu, ufl.outer(n, n))

    def energy(self, step: Step) -> Expr:
        e = step.e - step.q["plastic"]
        stored = isotropic_energy(self.lmbda, self.mu, e)
        if self.unilateral:
            stored -= self._tension(e, step.n) ** 2 / (2 * (self.lmbda + 2 * self.mu))
        elastic_energy = isotropic_energy(self.lmbda, self.mu, step.e)
        return (1 - self.elastic_fraction) * stored + self.elastic_fraction * elastic_energy

    def _plastic_increments(self, step: Step) -> tuple[Expr, Expr]:
        """Return the increments of the plastic strain (3, 3) and of the accumulated plastic strain until t + theta dt.

        Both are UFL. The increments are those from the beginning of the step, t. The plastic strain does not change the
        volume.
        """
        n, p = step.n, step.q["accumulated"]
        e = step.mid - step.q["plastic"]  # needs only the traction: compiles 50 times faster than with _trial_stress
        e_N = ufl.dot(n, ufl.dot(e, n))
        t_N, t_T = self.lmbda * ufl.tr(e) + 2 * self.mu * e_N, 2 * self.mu * (ufl.dot(e, n) - e_N * n)
        t_N = ufl.min_value(t_N, 0) if self.unilateral else t_N
        cohesion = self.cohesion + self.hardening * p + self.saturation * p / (self._half_saturation_strain + p)
        bound = cohesion - ufl.tan(ufl.pi / 180 * self.friction_angle) * t_N
        squared_norm = ufl.inner(t_T, t_T)
        is_plastic = ufl.gt(squared_norm, ufl.max_value(bound, 0) ** 2)
        norm = ufl.sqrt(ufl.conditional(is_plastic, squared_norm, 1))
        excess = ufl.conditional(is_plastic, norm - bound, 1)
        dp = ufl.min_value(self._p_increment(p, excess), norm / self.mu)  # beyond the apex no shear traction remains
        dp = ufl.conditional(is_plastic, dp, 0)
        return dp / norm * ufl.sym(ufl.outer(t_T, n)), dp

    @property
    def _half_saturation_strain(self) -> Expr:
        """Saturation strain p_0, at which the cohesion has gained half of its saturation, UFL; 1 without saturation."""
        return ufl.conditional(ufl.gt(self.saturation, 0), self.saturation_strain, 1.0)

    def _p_increment(self, p: Expr, excess: Expr) -> Expr:
        """Return the increment x > 0 of the accumulated plastic strain, UFL, for which excess = mu x + c(p + x) - c(p).

        c is the cohesion as a function of the accumulated plastic strain. x is the root of a quadratic equation.

        Args:
            p: accumulated plastic strain at the beginning of the step.
            excess: shear stress beyond its bound if the plastic strain did not change.
        """
        d, a = self._half_saturation_strain + p, self.mu + self.hardening
        b = a * d + self.saturation * self._half_saturation_strain / d - excess
        root = ufl.sqrt(b * b + 4 * a * excess * d)
        return ufl.conditional(ufl.gt(b, 0), 2 * excess * d / (b + root), (root - b) / (2 * a))

    def stress(self, step: Step) -> Expr:
        stress = self._trial_stress(step) - 2 * self.mu * self._plastic_increments(step)[0]
        return (1 - self.elastic_fraction) * stress + self.elastic_fraction * lame_stress(self.lmbda, self.mu, step.mid)

    def advance(self, step: Step) -> dict[str, Expr]:
        flow, dp = self._plastic_increments(step)
        increments = {"plastic": flow, "accumulated": dp}
        return {name: step.q[name] + change / step.theta for name, change in increments.items()}

    def dissipated(self, step: Step) -> Expr:
        flow, _ = self._plastic_increments(step)
        stress = self._trial_stress(step) - 2 * self.mu * flow
        return (1 - self.elastic_fraction) * ufl.inner(stress, flow) / step.theta


MAX_HARDENING_FRACTION = 1 - 1e-9  # largest fraction of the elastic stiffness after yield, in continuation


@dataclass(frozen=True)
class VonMises(KernelLaw, IsotropicLaw):
    """Isotropic elasticity, and plastic flow along the deviator where the equivalent stress reaches the yield stress.

    The yield condition is sqrt(3/2) |s - 2/3 K e^p| <= Y + H p + Q (1 - exp(-p/p_0)). s is the deviator of the stress.
    e^p is the plastic strain, which has no trace. p is the accumulated plastic strain, dp/dt = sqrt(2/3) |de^p/dt|. The
    right-hand side is the yield stress in uniaxial tension; at first yield in shear |s_12| is Y/sqrt(3). Flow is
    associated, steps are implicit (radial return).

    The work of isotropic hardening is dissipated, the work of kinematic hardening (Prager's) is stored.

    As a layer's law with the jump w: t = (lmbda + 2 mu/3)/eps w_N n + s n. s is the deviator at the strain sym(w (x)
    n)/eps. Without hardening t_T is at most Y/sqrt(3), which is reached under lasting shear. The deviator's part t_N -
    (lmbda + 2 mu/3)/eps w_N of the normal traction is at most 2 Y/3.

    Attributes:
        lmbda, mu: moduli, stress; mu > 0, lmbda + 2 mu/3 > 0.
        strength: Y in the formulas, yield stress in tension, stress; > 0. In a layer it does not scale with the
            thickness.
        hardening: H in the formulas, modulus of linear isotropic hardening, stress; >= 0.
        kinematic: K in the formulas, modulus of linear kinematic hardening, stress; >= 0.
        saturation: Q in the formulas, largest increase of the yield stress in addition to H p, stress; >= 0. In a layer
            it does not scale with the thickness.
        saturation_strain: p_0 in the formulas, strain (in a layer: strain times thickness, a length); > 0 where Q > 0.

    Raises:
        InputError: a parameter out of range.

    Example:
        >>> from forms import VonMises
        >>> from thinlayer import drive
        >>> solder = VonMises(lmbda=30e3, mu=18e3, strength=20.0)
        >>> sheared = drive(solder, [{"w_T": w, "w_N": 0.0} for w in (0.0005, 0.01)])
        >>> print(sheared.tractions[:, 0].round(3))
        [ 9.    11.547]
    """

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
    has_quadratic_energy: ClassVar = True
    bounded: ClassVar = True
    isochoric: ClassVar = True
    source: ClassVar = Path(__file__).with_name("von_mises.c")

    @classmethod
    def young(cls, E: Parameter, nu: Parameter, strength: Parameter, **hardening: Parameter) -> VonMises:
        """Return the law with Young's modulus E > 0 (stress) and Poisson's ratio -1 < nu < 1/2.

        Args:
            E, nu: numbers, or numpy functions of the coordinates (d, n) of n places in the joint that return n values.
            strength: yield stress in tension, stress; > 0.
            hardening: further parameters of the law, by name.
        """
        elastic_law = LinearElastic.young(E, nu)
        return cls(elastic_law.lmbda, elastic_law.mu, strength, **hardening)  # type: ignore[arg-type]

    def check(self) -> None:
        super().check()
        require_positive(self, "strength")
        require_valid_hardening(self, "hardening", "kinematic", "saturation")

    def homotopy(self, parameter: float) -> VonMises:
        """Return a law for continuation, whose kinematic hardening is larger than this law's.

        Args:
            parameter: from 0 (this law) to 1 (an almost elastic law).
        """
        if not parameter:
            return self
        fraction = min(MIN_ELASTIC_FRACTION ** (1 - parameter), MAX_HARDENING_FRACTION)
        return self.with_parameters({"kinematic": self.kinematic + 3 * self.mu * fraction / (1 - fraction)})
