"""Structures with free ends of a layer."""

from __future__ import annotations

import numpy as np

from forms import LinearElastic
from geometry import sandwich
from thinlayer import Structure

BODY, GLUE = LinearElastic.young(E=70.0, nu=0.2), LinearElastic.shear(3.0, 0.35)
SIZES = {2: {}, 3: {"depth": 0.7}}
LOAD = (0.3, -1.0, 0.2)


def structure(dim: int, angle: float = 0.3, h_ends: float = 0.15) -> Structure:
    """Two turned blocks of triangles or tetrahedra, cells at the ends of S larger than the strips of the layer's ends."""
    joint = sandwich(1.3, 0.3, 0.4, 0.3, h_ends=h_ends, **SIZES[dim])
    turn = np.eye(dim)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    load = tuple(turn @ LOAD[:dim])
    return Structure(joint.rotated(angle), body=BODY, supports={"BOTTOM": 0}, tractions={"TOP": load})
