"""Joint: two bodies (or one body and a rigid base) that meet on S, as plain arrays with names."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from geometry.topology import CELL_TYPES, FacetTable, FloatArray, IntArray, facet_normals

S = "S"
LAYER = "LAYER"
LOWER_FACE, UPPER_FACE, BASE = "LOWER_FACE", "UPPER_FACE", "BASE"


class GeometryError(ValueError):
    """A mesh, a name or a size that cannot be used; the message says what, where and what is allowed."""


def unknown(kind: str, name: object, known: Iterable[str]) -> str:
    """Message for a name that does not exist: the nearest known one and the whole list."""
    known = sorted(known)
    near = difflib.get_close_matches(str(name), known, n=1)
    return (
        f"unknown {kind} {name!r}" + (f", did you mean {near[0]!r}?" if near else "") + f"; known: {', '.join(known)}"
    )


@dataclass(frozen=True)
class Band:
    """What inflating did: the layer's thickness, its sublayers and the way the bodies made room for it.

    Attributes:
        eps: thickness of the layer, a length.
        bodies: "kept" or "extended".
        regions: names of the sublayers' cell regions, from the lower to the upper face.
        base: the joint before inflating.
        reference: (n_points, d) where each point was before inflating (points of the layer: their place on S).
    """

    eps: float
    bodies: str
    regions: tuple[str, ...]
    base: Joint
    reference: FloatArray


@dataclass(frozen=True)
class Joint:
    """Bodies meeting on S, the same on every MPI rank until it is distributed.

    The normal n of S points from the lower body to the upper one. Without a lower body S is a part of the upper body's
    boundary that stands on a rigid base.

    Attributes:
        points: (n_points, d) coordinates, lengths.
        cells: (n_cells, k) vertices of each cell, in DOLFINx's order.
        cell_type: "triangle", "quadrilateral", "tetrahedron" or "hexahedron".
        region: (n_cells,) for each cell the position of its region in `regions`.
        regions: names of the cell regions.
        facets: named sets of facets, each (n, k) vertices; S is one of them.
        upper: names of the regions above S.
        lower: names of the regions below S; empty for a rigid base.
        band: how the layer was meshed; None while S is a surface.

    Raises:
        GeometryError: S is missing, empty or does not separate the lower from the upper body, a set of facets is empty
            or not part of the mesh, a region has no cells.
    """

    points: FloatArray
    cells: IntArray
    cell_type: str
    region: IntArray
    regions: tuple[str, ...]
    facets: Mapping[str, IntArray]
    upper: tuple[str, ...]
    lower: tuple[str, ...] = ()
    band: Band | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.cell_type not in CELL_TYPES:
            raise GeometryError(unknown("cell type", self.cell_type, CELL_TYPES))
        if self.band is None and S not in self.facets:
            raise GeometryError(f"the mesh has no facets named {S!r}; named facets: {', '.join(sorted(self.facets))}")
        for name in self.lower + self.upper:
            if name not in self.regions:
                raise GeometryError(unknown("region", name, self.regions))
        for number, name in enumerate(self.regions):
            if not (self.region == number).any():
                raise GeometryError(f"region {name!r} has no cells")
        for name, facets in self.facets.items():
            if len(facets) == 0:
                raise GeometryError(f"the facets named {name!r} are an empty set")
            if (self.table.index(facets) < 0).any():
                raise GeometryError(f"some facets named {name!r} are not facets of the mesh's cells")
        if self.band is None:
            self._check_interface()

    def _check_interface(self) -> None:
        cells = self.table.cells[self.table.index(self.facets[S])]
        side = self.side
        if not self.lower:
            if (cells[:, 1] >= 0).any():
                raise GeometryError(
                    f"{S!r} on a rigid base must lie on the outer boundary; {(cells[:, 1] >= 0).sum()} facets do not"
                )
            return
        if (cells[:, 1] < 0).any():
            raise GeometryError(
                f"{(cells[:, 1] < 0).sum()} facets of {S!r} lie on the outer boundary; between {'+'.join(self.lower)} and "
                f"{'+'.join(self.upper)} each needs a cell on both sides"
            )
        if (side[cells[:, 0]] == side[cells[:, 1]]).any():
            raise GeometryError(
                f"{S!r} does not separate two bodies: some of its facets have the same body on both sides"
            )
        inner = self.table.cells[self.table.cells[:, 1] >= 0]
        across = (side[inner[:, 0]] != side[inner[:, 1]]).sum()
        if across != len(np.unique(self.table.index(self.facets[S]))):
            raise GeometryError(
                f"{S!r} does not separate two bodies: they also meet on {across - len(cells)} facets outside it"
            )

    @property
    def dim(self) -> int:
        """Space dimension, 2 or 3."""
        return self.points.shape[1]

    @property
    def reference(self) -> FloatArray:
        """(n_points, d) where each point was before inflating."""
        return self.band.reference if self.band else self.points

    @property
    def rigid_base(self) -> bool:
        """Whether S stands on a rigid base instead of a lower body."""
        return not self.lower

    @cached_property
    def table(self) -> FacetTable:
        """All facets of the mesh with the cells that meet there."""
        try:
            return FacetTable.of(self.cells, self.cell_type)
        except ValueError as error:
            raise GeometryError(str(error)) from None

    @cached_property
    def side(self) -> IntArray:
        """(n_cells,) -1 below S, +1 above, 0 in the layer."""
        sign = [(name in self.upper) * 1 - (name in self.lower) * 1 for name in self.regions]
        return np.array(sign, np.int64)[self.region]

    @cached_property
    def interface_normals(self) -> FloatArray:
        """(n_S, d) unit normals of S, from the lower to the upper body."""
        facets = self.facets[S]
        cells = self.table.cells[self.table.index(facets)]
        above = np.where(self.side[cells[:, 0]] > 0, cells[:, 0], cells[:, 1])
        normals = facet_normals(self.points, facets)
        towards = self.points[self.cells[above]].mean(axis=1) - self.points[facets].mean(axis=1)
        return normals * np.sign((normals * towards).sum(axis=1))[:, None]

    def rotated(self, angle: float) -> Joint:
        """The joint turned by an angle (radian, counter-clockwise; in 3D about the third axis)."""
        turn = np.eye(self.dim)
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        return replace(self, points=self.points @ turn.T)

    def swapped(self) -> Joint:
        """The joint with the roles of the lower and the upper body exchanged (n turns round, nothing moves)."""
        if self.rigid_base:
            raise GeometryError("a joint on a rigid base has no lower body to swap with")
        return replace(self, lower=self.upper, upper=self.lower)

    def nearest_point(self, x: Sequence[float]) -> int:
        """Number of the mesh vertex at x; raises GeometryError, naming the nearest vertex, if there is none."""
        points = self.reference
        if len(x) != self.dim:
            raise GeometryError(f"point {tuple(x)} has {len(x)} coordinates, the mesh has {self.dim}")
        distance = np.linalg.norm(points - np.asarray(x, float), axis=1)
        nearest = int(np.argmin(distance))
        if distance[nearest] > 1e-6 * np.ptp(points, axis=0).max():
            raise GeometryError(f"no mesh vertex at {tuple(x)}; the nearest is {tuple(points[nearest].tolist())}")
        return nearest
