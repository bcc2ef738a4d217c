"""A jump of temperature in a script of one's own: two blocks with a glue that insulates, on a scalar space of DOLFINx."""

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from forms import Conduction
from thinlayer import BrokenMesh, StepProblem, ThinLayer

S, TOP, BOTTOM, k, q = 1, 2, 3, 2.0, 3.0
grid = mesh.create_unit_square(MPI.COMM_WORLD, 8, 8, ghost_mode=mesh.GhostMode.shared_facet)
grid.topology.create_connectivity(1, 2)
cells = np.arange(grid.topology.index_map(2).size_local, dtype=np.int32)
upper = mesh.compute_midpoints(grid, 2, cells)[:, 1] > 0.5
lines = [mesh.locate_entities(grid, 1, lambda x, y=y: np.isclose(x[1], y)) for y in (0.5, 1, 0)]
tagged, tags = np.concatenate(lines), np.repeat([S, TOP, BOTTOM], list(map(len, lines))).astype(np.int32)
facets = mesh.meshtags(grid, 1, np.sort(tagged), tags[np.argsort(tagged)])

broken = BrokenMesh(grid, mesh.meshtags(grid, 2, cells, upper.astype(np.int32)), facets, S=S)
V = broken.space(("Lagrange", 2))
T, v, ds = fem.Function(V), ufl.TestFunction(V), ufl.Measure("ds", domain=grid, subdomain_data=facets)
bcs = [fem.dirichletbc(20.0, fem.locate_dofs_topological(V, 1, facets.find(BOTTOM)), V)]
F = k * ufl.inner(ufl.grad(T), ufl.grad(v)) * ufl.dx - q * v * ds(TOP)
problem = StepProblem(F, T, bcs, broken.layer(S, ThinLayer(Conduction(k=0.1), eps=0.05)))
snes = PETSc.SNES().create(grid.comm)
snes.getKSP().getPC().setType("lu")
snes.getKSP().getPC().setFactorSolverType("mumps")
problem.attach(snes)
problem.begin(dt=0)
snes.solve(None, T.x.petsc_vec)
T.x.scatter_forward()
jump = grid.comm.allreduce(fem.assemble_scalar(fem.form(broken.interface(S).jump(T) * broken.dS(S))))
top = grid.comm.allreduce(fem.assemble_scalar(fem.form(T * ds(TOP))))
if grid.comm.rank == 0:
    print(f"jump {jump:.10f}, top {top:.10f}")
