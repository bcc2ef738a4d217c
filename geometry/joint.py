"""Joint: bodies that meet on S, or stand on a rigid base there, as plain arrays with names."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain

import numpy as np

from forms.base import InputError, is_finite, require
from forms.temperature import checked_values, finite_values
from geometry.identified_sides import Periods
from geometry.refusals import place_text, refuse, require_known
from geometry.seam import JUNCTIONS, LAYER, RESERVED_NAMES, S, Seam
from geometry.topology import (
    CELL_TYPES,
    FACET_TYPES,
    FacetTable,
    FloatArray,
    IntArray,
    Splitting,
    corner_count,
    facet_normals,
    geometry_degree,
    keys_of_ridges,
    ridge_keys,
    ridges,
    weights_between,
)

Profile = Callable[[FloatArray], FloatArray]

# largest difference of unit normals of a planar S: coordinates in files may have only seven digits
PLANAR_TOLERANCE = 1e-5


def _digest(*arrays: IntArray) -> str:
    """Hash of arrays of integers, twelve digits."""
    content = b"".join(np.ascontiguousarray(array, np.int64).tobytes() for array in arrays)
    return hashlib.sha256(content).hexdigest()[:12]


@dataclass(frozen=True)
class InflatedBand:
    """Result of inflating: the layers' thickness, their regions, and how the bodies made room for them.

    Attributes:
        eps: name of a seam -> thickness of its layer or gap, a length; where it varies, multiplied by the profile.
        bodies: "kept" or "extended", see `inflate`.
        regions: names of all cell regions of the layers, regions of junctions last.
        of_seam: name of a seam -> regions of its sublayers, from the lower to the upper face; without gaps.
        junctions: region of junctions -> the seam that its cells belong to.
        aligned: regions of junctions whose layers have one common normal, as where a bed joint passes open head joints.
        faces: names of the facet sets between bodies and layers.
        base: the joint before inflating.
        reference: (n_points, d) place of each point before inflating (points of the layer: their place on S).
        director: (n_band_cells, n_corners, d) unit normal of S below or above each corner of the layers' cells, from
            the lower to the upper body; a fixed unit vector in junctions of layers with different normals.
    """

    eps: Mapping[str, float]
    bodies: str
    regions: tuple[str, ...]
    of_seam: Mapping[str, tuple[str, ...]]
    junctions: Mapping[str, str]
    aligned: tuple[str, ...]
    faces: tuple[str, ...]
    base: Joint = field(repr=False)
    reference: FloatArray = field(repr=False)
    director: FloatArray = field(repr=False)


@dataclass(frozen=True, repr=False)
class Joint:
    """Bodies that meet on S. Every MPI rank has the same joint until it is distributed.

    S consists of one or several seams, named sets of facets with a layer each. Bodies can part at every facet of S
    between them: S may end inside a body, branch, cross itself, or separate any number of bodies. A seam on the outer
    boundary stands on a rigid base.

    Attributes:
        points: (n_points, d) coordinates, lengths.
        cells: (n_cells, k) nodes of each cell, in DOLFINx's order: vertices, and for curved cells (degree 2) the nodes
            on edges, faces and inside.
        cell_type: "triangle", "quadrilateral", "tetrahedron" or "hexahedron".
        region: (n_cells,) for each cell the position of its region in `regions`.
        regions: names of the cell regions.
        facets: named sets of facets, each (n, k) vertices in any order; the seams are among them, and their facets are
            removed from the other sets.
        seams: name of a seam -> choice of its upper side. A single seam is named "S"; with several seams none is.
        band: how the layer was meshed; None while S is a surface.
        periods: pairs of identified sides, if the joint is a periodic cell; None: it is not.
        parted: (n_cells, k, d) places of the nodes of each cell if bodies have made room for layers without cells, see
            `inflating.inflation.with_gaps`; None: the nodes are at `points`.

    Raises:
        InputError: a seam is missing, empty or not oriented, or shares a facet with another seam; a set of facets is
            empty or not part of the mesh; a region has no cells; a periodic cell is less than three cells wide; a seam
            lies on the boundary of a periodic cell.
    """

    points: FloatArray
    cells: IntArray
    cell_type: str
    region: IntArray
    regions: tuple[str, ...]
    facets: Mapping[str, IntArray]
    seams: Mapping[str, Seam]
    band: InflatedBand | None = field(default=None, repr=False)
    periods: Periods | None = None
    parted: FloatArray | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        require_known("cell type", self.cell_type, CELL_TYPES)
        geometry_degree(self.cell_type, self.cells.shape[1])
        for name, facets in self.facets.items():
            if len(facets) == 0:
                raise InputError(f"the facets named {name!r} are an empty set")
            missing = f"some facets named {name!r} are not facets of the mesh's cells, as at {{at}}"
            refuse(self.table.index(facets) < 0, self.points[facets], missing)
        if self.band is None:
            self._check_seams()
            rows = {name: self.table.index(facets) for name, facets in self.facets.items()}
            kept = {name: np.isin(of, self.surface_rows, invert=name not in self.seams) for name, of in rows.items()}
            sets = {name: facets[kept[name]] for name, facets in self.facets.items() if kept[name].any()}
            object.__setattr__(self, "facets", sets)
        if self.periods:
            outer = self.surface_rows[self.surface_cells[:, 0] < 0] if self.band is None else np.empty(0, np.int64)
            self.periods.check(self.points, self.corners, self.cell_type, self.table.vertices[outer])

    def __getstate__(self) -> dict[str, object]:
        """State for pickling, with the pieces of the mesh computed, so that other ranks need not compute them again."""
        if self.band is None:
            _ = self.split_mesh.pieces
        return self.__dict__

    def _check_seams(self) -> None:
        for name in (*self.regions, *self.facets):
            taken = (LAYER, JUNCTIONS) if name in self.regions else RESERVED_NAMES
            if not isinstance(name, str) or name in taken or "/" in name:
                raise InputError(f"{name!r} cannot be a name; not allowed: {', '.join(taken)} and names with '/'")
        for number, name in enumerate(self.regions):
            if not (self.region == number).any():
                raise InputError(f"region {name!r} has no cells")
        if not self.seams:
            raise InputError(f"a joint needs a seam, such as {S!r}")
        for name, seam in self.seams.items():
            seam.check(name, self.regions, self.dim)
            require_known("set of facets", name, self.facets)
        if len(self.seams) > 1 and S in self.seams:
            raise InputError(f"{S!r} is all seams together and cannot name one of several")
        rows, counts = np.unique(np.concatenate([*map(self.rows_of, self.seams)]), return_counts=True)
        if (counts > 1).any():
            first, second, *_ = (name for name in self.seams if rows[counts > 1][0] in self.rows_of(name))
            both = f"{{bad}} facets are in two seams, {first!r} and {second!r}, the first at {{at}}"
            refuse(counts > 1, self.points[self.table.vertices[rows]], f"{both}; a facet has one layer")
        _ = self.surface_cells

    @cached_property
    def masters(self) -> IntArray:
        """(n_points,) master of each node: the first node that periods identify with it; else the node itself."""
        return self.periods.masters(len(self.points)) if self.periods else np.arange(len(self.points))

    @property
    def dim(self) -> int:
        """Space dimension, 2 or 3."""
        return self.points.shape[1]

    @cached_property
    def size(self) -> float:
        """Largest extent along an axis."""
        return float(np.ptp(self.points, axis=0).max())

    @property
    def degree(self) -> int:
        """Degree of the cells' geometry: 1 straight, 2 curved."""
        return geometry_degree(self.cell_type, self.cells.shape[1])

    @property
    def corners(self) -> IntArray:
        """(n_cells, k) vertices of each cell."""
        return self.cells[:, : corner_count(self.cell_type)]

    @property
    def cell_points(self) -> FloatArray:
        """(n_cells, k, d) places of the nodes of each cell."""
        return self.points[self.cells] if self.parted is None else self.parted

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the bodies' regions, regions below seams first."""
        sides = [seam.lower for seam in self.seams.values()] + [seam.upper for seam in self.seams.values()]
        layer = self.band.regions if self.band else ()
        return tuple(name for name in dict.fromkeys(chain(*sides, self.regions)) if name not in layer)

    @property
    def reference(self) -> FloatArray:
        """(n_points, d) place of each point before inflating."""
        return self.band.reference if self.band else self.points

    @cached_property
    def table(self) -> FacetTable:
        """All facets of the mesh with the cells that meet there."""
        return FacetTable.of(self.corners, self.cell_type)

    # ---------------------------------------------------------------- S
    def rows_of(self, name: str) -> IntArray:
        """Rows of `table` of the facets of a seam, or of all seams ("S"), each once, in ascending order."""
        if name != S:
            require_known("seam", name, self.seams)
        names = self.seams if name == S else (name,)
        return np.unique(np.concatenate([self.table.index(self.facets[seam_name]) for seam_name in names]))

    @cached_property
    def surface_rows(self) -> IntArray:
        """Rows of `table` of the facets of S, each once, in lexicographic order of their vertices."""
        return self.rows_of(S)

    @cached_property
    def seam_numbers(self) -> IntArray:
        """(n_S,) position of the seam of each facet of S in `seams`."""
        out = np.empty(len(self.surface_rows), np.int64)
        for number, name in enumerate(self.seams):
            out[np.searchsorted(self.surface_rows, self.rows_of(name))] = number
        return out

    @cached_property
    def surface_cells(self) -> IntArray:
        """(n_S, 2) the cell below and the cell above each facet of S; -1 for a rigid base.

        Raises:
            InputError: a seam lies partly on the outer boundary, or does not determine its upper side.
        """
        out = self.table.cells[self.surface_rows][:, ::-1].copy()
        for number, (name, seam) in enumerate(self.seams.items()):
            here = np.flatnonzero(self.seam_numbers == number)
            outer, nodes = out[here, 0] < 0, self.surface[here]
            if seam.lower or not outer.all():
                sides = f"between {'+'.join(seam.lower)} and {'+'.join(seam.upper)} " if seam.lower else ""
                some = f"{{bad}} of {{all}} facets of {name!r} lie on the outer boundary, as at {{at}}; {sides}each"
                refuse(outer, self.points[nodes], f"{some} needs cells on both sides, or all stand on a rigid base")
            if not outer.any():
                x = self.points[nodes].mean(axis=1)
                if seam.direction is None:
                    right = seam.between_regions(name, x, self.region[out[here]], self.regions)
                else:
                    normals = facet_normals(self.points, nodes, self.cell_type).mean(axis=1)
                    to_second = self.points[self.corners[out[here, 1]]].mean(axis=1) - x
                    right = seam.along_direction(name, x, normals, to_second)
                out[here[~right]] = out[here[~right]][:, ::-1]
        return out

    @property
    def rigid_base(self) -> bool:
        """Whether all of S stands, or stood before inflating, on a rigid base instead of lower bodies."""
        return len(self.base_seams) == len(self.seams)

    @property
    def base_seams(self) -> tuple[str, ...]:
        """Names of the seams that stand, or stood before inflating, on a rigid base."""
        joint = self.band.base if self.band else self
        on_base = joint.surface_cells[:, 0] < 0
        return tuple(name for k, name in enumerate(joint.seams) if on_base[joint.seam_numbers == k].all())

    @cached_property
    def outer_rows(self) -> IntArray:
        """Rows of `table` of the facets on the outer boundary that are not in S, in ascending order."""
        return np.setdiff1d(np.flatnonzero(self.table.cells[:, 1] < 0), self.surface_rows)

    @cached_property
    def outer_beside_s(self) -> tuple[IntArray, IntArray]:
        """Those `outer_rows` (n,) that touch S in a ridge, and keys (n, m) of their ridges; -1 for ridges not in S."""
        keys = keys_of_ridges(self.table.vertices[self.outer_rows], self.dim - 1)
        keys[~np.isin(keys, ridge_keys(ridges(self.surface, self.cell_type)[0]))] = -1
        adjacent = (keys >= 0).any(axis=1)
        return self.outer_rows[adjacent], keys[adjacent]

    @cached_property
    def split_mesh(self) -> Splitting:
        """The mesh, cut along S."""
        return self.split_along(self.surface_rows)

    def components_at(self, cells: IntArray, nodes: IntArray, cut: Splitting | None = None) -> IntArray:
        """(n, k) component of each cell (n,) around each of its nodes (n, k); -1 for cells < 0.

        Args:
            cells: (n,) cells.
            nodes: (n, k) nodes of each cell.
            cut: where the mesh is cut; None: along all seams.
        """
        position = (self.cells[cells][:, None, :] == nodes[:, :, None]).argmax(axis=2)
        of_nodes = (cut or self.split_mesh).of_nodes[cells]
        return np.where(cells[:, None] < 0, -1, np.take_along_axis(of_nodes, position, axis=1))

    @cached_property
    def pairs(self) -> IntArray:
        """(n_S, k) number that identifies vertex, seam and both bodies (components) at each vertex of facets of S."""
        vertices = self.table.vertices[self.surface_rows]
        below, above = (self.components_at(cells, vertices) for cells in self.surface_cells.T)
        count = int(max(below.max(), above.max())) + 2
        codes = (self.seam_numbers[:, None] * count + above) * count + below + 1
        return np.asarray(self.masters[vertices] * (codes.max() + 1) + codes, np.int64)

    def split_along(self, rows: IntArray) -> Splitting:
        """The mesh, cut along facets given by rows of `table`; cells across periodic sides are neighbours."""
        if self.periods is None:
            return Splitting(self.cells, self.cell_type, self.table, rows)
        table = FacetTable.of(self.masters[self.corners], self.cell_type)
        cut = np.sort(table.index(self.masters[self.table.vertices[rows]]))
        return Splitting(self.masters[self.cells], self.cell_type, table, cut)

    @cached_property
    def surface(self) -> IntArray:
        """(n_S, k) nodes of the facets of S, in the order of the facet's own element."""
        return self.table.nodes(self.surface_rows, self.cells, self.cell_type)

    def faces(self, cell_points: FloatArray | None = None) -> FloatArray:
        """(2, n_S, k, d) places of the nodes of `surface` in the cells below and above; a rigid base is at S.

        Args:
            cell_points: (n_cells, k, d), or more cells: places of the nodes of the cells; None: `Joint.cell_points`.
        """
        places = self.cell_points if cell_points is None else cell_points
        below, above = self.surface_cells.T
        lower, upper = (places[cells[:, None], self.on_surface(cells)] for cells in (np.maximum(below, 0), above))
        return np.stack([np.where((below >= 0)[:, None, None], lower, self.points[self.surface]), upper])

    def on_surface(self, cells: IntArray) -> IntArray:
        """(n_S, k) positions of the nodes of `surface` among the nodes of cells (n_S,)."""
        return np.asarray((self.cells[cells][:, None, :] == self.surface[:, :, None]).argmax(axis=2))

    @cached_property
    def branch_vertices(self) -> IntArray:
        """(n,) vertices (masters only) where seams meet, or where S branches: more than two facets meet in a ridge."""
        ridge_vertices, counts = ridges(self.masters[self.surface], self.cell_type)
        vertices = self.masters[self.table.vertices[self.surface_rows]]
        keys = np.unique(vertices * len(self.seams) + self.seam_numbers[:, None])
        several, seams = np.unique(keys // len(self.seams), return_counts=True)
        return np.union1d(ridge_vertices[counts > 2], several[seams > 1])

    @property
    def seams_meet(self) -> bool:
        """Whether S branches, or two seams have a vertex in common."""
        return len(self.branch_vertices) > 0

    @cached_property
    def tips(self) -> IntArray:
        """(n, d - 1) vertices of the ridges where S ends inside the bodies."""
        ridge_vertices, counts = ridges(self.surface, self.cell_type)
        at_outer, _ = ridges(self.table.nodes(self.outer_rows, self.corners, self.cell_type), self.cell_type)
        ends = ridge_vertices[counts == 1]
        return np.asarray(ends[~np.isin(ridge_keys(ends), ridge_keys(at_outer))])

    @property
    def tip(self) -> FloatArray | None:
        """A place where S ends inside the bodies; None if there is no such place."""
        return self.points[self.tips[0]].mean(axis=0) if len(self.tips) else None

    @cached_property
    def node_normals(self) -> FloatArray:
        """(n_S, k, d) unit normals at the nodes of `surface`, from the lower to the upper side."""
        above = self.surface_cells[:, 1]
        normals = facet_normals(self.points, self.surface, self.cell_type)
        towards = self.points[self.corners[above]].mean(axis=1) - self.points[self.surface].mean(axis=1)
        return normals * np.sign((normals.mean(axis=1) * towards).sum(axis=1))[:, None, None]

    @cached_property
    def interface_normals(self) -> FloatArray:
        """(n_S, d) mean unit normals of the facets of S, from the lower to the upper side."""
        mean = self.node_normals.mean(axis=1)
        return np.asarray(mean / np.linalg.norm(mean, axis=1, keepdims=True), float)

    @property
    def planar(self) -> bool:
        """Whether S lies in one plane, or in parallel planes."""
        return bool(np.ptp(self.node_normals.reshape(-1, self.dim), axis=0).max() <= PLANAR_TOLERANCE)

    def relative_thickness(self, profile: Profile | None, name: str = S) -> FloatArray:
        """(n_points,) values of a profile at the vertices of a seam or of S, linear in between; 1 elsewhere.

        Args:
            profile: function of coordinates (d, n) that returns n positive numbers; None for a uniform thickness.
            name: name of the seam, or "S".

        Raises:
            InputError: the profile returns something else, or not a positive number.
        """
        values = np.ones(len(self.points))
        if profile is None:
            return values
        rows = self.rows_of(name)
        vertices, what = np.unique(self.table.vertices[rows]), "the thickness profile"
        x, wanted = self.points[vertices], "it must be a numpy function of coordinates (d, n) that gives n numbers > 0"
        thickness = checked_values(what, profile, x.T, wanted=wanted, where=lambda k: f" at {place_text(x[k])}")
        for k in np.flatnonzero(thickness <= 0)[:1]:
            raise InputError(f"{what} is {thickness[k]:g} at {place_text(x[k])}; it must be > 0 on S")
        values[vertices] = thickness
        if self.degree == 2:
            facet_type = FACET_TYPES[self.cell_type]
            surface, k = self.surface[np.searchsorted(self.surface_rows, rows)], corner_count(facet_type)
            values[surface[:, k:]] = values[surface[:, :k]] @ weights_between(facet_type).T
        return values

    def rotated(self, angle: float) -> Joint:
        """The joint rotated by an angle (radian, counter-clockwise; in 3D about the third axis)."""
        require(is_finite(angle), "angle", angle, "it must be a number, in radians")
        turn = np.eye(self.dim)
        turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        seams = {name: seam.turned(turn) for name, seam in self.seams.items()}
        return replace(self, points=self.points @ turn.T, seams=seams)

    def moved(self, by: Sequence[float]) -> Joint:
        """The joint translated by a vector (d,), for example to turn a rectangle into the wall of a tube."""
        if len(by) != self.dim or not all(map(is_finite, by)):
            raise InputError(f"a joint is moved by {by!r}; it must be {self.dim} numbers")
        return replace(self, points=self.points + np.asarray(by, float))

    def swapped(self) -> Joint:
        """The joint with the two sides of every seam exchanged: n changes its sign, nothing moves."""
        return replace(self, seams={name: seam.reversed() for name, seam in self.seams.items()})

    def identity(self) -> dict[str, object]:
        """Identity of the joint, as JSON: counts and hashes of its cells, places, regions and named facets."""
        x = self.points if self.parted is None else np.concatenate([self.points, np.concatenate(self.parted)])
        weights = np.cos(np.arange(x.size)).reshape(x.shape)
        return {
            "cells": len(self.cells),
            "coordinates": [float(f"{(x * w).sum():.8g}") for w in (weights, weights**2)],
            "mesh": _digest(self.cells, self.region),
            "regions": list(self.regions),
            "seams": {name: [list(s.lower), list(s.upper), s.direction] for name, s in self.seams.items()},
            "facets": {name: _digest(facets) for name, facets in sorted(self.facets.items())},
            **({"periods": [list(pair) for pair in self.periods.sides]} if self.periods else {}),
        }

    def __repr__(self) -> str:
        size = " x ".join(f"{length:.6g}" for length in np.ptp(self.points, axis=0))
        facets = ", ".join(f"{name} {len(facets)}" for name, facets in self.facets.items())
        cells = f"{len(self.cells)} {self.cell_type} cells, {size}, of {', '.join(self.regions)}"
        return f"Joint({cells}; facets: {facets})"

    def nearest_point(self, x: Sequence[float]) -> int:
        """Number of the mesh vertex at x; raise InputError that names the nearest vertex if there is none at x."""
        vertices = np.unique(self.corners)
        if finite_values(x, (self.dim,)) is None:
            raise InputError(f"point {x!r} is not a place; give {self.dim} coordinates")
        distance = np.linalg.norm(self.reference[vertices] - np.asarray(x, float), axis=1)
        nearest = int(vertices[np.argmin(distance)])
        if distance.min() > 1e-6 * np.ptp(self.reference, axis=0).max():
            raise InputError(f"no mesh vertex at {tuple(x)}; the nearest is {place_text(self.reference[nearest])}")
        return nearest
