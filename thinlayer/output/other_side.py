"""The other side of S between two bodies: values at the same places there."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from forms.interface import Interface
from thinlayer.output.surface_mass import assembled

Array = npt.NDArray[np.float64]


class OtherSide:
    """Values of functions of degree 1, broken across S, at the same places on the other side. All methods are collective.

    Integrals over S by the quadrature rule whose points are the corners of facets have, at a node, only the value at the
    same place on the other side.

    Args:
        V: space of the functions.
        sides: the two sides of S, both of them bodies.
    """

    def __init__(self, V: fem.FunctionSpace, sides: Interface) -> None:
        self._V, self._sides = V, sides

    def of(self, f: fem.Function) -> Array:
        """Values of a function at the same places on the other side of S; zero elsewhere."""
        return np.divide(self._exchanged(f), self.areas, out=np.zeros_like(self.areas), where=self.areas > 0)

    @cached_property
    def areas(self) -> Array:
        """Areas of S around the nodes that have another side, by the rule that takes corners alone; zero elsewhere."""
        ones = fem.Function(self._V)
        ones.x.array[:] = 1.0
        return self._exchanged(ones)

    def _exchanged(self, f: fem.Function) -> Array:
        """Integrals over S of the other side's values."""
        values, form = self._exchange
        values.x.array[:] = f.x.array
        return np.asarray(assembled(self._V, form).x.array)

    @cached_property
    def _exchange(self) -> tuple[fem.Function, fem.Form]:
        """A function, and the form of its values that `_exchanged` assembles."""
        f, v = fem.Function(self._V), ufl.TestFunction(self._V)
        measure = self._sides.measure(metadata={"quadrature_rule": "vertex", "quadrature_degree": 1})
        return f, fem.form((ufl.inner(f("+"), v("-")) + ufl.inner(f("-"), v("+"))) * measure)
