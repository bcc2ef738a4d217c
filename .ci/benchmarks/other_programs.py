"""Two blocks with springs on S in NGSolve and in scikit-fem, which are not dependencies; for benchmarks."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import spsolve

from forms.base import Array
from geometry.topology import IntArray
from studies.by_hand import LMBDA, MU, TwoBlocks
from studies.timing import Stages

MODULES = {"NGSolve": "ngsolve", "scikit-fem": "skfem"}
RESIDUAL = 1e-10  # relative residual of conjugate gradients


def ngsolve(n: int, dim: int) -> dict[str, float]:
    """Solve `TwoBlocks` on one thread: sparse Cholesky in 2D, conjugate gradients in 3D; return `Stages.measured`."""
    ngs, netgen = import_module("ngsolve"), import_module("netgen.meshing")
    ngs.SetNumThreads(1)
    stages, blocks, raw = Stages(), TwoBlocks(n, dim), netgen.Mesh(dim=dim)
    raw.AddPoints(np.pad(blocks.points, ((0, 0), (0, 3 - dim))))
    if dim == 2:
        raw.Add(netgen.FaceDescriptor(surfnr=1, domin=1, bc=1))
    raw.AddElements(dim=dim, index=1, data=blocks.cells.astype(np.int32), base=0)
    mesh = ngs.Mesh(raw)
    stages.end("mesh")
    V = ngs.VectorH1(mesh, order=1)
    (u, v), a, w = V.TnT(), ngs.BilinearForm(V, symmetric=True), ngs.GridFunction(V)
    strain, tested = ngs.Sym(ngs.grad(u)), ngs.Sym(ngs.grad(v))
    a += (LMBDA * ngs.Trace(strain) * ngs.Trace(tested) + 2 * MU * ngs.InnerProduct(strain, tested)) * ngs.dx
    a.Assemble()
    entries: Iterable[IntArray | Array] = blocks.spring_entries(np.arange(V.ndof).reshape(dim, -1).T)
    if dim == 2:  # the factorisation takes one matrix
        entries = map(np.concatenate, zip(a.mat.COO(), entries, strict=True))
    A = ngs.la.SparseMatrixd.CreateFromCOO(*entries, V.ndof, V.ndof)
    b, free = w.vec.CreateVector(), ngs.BitArray((~blocks.is_fixed).T.ravel().tolist())
    b.FV().NumPy()[:] = blocks.load.T.ravel()
    stages.end("model")
    if dim == 2:
        w.vec.data = A.Inverse(free, inverse="sparsecholesky") * b
    else:  # its algebraic multigrid, BDDC and Gauss-Seidel take longer than Jacobi's preconditioner
        A = a.mat + A
        w.vec.data = ngs.CGSolver(A, a.mat.CreateSmoother(free), tol=RESIDUAL, maxiter=10_000) * b
    stages.end("solve")
    return stages.measured(ngs.InnerProduct(w.vec, A * w.vec) / 2, V.ndof, dim)


def scikit_fem(n: int, dim: int) -> dict[str, float]:
    """Solve `TwoBlocks` by scipy's factorisation; return `Stages.measured`."""
    fem, elasticity = import_module("skfem"), import_module("skfem.models.elasticity")
    stages, blocks = Stages(), TwoBlocks(n, dim)
    kind, element = (fem.MeshTri, fem.ElementTriP1()) if dim == 2 else (fem.MeshTet, fem.ElementTetP1())
    mesh = kind(blocks.points.T.copy(), blocks.cells.T.copy())
    stages.end("mesh")
    basis = fem.Basis(mesh, fem.ElementVector(element))
    K, numbers = elasticity.linear_elasticity(LMBDA, MU).assemble(basis), basis.nodal_dofs.T
    rows, columns, values = blocks.spring_entries(numbers)
    A = K + scipy.sparse.csr_matrix((values, (rows, columns)), K.shape)
    u, b = np.zeros(basis.N), np.zeros(basis.N)
    b[numbers], free = blocks.load, numbers[~blocks.is_fixed]
    stages.end("model")
    u[free] = spsolve(A[free][:, free].tocsc(), b[free], permc_spec="MMD_AT_PLUS_A")
    stages.end("solve")
    return stages.measured(u @ (A @ u) / 2, basis.N, dim)
