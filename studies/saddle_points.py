"""Benchmark: rubber bearings in 3D, solved iteratively, against an elastic layer on one mesh and against factorising."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import ufl

from forms import Incompressible, LinearElastic, Rubber
from geometry import sandwich
from studies.timing import timed
from thinlayer import Structure, ThinLayer
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.running.record import Record
from thinlayer.solving.petsc import OptionValue
from thinlayer.solving.solvers import Solver
from thinlayer.system.progress import track
from thinlayer.system.table import Row

RATIOS = (0.3, 0.45, 0.49, 0.499, 0.4999, 0.5)  # Poisson's
SIDE, PLATE, EPS = 100.0, 7.0, 12.0  # mm: a quarter of a bearing; height of a plate; thickness of the rubber
MU = 1.2  # MPa: shear modulus of the rubber
PRESSED: dict[str, Any] = {"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": -0.1, "z": 0.0}}  # mm
CELLS, QUICK_CELLS, FACTORED = 28, 9, 0.499  # cells along S; Poisson's ratio at which the matrix is factored, too
ELASTIC: dict[str, OptionValue] = {"pc_type": "gamg"}
BLOCKS: dict[str, OptionValue] = {"pc_type": "fieldsplit"}
FACTORS: dict[str, OptionValue] = {"pc_type": "cholesky"}
SLOWEST, UNEVEN, DISTANCE = 2.5, 2.0, 1e-8  # allowed: time over the elastic one; iterations, most over least; errors


@dataclass(frozen=True)
class Case:
    """A bearing.

    Attributes:
        E: Young's modulus of the plates, MPa.
        loaded: whether its upper plate carries a load that also turns it, held by the rubber alone; else it is moved.
    """

    E: float
    loaded: bool

    def model(self, cells: int) -> InterfaceModel:
        """The bearing with an elastic layer of order 1, Poisson's ratio 0.3; two ends of the rubber are free."""
        joint = sandwich(SIDE, PLATE, PLATE, SIDE / cells, depth=SIDE, structured=True)
        rollers: dict[str, Any] = {"LEFT": {"x": 0.0}, "BACK": {"z": 0.0}}  # the planes of symmetry
        load = {"TOP": lambda x, t: ufl.as_vector((0.0, -1.0 - x[0] / SIDE, 0.0))}  # MPa
        supports, tractions = ({"BOTTOM": 0.0}, load) if self.loaded else (PRESSED, {})
        body = LinearElastic.young(E=self.E, nu=0.3)
        structure = Structure(joint, body=body, supports=supports | rollers, tractions=tractions)
        return structure.interface(ThinLayer(LinearElastic.shear(MU, 0.3), EPS, order=1))


CASES = {
    "steel plates, moved": Case(210e3, loaded=False),
    "steel plates, loaded": Case(210e3, loaded=True),
    "soft plates, loaded": Case(25.0, loaded=True),
}


def run(record: Record, *, quick: bool = False) -> None:
    """Solve for all ratios in turn, beside the elastic layer.

    Times are of the processor, from the parts' matrices to the accepted state.

    Args:
        record: where to write.
        quick: 9 cells along a side of S in place of 28, without the limit of time.
    """
    cells = QUICK_CELLS if quick else CELLS
    table, first = record.table("table.csv"), next(iter(CASES))  # factoring rubber takes minutes on the fine mesh
    for name in track([*CASES], "saddle_points", "{}"):
        table.extend(compared(name, CASES[name].model(cells), factored=quick or name == first))
    for name, part in table.split("case").items():
        iterative = part.split("solver")["fieldsplit"]
        iterations = iterative["iterations"]
        record.check(f"{name}: iterations, most over least", iterations.max() / iterations.min(), high=UNEVEN)
        if not quick:
            record.check(f"{name}: largest ratio of time", iterative["ratio"].max(), high=SLOWEST)
        for distance in iterative["distance"][np.isfinite(iterative["distance"])]:
            record.check(f"{name}: distance from the factored solution", distance, high=DISTANCE)


def compared(name: str, elastic: InterfaceModel, *, factored: bool) -> Iterator[Row]:
    """Rows of one case: the elastic layer, by multigrid and factored; rubber, factored if asked; rubber for all ratios."""
    works: list[tuple[str, float, dict[str, OptionValue]]] = [("elastic", 0.3, ELASTIC), ("elastic", 0.3, FACTORS)]
    works += [("rubber", FACTORED, FACTORS)] if factored else []
    works += [("rubber", nu, BLOCKS) for nu in RATIOS]
    usual, direct = math.nan, None
    for layer, nu, options in works:
        model = elastic if layer == "elastic" else elastic.with_layer(_rubber(nu))
        with Solver(model, options=options) as solver:
            solver.equations.factor.destroy()  # a new one, or a new hierarchy
            seconds, state = timed(partial(_step, solver))
        usual = seconds if options is ELASTIC else usual
        if layer == "rubber" and options is FACTORS:
            direct = state.u.x.array
        distance = None
        if options is BLOCKS and nu == FACTORED and direct is not None:
            distance = float(np.abs(state.u.x.array - direct).max() / np.abs(direct).max())
        yield {
            "case": name, "layer": layer, "nu": nu, "solver": options["pc_type"], "unknowns": model.unknowns,
            "iterations": state.report.iterations, "residual": state.report.residual, "seconds": seconds,
            "ratio": seconds / usual, "distance": distance,
        }  # fmt: skip


def _step(solver: Solver) -> State:
    return solver.step(solver.rest(0.0), 0.0)


def _rubber(nu: float) -> ThinLayer:
    law = Incompressible(MU) if nu == 0.5 else Rubber.shear(MU, nu)
    return ThinLayer(law, EPS, order=1)
