"""Numbers of bodies that yield and creep, printed as JSON; run on several ranks by the tests."""

from __future__ import annotations

import json

import numpy as np
from mpi4py import MPI

from forms import LinearElastic, Maxwell, VonMises
from geometry import sandwich
from thinlayer import Structure, Surface, ThinLayer, compare, march
from thinlayer.discretisation.interface_model import InterfaceModel

JOINT = sandwich(1.0, 0.5, 0.5, 0.25)
YIELDING = VonMises(60.0, 50.0, strength=1.0, hardening=20.0, kinematic=10.0)
METAL = VonMises(60.0, 50.0, strength=lambda x: 0.5 + x[0], hardening=20.0)
SHEARED = {"TOP": lambda x, t: (0.5 * t * (1 + x[0]), -0.3 * t)}
LAYER = ThinLayer(LinearElastic(60.0, 40.0), 0.1)
SUPPORTS = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}}


def structure(body) -> Structure:
    return Structure(JOINT, body=body, supports=SUPPORTS, tractions=SHEARED)


def yielding(body=YIELDING) -> InterfaceModel:
    return structure(body).interface(LAYER)


def numbers() -> dict[str, float]:
    bodies = structure({"LOWER": YIELDING, "UPPER": Maxwell(60.0, 50.0, 0.7)})
    histories = [march(model, [0.5, 1.0, 1.5]) for model in (bodies.full(LAYER), bodies.interface(LAYER))]
    found = compare(*histories)
    state = histories[1].last
    surface = Surface(state.model)
    for name, stress in state.stresses.items():
        squares = float((stress**2).sum())
        found[name] = state.model.comm.allreduce(squares)
    graded = {"LOWER": LinearElastic.young(lambda x: 100 + 40 * x[0], 0.3), "UPPER": METAL}
    glue = LinearElastic(lambda x: 60 * (1 + x[0]), lambda x: 40 * (1 + x[0] ** 2))
    last = march(structure(graded).interface(ThinLayer(glue, 0.1)), [0.5, 1.0]).last
    found |= {f"graded, {name}": value for name, value in last.energies().items()}
    mean = state.mean_stress()
    return found | {
        "jump": surface.norm(surface.jump(state)),
        "mean stress": float(np.linalg.norm(mean)),
        "lost": float(histories[1].table["dissipated bodies"].sum()),
        **{f"energy of {name}": value for name, value in state.energies().items()},
    }


if __name__ == "__main__":
    printed = numbers()
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(printed))
