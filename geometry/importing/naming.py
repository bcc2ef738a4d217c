"""Choice of a joint's regions, its seams and their sides among the named groups of a mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from forms.base import is_finite
from geometry.errors import GeometryError, place, unknown
from geometry.importing.cells import Cells
from geometry.joint import Joint
from geometry.seam import S, Seam
from geometry.topology import IntArray

Groups = dict[str, npt.NDArray[np.bool_]]  # name -> which cells are in the group
Names = tuple[str, ...]


SeamsOf = str | Sequence[str] | Mapping[str, Any] | None  # what `read` takes as S


@dataclass(frozen=True)
class Sides:
    """The caller's choice of S and its sides.

    Attributes:
        S: name of the set of facets of the only seam; None for all facets between the regions `lower` and `upper`.
        upper: names of the regions above S; None if not given.
        lower: names of the regions below S; None if not given.
        direction: (d,) vector to the upper side; None if not given.
        seams: instead of these, the seams with their names; {} if there is only one.
    """

    S: str | None
    upper: Names | None = None
    lower: Names | None = None
    direction: tuple[float, ...] | None = None
    seams: Mapping[str, Seam] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        surface: SeamsOf,
        upper: str | Sequence[str] | None,
        lower: str | Sequence[str] | None,
        direction: Sequence[float] | None,
    ) -> Sides:
        """The choice from arguments as in `read`; raises GeometryError for wrong types."""
        above, below, way = _names_of(upper, "upper"), _names_of(lower, "lower"), _direction(direction)
        if surface is None or isinstance(surface, str):
            return cls(surface, above, below, way)
        rules = dict(surface) if isinstance(surface, Mapping) else dict.fromkeys(surface)
        if not rules or not all(isinstance(name, str) for name in rules):
            raise GeometryError(
                f"S is {surface!r}; give the name of one set of facets (a group can have several parts), the names of "
                "several, {name: its upper side}, or None for all facets between the regions lower and upper"
            )
        if (above, below, way) != (None, None, None):
            raise GeometryError("S names several seams: give the sides of each there, as {name: (lower, upper)}")
        return cls(None, seams={name: _seam(name, rule) for name, rule in rules.items()})


def _seam(name: str, rule: Any) -> Seam:
    """A seam from its rule in S: None, a direction, or the regions below and above."""
    if rule is None:
        return Seam()
    if isinstance(rule, Seam):
        return rule
    if np.ndim(rule) == 1 and all(map(is_finite, rule)):
        return Seam(direction=_direction(rule))
    if not isinstance(rule, tuple | list) or len(rule) != 2:
        raise GeometryError(
            f"S: the upper side of {name!r} is {rule!r}; give a vector, (lower, upper) with names of regions, or None for "
            "the order of the regions"
        )
    below, above = (_names_of(side, f"side of {name!r}") or () for side in rule)
    return Seam(below, above)


def _direction(given: Any) -> tuple[float, ...] | None:
    if given is not None and not (np.ndim(given) == 1 and all(map(is_finite, given))):
        raise GeometryError(f"direction is {given!r}; it needs 2 components, in 3D 3, not all zero")
    return None if given is None else tuple(float(c) for c in given)


def _names_of(regions: str | Sequence[str] | None, what: str) -> Names | None:
    """The names of one side's regions."""
    names = (regions,) if isinstance(regions, str) else regions
    if names is not None and not (isinstance(names, Sequence) and all(isinstance(name, str) for name in names)):
        raise GeometryError(f"{what} is {regions!r}; give the name of a region, or several in a list")
    return None if names is None else tuple(names)


@dataclass(frozen=True)
class Named:
    """The named groups of a mesh.

    Attributes:
        cells: its cells.
        regions: name -> which of these cells are in the region.
        facets: name -> (n, k) vertices of the facets.
        source: origin of the names, for messages.
    """

    cells: Cells
    regions: Groups
    facets: dict[str, IntArray]
    source: str

    @classmethod
    def of(cls, cells: Cells, regions: Groups, facets: dict[str, IntArray], source: str, sides: Sides) -> Named:
        """The named groups of a mesh. Where groups of cells overlap, the groups named in `sides` are the regions."""
        chosen = (sides.upper or ()) + (sides.lower or ())
        chosen += tuple(name for seam in sides.seams.values() for name in seam.lower + seam.upper)
        both = [name for name in regions if name in facets and not name.isdigit()]
        if both:
            raise GeometryError(f"{both[0]!r} names both cells and facets; each needs its own name")
        for name in chosen:
            if name not in regions:
                raise GeometryError(f"{unknown('region', name, regions)} ({source})")
        cells.refuse(~np.any(list(regions.values()), axis=0), f"are in no named group ({source}: {', '.join(regions)})")
        if chosen and (np.sum(list(regions.values()), axis=0) > 1).any():
            regions = {name: regions[name] for name in dict.fromkeys(chosen)}
            missed = ~np.any(list(regions.values()), axis=0)
            cells.refuse(missed, f"are in none of {', '.join(regions)}; name every region in upper or lower")
        several = np.sum(list(regions.values()), axis=0) > 1
        cells.refuse(several, f"are in several of the groups {', '.join(regions)}; name the regions in upper and lower")
        return cls(cells, regions, facets, source)

    def joint(self, sides: Sides) -> Joint:
        """The joint; raises GeometryError for unusable cells and for an S that does not fit them."""
        self.cells.require_sound()
        if sides.seams:
            for name in sides.seams:
                self._require_facets(name)
            seams, facets = dict(sides.seams), dict(self.facets)
        else:
            surface, seam = self._interface(sides.S, sides.upper, sides.lower, sides.direction)
            seams, facets = {S: seam}, {S: surface, **{k: rows for k, rows in self.facets.items() if k != sides.S}}
        region = np.stack(list(self.regions.values())).argmax(axis=0)
        cells, names = self.cells, tuple(self.regions)
        return Joint(cells.points, cells.nodes, cells.type, region, names, facets, seams)

    def _require_facets(self, name: str) -> None:
        """Raise GeometryError unless a set of facets of the mesh has this name."""
        if name not in self.facets:
            raise GeometryError(
                f"{unknown('set of facets', name, self.facets)} ({self.source})"
                if self.facets
                else f"no facets are named {name!r} or anything else; name some, or give S=None with upper and lower"
            )

    def _interface(
        self, name: str | None, upper: Names | None, lower: Names | None, way: tuple[float, ...] | None
    ) -> tuple[IntArray, Seam]:
        """Facets (n, k) of the only seam, and its sides."""
        regions = f"regions: {', '.join(self.regions)}"
        if name is not None:
            self._require_facets(name)
        if name != S and S in self.facets:
            raise GeometryError(f"other facets are named {S!r}; rename them, or give S={S!r}")
        if name is None:
            if not upper or not lower or set(upper) & set(lower):
                raise GeometryError(f"S=None is all that is between two bodies; give upper and lower; {regions}")
            return self._boundary(upper, lower), Seam(lower, upper)
        facets = self.facets[name]
        table = self.cells.facets_among(np.unique(facets))
        rows = table.index(facets)
        self._refuse(facets, rows < 0, f"named {name!r} are not facets of the mesh's cells")
        outer = table.cells[rows, 1] < 0
        if not outer.all():
            self._refuse(
                facets, outer, f"named {name!r} lie on the outer boundary, the others inside: S is one or the other"
            )
        elif not lower:
            if way is not None:
                raise GeometryError(f"direction is for S inside one body; {name!r} lies on the outer boundary")
            self._require_touched(name, upper or tuple(self.regions), table.cells[rows, 0])
            return facets, Seam((), upper or tuple(self.regions))
        if way is not None:
            whole = tuple(self.regions)
            return facets, Seam(lower or upper or whole, upper or lower or whole, way)
        if not upper:
            touched = [region for region, member in self.regions.items() if member[table.cells[rows]].any()]
            raise GeometryError(
                f"{name!r} lies inside {' and '.join(touched)}; name the regions above it in upper, or give the "
                f"direction of the upper side if the same body is on both; {regions}"
            )
        lower = tuple(region for region in self.regions if region not in upper) if lower is None else lower
        if not lower:
            raise GeometryError(f"{name!r} lies inside {'+'.join(upper)}, nothing is left below it; give the direction")
        return facets, Seam(lower, upper)

    def _require_touched(self, name: str, upper: Names, cells: IntArray) -> None:
        """Raise GeometryError unless the cells at S, which lies on the outer boundary, belong to the upper body."""
        other = [region for region in self.regions if region not in upper and self.regions[region][cells].any()]
        if other:
            raise GeometryError(
                f"{name!r} lies on the outer boundary of {' and '.join(other)}, and {'+'.join(upper)}, named in upper, "
                f"does not touch it there; have both bodies the same nodes on {name!r}?"
            )

    def _refuse(self, facets: IntArray, bad: npt.NDArray[np.bool_], what: str) -> None:
        if bad.any():
            x = self.cells.points[facets[bad.argmax()]].mean(axis=0)
            raise GeometryError(f"{bad.sum()} of {len(bad)} facets {what}; the first is at {place(x)}")

    def _boundary(self, upper: Names, lower: Names) -> IntArray:
        """All facets between the bodies."""
        above, below = (np.any([self.regions[name] for name in side], axis=0) for side in (upper, lower))
        shared = np.intersect1d(self.cells.corners[above], self.cells.corners[below])
        table = self.cells.facets_among(shared)
        first, second = table.cells[table.cells[:, 1] >= 0].T
        found = table.vertices[table.cells[:, 1] >= 0][above[first] & below[second] | below[first] & above[second]]
        if not len(found):
            raise GeometryError(f"{'+'.join(lower)} and {'+'.join(upper)} have no facet in common")
        return found
