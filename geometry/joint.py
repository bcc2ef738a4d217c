"""Joint: two bodies (or one body and a rigid base) that meet on S, as plain arrays with names."""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from forms.base import InputError, is_finite
from geometry.sides import sides_by_direction, upper_cells
from geometry.topology import (
    CELL_TYPES,
    FACET_TYPES,
    FacetTable,
    FloatArray,
    IntArray,
    corner_count,
    facet_normals,
    geometry_degree,
    lagrange,
    ridges,
)

Profile = Callable[[FloatArray], FloatArray]

S = "S"
LAYER = "LAYER"
LOWER_FACE, UPPER_FACE, BASE, BONDED = "LOWER_FACE", "UPPER_FACE", "BASE", "BONDED"
RESERVED = (LAYER, LOWER_FACE, UPPER_FACE, BASE, BONDED)
FLAT = 1e-5  # largest difference of unit normals of a planar S: coordinates in files may have only seven digits


class GeometryError(InputError):
    """A mesh, a name or a size that cannot be used. Says what is wrong, where, and what is allowed."""


def unknown(kind: str, name: object, known: Iterable[str]) -> str:
    """Message for a name that does not exist: the nearest known one and the whole list."""
    known = sorted(known)
    lowered = {one.lower(): one for one in known}
    near = [lowered[one] for one in difflib.get_close_matches(str(name).lower(), lowered, n=1)]
    return (
        f"unknown {kind} {name!r}" + (f", did you mean {near[0]!r}?" if near else "") + f"; known: {', '.join(known)}"
    )


def _digest(*arrays: IntArray) -> str:
    """Hash of arrays of integers, twelve digits."""
    content = b"".join(np.ascontiguousarray(array, np.int64).tobytes() for array in arrays)
    return hashlib.sha256(content).hexdigest()[:12]


def place(x: FloatArray) -> str:
    """Coordinates for a message, short."""
    return f"({', '.join(f'{c:.6g}' for c in x)})"


@dataclass(frozen=True)
class Band:
    """Result of inflating: the layer's thickness, its sublayers, and how the bodies made room for it.

    Attributes:
        eps: thickness of the layer, a length; where it varies, times the profile.
        bodies: "kept" or "extended".
        regions: names of the sublayers' cell regions, from the lower to the upper face.
        base: the joint before inflating.
        reference: (n_points, d) place of each point before inflating (points of the layer: their place on S).
        director: (n_band_cells, n_corners, d) unit normal of S below or above each corner of the layer's cells, from the
            lower to the upper body.
    """

    eps: float
    bodies: str
    regions: tuple[str, ...]
    base: Joint = field(repr=False)
    reference: FloatArray = field(repr=False)
    director: FloatArray = field(repr=False)


@dataclass(frozen=True, repr=False)
class Joint:
    """Bodies meeting on S, the same on every MPI rank until it is distributed.

    The normal n of S points from the lower body to the upper one. Without a lower body S is a part of the upper body's
    boundary that stands on a rigid base. Where the bodies also meet outside S they are bonded: S then ends inside.

    Attributes:
        points: (n_points, d) coordinates, lengths.
        cells: (n_cells, k) nodes of each cell, in DOLFINx's order: vertices, and for curved cells (degree 2) the nodes on
            edges, faces and inside.
        cell_type: "triangle", "quadrilateral", "tetrahedron" or "hexahedron".
        region: (n_cells,) for each cell the position of its region in `regions`.
        regions: names of the cell regions.
        facets: named sets of facets, each (n, k) vertices in any order. S is one of them; facets of S are removed from
            the other sets.
        upper: names of the regions above S.
        lower: names of the regions below S; empty for a rigid base; the same as `upper` for S inside one body.
        direction: (d,) vector that points to the upper side, for S inside one body only.
        band: how the layer was meshed; None while S is a surface.

    Raises:
        GeometryError: S is missing, empty, on the wrong side or ambiguous, a set of facets is empty or not part of the
            mesh, a region has no cells or belongs to no body.
    """

    points: FloatArray
    cells: IntArray
    cell_type: str
    region: IntArray
    regions: tuple[str, ...]
    facets: Mapping[str, IntArray]
    upper: tuple[str, ...]
    lower: tuple[str, ...] = ()
    direction: tuple[float, ...] | None = None
    band: Band | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if self.cell_type not in CELL_TYPES:
            raise GeometryError(unknown("cell type", self.cell_type, CELL_TYPES))
        try:
            geometry_degree(self.cell_type, self.cells.shape[1])
        except ValueError as error:
            raise GeometryError(str(error)) from None
        if self.band is None and S not in self.facets:
            raise GeometryError(f"the mesh has no facets named {S!r}; named facets: {', '.join(sorted(self.facets))}")
        self._check_regions()
        for name, facets in self.facets.items():
            if len(facets) == 0:
                raise GeometryError(f"the facets named {name!r} are an empty set")
            missing = self.table.index(facets) < 0
            if missing.any():
                x = self.points[facets[missing][0]].mean(axis=0)
                raise GeometryError(f"some facets named {name!r} are not facets of the mesh's cells, as at {place(x)}")
        if self.band is None:
            self._check_interface()
            self._take_out_interface()

    def _check_regions(self) -> None:
        for name in [*self.regions, *self.facets] if self.band is None else []:
            if name in RESERVED or "/" in name:
                raise GeometryError(f"{name!r} cannot be a name; not allowed: {', '.join(RESERVED)} and names with '/'")
        for name in self.lower + self.upper:
            if name not in self.regions:
                raise GeometryError(unknown("region", name, self.regions))
        homeless = sorted(set(self.regions) - set(self.bodies) - set(self.band.regions if self.band else ()))
        if homeless:
            raise GeometryError(f"region {homeless[0]!r} belongs to no body; name it in upper or lower")
        for number, name in enumerate(self.regions):
            if not (self.region == number).any():
                raise GeometryError(f"region {name!r} has no cells")
        shared = sorted(set(self.upper) & set(self.lower))
        if shared and self.direction is None:
            raise GeometryError(f"region {shared[0]!r} is on both sides of {S!r}; give the direction of the upper side")
        if self.direction is not None:
            if set(self.upper) != set(self.lower):
                raise GeometryError("direction is for S inside one body; upper and lower are different regions")
            length = np.linalg.norm(self.direction)
            if np.shape(self.direction) != (self.dim,) or not np.isfinite(length) or length == 0:
                raise GeometryError(f"direction is {self.direction}; it needs {self.dim} components, not all zero")

    def _check_interface(self) -> None:
        rows = self.surface_rows
        outer = self.table.cells[rows, 1] < 0
        if self.rigid_base:
            if not outer.all():
                raise GeometryError(
                    f"{S!r} on a rigid base must lie on the outer boundary; {(~outer).sum()} facets do not"
                )
            return
        if outer.any():
            x = self.points[self.table.vertices[rows[outer][0]]].mean(axis=0)
            raise GeometryError(
                f"{outer.sum()} facets of {S!r} lie on the outer boundary, the first at {place(x)}; between "
                f"{'+'.join(self.lower)} and {'+'.join(self.upper)} each needs a cell on both sides"
            )
        side = self.side[self.table.cells[rows]]
        if (side[:, 0] == side[:, 1]).any():
            x = self.points[self.table.vertices[rows[side[:, 0] == side[:, 1]][0]]].mean(axis=0)
            raise GeometryError(
                f"{S!r} does not separate two bodies: some of its facets have the same body on both sides, the first at "
                f"{place(x)}"
            )

    def _take_out_interface(self) -> None:
        rows = {name: self.table.index(facets) for name, facets in self.facets.items()}
        kept = {name: facets[~np.isin(rows[name], self.surface_rows)] for name, facets in self.facets.items()}
        kept[S] = self.facets[S]
        object.__setattr__(self, "facets", {name: facets for name, facets in kept.items() if len(facets)})

    @property
    def dim(self) -> int:
        """Space dimension, 2 or 3."""
        return self.points.shape[1]

    @property
    def degree(self) -> int:
        """Degree of the cells' geometry: 1 straight, 2 curved."""
        return geometry_degree(self.cell_type, self.cells.shape[1])

    @cached_property
    def corners(self) -> IntArray:
        """(n_cells, k) vertices of each cell."""
        return self.cells[:, : corner_count(self.cell_type)]

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies' regions, lower ones first."""
        return tuple(dict.fromkeys(self.lower + self.upper))

    @property
    def reference(self) -> FloatArray:
        """(n_points, d) place of each point before inflating."""
        return self.band.reference if self.band else self.points

    @property
    def rigid_base(self) -> bool:
        """Whether S stands on a rigid base instead of a lower body."""
        return not self.lower

    @cached_property
    def table(self) -> FacetTable:
        """All facets of the mesh with the cells that meet there."""
        try:
            return FacetTable.of(self.corners, self.cell_type)
        except ValueError as error:
            raise GeometryError(str(error)) from None

    @cached_property
    def side(self) -> IntArray:
        """(n_cells,) -1 below S, +1 above, 0 in the layer."""
        if self.direction is None:
            sign = [(name in self.upper) * 1 - (name in self.lower) * 1 for name in self.regions]
            return np.array(sign, np.int64)[self.region]
        rows = self.surface_rows
        if (self.table.cells[rows, 1] < 0).any():
            return -np.ones(len(self.cells), np.int64)
        x, n = (
            self.points[self.surface].mean(axis=1),
            facet_normals(self.points, self.surface, self.cell_type).mean(axis=1),
        )
        centres = self.points[self.corners].mean(axis=1)
        try:
            above = upper_cells(centres, self.table.cells[rows], x, n, np.asarray(self.direction, float))
            return sides_by_direction(self.corners, self.cell_type, self.table, rows, above)
        except ValueError as error:
            if self.branch is not None:
                raise GeometryError(
                    f"S branches at {place(self.branch)}, where three or more parts of the body meet: no direction tells "
                    "its sides; S is one layer between two sides"
                ) from None
            raise GeometryError(f"direction {tuple(self.direction)} does not tell the sides of S: {error}") from None

    @cached_property
    def surface_rows(self) -> IntArray:
        """Rows of `table` of the facets of S, each once, in lexicographic order of their vertices."""
        return np.unique(self.table.index(self.facets[S]))

    @cached_property
    def surface(self) -> IntArray:
        """(n_S, k) nodes of the facets of S, in the order of the facet's own element."""
        return self.table.nodes(self.surface_rows, self.cells, self.cell_type)

    @cached_property
    def branch(self) -> FloatArray | None:
        """A place where S branches: more than two of its facets meet there; None if there is none."""
        found, counts = ridges(self.surface, self.cell_type)
        return self.points[found[counts > 2][0]].mean(axis=0) if (counts > 2).any() else None

    @cached_property
    def tip(self) -> FloatArray | None:
        """A place where S ends inside the bodies; None if there is none."""
        found, counts = ridges(self.surface, self.cell_type)
        outer = np.setdiff1d(np.flatnonzero(self.table.cells[:, 1] < 0), self.surface_rows)
        at_outer, _ = ridges(self.table.nodes(outer, self.corners, self.cell_type), self.cell_type)
        ends = found[counts == 1]
        keys = [(rows[:, 0] << 32) + rows[:, -1] for rows in (ends, at_outer)]
        inside = ends[~np.isin(keys[0], keys[1])]
        return self.points[inside[0]].mean(axis=0) if len(inside) else None

    @cached_property
    def bonded(self) -> IntArray:
        """Rows of `table` where the lower and the upper side meet outside S."""
        if self.rigid_base or self.band is not None:
            return np.empty(0, np.int64)
        inner = np.flatnonzero(self.table.cells[:, 1] >= 0)
        side = self.side[self.table.cells[inner]]
        return np.setdiff1d(inner[side[:, 0] != side[:, 1]], self.surface_rows)

    @cached_property
    def node_normals(self) -> FloatArray:
        """(n_S, k, d) unit normals at the nodes of `surface`, from the lower to the upper body."""
        cells = self.table.cells[self.surface_rows]
        above = np.where(self.side[cells[:, 0]] > 0, cells[:, 0], cells[:, 1])
        normals = facet_normals(self.points, self.surface, self.cell_type)
        towards = self.points[self.corners[above]].mean(axis=1) - self.points[self.surface].mean(axis=1)
        return normals * np.sign((normals.mean(axis=1) * towards).sum(axis=1))[:, None, None]

    @cached_property
    def interface_normals(self) -> FloatArray:
        """(n_S, d) mean unit normals of the facets of S, from the lower to the upper body."""
        mean = self.node_normals.mean(axis=1)
        return np.asarray(mean / np.linalg.norm(mean, axis=1, keepdims=True), float)

    @property
    def planar(self) -> bool:
        """Whether S lies in planes of one direction."""
        return bool(np.ptp(self.node_normals.reshape(-1, self.dim), axis=0).max() <= FLAT)

    def relative_thickness(self, profile: Profile | None) -> FloatArray:
        """(n_points,) a profile at the vertices of S, linear between them; 1 away from S.

        Args:
            profile: function of coordinates (d, n) that returns n positive numbers; None for a uniform thickness.

        Raises:
            GeometryError: the profile returns something else, or not a positive number.
        """
        values = np.ones(len(self.points))
        if profile is None:
            return values
        vertices = np.unique(self.table.vertices[self.surface_rows])
        try:
            found = np.asarray(profile(self.points[vertices].T))
            if found.dtype.kind not in "fiu":
                raise TypeError(f"it returns {found.dtype}")
        except Exception as error:
            raise GeometryError(
                f"the thickness profile is no numpy function of coordinates x (d, n): {error}"
            ) from error
        if found.shape not in ((), vertices.shape):
            raise GeometryError(f"the thickness profile returns shape {found.shape} for {len(vertices)} points of S")
        values[vertices] = found
        bad = vertices[~(np.isfinite(values[vertices]) & (values[vertices] > 0))]
        if len(bad):
            raise GeometryError(
                f"the thickness profile is {values[bad[0]]:g} at {place(self.points[bad[0]])}; it must be > 0 on S"
            )
        k = corner_count(FACET_TYPES[self.cell_type])
        if self.surface.shape[1] > k:
            element = lagrange(FACET_TYPES[self.cell_type], 1)
            between = element.tabulate(0, lagrange(FACET_TYPES[self.cell_type], 2).points[k:])[0, :, :, 0]
            values[self.surface[:, k:]] = values[self.surface[:, :k]] @ between.T
        return values

    def rotated(self, angle: float) -> Joint:
        """The joint turned by an angle (radian, counter-clockwise; in 3D about the third axis)."""
        if not is_finite(angle):
            raise GeometryError(f"angle is {angle!r}; it must be a number, in radians")
        turn = np.eye(self.dim)
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        return replace(self, points=self.points @ turn.T, direction=self._direction(turn))

    def swapped(self) -> Joint:
        """The joint with lower and upper body exchanged: n changes its sign, nothing moves."""
        if self.rigid_base:
            raise GeometryError("a joint on a rigid base has no lower body to swap with")
        return replace(self, lower=self.upper, upper=self.lower, direction=self._direction(-np.eye(self.dim)))

    def _direction(self, turn: FloatArray) -> tuple[float, ...] | None:
        """The direction of the upper side, turned."""
        return None if self.direction is None else tuple(float(c) for c in turn @ np.array(self.direction))

    def identity(self) -> dict[str, Any]:
        """Identity of the joint, as JSON: counts and hashes of its cells, places, regions and named facets."""
        weights = np.cos(np.arange(self.points.size)).reshape(self.points.shape)
        return {
            "cells": len(self.cells),
            "coordinates": [float(f"{(self.points * w).sum():.8g}") for w in (weights, weights**2)],
            "mesh": _digest(self.cells, self.region),
            "regions": [list(self.regions), list(self.lower), list(self.upper), self.direction],
            "facets": {name: _digest(facets) for name, facets in sorted(self.facets.items())},
        }

    def __repr__(self) -> str:
        size = " x ".join(f"{length:.6g}" for length in np.ptp(self.points, axis=0))
        facets = ", ".join(f"{name} {len(facets)}" for name, facets in self.facets.items())
        what = f"{len(self.cells)} {self.cell_type} cells, {size}, of {', '.join(self.regions)}"
        return f"Joint({what}; facets: {facets})"

    def nearest_point(self, x: Sequence[float]) -> int:
        """Number of the mesh vertex at x; raises GeometryError, naming the nearest vertex, if there is none."""
        vertices = np.unique(self.corners)
        if np.ndim(x) != 1 or not all(map(is_finite, x)):
            raise GeometryError(f"point {x!r} is not a place; give {self.dim} coordinates")
        if len(x) != self.dim:
            raise GeometryError(f"point {tuple(x)} has {len(x)} coordinates, the mesh has {self.dim}")
        distance = np.linalg.norm(self.reference[vertices] - np.asarray(x, float), axis=1)
        nearest = int(vertices[np.argmin(distance)])
        if distance.min() > 1e-6 * np.ptp(self.reference, axis=0).max():
            raise GeometryError(f"no mesh vertex at {tuple(x)}; the nearest is {place(self.reference[nearest])}")
        return nearest
