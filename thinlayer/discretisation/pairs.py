"""Numbers for the pairs of bodies that a seam joins around a vertex of S."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from geometry.joint import Joint

IntArray = npt.NDArray[np.int64]


def component_at(joint: Joint, cells: IntArray, vertices: IntArray) -> IntArray:
    """(n, k) component, around vertices (n, k), of the cells (n,) that have them; -1 for cells < 0."""
    corner = (joint.corners[cells][:, None, :] == vertices[:, :, None]).argmax(axis=2)
    found = np.take_along_axis(joint.splitting.of_nodes[cells], corner, axis=1)
    return np.where(cells[:, None] < 0, -1, found)


def pair_numbers(joint: Joint) -> IntArray:
    """(n_S, k) number of the pair of bodies at each vertex of each facet of S: of the vertex, its seam and components."""
    vertices = joint.table.vertices[joint.surface_rows]
    below, above = (component_at(joint, cells, vertices) for cells in joint.surface_cells.T)
    count = int(max(below.max(), above.max())) + 2
    codes = (joint.seam_numbers[:, None] * count + above) * count + below + 1
    return np.asarray(joint.masters[vertices] * (codes.max() + 1) + codes, np.int64)


def pairs_of(joint: Joint, seam: str, file_numbers: IntArray) -> IntArray:
    """(n,) numbers of the pairs of bodies at nodes of a seam, which are given as `ContactNodes.file_numbers`."""
    here = joint.seam_numbers == list(joint.seams).index(seam)
    rows, facets = joint.surface_rows[here], pair_numbers(joint)[here]
    row, corner = np.divmod(file_numbers, facets.shape[1])
    return np.asarray(facets[np.searchsorted(rows, row), corner])
