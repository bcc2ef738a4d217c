"""Columns of the layer: single facets of S or, in the meshed layer, cells above each other through the thickness."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from mpi4py import MPI

from forms.base import Array, InputError
from forms.law import BulkLaw
from geometry.topology import IntArray

EXCESS_TOLERANCE = 1e-11  # largest excess (an energy over C) that counts as rounding error: the phase does not change


class Columns:
    """Sums and means of values at quadrature points over columns. Collective, as all methods are.

    Attributes:
        count: number of columns on all ranks.
        column_of: (points,) number of the column of each point of this rank.
    """

    def __init__(self, comm: MPI.Intracomm, of: IntArray, count: int, weights: Array) -> None:
        self.comm, self.column_of, self.count, self._weights = comm, of, count, weights
        self._total = self.sum_of(weights)

    def sum_of(self, values: Array) -> Array:
        """Sums (count,) over each column of values (points,), the same on all ranks."""
        # np.bincount gives integers if there are no points
        sums: Array = np.bincount(self.column_of, values, self.count).astype(float)
        self.comm.Allreduce(MPI.IN_PLACE, sums)
        return sums

    def mean(self, values: Array) -> Array:
        """Means (count,) over each column of values (points,), by quadrature weights, the same on all ranks."""
        return self.sum_of(self._weights * values) / self._total


@runtime_checkable
class SwitchingLaw(Protocol):
    """Methods that a law with pure phases must have, each for n columns of a layer.

    Their arguments are the law's `switching_variables`, (n,) each: the phase; the driving force, an energy per volume;
    and its bound, the energy of the transformation.
    """

    def excess(self, phase: Array, drive: Array, bound: Array) -> Array:
        """Energies (n,) of the phases minus the least energy of other phases, over `bound`; columns switch if > 0."""

    def switched(self, phase: Array, drive: Array, bound: Array) -> Array:
        """Phases (n,) of lowest energy."""


class Switching:
    """Phases of a layer's columns, read from and changed in the internal variables of a law with pure phases.

    Args:
        law: the law.
        columns: the columns of the quadrature points; None: each point has a phase of its own.

    Raises:
        InputError: the law lacks the methods of `SwitchingLaw`.
    """

    def __init__(self, law: BulkLaw, columns: Columns | None = None) -> None:
        if not isinstance(law, SwitchingLaw):
            raise InputError(f"{type(law).__name__} switches phases; write its methods excess and switched too")
        self.law, self.columns, names = law, columns, list(law.internal)
        self._variable_columns = [names.index(name) for name in law.switching_variables]

    def _column_values(self, memory: Array) -> list[Array]:
        values = [memory[:, slot] for slot in self._variable_columns]
        if not self.columns:
            return values
        phase, drive, bound = map(self.columns.mean, values)
        return [np.rint(phase), drive, bound]  # a mean of equal numbers has rounding errors

    def excess(self, memory: Array) -> float:
        """Largest energy that a column would lose by a change of phase, over the energy of the transformation.

        Collective, with the same result on all ranks; > 0 if a column must switch.

        Args:
            memory: (points, values) internal variables.
        """
        return float(self.law.excess(*self._column_values(memory)).max(initial=-np.inf))

    def switched(self, memory: Array, old: Array) -> Array | None:
        """Copy of the internal variables `old` with the phases of lowest energy. Collective.

        None: no column changes its phase.

        Args:
            memory: (points, values) internal variables at the equilibrium with fixed phases.
            old: (points, values) internal variables at the beginning of the step, with the same phases.
        """
        values = self._column_values(memory)
        phases = np.where(self.law.excess(*values) > EXCESS_TOLERANCE, self.law.switched(*values), values[0])
        if (phases == values[0]).all():
            return None
        new = old.copy()
        new[:, self._variable_columns[0]] = phases[self.columns.column_of] if self.columns else phases
        return new
