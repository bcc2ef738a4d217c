"""Virtual work of a softening law in a meshed layer, evaluated at the mean strains through the thickness."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from itertools import product, repeat

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from forms.base import Array
from forms.law_tangents import depends_on_normal, tangent_at_rest
from forms.work import Term
from geometry.topology import is_tensor
from thinlayer.pointwise.compiled_term import INDEPENDENCE_TOLERANCE, CompiledTerm, Projection, Response
from thinlayer.pointwise.quadrature import MeshOrigin
from thinlayer.system.ranks import destroy


class ColumnTerm(CompiledTerm):
    """Softening law in a meshed layer, evaluated at means of the strains through the thickness.

    The means are over columns, the cells above each other through the thickness, so that the layer behaves as one on S.
    With strains of single cells, only one row of cells would soften and the others unload. The fracture energy would
    then depend on the number of rows.

    The deviations of strains from their means are elastic, with the law's tangent C before loading. Nodes in a broken
    layer therefore keep a stiffness. With the law's energy psi and the strain e,

        energy = int [psi(mean) + (e - mean) : C (e - mean)/2].
    """

    def __init__(self, V: fem.FunctionSpace, term: Term, origin: MeshOrigin | None = None) -> None:
        super().__init__(V, term, origin)
        self._B_of_means, B_deviations = self._mean_projection.projected_matrix(self.B), self.B.copy()
        B_deviations.axpy(-1.0, self._B_of_means)
        self.constant_matrices = (self._tangent_matrix(self._C_start[:, self.mandel], B_deviations),)
        destroy(B_deviations)

    @cached_property
    def _mean_projection(self) -> Projection:
        """Projection that replaces strains at quadrature points by their means through the layer's thickness.

        Along S the means vary as polynomials in each column of cells. In quadrilaterals and hexahedra the polynomials
        have the quadrature degree, so that they represent any values at the points' positions along S. In other cells
        they have the degree of the displacements.
        """
        is_tensor_cell = is_tensor(self.region.mesh.topology.cell_name())
        max_degree = self.degree if is_tensor_cell else self._V.ufl_element().basix_element.degree
        exponents = [p for p in product(range(max_degree + 1), repeat=self.dim - 1) if sum(p) <= max_degree]
        column, joint_x = self.columns.column_of[self.cells[:, 0]], self.joint_x.T
        n_cells, bases = np.bincount(column), []
        for k in np.unique(n_cells[column]):  # columns at junctions of layers have other numbers of cells
            rows = np.flatnonzero(n_cells[column] == k)
            points = self.cells[rows[np.argsort(column[rows], kind="stable")]].reshape(-1, k * self.cells.shape[1])
            x = joint_x[points]
            U, sigma, _ = np.linalg.svd(x - x.mean(axis=1, keepdims=True), full_matrices=False)
            U *= np.sqrt(x.shape[1]) * (sigma > INDEPENDENCE_TOLERANCE * np.abs(x).max(axis=(1, 2))[:, None])[:, None]
            bases.append((points, np.stack([np.prod(U[..., : self.dim - 1] ** p, axis=2) for p in exponents], axis=2)))
        return Projection(self, bases, np.eye(6))

    @cached_property
    def _C_start(self) -> Array:
        """Tangents (points, 6, m) of the law before loading: the 6 Mandel components of stress by the m of strain.

        If the parameters do not depend on the place, points with the same normal of the layer share one computation.
        """
        law = self.term.law
        laws = list(law.at_places(self.joint_x)) if law.fields else repeat(law)
        n = self.n if law.fields or depends_on_normal(law) else self.n[:1]
        n, n_indices = (n, np.arange(len(n))) if law.fields else np.unique(n.round(12), axis=0, return_inverse=True)
        C = np.array([tangent_at_rest(law, v[: self.dim]) for law, v in zip(laws, n, strict=False)]).reshape(-1, 6, 6)
        return np.broadcast_to(C[n_indices.ravel()][..., self.mandel], (self.count, 6, len(self.mandel)))

    def respond(self, e: Array, e_old: Array, memory: Array, dt: float, theta: float) -> Response:
        """Return the law's response to mean strains over columns, plus the elastic response to deviations from them.

        theta must be 1. The stress is the derivative of the total energy by the strains e, not by their means.

        Args:
            e, e_old: (points, m) strains at the end and at the beginning of the step, as m Mandel components.
            memory: (points, values) internal variables at the beginning of the step.
            dt: length of the step.
            theta: fraction of the step after which forces balance.
        """
        mean, old = self._mean_projection(e), self._mean_projection(e_old)
        response, deviation = super().respond(mean, old, memory, dt, theta), e - mean
        elastic_stress = np.einsum("pij,pj->pi", self._C_start, deviation)
        stress = self._mean_projection(response.full_stress - elastic_stress) + elastic_stress
        energies = response.energies.copy()
        energies[:, 0] += self._energies(deviation)
        energies[:, 2] += self._energies(deviation - e_old + old)
        return replace(response, full_stress=stress, stress=stress[:, self.mandel], energies=energies)

    def driving_strain(self, e: Array) -> Array:
        """Return the means of strains (points, m) over columns, to which the law responds."""
        return self._mean_projection(e)

    def _energies(self, deviation: Array) -> Array:
        """Return the elastic energies (points,) per volume of `deviation` (points, m).

        These are the strains minus their means over columns, as m Mandel components.
        """
        return np.asarray(np.einsum("pi,pij,pj->p", deviation, self._C_start[:, self.mandel], deviation) / 2)

    def stored_energy(self, e: Array, memory: Array, dt: float) -> float:
        """Return the stored energy on this rank: that of the mean strains plus that of the deviations from them.

        Means are over columns, the cells above each other through the layer's thickness.

        Args:
            e: (points, m) strains, as m Mandel components.
            memory: (points, values) internal variables at the end of a step.
            dt: length of the step.
        """
        mean = self._mean_projection(e)
        return super().stored_energy(mean, memory, dt) + float(self.weights @ self._energies(e - mean))

    def stiffness(self, tangent: Array, relative_residual: float = 0.0, into: PETSc.Mat | None = None) -> PETSc.Mat:
        """Return the tangent matrix of the law at the mean strains over columns.

        The elastic matrix of the deviations from the means does not change; it is the attribute `constant_matrices`.

        Args:
            tangent: (points, m, m) tangents of the law, for m Mandel components.
            relative_residual: norm of the last residual over the reference force.
            into: an earlier result, which is overwritten and whose nonzero pattern is used again; None: a new matrix.
        """
        return self._tangent_matrix(self._regularised(tangent, relative_residual), self._B_of_means, into)

    def destroy(self) -> None:
        """Free the PETSc matrices and vectors."""
        super().destroy()
        destroy(self._B_of_means, *self.constant_matrices)
