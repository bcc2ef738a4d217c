"""What tables, pictures and files say of a law at its points in a layer: its status, a word, and shares of material."""

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
    """Points of a law in a layer on S, from which it gives their status.

    Attributes:
        internal: internal variables of the law by name, (points, *shape).
        plastic: (points, 3, 3) plastic strain, of a Stack the mean of its sublayers.
        traction: (points, 3) stress n.
        n: (points, 3) unit normals of S.
        opening: (points,) [u] . n.
        largest_traction: largest traction of the layer.
        largest_strain: largest jump of the layer over its thickness, or the jump if it has none.
    """

    internal: Mapping[str, Array]
    plastic: Array
    traction: Array
    n: Array
    opening: Array
    largest_traction: float
    largest_strain: float


class LayerResults:
    """Base of laws: the words and numbers that results show of a law, which a law may define otherwise."""

    if TYPE_CHECKING:  # defined by `forms.law.Law`
        internal: ClassVar[Mapping[str, tuple[int, ...]]]

        @property
        def traits(self) -> Traits:
            """Traits of the law."""

    # ---------------------------------------------------------------- status
    @property
    def statuses(self) -> tuple[str, ...]:
        """Words that `status_at` may give, "elastic" first."""
        return YIELD_STATUSES if self.internal.get("plastic") == (3, 3) else (ELASTIC,)

    def status_at(self, points: LayerPoints) -> npt.NDArray[np.str_]:
        """Status (points,) of a layer with this law, by default from traction, opening and plastic strain.

        In a Stack the first sublayer that is not elastic gives the status.
        """
        flow = np.einsum("pij,pj->pi", points.plastic, points.n)
        t_N, closed = ((vector * points.n).sum(axis=1) for vector in (points.traction, -flow))
        slip = 2 * np.linalg.norm(flow + closed[:, None] * points.n, axis=1)
        free = (points.opening > 0) & (np.abs(t_N) <= ZERO_TRACTION_SHARE * points.largest_traction)
        still = np.maximum(slip, np.abs(closed)) <= ZERO_TRACTION_SHARE * points.largest_strain
        kinds = {OPEN: free, ELASTIC: still, SLIDING: slip >= np.abs(closed), CRUSHED: closed > 0}
        return np.select([*kinds.values()], [*kinds], TORN)

    def plastic_strain(self, internal: Mapping[str, Array]) -> Array | None:
        """Plastic strain (points, 3, 3): by default the internal variable "plastic" of this shape; None: there is none.

        Args:
            internal: internal variables by name, (points, *shape).
        """
        return internal.get("plastic") if self.internal.get("plastic") == (3, 3) else None

    # ---------------------------------------------------------------- shares of material
    @property
    def share_columns(self) -> tuple[str, ...]:
        """Names of the numbers that `mean_shares` gives, columns of marches; () if the material does not change."""
        return ("plus", "minus", "boundary") if self.traits.phases and not self.traits.of_jumps else ()

    def shares(self, internal: Mapping[str, Array]) -> dict[str, Array]:
        """Shares (points,) of the material that are in another state, by name: by default in phases 1 and -1.

        Args:
            internal: internal variables by name, (points, *shape).
        """
        return {"plus": np.maximum(internal["phase"], 0), "minus": np.maximum(-internal["phase"], 0)}

    def mean_shares(self, totals: Mapping[str, float], whole: float, eps: float, fraction: float) -> dict[str, float]:
        """Numbers of a layer by the names of `share_columns`: by default means of shares, and the thickness of phase 0.

        Args:
            totals: integrals of the `shares`.
            whole: the same integral of 1.
            eps: thickness of the layer; 0 if it has none.
            fraction: share of the thickness that has such laws.
        """
        means = {name: total / whole for name, total in totals.items()}
        if self.traits.phases:
            means["boundary"] = max(1 - (totals["plus"] + totals["minus"]) / whole, 0.0) * eps * fraction
        return means
