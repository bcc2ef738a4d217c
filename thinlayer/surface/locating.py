"""Which cells and facets of a joint contain given places."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import basix
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from forms.temperature import real
from geometry.errors import place, unknown
from geometry.joint import Joint
from geometry.seam import S
from geometry.topology import IntArray, is_tensor, lagrange
from thinlayer.errors import ModelError

Array = npt.NDArray[np.float64]
INSIDE = 1e-9  # how far outside the reference cell a place may be that counts as in it
BULGE = 0.5  # by how much of its size a curved cell may exceed the box around its nodes, at most
STEPS = 30  # of Newton's method for places in cells that are not affine
SIDES = ("lower", "upper")


@dataclass(frozen=True)
class Located:
    """The cells of a joint that contain places: all of them, for a place on a facet lies in several.

    Attributes:
        joint: the joint, inflated or not.
        x: (n, d) the places.
        point: (m,) number of the place, ascending.
        cell: (m,) a cell that contains it.
        X: (m, d) its coordinates in the reference cell.
    """

    joint: Joint
    x: Array
    point: IntArray
    cell: IntArray
    X: Array

    @classmethod
    def of(cls, joint: Joint, x: Any) -> Located:
        """The cells that contain places (n, d), or one place (d,).

        Raises:
            ModelError: no finite numbers of this shape; a place that is in no cell.
        """
        try:
            found = np.atleast_2d(real(x))
        except (TypeError, ValueError):
            found = np.empty((0, 0))
        if found.ndim != 2 or not found.size or found.shape[1] != joint.dim or not np.isfinite(found).all():
            raise ModelError(f"places are {x!r:.80}; they need {joint.dim} finite coordinates each, (n, {joint.dim})")
        nodes = joint.cell_points
        low, high = nodes.min(axis=1), nodes.max(axis=1)
        margin = (high - low).max(axis=1, keepdims=True) * (BULGE if joint.degree > 1 else INSIDE)
        low, high = low - margin, high + margin
        radius = float(np.linalg.norm(high - low, axis=1).max()) / 2
        near = cKDTree((low + high) / 2).query_ball_point(found, radius * (1 + INSIDE))
        point = np.repeat(np.arange(len(found)), [len(one) for one in near])
        cell = np.array([k for one in near for k in sorted(one)], np.int64)
        boxed = ((found[point] >= low[cell]) & (found[point] <= high[cell])).all(axis=1)
        point, cell = point[boxed], cell[boxed]
        X = _pulled_back(joint, cell, found[point])
        inside = _is_inside(X, is_tensor(joint.cell_type))
        located = cls(joint, found, point[inside], cell[inside], X[inside])
        missing = np.setdiff1d(np.arange(len(found)), located.point)
        if len(missing):
            first = place(found[missing[0]])
            raise ModelError(f"{len(missing)} of {len(found)} places are in no cell of the mesh, the first at {first}")
        return located

    def facets(self) -> tuple[IntArray, IntArray, IntArray]:
        """(k,) each: positions among the cells found, rows of facets of S on which places lie, and the side of the cell.

        The side is 0 for the cell below a facet and 1 for that above it.
        """
        joint, rows = self.joint, self.joint.surface_rows
        kind = basix.CellType[joint.cell_type]
        normals = basix.cell.facet_outward_normals(kind)
        starts = np.array([basix.geometry(kind)[one[0]] for one in basix.topology(kind)[-2]])
        found = []
        for side in (0, 1):
            cells = joint.surface_cells[:, side]
            which = np.where(joint.table.cells[rows, 0] == cells, 0, 1)
            local = np.take_along_axis(joint.table.local[rows], which[:, None], axis=1)[:, 0]
            order = np.argsort(cells, kind="stable")
            start, end = (np.searchsorted(cells[order], self.cell, way) for way in ("left", "right"))
            at = np.repeat(np.arange(len(self.cell)), end - start)
            row = order[start[at] + np.arange(len(at)) - np.repeat(np.cumsum(end - start) - (end - start), end - start)]
            facet = local[row]
            off = np.abs(np.einsum("kd,kd->k", self.X[at] - starts[facet], normals[facet]))
            on = off <= INSIDE
            found.append((at[on], rows[row[on]], np.full(on.sum(), side)))
        at, row, side = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return at, row, side

    def on_seam(self, seam: str) -> Located:
        """The same; raises ModelError for an unknown seam, or places that are not on this one ("S": on any)."""
        if seam not in (S, *self.joint.seams):
            raise ModelError(unknown("seam", seam, self.joint.seams))
        at, row, _ = self.facets()
        off = np.setdiff1d(np.arange(len(self.x)), self.point[at[np.isin(row, self.joint.rows_of(seam))]])
        if len(off):
            raise ModelError(
                f"{len(off)} of {len(self.x)} places are not on {seam}, the first at {place(self.x[off[0]])}"
            )
        return self

    def on_side(self, name: str, seam: str) -> Located:
        """The same with the cells on one side of a seam ("S": of all) alone, for places on it; others keep their cells.

        Raises:
            ModelError: no side; an unknown seam; a rigid base, which has no cells below.
        """
        if name not in SIDES:
            raise ModelError(f"side is {name!r}; allowed: lower, upper")
        if seam not in (S, *self.joint.seams):
            raise ModelError(unknown("seam", seam, self.joint.seams))
        at, row, side = self.facets()
        here = np.isin(row, self.joint.rows_of(seam))
        at, side = at[here], side[here]
        wanted = np.unique(at[side == SIDES.index(name)])
        on_s = np.unique(self.point[at])
        without = np.setdiff1d(on_s, self.point[wanted])
        if len(without):
            raise ModelError(
                f"there is no body on the {name} side of S at {place(self.x[without[0]])}, but a rigid base"
            )
        kept = ~np.isin(self.point, on_s)
        kept[wanted] = True
        return Located(self.joint, self.x, self.point[kept], self.cell[kept], self.X[kept])


def _pulled_back(joint: Joint, cells: IntArray, x: Array) -> Array:
    """Coordinates (n, d) in the reference cell of places x (n, d) in cells (n,), outside it for places elsewhere."""
    element, nodes = lagrange(joint.cell_type, joint.degree), joint.cell_points[cells]
    X = np.tile(basix.geometry(basix.CellType[joint.cell_type]).mean(axis=0), (len(x), 1))
    if not len(x):  # basix takes no empty arrays
        return X
    for _ in range(STEPS):
        table = element.tabulate(1, X)[..., 0]
        there = np.einsum("pn,pnd->pd", table[0], nodes)
        slopes = np.einsum("tpn,pnd->pdt", table[1:], nodes)
        step = np.einsum("pij,pj->pi", np.linalg.pinv(slopes), x - there)
        X = np.clip(X + step, -1.0, 2.0)
        if np.abs(step).max(initial=0.0) < INSIDE**2:
            break
    there = np.einsum("pn,pnd->pd", element.tabulate(0, X)[0, :, :, 0], nodes)
    sizes = np.ptp(nodes, axis=1).max(axis=1)
    X[np.linalg.norm(x - there, axis=1) > INSIDE * sizes] = 2.0
    return X


def _is_inside(X: Array, tensor: bool) -> npt.NDArray[np.bool_]:
    last = X.max(axis=1, initial=-np.inf) if tensor else X.sum(axis=1)
    return np.asarray((X >= -INSIDE).all(axis=1) & (last <= 1 + INSIDE))
