"""Displacements on both sides of S, and jumps, of a condensed problem."""

from __future__ import annotations

import numpy as np
from scipy import linalg

from thinlayer.discretisation.contact_nodes import Array
from thinlayer.solving.contact.problem import ContactProblem


class SideDisplacements:
    """Free displacements on both sides of S, and jumps; global axes.

    If supports hold a component on one side, the displacement of the other side is the unknown of this jump component.

    Attributes:
        dofs: (c,) local numbers of the free displacements.
        moving: the nodes with a free component of the jump.
        held_jumps: (moving nodes, d) jump components held on both sides; zero for free components.
    """

    def __init__(self, problem: ContactProblem) -> None:
        self._problem, nodes = problem, problem.nodes
        below = np.zeros_like(nodes.dofs)
        if nodes.lower is not None:
            below = nodes.lower.getValuesCSR()[1].astype(np.int32).reshape(below.shape)
        self.moving = moving = np.flatnonzero(~nodes.held.all(axis=1))
        self._free = ~nodes.held[moving]
        self._on_rigid = nodes.lower is None
        self._places = nodes.dofs[moving], below[moving]
        self._held = nodes.held_upper[moving], nodes.held_lower[moving]
        self.dofs = np.concatenate([dofs[~held] for dofs, held in zip(self._places, self._held, strict=True)])
        # numbers in `dofs` of the upper and the lower displacement of each free component of the jump
        counts = np.cumsum(np.concatenate([~held.ravel() for held in self._held])) - 1
        upper, lower = (part.reshape(self._free.shape)[self._free] for part in np.split(counts, 2))
        top, bottom = (~held[self._free] for held in self._held)
        self._carrier, self._sign = np.where(top, upper, lower), np.where(top, 1.0, -1.0)
        self._upper, self._lower = upper[top & bottom], lower[top & bottom]
        self._two = np.flatnonzero(top & bottom)

    def to_jumps(self, S: Array) -> Array:
        """Stiffness (n d, n d) of the jumps, from the stiffness S of the free displacements.

        In rows and columns of held components only the diagonal is not zero.
        """
        carrier, sign = self._carrier, self._sign
        H = S
        if not (np.array_equal(carrier, np.arange(len(S))) and (sign > 0).all()):
            H = S[np.ix_(carrier, carrier)] * np.outer(sign, sign)
        if len(self._two):  # eliminate common motions of both sides, which do not change the jump
            rows = S[self._upper] + S[self._lower]
            self._coupling = rows[:, carrier] * sign
            self._together = linalg.cho_factor(rows[:, self._upper] + rows[:, self._lower], lower=True)
            H = H - self._coupling.T @ linalg.cho_solve(self._together, self._coupling)
            H = (H + H.T) / 2
        free = self._free.ravel()
        if free.all():
            return H
        out = np.diag(np.full(len(free), H.diagonal().mean()))
        out[np.ix_(free, free)] = H
        return out

    def take(self, condensed: Array) -> None:
        """Take the condensed forces (c,) and the prescribed displacements of a load."""
        known = self._problem.prescribed.array_r
        self._condensed = condensed
        upper, lower = (known[dofs] for dofs in self._places)
        if self._on_rigid:
            lower = np.zeros_like(upper)
        self.held_jumps = np.where(self._free, 0.0, upper - lower)
        self._shift = (lower - upper)[self._free]  # the unknown displacement, times its sign, less the jump
        self._shift[self._two] = 0.0

    def _lower_forces(self) -> Array:
        return self._condensed[self._upper] + self._condensed[self._lower]

    def forces(self, H: Array) -> Array:
        """Forces on the jumps, (n, d)."""
        g = self._condensed[self._carrier] * self._sign
        if len(self._two):
            g -= self._coupling.T @ linalg.cho_solve(self._together, self._lower_forces())
        out = np.zeros(self._free.shape)
        out[self._free] = g
        if self._shift.any():
            shift = np.zeros_like(out)
            shift[self._free] = self._shift
            out -= (H @ shift.ravel()).reshape(out.shape)
        return np.where(self._free, out, 0.0)

    def displacements(self, w: Array) -> Array:
        """Free displacements (c,) at jumps (n, d)."""
        y = w[self._free] + self._shift
        out = np.zeros(len(self.dofs))
        out[self._carrier] = y * self._sign
        if len(self._two):
            v = linalg.cho_solve(self._together, self._lower_forces() - self._coupling @ y)
            out[self._lower] = v
            out[self._upper] += v
        return out
