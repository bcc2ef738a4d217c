"""Nodes and cells of layers: copies of the nodes of S, lines of nodes between copies, and cells between lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import basix
import numpy as np

from forms.base import InputError, is_integer, require
from geometry.joint import Joint
from geometry.refusals import place_text, refuse
from geometry.topology import FACET_TYPES, BoolArray, FloatArray, IntArray, is_tensor, lagrange

HEIGHT_TOLERANCE = 1e-12  # difference of heights, relative to the thickness, that counts as zero


class NodeCopies(NamedTuple):
    """Nodes of the bodies after S has opened: each body has its own copy of each of its nodes on S.

    At each node of S one copy keeps the node's number: the one on the upper side of the first facet of S at the node.
    All other copies, and the nodes on a rigid base, have new numbers. These follow the numbers of the joint's points.

    Attributes:
        body_cells: (n_cells, k) numbers of the k nodes of each of the bodies' cells, with copies in place of nodes of
            S.
        below, above: (n_S, k) numbers of the copies of the k nodes of each facet of S, on its lower and on its upper
            side.
        copied_nodes: (n,) for each of the n copies with new numbers, in their order, the node of S that it copies.
        is_on_base: (n,) whether each of these n copies is on a rigid base.
    """

    body_cells: IntArray
    below: IntArray
    above: IntArray
    copied_nodes: IntArray
    is_on_base: BoolArray

    @classmethod
    def of(cls, joint: Joint) -> NodeCopies:
        """Return the copies of the nodes of a joint in which S is a surface."""
        surface, node_components, n = joint.surface, joint.split_mesh.node_components, len(joint.points)
        base_component = int(node_components.max(initial=0)) + 1
        components = joint.side_components()
        side_keys = surface * (base_component + 1) + np.where(components < 0, base_component, components)
        nodes, first_index = np.unique(surface, return_index=True)
        s_entries = np.nonzero(np.isin(joint.cells, nodes))
        keys = joint.cells[s_entries] * (base_component + 1) + node_components[s_entries]
        new_keys = np.setdiff1d(np.concatenate([keys, side_keys[0].ravel()]), side_keys[1].ravel()[first_index])

        def copy_number(keys: IntArray) -> IntArray:
            at = np.minimum(np.searchsorted(new_keys, keys), len(new_keys) - 1)
            return np.where(new_keys[at] == keys, n + at, keys // (base_component + 1))

        body_cells = joint.cells.copy()
        body_cells[s_entries] = copy_number(keys)
        nodes, component = np.divmod(new_keys, base_component + 1)
        return cls(body_cells, copy_number(side_keys[0]), copy_number(side_keys[1]), nodes, component == base_component)

    def renumbered(self, new_no: IntArray) -> NodeCopies:
        """Return the copies with other numbers in `body_cells`, `below` and `above`.

        Args:
            new_no: (n_nodes,) new number of each node and copy; -1 for copies on a rigid base that are left out.
        """
        return self._replace(body_cells=new_no[self.body_cells], below=new_no[self.below], above=new_no[self.above])


@dataclass(frozen=True)
class NodeLines:
    """Lines of nodes through the thickness of layers: each leads from one copy of a node of S to another copy.

    The nodes of a line are counted by levels, from 0 at the first copy to the last level at the other copy. Layers with
    cells of degree 2 also have a level in the middle of each cell.

    Attributes:
        first_inner_node: lowest number of a node inside a line; copies at the ends of lines have lower numbers.
        ends: (n, 2) numbers of the first and of the other copy of each line.
        feet: (n,) the node of S that both are copies of.
        seam_no: (n,) position in `Joint.seams` of the seam of each line.
        heights: for each seam the heights of all levels, as fractions of the thickness from 0 to 1.
    """

    first_inner_node: int
    ends: IntArray
    feet: IntArray
    seam_no: IntArray
    heights: tuple[FloatArray, ...]

    @cached_property
    def last_level(self) -> IntArray:
        """(n,) number of the last level of each line, at which its other copy is."""
        return np.array([len(heights) - 1 for heights in self.heights])[self.seam_no]

    @cached_property
    def start(self) -> IntArray:
        """(n,) number of the node at level 1 of each line; the nodes at its next levels have the next numbers."""
        return self.first_inner_node + np.cumsum(self.last_level - 1) - (self.last_level - 1)

    @property
    def n_inner_nodes(self) -> int:
        """Number of all nodes inside lines, without the copies at their ends."""
        return int((self.last_level - 1).sum())

    def node_numbers(self, lines: IntArray, level: IntArray | int) -> IntArray:
        """Return the numbers of the nodes at given levels of given lines.

        Args:
            lines: numbers of the lines, an array of any shape.
            level: level on each line; shapes of `lines` and `level` are broadcast as in numpy.
        """
        node = np.where(level == self.last_level[lines], self.ends[lines, 1], self.start[lines] + np.asarray(level) - 1)
        return np.where(np.asarray(level) == 0, self.ends[lines, 0], node)

    def interpolate(self, values: FloatArray) -> tuple[FloatArray, IntArray]:
        """Interpolate values at copies linearly to the nodes inside the lines.

        Args:
            values: (n_nodes, d) values at nodes and copies, such as a motion in d dimensions.

        Returns:
            (m, d) values at the m nodes inside the lines, in the order of their numbers; and (m,) the node of S to
            whose line each belongs.
        """
        line = np.repeat(np.arange(len(self.last_level)), self.last_level - 1)
        first_index = np.cumsum([0, *map(len, self.heights)])[self.seam_no[line]]
        level = np.arange(self.first_inner_node, self.first_inner_node + self.n_inner_nodes) - self.start[line] + 1
        z = np.concatenate(self.heights)[first_index + level][:, None]
        return (1 - z) * values[self.ends[line, 0]] + z * values[self.ends[line, 1]], self.feet[line]

    def with_lines(self, ends: IntArray, feet: IntArray, seam_no: int) -> NodeLines:
        """Return these lines followed by further lines, all with the levels of one seam.

        Args:
            ends: (n, 2) numbers of the copies at both ends of each of n further lines.
            feet: (n,) the node of S that both are copies of.
            seam_no: position in `Joint.seams` of the seam.
        """
        seams = np.append(self.seam_no, np.full(len(feet), seam_no))
        return replace(self, ends=np.append(self.ends, ends, axis=0), feet=np.append(self.feet, feet), seam_no=seams)


class FacetLines(NamedTuple):
    """Numbers and directions of the lines of nodes through the thickness at the nodes of each facet of S.

    Attributes:
        line_numbers: (n_S, k) number, in `NodeLines`, of the line through each of the k nodes of each facet.
        is_reversed: (n_S, k) whether this line leads from the facet's upper side to its lower side.
    """

    line_numbers: IntArray
    is_reversed: BoolArray


def node_lines(joint: Joint, copies: NodeCopies, heights: Sequence[FloatArray]) -> tuple[NodeLines, FacetLines]:
    """Return the lines of nodes through the layers, and for each node of each facet of S the line through it.

    A line connects the two copies of a node on the two sides of a facet of S. Facets with the same two copies share the
    line.

    Args:
        joint: the joint as drawn, before S is opened.
        copies: copies of its nodes, one on each body.
        heights: for each seam the heights of the levels of nodes, as fractions of the thickness from 0 to 1.

    Returns:
        All lines of nodes, and the lines at the nodes of each facet of S.

    Raises:
        InputError: at a node of S the same body lies on both sides. Or two seams share a line but have different
            levels. Or the upper side changes along a seam, and its levels are not symmetric. Or, in 3D, the upper side
            changes at a line.
    """
    below, above = copies.below.ravel(), copies.above.ravel()
    line_keys = np.column_stack([joint.surface.ravel(), np.minimum(below, above), np.maximum(below, above)])
    _, first, line_no = np.unique(line_keys, axis=0, return_index=True, return_inverse=True)
    line_no = line_no.ravel()
    ends = np.column_stack([below, above])[first]
    feet = joint.surface.ravel()[first]
    same_copy = "at {at} one body lies on both sides of S, so that the layer has no room there; use the interface model"
    refuse(ends[:, 0] == ends[:, 1], joint.points[feet], same_copy)
    is_reversed = below != ends[line_no, 0]
    seam = np.repeat(joint.seam_numbers, joint.surface.shape[1])
    meeting, example = np.unique(np.column_stack([seam[first][line_no], seam, is_reversed]), axis=0, return_index=True)
    names, example_points = list(joint.seams), joint.points[joint.surface.ravel()[example]]
    for (seam_no, other, reverse), x in zip(meeting, example_points, strict=True):
        levels, other_levels = heights[seam_no], 1 - heights[other][::-1] if reverse else heights[other]
        if len(levels) != len(other_levels) or np.abs(levels - other_levels).max() > HEIGHT_TOLERANCE:
            text = "the upper side changes" if seam_no == other else f"{names[seam_no]!r} continues {names[other]!r}"
            raise InputError(f"{text} at {place_text(x)}: sublayers do not meet; give equal ones, upwards on one body")
        if reverse and joint.dim == 3:
            raise InputError(f"the upper side of S changes at {place_text(x)}: in 3D it must be on one side there")
    lines = NodeLines(len(joint.points) + len(copies.copied_nodes), ends, feet, seam[first], tuple(heights))
    return lines, FacetLines(line_no.reshape(joint.surface.shape), is_reversed.reshape(joint.surface.shape))


def level_heights(degree: int, cells_through: int | Sequence[float], fractions: Sequence[float]) -> FloatArray:
    """Return the heights of a layer's levels of nodes, as increasing fractions of the thickness from 0 to 1.

    Args:
        degree: degree of the cells' geometry; with 2 there is also a level in the middle of each cell.
        cells_through: number of cells through the thickness. Each sublayer gets its fraction of them, rounded, and at
            least one. Or the heights between which cells lie.
        fractions: thickness of each sublayer over the layer's, from the lower to the upper face; () for no sublayers.

    Raises:
        InputError: the heights do not increase from 0 to 1, or cells would lie in two sublayers.
    """
    parts = np.asarray(fractions if len(fractions) else [1.0])
    if not is_integer(cells_through, 1):
        levels, n = np.asarray(cells_through, float), np.size(cells_through) - 1
        distances = np.abs(levels[:, None] - np.cumsum(parts)).min(axis=0, initial=1.0)
        is_valid = levels[:1] == 0 and levels[-1:] == 1 and (np.diff(levels) > 0).all()
        allowed = "heights that increase from 0 to 1, among them those of sublayers"
        require(is_valid and distances.max() <= HEIGHT_TOLERANCE, "cells_through", cells_through, allowed)
        return np.interp(np.arange(degree * n + 1) / degree, np.arange(n + 1), levels)
    n_levels = degree * np.maximum(1, np.rint(cells_through * parts).astype(int))
    bounds = [0.0, *np.cumsum(parts)[:-1], 1.0]
    heights = [np.linspace(*ends, n + 1)[1:] for ends, n in zip(pairwise(bounds), n_levels, strict=True)]
    return np.concatenate([[0.0], *heights])


def band_cells(
    joint: Joint, lines: NodeLines, s_lines: FacetLines, rows: IntArray, heights: FloatArray, fractions: Sequence[float]
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the cells of the layer of one seam, without those at junctions.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the thickness.
        s_lines: the lines at the nodes of each facet of S.
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
    bounds = np.cumsum(fractions)[:-1] if len(fractions) else np.empty(0)
    cells, sublayer, director = [], [], []
    k, top = joint.corners.shape[1], len(heights) - 1
    for low in range(0, top, degree):
        for facet_nodes, offsets in patterns:
            line_no = np.take_along_axis(s_lines.line_numbers[rows], facet_nodes, axis=1)
            is_reversed = np.take_along_axis(s_lines.is_reversed[rows], facet_nodes, axis=1)
            cells.append(lines.node_numbers(line_no, np.where(is_reversed, top - low - offsets, low + offsets)))
            director.append(np.take_along_axis(normals, facet_nodes[:, :k, None], axis=1))
            sublayer.append(np.full(len(surface), np.searchsorted(bounds, (heights[low] + heights[low + degree]) / 2)))
    return np.concatenate(cells), np.concatenate(sublayer), np.concatenate(director)


CellPattern = tuple[IntArray, IntArray]  # (n_S, k) node of each facet of S; (k,) levels above the first


def _tensor_pattern(cell_type: str, degree: int, n: int) -> list[CellPattern]:
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
    cell_points, facet_points = lagrange(cell_type, degree).points, lagrange(FACET_TYPES[cell_type], degree).points
    distance = np.linalg.norm(cell_points[:, None, :-1] - facet_points[None], axis=2)
    return [(np.tile(distance.argmin(axis=1), (n, 1)), np.rint(cell_points[:, -1] * degree).astype(np.int64))]


def _simplex_pattern(cell_type: str, degree: int, vertex_order: IntArray) -> list[CellPattern]:
    """Return the places of the nodes of the triangles or tetrahedra over each of n_S facets of S.

    The space over a facet, between two levels, is split into d simplices in d dimensions. Let the d vertices of the
    facet be sorted by their numbers, so that neighbours split their common sides alike. Simplex j, from 0, has vertices
    0 to j at the lower level, and vertices j to d - 1 at the upper one. The node in the middle of an edge lies over the
    middle of the edge's projection onto S.

    Args:
        cell_type: "triangle" or "tetrahedron".
        degree: degree of the cells' geometry.
        vertex_order: (n_S, d) positions, in the facet, of its d vertices sorted by their numbers.

    Returns:
        A pair for each simplex. First (n_S, k): for each of its k nodes the position, in the facet, of the facet's node
        below it. Second (k,): number of levels from the lower level to each node.
    """
    n = vertex_order.shape[1]
    edge_nodes = np.diag(np.arange(n))
    for edge_no, (i, j) in enumerate(basix.topology(basix.CellType[FACET_TYPES[cell_type]])[1]):
        edge_nodes[i, j] = edge_nodes[j, i] = n + edge_no
    patterns = []
    for k in range(n):
        node_columns = [vertex_order[:, i] for i in (*range(k + 1), *range(k, n))]
        level_offsets = [0] * (k + 1) + [degree] * (n - k)
        if degree == 2:
            for p, q in basix.topology(basix.CellType[cell_type])[1]:
                node_columns.append(edge_nodes[node_columns[p], node_columns[q]])
                level_offsets.append((level_offsets[p] + level_offsets[q]) // 2)
        patterns.append((np.column_stack(node_columns), np.array(level_offsets)))
    return patterns
