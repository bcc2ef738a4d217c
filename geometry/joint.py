"""The class `Joint`: mesh of bodies that meet on a surface S, or stand there on a rigid base, as named NumPy arrays."""

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
    facet_ridge_keys,
    geometry_degree,
    ridge_keys,
    ridges,
    unit_normals,
    vertex_weights,
)

Profile = Callable[[FloatArray], FloatArray]

# largest difference of unit normals of a planar S: coordinates in files may have only seven digits
PLANAR_TOLERANCE = 1e-5


def _digest(*arrays: IntArray) -> str:
    """Return the first twelve hexadecimal digits of the SHA-256 hash of arrays of integers."""
    content = b"".join(np.ascontiguousarray(array, np.int64).tobytes() for array in arrays)
    return hashlib.sha256(content).hexdigest()[:12]


@dataclass(frozen=True)
class InflatedBand:
    """Description of the meshed layers of a joint: thickness, regions, and how the bodies made room for them.

    To inflate a joint is to open its surface S to the thickness of the layers.

    Attributes:
        eps: name of a seam -> thickness of its layer or gap, a length. If a profile is given, the thickness is eps
            times the profile.
        bodies: how the bodies made room: "kept" (they moved apart and kept their shape) or "extended" (the layers were
            cut out of them).
        regions: names of all cell regions of the layers; regions of junctions come last.
        regions_of_seam: name of a seam -> regions of its sublayers, from the lower to the upper face. Seams without
            cells (gaps) are left out.
        junctions: name of a region of junctions -> name of the seam that its cells belong to.
        aligned_junctions: names of those regions of junctions in which all layers that meet at a junction have one
            normal. An example is a bed joint of mortar that passes empty head joints.
        faces: names of the facet sets between bodies and layers.
        drawn_joint: the joint as drawn, before it was inflated.
        reference: (n_points, d) place of each point in `drawn_joint`, in d dimensions. For points of the layers it is
            the place on S below or above them.
        director: (n_band_cells, n_corners, d) unit normal of S at each vertex of the layers' cells, from the lower to
            the upper body. In junctions of layers with different normals it is the unit vector along y.
        face_nodes: (2, n_S, k) numbers of the k nodes of each facet of `drawn_joint.surface` on the lower and on the
            upper face of its layer; -1 where a face has no nodes. In refined layers n_S is 0.
    """

    eps: Mapping[str, float]
    bodies: str
    regions: tuple[str, ...]
    regions_of_seam: Mapping[str, tuple[str, ...]]
    junctions: Mapping[str, str]
    aligned_junctions: tuple[str, ...]
    faces: tuple[str, ...]
    drawn_joint: Joint = field(repr=False)
    reference: FloatArray = field(repr=False)
    director: FloatArray = field(repr=False)
    face_nodes: IntArray = field(repr=False)


@dataclass(frozen=True, repr=False)
class Joint:
    """Mesh of bodies that meet on a surface S, with named regions and facet sets.

    S consists of one or several seams: named sets of facets of the mesh, each of which stands for a layer. S may end
    inside a body, branch, cross itself, or separate any number of bodies. A seam on the outer boundary stands on a
    rigid base, which takes the place of the lower body. Every MPI rank has the whole joint; `Domain` is its distributed
    mesh.

    Attributes:
        points: (n_points, d) coordinates of the nodes in d dimensions, lengths.
        cells: (n_cells, k) numbers of the k nodes of each cell, in DOLFINx's order. These are the vertices, and for
            curved cells (degree 2) the nodes on edges, on faces and inside.
        cell_type: "triangle", "quadrilateral", "tetrahedron" or "hexahedron".
        region: (n_cells,) for each cell the position of its region in `regions`.
        regions: names of the cell regions.
        facets: name -> (n, m) numbers of the m vertices, in any order, of each of the n facets in the set. The seams
            are among these sets. The facets of seams are removed from the other sets.
        seams: name of a seam -> choice of its upper side. The name "S" is allowed for a single seam only; if there are
            several, "S" stands for all of them.
        band: description of the meshed layers; None if S is a surface without thickness.
        periods: pairs of sides that are identified with each other, if the joint is a periodic cell; None: it is not.
        parted: (n_cells, k, d) coordinates of the nodes of each cell if the bodies have moved apart but the layers have
            no cells, see `inflating.inflation.with_gaps`. None: the nodes are at `points`.

    Raises:
        InputError: a seam is missing, empty or shares a facet with another seam, or its upper side is not determined; a
            set of facets is empty or not part of the mesh; a region has no cells; a name is reserved; a periodic cell
            is less than three cells wide; a seam lies on the boundary of a periodic cell.
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
                raise InputError(f"the facets named {name!r} are an empty set; leave the name out")
            complaint = f"some facets named {name!r} are not facets of the mesh's cells, as at {{at}}"
            refuse(self.table.index(facets) < 0, self.points[facets], complaint)
        if self.band is None:
            self._check_seams()
            on_s = {name: np.isin(self.table.index(facets), self.surface_rows) for name, facets in self.facets.items()}
            kept = {name: facets if name in self.seams else facets[~on_s[name]] for name, facets in self.facets.items()}
            object.__setattr__(self, "facets", {name: facets for name, facets in kept.items() if len(facets)})
        if self.periods:
            base_rows = self.surface_rows[self.surface_cells[:, 0] < 0] if self.band is None else np.empty(0, np.int64)
            self.periods.check(self.points, self.corners, self.cell_type, self.table.vertices[base_rows])

    def __getstate__(self) -> dict[str, object]:
        """Return the attributes for pickling, among them `split_mesh.pieces`, so that other ranks have it already."""
        if self.band is None:
            _ = self.split_mesh.pieces
        return self.__dict__

    def _check_seams(self) -> None:
        for name in (*self.regions, *self.facets):
            reserved = (LAYER, JUNCTIONS) if name in self.regions else RESERVED_NAMES
            if not isinstance(name, str) or name in reserved or "/" in name:
                raise InputError(f"{name!r} cannot be a name; not allowed: {', '.join(reserved)} and names with '/'")
        for number, name in enumerate(self.regions):
            if not (self.region == number).any():
                raise InputError(f"region {name!r} has no cells; leave the name out")
        if not self.seams:
            raise InputError(f"a joint needs a seam, such as {S!r}")
        for name, seam in self.seams.items():
            seam.check(name, self.regions, self.dim)
            require_known("set of facets", name, self.facets)
        if len(self.seams) > 1 and S in self.seams:
            raise InputError(f"{S!r} is all seams together and cannot name one of several; give it another name")
        rows, counts = np.unique(np.concatenate([*map(self.rows_of, self.seams)]), return_counts=True)
        if (counts > 1).any():
            first, second, *_ = (name for name in self.seams if rows[counts > 1][0] in self.rows_of(name))
            overlap_text = f"{{bad}} facets are in two seams, {first!r} and {second!r}, the first at {{at}}"
            refuse(counts > 1, self.points[self.table.vertices[rows]], f"{overlap_text}; a facet has one layer")
        _ = self.surface_cells

    @cached_property
    def masters(self) -> IntArray:
        """(n_points,) for each node the lowest number among the nodes that are identified with it, itself included.

        Nodes are identified by the periods of a periodic cell.
        """
        return self.periods.masters(len(self.points)) if self.periods else np.arange(len(self.points))

    @property
    def dim(self) -> int:
        """Space dimension, 2 or 3."""
        return self.points.shape[1]

    @cached_property
    def size(self) -> float:
        """Largest extent of the mesh along a coordinate axis, a length."""
        return float(np.ptp(self.points, axis=0).max())

    @property
    def degree(self) -> int:
        """Degree of the cells' geometry: 1 straight, 2 curved."""
        return geometry_degree(self.cell_type, self.cells.shape[1])

    @property
    def corners(self) -> IntArray:
        """(n_cells, k) numbers of the k vertices of each cell."""
        return self.cells[:, : corner_count(self.cell_type)]

    @property
    def cell_points(self) -> FloatArray:
        """(n_cells, k, d) coordinates of the k nodes of each cell in d dimensions; `parted` if it is given."""
        return self.points[self.cells] if self.parted is None else self.parted

    @property
    def bodies(self) -> tuple[str, ...]:
        """Names of the regions of bodies, not of layers.

        Regions that seams name as lower come first, then those that they name as upper, then all others.
        """
        side_regions = [seam.lower for seam in self.seams.values()] + [seam.upper for seam in self.seams.values()]
        layer_regions = self.band.regions if self.band else ()
        return tuple(name for name in dict.fromkeys(chain(*side_regions, self.regions)) if name not in layer_regions)

    @property
    def reference(self) -> FloatArray:
        """(n_points, d) place of each point in the joint as drawn, before S was opened to the layers' thickness."""
        return self.band.reference if self.band else self.points

    @cached_property
    def table(self) -> FacetTable:
        """All facets of the mesh, each with its vertices and the one or two cells that it belongs to."""
        return FacetTable.of(self.corners, self.cell_type)

    # ---------------------------------------------------------------- S
    def rows_of(self, name: str) -> IntArray:
        """Return the row numbers in `table`, ascending, of the facets of the seam `name`; "S" stands for all seams."""
        if name != S:
            require_known("seam", name, self.seams)
        names = self.seams if name == S else (name,)
        return np.unique(np.concatenate([self.table.index(self.facets[seam_name]) for seam_name in names]))

    def facets_of(self, name: str) -> IntArray:
        """Return the positions in `surface`, ascending, of the facets of the seam `name`; "S" stands for all seams."""
        return np.searchsorted(self.surface_rows, self.rows_of(name))

    @cached_property
    def surface_rows(self) -> IntArray:
        """(n_S,) row numbers in `table` of the facets of S, ascending."""
        return self.rows_of(S)

    @cached_property
    def seam_numbers(self) -> IntArray:
        """(n_S,) for each facet of S, in the order of `surface_rows`, the position of its seam in `seams`."""
        return np.argmax([np.isin(self.surface_rows, self.rows_of(name)) for name in self.seams], axis=0)

    @cached_property
    def surface_cells(self) -> IntArray:
        """(n_S, 2) numbers of the cell below and of the cell above each facet of S, in the order of `surface_rows`.

        If the facet is on a rigid base, the number below is -1.

        Raises:
            InputError: a seam lies partly on the outer boundary, or does not determine its upper side.
        """
        cell_pairs = self.table.cells[self.surface_rows][:, ::-1].copy()
        for number, (name, seam) in enumerate(self.seams.items()):
            in_seam = np.flatnonzero(self.seam_numbers == number)
            is_outer, nodes = cell_pairs[in_seam, 0] < 0, self.surface[in_seam]
            if seam.lower or not is_outer.all():
                between = f"between {'+'.join(seam.lower)} and {'+'.join(seam.upper)} " if seam.lower else ""
                text = f"{{bad}} of {{all}} facets of {name!r} lie on the outer boundary, as at {{at}}; {between}each"
                refuse(is_outer, self.points[nodes], f"{text} needs cells on both sides, or all stand on a rigid base")
            if not is_outer.any():
                x = self.points[nodes]
                to_second = self.points[self.corners[cell_pairs[in_seam, 1]]].mean(axis=1) - x.mean(axis=1)
                n = unit_normals(x, self.cell_type, self.degree, to_second).mean(axis=1)
                region = self.region[cell_pairs[in_seam]]
                is_upwards = seam.second_is_upper(name, x.mean(axis=1), n, region, self.regions)
                cell_pairs[in_seam[~is_upwards]] = cell_pairs[in_seam[~is_upwards]][:, ::-1]
        return cell_pairs

    @property
    def rigid_base(self) -> bool:
        """Whether all seams stand on a rigid base, without lower bodies; with meshed layers, in the joint as drawn."""
        return len(self.base_seams) == len(self.seams)

    @property
    def base_seams(self) -> tuple[str, ...]:
        """Names of the seams on a rigid base, without a lower body; with meshed layers, in the joint as drawn."""
        joint = self.band.drawn_joint if self.band else self
        on_base = joint.surface_cells[:, 0] < 0
        return tuple(name for k, name in enumerate(joint.seams) if on_base[joint.seam_numbers == k].all())

    @cached_property
    def outer_rows(self) -> IntArray:
        """(n,) row numbers in `table`, ascending, of the facets on the outer boundary that are not in S."""
        return np.setdiff1d(np.flatnonzero(self.table.cells[:, 1] < 0), self.surface_rows)

    @cached_property
    def outer_beside_s(self) -> tuple[IntArray, IntArray]:
        """Outer facets that share a ridge (a vertex in 2D, an edge in 3D) with S, and the shared ridges.

        These are (n,) row numbers of the facets in `table`, and (n, m) keys of the m ridges of each facet, as from
        `ridge_keys`. The key is -1 for ridges that are not in S.
        """
        keys = facet_ridge_keys(self.table.vertices[self.outer_rows], self.dim - 1)
        keys[~np.isin(keys, ridge_keys(ridges(self.surface, self.cell_type)[0]))] = -1
        is_beside = (keys >= 0).any(axis=1)
        return self.outer_rows[is_beside], keys[is_beside]

    @cached_property
    def split_mesh(self) -> Splitting:
        """The mesh cut along S, with the components into which the cut divides the cells around each vertex or edge."""
        return self.split_along(self.surface_rows)

    def side_components(self, cut: Splitting | None = None) -> IntArray:
        """Return which component of the cells around each node of S contains the cell below, and the cell above S.

        Components are groups of cells around a node that are connected there by uncut facets. At a node that is not on
        a cut there is one.

        Args:
            cut: the mesh with its cuts; None: cut along all seams.

        Returns:
            (2, n_S, k) number of the component, from 0 at each node, for the k nodes of each facet in `surface`; -1
            where there is no cell.
        """
        cells = self.surface_cells.T[..., None]
        return np.where(cells < 0, -1, (cut or self.split_mesh).node_components[cells, self.in_cells])

    @cached_property
    def pairs(self) -> IntArray:
        """(n_S, k) integers that identify each of the k vertices of each facet of S together with its two bodies.

        Integers are equal only if vertex, seam, lower body and upper body are the same. Vertices that a periodic cell
        identifies count as one. A body is here a component: the cells around the vertex that are connected by facets
        not in S. Facets and vertices are in the order of `surface`.
        """
        vertices = self.surface[:, : self.table.vertices.shape[1]]
        below, above = self.side_components()[:, :, : vertices.shape[1]]
        count = int(max(below.max(), above.max())) + 2
        codes = (self.seam_numbers[:, None] * count + above) * count + below + 1
        return np.asarray(self.masters[vertices] * (codes.max() + 1) + codes, np.int64)

    def split_along(self, rows: IntArray) -> Splitting:
        """Return the mesh cut along some facets, with the components into which the cut divides the cells at each node.

        Cells on identified sides of a periodic cell count as neighbours.

        Args:
            rows: (n,) row numbers in `table` of the facets.
        """
        if self.periods is None:
            return Splitting(self.cells, self.cell_type, self.table, rows)
        table = FacetTable.of(self.masters[self.corners], self.cell_type)
        cut = np.sort(table.index(self.masters[self.table.vertices[rows]]))
        return Splitting(self.masters[self.cells], self.cell_type, table, cut)

    @cached_property
    def surface(self) -> IntArray:
        """(n_S, k) numbers of the k nodes of each facet of S, in the order of a facet's Lagrange element.

        Facets are in the order of `surface_rows`.
        """
        return self.table.nodes(self.surface_rows, self.cells, self.cell_type)

    @property
    def faces(self) -> FloatArray:
        """(2, n_S, k, d) coordinates of the k nodes of each facet of S, on its lower and then on its upper side, lengths.

        They differ only if bodies have moved apart. The lower side of a seam on a rigid base stays in place.
        """
        cells = self.surface_cells.T[..., None]
        return np.where((cells >= 0)[..., None], self.cell_points[cells, self.in_cells], self.points[self.surface])

    @cached_property
    def in_cells(self) -> IntArray:
        """(2, n_S, k) positions of the k nodes of each facet of S in the cell below, and in the cell above.

        On a rigid base the positions below have no meaning.
        """
        return np.asarray((self.cells[self.surface_cells.T][:, :, None] == self.surface[..., None]).argmax(axis=3))

    @cached_property
    def branch_vertices(self) -> IntArray:
        """(n,) numbers of the vertices where seams meet, or where S branches.

        S branches at a ridge (a vertex in 2D, an edge in 3D) that more than two of its facets share. Of vertices that a
        periodic cell identifies, only the one with the lowest number is included.
        """
        ridge_vertices, counts = ridges(self.masters[self.surface], self.cell_type)
        vertices = self.masters[self.table.vertices[self.surface_rows]]
        keys = np.unique(vertices * len(self.seams) + self.seam_numbers[:, None])
        shared, n_seams = np.unique(keys // len(self.seams), return_counts=True)
        return np.union1d(ridge_vertices[counts > 2], shared[n_seams > 1])

    @property
    def seams_meet(self) -> bool:
        """Whether two seams share a vertex, or more than two facets of S share a vertex in 2D, an edge in 3D."""
        return len(self.branch_vertices) > 0

    @cached_property
    def tips(self) -> IntArray:
        """(n, 1) vertices in 2D, (n, 2) vertices of edges in 3D, where S ends inside the bodies."""
        ridge_vertices, counts = ridges(self.surface, self.cell_type)
        outer_ridges, _ = ridges(self.table.nodes(self.outer_rows, self.corners, self.cell_type), self.cell_type)
        free_ridges = ridge_vertices[counts == 1]
        return np.asarray(free_ridges[~np.isin(ridge_keys(free_ridges), ridge_keys(outer_ridges))])

    @property
    def tip(self) -> FloatArray | None:
        """Coordinates of a place where S ends inside the bodies; None if there is no such place."""
        return self.points[self.tips[0]].mean(axis=0) if len(self.tips) else None

    @cached_property
    def node_normals(self) -> FloatArray:
        """(n_S, k, d) unit normals of S in d dimensions, towards its upper side, at the k nodes of each facet."""
        x, above = self.points[self.surface], self.surface_cells[:, 1]
        upwards = self.points[self.corners[above]].mean(axis=1) - x.mean(axis=1)
        return unit_normals(x, self.cell_type, self.degree, upwards)

    @cached_property
    def interface_normals(self) -> FloatArray:
        """(n_S, d) mean normal of each facet of S in d dimensions, a unit vector from the lower to the upper side."""
        mean = self.node_normals.mean(axis=1)
        return np.asarray(mean / np.linalg.norm(mean, axis=1, keepdims=True), float)

    @property
    def planar(self) -> bool:
        """Whether S lies in one plane, or in parallel planes."""
        return bool(np.ptp(self.node_normals.reshape(-1, self.dim), axis=0).max() <= PLANAR_TOLERANCE)

    def relative_thickness(self, profile: Profile | None, name: str = S) -> FloatArray:
        """Return the layer's thickness divided by eps at each node of S, and 1 at all other nodes, as (n_points,).

        This is the profile at vertices of S, and linear in between.

        Args:
            profile: function of the coordinates (d, n) of n points in d dimensions that returns n numbers > 0; None: 1
                everywhere.
            name: name of the seam with this profile, or "S" for all seams; the result is 1 on other seams.

        Raises:
            InputError: the profile returns something else, or not a positive number.
        """
        values = np.ones(len(self.points))
        if profile is None:
            return values
        surface, k = self.surface[self.facets_of(name)], self.table.vertices.shape[1]
        vertices, subject = np.unique(surface[:, :k]), "the thickness profile"
        x, wanted = self.points[vertices], "it must be a numpy function of coordinates (d, n) that gives n numbers > 0"
        thickness = checked_values(subject, profile, x.T, wanted=wanted, where=lambda k: f" at {place_text(x[k])}")
        for k in np.flatnonzero(thickness <= 0)[:1]:
            raise InputError(f"{subject} is {thickness[k]:g} at {place_text(x[k])}; it must be > 0 on S")
        values[vertices] = thickness
        if self.degree == 2:
            values[surface[:, k:]] = values[surface[:, :k]] @ vertex_weights(FACET_TYPES[self.cell_type], 2)[k:].T
        return values

    def rotated(self, angle: float) -> Joint:
        """Return the joint rotated by `angle` (radians), counter-clockwise about the origin, in 3D about the axis z."""
        require(is_finite(angle), "angle", angle, "it must be a number, in radians")
        rotation = np.eye(self.dim)
        rotation[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        seams = {name: seam.rotated_by(rotation) for name, seam in self.seams.items()}
        return replace(self, points=self.points @ rotation.T, seams=seams)

    def moved(self, by: Sequence[float]) -> Joint:
        """Return the joint translated by a vector, for example to make a rectangle the wall of an axisymmetric tube.

        Args:
            by: translation, one length per dimension.

        Raises:
            InputError: the vector has a wrong number of components, or one that is not finite.
        """
        if len(by) != self.dim or not all(map(is_finite, by)):
            raise InputError(f"a joint is moved by {by!r}; it must be {self.dim} numbers")
        return replace(self, points=self.points + np.asarray(by, float))

    def swapped(self) -> Joint:
        """Return the joint with lower and upper side of every seam exchanged: n changes its sign, no point moves."""
        return replace(self, seams={name: seam.reversed() for name, seam in self.seams.items()})

    def identity(self) -> dict[str, object]:
        """Return data that identify the joint, as a dictionary that can be written to JSON.

        The data are counts, names, weighted sums of coordinates, and hashes of cells. Joints with equal data count as
        the same mesh, for example when a stored result is read.
        """
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
        """Return the number of the mesh vertex at a place, in the joint as drawn.

        Args:
            x: coordinates of the place, one length per dimension.

        Raises:
            InputError: no vertex is within 1e-6 of the mesh's size from `x`; the message names the nearest one.
        """
        vertices = np.unique(self.corners)
        if finite_values(x, (self.dim,)) is None:
            raise InputError(f"point {x!r} is not a place; give {self.dim} coordinates")
        distance = np.linalg.norm(self.reference[vertices] - np.asarray(x, float), axis=1)
        nearest = int(vertices[np.argmin(distance)])
        if distance.min() > 1e-6 * np.ptp(self.reference, axis=0).max():
            raise InputError(f"no mesh vertex at {tuple(x)}; the nearest is {place_text(self.reference[nearest])}")
        return nearest
