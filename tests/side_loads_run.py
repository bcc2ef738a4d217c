"""A glued block in 3D loaded on the sides of the layer."""

from __future__ import annotations

from forms import LinearElastic
from geometry import sandwich
from geometry.joint import Joint
from thinlayer import Pressure, Structure, ThinLayer, solve
from thinlayer.discretisation.state import State

BODY, GLUE = LinearElastic.young(E=70.0, nu=0.2), LinearElastic.shear(3.0, 0.35)
SIDES = {"LEFT/LAYER": (0.7, -0.4, 0.5), "FRONT/LAYER": Pressure(0.8), "RIGHT/LAYER": lambda x, t: (0.3 * x[2], t, 0.1)}
EPS = 0.05


def box(angle: float = 0.0) -> Joint:
    return sandwich(1.3, 0.3, 0.4, 0.3, h_ends=0.15, depth=0.7).rotated(angle)


def loaded(edges: str | None) -> State:
    """Three of the layer's sides are loaded."""
    structure = Structure(box(), body=BODY, supports={"BOTTOM": 0}, tractions=SIDES)
    return solve(structure.interface(ThinLayer(GLUE, EPS, order=1, edges=edges, at=1.0)))
