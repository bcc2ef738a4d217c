"""A Norton layer between two blocks in 3D, under a constant shear: it creeps."""

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from forms import LinearElastic, Norton
from forms.work import body
from thinlayer import BrokenMesh, StepProblem, ThinLayer

comm, LAYER, TOP = MPI.COMM_WORLD, 3, 4
box = [(0, 0, 0), (2, 1, 1)]
grid = mesh.create_box(comm, box, (4, 2, 4), ghost_mode=mesh.GhostMode.shared_facet)
grid.topology.create_connectivity(2, 3)
cells = np.arange(grid.topology.index_map(3).size_local, dtype=np.int32)
bodies = mesh.meshtags(grid, 3, cells, (mesh.compute_midpoints(grid, 3, cells)[:, 2] > 0.5).astype(np.int32))
middle, above = (mesh.locate_entities(grid, 2, lambda x, z=z: np.isclose(x[2], z)) for z in (0.5, 1))
values = np.repeat([LAYER, TOP], [len(middle), len(above)]).astype(np.int32)
order = np.argsort(np.concatenate([middle, above]))
facets = mesh.meshtags(grid, 2, np.concatenate([middle, above])[order], values[order])

broken = BrokenMesh(grid, bodies, facets, S={LAYER: (0, 0, 1)})
V = broken.space(("Lagrange", 1, (3,)))
u, v = fem.Function(V), ufl.TestFunction(V)
dx, ds = ufl.Measure("dx", domain=grid), ufl.Measure("ds", domain=grid, subdomain_data=facets)
terms = [body(LinearElastic.young(E=100, nu=0.3), dx)]
terms += broken.layer(LAYER, ThinLayer(Norton(lmbda=3, mu=2, eta=5, p=1.5), 0.02, at=1.0))
held = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], 0))
bcs = [fem.dirichletbc(np.zeros(3), held, V)]
load = fem.Constant(grid, (0.4, 0.1, -0.2))
problem = StepProblem(-ufl.inner(load, v) * ds(TOP), u, bcs, terms)

PETSc.Options()["snes_linesearch_type"] = "basic"  # Newton's full steps: at rest the dashpot is next to rigid
snes = PETSc.SNES().create(comm)
snes.setFromOptions()
snes.setTolerances(rtol=1e-12, atol=1e-12)
snes.getKSP().getPC().setType("lu")
snes.getKSP().getPC().setFactorSolverType("mumps")
problem.attach(snes)
slip = fem.form(broken.interface(LAYER).jump(u)[0] * broken.dS(LAYER))
for t in (1, 2, 4):
    problem.begin(dt=t - problem.t)
    snes.solve(None, u.x.petsc_vec)
    problem.accept()
    mean, (stored, dissipated, _) = comm.allreduce(fem.assemble_scalar(slip)) / 2, problem.energies["layer"]
    if comm.rank == 0:
        print(f"t = {t}: mean slip {mean:.10f}, stored {stored:.10f}, dissipated {dissipated:.10f}")
