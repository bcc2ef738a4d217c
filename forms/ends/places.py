"""Displacements and stresses of solutions on quadrilaterals, at places."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from forms.ends.quadrilaterals import SPLIT, Array, Quadrilateral, Solution, Square

INSIDE = 1e-9  # how far outside the square -1 < a, b < 1 a place may be that counts as in it
STEPS = 4  # of Newton's method for places in trapezoids, one coordinate of which is known at once
BILINEAR = Square(1)
ORDER = [0, 2, 1, 3]  # of the corners, a first


def values_at(solutions: Sequence[Solution], x: Array) -> tuple[Array, Array]:
    """Displacements (m, n, 2) and stresses 11, 22, 12 (m, n, 3) of solutions on one grid at places (n, 2).

    They are zero outside the grid.
    """
    u, stress = np.zeros((len(solutions), len(x), 2)), np.zeros((len(solutions), len(x), 3))
    grid = solutions[0].grid
    corners = np.stack([cell.corners for cell in grid.cells])
    low, high = corners.min(axis=1), corners.max(axis=1)
    margin = INSIDE * (high - low)
    near = ((x[:, None] >= low - margin) & (x[:, None] <= high + margin)).all(axis=2)
    for k in np.flatnonzero(near.any(axis=0)):
        places = np.flatnonzero(near[:, k])
        at = _pulled_back(grid.cells[k], x[places])
        inside = (np.abs(at) <= 1 + 10 * INSIDE).all(axis=1)
        unknowns = np.stack([one.unknowns[k] for one in solutions])
        u[:, places[inside]], stress[:, places[inside]] = _values(grid.cells[k], unknowns, at[inside])
    return u, stress


def _jacobians(cell: Quadrilateral, at: Array) -> tuple[Array, Array]:
    """Places (n, 2) and their slopes (n, 2, 2), [:, k] along the k-th coordinate of the square."""
    (A, dA), (B, dB) = BILINEAR.line(at[:, 0]), BILINEAR.line(at[:, 1])
    corners = cell.corners[ORDER]
    return _products(A, B) @ corners, np.stack([_products(dA, B) @ corners, _products(A, dB) @ corners], axis=1)


def _products(A: Array, B: Array) -> Array:
    """Products (n, k m) of functions of one coordinate, (n, k) and (n, m), at each place."""
    return np.asarray((A[:, :, None] * B[:, None]).reshape(len(A), A.shape[1] * B.shape[1]))


def _pulled_back(cell: Quadrilateral, x: Array) -> Array:
    """Coordinates (n, 2) in the square of places (n, 2)."""
    at = np.zeros_like(x)
    for _ in range(STEPS):
        there, slopes = _jacobians(cell, at)
        step = np.linalg.solve(np.swapaxes(slopes, 1, 2), (x - there)[..., None])[..., 0]
        at = np.clip(at + step, -3.0, 3.0)
    return at


def _values(cell: Quadrilateral, unknowns: Array, at: Array) -> tuple[Array, Array]:
    """Displacements (m, n, 2) and stresses (m, n, 3) from the unknowns (m, size) at places (n, 2) of the square."""
    square, n = cell.square, 2 * (cell.square.degree + 1) ** 2
    (A, dA), (B, dB) = square.line(at[:, 0]), square.line(at[:, 1])
    nodal = unknowns[:, :n].reshape(len(unknowns), -1, 2)
    u = _products(A, B) @ nodal
    along = np.stack([_products(dA, B) @ nodal, _products(A, dB) @ nodal], axis=2)  # (m, n, square, component)
    gradient = np.linalg.solve(_jacobians(cell, at)[1], along)  # (m, n, along, component)
    volume = gradient[..., 0, 0] + gradient[..., 1, 1]
    rest = unknowns[:, n:] @ square.pressures_at(at).T + SPLIT * volume
    shear = gradient[..., 0, 1] + gradient[..., 1, 0]
    return u, np.stack([rest + 2 * gradient[..., 0, 0], rest + 2 * gradient[..., 1, 1], shear], axis=2)
