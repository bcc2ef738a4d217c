"""A mesh of DOLFINx, its tags and their names become a joint with a glue line."""

import numpy as np
from dolfinx import mesh
from mpi4py import MPI

from forms import LinearElastic
from geometry import read
from thinlayer import Structure, Surface, ThinLayer, compare, solve

comm, LOWER, UPPER, GLUE, TOP, BOTTOM = MPI.COMM_WORLD, 1, 2, 3, 4, 5
# mm; on any number of ranks, without ghosts too
grid = mesh.create_rectangle(comm, [(0, -4), (20, 6)], (40, 20))
grid.topology.create_connectivity(1, 2)
cells = np.arange(grid.topology.index_map(2).size_local, dtype=np.int32)
above = mesh.compute_midpoints(grid, 2, cells)[:, 1] > 0
body_of_cell = np.where(above, UPPER, LOWER).astype(np.int32)
bodies = mesh.meshtags(grid, 2, cells, body_of_cell)
at = {GLUE: 0, TOP: 6, BOTTOM: -4}
lines = {}
for tag, y in at.items():
    lines[tag] = mesh.locate_entities(grid, 1, lambda x, y=y: np.isclose(x[1], y))
tagged = np.concatenate(list(lines.values()))
values = np.repeat(list(lines), [len(line) for line in lines.values()])
order = np.argsort(tagged)
sides = mesh.meshtags(grid, 1, tagged[order], values[order].astype(np.int32))

names = {"LOWER": (2, LOWER), "UPPER": (2, UPPER)}
names |= {"S": (1, GLUE), "TOP": (1, TOP), "BOTTOM": (1, BOTTOM)}
plates = read((grid, bodies, sides), names=names, upper="UPPER")

steel = LinearElastic.young(E=210e3, nu=0.3)  # MPa
glue = ThinLayer(LinearElastic.young(E=2e3, nu=0.0), 0.2)  # mm
fixed = {"BOTTOM": {"y": 0}, (0, -4): 0}
pulled = Structure(plates, body=steel, supports=fixed, tractions={"TOP": (0, 50)})
limit = solve(pulled.interface(glue))
difference = compare(solve(pulled.full(glue)), limit)

surface = Surface(limit.model)
opening = surface.integral(surface.jump(limit)[1]) / 20
if comm.rank == 0:
    print(f"S opens by {opening:.9f} mm; 50 MPa / (2000 MPa / 0.2 mm) = 0.005 mm")
    error = difference["error_jump"]
    print(f"with a meshed layer by as much but for {error:.1e} of it")
