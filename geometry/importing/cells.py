"""Cells of a mesh from a file or from DOLFINx, as arrays, and checks that a joint can be made of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy.spatial

from geometry.errors import GeometryError, place
from geometry.topology import FACET_TYPES, FacetTable, FloatArray, IntArray, corner_count, lagrange, node_jacobians

CLOSE = 1e-9  # distance of nodes at the same place, at most, over the size of the mesh
FLAT_CELL = 1e-12  # Jacobian of a cell without volume, at most, over size^d
FOLDED = 1e-10  # ratio of the smallest to the largest Jacobian in a folded cell, at most


@dataclass(frozen=True)
class Cells:
    """Cells of one type.

    Attributes:
        points: (n_points, d) coordinates of their nodes.
        nodes: (n_cells, k) in DOLFINx's order.
        type: as in `Joint.cell_type`.
        used: (n_points,) numbers of these points in the mesh they come from.
    """

    points: FloatArray
    nodes: IntArray
    type: str
    used: IntArray

    @classmethod
    def of(cls, points: FloatArray, nodes: IntArray, cell_type: str, what: str) -> Cells:
        """Take over cells and the points that they use.

        Args:
            points: (n, d or 3) coordinates.
            nodes: (n_cells, k) in DOLFINx's order.
            cell_type: as in `Joint.cell_type`.
            what: text for the cells in messages.

        Raises:
            GeometryError: nodes without coordinates, or a surface in 3D.
        """
        used, numbers = np.unique(nodes, return_inverse=True)
        if used[0] < 0 or used[-1] >= len(points) or not np.isfinite(points[used]).all():
            raise GeometryError("the cells have nodes without coordinates")
        dim = lagrange(cell_type, 1).points.shape[1]
        own = points[used]
        height = own[:, dim:]
        if height.size and np.ptp(height) > CLOSE * np.ptp(own, axis=0).max():
            raise GeometryError(
                f"2D mesh in 3D: {what} at z = {height.min():g} to {height.max():g}, not in a plane z = const; "
                "for a solid save the cells of the volume too (gmsh: name them with Physical Volume)"
            )
        return cls(own[:, :dim].copy(), numbers.reshape(nodes.shape), cell_type, used)

    @property
    def corners(self) -> IntArray:
        """(n_cells, k) vertices of each cell."""
        return self.nodes[:, : corner_count(self.type)]

    def refuse(self, bad: npt.NDArray[np.bool_], what: str) -> None:
        """Raise GeometryError if there are bad cells, with their number and the first one's place."""
        if bad.any():
            x = self.points[self.nodes[bad.argmax()]].mean(axis=0)
            raise GeometryError(f"{bad.sum()} of {len(bad)} cells {what}; the first is at {place(x)}")

    def require_sound(self) -> None:
        """Raise GeometryError for cells without volume, folded or duplicate cells, and for nodes at the same place."""
        size = np.ptp(self.points[self.nodes], axis=1).max(axis=1)
        jacobian = node_jacobians(self.points, self.nodes, self.type)
        largest = np.abs(jacobian).max(axis=1)
        self.refuse(largest <= FLAT_CELL * size ** self.points.shape[1], "are degenerate (no volume)")
        smallest = (jacobian * np.sign(jacobian.sum(axis=1))[:, None]).min(axis=1)
        self.refuse(
            smallest <= FOLDED * largest, "are folded (their Jacobian vanishes or changes sign within the cell)"
        )
        _, first = np.unique(np.sort(self.corners, axis=1), axis=0, return_index=True)
        self.refuse(
            ~np.isin(np.arange(len(self.nodes)), first),
            "have the vertices of another cell; each needs to be there once, in one group",
        )
        tree = scipy.spatial.cKDTree(self.points)
        pairs = tree.query_pairs(CLOSE * np.ptp(self.points, axis=0).max(), output_type="ndarray")
        if len(pairs):
            x = self.points[pairs[pairs[:, 0].argmin(), 0]]
            raise GeometryError(
                f"{len(pairs)} pairs of nodes at the same place, the first at {place(x)}: the cells there are not "
                "connected; let bodies share their nodes (gmsh: BooleanFragments or Coherence before meshing, "
                f"removeDuplicateNodes after it), or, for a gap that is to stay unbonded, draw it wider than {CLOSE:g} of "
                "the mesh's size"
            )

    def facets_among(self, vertices: IntArray) -> FacetTable:
        """Facets of the cells that have a whole facet among the given vertices; cells numbered as in `nodes`."""
        near = np.flatnonzero(np.isin(self.corners, vertices).sum(axis=1) >= corner_count(FACET_TYPES[self.type]))
        try:
            table = FacetTable.of(self.corners[near], self.type)
        except ValueError as error:
            raise GeometryError(str(error)) from None
        return replace(table, cells=np.where(table.cells < 0, -1, near[table.cells]))
