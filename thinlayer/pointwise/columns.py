"""Columns of the layer: facets of S, and in the meshed layer the cells above each of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI

from forms.base import Array
from geometry.topology import IntArray

EXCESS_TOLERANCE = 1e-11  # largest excess that counts as rounding: the phase stays


class Columns:
    """Means over columns. Collective, as all methods are.

    Attributes:
        count: number of columns, of all ranks.
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


class Switching:
    """Reads and changes the phases of columns in the internal values of a law that switches."""

    def __init__(self, law: Any, columns: Columns | None = None) -> None:
        self.law, self.columns = law, columns
        self._slot = {name: k for k, name in enumerate(law.internal)}

    def _of_columns(self, memory: Array) -> list[Array]:
        values = [memory[:, self._slot[name]] for name in ("phase", "drive", "bound")]
        if not self.columns:
            return values
        phase, drive, bound = map(self.columns.mean, values)
        return [np.rint(phase), drive, bound]  # a mean of equal numbers has rounding errors

    def excess(self, memory: Array) -> float:
        """Largest excess of all columns: energy of a column's phase less the least of the others', over C. Collective."""
        return float(self.law.excess(*self._of_columns(memory)).max(initial=-np.inf))

    def switched(self, memory: Array, old: Array) -> Array | None:
        """Internal values `old` with the phases that columns change to; None if none changes. Collective.

        Args:
            memory: internal values at the equilibrium that was found with fixed phases.
            old: internal values at the beginning of the step, with these phases.
        """
        before = self._of_columns(memory)
        after = np.where(self.law.excess(*before) > EXCESS_TOLERANCE, self.law.switched(*before), before[0])
        if (after == before[0]).all():
            return None
        new = old.copy()
        new[:, self._slot["phase"]] = after[self.columns.of] if self.columns else after
        return new
