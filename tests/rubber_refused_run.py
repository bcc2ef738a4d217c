"""Prints the errors of all ranks for a modulus that is negative near one end of S; run by test_rubber_refused.py."""

from __future__ import annotations

import json

from mpi4py import MPI

from forms import LinearElastic, Rubber
from geometry import sandwich
from thinlayer import Structure, ThinLayer


def half_negative() -> list[str]:
    joint, law = sandwich(1.0, 0.5, 0.5, 0.25), Rubber(lambda x: 90.0 - 100.0 * x[0], 3.0)
    structure, said = Structure(joint, body=LinearElastic(2.0, 1.0), supports={"BOTTOM": 0.0}), []
    for build in (structure.full, structure.interface):
        try:
            build(ThinLayer(law, 0.1, order=1))
        except Exception as error:
            said.append(str(error))
    return said


if __name__ == "__main__":
    gathered = MPI.COMM_WORLD.gather(half_negative())
    if gathered:
        print(json.dumps([one for found in gathered for one in found]))
