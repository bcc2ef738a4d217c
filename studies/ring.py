"""Curved S: a glued shaft and hub; the bodies give up room for the layer, error O(eps)."""

from __future__ import annotations

from collections.abc import Sequence

import ufl

from forms import LinearElastic
from geometry import ring
from studies.sweeping import Sweep, draw_rates
from thinlayer import ThinLayer
from thinlayer.running.record import Record

EPS = (0.8, 0.4, 0.2, 0.1)  # mm
SHAFT = LinearElastic.young(E=210e3, nu=0.3)  # MPa
HUB = LinearElastic.young(E=70e3, nu=0.33)
GLUE = LinearElastic.young(E=2e3, nu=0.4).per_thickness(0.2)  # 2 GPa where the layer is 0.2 mm thick
RADII = (10.0, 15.0, 20.0)  # mm: inside of the shaft, S, outside of the hub


def run(record: Record, *, eps: Sequence[float] = EPS, quick: bool = False) -> None:
    """A hollow shaft, held inside, glued into a hub that is pushed down on its upper half.

    Args:
        record: where to write.
        eps: thicknesses (mm), half of it taken from each body.
        quick: coarser mesh.
    """
    joint = ring(*RADII, h=2.0 if quick else 1.0, degree=2)
    setup = {
        "body": {"INNER": SHAFT, "OUTER": HUB},
        "supports": {"INSIDE": 0.0},
        "tractions": {"OUTSIDE": lambda x, t: (0.0, -ufl.conditional(x[1] > 0, 10.0 * x[1] / RADII[2], 0.0))},
    }
    record.parameters = {"radii_mm": RADII, "shaft": str(SHAFT), "hub": str(HUB), "glue_per_mm": str(GLUE)}
    sweep = Sweep(record, joint, setup, lambda e: ThinLayer(GLUE, e), bodies="extended")
    sweep.run(eps, (0.9, 1.1), unit="mm", title="glued shaft and hub")


def draw(record: Record) -> None:
    """Draw the rates from table.csv."""
    draw_rates(record, title="glued shaft and hub")
