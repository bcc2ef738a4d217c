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
from forms.ends.constants import FreeEnd, free_end
from forms.ends.weights import EndWeights
from forms.law import BulkLaw, Step, choice, require_positive
from forms.parameter_fields import (
    Parameter,
    ParameterField,
    ParameterRangeError,
    as_parameter_field,
    parameter_numbers,
)
from forms.stations import AnyStation, Faces, Station, gauss_stations
from forms.tensors import MANDEL_BASIS, Expr, condensed_tangent, isotropic_tensor, layer_frame
from forms.traits import warn_caller

VOIGT_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
VOIGT_INDEX = ((0, 5, 4), (5, 1, 3), (4, 3, 2))  # Voigt index of each component of a tensor
MAX_FREE_END_NU = 0.45  # largest Poisson's ratio with constants of free ends for laws without a pressure on S
MODULUS_RATIO_TOLERANCE = 1e-9  # relative tolerance of ratios of moduli
OUT_OF_PLANE_VOIGT = [2, 3, 4]
IN_PLANE_VOIGT = [0, 1, 5]


def lame_stress(lmbda: Expr, mu: Expr, e: Expr) -> Expr:
    """Return the isotropic stress lmbda tr(e) I + 2 mu e, (3, 3), UFL, at the strain `e` (3, 3)."""
    return lmbda * ufl.tr(e) * ufl.Identity(3) + 2 * mu * e


def __getattr__(name: str) -> Callable[[Expr, Expr, Expr], Expr]:
    """Return `lame_stress`, with a DeprecationWarning, if `name` is "lame", as version 1.0 called this function.

    Raises:
        AttributeError: the module has no attribute `name`.
    """
    if name != "lame":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warn_caller(DeprecationWarning(f"{__name__}.lame is deprecated since thinlayer 1.1; use {__name__}.lame_stress"))
    return lame_stress


@dataclass(frozen=True, eq=False)
class IsotropicLaw(BulkLaw):
    """Base of laws whose elastic response is isotropic.

    Attributes:
        lmbda, mu: Lame moduli, stresses; lmbda > -2 mu/3, mu > 0.
    """

    lmbda: float
    mu: float
    powers: ClassVar[Mapping[str, float]] = {"lmbda": 1, "mu": 1}

    def check(self) -> None:
        require_positive(self, "mu")
        min_lmbda = -2 / 3 * self.mu
        self.require(min_lmbda < self.lmbda < math.inf, "lmbda", f"> -2 mu/3 = {min_lmbda:g}")

    def stiffness(self, n: Array) -> Array:
        return isotropic_tensor(float(self.lmbda), float(self.mu))


def poisson_ratio(law: BulkLaw) -> float:
    """Return Poisson's ratio of a law whose moduli lmbda and mu are numbers."""
    lmbda, mu = (float(parameter_numbers(law.parameters()[name])) for name in ("lmbda", "mu"))
    return lmbda / (lmbda + mu) / 2


class LinearLaw(BulkLaw):
    """Base of laws whose stiffness tensor does not depend on the strain."""

    linear = True
    has_quadratic_energy = True

    def energy(self, step: Step) -> Expr:
        """Return the strain energy per unit volume, UFL: e:C:e/2 with the strain e and the stiffness tensor C."""
        return ufl.inner(self.stress(Step(step.e, step.n)), step.e) / 2


@dataclass(frozen=True)
class LinearElastic(LinearLaw, IsotropicLaw):
    """Isotropic elasticity, stress = lmbda tr(e) I + 2 mu e with the strain e.

    As a layer's law with the jump w: t_T = mu/eps w_T and t_N = (lmbda + 2 mu)/eps w_N. This is the elastic part of Eq.
    (16) of the paper.

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
        """Return the law with Young's modulus E > 0 (stress) and Poisson's ratio -1 < nu < 1/2.

        Each is a number, or a numpy function of the coordinates (d, n) of n places in the joint that returns n values.
        """
        E, nu = as_parameter_field(E), as_parameter_field(nu)
        if isinstance(E, ParameterField) or isinstance(nu, ParameterField):
            moduli = [ParameterField(compute_modulus, (E, nu)) for compute_modulus in (_lmbda_of_young, _mu_of_young)]
            return cls(*moduli)  # type: ignore[arg-type]
        return cls(_lmbda_of_young(E, nu), _mu_of_young(E, nu))

    @classmethod
    def shear(cls, mu: Parameter, nu: Parameter) -> LinearElastic:
        """Return the law with shear modulus mu > 0 (stress) and Poisson's ratio -1 < nu < 1/2.

        Each is a number, or a numpy function of the coordinates (d, n) of n places in the joint that returns n values.
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
        """Return two stations at the Gauss points through the thickness, for displacements quadratic in the height.

        The strain changes linearly from the lower to the upper face. The quadratic part of the displacements is chosen
        so that the stress of this change has no traction on planes parallel to S. With displacements linear in the
        height a nearly incompressible layer would lock.
        """
        return gauss_stations(self, self._strain_change)

    @staticmethod
    def _strain_change(law: LinearElastic, faces: Faces) -> Expr:
        in_plane = faces.in_plane(faces.strain_change)
        return in_plane - law._thinning_ratio * ufl.tr(in_plane) * faces.n_dyad

    @property
    def _thinning_ratio(self) -> float:
        """Ratio lmbda/(lmbda + 2 mu): thinning of a layer with free faces over the sum of its in-plane strains."""
        return self.lmbda / (self.lmbda + 2 * self.mu)

    def end_constants(self) -> FreeEnd | None:
        """Return the constants of a free end with which the interface law of order 1 is corrected there.

        None if Poisson's ratio is not from 0 to `MAX_FREE_END_NU`, or if parameters vary along the layer. Above this
        maximum the layer's pressure decays over a length greater than the strip in which openings are corrected. In
        plane stress the ratio that counts is nu/(1 + nu) of the material.
        """
        if self.fields:
            return None
        nu = poisson_ratio(self)
        has_constants = 0 <= nu <= MAX_FREE_END_NU * (1 + MODULUS_RATIO_TOLERANCE)
        return free_end(nu)._replace(kappa=1.0) if has_constants else None  # this law has no flow

    def stations_at_ends(self, weights: EndWeights) -> list[AnyStation]:
        """Return three stations near free ends: two for the mean strain, one for its change between the faces.

        The energies at the first two stations add up to the energy of the mean strain near a free end. This energy is W
        in the docstring of the module `forms.ends.weights`.

        Args:
            weights: reductions of the stiffness near free ends, UFL on S.
        """

        def strain(k: int) -> Callable[[LinearElastic, Faces], Expr]:
            return lambda law, faces: weights.strains(faces, law._thinning_ratio)[k]

        return [Station(self, 1, strain(0)), Station(self, 1, strain(1)), Station(self, 1 / 12, self._strain_change)]

    def plane_stress(self) -> LinearElastic:
        return self.with_parameters({"lmbda": 2 * self.lmbda * self.mu / (self.lmbda + 2 * self.mu)})


def _lmbda_of_young(E: float, nu: float) -> float:
    _require_valid_young(E, nu)
    return E * nu / ((1 + nu) * (1 - 2 * nu))


def _mu_of_young(E: float, nu: float) -> float:
    _require_valid_young(E, nu)
    return E / (2 * (1 + nu))


def _require_valid_young(E: float, nu: float) -> None:
    """Raise an error unless Young's modulus E > 0 and Poisson's ratio -1 < nu < 1/2.

    E and nu are numbers, or arrays of values at several places.

    Raises:
        ParameterRangeError: E or nu is out of range, with the index of the first such place.
        InputError: E or nu is not a number.
    """
    for name, values, least, most, allowed in (("E", E, 0.0, math.inf, "> 0"), ("nu", nu, -1.0, 0.5, "-1 < nu < 0.5")):
        require(np.asarray(values).dtype.kind in "iuf", f"LinearElastic: {name}", values, f"allowed: {allowed}")
        is_allowed = (np.asarray(values) > least) & (np.asarray(values) < most)
        if not np.all(is_allowed):
            k = int(np.argmin(is_allowed))
            raise ParameterRangeError(f"{name} is {np.ravel(values)[k]:g}; allowed: {allowed}", k)


@dataclass(frozen=True, eq=False)
class Anisotropic(LinearLaw):
    """General linear elasticity, stress = C : e with the strain e.

    As a layer's law with the jump w: t_i = C_ijkl n_j n_l w_k/eps. The stiffness is the acoustic tensor n.C.n divided
    by the thickness eps.

    Attributes:
        C: (6, 6) symmetric stiffness, stress, positive semidefinite, in Voigt order 11, 22, 33, 23, 13, 12 (engineering
            shear strains). A layer needs a positive definite acoustic tensor, a body a positive definite C. Otherwise
            supports must prevent the deformations that cause no stress.
        frame: axes of C. "global" are those of the coordinates. With "layer", axis 2 is the normal n of the layer, and
            axes 1 and 3 lie in it (`forms.tensors.layer_frame`).

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
        eig_min = np.linalg.eigvalsh(C)[0]
        self.require(eig_min >= -1e-10 * np.abs(C).max(), "smallest eigenvalue of C", ">= 0", f"{eig_min:g}")
        self.require(self.frame in ("global", "layer"), "frame", "'global', 'layer'", repr(self.frame))
        object.__setattr__(self, "C", C)

    @classmethod
    def springs(cls, K_N: float, K_T: float) -> Anisotropic:
        """Return the law of a layer of independent springs: t_N = K_N w_N/eps and t_T = K_T w_T/eps.

        w is the jump and eps the thickness of the layer. K_N > 0 and K_T >= 0 are moduli, in units of stress. In a
        layer of thickness 1 they are its stiffnesses, stress per length. With K_T = 0 the layer is a bearing without
        friction: supports must prevent the bodies from sliding.
        """
        require(is_finite(K_N) and K_N > 0, "Anisotropic.springs: K_N", K_N, "allowed: > 0")
        require(is_finite(K_T) and K_T >= 0, "Anisotropic.springs: K_T", K_T, "allowed: >= 0")
        return cls(np.diag([0, K_N, 0, K_T, 0, K_T]), "layer")

    def stress(self, step: Step) -> Expr:
        if self.frame == "layer" and step.n is None:
            raise InputError("Anisotropic: frame='layer' needs a layer; in a body use frame='global'")
        rotation = layer_frame(step.n) if self.frame == "layer" else ufl.Identity(3)
        e = rotation.T * step.mid * rotation
        voigt_strain = ufl.as_vector([e[i, j] if i == j else 2 * e[i, j] for i, j in VOIGT_PAIRS])
        s = ufl.dot(ufl.as_tensor(self.C) if isinstance(self.C, np.ndarray) else self.C, voigt_strain)
        return rotation * ufl.as_tensor([[s[k] for k in row] for row in VOIGT_INDEX]) * rotation.T

    def stiffness(self, n: Array) -> Array:
        voigt_index = np.array(VOIGT_INDEX)
        C = np.asarray(self.C, float)[voigt_index[:, :, None, None], voigt_index[None, None]]
        if self.frame == "layer":
            rotation = Rotation.align_vectors([np.pad(n, (0, 3 - len(n)))], [[0.0, 1.0, 0.0]])[0].as_matrix()
            C = np.einsum("ia,jb,kc,ld,abcd->ijkl", rotation, rotation, rotation, rotation, C, optimize=True)
        return np.einsum("aij,ijkl,bkl->ab", MANDEL_BASIS, C, MANDEL_BASIS)

    def plane_stress(self) -> Anisotropic:
        C = np.zeros((6, 6))
        C[np.ix_(IN_PLANE_VOIGT, IN_PLANE_VOIGT)] = condensed_tangent(self.C, IN_PLANE_VOIGT, OUT_OF_PLANE_VOIGT)
        C[3:5, 3:5] = self.C[3:5, 3:5]  # these shear strains are zero, but sublayers in series need a stiffness
        return self.with_parameters({"C": C})
