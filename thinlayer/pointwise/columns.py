"""Columns of the layer: facets of S, and in the meshed layer the cells above each of them."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from mpi4py import MPI

from forms.base import Array, InputError
from forms.law import BulkLaw
from geometry.topology import IntArray

EXCESS_TOLERANCE = 1e-11  # largest excess (an energy over C) that counts as rounding error: the phase does not change


class Columns:
    """Sums and means over columns. Collective, as all methods are.

    Attributes:
        count: number of columns on all ranks.
        of: (points,) column of each point of this rank.
    """

    def __init__(self, comm: MPI.Intracomm, of: IntArray, count: int, weights: Array) -> None:
        self.comm, self.of, self.count, self._weights = comm, of, count, weights
        self._total = self.sum_of(weights)

    def sum_of(self, values: Array) -> Array:
        """Sums (columns,) of values at the points, the same on all ranks."""
        # np.bincount gives integers if there are no points
        sums: Array = np.bincount(self.of, values, self.count).astype(float)
        self.comm.Allreduce(MPI.IN_PLACE, sums)
        return sums

    def mean(self, values: Array) -> Array:
        """Weighted means (columns,) of values at the points, the same on all ranks."""
        return self.sum_of(self._weights * values) / self._total


@runtime_checkable
class SwitchingLaw(Protocol):
    """Methods of a law that switches, at the values (n,) of its `switching_variables`, the phase first."""

    def excess(self, phase: Array, drive: Array, bound: Array) -> Array:
        """(n,) energy of the phase less the least energy of other phases, over C; the phase switches if it is > 0."""

    def switched(self, phase: Array, drive: Array, bound: Array) -> Array:
        """(n,) phases of lowest energy."""


class Switching:
    """Phases of columns in the internal variables of a law that switches: their excess energies and their changes."""

    def __init__(self, law: BulkLaw, columns: Columns | None = None) -> None:
        if not isinstance(law, SwitchingLaw):
            raise InputError(f"{type(law).__name__} switches phases; write its methods excess and switched too")
        self.law, self.columns, names = law, columns, list(law.internal)
        self._slots = [names.index(name) for name in law.switching_variables]

    def _of_columns(self, memory: Array) -> list[Array]:
        values = [memory[:, slot] for slot in self._slots]
        if not self.columns:
            return values
        phase, drive, bound = map(self.columns.mean, values)
        return [np.rint(phase), drive, bound]  # a mean of equal numbers has rounding errors

    def excess(self, memory: Array) -> float:
        """Largest excess of all columns: energy of the phase less the least energy of others, over C. Collective."""
        return float(self.law.excess(*self._of_columns(memory)).max(initial=-np.inf))

    def switched(self, memory: Array, old: Array) -> Array | None:
        """Internal variables `old` with the new phases of columns that change; None if no column changes. Collective.

        Args:
            memory: internal variables at the equilibrium with fixed phases.
            old: internal variables at the beginning of the step, with the same phases.
        """
        before = self._of_columns(memory)
        after = np.where(self.law.excess(*before) > EXCESS_TOLERANCE, self.law.switched(*before), before[0])
        if (after == before[0]).all():
            return None
        new = old.copy()
        new[:, self._slots[0]] = after[self.columns.of] if self.columns else after
        return new
