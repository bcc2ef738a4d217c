"""Seam: the choice of the upper side of a layer's surface; and the names that joints give to parts of layers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from forms.base import InputError
from forms.temperature import finite_values
from geometry.refusals import refuse, require_known
from geometry.topology import BoolArray, FloatArray, IntArray

S = "S"
LAYER = "LAYER"
JUNCTIONS = "JUNCTIONS"  # part of the layer where three or more layers or bodies meet
LOWER_FACE, UPPER_FACE, BASE = "LOWER_FACE", "UPPER_FACE", "BASE"
RESERVED_NAMES = (LAYER, LOWER_FACE, UPPER_FACE, BASE, JUNCTIONS)
MIN_COSINE = 0.02  # least cosine of the angle between a facet's normal and a direction that determines its upper side


class FacetName(NamedTuple):
    """Name of a facet set, as text "NAME" or "NAME/REGION". Tags, supports and loads have the texts.

    Attributes:
        whole: name of the set that users or builders named, or of a seam.
        region: region whose part of the set it is, `LAYER` for the side faces of the layer that continue the set, or
            the face of a seam's layer; "": all.
    """

    whole: str
    region: str = ""

    @classmethod
    def parse(cls, text: str) -> FacetName:
        """Return the name with a text."""
        return cls(*text.split("/", 1))

    def __str__(self) -> str:
        return f"{self.whole}/{self.region}" if self.region else self.whole

    @property
    def continued(self) -> str:
        """Text of the name of the set that these side faces of a layer continue; of other sets their own."""
        return self.whole if self.region == LAYER else str(self)


@dataclass(frozen=True)
class Seam:
    """Choice of the upper side of a layer's surface. The normal n points from the lower to the upper side.

    The upper side of a facet between two cells is where `direction` points, unless this is None. Else it is in the
    regions `upper`, or outside the regions `lower`. Without any of these it is in the later of the two cells' regions.
    On the outer boundary the layer stands on a rigid base, and the cell is on the upper side.

    The choice is a convention: jumps, tractions and the order of sublayers refer to it, equilibria do not depend on it.

    Attributes:
        lower, upper: names of regions on either side; (): not specified.
        direction: (d,) vector to the upper side; None: not specified.
    """

    lower: tuple[str, ...] = ()
    upper: tuple[str, ...] = ()
    direction: tuple[float, ...] | None = None

    def reversed(self) -> Seam:
        """The seam with the opposite normal. Raise InputError if it specifies neither regions nor a direction."""
        if self == Seam():
            raise InputError("a seam whose sides follow the order of regions cannot be reversed; name its sides")
        return Seam(self.upper, self.lower, None if self.direction is None else tuple(-c for c in self.direction))

    def turned(self, turn: FloatArray) -> Seam:
        """The seam after the joint is rotated by a matrix (d, d)."""
        return self if self.direction is None else replace(self, direction=tuple(map(float, turn @ self.direction)))

    def check(self, name: str, regions: Sequence[str], dim: int) -> None:
        """Raise InputError unless the seam determines its upper side in a mesh with these regions."""
        for region in self.lower + self.upper:
            require_known("region", region, regions)
        shared = sorted(set(self.upper) & set(self.lower))
        if shared and self.direction is None:
            raise InputError(f"region {shared[0]!r} is on both sides of {name!r}; give the direction upwards")
        if self.direction is not None:
            if set(self.upper) != set(self.lower):
                raise InputError(f"{name!r}: a direction tells the upper side, or regions do; give one of them")
            if finite_values(self.direction, (dim,)) is None or not np.any(self.direction):
                raise InputError(f"direction is {self.direction}; it needs {dim} components, not all zero")

    def along_direction(self, name: str, x: FloatArray, normals: FloatArray, to_second: FloatArray) -> BoolArray:
        """(n,) whether the second of the two cells at each of n facets is on the upper side, by `direction`.

        Args:
            name: name of the seam, for messages.
            x: (n, d) middles of the facets.
            normals: (n, d) normals of the facets, in either direction.
            to_second: (n, d) vectors from the middles into the second cells.

        Raises:
            InputError: the direction lies in a facet.
        """
        way = np.asarray(self.direction, float)
        cosine = normals @ way / np.linalg.norm(normals, axis=1) / np.linalg.norm(way)
        refuse(np.abs(cosine) < MIN_COSINE, x, f"direction {self.direction} of {name!r} lies in the facet near {{at}}")
        return np.asarray((to_second * normals).sum(axis=1) * cosine > 0)

    def between_regions(self, name: str, x: FloatArray, region: IntArray, regions: Sequence[str]) -> BoolArray:
        """(n,) whether the second of the two cells at each of n facets is on the upper side, by the cells' regions.

        Args:
            name: name of the seam, for messages.
            x: (n, d) middles of the facets.
            region: (n, 2) positions of the regions of both cells in `regions`.
            regions: names of all regions.

        Raises:
            InputError: both cells are on one side.
        """
        if self.lower or self.upper:
            lower, upper = (np.isin(region, [regions.index(key) for key in side]) for side in (self.lower, self.upper))
            below, above = lower if self.lower else ~upper, upper if self.upper else ~lower
            second, first = above[:, 1] & below[:, 0], above[:, 0] & below[:, 1]
            what = "have the same body on both sides"
        else:
            second, first = region[:, 1] > region[:, 0], region[:, 1] < region[:, 0]
            what = "have one region on both sides; give the direction of the upper side"
        refuse(~(first | second), x, f"{name!r} does not separate two bodies: some facets {what}, the first at {{at}}")
        return np.asarray(second)
