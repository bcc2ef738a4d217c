"""Inflating S: the surface between two bodies becomes a band of cells of total thickness eps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
import scipy.sparse.linalg

from geometry.joint import BASE, LAYER, LOWER_FACE, UPPER_FACE, Band, GeometryError, Joint, S, unknown
from geometry.topology import FacetTable, FloatArray, IntArray, corner_jacobians, facet_normals, is_tensor

WAYS = ("kept", "extended")
FLAT = 1e-9  # S counts as planar when its unit normals differ by less


@dataclass(frozen=True)
class _Levels:
    """Vertices of the band: level 0 is its lower face, the last level its upper face, which keeps S's vertex numbers."""

    vertices: IntArray  # of S
    first_new: int
    heights: FloatArray  # of the levels, in units of eps, from 0 to 1

    @property
    def top(self) -> int:
        return len(self.heights) - 1

    def number(self, vertices: IntArray, level: int) -> IntArray:
        """Vertex numbers at a level above or below the given vertices of S."""
        if level == self.top:
            return vertices
        return self.first_new + level * len(self.vertices) + np.searchsorted(self.vertices, vertices)

    def drop(self, rows: IntArray) -> IntArray:
        """The same cells or facets, standing on the lower face of the band instead of S."""
        on_s = np.isin(rows, self.vertices)
        out = rows.copy()
        out[on_s] = self.number(rows[on_s], 0)
        return out


def inflate(joint: Joint, eps: float, *, layers: int = 4, strata: Sequence[float] = (), bodies: str = "kept") -> Joint:
    """Open S into a meshed layer.

    Args:
        joint: the joint; S planar.
        eps: thickness of the layer, a length > 0.
        layers: number of cells through the thickness, at least 1 (each stratum gets at least one).
        strata: thickness fractions of sublayers, from the lower to the upper face, adding up to 1; () for one layer.
        bodies: "kept": the bodies keep their shape and are moved apart by eps (on a rigid base the layer grows below
            the body). "extended": the total shape is kept; the bodies give up eps/2 each (on a rigid base the body
            gives up eps), and their cells follow by a harmonic motion along n.

    Returns:
        A joint with the layer's cells in regions "LAYER" (or "LAYER/1", "LAYER/2", ... upwards), its faces in the facet
        sets "LOWER_FACE" ("BASE" on a rigid base) and "UPPER_FACE", and its side faces in "NAME/LAYER" for each outer
        set NAME that they continue. Body cells keep their numbers and their vertices' order.

    Raises:
        GeometryError: eps, layers or strata out of range, S not planar, faces inclined to n that touch S (extended),
            cells turned inside out.
    """
    _check(joint, eps, layers, strata, bodies)
    normal = _planar_normal(joint)
    levels = _levels(joint, layers, strata)
    surface = joint.facets[S]
    below = joint.side < 0

    body_cells = joint.cells.copy()
    body_cells[below] = levels.drop(joint.cells[below])
    band_cells, stratum = _band_cells(surface, levels, strata, joint.cell_type)
    cells = np.concatenate([body_cells, band_cells])

    names = (LAYER,) if not strata else tuple(f"{LAYER}/{k + 1}" for k in range(len(strata)))
    region = np.concatenate([joint.region, len(joint.regions) + stratum])
    reference = np.concatenate([joint.points] + [joint.points[levels.vertices]] * levels.top)
    height = _heights(joint, body_cells, levels, bodies, float(eps), normal)
    points = reference + height[:, None] * normal
    _check_cells(joint, points, cells)

    facets = _move_facets(joint, surface, levels, cells, len(body_cells))
    return Joint(
        points,
        cells,
        joint.cell_type,
        region,
        joint.regions + names,
        facets,
        joint.upper,
        joint.lower,
        band=Band(float(eps), bodies, names, joint, reference),
    )


def check_layering(layers: int, bodies: str) -> None:
    """Raise GeometryError if the number of cells through the thickness or the way to make room is out of range."""
    if bodies not in WAYS:
        raise GeometryError(unknown("way to make room for the layer (bodies=...)", bodies, WAYS))
    if not np.isfinite(layers) or int(layers) != layers or layers < 1:
        raise GeometryError(f"layers is {layers}; the layer needs a whole number >= 1 of cells through its thickness")


def _check(joint: Joint, eps: float, layers: int, strata: Sequence[float], bodies: str) -> None:
    check_layering(layers, bodies)
    if joint.band is not None:
        raise GeometryError("this joint is inflated already; inflate the joint it came from")
    if not np.isfinite(eps) or eps <= 0:
        raise GeometryError(f"the layer's thickness eps is {eps}; it must be > 0")
    if len(strata) and (min(strata) <= 0 or abs(sum(strata) - 1) > 1e-12):
        raise GeometryError(f"the strata's fractions {tuple(strata)} must be > 0 and add up to 1")
    inner = np.unique(joint.cells[joint.side < 0]) if joint.lower else np.empty(0, np.int64)
    shared = np.intersect1d(inner, np.unique(joint.cells[joint.side > 0]))
    if not np.isin(shared, joint.facets[S]).all():
        raise GeometryError("S ends inside the bodies: a layer cannot be meshed there")


def _planar_normal(joint: Joint) -> FloatArray:
    normals = joint.interface_normals
    if np.ptp(normals, axis=0).max() > FLAT:
        raise GeometryError("S is not planar: it cannot be inflated")
    return normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))


def _levels(joint: Joint, layers: int, strata: Sequence[float]) -> _Levels:
    fractions = np.asarray(strata if len(strata) else [1.0])
    counts = np.maximum(1, np.rint(layers * fractions).astype(int))
    edges = np.concatenate([[0.0], np.cumsum(fractions)])
    edges[-1] = 1.0
    heights = [np.linspace(edges[k], edges[k + 1], n + 1)[1:] for k, n in enumerate(counts)]
    return _Levels(np.unique(joint.facets[S]), len(joint.points), np.concatenate([[0.0], *heights]))


def _band_cells(
    surface: IntArray, levels: _Levels, strata: Sequence[float], cell_type: str
) -> tuple[IntArray, IntArray]:
    """Cells between the levels and their stratum; prisms are split along sorted vertex numbers, alike on both sides."""
    edges = np.cumsum(strata)[:-1] if len(strata) else np.empty(0)
    cells, stratum = [], []
    for level in range(levels.top):
        facets = surface if is_tensor(cell_type) else np.sort(surface, axis=1)
        low, high = levels.number(facets, level), levels.number(facets, level + 1)
        if is_tensor(cell_type):
            new = [np.concatenate([low, high], axis=1)]
        else:
            new = [np.concatenate([low[:, : k + 1], high[:, k:]], axis=1) for k in range(surface.shape[1])]
        middle = levels.heights[level : level + 2].mean()
        cells += new
        stratum.append(np.full(sum(map(len, new)), np.searchsorted(edges, middle)))
    return np.concatenate(cells), np.concatenate(stratum)


def _heights(
    joint: Joint, body_cells: IntArray, levels: _Levels, bodies: str, eps: float, normal: FloatArray
) -> FloatArray:
    """How far each vertex moves along n."""
    n_body = len(joint.points)
    height = np.zeros(n_body + levels.top * len(levels.vertices))
    start = (-1.0 if bodies == "kept" else 0.0) if joint.rigid_base else -0.5
    for level, z in enumerate(levels.heights):
        height[levels.number(levels.vertices, level)] = (start + z) * eps
    above, below = (np.unique(body_cells[joint.side == s]) for s in (1, -1))
    if bodies == "kept":
        height[above] = height[levels.vertices[0]]
        height[below] = -eps / 2
        return height
    faces = np.concatenate([levels.number(levels.vertices, level) for level in (0, levels.top)])
    fixed = np.setdiff1d(_inclined_vertices(joint, normal), levels.vertices)
    free = np.setdiff1d(np.union1d(above, below), np.union1d(faces, fixed))
    laplacian = scipy.sparse.csgraph.laplacian(_edge_graph(body_cells, len(height)))
    if len(free):
        rows = laplacian.tocsr()[free]
        known = np.setdiff1d(np.arange(len(height)), free)
        height[free] = scipy.sparse.linalg.spsolve(rows[:, free].tocsc(), -(rows[:, known] @ height[known]))
    return height


def _edge_graph(cells: IntArray, n: int) -> scipy.sparse.csr_matrix:
    """Vertices of a common cell, connected with weight one."""
    k = cells.shape[1]
    pairs = np.concatenate([cells[:, [i, j]] for i in range(k) for j in range(k) if i != j])
    graph = scipy.sparse.coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n)).tocsr()
    graph.data[:] = 1.0
    return graph


def _inclined_vertices(joint: Joint, normal: FloatArray) -> IntArray:
    """Vertices of outer faces that are not parallel to n: the total shape is kept when they stay."""
    outer = joint.table.vertices[joint.table.cells[:, 1] < 0]
    outer = outer[~np.isin(joint.table.index(outer), joint.table.index(joint.facets[S]))]
    inclined = np.abs(facet_normals(joint.points, outer) @ normal) > 1e-6
    touching = np.isin(outer[inclined], joint.facets[S]).any(axis=1)
    if touching.any():
        x = joint.points[outer[inclined][touching][0]].mean(axis=0)
        raise GeometryError(
            f"bodies='extended' cannot keep the shape: the outer face at {tuple(x.tolist())} touches S and is inclined to n"
        )
    return np.unique(outer[inclined])


def _check_cells(joint: Joint, points: FloatArray, cells: IntArray) -> None:
    before = corner_jacobians(joint.points, joint.cells, joint.cell_type)
    after = corner_jacobians(points, cells, joint.cell_type)
    n = len(joint.cells)
    bad = np.flatnonzero((before * after[:n] <= 0).any(axis=1))
    if len(bad):
        x = joint.points[joint.cells[bad[0]]].mean(axis=0)
        raise GeometryError(
            f"eps is too large for these bodies: {len(bad)} cells turn inside out, the first at {tuple(x.tolist())}"
        )
    band = after[n:]
    if not ((band > 0).all(axis=1) | (band < 0).all(axis=1)).all():
        raise GeometryError("cells of the layer are folded")


def _move_facets(joint: Joint, surface: IntArray, levels: _Levels, cells: IntArray, n_body: int) -> dict[str, IntArray]:
    """Facet sets of the inflated joint."""
    lower_face = BASE if joint.rigid_base else LOWER_FACE
    out = {UPPER_FACE: surface, lower_face: levels.number(surface, 0)}
    side_faces = _side_faces(cells[n_body:], joint.cell_type, levels)
    footprint = np.sort(side_faces, axis=1)
    new = side_faces >= levels.first_new
    footprint = np.where(new, levels.vertices[(side_faces - levels.first_new) % len(levels.vertices)], side_faces)
    for name, facets in joint.facets.items():
        if name == S:
            continue
        side = joint.side[joint.table.cells[joint.table.index(facets), 0]]
        moved = facets.copy()
        moved[side < 0] = levels.drop(facets[side < 0])
        out[name] = moved
        continued = np.isin(footprint, facets).all(axis=1)
        if continued.any():
            out[f"{name}/{LAYER}"] = side_faces[continued]
    return out


def _side_faces(band: IntArray, cell_type: str, levels: _Levels) -> IntArray:
    """Outer facets of the band other than its lower and upper face."""
    table = FacetTable.of(band, cell_type)
    outer = table.vertices[table.cells[:, 1] < 0]
    flat = (outer < levels.first_new).all(axis=1) | (
        (outer >= levels.first_new) & (outer < levels.first_new + len(levels.vertices))
    ).all(axis=1)
    return outer[~flat]
