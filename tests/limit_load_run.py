"""Where the loads of a sheared block end, and what continuation finds."""

from __future__ import annotations

import ufl

from forms import IncrementalCoulomb, LinearElastic, MohrCoulomb, MohrCoulombMonodirectional
from geometry import block, sandwich
from tests.dry_walls import dry_wall
from tests.own_laws import layer_of
from thinlayer import Model, Structure, ThinLayer, march, solve
from thinlayer.errors import LimitLoad

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


def rubbed() -> Model:
    """A block on another one with cohesion and friction, pressed by 2 and sheared by t: it slides at 0.9."""
    joint = sandwich(1.0, 0.5, 0.5, 0.25, cell="quadrilateral", structured=True)
    setup = {"supports": {"BOTTOM": 0.0}, "tractions": {"TOP": lambda x, t: (t, -2.0)}, "element": "Q1"}
    return Structure(joint, body=BODY, **setup).interface(IncrementalCoulomb(300.0, 80.0, 0.35, 0.2))


def numbers() -> dict[str, float]:
    found: dict[str, float] = {}
    for kind in ("S", "band"):
        try:
            march(sheared(kind), [0.5, 1.0])
        except LimitLoad as error:
            found |= {f"{kind} t": error.t, f"{kind} failed at": error.failed_at, f"{kind} steps": len(error.history)}
            found |= {f"{kind} load {i}": force for i, force in enumerate(error.resultant)}
            found[f"{kind} run away"] = float(error.growth > 1e3)
            found[f"{kind} dissipated"] = float(error.history.table["dissipated"].sum())
    wall = dry_wall(h=0.25, weight=0.07, bricks=2, courses=2)
    for name, model, times, method in (
        ("block", rubbed(), [0.5, 2.0], "multigrid"),
        ("wall", wall, [0.3, 0.6], "newton"),
    ):
        try:
            march(model, times, method=method)
        except LimitLoad as error:
            found |= {f"{name} t": error.t, f"{name} failed at": error.failed_at, f"{name} steps": len(error.history)}
            found |= {f"{name} {seam} > 0.5": float(share > 0.5) for seam, share in error.shares.items()}
    law = MohrCoulomb(60.0, 40.0, cohesion=0.05, friction_angle=30.0, elastic_fraction=0.02)
    state = solve(dragged(law, far=0.06, eps=1 / 16), options={"snes_max_it": 4})
    found["continued u"] = state.integral(ufl.inner(state.u, state.u) * ufl.dx)
    found["eased"] = float(state.report.eased > 0)
    return found
