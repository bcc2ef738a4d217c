"""Mean strain or mean stress of a periodic cell, which loads it; bodies see the strain beside that of the displacements."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import ufl

from forms.kinematics import Expr, lift
from forms.work import Term
from geometry.joint import Joint
from thinlayer.discretisation.given import Coordinates
from thinlayer.errors import ModelError

MEAN_STRAIN = "mean strain"  # key of the mean strain under a mean stress, in the fields of states
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

    what: ClassVar[str] = "the mean strain"

    def __init__(self, given: Strain, at: Coordinates, joint: Joint) -> None:
        if joint.periods is None:
            raise ModelError(f"{self.what} is for a periodic cell, and this joint is none; see geometry.periodic")
        self._dim, d = joint.dim, joint.dim
        self._given = at.given(given, self.what, (d, d)).once("the whole cell")
        self.size = float(np.ptp(joint.points, axis=0).max())
        if not self._given.varies:
            self.at(0.0)

    def at(self, t: float) -> Array:
        """The strain (d, d) at a time; raises ModelError if it is not finite or not symmetric."""
        strain = self._given.at_time(t)
        if np.abs(strain - strain.T).max() > SYMMETRY * np.abs(strain).max():
            raise ModelError(f"{self.what} is not symmetric at t = {t:g}: {strain.tolist()}")
        return strain

    @property
    def expression(self) -> Expr:
        """The strain (3, 3) as an expression of the time."""
        return lift(self._given.expression)


class MeanStress(MeanStrain):
    """A mean stress as a function of time; the mean strain is then unknown. Arguments and errors as in `MeanStrain`.

    Raises:
        ModelError: sides of the cell are free, or bodies are not linear.
    """

    what = "the mean stress"

    def __init__(self, given: Strain, at: Coordinates, joint: Joint, bodies: Sequence[Term]) -> None:
        super().__init__(given, at, joint)
        d = joint.dim
        assert joint.periods is not None
        if np.linalg.matrix_rank(joint.periods.vectors(joint.points)) < d:
            raise ModelError(
                f"a mean stress needs a joint that is periodic in {d} directions; load free sides by tractions"
            )
        for p in bodies:
            if not p.proportional:
                raise ModelError(
                    f"a mean stress needs bodies with linear laws without stress at zero strain, not {p.law!r}; prescribe "
                    "the mean strain"
                )

    @property
    def count(self) -> int:
        """Number of components."""
        return self._dim * (self._dim + 1) // 2

    def components(self, t: float) -> Array:
        """The stress at a time, (k,) in the order of `of_components`."""
        return self.at(t)[tuple(np.array(PAIRS[self._dim]).T)]


PAIRS = {2: ((0, 0), (1, 1), (0, 1)), 3: ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))}  # Voigt's order


def of_components(e: Expr) -> Expr:
    """The strain (d, d) of a UFL vector in Voigt's order, shears twice."""
    d = {3: 2, 6: 3}[e.ufl_shape[0]]
    place = {pair: k for k, pair in enumerate(PAIRS[d])}
    return ufl.as_tensor([[e[place[min(i, j), max(i, j)]] / (1 if i == j else 2) for j in range(d)] for i in range(d)])
