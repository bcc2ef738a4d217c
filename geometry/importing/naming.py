"""Cells and named groups of an imported mesh, and which groups become the regions, seams and facet sets of a joint."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple, TypedDict

import numpy as np
from scipy.spatial import cKDTree

from forms.base import InputError, is_finite, require
from forms.temperature import checked_values, finite_values
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

ALL, PAIRS = "all", "pairs"  # values of S: all facets between regions as one seam, or a seam for each pair of regions

GroupMasks = dict[str, BoolArray]  # name -> which cells are in the group
Marker = Callable[[FloatArray], object]  # function of (d, n) coordinates -> (n,) whether each place is meant
Names = tuple[str, ...]
SeamNames = str | Sequence[str] | Mapping[str, object] | None  # names of seams, or name -> its upper side


class SideArgs(TypedDict, total=False):
    """Keyword arguments of `read` that choose the groups, the facets of S and the upper side of S.

    Attributes:
        S: name of a facet set; or names of several seams; or name -> upper side for each seam, written as in `read`;
            None: all facets between `lower` and `upper`; "all" or "pairs": all facets between regions.
        upper, lower: name or names of the regions above and below a single seam; None: not specified.
        direction: vector to the upper side of a single seam; None: not specified.
        regions: name of the cell data with the number of each element's group; None: the only array of integers.
        join: largest distance of nodes that become one, over the size of the mesh; None: nodes stay.
    """

    S: SeamNames
    upper: str | Sequence[str] | None
    lower: str | Sequence[str] | None
    direction: Sequence[float] | None
    regions: str | None
    join: float | None


class FileCells(NamedTuple):
    """The cells of an imported mesh, all of one type, with only those points of the mesh that are their nodes.

    Attributes:
        points: (n_points, d) coordinates of the cells' nodes in d dimensions, lengths.
        nodes: (n_cells, k) row numbers in `points` of the k nodes of each cell, in DOLFINx's order.
        type: "triangle", "quadrilateral", "tetrahedron" or "hexahedron".
        point_numbers: (n_points,) for each row of `points` the number of this point in the imported mesh.
    """

    points: FloatArray
    nodes: IntArray
    type: str
    point_numbers: IntArray

    @classmethod
    def of(cls, points: FloatArray, nodes: IntArray, cell_type: str) -> FileCells:
        """Return the cells with only those points that are their nodes.

        Args:
            points: (n, 2 or 3) coordinates of all points of the mesh; plane cells may have a third, constant
                coordinate.
            nodes: (n_cells, k) numbers of the k nodes of each cell, in DOLFINx's order.
            cell_type: "triangle", "quadrilateral", "tetrahedron" or "hexahedron".

        Raises:
            InputError: nodes without coordinates, or a surface in 3D.
        """
        point_numbers, node_rows = np.unique(nodes, return_inverse=True)
        if point_numbers[0] < 0 or point_numbers[-1] >= len(points) or not np.isfinite(points[point_numbers]).all():
            raise InputError("the cells have nodes without coordinates")
        dim = lagrange(cell_type, 1).points.shape[1]
        x = points[point_numbers]
        z = x[:, dim:]
        if z.size and np.ptp(z) > NODE_TOLERANCE * np.ptp(x, axis=0).max():
            z_text = f"{len(nodes)} {cell_type} cells at z = {z.min():g} to {z.max():g}, not in a plane z = const"
            raise InputError(f"2D mesh in 3D: {z_text}; for a solid save its cells too (gmsh: in a Physical Volume)")
        return cls(x[:, :dim].copy(), node_rows.reshape(nodes.shape), cell_type, point_numbers)

    @property
    def corners(self) -> IntArray:
        """(n_cells, k) numbers of the k vertices of each cell."""
        return self.nodes[:, : corner_count(self.type)]

    def refuse(self, bad: BoolArray, fault: str) -> None:
        """Raise InputError if any cell is bad; the message has the number of bad cells and the place of the first.

        Args:
            bad: (n_cells,) whether each cell is bad.
            fault: what is wrong with these cells, a verb phrase for the message.
        """
        if bad.any():  # gathering the places of all nodes is expensive
            refuse(bad, self.points[self.nodes], f"{{bad}} of {{all}} cells {fault}; the first is at {{at}}")

    def require_sound(self) -> None:
        """Raise InputError if cells have no volume or are folded, or if several nodes lie at one place."""
        self.refuse((np.diff(np.sort(self.nodes, axis=1)) == 0).any(axis=1), "have a node twice; is join too large?")
        cell_sizes = np.ptp(self.points[self.nodes], axis=1).max(axis=1)
        jacobian = node_jacobians(self.points, self.nodes, self.type)
        largest = np.abs(jacobian).max(axis=1)
        self.refuse(largest <= MIN_RELATIVE_JACOBIAN * cell_sizes ** self.points.shape[1], "are degenerate (no volume)")
        smallest = (jacobian * np.sign(jacobian.sum(axis=1))[:, None]).min(axis=1)
        is_folded = smallest <= MIN_JACOBIAN_RATIO * largest
        self.refuse(is_folded, "are folded (their Jacobian vanishes or changes sign within the cell)")
        coincidence_distance = NODE_TOLERANCE * np.ptp(self.points, axis=0).max()
        node_pairs = cKDTree(self.points).query_pairs(coincidence_distance, output_type="ndarray")
        pairs_text = "{bad} pairs of nodes at the same place, the first at {at}, do not connect cells: read with"
        how = f"join=1e-6, or share them (gmsh: BooleanFragments), or draw gaps > {NODE_TOLERANCE:g} of the mesh"
        refuse(np.ones(len(node_pairs), bool), self.points[np.sort(node_pairs[:, 0])], f"{pairs_text} {how}")

    def facets_of_cells_at(self, vertices: IntArray) -> FacetTable:
        """Return all facets of those cells that have a facet whose vertices are all in `vertices`.

        A few more cells may be included. Cell numbers in the result are rows of `nodes`.

        Args:
            vertices: (n,) row numbers in `points` of the vertices.
        """
        cells = np.flatnonzero(np.isin(self.corners, vertices).sum(axis=1) >= corner_count(FACET_TYPES[self.type]))
        table = FacetTable.of(self.corners[cells], self.type)
        return replace(table, cells=np.where(table.cells < 0, -1, cells[table.cells]))


class SeamSides(NamedTuple):
    """Choice of the facets of S and of the upper side of each seam, from the arguments of `read`.

    Attributes:
        S: name of the facet set of a single seam; "all" or "pairs"; None: the single seam is all facets between its
            lower and upper regions, or there are several `seams`.
        default_seam: upper side of a single seam, as far as the user has specified it.
        seams: name -> upper side of each of several seams; {}: `S` and `default_seam` describe the seams.
        named: name of a facet set that the user describes -> function of the place, or regions on the two sides.
        regions: name of the cell data with the number of each element's group; None: the only array of integers.
        join: largest distance of nodes that become one, over the size of the mesh; None: nodes stay.
    """

    S: str | None
    default_seam: Seam
    seams: Mapping[str, Seam] = {}
    named: Mapping[str, Marker | Seam] = {}
    regions: str | None = None
    join: float | None = None

    @classmethod
    def of(
        cls, S: SeamNames = S, upper: object = None, lower: object = None, direction: Any = None, **choice: Any
    ) -> SeamSides:
        """Return the choice of S and its upper sides from the arguments of `read`.

        Args:
            S: name of one facet set; or names of several seams; or name -> upper side for each seam; None: all facets
                between `lower` and `upper`; "all" or "pairs": all facets between regions.
            upper, lower: name or names of the regions above and below a single seam; None: not specified.
            direction: vector to the upper side of a single seam; None: not specified.
            choice: further attributes by name; in `named` the regions on the two sides are (lower, upper).

        Raises:
            InputError: an argument has a wrong type; or `S` names several seams, and another argument is given.
        """
        join, named = choice.get("join"), choice.pop("named", {})
        require(join is None or (is_finite(join) and 0 < join < 1), "join", join, "it must be a number > 0 and < 1")
        vector: Any = None if direction is None else tuple(np.ravel(direction).tolist())  # checked by the seam
        single = Seam(_names_of(lower, "lower"), _names_of(upper, "upper"), vector)
        rules = {name: rule if callable(rule) else _seam(name, rule) for name, rule in named.items()}
        sides = {name: rule for name, rule in rules.items() if isinstance(rule, Seam)}
        if (S is None or isinstance(S, str)) and (S not in (ALL, PAIRS) or single == Seam()):
            return cls(S, sides.get(S or "", single) if single == Seam() else single, {}, rules, **choice)
        side_rules = dict(S) if isinstance(S, Mapping) else dict.fromkeys(S)
        if not side_rules or not all(isinstance(name, str) for name in side_rules):
            allowed = "the names of several, {name: its upper side}, or None for all facets between lower and upper"
            raise InputError(f"S is {S!r}; give the name of one set of facets, {allowed}")
        if single != Seam():
            raise InputError("S names several seams: give the sides of each there, as {name: (lower, upper)}")
        seams = {name: _seam(name, sides.get(name) if rule is None else rule) for name, rule in side_rules.items()}
        return cls(None, single, seams, rules, **choice)


def _seam(name: str, rule: object) -> Seam:
    """Return a `Seam` from the upper side that the user gave for it; raise InputError if this has a wrong type.

    Args:
        name: name of the seam, for messages.
        rule: the upper side: a vector that points there; (lower regions, upper regions), each a name or names; a
            `Seam`, which is returned; or None for a seam whose sides follow the order of the regions.
    """
    if rule is None or isinstance(rule, Seam):
        return rule or Seam()
    if (vector := finite_values(rule, (-1,))) is not None and vector.ndim:
        return Seam(direction=tuple(map(float, vector)))
    if not isinstance(rule, tuple | list) or len(rule) != 2:
        allowed = "a vector, (lower, upper) with names of regions, or None for the order of the regions"
        raise InputError(f"S: the upper side of {name!r} is {rule!r}; give {allowed}")
    lower, upper = (_names_of(side, f"side of {name!r}") for side in rule)
    return Seam(lower, upper)


def _names_of(regions: object, argument: str) -> Names:
    """Return the names of regions as a tuple; () for None. Raise InputError for anything else than names.

    Args:
        regions: one name, several names, or None.
        argument: name of the argument, for messages.
    """
    names = (regions,) if isinstance(regions, str) else () if regions is None else regions
    if not (isinstance(names, Sequence) and all(isinstance(name, str) for name in names)):
        raise InputError(f"{argument} is {regions!r}; give the name of a region, or several in a list")
    return tuple(names)


def _marks(x: FloatArray, marker: Marker) -> FloatArray:
    """Return (n,) 1 where a user's function of coordinates (d, n) is true, else 0; numbers are a TypeError."""
    return (np.asarray(marker(x)) & True).astype(float)


class NamedGroups(NamedTuple):
    """A mesh with named groups of cells and of facets, and the choice of S among them.

    Attributes:
        cells: cells of the mesh.
        region_masks: name of a group of cells -> (n_cells,) whether each cell is in this group.
        facets: name of a group of facets -> (n, k) numbers of the k vertices of each of its n facets.
        source_text: where the names come from, for messages.
        sides: choice of the facets of S and of the upper side of each seam.
        node_sets: name of a set of nodes -> (n_points,) whether each of the cells' points is in this set.
    """

    cells: FileCells
    region_masks: GroupMasks
    facets: dict[str, IntArray]
    source_text: str
    sides: SeamSides
    node_sets: GroupMasks = {}

    def make_joint(self) -> Joint:
        """Return the joint whose regions and facet sets are the groups.

        If groups of cells overlap, only those named in `sides` become regions.

        Raises:
            InputError: cells are degenerate or do not fit together; a name is unknown or ambiguous; S does not fit.
        """
        cells, sides = self.cells, self.sides
        cells_named = self._replace(region_masks=self._disjoint_regions())
        cells.require_sound()
        named = cells_named.with_described_facets()
        facets, seams, regions = named.facets, dict(sides.seams), tuple(named.region_masks)
        if sides.S == PAIRS:
            borders, pairs = named._borders()
            for pair in np.unique(pairs, axis=0):
                lower, upper = (regions[k] for k in pair)
                facets[f"{lower}-{upper}"] = borders[(pairs == pair).all(axis=1)]
                seams[f"{lower}-{upper}"] = Seam((lower,), (upper,))
        for name in seams or {sides.S} - {None, ALL}:
            require_known("set of facets", name, facets, self.source_text)
        if not seams:
            surface, seams[S] = named._default_seam()
            facets = {S: surface, **{name: rows for name, rows in facets.items() if name != sides.S}}
        joint = Joint(cells.points, cells.nodes, cells.type, named.region, regions, facets, seams)
        _require_conforming(joint)
        return joint

    @property
    def region(self) -> IntArray:
        """(n_cells,) for each cell the position of its region in `region_masks`."""
        return np.argmax([*self.region_masks.values()], axis=0)

    def with_described_facets(self) -> NamedGroups:
        """Return the groups with those facets too that node sets, functions of the place or two regions describe.

        Node sets that have the name of facets or of a region, or no facets, are left out.
        """
        facets, cells = dict(self.facets), self.cells
        for name, is_there in self.node_sets.items():
            if name not in facets and name not in self.region_masks and len(rows := self._facets_at(is_there, name)):
                facets[name] = rows
        wanted = "it must be a numpy function of coordinates (d, n) that gives n times True or False"
        for name, rule in self.sides.named.items():
            if isinstance(rule, Seam):
                facets[name] = self._facets_between(rule.upper, rule.lower)
                continue
            marks = checked_values(f"names: {name!r}", _marks, cells.points.T, rule, wanted=wanted, where=str)
            facets[name] = self._facets_at(marks > 0, name)
        return self._replace(facets=facets)

    def _facets_at(self, is_there: BoolArray, name: str) -> IntArray:
        """Return (n, k) vertices of the facets whose vertices are all at given points.

        Of a seam these are all within the bodies, or if there are none those on the outer boundary. Else they are those
        on the outer boundary, or if there are none those between regions, or if there are none those inside regions.

        Args:
            is_there: (n_points,) whether each of the cells' points is given.
            name: name of the facets.
        """
        table, region = self.cells.facets_of_cells_at(np.flatnonzero(is_there)), self.region
        is_outer, is_border = table.cells[:, 1] < 0, np.diff(region[table.cells], axis=1)[:, 0] != 0
        is_seam, is_found = name in (self.sides.S, *self.sides.seams), is_there[table.vertices].all(axis=1)
        choices = (~is_outer, is_outer) if is_seam else (is_outer, is_border, ~is_outer)
        return table.vertices[next((rows for choice in choices if (rows := is_found & choice).any()), is_found)]

    def _borders(self) -> tuple[IntArray, IntArray]:
        """Return (n, k) vertices of all facets between different regions, and (n, 2) their regions, ascending."""
        corners, region = self.cells.corners, self.region
        first, last = np.full(len(self.cells.points), len(self.region_masks)), np.full(len(self.cells.points), -1)
        np.minimum.at(first, corners, region[:, None])
        np.maximum.at(last, corners, region[:, None])
        table = self.cells.facets_of_cells_at(np.flatnonzero(first < last))
        pairs = np.sort(np.where(table.cells < 0, -1, region[table.cells]), axis=1)
        is_border = (pairs[:, 0] >= 0) & (pairs[:, 0] < pairs[:, 1])
        if not is_border.any():
            raise InputError(f"no two regions have a facet in common: {', '.join(self.region_masks)}")
        return table.vertices[is_border], pairs[is_border]

    def _disjoint_regions(self) -> GroupMasks:
        """Return the groups of cells that become regions.

        Raises:
            InputError: a cell is in none of them or in several, or a name is unknown or names cells and facets.
        """
        regions, cells, sides = self.region_masks, self.cells, self.sides
        seams = sides.default_seam, *sides.seams.values(), *sides.named.values()
        side_names = [name for seam in seams if isinstance(seam, Seam) for name in seam.upper + seam.lower]
        for name in side_names:
            require_known("region", name, regions, self.source_text)
        counts = np.sum(list(regions.values()), axis=0)
        cells.refuse(counts == 0, f"are in no named group ({self.source_text}: {', '.join(regions)})")
        parts = {name: mask for name, mask in regions.items() if name in side_names or not mask.all()}
        if (counts > 1).any() and np.any([*parts.values()], axis=0).all():  # a group of all cells besides others
            regions, counts = parts, np.sum([*parts.values()], axis=0)
        if side_names and (counts > 1).any():
            regions = {name: regions[name] for name in dict.fromkeys(side_names)}
            counts = np.sum(list(regions.values()), axis=0)
            cells.refuse(counts == 0, f"are in none of {', '.join(regions)}; name every region in upper or lower")
        for name in regions:
            if (name in self.facets and not name.isdigit()) or name in sides.named:
                raise InputError(f"{name!r} names both cells and facets; each needs its own name")
        cells.refuse(counts > 1, f"are in several of the groups {', '.join(regions)}; name regions in upper and lower")
        return regions

    def _default_seam(self) -> tuple[IntArray, Seam]:
        """Return the facets and the upper side of the single seam, with defaults for what the user has not specified.

        Returns:
            (n, k) numbers of the k vertices of each of the n facets, and the `Seam` with the upper side.

        Raises:
            InputError: the regions on the two sides are missing or do not meet there, or other facets are named "S".
        """
        name, default_seam, all_regions = self.sides.S, self.sides.default_seam, tuple(self.region_masks)
        lower, upper, regions_text = default_seam.lower, default_seam.upper, f"regions: {', '.join(all_regions)}"
        if name != S and S in self.facets:
            raise InputError(f"other facets are named {S!r}; rename them, or give S={S!r}")
        if name is None:
            if not upper or not lower or set(upper) & set(lower):
                raise InputError(f"S=None is all that is between two bodies; give upper and lower; {regions_text}")
            return self._facets_between(upper, lower), Seam(lower, upper)
        if name == ALL:
            return self._borders()[0], default_seam
        facets, cells = self.facets[name], self.adjacent_cells(name)
        near_regions = self.region_names_of_cells(cells)
        if (cells[:, 1] < 0).all() and not lower:
            if other_regions := " and ".join(region for region in near_regions if region not in (upper or all_regions)):
                conflict = f"{other_regions}, and {'+'.join(upper)}, named in upper, does not touch it there"
                remedy = "let both share their nodes, or give a larger join"
                raise InputError(f"{name!r} lies on the outer boundary of {conflict}; {remedy}")
            return facets, Seam((), upper or all_regions)
        if default_seam.direction is not None:
            return facets, Seam(lower or upper or all_regions, upper or lower or all_regions, default_seam.direction)
        if not upper:
            remedy = "name the regions above it in upper, or a direction towards this side if one body is on both sides"
            raise InputError(f"{name!r} lies inside {' and '.join(near_regions)}; {remedy}; {regions_text}")
        return facets, Seam(lower or tuple(region for region in all_regions if region not in upper), upper)

    def adjacent_cells(self, name: str) -> IntArray:
        """Return (n, 2) numbers of the two cells at each facet of the group `name`; -1 on the outer boundary.

        Facets that belong to no cell are left out.
        """
        facets = self.facets[name]
        table = self.cells.facets_of_cells_at(np.unique(facets))
        rows = table.index(facets)
        return table.cells[rows[rows >= 0]]

    def region_names_of_cells(self, cells: IntArray) -> list[str]:
        """Return the names of all regions to which at least one of the given cells belongs.

        Args:
            cells: numbers of the cells; -1 stands for no cell.
        """
        return [region for region, in_region in self.region_masks.items() if in_region[cells[cells >= 0]].any()]

    def _facets_between(self, upper: Names, lower: Names) -> IntArray:
        """Return the facets between two sets of regions; raise InputError if there are none.

        Args:
            upper, lower: names of the regions on the two sides.

        Returns:
            (n, k) numbers of the k vertices of each of the n facets.
        """
        (facets, pairs), regions = self._borders(), [*self.region_masks]
        above, below = (np.isin(pairs, [regions.index(name) for name in side]) for side in (upper, lower))
        is_between = (above & below[:, ::-1]).any(axis=1)
        if not is_between.any():
            raise InputError(f"{'+'.join(lower)} and {'+'.join(upper)} have no facet in common")
        return facets[is_between]


def _require_conforming(joint: Joint) -> None:
    """Raise InputError if cells overlap their neighbours or nodes hang; the message gives the first place.

    A node hangs if it lies on a facet of cells whose node it is not.
    """
    points, d, facets, cells = joint.points, joint.dim, joint.table.vertices, joint.table.cells
    is_inner = cells[:, 1] >= 0
    first, *others = points[facets[is_inner, :d]].swapaxes(0, 1)
    centres = points[joint.corners].mean(axis=1)[cells[is_inner]]
    volumes = [np.linalg.det(np.stack([*others, centre], axis=1) - first[:, None]) for centre in centres.swapaxes(0, 1)]
    overlap = "{bad} facets have both cells on one side, the first at {at}: the mesh overlaps itself; mesh anew"
    refuse(np.sign(volumes[0]) == np.sign(volumes[1]), points[facets[is_inner]], overlap)
    hanging = points[_hanging_nodes(points, facets[~is_inner])]
    disconnected = "{bad} nodes hang on facets of other cells, the first at {at}: these cells are not connected"
    refuse(np.ones(len(hanging), bool), hanging, f"{disconnected}; make the mesh conforming")


def _hanging_nodes(points: FloatArray, facets: IntArray) -> IntArray:
    """Return the numbers, ascending, of the nodes that lie on a facet of the outer boundary but are no vertex of it.

    Args:
        points: (n_points, d) coordinates of the nodes in d dimensions.
        facets: (n, k) numbers of the k vertices of each facet of the outer boundary.
    """
    vertices, x = np.unique(facets), points[facets]
    middles = x.mean(axis=1)
    near = cKDTree(points[vertices]).query_ball_point(middles, np.linalg.norm(x - middles[:, None], axis=2).max(axis=1))
    facet, vertex = np.repeat(np.arange(len(facets)), [*map(len, near)]), vertices[np.concatenate(near).astype(int)]
    is_foreign = (facets[facet] != vertex[:, None]).all(axis=1)
    x, vertex = x[facet[is_foreign]], vertex[is_foreign]
    is_on_facet = np.zeros(len(vertex), bool)
    for triple in combinations(range(x.shape[1]), x.shape[2]):  # the corners of a quadrilateral are unordered
        first, *others = (x[:, k] for k in triple)
        edges, offsets = np.stack(others, axis=1) - first[:, None], points[vertex] - first
        barycentric = np.einsum("nj,njk->nk", offsets, np.linalg.pinv(edges))
        distance = np.linalg.norm(offsets - np.einsum("nk,nkj->nj", barycentric, edges), axis=1)
        is_inside = (barycentric >= -NODE_TOLERANCE).all(axis=1) & (barycentric.sum(axis=1) <= 1 + NODE_TOLERANCE)
        is_on_facet |= is_inside & (distance <= NODE_TOLERANCE * np.ptp(points, axis=0).max())
    return np.unique(vertex[is_on_facet])
