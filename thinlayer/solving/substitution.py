"""Other unknowns in place of displacements: along inclined supports, motions of rigid plates, none that follow others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from thinlayer.discretisation.followers import Followers
from thinlayer.errors import ModelError
from thinlayer.parts.part import DISPLACEMENTS
from thinlayer.solving.layout import Layout

Array = npt.NDArray[np.float64]
Sparse = Any  # scipy.sparse.csr_matrix, which has no types


class Substitution:
    """Displacements u = C (Q y + sum of R q), for unknowns y and some parts' own unknowns q. All methods are collective.

    y are as many as u: at a node that follows a plate u = R q, and y, zero there, is held. C is the identity but for
    displacements that are means of others (`Followers`), where y is zero and held, too. With T = [[C Q, C R], [0, 1]]
    the residual is T^t f and the tangent T^t A T, so that what is conjugate to q are the resultants of the forces.

    Args:
        layout: the unknowns.
        frames: Q of this rank, sparse and orthogonal; None: the identity.
        ties: key of a part -> R (n, k) of this rank, k being the number of the part's own unknowns on all ranks, which
            every rank knows.
        followers: displacements that follow others; None: C is the identity.
    """

    def __init__(
        self, layout: Layout, frames: Sparse | None, ties: Mapping[str, Sparse], followers: Followers | None = None
    ) -> None:
        self.comm, self._layout, self.ties = layout.comm, layout, dict(ties)
        self.following = np.empty(0, np.int64) if followers is None else followers.rows
        self._n = layout.sizes[DISPLACEMENTS]
        self.Q = scipy.sparse.identity(self._n, format="csr") if frames is None else frames
        self._require_apart()
        self._C = None if followers is None else self._followed_matrix(followers, {DISPLACEMENTS: self._n})
        self._T = self._matrix()
        if followers is not None:
            C, T = self._followed_matrix(followers, layout.sizes), self._T
            self._T = C.matMult(T)
            C.destroy()
            T.destroy()
        self._product: PETSc.Mat | None = None

    def _require_apart(self) -> None:
        """Raise ModelError if a displacement follows two parts."""
        of = {key: np.diff(R.indptr) > 0 for key, R in self.ties.items()}
        both = sum((one.astype(int) for one in of.values()), np.zeros(self._n, int)) > 1
        names = [key for key, one in of.items() if (one & both).any()]
        if found := [one for one in self.comm.allgather(names) if one]:
            raise ModelError(
                f"{' and '.join(found[0])} have a node in common: their motions would depend on each other"
            )

    @property
    def tied(self) -> npt.NDArray[np.int32]:
        """Displacements of this rank that follow a part's own unknowns, or other displacements."""
        rows = [np.flatnonzero(np.diff(R.indptr)) for R in self.ties.values()]
        return np.unique(np.concatenate([self.following, *rows])).astype(np.int32)

    @property
    def own_sizes(self) -> dict[str, int]:
        """Key of a part -> number of its own unknowns on this rank, in their order."""
        return dict(list(self._layout.sizes.items())[1:])

    def own(self, key: str) -> Array:
        """All own unknowns of a part, on every rank, as they were written last."""
        return np.asarray(self._layout.fields[key].x.array[: self.ties[key].shape[1]])

    def put(self, u: fem.Function) -> None:
        """Turn u, which has y, into displacements."""
        values = self.Q @ u.x.array[: self._n]
        for key, R in self.ties.items():
            values += R @ self.own(key)
        u.x.array[: self._n] = values
        self._follow(u.x.array[: self._n])
        u.x.scatter_forward()

    def start(self, values: Mapping[str, Array]) -> None:
        """Turn displacements, in `values` beside the parts' own unknowns, into y."""
        u = values[DISPLACEMENTS].copy()
        for key, R in self.ties.items():
            u -= R @ self._everywhere(values[key])
        values[DISPLACEMENTS][:] = self.Q.T @ u
        values[DISPLACEMENTS][self.following] = 0.0

    def _follow(self, u: Array) -> None:
        """Let displacements of this rank follow others."""
        if self._C is not None:
            x, y = self._C.createVecs()
            x.array[:] = u
            self._C.mult(x, y)
            u[:] = y.array_r
            x.destroy()
            y.destroy()

    def passed_on(self, f: Array) -> Array:
        """Nodal forces C^t f of this rank: those on displacements that follow others go to these."""
        if self._C is None:
            return f
        x, y = self._C.createVecs()
        y.array[:] = f
        self._C.multTranspose(y, x)
        found = x.array_r.copy()
        x.destroy()
        y.destroy()
        return np.asarray(found)

    def _everywhere(self, own: Array) -> Array:
        return np.concatenate(self.comm.allgather(own))

    def forces(self, rows: Mapping[str, Array]) -> None:
        """Turn nodal forces f, and the parts' own residuals, into T^t f."""
        f = self.passed_on(rows[DISPLACEMENTS].copy())
        rows[DISPLACEMENTS][:] = self.Q.T @ f
        for key, R in self.ties.items():
            total = np.asarray(self.comm.allreduce(R.T @ f))
            if len(rows[key]):
                rows[key][:] += total

    def tangent(self, A: PETSc.Mat) -> PETSc.Mat:
        """T^t A T; each call fills the same matrix."""
        if self._product is None:
            self._product = A.ptap(self._T)
            self._product.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        else:
            A.ptap(self._T, result=self._product)
        return self._product

    def _matrix(self) -> PETSc.Mat:
        """T on all unknowns."""
        layout, n = self._layout, self._n
        size = sum(layout.sizes.values())
        rows = [self.Q.tocoo().row, np.arange(n, size)]
        columns = [layout.rows(self.Q.tocoo().col), layout.rows(np.arange(n, size, dtype=np.int32))]
        values = [self.Q.tocoo().data, np.ones(size - n)]
        offset = n
        for key, own in list(layout.sizes.items())[1:]:
            if key in self.ties:
                R = self.ties[key].tocoo()
                numbers = self._everywhere(layout.rows(np.arange(offset, offset + own, dtype=np.int32)))
                rows.append(R.row)
                columns.append(numbers[R.col])
                values.append(R.data)
            offset += own
        i, j, v = np.concatenate(rows), np.concatenate(columns).astype(PETSc.IntType), np.concatenate(values)
        return self._assembled(i, j, v, size)

    def _assembled(self, i: Any, j: Any, v: Array, size: int) -> PETSc.Mat:
        """A square matrix with values v in rows i of this rank and columns j of all."""
        order = np.lexsort((j, i))
        starts = np.searchsorted(i[order], np.arange(size + 1)).astype(PETSc.IntType)
        return PETSc.Mat().createAIJ(((size, None), (size, None)), csr=(starts, j[order], v[order]), comm=self.comm)

    def _followed_matrix(self, followers: Followers, sizes: Mapping[str, int]) -> PETSc.Mat:
        """C on unknowns of these sizes, of which the displacements are the first ones of each rank."""
        size, n = sum(sizes.values()), self._n
        counts = np.array(self.comm.allgather((n, size)))
        first_u, first = (np.cumsum(column) - column for column in counts.T)
        rank = np.searchsorted(first_u, followers.of, side="right") - 1
        of = followers.of - first_u[rank] + first[rank]
        every, own = np.arange(size), np.ones(size)
        own[followers.rows] = 0.0  # stored, as products need diagonal entries
        i = np.concatenate([every, followers.rows.repeat(of.shape[1])])
        j = np.concatenate([every + first[self.comm.rank], of.ravel()]).astype(PETSc.IntType)
        return self._assembled(i, j, np.concatenate([own, followers.shares.ravel()]), size)

    def followed(self, motion: Array) -> dict[str, Array]:
        """Own unknowns of parts for which the displacements that follow them are nearest to those of a motion (n,)."""
        found = {}
        for key, R in self.ties.items():
            matrix = self.comm.allreduce(np.asarray((R.T @ R).todense()), MPI.SUM)
            found[key] = np.linalg.lstsq(matrix, self.comm.allreduce(R.T @ motion), rcond=None)[0]
        return found

    def destroy(self) -> None:
        """Free the matrices."""
        for matrix in (self._T, self._C, self._product):
            if matrix is not None:
                matrix.destroy()
