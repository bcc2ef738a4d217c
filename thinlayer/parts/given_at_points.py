"""The strain that a term is given beside that of displacements, at the points of a compiled law."""

from __future__ import annotations

import numpy as np

from thinlayer.discretisation.given import OverStep
from thinlayer.discretisation.state import Configuration
from thinlayer.pointwise.compiled_term import CompiledTerm
from thinlayer.pointwise.kernels import Array


class GivenAtPoints:
    """The given strain of a compiled term, at any time. Collective.

    Args:
        points: the compiled term.
    """

    def __init__(self, points: CompiledTerm) -> None:
        self._points, given = points, points.term.given
        self._over = OverStep(points.region.parent_mesh, [points.term])
        self._form = None if given is None else points.form_of(self._over.now(given))

    def __call__(self, t: float) -> Array:
        """Strains (points, m) at a time."""
        points = self._points
        if self._form is None:
            return np.zeros((points.count, len(points.slots)))
        self._over.look_at(t)
        return points.values_of(self._form)

    def before(self, old: Configuration) -> Array:
        """Strains (points, m) from which a step starts: none at rest.

        Laws with rate do not answer to sudden strains: what is given at the start has always been there.
        """
        rate = self._points.term.law.traits.rate
        return np.zeros((self._points.count, len(self._points.slots))) if old.at_rest and not rate else self(old.t)
