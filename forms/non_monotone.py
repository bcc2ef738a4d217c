"""Laws of non-monotone layers: an elastic material with three phases, which either mix or stay pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar

import numpy as np
import ufl

from forms.base import Array, InputError, is_finite
from forms.elastic import IsotropicLaw, lame_stress
from forms.law import ChangeParameter, Step
from forms.parameter_fields import ParameterValue
from forms.temperature import (
    TemperatureField,
    TemperatureFunction,
    checked_values,
    evaluate_parameter,
    place_and_time_text,
    real_values,
)
from forms.tensors import Expr, layer_frame, three_dimensional
from forms.viscous import isotropic_energy

PHASE_PARAMETERS = ("alpha", "transformation_energy")  # parameters that may depend on the temperature


def lamination_gain(lmbda: float, mu: float, chi: Array) -> float:
    """Return the factor G, 1/stress, of the energy that the best laminate of two phases saves.

    The stresses of the two phases differ by alpha chi. A laminate of them with the unit normal k and the fraction theta
    of one phase is compared with a mixture of uniform strain. Per volume the laminate saves the energy alpha^2 G(k)
    theta (1 - theta)/2. Here G(k) = (chi k).A(k)^-1 (chi k) with the acoustic tensor A(k) = mu I + (lmbda + mu) k (x)
    k. G is the maximum of G(k).

    The best k lies in the plane of the principal directions of chi with the extreme principal values c_min and c_max.
    With s = k.chi k, G(k) is (|chi k|^2 - s^2)/mu + s^2/(lmbda + 2 mu). It is largest at s = (1 - nu)(c_min + c_max),
    or, if this s is outside c_min to c_max, at the nearer of these two.

    Args:
        lmbda, mu: Lame moduli, stress.
        chi: orientation of the transformation, symmetric, (2, 2) or (3, 3). If it is (2, 2), k is in the plane.
    """
    c = np.linalg.eigvalsh(chi)
    c_min, c_max = float(c[0]), float(c[-1])
    s = min(max((lmbda + 2 * mu) / (2 * (lmbda + mu)) * (c_min + c_max), c_min), c_max)
    norm_squared = (c_min + c_max) * s - c_min * c_max  # |chi k|^2
    return (norm_squared - s * s) / mu + s * s / (lmbda + 2 * mu)


@dataclass(frozen=True, eq=False)
class PhaseLaw(IsotropicLaw):
    """Base of the non-monotone laws: an elastic material with three phases z = -1, 0, 1 of equal elastic moduli.

    At the strain e phase z has the energy lmbda tr(e)^2/2 + mu e:e - z alpha chi:e + Psi |z| per volume. Its stress is
    lmbda tr(e) I + 2 mu e - z alpha chi. This is Eq. (39) of the paper, where Psi is called C.

    Attributes:
        lmbda, mu: moduli, stress; mu > 0, lmbda + 2 mu/3 > 0.
        alpha: transformation stress, > 0, which in a layer does not scale with the thickness; or a numpy function of
            the temperature T.
        transformation_energy: Psi in the formulas, energy per volume, > 0; or a numpy function of T. For a layer it is
            given per area: eps times the energy per volume. Section 6.1 of the paper prints the same power of eps for
            alpha and C.
        chi: orientation of the transformation, symmetric, (2, 2) in plane strain and (3, 3) in 3D. Its axes are those
            of the layer, the second one along n (`forms.tensors.layer_frame`): chi_22 acts across S, chi_12 along S.
        T: temperature, if alpha or the transformation energy depends on it, else None. It is a number, or a numpy
            function T(x, t) of the coordinates x (d, n) of n places and the time t. The places are those in the joint
            as drawn, before S is opened to the layer's thickness.

    Raises:
        InputError: a parameter out of range, or a function of the temperature without T.
    """

    alpha: float | TemperatureFunction
    transformation_energy: float | TemperatureFunction
    chi: Array
    T: float | TemperatureField | None = None
    powers: ClassVar[Mapping[str, float]] = {"lmbda": 1, "mu": 1, "transformation_energy": -1}
    functions: ClassVar = ("alpha", "transformation_energy", "T")
    phases: ClassVar = True

    def check(self) -> None:
        self._check_material()
        self._check_temperature()

    def _check_material(self) -> None:
        super().check()
        chi = np.array(self.chi, float)
        self.require(chi.shape in ((2, 2), (3, 3)), "shape of chi", "(2, 2) in plane strain, (3, 3) in 3D", chi.shape)
        self.require(bool(np.isfinite(chi).all()), "chi", "finite numbers", "not finite")
        tolerance = 1e-12 * float(np.abs(chi).max())
        self.require(bool((np.abs(chi - chi.T) <= tolerance).all()), "chi", "a symmetric tensor", chi.tolist())
        self.require(bool(chi.any()), "chi", "a tensor that is not zero", "zero")
        object.__setattr__(self, "chi", (chi + chi.T) / 2)

    def _check_temperature(self) -> None:
        """Raise InputError unless T and the `PHASE_PARAMETERS`, alpha and transformation energy, are allowed.

        If T is a number, the values at this temperature replace parameters that are functions of it.
        """
        callables = [name for name in PHASE_PARAMETERS if callable(getattr(self, name))]
        if callables and self.T is None:
            raise InputError(f"{type(self).__name__}: {callables[0]} needs T; give T, a number or a function (x, t)")
        if self.varies:
            return
        self.require(self.T is None or is_finite(self.T), "T", "a number, a function", repr(self.T))
        for name in callables:
            value = evaluate_parameter(self, name, getattr(self, name), np.array([self.T], float))
            object.__setattr__(self, name, float(value[0]))
        self._check_ranges({name: np.array([getattr(self, name)], float) for name in PHASE_PARAMETERS}, lambda k: "")

    def plane_stress(self) -> PhaseLaw:
        """Return the law for plane stress: the same phases with the modulus lmbda of plane stress.

        This is exact because chi acts in the plane, and all phases have equal moduli.
        """
        self.require(len(self.chi) == 2, "shape of chi", "(2, 2) in plane stress", self.chi.shape)
        return replace(self, lmbda=2 * self.lmbda * self.mu / (self.lmbda + 2 * self.mu))

    def check_dimension(self, d: int) -> None:
        self.require(len(self.chi) == d, "shape of chi", f"({d}, {d}) in a model of dimension {d}", self.chi.shape)

    def _check_ranges(self, parameters: Mapping[str, Array], where: Callable[[int], str]) -> None:
        """Raise InputError unless alpha and the transformation energy are positive and finite at all of n places.

        Args:
            parameters: name in `PHASE_PARAMETERS` -> values (n,) at the places.
            where: function from the index of a place to a text that tells the place, for messages.
        """
        for name, values in parameters.items():
            invalid_indices = np.flatnonzero(~((values > 0) & np.isfinite(values)))
            for k in invalid_indices[np.argsort(values[invalid_indices])][:1]:
                self.require(False, name + where(k), "> 0", f"{values[k]:g}")

    @property
    def varies(self) -> bool:
        return callable(self.T)

    def parameters(self) -> dict[str, ParameterValue]:
        values = super().parameters()
        if self.varies:
            return values | dict.fromkeys(self.functions, math.nan)
        return values | {"T": 0.0} if self.T is None else values

    def at(self, x: Array, t: float) -> dict[str, Array]:
        if not callable(self.T):
            return {}
        wanted = "T(x, t) must be a numpy function of places (d, n) and a time that gives n temperatures"
        where = partial(place_and_time_text, x, t)
        T = checked_values(f"{type(self).__name__}: T", self.T, x, t, wanted=wanted, where=where)
        values = {name: evaluate_parameter(self, name, getattr(self, name), T) for name in PHASE_PARAMETERS}
        self._check_ranges(values, where)
        return values | {"T": T}

    def mapped(self, change: ChangeParameter) -> PhaseLaw:
        law = super().mapped(change)
        if not self.varies:
            return law.with_parameters({"T": None})
        new_values = {name: self._changed_parameter(name, change) for name in PHASE_PARAMETERS}
        return law.with_parameters(new_values | {"T": self.T})

    def _changed_parameter(self, name: str, change: ChangeParameter) -> ParameterValue | Callable[[Array], Expr]:
        parameter, power = getattr(self, name), self.powers.get(name, 0)
        return (lambda T: change(real_values(parameter(T)), power)) if callable(parameter) else change(parameter, power)

    # ---------------------------------------------------------------- quantities of a step, UFL
    def _driving_force(self, e: Expr, n: Expr) -> Expr:
        """Return the driving force alpha chi:e of phase 1, energy per volume, UFL.

        `e` is the strain (3, 3), `n` the unit normal of the layer.
        """
        return ufl.inner(self._transformation_stress(n), e)

    def _transformation_stress(self, n: Expr) -> Expr:
        """Return the tensor alpha chi (3, 3), stress, UFL, in the joint's axes, for a layer with the normal `n`."""
        rotation = layer_frame(n)
        return self.alpha * rotation * three_dimensional(ufl.as_tensor(self.chi)) * rotation.T

    def remainder(self, step: Step) -> Expr:
        """Return the work of the stress in a step minus the increase of the stored energy, UFL, per unit volume.

        It is the error of the time scheme, plus the energy that changes of temperature or phase release.
        """
        return ufl.inner(self.stress(step), step.e - step.e_old) - (self.advance(step)["stored"] - step.q["stored"])


@dataclass(frozen=True, eq=False)
class NonMonotone(PhaseLaw):
    """The relaxed non-monotone law: phases mix in fine laminates that minimise the energy.

    Let m = alpha chi:e be the driving force, and Psi the transformation energy. The material is a mixture of phase 0
    and phase sign(m). The latter has the fraction theta = clip(1/2 + (|m| - Psi)/g, 0, 1), and

        stress = lmbda tr(e) I + 2 mu e - sign(m) theta alpha chi,   g = alpha^2 G.

    G (`lamination_gain`) belongs to the energy saved by laminates with the best normal. This normal is n for chi =
    sym(a (x) n) with a vector a tangent to S. For chi = n (x) n it is n if lmbda = 0, but not if lmbda > 0.

    As a layer's law with the jump w: t = K w - sign(m) theta alpha chi n. Here m = alpha chi:E with the strain E =
    sym(w (x) n)/eps. K has the stiffnesses (lmbda + 2 mu)/eps along n and mu/eps along S. This replaces Eqs. (41)-(43)
    of the paper, which print lmbda + mu for lmbda + 2 mu, [u_1] for [u_2], and one branch only.

    The stress is continuous. For mixing = 1 the energy is convex along every strain sym(a (x) k). The traction is then
    monotone in w, and nothing snaps. Along other strains the energy need not be convex, for example with chi = I. Where
    phases mix the tangent may be singular (chi = n (x) n, lmbda = 0); the stiffness of the bodies remains.

    The moduli lmbda and mu, alpha, transformation_energy (Psi), chi and T are described in the base class `PhaseLaw`.

    Attributes:
        mixing: factor on the energy that laminates save, > 0 and <= 1: g = mixing alpha^2 G. If it is below 1, the
            stress falls as the phases change, more steeply for smaller values. The law then acts on S only. Its
            equilibria are followed by steps of arc length (`thinlayer.ArcLength`).
        G: value of `lamination_gain`, 1/stress; computed from the other parameters.

    Raises:
        InputError: a parameter out of range, a function of the temperature without T, or Psi < g/2, where phases 1 and
            -1 would mix.
    """

    mixing: float = 1.0
    G: float = field(init=False, repr=False, default=0.0)
    powers: ClassVar = {"lmbda": 1, "mu": 1, "transformation_energy": -1, "G": -1}
    internal: ClassVar = {"phase": (), "stored": ()}
    singular: ClassVar = True

    def check(self) -> None:
        self.require(0 < self.mixing <= 1, "mixing", "0 < mixing <= 1")
        self._check_material()
        object.__setattr__(self, "G", lamination_gain(self.lmbda, self.mu, self.chi))
        self._check_temperature()

    def _check_ranges(self, parameters: Mapping[str, Array], where: Callable[[int], str]) -> None:
        super()._check_ranges(parameters, where)
        psi, psi_min = parameters["transformation_energy"], self.mixing * self.G * np.square(parameters["alpha"]) / 2
        for k in np.flatnonzero(~(psi >= psi_min * (1 - 1e-12)))[:1]:
            allowed = f">= mixing alpha^2 G/2 = {psi_min[k]:g}: phases 1 and -1 would mix"
            self.require(False, f"transformation_energy{where(k)}", allowed, f"{psi[k]:g}")

    @property
    def softens(self) -> bool:
        return bool(self.mixing < 1)

    @property
    def plateau(self) -> bool:
        chi_n, chi_nn = np.asarray(self.chi)[:, 1], np.asarray(self.chi)[1, 1]
        gain_along_n = (chi_n @ chi_n - chi_nn**2) / self.mu + chi_nn**2 / (self.lmbda + 2 * self.mu)
        return bool(gain_along_n > self.mixing * self.G * (1 - 1e-9))

    @property
    def _mixing_gain(self) -> Expr:
        """Factor g = mixing alpha^2 G, energy per volume: mixing phases in equal parts saves g/8."""
        return self.mixing * self.G * self.alpha * self.alpha  # type: ignore[operator]

    def _phase_fraction(self, m: Expr) -> Expr:
        """Return the fraction, from 0 to 1, of phase 1 (driving force `m` >= 0) or of phase -1 (`m` < 0), UFL."""
        return ufl.min_value(ufl.max_value((abs(m) - self.transformation_energy) / self._mixing_gain + 0.5, 0.0), 1.0)

    def _signed_fraction(self, m: Expr) -> Expr:
        return ufl.conditional(ufl.lt(m, 0), -1.0, 1.0) * self._phase_fraction(m)

    def stress(self, step: Step) -> Expr:
        signed_fraction = self._signed_fraction(self._driving_force(step.mid, step.n))
        return lame_stress(self.lmbda, self.mu, step.mid) - signed_fraction * self._transformation_stress(step.n)

    def advance(self, step: Step) -> dict[str, Expr]:
        return {"phase": self._signed_fraction(self._driving_force(step.e, step.n)), "stored": self.energy(step)}

    def energy(self, step: Step) -> Expr:
        m = self._driving_force(step.e, step.n)
        theta, g = self._phase_fraction(m), self._mixing_gain
        phase_gain = theta * (abs(m) - self.transformation_energy) + theta * (1 - theta) * g / 2
        return isotropic_energy(self.lmbda, self.mu, step.e) - phase_gain


@dataclass(frozen=True, eq=False)
class NonMonotoneUnrelaxed(PhaseLaw):
    """The non-monotone law with pure phases: stress = lmbda tr(e) I + 2 mu e - z alpha chi, z = -1, 0 or 1.

    The phase z is an internal variable. Each facet of S has one phase. In the meshed layer each column of cells over a
    facet has one phase. (If the cells of a column switched one by one, they would unload each other, which cannot
    happen on S.)

    A phase stays while no other phase has a lower energy: Eq. (39) of the paper. Let m be the mean of the driving force
    alpha chi:e over the column, and Psi the transformation energy. Phase 0 stays while |m| <= Psi, phase 1 while m >=
    Psi, and phase -1 while m <= -Psi. As a layer's law with the jump w: t = K w - z alpha chi n.

    Equilibria are local minima of the energy. Alternate minimisation, which starts from the last equilibrium, selects
    one of them. First all columns switch to their phase of lowest energy, then the equilibrium with these phases is
    computed. Both steps are repeated until no phase changes, and the energy falls each time. `march` stops where the
    first column switches, so that the result does not depend on its steps.

    The moduli lmbda and mu, alpha, transformation_energy (Psi), chi and T are described in the base class `PhaseLaw`.
    """

    linear: ClassVar = True
    internal: ClassVar = {"phase": (), "stored": (), "drive": (), "bound": ()}
    switches: ClassVar = True

    def stress(self, step: Step) -> Expr:
        return lame_stress(self.lmbda, self.mu, step.mid) - step.q["phase"] * self._transformation_stress(step.n)

    def advance(self, step: Step) -> dict[str, Expr]:
        drive, bound = self._driving_force(step.e, step.n), ufl.as_ufl(self.transformation_energy)
        return {"phase": step.q["phase"], "stored": self.energy(step), "drive": drive, "bound": bound}

    def energy(self, step: Step) -> Expr:
        z = step.q["phase"]
        phase_energy = abs(z) * self.transformation_energy - z * self._driving_force(step.e, step.n)
        return isotropic_energy(self.lmbda, self.mu, step.e) + phase_energy

    def excess(self, phase: Array, drive: Array, bound: Array) -> Array:
        """Return the energy (n,) by which the phase of each column exceeds another phase, divided by Psi.

        Where it is > 0 the column switches. Phases 1 and -1 are compared with 0, and phase 0 with the one that the
        driving force favours.

        Args:
            phase: phases -1, 0 or 1 of the n columns, (n,).
            drive: means (n,) of the driving force alpha chi:e over the columns, energy per volume.
            bound: means (n,) of the transformation energy Psi over the columns, energy per volume.
        """
        return np.where(phase == 0, abs(drive) / bound - 1, 1 - phase * drive / bound)

    def switched(self, phase: Array, drive: Array, bound: Array) -> Array:
        """Return the phases (n,) after columns with a positive `excess` have switched to their phase of lowest energy.

        Args:
            phase: phases -1, 0 or 1 of the n columns before the switch, (n,).
            drive: means (n,) of the driving force alpha chi:e over the columns, energy per volume.
            bound: means (n,) of the transformation energy Psi over the columns, energy per volume.
        """
        best_phase = np.where(drive > bound, 1.0, np.where(drive < -bound, -1.0, 0.0))
        return np.where(self.excess(phase, drive, bound) > 0, best_phase, phase)
