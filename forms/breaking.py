"""Laws of joints that break: damage of a layer's material, and cohesive laws of jumps, in opening, shear and both.

Both kinds have one scalar damage d, from 0 (sound) to 1 (broken). It grows with the energies that the opening (mode I)
and the shear (mode II) would store without damage. It never decreases, and is the only memory.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import numpy.typing as npt
import ufl

from forms.base import Array, InputError, is_finite, is_number, require
from forms.elastic import IsotropicLaw, LinearElastic
from forms.law import Law, Step, choice, require_positive
from forms.law_tangents import evaluate
from forms.layer_results import ELASTIC, LayerPoints, LayerResults
from forms.parameter_fields import Parameter, as_parameter_field
from forms.tensors import Expr
from forms.traction import JumpStep, TractionLaw

BREAKING, BROKEN = "breaking", "broken"
BROKEN_DAMAGE = 0.999  # damage beyond which a point counts as broken
MIN_BRITTLENESS = 1e-9  # k - 1 of a law that breaks at once where its toughness does not suffice for any softening
SAMPLED_SOFTENING = np.geomspace(1e-3, 1e2, 61)  # (x - 1)/(k - 1) at which softening curves are checked
CURVE_TOLERANCE = 1e-6  # error of damages, stresses and energies, relative to their largest values, in these checks
SAMPLED_MIXITIES = np.linspace(0.0, 1.0, 101)  # mode mixities at which the toughness is checked
MIN_MIXITY = 1e-12  # share of a mode below which the toughness is linear, as the slope of powers at 0 may be infinite
MIN_STRESS_LEFT = 1e-290  # 1 - d of a broken point, of which a logarithm is taken


@dataclass(frozen=True)
class SofteningCurve:
    """Stress over strength as a function of x, the jump over the jump at the strength, for x >= 1.

    A new curve defines the two methods, in UFL. The mode mixity does not change along it.

    Attributes:
        k: toughness over the elastic energy at the strength, > 1. The area below stress over strength is k/2.
    """

    k: Expr

    def damage(self, x: Expr) -> Expr:
        """Return the damage at x >= 1: 1 minus the stress over that of the sound material."""
        raise InputError(f"{type(self).__name__} has no damage; a softening curve needs a method damage(x)")

    def energy(self, d: Expr) -> Expr:
        """Return the energy dissipated up to the damage `d`, over the elastic energy at the strength; k at d = 1.

        It is the integral over the damage of x^2, where x is the jump ratio at which the damage is d.
        """
        raise InputError(f"{type(self).__name__} has no energy; a softening curve needs a method energy(d)")

    def check(self) -> None:
        """Raise InputError unless the stress falls from the strength, and the energy is that below its curve.

        `k` must be a number. Both methods are evaluated at many x. Between two, the energy must grow by the growth of the
        damage times a number from x^2 at the first to x^2 at the second.
        """
        x = 1 + (self.k - 1) * np.append(0.0, SAMPLED_SOFTENING)
        d = np.array([float(evaluate(ufl.as_ufl(self.damage(value)))) for value in x])
        energy = np.array([float(evaluate(ufl.as_ufl(self.energy(value)))) for value in d])
        stress, growth, gain, rounding = (1 - d) * x, np.diff(d), np.diff(energy), CURVE_TOLERANCE * self.k
        is_integral = (x[:-1] ** 2 * growth - rounding <= gain) & (gain <= x[1:] ** 2 * growth + rounding)
        for name, values, is_bad, allowed in (
            ("damage", d, (x == 1) & ~(abs(d) <= CURVE_TOLERANCE), "0, as the stress is the strength there"),
            ("damage", d, np.append(0, growth) < -CURVE_TOLERANCE, "no less than before"),
            ("damage", d, ~(d <= 1 + CURVE_TOLERANCE), "at most 1"),
            ("stress over strength", stress, stress > 1 + CURVE_TOLERANCE, "at most 1"),
            ("energy", energy, (x == 1) & ~(abs(energy) <= rounding), "0, as nothing is dissipated before"),
            ("energy", energy, np.append(False, ~is_integral), "the integral of x^2 over the damage"),
        ):
            for i in np.flatnonzero(is_bad)[:1]:
                place = f"at x = {x[i]:.6g}, where the damage is {d[i]:.6g} and k is {self.k:.4g}"
                raise InputError(f"{type(self).__name__}: {name} is {values[i]:.6g} {place}; allowed: {allowed}")


@cache
def _check_curve(curve: SofteningCurve) -> None:
    """Check a curve once, as laws whose parameters vary ask for it at many places."""
    curve.check()


class LinearSoftening(SofteningCurve):
    """The stress falls linearly to zero, at x = k."""

    def damage(self, x: Expr) -> Expr:
        return ufl.min_value(self.k * (x - 1) / (x * (self.k - 1)), 1.0)

    def energy(self, d: Expr) -> Expr:
        return self.k * d / (self.k - d * (self.k - 1))


class ExponentialSoftening(SofteningCurve):
    """The stress falls as exp(-2 (x - 1)/(k - 1)), never quite to zero."""

    def damage(self, x: Expr) -> Expr:
        return 1 - ufl.exp(-2 * (x - 1) / (self.k - 1)) / x

    def energy(self, d: Expr) -> Expr:
        """Return the energy dissipated up to the damage `d`, over the elastic energy at the strength.

        With c = 2/(k - 1), w = c x is Lambert's function of c exp(c)/(1 - d). An approximation like Winitzki's (2003) and
        two steps of Newton's method for w + ln w give it with a relative error of 1e-9.
        """
        c, stress_left = 2 / (self.k - 1), ufl.max_value(1 - d, MIN_STRESS_LEFT)
        log = ufl.ln(c / stress_left) + c
        size = ufl.max_value(log, 0.0) + ufl.ln(1 + ufl.exp(-abs(log)))  # ln(1 + exp(log)) without overflow
        w = size * (1 - ufl.ln(1 + size) / (2.1 + size))
        for _ in range(2):
            w *= (1 + log - ufl.ln(w)) / (1 + w)
        return 1 + 2 / c - stress_left * w * (2 + w) / c**2


@dataclass(frozen=True)
class BilinearSoftening(SofteningCurve):
    """The stress falls along two straight lines that meet at a knee.

    Attributes:
        knee_jump: (x - 1)/(k - 1) at the knee, less than 1/(1 + knee_stress).
        knee_stress: stress at the knee over the strength.
    """

    knee_jump: Expr
    knee_stress: Expr

    @property
    def _knee(self) -> Expr:
        return 1 + self.knee_jump * (self.k - 1)

    def _lines(self) -> tuple[tuple[Expr, Expr], tuple[Expr, Expr]]:
        """Return value at x = 0 and fall per x of both lines, stresses over the strength."""
        end = 1 + (self.k - self._knee) / self.knee_stress
        falls = (1 - self.knee_stress) / (self._knee - 1), self.knee_stress / (end - self._knee)
        return (1 + falls[0], falls[0]), (end * falls[1], falls[1])

    def damage(self, x: Expr) -> Expr:
        first, second = (1 + fall - start / x for start, fall in self._lines())
        return ufl.min_value(ufl.conditional(ufl.lt(x, self._knee), first, second), 1.0)

    def energy(self, d: Expr) -> Expr:
        (start, fall), (start_2, fall_2) = self._lines()
        x, x_2 = start / (1 + fall - d), start_2 / (1 + fall_2 - d)  # on each of both lines
        at_knee = start * (self._knee - 1)
        return ufl.conditional(ufl.lt(x, self._knee), start * (x - 1), at_knee + start_2 * (x_2 - self._knee))


class ModeMix(NamedTuple):
    """Damage criterion at a jump or strain, for the mixity B = Y_II/(Y_I + Y_II) of the energies of both modes there.

    Attributes:
        x: jump over the jump at the strength; damage begins at 1.
        onset: energy at which damage begins.
        curve: softening curve.
    """

    x: Expr
    onset: Expr
    curve: SofteningCurve


class DamageResults(LayerResults):
    """What results show of a law whose internal variable "d" is a damage from 0 (sound) to 1 (broken)."""

    @property
    def statuses(self) -> tuple[str, ...]:
        return ELASTIC, BREAKING, BROKEN

    def status_at(self, points: LayerPoints) -> npt.NDArray[np.str_]:
        """Return "broken", "breaking" or "elastic" for each of several points, by their damage."""
        d = points.internal["d"]
        return np.select([d > BROKEN_DAMAGE, d > 0], [BROKEN, BREAKING], ELASTIC)

    @property
    def share_columns(self) -> tuple[str, ...]:
        return BROKEN, BREAKING

    def shares(self, internal: Mapping[str, Array]) -> dict[str, Array]:
        is_broken = internal["d"] > BROKEN_DAMAGE
        return {BROKEN: is_broken.astype(float), BREAKING: ((internal["d"] > 0) & ~is_broken).astype(float)}


@dataclass(frozen=True)
class MixedModeDamage(DamageResults, Law):
    """Base of laws with one damage d for opening (mode I) and shear (mode II), of strains or of jumps.

    Subclasses define `stiffnesses` and `opening_and_slip`. From these follow the traction

        t = (1 - d) (K_N <w_N>+ n + K_T w_T) - K_N <-w_N>+ n,

    the energies Y_I = K_N <w_N>+^2/2 and Y_II = K_T |w_T|^2/2 that damage releases, and x = sqrt(Y_I/Y_I0 + Y_II/Y_II0)
    with Y_I0 = t_N^2/(2 K_N) and Y_II0 = t_T^2/(2 K_T). Damage begins at x = 1. With the mixity B = Y_II/(Y_I + Y_II) it
    follows the softening curve for the toughness G(B):

    - criterion "BK" (Benzeggagh and Kenane): G_I + (G_II - G_I) B^eta;
    - criterion "power": [((1 - B)/G_I)^eta + (B/G_II)^eta]^(-1/eta).

    Attributes:
        t_N, t_T: strengths in opening and in shear.
        G_I, G_II: toughness in opening and in shear, more than the elastic energy at the strength for all mixities.
        eta: exponent of the criterion.
        cracked: damage at the start, from 0 (sound) to 1 (broken: a precrack, or a kissing bond); a number or a function
            of places.
        knee_jump, knee_stress: knee of the bilinear curve, see `BilinearSoftening`.
        softening: "linear", "exponential" or "bilinear".
        criterion: "BK" or "power".
        closure: "unilateral": sides that touch are stiff. "bilateral": sides slide, and neither part nor close; opening
            causes no damage.
    """

    t_N: float
    t_T: float
    G_I: float
    G_II: float
    eta: float = 1.0
    cracked: float = 0.0
    knee_jump: float = 0.4  # of concrete, Petersson (1981), as knee_stress
    knee_stress: float = 1 / 3
    softening: str = choice("linear")
    criterion: str = choice("BK")
    closure: str = choice("unilateral")
    internal: ClassVar = {"d": ()}
    softens: ClassVar = True
    symmetric: ClassVar = False

    # ---------------------------------------------------------------- what subclasses define
    def stiffnesses(self) -> tuple[Expr, Expr]:
        """Return K_N and K_T of the sound joint: tractions per opening and per slip."""
        raise NotImplementedError

    def opening_and_slip(self, deformation: Expr, n: Expr) -> tuple[Expr, Expr]:
        """Return w_N and w_T, UFL, of a jump (3,) or a strain (3, 3); K_N w_N and K_T w_T are tractions.

        Args:
            deformation: the jump, or the strain.
            n: unit normal (3,).
        """
        raise NotImplementedError

    def softening_curve(self, k: Expr) -> SofteningCurve:
        """Return the softening curve for a ratio `k` of toughness and elastic energy at the strength."""
        if self.softening == "bilinear":
            return BilinearSoftening(k, self.knee_jump, self.knee_stress)
        return ExponentialSoftening(k) if self.softening == "exponential" else LinearSoftening(k)

    def toughness(self, B: Any) -> Any:
        """Return the toughness at a mixity B, from 0 (mode I) to 1 (mode II); numbers, arrays or UFL."""
        if self.criterion == "power":
            return (((1 - B) / self.G_I) ** self.eta + (B / self.G_II) ** self.eta) ** (-1 / self.eta)
        return self.G_I + (self.G_II - self.G_I) * B**self.eta

    def _toughness_near_pure_modes(self, B: Expr) -> Expr:
        """Return the toughness at a mixity B, UFL, linear where its slope may be infinite: next to B = 0 and B = 1."""
        pure = ufl.conditional(ufl.lt(B, 0.5), self.G_I, self.G_II)
        share = ufl.min_value(ufl.min_value(B, 1 - B) / MIN_MIXITY, 1.0)
        return pure + share * (self.toughness(ufl.min_value(ufl.max_value(B, MIN_MIXITY), 1 - MIN_MIXITY)) - pure)

    # ---------------------------------------------------------------- parameters
    def check(self) -> None:
        super().check()
        require_positive(self, "t_N", "t_T", "G_I", "G_II", "eta")
        self.require(0 <= self.cracked <= 1, "cracked", "from 0 (sound) to 1 (broken)")
        self.require(0 < self.knee_stress < 1, "knee_stress", "> 0, < 1")
        max_jump = 1 / (1 + self.knee_stress)
        self.require(0 < self.knee_jump < max_jump, "knee_jump", f"> 0, < 1/(1 + knee_stress) = {max_jump:g}")
        choices = {"softening": ("linear", "exponential", "bilinear"), "criterion": ("BK", "power"),
            "closure": ("unilateral", "bilateral")}  # fmt: skip
        for name, allowed in choices.items():
            self.require(getattr(self, name) in allowed, name, " or ".join(map(repr, allowed)))
        B = SAMPLED_MIXITIES if self.closure == "unilateral" else np.ones(1)
        k = self.toughness(B) * ((1 - B) / self._onset_energies[0] + B / self._onset_energies[1])
        worst = int(np.argmin(k))
        needs = f"the elastic energy at the strength: it is {k[worst]:.3g} times that at the mode mixity {B[worst]:g}"
        self.require(k[worst] > 1, "toughness", f"more than {needs}", f"({self.G_I:.4g}, {self.G_II:.4g})")
        if type(self).softening_curve is not MixedModeDamage.softening_curve:
            for extreme in (k.min(), k.max()):  # rounded, as a curve is checked once
                curve = self.softening_curve(1 + 2.0 ** round(math.log2(extreme - 1)))
                self.require(isinstance(curve, SofteningCurve), "softening_curve", "a SofteningCurve", curve)
                _check_curve(curve)

    @property
    def _onset_energies(self) -> tuple[Expr, Expr]:
        """Elastic energies at the strength in opening and in shear."""
        K_N, K_T = self.stiffnesses()
        return self.t_N**2 / (2 * K_N), self.t_T**2 / (2 * K_T)

    # ---------------------------------------------------------------- damage
    has_modes = True

    def mode_energies(self, step: Step) -> tuple[Expr, Expr]:
        return self._released(step.e, step.n)

    def _released(self, deformation: Expr, n: Expr) -> tuple[Expr, Expr]:
        """Return the energies Y_I and Y_II that damage releases."""
        (K_N, K_T), (w_N, w_T) = self.stiffnesses(), self.opening_and_slip(deformation, n)
        return K_N * self._parting(w_N) ** 2 / 2, K_T * ufl.inner(w_T, w_T) / 2

    def _parting(self, w_N: Expr) -> Expr:
        """Return the part of the opening that damage releases, with the slope 1 at w_N = 0, as where sides part."""
        return ufl.conditional(ufl.ge(w_N, 0), w_N, 0.0) if self.closure == "unilateral" else ufl.as_ufl(0.0)

    def _mode_mix(self, deformation: Expr, n: Expr) -> ModeMix:
        """Return the damage criterion, UFL. Where toughness does not suffice for any softening, k is nearly 1."""
        (Y_I, Y_II), (Y_I0, Y_II0) = self._released(deformation, n), self._onset_energies
        least = Y_I0 * Y_II0 / (Y_I0 + Y_II0)  # below it there is no damage, and the mixity does not count
        B = Y_II / ufl.max_value(Y_I + Y_II, least)
        onset = 1 / ((1 - B) / Y_I0 + B / Y_II0)
        k = ufl.max_value(self._toughness_near_pure_modes(B) / onset, 1 + MIN_BRITTLENESS)
        x = ufl.sqrt(ufl.max_value(Y_I / Y_I0 + Y_II / Y_II0, 1.0))
        return ModeMix(x, onset, self.softening_curve(k))

    def _old_damage(self, step: Step) -> Expr:
        return ufl.max_value(step.q["d"], self.cracked)

    def _new_damage(self, step: Step) -> Expr:
        mix = self._mode_mix(step.e, step.n)
        return ufl.max_value(self._old_damage(step), mix.curve.damage(mix.x))

    def dissipated(self, step: Step) -> Expr:
        """Return the energy that breaking costs in the step, UFL; exact for steps of any length at one mode mixity.

        It is the mean of the energies to grow from the old to the new damage at the mixities of the end and of the
        beginning of the step; at the end alone if the beginning is below the strength, where a mixity is meaningless.
        The result is never negative.
        """
        n, old, new = step.n, self._old_damage(step), self._new_damage(step)
        mixes = self._mode_mix(step.e, n), self._mode_mix(step.e_old, n)
        end, start = (mix.onset * (mix.curve.energy(new) - mix.curve.energy(old)) for mix in mixes)
        return self._mean_of_growth(step, end, start)

    def _mean_of_growth(self, step: Step, end: Expr, start: Expr) -> Expr:
        """Return the mean of values at the end and at the start of a step; that at the end if the start is sound."""
        is_growing = ufl.gt(self._mode_mix(step.e_old, step.n).x, 1)
        return (end + ufl.conditional(is_growing, start, end)) / 2

    # ---------------------------------------------------------------- traction and energy
    def _damaged_traction(self, step: Step) -> tuple[Expr, Expr]:
        """Return the normal component and the tangential vector (3,) of the traction."""
        (K_N, K_T), d = self.stiffnesses(), self._new_damage(step)
        w_N, w_T = self.opening_and_slip(step.e, step.n)
        return K_N * (w_N - d * self._parting(w_N)), (1 - d) * K_T * w_T

    def _damaged_energy(self, step: Step) -> Expr:
        (K_N, _), n, d = self.stiffnesses(), step.n, step.q["d"]
        w_N, _ = self.opening_and_slip(step.e, n)
        Y_I, Y_II = self._released(step.e, n)
        return K_N * w_N**2 / 2 - d * Y_I + (1 - d) * Y_II


class CracksAlongS(IsotropicLaw):
    """Base of laws of an isotropic material with cracks parallel to S; subclasses define the traction across S."""

    def opening_and_slip(self, deformation: Expr, n: Expr) -> tuple[Expr, Expr]:
        """Return the opening, with which the stress across S of the sound material is M times as large, and the shear."""
        across = ufl.dot(deformation, n)
        e_N = ufl.dot(across, n)
        return e_N + self._ratio * (ufl.tr(deformation) - e_N), 2 * (across - e_N * n)

    @property
    def _ratio(self) -> Expr:
        """Ratio lmbda/(lmbda + 2 mu)."""
        return self.lmbda / (self.lmbda + 2 * self.mu)

    def _along(self, step: Step) -> tuple[Expr, Expr, Expr]:
        """Return n (3,), the projector P on S, and the stress P (C:e) P of the strain e_S along S with no stress across."""
        n = step.n
        P = ufl.Identity(3) - ufl.outer(n, n)
        e_S = ufl.dot(P, ufl.dot(step.e, P))
        return n, P, 2 * self.mu * (e_S + self._ratio * ufl.tr(e_S) * P)

    def _damaged_traction(self, step: Step) -> tuple[Expr, Expr]:
        """Return the normal component and the tangential vector (3,) of the traction at t + theta dt."""
        raise NotImplementedError

    def stress(self, step: Step) -> Expr:
        (n, P, along), (t_N, t_T) = self._along(step), self._damaged_traction(step)
        return t_N * (ufl.outer(n, n) + self._ratio * P) + ufl.outer(t_T, n) + ufl.outer(n, t_T) + along


@dataclass(frozen=True)
class Breaking(MixedModeDamage, CracksAlongS):
    """Damage of an isotropic material by cracks parallel to S, which no longer bear opening and shear, but closing.

    With the strain e, the stress a = n.(C:e)n across S, the shear g = 2 P e n with P = I - n (x) n, the strain along S
    e_S = P e P, and M = lmbda + 2 mu, the energy per volume is

        (1 - d) (<a>+^2/2M + mu |g|^2/2) + <-a>+^2/2M + mu (e_S:e_S + lmbda/M (tr e_S)^2).

    As a layer's law with the jump w: t_N = (1 - d) K_N w_N in opening, K_N w_N in closing, and t_T = (1 - d) K_T w_T, with
    K_N = M/eps and K_T = mu/eps. Toughnesses are energies per volume: per area, divided by the thickness of the layer.

    Attributes:
        lmbda, mu: Lame moduli of the sound material, stresses; lmbda > -2 mu/3, mu > 0.
        bond_line: thickness for which the energies per volume hold, for a warning in a layer of another one; a number,
            or a function of places; 0: not known.
        t_N, t_T, G_I, G_II, eta, cracked, knee_jump, knee_stress, softening, criterion, closure: see `MixedModeDamage`.

    Raises:
        InputError: a parameter out of range, such as a toughness below the elastic energy at the strength.

    Example:
        >>> from forms import Breaking
        >>> from thinlayer import drive
        >>> data = {"strength": (40, 30), "toughness": (0.4, 1.6), "eta": 2}
        >>> glue = Breaking.glue(E=2e3, nu=0.4, **data, bond_line=0.2)
        >>> history = drive(glue, [{"w_T": 0.0, "w_N": 0.5}])
        >>> print((0.2 * history.energies[:, 1]).round(6))
        [0.4]
    """

    bond_line: float = 0.0
    powers: ClassVar[Mapping[str, float]] = {"lmbda": 1, "mu": 1, "G_I": -1, "G_II": -1, "bond_line": 1}

    @classmethod
    def glue(
        cls, E: Parameter, nu: Parameter, strength: tuple[Parameter, Parameter], toughness: tuple[Parameter, Parameter],
        eta: Parameter = 1.0, *, bond_line: Parameter, **others: Any,
    ) -> Self:  # fmt: skip
        """Return the law of an adhesive as data sheets describe it.

        Args:
            E, nu: Young's modulus and Poisson's ratio.
            strength: strengths in opening and in shear, stresses.
            toughness: toughness in modes I and II, energies per area, measured at this bond line.
            eta: exponent of the criterion.
            bond_line: thickness of the layer in the tests that gave the toughness; in a layer of variable thickness, if
                the toughness per area does not depend on it, that thickness as a function of places.
            others: further parameters by name, such as `cracked`.
        """
        what, thickness = "Breaking.glue:", as_parameter_field(bond_line)
        is_thickness = callable(thickness) or (is_finite(thickness) and thickness > 0)
        require(is_thickness, f"{what} bond_line", bond_line, "allowed: > 0, the thickness of the layer in tests")
        for name, pair in {"strength": strength, "toughness": toughness}.items():
            is_pair = (
                isinstance(pair, Sequence | np.ndarray)
                and len(pair) == 2
                and all(callable(x) or is_number(x) for x in pair)
            )
            require(is_pair, f"{what} {name}", pair, "allowed: two values, in opening and in shear")
        sound, (t_N, t_T) = LinearElastic.young(E, nu), strength
        G_I, G_II = (as_parameter_field(G) / thickness for G in toughness)
        return cls(sound.lmbda, sound.mu, t_N, t_T, G_I, G_II, eta, bond_line=thickness, **others)  # type: ignore[arg-type]

    opening_and_slip = CracksAlongS.opening_and_slip

    def stiffnesses(self) -> tuple[Expr, Expr]:
        return self.lmbda + 2 * self.mu, self.mu

    def advance(self, step: Step) -> dict[str, Expr]:
        return {"d": self._new_damage(step)}

    def energy(self, step: Step) -> Expr:
        return self._damaged_energy(step) + ufl.inner(self._along(step)[2], step.e) / 2

    def plane_stress(self) -> Self:
        """Return the law whose sound material is in plane stress; strengths and toughnesses stay.

        Raises:
            InputError: a toughness is below the elastic energy at the strength, which is larger than in plane strain.
        """
        law = self.with_parameters({"lmbda": 2 * self.mu * self._ratio})
        if not law.fields:
            law.check()
        return law


@dataclass(frozen=True)
class ElasticJumpLaw(TractionLaw):
    """Base of traction laws with two stiffnesses.

    Attributes:
        K_N, K_T: stiffnesses in opening and in shear, stress per length.
    """

    K_N: float
    K_T: float

    def check(self) -> None:
        require_positive(self, "K_N", "K_T")


@dataclass(frozen=True)
class Cohesive(MixedModeDamage, ElasticJumpLaw):
    """Cohesive law of jumps, t = (1 - d) (K_N <w_N>+ n + K_T w_T) - K_N <-w_N>+ n, with free stiffnesses K_N and K_T.

    Attributes:
        K_N, K_T: stiffnesses of the sound joint in opening and in shear, stress per length.
        t_N, t_T, eta, cracked, knee_jump, knee_stress, softening, criterion, closure: see `MixedModeDamage`.
        G_I, G_II: toughness in opening and in shear, energies per area.

    Raises:
        InputError: a parameter out of range, such as a toughness below the elastic energy at the strength.

    Example:
        >>> from forms import Cohesive
        >>> from thinlayer import drive
        >>> joint = Cohesive(K_N=1e4, K_T=6e3, t_N=20.0, t_T=30.0, G_I=0.3, G_II=0.9, eta=2)
        >>> history = drive(joint, [{"w_T": 0.0, "w_N": 0.05}])
        >>> print(history.energies[:, 1].round(6))
        [0.3]
    """

    takes_fields: ClassVar = True

    def stiffnesses(self) -> tuple[Expr, Expr]:
        return self.K_N, self.K_T

    def opening_and_slip(self, deformation: Expr, n: Expr) -> tuple[Expr, Expr]:
        w_N = ufl.dot(deformation, n)
        return w_N, deformation - w_N * n

    def traction(self, step: JumpStep) -> Expr:
        t_N, t_T = self._damaged_traction(step)
        return t_N * step.n + t_T

    def evolve(self, step: JumpStep) -> dict[str, Expr]:
        return {"d": self._new_damage(step)}

    def energy(self, step: JumpStep) -> Expr:
        return self._damaged_energy(step)
