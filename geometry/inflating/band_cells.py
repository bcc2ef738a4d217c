"""Bands: copies of the nodes of S for each body, node lines between two copies, and cells between lines."""

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
    """Nodes of the bodies after parting on S: each body has its own copy of a node of S.

    One copy keeps the node's number, the copy on the upper side of the node's first facet. The other copies, and the
    nodes of a rigid base, are numbered after the joint's points, in the order of their nodes.

    Attributes:
        cells: (n_cells, k) nodes of the bodies' cells.
        below, above: (n_S, k) copies of the nodes of each facet of S, on its lower and on its upper side.
        new: (n,) nodes of S whose copies follow after the joint's points.
        base: (n,) whether these copies are on a rigid base.
    """

    cells: IntArray
    below: IntArray
    above: IntArray
    new: IntArray
    base: BoolArray

    @classmethod
    def of(cls, joint: Joint) -> NodeCopies:
        """The copies of a joint's nodes."""
        surface, split, n = joint.surface, joint.split_mesh.of_nodes, len(joint.points)
        on_base = int(split.max(initial=0)) + 1
        components = np.stack([joint.components_at(cells, surface) for cells in joint.surface_cells.T])
        sides = surface * (on_base + 1) + np.where(components < 0, on_base, components)
        nodes, first = np.unique(surface, return_index=True)
        where = np.nonzero(np.isin(joint.cells, nodes))
        keys = joint.cells[where] * (on_base + 1) + split[where]
        copy_keys = np.unique(np.concatenate([keys, sides[0].ravel()]))
        new = np.setdiff1d(copy_keys, sides[1].ravel()[first], assume_unique=True)

        def number(keys: IntArray) -> IntArray:
            at = np.minimum(np.searchsorted(new, keys), len(new) - 1)
            return np.where(new[at] == keys, n + at, keys // (on_base + 1))

        body_cells = joint.cells.copy()
        body_cells[where] = number(keys)
        nodes, component = np.divmod(new, on_base + 1)
        return cls(body_cells, number(sides[0]), number(sides[1]), nodes, component == on_base)

    def renumbered(self, number: IntArray) -> NodeCopies:
        """The copies with other numbers; -1 for copies that are left out, which are on a rigid base."""
        return self._replace(cells=number[self.cells], below=number[self.below], above=number[self.above])


@dataclass(frozen=True)
class NodeLines:
    """Lines of nodes, each from one copy of a node of S (level 0) to another copy (the last level).

    Cells of degree 2 have nodes at the levels of their faces and half-way between.

    Attributes:
        first_new: number of the first node between copies.
        ends: (n, 2) the two copies of each line.
        nodes: (n,) the node of S that they are copies of.
        kind: (n,) number of the seam of a facet at the line; the line has the heights of this seam.
        heights: for each seam the heights of the levels, in units of the thickness, from 0 to 1.
    """

    first_new: int
    ends: IntArray
    nodes: IntArray
    kind: IntArray
    heights: tuple[FloatArray, ...]

    @cached_property
    def top(self) -> IntArray:
        """(n,) the last level of each line."""
        return np.array([len(heights) - 1 for heights in self.heights])[self.kind]

    @cached_property
    def start(self) -> IntArray:
        """(n,) number of the node at level 1 of each line; the next levels follow."""
        return self.first_new + np.cumsum(self.top - 1) - (self.top - 1)

    @property
    def size(self) -> int:
        """Number of nodes between copies."""
        return int((self.top - 1).sum())

    def number(self, lines: IntArray, level: IntArray | int) -> IntArray:
        """Nodes of the lines with these numbers at levels."""
        second = np.where(level == self.top[lines], self.ends[lines, 1], self.start[lines] + np.asarray(level) - 1)
        return np.where(np.asarray(level) == 0, self.ends[lines, 0], second)

    def between(self, values: FloatArray) -> tuple[FloatArray, IntArray]:
        """Values at the nodes between copies, linear between values (n_nodes, d) at copies; and their nodes of S."""
        line = np.repeat(np.arange(len(self.top)), self.top - 1)
        first = np.cumsum([0, *map(len, self.heights)])[self.kind[line]]
        level = np.arange(self.first_new, self.first_new + self.size) - self.start[line] + 1
        z = np.concatenate(self.heights)[first + level][:, None]
        return (1 - z) * values[self.ends[line, 0]] + z * values[self.ends[line, 1]], self.nodes[line]

    def joined(self, ends: IntArray, nodes: IntArray, kind: int) -> NodeLines:
        """These lines and further lines."""
        kinds = np.append(self.kind, np.full(len(nodes), kind))
        return replace(self, ends=np.append(self.ends, ends, axis=0), nodes=np.append(self.nodes, nodes), kind=kinds)


class FacetLines(NamedTuple):
    """Node lines at the nodes of each facet of S.

    Attributes:
        lines: (n_S, k) the line at each node of each facet.
        turned: (n_S, k) whether the line leads from the upper side of this facet to the lower side.
    """

    lines: IntArray
    turned: BoolArray


def node_lines(joint: Joint, copies: NodeCopies, heights: Sequence[FloatArray]) -> tuple[NodeLines, FacetLines]:
    """Node lines at the nodes of S, one for each two copies with a facet between them.

    Args:
        joint: the joint before inflating.
        copies: copies of its nodes.
        heights: heights of the levels, for each seam.

    Raises:
        InputError: one body is on both sides of S at a vertex; the levels of two seams differ where they continue one
            another; the levels of one seam differ where its upper side changes, or in 3D its upper side changes.
    """
    below, above = copies.below.ravel(), copies.above.ravel()
    rows = np.column_stack([joint.surface.ravel(), np.minimum(below, above), np.maximum(below, above)])
    _, first, at = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    at = at.ravel()
    ends = np.column_stack([below, above])[first]
    nodes = joint.surface.ravel()[first]
    closed = "at {at} one body lies on both sides of S, so that the layer has no room there; use the interface model"
    refuse(ends[:, 0] == ends[:, 1], joint.points[nodes], closed)
    turned = below != ends[at, 0]
    seam = np.repeat(joint.seam_numbers, joint.surface.shape[1])
    cases, example = np.unique(np.column_stack([seam[first][at], seam, turned]), axis=0, return_index=True)
    names, places = list(joint.seams), joint.points[joint.surface.ravel()[example]]
    for (number, other, way), x in zip(cases, places, strict=True):
        levels, other_levels = heights[number], 1 - heights[other][::-1] if way else heights[other]
        if len(levels) != len(other_levels) or np.abs(levels - other_levels).max() > HEIGHT_TOLERANCE:
            sides = "the upper side changes" if number == other else f"{names[number]!r} continues {names[other]!r}"
            raise InputError(f"{sides} at {place_text(x)}: sublayers do not meet; give equal ones, upwards on one body")
        if way and joint.dim == 3:
            raise InputError(f"the upper side of S changes at {place_text(x)}: in 3D it must be on one side there")
    lines = NodeLines(len(joint.points) + len(copies.new), ends, nodes, seam[first], tuple(heights))
    return lines, FacetLines(at.reshape(joint.surface.shape), turned.reshape(joint.surface.shape))


def level_heights(degree: int, cells_through: int, fractions: Sequence[float]) -> FloatArray:
    """Heights of the levels of a layer, in units of its thickness, from 0 to 1.

    Args:
        degree: degree of the cells' geometry.
        cells_through: number of cells through the thickness.
        fractions: thickness fractions of the sublayers; () for a single layer.
    """
    shares = np.asarray(fractions if len(fractions) else [1.0])
    counts = degree * np.maximum(1, np.rint(cells_through * shares).astype(int))
    edges = [0.0, *np.cumsum(shares)[:-1], 1.0]
    heights = [np.linspace(*ends, n + 1)[1:] for ends, n in zip(pairwise(edges), counts, strict=True)]
    return np.concatenate([[0.0], *heights])


def band_cells(
    joint: Joint, lines: NodeLines, footing: FacetLines, rows: IntArray, heights: FloatArray, fractions: Sequence[float]
) -> tuple[IntArray, IntArray, FloatArray]:
    """Cells of the band over the facets `rows` of S, their sublayers, and the normals of S at their corners."""
    surface, normals, degree = joint.surface[rows], joint.node_normals[rows], joint.degree
    if is_tensor(joint.cell_type):
        patterns = _tensor_pattern(joint.cell_type, degree, len(surface))
    else:
        patterns = _simplex_pattern(joint.cell_type, degree, np.argsort(surface[:, : joint.dim], axis=1))
    edges = np.cumsum(fractions)[:-1] if len(fractions) else np.empty(0)
    cells, sublayer, director = [], [], []
    k, top = joint.corners.shape[1], len(heights) - 1
    for base in range(0, top, degree):
        for picked, offsets in patterns:
            at = np.take_along_axis(footing.lines[rows], picked, axis=1)
            turned = np.take_along_axis(footing.turned[rows], picked, axis=1)
            cells.append(lines.number(at, np.where(turned, top - base - offsets, base + offsets)))
            director.append(np.take_along_axis(normals, picked[:, :k, None], axis=1))
            sublayer.append(np.full(len(surface), np.searchsorted(edges, (heights[base] + heights[base + degree]) / 2)))
    return np.concatenate(cells), np.concatenate(sublayer), np.concatenate(director)


Pattern = tuple[IntArray, IntArray]  # (n_S, k) node of each facet of S; (k,) levels above the first


def _tensor_pattern(cell_type: str, degree: int, n: int) -> list[Pattern]:
    """Quadrilaterals and hexahedra: the facet is the cell's face with last coordinate zero."""
    cell, facet = lagrange(cell_type, degree).points, lagrange(FACET_TYPES[cell_type], degree).points
    distance = np.linalg.norm(cell[:, None, :-1] - facet[None], axis=2)
    return [(np.tile(distance.argmin(axis=1), (n, 1)), np.rint(cell[:, -1] * degree).astype(np.int64))]


def _simplex_pattern(cell_type: str, degree: int, order: IntArray) -> list[Pattern]:
    """Simplices: prisms are split along sorted vertex numbers, so that neighbours split their common side alike.

    With the facet's vertices sorted, simplex k has the first k + 1 vertices below, and the vertices from k on above. A
    node half-way along an edge lies above the middle of the edge's projection onto S.
    """
    n = order.shape[1]
    middle = np.diag(np.arange(n))
    for number, (i, j) in enumerate(basix.topology(basix.CellType[FACET_TYPES[cell_type]])[1]):
        middle[i, j] = middle[j, i] = n + number
    patterns = []
    for k in range(n):
        picked = [order[:, i] for i in (*range(k + 1), *range(k, n))]
        offsets = [0] * (k + 1) + [degree] * (n - k)
        if degree == 2:
            for p, q in basix.topology(basix.CellType[cell_type])[1]:
                picked.append(middle[picked[p], picked[q]])
                offsets.append((offsets[p] + offsets[q]) // 2)
        patterns.append((np.column_stack(picked), np.array(offsets)))
    return patterns
