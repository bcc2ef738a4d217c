"""Stresses inside a layer and strengths of their singularities by `Zoom`, against those of a meshed layer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from forms import LinearElastic
from studies.problems import free_blocks
from studies.sweeping import last_order
from thinlayer import Structure, ThinLayer, Zoom, estimate, plotting, solve
from thinlayer.discretisation.state import State
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.running.record import Record
from thinlayer.system.progress import track

# Poisson's ratio; E of the bodies over mu, see EPS
CASES = ((0.3, 1000.0), (0.3, 100.0), (0.45, 1000.0), (0.45, 100.0))
EPS = (1 / 16, 1 / 32, 1 / 64)  # thicknesses; moduli are proportional to eps, and defined at the first one
THROUGH = 32  # cells through the meshed layer
LONG = 2.0  # length of cells of S where it is not meshed, over eps
DISTANCES = np.array([0.05, 0.1, 0.2, 0.5, 1, 1.5, 2, 3, 5, 10])  # distances of compared points from an end, over eps
HEIGHTS = np.array([-0.3, -0.15, 0.0, 0.15, 0.3])  # heights of these; nearer to corners the mesh is too coarse
AT_END = 3.0  # distance over eps up to which points belong to the end


def _by_law(blocks: Structure, law: LinearElastic, eps: float, order: int = 0, edges: str | None = None) -> State:
    return solve(blocks.interface(ThinLayer(law, eps, order, at=EPS[0], edges=edges)))


# states that prescribe the displacements of the layer's faces
STATES: dict[str, Callable[[Structure, LinearElastic, float], State]] = {"order 0": _by_law}
STATES["order 1, free"] = partial(_by_law, order=1, edges="free")
STATES["estimate"] = lambda *case: estimate(_by_law(*case)).better


def run(record: Record, *, quick: bool = False) -> None:
    """Compare stresses in a meshed layer between two blocks with those of `Zoom` into interface models.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: two thicknesses, one ratio of moduli for each Poisson's ratio.
    """
    for nu, ratio in CASES[::3] if quick else CASES:
        _errors(record, nu, ratio, EPS[:2] if quick else EPS)


def _errors(record: Record, nu: float, ratio: float, thicknesses: Sequence[float]) -> None:
    """Measure and check the errors of `Zoom` in stresses and in strengths of singularities, for one layer's material.

    Args:
        record: record of the run, which writes a table for the material.
        nu: Poisson's ratio of the layer.
        ratio: Young's modulus of the bodies over the layer's shear modulus at the first thickness.
        thicknesses: thicknesses of the layer; its moduli are proportional to the thickness.
    """
    table = record.table(f"errors_{nu:g}_{ratio:g}.csv")
    law = LinearElastic.shear(100.0 / ratio, nu)
    for eps in track(list(thicknesses), "zoom", f"nu = {nu:g}, E/mu = {ratio:g}, eps = {{:g}}"):
        layer = ThinLayer(law, eps, at=EPS[0])
        full = Zoom(record.solved(solve(free_blocks(eps / THROUGH).full(layer, cells_through=THROUGH))))
        row = {"eps": eps, "M/E": (law.lmbda + 2 * law.mu) * eps / EPS[0] / 100.0}
        for name, state in STATES.items():
            zoom = Zoom(record.solved(state(free_blocks(LONG * eps, h_S=LONG * eps), law, eps)))
            row |= {f"{key} {name}": value for key, value in _compared(zoom, full).items()}
        table.append(row)
        if eps == thicknesses[-1] and (nu, ratio) == CASES[-1]:
            for component, file in {"N": "end_N.png", "T": "end_T.png"}.items():
                plotting.zoomed(zoom, full, end=1, component=component, save=record.path(file), stress="E/100")
    what = f"nu = {nu:g}, E/mu = {ratio:g}"
    record.check(f"order of the error of H, order 0, {what}", last_order(table, "H order 0"), low=0.6)
    for key, high in (("end", 0.03), ("inside", 0.01), ("H", 0.02)):
        record.check(f"largest error, {key}, {what}", table[f"{key} estimate"].max(), high=high)


def _compared(zoom: Zoom, full: Zoom) -> dict[str, float]:
    """Compare a zoom into an interface model with a zoom into a full model.

    Args:
        zoom: zoom into the interface model.
        full: zoom into the full model, the reference.

    Returns:
        "end" and "inside" -> relative root mean square error of stresses near the ends and elsewhere. "H" -> largest
        error of the strengths of the singularities at corners, over the largest strength.
    """
    eps, samples = zoom.eps, []
    for end, (start, *_) in zoom.ends:
        d, y = (grid.ravel() for grid in np.meshgrid(DISTANCES[DISTANCES * eps <= 0.5], HEIGHTS))
        x = start - d[:, None] * eps * end.m
        stress = full.stress(x, y)
        samples.append((d, stress, zoom.stress(x, y) - stress))
    distance, stress, error = (np.concatenate(arrays) for arrays in zip(*samples, strict=True))
    parts = {"end": distance <= AT_END, "inside": distance > AT_END}
    errors = {name: float(np.sqrt(np.mean(error[at] ** 2) / np.mean(stress[at] ** 2))) for name, at in parts.items()}
    zoomed, meshed = (np.array([corner.H[0] for corner in of.corners]) for of in (zoom, full))
    return errors | {"H": float(np.abs(zoomed - meshed).max() / np.abs(meshed).max())}


def draw(record: Record) -> None:
    """Draw the errors of stresses and of strengths of singularities over the thickness.

    The values are read from the tables of the materials in the folder of `record`.
    """
    parts, lines = {}, {"order 0": "o:", "order 1, free": "o--", "estimate": "o-"}
    names = [f"{key} {state}" for state in STATES for key in ("end", "inside", "H")]
    for nu, ratio in CASES:
        if record.has(file := f"errors_{nu:g}_{ratio:g}.csv"):
            table = record.load(file)
            parts[f"nu = {nu:g}, E/mu = {ratio:g}"] = {name: (table["eps"], table[name]) for name in names}
    styles = {name: lines[name.split(" ", 1)[1]] for name in names}
    colours, save = dict(zip(names, 3 * COLOURS[:3], strict=True)), record.path("errors.svg")
    look = {"styles": styles, "colours": colours, "log": "y", "columns": 2, "save": save}
    plotting.curves(parts, "layer thickness eps over the width", "relative error", **look)
