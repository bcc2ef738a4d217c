"""Curved S: a glued shaft and hub; the bodies give up room for the layer, error O(eps), and O(eps^2) at order 1."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import ufl

from forms import LinearElastic
from geometry import ring
from studies.sweeping import Sweep, draw_rates
from thinlayer import ThinLayer
from thinlayer.running.record import Record

EPS = (0.8, 0.4, 0.2, 0.1)  # mm
SHAFT = LinearElastic.young(E=210e3, nu=0.3)  # MPa
HUB = LinearElastic.young(E=70e3, nu=0.33)
GLUE, GLUE_EPS = LinearElastic.young(E=2e3, nu=0.4), 0.2  # 2 GPa where the layer is 0.2 mm thick
RADII = (10.0, 15.0, 20.0)  # mm: inside of the shaft, S, outside of the hub
NEXT = "order1"


def run(record: Record, *, eps: Sequence[float] = EPS, quick: bool = False) -> None:
    """A hollow shaft, held inside, glued into a hub that is pushed down on its upper half.

    At order 1 the bodies of the law stand where the meshed layer has them.

    Args:
        record: where to write.
        eps: thicknesses (mm), half of it taken from each body.
        quick: coarser mesh.
    """
    joint = ring(*RADII, h=2.0 if quick else 1.0, cell="quadrilateral", degree=2)
    setup = {
        "body": {"INNER": SHAFT, "OUTER": HUB},
        "supports": {"INSIDE": 0.0},
        "tractions": {"OUTSIDE": lambda x, t: (0.0, -ufl.conditional(x[1] > 0, 10.0 * x[1] / RADII[2], 0.0))},
    }
    record.parameters = {"radii_mm": RADII, "shaft": str(SHAFT), "hub": str(HUB), "glue": str(GLUE)}
    for case, order, rates in (("", 0, (0.9, 1.1)), (NEXT, 1, (1.8, 2.2))):
        layer = partial(ThinLayer, GLUE, order=order, at=GLUE_EPS)
        sweep = Sweep(record, joint, setup, layer, bodies="extended", case=case)
        sweep.run(eps, rates, unit="mm", title="glued shaft and hub", pictured=None if order else max)


def draw(record: Record) -> None:
    """Draw the rates of both laws from the tables."""
    cases = {"order 0": "table.csv", "order 1": f"table_{NEXT}.csv"}
    draw_rates(record, title="glued shaft and hub", cases=cases)
