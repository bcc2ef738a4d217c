"""Three dimensions: two steel cylinders, glued end to end, under tension and bending."""

from __future__ import annotations

from collections.abc import Sequence

import ufl

from forms import LinearElastic
from forms.kinematics import Expr
from geometry import disc
from studies.sweeping import Sweep, draw_rates
from thinlayer import ThinLayer
from thinlayer.running.record import Record

EPS = (0.8, 0.4, 0.2, 0.1)  # mm
STEEL = LinearElastic.young(E=210e3, nu=0.3)  # MPa
GLUE = LinearElastic.young(E=2e3, nu=0.4).per_thickness(0.2)  # 2 GPa where the layer is 0.2 mm thick
RADIUS, HEIGHT = 12.0, 10.0  # mm
STRESS, BENDING = 20.0, 30.0  # MPa: mean, and at the edge


def run(record: Record, *, eps: Sequence[float] = EPS, quick: bool = False) -> None:
    """Sweep the thickness; S is measured away from its edge, where the layer's free side disturbs it.

    Equilibrium alone nearly fixes the traction inside, so that its error falls faster than that of the jump.

    Args:
        record: where to write.
        eps: thicknesses (mm).
        quick: coarser mesh.
    """
    h, h_S = (6.0, 4.0) if quick else (4.0, 2.5)
    joint = disc(RADIUS, HEIGHT, HEIGHT, h, h_S=h_S, cell="hexahedron", degree=2)
    setup = {
        "body": STEEL,
        "supports": {"BOTTOM": 0.0},
        "tractions": {"TOP": lambda x, t: (0.0, STRESS + BENDING * x[0] / RADIUS, 0.0)},
    }
    record.parameters = {"radius_mm": RADIUS, "height_mm": HEIGHT, "steel": str(STEEL), "glue_per_mm": str(GLUE)}
    sweep = Sweep(record, joint, setup, lambda e: ThinLayer(GLUE, e), where=inside)
    sweep.run(eps, (0.9, None), unit="mm", title="butt joint")


def inside(x: Expr) -> Expr:
    """Away from the edge."""
    return ufl.sqrt(x[0] ** 2 + x[2] ** 2) < 0.75 * RADIUS


def draw(record: Record) -> None:
    """Draw the rates from table.csv."""
    draw_rates(record, title="butt joint")
