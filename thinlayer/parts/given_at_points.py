"""The strain that a term is given beside that of displacements, at the points of a compiled law."""

from __future__ import annotations

import numpy as np

from thinlayer.discretisation.given import OverStep
from thinlayer.pointwise.compiled_term import CompiledTerm
from thinlayer.pointwise.kernels import Array


class GivenAtPoints:
    """The given strain of a compiled term, at any time. Collective.

    Args:
        points: the compiled term.
    """

    def __init__(self, points: CompiledTerm) -> None:
        self._points, given = points, points.term.given
        self._over = OverStep() if given is None else OverStep(given)
        self._form = None if given is None else points.form_of(self._over.now(given))

    def __call__(self, t: float) -> Array:
        """Strains (points, m) at a time."""
        points = self._points
        if self._form is None:
            return np.zeros((points.count, len(points.slots)))
        self._over.look_at(t)
        return points.values_of(self._form)
