"""Three dimensions: two steel cylinders, glued end to end, under tension and bending; under tension alone axisymmetric."""

from __future__ import annotations

import math
from collections.abc import Sequence

import ufl

from forms import LinearElastic
from forms.kinematics import Expr
from geometry import disc, sandwich
from studies.sweeping import Solution, Sweep, draw_rates, last
from thinlayer import State, Structure, Surface, ThinLayer, solve
from thinlayer.running.record import Record

EPS = (0.8, 0.4, 0.2, 0.1)  # mm
STEEL = LinearElastic.young(E=210e3, nu=0.3)  # MPa
GLUE, GLUE_EPS = LinearElastic.young(E=2e3, nu=0.4), 0.2  # 2 GPa where the layer is 0.2 mm thick
RADIUS, HEIGHT = 12.0, 10.0  # mm
STRESS, BENDING = 20.0, 30.0  # MPa: mean, and at the edge
SAME = 0.01  # relative difference of means in three dimensions and in the axisymmetric section


def run(record: Record, *, eps: Sequence[float] = EPS, quick: bool = False) -> None:
    """Sweep the thickness; S is measured away from its edge, where the layer's free side disturbs it.

    Equilibrium alone nearly fixes the traction inside, so that its error falls faster than that of the jump. Bending opens
    one half of S as much as it closes the other: means over S and over the top are those of tension, which the section
    through the axis has too.

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
    record.parameters = {"radius_mm": RADIUS, "height_mm": HEIGHT, "steel": str(STEEL), "glue": str(GLUE)}
    sweep = Sweep(record, joint, setup, lambda e: ThinLayer(GLUE, e, at=GLUE_EPS), where=inside, more=against_section)
    table = sweep.run(eps, (0.9, None), unit="mm", title="butt joint")
    for name in ("rise_meshed", "rise_law", "traction_meshed", "traction_law"):
        apart = max(abs(a / b - 1) for a, b in zip(table[name], table[f"{name}_axisymmetric"], strict=True))
        record.check(f"{name} in 3D against the axisymmetric section", apart, high=SAME)


def inside(x: Expr) -> Expr:
    """Away from the edge."""
    return _radius(x) < 0.75 * RADIUS


def _radius(x: Expr) -> Expr:
    return ufl.sqrt(sum(x[k] ** 2 for k in (0, 2)[: len(x) - 1]))


def against_section(full: Solution, limit: Solution) -> dict[str, float]:
    """Mean rise of the top (mm) and mean normal traction (MPa), in 3D and in the section through the axis.

    The mean is weighted with 1 - r^2/R^2, because equilibrium gives the plain one. In the section x = r, y is the axis.
    """
    layer = last(limit).model.layers["S"].thin
    section = sandwich(RADIUS, HEIGHT, HEIGHT, 2.0, h_S=0.8, h_ends=0.3)
    load = {"TOP": (0.0, STRESS)}
    rods = Structure(section, body=STEEL, supports={"BOTTOM": 0.0}, tractions=load, plane="axisymmetric")
    assert layer is not None
    limit_of_rods = solve(rods.interface(layer))
    found = {}
    for name, state, of_rods in (("meshed", full, solve(rods.full(layer))), ("law", limit, limit_of_rods)):
        for where, one, surface in (
            ("", last(state), Surface(last(limit).model)),
            ("_axisymmetric", of_rods, Surface(limit_of_rods.model)),
        ):
            found[f"rise_{name}{where}"] = _rise(one)
            part = 1 - _radius(ufl.SpatialCoordinate(surface.model.domain.mesh)) ** 2 / RADIUS**2
            normal = ufl.dot(surface.traction(one), surface.sides.n)
            found[f"traction_{name}{where}"] = surface.integral(part * normal) / surface.integral(part)
    return found


def _rise(state: State) -> float:
    model = state.model
    top = model.ds(model.domain.values("TOP"))
    return state.integral(state.u[1] * top) / (math.pi * RADIUS**2)


def draw(record: Record) -> None:
    """Draw the rates from table.csv."""
    draw_rates(record, title="butt joint")
