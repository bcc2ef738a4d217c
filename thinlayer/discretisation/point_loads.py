"""Loads at vertices and along edges: cells and places where they act, and their virtual work as forms."""

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
from geometry.topology import Indices, IntArray, lagrange, sum_by_number
from thinlayer.discretisation.boundary import refuse_periodic
from thinlayer.discretisation.coefficient import Coordinates, LoadInput
from thinlayer.discretisation.mesh_functions import cellwise_function

EDGE_GAUSS_POINTS = 4  # Gauss points on an edge: exact for degree 7


@dataclass(frozen=True)
class LoadPlaces:
    """Places in n cells, k in each, at which a load at points or along lines acts.

    Attributes:
        cells: (n,) numbers of the cells in the joint.
        reference_points: (n, k, d) coordinates of the places in the reference cell, in d dimensions.
        length_vectors: (n, k, d) vectors in the reference cell. The length of one, mapped to space, is the weight of
            the load at the place. None: all weights are 1.
    """

    cells: IntArray
    reference_points: Array
    length_vectors: Array | None = None

    def mapped_to_space(self, joint: Joint, cell_points: Array) -> tuple[Array, Array]:
        """Return the coordinates (n, k, d) in space of the places, and `length_vectors` (n, k, d) mapped to space.

        The vectors are zero if `length_vectors` is None.

        Args:
            joint: the joint, with the type and degree of the cells.
            cell_points: (n_cells, m, d) coordinates of the m nodes of each cell of the joint.
        """
        n, k, d = self.reference_points.shape
        table = lagrange(joint.cell_type, joint.degree).tabulate(1, self.reference_points.reshape(-1, d))
        table, nodes = table.reshape(d + 1, n, k, -1), cell_points[self.cells]
        vectors = np.zeros((n, k, d)) if self.length_vectors is None else self.length_vectors
        return table[0] @ nodes, np.einsum("jnkm,nmi,nkj->nki", table[1:], nodes, vectors)


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

    def nodes(self, joint: Joint) -> LoadPlaces:
        """Return the vertex at which the load acts, as a place in one cell of the loaded body.

        Raises:
            InputError: there is no vertex at the place, or several bodies have a node there.
        """
        vertex = joint.nearest_point(self.place)
        is_loaded = joint.masters == joint.masters[vertex] if joint.periods else np.arange(len(joint.points)) == vertex
        cells, corners = np.nonzero(is_loaded[joint.corners])
        index = _chosen_cell(joint, cells, joint.split_mesh.components(0)[cells, corners], self)
        X = np.asarray(basix.geometry(basix.CellType[joint.cell_type]))
        return LoadPlaces(cells[index : index + 1], X[corners[index : index + 1], None])


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

    def nodes(self, joint: Joint) -> LoadPlaces:
        """Return the Gauss points at which the load acts, on the edges that both facet sets share.

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
        X = np.asarray(basix.geometry(cell_type))[np.array(edges)[cell_edges]][:, :, None]  # (n, 2, 1, d)
        return LoadPlaces(cells, X[:, 0] + s[:, :1] * (X[:, 1] - X[:, 0]), w[:, None] * (X[:, 1] - X[:, 0]))


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


class ConcentratedForms:
    """Loads at points and along lines as forces per volume that do the same virtual work.

    A force F at a place in a cell becomes the force per volume F g/J. J is the volume of the cell over that of the
    reference cell. The polynomial g is such that the integral of F . v g over the reference cell is F . v at the place.
    This holds for all displacements v of the cell.

    Args:
        domain: the distributed mesh.
        joint: the joint as drawn, before S is opened to the layer's thickness; its cells are the first cells of the
            domain's joint.
        degree: degree of the displacements.
        at: coordinates and time.
    """

    def __init__(self, domain: Domain, joint: Joint, degree: int, at: Coordinates) -> None:
        self.domain, self.joint, self.at, metadata = domain, joint, at, {"quadrature_degree": 2 * degree}
        self._dx = ufl.Measure("dx", domain=domain.mesh, subdomain_data=domain.cell_tags, metadata=metadata)
        cell_type = basix.CellType[joint.cell_type]
        self._ufl = basix.ufl.element("DG", domain.mesh.basix_cell(), degree)
        self._element = self._ufl.basix_element
        X, w = basix.make_quadrature(cell_type, 2 * degree)
        phi = self._element.tabulate(0, X)[0, :, :, 0]
        self._inverse_mass = np.linalg.inv(phi.T @ (w[:, None] * phi))
        self._jacobian = abs(ufl.JacobianDeterminant(domain.mesh))

    def densities(self, load: ConcentratedLoad) -> list[tuple[Expr, ufl.Measure]]:
        """Return forces per volume (d,), in UFL, that add up to a load, each with the measure of its integral.

        Collective.
        """
        nodes, d, joint, densities = load.nodes(self.joint), self.joint.dim, self.domain.joint, []
        weights = np.ones(nodes.reference_points.shape[:2])
        if nodes.length_vectors is not None:
            weights = np.linalg.norm(nodes.mapped_to_space(self.joint, joint.cell_points)[1], axis=2)
        is_kept = joint.band is not None and joint.band.bodies == "kept"
        x = nodes.mapped_to_space(joint, joint.reference[joint.cells] if is_kept else joint.cell_points)[0]
        # if the load varies each node has its own place, so that nodes in one cell are in different terms
        varies = self.at.coefficient(load.force, load.what, (d,)).varies
        body_dx = self._dx(self.domain.region_tags(*self.joint.bodies))
        batches = [(r, slice(j, j + 1)) for r in _disjoint_groups(nodes.cells) for j in range(weights.shape[1])]
        for rows, column in batches if varies else [(np.arange(len(nodes.cells)), slice(None))]:
            batch = LoadPlaces(nodes.cells[rows], nodes.reference_points[rows, column])
            g = cellwise_function(self.domain, self._ufl, self._g_values(batch, weights[rows, column])) / self._jacobian
            places = np.zeros((len(joint.cells), 1, d))
            places[batch.cells] = x[rows, column][:, :1]
            at = self.at.with_place(cellwise_function(self.domain, ("DG", 0, (d,)), places)) if varies else self.at
            densities.append((at.coefficient(load.force, load.what, (d,)).expression * g, body_dx))
        return densities

    def _g_values(self, nodes: LoadPlaces, weights: Array) -> Array:
        """Return the weighted sum of the polynomials g of all loaded places, as coefficients (n_cells, m, 1).

        The coefficients are those of the m basis functions of each cell. The integral of g v over the reference cell is
        the value of v at the place that belongs to g.

        Args:
            nodes: n loaded cells, each with k loaded places; a cell may occur several times.
            weights: (n, k) factor of the polynomial of each place.
        """
        phi = self._element.tabulate(0, nodes.reference_points.reshape(-1, self.joint.dim))[0, :, :, 0]
        g = (phi @ self._inverse_mass.T).reshape(*nodes.reference_points.shape[:2], -1)
        return sum_by_number(nodes.cells, np.einsum("nk,nkm->nm", weights, g), len(self.domain.joint.cells))[..., None]


def _disjoint_groups(cells: IntArray) -> Iterable[IntArray]:
    """Divide the indices of `cells` (n,) into groups in which each cell number occurs at most once."""
    order = np.argsort(cells, kind="stable")
    occurrence = np.arange(len(cells)) - np.searchsorted(cells[order], cells[order])
    return [order[occurrence == k] for k in range(int(occurrence.max(initial=-1)) + 1)]
