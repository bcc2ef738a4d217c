"""Nodes and cells of layers: copies of the nodes of S, lines of nodes between copies, and cells between lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import basix
import numpy as np

from forms.base import InputError
from geometry.joint import Joint
from geometry.refusals import place_text, refuse
from geometry.topology import FACET_TYPES, BoolArray, FloatArray, IntArray, is_tensor, lagrange

HEIGHT_TOLERANCE = 1e-12  # difference of heights, relative to the thickness, that counts as zero


class NodeCopies(NamedTuple):
    """Nodes of the bodies after S has opened: each body has its own copy of each of its nodes on S.

    At each node of S one copy keeps the node's number: the one on the upper side of the first facet of S at the node.
    All other copies, and the nodes on a rigid base, have new numbers. These follow the numbers of the joint's points.

    Attributes:
        cells: (n_cells, k) numbers of the k nodes of each of the bodies' cells, with copies in place of nodes of S.
        below, above: (n_S, k) numbers of the copies of the k nodes of each facet of S, on its lower and on its upper
            side.
        new: (n,) for each of the n copies with new numbers, in their order, the node of S that it copies.
        base: (n,) whether each of these n copies is on a rigid base.
    """

    cells: IntArray
    below: IntArray
    above: IntArray
    new: IntArray
    base: BoolArray

    @classmethod
    def of(cls, joint: Joint) -> NodeCopies:
        """Return the copies of the nodes of a joint in which S is a surface."""
        surface, split, n = joint.surface, joint.split_mesh.of_nodes, len(joint.points)
        base_part = int(split.max(initial=0)) + 1
        components = np.stack([joint.components_at(cells, surface) for cells in joint.surface_cells.T])
        sides = surface * (base_part + 1) + np.where(components < 0, base_part, components)
        nodes, first = np.unique(surface, return_index=True)
        places = np.nonzero(np.isin(joint.cells, nodes))
        keys = joint.cells[places] * (base_part + 1) + split[places]
        copy_keys = np.unique(np.concatenate([keys, sides[0].ravel()]))
        new = np.setdiff1d(copy_keys, sides[1].ravel()[first], assume_unique=True)

        def copy_number(keys: IntArray) -> IntArray:
            at = np.minimum(np.searchsorted(new, keys), len(new) - 1)
            return np.where(new[at] == keys, n + at, keys // (base_part + 1))

        body_cells = joint.cells.copy()
        body_cells[places] = copy_number(keys)
        nodes, component = np.divmod(new, base_part + 1)
        return cls(body_cells, copy_number(sides[0]), copy_number(sides[1]), nodes, component == base_part)

    def renumbered(self, number: IntArray) -> NodeCopies:
        """Return the copies with other numbers in `cells`, `below` and `above`.

        Args:
            number: (n_nodes,) new number of each node and copy; -1 for copies on a rigid base that are left out.
        """
        return self._replace(cells=number[self.cells], below=number[self.below], above=number[self.above])


@dataclass(frozen=True)
class NodeLines:
    """Lines of nodes through the thickness of layers: each leads from one copy of a node of S to another copy.

    The nodes of a line are counted by levels, from 0 at the first copy to the last level at the other copy. Layers with
    cells of degree 2 also have a level in the middle of each cell.

    Attributes:
        first_new: number of the first node inside a line; the copies at the ends of lines have smaller numbers.
        ends: (n, 2) numbers of the first and of the other copy of each line.
        nodes: (n,) the node of S that both are copies of.
        seam_no: (n,) position in `Joint.seams` of the seam of each line.
        heights: for each seam the heights of all levels, as fractions of the thickness from 0 to 1.
    """

    first_new: int
    ends: IntArray
    nodes: IntArray
    seam_no: IntArray
    heights: tuple[FloatArray, ...]

    @cached_property
    def top(self) -> IntArray:
        """(n,) last level of each line."""
        return np.array([len(heights) - 1 for heights in self.heights])[self.seam_no]

    @cached_property
    def start(self) -> IntArray:
        """(n,) number of the node at level 1 of each line; the nodes at its next levels have the next numbers."""
        return self.first_new + np.cumsum(self.top - 1) - (self.top - 1)

    @property
    def size(self) -> int:
        """Number of all nodes inside lines, without the copies at their ends."""
        return int((self.top - 1).sum())

    def number(self, lines: IntArray, level: IntArray | int) -> IntArray:
        """Return the numbers of the nodes at given levels of given lines.

        Args:
            lines: numbers of the lines, an array of any shape.
            level: level on each line; shapes of `lines` and `level` are broadcast as in numpy.
        """
        second = np.where(level == self.top[lines], self.ends[lines, 1], self.start[lines] + np.asarray(level) - 1)
        return np.where(np.asarray(level) == 0, self.ends[lines, 0], second)

    def between(self, values: FloatArray) -> tuple[FloatArray, IntArray]:
        """Interpolate values at copies linearly to the nodes inside the lines.

        Args:
            values: (n_nodes, d) values at nodes and copies, such as a motion in d dimensions.

        Returns:
            (m, d) values at the m nodes inside the lines, in the order of their numbers; and (m,) the node of S to
            whose line each belongs.
        """
        line = np.repeat(np.arange(len(self.top)), self.top - 1)
        height_start = np.cumsum([0, *map(len, self.heights)])[self.seam_no[line]]
        level = np.arange(self.first_new, self.first_new + self.size) - self.start[line] + 1
        z = np.concatenate(self.heights)[height_start + level][:, None]
        return (1 - z) * values[self.ends[line, 0]] + z * values[self.ends[line, 1]], self.nodes[line]

    def joined(self, ends: IntArray, nodes: IntArray, seam_no: int) -> NodeLines:
        """Return these lines followed by further lines, all with the levels of one seam.

        Args:
            ends: (n, 2) numbers of the copies at both ends of each of n further lines.
            nodes: (n,) the node of S that both are copies of.
            seam_no: position in `Joint.seams` of the seam.
        """
        kinds = np.append(self.seam_no, np.full(len(nodes), seam_no))
        return replace(self, ends=np.append(self.ends, ends, axis=0), nodes=np.append(self.nodes, nodes), seam_no=kinds)


class FacetLines(NamedTuple):
    """Numbers and directions of the lines of nodes through the thickness at the nodes of each facet of S.

    Attributes:
        lines: (n_S, k) number, in `NodeLines`, of the line at each of the k nodes of each facet.
        is_reversed: (n_S, k) whether this line leads from the facet's upper side to its lower side.
    """

    lines: IntArray
    is_reversed: BoolArray


def node_lines(joint: Joint, copies: NodeCopies, heights: Sequence[FloatArray]) -> tuple[NodeLines, FacetLines]:
    """Return the lines of nodes through the layers, and which of them each facet of S has at its nodes.

    A line connects the copies of a node on the two sides of a facet of S. Facets between the same two copies share it.

    Args:
        joint: the joint as drawn, before S is opened.
        copies: copies of its nodes, one on each body.
        heights: for each seam the heights of the levels of nodes, as fractions of the thickness from 0 to 1.

    Returns:
        All lines of nodes, and the lines at the nodes of each facet of S.

    Raises:
        InputError: one body is on both sides of S at a vertex; two seams share a line but their levels differ; the
            upper side changes along a seam, in 3D or with levels that are not symmetric.
    """
    below, above = copies.below.ravel(), copies.above.ravel()
    line_keys = np.column_stack([joint.surface.ravel(), np.minimum(below, above), np.maximum(below, above)])
    _, first, at = np.unique(line_keys, axis=0, return_index=True, return_inverse=True)
    at = at.ravel()
    ends = np.column_stack([below, above])[first]
    nodes = joint.surface.ravel()[first]
    same_copy = "at {at} one body lies on both sides of S, so that the layer has no room there; use the interface model"
    refuse(ends[:, 0] == ends[:, 1], joint.points[nodes], same_copy)
    is_reversed = below != ends[at, 0]
    seam = np.repeat(joint.seam_numbers, joint.surface.shape[1])
    meetings, example = np.unique(np.column_stack([seam[first][at], seam, is_reversed]), axis=0, return_index=True)
    names, places = list(joint.seams), joint.points[joint.surface.ravel()[example]]
    for (number, other, reverse), x in zip(meetings, places, strict=True):
        levels, other_levels = heights[number], 1 - heights[other][::-1] if reverse else heights[other]
        if len(levels) != len(other_levels) or np.abs(levels - other_levels).max() > HEIGHT_TOLERANCE:
            sides = "the upper side changes" if number == other else f"{names[number]!r} continues {names[other]!r}"
            raise InputError(f"{sides} at {place_text(x)}: sublayers do not meet; give equal ones, upwards on one body")
        if reverse and joint.dim == 3:
            raise InputError(f"the upper side of S changes at {place_text(x)}: in 3D it must be on one side there")
    lines = NodeLines(len(joint.points) + len(copies.new), ends, nodes, seam[first], tuple(heights))
    return lines, FacetLines(at.reshape(joint.surface.shape), is_reversed.reshape(joint.surface.shape))


def level_heights(degree: int, cells_through: int, fractions: Sequence[float]) -> FloatArray:
    """Return the heights of a layer's levels of nodes, as increasing fractions of the thickness from 0 to 1.

    Args:
        degree: degree of the cells' geometry; with 2 there is also a level in the middle of each cell.
        cells_through: number of cells through the thickness. Each sublayer gets its fraction of them, rounded, and at
            least one.
        fractions: thickness of each sublayer over the layer's, from the lower to the upper face; () for no sublayers.
    """
    shares = np.asarray(fractions if len(fractions) else [1.0])
    counts = degree * np.maximum(1, np.rint(cells_through * shares).astype(int))
    edges = [0.0, *np.cumsum(shares)[:-1], 1.0]
    heights = [np.linspace(*ends, n + 1)[1:] for ends, n in zip(pairwise(edges), counts, strict=True)]
    return np.concatenate([[0.0], *heights])


def band_cells(
    joint: Joint, lines: NodeLines, footing: FacetLines, rows: IntArray, heights: FloatArray, fractions: Sequence[float]
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the cells of the layer of one seam, without those at junctions.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the thickness.
        footing: the lines at the nodes of each facet of S.
        rows: numbers of the seam's facets among the n_S facets of S.
        heights: heights of the levels of nodes, as fractions of the thickness from 0 to 1.
        fractions: thickness of each sublayer over the layer's, from the lower to the upper face; () for no sublayers.

    Returns:
        (n, k) numbers of the k nodes of each of the n cells; (n,) number of its sublayer, from 0; and (n, m, d) unit
        normals of S in d dimensions, at the nodes of S to whose lines the m vertices of each cell belong.
    """
    surface, normals, degree = joint.surface[rows], joint.node_normals[rows], joint.degree
    if is_tensor(joint.cell_type):
        patterns = _tensor_pattern(joint.cell_type, degree, len(surface))
    else:
        patterns = _simplex_pattern(joint.cell_type, degree, np.argsort(surface[:, : joint.dim], axis=1))
    edges = np.cumsum(fractions)[:-1] if len(fractions) else np.empty(0)
    cells, sublayer, director = [], [], []
    k, top = joint.corners.shape[1], len(heights) - 1
    for base in range(0, top, degree):
        for facet_nodes, offsets in patterns:
            at = np.take_along_axis(footing.lines[rows], facet_nodes, axis=1)
            is_reversed = np.take_along_axis(footing.is_reversed[rows], facet_nodes, axis=1)
            cells.append(lines.number(at, np.where(is_reversed, top - base - offsets, base + offsets)))
            director.append(np.take_along_axis(normals, facet_nodes[:, :k, None], axis=1))
            sublayer.append(np.full(len(surface), np.searchsorted(edges, (heights[base] + heights[base + degree]) / 2)))
    return np.concatenate(cells), np.concatenate(sublayer), np.concatenate(director)


Pattern = tuple[IntArray, IntArray]  # (n_S, k) node of each facet of S; (k,) levels above the first


def _tensor_pattern(cell_type: str, degree: int, n: int) -> list[Pattern]:
    """Return the places of the nodes of one quadrilateral or hexahedron over each of `n` facets of S.

    The facet is the side of the cell where the last reference coordinate is zero.

    Args:
        cell_type: "quadrilateral" or "hexahedron".
        degree: degree of the cells' geometry.
        n: number of facets.

    Returns:
        A list of one pair. First (n, k): for each of the cell's k nodes the position, in the facet, of the facet's node
        below it. Second (k,): number of levels from the facet's side of the cell to each node.
    """
    cell, facet = lagrange(cell_type, degree).points, lagrange(FACET_TYPES[cell_type], degree).points
    distance = np.linalg.norm(cell[:, None, :-1] - facet[None], axis=2)
    return [(np.tile(distance.argmin(axis=1), (n, 1)), np.rint(cell[:, -1] * degree).astype(np.int64))]


def _simplex_pattern(cell_type: str, degree: int, order: IntArray) -> list[Pattern]:
    """Return the places of the nodes of the triangles or tetrahedra over each of n_S facets of S.

    The space over a facet, between two levels, is split into d simplices in d dimensions. Let the d vertices of the
    facet be sorted by their numbers, so that neighbours split their common sides alike. Simplex j, from 0, has vertices
    0 to j at the lower level, and vertices j to d - 1 at the upper one. The node in the middle of an edge lies over the
    middle of the edge's projection onto S.

    Args:
        cell_type: "triangle" or "tetrahedron".
        degree: degree of the cells' geometry.
        order: (n_S, d) positions, in the facet, of its d vertices sorted by their numbers.

    Returns:
        A pair for each simplex. First (n_S, k): for each of its k nodes the position, in the facet, of the facet's node
        below it. Second (k,): number of levels from the lower level to each node.
    """
    n = order.shape[1]
    edge_nodes = np.diag(np.arange(n))
    for number, (i, j) in enumerate(basix.topology(basix.CellType[FACET_TYPES[cell_type]])[1]):
        edge_nodes[i, j] = edge_nodes[j, i] = n + number
    patterns = []
    for k in range(n):
        columns = [order[:, i] for i in (*range(k + 1), *range(k, n))]
        offsets = [0] * (k + 1) + [degree] * (n - k)
        if degree == 2:
            for p, q in basix.topology(basix.CellType[cell_type])[1]:
                columns.append(edge_nodes[columns[p], columns[q]])
                offsets.append((offsets[p] + offsets[q]) // 2)
        patterns.append((np.column_stack(columns), np.array(offsets)))
    return patterns
