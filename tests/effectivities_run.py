"""As a script, numbers of a case whose layer is dropped and meshed, which do not depend on the number of ranks."""

from __future__ import annotations

import json

import numpy as np
from mpi4py import MPI

from studies.dropping.further import further_cases
from studies.dropping.mapping import along
from studies.dropping.measuring import Dropped

CASE, EPS = "two stiffnesses", 1 / 16


def dropped() -> Dropped:
    """The case."""
    (case,) = (one for one in further_cases() if one.name == CASE)
    return Dropped.of(case, EPS)


def numbers(one: Dropped) -> dict[str, float]:
    """True and estimated changes, and sums of squares of densities along S."""
    table = along(one)
    found = {f"true {name}": value for name, value in one.truth.items()}
    found |= {f"estimated {name}": value for name, value in one.estimated.items()}
    return found | {name: float(np.sum(table[name] ** 2)) for name in ("density", "true_density")}


if __name__ == "__main__":
    result = numbers(dropped())
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(result))
