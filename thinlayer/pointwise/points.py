"""Quadrature points of a layer where a compiled law acts, in a meshed layer and on S alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import basix.ufl
import dolfinx.fem.petsc
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.kinematics import MANDEL, ROOT2, Expr, lift
from forms.work import Points
from geometry.domain import Domain
from geometry.joint import S
from thinlayer.compat import create_submesh
from thinlayer.pointwise.kernels import Array
from thinlayer.pointwise.material import Material


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


@dataclass(frozen=True)
class Response:
    """What a law answers at the points of this rank.

    Attributes:
        stress: (points, m), at t + theta dt.
        tangent: (points, m, m).
        memory: (points, values) internal values at the end of the step.
        energies: stored, dissipated, remainder, integrated over this rank's points; NaN if the law declares no energy.
        failed: number of points of this rank where the law failed.
    """

    stress: Array
    tangent: Array
    memory: Array
    energies: Array
    failed: int

    @property
    def skew(self) -> float:
        """Largest difference between the tangent at a point of this rank and its transpose, over its size."""
        C = self.tangent
        apart, size = np.abs(C - C.swapaxes(1, 2)).max(axis=(1, 2)), np.abs(C).max(axis=(1, 2))
        regular = np.isfinite(apart) & (size > 0)
        return float((apart[regular] / size[regular]).max(initial=0.0))


class LawPoints:
    """Points where one compiled law acts. Collective.

    Attributes:
        points: the law, its strain, weight and measure.
        material: the compiled law.
        count: number of points of this rank.
        cells: (cells of the region that this rank owns, points per cell) their points.
        x: (points, d) their places.
        n: (points, 3) director.
        weights: (points,) quadrature weights.
    """

    def __init__(self, domain: Domain, V: fem.FunctionSpace, points: Points, degree: int) -> None:
        self.domain, self.points = domain, points
        metadata = dict(points.measure.metadata())
        self.degree = metadata.setdefault("quadrature_degree", degree)
        self.region = Region(domain, points.measure)
        self._measure = points.measure.reconstruct(metadata=metadata)
        self.slots = [k for k, (_, j) in enumerate(MANDEL) if j < domain.joint.dim]
        self._strain_matrix(V)
        self._geometry()
        self.B.diagonalScale(L=self._vector(np.repeat(1 / self._integrals, len(self.slots))))
        self.material = Material(domain.comm, points.law)

    def _space(self, shape: tuple[int, ...]) -> fem.FunctionSpace:
        cell = self.region.mesh.basix_cell()
        return fem.functionspace(
            self.region.mesh, basix.ufl.quadrature_element(cell, value_shape=shape, degree=self.degree)
        )

    def _strain_matrix(self, V: fem.FunctionSpace) -> None:
        """B: displacements -> strains at the points (m rows each); assembled once, as strains are linear."""
        W = self._space((len(self.slots),))
        self.count = W.dofmap.index_map.size_local
        mesh = self.region.mesh
        self.cells = np.asarray(W.dofmap.list)[: mesh.topology.index_map(mesh.topology.dim).size_local]
        du, q = ufl.TrialFunction(V), self.region.side(ufl.TestFunction(W))
        e = self.points.strain(du)
        rows = [e[i, j] * (1.0 if i == j else ROOT2) for i, j in (MANDEL[k] for k in self.slots)]
        form = fem.form(ufl.inner(ufl.as_vector(rows), q) * self._measure, entity_maps=self.region.maps)
        self.B = dolfinx.fem.petsc.assemble_matrix(form)
        self.B.assemble()
        self._strain, self._forces = self.B.createVecLeft(), self.B.createVecRight()

    def _geometry(self) -> None:
        """Places, director and weights of the points."""
        d = self.domain.joint.dim
        q = self.region.side(ufl.TestFunction(self._space((5 + d,))))
        n, x = lift(self.points.n), self.region.side(ufl.SpatialCoordinate(self.domain.mesh))
        rows = ufl.as_vector([n[0], n[1], n[2], 1, self.points.weight, *(x[i] for i in range(d))])
        form = fem.form(ufl.inner(rows, q) * self._measure, entity_maps=self.region.maps)
        values = fem.assemble_vector(form).array.reshape(-1, 5 + d)[: self.count]
        self._integrals, self.weights = values[:, 3].copy(), values[:, 4].copy()
        self.n, self.x = (values[:, part] / values[:, 3:4] for part in (slice(0, 3), slice(5, None)))

    def _vector(self, values: Array) -> PETSc.Vec:
        """A vector over the rows of B."""
        out = self.B.createVecLeft()
        out.array[:] = values
        return out

    def strain(self, u: PETSc.Vec) -> Array:
        """Strains (points, m) of a displacement vector. Collective."""
        self.B.mult(u, self._strain)
        return self._strain.array_r.reshape(self.count, len(self.slots)).copy()

    def respond(self, e: Array, e_old: Array, memory: Array, dt: float, theta: float) -> Response:
        """The law's answer to strains e after e_old and the internal values `memory`."""
        s, C, new, energies, failed = self.material.update(self.slots, e, e_old, memory, self.n, dt, theta)
        total = self.weights @ energies if self.points.law.has_energy else np.full(3, np.nan)
        return Response(s, C, new, total, failed)

    def ease(self, ease: float) -> None:
        """Let the law answer from now on with an ease, see `Law.eased`; 0: the law itself."""
        self.material.take(self.points.law.eased(ease) if ease else self.points.law)

    def rest(self) -> Array:
        """Internal values before anything happened."""
        return np.zeros((self.count, self.material.memory))

    def forces(self, stress: Array) -> PETSc.Vec:
        """Nodal forces of stresses: int stress : e(v). The vector is overwritten by the next call. Collective."""
        weighted = self._vector((stress * self.weights[:, None]).ravel())
        self.B.multTranspose(weighted, self._forces)
        weighted.destroy()
        return self._forces

    def stiffness(self, tangent: npt.NDArray[Any]) -> PETSc.Mat:
        """Matrix of int e(v) : tangent : e(du). Collective."""
        m, rows = len(self.slots), self.count * len(self.slots)
        first = self.B.getOwnershipRange()[0]
        indptr = np.arange(0, rows * m + 1, m, dtype=PETSc.IntType)
        blocks = np.arange(rows, dtype=PETSc.IntType).reshape(self.count, 1, m)
        indices = (first + np.broadcast_to(blocks, (self.count, m, m))).astype(PETSc.IntType).ravel()
        values = (tangent * self.weights[:, None, None]).ravel()
        size = (self.B.getSizes()[0], self.B.getSizes()[0])
        D = PETSc.Mat().createAIJ(size, csr=(indptr, indices, values), comm=self.domain.comm)
        A = D.ptap(self.B)
        D.destroy()
        return A

    def destroy(self) -> None:
        """Free the matrices."""
        for thing in (self.B, self._strain, self._forces):
            thing.destroy()
