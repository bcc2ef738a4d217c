"""Uniqueness: a solution is undetermined if neither supports nor the layer resist a rigid motion of a body."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse
from petsc4py import PETSc
from scipy.sparse.csgraph import connected_components

from geometry.topology import IntArray
from thinlayer.discretisation.loads import AXES
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.rigid import rigid_motions
from thinlayer.errors import SolveError

# Largest eigenvalue of a motion that supports allow, relative to the largest one, of the Gram matrix of the motions at
# supports.
ALLOWED_MOTION = 1e-10
# Least stiffness against a rigid motion, relative to that of the bodies. Rounding of the forces moves a body by eps over
# this ratio, relative to the displacements: here by a thousandth.
RESISTED_MOTION = 1e3 * np.finfo(float).eps

Array = npt.NDArray[np.float64]


def pieces(model: Model) -> tuple[IntArray, int]:
    """The number of each cell's connected piece (cells,), and the number of pieces.

    Cells that share a node are connected, unless they lie on different sides of S there.
    """
    joint = model.domain.joint
    nodes = joint.cells * 3 + (joint.side + 1)[:, None] if model.broken else joint.cells * 3
    links: list[tuple[Any, Any]] = [(nodes[:, :1].repeat(nodes.shape[1] - 1, axis=1).ravel(), nodes[:, 1:].ravel())]
    if model.broken and len(joint.bonded):
        at = np.unique(joint.table.vertices[joint.bonded]) * 3
        links += [(at, at + 1), (at, at + 2)]
    first, second = (np.concatenate(ends) for ends in zip(*links, strict=True))
    size = 3 * len(joint.points)
    graph = scipy.sparse.coo_matrix((np.ones(len(first)), (first, second)), shape=(size, size))
    found = connected_components(graph, directed=False)[1][nodes[:, 0]]
    names, number = np.unique(found, return_inverse=True)
    return number, len(names)


class RigidMotions:
    """The rigid motions of a model's connected pieces that its supports allow. All methods are collective.

    Args:
        model: the model.
        held: displacements of this rank that supports prescribe (local, unrolled).
        stiffness: norm of the diagonal of the stiffness matrix.
    """

    def __init__(self, model: Model, held: npt.NDArray[np.int32], stiffness: float) -> None:
        self.model, self.held, self._stiffness = model, held, stiffness

    @cached_property
    def _free(self) -> tuple[Array, Array]:
        """Motions that supports allow (displacements of this rank, m), and their shares of each piece's motions (m, k)."""
        motions = self._motions()
        at_supports = motions[self.held]
        gram = self.model.comm.allreduce(at_supports.T @ at_supports)
        values, vectors = np.linalg.eigh(gram)
        allowed = vectors[:, values <= ALLOWED_MOTION * max(values[-1], 1.0)]
        free = motions @ allowed
        free[self.held] = 0.0
        return free, allowed.T

    def _motions(self) -> Array:
        """Translations and rotations of each piece at the displacements of this rank; they are of the order of 1."""
        model, joint = self.model, self.model.domain.joint
        V = model.V
        number, count = pieces(model)
        self._names = [joint.regions[joint.region[int((number == k).argmax())]] for k in range(count)]
        owned, bs = V.dofmap.index_map.size_local, V.dofmap.index_map_bs
        of = np.zeros(owned + V.dofmap.index_map.num_ghosts, np.int32)
        dofs = np.asarray(V.dofmap.list)
        of[dofs] = model.domain.on_cells(number)[: len(dofs), None]
        of = of[:owned]
        rigid = [f.x.array[: owned * bs].reshape(owned, bs) for f in rigid_motions(V, joint).values()]
        motions = np.zeros((count, len(rigid), owned, bs))
        for k in range(count):
            here = of == k
            for out, motion in zip(motions[k], rigid, strict=True):
                np.copyto(out, motion, where=here[:, None])
        return motions.reshape(count * len(rigid), owned * bs).T

    def require_resisted(self, A: PETSc.Mat) -> None:
        """Raise SolveError if a tangent, with or without supports, does not resist a motion that supports allow."""
        free, shares = self._free
        if not len(shares):
            return
        v, f = A.createVecs()
        v.set(0.0)
        forces = np.empty_like(free)
        for k, motion in enumerate(free.T):
            v.array[: len(motion)] = motion
            A.mult(v, f)
            forces[:, k] = f.array_r[: len(motion)]
        v.destroy()
        f.destroy()
        _, sizes, rows = np.linalg.svd(self.model.comm.allreduce(free.T @ forces))
        if sizes[-1] > RESISTED_MOTION * self._stiffness or not np.isfinite(sizes[-1]):
            return
        raise SolveError(
            f"no unique solution: {self._described(rows[-1] @ shares)}, and neither supports nor the layer resist it "
            "(to rounding)",
            advice="add supports, or give the layer's law a stiffness in this direction",
        )

    def _described(self, motion: Array) -> str:
        """Words for the motion of the piece that moves most."""
        d = self.model.joint.dim
        of_pieces = motion.reshape(len(self._names), -1)
        k = int(np.abs(of_pieces).max(axis=1).argmax())
        shift, turn = of_pieces[k, :d], of_pieces[k, d:]
        if np.abs(turn).max() > np.abs(shift).max():
            pairs = [AXES[i] + AXES[j] for i in range(d) for j in range(i + 1, d)]
            return f"body {self._names[k]!r} can turn in the plane {pairs[int(np.abs(turn).argmax())]}"
        shift /= shift[np.abs(shift).argmax()]  # largest component 1, whichever sign the motion has
        direction = ", ".join(f"{c:.3g}" for c in np.round(shift, 6) + 0.0)
        return f"body {self._names[k]!r} can move along ({direction})"
