"""What an estimate costs, beside the solve with the law that it judges, and beside meshing the layer."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from statistics import median
from typing import Any

from forms import LinearElastic, Rubber
from geometry import sandwich
from studies.dropping.measuring import unknowns
from studies.dropping.structures import corner, free
from studies.problems import FOURIER_BODY
from thinlayer import RangeWarning, Structure, ThinLayer, estimate, solve

EPS = 1 / 32
REPEATS = 5
ELASTIC = ThinLayer(LinearElastic.shear(30.0, 0.3), EPS, at=1.0)
RUBBER = ThinLayer(Rubber.shear(30.0, 0.49), EPS, at=1.0)


def _fine() -> Structure:
    """Two blocks with free sides, on a fine mesh."""
    joint = sandwich(1.0, 0.5, 0.5, 1 / 60, h_ends=EPS / 8, cell="quadrilateral")
    return Structure(joint, body=FOURIER_BODY, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.3, -1.0)})


PLACES: dict[str, tuple[Callable[[], Structure], ThinLayer]] = {
    "small": (lambda: free(EPS), ELASTIC),
    "fine": (_fine, ELASTIC),
    "fine, rubber": (_fine, RUBBER),
    "3D": (lambda: corner(EPS), ELASTIC),
}


def cost(name: str) -> dict[str, float | str]:
    """Times of one of `PLACES`: medians of several runs after a first one, processor time.

    Returns:
        seconds: of building the interface model and solving it.
        further_solves: what the package says, solves alone.
        over_solve: all of the estimate, over the solve of the interface model.
        over_model: over building this model and solving it.
        over_meshing: over meshing the layer, building that model and solving it.
    """
    make, layer = PLACES[name]
    structure = make()
    rows = [_once(structure, layer) for _ in range(REPEATS + 1)][1:]
    model, alone, told, meshed, further = (median(row[k] for row in rows) for k in range(5))
    size = unknowns(structure.interface(layer))
    ratios = {"solve": alone, "model": model + alone, "meshing": meshed}
    row: dict[str, float | str] = {"case": name, "unknowns": size, "seconds": model + alone, "further_solves": further}
    return row | {f"over_{key}": told / value for key, value in ratios.items()}


def _once(structure: Structure, layer: ThinLayer) -> tuple[float, ...]:
    """Times of building the interface model, of its solve, of the estimate, of meshing; and the estimate's own ratio."""
    with warnings.catch_warnings(action="ignore", category=RangeWarning):
        model, building = _timed(lambda: structure.interface(layer))
        state, solving = _timed(lambda: solve(model))
        found, telling = _timed(lambda: estimate(state))
        _, meshing = _timed(lambda: solve(structure.full(layer)))
    return building, solving, telling, meshing, found.cost


def _timed(do: Callable[[], Any]) -> tuple[Any, float]:
    start = time.process_time()
    found = do()
    return found, time.process_time() - start
