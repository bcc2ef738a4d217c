"""Numbers of interface models whose bodies stand apart, printed as JSON; run on several ranks by the tests."""

from __future__ import annotations

import json

import numpy as np
import ufl
from mpi4py import MPI

from forms import LinearElastic, Rubber
from geometry import ring
from thinlayer import Structure, Surface, ThinLayer, solve

BODY = LinearElastic.young(100.0, 0.3)


def taper(x):
    """Thickness over eps, with zero slope on the axes."""
    return 1 + 0.4 * (x[0] ** 2 - x[1] ** 2) / (x[0] ** 2 + x[1] ** 2)


def quarter(cell="quadrilateral", h=0.2, body_force=None) -> Structure:
    """A quarter of two rings, held inside and drawn on from outside."""
    joint = ring(0.5, 1.0, 1.6, h=h, angle=np.pi / 2, cell=cell, degree=2)
    supports = {"INSIDE": 0.0, "START": {"y": 0.0}, "END": {"x": 0.0}}
    return Structure(
        joint,
        body=BODY,
        supports=supports,
        tractions={"OUTSIDE": lambda x, t: (0.5 * x[0] * x[1], 1 + x[1])},
        body_force=body_force,
    )


WEIGHT = {"S": lambda x, t: (0.0, -3.0 * x[0] ** 2), "INNER": (0.0, 0.2)}


def numbers() -> dict[str, float]:
    found: dict[str, float] = {}
    for name, law in {"elastic": LinearElastic(60.0, 40.0), "rubber": Rubber(400.0, 4.0)}.items():
        eigenstrain = None if name == "rubber" else lambda x, t: 0.1 * x[0] * x[1]
        layer = ThinLayer(law, 1 / 16, order=1, profile=taper, eigenstrain=eigenstrain)
        state = solve(quarter(body_force=WEIGHT).interface(layer, bodies="extended"))
        surface, x = Surface(state.model), ufl.SpatialCoordinate(state.model.domain.mesh)
        found |= {
            f"{name} energies": sum(value for value in state.energies().values() if np.isfinite(value)),
            f"{name} traction": surface.norm(surface.traction(state)),
            f"{name} jump": surface.norm(surface.jump(state)),
            f"{name} profile": float(np.abs(surface.profile(surface.traction(state))[1]).sum()),
            f"{name} held": float(np.abs(state.reaction("INSIDE").force).sum()),
            f"{name} moved": state.integral(ufl.dot(x, state.u) * ufl.dx),
        }
    return found


if __name__ == "__main__":
    values = numbers()
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(values))
