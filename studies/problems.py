"""Structures that several studies solve."""

from __future__ import annotations

from typing import Any

import ufl

from forms import LinearElastic
from geometry import Joint, sandwich

FOURIER_BODY = LinearElastic.young(E=100.0, nu=0.3)
FOURIER_LAYER = LinearElastic(lmbda=60.0, mu=40.0)


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
