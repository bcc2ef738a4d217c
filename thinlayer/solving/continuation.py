"""Continuation: solve a step on which Newton's method fails through a sequence of eased laws."""

from __future__ import annotations

import math
from collections.abc import Callable

from petsc4py import PETSc

from thinlayer.errors import SolveError

FIRST_DECREMENT, LEAST_DECREMENT = 0.25, 1 / 64  # decrements of the ease from one law to the next
MOST_SOLVES = 30  # number of solves after which continuation gives up
RUN_AWAY = 1e5  # displacements, relative to those of an elastic layer, at which no equilibrium is expected


class Continuation:
    """Lowers the ease from 1, an elastic layer, to 0, the law itself.

    The decrement of the ease is doubled after a solve that converges and halved after one that fails.

    Attributes:
        solves: number of solves so far.
    """

    def __init__(self) -> None:
        self.solves = 0
        self._reached: float | None = None
        self._decrement = FIRST_DECREMENT

    def follow(self, solve: Callable[[float, PETSc.Vec | None], PETSc.Vec]) -> PETSc.Vec:
        """The unknowns of the law itself, as the last solve returned them. Collective.

        Args:
            solve: ease, unknowns to start from (None: those of the old state) -> unknowns. The next solve starts from a
                copy of them.

        Raises:
            SolveError: the solve of an eased law fails, or displacements run away.
        """
        reached: PETSc.Vec | None = None
        limit = math.inf
        try:
            while True:
                ease = 1.0 if self._reached is None else max(self._reached - self._decrement, 0.0)
                self.solves += 1
                try:
                    x = solve(ease, reached)
                except SolveError:
                    self._decrement /= 2
                    if self._reached is None or self._decrement < LEAST_DECREMENT or self.solves >= MOST_SOLVES:
                        raise
                    continue
                size = float(x.norm(PETSc.NormType.INFINITY))
                limit = RUN_AWAY * size if reached is None else limit
                if size > limit:
                    raise SolveError(f"displacements of an eased law are {RUN_AWAY:g} times those of an elastic layer")
                if not ease:
                    return x
                if reached is not None:
                    reached.destroy()
                reached = x.copy()
                self._reached, self._decrement = ease, 2 * self._decrement
        finally:
            if reached is not None:
                reached.destroy()
