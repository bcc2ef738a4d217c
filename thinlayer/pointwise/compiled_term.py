"""A compiled law at the quadrature points of a body or a layer: strains, stresses and their nodal forces."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product, repeat

import numpy as np
import scipy.sparse
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.base import Array, InputError
from forms.law_tangents import LONG_TIME_STEP, depends_on_normal, tangent_at_rest
from forms.tensors import MANDEL_BASIS, MANDEL_PAIRS, Expr, mandel_vector
from forms.work import Term
from geometry.topology import is_tensor
from thinlayer.pointwise.columns import Switching
from thinlayer.pointwise.compiled_law import CompiledLaw
from thinlayer.pointwise.quadrature import MeshOrigin, Quadrature, assemble_matrix
from thinlayer.system.ranks import destroy, errors_on_all

# size of a tangent below which underflow may have lost digits
UNDERFLOW_LIMIT = np.finfo(float).tiny / np.finfo(float).eps ** 2
# stresses fall if an eigenvalue of the tangent, or the work of stress changes, is below minus this share of its size
SOFTENING_TOLERANCE = 1e-3
REST_STEP_FRACTION = np.finfo(float).eps  # fraction of a step that is too short for any change of internal variables
INDEPENDENCE_TOLERANCE = 1e-8  # least singular value, over the largest, of linearly independent functions
MIN_REGULARISATION, MAX_REGULARISATION = 1e-6, 1e-3  # share of the tangent at rest that is added to a singular one


@dataclass(frozen=True)
class Response:
    """Stress, tangent, internal variables and energies of a law at this rank's points, after a step.

    Attributes:
        full_stress: (points, 6) stress at old.t + theta dt, where forces balance; all Mandel components.
        stress: (points, m) those m components of `full_stress` for which strains are computed.
        tangent: (points, m, m) derivative of `stress` by the strains at the end of the step.
        memory: (points, values) internal variables at the end of the step.
        energies: (points, 3) energies per volume, on S for a weight of 1: stored at the end, dissipated in the step, and
            remainder of the energy balance (error of the time scheme); NaN if the law declares no energy.
        n_failed: number of points of this rank where the law failed.
    """

    full_stress: Array
    stress: Array
    tangent: Array
    memory: Array
    energies: Array
    n_failed: int

    @property
    def asymmetry(self) -> float:
        """Asymmetry of the tangent C: the largest entry of C - C^T over the largest entry of C.

        It is the maximum over this rank's points.
        """
        C = self.tangent
        asymmetry, size = np.abs(C - C.swapaxes(1, 2)).max(axis=(1, 2)), np.abs(C).max(axis=(1, 2))
        is_regular = np.isfinite(asymmetry) & (size > UNDERFLOW_LIMIT)
        return float((asymmetry[is_regular] / size[is_regular]).max(initial=0.0))


class CompiledTerm(Quadrature):
    """Compiled law at the quadrature points of a measure: strains, stresses, nodal forces and tangents. Collective.

    Args:
        V: space of the displacements on the term's mesh.
        term: virtual work of the law.
        origin: relation of the mesh to the joint, the undistributed mesh from which it was made; None: there is no
            joint.

    Attributes:
        B: matrix from displacements to strains. Each point has m rows, one for each of the m Mandel components
            `mandel`.
        material: the compiled law.
        switching: phases of a law that are fixed in a solve and switch after it; None for other laws.
        constant_matrices: matrices of the tangent that do not change; the result of `stiffness` does not contain them.
    """

    constant_matrices: tuple[PETSc.Mat, ...] = ()

    def __init__(self, V: fem.FunctionSpace, term: Term, origin: MeshOrigin | None = None) -> None:
        super().__init__(V, term, origin)
        self._V = V
        # assembled once, as strains are linear in the displacements
        self.B = B = self.matrix_to_strains(self.term.strain(ufl.TrialFunction(V)))
        self._volume_projection = None if term.bbar_degree is None else VolumeProjection(self, term.bbar_degree)
        if self._volume_projection:
            self.B = self._volume_projection.projected_matrix(B)
            destroy(B)
        self._zero_indices = [k for k in range(len(MANDEL_PAIRS)) if k not in term.kinematics.stress_indices(self.dim)]
        self._strain, self._forces = self.B.createVecLeft(), self.B.createVecRight()
        self.material = CompiledLaw(self.comm, term.law)
        self.switching = Switching(term.law, self.columns) if term.law.traits.switches else None
        self._C_rest = self.tangent_at_rest() if term.law.traits.singular else None

    def matrix_to_strains(self, strain: Expr) -> PETSc.Mat:
        """Return the matrix from unknowns to strains at the points, for a UFL strain linear in a trial function."""
        B = assemble_matrix(self.strain_form(strain))
        B.diagonalScale(L=_vector_of_rows(B, np.repeat(1 / self._measure_weights, len(self.mandel))))
        return B

    def strain_form(self, strain: Expr) -> fem.Form:
        """Compile a form from which `strain_values` computes the values of `strain`, (3, 3) in UFL, at the points."""
        q = self.region.plus_side(ufl.TestFunction(self._space((len(self.mandel),))))
        return self.region.compiled(ufl.inner(mandel_vector(strain, self.mandel), q) * self.measure)

    def strain_values(self, form: fem.Form) -> Array:
        """Return the values (points, m) of a strain at the points, from a `form` that `strain_form` made of it.

        They are the m Mandel components `mandel`, at the present values of the form's constants. If the law uses B-bar,
        the traces are projected in each cell.
        """
        values = np.asarray(fem.assemble_vector(form).array).reshape(-1, len(self.mandel))[: self.count]
        return self.projected(values / self._measure_weights[:, None])

    def projected(self, values: Array) -> Array:
        """Return `values` with traces projected in each cell if the law uses B-bar, else unchanged.

        `values` are strains (points, m) or stresses (points, 6). The projection is symmetric: projected stresses do the
        same work in strains as stresses in projected strains.
        """
        return self._volume_projection(values) if self._volume_projection else values

    def strain(self, u: PETSc.Vec) -> Array:
        """Return the strains (points, m) of displacements `u`, as the m Mandel components `mandel`. Collective.

        Prescribed strains are not included.
        """
        self.B.mult(u, self._strain)
        return self._strain.array_r.reshape(self.count, len(self.mandel)).copy()

    def respond(self, e: Array, e_old: Array, memory: Array, dt: float, theta: float) -> Response:
        """Return the response of the law at this rank's points over a step.

        Args:
            e, e_old: (points, m) strains at the end and at the beginning of the step, as m Mandel components.
            memory: (points, values) internal variables at the beginning of the step.
            dt: length of the step.
            theta: fraction of the step after which forces balance.
        """
        s, C, new, energies, n_failed = self.material.update(self.mandel, e, e_old, memory, self.n, dt, theta)
        s[:, self._zero_indices] = 0.0
        if not self.term.law.traits.has_energy:
            energies[:] = np.nan
        return Response(s, s[:, self.mandel], C, new, energies, n_failed)

    def driving_strain(self, e: Array) -> Array:
        """Return the strains (points, m) to which the law responds at strains `e` (points, m): these themselves."""
        return e

    def stored_energy(self, e: Array, memory: Array, dt: float) -> float:
        """Return the stored energy, integrated over this rank's points; NaN if the law declares no energy.

        Args:
            e: (points, m) strains, as m Mandel components.
            memory: (points, values) internal variables at the end of a step.
            dt: length of the step.
        """
        energies = self.material.update(self.mandel, e, e, memory, self.n, REST_STEP_FRACTION * dt, 1.0, frozen=True)[3]
        return float(self.weights @ energies[:, 0]) if self.term.law.traits.has_energy else np.nan

    def failure(self, response: Response) -> str:
        """Return a message about the first point of this rank where the law failed; "" if it failed nowhere.

        `response` is the response of the law in which the failures are looked for.
        """
        if not (is_failed := np.isnan(response.full_stress[:, 0])).any():
            return ""
        k, law = int(is_failed.argmax()), self.term.law
        text = "stress" if np.isfinite(response.tangent[k]).all() else "tangent (the slope of the stress)"
        plane_stress = any(sublayer.law_3d is not sublayer for _, sublayer in law.sublayers)
        why = ", or no strain out of the plane makes the stresses there zero" if plane_stress else ""
        place = ", ".join(f"{c:g}" for c in self.x[k])
        return f"the {text} of {type(law.law_3d).__name__} is not finite at x = ({place}){why}"

    def count_softening_points(self, e: Array, e_old: Array, memory: Array, response: Response) -> int:
        """Return the number of this rank's points where stresses fall, in a step, as the layer opens or slips.

        Stresses fall where the tangent is negative for the strain sym(v (x) n) of some jump v. For a law with constant
        parameters and no internal variables they also fall under a second condition. It is that the change of stress
        does negative work on the change of strain.

        Args:
            e, e_old: (points, m) strains at the end and at the beginning of the step, as m Mandel components.
            memory: (points, values) internal variables at the beginning of the step.
            response: response of the law in this step.
        """
        law = self.term.law
        N = np.einsum("kij,pj->pik", MANDEL_BASIS[self.mandel], self.n)[:, : self.dim]  # strains of unit jumps
        A = N @ response.tangent @ N.swapaxes(1, 2)
        size = np.abs(A).max(axis=(1, 2), initial=0.0)
        valid = np.isfinite(size) & (size > UNDERFLOW_LIMIT)
        falls = np.zeros(self.count, bool)
        falls[valid] = np.linalg.eigvalsh((A + A.swapaxes(1, 2))[valid] / 2)[:, 0] < -SOFTENING_TOLERANCE * size[valid]
        if not (law.internal or law.traits.varies):
            strain_change = e - e_old
            stress_change = response.stress - self.respond(e_old, e_old, memory, 0.0, 1.0).stress
            work_scale = np.linalg.norm(strain_change, axis=1) * np.linalg.norm(stress_change, axis=1)
            falls |= np.sum(strain_change * stress_change, axis=1) < -SOFTENING_TOLERANCE * work_scale
        return int(np.count_nonzero(falls))

    def set_homotopy(self, parameter: float) -> None:
        """Choose a law for homotopy continuation: `parameter` 0 selects the law itself, 1 an elastic law."""
        self.material.set_law(self.term.law.homotopy(parameter) if parameter else self.term.law)

    def set_time(self, t: float) -> None:
        """Set the law's parameters to their values at time `t`. Collective.

        Raises:
            InputError: parameters out of range on some rank; all ranks raise it.
        """
        if self.material.varies:
            joint_x = self.joint_x  # collective
            with errors_on_all(self.comm):
                self.material.set_parameters_at(joint_x, t)

    def tangent_at_rest(self) -> Array:
        """Return the tangents (points, m, m) before loading, for m Mandel components, with parameters of time 0.

        For laws that depend on strain rates, the rates are zero. If parameters vary in place or time, the method is
        collective. It then also sets them to their values at time 0, which hold until the next `set_time`.
        """
        zero = np.zeros((self.count, len(self.mandel)))
        self.set_time(0.0)
        return self.respond(zero, zero, self.rest(), LONG_TIME_STEP if self.term.law.traits.rate else 0.0, 1.0).tangent

    def _regularised(self, tangent: Array, relative_residual: float) -> Array:
        """Return the tangents (points, m, m) `tangent`, regularised if the law may have singular ones.

        Where a tangent differs from that before loading, a fraction of the latter is added. The fraction is
        `relative_residual`, within bounds.
        """
        if self._C_rest is None:
            return tangent
        factor = min(max(relative_residual, MIN_REGULARISATION), MAX_REGULARISATION)
        difference, size = (np.abs(a).max(axis=(1, 2), initial=0.0) for a in (tangent - self._C_rest, self._C_rest))
        return tangent + factor * self._C_rest * (difference > 1e-9 * size)[:, None, None]

    def rest(self) -> Array:
        """Return the internal variables (points, values) before the first step: zeros."""
        return np.zeros((self.count, self.material.memory_size))

    def forces(self, stress: Array) -> PETSc.Vec:
        """Return the nodal forces int stress : e(v) of stresses (points, m), m Mandel components `mandel`. Collective.

        The next call overwrites the vector.
        """
        weighted = _vector_of_rows(self.B, (stress * self.weights[:, None]).ravel())
        self.B.multTranspose(weighted, self._forces)
        weighted.destroy()
        return self._forces

    def stiffness(self, tangent: Array, relative_residual: float = 0.0, into: PETSc.Mat | None = None) -> PETSc.Mat:
        """Return the tangent matrix int e(v) : tangent : e(du) for Newton's method. Collective.

        If the law may have singular tangents (`Traits.singular`), a small multiple of the tangent before loading is
        added. It grows with the residual (Levenberg-Marquardt), and the equilibrium does not change. Without it the
        matrix is singular where the strains of cells above each other in the meshed layer are not unique.

        Args:
            tangent: (points, m, m) derivatives of the stress by the strain, for m Mandel components.
            relative_residual: norm of the last residual over the reference force.
            into: an earlier result, which is overwritten and whose nonzero pattern is used again; None: a new matrix.
        """
        return self._tangent_matrix(self._regularised(tangent, relative_residual), self.B, into)

    def _tangent_matrix(self, tangent: Array, B: PETSc.Mat, into: PETSc.Mat | None = None) -> PETSc.Mat:
        """Return the matrix of int e(v) : tangent : e(du) for strains e(u) that are `B` times u. Collective.

        Args:
            tangent: (points, m, m) derivatives of the stress by the strain, for m Mandel components.
            B: matrix from displacements to strains at the points, m rows for each point.
            into: an earlier result, which is overwritten; None: a new matrix.
        """
        D = self.point_matrix(tangent)
        A = D.ptap(B, result=into)
        D.destroy()
        return A

    def point_matrix(self, tangent: Array) -> PETSc.Mat:
        """Return the matrix of a block (m, m) for each point: a tangent (points, m, m) times the point's weight."""
        m, n_rows = len(self.mandel), self.count * len(self.mandel)
        row_start = self.B.getOwnershipRange()[0]
        indptr = np.arange(0, n_rows * m + 1, m, dtype=PETSc.IntType)
        column_blocks = np.arange(n_rows, dtype=PETSc.IntType).reshape(self.count, 1, m)
        indices = (row_start + np.broadcast_to(column_blocks, (self.count, m, m))).astype(PETSc.IntType).ravel()
        values = (tangent * self.weights[:, None, None]).ravel()
        return PETSc.Mat().createAIJ((self.B.getSizes()[0],) * 2, csr=(indptr, indices, values), comm=self.comm)

    def destroy(self) -> None:
        """Free the PETSc matrices and vectors."""
        destroy(self.B, self._strain, self._forces)


def _vector_of_rows(B: PETSc.Mat, values: Array) -> PETSc.Vec:
    """Return a vector with the numbers `values` of this rank, one for each row of a matrix."""
    out = B.createVecLeft()
    out.array[:] = values
    return out


class Projection:
    """L2 projection of strains or stresses at quadrature points on functions, in separate groups of points. Collective.

    A group has for instance the points of one cell, or of one column of cells. The projection is orthogonal in the
    product with quadrature weights. So a projected stress does the same work in strains as the stress in projected
    strains.

    Args:
        points: the quadrature points.
        bases: for each number q of points that groups have, two arrays. The first has the numbers (groups, q) of the
            points in each group. The second has the values (groups, q, k) there of k functions, which may be linearly
            dependent.
        P: (c, c) symmetric matrix P with P P = P for the first c Mandel components. Of a strain e, P e is projected
            and e - P e is unchanged.
    """

    def __init__(self, points: Quadrature, bases: Iterable[tuple[Array, Array]], P: Array) -> None:
        self._P, self._n_strains = np.pad(P, (0, len(MANDEL_PAIRS) - len(P))), len(points.mandel)
        self._correction = scipy.sparse.csr_matrix((points.count, points.count))
        for groups, basis in bases:
            root = np.sqrt(points.weights[groups])
            U, sigma, _ = np.linalg.svd(basis * root[..., None], full_matrices=False)
            U *= (sigma > INDEPENDENCE_TOLERANCE * sigma[:, :1])[:, None]
            change = (U @ U.swapaxes(1, 2)) * root[:, None, :] / root[:, :, None] - np.eye(root.shape[1])
            mask = np.abs(change) > INDEPENDENCE_TOLERANCE  # in tensor cells positions on S decouple
            ij = [np.broadcast_to(indices, change.shape)[mask] for indices in (groups[:, :, None], groups[:, None])]
            self._correction += scipy.sparse.csr_matrix((change[mask], ij), self._correction.shape)

    def __call__(self, values: Array) -> Array:
        """Return the projection (points, m) of strains or stresses `values` (points, m), as m Mandel components."""
        m = values.shape[1]
        return np.asarray(values + self._correction @ values @ self._P[:m, :m])

    def projected_matrix(self, B: PETSc.Mat) -> PETSc.Mat:
        """Return the matrix from displacements to projected strains, m rows for each point. Collective.

        Args:
            B: matrix from displacements to strains, m rows for each point.
        """
        P, n_rows, start = self._P[: self._n_strains, : self._n_strains], B.getLocalSize()[0], B.getOwnershipRange()[0]
        M = scipy.sparse.kron(self._correction, P, format="csr") + scipy.sparse.eye(n_rows, format="csr")
        csr = M.indptr.astype(PETSc.IntType), (start + M.indices).astype(PETSc.IntType), M.data
        A = PETSc.Mat().createAIJ((B.getSizes()[0], B.getSizes()[0]), csr=csr, comm=B.getComm())
        out = A.matMult(B)
        destroy(A)
        return out


class VolumeProjection(Projection):
    """Projection of the volume strains (traces) on polynomials in each cell, known as B-bar.

    It avoids volumetric locking: elements with too many independent volume strains resist isochoric deformation.
    Stiffnesses stay symmetric (Hughes 1980; Simo, Taylor and Pister 1985).

    Args:
        points: quadrature points in cells; the first components of their strains are 11, 22 and 33.
        degree: degree of the polynomials of the coordinates: 0, which gives means over cells, or 1.

    Raises:
        InputError: another degree, or quadrature points on facets.
    """

    def __init__(self, points: Quadrature, degree: int) -> None:
        if degree not in (0, 1) or points.region.dim < points.dim:
            raise InputError(f"volume is {degree!r}; allowed: 0 or 1, for a law of cells, or None")
        x = points.x[points.cells]
        basis = np.ones((*x.shape[:2], 1))
        if degree:
            centred = x - x.mean(axis=1, keepdims=True)
            size = np.abs(centred).max(axis=(1, 2), keepdims=True, initial=0)
            basis = np.concatenate([basis, centred / size], axis=2)
        super().__init__(points, [(points.cells, basis)], np.full((3, 3), 1 / 3))


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
