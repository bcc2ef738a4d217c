"""A glued block in 3D loaded on the sides of the layer; as a script, numbers that do not depend on the number of ranks."""

from __future__ import annotations

import json

from mpi4py import MPI

from forms import LinearElastic
from geometry import sandwich
from geometry.joint import Joint
from thinlayer import Pressure, State, Structure, Surface, ThinLayer, solve

BODY, GLUE = LinearElastic.young(E=70.0, nu=0.2), LinearElastic.shear(3.0, 0.35)
SIDES = {"LEFT/LAYER": (0.7, -0.4, 0.5), "FRONT/LAYER": Pressure(0.8), "RIGHT/LAYER": lambda x, t: (0.3 * x[2], t, 0.1)}
EPS = 0.05


def box(angle: float = 0.0) -> Joint:
    return sandwich(1.3, 0.3, 0.4, 0.3, h_ends=0.15, depth=0.7).rotated(angle)


def loaded(edges: str | None) -> State:
    """Three of the layer's sides are loaded."""
    structure = Structure(box(), body=BODY, supports={"BOTTOM": 0}, tractions=SIDES)
    return solve(structure.interface(ThinLayer(GLUE, EPS, order=1, edges=edges)))


def numbers(edges: str | None) -> dict[str, float]:
    """The work of the loads, and the norm of the jump."""
    state = loaded(edges)
    surface = Surface(state.model)
    jump = surface.integral(sum(one**2 for one in surface.jump(state)))
    force = state.applied().force
    return {
        f"{edges}, {name}": value
        for name, value in zip("wjxyz", (state.energies()["loads"], jump, *force), strict=True)
    }


if __name__ == "__main__":
    found = numbers("free") | numbers("plain")
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
