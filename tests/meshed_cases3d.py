"""mpirun -n N python3 -m tests.meshed_cases3d: meshed networks of layers in 3D beside their interface models."""

from __future__ import annotations

import numpy as np

from geometry import Joint, Seam
from geometry.topology import FacetTable
from tests.meshes import grid

SIDES = ("LEFT", "RIGHT", "BOTTOM", "TOP", "BACK", "FRONT")
BLOCKS = {  # the block of each octant of the cube (-1, 1)^3, from its signs 0 or 1
    "T": lambda x, y, z: np.where(y == 0, 0, 1 + x),
    "X": lambda x, y, z: x + 2 * y,
    "T x collar": lambda x, y, z: np.where(y == 0, 0, 1 + x) + 3 * z,
    "staggered": lambda x, y, z: np.where(y == 0, 0, 1 + x * (z == 0)) + 3 * z,
    "octants": lambda x, y, z: x + 2 * y + 4 * z,
}


def cube(kind: str, cell: str, m: int = 4) -> Joint:
    """A cube of m^3 cells or 6 m^3, cut into blocks along x = 0, y = 0, z = 0: seams X, Y, Z."""
    axis = np.linspace(-1.0, 1.0, m + 1)
    whole = grid([axis] * 3, lambda x: x[:, 1] > 0, cell)
    region = BLOCKS[kind](*(whole.points[whole.corners].mean(axis=1) > 0).astype(int).T)
    region = np.unique(region, return_inverse=True)[1]
    table = FacetTable.of(whole.cells, cell)
    first, second = table.cells.T
    cut = (second >= 0) & (region[first] != region[second])
    x = whole.points[table.vertices]
    flat = [np.ptp(x[..., k], axis=1) < 1e-12 for k in range(3)]
    facets = {name: table.vertices[cut & flat[k]] for k, name in enumerate("XYZ") if (cut & flat[k]).any()}
    seams = {name: Seam(direction=tuple(np.eye(3)["XYZ".index(name)])) for name in facets}
    for k, (low, high) in enumerate(zip(SIDES[::2], SIDES[1::2], strict=True)):
        facets |= {name: table.vertices[flat[k] & (x[:, 0, k] == at)] for name, at in ((low, -1.0), (high, 1.0))}
    names = tuple(f"BLOCK {k + 1}" for k in range(region.max() + 1))
    return Joint(whole.points, whole.cells, cell, region, names, facets, seams)
