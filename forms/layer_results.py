"""What results show of a law in a layer: a word for its status at a point, and fractions of changed material."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from forms.base import Array
from forms.tensors import Expr
from forms.traits import Traits

if TYPE_CHECKING:
    from forms.law import Step

ELASTIC, SLIDING, CRUSHED, TORN, OPEN = "elastic", "sliding", "crushed", "torn", "open"
YIELD_STATUSES = (ELASTIC, SLIDING, CRUSHED, TORN, OPEN)
# traction or plastic strain, over the largest traction or strain of a layer, that counts as zero
NEGLIGIBLE_FRACTION = 1e-6


class LayerPoints(NamedTuple):
    """Values at points of a layer on S from which a law determines its status there.

    Attributes:
        internal: name of an internal variable of the law -> values, (points, ...) with the variable's shape.
        plastic: plastic strains (points, 3, 3); for a Stack their mean over the sublayers.
        traction: tractions (points, 3), stress times n.
        n: unit normals (points, 3) of S.
        opening: normal jumps (points,), lengths; > 0 if S opens.
        largest_traction: largest absolute component of the tractions in the layer.
        largest_strain: the same of the jumps, divided by the thickness if the layer has one.
    """

    internal: Mapping[str, Array]
    plastic: Array
    traction: Array
    n: Array
    opening: Array
    largest_traction: float
    largest_strain: float


class LayerResults:
    """Base of laws that defines what results show of a law in a layer: statuses and fractions of changed material.

    A law may override these methods.
    """

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
        """Return a word for the status of the law at each of several points on S, (points,).

        By default a point without normal traction is "open" if the jump opens it. One without plastic strain is
        "elastic". Otherwise the plastic strain makes it "sliding" (mostly shear), "crushed" (shortening) or "torn"
        (lengthening along n). In a Stack the first sublayer that is not elastic gives the status.

        Args:
            points: values at the points.
        """
        plastic_vector = np.einsum("pij,pj->pi", points.plastic, points.n)
        t_N, closure = ((vector * points.n).sum(axis=1) for vector in (points.traction, -plastic_vector))
        slip = 2 * np.linalg.norm(plastic_vector + closure[:, None] * points.n, axis=1)
        is_open = (points.opening > 0) & (np.abs(t_N) <= NEGLIGIBLE_FRACTION * points.largest_traction)
        is_elastic = np.maximum(slip, np.abs(closure)) <= NEGLIGIBLE_FRACTION * points.largest_strain
        masks = {OPEN: is_open, ELASTIC: is_elastic, SLIDING: slip >= np.abs(closure), CRUSHED: closure > 0}
        return np.select([*masks.values()], [*masks], TORN)

    def plastic_strain(self, internal: Mapping[str, Array]) -> Array | None:
        """Return the plastic strains (points, 3, 3) at several points; None: the law has no plastic strain.

        By default they are the internal variable "plastic", if this has the shape (3, 3).

        Args:
            internal: name of an internal variable -> values, (points, ...) with the variable's shape.
        """
        return internal.get("plastic") if self.internal.get("plastic") == (3, 3) else None

    # ---------------------------------------------------------------- modes of fracture
    @property
    def has_modes(self) -> bool:
        """Whether the law has energies of modes I and II, `mode_energies`."""
        return False

    def mode_energies(self, step: Step) -> tuple[Expr, Expr]:
        """Return the energies Y_I and Y_II that damage releases in opening and in shear, UFL, at the end of a step."""
        raise NotImplementedError

    # ---------------------------------------------------------------- shares of material
    @property
    def share_columns(self) -> tuple[str, ...]:
        """Names of the numbers that `mean_shares` returns, which are columns in the table of a march.

        (): the law has no phases or damage to show.
        """
        return ("plus", "minus", "boundary") if self.traits.phases and not self.traits.of_jumps else ()

    def shares(self, internal: Mapping[str, Array]) -> dict[str, Array]:
        """Return fractions (points,) of the material at several points that are in other phases, or broken, by name.

        By default they are "plus" and "minus", the fractions in the phases 1 and -1.

        Args:
            internal: name of an internal variable -> values, (points, ...) with the variable's shape.
        """
        return {"plus": np.maximum(internal["phase"], 0), "minus": np.maximum(-internal["phase"], 0)}

    def mean_shares(self, totals: Mapping[str, float], whole: float, eps: float, fraction: float) -> dict[str, float]:
        """Return the numbers of a whole layer that a march lists in the columns `share_columns`.

        By default they are the means of the fractions in `shares`. For a law with phases "boundary" is added, the mean
        thickness of the material in phase 0, a length.

        Args:
            totals: name of a fraction in `shares` -> its integral over the layer, or over some of its sublayers.
            whole: integral of 1 over the same domain.
            eps: thickness of the layer; 0 if it has none.
            fraction: part, from 0 to 1, of the thickness that the domain of the integrals takes; 1 for the whole layer.
        """
        means = {name: total / whole for name, total in totals.items()}
        if self.traits.phases:
            means["boundary"] = max(1 - (totals["plus"] + totals["minus"]) / whole, 0.0) * eps * fraction
        return means
