"""Structures with free ends of a layer."""

from __future__ import annotations

import numpy as np

from forms import LinearElastic, Rubber
from geometry import sandwich
from thinlayer import Structure, Surface, ThinLayer, solve

BODY, GLUE = LinearElastic.young(E=70.0, nu=0.2), LinearElastic.shear(3.0, 0.35)
SIZES = {2: {}, 3: {"depth": 0.7}}
LOAD = (0.3, -1.0, 0.2)
LAYER = ThinLayer(GLUE, 0.05, order=1, edges="free", at=1.0)
RUBBER = ThinLayer(Rubber.shear(15.0, 0.48), 0.1, order=1, edges="free", at=1.0)


def structure(dim: int, angle: float = 0.3, h_ends: float = 0.15) -> Structure:
    """Two turned blocks of triangles or tetrahedra, cells at the ends of S larger than the strips of the layer's ends."""
    joint = sandwich(1.3, 0.3, 0.4, 0.3, h_ends=h_ends, **SIZES[dim])
    turn = np.eye(dim)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    load = tuple(turn @ LOAD[:dim])
    return Structure(joint.rotated(angle), body=BODY, supports={"BOTTOM": 0}, tractions={"TOP": load})


def numbers() -> dict[str, float]:
    """The work of the loads, and norms of jump and traction."""
    found = {}
    cases = {f"{dim}D glue": (LAYER, structure(dim)) for dim in SIZES}
    cases["2D rubber"] = RUBBER, structure(2, h_ends=0.12)  # its forms in space are those of the glue, too
    for name, (layer, joint) in cases.items():
        state = solve(joint.interface(layer))
        surface = Surface(state.model)
        fields = {"jump": surface.jump(state), "traction": surface.traction(state)}
        squares = {what: surface.integral(sum(one**2 for one in field)) for what, field in fields.items()}
        values = {"loads": state.energies()["loads"]} | squares
        found |= {f"{name} {what}": value for what, value in values.items()}
    return found
