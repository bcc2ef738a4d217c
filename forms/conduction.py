"""Laws of conduction: of heat, electric current, diffusing species, or a fluid in pores."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
import ufl
from scipy.spatial.transform import Rotation

from forms.base import Array, InputError, is_finite, require
from forms.flux import FluxLaw, FluxStep
from forms.law import BulkLaw, choice, require_positive
from forms.parameter_fields import ParameterValue
from forms.temperature import checked_values, place_and_time_text
from forms.tensors import Expr, layer_frame
from forms.traction import JumpStep, TractionLaw


@dataclass(frozen=True, eq=False)
class Conduction(FluxLaw):
    """Fourier's, Ohm's, Fick's or Darcy's law: the flux is k times the gradient of the field.

    As a layer's law of order 0, the flux through the layer is k [T]/eps: eps is its thickness, [T] the field's jump.

    Attributes:
        k: conductivity, > 0: flux over gradient. A number, or a numpy function of the coordinates (d, n) of n places.

    Raises:
        InputError: k out of range.

    Example:
        >>> from forms import Conduction
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, solve
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")  # mm
        >>> plates = Structure(
        ...     joint, body=Conduction(k=0.05), supports={"BOTTOM": 20, "TOP": 80}
        ... )
        >>> state = solve(plates.interface(ThinLayer(Conduction(k=2e-4), eps=0.1)))
        >>> print(f"{state.reaction('TOP').flow:.4f} W/mm")
        0.4286 W/mm
    """

    k: float
    linear = True
    has_quadratic_energy = True
    powers: ClassVar = {"k": 1}

    def check(self) -> None:
        require_positive(self, "k")

    def flux(self, step: FluxStep) -> Expr:
        return self.k * step.g

    def potential(self, step: FluxStep) -> Expr:
        return self.k * ufl.inner(step.g_end, step.g_end) / 2

    def stiffness(self, n: Array) -> Array:
        return np.diag([float(self.k)] * 3 + [0.0] * 3)


@dataclass(frozen=True, eq=False)
class AnisotropicConduction(FluxLaw):
    """Conduction that depends on the direction: the flux is K times the gradient, with a tensor K.

    Attributes:
        K: (3, 3) symmetric positive definite conductivities: flux over gradient.
        frame: axes of K. "global" are those of the coordinates. With "layer", axis 2 is the normal n of the layer, and
            axes 1 and 3 lie in it (`forms.tensors.layer_frame`).

    Raises:
        InputError: K of the wrong shape, not symmetric, not positive definite; unknown frame.

    Example:
        >>> from forms import AnisotropicConduction
        >>> foil = AnisotropicConduction.layered(along=0.4, across=2e-3)
    """

    K: Array
    frame: str = choice("global")
    linear = True
    has_quadratic_energy = True
    powers: ClassVar = {"K": 1}

    def check(self) -> None:
        K = np.array(self.K, float)  # a copy, which the caller cannot change
        self.require(K.shape == (3, 3), "shape of K", "(3, 3)", K.shape)
        self.require(bool(np.isfinite(K).all()), "K", "finite numbers", "not finite")
        self.require(np.allclose(K, K.T, rtol=1e-10, atol=0), "K", "K = K^T", "not symmetric")
        eig_min = np.linalg.eigvalsh(K)[0]
        self.require(eig_min > 0, "smallest eigenvalue of K", "> 0", f"{eig_min:g}")
        self.require(self.frame in ("global", "layer"), "frame", "'global', 'layer'", repr(self.frame))
        object.__setattr__(self, "K", K)

    @classmethod
    def layered(cls, along: float, across: float) -> AnisotropicConduction:
        """Return the law of a layer with one conductivity > 0 along it, and another one > 0 across it."""
        for name, value in (("along", along), ("across", across)):
            require(is_finite(value), f"{cls.__name__}.layered: {name}", value, "allowed: > 0")
        return cls(np.diag([along, across, along]), "layer")

    def _rotation(self, n: Any) -> Expr:
        if self.frame == "layer" and n is None:
            raise InputError("AnisotropicConduction: frame='layer' needs a layer; in a body use frame='global'")
        return layer_frame(n) if self.frame == "layer" else ufl.Identity(3)

    def flux(self, step: FluxStep) -> Expr:
        return self._flux(step, step.g)

    def _flux(self, step: FluxStep, g: Expr) -> Expr:
        rotation, K = self._rotation(step.n), ufl.as_tensor(self.K) if isinstance(self.K, np.ndarray) else self.K
        return rotation * K * rotation.T * g

    def potential(self, step: FluxStep) -> Expr:
        return ufl.inner(self._flux(step, step.g_end), step.g_end) / 2

    def stiffness(self, n: Array) -> Array:
        K = np.asarray(self.K, float)
        if self.frame == "layer":
            rotation = Rotation.align_vectors([np.pad(n, (0, 3 - len(n)))], [[0.0, 1.0, 0.0]])[0].as_matrix()
            K = rotation @ K @ rotation.T
        return np.pad(K, (0, 3))


class _ConductanceOfGradients(Conduction):
    """A conductance in the form of a law of gradients, for a layer with the thickness 1."""

    functions: ClassVar = ("k",)

    def check(self) -> None:
        if not callable(self.k):
            super().check()

    def stiffness(self, n: Array) -> Array | None:  # type: ignore[override]
        return None if callable(self.k) else super().stiffness(n)

    @property
    def varies(self) -> bool:
        return callable(self.k)

    def parameters(self) -> dict[str, ParameterValue]:
        return {"k": math.nan if callable(self.k) else self.k}

    def at(self, x: Array, t: float) -> dict[str, Array]:
        if not callable(self.k):
            return {}
        wanted = "it must be a numpy function of places (d, n) on S and of the time that gives n numbers > 0"
        h = checked_values("h(x, t)", self.k, x, t, wanted=wanted, where=partial(place_and_time_text, x, t))
        for k in np.flatnonzero(h <= 0)[:1]:
            raise InputError(f"h(x, t) is {h[k]:g}{place_and_time_text(x, t, int(k))}; {wanted}")
        return {"k": h}


@dataclass(frozen=True, eq=False)
class Conductance(TractionLaw):
    """Law of a scalar field on S without a thickness: the flux is h times the jump of the field.

    Examples are a contact resistance 1/h, or gas with the conductivity k_g in a gap: h = k_g/(opening + g_0), with the
    opening of a mechanical model (`Surface.function`), and the gap g_0 that is left where the opening is 0.

    Attributes:
        h: conductance, flux over jump; > 0. A number, or a numpy function (x, t) of the coordinates (d, n) of n places
            on S and of the time.

    Raises:
        InputError: h out of range, also while a model is solved.

    Example:
        >>> from forms import Conductance, Conduction
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, solve
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")  # mm
        >>> plates = Structure(
        ...     joint, body=Conduction(k=0.05), supports={"BOTTOM": 20, "TOP": 80}
        ... )
        >>> state = solve(plates.interface(Conductance(h=2e-3)))
        >>> print(f"{state.reaction('TOP').flow:.4f} W/mm")
        0.4286 W/mm
    """

    h: float
    unknown = FluxLaw.unknown
    linear = True
    functions: ClassVar = ("h",)

    def check(self) -> None:
        if not callable(self.h):
            require_positive(self, "h")

    def traction(self, step: JumpStep) -> Expr:
        return self.h * step.w

    def as_bulk_law(self) -> BulkLaw:
        return _ConductanceOfGradients(self.h)


@dataclass(frozen=True, eq=False)
class Heat(Conduction):
    """Conduction with a capacity, for marches in time: the flux is k times the gradient, and c dT/dt is stored.

    Attributes:
        k: conductivity, > 0: flux over gradient. A number, or a numpy function of the coordinates (d, n) of n places.
        c: capacity per volume, > 0, such as density times specific heat. A number, or such a function.

    Raises:
        InputError: k or c out of range.

    Example:
        >>> from forms import Heat
        >>> steel = Heat(k=50e-3, c=3.6e-3)  # W/(mm K), J/(mm3 K)
    """

    c: float
    rate = True

    def check(self) -> None:
        require_positive(self, "k", "c")

    def sink(self, step: FluxStep) -> Expr:
        return self.c * step.T_rate

    def loss(self, step: FluxStep) -> Expr:
        return self.c * step.T_rate**2
