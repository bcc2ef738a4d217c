"""Numbers of Mohr-Coulomb layers, printed as JSON; run on several ranks by the tests."""

from __future__ import annotations

import json

from mpi4py import MPI

from forms import LinearElastic, MohrCoulomb
from geometry import block
from studies.sweep_mohr_coulomb import sheared_blocks
from thinlayer import History, Structure, Surface, ThinLayer, march


def measured(name: str, history: History, surface: Surface) -> dict[str, float]:
    state = history.last
    return {
        f"{name}: traction": surface.norm(surface.traction(state)),
        f"{name}: jump": surface.norm(surface.jump(state)),
        f"{name}: dissipated": float(history.table["dissipated"].sum()),
    }


def numbers() -> dict[str, float]:
    joint, setup = sheared_blocks(1 / 8)
    layer = ThinLayer(MohrCoulomb(60.0, 40.0, cohesion=0.05, friction_angle=30.0, elastic_fraction=0.02), 1 / 16)
    limit = Structure(joint, **setup).interface(layer)
    surface, times = Surface(limit), [0.5, 1.0, 1.5]
    found = measured("S", march(limit, times), surface)
    found |= measured("band", march(Structure(joint, **setup).full(layer), times), surface)

    cube = block(1.0, 0.5, 0.25, structured=True, depth=0.5)
    dilatant = ThinLayer(
        MohrCoulomb(60.0, 40.0, cohesion=0.1, friction_angle=30.0, elastic_fraction=0.02, dilatancy_angle=10.0), 1.0
    )
    body = {"body": LinearElastic.young(100.0, 0.3), "element": "P1"}
    along, across = (lambda x, t: 0.06 * t), (lambda x, t: 0.03 * t * x[2])
    push = {"x": along, "y": lambda x, t: -0.01 + 0 * t, "z": across}
    model = Structure(cube, supports={"TOP": push}, **body).interface(dilatant)
    found |= measured("3D", march(model, times[:2]), Surface(model))
    pull = {"x": 0.0, "y": lambda x, t: 0.04 * t * x[0], "z": 0.0}
    torn = ThinLayer(MohrCoulomb(60.0, 40.0, cohesion=0.1, friction_angle=30.0, elastic_fraction=0.02), 1.0)
    model = Structure(cube, supports={"TOP": pull}, **body).interface(torn)
    return found | measured("3D, torn", march(model, times[:2]), Surface(model))


if __name__ == "__main__":
    found = numbers()
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
