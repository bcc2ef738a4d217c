"""Constraints: displacements u = T y that satisfy supports and multi-point constraints, with new unknowns y."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
import scipy.sparse
from mpi4py import MPI
from petsc4py import PETSc
from scipy.sparse.csgraph import connected_components

from forms.base import Array, InputError
from geometry.refusals import place_text as at_place
from geometry.topology import IntArray, sum_by_number
from thinlayer.discretisation.supports import RELATIVE_LENGTH_TOLERANCE, SupportConditions
from thinlayer.errors import make_module_getattr
from thinlayer.system.ranks import destroy

CsrMatrix: TypeAlias = scipy.sparse.csr_matrix
INDEPENDENCE_TOLERANCE = 1e-6  # least singular value of independent conditions
# largest difference of two values of one displacement, over the largest prescribed displacement
AGREEMENT_TOLERANCE = 1e-9
COEFFICIENT_TOLERANCE = 1e-13  # coefficient of a condition that counts as rounding; coefficients are of order 1


@dataclass(frozen=True)
class MultiPointConstraint:
    """Multi-point constraint u = R q: displacements u, called slaves, follow a few motions q, as on a rigid plate.

    Attributes:
        key: name of the constraint in messages.
        motion_names: names of the m motions in messages.
        R: (n, m) sparse matrix, for the n displacements of this rank and m motions q, which are lengths. Only rows of
            slaves have entries.
        motion: index of each prescribed motion -> function of the time that returns its value, a length.
        resultant: function of the time that returns the prescribed forces (m,) that do work in motions. They are
            zero for motions that are prescribed.
    """

    key: str
    motion_names: Sequence[str]
    R: CsrMatrix
    motion: Mapping[int, Callable[[float], float]]
    resultant: Callable[[float], Array]

    @property
    def n_motions(self) -> int:
        """Number m of motions."""
        return int(self.R.shape[1])


@dataclass(frozen=True)
class _ConditionGroup:
    """Group of r conditions N y = c that involve the same k unknowns y.

    Attributes:
        rows: (r,) indices of the conditions among the grouped conditions of all ranks.
        columns: (k,) global numbers of the unknowns.
        N: (r, k) coefficients of the conditions.
        basis: (k, k) orthonormal basis of the unknowns, as columns. The conditions determine the components of y along
            the first `rank` columns, and leave those along the others free.
        rank: rank of N.
    """

    rows: np.ndarray
    columns: np.ndarray
    N: Array
    basis: Array
    rank: int

    @cached_property
    def pseudo_inverse(self) -> Array:
        """Matrix (rank, r) from right-hand sides c (r,) to the components of y that the conditions determine."""
        return np.asarray(np.linalg.pinv(self.N @ self.basis[:, : self.rank], rcond=INDEPENDENCE_TOLERANCE))

    def residual(self, c: Array) -> Array:
        """Return |N y - c| (r,) for right-hand sides c (r,) and the y that fits all conditions best.

        It is not zero where conditions contradict each other.
        """
        return np.asarray(np.abs(self.N @ self.basis[:, : self.rank] @ (self.pseudo_inverse @ c) - c))

    @cached_property
    def force_map(self) -> Array:
        """Matrix (r, k) from forces on the k unknowns to the forces of the r conditions that balance them.

        If several forces of the conditions do so, the matrix gives those of least norm.
        """
        return np.asarray(np.linalg.pinv(self.N.T, rcond=INDEPENDENCE_TOLERANCE))


class Constraints:
    """Supports and multi-point constraints of a model, as a map u = T y from unknowns to displacements.

    All methods are collective.

    Multi-point constraints give u = T0 y. The unknowns y are the displacements, but some entries have another meaning.
    The motions q of each constraint (the masters) take the entries of its first slaves. The entries of its other slaves
    are zero.

    Supports A u = c become conditions A T0 y = c. Prescribed motions are conditions on y too. Conditions that share
    unknowns form a group. Its orthonormal basis Q separates the combinations of unknowns that are constrained from
    those that are free: y = Q z and T = T0 Q. The final unknowns are z; methods call them y. T is None if it is the
    identity, for example if each condition constrains a single displacement.

    Args:
        prescribed: conditions of supports, at nodes.
        mpcs: the multi-point constraints.

    Attributes:
        bc_dofs: (h,) local numbers, increasing, of the h constrained unknowns of this rank, those at slaves included.

    Raises:
        InputError: two multi-point constraints share a node; one has fewer displacements than motions; conditions with
            constant values contradict each other.
    """

    def __init__(self, prescribed: SupportConditions, mpcs: Sequence[MultiPointConstraint] = ()) -> None:
        self.prescribed, self.mpcs = prescribed, list(mpcs)
        self.comm: MPI.Intracomm = prescribed.comm
        self.d, self.n = prescribed.d, prescribed.size
        self.row_start, self._n_global = int(self.comm.scan(self.n) - self.n), int(self.comm.allreduce(self.n))
        self.slaves = self._find_slaves()
        self.masters = {mpc.key: self._masters_of(mpc) for mpc in self.mpcs}
        self._all_masters = np.concatenate([np.empty(0, np.int64), *self.masters.values()])
        self._T0 = self._mpc_matrix()
        self._condition_matrix = self._assemble_conditions()
        self._group_conditions()
        self.Q = self._basis_matrix()
        T, Q = self._T0, self.Q
        self.T = Q or T if T is None or Q is None else T.matMult(Q)
        if not (prescribed.varies or self.comm.allreduce(len(self._motions))):
            self._require_agreement(self._condition_values(0.0))

    # ---------------------------------------------------------------- slaves and masters
    def _find_slaves(self) -> IntArray:
        """Return the local numbers of the displacements that are slaves of a multi-point constraint.

        Raises:
            InputError: two multi-point constraints have a common slave.
        """
        by_mpc = [np.flatnonzero(np.diff(mpc.R.indptr)) for mpc in self.mpcs]
        slaves, counts = np.unique(np.concatenate([np.empty(0, np.int64), *by_mpc]), return_counts=True)
        names = [mpc.key for mpc, its in zip(self.mpcs, by_mpc, strict=True) if np.isin(its, slaves[counts > 1]).any()]
        if conflicts := [keys for keys in self.comm.allgather(names) if keys]:
            reason = f"{' and '.join(conflicts[0])} share a node: their motions would not be independent"
            raise InputError(f"{reason}; make them one, or give them facets without common nodes")
        return slaves

    def _masters_of(self, mpc: MultiPointConstraint) -> np.ndarray:
        """Return the global numbers (m,) of the unknowns that hold the m motions of a multi-point constraint.

        They are the numbers of its first slaves.

        Raises:
            InputError: the constraint has fewer slaves than motions.
        """
        slave_numbers = self.row_start + np.flatnonzero(np.diff(mpc.R.indptr))
        masters = np.sort(np.concatenate(self.comm.allgather(slave_numbers[: mpc.n_motions])))[: mpc.n_motions]
        if len(masters) < mpc.n_motions:
            reason = f"{mpc.key} has fewer displacements than its {mpc.n_motions} motions"
            raise InputError(f"{reason}; give it more facets, or use finer cells")
        return masters

    def _mpc_matrix(self) -> PETSc.Mat | None:
        """Return the matrix T0 from unknowns y, which include motions, to displacements u; None for the identity."""
        if not self.comm.allreduce(len(self.slaves) + len(self.mpcs)):
            return None
        free = np.setdiff1d(np.arange(self.n), self.slaves)
        blocks = [(self.masters[mpc.key], mpc.R.tocoo()) for mpc in self.mpcs]
        entries = [(R.row, masters[R.col], R.data) for masters, R in blocks]
        return self._square_matrix((free, self.row_start + free, np.ones(len(free))), *entries)

    def _square_matrix(self, *entries: tuple[np.ndarray, np.ndarray, Array]) -> PETSc.Mat:
        """Make a square PETSc matrix over all unknowns from lists of entries, which add up.

        Each list has the local rows, the global columns and the values of its entries. The diagonal is stored even
        where it is zero, as matrix products need it.
        """
        diagonal = np.arange(self.n), self.row_start + np.arange(self.n), np.zeros(self.n)
        i, j, v = map(np.concatenate, zip(*entries, diagonal, strict=True))
        A = scipy.sparse.csr_matrix((v, (i.astype(np.int64), j.astype(np.int64))), (self.n, self._n_global))
        return create_aij(A, self.comm, ((self.n, None), (self.n, None)))

    # ---------------------------------------------------------------- conditions
    def _assemble_conditions(self) -> CsrMatrix:
        """Return the coefficients (r, N) of this rank's r conditions on all N unknowns of the model.

        Conditions of supports come first. Conditions of prescribed motions follow; rank 0 has all of these.
        """
        rows = self.prescribed.condition_rows
        csr_arrays = rows.data, self.row_start + rows.indices, rows.indptr  # unknowns that are displacements
        conditions = scipy.sparse.csr_matrix(csr_arrays, (rows.shape[0], self._n_global))
        if self._T0 is not None:
            A = create_aij(conditions, self.comm, ((rows.shape[0], None), (self.n, None)))
            reduced = A.matMult(self._T0)
            conditions = local_csr(reduced)
            destroy(A, reduced)
        self._motions = [(mpc, k, value) for mpc in self.mpcs for k, value in mpc.motion.items() if self.comm.rank == 0]
        columns = [self.masters[mpc.key][k] for mpc, k, _ in self._motions]
        k = len(columns)
        motion_rows = scipy.sparse.csr_matrix((np.ones(k), (np.arange(k), columns)), (k, self._n_global))
        conditions = scipy.sparse.vstack([conditions, motion_rows], format="csr")
        conditions.data[np.abs(conditions.data) < COEFFICIENT_TOLERANCE] = 0.0
        conditions.eliminate_zeros()
        return conditions

    def support_works(self, forces: Array, motions: Callable[[IntArray], Array]) -> Array:
        """Return the work (s, k) of the forces of s supports in k motions, from the conditions of this rank alone.

        Args:
            forces: (r,) forces of this rank's r conditions, see `support_forces`.
            motions: function of local numbers (n,) of displacements that returns their values (n, k) in the k motions.
        """
        works = forces[:, None] * self._values_along_conditions(motions)
        return sum_by_number(self.prescribed.entry, works, len(self.prescribed.supports.entries) + 1)[:-1]

    def _condition_values(self, t: float) -> Array:
        """Return the prescribed values (r,) of this rank's r conditions at the time t, as in `_condition_matrix`."""
        return np.concatenate([self.prescribed.values_at(t), [value(t) for _, _, value in self._motions]])

    # ---------------------------------------------------------------- constrained unknowns
    def _group_conditions(self) -> None:
        """Divide the conditions into groups that share no unknowns, and set `bc_dofs`.

        A condition is in no group if it involves a single unknown, which no other condition involves. All ranks have
        all groups.
        """
        A, counts = self._condition_matrix, np.diff(self._condition_matrix.indptr)
        foreign = np.ones(len(A.indices), bool)
        foreign[self._select_owned(A.indices)[0]] = False
        columns, column_counts = np.unique(A.indices, return_counts=True)
        shared_unknowns = np.concatenate([A.indices[foreign | (counts > 1).repeat(counts)], columns[column_counts > 1]])
        shared_by_rank = self.comm.allgather(np.unique(np.concatenate([shared_unknowns, self._all_masters])))
        is_single = counts == 1
        is_single[is_single] = ~np.isin(A.indices[A.indptr[:-1][is_single]], np.concatenate(shared_by_rank))
        self._single_rows, self._grouped_rows = np.flatnonzero(is_single), np.flatnonzero(~is_single & (counts > 0))
        starts = A.indptr[self._single_rows]
        self._single_dofs, self._single_coefficients = A.indices[starts] - self.row_start, A.data[starts]
        self._groups = _group_rows(scipy.sparse.vstack(self.comm.allgather(A[self._grouped_rows]), format="csr"))
        fixed = np.concatenate([self._single_dofs, *(self._select_owned(g.columns[: g.rank])[1] for g in self._groups)])
        self.bc_dofs = np.union1d(fixed, np.setdiff1d(self.slaves, self._all_masters - self.row_start)).astype(np.int32)

    def _basis_matrix(self) -> PETSc.Mat | None:
        """Return the matrix Q of y = Q z, from the final unknowns z to the unknowns y; None for the identity.

        It contains the orthonormal bases of the groups of conditions.
        """
        rotated = [group for group in self._groups if not np.array_equal(group.basis, np.eye(len(group.columns)))]
        if not rotated:
            return None
        entries = [(np.arange(self.n), self.row_start + np.arange(self.n), np.ones(self.n))]
        for group in rotated:
            indices, local_numbers = self._select_owned(group.columns)
            rows, columns = np.meshgrid(local_numbers, group.columns, indexing="ij")
            difference = (group.basis - np.eye(len(group.columns)))[indices]  # to the identity
            entries.append((rows.ravel(), columns.ravel(), difference.ravel()))
        return self._square_matrix(*entries)

    def _select_owned(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Select from global numbers of unknowns, `columns`, those that this rank owns.

        Returns:
            Their indices in `columns`, and their local numbers.
        """
        indices = np.flatnonzero((columns >= self.row_start) & (columns < self.row_start + self.n))
        return indices, columns[indices] - self.row_start

    def _set_entries(self, y: Array, columns: np.ndarray, values: Array) -> None:
        """Set the entries of `y` (n,) with the global numbers `columns` to `values`; skip entries of other ranks."""
        indices, local_numbers = self._select_owned(columns)
        y[local_numbers] = values[indices]

    # ---------------------------------------------------------------- values
    def bc_values(self, t: float) -> Array:
        """Return the values (h,) of the h constrained unknowns `bc_dofs` at the time t. Collective.

        Raises:
            InputError: two conditions prescribe different values of a displacement, or a value is not finite.
        """
        c = self._condition_values(t)
        if self.comm.allreduce(int(not np.isfinite(c).all())):
            raise InputError(f"a prescribed displacement is not finite at t = {t:g}")
        self._require_agreement(c, when=f" at t = {t:g}")
        y = np.zeros(self.n)
        y[self._single_dofs] = c[self._single_rows] / self._single_coefficients
        for group, values in self._values_by_group(c):
            self._set_entries(y, group.columns[: group.rank], group.pseudo_inverse @ values)
        return y[self.bc_dofs]

    def _values_by_group(self, c: Array) -> list[tuple[_ConditionGroup, Array]]:
        """Return each group of conditions with the prescribed values of its conditions.

        `c` (r,) are the prescribed values of this rank's conditions.
        """
        all_values = np.concatenate(self.comm.allgather(c[self._grouped_rows]))
        return [(group, all_values[group.rows]) for group in self._groups]

    def _ungroup(self, of_groups: Sequence[Array]) -> Array:
        """Return one number for each of this rank's r conditions (r,), from numbers by group; 0 outside all groups.

        `of_groups` has an array for each group, with a number for each of its conditions.
        """
        out, every = np.zeros(self._condition_matrix.shape[0]), np.zeros(sum(len(group.rows) for group in self._groups))
        for group, numbers in zip(self._groups, of_groups, strict=True):
            every[group.rows] = numbers
        end = int(self.comm.scan(len(self._grouped_rows)))
        out[self._grouped_rows] = every[end - len(self._grouped_rows) : end]
        return out

    def _require_agreement(self, c: Array, when: str = "") -> None:
        """Raise InputError if prescribed values `c` (r,) of this rank's r conditions contradict each other.

        `when` are words with the time, which end the message.
        """
        residuals = self._ungroup([group.residual(values) for group, values in self._values_by_group(c)])
        largest = self.comm.allreduce(float(np.abs(c).max(initial=0.0)), max)
        limit, message = max(AGREEMENT_TOLERANCE * largest, RELATIVE_LENGTH_TOLERANCE * self.prescribed.extent), ""
        if residuals.max(initial=0.0) > limit:
            message = self._contradiction_text(int(residuals.argmax()), c) + when
        if messages := [text for text in self.comm.allgather(message) if text]:
            raise InputError(f"{messages[0]}; where supports overlap, their values must agree")

    def _contradiction_text(self, row: int, c: Array) -> str:
        """Return a message about this rank's condition number `row` and the conditions on the same unknowns.

        `c` (r,) are the prescribed values of this rank's conditions.
        """
        rows, columns = self._condition_matrix.nonzero()
        touched = np.unique(rows[np.isin(columns, self._condition_matrix[row].indices)])
        point = self.prescribed.point_of_condition(int(touched[0])) if touched[0] < len(self.prescribed.entry) else None
        place_text = f" at {at_place(point)}" if point is not None else ""
        texts = dict.fromkeys(self._condition_text(int(k), c[k]) for k in touched)
        return f"contradictory supports{place_text}: " + " and ".join(texts)

    def _condition_text(self, row: int, value: float) -> str:
        if row < len(self.prescribed.entry):
            return self.prescribed.condition_text(row, value)
        mpc, k, _ = self._motions[row - len(self.prescribed.entry)]
        return f"the {mpc.key} prescribes {mpc.motion_names[k]} = {value:.6g}"

    # ---------------------------------------------------------------- displacements and forces
    def displacements(self, y: Array) -> Array:
        """Return this rank's displacements u = T y (n,) from its unknowns y (n,)."""
        return self._multiply(self.T, y)

    def unknowns(self, u: Array) -> Array:
        """Return the unknowns y (n,) of displacements u (n,).

        The motions q of a multi-point constraint u = R q are among the unknowns. If u violates the constraint, they are
        those that fit u by least squares.
        """
        y = u.copy()
        y[self.slaves] = 0.0
        for mpc in self.mpcs:
            self._set_entries(y, self.masters[mpc.key], self.fit_motions(mpc, u))
        return self._multiply(self.Q, y, transposed=True)

    def forces_on_y(self, f: Array) -> Array:
        """Return the forces T^T f (n,) on this rank's unknowns y from nodal forces f (n,) on its displacements."""
        return self._multiply(self.T, f, transposed=True)

    def _multiply(self, matrix: PETSc.Mat | None, values: Array, *, transposed: bool = False) -> Array:
        if matrix is None:
            return values
        x, b = matrix.createVecs()
        x, b = (b, x) if transposed else (x, b)
        x.array[:] = values
        (matrix.multTranspose if transposed else matrix.mult)(x, b)
        product = b.array_r.copy()
        destroy(x, b)
        return np.asarray(product)

    def fit_motions(self, mpc: MultiPointConstraint, u: Array) -> Array:
        """Return the motions (m,) of a multi-point constraint that fit displacements u (n,) by least squares.

        The result is the same on every rank.
        """
        return self._least_squares(mpc, self.comm.allreduce(mpc.R.T @ u))

    def loads_at(self, t: float) -> Array:
        """Return nodal forces (n,) with the resultants that the multi-point constraints prescribe at the time `t`.

        Of all such forces they have the least norm.
        """
        return sum((mpc.R @ self._least_squares(mpc, mpc.resultant(t)) for mpc in self.mpcs), np.zeros(self.n))

    def _least_squares(self, mpc: MultiPointConstraint, b: Array) -> Array:
        """Return the solution x (m,) of R^T R x = b (m,), with the R of a multi-point constraint on all ranks."""
        return np.asarray(np.linalg.lstsq(self.comm.allreduce((mpc.R.T @ mpc.R).toarray()), b, rcond=None)[0])

    # ---------------------------------------------------------------- reactions
    def support_forces(self, r: Array) -> Array:
        """Return the forces (k,) of this rank's k support conditions that balance nodal forces r (n,).

        Each is a component along the direction of its condition. If several forces balance r, they are those of least
        norm.
        """
        f = self._multiply(self._T0, r, transposed=True)
        columns = np.concatenate([np.empty(0, np.int64), *(group.columns for group in self._groups)])
        indices, local_numbers = self._select_owned(columns)
        forces = np.zeros(len(columns))
        forces[indices] = f[local_numbers]
        by_group = np.split(self.comm.allreduce(forces), np.cumsum([len(group.columns) for group in self._groups]))
        out = self._ungroup([group.force_map @ part for group, part in zip(self._groups, by_group, strict=False)])
        out[self._single_rows] = f[self._single_dofs] / self._single_coefficients
        return out[: len(self.prescribed.entry)]

    def _translation_motions(self, indices: Sequence[int], direction: Array) -> dict[str, Array]:
        """Return the motions (m,) of each multi-point constraint, by key, in a unit translation along `direction` (d,).

        They are zero for constraints that are not in `indices`. These are indices that count all supports first, and
        then the multi-point constraints.
        """
        n_supports, shift = len(self.prescribed.supports.entries), np.tile(direction, self.n // self.d)
        return {mpc.key: self.fit_motions(mpc, shift) * (n_supports + k in indices) for k, mpc in enumerate(self.mpcs)}

    def prescribed_resultant(self, indices: Sequence[int], direction: Array, t: float) -> float:
        """Return the component along a direction of the prescribed forces on chosen multi-point constraints.

        Args:
            indices: chosen indices of `Model.held_places`: supports come first and the constraints follow. Supports
                have no prescribed forces and add nothing.
            direction: (d,) unit vector of the direction.
            t: the time of the forces.
        """
        motions = self._translation_motions(indices, direction)
        return float(sum(motions[mpc.key] @ mpc.resultant(t) for mpc in self.mpcs))

    def resultant_weights(self, indices: Sequence[int], direction: Array) -> Array:
        """Return weights g (n,) of forces on the unknowns that give the reaction of chosen supports along a direction.

        For nodal forces r on the displacements the reaction is g . T^T r plus `prescribed_resultant`.

        Args:
            indices: chosen indices of `Model.held_places`: supports come first and multi-point constraints follow.
            direction: (d,) unit vector of the direction.
        """
        prescribed, motions = self.prescribed, self._translation_motions(indices, direction)
        along = np.isin(prescribed.entry, indices) * (prescribed.directions @ direction)
        along = np.append(along, [motions[mpc.key][k] for mpc, k, _ in self._motions])
        g = np.zeros(self.n)
        for mpc in self.mpcs:  # motions that are not prescribed: the forces that balance their resultants
            self._set_entries(g, self.masters[mpc.key], motions[mpc.key])
        g[self._single_dofs] = along[self._single_rows] / self._single_coefficients
        for group, values in self._values_by_group(along):
            self._set_entries(g, group.columns, group.force_map.T @ values)
        return self._multiply(self.Q, g, transposed=True)

    # ---------------------------------------------------------------- motions
    def project_motions(self, motions: CsrMatrix) -> tuple[CsrMatrix, CsrMatrix]:
        """Return motions that satisfy the constraints, made from given ones, and how far the given ones violate them.

        Motions of the multi-point constraints are added to the c given ones. Then the constrained unknowns are set to
        zero in all of these motions.

        Args:
            motions: (n, c) sparse matrix of the given motions, for the n displacements of this rank.

        Returns:
            The displacements (n, c + m) of the motions that satisfy the constraints; m is the number of added motions.
            And a Gram matrix (c + m, c + m). Entry (i, j) is the scalar product of the violations of all constraints by
            motions i and j, before unknowns are set to zero. Its quadratic form is zero for a combination of motions
            that satisfies all constraints.
        """
        c, m = motions.shape[1], sum(mpc.n_motions for mpc in self.mpcs)
        starts = dict(zip(self.masters, np.cumsum([0, *(mpc.n_motions for mpc in self.mpcs)]).tolist(), strict=False))
        indices, local_numbers = self._select_owned(self._all_masters)
        selection = scipy.sparse.csr_matrix((np.ones(len(indices)), (local_numbers, indices)), (self.n, m))
        y = scipy.sparse.hstack([_with_zero_rows(motions, self.slaves), selection], format="csr")
        padded = scipy.sparse.hstack([motions, scipy.sparse.csr_matrix((self.n, m))], format="csr")
        diagonal = np.zeros(c + m)
        diagonal[[c + starts[mpc.key] + k for mpc, k, _ in self._motions]] = 1.0
        gram = scipy.sparse.diags(diagonal, format="csr")
        for rows in (self.prescribed.condition_rows @ padded, (distributed_product(self._T0, y) - padded)[self.slaves]):
            gram = gram + rows.T @ rows
        z = _with_zero_rows(distributed_product(self.Q, y, transposed=True), self.bc_dofs)
        return distributed_product(self.T, z), self.comm.allreduce(gram)

    def violation_gram(self, motions: Callable[[IntArray], Array]) -> Array:
        """Return how far c motions violate the constraints: the scalar products (c, c) of their violations.

        The motions of multi-point constraints adapt so that the violations are least; a Schur complement eliminates
        them.

        Args:
            motions: function of local numbers (n,) of displacements that returns their values (n, c) in the c motions.
        """
        if self._T0 is None:
            rows = self._values_along_conditions(motions)
            return np.asarray(self.comm.allreduce(rows.T @ rows))
        values = motions(np.arange(self.n))
        c, gram = values.shape[1], self.project_motions(scipy.sparse.csr_matrix(values))[1].toarray()
        return np.asarray(gram[:c, :c] - gram[:c, c:] @ np.linalg.pinv(gram[c:, c:]) @ gram[c:, :c])

    def _values_along_conditions(self, motions: Callable[[IntArray], Array]) -> Array:
        """Return the displacements (r, k) in k motions along the directions of this rank's r support conditions.

        Args:
            motions: function of local numbers (n,) of displacements that returns their values (n, k) in the k motions.
        """
        dofs = np.unique(self.prescribed.condition_rows.indices)
        return np.asarray(self.prescribed.condition_rows[:, dofs] @ motions(dofs))


def distributed_product(matrix: PETSc.Mat | None, columns: CsrMatrix, *, transposed: bool = False) -> CsrMatrix:
    """Return this rank's rows of the product of a PETSc matrix with distributed sparse columns.

    Args:
        matrix: the matrix; None: the identity.
        columns: (n, c) the n rows of the c columns that this rank has.
        transposed: whether to multiply by the transpose of the matrix instead.
    """
    if matrix is None:
        return columns
    column_matrix = create_aij(columns, matrix.comm, ((columns.shape[0], None), (None, columns.shape[1])))
    product = matrix.transposeMatMult(column_matrix) if transposed else matrix.matMult(column_matrix)
    local_rows = local_csr(product)
    destroy(column_matrix, product)
    return local_rows


def _with_zero_rows(A: CsrMatrix, rows: np.ndarray) -> CsrMatrix:
    """Return a copy of A with zeros in the rows with the numbers `rows`, and with the same sparsity pattern."""
    row_factors = np.ones(A.shape[0])
    row_factors[rows] = 0.0
    return scipy.sparse.csr_matrix((A.data * row_factors.repeat(np.diff(A.indptr)), A.indices, A.indptr), A.shape)


def _group_rows(A: CsrMatrix) -> list[_ConditionGroup]:
    """Group the conditions that share unknowns, directly or through other conditions.

    The rows of `A` are the conditions, and its columns are the unknowns.
    """
    columns, local_columns = np.unique(A.indices, return_inverse=True)
    if not len(columns):
        return []
    B = scipy.sparse.csr_matrix((A.data, local_columns, A.indptr), (A.shape[0], len(columns)))
    labels = connected_components(scipy.sparse.bmat([[None, B], [B.T, None]]), directed=False)[1]
    row_labels, column_labels = labels[: A.shape[0]], labels[A.shape[0] :]
    groups = []
    for r, c in zip(_rows_by_label(row_labels), _rows_by_label(column_labels), strict=True):
        N = B[r][:, c].toarray()
        _, sigma, right_vectors = np.linalg.svd(N)
        rank = int((sigma > INDEPENDENCE_TOLERANCE * max(1.0, sigma[0])).sum())
        basis = np.eye(len(c)) if rank == len(c) else right_vectors.T
        groups.append(_ConditionGroup(r, columns[c].astype(np.int64), N, basis, rank))
    return groups


def _rows_by_label(labels: np.ndarray) -> list[np.ndarray]:
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)


def create_aij(A: CsrMatrix, comm: MPI.Intracomm, sizes: object = None) -> PETSc.Mat:
    """Make a PETSc matrix of which this rank has the rows `A` (CSR).

    Args:
        A: rows of this rank, with global column numbers.
        comm: MPI communicator of the matrix.
        sizes: ((local rows, all rows), (local columns, all columns)). PETSc computes sizes that are None. By default A
            is the whole matrix, on a communicator of one rank.
    """
    csr = (*(array.astype(PETSc.IntType, copy=False) for array in (A.indptr, A.indices)), A.data)
    return PETSc.Mat().createAIJ(sizes or A.shape, csr=csr, comm=comm)


def local_csr(A: PETSc.Mat) -> CsrMatrix:
    """Return the rows of a PETSc matrix that this rank owns, as a CSR matrix."""
    indptr, columns, entries = A.getValuesCSR()
    return scipy.sparse.csr_matrix((entries, columns, indptr), (A.getLocalSize()[0], A.getSize()[1]))


__getattr__ = make_module_getattr(__name__, {"Tied": MultiPointConstraint})
