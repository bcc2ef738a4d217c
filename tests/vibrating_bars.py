"""A bar of two bodies and a layer, held below, that moves along its axis alone; its frequencies in closed form."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from forms import LinearElastic
from geometry import sandwich
from thinlayer import Inertia, Structure, ThinLayer

WIDTH = 0.1
UNIFORM = {"LOWER": 1.0, "UPPER": 1.0, "S": 1.0}
SIDES = {"LEFT": {"x": 0}, "RIGHT": {"x": 0}}


def bar(
    eps=1 / 16,
    modulus=1 / 16,
    density=UNIFORM,
    heights=(0.5, 0.5),
    h=1 / 16,
    law=None,
    order=1,
    kind="interface",
    **data,
):
    """The model; bodies have the modulus 1 along the bar, the layer has `modulus`."""
    joint = sandwich(WIDTH, *heights, h, cell="quadrilateral", structured=True)
    data = {"supports": {"BOTTOM": {"y": 0}, **SIDES}, "parts": [Inertia(density)]} | data
    layer = ThinLayer(law or LinearElastic(0.0, modulus / 2), eps, order=order)
    return getattr(Structure(joint, body=LinearElastic(0.0, 0.5), **data), kind)(layer)


def frequencies(n, eps=1 / 16, modulus=1 / 16, density=UNIFORM, heights=(0.5, 0.5), exact=False):
    """Of the law with mass on S, or of the layer itself: roots of a determinant in mean and jump."""
    rho = density["S"]

    def determinant(omega):
        x = omega * eps * np.sqrt(rho / modulus) / 2
        across, along = (x / np.tan(x), x * np.tan(x)) if exact else (1 - x**2 / 3, x**2)
        k = [omega * np.sqrt(density[name]) for name in ("LOWER", "UPPER")]
        a, b = k[0] / np.tan(k[0] * heights[0]), -k[1] * np.tan(k[1] * heights[1])
        matrix = [[(a + b) / 4 + modulus / eps * across, (b - a) / 2], [(b - a) / 2, a + b - 4 * modulus / eps * along]]
        return np.linalg.det(matrix) * np.sin(k[0] * heights[0]) * np.cos(k[1] * heights[1]) * np.cos(x)

    grid = np.linspace(1e-3, 12.0, 4001)
    signs = np.sign([determinant(omega) for omega in grid])
    brackets = np.flatnonzero(signs[1:] != signs[:-1])[:n]
    return np.array([brentq(determinant, grid[i], grid[i + 1], xtol=1e-14) for i in brackets])
