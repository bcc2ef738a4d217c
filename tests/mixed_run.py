"""Mixed models of plane and solid blocks, and of bricks."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from forms import LinearElastic
from geometry import block, sandwich, wall
from thinlayer import Structure, Surface, ThinLayer, solve

BODY, LAYER = LinearElastic.young(E=100.0, nu=0.3), LinearElastic.shear(40.0, 0.3)
EPS = 1 / 8


def near_ends(x):
    return abs(x[0] - 0.5) > 0.5 - 2 * EPS


def plane(cell: str) -> Structure:
    joint = sandwich(1.0, 0.5, 0.4, h=1 / 4, h_S=1 / 16, cell=cell)
    return Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.3, -1.0)})


def space(cell: str) -> Structure:
    """Rollers hold nodes at the cuts, too."""
    joint = sandwich(1.0, 0.4, 0.3, depth=0.25, h=1 / 4, cell=cell)
    supports = {"BOTTOM": 0.0, "FRONT": {"z": 0.0}, "BACK": {"z": 0.0}}
    return Structure(joint, body=BODY, supports=supports, tractions={"TOP": (0.3, -1.0, 0.1)})


def on_base() -> Structure:
    joint = block(1.0, 0.5, h=1 / 4, h_S=1 / 16, cell="triangle")
    return Structure(joint, body=BODY, supports={}, tractions={"TOP": (0.3, -1.0)})


BRICKS, HEADS = 1 / 16, 0.7  # thickness of beds, over the length of bricks; of heads, over that of beds


def bricks(h: float) -> Structure:
    joint = wall(2, 2, (1.0, 0.5), h=h)
    return Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.3, -1.0)})


def mortar(order: int, eps: float = BRICKS) -> dict[str, ThinLayer]:
    return {
        "BED": ThinLayer(LAYER, eps, order=order, at=1.0),
        "HEAD": ThinLayer(LAYER, HEADS * eps, order=order, at=1.0),
    }


def near_junctions(structure: Structure, distance: float):
    """Within a distance of junctions and of free ends."""
    joint = structure.joint
    on_s = np.unique(joint.surface)
    outer = np.unique(joint.table.vertices[joint.table.cells[:, 1] < 0])
    special = joint.points[on_s[(joint.splitting.valence[on_s] > 2) | np.isin(on_s, outer)]]
    return lambda x: cKDTree(special).query(x.T)[0] < distance


def numbers() -> dict[str, float]:
    found: dict[str, float] = {}
    for structure, bodies in (
        (plane("triangle"), "kept"),
        (plane("quadrilateral"), "extended"),
        (space("hexahedron"), "kept"),
    ):
        layer = ThinLayer(LAYER, EPS, order=1, at=1.0)
        model = structure.mixed(layer, where=near_ends, bodies=bodies.replace("space", "kept"), cells_through=2)
        state, surface = solve(model), Surface(model)
        name = structure.joint.cell_type
        held = sum(one.force for one in state.reactions_by_place().values())
        found |= {
            f"{name} loads": state.energies()["loads"],
            f"{name} layer": state.energies()["layer"],
            f"{name} bodies": state.energies()["bodies"],
            f"{name} traction": surface.norm(surface.traction(state)),
            f"{name} jump": surface.norm(surface.jump(state)),
            f"{name} unbalanced": float(np.abs(held + state.applied().force).max()),
        }
    return found
