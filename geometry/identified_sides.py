"""The class `Periods`: pairs of sides of a periodic cell that are identified with each other."""

from __future__ import annotations

from dataclasses import dataclass, field

import basix
import numpy as np

from geometry.refusals import refuse
from geometry.topology import BoolArray, FloatArray, IntArray, components, ridge_keys

DISTANCE_TOLERANCE = 1e-6  # largest distance of two places that count as the same, over the size of the joint
CUT_ADVICE = "the cells on its two sides are no neighbours in the mesh; cut the periodic cell through bodies instead"


@dataclass(frozen=True)
class Periods:
    """Pairs of sides of a periodic cell that are identified: a translation maps one side onto the other.

    Attributes:
        sides: for each pair, the names of the facet sets of its first and of its second side.
        node_pairs: for each pair of sides an array (n, 2). A row has the numbers of a node on the first side and of the
            node on the second side onto which the translation maps it.
    """

    sides: tuple[tuple[str, str], ...]
    node_pairs: tuple[IntArray, ...] = field(repr=False)

    @property
    def side_names(self) -> tuple[str, ...]:
        """Names of the facet sets of all sides that are identified in pairs by periodicity."""
        return tuple(name for pair in self.sides for name in pair)

    def vectors(self, points: FloatArray) -> FloatArray:
        """Return the array (m, d): for each of the m pairs the translation of the first side onto the second, lengths.

        Args:
            points: (n, d) coordinates of the nodes of the mesh in d dimensions, lengths.
        """
        return np.array([points[pair[0, 1]] - points[pair[0, 0]] for pair in self.node_pairs])

    def masters(self, n: int) -> IntArray:
        """Return (n,): for each of `n` nodes the lowest number among the nodes identified with it, itself included."""
        first, second = np.concatenate(self.node_pairs).T
        component = components(first, second, n)
        return np.unique(component, return_index=True)[1][component]

    def check(self, points: FloatArray, corners: IntArray, cell_type: str, seams: IntArray) -> None:
        """Raise InputError if sides do not match, a seam lies on one, or fewer than three cells lie between two sides.

        Args:
            points: (n_points, d) coordinates of the nodes in d dimensions.
            corners: (n_cells, k) numbers of the k vertices of each cell.
            cell_type: type of the cells.
            seams: (n, m) numbers of the m vertices of each facet on the outer boundary that is in a seam.
        """
        for (first, second), pair, vector in zip(self.sides, self.node_pairs, self.vectors(points), strict=True):
            mismatch = np.abs(points[pair[:, 1]] - points[pair[:, 0]] - vector).max(axis=1)
            message = f"the sides {first!r} and {second!r} do not match any more at {{at}}; move both alike"
            refuse(mismatch > DISTANCE_TOLERANCE * np.ptp(points, axis=0).max(), points[pair[:, 0]], message)
        master = self.masters(len(points))
        tied = np.bincount(master, minlength=len(master))[master] > 1
        refuse(tied[seams].all(axis=1), points[seams], f"a seam lies on the periodic boundary, at {{at}}: {CUT_ADVICE}")
        edges = corners[:, np.array(basix.topology(basix.CellType[cell_type])[1])].reshape(-1, 2)
        names = " and ".join(f"{first!r} and {second!r}" for first, second in self.sides)
        advice = f"a periodic cell needs three cells or more between its sides ({names}); use a finer mesh near {{at}}"
        refuse(_folded_edges(points, edges, master), points[edges], advice)


def _folded_edges(points: FloatArray, edges: IntArray, master: IntArray) -> BoolArray:
    """Return (n,) whether each edge is closed, or coincides with a different edge, once periodic sides are identified.

    Both happen if a periodic cell is too few cells wide.

    Args:
        points: (n_points, d) coordinates of the nodes in d dimensions.
        edges: (n, 2) numbers of the two end nodes of each edge.
        master: (n_points,) for each node the lowest number among the nodes identified with it, itself included.
    """
    ends = master[edges]
    edge_vectors = (points[edges[:, 1]] - points[edges[:, 0]]) * np.where(ends[:, 0] > ends[:, 1], -1.0, 1.0)[:, None]
    _, row, code = np.unique(ridge_keys(ends), return_index=True, return_inverse=True)
    difference = np.abs(edge_vectors - edge_vectors[row[code.ravel()]]).max(axis=1)
    return np.asarray((ends[:, 0] == ends[:, 1]) | (difference > DISTANCE_TOLERANCE * np.ptp(points, axis=0).max()))
