"""Uniqueness: a solution is undetermined if neither supports nor the layer resist a rigid motion of a body."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse
from petsc4py import PETSc

from geometry.errors import place
from thinlayer.discretisation.axis import AXES
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.rigid import rigid_motions
from thinlayer.errors import LooseBody

# Largest eigenvalue of a motion that supports allow, relative to the largest one, of the Gram matrix of the motions at
# supports.
ALLOWED_MOTION = 1e-10
# Least stiffness against a rigid motion, relative to that of the bodies. Rounding of the forces moves a body by eps over
# this ratio, relative to the displacements: here by a thousandth.
RESISTED_MOTION = 1e3 * np.finfo(float).eps

SEVERAL = 1e-6  # least singular value of motions of a piece that are independent of each other

Array = npt.NDArray[np.float64]
Sparse = Any  # scipy.sparse.csr_matrix, which has no types


def _of_pieces(motions: Array, piece: npt.NDArray[np.int32], pieces: int) -> Sparse:
    """Motions (n, per) of the pieces that displacements belong to as columns, one for each motion of each piece."""
    n, per = motions.shape
    columns = (piece[:, None] * per + np.arange(per)).ravel()
    return scipy.sparse.csr_matrix((motions.ravel(), columns, np.arange(n + 1) * per), (n, pieces * per))


class RigidMotions:
    """The rigid motions of a model's connected pieces that its supports allow. All methods are collective.

    Args:
        model: the model.
        stiffness: norm of the diagonal of the stiffness matrix.
    """

    def __init__(self, model: Model, stiffness: float) -> None:
        self.model, self._stiffness = model, stiffness

    @cached_property
    def _free(self) -> tuple[Sparse, Array]:
        """Motions (n, c), sparse: those of pieces in turn, then of plates, with those parts that supports prevent left out.

        The second value, (c, k), has the motions that supports allow, as sums of these.
        """
        motions, piece = self._motions()
        shown, gram = self.model.constraints.shown(_of_pieces(motions, piece, len(self._names)))
        values, vectors = np.linalg.eigh(gram)
        return shown, vectors[:, values <= ALLOWED_MOTION * max(values.max(), 1.0)]

    def _motions(self) -> tuple[Array, npt.NDArray[np.int32]]:
        """At each displacement of this rank, its translations and rotations (n, per), of order 1; its piece (n,)."""
        model, joint = self.model, self.model.domain.joint
        V, number = model.V, model.splitting.pieces
        _, first, cells = np.unique(number, return_index=True, return_counts=True)
        self._names = [joint.regions[joint.region[cell]] for cell in first]
        middles = joint.points[joint.corners].mean(axis=1)
        self._places = np.column_stack([np.bincount(number, along) / cells for along in middles.T])
        owned, bs = V.dofmap.index_map.size_local, V.dofmap.index_map_bs
        of = np.zeros(owned + V.dofmap.index_map.num_ghosts, np.int32)
        dofs = np.asarray(V.dofmap.list)
        of[dofs] = model.domain.on_cells(number)[: len(dofs), None]
        rigid = [f.x.array[: owned * bs] for f in rigid_motions(V, joint, model.kinematics).values()]
        self._per = len(rigid)
        return np.column_stack(rigid), of[:owned].repeat(bs)

    def require_resisted(self, A: PETSc.Mat, unbalanced: PETSc.Vec | None = None) -> None:
        """Raise LooseBody if a tangent, with or without supports, does not resist a motion that supports allow.

        Args:
            A: the tangent.
            unbalanced: forces that nothing balances, whose direction the error tells; None: any motion that is free.
        """
        motions, allowed = self._free
        if not allowed.shape[1]:
            return
        rows = A.getLocalSize()[0]  # displacements, then further unknowns
        starts = motions.indptr[np.minimum(np.arange(rows + 1), motions.shape[0])]
        csr = starts.astype(PETSc.IntType), motions.indices.astype(PETSc.IntType), motions.data
        rigid = PETSc.Mat().createAIJ(((rows, None), (None, len(allowed))), csr=csr, comm=self.model.comm)
        product = A.ptap(rigid)
        first, last = product.getOwnershipRange()
        begins, columns, values = product.getValuesCSR()
        stiffness = np.zeros(product.getSize())
        stiffness[np.repeat(np.arange(first, last), np.diff(begins)), columns] = values
        product.destroy()
        rigid.destroy()
        _, sizes, ways = np.linalg.svd(allowed.T @ self.model.comm.allreduce(stiffness) @ allowed)
        if sizes[-1] > RESISTED_MOTION * self._stiffness or not np.isfinite(sizes[-1]):
            return
        least = np.flatnonzero(sizes <= max(RESISTED_MOTION * self._stiffness, sizes[-1]))
        free = allowed @ ways[least].T
        if unbalanced is not None:
            free = self._led(free, unbalanced)
        motion = self._described(free)
        raise LooseBody(
            f"no unique solution: {motion}, and neither supports nor the layer resist it (to rounding)",
            motion,
            advice="add supports, or give the layer's law a stiffness in this direction",
        )

    def _led(self, free: Array, forces: PETSc.Vec) -> Array:
        """Free motions (pieces times per, k), and as a further one that to which forces on the displacements lead."""
        motions, _ = self._free
        along = motions.T @ forces.array_r[: motions.shape[0]]
        led = free @ (free.T @ self.model.comm.allreduce(along))
        size = float(np.linalg.norm(led))
        return np.column_stack([free, led / size]) if size else free

    def _described(self, motions: Array) -> str:
        """Words for the motions (pieces times per, k) of the piece that moves most in the last one."""
        d = self.model.joint.dim
        of_plates = len(motions) - len(self._names) * (self._per)
        motions = motions[: len(motions) - of_plates]
        each = motions.reshape(len(self._names), -1, motions.shape[1])
        of_pieces = each[..., -1]
        k = int(np.abs(of_pieces).max(axis=1).argmax())
        axes, shift = [*self.model.kinematics.translations(d)], np.zeros(d)
        shift[axes], turn = of_pieces[k, : len(axes)], of_pieces[k, len(axes) :]
        where = f" at {place(self._places[k])}" if self._names.count(self._names[k]) > 1 else ""
        body = f"body {self._names[k]!r}{where}"
        if self.model.kinematics.turns and np.linalg.matrix_rank(each[k], tol=SEVERAL) == len(each[k]):
            return f"{body} can move and turn freely"
        if np.abs(turn).max(initial=0.0) > np.abs(shift).max():
            if self.model.joint.periods:
                return f"{body} can turn about the period"
            pairs = [AXES[i] + AXES[j] for i in range(d) for j in range(i + 1, d)]
            return f"{body} can turn in the plane {pairs[int(np.abs(turn).argmax())]}"
        shift /= shift[np.abs(shift).argmax()]  # largest component 1, whichever sign the motion has
        direction = ", ".join(f"{c:.3g}" for c in np.round(shift, 6) + 0.0)
        return f"{body} can move along ({direction})"
