"""Joints as they are built: a glued shaft and hub, a masonry arch, two cylinders glued end to end; in mm or m, and MPa."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl

from forms import LinearElastic
from geometry import Joint, disc, read, ring, sandwich
from studies.sweeping import Solution, last, layer_of
from thinlayer import State, Structure, Surface, solve

Array = npt.NDArray[Any]

young = LinearElastic.young
STEEL, ALUMINIUM, STONE = young(E=210e3, nu=0.3), young(E=70e3, nu=0.33), young(E=20e3, nu=0.2)
GLUE, GLUE_EPS = young(E=2e3, nu=0.4), 0.2  # 2 GPa where the layer is 0.2 mm thick
MORTAR, MORTAR_EPS = young(E=1e3, nu=0.2), 0.01  # 1 GPa where joints are 10 mm thick
RADII = (10.0, 15.0, 20.0)  # mm: inside of the shaft, S, outside of the hub
MESH = Path(__file__).parent / "data" / "arch.msh"  # curved cells; arch.geo is its drawing
WEIGHT = (0.0, -0.025)  # MN/m^3
ARCH_RADIUS, MIDDLE = 1.15, 0.1  # m: joints are measured over the middle two thirds of their length
RADIUS, HEIGHT = 12.0, 10.0  # mm: of each cylinder
STRESS, BENDING = 20.0, 30.0  # MPa: mean, and at the edge


def glued_hub(h: float) -> tuple[Joint, dict[str, Any]]:
    """A hollow shaft, held inside, glued into a hub that is pushed down on its upper half; joint, data of its models."""
    return ring(*RADII, h=h, cell="quadrilateral", degree=2), {
        "body": {"INNER": STEEL, "OUTER": ALUMINIUM},
        "supports": {"INSIDE": 0.0},
        "tractions": {"OUTSIDE": lambda x, t: (0.0, -ufl.conditional(x[1] > 0, 10.0 * x[1] / RADII[2], 0.0))},
    }


def arch(element: str) -> tuple[Joint, dict[str, Any]]:
    """Five stones, from a mesh file, under their weight and a load on the right half; all four joints are one S."""
    return read(MESH, S="JOINTS", lower="ODD STONES", upper="EVEN STONES"), {
        "body": STONE,
        "supports": {"SPRINGINGS": 0.0},
        "tractions": {"EXTRADOS": lambda x, t: (0.0, ufl.conditional(x[0] > 0, -0.4, -0.1))},
        "body_force": WEIGHT,
        "element": element,
    }


def inside_joints(x: Array) -> Array:
    """Away from the ends of the arch's joints."""
    return abs(np.sqrt(x[0] ** 2 + x[1] ** 2) - ARCH_RADIUS) < MIDDLE


def rods(sizes: tuple[float, float]) -> tuple[Joint, dict[str, Any]]:
    """Two cylinders, glued end to end, under tension and bending; sizes of cells inside and on S.

    Bending opens one half of S as much as it closes the other: means over S and over the top are those of tension, which
    the section through the axis has too.
    """
    return disc(RADIUS, HEIGHT, HEIGHT, sizes[0], h_S=sizes[1], cell="hexahedron", degree=2), {
        "body": STEEL,
        "supports": {"BOTTOM": 0.0},
        "tractions": {"TOP": lambda x, t: (0.0, STRESS + BENDING * x[0] / RADIUS, 0.0)},
    }


def inside_rods(x: Array) -> Array:
    """Away from the edge, where the layer's free side disturbs."""
    return _radius(x) < 0.75 * RADIUS


def _radius(x: Array) -> Array:
    return np.sqrt(sum(x[k] ** 2 for k in (0, 2)[: len(x) - 1]))


def against_section(full: Solution, limit: Solution) -> dict[str, float]:
    """Mean rise of the top (mm) and mean normal traction (MPa), in 3D and in the section through the axis.

    The mean is weighted with 1 - r^2/R^2, because equilibrium gives the plain one. In the section x = r, y is the axis.
    """
    layer = layer_of(limit)
    section = sandwich(RADIUS, HEIGHT, HEIGHT, 2.0, h_S=0.8, h_ends=0.3)
    load = {"TOP": (0.0, STRESS)}
    tension = Structure(section, body=STEEL, supports={"BOTTOM": 0.0}, tractions=load, plane="axisymmetric")
    limit_there = solve(tension.interface(layer))
    found = {}
    for name, state, there in (("meshed", full, solve(tension.full(layer))), ("law", limit, limit_there)):
        for where, one, surface in (
            ("", last(state), Surface(last(limit).model)),
            ("_axisymmetric", there, Surface(limit_there.model)),
        ):
            found[f"rise_{name}{where}"] = _rise(one)
            part = 1 - _radius(surface.x) ** 2 / RADIUS**2
            normal = surface.frame(surface.traction(one))[-1]
            found[f"traction_{name}{where}"] = surface.integral(part * normal) / surface.integral(part)
    return found


def _rise(state: State) -> float:
    top = state.model.ds(state.model.domain.values("TOP"))
    return state.integral(state.u[1] * top) / (math.pi * RADIUS**2)
