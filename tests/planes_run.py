"""Numbers of models in plane stress and of axisymmetric ones, printed as JSON; run on several ranks by the tests."""

from __future__ import annotations

import json

import numpy as np
import ufl
from mpi4py import MPI

from forms import HolonomicCoulomb, Incompressible, LinearElastic, Maxwell, MohrCoulomb, Rubber, Stack
from geometry import sandwich
from thinlayer import State, Structure, Surface, ThinLayer, compare, march, solve

BODY = LinearElastic(80.0, 50.0)
CREEPS, YIELDS = Maxwell(3.0, 2.0, 0.8, 2.5), MohrCoulomb(3.0, 2.0, 0.005, 30.0, 0.05)


def plate() -> Structure:
    joint = sandwich(1.0, 0.5, 0.5, 0.25)
    setup = {"supports": {"BOTTOM": 0.0, "LEFT": {"x": 0.0}}, "tractions": {"TOP": lambda x, t: (0.01 * x[0], -0.03)}}
    return Structure(joint, body=BODY, plane="stress", **setup)


def rods(sides=(), **options) -> Structure:
    joint = sandwich(1.3, 0.6, 0.5, 0.25)
    setup = {
        "supports": {"BOTTOM": {"y": 0.0}} | {name: {"x": 0.0} for name in sides},
        "tractions": {"TOP": lambda x, t: (0.01 * x[0], -0.03 * (1 + x[0] ** 2))},
    }
    return Structure(joint, body=BODY, plane="axisymmetric", **setup, **options)


def measured(name: str, state: State) -> dict[str, float]:
    surface = Surface(state.model)
    t = surface.traction(state)
    return {
        f"{name} u": state.integral(ufl.inner(state.u, state.u) * ufl.dx),
        f"{name} traction": surface.norm(t),
        f"{name} jump": surface.norm(surface.jump(state)),
        f"{name} profile": float(np.abs(surface.profile(surface.frame(t))[1]).sum()),
        f"{name} energies": sum(value for value in state.energies().values() if np.isfinite(value)),
    }


def numbers() -> dict[str, float]:
    found: dict[str, float] = {}
    stack = Stack((0.4, CREEPS), (0.6, YIELDS))
    for plane, structure in {"stress": plate(), "axisymmetric": rods()}.items():
        layer = ThinLayer(stack, 0.05)
        full, limit = (march(model, [0.3, 0.6]) for model in (structure.full(layer), structure.interface(layer)))
        found |= {f"{plane} {key}": value for key, value in compare(full, limit).items()}
        found |= measured(plane, limit.last)
        first = solve(structure.interface(ThinLayer(BODY, 0.05, order=1)))
        found |= measured(f"{plane} order 1", first)
    found |= measured("rods, incompressible", solve(rods(["RIGHT"]).interface(ThinLayer(Incompressible(2.0), 0.05))))
    rubber = ThinLayer(Rubber(900.0, 2.0), 0.05, order=1)
    thin = rods()
    states = [solve(thin.full(rubber)), solve(thin.interface(rubber))]
    found |= measured("rods, rubber", states[1])
    found |= {f"rods, rubber {key}": value for key, value in compare(*states).items()}
    found |= measured("rods, contact", solve(rods(element="P1").interface(HolonomicCoulomb(9.0, 3.0, 0.4))))
    return found


if __name__ == "__main__":
    printed = numbers()
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(printed))
