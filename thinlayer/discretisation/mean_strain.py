"""The mean strain of a periodic cell, which loads it: bodies see it beside the strain of the displacements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.corealg.traversal import unique_pre_traversal

from forms.kinematics import Expr, lift
from forms.work import Term
from geometry.joint import Joint
from thinlayer.discretisation.loads import Coordinates, called
from thinlayer.errors import ModelError

Array = npt.NDArray[np.float64]
Strain = Sequence[Sequence[float]] | Array | Callable[[Expr, Any], Sequence[Sequence[Any]]]
SYMMETRY = 1e-12  # difference of a strain from its transpose, at most, over its size


class MeanStrain:
    """A mean strain as a function of time.

    Args:
        given: (d, d) symmetric numbers, or a function (x, t) that returns them and does not depend on x.
        at: coordinates and time.
        joint: the periodic joint.

    Attributes:
        size: largest extent of the cell along an axis.

    Raises:
        ModelError: the joint is not periodic; not (d, d) finite numbers, not symmetric, or depending on the place.
    """

    def __init__(self, given: Strain, at: Coordinates, joint: Joint) -> None:
        if joint.periods is None:
            raise ModelError("a mean strain loads a periodic cell, and this joint is none; see geometry.periodic")
        self.given, self._coordinates, self._dim = given, at, joint.dim
        self.size = float(np.ptp(joint.points, axis=0).max())
        if callable(given):
            found = self._components(at.t)
            for node in (node for row in found for c in row for node in unique_pre_traversal(ufl.as_ufl(c))):
                if isinstance(node, ufl.SpatialCoordinate):
                    raise ModelError("the mean strain depends on the place x; it is one strain for the whole cell")
        else:
            self.at(0.0)

    def _components(self, t: Any) -> Any:
        """Rows of the strain at a time, a number or the symbol."""
        found = called(self.given, self._coordinates, "the mean strain", t) if callable(self.given) else self.given
        d = self._dim
        try:
            whole = len(found) == d and all(len(row) == d for row in found)
        except TypeError:
            whole = False
        if not whole:
            raise ModelError(
                f"the mean strain is {found!r}; it needs {d} x {d} components, ((e_xx, e_xy), (e_xy, e_yy))"
            )
        return found

    def at(self, t: float) -> Array:
        """The strain (d, d) at a time; raises ModelError if it is not finite or not symmetric."""
        try:
            strain = np.array([[float(c) for c in row] for row in self._components(t)])
        except (TypeError, ValueError, ArithmeticError) as error:
            raise ModelError(f"the mean strain at t = {t:g} is no table of numbers: {error}") from error
        if not np.isfinite(strain).all():
            raise ModelError(f"the mean strain is not finite at t = {t:g}: {strain.tolist()}")
        if np.abs(strain - strain.T).max() > SYMMETRY * np.abs(strain).max():
            raise ModelError(f"the mean strain is not symmetric at t = {t:g}: {strain.tolist()}")
        return strain

    def constant(self, value: Array | None = None) -> fem.Constant:
        """A constant (d, d) on the mesh."""
        return fem.Constant(self._coordinates.mesh, np.zeros((self._dim, self._dim)) if value is None else value)

    @staticmethod
    def added(terms: Sequence[Term], E: fem.Constant) -> list[Term]:
        """The terms, those of bodies with a mean strain."""
        return [replace(p, mean=lift(E)) if p.n is None else p for p in terms]
