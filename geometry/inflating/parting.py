"""Parting bodies for layers that are not meshed: they stand where a meshed layer would leave them, with nothing between."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from geometry.inflating.inflation import inflate
from geometry.joint import Joint, Profile
from geometry.topology import FloatArray


def parted(
    joint: Joint, eps: float | Mapping[str, float], *, profile: Profile | Mapping[str, Profile | None] | None = None
) -> Joint:
    """The same joint, whose bodies have given up their share of the thickness, as `inflate(..., bodies="extended")` has it.

    Cells, names and numbers stay, and so do `points`, in which S is one surface; the cells' own nodes are elsewhere
    (`Joint.parted`).

    Args:
        joint, eps, profile: as in `inflate`.

    Raises:
        GeometryError: as `inflate` does.
    """
    inflated = inflate(joint, eps, profile=profile, cells_through=2, bodies="extended")
    return replace(joint, parted=inflated.points[inflated.cells[: len(joint.cells)]])


def middle(joint: Joint) -> FloatArray:
    """(n_S, k, d) places of the nodes of the facets of S midway between the bodies, or a body and its rigid base."""
    below, above = joint.surface_cells.T
    upper = _on_side(joint, above)
    there = (below >= 0)[:, None, None]
    lower = np.where(there, _on_side(joint, np.maximum(below, 0)), joint.points[joint.surface])
    return np.asarray((upper + lower) / 2)


def points_on_middle(joint: Joint) -> FloatArray:
    """(n_points, d) `points`, those of S in the middle between bodies that have parted; seams do not meet."""
    if joint.parted is None:
        return joint.points
    x = joint.points.copy()
    x[joint.surface] = middle(joint)
    return x


def to_middle(joint: Joint) -> FloatArray:
    """(n_cells, k, d) how far the nodes of each cell on its facets of S are from `middle`; zero at other nodes."""
    out, x = np.zeros_like(joint.cell_points), middle(joint)
    for cells in joint.surface_cells.T:
        at = np.flatnonzero(cells >= 0)
        out[cells[at, None], _places(joint, at, cells[at])] = x[at] - _on_side(joint, cells)[at]
    return out


def _on_side(joint: Joint, cells: np.ndarray) -> FloatArray:
    """(n_S, k, d) places of the nodes of the facets of S in the cells (n_S,) on one side."""
    at = np.arange(len(cells))
    return np.asarray(joint.cell_points[cells[:, None], _places(joint, at, cells)])


def _places(joint: Joint, at: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """(n, k) positions of the nodes of facets of S, given by their numbers, among those of cells (n,)."""
    return np.asarray((joint.cells[cells][:, None, :] == joint.surface[at][:, :, None]).argmax(axis=2))
