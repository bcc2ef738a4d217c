"""mpirun -n N python3 -m tests.meshed_cases3d: meshed networks of layers in 3D beside their interface models."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import ufl
from mpi4py import MPI

from forms import LinearElastic
from geometry import Joint, Seam
from geometry.topology import FacetTable
from tests.meshed_cases import star
from tests.meshes import grid
from tests.network_cases import square
from thinlayer import Structure, Surface, ThinLayer, UflPart, solve

THICK = {"X": 0.7, "Y": 1.0, "Z": 1.3}  # of the layers of the cube over eps
LAW = {"X": (0.3, 0.45), "Y": (0.6, 0.7), "Z": (0.4, 0.5)}  # their lmbda and mu per thickness
SIDES = ("LEFT", "RIGHT", "BOTTOM", "TOP", "BACK", "FRONT")
BLOCKS = {  # the block of each octant of the cube (-1, 1)^3, from its signs 0 or 1
    "T": lambda x, y, z: np.where(y == 0, 0, 1 + x),
    "X": lambda x, y, z: x + 2 * y,
    "T x collar": lambda x, y, z: np.where(y == 0, 0, 1 + x) + 3 * z,
    "staggered": lambda x, y, z: np.where(y == 0, 0, 1 + x * (z == 0)) + 3 * z,
    "octants": lambda x, y, z: x + 2 * y + 4 * z,
}


@cache
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


def parted(whole: Joint, region: np.ndarray) -> Joint:
    """A mesh with S between all cells of different regions; the outer facets are OUT."""
    table = whole.table
    first, second = table.cells.T
    cut = (second >= 0) & (region[first] != region[second])
    facets = {"S": table.vertices[cut], "OUT": table.vertices[second < 0]}
    names = tuple(f"B{k}" for k in range(region.max() + 1))
    return Joint(whole.points, whole.cells, whole.cell_type, region, names, facets, {"S": Seam()})


def half_star(cell: str, collar: bool) -> Joint:
    """Three wedges of a half-cylinder about the z axis, |z| < 1, that meet on the axis in its flat side x = 0.

    Seams R between them and, where there is a collar, Z at z = 0; facets SIDE on the flat side and RIM elsewhere.
    """
    flat = star((-90, -45, 45, 90), "triangle" if cell == "tetrahedron" else "quadrilateral")
    n, z = len(flat.points), np.linspace(-1.0, 1.0, 5)
    points = np.column_stack([np.tile(flat.points, (5, 1)), np.repeat(z, n)])
    rows = flat.cells[flat.region != 3]
    body, at = np.tile(flat.region[flat.region != 3], 4), np.repeat(np.arange(4), len(rows))
    low = np.tile(rows, (4, 1)) + at[:, None] * n
    if cell == "tetrahedron":  # prisms, split in the order of their vertices
        low = np.sort(low, axis=1)
        cells = np.concatenate([np.column_stack([low[:, : k + 1], low[:, k:] + n]) for k in range(3)])
        body, at = np.tile(body, 3), np.tile(at, 3)
    else:
        cells = np.column_stack([low, low + n])
    used, cells = np.unique(cells, return_inverse=True)
    points, cells = points[used], cells.reshape(len(body), -1)
    region = body + 3 * collar * (at > 1)
    table = FacetTable.of(cells, cell)
    first, second = table.cells.T
    cut, x = (second >= 0) & (region[first] != region[second]), points[table.vertices]
    across = np.ptp(x[..., 2], axis=1) < 1e-12
    side = (second < 0) & (np.abs(x[..., 0]) < 1e-12).all(axis=1)
    facets = {"R": table.vertices[cut & ~across], "SIDE": table.vertices[side]}
    facets["RIM"] = table.vertices[(second < 0) & ~side]
    seams = {"R": Seam()}
    if collar:
        facets["Z"], seams["Z"] = table.vertices[cut & across], Seam(direction=(0.0, 0.0, 1.0))
    return Joint(points, cells, cell, region, tuple(f"B{k}" for k in range(region.max() + 1)), facets, seams)


def thickness(base: Joint, eps: float) -> dict[str, float]:
    """Of each seam of a cube."""
    return {name: THICK[name] * eps for name in base.seams}


def mortar(base: Joint, eps: float) -> dict[str, ThinLayer]:
    """The layer of each seam of a cube."""
    return {name: ThinLayer(LinearElastic(*LAW[name]), one) for name, one in thickness(base, eps).items()}


@cache
def sheared(element: str, m: int, kind: str = "T", parts: tuple[UflPart, ...] = ()) -> Structure:
    """A cube whose top is shifted."""
    return Structure(
        cube(kind, "tetrahedron" if element[0] == "P" else "hexahedron", m),
        body=LinearElastic.young(1.0, 0.2),
        supports={"BOTTOM": 0.0, "TOP": {"x": 0.01, "y": -0.02, "z": 0.005}},
        element=element,
        parts=parts,
    )


def jump_errors(element: str, sizes, m: int = 4, parts=(), **choices) -> np.ndarray:
    """(sizes,) errors of the jump of the interface model against meshed layers, .3 away from junctions and the outside."""
    structure = sheared(element, m)
    limit = structure.interface(mortar(structure.joint, 0.01))
    surface, state, x = Surface(limit), solve(limit), ufl.SpatialCoordinate(limit.domain.mesh)
    inner = ufl.conditional(ufl.gt(x[0] ** 2 + x[1] ** 2, 0.09), 1.0, 0.0)
    for k in range(3):
        inner *= ufl.conditional(ufl.lt(abs(x[k]), 0.7), 1.0, 0.0)
    whole, errors = surface.norm(surface.jump(state), inner), []
    for eps in sizes:
        full = sheared(element, m, parts=parts).full(
            mortar(structure.joint, eps), cells_through=2, **{"bodies": "extended"} | choices
        )
        difference = surface.displacement(solve(full)).copy()
        difference.x.array[:] -= state.u.x.array
        errors.append(surface.norm(surface.sides.jump(difference), inner) / whole)
    return np.array(errors)


def main() -> None:
    """Print the numbers as JSON."""
    found = {}
    for element in ("Q2", "P2"):
        structure = sheared(element, 2)
        state = solve(structure.full(mortar(structure.joint, 0.02), bodies="extended", cells_through=2))
        found[element] = [*list(state.energies().values())[:2], square(state)]
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))


if __name__ == "__main__":
    main()
