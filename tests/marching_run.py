"""Marches with memory of every kind; as a program, some of them, killed at a row: OUT ROW stepping|writing NAME..."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import ufl

from forms import Incompressible, KelvinVoigt, LinearElastic, Maxwell, Norton, Stack
from geometry import block, sandwich
from tests.mpirun import Ending
from tests.non_monotone_run import HEATED
from tests.own_laws import Mises, layer_of
from tests.softening_bars import DAMAGED, KINKED, SHORT, tilted
from thinlayer import Adaptive, Structure, march

BODY = LinearElastic.young(100.0, 0.3)
MAXWELL = Maxwell(60.0, 40.0, t1=0.7, t2=0.9)
SERIES = Stack((0.4, MAXWELL), (0.6, Norton(30.0, 20.0, eta=5.0, p=1.5)))
TIMES = [0.05, 0.1, 0.2, 0.25, 0.4]


PLANE, SPACE = sandwich(1.0, 0.5, 0.5, 0.25), block(1.0, 0.5, 0.5, depth=0.7)
LOAD = {"TOP": lambda x, t: (0.5 + t, ufl.cos(ufl.pi * x[0]))}
LOAD_3 = {"TOP": lambda x, t: (0.3 * x[2], ufl.cos(ufl.pi * x[0]) + t, 0.2)}
FLAT = Structure(PLANE, body=BODY, supports={"BOTTOM": 0.0, "RIGHT": {"x": 0.0}}, tractions=LOAD)
SOLID = Structure(SPACE, body=BODY, supports={"RIGHT": {"x": 0.0}}, tractions=LOAD_3)
softening = partial(tilted, cells=4)  # a block on a law of jumps, which is followed along its path
# memory in the meshed layer and on S, in 2D and 3D, adaptive steps, pressures, paths: way of modelling, law, times, theta
MARCHES: dict[str, tuple] = {
    "meshed": (FLAT.full, MAXWELL, TIMES, 0.5),
    "series": (FLAT.interface, SERIES, TIMES, 1.0),
    "space": (SOLID.interface, MAXWELL, TIMES, 1.0),
    "damaged": (softening, DAMAGED, SHORT, 1.0),
    "kinked": (softening, KINKED, SHORT, 1.0),
    "plastic": (SOLID.full, Mises(60.0, 40.0, 1.5), TIMES, 1.0),
    "adaptive": (FLAT.interface, KelvinVoigt(60.0, 40.0, 0.3, 0.5), Adaptive(0.4, 0.02, 5e-3), 0.5),
    "switching": (FLAT.interface, HEATED, TIMES, 1.0),
    "pressure": (FLAT.full, Incompressible(40.0), TIMES, 1.0),
}

NEVER = Ending()


def run(out: Path, names: Iterable[str] = MARCHES, *, resume: bool = False, ending: Ending = NEVER) -> None:
    """Run marches, or begin them."""

    def energy(state):
        ending.at_row()
        return state.energies()["bodies"]

    for name in names:
        build, law, times, theta = MARCHES[name]
        keep, model = "all" if name in ("series", "damaged") else "last", build(layer_of(law, 0.1))
        march(model, times, theta=theta, observe={"of bodies": energy}, out=out / name, resume=resume, keep=keep)


if __name__ == "__main__":
    folder, row, how, *names = sys.argv[1:]
    run(Path(folder), names, ending=Ending(int(row), writing=how == "writing"))
