"""Displacements and stresses of a solution on quadrilaterals, at places."""

from __future__ import annotations

import numpy as np

from forms.ends.quadrilaterals import SPLIT, Array, Quadrilateral, Solution, Square

INSIDE = 1e-9  # how far outside the square -1 < a, b < 1 a place may be that counts as in it
STEPS = 4  # of Newton's method for places in trapezoids, one coordinate of which is known at once
BILINEAR = Square(1)
ORDER = [0, 2, 1, 3]  # of the corners, a first


def values_at(solution: Solution, x: Array) -> tuple[Array, Array]:
    """Displacements (n, 2) and stresses 11, 22, 12 (n, 3) at places (n, 2); zero outside the grid."""
    u, stress = np.zeros((len(x), 2)), np.zeros((len(x), 3))
    for cell, unknowns in zip(solution.grid.cells, solution.unknowns, strict=True):
        low, high = cell.corners.min(axis=0), cell.corners.max(axis=0)
        margin = INSIDE * (high - low)
        near = np.flatnonzero(((x >= low - margin) & (x <= high + margin)).all(axis=1))
        at = _pulled_back(cell, x[near])
        inside = (np.abs(at) <= 1 + 10 * INSIDE).all(axis=1)
        u[near[inside]], stress[near[inside]] = _values(cell, unknowns, at[inside])
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
    square, n = cell.square, 2 * (cell.square.degree + 1) ** 2
    (A, dA), (B, dB) = square.line(at[:, 0]), square.line(at[:, 1])
    nodal = unknowns[:n].reshape(-1, 2)
    u = _products(A, B) @ nodal
    along = np.stack([_products(dA, B) @ nodal, _products(A, dB) @ nodal], axis=1)  # (n, square, component)
    gradient = np.linalg.solve(_jacobians(cell, at)[1], along)  # (n, along, component)
    volume = gradient[:, 0, 0] + gradient[:, 1, 1]
    rest = np.einsum("nk,k->n", square.pressures_at(at), unknowns[n:]) + SPLIT * volume
    shear = gradient[:, 0, 1] + gradient[:, 1, 0]
    return u, np.stack([rest + 2 * gradient[:, 0, 0], rest + 2 * gradient[:, 1, 1], shear], axis=1)
