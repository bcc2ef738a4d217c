"""Structures of the cases, each with one mesh for all layers of a thickness."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial
from math import pi
from typing import Any

import ufl

from forms import LinearElastic
from forms.kinematics import Expr
from geometry import block, faults, ring, sandwich
from geometry.joint import Joint
from studies.problems import FOURIER_BODY, fourier
from thinlayer import RigidPlate, Springs, Structure

ALONG, ENDS = 1 / 24, 8  # cell size on S; cells within a thickness at free ends
TILT = 0.5  # rad
WIDTH, DEPTH = 1.3, 0.8
CLAMPED: dict[Any, Any] = {"BOTTOM": 0.0}
WALLS: dict[Any, Any] = CLAMPED | {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
young = LinearElastic.young
Vector = tuple[float, ...]


def loaded(
    joint: Joint, top: Any, *, body: Any = FOURIER_BODY, supports: Mapping[Any, Any] = CLAMPED, **more: Any
) -> Structure:
    """Bodies under a traction on top, clamped below."""
    return Structure(joint, body=body, supports=supports, tractions={"TOP": top}, **more)


def of_any_thickness(make: Callable[[], Structure]) -> Callable[[float], Structure]:
    """A structure with one mesh for layers of any thickness."""
    once = cache(make)
    return lambda eps: once()


@of_any_thickness
def rollers() -> Structure:
    """Two blocks between rollers under one half-wave, `studies.problems.fourier`."""
    joint, setup = fourier(1 / 16, cell="quadrilateral")
    return Structure(joint, **setup)


@of_any_thickness
def box() -> Structure:
    """A box between rollers on all four sides, under half a wave along x and a whole one along z."""
    joint = sandwich(1.0, 0.5, 0.5, 1 / 8, depth=0.5, cell="hexahedron", structured=True)
    k1, k3 = pi, 2 * pi
    k = (k1**2 + k3**2) ** 0.5

    def top(x: Expr, t: Expr) -> tuple[Expr, ...]:
        (s1, c1), (s3, c3) = ((ufl.sin(a * x[i]), ufl.cos(a * x[i])) for a, i in ((k1, 0), (k3, 2)))
        return 0.5 * k1 / k * s1 * c3, c1 * c3, 0.5 * k3 / k * c1 * s3

    return loaded(joint, top, supports=WALLS | {"BACK": {"z": 0.0}, "FRONT": {"z": 0.0}})


def _blocks(eps: float, lower: float = 0.5, upper: float = 0.5) -> Joint:
    return sandwich(1.0, lower, upper, 1 / 8, h_S=ALONG, h_ends=min(eps / ENDS, ALONG), cell="quadrilateral")


@cache
def free(
    eps: float,
    *,
    load: Vector = (0.3, -1.0),
    heights: tuple[float, float] = (0.5, 0.5),
    lower: LinearElastic = FOURIER_BODY,
    upper: LinearElastic = FOURIER_BODY,
    **more: Any,
) -> Structure:
    """Two blocks, 1 wide, with free sides, clamped below, under a traction above."""
    return loaded(_blocks(eps, *heights), load, body={"LOWER": lower, "UPPER": upper}, **more)


def freely(**choices: Any) -> Callable[[float], Structure]:
    """`free` with these choices."""
    return partial(free, **choices)


@cache
def displaced(eps: float, *, body: LinearElastic) -> Structure:
    """Two stiff blocks with free sides, the upper one pressed down by 0.01."""
    return Structure(_blocks(eps), body=body, supports=CLAMPED | {"TOP": {"x": 0.0, "y": -0.01}})


@cache
def tilted(eps: float) -> Structure:
    """Two blocks of unequal heights with free sides, turned by `TILT`, under a traction that is not."""
    return loaded(_blocks(eps, 0.4, 0.7).rotated(TILT), (-0.7, 0.4), body=young(E=150.0, nu=0.2))


@of_any_thickness
def channel() -> Structure:
    """Two unequal blocks between rollers, under a traction that is no wave."""
    joint = sandwich(WIDTH, 0.4, 0.6, 1 / 16, cell="quadrilateral", structured=True)
    body = {"LOWER": young(E=120.0, nu=0.25), "UPPER": young(E=80.0, nu=0.35)}
    return loaded(joint, lambda x, t: (x[0] * (WIDTH - x[0]), x[0] ** 2 - 0.3), body=body, supports=WALLS)


@of_any_thickness
def rings() -> Structure:
    """A ring around another one that is held inside, pushed down on its upper half."""
    joint = ring(1.0, 1.5, 2.2, 1 / 6, h_S=1 / 12, cell="quadrilateral", degree=2)
    return Structure(
        joint,
        body={"INNER": young(E=200.0, nu=0.3), "OUTER": young(E=70.0, nu=0.33)},
        supports={"INSIDE": 0.0},
        tractions={"OUTSIDE": lambda x, t: (0.0, -ufl.conditional(x[1] > 0, x[1], 0.0))},
    )


@cache
def on_base(eps: float) -> Structure:
    """A block with free sides on a rigid base."""
    joint = block(1.0, 0.6, 1 / 8, h_S=ALONG, h_ends=min(eps / ENDS, ALONG), cell="quadrilateral")
    return loaded(joint, lambda x, t: (0.4, -0.5 - x[0]), body=young(E=90.0, nu=0.2), supports={})


@of_any_thickness
def tube() -> Structure:
    """Two tubes, one on the other, between smooth walls: a section from r = 0.4 to 1.4."""
    joint = sandwich(1.0, 0.5, 0.5, 1 / 12, cell="quadrilateral", structured=True).moved((0.4, 0.0))
    body = young(E=100.0, nu=0.25)
    return loaded(joint, lambda x, t: (0.0, 1 - x[0] ** 2), body=body, supports=WALLS, plane="axisymmetric")


@cache
def disc(eps: float) -> Structure:
    """Two round blocks with a free side, a section from the axis to r = 1, pressed most at the axis."""
    return loaded(_blocks(eps), lambda x, t: (0.0, x[0] ** 2 - 1), plane="axisymmetric")


@cache
def plated(eps: float) -> Structure:
    """Two blocks with free sides on springs, under a rigid plate that may turn."""
    parts = [Springs("BOTTOM", normal=300.0, tangential=200.0), RigidPlate("TOP", force=(0.3, -1.0), moment=0.1)]
    return Structure(_blocks(eps), body=FOURIER_BODY, supports={}, parts=parts)


@cache
def two_seams(eps: float) -> Structure:
    """Three blocks with free sides, one on the other."""
    cuts = {"LOW": ((-0.1, 0.4), (1.1, 0.4)), "HIGH": ((-0.1, 0.8), (1.1, 0.8))}
    return loaded(faults(1.0, 1.2, cuts, 1 / 8, h_S=ALONG, h_ends=min(eps / ENDS, ALONG)), (0.3, -1.0))


@cache
def heated(eps: float) -> Structure:
    """Two blocks with free sides, of which the upper one expands by a hundredth."""
    body = {"LOWER": FOURIER_BODY, "UPPER": young(E=80.0, nu=0.2)}
    return Structure(_blocks(eps), body=body, supports=CLAMPED, eigenstrain={"UPPER": 0.01})


@cache
def corner(eps: float) -> Structure:
    """A quarter of two plates, with two free sides that meet at a corner, pressed and sheared, in three dimensions."""
    joint = sandwich(1.0, 0.5, 0.5, 1 / 4, depth=DEPTH, h_S=1 / 6, h_ends=eps / 3, cell="hexahedron")
    supports = CLAMPED | {"LEFT": {"x": 0.0}, "BACK": {"z": 0.0}}
    return loaded(joint, lambda x, t: (0.2 * x[0], -1.0 + 0.5 * x[2], 0.1), supports=supports)
