"""Inflating S: the surface between two bodies becomes a band of cells of total thickness eps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import basix
import numpy as np

from forms.base import is_finite
from geometry.joint import (
    BASE,
    FLAT,
    LAYER,
    LOWER_FACE,
    UPPER_FACE,
    Band,
    GeometryError,
    Joint,
    Profile,
    place,
    unknown,
)
from geometry.motion import extended_motion, face_directions, require_no_branches, require_room, sides_at_nodes
from geometry.topology import (
    FACET_TYPES,
    FacetTable,
    FloatArray,
    IntArray,
    is_tensor,
    lagrange,
    node_jacobians,
)

WAYS = ("kept", "extended")
NOT_KEPT = "the bodies cannot be moved apart in one piece; use bodies='extended'"


@dataclass(frozen=True)
class _Levels:
    """Nodes of the band: level 0 is its lower face, the last level its upper face, which keeps S's node numbers.

    Cells of degree 2 have nodes at the levels of their faces and half-way between.
    """

    nodes: IntArray  # of S
    first_new: int
    heights: FloatArray  # of the levels, in units of the thickness, from 0 to 1

    @property
    def top(self) -> int:
        return len(self.heights) - 1

    def number(self, nodes: IntArray, level: int | IntArray) -> IntArray:
        """Node numbers at a level above or below the given nodes of S."""
        new = self.first_new + level * len(self.nodes) + np.searchsorted(self.nodes, nodes)
        return np.where(level == self.top, nodes, new)

    def footprint(self, rows: IntArray) -> IntArray:
        """The nodes of S below or above given nodes of the band."""
        return np.where(rows < self.first_new, rows, self.nodes[(rows - self.first_new) % len(self.nodes)])


def inflate(
    joint: Joint,
    eps: float,
    *,
    profile: Profile | None = None,
    cells_through: int = 4,
    fractions: Sequence[float] = (),
    bodies: str = "kept",
) -> Joint:
    """Open S into a meshed layer.

    Args:
        joint: the joint; S planar for bodies="kept".
        eps: thickness of the layer, a length > 0.
        profile: function of coordinates (d, n) that returns n numbers > 0: the thickness at the vertices of S is eps times
            these, and linear in between. None: uniform.
        cells_through: number of cells through the thickness, at least 1; each sublayer gets at least one.
        fractions: thickness shares of the sublayers, from the lower to the upper face, with sum 1; () for a single layer.
        bodies: "kept": the bodies keep their shape and move apart by eps (on a rigid base the layer grows below
            the body); S planar, thickness uniform. "extended": the outer shape is kept; each body gives up half of the
            thickness (on a rigid base the body gives up all of it), its nodes move by a harmonic motion that slides
            along the outer faces.

    Returns:
        A joint with the layer's cells in regions "LAYER" (or "LAYER/1", "LAYER/2", ... upwards), its faces in the facet
        sets "LOWER_FACE" ("BASE" on a rigid base) and "UPPER_FACE", and its side faces in "NAME/LAYER" for each outer
        set NAME that they continue. Body cells keep their numbers and their nodes' order, curved cells stay curved.

    Raises:
        GeometryError: a size, cells_through or fractions out of range; S ends inside the bodies, branches or is folded; S
            curved or the thickness varying (kept); outer faces that touch S and are nearly parallel to it (extended); cells
            turned inside out, a layer that overlaps the bodies.
    """
    _check(joint, eps, cells_through, fractions, bodies)
    thickness = float(eps) * joint.relative_thickness(profile)
    levels = _levels(joint, cells_through, fractions)
    low, _ = sides_at_nodes(joint)
    body_cells = joint.cells.copy()
    below = low[joint.cells] == joint.splitting.of_nodes
    body_cells[below] = levels.number(joint.cells[below], 0)
    band_cells, sublayer, director = _band_cells(joint, levels, fractions)
    cells = np.concatenate([body_cells, band_cells])

    reference = np.concatenate([joint.points, np.tile(joint.points[levels.nodes], (levels.top, 1))])
    points = reference + _motion(joint, body_cells, levels, thickness, bodies)
    _check_cells(joint, points, cells)

    names = (LAYER,) if not fractions else tuple(f"{LAYER}/{k + 1}" for k in range(len(fractions)))
    return Joint(
        points,
        cells,
        joint.cell_type,
        np.concatenate([joint.region, len(joint.regions) + sublayer]),
        joint.regions + names,
        _move_facets(joint, body_cells, levels, band_cells[:, : joint.corners.shape[1]]),
        joint.seams,
        band=Band(float(eps), bodies, names, joint, reference, director),
    )


def check_layering(cells_through: int, bodies: str) -> None:
    """Raise GeometryError unless cells_through >= 1 and `bodies` is "kept" or "extended"."""
    if bodies not in WAYS:
        raise GeometryError(unknown("way to make room for the layer (bodies=...)", bodies, WAYS))
    if not is_finite(cells_through) or int(cells_through) != cells_through or cells_through < 1:
        raise GeometryError(
            f"cells_through is {cells_through!r}; the layer needs a whole number >= 1 of cells through its thickness"
        )


def _check(joint: Joint, eps: float, cells_through: int, fractions: Sequence[float], bodies: str) -> None:
    check_layering(cells_through, bodies)
    if not isinstance(joint, Joint):
        raise GeometryError(f"inflate takes a joint, not {joint!r}")
    if joint.band is not None:
        raise GeometryError("this joint is inflated already; inflate the joint it came from")
    if not is_finite(eps) or eps <= 0:
        raise GeometryError(f"the layer's thickness eps is {eps!r}; it must be > 0")
    if len(fractions) and not (
        all(map(is_finite, fractions)) and min(fractions) > 0 and abs(sum(fractions) - 1) <= 1e-12
    ):
        raise GeometryError(f"the sublayers' fractions {tuple(fractions)} must be numbers > 0 and add up to 1")
    if joint.periods:
        raise GeometryError(
            "a periodic joint has no meshed layer: inflated, its sides would not match; use the interface model, or "
            "inflate a large piece that is not periodic"
        )
    if joint.tip is not None:
        raise GeometryError(
            f"S ends inside the bodies (near {place(joint.tip)}): the layer has no room at its tip and cannot be meshed; "
            "use the interface model"
        )
    require_no_branches(joint)
    if len(joint.seams) > 1:
        raise GeometryError(f"a joint with several seams, {', '.join(joint.seams)}, cannot be inflated")


def _levels(joint: Joint, cells_through: int, fractions: Sequence[float]) -> _Levels:
    degree = joint.degree
    shares = np.asarray(fractions if len(fractions) else [1.0])
    counts = degree * np.maximum(1, np.rint(cells_through * shares).astype(int))
    edges = np.concatenate([[0.0], np.cumsum(shares)])
    edges[-1] = 1.0
    heights = [np.linspace(edges[k], edges[k + 1], n + 1)[1:] for k, n in enumerate(counts)]
    return _Levels(np.unique(joint.surface), len(joint.points), np.concatenate([[0.0], *heights]))


def _band_cells(joint: Joint, levels: _Levels, fractions: Sequence[float]) -> tuple[IntArray, IntArray, FloatArray]:
    """Cells between the levels, their sublayer, and the normal of S at each of their corners."""
    surface, degree = joint.surface, joint.degree
    if is_tensor(joint.cell_type):
        patterns = _extruded(joint.cell_type, degree, len(surface))
    else:
        order = np.argsort(surface[:, : joint.dim], axis=1)
        patterns = _split_prisms(joint.cell_type, degree, order)
    edges = np.cumsum(fractions)[:-1] if len(fractions) else np.empty(0)
    cells, sublayer, director = [], [], []
    k = joint.corners.shape[1]
    for base in range(0, levels.top, degree):
        middle = (levels.heights[base] + levels.heights[base + degree]) / 2
        for columns, offsets in patterns:
            cells.append(levels.number(np.take_along_axis(surface, columns, axis=1), base + offsets))
            director.append(np.take_along_axis(joint.node_normals, columns[:, :k, None], axis=1))
            sublayer.append(np.full(len(surface), np.searchsorted(edges, middle)))
    return np.concatenate(cells), np.concatenate(sublayer), np.concatenate(director)


Pattern = tuple[IntArray, IntArray]  # (n_S, k) node of each facet of S; (k,) levels above the first


def _extruded(cell_type: str, degree: int, n: int) -> list[Pattern]:
    """Quadrilaterals and hexahedra: the facet is the cell's face with last coordinate zero."""
    cell, facet = lagrange(cell_type, degree).points, lagrange(FACET_TYPES[cell_type], degree).points
    distance = np.linalg.norm(cell[:, None, :-1] - facet[None], axis=2)
    return [(np.tile(distance.argmin(axis=1), (n, 1)), np.rint(cell[:, -1] * degree).astype(np.int64))]


def _split_prisms(cell_type: str, degree: int, order: IntArray) -> list[Pattern]:
    """Simplices: prisms are split along sorted vertex numbers, so that neighbours split their common side alike.

    With the facet's vertices sorted, simplex k has its first k + 1 vertices below and the rest, from k on, above. Nodes
    half-way along an edge stand on the middle of that edge's footprint.
    """
    n = order.shape[1]
    middle = np.diag(np.arange(n))
    facet_edges = basix.topology(basix.CellType[FACET_TYPES[cell_type]])[1]
    for number, (i, j) in enumerate(facet_edges):
        middle[i, j] = middle[j, i] = n + number
    patterns = []
    for k in range(n):
        corners = [(i, 0) for i in range(k + 1)] + [(i, degree) for i in range(k, n)]
        columns = [order[:, i] for i, _ in corners]
        offsets = [level for _, level in corners]
        if degree == 2:
            for p, q in basix.topology(basix.CellType[cell_type])[1]:
                columns.append(middle[columns[p], columns[q]])
                offsets.append((offsets[p] + offsets[q]) // 2)
        patterns.append((np.column_stack(columns), np.array(offsets)))
    return patterns


def _motion(joint: Joint, body_cells: IntArray, levels: _Levels, thickness: FloatArray, bodies: str) -> FloatArray:
    """(n_nodes, d) motion of each node."""
    motion: FloatArray = np.zeros((len(joint.points) + levels.top * len(levels.nodes), joint.dim))
    h = thickness[levels.nodes][:, None]
    if bodies == "kept":
        _require_one_way(joint)
        if np.ptp(h) > 1e-12 * h.max():
            raise GeometryError(f"the thickness varies along S: {NOT_KEPT}")
        mean = joint.interface_normals.mean(axis=0)
        n, eps = mean / np.linalg.norm(mean), float(h[0, 0])
        require_room(joint, n, eps)
        start = -1.0 if joint.rigid_base else -0.5
        low = high = np.tile(n, (len(h), 1))
        pieces = joint.splitting.pieces
        for side, end in zip(_pieces_beside(joint), (start, start + 1), strict=True):
            motion[np.unique(body_cells[np.isin(pieces, side)])] = end * eps * n
    else:
        start = 0.0 if joint.rigid_base else -0.5
        high = face_directions(joint, levels.nodes, 1)
        low = high if joint.rigid_base else face_directions(joint, levels.nodes, 0)
        known = np.concatenate([levels.number(levels.nodes, 0), levels.nodes])
        faces = np.concatenate([start * h * low, (start + 1) * h * high])
        motion = extended_motion(joint, body_cells, len(motion), known, faces)
    for level, z in enumerate(levels.heights):
        motion[levels.number(levels.nodes, level)] = h * ((1 - z) * start * low + z * (start + 1) * high)
    return motion


def _pieces_beside(joint: Joint) -> tuple[IntArray, IntArray]:
    """The pieces of the bodies below S and above it."""
    cells, pieces = joint.surface_cells, joint.splitting.pieces
    below, above = (np.unique(pieces[side[side >= 0]]) for side in cells.T)
    return below, above


def _require_one_way(joint: Joint) -> None:
    """Raise GeometryError if the bodies cannot be moved apart along one normal of S."""
    both = np.intersect1d(*_pieces_beside(joint))
    if len(both):
        at = joint.points[joint.corners[joint.splitting.pieces == both[0]][0]].mean(axis=0)
        raise GeometryError(f"one body, as at {place(at)}, lies below S and above it: {NOT_KEPT}")
    if joint.planar:
        return
    normals = joint.node_normals.reshape(-1, joint.dim)
    if (normals @ normals[0] < FLAT - 1).any() and (np.abs(normals @ normals[0]) > 1 - FLAT).all():
        ends = [place(joint.points[joint.surface.ravel()[k]]) for k in (0, int((normals @ normals[0]).argmin()))]
        raise GeometryError(
            f"S lies in parallel planes, and the upper body is on opposite sides of them at {ends[0]} and at {ends[1]}: "
            f"{NOT_KEPT}"
        )
    raise GeometryError(f"S is not planar: {NOT_KEPT}")


def _check_cells(joint: Joint, points: FloatArray, cells: IntArray) -> None:
    before = node_jacobians(joint.points, joint.cells, joint.cell_type)
    after = node_jacobians(points, cells, joint.cell_type)
    n = len(joint.cells)
    bad = np.flatnonzero((before * after[:n] <= 0).any(axis=1))
    if len(bad):
        x = joint.points[joint.cells[bad[0]]].mean(axis=0)
        raise GeometryError(
            f"eps is too large for these bodies: {len(bad)} cells turn inside out, the first at {place(x)}"
        )
    bad = np.flatnonzero(~((after[n:] > 0).all(axis=1) | (after[n:] < 0).all(axis=1)))
    if len(bad):
        x = points[cells[n + bad[0]]].mean(axis=0)
        raise GeometryError(
            f"S turns too sharply for this eps: {len(bad)} cells of the layer are folded, the first at {place(x)}"
        )


def _move_facets(joint: Joint, body_cells: IntArray, levels: _Levels, band: IntArray) -> dict[str, IntArray]:
    """Facet sets of the inflated joint; `band`: vertices of the layer's cells."""
    surface = joint.table.vertices[joint.surface_rows]
    out = {UPPER_FACE: surface, BASE if joint.rigid_base else LOWER_FACE: levels.number(surface, 0)}
    sides = _side_faces(band, joint.cell_type, levels)
    ridges = _ridges(levels.footprint(sides), joint.dim)
    for name, facets in joint.facets.items():
        if name in joint.seams:
            continue
        rows = joint.table.index(facets)
        out[name] = joint.table.nodes(rows, body_cells[:, : joint.corners.shape[1]], joint.cell_type)
        outer = facets[joint.table.cells[rows, 1] < 0]
        continued = np.isin(ridges, _ridges(outer, joint.dim)).any(axis=1)
        if continued.any():
            out[f"{name}/{LAYER}"] = sides[continued]
    return out


def _side_faces(band: IntArray, cell_type: str, levels: _Levels) -> IntArray:
    """Outer facets of the band other than its lower and upper face."""
    table = FacetTable.of(band, cell_type)
    outer = table.vertices[table.cells[:, 1] < 0]
    upper, lower = (
        outer < levels.first_new,
        (outer >= levels.first_new) & (outer < levels.first_new + len(levels.nodes)),
    )
    return outer[~upper.all(axis=1) & ~lower.all(axis=1)]


def _ridges(rows: IntArray, dim: int) -> IntArray:
    """Keys of the ridges of facets given by vertices: vertices in 2D, edges (and a quadrilateral's diagonals) in 3D."""
    rows = np.sort(rows, axis=1)
    k = range(rows.shape[1])
    pairs = [(i, i) for i in k] if dim == 2 else list(combinations(k, 2))
    return np.stack([(rows[:, i] << 32) + rows[:, j] for i, j in pairs], axis=1)
