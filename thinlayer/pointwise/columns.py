"""Columns of the layer: facets of S, and in the meshed layer the cells above each of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from mpi4py import MPI

from forms.base import Array
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


class Switching:
    """Phases of columns in the internal variables of a law that switches: their excess energies and their changes."""

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
        new[:, self._slot["phase"]] = after[self.columns.of] if self.columns else after
        return new
