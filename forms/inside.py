"""Stresses inside a layer, at any height, from the displacements of its two faces.

Of isotropic linear elastic sublayers (`Sublayers`), and of a law with a pressure (`Pressed`).

Between the faces strains along S are e(y) = e_S + Phi_T(y) E_1, e_S and E_1 those of <u> and of [u]; Phi_T and Phi_N grow
from -1/2 to 1/2 through the layer, in proportion to 1/mu and 1/M, M = lmbda + 2 mu. The tractions on planes parallel to S
balance the stresses along S, eps^-1 dt/dy = -div_S s, whose leading term is r t_N in all directions of S, r = lmbda/M:

    t_T(y) = T_0 - <1/M>^-1 R(y) grad_S w_N,   R' = r, R(-1/2) = 0,
    t_N(y) = N_0 - (y + 1/2) <1/mu>^-1 div_S w_T,

where < > are means through the layer. T_0 and N_0 follow from the jump, whose strains t_T/mu - grad_S v_N and
(t_N - lmbda tr e)/M the layer has: w_T = eps <t_T/mu> - eps grad_S <v_N>, and so on. The stresses along S are

    s = r t_N P + 2 lmbda mu/M (tr e) P + 2 mu e,   P = I - n (x) n.

With uniform gradients this is exact. Otherwise its error is of the second order in eps over the length of change; at order
0, where strains along S are left out, of the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FaceValues:
    """How the faces of a layer are displaced at n places of S, lifted to three dimensions.

    Attributes:
        n: unit normals, (n, 3).
        jump: [u], (n, 3).
        mean: strain along S of <u>, as of `forms.stations.Faces`, (n, 3, 3).
        difference: strain along S of [u], likewise.
        pressure, slope: of a law with a pressure: p (n,) and grad_S p (n, 3); else zero.
    """

    n: Array
    jump: Array
    mean: Array
    difference: Array
    pressure: Array
    slope: Array

    @cached_property
    def projection(self) -> Array:
        """P, (n, 3, 3)."""
        return np.asarray(np.eye(3) - self.n[:, :, None] * self.n[:, None])

    @cached_property
    def in_s(self) -> tuple[Array, Array]:
        """e_S and E_1: the parts of both strains in S, (n, 3, 3)."""
        first, second = (self.projection @ one @ self.projection for one in (self.mean, self.difference))
        return first, second

    @cached_property
    def turns(self) -> tuple[Array, Array]:
        """grad_S <u_N> and grad_S w_N, (n, 3)."""
        first, second = (
            2 * np.einsum("nij,njk,nk->ni", self.projection, one, self.n) for one in (self.mean, self.difference)
        )
        return first, second

    @cached_property
    def opening(self) -> Array:
        """w_N, (n,)."""
        return np.asarray(np.einsum("ni,ni->n", self.n, self.jump))

    @cached_property
    def slip(self) -> Array:
        """w_T, (n, 3)."""
        return np.asarray(self.jump - self.opening[:, None] * self.n)

    def composed(self, in_s: Array, t_N: Array, t_T: Array) -> Array:
        """Stresses (n, 3, 3) from their part in S and the tractions across it (n,) and along it (n, 3)."""
        shear = t_T[:, :, None] * self.n[:, None]
        both = self.n[:, :, None] * self.n[:, None]
        return np.asarray(in_s + t_N[:, None, None] * both + shear + np.swapaxes(shear, 1, 2))


class Inside:
    """What gives the stresses inside a layer.

    Attributes:
        flows: whether the pressure is a field that flows along S, and falls towards free ends.
    """

    flows: ClassVar[bool] = False

    @property
    def moduli(self) -> tuple[float, float] | None:
        """Real lmbda and mu of a layer of one law; None: it has several."""
        raise NotImplementedError

    def stress(self, faces: FaceValues, eps: Array, y: Array) -> Array:
        """Stresses (n, 3, 3) at heights y (n,), from -1/2 to 1/2.

        Args:
            faces: displacements of the faces at n places.
            eps: (n,) thickness.
            y: heights.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class Pressed(Inside):
    """A layer of one law with a pressure.

    Attributes:
        lmbda, mu: real moduli; lmbda may be math.inf.
    """

    lmbda: float
    mu: float

    flows: ClassVar[bool] = True

    @property
    def moduli(self) -> tuple[float, float]:
        return self.lmbda, self.mu

    def stress(self, faces: FaceValues, eps: Array, y: Array) -> Array:
        mu, (e_S, E_1) = self.mu, faces.in_s
        change = np.trace(E_1, axis1=1, axis2=2)
        t_T = mu * (faces.slip / eps[:, None] + faces.turns[0]) - (y * eps)[:, None] * faces.slope
        t_N = faces.pressure + 2 * mu * faces.opening / eps - y * mu * change
        growth = mu / (1 + 2 * mu / self.lmbda)
        p = faces.pressure + y * growth * change
        in_s = p[:, None, None] * faces.projection + 2 * mu * (e_S + y[:, None, None] * E_1)
        return faces.composed(in_s, t_N, t_T)


@dataclass(frozen=True)
class Sublayers(Inside):
    """The sublayers of a layer, from the lower to the upper face.

    Attributes:
        fractions, lmbda, mu: shares of the thickness and real moduli of the sublayers, (k,) each.
    """

    fractions: Array
    lmbda: Array
    mu: Array

    @classmethod
    def of(cls, sublayers: Sequence[tuple[float, float, float]]) -> Self:
        """The layer of sublayers with these fractions, lmbda and mu."""
        return cls(*np.array(sublayers, float).T)

    @property
    def moduli(self) -> tuple[float, float] | None:
        return (float(self.lmbda[0]), float(self.mu[0])) if len(self.mu) == 1 else None

    @cached_property
    def _ends(self) -> Array:
        """Heights (k + 1,) at which sublayers begin and end."""
        ends = np.concatenate([[0.0], np.cumsum(self.fractions)]) - 0.5
        ends[-1] = 0.5
        return ends

    @property
    def M(self) -> Array:
        """lmbda + 2 mu."""
        return self.lmbda + 2 * self.mu

    @property
    def r(self) -> Array:
        """lmbda/(lmbda + 2 mu)."""
        return self.lmbda / self.M

    def _mean(self, values: Array) -> float:
        return float(self.fractions @ values)

    def _grown(self, rates: Array) -> Array:
        """Values (k + 1,) at `_ends` of what grows from zero at these rates in the sublayers."""
        return np.concatenate([[0.0], np.cumsum(self.fractions * rates)])

    def _through(self, rates: Array) -> Array:
        """`_grown` from -1/2 to 1/2, in proportion to the rates: Phi."""
        grown = self._grown(rates)
        return np.asarray(grown / grown[-1] - 0.5)

    def stress(self, faces: FaceValues, eps: Array, y: Array) -> Array:
        """As of `Inside`; between two sublayers those of the lower one."""
        M, mu, r, (e_S, E_1), (slope, steepness) = self.M, self.mu, self.r, faces.in_s, faces.turns
        trace, change = (np.trace(one, axis1=1, axis2=2) for one in (e_S, E_1))
        phi_N, phi_T, R = self._through(1 / M), self._through(1 / mu), self._grown(r)

        def middle(ends: Array) -> Array:
            return np.asarray((ends[1:] + ends[:-1]) / 2)

        whole, sheared = 1 / self._mean(1 / M), 1 / self._mean(1 / mu)
        turned = self._mean(middle(phi_N)) + whole * self._mean(middle(R) / mu)
        T_0 = sheared * (faces.slip / eps[:, None] + slope + turned * steepness)
        thinned = self._mean(r * middle(phi_T)) + sheared * self._mean(middle(self._ends + 0.5) / M)
        N_0 = whole * (faces.opening / eps + self._mean(r) * trace + thinned * change)

        one = np.clip(np.searchsorted(self._ends, y) - 1, 0, len(M) - 1)
        at_R, at_phi = (np.interp(y, self._ends, ends) for ends in (R, phi_T))
        t_T = T_0 - whole * at_R[:, None] * steepness
        t_N = N_0 - (y + 0.5) * sheared * change
        e = e_S + at_phi[:, None, None] * E_1
        along = r[one] * t_N + (2 * r * mu)[one] * (trace + at_phi * change)
        in_s = along[:, None, None] * faces.projection + 2 * mu[one][:, None, None] * e
        return faces.composed(in_s, t_N, t_T)
