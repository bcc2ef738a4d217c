"""Static condensation of the bodies' stiffness to the displacements in contact, by MUMPS, on one rank."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.sparse
from petsc4py import PETSc
from scipy import linalg
from scipy.sparse.csgraph import connected_components

from forms.base import Array
from geometry.topology import BoolArray, Indices, IntArray
from thinlayer.errors import SolveError
from thinlayer.solving.linear_solvers import LOW_RANK_OPTIONS
from thinlayer.solving.petsc import PREFIX, OptionDict, schur_complement, set_defaults, set_schur_unknowns
from thinlayer.system.compilation import c_pointers, load_own_library
from thinlayer.system.ranks import destroy

CsrRows = tuple[Indices, Indices, Array]  # row starts, columns and entries of a sparse matrix
C_SOURCE = Path(__file__).with_name("triangle.c")
MAX_GROUP_UNKNOWNS = 100  # about the number of kept unknowns of pieces that are factorised together
FRONT_SLOPE = 1.2  # slope, relative to S, of the front along which nodes are numbered
BAND_CELL_LAYERS = 4.0  # thickness of the bands in which that front moves, in layers of cells
N_SAMPLE_NODES = 64  # number of nodes whose edges show the diagonals of the cells
MAX_SPARSE_FRACTION = 0.05  # largest share of non-zeros of a right-hand side that is treated as sparse
# minimum degree, as with a Schur complement MUMPS offers only this and METIS; no scaling, which changes nothing here
MUMPS_OPTIONS = OptionDict(LOW_RANK_OPTIONS, mat_mumps_icntl_7=0, mat_mumps_icntl_8=0)
SMALL_PIECE_NODES = 1000  # number of nodes of pieces below which MUMPS underestimates its workspace
SMALL_PIECE_OPTIONS = OptionDict(mat_mumps_icntl_14=200)  # additional workspace in per cent


class Condensation:
    """Static condensation of a stiffness matrix: its Schur complement on some unknowns, the kept ones.

    With many bodies, a few connected pieces of the bodies are factorised at a time. The constructor reads the PETSc
    options -thinlayer_mat_mumps_NAME.

    Args:
        A: symmetric stiffness of N nodes without supports, as row starts, columns and entries (CSR). Each two coupled
            nodes have a full block (d, d) of entries, in d dimensions.
        is_fixed: (N d,) mask of constrained unknowns. Of their rows and columns only the diagonal entry is used.
        kept: (c,) numbers of the kept unknowns, ascending.
        x: (N, d) coordinates of the nodes.
        normal: (d,) mean normal of S, of any length.
        n_bodies: number of bodies. Up to two are factorised together.

    Attributes:
        stiffness: (c, c) condensed stiffness. It is a dense array if all pieces are factorised together, else sparse.

    Raises:
        SolveError: MUMPS failed, for instance because the stiffness is not positive definite.
    """

    stiffness: Array | scipy.sparse.csr_matrix

    def __init__(self, A: CsrRows, is_fixed: BoolArray, kept: IntArray, x: Array, normal: Array, n_bodies: int) -> None:
        d = x.shape[1]
        order = oblique_order(x - x[kept // d].mean(axis=0), normal, A)
        group_of = np.zeros(len(x), np.int32)  # of nodes
        if n_bodies > 2:
            n_pieces, piece_of = connected_components(scipy.sparse.csr_matrix(A[::-1]), directed=False)
            group_of = (np.cumsum(np.bincount(piece_of[kept], minlength=n_pieces)) // MAX_GROUP_UNKNOWNS)[piece_of[::d]]
        self._kept, self._positions, self._factors = kept, list[IntArray](), list[SchurFactor]()
        for k in np.unique(group_of):
            self._positions.append(np.flatnonzero(group_of[kept // d] == k))
            self._factors.append(SchurFactor(A, is_fixed, d, order[group_of[order] == k], kept[self._positions[-1]]))
        self.stiffness = self._factors[0].complement
        if len(self._positions) > 1:
            factors = [scipy.sparse.csr_matrix(factor.complement) for factor in self._factors]
            complements = scipy.sparse.block_diag(factors, format="csr")
            complements.eliminate_zeros()  # zeros between pieces
            inverse_order = np.argsort(np.concatenate(self._positions))
            self.stiffness = complements[inverse_order][:, inverse_order]

    def condense(self, b: Array) -> Array:
        """Return the forces (c,) on the kept unknowns that are equivalent to forces `b` (N d,) on all unknowns."""
        out = np.empty(len(self._kept))
        for positions, factor in zip(self._positions, self._factors, strict=True):
            out[positions] = factor.condense(b)
        return out

    def expand(self, b: Array, kept_values: Array, out: Array) -> None:
        """Compute all unknowns under given forces from the values of the kept unknowns, and write them into `out`.

        Args:
            b: (N d,) forces on all unknowns, as in the last call of `condense`.
            kept_values: (c,) values of the kept unknowns.
            out: (N d,) all unknowns; overwritten.
        """
        out[self._kept] = kept_values
        for factor in self._factors:
            factor.expand(b, out)

    def close(self) -> None:
        """Free the factors."""
        for factor in self._factors:
            factor.close()


def oblique_order(x: Array, normal: Array, A: CsrRows) -> IntArray:
    """Return an order of the nodes in which MUMPS factorises the stiffness quickly.

    The order sorts nodes by their side of S, then by bands parallel to S. Within a band they are numbered along a front
    that is oblique to S, as the diagonals of the cells are. Bands keep neighbours close in memory.

    MUMPS chooses its order by minimum degree when it computes a Schur complement, and takes nodes of equal degree by
    their numbers. On grids an unsuited numbering doubles its work. With this order its work is little more than with
    the best order for a factorisation without a Schur complement.

    Args:
        x: (N, d) coordinates of the nodes, relative to the centre of S.
        normal: (d,) mean normal of S, of any length.
        A: row starts, columns and entries (CSR) of the stiffness, in blocks (d, d) of nodes.

    Returns:
        Numbers (N,) of the nodes in this order.
    """
    indptr, indices, d = *A[:2], x.shape[1]
    sample_nodes = np.linspace(0, len(x) - 1, min(len(x), N_SAMPLE_NODES)).astype(int)
    edges = np.concatenate([x[indices[indptr[r * d] : indptr[r * d + 1] : d] // d] - x[r] for r in sample_nodes])
    length, default_normal = np.linalg.norm(normal), np.eye(len(normal))[-1]
    normal = normal / length if length > 0 else default_normal
    height = x @ normal
    front_key = FRONT_SLOPE * np.abs(height)
    for tangent in linalg.null_space(normal[None]).T:
        diagonal_sign = np.sign((edges @ tangent) @ (edges @ normal)) or 1.0
        front_key += diagonal_sign * np.sign(height) * (x @ tangent)
    band_thickness = BAND_CELL_LAYERS * np.abs(edges @ normal).max() or 1.0
    band_number = np.floor(np.abs(height) / band_thickness + 0.1)  # so that rounding splits no layer of a grid
    return np.asarray(np.lexsort((front_key, band_number, height < 0)))


class SchurFactor:
    """Factor of the stiffness of some connected pieces of the bodies, and its Schur complement on the kept unknowns.

    Springs at the kept unknowns make the factorised matrix definite, also for pieces without supports. They are
    subtracted again from the complement.

    Args:
        A: row starts, columns and entries (CSR) of the stiffness of all bodies, without supports.
        is_fixed: mask of the constrained unknowns of all bodies. Of their rows and columns only the diagonal entry is
            used.
        d: number of dimensions, which is the number of unknowns of a node.
        nodes: (n,) numbers of the nodes of these pieces, in the order in which MUMPS gets them.
        kept: (c,) numbers of the kept unknowns of these pieces.

    Attributes:
        complement: (c, c) Schur complement on the kept unknowns, without the springs.
    """

    def __init__(self, A: CsrRows, is_fixed: BoolArray, d: int, nodes: IntArray, kept: IntArray) -> None:
        self._unknowns = (nodes[:, None] * d + np.arange(d)).ravel()
        position = np.full(len(A[0]) - 1, -1, np.int32)
        position[self._unknowns] = np.arange(len(self._unknowns))
        self._all_kept, self._local_kept = kept, position[kept]
        row_starts, columns, entries = _upper_triangle(A, is_fixed, d, nodes)
        diagonal_indices = row_starts[self._local_kept]  # the first entry of a row is its diagonal
        self._springs = entries[diagonal_indices] / max(len(kept), 1)
        entries[diagonal_indices] += self._springs
        csr = row_starts.astype(PETSc.IntType, copy=False), columns.astype(PETSc.IntType, copy=False), entries
        upper = PETSc.Mat().createAIJWithArrays((len(self._unknowns),) * 2, csr, comm=PETSc.COMM_SELF)
        upper.setOption(PETSc.Mat.Option.SPD, True)
        self._pc = pc = PETSc.PC().create(PETSc.COMM_SELF)
        pc.setOptionsPrefix(PREFIX)
        pc.setOperators(upper)
        pc.setType("cholesky")
        pc.setFactorSolverType("mumps")
        with set_defaults(MUMPS_OPTIONS | (SMALL_PIECE_OPTIONS if len(nodes) < SMALL_PIECE_NODES else {})):
            pc.setFactorSetUpSolverType()
            self._factor = pc.getFactorMatrix()
            self._factor.setOptionsPrefix(PREFIX)
            if len(kept):
                set_schur_unknowns(self._factor, self._local_kept)
            pc.setUp()
        upper.destroy()
        infog = self._factor.getMumpsInfog(1)
        if infog < 0 or pc.getFailedReason():
            self.close()
            advice = "is every body supported, or does it meet S in more than a point?"
            raise SolveError(f"contact: MUMPS could not factorise the stiffness: INFOG(1) = {infog}", advice=advice)
        complement = schur_complement(self._factor, len(kept)) if len(kept) else np.empty((0, 0))
        self.complement = np.triu(complement)
        self.complement += np.triu(complement, 1).T
        self.complement[np.diag_indices(len(kept))] -= self._springs

    def _complement_forces(self, kept_values: Array) -> Array:
        """Return the Schur complement plus the springs, times the values `kept_values` (c,) of the kept unknowns."""
        return np.asarray(self.complement @ kept_values + self._springs * kept_values)

    def condense(self, b: Array) -> Array:
        """Return forces (c,) on the kept unknowns that are equivalent to forces on all unknowns of this factor.

        Args:
            b: forces on the unknowns of all bodies, also on those that this factor does not contain.
        """
        if not len(self._local_kept):
            return np.empty(0)
        self._factor.setMumpsIcntl(26, 1)  # solve for the kept unknowns only
        self._condensed = self._complement_forces(self._solve(b[self._unknowns])[self._local_kept])
        self._factor.setMumpsIcntl(26, -1)
        return self._condensed

    def expand(self, b: Array, out: Array) -> None:
        """Compute the unknowns of the factorised pieces, under given forces, from the values of the kept unknowns.

        Args:
            b: forces on the unknowns of all bodies, as in the last call of `condense`.
            out: unknowns of all bodies. The values of the kept unknowns are read from it. The other unknowns of the
                factorised pieces are overwritten.
        """
        forces, kept_values = b[self._unknowns], out[self._all_kept]
        if len(kept_values):
            forces[self._local_kept] += self._complement_forces(kept_values) - self._condensed
        out[self._unknowns] = self._solve(forces)
        out[self._all_kept] = kept_values  # a stiff layer would magnify their rounding

    def _solve(self, b: Array) -> Array:
        """Return the solution of the factorised system for the right-hand side `b`, by MUMPS.

        Both have the order of the factor's unknowns. A sparse `b` is passed in sparse form, which is faster.
        """
        nonzeros = np.flatnonzero(b)
        if not len(nonzeros):  # MUMPS fails for an empty sparse right-hand side
            return np.zeros_like(b)
        solution = np.empty((len(b), 1), order="F")
        X = PETSc.Mat().createDense(solution.shape, array=solution, comm=PETSc.COMM_SELF)
        if len(nonzeros) > MAX_SPARSE_FRACTION * len(b):
            B = PETSc.Mat().createDense(solution.shape, array=b[:, None], comm=PETSc.COMM_SELF)
            self._factor.matSolve(B, X)
        else:
            csr = np.array([0, len(nonzeros)], PETSc.IntType), nonzeros.astype(PETSc.IntType), b[nonzeros]
            row = PETSc.Mat().createAIJ((1, len(b)), csr=csr, comm=PETSc.COMM_SELF)
            B = PETSc.Mat().createTranspose(row)
            self._factor.matSolve(B, X)
            row.destroy()
        destroy(B, X)
        return solution[:, 0]

    def close(self) -> None:
        """Free the factor."""
        self._pc.destroy()


def _upper_triangle(A: CsrRows, is_fixed: BoolArray, d: int, nodes: IntArray) -> CsrRows:
    """Extract the stiffness of some nodes, renumbered in the order of `nodes`, as its upper triangle in CSR format.

    MUMPS reads only the upper triangle. The work is done in C: with 512 square cells it takes 0.05 s of a contact solve
    of 2.4 s, where scipy.sparse would take 0.3 s.

    Args:
        A: row starts, columns and entries (CSR) of the whole stiffness, in blocks (d, d) of nodes.
        is_fixed: mask of the constrained unknowns. Of their rows and columns only the diagonal entry is taken.
        d: number of dimensions.
        nodes: (n,) numbers of the nodes to extract.

    Raises:
        SolveError: the nonzero pattern is not symmetric, or not made of blocks.
    """
    indptr, indices, values = A
    n, row_lengths = len(nodes), np.diff(indptr)[nodes * d]
    n_entries = (d * int(row_lengths.sum()) + n * d) // 2
    position = np.full((len(indptr) - 1) // d, -1, np.int32)
    position[nodes] = np.arange(n, dtype=np.int32)
    row_starts, columns, entries = np.empty(n * d + 1, np.int32), np.empty(n_entries, np.int32), np.empty(n_entries)
    c = load_own_library(C_SOURCE)
    indptr, indices, order = (a.astype(np.int32, copy=False) for a in (indptr, indices, nodes))
    arrays = c_pointers(c, indptr, indices, values, is_fixed, position, order, row_starts, columns, entries)
    if c.lib.upper_triangle(n, d, n_entries, *arrays) != n_entries:
        text = "contact: the nonzero pattern of the stiffness is not symmetric, or not made of blocks of nodes"
        raise SolveError(text, advice="use method='newton'")
    return row_starts, columns, entries
