"""Cells of an imported mesh, and the choice of regions, seams and their sides among its named groups."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple, TypedDict

import numpy as np
from scipy.spatial import cKDTree

from forms.base import InputError
from forms.temperature import finite_values
from geometry.joint import Joint
from geometry.refusals import refuse, require_known
from geometry.seam import S, Seam
from geometry.topology import (
    FACET_TYPES,
    BoolArray,
    FacetTable,
    FloatArray,
    IntArray,
    corner_count,
    lagrange,
    node_jacobians,
)

NODE_TOLERANCE = 1e-9  # largest distance of nodes that count as coincident, over the size of the mesh
MIN_RELATIVE_JACOBIAN = 1e-12  # largest Jacobian of a cell that counts as degenerate, over size^d
MIN_JACOBIAN_RATIO = 1e-10  # ratio of the smallest to the largest Jacobian up to which a cell counts as folded

Groups = dict[str, BoolArray]  # name -> which cells are in the group
Names = tuple[str, ...]
SeamNames = str | Sequence[str] | Mapping[str, object] | None  # names of seams, or name -> its upper side


class SideArgs(TypedDict, total=False):
    """Arguments for S and its sides, as `read` describes them."""

    S: SeamNames
    upper: str | Sequence[str] | None
    lower: str | Sequence[str] | None
    direction: Sequence[float] | None


class FileCells(NamedTuple):
    """Cells of one type.

    Attributes:
        points: (n_points, d) coordinates of the cells' nodes.
        nodes: (n_cells, k) nodes of each cell, in DOLFINx's order.
        type: type as in `Joint.cell_type`.
        used: (n_points,) numbers of these points in the mesh they come from.
    """

    points: FloatArray
    nodes: IntArray
    type: str
    used: IntArray

    @classmethod
    def of(cls, points: FloatArray, nodes: IntArray, cell_type: str, what: str) -> FileCells:
        """Take over cells and the points that they use.

        Args:
            points: (n, d or 3) coordinates.
            nodes: (n_cells, k) nodes of each cell, in DOLFINx's order.
            cell_type: type as in `Joint.cell_type`.
            what: text for the cells in messages.

        Raises:
            InputError: nodes without coordinates, or a surface in 3D.
        """
        used, numbers = np.unique(nodes, return_inverse=True)
        if used[0] < 0 or used[-1] >= len(points) or not np.isfinite(points[used]).all():
            raise InputError("the cells have nodes without coordinates")
        dim = lagrange(cell_type, 1).points.shape[1]
        x = points[used]
        height = x[:, dim:]
        if height.size and np.ptp(height) > NODE_TOLERANCE * np.ptp(x, axis=0).max():
            surface = f"{what} at z = {height.min():g} to {height.max():g}, not in a plane z = const"
            raise InputError(f"2D mesh in 3D: {surface}; for a solid save its cells too (gmsh: in a Physical Volume)")
        return cls(x[:, :dim].copy(), numbers.reshape(nodes.shape), cell_type, used)

    @property
    def corners(self) -> IntArray:
        """(n_cells, k) vertices of each cell."""
        return self.nodes[:, : corner_count(self.type)]

    def refuse(self, bad: BoolArray, what: str) -> None:
        """Raise InputError if there are bad cells, with their number and the place of the first."""
        if bad.any():  # gathering the places of all nodes is expensive
            refuse(bad, self.points[self.nodes], f"{{bad}} of {{all}} cells {what}; the first is at {{at}}")

    def require_sound(self) -> None:
        """Raise InputError for cells without volume, for folded cells, and for nodes at the same place."""
        size = np.ptp(self.points[self.nodes], axis=1).max(axis=1)
        jacobian = node_jacobians(self.points, self.nodes, self.type)
        largest = np.abs(jacobian).max(axis=1)
        self.refuse(largest <= MIN_RELATIVE_JACOBIAN * size ** self.points.shape[1], "are degenerate (no volume)")
        smallest = (jacobian * np.sign(jacobian.sum(axis=1))[:, None]).min(axis=1)
        folded = smallest <= MIN_JACOBIAN_RATIO * largest
        self.refuse(folded, "are folded (their Jacobian vanishes or changes sign within the cell)")
        distance = NODE_TOLERANCE * np.ptp(self.points, axis=0).max()
        pairs = cKDTree(self.points).query_pairs(distance, output_type="ndarray")
        pairs_text = "{bad} pairs of nodes at the same place, the first at {at}, do not connect cells: let bodies share"
        how = f"them (gmsh: BooleanFragments, removeDuplicateNodes), or draw gaps > {NODE_TOLERANCE:g} of the mesh"
        refuse(np.ones(len(pairs), bool), self.points[np.sort(pairs[:, 0])], f"{pairs_text} {how}")

    def facets_among(self, vertices: IntArray) -> FacetTable:
        """Facets of the cells that have a whole facet among `vertices`; cells are numbered as in `nodes`."""
        near = np.flatnonzero(np.isin(self.corners, vertices).sum(axis=1) >= corner_count(FACET_TYPES[self.type]))
        table = FacetTable.of(self.corners[near], self.type)
        return replace(table, cells=np.where(table.cells < 0, -1, near[table.cells]))


class SeamSides(NamedTuple):
    """The caller's choice of S and its sides.

    Attributes:
        S: name of the set of facets of the only seam; None for all facets between the regions `lower` and `upper`.
        single: sides of the only seam, as far as they are specified.
        seams: name -> seam, in place of `S` and `single`, if there are several seams; else {}.
    """

    S: str | None
    single: Seam
    seams: Mapping[str, Seam] = {}

    @classmethod
    def of(
        cls, S: SeamNames = S, upper: object = None, lower: object = None, direction: Sequence[float] | None = None
    ) -> SeamSides:
        """The choice from arguments as in `read`; raise InputError for wrong types."""
        above, below = _names_of(upper, "upper"), _names_of(lower, "lower")
        way = None if direction is None else tuple(np.ravel(direction).tolist())  # checked by the seam
        if S is None or isinstance(S, str):
            return cls(S, Seam(below, above, way))
        rules = dict(S) if isinstance(S, Mapping) else dict.fromkeys(S)
        if not rules or not all(isinstance(name, str) for name in rules):
            several = "the names of several, {name: its upper side}, or None for all facets between lower and upper"
            raise InputError(f"S is {S!r}; give the name of one set of facets, {several}")
        if above or below or way:
            raise InputError("S names several seams: give the sides of each there, as {name: (lower, upper)}")
        return cls(None, Seam(), {name: _seam(name, rule) for name, rule in rules.items()})


def _seam(name: str, rule: object) -> Seam:
    """A seam from its rule in S: None, a direction, or the regions below and above."""
    if rule is None:
        return Seam()
    if isinstance(rule, Seam):
        return rule
    if (way := finite_values(rule, (-1,))) is not None and way.ndim:
        return Seam(direction=tuple(map(float, way)))
    if not isinstance(rule, tuple | list) or len(rule) != 2:
        sides = "a vector, (lower, upper) with names of regions, or None for the order of the regions"
        raise InputError(f"S: the upper side of {name!r} is {rule!r}; give {sides}")
    lower, upper = (_names_of(side, f"side of {name!r}") for side in rule)
    return Seam(lower, upper)


def _names_of(regions: object, what: str) -> Names:
    """Names of the regions of one side; () for None."""
    names = (regions,) if isinstance(regions, str) else () if regions is None else regions
    if not (isinstance(names, Sequence) and all(isinstance(name, str) for name in names)):
        raise InputError(f"{what} is {regions!r}; give the name of a region, or several in a list")
    return tuple(names)


class NamedGroups(NamedTuple):
    """The named groups of a mesh.

    Attributes:
        cells: cells of the mesh.
        regions: name -> which of these cells are in the region.
        facets: name -> (n, k) vertices of the facets.
        source: origin of the names, for messages.
        sides: the caller's choice among the names.
    """

    cells: FileCells
    regions: Groups
    facets: dict[str, IntArray]
    source: str
    sides: SeamSides

    def joint(self) -> Joint:
        """The joint of the groups; where groups of cells overlap, the groups named in `sides` are the regions.

        Raises:
            InputError: unusable cells or names, or an S that does not fit them.
        """
        named = self._replace(regions=self._disjoint())
        self.cells.require_sound()
        for name in self.sides.seams or filter(None, [self.sides.S]):
            require_known("set of facets", name, self.facets, self.source)
        seams, facets = dict(self.sides.seams), self.facets
        if not seams:
            surface, seams[S] = named._single()
            facets = {S: surface, **{name: rows for name, rows in facets.items() if name != self.sides.S}}
        cells, region = self.cells, np.stack(list(named.regions.values())).argmax(axis=0)
        joint = Joint(cells.points, cells.nodes, cells.type, region, tuple(named.regions), facets, seams)
        _require_whole(joint)
        return joint

    def _disjoint(self) -> Groups:
        """The regions, with each cell in exactly one of them."""
        regions, cells, single = self.regions, self.cells, self.sides.single
        chosen = single.upper + single.lower
        chosen += tuple(name for seam in self.sides.seams.values() for name in seam.lower + seam.upper)
        for name in regions:
            if name in self.facets and not name.isdigit():
                raise InputError(f"{name!r} names both cells and facets; each needs its own name")
        for name in chosen:
            require_known("region", name, regions, self.source)
        count = np.sum(list(regions.values()), axis=0)
        cells.refuse(count == 0, f"are in no named group ({self.source}: {', '.join(regions)})")
        if chosen and (count > 1).any():
            regions = {name: regions[name] for name in dict.fromkeys(chosen)}
            count = np.sum(list(regions.values()), axis=0)
            cells.refuse(count == 0, f"are in none of {', '.join(regions)}; name every region in upper or lower")
        cells.refuse(count > 1, f"are in several of the groups {', '.join(regions)}; name regions in upper and lower")
        return regions

    def _single(self) -> tuple[IntArray, Seam]:
        """Facets (n, k) of the only seam, and the seam."""
        name, single, whole = self.sides.S, self.sides.single, tuple(self.regions)
        lower, upper, regions = single.lower, single.upper, f"regions: {', '.join(whole)}"
        if name != S and S in self.facets:
            raise InputError(f"other facets are named {S!r}; rename them, or give S={S!r}")
        if name is None:
            if not upper or not lower or set(upper) & set(lower):
                raise InputError(f"S=None is all that is between two bodies; give upper and lower; {regions}")
            return self._boundary(upper, lower), Seam(lower, upper)
        facets, cells = self.facets[name], self.adjacent_cells(name)
        touched = self.touched(cells)
        if (cells[:, 1] < 0).all() and not lower:
            if other := " and ".join(region for region in touched if region not in (upper or whole)):
                bodies = f"{other}, and {'+'.join(upper)}, named in upper, does not touch it there"
                raise InputError(f"{name!r} lies on the outer boundary of {bodies}; let both share their nodes")
            return facets, Seam((), upper or whole)
        if single.direction is not None:
            return facets, Seam(lower or upper or whole, upper or lower or whole, single.direction)
        if not upper:
            sides = "name the regions above it in upper, or give the direction upwards if one body is on both sides"
            raise InputError(f"{name!r} lies inside {' and '.join(touched)}; {sides}; {regions}")
        return facets, Seam(lower or tuple(region for region in whole if region not in upper), upper)

    def adjacent_cells(self, name: str) -> IntArray:
        """(n, 2) cells on either side of the facets of a set that belong to cells; -1 on the outer boundary."""
        facets = self.facets[name]
        table = self.cells.facets_among(np.unique(facets))
        rows = table.index(facets)
        return table.cells[rows[rows >= 0]]

    def touched(self, cells: IntArray) -> list[str]:
        """Names of the regions of cells; numbers < 0 are no cells."""
        return [region for region, member in self.regions.items() if member[cells[cells >= 0]].any()]

    def _boundary(self, upper: Names, lower: Names) -> IntArray:
        """All facets between the regions `upper` and `lower`."""
        above, below = (np.any([self.regions[name] for name in side], axis=0) for side in (upper, lower))
        table = self.cells.facets_among(np.intersect1d(self.cells.corners[above], self.cells.corners[below]))
        first, second = table.cells[table.cells[:, 1] >= 0].T
        facets = table.vertices[table.cells[:, 1] >= 0][above[first] & below[second] | below[first] & above[second]]
        if not len(facets):
            raise InputError(f"{'+'.join(lower)} and {'+'.join(upper)} have no facet in common")
        return facets


def _require_whole(joint: Joint) -> None:
    """Raise InputError for a mesh that overlaps itself or has hanging nodes, with the first place."""
    points, d, facets, cells = joint.points, joint.dim, joint.table.vertices, joint.table.cells
    inner = cells[:, 1] >= 0
    first, *others = points[facets[inner, :d]].swapaxes(0, 1)
    centres = points[joint.corners].mean(axis=1)[cells[inner]]
    sides = [np.linalg.det(np.stack([*others, centre], axis=1) - first[:, None]) for centre in centres.swapaxes(0, 1)]
    overlap = "{bad} facets have both cells on one side, the first at {at}: the mesh overlaps itself; mesh anew"
    refuse(np.sign(sides[0]) == np.sign(sides[1]), points[facets[inner]], overlap)
    hanging = points[_hanging_nodes(points, facets[~inner])]
    gaps = "{bad} nodes hang on facets of other cells, the first at {at}: these cells are not connected"
    refuse(np.ones(len(hanging), bool), hanging, f"{gaps}; make the mesh conforming")


def _hanging_nodes(points: FloatArray, facets: IntArray) -> IntArray:
    """Nodes that lie on a facet (n, k) of the outer boundary, given by its vertices, without being its vertex."""
    vertices, x = np.unique(facets), points[facets]
    middles = x.mean(axis=1)
    near = cKDTree(points[vertices]).query_ball_point(middles, np.linalg.norm(x - middles[:, None], axis=2).max(axis=1))
    facet, vertex = np.repeat(np.arange(len(facets)), [*map(len, near)]), vertices[np.concatenate(near).astype(int)]
    other = (facets[facet] != vertex[:, None]).all(axis=1)
    x, vertex = x[facet[other]], vertex[other]
    on = np.zeros(len(vertex), bool)
    for chosen in combinations(range(x.shape[1]), x.shape[2]):  # the corners of a quadrilateral are unordered
        first, *others = (x[:, k] for k in chosen)
        edges, way = np.stack(others, axis=1) - first[:, None], points[vertex] - first
        shares = np.einsum("nj,njk->nk", way, np.linalg.pinv(edges))
        off = np.linalg.norm(way - np.einsum("nk,nkj->nj", shares, edges), axis=1)
        inside = (shares >= -NODE_TOLERANCE).all(axis=1) & (shares.sum(axis=1) <= 1 + NODE_TOLERANCE)
        on |= inside & (off <= NODE_TOLERANCE * np.ptp(points, axis=0).max())
    return np.unique(vertex[on])
