"""mpirun -n N python3 -m tests.turning_run: a bar on a surface that softens, to its turning point and on."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import ClassVar

from mpi4py import MPI

from tests.arc_length_run import Trilinear, bar
from tests.snapping_bars import FAR
from thinlayer import ArcLength, TurningPoint, follow, march


@dataclass(frozen=True)
class Softening(Trilinear):
    """The law of `Trilinear`, which says that it softens."""

    softens: ClassVar = True


STEEP = Softening(k=7.0, fall=5.0, w_1=0.11, w_2=0.23, k_T=1.9)


def turned(n: int = 4):
    """The history to the turning point of a march in n steps, and the path from there on."""
    try:
        march(bar(STEEP), [FAR * (k + 1) / n for k in range(n)])
    except TurningPoint as error:
        return error, follow(error.history, ArcLength(end=FAR, first=0.05))
    raise AssertionError("the march has not ended")


if __name__ == "__main__":
    error, path = turned()
    found = {"t": error.t, "lowest": float(path.t.min()), "rows": len(path), "end": path.last.t}
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
