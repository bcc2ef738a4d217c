"""Linear elastic laws: isotropic, anisotropic, and sublayers in series."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import ufl

from forms.kinematics import Expr, layer_frame, lift
from forms.law import Law, LawError, Step, require

VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
OUT_OF_PLANE = [2, 3, 4]
IN_PLANE = [0, 1, 5]


class LinearLaw(Law):
    """A law with a constant stiffness tensor."""

    linear = True

    def energy(self, step: Step) -> Expr:
        """Strain energy per unit volume, e:C:e/2."""
        return ufl.inner(self.stress(step), step.e) / 2


@dataclass(frozen=True)
class LinearElastic(LinearLaw):
    """Isotropic elasticity, stress = lmbda tr(e) I + 2 mu e.

    As a layer's law: t_T = mu [u_T], t_N = (lmbda + 2 mu) [u_N], the elastic part of Eq. (16).

    Attributes:
        lmbda: first Lame modulus, stress (in a layer: stress per thickness); lmbda + 2 mu/3 > 0.
        mu: shear modulus, likewise; > 0.

    Raises:
        LawError: a modulus out of range.
    """

    lmbda: float
    mu: float
    powers: ClassVar = {"lmbda": 1, "mu": 1}

    def check(self) -> None:
        require(math.isfinite(self.mu) and self.mu > 0, self, "mu", self.mu, "> 0")
        bound = -2 / 3 * self.mu
        require(math.isfinite(self.lmbda) and self.lmbda > bound, self, "lmbda", self.lmbda, f"> -2 mu/3 = {bound:g}")

    @classmethod
    def young(cls, E: float, nu: float) -> LinearElastic:
        """From Young's modulus E > 0 (stress; in a layer per thickness) and Poisson's ratio -1 < nu < 1/2."""
        if not (math.isfinite(E) and E > 0):
            raise LawError(f"LinearElastic: E is {E}; allowed: > 0")
        if not -1 < nu < 0.5:
            raise LawError(f"LinearElastic: nu is {nu}; allowed: -1 < nu < 0.5")
        return cls(E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu)))

    @classmethod
    def shear(cls, mu: float, nu: float) -> LinearElastic:
        """From the shear modulus mu > 0 (stress; in a layer per thickness) and Poisson's ratio -1 < nu < 1/2."""
        return cls.young(2 * mu * (1 + nu), nu)

    def stress(self, step: Step) -> Expr:
        return self.lmbda * ufl.tr(step.e) * ufl.Identity(3) + 2 * self.mu * step.e

    def plane_stress(self) -> LinearElastic:
        return self.with_parameters({"lmbda": 2 * self.lmbda * self.mu / (self.lmbda + 2 * self.mu)})


@dataclass(frozen=True, eq=False)
class Anisotropic(LinearLaw):
    """General linear elasticity, stress = C : e.

    As a layer's law: t_i = C_ijkl n_j n_l [u_k], the acoustic tensor of the layer.

    Attributes:
        C: (6, 6) symmetric stiffness in Voigt order 11, 22, 33, 23, 13, 12 (engineering shear strains), stress (in a
            layer: stress per thickness). Not negative in any direction; as a layer's law its acoustic tensor must be
            positive definite, as a body's law C itself.
        frame: "global", or "layer": axis 2 is the director n, axes 1 and 3 lie in the layer (`layer_frame`).

    Raises:
        LawError: C of the wrong shape, not symmetric or indefinite; unknown frame.
    """

    C: npt.NDArray[np.float64]
    frame: str = "global"
    powers: ClassVar = {"C": 1}

    def check(self) -> None:
        C = np.asarray(self.C, float)
        require(C.shape == (6, 6), self, "shape of C", C.shape, "(6, 6)")
        require(bool(np.isfinite(C).all()), self, "C", "not finite", "finite numbers")
        require(np.allclose(C, C.T, rtol=1e-10, atol=0), self, "C", "not symmetric", "C = C^T")
        lowest = np.linalg.eigvalsh(C)[0]
        require(lowest >= -1e-10 * np.abs(C).max(), self, "smallest eigenvalue of C", f"{lowest:g}", ">= 0")
        require(self.frame in ("global", "layer"), self, "frame", repr(self.frame), "'global', 'layer'")
        object.__setattr__(self, "C", C)

    @classmethod
    def springs(cls, K_N: float, K_T: float) -> Anisotropic:
        """A layer whose only stiffnesses are its normal one K_N > 0 and its tangential one K_T > 0 (stress per length)."""
        for name, value in {"K_N": K_N, "K_T": K_T}.items():
            if not (math.isfinite(value) and value > 0):
                raise LawError(f"Anisotropic.springs: {name} is {value}; allowed: > 0")
        return cls(np.diag([0, K_N, 0, K_T, 0, K_T]), "layer")

    def parameters(self) -> dict[str, Any]:
        return {"C": self.C}

    def stress(self, step: Step) -> Expr:
        if self.frame == "layer" and step.n is None:
            raise LawError("Anisotropic: frame='layer' needs a layer; in a body use frame='global'")
        turn = layer_frame(step.n) if self.frame == "layer" else ufl.Identity(3)
        e = turn.T * step.e * turn
        voigt = ufl.as_vector([e[i, j] if i == j else 2 * e[i, j] for i, j in VOIGT])
        s = ufl.dot(ufl.as_tensor(self.C) if isinstance(self.C, np.ndarray) else self.C, voigt)
        index = {pair: k for k, pair in enumerate(VOIGT)} | {pair[::-1]: k for k, pair in enumerate(VOIGT)}
        return turn * ufl.as_tensor([[s[index[i, j]] for j in range(3)] for i in range(3)]) * turn.T

    def plane_stress(self) -> Anisotropic:
        C, out = self.C, OUT_OF_PLANE
        condensed = np.zeros((6, 6))
        coupling = C[np.ix_(IN_PLANE, out)]
        condensed[np.ix_(IN_PLANE, IN_PLANE)] = (
            C[np.ix_(IN_PLANE, IN_PLANE)] - coupling @ np.linalg.pinv(C[np.ix_(out, out)]) @ coupling.T
        )
        return self.with_parameters({"C": condensed})


@dataclass(frozen=True)
class Stack(LinearLaw):
    """Sublayers in series, from the lower to the upper face: common traction and in-plane strain, the jumps add up.

    Between perfectly bonded linear sublayers the compliances add, K = (sum_i a_i K_i^-1)^-1: for isotropic ones the
    harmonic means of mu and of lmbda + 2 mu. Equation (52) prints these sums as stiffnesses, and averages lmbda alone.

    Attributes:
        sublayers: (fraction, law) of each sublayer; fractions of the layer's thickness, > 0, adding up to 1.

    Raises:
        LawError: fractions out of range, a law that is not linear.
    """

    sublayers: tuple[tuple[float, LinearLaw], ...]

    def __init__(self, *sublayers: tuple[float, LinearLaw]) -> None:
        object.__setattr__(self, "sublayers", tuple(sublayers))
        self.check()

    def check(self) -> None:
        require(len(self.sublayers) > 0, self, "number of sublayers", 0, ">= 1")
        require(min(self.fractions) > 0, self, "fractions", self.fractions, "each > 0")
        total = sum(self.fractions)
        require(abs(total - 1) < 1e-12, self, "sum of the fractions", total, "1")
        for law in self.laws:
            require(law.linear and not isinstance(law, Stack), self, "a sublayer", law, "linear elastic laws")

    @property
    def fractions(self) -> tuple[float, ...]:
        """Thickness fractions, from the lower to the upper face."""
        return tuple(a for a, _ in self.sublayers)

    @property
    def laws(self) -> tuple[LinearLaw, ...]:
        """Laws, from the lower to the upper face."""
        return tuple(law for _, law in self.sublayers)

    def with_laws(self, laws: Sequence[Law]) -> Stack:
        """The same fractions with other laws, unchecked."""
        return self.with_parameters({"sublayers": tuple(zip(self.fractions, laws, strict=True))})

    def mapped(self, change: Callable[[Any, float], Any]) -> Stack:
        return self.with_laws([law.mapped(change) for law in self.laws])

    def plane_stress(self) -> Stack:
        return self.with_laws([law.plane_stress() for law in self.laws])

    def stress(self, step: Step) -> Expr:
        return sum(
            a * law.stress(Step(e, step.n)) for (a, law), e in zip(self.sublayers, self._strains(step), strict=True)
        )

    def _strains(self, step: Step) -> list[Expr]:
        """Strain of each sublayer, e + sym(g_i (x) n) with the g_i that make the tractions equal and average to zero."""
        if step.n is None:
            raise LawError("Stack: sublayers need a layer; a body has no director")
        n, d = step.n, step.n.ufl_shape[0]
        in_space = [ufl.as_vector([1.0 if k == i else 0.0 for k in range(d)]) for i in range(d)]

        def traction(law: Law, e: Expr) -> Expr:
            t = ufl.dot(law.stress(Step(e, n)), lift(n))
            return ufl.as_vector([t[i] for i in range(d)])

        def spread(g: Expr) -> Expr:
            return ufl.sym(ufl.outer(lift(g), lift(n)))

        compliances, held = [], []
        for law in self.laws:
            columns = [traction(law, spread(axis)) for axis in in_space]
            compliances.append(ufl.inv(ufl.as_tensor([[columns[j][i] for j in range(d)] for i in range(d)])))
            held.append(traction(law, step.e))
        soft = sum(a * K for (a, _), K in zip(self.sublayers, compliances, strict=True))
        rest = sum(a * ufl.dot(K, t) for (a, _), K, t in zip(self.sublayers, compliances, held, strict=True))
        common = ufl.dot(ufl.inv(soft), rest)
        return [step.e + spread(ufl.dot(K, common - t)) for K, t in zip(compliances, held, strict=True)]
