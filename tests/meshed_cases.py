"""Meshed networks of layers beside their interface models."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.spatial import cKDTree

from forms import LinearElastic, MohrCoulomb
from geometry import wall
from geometry.joint import Joint
from geometry.seam import Seam
from geometry.topology import FacetTable
from tests.network_cases import cell_of, springs
from thinlayer import Gap, Structure, Surface, ThinLayer, solve

SHARES = {"BED": 1.0, "HEAD": 0.7}  # thickness of the layers of the panel over eps
DISTANCE = 0.15  # from junctions and free ends, of the inner part of S


def mortar(eps: float, **layers: ThinLayer | Gap | None) -> dict[str, ThinLayer | Gap | None]:
    """The layers of the panel."""
    return {"BED": springs(2.0, 0.7, eps), "HEAD": springs(1.2, 0.45, SHARES["HEAD"] * eps)} | layers


@cache
def bricks(cell: str, h: float) -> Joint:
    return wall(2, 2, (1.0, 0.5), h, cell=cell)


@cache
def panel(element: str, h: float = 0.125) -> Structure:
    """Two courses, whose top is shifted up to t = 1."""
    joint = bricks(cell_of(element), h)
    supports = {"BOTTOM": 0.0, "TOP": {"x": lambda x, t: 0.01 * t, "y": lambda x, t: -0.02 * t}}
    return Structure(joint, body=LinearElastic.young(1.0, 0.2), supports=supports, element=element)


def inner(surface: Surface, distance: float = DISTANCE):
    """True on S further than a distance from junctions and free ends."""
    joint = surface.joint
    on_s = np.unique(joint.surface)
    outer = np.unique(joint.table.vertices[joint.table.cells[:, 1] < 0])
    special = on_s[(joint.split_mesh.component_counts[on_s] > 2) | np.isin(on_s, outer)]
    return cKDTree(joint.points[special]).query(np.moveaxis(surface.x, 0, -1))[0] > distance


def jump_errors(element: str, sizes, **choices) -> np.ndarray:
    """(sizes, 2) errors of the jump of the interface model against meshed layers, on all of S and on its inner part."""
    structure = panel(element)
    limit = structure.interface(mortar(0.01))
    surface, rows = Surface(limit), []
    by_law = surface.jump(solve(limit, 1.0))
    for eps in sizes:
        w = surface.jump(solve(structure.full(mortar(eps), **choices), 1.0))
        rows.append([surface.norm(w - by_law, part) / surface.norm(by_law, part) for part in (1, inner(surface))])
    return np.array(rows)


def yielding(eps: float) -> dict[str, ThinLayer]:
    """Mortar that is elastic in the beds and yields in the heads."""
    law = MohrCoulomb(0.3, 0.45, cohesion=2e-4, friction_angle=30.0)
    return mortar(eps, HEAD=ThinLayer(law, SHARES["HEAD"] * eps, at=1.0))


def star(angles, cell: str, n: int = 4) -> Joint:
    """A disc of radius 1, cut along rays at these angles, in degrees; seams L0, L1, ... and bodies B0, B1, ... between."""
    ends = np.radians([*angles, angles[0] + 360.0])
    steps = np.maximum(2, 2 * np.rint(np.diff(ends) / np.radians(30)).astype(int))
    parts = [np.linspace(a, b, k + 1)[:-1] for a, b, k in zip(ends, ends[1:], steps, strict=False)]
    turn, body = np.concatenate(parts), np.repeat(np.arange(len(angles)), steps)
    m, radius = len(turn), np.linspace(0.0, 1.0, n + 1)[1:]
    around = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    points = np.concatenate([[[0.0, 0.0]], (radius[:, None, None] * around).reshape(-1, 2)])
    node = 1 + np.arange(n * m).reshape(n, m)
    on = np.roll(node, -1, axis=1)
    rows = np.stack([node[:-1], node[1:], on[:-1], on[1:]], axis=-1).reshape(-1, 4)
    region = [np.tile(body, n - 1)]
    if cell == "quadrilateral":
        first = np.arange(0, m, 2)
        middle = np.stack([0 * first, node[0, first], node[0, (first + 2) % m], node[0, first + 1]], axis=1)
        cells, region = np.concatenate([rows, middle]), np.concatenate([*region, body[first]])
    else:
        middle = np.stack([0 * node[0], node[0], on[0]], axis=1)
        cells = np.concatenate([rows[:, [0, 1, 3]], rows[:, [0, 3, 2]], middle])
        region = np.concatenate([*region, *region, body])
    rays = np.concatenate([[0], np.cumsum(steps)[:-1]])
    facets = {f"L{k}": np.column_stack([[0, *node[:-1, ray]], node[:, ray]]) for k, ray in enumerate(rays)}
    table = FacetTable.of(cells, cell)
    facets["RIM"] = table.vertices[table.cells[:, 1] < 0]
    names, seams = tuple(f"B{k}" for k in range(len(angles))), {name: Seam() for name in facets if name != "RIM"}
    return Joint(points, cells, cell, region, names, facets, seams)
