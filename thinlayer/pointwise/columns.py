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
    """Columns of a layer, with sums and means over each column of values at quadrature points.

    A column is a facet of S or, in the meshed layer, the cells above each other through the thickness. All methods are
    collective.

    Attributes:
        n_columns: number of columns on all ranks.
        column_of: (points,) number of the column of each point of this rank.
    """

    def __init__(self, comm: MPI.Intracomm, column_of: IntArray, n_columns: int, weights: Array) -> None:
        self.comm, self.column_of, self.n_columns, self._weights = comm, column_of, n_columns, weights
        self._column_weights = self.column_sums(weights)

    def column_sums(self, values: Array) -> Array:
        """Return the sum of `values` (points,) over the points of each column, as an array (n_columns,).

        The result is the same on all ranks.
        """
        # np.bincount gives integers if there are no points
        sums: Array = np.bincount(self.column_of, values, self.n_columns).astype(float)
        self.comm.Allreduce(MPI.IN_PLACE, sums)
        return sums

    def column_means(self, values: Array) -> Array:
        """Return the mean of `values` (points,) over the points of each column, as an array (n_columns,).

        Points have the weights of the quadrature rule. The result is the same on all ranks.
        """
        return self.column_sums(self._weights * values) / self._column_weights


@runtime_checkable
class SwitchingLaw(Protocol):
    """Methods of a law whose points are in one of several pure phases, which may switch.

    The arguments of both methods are arrays (n,), one number for each of n columns of a layer:

    - phase: the present phase, such as -1, 0 or 1.
    - drive: driving force, an energy per volume.
    - bound: energy per volume of the transformation, with which the driving force is compared.
    """

    def excess(self, phase: Array, drive: Array, bound: Array) -> Array:
        """Return (n,) for each column the energy of its phase minus the least energy of the others, divided by `bound`.

        The numbers have no unit. A column with a positive number switches its phase.

        Args:
            phase: (n,) present phases.
            drive: (n,) driving forces, energies per volume.
            bound: (n,) energies of the transformation per volume.
        """

    def switched(self, phase: Array, drive: Array, bound: Array) -> Array:
        """Return (n,) for each column the phase of lowest energy; the arguments are those of `excess`."""


class Switching:
    """Phases of a layer's columns, read from and changed in the internal variables of a law with pure phases.

    Args:
        law: the law; it has the methods of `SwitchingLaw`.
        columns: the columns, with the number of the column of each quadrature point; None: each point is a column.

    Raises:
        InputError: the law lacks the methods of `SwitchingLaw`.
    """

    def __init__(self, law: BulkLaw, columns: Columns | None = None) -> None:
        if not isinstance(law, SwitchingLaw):
            raise InputError(f"{type(law).__name__} switches phases; write its methods excess and switched too")
        self.law, self.columns, names = law, columns, list(law.internal)
        self._variable_positions = [names.index(name) for name in law.switching_variables]

    def _column_values(self, memory: Array) -> list[Array]:
        values = [memory[:, position] for position in self._variable_positions]
        if not self.columns:
            return values
        phase, drive, bound = map(self.columns.column_means, values)
        return [np.rint(phase), drive, bound]  # a mean of equal numbers has rounding errors

    def phase_gain(self, memory: Array) -> float:
        """Return the largest energy that a column would lose by changing phase, divided by the transformation energy.

        The transformation energy is a parameter of the law. If the result is positive, a column must switch. The result
        is the same on all ranks. Collective.

        Args:
            memory: (points, values) internal variables.
        """
        return float(self.law.excess(*self._column_values(memory)).max(initial=-np.inf))

    def switched(self, memory: Array, old: Array) -> Array | None:
        """Return a copy of the internal variables `old` in which all columns have phases of lowest energy. Collective.

        Args:
            memory: (points, values) internal variables at an equilibrium that was computed with fixed phases.
            old: (points, values) internal variables at the beginning of the step, with the same phases.

        Returns:
            The copy (points, values). None: no column changes its phase.
        """
        values = self._column_values(memory)
        phases = np.where(self.law.excess(*values) > EXCESS_TOLERANCE, self.law.switched(*values), values[0])
        if (phases == values[0]).all():
            return None
        new_memory = old.copy()
        new_memory[:, self._variable_positions[0]] = phases[self.columns.column_of] if self.columns else phases
        return new_memory
