"""Structures with supports, springs, plates and loads of all kinds."""

from __future__ import annotations

import numpy as np

from forms import LinearElastic, Maxwell, MohrCoulomb
from forms.contact import HolonomicCoulomb
from geometry import block, sandwich
from thinlayer import LineLoad, PointLoad, Pressure, RigidPlate, Springs, Structure, ThinLayer
from thinlayer.discretisation.state import State

BODY = LinearElastic.young(100.0, 0.2)
GLUE = LinearElastic(3.0, 2.0)  # per thickness
CREEP = Maxwell(3.0, 2.0, 0.5)
MORTAR = MohrCoulomb(3.0, 2.0, cohesion=0.05, friction_angle=30.0)
CONTACT = HolonomicCoulomb(50.0, 20.0, 0.3)
EPS, ANGLE = 0.1, 0.3
DIM = {2: {}, 3: {"depth": 1.0}}
KINDS = ("full", "interface", "bonded")


def turn(angle: float = ANGLE) -> np.ndarray:
    """Columns: the turned axes."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def model(structure: Structure, kind: str, law=GLUE):
    """A model of one kind."""
    return structure.bonded() if kind == "bonded" else getattr(structure, kind)(ThinLayer(law, EPS, at=1.0))


def loaded(dim: int, kind: str, law=GLUE, element: str | None = None):
    """Two blocks with a layer: held at the sides in part, on springs, loaded in every way."""
    loads = [PointLoad((2.0, 0.6, 0.0)[:dim], (0.1, 0.3, -0.2)[:dim])]
    if dim == 3:
        loads.append(LineLoad("TOP", "RIGHT", lambda x, t: (0.1 * x[2] ** 3, t * x[2], 0.2)))
    else:
        loads.append(PointLoad((0.0, 0.0), lambda x, t: (0.3 * t, -0.1), body="UPPER"))
    weight = {"LOWER": (0.0, -0.4, 0.0)[:dim], "S": (0.1, -2.0, 0.3)[:dim]}
    structure = Structure(
        sandwich(2.0, 0.5, 0.6, 0.5, **DIM[dim]),
        body=BODY, supports={"LEFT": {"x": 0.0, "y": 0.0}, "RIGHT/LOWER": 0.0},
        tractions={"TOP": Pressure(lambda x, t: 0.2 * t * x[0]), "RIGHT/UPPER": (0.2, 0.1, -0.3)[:dim]},
        body_force=weight, loads=loads, parts=[Springs("BOTTOM", normal=lambda x: 3.0 + x[0], tangential=2.0)],
        element=element or ("P1" if dim == 3 else "P2"),
    )  # fmt: skip
    return model(structure, kind, law)


def plate(dim: int, kind: str, *, angle: float = 0.0, law=GLUE, **motion):
    """Two blocks held at the bottom, and a plate on top with a force and a moment; the plate and its model."""
    force = np.array([0.3, -2.0, 0.1][:dim])
    if angle:
        force = turn(angle) @ force
    pushed = {"force": tuple(force), "moment": 0.7 if dim == 2 else (0.3, 0.2, 0.7)}
    top = RigidPlate("TOP", **({"motion": motion} if motion else pushed))
    joint = sandwich(2.0, 0.5, 0.6, 0.5, **DIM[dim])
    joint = joint.rotated(angle) if angle else joint
    supports = {"BOTTOM": {"n": 0.0}, "LEFT/LOWER": {"n": 0.0}} if angle else {"BOTTOM": 0.0}
    structure = Structure(joint, body=BODY, supports=supports, parts=[top], element="P1" if dim == 3 else "P2")
    return top, model(structure, kind, law)


def on_base(law, *, contact: bool = False):
    """A block pressed and pushed along a layer, or in contact, on a rigid base."""
    joint = block(4.0, 2.0, 1.0, structured=contact)
    push = (0.02, -1.0) if contact else lambda x, t: (0.02 * t, -0.2 - 0.05 * x[0])
    data = {"supports": {"RIGHT": {"x": 0.0}}, "tractions": {"TOP": push}, "element": "P1" if contact else "P2"}
    return Structure(joint, body=BODY, **data).interface(law if contact else ThinLayer(law, EPS, at=1.0))


def out_of_balance(state: State) -> float:
    """Sum of all reactions and loads, force and moment, over the largest of them."""
    every = [*state.reactions_by_place().values(), state.applied()]
    rows = np.array([[*resultant.force, *np.atleast_1d(resultant.moment)] for resultant in every])
    return float(np.abs(rows.sum(axis=0)).max() / np.abs(rows).max())
