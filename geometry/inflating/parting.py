"""Parting bodies for layers that are not meshed: they stand where a meshed layer would leave them, with nothing between."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from geometry.inflating.inflation import inflate
from geometry.joint import Joint, Profile
from geometry.topology import FloatArray, IntArray


def parted(
    joint: Joint, eps: float | Mapping[str, float], *, profile: Profile | Mapping[str, Profile | None] | None = None
) -> Joint:
    """The same joint, whose bodies have given up their share of the thickness, as `inflate(..., bodies="extended")` has it.

    Cells, names and numbers stay, and so do `points`, in which S is one surface; the cells' own nodes are elsewhere
    (`Joint.parted`).

    Args:
        joint, eps, profile: as in `inflate`.

    Raises:
        InputError: as `inflate` does.
    """
    inflated = inflate(joint, eps, profile=profile, cells_through=2, bodies="extended")
    return replace(joint, parted=inflated.points[inflated.cells[: len(joint.cells)]])


def faces(joint: Joint, cell_points: FloatArray | None = None) -> FloatArray:
    """(2, n_S, k, d) places of the nodes of the facets of S in the cells below and above; of a rigid base those of S.

    Args:
        joint: the joint.
        cell_points: (n_cells, k, d) or more: places of the nodes of its cells, if others than its own.
    """
    places = joint.cell_points if cell_points is None else cell_points
    below, above = joint.surface_cells.T
    lower, upper = (places[cells[:, None], _positions(joint, cells)] for cells in (np.maximum(below, 0), above))
    return np.stack([np.where((below >= 0)[:, None, None], lower, joint.points[joint.surface]), upper])


def points_on_middle(joint: Joint) -> FloatArray:
    """(n_points, d) `points`, those of S in the middle between bodies that have parted; seams do not meet."""
    if joint.parted is None:
        return joint.points
    x = joint.points.copy()
    x[joint.surface] = faces(joint).mean(axis=0)
    return x


def to_middle(joint: Joint) -> FloatArray:
    """(n_cells, k, d) how far the nodes of each cell on its facets of S are from the middle; zero at other nodes."""
    out, both = np.zeros_like(joint.cell_points), faces(joint)
    for cells, own in zip(joint.surface_cells.T, both, strict=True):
        at = np.flatnonzero(cells >= 0)
        out[cells[at, None], _positions(joint, cells)[at]] = (both.mean(axis=0) - own)[at]
    return out


def _positions(joint: Joint, cells: IntArray) -> IntArray:
    """(n_S, k) positions of the nodes of the facets of S among those of cells (n_S,)."""
    return np.asarray((joint.cells[cells][:, None, :] == joint.surface[:, :, None]).argmax(axis=2))
