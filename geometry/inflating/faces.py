"""Facet sets of an inflated joint."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from geometry.inflating.bands import Copies
from geometry.joint import Joint
from geometry.seam import BASE, CUT, LAYER, LOWER_FACE, UPPER_FACE
from geometry.sheet import continued
from geometry.topology import BITS, BoolArray, FacetTable, IntArray, ridge_keys, ridges


def moved_facets(
    joint: Joint, copies: Copies, layers: IntArray, n_bands: int, footprint: IntArray, filled: BoolArray
) -> tuple[dict[str, IntArray], tuple[str, ...]]:
    """Facet sets of the inflated joint, and the names of those between bodies and layers.

    Args:
        joint: the joint before inflating.
        copies: of its nodes.
        layers: vertices of the layers' cells, those of bands first.
        n_bands: number of the latter.
        footprint: node of S below or above each node.
        filled: (n_S,) which facets of S have cells.
    """
    vertices = joint.table.vertices[joint.surface_rows]
    order = np.argsort(joint.surface[:, : vertices.shape[1]], axis=1)
    above, below = (np.take_along_axis(side, order, axis=1) for side in (copies.above, copies.below))
    on_base = joint.surface_cells[:, 0] < 0
    out: dict[str, IntArray] = {}
    for number, seam in enumerate(joint.seams):
        here, prefix = joint.seam_numbers == number, "" if len(joint.seams) == 1 else f"{seam}/"
        out[f"{prefix}{UPPER_FACE}"] = above[here]
        if not on_base[here].any():
            out[f"{prefix}{LOWER_FACE}"] = below[here]
    gaps = [name for number, name in enumerate(joint.seams) if not filled[joint.seam_numbers == number].any()]
    faces = tuple(name for name in out if name.split("/")[0] not in gaps)
    if (on_base & filled).any():
        out[BASE] = below[on_base & filled]
    sides, of_band = _side_faces(layers, n_bands, joint.cell_type, np.concatenate([above[filled], below[filled]]))
    stands = footprint[sides]
    at_cut = np.isin(_ridges(stands, joint.dim), _cut(joint, filled)).any(axis=1)
    if at_cut.any():
        out[CUT] = sides[at_cut]
    ridges, upright = _ridges(stands, joint.dim), (stands == stands[:, :1]).all(axis=1)
    for name, facets in joint.facets.items():
        if name in joint.seams:
            continue
        rows = joint.table.index(facets)
        out[name] = joint.table.nodes(rows, copies.cells[:, : joint.corners.shape[1]], joint.cell_type)
        outer = facets[joint.table.cells[rows, 1] < 0]
        on = np.isin(ridges, continued(joint, outer)).any(axis=1)
        around = stands[on & of_band]  # the end of a junction in 3D continues what the layers around it do
        on |= upright & np.isin(stands[:, 0], around)
        if on.any():
            out[f"{name}/{LAYER}"] = sides[on]
    return out, faces


def _cut(joint: Joint, filled: BoolArray) -> IntArray:
    """Keys of the ridges of S between facets with cells and facets of the same seam without."""
    found = []
    for number in range(len(joint.seams)):
        here = joint.seam_numbers == number
        with_cells, without = (
            ridge_keys(ridges(joint.surface[here & some], joint.cell_type)[0]) for some in (filled, ~filled)
        )
        found.append(np.intersect1d(with_cells, without))
    return np.concatenate(found)


def _side_faces(layers: IntArray, n_bands: int, cell_type: str, faces: IntArray) -> tuple[IntArray, BoolArray]:
    """Outer facets of the layers other than their lower and upper faces, and whether they are those of bands."""
    table = FacetTable.of(layers, cell_type)
    outer = table.cells[:, 1] < 0
    outer[table.index(faces)] = False
    return table.vertices[outer], table.cells[outer, 0] < n_bands


def _ridges(rows: IntArray, dim: int) -> IntArray:
    """Keys of the ridges of facets given by vertices: vertices in 2D, edges (and a quadrilateral's diagonals) in 3D."""
    rows = np.sort(rows, axis=1)
    k = range(rows.shape[1])
    pairs = [(i, i) for i in k] if dim == 2 else list(combinations(k, 2))
    return np.stack([(rows[:, i] << BITS) + rows[:, j] for i, j in pairs], axis=1)
