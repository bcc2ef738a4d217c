"""Tensors that users give for a body or a layer: numbers, tables and functions as components, checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.conditional import Condition

from forms.base import is_finite, is_number
from forms.law import BulkLaw
from forms.planes import Kinematics
from thinlayer.discretisation.loads import Coordinates, called, has_finite_numbers
from thinlayer.errors import ModelError

Array = npt.NDArray[np.float64]
Rows = list[list[Any]]  # numbers, or UFL scalars of place and time
SYMMETRY = 1e-12  # difference of a table from its transpose, at most, over its size


@dataclass(frozen=True)
class Matter:
    """A body or a layer, as far as its eigenstrain depends on it.

    Attributes:
        name: for messages.
        law: its law, with real parameters, for these kinematics.
        n: the mean normal of S, (d,).
        kinematics: strains of displacements.
        at: coordinates and time.
    """

    name: str
    law: BulkLaw
    n: Array
    kinematics: Kinematics
    at: Coordinates

    def rows(self, value: Any, what: str) -> Rows:
        """The components of a tensor, (d, d) or (3, 3): of a number times the identity, of a table, or of a function.

        Raises:
            ModelError: another shape, components that are no finite numbers, or a table that is not symmetric.
        """
        what, d = f"{what} of {self.name}", len(self.n)
        found = called(value, self.at, what) if callable(value) else value
        if is_number(found) or getattr(found, "ufl_shape", None) == ():
            one = component(found, what)
            return [[one if i == j else 0.0 for j in range(3)] for i in range(3)]
        try:
            k = found.ufl_shape[0] if hasattr(found, "ufl_shape") else len(found)
            whole = k in (d, 3) and all(len(found[i]) == k for i in range(k))
        except Exception:  # whatever a user gives
            whole = False
        if not whole:
            shapes = "(3, 3)" if d == 3 else "(2, 2) or (3, 3)"
            raise ModelError(
                f"{what} is {found!r}; it needs a number, a symmetric table {shapes}, or a function of one"
            )
        rows = [[component(found[i][j], what) for j in range(k)] for i in range(k)]
        require_symmetric(rows, what)
        return rows


def component(value: Any, what: str) -> Any:
    """A component, a finite number or a UFL scalar; raises ModelError if it is none."""
    if is_number(value):
        if not is_finite(value):
            raise ModelError(f"{what} has a component {value!r}; it needs finite numbers")
        return float(value)
    try:
        found = ufl.as_ufl(value)
        fits = found.ufl_shape == () and not isinstance(found, Condition) and not isinstance(value, (bool, np.bool_))
    except Exception:  # UFL's, for anything that is no expression
        fits = False
    if not fits or not has_finite_numbers(found):
        raise ModelError(f"{what} has a component {value!r}; it needs finite numbers, or UFL scalars of x and t")
    return found


def require_symmetric(rows: Rows, what: str) -> None:
    """Raise ModelError if a table is not symmetric; UFL expressions are compared as they are written."""
    numbers = [abs(c) for row in rows for c in row if isinstance(c, float)]
    for i in range(len(rows)):
        for j in range(i):
            a, b = rows[i][j], rows[j][i]
            both = isinstance(a, float) and isinstance(b, float)
            same = abs(a - b) <= SYMMETRY * max(numbers) if both else ufl.as_ufl(a) == ufl.as_ufl(b)
            if not same:
                raise ModelError(
                    f"{what} is not symmetric: its components {i + 1}{j + 1} and {j + 1}{i + 1} are {a}, {b}"
                )


def lifted(rows: Rows) -> Rows:
    """A table (d, d) with zeros added to (3, 3)."""
    k = len(rows)
    return [[rows[i][j] if max(i, j) < k else 0.0 for j in range(3)] for i in range(3)]
