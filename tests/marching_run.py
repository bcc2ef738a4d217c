"""Marches with memory of every kind, for runs that are killed and resumed.

OUT [--first N] [--resume] [--kill ROW [--writing]]
"""

from __future__ import annotations

import argparse
import os
import signal
from collections.abc import Sequence
from itertools import count, islice
from pathlib import Path

import ufl
from mpi4py import MPI

from forms.laws import Incompressible, KelvinVoigt, LinearElastic, Maxwell, Norton, Stack
from geometry import block, sandwich
from tests.own_laws import Mises
from thinlayer import Adaptive, Structure, ThinLayer, march

BODY = LinearElastic.young(100.0, 0.3)
MAXWELL = Maxwell(60.0, 40.0, t1=0.7, t2=0.9)
SERIES = Stack((0.4, MAXWELL), (0.6, Norton(30.0, 20.0, eta=5.0, p=1.5)))
TIMES = [0.05, 0.1, 0.2, 0.25, 0.4]


def marches():
    """name -> model, times, time scheme: memory in the meshed layer and on S, in 2D and 3D, adaptive steps, pressures."""
    plane = sandwich(1.0, 0.5, 0.5, 0.25)
    space = block(1.0, 0.5, 0.5, depth=0.7)
    load = {"TOP": lambda x, t: (0.5 + t, ufl.cos(ufl.pi * x[0]))}
    load3 = {"TOP": lambda x, t: (0.3 * x[2], ufl.cos(ufl.pi * x[0]) + t, 0.2)}
    flat = {"body": BODY, "supports": {"BOTTOM": 0.0, "RIGHT": {"x": 0.0}}, "tractions": load}
    solid = {"body": BODY, "supports": {"RIGHT": {"x": 0.0}}, "tractions": load3}
    kelvin_voigt = KelvinVoigt(60.0, 40.0, 0.3, 0.5)
    yield "meshed", Structure(plane, **flat).full(ThinLayer(MAXWELL, 0.1)), TIMES, 0.5
    yield "series", Structure(plane, **flat).interface(ThinLayer(SERIES, 0.1)), TIMES, 1.0
    yield "space", Structure(space, **solid).interface(ThinLayer(MAXWELL, 0.1)), TIMES, 1.0
    yield "plastic", Structure(space, **solid).full(ThinLayer(Mises(60.0, 40.0, limit=1.5), 0.1)), TIMES, 1.0
    yield "adaptive", Structure(plane, **flat).interface(ThinLayer(kelvin_voigt, 0.1)), Adaptive(0.4, 0.02, 5e-3), 0.5
    yield "pressure", Structure(plane, **flat).full(ThinLayer(Incompressible(40.0), 0.1)), TIMES, 1.0


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--first", type=int, metavar="N", help="the first N marches alone")
    parser.add_argument("--resume", action="store_true")
    parser.add_argument("--kill", type=int, default=0)
    parser.add_argument("--writing", action="store_true")
    chosen = parser.parse_args(words)
    comm, rows = MPI.COMM_WORLD, count(1)
    victim = comm.rank == (0 if chosen.writing else comm.size - 1)

    def energy(state):
        """Energy of the bodies; ends the run at a row, before the row is written or amid the writing of files."""
        if next(rows) == chosen.kill and victim:
            if not chosen.writing:
                os.kill(os.getpid(), signal.SIGKILL)
            Path.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
        return state.energies()["bodies"]

    for name, model, times, theta in islice(marches(), chosen.first):
        out = chosen.out / name
        keep = "all" if name == "series" else "last"
        march(model, times, theta=theta, observe={"energy": energy}, out=out, resume=chosen.resume, keep=keep)


if __name__ == "__main__":
    main()
