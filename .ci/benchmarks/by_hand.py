"""A script in plain DOLFINx, as a careful user would write it, for two blocks with springs on S; for benchmarks."""

from __future__ import annotations

from functools import cached_property

import basix.ufl
import dolfinx.mesh
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.fem.petsc import apply_lifting, assemble_matrix, assemble_vector, set_bc
from mpi4py import MPI
from petsc4py import PETSc

from forms.base import Array, require
from geometry.shapes.boxes import BoxGrid
from geometry.topology import IntArray
from studies.timing import Stages

E, NU = 100.0, 0.3  # of the blocks, MPa
LMBDA, MU = E * NU / (1 + NU) / (1 - 2 * NU), E / 2 / (1 + NU)
K_T, K_N = 40.0, 140.0  # stiffnesses of S, MPa/mm
LOAD = (0.5, 1.0, 0.0)  # on the top, MPa
CHOLESKY = {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps", "mat_mumps_icntl_7": 2}
LEVELS = {"mg_levels_pc_type": "jacobi", "pc_gamg_threshold": 0.01}
MULTIGRID = {"ksp_type": "cg", "ksp_rtol": 1e-10, "pc_type": "gamg", **LEVELS}


class TwoBlocks:
    """Arrays of two blocks, 1 wide and 0.5 high each, on a grid of simplices with duplicated nodes on S.

    Args:
        n: even number of cells along each side.
        dim: 2 or 3.

    Raises:
        InputError: n is odd.

    Attributes:
        points: (nodes, dim) coordinates.
        cells: (cells, dim + 1) nodes of the cells.
        springs: (facets, 2 dim) nodes of each facet of S, of the lower block and then of the upper one.
        jump: (2 dim^2, 2 dim^2) stiffness that the springs of one facet add, node by node.
    """

    def __init__(self, n: int, dim: int) -> None:
        require(n % 2 == 0, "n", n, "S lies between cells: take an even number")
        x = np.linspace(0.0, 1.0, n + 1)
        axes = x, x[: n // 2 + 1] - 0.5, *[x] * (dim - 2)
        grid = BoxGrid(axes, "triangle" if dim == 2 else "tetrahedron")
        below, low, top = grid.points, grid.facets_at(1, 0), grid.facets_at(1, -1)
        self.points = np.concatenate([below, below + 0.5 * (np.arange(dim) == 1)])
        self.cells = np.concatenate([grid.cells, grid.cells + len(below)])
        self._top = top + len(below)
        self.springs = np.column_stack([top, low + len(below)])
        self._area = n ** (1 - dim) / (dim - 1)
        mass = self._area * (np.ones((dim, dim)) + np.eye(dim)) / dim / (dim + 1)
        K = np.diag(np.where(np.arange(dim) == 1, K_N, K_T))
        self.jump = np.kron([[1, -1], [-1, 1]], np.kron(mass, K))

    @cached_property
    def is_fixed(self) -> npt.NDArray[np.bool_]:
        """Mask (nodes, dim) of displacements that are zero: all components at the bottom, the first at the sides."""
        at_sides = np.isclose(self.points[:, 0] * (1 - self.points[:, 0]), 0.0)
        return np.isclose(self.points[:, 1], -0.5)[:, None] | np.outer(at_sides, np.arange(self.points.shape[1]) == 0)

    @cached_property
    def load(self) -> npt.NDArray[np.float64]:
        """Nodal forces (nodes, dim)."""
        forces, dim = np.zeros_like(self.points), self.points.shape[1]
        np.add.at(forces, self._top, np.array(LOAD[:dim]) * self._area / dim)
        return forces

    def spring_entries(self, numbers: IntArray) -> tuple[IntArray, IntArray, Array]:
        """Rows, columns and values of the springs' stiffness; `numbers` (nodes, dim): numbers of displacements."""
        at = numbers[self.springs].reshape(len(self.springs), -1)
        rows, columns = np.repeat(at, at.shape[1], axis=1), np.tile(at, at.shape[1])
        return rows.ravel(), columns.ravel(), np.tile(self.jump.ravel(), len(at))


def by_hand(n: int, dim: int, options: dict[str, object]) -> dict[str, float]:
    """Solve `TwoBlocks` with PETSc options of the linear solver; return `Stages.measured`."""
    stages, blocks = Stages(), TwoBlocks(n, dim)
    element = basix.ufl.element("Lagrange", "triangle" if dim == 2 else "tetrahedron", 1, shape=(dim,))
    mesh = dolfinx.mesh.create_mesh(comm=MPI.COMM_SELF, cells=blocks.cells, e=element, x=blocks.points)
    stages.end("mesh")

    V = fem.functionspace(mesh, element)
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    mesh.topology.create_connectivity(dim - 1, dim)
    top = dolfinx.mesh.locate_entities_boundary(mesh, dim - 1, lambda x: np.isclose(x[1], 0.5))
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=dolfinx.mesh.meshtags(mesh, dim - 1, np.sort(top), 1))
    bottom = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], -0.5))
    V_x, _ = V.sub(0).collapse()
    sides = fem.locate_dofs_geometrical((V.sub(0), V_x), lambda x: np.isclose(x[0] * (1 - x[0]), 0.0))
    supports = [fem.dirichletbc(np.zeros(dim), bottom, V), fem.dirichletbc(fem.Function(V_x), sides, V.sub(0))]
    stages.end("space")

    def strain(w: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
        return ufl.sym(ufl.grad(w))

    def stress(w: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
        return LMBDA * ufl.tr(strain(w)) * ufl.Identity(dim) + 2 * MU * strain(w)

    a = fem.form(ufl.inner(stress(u), strain(v)) * ufl.dx)
    load = fem.form(ufl.inner(fem.Constant(mesh, np.array(LOAD[:dim])), v) * ds(1))
    stages.end("forms")

    x = V.tabulate_dof_coordinates()[:, :dim]
    number = np.empty(len(blocks.points), np.int32)  # number of the node at each grid point
    number[mesh.geometry.input_global_indices[mesh.geometry.dofmap]] = V.dofmap.list
    springs, jump = number[blocks.springs], blocks.jump
    pattern = fem.create_sparsity_pattern(a)
    for nodes in springs:
        pattern.insert(nodes, nodes)
    pattern.finalize()
    A = dolfinx.cpp.la.petsc.create_matrix(mesh.comm, pattern)
    assemble_matrix(A, a, bcs=supports)
    A.assemble(PETSc.Mat.AssemblyType.FLUSH)
    is_fixed = np.zeros((len(x), dim), bool)
    is_fixed[bottom], is_fixed.ravel()[sides[0]] = True, True
    for nodes in springs:
        free = ~is_fixed[nodes].ravel()
        A.setValuesBlockedLocal(nodes, nodes, jump * free * free[:, None], PETSc.InsertMode.ADD_VALUES)
    A.assemble()
    b = assemble_vector(load)
    apply_lifting(b, [a], bcs=[supports])
    set_bc(b, supports)
    stages.end("assembly")

    A.setOption(PETSc.Mat.Option.SPD, True)
    ksp, w = PETSc.KSP().create(mesh.comm), fem.Function(V)
    for name, value in options.items():
        PETSc.Options("by_hand_")[name] = value
    ksp.setOptionsPrefix("by_hand_")
    ksp.setOperators(A)
    ksp.setFromOptions()
    coordinates = PETSc.Vec().createWithArray(np.ascontiguousarray(x).ravel(), bsize=dim, comm=MPI.COMM_SELF)
    A.setNearNullSpace(PETSc.NullSpace().createRigidBody(coordinates))
    ksp.setUp()
    stages.end("factor")
    ksp.solve(b, w.x.petsc_vec)
    stages.end("solve")
    energy = fem.assemble_scalar(fem.form(ufl.inner(stress(w), strain(w)) / 2 * ufl.dx))
    values = w.x.array.reshape(-1, dim)[springs].reshape(len(springs), -1)
    energy += np.einsum("fi,ij,fj->", values, jump, values) / 2
    stages.end("results")
    for thing in (ksp, A, b):
        thing.destroy()
    return stages.measured(energy, len(x) * dim, dim)
