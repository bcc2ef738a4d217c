"""Where the loads of a sheared block end, and what continuation finds."""

from __future__ import annotations

from forms import LinearElastic, MohrCoulomb, MohrCoulombMonodirectional
from geometry import block, sandwich
from tests.own_laws import layer_of
from thinlayer import Structure, ThinLayer
from thinlayer.discretisation.model import Model

BODY = LinearElastic.young(100.0, 0.3)
SLIDING = MohrCoulombMonodirectional(60.0, 40.0, cohesion=0.1, friction_angle=30.0)
FULL = MohrCoulomb(60.0, 40.0, cohesion=0.1, friction_angle=30.0)


def sheared(kind: str, law=SLIDING, **data) -> Model:
    """A flat block on a layer on a rigid base, pressed by 1; at the time t it is sheared by t."""
    data = {"tractions": {"TOP": lambda x, t: (t, -1.0)}, "supports": {}} | data
    column = Structure(block(1.0, 0.25, 0.25, structured=True), body=BODY, element="P1", **data)
    layer = layer_of(law, 1 / 16)
    return column.interface(layer) if kind == "S" else column.full(layer, cells_through=1)


def dragged(law, far: float = 0.16, eps: float = 1 / 4, kind: str = "full") -> Model:
    """Two blocks with a layer, pressed together, the upper one moved along by `far`; the layer's ends are free."""
    supports = {"BOTTOM": 0.0, "TOP": {"x": far, "y": -0.02}}
    joint = sandwich(1.0, 0.5, 0.5, 1 / 8, cell="quadrilateral", structured=True)
    build = Structure.interface if kind == "S" else Structure.full
    return build(Structure(joint, body=BODY, supports=supports, element="Q1"), ThinLayer(law, eps, at=1.0))
