"""The classes `Seam`, which chooses the upper side of a surface that stands for a layer, and `FacetName`."""

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
    """Name of a facet set or of a part of it, written as "NAME" or "NAME/PART".

    Domains, supports and loads refer to facet sets by this text.

    Attributes:
        set_name: name that users or builders gave to the set, or name of a seam.
        part_name: the part: name of the cell region to whose cells the part belongs; or "LAYER" for those outer facets
            of the meshed layer that continue the set; or, for a seam, "LOWER_FACE" or "UPPER_FACE". "": the whole set.
    """

    set_name: str
    part_name: str = ""

    @classmethod
    def parse(cls, text: str) -> FacetName:
        """Return the name that is written as `text`, "NAME" or "NAME/PART"."""
        return cls(*text.split("/", 1))

    def __str__(self) -> str:
        return f"{self.set_name}/{self.part_name}" if self.part_name else self.set_name

    @property
    def continued_set(self) -> str:
        """NAME if this is "NAME/LAYER", the facets of a layer that continue the set NAME; else this name, as text."""
        return self.set_name if self.part_name == LAYER else str(self)


@dataclass(frozen=True)
class Seam:
    """Choice of the upper side of a surface that stands for a layer.

    The normal n points from the lower to the upper side. At a facet between two cells, `direction` points to the upper
    side if it is given. Else the upper cell is the one in the regions `upper`, or not in the regions `lower`. Without
    any of these, the upper cell is the one whose region comes later in `Joint.regions`. On the outer boundary the layer
    stands on a rigid base, and the only cell is above it.

    Jumps, tractions and the order of sublayers depend on this choice; equilibria do not.

    Attributes:
        lower, upper: names of the regions on the lower and on the upper side; (): not specified.
        direction: vector that points to the upper side, one component per dimension, of any length; None: not
            specified.
    """

    lower: tuple[str, ...] = ()
    upper: tuple[str, ...] = ()
    direction: tuple[float, ...] | None = None

    def reversed(self) -> Seam:
        """Return the seam with lower and upper side exchanged.

        Raises:
            InputError: the seam has neither regions nor a direction, so that its sides follow the order of the regions.
        """
        if self == Seam():
            raise InputError("a seam whose sides follow the order of regions cannot be reversed; name its sides")
        return Seam(self.upper, self.lower, None if self.direction is None else tuple(-c for c in self.direction))

    def rotated_by(self, R: FloatArray) -> Seam:
        """Return the seam for a joint rotated by the orthogonal matrix `R`, (2, 2) or (3, 3)."""
        return self if self.direction is None else replace(self, direction=tuple(map(float, R @ self.direction)))

    def check(self, name: str, regions: Sequence[str], dim: int) -> None:
        """Raise InputError if regions or direction are unknown, contradictory or of the wrong size.

        Args:
            name: name of the seam, for messages.
            regions: names of all cell regions of the mesh.
            dim: number of dimensions of the mesh, 2 or 3.
        """
        for region in self.lower + self.upper:
            require_known("region", region, regions)
        in_both = sorted(set(self.upper) & set(self.lower))
        if in_both and self.direction is None:
            raise InputError(f"region {in_both[0]!r} is on both sides of {name!r}; give a direction to the upper side")
        if self.direction is not None:
            if set(self.upper) != set(self.lower):
                raise InputError(f"{name!r}: a direction tells the upper side, or regions do; give one of them")
            if finite_values(self.direction, (dim,)) is None or not np.any(self.direction):
                raise InputError(f"{name!r}: direction is {self.direction}; it needs {dim} components, not all zero")

    def second_is_upper(
        self, name: str, x: FloatArray, normals: FloatArray, region: IntArray, regions: Sequence[str]
    ) -> BoolArray:
        """Return (n,) whether the second of the two cells at each facet is on the upper side.

        Args:
            name: name of the seam, for messages.
            x: (n, d) centres of the facets, in d dimensions.
            normals: (n, d) normals of the facets, towards their second cells.
            region: (n, 2) positions in `regions` of the regions of the first and of the second cell.
            regions: names of all cell regions of the mesh.

        Raises:
            InputError: the direction is parallel to a facet, or nearly so; or both cells at a facet are on one side.
        """
        if self.direction is not None:
            direction = np.asarray(self.direction, float)
            cosine = normals @ direction / np.linalg.norm(normals, axis=1) / np.linalg.norm(direction)
            text = f"direction {self.direction} of {name!r} lies in the facet near {{at}}; give one across it"
            refuse(np.abs(cosine) < MIN_COSINE, x, text)
            return np.asarray(cosine > 0)
        if self.lower or self.upper:
            lower, upper = (np.isin(region, [regions.index(key) for key in side]) for side in (self.lower, self.upper))
            in_lower, in_upper = lower if self.lower else ~upper, upper if self.upper else ~lower
            second, first = in_upper[:, 1] & in_lower[:, 0], in_upper[:, 0] & in_lower[:, 1]
            fault = "have the same body on both sides"
        else:
            second, first = region[:, 1] > region[:, 0], region[:, 1] < region[:, 0]
            fault = "have one region on both sides; give the direction of the upper side"
        refuse(~(first | second), x, f"{name!r} does not separate two bodies: some facets {fault}, the first at {{at}}")
        return np.asarray(second)
