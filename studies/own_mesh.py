"""A user's own mesh file: a masonry arch whose mortar joints are replaced by the interface law."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import ufl

from forms import LinearElastic
from forms.kinematics import Expr
from geometry import read
from studies.sweeping import Sweep, draw_rates, middle
from thinlayer import ThinLayer
from thinlayer.running.record import Record

MESH = Path(__file__).parent / "data" / "arch.msh"  # curved cells; arch.geo is its drawing
EPS = (0.04, 0.02, 0.01, 0.005)  # m
STONE = LinearElastic.young(E=20e3, nu=0.2)  # MPa
MORTAR, MORTAR_EPS = LinearElastic.young(E=1e3, nu=0.2), 0.01  # 1 GPa where joints are 10 mm thick
WEIGHT = (0.0, -0.025)  # MN/m^3
RADIUS, MIDDLE = 1.15, 0.1  # m: joints are measured over the middle two thirds of their length


def run(record: Record, *, eps: Sequence[float] = EPS, quick: bool = False) -> None:
    """Five stones under their weight and a load on the right half; all four joints are one S, in four pieces.

    Args:
        record: where to write.
        eps: thicknesses of the joints (m); the arch keeps its shape.
        quick: elements of degree 1.
    """
    joint = read(MESH, S="JOINTS", lower="ODD STONES", upper="EVEN STONES")
    setup = {
        "body": STONE,
        "supports": {"SPRINGINGS": 0.0},
        "tractions": {"EXTRADOS": lambda x, t: (0.0, ufl.conditional(x[0] > 0, -0.4, -0.1))},
        "body_force": WEIGHT,
        "element": "P1" if quick else "P2",
    }
    record.parameters = {"mesh": MESH.name, "stone": str(STONE), "mortar": str(MORTAR)}
    sweep = Sweep(record, joint, setup, lambda e: ThinLayer(MORTAR, e, at=MORTAR_EPS), bodies="extended", where=inside)
    sweep.run(eps, (0.9, 1.1), pictured=middle, unit="m", title="masonry arch")


def inside(x: Expr) -> Expr:
    """Away from the ends of the joints."""
    return abs(ufl.sqrt(x[0] ** 2 + x[1] ** 2) - RADIUS) < MIDDLE


def draw(record: Record) -> None:
    """Draw the rates from table.csv."""
    draw_rates(record, title="mortar joints of an arch")
