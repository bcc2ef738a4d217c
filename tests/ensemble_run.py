"""mpirun -n N python3 -m tests.ensemble_run FOLDER RANKS: an ensemble in groups of ranks; prints its table as JSON."""

from __future__ import annotations

import json
import sys

from mpi4py import MPI

from forms import LinearElastic
from geometry import sandwich
from thinlayer import Structure, Surface, ThinLayer, ensemble, solve

CASES = [{"mu": 40.0 + 7 * k, "where": "left" if k % 2 else "right"} for k in range(5)]


def make():
    joint = sandwich(width=2.0, lower=0.5, upper=0.7, h=0.25, structured=True)
    steel = LinearElastic.young(E=900.0, nu=0.3)
    pulled = Structure(joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (0.3, 0.8)}, element="P1")

    def run(case):
        pull = 1.0 if case["where"] == "left" else 2.0
        model = pulled.interface(ThinLayer(LinearElastic(60.0, case["mu"] * pull), 0.01))
        surface = Surface(model)
        return {"jump": surface.norm(surface.jump(solve(model))), "side": case["where"][0], "ranks": model.comm.size}

    return run


if __name__ == "__main__":
    table = ensemble(make, CASES, out=f"{sys.argv[1]}/table.csv", resume=True, ranks=int(sys.argv[2]))
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(table.rows))
