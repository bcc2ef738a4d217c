"""Results that tables, pictures and files show of a law in a layer: its status, a word, and fractions of material."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from forms.base import Array

if TYPE_CHECKING:
    from forms.traits import Traits

ELASTIC, SLIDING, CRUSHED, TORN, OPEN = "elastic", "sliding", "crushed", "torn", "open"
YIELD_STATUSES = (ELASTIC, SLIDING, CRUSHED, TORN, OPEN)
# traction or plastic strain, over the largest traction or strain of a layer, that counts as zero
ZERO_TRACTION_SHARE = 1e-6


class LayerPoints(NamedTuple):
    """Values at points of a layer on S from which a law computes its status there.

    Attributes:
        internal: internal variables of the law by name, (points, *shape).
        plastic: (points, 3, 3) plastic strain, of a Stack the mean of its sublayers.
        traction: (points, 3) traction, stress times n.
        n: (points, 3) unit normals of S.
        opening: (points,) normal jump [u] . n.
        largest_traction: largest traction of the layer.
        largest_strain: largest jump of the layer over its thickness; without a thickness, the largest jump.
    """

    internal: Mapping[str, Array]
    plastic: Array
    traction: Array
    n: Array
    opening: Array
    largest_traction: float
    largest_strain: float


class LayerResults:
    """Base of laws with the words and numbers that results show of a law; a law may define them otherwise."""

    if TYPE_CHECKING:  # defined by `forms.law.Law`
        internal: ClassVar[Mapping[str, tuple[int, ...]]]

        @property
        def traits(self) -> Traits:
            """Traits of the law."""

    # ---------------------------------------------------------------- status
    @property
    def statuses(self) -> tuple[str, ...]:
        """Words that `status_at` may return, with "elastic" first."""
        return YIELD_STATUSES if self.internal.get("plastic") == (3, 3) else (ELASTIC,)

    def status_at(self, points: LayerPoints) -> npt.NDArray[np.str_]:
        """Status (points,), a word, of a layer with this law at points on S.

        By default it follows from traction, opening and plastic strain. In a Stack the first sublayer that is not
        elastic gives the status.
        """
        flow = np.einsum("pij,pj->pi", points.plastic, points.n)
        t_N, closure = ((vector * points.n).sum(axis=1) for vector in (points.traction, -flow))
        slip = 2 * np.linalg.norm(flow + closure[:, None] * points.n, axis=1)
        is_open = (points.opening > 0) & (np.abs(t_N) <= ZERO_TRACTION_SHARE * points.largest_traction)
        is_elastic = np.maximum(slip, np.abs(closure)) <= ZERO_TRACTION_SHARE * points.largest_strain
        masks = {OPEN: is_open, ELASTIC: is_elastic, SLIDING: slip >= np.abs(closure), CRUSHED: closure > 0}
        return np.select([*masks.values()], [*masks], TORN)

    def plastic_strain(self, internal: Mapping[str, Array]) -> Array | None:
        """Plastic strain (points, 3, 3), by default the internal variable "plastic" if it has the shape (3, 3).

        None: the law has no plastic strain.

        Args:
            internal: internal variables by name, (points, *shape).
        """
        return internal.get("plastic") if self.internal.get("plastic") == (3, 3) else None

    # ---------------------------------------------------------------- shares of material
    @property
    def share_columns(self) -> tuple[str, ...]:
        """Names of the numbers that `mean_shares` returns, columns of the table of a march.

        (): the material of the law does not change.
        """
        return ("plus", "minus", "boundary") if self.traits.phases and not self.traits.of_jumps else ()

    def shares(self, internal: Mapping[str, Array]) -> dict[str, Array]:
        """Fractions (points,) of the material that have changed, by name.

        By default they are "plus" and "minus", the fractions in the phases 1 and -1.

        Args:
            internal: internal variables by name, (points, *shape).
        """
        return {"plus": np.maximum(internal["phase"], 0), "minus": np.maximum(-internal["phase"], 0)}

    def mean_shares(self, totals: Mapping[str, float], whole: float, eps: float, fraction: float) -> dict[str, float]:
        """Numbers of a whole layer, with the names in `share_columns`.

        By default they are the means of `shares` and, for a law with phases, the thickness of the material in phase 0
        ("boundary").

        Args:
            totals: integrals of the fractions that `shares` returns over the layer, by name.
            whole: integral of 1 over the layer.
            eps: thickness of the layer; 0 if it has none.
            fraction: fraction of the layer's thickness taken by the sublayers over which `totals` are integrals; 1
                without sublayers.
        """
        means = {name: total / whole for name, total in totals.items()}
        if self.traits.phases:
            means["boundary"] = max(1 - (totals["plus"] + totals["minus"]) / whole, 0.0) * eps * fraction
        return means
