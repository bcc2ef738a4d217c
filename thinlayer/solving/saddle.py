"""Blocks of a tangent with pressures on S, [A B'; B -C], for PETSc's PCFIELDSPLIT.

The Schur complement of the pressures is -(C + B A^-1 B'). C has the compliance and the flow of the layer, and is assembled.
B A^-1 B' is what the sides of S yield to pressures: for waves of length l about l/E, with Young's modulus E of the bodies.
It is replaced by a multiple of the mass matrix of S: the compliance under waves as long as cells, 1'B D^-1 B'1 over 1'M 1
with the diagonal D of A, times the square root of the number of cells along S. That is the geometric mean of the
compliances from the shortest waves to the longest. Where bodies are stiff, or waves short, C is the larger one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from thinlayer.parts.part import DISPLACEMENTS
from thinlayer.solving.layout import Layout
from thinlayer.solving.linear_solvers import orthonormal


def split(
    pc: PETSc.PC,
    A: PETSc.Mat,
    layout: Layout,
    held: npt.NDArray[np.int32],
    masses: Mapping[str, PETSc.Mat],
    motions: Sequence[PETSc.Vec],
) -> None:
    """Tell a PCFIELDSPLIT its blocks "u", displacements, and "p", pressures, and the Schur complement. Collective.

    Args:
        pc: the preconditioner, which has read its options.
        A: the tangent, with supports, see `Equations.hold`.
        layout: of the unknowns: displacements and fields on S.
        held: held unknowns of this rank.
        masses: key of a field on S -> its mass matrix.
        motions: rigid motions: their displacements, or also further unknowns.
    """
    first, last = A.getOwnershipRange()
    n, bs = layout.sizes[DISPLACEMENTS], layout.fields[DISPLACEMENTS].function_space.dofmap.index_map_bs
    of_u = PETSc.IS().createStride(n, first, 1, comm=A.comm)
    of_u.setBlockSize(bs)
    of_p = PETSc.IS().createStride(last - first - n, first + n, 1, comm=A.comm)
    modes = [PETSc.Vec().createWithArray(v.array_r[:n].copy(), (n, None), bsize=bs, comm=A.comm) for v in motions]
    of_u.compose("nearnullspace", PETSc.NullSpace().create(vectors=orthonormal(modes), comm=A.comm))
    pc.setFieldSplitIS(("u", of_u), ("p", of_p))
    schur = A.createSubMatrix(of_p, of_p)
    added = _compliance(A, layout, held, masses)
    schur.axpy(-1.0, added, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    pc.setFieldSplitSchurPreType(PETSc.PC.FieldSplitSchurPreType.USER, schur)
    for thing in (added, schur, of_u, of_p):
        thing.destroy()


def _compliance(
    A: PETSc.Mat, layout: Layout, held: npt.NDArray[np.int32], masses: Mapping[str, PETSc.Mat]
) -> PETSc.Mat:
    """Multiples of the mass matrices that stand for B A^-1 B', without rows and columns of held unknowns."""
    diagonal, ones, forces, free = A.getDiagonal(), layout.vector(), layout.vector(), layout.vector()
    free.set(1.0)
    free.array[held] = 0.0
    scaled = []
    for key, M in masses.items():
        ones.set(0.0)
        layout.split(ones.array)[key][:] = layout.split(free.array_r)[key]
        A.mult(ones, forces)
        f, d = (layout.split(v.array_r)[DISPLACEMENTS] for v in (forces, diagonal))
        yielding = layout.comm.allreduce(float((f**2 / np.abs(d)).sum()))
        mine = M.copy()
        mask = M.createVecRight()
        mask.array[:] = layout.split(free.array_r)[key]
        mine.diagonalScale(mask, mask)
        mask.array[:] = layout.split(ones.array_r)[key]
        image = M.createVecLeft()
        M.mult(mask, image)
        space = layout.fields[key].function_space
        along = M.getSize()[0] ** (1 / space.mesh.topology.dim)
        mine.scale(math.sqrt(along) * yielding / image.dot(mask))
        scaled.append(mine)
        mask.destroy()
        image.destroy()
    rows = [[one if k == i else None for k, one in enumerate(scaled)] for i in range(len(scaled))]
    nest = PETSc.Mat().createNest(rows, comm=A.comm)
    whole = nest.convert("aij", PETSc.Mat())
    for thing in (nest, *scaled, diagonal, ones, forces, free):
        thing.destroy()
    return whole
