import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from forms import LinearElastic
from thinlayer import BrokenMesh, StepProblem, ThinLayer

comm, LOWER, UPPER, GLUE = MPI.COMM_WORLD, 1, 2, 3
grid = mesh.create_rectangle(comm, [(0, -5), (20, 5)], (16, 8), ghost_mode=mesh.GhostMode.shared_facet)  # mm
grid.topology.create_connectivity(1, 2)
cells = np.arange(grid.topology.index_map(2).size_local, dtype=np.int32)
above = mesh.compute_midpoints(grid, 2, cells)[:, 1] > 0
bodies = mesh.meshtags(grid, 2, cells, np.where(above, UPPER, LOWER).astype(np.int32))
line = mesh.locate_entities(grid, 1, lambda x: np.isclose(x[1], 0))
facets = mesh.meshtags(grid, 1, line, np.full(len(line), GLUE, np.int32))

broken = BrokenMesh(grid, bodies, facets, S={GLUE: UPPER})  # bodies part where facets are tagged GLUE
V = broken.space(("Lagrange", 2, (2,)))
glue = broken.layer(GLUE, ThinLayer(LinearElastic.young(E=2.0, nu=0.4).per_thickness(0.1), 0.1))  # MPa, 0.1 mm

u, v = fem.Function(V), ufl.TestFunction(V)
F = ufl.Identity(2) + ufl.grad(u)
psi = 50 * (ufl.tr(F.T * F) - 2 - 2 * ufl.ln(ufl.det(F))) + 75 * ufl.ln(ufl.det(F)) ** 2  # neo-Hooke
bottom, top = (fem.locate_dofs_geometrical(V, lambda x, y=y: np.isclose(x[1], y)) for y in (-5, 5))
bcs = [fem.dirichletbc(np.zeros(2), bottom, V), fem.dirichletbc(np.array([1.0, 0.5]), top, V)]

problem = StepProblem(ufl.derivative(psi * ufl.dx, u, v), u, bcs, glue)
snes = PETSc.SNES().create(comm)  # line search, linear solver and tolerances are yours
snes.getKSP().getPC().setType("lu")
snes.getKSP().getPC().setFactorSolverType("mumps")
problem.attach(snes)
snes.solve(None, u.x.petsc_vec)

jump = broken.interface(GLUE).jump(u)
means = [comm.allreduce(fem.assemble_scalar(fem.form(w * broken.dS(GLUE)))) / 20 for w in (jump[0], jump[1])]
if comm.rank == 0:
    print(f"{snes.getIterationNumber()} steps, mean jump ({means[0]:.6f}, {means[1]:.6f}) mm")
