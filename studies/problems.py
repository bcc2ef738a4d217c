"""Structures that several studies solve."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import ufl

from forms import LinearElastic
from geometry import Joint, block, sandwich
from thinlayer import piecewise

FOURIER_BODY = LinearElastic.young(E=100.0, nu=0.3)
FOURIER_LAYER = LinearElastic(lmbda=60.0, mu=40.0)
BAR = LinearElastic.young(E=130e3, nu=0.2)  # MPa, section 8.2 of the paper


def fourier(h: float, *, cell: str = "triangle") -> tuple[Joint, dict[str, Any]]:
    """Two blocks, 1 wide and 0.5 high, under a traction with one half-wave; its solution is a single Fourier mode.

    The lower side is clamped, the lateral sides (the layer's too) are on rollers, the upper side carries
    (sin(pi x)/2, cos(pi x)). Without units. The bodies have E = 100 and nu = 0.3.

    Args:
        h: cell size; the mesh is a grid.
        cell: "triangle" or "quadrilateral".

    Returns:
        The joint, and the data of its models without their layer.
    """
    joint = sandwich(1.0, 0.5, 0.5, h, cell=cell, structured=True)
    supports = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    tractions = {"TOP": lambda x, t: (0.5 * ufl.sin(ufl.pi * x[0]), ufl.cos(ufl.pi * x[0]))}
    return joint, {"body": FOURIER_BODY, "supports": supports, "tractions": tractions}


def pressed(h: float, path: Mapping[Any, tuple[float, float, float]]) -> tuple[Joint, dict[str, Any]]:
    """Two blocks, 2 wide and 0.5 high, pressed together more at one end than at the other, and sheared.

    The lower side is clamped, the lateral sides (the layer's too) are on rollers, so that nothing is singular at the ends
    of S; the upper side carries (q sin(pi x/2), -p - r cos(pi x/2)). Without units. The bodies have E = 100 and nu = 0.3.
    Through a layer of `FOURIER_LAYER` S would carry the pressure p + (0.88 r - 0.36 q) cos(pi x/2) and the shear
    (0.13 r + 0.08 q) sin(pi x/2).

    Args:
        h: cell size; the mesh is a grid of squares.
        path: time -> p, r and q, linear in between.

    Returns:
        The joint, and the data of its models without their layer.
    """
    joint = sandwich(2.0, 0.5, 0.5, h, cell="quadrilateral", structured=True)
    loads = piecewise(path)

    def top(x: Any, t: Any) -> tuple[Any, Any]:
        p, r, q = loads(x, t)
        return q * ufl.sin(ufl.pi * x[0] / 2), -p - r * ufl.cos(ufl.pi * x[0] / 2)

    supports = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    return joint, {"body": FOURIER_BODY, "supports": supports, "tractions": {"TOP": top}}


def sliding_bar(n: int, *, depth: bool = False, arrangement: str = "Right") -> tuple[Joint, dict[str, Any]]:
    """The bar of Fig. 7: a square of 40 mm, in plane strain, pushed along a rigid base AB by 100 MPa and onto it by 50 MPa.

    u_1 = 0 on the right side, and its lower corner B does not move. With a depth it is a cube, its back side on rollers,
    without the held corner.

    Args:
        n: squares along each side; S has n + 1 nodes along x.
        depth: whether it is a cube.
        arrangement: which diagonals halve the squares.

    Returns:
        The joint, and the data of its models without their layer.
    """
    side = 40.0
    joint = block(side, side, side / n, structured=True, arrangement=arrangement, depth=side if depth else None)
    supports: dict[Any, Any] = {"RIGHT": {"x": 0.0}}
    supports |= {"BACK": {"z": 0.0}} if depth else {(side, 0.0): 0.0}
    zero = (0.0,) if depth else ()
    loads = {"LEFT": (100.0, 0.0, *zero), "TOP": (0.0, -50.0, *zero)}
    return joint, {"body": BAR, "supports": supports, "tractions": loads, "element": "P1"}
