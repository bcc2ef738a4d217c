"""mpirun -n N python3 -m tests.junction_run: tractions where seams meet, the same on any number of ranks."""

from __future__ import annotations

import json

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from forms import LinearElastic, MohrCoulomb
from geometry import Joint, wall
from tests.network_cases import BED, HEAD, panel, pushed, springs, three_bricks
from tests.test_networks import cut_at, on
from thinlayer import Model, State, Structure, Surface, ThinLayer, solve

LAYERS = {"BED": springs(2.0, 0.7), "HEAD": springs(1.2, 0.45, 0.007)}
STRONG = ThinLayer(MohrCoulomb(0.3, 0.45, cohesion=1e3, friction_angle=30.0), 0.007)  # springs(1.2, 0.45) to its limit


def blocks(cell: str, cross: bool = False, depth: float = 0.5) -> Joint:
    """Two blocks of 1 x 0.5 on one, or four that cross, all of one region; in 3D 0.5 deep."""
    grid = wall(1, 2, (2.0, 0.5), 0.25, depth=None if cell in ("triangle", "quadrilateral") else depth, cell=cell)
    d = grid.dim
    upright = lambda x, n: on(0, 1.0)(x, n) & (cross | (x[:, 1] > 0.5))
    return cut_at(grid, {"BED": (on(1, 0.5), np.eye(d)[1]), "HEAD": (upright, np.eye(d)[0])})


def sheared(joint: Joint, element: str, supports=None, **layers) -> State:
    """Bodies on a bottom that is held, under their weight and a pull at the right and on top."""
    d = joint.dim
    structure = Structure(
        joint, body=LinearElastic.young(5.0, 0.2), supports={"BOTTOM": 0.0} if supports is None else supports,
        tractions={"RIGHT": (0.01, 0.004, 0.0)[:d], "TOP": (0.01, -0.02, 0.005)[:d]}, body_force=(0.01, -0.03, 0.02)[:d],
        element=element,
    )  # fmt: skip
    return solve(structure.interface(LAYERS | layers))


def left_over(state: State) -> np.ndarray:
    """Forces and moments on each brick, of the tractions on its seams and of loads, (bricks, 3 or 6)."""
    model, d, mesh = state.model, state.model.joint.dim, state.model.domain.mesh
    x, pieces = ufl.SpatialCoordinate(mesh), model.domain.on_cells(model.joint.splitting.pieces)
    brick, v = fem.Function(fem.functionspace(mesh, ("DG", 0))), fem.Function(model.space(1))
    seams = [(one := Surface(model, name), one.traction(state)) for name in model.joint.seams]
    out = []
    for number in range(model.joint.splitting.pieces.max() + 1):
        brick.x.array[:] = pieces == number
        row = []
        for shift, turn in motions(d):
            v.x.array[:] = 0.0
            v.interpolate(lambda y, a=shift, b=turn: a[:, None] + b @ y[:d], np.flatnonzero(pieces == number))
            way = ufl.as_vector(shift.tolist()) + ufl.as_matrix(turn.tolist()) * x
            total = state.integral(model.external_work(v, state.t))
            for surface, t in seams:
                above, below = surface.sides.upper(brick), surface.sides.lower(brick)
                total += surface.integral((below - above) * ufl.inner(t, way))
            row.append(total)
        out.append(row)
    return np.array(out)


def motions(d: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rigid motions: shifts (d,) and rotations (d, d)."""
    out = [(shift, np.zeros((d, d))) for shift in np.eye(d)]
    for a in range(d):
        for b in range(a):
            turn = np.zeros((d, d))
            turn[a, b], turn[b, a] = 1.0, -1.0
            out.append((np.zeros(d), turn))
    return out


def by_law(surface: Surface, state: State, K_N: float, K_T: float):
    """Tractions of springs at the jump."""
    w, n = surface.jump(state), surface.sides.n
    return K_T * w + (K_N - K_T) * ufl.dot(w, n) * n


def sizes(model: Model, state: State) -> list[float]:
    """Norms of tractions on seams, and their values along them."""
    found = []
    for name in model.joint.seams:
        surface = Surface(model, name)
        t = surface.traction(state)
        x, values = surface.profile(surface.frame(t))
        found += [surface.norm(t), *np.abs(values).sum(axis=0), float((np.arange(len(x)) * values[:, 0]).sum())]
    return found


def main() -> None:
    """Print the numbers as JSON."""
    states = {
        "panel": solve(panel("Q2", 0.125), 1.0),
        "panel, triangles": solve(panel("P2", 0.125), 1.0),
        "strong heads": solve(panel("Q2", 0.125, HEAD=STRONG), 1.0),
        "T, hexahedra": sheared(blocks("hexahedron"), "Q1"),
        "X, tetrahedra": sheared(blocks("tetrahedron", cross=True), "P1"),
        "contact": pushed(three_bricks(4, "triangle", cross=True), 0.6, {"BED": BED, "HEAD": HEAD}),
        "contact and mortar": pushed(three_bricks(4, "quadrilateral"), 0.6, {"BED": BED, "HEAD": LAYERS["HEAD"]}),
    }
    found: dict[str, list] = {name: sizes(state.model, state) for name, state in states.items()}
    found["left over"] = [float(np.abs(left_over(states["T, hexahedra"])[1:]).max() < 1e-13)]
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))


if __name__ == "__main__":
    main()
