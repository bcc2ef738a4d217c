"""Structures on springs; as a script, numbers that do not depend on the number of ranks: OUT, a folder to march in."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from forms import LinearElastic, Maxwell
from geometry import sandwich
from thinlayer import Structure, ThinLayer, march, solve
from thinlayer.parts.springs import Springs

E, HEIGHT, EPS = 100.0, 0.5, 0.1
ANGLE = 0.4
BODY = LinearElastic.young(E, 0.0)
GLUE = LinearElastic(lmbda=0.0, mu=4.0)  # per thickness
CREEP = Maxwell(lmbda=0.0, mu=4.0, t1=0.5)
BED = Springs("BOTTOM", normal=20.0, tangential=7.0)
P, PULL = 0.3, (0.2, -0.1)  # pressure on top; tractions at the bottom, along it
DIM = {2: {}, 3: {"depth": 0.5}}


def axes(dim: int) -> np.ndarray:
    """Rows: the turned axes along the bottom, then across it, upwards."""
    c, s = np.cos(ANGLE), np.sin(ANGLE)
    return np.array([[c, s], [-s, c]] if dim == 2 else [[c, s, 0], [0, 0, 1], [-s, c, 0]])


def turned(dim: int = 2, kind: str = "interface", parts=(BED,), **change):
    """Two turned blocks, a layer between them, on springs alone: pressed from above, and pulled along at the bottom."""
    joint = sandwich(1.0, HEIGHT, HEIGHT, 0.25, structured=True, **DIM[dim]).rotated(ANGLE)
    along, n = np.array(PULL[: dim - 1]) @ axes(dim)[:-1], axes(dim)[-1]
    loads = {"TOP": tuple(-P * n), "BOTTOM": tuple(along)}
    setup = {"body": BODY, "supports": {}, "tractions": loads, "element": "P1" if dim == 3 else None} | change
    return getattr(Structure(joint, parts=list(parts), **setup), kind)(ThinLayer(GLUE, EPS))


def mean(state, place):
    """Mean displacement of a boundary, in the turned axes."""
    model = state.model
    there = model.ds(model.domain.values(place))
    u = [state.integral(state.u[k] * there) for k in range(model.joint.dim)]
    area = state.integral(fem.Constant(model.domain.mesh, 1.0) * there)
    return axes(model.joint.dim) @ np.array(u) / area


def relaxing(kind: str = "interface", closing: float = 0.02):
    """A column on springs, with a layer that creeps; its top is moved down once, and held."""
    joint = sandwich(1.0, HEIGHT, HEIGHT, 0.25, structured=True)
    supports = {"TOP": {"x": 0.0, "y": -closing}}
    return getattr(Structure(joint, body=BODY, supports=supports, parts=[BED]), kind)(ThinLayer(CREEP, EPS))


def numbers(out: Path) -> dict[str, float]:
    """Energies of turned blocks, and of a march, or of the rest of one that is in the folder."""
    found = {}
    for dim in (2, 3):
        state = solve(turned(dim))
        found |= {f"{name} {dim}": value for name, value in state.energies().items()}
    history = march(relaxing(), [0.1, 0.2, 0.3, 0.4], out=out, resume=True)
    return found | {"at the end": history.last.energies()["springs BOTTOM"], "rows": float(len(history))}


if __name__ == "__main__":
    answer = numbers(Path(sys.argv[1]))
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(answer))
