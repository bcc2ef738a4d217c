"""Continuation: a step that Newton's method does not find, through laws whose equilibrium is found more easily."""

from __future__ import annotations

import math
from collections.abc import Callable

from petsc4py import PETSc

from thinlayer.errors import SolveError

FIRST, LEAST = 0.25, 1 / 64  # how much easier a law is than the next one
MOST = 30  # solves
RUN_AWAY = 1e5  # displacements over those of an elastic layer: the law itself has no equilibrium


class Continuation:
    """The eases of the laws on the way from an elastic layer (1) to the law itself (0), and what was found.

    The ease falls by a decrement that doubles after a solve that converges and is halved after one that does not.

    Attributes:
        solves: number of solves so far.
    """

    def __init__(self) -> None:
        self.solves = 0
        self._reached: float | None = None
        self._decrement = FIRST

    def follow(self, solve: Callable[[float, PETSc.Vec | None], PETSc.Vec]) -> PETSc.Vec:
        """The unknowns of the law itself, as the last solve gave them. Collective.

        Args:
            solve: ease and unknowns to start from (None: those of the old state) -> unknowns; where another solve follows,
                a copy of them is where it starts.

        Raises:
            SolveError: a law on the way has no equilibrium that is found, or displacements run away.
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
                    if self._reached is None or self._decrement < LEAST or self.solves >= MOST:
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
