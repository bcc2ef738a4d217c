"""Loads at vertices and along edges, and in which cells and where they act."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt

from geometry.errors import place as at_place
from geometry.errors import unknown
from geometry.joint import Joint
from thinlayer.discretisation.axis import refuse_periodic
from thinlayer.discretisation.given import Load
from thinlayer.errors import ModelError

Array = npt.NDArray[np.float64]
EDGE_POINTS = 4  # Gauss points on an edge: exact for degree 7


@dataclass(frozen=True)
class Nodes:
    """Places at which a load acts, each in one cell.

    Attributes:
        cells: (n,) numbers of cells of the joint.
        points: (n, k, d) places in the reference cell.
        along: (n, k, d) factors of the load as a vector of the reference cell, whose length in space is the weight; None:
            all weights are 1.
    """

    cells: npt.NDArray[np.int64]
    points: Array
    along: Array | None = None

    def in_space(self, joint: Joint, cell_points: Array) -> tuple[Array, Array]:
        """Places (n, k, d), and `along` as vectors in space, zero if there is none; nodes of cells have these places."""
        kind = basix.CellType[joint.cell_type]
        element = basix.create_element(basix.ElementFamily.P, kind, joint.degree, basix.LagrangeVariant.equispaced)
        places, along = np.zeros_like(self.points), np.zeros_like(self.points)
        for row, cell in enumerate(self.cells):
            table = element.tabulate(1, self.points[row])[..., 0]
            places[row] = table[0] @ cell_points[cell]
            if self.along is not None:
                along[row] = np.einsum("jkn,ni,kj->ki", table[1:], cell_points[cell], self.along[row])
        return places, along


class Concentrated(Protocol):
    """A load at points or along lines."""

    force: Load

    @property
    def what(self) -> str:
        """Words for errors."""

    def nodes(self, joint: Joint) -> Nodes:
        """Where it acts. Raises GeometryError or ModelError: no such place, or several nodes are there."""


@dataclass(frozen=True)
class PointLoad:
    """A force at a vertex of the mesh.

    Attributes:
        place: (d,) coordinates of the vertex, before inflating.
        force: (d,) force, in 2D per unit thickness, constant or a function (x, t). On a body of revolution its sum around
            the ring that the vertex makes: along the axis the whole force, x all that pulls outwards.
        body: region whose node it is; needed where S parts bodies, because each has a node there.
    """

    place: Sequence[float]
    force: Load
    body: str | None = None

    @property
    def what(self) -> str:
        """As in `Concentrated`."""
        return f"point load at {tuple(self.place)!r}"

    def nodes(self, joint: Joint) -> Nodes:
        """As in `Concentrated`."""
        vertex = joint.nearest_point(self.place)
        same = joint.masters == joint.masters[vertex] if joint.periods else np.arange(len(joint.points)) == vertex
        cells, corners = np.nonzero(same[joint.corners])
        chosen = _in_one_body(joint, cells, joint.splitting.components(0)[cells, corners], self.body, self.what)
        X = np.asarray(basix.geometry(basix.CellType[joint.cell_type]))
        return Nodes(cells[chosen : chosen + 1], X[corners[chosen : chosen + 1], None])


@dataclass(frozen=True)
class LineLoad:
    """A force per length along the edges that two facet sets of a solid share.

    Attributes:
        first, second: names of facet sets of the outer boundary.
        force: (3,) force per length, constant or a function (x, t).
        body: region whose edges are loaded; needed for edges in S.
    """

    first: str
    second: str
    force: Load
    body: str | None = None

    @property
    def what(self) -> str:
        """As in `Concentrated`."""
        return f"line load between {self.first!r} and {self.second!r}"

    def nodes(self, joint: Joint) -> Nodes:
        """As in `Concentrated`."""
        if joint.dim != 3:
            raise ModelError(f"{self.what}: lines are edges of solids; in two dimensions give a PointLoad")
        names = joint.facets
        for name in (self.first, self.second):
            if name not in names:
                raise ModelError(f"{self.what}: {unknown('facet set', name, names)}")
            refuse_periodic(joint, name, "line load")
        if len(np.intersect1d(joint.table.index(names[self.first]), joint.table.index(names[self.second]))):
            raise ModelError(f"{self.what}: both have the same facets; a line lies between two sides")
        on = [np.isin(np.arange(len(joint.points)), joint.facets[name]) for name in (self.first, self.second)]
        kind = basix.CellType[joint.cell_type]
        edges = np.array(basix.topology(kind)[1])
        near = np.flatnonzero((on[0] & on[1])[joint.corners].sum(axis=1) >= 2)
        ends = np.sort(joint.corners[near][:, edges], axis=2)
        shared = _edges_of(joint, self.first) & _edges_of(joint, self.second)
        found: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for row, column in zip(*np.nonzero((on[0] & on[1])[ends].all(axis=2)), strict=True):
            pair = (int(ends[row, column, 0]), int(ends[row, column, 1]))
            if pair in shared:
                found.setdefault(pair, []).append((int(near[row]), int(column)))
        if not found:
            raise ModelError(f"{self.what}: they have no edge in common")
        components = joint.splitting.components(1)
        chosen = []
        for around in found.values():
            cells, columns = np.array(around).T
            k = _in_one_body(joint, cells, components[cells, columns], self.body, self.what)
            chosen.append((cells[k], columns[k]))
        cells, columns = np.array(chosen).T
        return along_edges(kind, cells, edges[columns])


def _edges_of(joint: Joint, name: str) -> set[tuple[int, int]]:
    """Edges of the facets of a name, as pairs of vertices."""
    rows = joint.table.index(joint.facets[name])
    cells, local = joint.table.cells[rows, 0], joint.table.local[rows, 0]
    kind = basix.CellType[joint.cell_type]
    topology = basix.topology(kind)
    found = set()
    for number, corners in enumerate(topology[2]):
        inside = [edge for edge in topology[1] if set(edge) <= set(corners)]
        for edge in inside:
            ends = np.sort(joint.corners[cells[local == number]][:, edge], axis=1)
            found |= {(int(a), int(b)) for a, b in ends}
    return found


def along_edges(
    kind: basix.CellType, cells: npt.NDArray[np.int64], ends: npt.NDArray[np.int64], count: int = EDGE_POINTS
) -> Nodes:
    """Gauss points on edges of cells (n,) between these corners (n, 2)."""
    s, w = basix.make_quadrature(basix.CellType.interval, 2 * count - 1)
    X = np.asarray(basix.geometry(kind))[ends]  # (n, 2, d)
    points = X[:, None, 0] + s[None, :, :1] * (X[:, None, 1] - X[:, None, 0])
    return Nodes(cells, points, w[None, :, None] * (X[:, None, 1] - X[:, None, 0]))


def _in_one_body(
    joint: Joint, cells: npt.NDArray[np.int64], components: npt.NDArray[np.int64], body: str | None, what: str
) -> int:
    """The first of the cells around a place that are of one body; raises ModelError if the place has several nodes."""
    regions = joint.region[cells]
    if body is not None:
        if body not in joint.bodies:
            raise ModelError(f"{what}: {unknown('body', body, joint.bodies)}")
        kept = np.flatnonzero(regions == joint.regions.index(body))
        if not len(kept):
            around = ", ".join(sorted({joint.regions[r] for r in regions}))
            raise ModelError(f"{what}: body {body!r} does not reach this place; around it: {around}")
    else:
        kept = np.arange(len(cells))
    if len(np.unique(components[kept])) > 1:
        names = sorted({joint.regions[r] for r in regions[kept]})
        hint = f"give body=..., one of {', '.join(map(repr, names))}" if len(names) > 1 else "move it off S"
        where = at_place(joint.points[joint.corners[cells[kept[0]]]].mean(axis=0))
        raise ModelError(f"{what} acts where S parts bodies, near {where}, and each of them has a node there; {hint}")
    return int(kept[cells[kept].argmin()])


def check_loads(loads: Any) -> tuple[Concentrated, ...]:
    """Loads as a tuple; raises ModelError if one of them is none."""
    if isinstance(loads, PointLoad | LineLoad):
        raise ModelError(f"loads is {loads!r}; it must be a list of loads")
    for one in loads:
        if not isinstance(one, PointLoad | LineLoad):
            raise ModelError(f"one of loads is {one!r}; allowed: PointLoad, LineLoad")
    return tuple(loads)
