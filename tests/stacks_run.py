"""Numbers of stacks of order 1, printed; run on several ranks by the tests."""

from __future__ import annotations

from forms import LinearElastic, Stack
from studies.problems import fourier
from thinlayer import Structure, Surface, ThinLayer, solve

TWO = Stack((0.3, LinearElastic(400.0, 20.0)), (0.7, LinearElastic(60.0, 5.0)))
LAWS = TWO, Stack.graded(lambda y: LinearElastic(60.0 + 30.0 * y, 40.0 - 25.0 * y), 4)

joint, setup = fourier(1 / 8, cell="quadrilateral")
found = []
for law in LAWS:
    state = solve(Structure(joint, **setup).interface(ThinLayer(law, 0.1, order=1)))
    surface = Surface(state.model)
    found += [surface.norm(surface.jump(state)), surface.norm(surface.traction(state)), *state.energies().values()]
if state.model.comm.rank == 0:
    print(*(repr(float(one)) for one in found))
