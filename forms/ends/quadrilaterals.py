"""Plane strain on a few quadrilaterals, with displacements of a high degree p and pressures of degree p - 2.

For fields with a singular corner, to many digits: quadrilaterals shrink towards it. The pressures are discontinuous, so
that nothing locks up to an incompressible material. What is inside a quadrilateral is eliminated there; unknowns of the
whole are the displacements on sides and one pressure in each quadrilateral. Stresses are over mu.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from numpy.polynomial import legendre
from scipy.sparse.linalg import splu

Array = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]

SPLIT = -0.5  # first Lame modulus over mu that is left beside the pressure: the rest stays positive definite
SIDES = ((0, 1), (2, 3), (0, 2), (1, 3))  # corners of each side, in the order (-1, -1), (1, -1), (-1, 1), (1, 1)


@dataclass(frozen=True)
class Square:
    """Functions on the square -1 < a, b < 1: products of polynomials of one coordinate.

    Attributes:
        degree: p, of the displacements in each direction; >= 3.
    """

    degree: int

    @cached_property
    def nodes(self) -> Array:
        """Points of Gauss and Lobatto on [-1, 1], (p + 1,): each displacement is one at one of them."""
        inner = np.sort(legendre.legroots(legendre.legder(np.eye(self.degree + 1)[self.degree])))
        return np.concatenate([[-1.0], inner, [1.0]])

    @cached_property
    def gauss(self) -> tuple[Array, Array]:
        """Points and weights on [-1, 1], each (q,)."""
        points, weights = legendre.leggauss(self.degree + 3)
        return np.asarray(points, float), np.asarray(weights, float)

    def line(self, x: Array) -> tuple[Array, Array]:
        """Values and slopes of the functions of the nodes at places x, each (len(x), p + 1)."""
        functions, derivatives = self._coefficients
        powers = legendre.legvander(x, self.degree)
        return np.asarray(powers @ functions), np.asarray(powers[:, :-1] @ derivatives)

    @cached_property
    def _coefficients(self) -> tuple[Array, Array]:
        """Legendre coefficients of the functions of the nodes, (p + 1, p + 1), and of their slopes, (p, p + 1)."""
        functions = np.linalg.inv(legendre.legvander(self.nodes, self.degree))
        return np.asarray(functions, float), np.asarray(legendre.legder(functions), float)

    def slopes(self, a: Array, b: Array) -> tuple[Array, Array]:
        """Slopes along a and along b at the places a X b, each (places, (p + 1)^2)."""
        (A, dA), (B, dB) = self.line(a), self.line(b)
        return np.asarray(np.kron(dA, B), np.float64), np.asarray(np.kron(A, dB), np.float64)

    def pressures(self, a: Array, b: Array) -> Array:
        """Pressures at the places a X b, (places, (p - 1)^2), orthogonal; the first one is constant, 1."""
        A, B = (legendre.legvander(x, self.degree - 2) for x in (a, b))
        return np.asarray(np.kron(A, B), np.float64)

    def pressures_at(self, at: Array) -> Array:
        """As `pressures`, at places (n, 2)."""
        A, B = (legendre.legvander(x, self.degree - 2) for x in at.T)
        return np.asarray((A[:, :, None] * B[:, None]).reshape(len(at), (self.degree - 1) ** 2), np.float64)

    def side(self, number: int) -> Numbers:
        """Nodes of a side, numbered a first, from the first to the second of its `SIDES`; (p + 1,)."""
        p = self.degree
        every = np.arange((p + 1) ** 2).reshape(p + 1, p + 1)
        return np.asarray((every[:, 0], every[:, p], every[0], every[p])[number])


def strains(along_x: Array, along_y: Array) -> tuple[Array, Array, Array]:
    """Strains 11, 22 and 2 x 12, of displacements with x and y of a node side by side, from slopes of its function."""
    e1, e2 = np.array([[1.0, 0.0]]), np.array([[0.0, 1.0]])
    return np.kron(along_x, e1), np.kron(along_y, e2), np.kron(along_y, e1) + np.kron(along_x, e2)


class Quadrilateral:
    """One cell, with what is inside it eliminated.

    Args:
        square: its functions.
        corners: places (4, 2), in the order of `SIDES`.
        compliance: 1/(lmbda - SPLIT); >= 0.

    Attributes:
        matrix: of what is kept: displacements on its sides, then its mean pressure.
        kept: numbers of what is kept among all displacements, (p + 1)^2 x 2, and pressures of the cell.
    """

    def __init__(self, square: Square, corners: Array, compliance: float) -> None:
        self.square, self.corners = square, corners
        p, points = square.degree, square.gauss[0]
        self.places, self.weights, (xx, yy, xy) = self._at(points, points)
        volume, w = xx + yy, self.weights[:, None]
        K = SPLIT * volume.T @ (w * volume) + 2 * (xx.T @ (w * xx) + yy.T @ (w * yy)) + xy.T @ (w * xy)
        P = square.pressures(points, points)
        B, C = P.T @ (w * volume), compliance * P.T @ (w * P)
        whole = np.block([[K, B.T], [B, -C]])
        sides = np.unique(np.concatenate([square.side(k) for k in range(4)]))
        self.kept = np.concatenate([(2 * sides[:, None] + [0, 1]).ravel(), [2 * (p + 1) ** 2]])
        self._lost = np.setdiff1d(np.arange(len(whole)), self.kept)
        self._inside = -np.linalg.solve(whole[np.ix_(self._lost, self._lost)], whole[np.ix_(self._lost, self.kept)])
        matrix = whole[np.ix_(self.kept, self.kept)] + whole[np.ix_(self.kept, self._lost)] @ self._inside
        self.matrix = (matrix + matrix.T) / 2

    def _at(self, a: Array, b: Array) -> tuple[Array, Array, tuple[Array, Array, Array]]:
        """Places (n, 2), weights of the area (n,) at Gauss points, and strains, at the places a X b of the square."""
        corners, w = self.corners, self.square.gauss[1]
        bilinear = Square(1)
        (A, dA), (B, dB) = bilinear.line(a), bilinear.line(b)
        order = [0, 2, 1, 3]  # a first
        along_a, along_b = np.kron(dA, B) @ corners[order], np.kron(A, dB) @ corners[order]
        area = along_a[:, 0] * along_b[:, 1] - along_a[:, 1] * along_b[:, 0]
        da, db = self.square.slopes(a, b)
        along_x = (along_b[:, 1:] * da - along_a[:, 1:] * db) / area[:, None]
        along_y = (along_a[:, :1] * db - along_b[:, :1] * da) / area[:, None]
        weights = np.kron(w, w) * area if len(a) == len(b) == len(w) else np.empty(0)
        return np.kron(A, B) @ corners[order], weights, strains(along_x, along_y)

    def all_unknowns(self, kept: Array) -> Array:
        """All displacements and pressures of the cell from those that are kept."""
        found = np.empty(len(self.kept) + len(self._lost))
        found[self.kept], found[self._lost] = kept, self._inside @ kept
        return found

    def stresses(self, unknowns: Array, a: Array, b: Array) -> tuple[Array, Array]:
        """Places (n, 2) and stresses 11, 22 and 12, (3, n), at the places a X b of the square."""
        n = 2 * (self.square.degree + 1) ** 2
        places, _, (xx, yy, xy) = self._at(a, b)
        u = unknowns[:n]
        rest = self.square.pressures(a, b) @ unknowns[n:] + SPLIT * ((xx + yy) @ u)
        return places, np.stack([rest + 2 * (xx @ u), rest + 2 * (yy @ u), xy @ u])


class Grid:
    """Quadrilaterals that share sides.

    Args:
        points: vertices (n, 2).
        cells: their corners (m, 4), in the order of `SIDES`.
        lmbda: first Lame modulus over mu; >= 0 or math.inf.
        degree: of the displacements; >= 3.

    Attributes:
        cells: the quadrilaterals.
        sides: pairs of vertices of all sides, (s, 2).
    """

    def __init__(self, points: Array, cells: Numbers, lmbda: float, degree: int) -> None:
        self.square, self.points, p = Square(degree), points, degree
        self.cells = [Quadrilateral(self.square, points[corners], 1 / (lmbda - SPLIT)) for corners in cells]
        pairs = np.sort(np.concatenate([cells[:, list(ends)] for ends in SIDES]), axis=1)
        self.sides, number = np.unique(pairs, axis=0, return_inverse=True)
        number = number.reshape(4, len(cells))
        inner = len(points) + np.arange(len(self.sides) * (p - 1)).reshape(len(self.sides), p - 1)
        self.side_nodes = np.concatenate([self.sides[:, :1], inner, self.sides[:, 1:]], axis=1)
        n_nodes = len(points) + inner.size
        self._kept = []
        for k, corners in enumerate(cells):
            nodes = np.full((p + 1) ** 2, -1)
            for side, ends in enumerate(SIDES):
                own = self.side_nodes[number[side, k]]
                nodes[self.square.side(side)] = own if corners[ends[0]] < corners[ends[1]] else own[::-1]
            kept = np.concatenate([(2 * nodes[:, None] + [0, 1]).ravel(), [2 * n_nodes + k]])
            self._kept.append(kept[self.cells[k].kept])
        self.size = 2 * n_nodes + len(cells)
        self._matrix = self._assembled()

    def _assembled(self) -> sp.csc_matrix:
        kept = np.stack(self._kept)
        n = kept.shape[1]
        rows, columns = np.repeat(kept, n, axis=1).ravel(), np.tile(kept, (1, n)).ravel()
        values = np.stack([one.matrix for one in self.cells]).ravel()
        return sp.csc_matrix((values, (rows, columns)), shape=(self.size, self.size))

    def on(self, where: Callable[[Array], npt.NDArray[np.bool_]]) -> Numbers:
        """Numbers of the sides with both vertices where a function of places (n, 2) is true."""
        return np.flatnonzero(where(self.points)[self.sides].all(axis=1))

    def unknowns(self, sides: Numbers, *components: int) -> Numbers:
        """Numbers of displacements, along x (0) or y (1), at the nodes of sides."""
        nodes = np.unique(self.side_nodes[sides])
        return (2 * nodes[:, None] + components).ravel()

    def load(self, sides: Numbers, traction: Callable[[Array], Array]) -> Array:
        """Work of a traction, a function of places (n, 2) -> (n, 2), on straight sides; (size,)."""
        f, (points, w) = np.zeros(self.size), self.square.gauss
        values, _ = self.square.line(points)
        for side in sides:
            start, end = self.points[self.sides[side]]
            at = start + (points[:, None] + 1) / 2 * (end - start)
            force = values.T @ (traction(at) * (w * np.linalg.norm(end - start) / 2)[:, None])
            f[2 * self.side_nodes[side][:, None] + [0, 1]] += force
        return f

    def solve(self, load: Array, held: Numbers) -> Solution:
        """Displacements and pressures under a load, where some displacements are held at zero."""
        free = np.setdiff1d(np.arange(self.size), held)
        u = np.zeros(self.size)
        u[free] = splu(self._matrix[free][:, free]).solve(load[free])
        cells = [cell.all_unknowns(u[kept]) for cell, kept in zip(self.cells, self._kept, strict=True)]
        return Solution(self, cells, float(load @ u))


@dataclass(frozen=True)
class Solution:
    """Displacements and pressures on a grid.

    Attributes:
        grid: the grid.
        unknowns: of each cell: displacements, then pressures.
        work: of the load, twice the energy.
    """

    grid: Grid
    unknowns: list[Array]
    work: float

    def everywhere(self) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Weights, places x and y, and stresses 11, 22, 12 at all Gauss points; each (points,)."""
        points, _ = self.grid.square.gauss
        found = []
        for cell, unknowns in zip(self.grid.cells, self.unknowns, strict=True):
            places, stresses = cell.stresses(unknowns, points, points)
            found.append(np.concatenate([cell.weights[None], places.T, stresses]))
        return tuple(np.concatenate(found, axis=1))

    def along_top(self, y: float) -> tuple[Array, Array, Array, Array, Array, Array]:
        """As `everywhere`, on the sides (-1, 1), (1, 1) of cells that lie on this y, with weights of their length."""
        points, w = self.grid.square.gauss
        found = []
        for cell, unknowns in zip(self.grid.cells, self.unknowns, strict=True):
            if (cell.corners[2:, 1] == y).all():
                places, stresses = cell.stresses(unknowns, points, np.array([1.0]))
                weights = w * (cell.corners[3, 0] - cell.corners[2, 0]) / 2
                found.append(np.concatenate([weights[None], places.T, stresses]))
        return tuple(np.concatenate(found, axis=1))
