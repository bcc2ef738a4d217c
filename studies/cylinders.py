"""Rows of the study `rates` with cylinders: a coated fibre and bonded tubes."""

from __future__ import annotations

import numpy as np

from forms import LinearElastic
from geometry import fibre, sandwich
from studies.problems import Problem, StructureArguments
from thinlayer.discretisation.supports import Support

young = LinearElastic.young


# ---------------------------------------------------------------- a coated fibre
RADIUS, RIM, STRETCH = 0.4, 1.0, 0.1  # the rim is stretched along x
GLASS, RESIN = young(E=5.0, nu=0.3), young(E=1.0, nu=0.2)
COATING = LinearElastic(lmbda=0.6, mu=0.7)  # at the thickness 1


def coated_fibre(h: float) -> Problem:
    """A fibre in a disc of resin whose rim is stretched along x; the thin layer is the coating.

    Args:
        h: cell size; lengths and stresses have no units.

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    joint = fibre(RADIUS, RIM, h, cell="quadrilateral", degree=2)
    rim: Support = {"x": lambda x, t: STRETCH * x[0], "y": 0.0}
    return joint, {"body": {"FIBRE": GLASS, "MATRIX": RESIN}, "supports": {"OUTSIDE": rim}}


# ---------------------------------------------------------------- bonded tubes
SHAFT, HUB = young(E=210e3, nu=0.3), young(E=70e3, nu=0.34)  # MPa: steel and aluminium
GLUE, GLUE_EPS = young(E=2e3, nu=0.3), 0.2  # 2 GPa where the layer is 0.2 mm thick
RADII = (6.0, 12.0, 18.0)  # mm: bore, S, rim
TUBE_LENGTH = 8.0  # mm
PRESSURE, PUSH_STRESS = 50.0, 40.0  # MPa: in the bore; on the end of the shaft
PLATE_SUPPORTS: dict[str, Support] = {"LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}}
PRESSURE_LOADS: StructureArguments = {"supports": PLATE_SUPPORTS, "tractions": {"BOTTOM": (PRESSURE, 0.0)}}
PUSH_LOADS: StructureArguments = {"supports": {"RIGHT/UPPER": 0.0}, "tractions": {"LEFT/LOWER": (0.0, -PUSH_STRESS)}}


def tubes(h: float, loads: StructureArguments) -> Problem:
    """A tube glued into another tube, in an axisymmetric section.

    In the section x is the radius and y the axis. The facet set "BOTTOM" of the joint is the bore (the inner side
    of the inner tube), "LEFT" the upper end of both tubes, where y is largest.

    Args:
        h: cell size, mm.
        loads: supports and tractions.

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    bore, on_S, rim = RADII
    section = sandwich(TUBE_LENGTH, on_S - bore, rim - on_S, h, cell="quadrilateral", structured=True)
    bodies: StructureArguments = {"body": {"LOWER": SHAFT, "UPPER": HUB}, "plane": "axisymmetric"}
    return section.rotated(-np.pi / 2).moved((on_S, 0.0)), bodies | loads
