"""Networks with known numbers, which an independent program has found."""

from __future__ import annotations

import numpy as np

from forms import HolonomicCoulomb, LinearElastic
from geometry import wall
from geometry.joint import Joint
from geometry.seam import Seam
from geometry.topology import FacetTable
from thinlayer import Structure, ThinLayer, solve

WALL = {"P1": 0.011796375720487, "P2": 0.011640644960255, "Q1": 0.011718794213387, "Q2": 0.011631044498488}
PANEL = {"P2": 0.00029830576641769, "Q2": 0.00029827111412196}
YIELDED = {"P2": (0.000297263054, 6.1261783e-7), "Q2": (0.000297225625, 6.1393934e-7)}  # stored, dissipated
PUSHED = {("triangle", 0.6): 0.14971313219837, ("triangle", -0.6): 0.21456359531576}  # |u|^2


def springs(K_N: float, K_T: float, eps: float = 0.01) -> ThinLayer:
    """A layer whose law on S is that of springs."""
    return ThinLayer(LinearElastic(K_N - 2 * K_T, K_T), eps, at=1.0)


def cell_of(element: str) -> str:
    return "triangle" if element[0] == "P" else "quadrilateral"


def wall_energy(element: str, joint: Joint | None = None) -> float:
    """Energy of a wall of 14 bricks under a shift of its top."""
    joint = joint or wall(3, 4, (1.0, 0.5), 0.25, cell=cell_of(element))
    supports = {"BOTTOM": 0.0, "TOP": {"x": 0.1, "y": -0.05}}
    bricks = Structure(joint, body=LinearElastic.young(20.0, 0.2), supports=supports, element=element)
    energies = solve(bricks.interface({"BED": springs(5.0, 2.1), "HEAD": springs(3.0, 1.3)})).energies()
    return energies["bodies"] + energies["layer"]


def three_bricks(m: int, cell: str, cross: bool = False) -> Joint:
    """Two bricks 1 x .5 on one of 2 x .5, or on two; m cells along their height."""
    grid = wall(2, 2, (1.0, 0.5), 0.5 / m, cell=cell)
    x = grid.points[grid.corners].mean(axis=1)
    region = np.where(x[:, 1] < 0.5, (x[:, 0] > 1) * 3 * cross, 1 + (x[:, 0] > 1))
    table = FacetTable.of(grid.cells, cell)
    first, second = table.cells.T
    cut = (second >= 0) & (region[first] != region[second])
    upright = np.ptp(grid.points[table.vertices][..., 0], axis=1) < 1e-12
    middle = grid.points[table.vertices].mean(axis=1)
    facets = {"BED": table.vertices[cut & ~upright], "HEAD": table.vertices[cut & upright]}
    facets["LEFT"] = table.vertices[(second < 0) & (middle[:, 0] < 1e-9) & (middle[:, 1] > 0.5)]
    facets |= {name: grid.facets[name] for name in ("BOTTOM", "TOP")}
    seams = {"BED": Seam(direction=(0.0, 1.0)), "HEAD": Seam(direction=(1.0, 0.0))}
    names = ("FOOT", "LEFT BRICK", "RIGHT BRICK", "RIGHT FOOT")[: 3 + cross]
    return Joint(grid.points, grid.cells, cell, region, names, facets, seams)


def pushed(joint: Joint, push: float, layer):
    """The state of three bricks under a pressure of 1 and a push on the upper left one."""
    data = {"supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.0, -1.0), "LEFT": (push, 0.0)}}
    data["element"] = "P1" if joint.cell_type == "triangle" else "Q1"
    return solve(Structure(joint, body=LinearElastic.young(50.0, 0.2), **data).interface(layer))


def square(state) -> float:
    """Sum of the squares of all displacements."""
    dofmap = state.u.function_space.dofmap
    owned = state.u.x.array[: dofmap.index_map.size_local * dofmap.index_map_bs]
    return float(state.model.comm.allreduce(float(owned @ owned)))


BED = HolonomicCoulomb(K_N=200.0, K_T=80.0, friction=0.5)
HEAD = HolonomicCoulomb(K_N=100.0, K_T=40.0, friction=0.3)
