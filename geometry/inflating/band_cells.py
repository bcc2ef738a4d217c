"""Bands: copies of the nodes of S for each body, lines of nodes between copies, and the layer's cells between lines."""

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
    """Nodes of the bodies after S has opened: each body has its own copy of a node of S.

    One copy keeps the node's number: that on the upper side of the first facet at the node. The other copies, and the
    nodes on a rigid base, are numbered after the joint's points, in the order of their nodes.

    Attributes:
        cells: (n_cells, k) numbers of the k nodes of each of the bodies' cells, copies in place of nodes of S.
        below, above: (n_S, k) copies of the k nodes of each facet of S, on its lower and on its upper side.
        new: (n,) for each of the n copies with new numbers the node of S that it copies.
        base: (n,) whether each of these copies is on a rigid base.
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
        """Return the copies with other numbers.

        Args:
            number: new number of each node and copy; -1 for copies that are left out, which are on a rigid base.
        """
        return self._replace(cells=number[self.cells], below=number[self.below], above=number[self.above])


@dataclass(frozen=True)
class NodeLines:
    """Lines of nodes through the thickness of layers, each from one copy of a node of S to another copy.

    Levels are the positions along a line, from 0 at the first copy to the last level at the other. Cells of degree 2
    have nodes at their two faces and half-way between.

    Attributes:
        first_new: number of the first node inside the lines; all copies have smaller numbers.
        ends: (n, 2) the first and the other copy of each line.
        nodes: (n,) the node of S that both are copies of.
        seam_no: (n,) position in `Joint.seams` of the seam of each line.
        heights: for each seam the heights of all levels over the thickness, from 0 to 1.
    """

    first_new: int
    ends: IntArray
    nodes: IntArray
    seam_no: IntArray
    heights: tuple[FloatArray, ...]

    @cached_property
    def top(self) -> IntArray:
        """(n,) number of the last level of each line."""
        return np.array([len(heights) - 1 for heights in self.heights])[self.seam_no]

    @cached_property
    def start(self) -> IntArray:
        """(n,) number of the node at level 1 of each line; nodes at the next levels have the next numbers."""
        return self.first_new + np.cumsum(self.top - 1) - (self.top - 1)

    @property
    def size(self) -> int:
        """Number of nodes inside the lines, without copies."""
        return int((self.top - 1).sum())

    def number(self, lines: IntArray, level: IntArray | int) -> IntArray:
        """Return the numbers of the nodes on lines, given by the lines' numbers and levels; these may be broadcast."""
        second = np.where(level == self.top[lines], self.ends[lines, 1], self.start[lines] + np.asarray(level) - 1)
        return np.where(np.asarray(level) == 0, self.ends[lines, 0], second)

    def between(self, values: FloatArray) -> tuple[FloatArray, IntArray]:
        """Interpolate values at copies linearly to the nodes inside the lines.

        Args:
            values: (n_nodes, d) values at nodes and copies, such as a motion in d dimensions.

        Returns:
            (m, d) values at the m nodes inside the lines, and (m,) the node of S below or above each.
        """
        line = np.repeat(np.arange(len(self.top)), self.top - 1)
        height_start = np.cumsum([0, *map(len, self.heights)])[self.seam_no[line]]
        level = np.arange(self.first_new, self.first_new + self.size) - self.start[line] + 1
        z = np.concatenate(self.heights)[height_start + level][:, None]
        return (1 - z) * values[self.ends[line, 0]] + z * values[self.ends[line, 1]], self.nodes[line]

    def joined(self, ends: IntArray, nodes: IntArray, seam_no: int) -> NodeLines:
        """Return these lines followed by further lines, all with the levels of one seam.

        Args:
            ends: (n, 2) the copies at both ends of each further line.
            nodes: (n,) the node of S that both are copies of.
            seam_no: position in `Joint.seams` of the seam.
        """
        kinds = np.append(self.seam_no, np.full(len(nodes), seam_no))
        return replace(self, ends=np.append(self.ends, ends, axis=0), nodes=np.append(self.nodes, nodes), seam_no=kinds)


class FacetLines(NamedTuple):
    """Lines of nodes through the thickness at the nodes of each facet of S.

    Attributes:
        lines: (n_S, k) number of the line at each of the k nodes of each facet.
        is_reversed: (n_S, k) whether this line leads from the facet's upper side to its lower side.
    """

    lines: IntArray
    is_reversed: BoolArray


def node_lines(joint: Joint, copies: NodeCopies, heights: Sequence[FloatArray]) -> tuple[NodeLines, FacetLines]:
    """Return the lines of nodes through the layers: one for each two copies of a node of S with a facet between them.

    Args:
        joint: the joint as drawn, before S is opened.
        copies: copies of its nodes, one on each body.
        heights: for each seam the heights of the levels of nodes over the thickness, from 0 to 1.

    Raises:
        InputError: one body is on both sides of S at a vertex; the levels of two seams differ where they continue one
            another; the levels of one seam differ where its upper side changes, or in 3D its upper side changes.
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
    """Return the heights of the levels of nodes of a layer over its thickness, from 0 to 1.

    Args:
        degree: degree of the cells' geometry; with 2 there is a level in the middle of each cell.
        cells_through: number of cells through the thickness; each sublayer gets its fraction of it, at least one.
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
    """Return the cells of the band of one seam.

    Args:
        joint: the joint as drawn, before S is opened.
        lines: all lines of nodes through the thickness.
        footing: the lines at the nodes of each facet of S.
        rows: numbers, among the facets of S, of those that the band covers.
        heights: heights of the levels of nodes over the thickness, from 0 to 1.
        fractions: thickness of each sublayer over the layer's, from the lower to the upper face; () for no sublayers.

    Returns:
        (n, k) numbers of the k nodes of each cell; (n,) number of its sublayer, from 0; and (n, m, d) unit normal of S
        in d dimensions at each of its m vertices.
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
    """Return where the nodes of the layer's quadrilateral or hexahedron over each of n facets of S are.

    This is one pair: (n, k) the node of the facet below each of the cell's k nodes, and (k,) their levels above the
    cell's first level. The facet is the cell's face with last coordinate zero.
    """
    cell, facet = lagrange(cell_type, degree).points, lagrange(FACET_TYPES[cell_type], degree).points
    distance = np.linalg.norm(cell[:, None, :-1] - facet[None], axis=2)
    return [(np.tile(distance.argmin(axis=1), (n, 1)), np.rint(cell[:, -1] * degree).astype(np.int64))]


def _simplex_pattern(cell_type: str, degree: int, order: IntArray) -> list[Pattern]:
    """Return where the nodes of the layer's simplices over each of n_S facets of S are, a pair for each simplex.

    A pair is: (n_S, k) the node of the facet below each of the simplex's k nodes, and (k,) their levels above the first
    one. Prisms over facets are split along sorted vertex numbers, so that neighbours split common sides alike. With the
    facet's vertices sorted, simplex j has the first j + 1 vertices below, and the vertices from j on above. A node
    half-way along an edge lies above the middle of the edge's projection onto S.

    Args:
        cell_type: type of the cells.
        degree: degree of their geometry.
        order: for each facet the positions of its vertices in the order of their numbers, one row each.
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
