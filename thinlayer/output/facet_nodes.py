"""Values of expressions on S at the nodes of its facets, each facet by itself: fields may jump from facet to facet."""

from __future__ import annotations

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from ufl.classes import Zero

from forms.kinematics import Expr
from geometry.topology import FACET_TYPES, IntArray, lagrange
from thinlayer.compiling.compat import joined_maps
from thinlayer.output.surface import Surface
from thinlayer.pointwise.quadrature import Region

Array = npt.NDArray[np.float64]


class FacetNodes:
    """The nodes of the facets of a surface that this rank owns; those of elements of the displacements' degree. Collective.

    A facet has nodes of its own, so that all expressions have one value there: tractions that jump where seams meet,
    normals of a S with corners.

    Attributes:
        rows: (facets,) rows of the facets in the joint's table.
        kind: type of the facets, "interval", "triangle" or "quadrilateral".
        degree: polynomial degree.
    """

    def __init__(self, surface: Surface) -> None:
        model, sides = surface.model, surface.sides
        self.kind = FACET_TYPES[model.joint.cell_type]
        self.degree = max(model.joint.degree, model.structure.degree)
        self._region = Region(model.domain.mesh, sides.measure)
        mesh, self._maps = self._region.mesh, surface.entity_maps
        self._count = mesh.topology.index_map(mesh.topology.dim).size_local
        self.rows: IntArray = model.domain.numbers(self._region.dim, self._region.parent)[: self._count]
        points, _ = basix.make_quadrature(basix.CellType[self.kind], 2 * self.degree)
        # from values at the points of quadrature to those at the nodes: exact for polynomials of this degree
        self._to_nodes = np.linalg.pinv(lagrange(self.kind, self.degree).tabulate(0, points)[0, :, :, 0])
        self._measure = sides.measure(metadata={"quadrature_degree": 2 * self.degree})
        self._sizes = self._integrated(ufl.as_vector([fem.Constant(model.domain.mesh, 1.0)]))

    def values(self, f: Expr) -> Array:
        """Values (facets, nodes, m) of a vector expression (m,) on S. Collective."""
        if isinstance(f, Zero):
            return np.zeros((self._count, len(self._to_nodes), *f.ufl_shape))
        return np.asarray(np.einsum("nq,fqm->fnm", self._to_nodes, self._integrated(f) / self._sizes))

    def _integrated(self, f: Expr) -> Array:
        """Values (facets, points of quadrature, m) times the quadrature weights."""
        kind, degree = basix.CellType[self.kind], 2 * self.degree
        W = fem.functionspace(
            self._region.mesh, basix.ufl.quadrature_element(kind, value_shape=f.ufl_shape, degree=degree)
        )
        q = self._region.side(ufl.TestFunction(W))
        form = fem.form(ufl.inner(f, q) * self._measure, entity_maps=joined_maps(self._region.maps, self._maps))
        found = np.asarray(fem.assemble_vector(form).array.reshape(-1, *f.ufl_shape))
        return found[np.asarray(W.dofmap.list)[: self._count]]
