"""mpirun -n N python3 -m tests.pressure_run: how much too stiff two rubbery layers between stiff blocks are, by name."""

from __future__ import annotations

import json
import warnings

import numpy as np
from mpi4py import MPI

from forms import LinearElastic
from geometry import wall
from tests.ranges_told import STIFF
from tests.test_networks import cut_at, on
from thinlayer import PressureReport, RangeWarning, Structure, ThinLayer, compare, solve

HALF_WIDTH = 0.5
LAYERS = {
    "LOW": ThinLayer(LinearElastic.shear(3.0, 0.49), 1 / 16),
    "HIGH": ThinLayer(LinearElastic.shear(5.0, 0.4), 1 / 10),
}


def main() -> None:
    """Print the report's table and the columns of a comparison as JSON."""
    grid = wall(1, 3, (2 * HALF_WIDTH, 0.5), 1 / 32, cell="quadrilateral")
    joint = cut_at(grid, {"LOW": (on(1, 0.5), np.eye(2)[1]), "HIGH": (on(1, 1.0), np.eye(2)[1])})
    blocks = Structure(joint, body=STIFF, supports={"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": 1e-3}})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RangeWarning)
        state = solve(blocks.interface(LAYERS))
        full = solve(blocks.full(LAYERS, cells_through=1))
    report = PressureReport(state)
    found = {"table": report.table.rows, "text": str(report), "one": PressureReport(state, "HIGH").too_stiff}
    found |= {f"compared {seam}": compare(full, state, seam=seam) for seam in ("S", "LOW")}
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))


if __name__ == "__main__":
    main()
