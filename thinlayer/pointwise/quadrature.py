"""Where compiled laws act: quadrature points in a meshed layer and on S alike."""

from __future__ import annotations

from functools import cached_property

import basix.ufl
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from forms.kinematics import Expr, lift
from forms.work import Term
from geometry.domain import Domain
from geometry.joint import S
from thinlayer.discretisation.compat import create_submesh
from thinlayer.discretisation.loads import Coordinates
from thinlayer.pointwise.columns import Columns, column_numbers

Array = npt.NDArray[np.float64]


class Region:
    """The part of the mesh where a measure integrates, as a mesh of its own.

    Attributes:
        domain: the domain.
        measure: dx(values), ds(values) or dS(value) of S.
        mesh: the cells of the meshed layer, or the facets of S.
        dim: dimension of its cells.
        parent: local number in the domain's mesh of each cell of `mesh`.
        maps: entity maps for fem.form.
    """

    def __init__(self, domain: Domain, measure: ufl.Measure) -> None:
        self.domain, self.measure = domain, measure
        in_volume = measure.integral_type() == "cell"
        if in_volume:
            wanted = np.atleast_1d(measure.subdomain_id())
            entities = domain.cell_tags.indices[np.isin(domain.cell_tags.values, wanted)]
        else:
            entities = domain.facets(S)
        self.dim = domain.joint.dim - (not in_volume)
        self.mesh, self.maps, self.parent = create_submesh(domain.mesh, self.dim, np.sort(entities))

    @property
    def original(self) -> npt.NDArray[np.int64]:
        """For each cell of `mesh` its number in the joint: of the cell, or of the facet in the joint's table."""
        domain = self.domain
        if self.dim == domain.joint.dim:
            return np.asarray(domain.original_cells[self.parent], np.int64)
        topology = domain.mesh.topology
        topology.create_connectivity(0, topology.dim)
        vertices = [topology.connectivity(self.dim, 0).links(facet) for facet in self.parent]
        if not vertices:
            return np.empty(0, np.int64)
        nodes = dolfinx.mesh.entities_to_geometry(domain.mesh, 0, np.concatenate(vertices).astype(np.int32)).ravel()
        original = np.asarray(domain.mesh.geometry.input_global_indices)[nodes].reshape(len(vertices), -1)
        return domain.joint.table.index(original)

    def side(self, f: Expr) -> Expr:
        """A function on `mesh` as the measure's integrands need it."""
        return f("+") if self.measure.integral_type() == "interior_facet" else f


class Quadrature:
    """Quadrature points of a region. Collective.

    Attributes:
        points: law, strain, weight and measure there.
        region: the cells of the meshed layer, or S.
        degree: of the quadrature.
        count: number of points of this rank.
        cells: (cells of the region that this rank owns, points per cell) their points.
        x: (points, d) their places.
        n: (points, 3) director.
        weights: (points,) quadrature weights.
    """

    def __init__(self, domain: Domain, term: Term, degree: int) -> None:
        self.domain, self.term = domain, term
        metadata = dict(term.measure.metadata())
        self.degree = metadata.setdefault("quadrature_degree", degree)
        self.region = Region(domain, term.measure)
        self._measure = term.measure.reconstruct(metadata=metadata)
        self._geometry()

    def _space(self, shape: tuple[int, ...]) -> fem.FunctionSpace:
        cell = self.region.mesh.basix_cell()
        return fem.functionspace(
            self.region.mesh, basix.ufl.quadrature_element(cell, value_shape=shape, degree=self.degree)
        )

    def _geometry(self) -> None:
        """Places, director and weights of the points."""
        d = self.domain.joint.dim
        W = self._space((5 + d,))
        self.count = W.dofmap.index_map.size_local
        mesh = self.region.mesh
        self.cells = np.asarray(W.dofmap.list)[: mesh.topology.index_map(mesh.topology.dim).size_local]
        q = self.region.side(ufl.TestFunction(W))
        n, x = lift(self.term.n), self.region.side(ufl.SpatialCoordinate(self.domain.mesh))
        rows = ufl.as_vector([n[0], n[1], n[2], 1, self.term.weight, *(x[i] for i in range(d))])
        form = fem.form(ufl.inner(rows, q) * self._measure, entity_maps=self.region.maps)
        values = fem.assemble_vector(form).array.reshape(-1, 5 + d)[: self.count]
        self._integrals, self.weights = values[:, 3].copy(), values[:, 4].copy()
        self.n, self.x = (values[:, part] / values[:, 3:4] for part in (slice(0, 3), slice(5, None)))

    @cached_property
    def joint_x(self) -> Array:
        """Places (d, points) of the points in the joint before inflating."""
        d, band = self.domain.joint.dim, self.domain.joint.band
        if band is None or band.bodies == "extended":
            return np.ascontiguousarray(self.x.T)
        q = self.region.side(ufl.TestFunction(self._space((d,))))
        x = self.region.side(Coordinates.of(self.domain).x)
        form = fem.form(ufl.inner(x, q) * self._measure, entity_maps=self.region.maps)
        values = fem.assemble_vector(form).array.reshape(-1, d)[: self.count]
        return np.ascontiguousarray((values / self._integrals[:, None]).T)

    @cached_property
    def columns(self) -> Columns:
        """The columns of the layer that the points are in."""
        numbers, centres = column_numbers(self.domain.joint)
        of_cells = numbers[self.region.original]
        of = np.empty(self.count, np.int64)
        of[self.cells] = of_cells[: len(self.cells), None]
        return Columns(self.domain.comm, of, centres, self.weights)
