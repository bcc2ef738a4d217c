"""Numbers of bearings that are solved iteratively, printed as JSON; run on several ranks by the tests."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import ufl
from mpi4py import MPI

from forms import Incompressible, LinearElastic, Rubber
from geometry import sandwich
from thinlayer import Model, State, Structure, Surface, ThinLayer, solve

BLOCKS, FACTORS = {"pc_type": "fieldsplit"}, {"pc_type": "cholesky"}
MU, EPS = 1.3, 0.6  # MPa, mm: of the rubber
LOWER, UPPER = LinearElastic.young(2.1e5, 0.3), LinearElastic.young(40.0, 0.2)  # steel, and a body as soft as 30 mu


def bearing(nu: float, *, mm: float = 1.0, MPa: float = 1.0, upper: LinearElastic = UPPER, held: bool = False) -> Model:
    """Two bodies, 5.2 mm x 3.7 mm, with a rubber layer; its right and front ends are free, the others symmetric.

    Args:
        nu: Poisson's ratio of the rubber; 0: an elastic layer of ratio 0.3.
        mm, MPa: a millimetre and a megapascal in the units of the numbers.
        upper: the law of the upper body.
        held: whether the upper body is moved by its upper side; else a load there presses and turns it.
    """
    joint = sandwich(5.2 * mm, 1.1 * mm, 0.8 * mm, 1.1 * mm, depth=3.7 * mm, cell="hexahedron", structured=True)
    sides: dict[str, Any] = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "BACK": {"z": 0.0}}
    if held:
        setup: dict[str, Any] = {"supports": {**sides, "TOP": {"x": 0.0, "y": -0.02 * mm, "z": 0.0}}}
    else:
        load = {"TOP": lambda x, t: ufl.as_vector((0.02, -0.1 - 0.05 * x[0] / mm, 0.03 * x[2] / mm)) * MPa}
        setup = {"supports": sides, "tractions": load}
    bodies = {name: law.with_parameters({k: v * MPa for k, v in law.parameters().items()})
              for name, law in (("LOWER", LOWER), ("UPPER", upper))}  # fmt: skip
    structure = Structure(joint, body=bodies, **setup)
    return structure.interface(ThinLayer(layer_law(nu, MPa).per_thickness(EPS * mm), EPS * mm, order=1))


def layer_law(nu: float, MPa: float = 1.0) -> Rubber | Incompressible | LinearElastic:
    if nu == 0:
        return LinearElastic.shear(MU * MPa, 0.3)
    return Incompressible(MU * MPa) if nu == 0.5 else Rubber.shear(MU * MPa, nu)


def measured(state: State) -> dict[str, float]:
    surface = Surface(state.model)
    return {
        "u": state.integral(ufl.inner(state.u, state.u) * ufl.dx),
        "traction": surface.norm(surface.traction(state)),
        "jump": surface.norm(surface.jump(state)),
        "energy": state.energies()["layer"],
        "reaction": float(np.linalg.norm(state.reaction("BOTTOM").force)),
    }


def numbers(options: dict[str, str]) -> dict[str, float]:
    found = {}
    for nu in (0.4, 0.5):
        state = solve(bearing(nu), options=options)
        found |= {f"{name}, nu = {nu}": value for name, value in measured(state).items()}
    return found


if __name__ == "__main__":
    printed = numbers(BLOCKS)
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(printed))
