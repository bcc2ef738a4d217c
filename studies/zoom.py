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
from thinlayer.running.record import Record
from thinlayer.system.progress import track

# Poisson's ratio; E of the bodies over mu, see EPS
CASES = ((0.3, 1000.0), (0.3, 100.0), (0.45, 1000.0), (0.45, 100.0))
EPS = (1 / 16, 1 / 32, 1 / 64)  # thicknesses; moduli are proportional to eps, and defined at the first one
CELLS_THROUGH = 32  # cells through the meshed layer
CELL_LENGTH = 2.0  # length of cells of S where it is not meshed, over eps
DISTANCES = np.array([0.05, 0.1, 0.2, 0.5, 1, 1.5, 2, 3, 5, 10])  # distances of compared points from an end, over eps
HEIGHTS = np.array([-0.3, -0.15, 0.0, 0.15, 0.3])  # heights of these; nearer to corners the mesh is too coarse
END_DISTANCE = 3.0  # distance over eps up to which points belong to the end


def _law_state(blocks: Structure, law: LinearElastic, eps: float, order: int = 0, edges: str | None = None) -> State:
    return solve(blocks.interface(ThinLayer(law, eps, order, at=EPS[0], edges=edges)))


# states that prescribe the displacements of the layer's faces
STATE_FUNCTIONS: dict[str, Callable[[Structure, LinearElastic, float], State]] = {"order 0": _law_state}
STATE_FUNCTIONS["order 1, free"] = partial(_law_state, order=1, edges="free")
STATE_FUNCTIONS["estimate"] = lambda *case: estimate(_law_state(*case)).better


def run(record: Record, *, quick: bool = False) -> None:
    """Compare stresses in a meshed layer between two blocks with those of `Zoom` into interface models.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: two thicknesses, one ratio of moduli for each Poisson's ratio.
    """
    for nu, contrast in CASES[::3] if quick else CASES:
        _check_errors(record, nu, contrast, EPS[:2] if quick else EPS)


def _check_errors(record: Record, nu: float, contrast: float, thicknesses: Sequence[float]) -> None:
    """Measure and check the errors of `Zoom` in stresses and in strengths of singularities, for one layer's material.

    Args:
        record: record of the run, which writes a table for the material.
        nu: Poisson's ratio of the layer.
        contrast: Young's modulus of the bodies over the layer's shear modulus at the first thickness.
        thicknesses: thicknesses of the layer; its moduli are proportional to the thickness.
    """
    table = record.new_table(f"errors_{nu:g}_{contrast:g}.csv")
    law = LinearElastic.shear(100.0 / contrast, nu)
    for eps in track(list(thicknesses), "zoom", f"nu = {nu:g}, E/mu = {contrast:g}, eps = {{:g}}"):
        layer = ThinLayer(law, eps, at=EPS[0])
        full = Zoom(record.add_report(solve(free_blocks(eps / CELLS_THROUGH).full(layer, cells_through=CELLS_THROUGH))))
        row = {"eps": eps, "M/E": (law.lmbda + 2 * law.mu) * eps / EPS[0] / 100.0}
        for name, make_state in STATE_FUNCTIONS.items():
            zoom = Zoom(record.add_report(make_state(free_blocks(CELL_LENGTH * eps, h_S=CELL_LENGTH * eps), law, eps)))
            row |= {f"{key} {name}": value for key, value in _zoom_errors(zoom, full).items()}
        table.append(row)
        if eps == thicknesses[-1] and (nu, contrast) == CASES[-1]:
            for component, file in {"N": "end_N.png", "T": "end_T.png"}.items():
                plotting.zoomed(zoom, full, end=1, component=component, save=record.path(file), stress="E/100")
    what = f"nu = {nu:g}, E/mu = {contrast:g}"
    record.check(f"order of the error of H, order 0, {what}", last_order(table, "H order 0"), low=0.6)
    for key, high in (("end", 0.03), ("inside", 0.01), ("H", 0.02)):
        record.check(f"largest error, {key}, {what}", table[f"{key} estimate"].max(), high=high)


def _zoom_errors(zoom: Zoom, full: Zoom) -> dict[str, float]:
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
    masks = {"end": distance <= END_DISTANCE, "inside": distance > END_DISTANCE}
    errors = {name: float(np.sqrt(np.mean(error[at] ** 2) / np.mean(stress[at] ** 2))) for name, at in masks.items()}
    zoom_H, full_H = (np.array([corner.H[0] for corner in zoom_view.corners]) for zoom_view in (zoom, full))
    return errors | {"H": float(np.abs(zoom_H - full_H).max() / np.abs(full_H).max())}


def draw(record: Record) -> None:
    """Draw the relative errors of stresses at the ends of S over the thickness, from the tables in `record`'s folder."""
    panels = {}
    for nu, contrast in CASES:
        if record.has(file := f"errors_{nu:g}_{contrast:g}.csv"):
            table = record.load(file)
            lines = {name: (table["eps"], table[f"end {name}"]) for name in STATE_FUNCTIONS}
            panels[f"nu = {nu:g}, E/mu = {contrast:g}"] = lines
    labels, save = ("layer thickness eps over the width", "error of stresses at the end"), record.path("errors.svg")
    plotting.curves(panels, *labels, styles=("o:", "s--", "^-"), log="xy", columns=2, save=save)
