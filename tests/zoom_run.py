"""Zooms whose stresses do not depend on frames, units and kinematics."""

from __future__ import annotations

from typing import Any

import numpy as np

from forms import LinearElastic
from geometry import sandwich
from geometry.joint import Joint
from thinlayer import Structure, ThinLayer, solve
from thinlayer.discretisation.state import State

EPS = 0.05
BODY, GLUE = LinearElastic.young(E=70.0, nu=0.2), LinearElastic.shear(3.0, 0.35)
FREE = ThinLayer(GLUE, EPS, order=1, edges="free", at=1.0)
D, Y = (one.ravel() for one in np.meshgrid([0.0, 0.1, 0.6, 2.0, 7.0], [-0.4, -0.1, 0.3]))
PLACES = np.concatenate([np.stack([D * EPS, 0 * D], axis=1), np.stack([1.3 - D * EPS, 0 * D], axis=1)])
HEIGHTS = np.concatenate([Y, Y])


def joint(**cells: Any) -> Joint:
    """Two blocks on one another."""
    return sandwich(1.3, 0.3, 0.4, 0.1, cell="quadrilateral", structured=True, **cells)


def state(layer: ThinLayer = FREE, of: Joint | None = None, turn: Any = None, **given: Any) -> State:
    """The blocks sheared and pulled more on one side."""
    turn = np.eye(2) if turn is None else turn
    pull = {"TOP": tuple(turn @ [0.3, -1.0]), "RIGHT/UPPER": tuple(turn @ [0.1, 0.2])}
    data: dict[str, Any] = {"body": BODY, "supports": {"BOTTOM": 0}, "tractions": pull} | given
    return solve(Structure(joint() if of is None else of, **data).interface(layer))
