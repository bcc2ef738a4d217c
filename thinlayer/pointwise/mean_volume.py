"""Mean volume strains (B-bar): the trace of strains, projected in each cell onto polynomials of a low degree."""

from __future__ import annotations

import numpy as np
import scipy.sparse
from petsc4py import PETSc

from thinlayer.errors import ModelError
from thinlayer.pointwise.quadrature import DIAGONAL, Array, Quadrature


class MeanVolume:
    """The projection, in L2 with the term's weights, of the traces of strains in each cell.

    Elements whose volume strains are more than their displacements can keep at zero resist flow that keeps volumes. With
    these strains projected they do not, and stiffnesses stay symmetric (Hughes 1980; Simo, Taylor and Pister 1985). The
    projection is orthogonal: a stress does the same work in projected strains as the stress with its mean part projected
    does in the others.

    Args:
        points: the quadrature points of a term over cells; its slots start with 11, 22 and 33.
        degree: of the polynomials of the coordinates: 0, means over cells, or 1.

    Raises:
        ModelError: another degree, or a term that is not over cells.
    """

    def __init__(self, points: Quadrature, degree: int) -> None:
        if degree not in (0, 1) or points.region.dim < points.dim:
            raise ModelError(f"volume is {degree!r}; allowed: 0 or 1, for a law of cells, or None")
        self._cells, self._width = points.cells, len(points.slots)
        x, root = points.x[points.cells], np.sqrt(points.weights[points.cells])
        basis = np.ones((*root.shape, 1))
        if degree:
            centred = x - x.mean(axis=1, keepdims=True)
            basis = np.concatenate(
                [basis, centred / np.abs(centred).max(axis=(1, 2), keepdims=True, initial=0)], axis=2
            )
        U = np.linalg.svd(basis * root[..., None], full_matrices=False)[0]
        self._change = (U @ U.swapaxes(1, 2)) * root[:, None, :] / root[:, :, None] - np.eye(root.shape[1])

    def projected(self, values: Array) -> Array:
        """Strains or stresses (points, m) with their traces projected."""
        out, here = values.copy(), values[self._cells][..., : len(DIAGONAL)].sum(axis=2)
        change = np.einsum("cpq,cq->cp", self._change, here) / len(DIAGONAL)
        out[self._cells[..., None], np.arange(len(DIAGONAL))] += change[..., None]
        return out

    def matrix(self, B: PETSc.Mat) -> PETSc.Mat:
        """The matrix of projected strains (m rows a point) for that of strains, which is destroyed. Collective."""
        rows = self._cells[..., None] * self._width + np.arange(len(DIAGONAL))  # (cells, points, 3)
        shape = (*rows.shape, *rows.shape[1:])
        change = np.broadcast_to(self._change[:, :, None, :, None] / len(DIAGONAL), shape)
        at = [np.broadcast_to(one, shape).ravel() for one in (rows[:, :, :, None, None], rows[:, None, None, :, :])]
        (own, _), (first, _) = B.getSizes()[0], B.getOwnershipRange()
        M = scipy.sparse.csr_matrix((change.ravel(), at), (own, own)) + scipy.sparse.eye(own, format="csr")
        csr = M.indptr.astype(PETSc.IntType), (first + M.indices).astype(PETSc.IntType), M.data
        A = PETSc.Mat().createAIJ((B.getSizes()[0], B.getSizes()[0]), csr=csr, comm=B.getComm())
        out = A.matMult(B)
        for one in (A, B):
            one.destroy()
        return out
