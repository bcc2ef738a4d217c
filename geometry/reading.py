"""Joints from mesh files of any format that meshio reads: which groups are the regions and S."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import meshio
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from geometry.joint import GeometryError, Joint, S, place, unknown
from geometry.meshfile import Cells, load
from geometry.parallel import on_root
from geometry.topology import FACET_TYPES, IntArray, corner_count
from thinlayer_base import is_finite

Groups = dict[str, npt.NDArray[np.bool_]]  # name -> which cells of one dimension, block after block of the file
Names = tuple[str, ...]

FACETS = {"interval": "line", "triangle": "triangle", "quadrilateral": "quad"}  # how meshio's names of them start
PHYSICAL = "gmsh:physical"


def read(
    path: str | Path,
    *,
    S: str | None = "S",
    upper: str | Sequence[str] | None = None,
    lower: str | Sequence[str] | None = None,
    direction: Sequence[float] | None = None,
    scale: float = 1.0,
    comm: MPI.Intracomm | None = None,
) -> Joint:
    """A joint from a mesh file. Collective.

    Names are gmsh's physical names, or the file's cell sets. Where there are none they are the numbers, as text, in the
    cell data "gmsh:physical" or in the file's only array of integers (negative: no name). Named groups of cells are the
    regions; every cell is in one of them. Groups of cells of one dimension less are sets of facets. Where groups of
    cells overlap, those named in `upper` and `lower` are the regions.

    Args:
        path: a file with triangles, quadrilaterals, tetrahedra or hexahedra, straight or of degree 2; 2D: in a plane
            z = const.
        S: name of the group of facets that becomes "S"; None for all facets between the regions `lower` and `upper`.
        upper: name or names of the regions above S (default for S on the outer boundary or with `direction`: all).
        lower: name or names of the regions below S (default: all others; for S on the outer boundary none, a rigid base).
        direction: (d,) vector to the upper side, for S inside one body.
        scale: factor on the coordinates, > 0, e.g. 1e3 from metre to millimetre.
        comm: communicator whose rank 0 reads (default: the world).

    Raises:
        GeometryError: the file cannot be read or lacks names; a name is unknown or ambiguous; cells of several types or
            of one that is not allowed; a surface in space; nodes or cells that are there twice, cells that are flat or
            folded; S is not what `Joint` needs.
    """
    if not isinstance(path, (str, Path)):
        raise GeometryError(f"path is {path!r}; it must be the name of a file")
    if not (S is None or isinstance(S, str)):
        raise GeometryError(
            f"S is {S!r}; give the name of one set of facets (a group of the file can have several parts), or None for "
            "all facets between the regions lower and upper"
        )
    above, below = _names_of(upper, "upper"), _names_of(lower, "lower")
    if direction is not None and not (np.ndim(direction) == 1 and all(map(is_finite, direction))):
        raise GeometryError(f"direction is {direction!r}; it needs 2 components, in 3D 3, not all zero")
    way = None if direction is None else tuple(float(c) for c in direction)
    if not is_finite(scale) or scale <= 0:
        raise GeometryError(f"scale is {scale!r}; it must be a number > 0")
    return on_root(comm, partial(_read, Path(path), S, above, below, way, scale))


def _names_of(regions: str | Sequence[str] | None, what: str) -> Names | None:
    """The names of one side's regions."""
    names = (regions,) if isinstance(regions, str) else regions
    if names is not None and not (isinstance(names, Sequence) and all(isinstance(name, str) for name in names)):
        raise GeometryError(f"{what} is {regions!r}; give the name of a region, or several in a list")
    return None if names is None else tuple(names)


def _read(
    path: Path, s: str | None, upper: Names | None, lower: Names | None, way: tuple[float, ...] | None, scale: float
) -> Joint:
    try:
        mesh = load(path, scale)
        cells = Cells.of(mesh)
        named = _Named.of(mesh, cells, (upper or ()) + (lower or ()))
        cells.require_sound()
        surface, upper, lower = named.interface(s, upper, lower, way)
        facets = {S: surface, **{name: rows for name, rows in named.facets.items() if name != s}}
        region = np.stack(list(named.regions.values())).argmax(axis=0)
        return Joint(cells.points, cells.nodes, cells.type, region, tuple(named.regions), facets, upper, lower, way)
    except GeometryError as error:
        raise GeometryError(f"{path}: {error}") from None


def _source(mesh: meshio.Mesh) -> tuple[str, str | None]:
    """Where names are from, for messages, and the cell data whose numbers stand for groups."""
    if PHYSICAL in mesh.cell_data:
        return "physical names" if mesh.field_data else f"numbers in the cell data {PHYSICAL!r}", PHYSICAL
    if getattr(mesh, "cell_tags", None):
        return "families", "cell_tags"
    if any(not name.startswith("gmsh:") for name in mesh.cell_sets):
        return "cell sets", None
    arrays = [
        name
        for name, data in mesh.cell_data.items()
        if name != "gmsh:geometrical" and all(np.ndim(values) == 1 and values.dtype.kind in "iu" for values in data)
    ]
    if len(arrays) > 1:
        raise GeometryError(f"several arrays of integers could number the groups: {', '.join(arrays)}; keep one")
    return (f"numbers in the cell data {arrays[0]!r}", arrays[0]) if arrays else ("no cell sets, no numbers", None)


def _groups(mesh: meshio.Mesh, dim: int, array: str | None) -> Groups:
    """The named groups of cells of a dimension that are not empty."""
    blocks = [k for k, block in enumerate(mesh.cells) if block.dim == dim]
    groups: Groups = {}
    for name, members in mesh.cell_sets.items():
        if blocks and not name.startswith("gmsh:"):
            parts = [np.asarray([] if members[k] is None else members[k]) for k in blocks]
            groups[name] = np.concatenate(
                [np.isin(np.arange(len(mesh.cells[k])), part) for k, part in zip(blocks, parts, strict=True)]
            )
    if blocks and array is not None:
        numbers = np.concatenate([mesh.cell_data[array][k] for k in blocks]).astype(np.int64)
        for number in np.unique(numbers):
            for name in _names(mesh, dim, array, int(number)):
                groups[name] = groups.get(name, False) | (numbers == number)
    return {name: member for name, member in groups.items() if member.any()}


def _names(mesh: meshio.Mesh, dim: int, array: str, number: int) -> Sequence[str]:
    """Names of the group with a number."""
    if families := getattr(mesh, "cell_tags", None):
        return tuple(families.get(number, ()))
    if array == PHYSICAL:
        number = abs(number) or -1  # negative where gmsh turned the cells round; zero: no group
        known = [name for name, value in mesh.field_data.items() if tuple(np.ravel(value)) == (number, dim)]
        return known or ([str(number)] if number > 0 else ())
    return [str(number)] if number >= 0 else ()


@dataclass(frozen=True)
class _Named:
    """What has a name: regions, and sets of facets by their (n, k) vertices; `source`: where the names are from."""

    cells: Cells
    regions: Groups
    facets: dict[str, IntArray]
    source: str

    @classmethod
    def of(cls, mesh: meshio.Mesh, cells: Cells, chosen: Names) -> _Named:
        """The groups of a file; `chosen`: the regions where groups of cells overlap."""
        dim = cells.points.shape[1]
        source, array = _source(mesh)
        regions, facets = _groups(mesh, dim, array), _groups(mesh, dim - 1, array)
        if not regions:
            example = f'Physical {"Surface" if dim == 2 else "Volume"}("BODY") = {{...}}'
            raise GeometryError(f"no named groups of cells ({source}); in gmsh: {example}; saved with Mesh.SaveAll = 0")
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
        return cls(cells, regions, _vertices(mesh, cells, facets), source)

    def interface(
        self, name: str | None, upper: Names | None, lower: Names | None, way: tuple[float, ...] | None
    ) -> tuple[IntArray, Names, Names]:
        """Facets of S (n, k), the regions above it and below it."""
        regions = f"regions: {', '.join(self.regions)}"
        if name is not None and name not in self.facets:
            raise GeometryError(
                f"{unknown('set of facets', name, self.facets)} ({self.source})"
                if self.facets
                else f"no facets are named {name!r} or anything else; name some, or give S=None with upper and lower"
            )
        if name != S and S in self.facets:
            raise GeometryError(f"the file names other facets {S!r}; rename them, or give S={S!r}")
        if name is None:
            if not upper or not lower or set(upper) & set(lower):
                raise GeometryError(f"S=None is all that is between two bodies; give upper and lower; {regions}")
            return self._boundary(upper, lower), upper, lower
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
            return facets, upper or tuple(self.regions), ()
        if way is not None:
            return facets, upper or lower or tuple(self.regions), lower or upper or tuple(self.regions)
        if not upper:
            touched = [region for region, member in self.regions.items() if member[table.cells[rows]].any()]
            raise GeometryError(
                f"{name!r} lies inside {' and '.join(touched)}; name the regions above it in upper, or give the "
                f"direction of the upper side if the same body is on both; {regions}"
            )
        lower = tuple(region for region in self.regions if region not in upper) if lower is None else lower
        if not lower:
            raise GeometryError(f"{name!r} lies inside {'+'.join(upper)}, nothing is left below it; give the direction")
        return facets, upper, lower

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


def _vertices(mesh: meshio.Mesh, cells: Cells, groups: Groups) -> dict[str, IntArray]:
    """Sets of facets by their vertices (n, k), each facet once."""
    if not groups:
        return {}
    kind = FACET_TYPES[cells.type]
    blocks = [block for block in mesh.cells if block.dim == cells.points.shape[1] - 1]
    alien = [block.type for block in blocks if not block.type.startswith(FACETS[kind])]
    if alien:
        raise GeometryError(f"the file has {alien[0]} facets, but its {cells.type} cells have {FACETS[kind]} facets")
    number = np.full(len(mesh.points), -1, np.int64)
    number[cells.used] = np.arange(len(cells.used))
    rows = np.concatenate([block.data[:, : corner_count(kind)] for block in blocks]).astype(np.int64)
    for name, member in groups.items():
        loose = member & (number[rows] < 0).any(axis=1)
        if loose.any():
            x = mesh.points[rows[loose.argmax()], : cells.points.shape[1]].mean(axis=0)
            raise GeometryError(
                f"{loose.sum()} of {member.sum()} facets named {name!r} are not part of the bodies' mesh, the first at "
                f"{place(x)}; in gmsh fragment the bodies with it, or embed it"
            )
    return {name: np.unique(np.sort(number[rows[member]], axis=1), axis=0) for name, member in groups.items()}
