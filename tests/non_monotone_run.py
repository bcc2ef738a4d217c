"""Models with non-monotone layers that are heated."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from forms import LinearElastic, NonMonotoneUnrelaxed, Tabulated
from geometry import sandwich
from geometry.joint import Joint
from thinlayer import Structure, ThinLayer
from thinlayer.discretisation.model import Model

CHI = np.array([[-0.3, 0.5], [0.5, 0.9]])
C = Tabulated([(20.0, 0.03), (50.0, 0.016), (100.0, 0.008)])


def warmer(x: Any, t: float) -> Any:
    """Temperature: 20 at the left end, growing to the right and in time."""
    return 20 + 35 * x[0] * (1 + t)


HEATED = NonMonotoneUnrelaxed(60.0, 40.0, 1.2, C, CHI, T=warmer)


@cache
def joint() -> Joint:
    return sandwich(1.0, 0.5, 0.5, 0.125, cell="quadrilateral", structured=True)


def models(law: Any) -> list[Model]:
    """S and the meshed layer between two blocks; the upper side is sheared and pulled, more at its right end."""
    top = {"x": lambda x, t: 0.03 * t, "y": lambda x, t: t * (0.05 * x[0] - 0.01)}
    setup = {"body": LinearElastic.young(100.0, 0.3), "supports": {"BOTTOM": 0.0, "TOP": top}, "element": "Q1"}
    blocks, layer = Structure(joint(), **setup), ThinLayer(law, 0.05, at=1.0)
    return [blocks.interface(layer), blocks.full(layer, cells_through=2)]
