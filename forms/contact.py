"""Contact laws at the nodes of S: normal compliance with Coulomb or Tresca friction. They are not for meshed layers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from enum import IntEnum
from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt

from forms.base import Array, InputError, require
from forms.elastic import LinearElastic
from forms.law import Law, require_nonnegative, require_positive
from forms.parameter_fields import Parameter, ParameterValue, place_text
from forms.temperature import checked_values


class Status(IntEnum):
    """Contact status of a node of S: separated (without pressure), sticking or sliding."""

    SEPARATED = 0
    STICK = 1
    SLIDING = 2


@dataclass(frozen=True)
class ContactLaw(Law):
    """A law between the jump and the traction at a node of S, without an underlying bulk law.

    Jumps w (n, d) and tractions t (n, d) are those at n nodes in d dimensions, with components in the frame of S. The
    first d - 1 components are tangential, the last one is normal. A positive normal jump opens S, and a positive normal
    traction is tension. The normal jump includes the initial gap, so that it is zero at first contact. The penetration
    is u_N = -w_N, the contact pressure p = -t_N >= 0:

        p = K_N max(u_N, 0),   t_T = K_T (w_T - slip), shortened to the length threshold(p) where it is longer.

    A user-defined contact law defines `threshold` and `threshold_rate`, functions of an array of pressures. Its
    equilibria are computed by Newton's method. A law with `numbers` has both already.

    Attributes:
        K_N, K_T: normal and tangential stiffness, stress per length; > 0.
        gap: by keyword, initial gap along n between the two sides, a length. It is a number, or a numpy function of the
            coordinates (d, n) of n places that returns n numbers. A gap < 0 is an interference, which presses the
            undisplaced sides together.
        memory: whether the slip, d - 1 components at a node, is stored from step to step; otherwise the slip is always
            zero.
        numbers: K_N, K_T, friction coefficient and cohesion, for a compiled Gauss-Seidel solver of contact. None: four
            numbers do not describe the law, and only Newton's method can solve it.
    """

    K_N: float
    K_T: float
    gap: float | Callable[[Array], npt.ArrayLike] = field(default=0.0, kw_only=True)
    symmetric = False
    bounded = True
    functions = ("gap",)
    memory: ClassVar[bool] = False
    numbers: ClassVar[tuple[float, float, float, float] | None] = None

    def check(self) -> None:
        require_positive(self, "K_N", "K_T")
        self.require(callable(self.gap) or bool(np.isfinite(self.gap)), "gap", "a finite number, or a function")

    def parameters(self) -> dict[str, ParameterValue]:
        return super().parameters() | ({"gap": np.nan} if callable(self.gap) else {})

    def gaps(self, x: Array) -> Array:
        """Return the initial gaps (n,), lengths, at n places with the coordinates `x` (d, n).

        Raises:
            InputError: the function `gap` fails, or does not return n finite numbers.
        """
        if not callable(self.gap):
            return np.full(x.shape[1], float(self.gap))
        call, wanted = f"{type(self).__name__}: gap(x)", "it must be a numpy function of places (d, n) with n lengths"
        return checked_values(call, self.gap, x, wanted=wanted, where=lambda k: f" at {place_text(x, k)}")

    def _traits_of_methods(self) -> dict[str, bool]:
        return {"has_energy": self.memory, "remembers": self.memory, "of_jumps": True, "nodal": True}

    def threshold(self, p: Array) -> Array:
        """Return the largest magnitude (n,) of the tangential traction, stress, at contact pressures `p` (n,)."""
        if self.numbers is None:
            raise InputError(f"{type(self).__name__} has no threshold; a contact law needs a method threshold(p)")
        friction, cohesion = self.numbers[2:]
        return cohesion + friction * p

    def threshold_rate(self, p: Array) -> Array:
        """Return the derivative (n,) of the threshold by the pressure, dimensionless, at contact pressures `p` (n,)."""
        if self.numbers is None:
            raise InputError(f"{type(self).__name__} has no method threshold_rate(p)")
        return np.full_like(p, self.numbers[2])

    def check_threshold(self) -> None:
        """Raise InputError unless `threshold` and `threshold_rate` return finite arrays (n,) for pressures (n,).

        The threshold must also be >= 0. If `numbers` is not None, the threshold must be friction coefficient times
        pressure plus cohesion, with the values in `numbers`.
        """
        p = np.concatenate([[0.0], self.K_N * np.logspace(-9, 0, 10)])
        for name, least in {"threshold": 0.0, "threshold_rate": -np.inf}.items():
            label, pressures = f"{type(self).__name__}.{name}(p)", p.copy()
            try:
                with np.errstate(all="ignore"):  # the law may not be meant for pressures this large
                    value = getattr(self, name)(pressures)
            except InputError:
                raise
            except Exception as error:
                raise InputError(f"{label}: {type(error).__name__}: {error}; p is an array (n,), pressures") from error
            if not np.array_equal(pressures, p):
                raise InputError(f"{label} changes p; it must return a new array")
            is_valid = isinstance(value, np.ndarray) and value.shape == p.shape and value.dtype.kind == "f"
            require(is_valid, f"{label} for {len(p)} pressures", value, f"it must be an array of {len(p)} floats")
            for k in np.flatnonzero(~(np.isfinite(value) & (value >= least)))[:1]:
                allowed = "finite, >= 0" if name == "threshold" else "finite"
                raise InputError(f"{label} is {value[k]} at p = {p[k]:g}; allowed: {allowed}")
        if self.numbers is not None:
            if np.shape(self.numbers) != (4,) or self.numbers[:2] != (self.K_N, self.K_T):
                raise InputError(f"{type(self).__name__}.numbers is {self.numbers!r}; see ContactLaw.numbers, or None")
            friction, cohesion = self.numbers[2:]
            if not np.allclose(cohesion + friction * p, self.threshold(p)):
                raise InputError(f"{type(self).__name__}: numbers and threshold(p) are two laws; give numbers = None")

    def pressure(self, w: Array) -> Array:
        """Return the contact pressures (n,), >= 0, at jumps `w` (n, d), tangential components first."""
        return self.K_N * np.maximum(-w[:, -1], 0.0)

    def _trial_state(self, w: Array, slip: Array | None) -> tuple[Array, Array, Array, Array]:
        """Return pressure, threshold, trial traction and its norm at the jumps `w` (n, d).

        The trial traction (n, d - 1) is the tangential traction if the slip stays at its value `slip` (n, d - 1) before
        the step; None: zero. The other arrays have the shape (n,).
        """
        p = self.pressure(w)
        trial_t = self.K_T * (w[:, :-1] if slip is None else w[:, :-1] - slip)
        return p, self.threshold(p), trial_t, np.linalg.norm(trial_t, axis=1)

    def traction(self, w: Array, slip: Array | None = None) -> Array:
        """Return the tractions (n, d), stress, that the upper side of S exerts on the lower one at n nodes.

        Their tangential components come first, the normal one last.

        Args:
            w: jumps (n, d) at the end of the step, tangential components first.
            slip: slip (n, d - 1) at the beginning of the step; None: zero.
        """
        p, bound, trial_t, norm = self._trial_state(w, slip)
        factor = np.where(norm <= bound, 1.0, bound / np.where(norm > 0, norm, 1.0))
        return np.column_stack([trial_t * factor[:, None], -p])

    def tangent(self, w: Array, slip: Array | None = None) -> Array:
        """Return the derivatives (n, d, d) of the tractions by the jumps at n nodes, stress per length.

        They are not symmetric where S slides with friction.

        Args:
            w: jumps (n, d) at the end of the step, tangential components first.
            slip: slip (n, d - 1) at the beginning of the step; None: zero.
        """
        p, bound, trial_t, norm = self._trial_state(w, slip)
        slides, (n, d) = norm > bound, w.shape
        direction = np.where(slides[:, None], trial_t / np.where(slides, norm, 1.0)[:, None], 0.0)  # of the slip
        stiffness = np.where(slides, self.K_T * bound / np.where(slides, norm, 1.0), self.K_T)
        bound_slope = -self.K_N * np.where(p > 0, self.threshold_rate(p), 0.0)
        tangents = np.zeros((n, d, d))
        tangents[:, :-1, :-1] = np.eye(d - 1) - direction[:, :, None] * direction[:, None, :]
        tangents[:, :-1, :-1] *= stiffness[:, None, None]
        tangents[:, :-1, -1] = direction * bound_slope[:, None]
        tangents[:, -1, -1] = np.where(p > 0, self.K_N, 0.0)
        return tangents

    def bonded(self, n: int, d: int) -> Array:
        """Return the tangents (n, d, d), stress per length, of `n` nodes whose sides are joined elastically.

        The tangent at each node is diag(K_T, ..., K_N), with the tangential components first.
        """
        return np.tile(np.diag([self.K_T] * (d - 1) + [self.K_N]), (n, 1, 1))

    def status(self, w: Array, slip: Array | None = None) -> npt.NDArray[np.int8]:
        """Return the `Status` (n,) of each node: separated, sticking or sliding.

        A node without pressure is separated. One with pressure sticks if its tangential traction is at most the
        threshold, else it slides. A separated node may carry a tangential traction up to the cohesion, or up to
        Tresca's bound.

        Args:
            w: jumps (n, d) at the end of the step, tangential components first.
            slip: slip (n, d - 1) at the beginning of the step; None: zero.
        """
        p, bound, _, norm = self._trial_state(w, slip)
        return np.where(p <= 0, Status.SEPARATED, np.where(norm <= bound, Status.STICK, Status.SLIDING)).astype(np.int8)

    def slip_after(self, w: Array, slip: Array) -> Array:
        """Return the slip (n, d - 1), a length, at the end of a step.

        Args:
            w: jumps (n, d) at the end of the step, tangential components first.
            slip: slip (n, d - 1) at the beginning of the step.
        """
        return w[:, :-1] - self.traction(w, slip)[:, :-1] / self.K_T if self.memory else slip

    def energies(self, w: Array, slip: Array) -> tuple[Array, Array]:
        """Return the energy (n,) per area of S that is stored at the end of a step, and the one dissipated in the step.

        Args:
            w: jumps (n, d) at the end of the step, tangential components first.
            slip: slip (n, d - 1) at the beginning of the step.
        """
        t = self.traction(w, slip)
        stored = (t[:, -1] ** 2 / self.K_N + (t[:, :-1] ** 2).sum(axis=1) / self.K_T) / 2
        return stored, (t[:, :-1] * (self.slip_after(w, slip) - slip)).sum(axis=1)

    def homotopy(self, spring_weight: float) -> ContactHomotopy:
        """Return a law for continuation: the weighted mean of this law and of elastic springs.

        Args:
            spring_weight: weight of the springs, from 0 (this law alone) to 1 (springs alone).
        """
        return ContactHomotopy(self, spring_weight)

    @classmethod
    def of_layer(cls, lmbda: float, mu: float, **others: Parameter) -> Self:
        """Return the law with the stiffness of an isotropic layer in plane strain or 3D: K_N = lmbda + 2 mu, K_T = mu.

        Args:
            lmbda, mu: Lame moduli of the layer divided by its thickness, stress per length.
            others: the law's other parameters, by name.
        """
        other_names = [f.name for f in fields(cls) if f.name not in ("K_N", "K_T")]
        for name in (name for name in others if name not in other_names):
            raise InputError(f"{cls.__name__}.of_layer has no {name!r}; known: lmbda, mu, {', '.join(other_names)}")
        LinearElastic(lmbda, mu)  # raises InputError for moduli out of range
        return cls(K_N=lmbda + 2 * mu, K_T=mu, **others)


@dataclass(frozen=True)
class ContactHomotopy:
    """Weighted mean of a contact law and of elastic springs: t = (1 - a) t_law + a K (w - slip).

    t is the traction, w the jump, a the weight of the springs. The springs have the stiffnesses of the law, K =
    diag(K_T, ..., K_N). They resist jumps in all directions, so that an equilibrium exists under all loads.

    Attributes:
        law: the contact law.
        spring_weight: weight a of the springs, from 0 (the contact law alone) to 1 (springs alone).
    """

    law: ContactLaw
    spring_weight: float

    def bonded(self, n: int, d: int) -> Array:
        """Return the tangents (n, d, d) of the springs alone at `n` nodes, diag(K_T, ..., K_N) at each."""
        return self.law.bonded(n, d)

    def traction(self, w: Array, slip: Array | None = None) -> Array:
        """Return the traction (n, d) at jumps `w` (n, d), with the slip (n, d - 1) before the step; None: no slip."""
        elastic_jumps = w[:, :-1] if slip is None else w[:, :-1] - slip
        spring_tractions = np.column_stack([self.law.K_T * elastic_jumps, self.law.K_N * w[:, -1]])
        return (1 - self.spring_weight) * self.law.traction(w, slip) + self.spring_weight * spring_tractions

    def tangent(self, w: Array, slip: Array | None = None) -> Array:
        """Return the derivative (n, d, d) of the traction by the jumps `w` (n, d).

        `slip` (n, d - 1) is the slip before the step; None: no slip.
        """
        return (1 - self.spring_weight) * self.law.tangent(w, slip) + self.spring_weight * self.bonded(*w.shape)

    def status(self, w: Array, slip: Array | None = None) -> npt.NDArray[np.int8]:
        """Return the `Status` (n,) that the contact law alone has at the jumps `w` (n, d).

        `slip` (n, d - 1) is the slip before the step; None: no slip.
        """
        return self.law.status(w, slip)


@dataclass(frozen=True)
class _Coulomb(ContactLaw):
    friction: float
    cohesion: float = 0.0

    def check(self) -> None:
        super().check()
        require_nonnegative(self, "friction", "cohesion")

    @property
    def numbers(self) -> tuple[float, float, float, float]:  # type: ignore[override]
        return self.K_N, self.K_T, self.friction, self.cohesion


@dataclass(frozen=True)
class HolonomicCoulomb(_Coulomb):
    """Normal compliance and friction without memory of the slip: the unilateral law of section 8 of the paper.

    The tangential traction t_T opposes the tangential jump w_T: |t_T| = min(K_T |w_T|, friction p + cohesion) with the
    contact pressure p. The traction depends on the present jump only, so that unloading returns along the loading
    curve.

    Section 8 of the paper treats this law as that of sections 5.3 and 7.3. That one stores a slip, and its surface S
    cannot open (`IncrementalCoulomb` is the law that can). The two agree where p only grows and the slip does not
    reverse. This law is not the limit of a bulk law of a layer.

    The cohesion does not depend on the opening. A separated node has no pressure, but it may carry a tangential
    traction up to the cohesion.

    Attributes:
        K_N, K_T: normal and tangential stiffness, stress per length; > 0.
        friction: Coulomb's friction coefficient; >= 0.
        cohesion: largest |t_T| without pressure, stress; >= 0.
        gap: by keyword, initial gap along n, a length. It is a number, or a numpy function of the coordinates (d, n) of
            n places that returns n numbers.

    Raises:
        InputError: a parameter out of range.
    """


@dataclass(frozen=True)
class IncrementalCoulomb(_Coulomb):
    """Normal compliance, and Coulomb friction with memory of the slip.

    The tangential traction is t_T = K_T (w_T - slip) with |t_T| <= friction p + cohesion. w_T is the tangential jump, p
    the contact pressure. Where |t_T| reaches its bound the slip grows along t_T (backward Euler, like the return
    mapping of elastoplasticity). Without cohesion the slip equals w_T where S is open. A node that closes again
    therefore starts without tangential traction. This is the law of sections 5.3 and 7.3 of the paper, except that S
    can open. It needs time steps (`march`).

    Attributes:
        K_N, K_T: normal and tangential stiffness, stress per length; > 0.
        friction: Coulomb's friction coefficient; >= 0.
        cohesion: largest |t_T| without pressure, stress; >= 0.
        gap: by keyword, initial gap along n, a length. It is a number, or a numpy function of the coordinates (d, n) of
            n places that returns n numbers.

    Raises:
        InputError: a parameter out of range.

    Example:
        >>> from forms import IncrementalCoulomb, LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, Surface, march, piecewise
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> stone = LinearElastic.young(E=30e3, nu=0.2)
        >>> fault = IncrementalCoulomb(K_N=1e4, K_T=5e3, friction=0.3)
        >>> pushed = {"TOP": piecewise({0: (0, -2), 1: (0.5, -2)})}
        >>> blocks = Structure(joint, body=stone, supports={"BOTTOM": 0}, tractions=pushed)
        >>> history = march(blocks.interface(fault), [0.5, 1.0])
        >>> print(Surface(history.last.model).table(history.last))
        seam  size  separated  sliding   stick  pinned  normal_force
           S     4          0   0.6875  0.3125       0             8
    """

    memory: ClassVar[bool] = True


@dataclass(frozen=True)
class Tresca(ContactLaw):
    """Normal compliance, and a tangential traction with a fixed bound that also applies where S is open.

    The fixed-point iteration of section 8 of the paper solves a problem with this law in each step. The energy of the
    law (psi in the paper) is convex.

    Attributes:
        K_N, K_T: normal and tangential stiffness, stress per length; > 0.
        bound: largest magnitude of the tangential traction, stress; >= 0.
        gap: by keyword, initial gap along n, a length. It is a number, or a numpy function of the coordinates (d, n) of
            n places that returns n numbers.

    Raises:
        InputError: a parameter out of range.
    """

    bound: float
    symmetric = True

    def check(self) -> None:
        super().check()
        require_nonnegative(self, "bound")

    @property
    def numbers(self) -> tuple[float, float, float, float]:  # type: ignore[override]
        return self.K_N, self.K_T, 0.0, self.bound
