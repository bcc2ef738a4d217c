"""Loads at vertices and along edges: points of cells where they act, and their virtual work as forms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import basix
import basix.ufl
import numpy as np
import ufl

from forms.base import Array, InputError, require
from forms.tensors import Expr
from geometry.domain import Domain
from geometry.joint import Joint
from geometry.refusals import place_text as at_place
from geometry.refusals import require_known
from geometry.topology import Indices, IntArray, lagrange
from thinlayer.discretisation.boundary import refuse_periodic
from thinlayer.discretisation.coefficient import Coordinates, LoadInput

EDGE_GAUSS_POINTS = 4  # Gauss points on an edge: exact for degree 7


@dataclass(frozen=True)
class PointLoad:
    """A force at a vertex of the mesh.

    Attributes:
        place: (d,) coordinates of the vertex in d dimensions, in the joint as drawn, before S is opened to the layer's
            thickness.
        force: (d,) force, in 2D per unit thickness, constant or a function (x, t). In axisymmetry it is the sum over
            the ring of the vertex: y is the total force along the axis, x the total of the radial forces.
        body: region whose node is loaded; needed where S separates bodies, because each has a node there.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import PointLoad, Structure, ThinLayer, solve
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> at_corner = PointLoad((4, 2), (5, -30))
        >>> plates = Structure(joint, body=steel, supports={"BOTTOM": 0}, loads=[at_corner])
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> print(state.reaction("BOTTOM").force.round(6))
        [-5. 30.]
    """

    place: Sequence[float]
    force: LoadInput
    body: str | None = None

    @property
    def what(self) -> str:
        """Name of the load in error messages."""
        return f"point load at {at_place(np.asarray(self.place, float))}"

    def points_and_weights(self, joint: Joint, _: Array) -> tuple[Array, Array]:
        """Return the vertices of the reference cell, and 1 at the loaded one in a cell of the loaded body.

        Raises:
            InputError: there is no vertex at the place, or several bodies have a node there.
        """
        vertex = joint.nearest_point(self.place)
        is_loaded = joint.masters == joint.masters[vertex] if joint.periods else np.arange(len(joint.points)) == vertex
        cells, corners = np.nonzero(is_loaded[joint.corners])
        index = _chosen_cell(joint, cells, joint.split_mesh.components(0)[cells, corners], self)
        weights = np.zeros(joint.corners.shape)
        weights[cells[index], corners[index]] = 1.0
        return basix.geometry(basix.CellType[joint.cell_type]), weights


@dataclass(frozen=True)
class LineLoad:
    """A force per length along edges of a three-dimensional joint: the edges that two facet sets have in common.

    Attributes:
        first, second: names of the facet sets, on the outer boundary.
        force: (3,) force per length, constant or a function (x, t).
        body: region whose edges are loaded; needed for edges in S, where each body has its own.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import LineLoad, Structure, solve
        >>> joint = sandwich(4, 1, 2, h=1, depth=1, cell="hexahedron")
        >>> edge = LineLoad("TOP", "RIGHT", (0, -30, 0))
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> blocks = Structure(joint, body=steel, supports={"BOTTOM": 0}, loads=[edge])
        >>> f"{solve(blocks.bonded()).reaction('BOTTOM').force[1]:.3f}"
        '30.000'
    """

    first: str
    second: str
    force: LoadInput
    body: str | None = None

    @property
    def what(self) -> str:
        """Name of the load in error messages."""
        return f"line load between {self.first!r} and {self.second!r}"

    def points_and_weights(self, joint: Joint, cell_points: Array) -> tuple[Array, Array]:
        """Return Gauss points on all edges of the reference cell, and weights on the edges that both sets share.

        Each of these edges has its weights in one cell. The points are those of all edges, so that code is compiled
        once for all loads.

        Raises:
            InputError: the facet sets have no edge in common, or several bodies have this edge.
        """
        if joint.dim != 3:
            raise InputError(f"{self.what}: lines are edges of solids; in two dimensions give a PointLoad")
        for name in (self.first, self.second):
            require_known("facet set", name, joint.facets, self.what)
            refuse_periodic(joint, name, f"line load on {name!r}")
        table = joint.table
        first_facets, second_facets = (table.index(joint.facets[name]) for name in (self.first, self.second))
        if len(np.intersect1d(first_facets, second_facets)):
            raise InputError(f"{self.what}: both have the same facets; a line lies between two sides")
        cell_type, edge_numbers = basix.CellType[joint.cell_type], joint.split_mesh.number_entities(1, joint.corners)
        _, edges, facets, _ = basix.topology(cell_type)
        edges_of_facet = np.array([[k for k, edge in enumerate(edges) if {*edge} <= {*facet}] for facet in facets])
        edges_of_sides = (
            edge_numbers[table.cells[rows, :1], edges_of_facet[table.local[rows, 0]]]
            for rows in (first_facets, second_facets)
        )
        shared_edges = np.intersect1d(*edges_of_sides)
        if not len(shared_edges):
            raise InputError(f"{self.what}: they have no edge in common")
        all_cells, local_edges = np.nonzero(np.isin(edge_numbers, shared_edges))
        edge_components = joint.split_mesh.components(1)[all_cells, local_edges]
        rows_of_edge = [np.flatnonzero(edge_numbers[all_cells, local_edges] == number) for number in shared_edges]
        chosen_rows = [rows[_chosen_cell(joint, all_cells[rows], edge_components[rows], self)] for rows in rows_of_edge]
        cells, cell_edges = all_cells[chosen_rows], local_edges[chosen_rows]
        s, w = basix.make_quadrature(basix.CellType.interval, 2 * EDGE_GAUSS_POINTS - 1)
        first_ends, last_ends = np.moveaxis(np.asarray(basix.geometry(cell_type))[np.array(edges)], 1, 0)
        tangents = last_ends - first_ends
        points = first_ends[:, None] + s[:, :1] * tangents[:, None]  # (n_edges, q, d)
        gradients = lagrange(joint.cell_type, joint.degree).tabulate(1, points.reshape(-1, 3))[1:]
        gradients = gradients.reshape(3, *points.shape[:2], -1)[:, cell_edges]
        vectors = np.einsum("jnqm,nmi,nj->nqi", gradients, cell_points[cells], tangents[cell_edges])
        weights = np.zeros((len(joint.cells), *points.shape[:2]))
        weights[cells, cell_edges] = w * np.linalg.norm(vectors, axis=2)
        return points.reshape(-1, 3), weights.reshape(len(weights), -1)


def _chosen_cell(joint: Joint, cells: IntArray, components: Indices, load: ConcentratedLoad) -> int:
    """Return the index in `cells` of one cell of the loaded body: that with the lowest number.

    Args:
        joint: the joint.
        cells: (n,) numbers of the cells that contain the loaded vertex or edge.
        components: (n,) number of the node that each cell has there; where S separates bodies, there are several nodes.
        load: the load, which may name the loaded body.

    Raises:
        InputError: the loaded cells have several nodes there, or the named body does not reach this place.
    """
    regions, body, text = joint.region[cells], load.body, load.what
    kept_indices: IntArray = np.arange(len(cells))
    if body is not None:
        require_known("body", body, joint.bodies, text)
        kept_indices = np.flatnonzero(regions == joint.regions.index(body))
        if not len(kept_indices):
            region_names = ", ".join(sorted({joint.regions[r] for r in regions}))
            raise InputError(f"{text}: body {body!r} does not reach this place; around it: {region_names}")
    if len(np.unique(components[kept_indices])) > 1:
        names = sorted({joint.regions[r] for r in regions[kept_indices]})
        hint = f"give body=..., one of {', '.join(map(repr, names))}" if len(names) > 1 else "move it off S"
        place = at_place(joint.points[joint.corners[cells[kept_indices[0]]]].mean(axis=0))
        raise InputError(f"{text} acts where S parts bodies, near {place}, and each of them has a node there; {hint}")
    return int(kept_indices[cells[kept_indices].argmin()])


ConcentratedLoad = PointLoad | LineLoad


def check_loads(loads: Iterable[ConcentratedLoad]) -> tuple[ConcentratedLoad, ...]:
    """Return loads as a tuple.

    Raises:
        InputError: one is neither a `PointLoad` nor a `LineLoad`.
    """
    require(isinstance(loads, Iterable) and not isinstance(loads, str), "loads", loads, "it must be a list of loads")
    checked = tuple(loads)
    for load in checked:
        require(isinstance(load, ConcentratedLoad), "one of loads", load, "allowed: PointLoad, LineLoad")
    return checked


def concentrated_density(
    load: ConcentratedLoad, domain: Domain, joint: Joint, at: Coordinates
) -> tuple[Expr, ufl.Measure]:
    """Return a force per volume (d,), in UFL, that does the work of a load at points, and the measure of its integral.

    The measure has the quadrature points at which the load acts, so that its integral of f . v is the sum of the work
    there. Collective.

    Args:
        load: the load.
        domain: the distributed mesh.
        joint: the joint as drawn, before S is opened to the layer's thickness; its cells are the first cells of the
            domain's joint.
        at: coordinates and time.
    """
    points, weights = load.points_and_weights(joint, domain.joint.cell_points)
    values, unit_weights = np.zeros((len(domain.joint.cells), len(points), 1)), np.ones(len(points))
    values[: len(weights), :, 0] = weights
    element = basix.ufl.quadrature_element(domain.mesh.basix_cell(), points=points, weights=unit_weights)
    factor = domain.cellwise_function(element, values) / abs(ufl.JacobianDeterminant(domain.mesh))
    rule = {"quadrature_points": points.tolist(), "quadrature_weights": unit_weights.tolist()}
    metadata = {"quadrature_rule": "custom", **rule}
    dx = ufl.Measure("dx", domain=domain.mesh, subdomain_data=domain.cell_tags, metadata=metadata)
    force = at.coefficient(load.force, load.what, (joint.dim,)).expression
    return force * factor, dx(domain.region_tags(*joint.bodies))
