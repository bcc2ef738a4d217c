"""Two blocks in contact with friction, one tilted and pushed along the other: parts of S stick, slide and open.

Once in a SNES of one's own, once as a structure of the same mesh.
"""

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from forms import IncrementalCoulomb, LinearElastic
from forms.work import body
from geometry import read
from thinlayer import BrokenMesh, StepProblem, Structure, Surface, march
from thinlayer.parts.contact_part import ContactPart

comm, LOWER, UPPER, S, TOP, BOTTOM = MPI.COMM_WORLD, 1, 2, 3, 4, 5
grid = mesh.create_rectangle(comm, [(0, 0), (2, 1)], (16, 8), ghost_mode=mesh.GhostMode.shared_facet)
grid.topology.create_connectivity(1, 2)
cells = np.arange(grid.topology.index_map(2).size_local, dtype=np.int32)
above = mesh.compute_midpoints(grid, 2, cells)[:, 1] > 0.5
bodies = mesh.meshtags(grid, 2, cells, np.where(above, UPPER, LOWER).astype(np.int32))
at = {S: 0.5, TOP: 1, BOTTOM: 0}
lines = {tag: mesh.locate_entities(grid, 1, lambda x, y=y: np.isclose(x[1], y)) for tag, y in at.items()}
tagged, values = np.concatenate(list(lines.values())), np.repeat(list(lines), [len(line) for line in lines.values()])
order = np.argsort(tagged)
facets = mesh.meshtags(grid, 1, tagged[order], values[order].astype(np.int32))

stone, law = LinearElastic.young(E=100, nu=0.2), IncrementalCoulomb(K_N=400, K_T=300, friction=0.4)
push, tilt, times = 0.008, 0.012, (0.5, 1, 1.5)  # the top moves along by push t, and down by 0.006 - tilt t (1 - x)

broken = BrokenMesh(grid, bodies, facets, S={S: UPPER})
V = broken.space(("Lagrange", 1, (2,)))
u, v, u_D = fem.Function(V), ufl.TestFunction(V), fem.Function(V)
bc_dofs = {tag: fem.locate_dofs_topological(V, 1, facets.find(tag)) for tag in (TOP, BOTTOM)}
bcs = [fem.dirichletbc(np.zeros(2), bc_dofs[BOTTOM], V), fem.dirichletbc(u_D, bc_dofs[TOP])]
contact = ContactPart(law, broken.contact_surface(S, V))
none = ufl.inner(fem.Constant(grid, np.zeros(2)), v) * ufl.dx
problem = StepProblem(none, u, bcs, [body(stone, ufl.Measure("dx", domain=grid))], parts=[contact])
snes = PETSc.SNES().create(comm)
snes.setTolerances(rtol=1e-13, atol=1e-13)
snes.getKSP().getPC().setType("lu")
snes.getKSP().getPC().setFactorSolverType("mumps")
problem.attach(snes)
for t in times:
    u_D.interpolate(lambda x, t=t: np.vstack([push * t + 0 * x[0], -0.006 + tilt * t * (1 - x[0])]))
    problem.begin(dt=t - problem.t)
    snes.solve(None, u.x.petsc_vec)
    problem.accept()
jump = broken.interface(S).jump(u)
mine = [comm.allreduce(fem.assemble_scalar(fem.form(jump[k] * broken.dS(S)))) for k in (0, 1)]
# contact.slip is the slip before the step; the memory of problem.state is already that after it
status = np.concatenate(comm.allgather(law.status(contact.nodes.jump(u.x.petsc_vec), contact.slip)))
my_counts = np.bincount(status, minlength=3)  # separated, stick, sliding

names = {"LOWER": (2, LOWER), "UPPER": (2, UPPER), "S": (1, S), "TOP": (1, TOP), "BOTTOM": (1, BOTTOM)}
blocks = read((grid, bodies, facets), names=names, upper="UPPER")
top = {"x": lambda x, t: push * t + 0 * x[0], "y": lambda x, t: -0.006 + tilt * t * (1 - x[0])}
structure = Structure(blocks, body=stone, supports={"BOTTOM": 0.0, "TOP": top}, element="P1")
history = march(structure.interface(law), times)
surface = Surface(history.last.model)
its = [surface.integral(surface.jump(history.last)[k]) for k in (0, 1)]
its_counts = [surface.contact(history.last).counts[name] for name in ("separated", "stick", "sliding")]

if comm.rank == 0:
    print(f"own SNES: jumps {mine[0]:.14f}, {mine[1]:.14f}, lost {problem.energies['contact'][1]:.14f}")
    print(f"march:    jumps {its[0]:.14f}, {its[1]:.14f}, lost {sum(history.table['dissipated']):.14f}")
    print("own SNES: nodes that are open, stick, slide:", *my_counts)
    print("march:    nodes that are open, stick, slide:", *its_counts)
