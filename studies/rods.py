"""Row of the study `rates` on two cylinders, glued end to end, in 3D and in an axisymmetric section."""

from __future__ import annotations

import math

import numpy as np

from forms.base import Array
from geometry import disc, sandwich
from geometry.topology import BoolArray
from studies.problems import STEEL, Problem
from studies.sweeping import Tables, end_state, layer_of
from thinlayer import Structure, Surface, solve
from thinlayer.running.record import Record
from thinlayer.solving.history import Solution

RADIUS, HEIGHT = 12.0, 10.0  # mm: of each cylinder
STRESS, BENDING = 20.0, 30.0  # MPa: mean, and at the edge
SECTION_RTOL = 0.01  # relative difference of means in three dimensions and in the axisymmetric section


def rods(sizes: tuple[float, float]) -> Problem:
    """Two cylinders, glued end to end, under tension and bending, in 3D.

    Bending opens one half of S as much as it closes the other half. Means over S and over the top are therefore equal
    to the means under tension alone, which the section through the axis gives, too.

    Args:
        sizes: sizes of cells inside and on S, mm.

    Returns:
        The joint, and the arguments of its `Structure`.
    """
    tractions = {"TOP": lambda x, t: (0.0, STRESS + BENDING * x[0] / RADIUS, 0.0)}
    joint = disc(RADIUS, HEIGHT, HEIGHT, sizes[0], h_S=sizes[1], cell="hexahedron", degree=2)
    return joint, {"body": STEEL, "supports": {"BOTTOM": 0.0}, "tractions": tractions}


def is_inside_rods(x: Array) -> BoolArray:
    """Return a mask of the points of S away from the layer's free end, within 3/4 of the radius.

    `x` are coordinates, mm, with the components on the first axis; the mask has the shape of x[0].
    """
    return _radius(x) < 0.75 * RADIUS


def _radius(x: Array) -> Array:
    return np.asarray(np.sqrt(sum(x[k] ** 2 for k in (0, 2)[: len(x) - 1])))


def section_means(full: Solution, limit: Solution) -> dict[str, float]:
    """Compare the cylinders in 3D with an axisymmetric section of them, which is solved here.

    The mean traction is weighted with 1 - r^2/R^2 at the distance r from the axis, with the radius R. Equilibrium alone
    would determine the plain mean. In the section x is the radius, and y the axis.

    Args:
        full: solution in 3D with the meshed layer ("meshed").
        limit: solution in 3D with the interface law ("law").

    Returns:
        "rise_MODEL" -> mean displacement of the top along the axis, mm; "traction_MODEL" -> mean normal traction, MPa.
        "rise_MODEL_axisymmetric" and "traction_MODEL_axisymmetric" are those of the section.
    """
    layer = layer_of(limit)
    section, load = sandwich(RADIUS, HEIGHT, HEIGHT, 2.0, h_S=0.8, h_ends=0.3), {"TOP": (0.0, STRESS)}
    structure = Structure(section, body=STEEL, supports={"BOTTOM": 0.0}, tractions=load, plane="axisymmetric")
    law_2d, means = solve(structure.interface(layer)), {}
    for name, state, axi in (("meshed", full, solve(structure.full(layer))), ("law", limit, law_2d)):
        for suffix, end, model in ("", end_state(state), end_state(limit).model), ("_axisymmetric", axi, law_2d.model):
            surface = Surface(model)
            top = end.model.ds(end.model.domain.values("TOP"))
            means[f"rise_{name}{suffix}"] = end.integral(end.u[1] * top) / (math.pi * RADIUS**2)
            weight, normal = 1 - _radius(surface.x) ** 2 / RADIUS**2, surface.frame(surface.traction(end))[-1]
            means[f"traction_{name}{suffix}"] = surface.integral(weight * normal) / surface.integral(weight)
    return means


def check_section(record: Record, tables: Tables) -> None:
    """Check that means in 3D are equal to those in the axisymmetric section, to 1 %.

    Args:
        record: record of the run, which receives the checks.
        tables: name of a `Sweep` of the study `rates` -> its table, with a line for each thickness.
    """
    for name in (f"{what}_{model}" for what in ("rise", "traction") for model in ("meshed", "law")):
        difference = np.abs(tables["butt_joint"][name] / tables["butt_joint"][f"{name}_axisymmetric"] - 1).max()
        record.check(f"{name} in 3D against the axisymmetric section", difference, high=SECTION_RTOL)
