"""Linear elastic laws: isotropic and anisotropic."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
import ufl
from scipy.spatial.transform import Rotation

from forms.base import Array, InputError, is_finite, require
from forms.ends.constants import free_end
from forms.ends.weights import EndStrips, EndWeights
from forms.law import BulkLaw, Step, choice, require_positive
from forms.parameter_fields import (
    Parameter,
    ParameterField,
    ParameterRangeError,
    as_parameter_field,
    parameter_numbers,
)
from forms.stations import AnyStation, Faces, Station, gauss_stations
from forms.tensors import MANDEL_PAIRS, SQRT2, Expr, condensed_tangent, isotropic_tensor, layer_frame
from forms.traits import warn_outside

VOIGT_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
VOIGT_INDEX = ((0, 5, 4), (5, 1, 3), (4, 3, 2))  # Voigt index of each component of a tensor
MAX_FREE_END_NU = 0.45  # largest Poisson's ratio with free-end strips for laws without a pressure on S
MODULUS_RATIO_TOLERANCE = 1e-9  # relative tolerance of ratios of moduli
OUT_OF_PLANE_VOIGT = [2, 3, 4]
IN_PLANE_VOIGT = [0, 1, 5]


def lame_stress(lmbda: Expr, mu: Expr, e: Expr) -> Expr:
    """Isotropic stress (3, 3), UFL, at the strain e (3, 3): lmbda tr(e) I + 2 mu e."""
    return lmbda * ufl.tr(e) * ufl.Identity(3) + 2 * mu * e


def __getattr__(name: str) -> Callable[[Expr, Expr, Expr], Expr]:
    """Return `lame_stress` for its name of version 1.0, "lame", with a DeprecationWarning."""
    if name != "lame":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warn_outside(DeprecationWarning(f"{__name__}.lame is deprecated since thinlayer 1.1; use {__name__}.lame_stress"))
    return lame_stress


@dataclass(frozen=True, eq=False)
class IsotropicLaw(BulkLaw):
    """Base of laws whose elastic response is isotropic, with the Lame moduli lmbda > -2 mu/3 and mu > 0, stresses."""

    lmbda: float
    mu: float
    powers: ClassVar[Mapping[str, float]] = {"lmbda": 1, "mu": 1}

    def check(self) -> None:
        require_positive(self, "mu")
        minimum = -2 / 3 * self.mu
        self.require(minimum < self.lmbda < math.inf, "lmbda", f"> -2 mu/3 = {minimum:g}")

    def stiffness(self, n: Array) -> Array:
        return isotropic_tensor(float(self.lmbda), float(self.mu))


def poisson_ratio(law: BulkLaw) -> float:
    """Poisson's ratio of a law with numeric moduli lmbda and mu."""
    lmbda, mu = (float(parameter_numbers(law.parameters()[name])) for name in ("lmbda", "mu"))
    return lmbda / (lmbda + mu) / 2


class LinearLaw(BulkLaw):
    """Base of laws whose stiffness tensor does not depend on the strain."""

    linear = True
    quadratic = True

    def energy(self, step: Step) -> Expr:
        """Strain energy per unit volume, UFL: e:C:e/2 with the stiffness tensor C."""
        return ufl.inner(self.stress(Step(step.e, step.n)), step.e) / 2


@dataclass(frozen=True)
class LinearElastic(LinearLaw, IsotropicLaw):
    """Isotropic elasticity, stress = lmbda tr(e) I + 2 mu e.

    As a layer's law: t_T = mu/eps w_T, t_N = (lmbda + 2 mu)/eps w_N with the jump w, the elastic part of Eq. (16) of
    the paper.

    Attributes:
        lmbda: first Lame modulus, stress; lmbda + 2 mu/3 > 0.
        mu: shear modulus, stress; > 0.

    Raises:
        InputError: a modulus out of range.

    Example:
        >>> from forms import LinearElastic
        >>> LinearElastic(lmbda=800.0, mu=400.0)
        LinearElastic(lmbda=800.0, mu=400.0)
        >>> LinearElastic.young(E=1000.0, nu=0.25)
        LinearElastic(lmbda=400.0, mu=400.0)
    """

    def __new__(cls, *_: object, **named: object) -> Self:
        if {"E", "nu"} & {*named}:
            raise InputError("LinearElastic has the parameters lmbda and mu; of E and nu: LinearElastic.young(E, nu)")
        return super().__new__(cls)

    @classmethod
    def young(cls, E: Parameter, nu: Parameter) -> LinearElastic:
        """The law with Young's modulus E > 0 (stress) and Poisson's ratio -1 < nu < 1/2.

        Both may be numpy functions of places (d, n) in the joint that give n values.
        """
        E, nu = as_parameter_field(E), as_parameter_field(nu)
        if isinstance(E, ParameterField) or isinstance(nu, ParameterField):
            moduli = [ParameterField(modulus, (E, nu)) for modulus in (_lmbda_of_young, _mu_of_young)]
            return cls(*moduli)  # type: ignore[arg-type]
        return cls(_lmbda_of_young(E, nu), _mu_of_young(E, nu))

    @classmethod
    def shear(cls, mu: Parameter, nu: Parameter) -> LinearElastic:
        """The law with shear modulus mu > 0 (stress) and Poisson's ratio -1 < nu < 1/2.

        Both may be numpy functions of places (d, n) in the joint that give n values.
        """
        for name, value in (("mu", mu), ("nu", nu)):
            require(callable(value) or is_finite(value), f"LinearElastic.shear: {name}", value, "it must be a number")
        mu, nu = as_parameter_field(mu), as_parameter_field(nu)
        return cls.young(2 * mu * (1 + nu), nu)

    def stress(self, step: Step) -> Expr:
        return lame_stress(self.lmbda, self.mu, step.mid)

    def elastic_moduli(self) -> tuple[float, float]:
        return super().elastic_moduli() if self.traits.compiled else (self.lmbda, self.mu)  # compiled: its moduli vary

    def stations(self) -> list[AnyStation]:
        """Two Gauss stations through the thickness, for displacements that are parabolic from face to face.

        The change of the strain from face to face causes no traction: its stress times n is zero. Displacements linear
        through the thickness would lock in a nearly incompressible layer.
        """
        return gauss_stations(self, self._strain_change)

    @staticmethod
    def _strain_change(law: LinearElastic, faces: Faces) -> Expr:
        in_s = faces.in_s(faces.change)
        return in_s - law._thinning_ratio * ufl.tr(in_s) * faces.normal

    @property
    def _thinning_ratio(self) -> float:
        """The ratio lmbda/(lmbda + 2 mu): thinning of a layer with free faces per stretch along it."""
        return self.lmbda / (self.lmbda + 2 * self.mu)

    def end_strips(self) -> EndStrips | None:
        """Strips along a free end in which the interface law of order 1 is made less stiff.

        None if Poisson's ratio is outside the range from 0 to `MAX_FREE_END_NU`, or if parameters vary along the layer.
        Beyond this maximum the layer's pressure decays over more than the strip. In plane stress the law has the moduli
        of `plane_stress`, and the ratio here is nu/(1 + nu) of the material.
        """
        if self.fields:
            return None
        nu = poisson_ratio(self)
        return EndStrips.of(free_end(nu)) if 0 <= nu <= MAX_FREE_END_NU * (1 + MODULUS_RATIO_TOLERANCE) else None

    def stations_at_ends(self, weights: EndWeights) -> list[AnyStation]:
        """Three stations of the law near free ends: two for the mean strain, one for its change from face to face.

        The energies at the first two add up to that of a layer with free ends, W in the module `forms.ends.weights`.

        Args:
            weights: reductions of the stiffness near free ends, UFL on S.
        """

        def strain(k: int) -> Callable[[LinearElastic, Faces], Expr]:
            return lambda law, faces: weights.strains(faces, law._thinning_ratio)[k]

        return [Station(self, 1, strain(0)), Station(self, 1, strain(1)), Station(self, 1 / 12, self._strain_change)]

    def plane_stress(self) -> LinearElastic:
        return self.with_parameters({"lmbda": 2 * self.lmbda * self.mu / (self.lmbda + 2 * self.mu)})


def _lmbda_of_young(E: float, nu: float) -> float:
    _require_young(E, nu)
    return E * nu / ((1 + nu) * (1 - 2 * nu))


def _mu_of_young(E: float, nu: float) -> float:
    _require_young(E, nu)
    return E / (2 * (1 + nu))


def _require_young(E: float, nu: float) -> None:
    """Check Young's modulus and Poisson's ratio, numbers or arrays of values at several places.

    Raises:
        ParameterRangeError: E <= 0, or nu outside -1 < nu < 1/2, at a place.
        InputError: one of them is not a number.
    """
    for name, values, least, most, allowed in (("E", E, 0.0, math.inf, "> 0"), ("nu", nu, -1.0, 0.5, "-1 < nu < 0.5")):
        require(np.asarray(values).dtype.kind in "iuf", f"LinearElastic: {name}", values, f"allowed: {allowed}")
        allowed_ones = (np.asarray(values) > least) & (np.asarray(values) < most)
        if not np.all(allowed_ones):
            k = int(np.argmin(allowed_ones))
            raise ParameterRangeError(f"{name} is {np.ravel(values)[k]:g}; allowed: {allowed}", k)


@dataclass(frozen=True, eq=False)
class Anisotropic(LinearLaw):
    """General linear elasticity, stress = C : e.

    As a layer's law: t_i = C_ijkl n_j n_l w_k/eps with the jump w, the acoustic tensor n.C.n over the thickness.

    Attributes:
        C: (6, 6) symmetric stiffness in Voigt order 11, 22, 33, 23, 13, 12 (engineering shear strains), stress,
            positive semidefinite. A layer needs a positive definite acoustic tensor, and a body a positive definite C,
            unless supports constrain the motions that it does not resist.
        frame: axes of C. "global": those of the coordinates; "layer": axis 2 is the normal n of the layer, axes 1 and 3
            lie in the layer (`forms.tensors.layer_frame`).

    Raises:
        InputError: C of the wrong shape, not symmetric or indefinite; unknown frame.
    """

    C: Array
    frame: str = choice("global")
    powers: ClassVar = {"C": 1}

    def check(self) -> None:
        C = np.array(self.C, float)  # a copy, which the caller cannot change
        self.require(C.shape == (6, 6), "shape of C", "(6, 6)", C.shape)
        self.require(bool(np.isfinite(C).all()), "C", "finite numbers", "not finite")
        self.require(np.allclose(C, C.T, rtol=1e-10, atol=0), "C", "C = C^T", "not symmetric")
        lowest = np.linalg.eigvalsh(C)[0]
        self.require(lowest >= -1e-10 * np.abs(C).max(), "smallest eigenvalue of C", ">= 0", f"{lowest:g}")
        self.require(self.frame in ("global", "layer"), "frame", "'global', 'layer'", repr(self.frame))
        object.__setattr__(self, "C", C)

    @classmethod
    def springs(cls, K_N: float, K_T: float) -> Anisotropic:
        """A layer that only has springs: t_N = K_N w_N/eps, t_T = K_T w_T/eps with the jump w and the thickness eps.

        K_N > 0 and K_T >= 0 are moduli, stresses, or stiffnesses, stress per length, if the thickness is 1. K_T = 0 is
        a bearing without friction: supports must constrain bodies that may slide.
        """
        require(is_finite(K_N) and K_N > 0, "Anisotropic.springs: K_N", K_N, "allowed: > 0")
        require(is_finite(K_T) and K_T >= 0, "Anisotropic.springs: K_T", K_T, "allowed: >= 0")
        return cls(np.diag([0, K_N, 0, K_T, 0, K_T]), "layer")

    def stress(self, step: Step) -> Expr:
        if self.frame == "layer" and step.n is None:
            raise InputError("Anisotropic: frame='layer' needs a layer; in a body use frame='global'")
        rotation = layer_frame(step.n) if self.frame == "layer" else ufl.Identity(3)
        e = rotation.T * step.mid * rotation
        voigt = ufl.as_vector([e[i, j] if i == j else 2 * e[i, j] for i, j in VOIGT_PAIRS])
        s = ufl.dot(ufl.as_tensor(self.C) if isinstance(self.C, np.ndarray) else self.C, voigt)
        return rotation * ufl.as_tensor([[s[k] for k in row] for row in VOIGT_INDEX]) * rotation.T

    def stiffness(self, n: Array) -> Array:
        voigt_index = np.array(VOIGT_INDEX)
        C = np.asarray(self.C, float)[voigt_index[:, :, None, None], voigt_index[None, None]]
        if self.frame == "layer":
            rotation = Rotation.align_vectors([np.pad(n, (0, 3 - len(n)))], [[0.0, 1.0, 0.0]])[0].as_matrix()
            C = np.einsum("ia,jb,kc,ld,abcd->ijkl", rotation, rotation, rotation, rotation, C, optimize=True)
        first, second = np.array(MANDEL_PAIRS).T
        mandel_factor = np.where(first == second, 1.0, SQRT2)
        return np.asarray(C[first[:, None], second[:, None], first, second] * np.outer(mandel_factor, mandel_factor))

    def plane_stress(self) -> Anisotropic:
        C = np.zeros((6, 6))
        C[np.ix_(IN_PLANE_VOIGT, IN_PLANE_VOIGT)] = condensed_tangent(self.C, IN_PLANE_VOIGT, OUT_OF_PLANE_VOIGT)
        C[3:5, 3:5] = self.C[3:5, 3:5]  # these shear strains are zero, but sublayers in series need a stiffness
        return self.with_parameters({"C": C})
