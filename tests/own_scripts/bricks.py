import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from forms import LinearElastic, MohrCoulomb
from thinlayer import BrokenMesh, StepProblem, ThinLayer

BED, HEAD, comm = 3, 4, MPI.COMM_WORLD
grid = mesh.create_rectangle(comm, [(0, 0), (3, 2)], (12, 8), ghost_mode=mesh.GhostMode.shared_facet)


def tags(dim, value):
    """Tags of cells or facets by the places of their centres; -1: none."""
    grid.topology.create_connectivity(dim, 2)
    n = grid.topology.index_map(dim).size_local
    values = value(*mesh.compute_midpoints(grid, dim, np.arange(n, dtype=np.int32)).T[:2]).astype(np.int32)
    entities = np.flatnonzero(values >= 0).astype(np.int32)
    return mesh.meshtags(grid, dim, entities, values[entities])


def brick(x, y):
    """Number of the brick at a place: bricks are 1 wide and 0.5 high, every second course lies half a brick farther."""
    course = np.floor(2 * y)
    return 10 * course + np.floor(x + 0.5 * (course % 2))


def joints(x, y):
    """Joints: where the brick a little to the right, or above, is another one."""
    inside = (x > 0.01) & (x < 2.99) & (y > 0.01) & (y < 1.99)
    head, bed = (brick(x - a, y - b) != brick(x + a, y + b) for a, b in ((0.01, 0), (0, 0.01)))
    return np.select([inside & head, inside & bed], [HEAD, BED], -1)


wall = BrokenMesh(grid, tags(2, brick), tags(1, joints), S={BED: (0, 1), HEAD: (1, 0)})
V = wall.space(("Lagrange", 2, (2,)))
bed = MohrCoulomb(lmbda=0.8, mu=2.1, cohesion=0.02, friction_angle=30)  # per thickness
head = LinearElastic(lmbda=0.4, mu=1.3)
terms = wall.layer(BED, ThinLayer(bed, 0.01, at=1.0)) + wall.layer(HEAD, ThinLayer(head, 0.02, at=1.0))

u, v = fem.Function(V), ufl.TestFunction(V)
F = ufl.Identity(2) + ufl.grad(u)
psi = 25 / 6 * (ufl.tr(F.T * F) - 2 - 2 * ufl.ln(ufl.det(F))) + 25 / 9 * ufl.ln(ufl.det(F)) ** 2
bottom, top = (fem.locate_dofs_geometrical(V, lambda x, y=y: np.isclose(x[1], y)) for y in (0, 2))
move = fem.Constant(grid, np.zeros(2))
bcs = [fem.dirichletbc(np.zeros(2), bottom, V), fem.dirichletbc(move, top, V)]

problem = StepProblem(ufl.derivative(psi * ufl.dx, u, v), u, bcs, terms)
snes = PETSc.SNES().create(comm)
snes.getKSP().getPC().setType("lu")
snes.getKSP().getPC().setFactorSolverType("mumps")
snes.setTolerances(rtol=1e-12, atol=1e-12)
problem.attach(snes)
for t in (0.25, 0.5, 0.75, 1.0):
    move.value[:] = (0.1 * t, -0.05)
    problem.begin(dt=0.25)
    snes.solve(None, u.x.petsc_vec)
    problem.accept()
    if comm.rank == 0:
        stored, dissipated, _ = problem.energies["layer"]
        print(f"t = {t}: {snes.getIterationNumber()} steps, bed joints store {stored:.9f}, dissipated {dissipated:.9f}")
