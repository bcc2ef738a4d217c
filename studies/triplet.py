"""Shear test of mortar: strength of a triplet of bricks against the pressure on its beds, both models, two laws."""

from __future__ import annotations

from math import cos, radians, sin, tan
from typing import Any

import numpy as np

from forms import MohrCoulomb, MohrCoulombMonodirectional
from forms.plastic import Plastic
from geometry.joint import Joint
from geometry.seam import Seam
from studies.wall import CLAY, EPS, MORTAR
from thinlayer import LimitLoad, Structure, ThinLayer, march, plotting
from thinlayer.discretisation.model import Model
from thinlayer.running.record import Record

LENGTH, HEIGHT = 250.0, 60.0  # mm, of a brick
COHESION, ANGLE = 0.2, 35.0  # MPa, degrees
LAWS: dict[str, type[Plastic]] = {"MohrCoulomb": MohrCoulomb, "MohrCoulombMonodirectional": MohrCoulombMonodirectional}
# |shear traction| = cohesion + friction * pressure, as these laws have it under lasting shear
STRENGTHS = {
    "MohrCoulomb": (COHESION * cos(radians(ANGLE)), sin(radians(ANGLE)), "C cos(Omega) + sin(Omega) p"),
    "MohrCoulombMonodirectional": (COHESION, tan(radians(ANGLE)), "C + tan(Omega) p"),
}
LOADED = (0.5, 0.8, 0.95, 1.1)  # ends of steps, over the strength
PRESSURES = (0.2, 0.4, 0.6, 0.8)  # MPa; below, the push bends the triplet, and ends of beds are pulled apart
MODELS = {"S": "interface law", "meshed": "meshed beds"}


def run(record: Record, *, quick: bool = False) -> None:
    """Press three bricks together and push the middle one out, harder and harder; its neighbours are held at the far end.

    Both models have the strength of a uniformly sheared layer, wherever pressure and shear concentrate: in the end all of
    the bed is at its limit. In the meshed model beds are one row of cells of degree 1, which stiff bricks strain
    uniformly; with nodes inside, their free ends are squeezed out first.

    Args:
        record: where to write.
        quick: coarser mesh, fewer pressures.
    """
    h, pressures = (30.0, PRESSURES[1::2]) if quick else (15.0, PRESSURES)
    table = record.table("table.csv")
    for name, (cohesion, friction, _) in STRENGTHS.items():
        for p in pressures:
            strength = cohesion + friction * p
            row: dict[str, str | float] = {"law": name, "pressure_MPa": p, "formula_MPa": strength}
            for kind in MODELS:
                limit = pushed(sheared(LAWS[name], p, h, kind), strength)
                record.solved(limit.history.last)
                row |= {f"{kind}_MPa": limit.t, f"{kind}_failed_MPa": limit.failed_at}
                record.check(f"{name}, {kind}, {p:g} MPa: carried, over the formula", limit.t / strength, low=0.995)
                record.check(f"{name}, {kind}, {p:g} MPa: not carried", limit.failed_at / strength, high=1.005)
            table.append(row)


def stack(courses: int, h: float, length: float = LENGTH, height: float = HEIGHT) -> Joint:
    """Bricks one on another, "LOWER", "MIDDLE" and "UPPER" of three; their beds are one seam, "BED"."""
    nx, ny = round(length / h), round(height / h)
    x, y = np.linspace(0.0, length, nx + 1), np.linspace(0.0, courses * height, courses * ny + 1)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    node = np.arange(len(points)).reshape(len(y), len(x))
    cells = np.stack([node[:-1, :-1], node[:-1, 1:], node[1:, :-1], node[1:, 1:]], axis=-1).reshape(-1, 4)
    rows, columns = (np.stack([line[:, :-1], line[:, 1:]], axis=-1) for line in (node, node.T))
    facets = {"BED": rows[ny:-1:ny].reshape(-1, 2), "BOTTOM": rows[0], "TOP": rows[-1]}
    facets |= {"LEFT": columns[0], "RIGHT": columns[-1]}
    names = ("LOWER", "MIDDLE", "UPPER") if courses == 3 else tuple(f"BRICK {k + 1}" for k in range(courses))
    region = np.repeat(np.arange(courses), nx * ny)
    return Joint(points, cells, "quadrilateral", region, names, facets, {"BED": Seam(direction=(0.0, 1.0))})


def sheared(law: type[Plastic], pressure: float, h: float, kind: str) -> Model:
    """A triplet whose middle brick is pushed so that the mean shear traction on both beds is t, in MPa."""
    bed = ThinLayer(law(MORTAR.lmbda, MORTAR.mu, cohesion=COHESION, friction_angle=ANGLE), EPS)
    supports = {"BOTTOM": {"y": 0.0}, "RIGHT/LOWER": {"x": 0.0}, "RIGHT/UPPER": {"x": 0.0}}
    tractions: dict[str, Any] = {"TOP": (0.0, -pressure), "LEFT/MIDDLE": lambda x, t: (2 * LENGTH / HEIGHT * t, 0.0)}
    structure = Structure(stack(3, h), body=CLAY, supports=supports, tractions=tractions, element="Q1")
    return structure.interface(bed) if kind == "S" else structure.full(bed, cells_through=1)


def pushed(model: Model, strength: float) -> LimitLoad:
    """Where no equilibrium is left."""
    try:
        march(model, [share * strength for share in LOADED])
    except LimitLoad as limit:
        return limit
    raise AssertionError("the triplet has no limit")


def draw(record: Record) -> None:
    """Draw strengths against pressure from table.csv."""
    lines, styles = {}, {}
    for name, part in record.load("table.csv").split("law").items():
        cohesion, friction, formula = STRENGTHS[name]
        p = np.array([0.0, part["pressure_MPa"].max()])
        lines[formula] = p, cohesion + friction * p
        for (kind, model), marker in zip(MODELS.items(), "sx", strict=True):
            lines[f"{name}, {model}"] = part["pressure_MPa"], part[f"{kind}_MPa"]
            styles[f"{name}, {model}"] = marker
    xlabel, ylabel = "pressure on the beds (MPa)", "mean shear traction at the limit (MPa)"
    title, save = "a triplet of bricks pushed to its limit", record.path("strength.png")
    plotting.curves(lines, xlabel, ylabel, title=title, styles=styles, save=save)
