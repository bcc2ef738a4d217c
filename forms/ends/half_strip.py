"""The free end of a layer between rigid faces: plane strain on the half strip x > 0, 0 < y < 1, and its constants.

The faces y = 0 and y = 1 are moved by -+w/2 across the layer (N) or along it (T), and the end x = 0 is free. Far from
it the strain is uniform; near it the layer is weaker. Lengths are over the thickness of the layer, stresses over mu.

A few quadrilaterals shrink towards the singular corner, with displacements of a high degree p and pressures of degree
p - 2. The pressures are discontinuous, so that nothing locks up to an incompressible material. What is inside a
quadrilateral is eliminated there; unknowns of the whole are the displacements on sides and one pressure in each of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from numpy.polynomial import legendre
from scipy.sparse.linalg import splu

from forms.base import Array
from forms.ends.constants import FreeEnd, flow_factor, lame_over_mu

Numbers = npt.NDArray[np.int64]

MIDDLE = 0.5  # y of the middle line, where the faces are at 0 and 1
FAR = 14.0  # where what decays over the thickness has gone
RATIO = 0.2  # of the sizes of cells that shrink towards the corner
LEVELS, DEGREE = 11, 12  # how often they shrink, and the degree of displacements: constants to ten digits
SPLIT = -0.5  # first Lame modulus over mu that is left beside the pressure: the rest stays positive definite
SIDES = ((0, 1), (2, 3), (0, 2), (1, 3))  # corners of each side, in the order (-1, -1), (1, -1), (-1, 1), (1, 1)
ORDER = [0, 2, 1, 3]  # of the corners, the second coordinate first


@dataclass(frozen=True)
class Square:
    """Functions on the square -1 < a, b < 1: products of polynomials of one coordinate.

    Attributes:
        degree: p, of the displacements in each direction; >= 3, or 1 for corners.
    """

    degree: int

    @cached_property
    def nodes(self) -> Array:
        """Points of Gauss and Lobatto on [-1, 1], (p + 1,): each displacement is one at one of them."""
        inner = np.sort(legendre.legroots(legendre.legder(np.eye(self.degree + 1)[self.degree])))
        return np.concatenate([[-1.0], inner, [1.0]])

    @cached_property
    def _coefficients(self) -> Array:
        """Legendre coefficients of the functions of the nodes, (p + 1, p + 1)."""
        return np.asarray(np.linalg.inv(legendre.legvander(self.nodes, self.degree)))

    def line(self, x: Array) -> tuple[Array, Array]:
        """Values and slopes of the functions of the nodes at places x, each (len(x), p + 1)."""
        powers, functions = legendre.legvander(x, self.degree), self._coefficients
        return np.asarray(powers @ functions), np.asarray(powers[:, :-1] @ legendre.legder(functions))

    def at(self, x: Array) -> tuple[Array, Array]:
        """Values (n, (p + 1)^2) of displacements and slopes (n, 2, (p + 1)^2) at places x (n, 2)."""
        (A, dA), (B, dB) = (self.line(coordinate) for coordinate in x.T)
        return _products(A, B), np.stack([_products(dA, B), _products(A, dB)], axis=1)

    def pressures(self, x: Array) -> Array:
        """Values (n, (p - 1)^2) of pressures at places x (n, 2), orthogonal; the first one is constant, 1."""
        A, B = (legendre.legvander(coordinate, self.degree - 2) for coordinate in x.T)
        return _products(A, B)

    @cached_property
    def gauss(self) -> tuple[Array, Array]:
        """Points (q^2, 2) and weights (q^2,)."""
        points, weights = legendre.leggauss(self.degree + 3)
        both = np.meshgrid(points, points, indexing="ij")
        return np.stack([np.ravel(one) for one in both], axis=1), np.asarray(np.kron(weights, weights), float)

    def side(self, number: int) -> Numbers:
        """Nodes of a side from the first to the second of its `SIDES`; (p + 1,)."""
        every = np.arange((self.degree + 1) ** 2).reshape(self.degree + 1, -1)
        return np.asarray((every[:, 0], every[:, -1], every[0], every[-1])[number])


def _products(A: Array, B: Array) -> Array:
    """Products (n, k m) of functions of one coordinate, (n, k) and (n, m), at each place."""
    return np.asarray((A[:, :, None] * B[:, None]).reshape(len(A), A.shape[1] * B.shape[1]))


BILINEAR = Square(1)


class Quadrilateral:
    """One cell, with what is inside it eliminated.

    Args:
        square: its functions.
        corners: places (4, 2), in the order of `SIDES`.
        compliance: 1/(lmbda - SPLIT); >= 0.

    Attributes:
        places, weights: of its Gauss points, (q^2, 2) and (q^2,).
        matrix: of what is kept: displacements on its sides, then its mean pressure.
        kept: numbers of what is kept among all displacements, (p + 1)^2 x 2, and pressures of the cell.
    """

    def __init__(self, square: Square, corners: Array, compliance: float) -> None:
        self.square, self.corners = square, corners
        points, weights = square.gauss
        self.places, slopes = self.mapped(points)
        self.weights = weights * np.linalg.det(slopes)
        along_x, along_y = np.swapaxes(np.linalg.solve(slopes, square.at(points)[1]), 0, 1)
        first, second = np.array([[1.0, 0.0]]), np.array([[0.0, 1.0]])  # x and y of a node are side by side
        xx, yy = np.kron(along_x, first), np.kron(along_y, second)
        xy, volume, w = np.kron(along_y, first) + np.kron(along_x, second), xx + yy, self.weights[:, None]
        K = SPLIT * volume.T @ (w * volume) + 2 * (xx.T @ (w * xx) + yy.T @ (w * yy)) + xy.T @ (w * xy)
        P = square.pressures(points)
        B, C = P.T @ (w * volume), compliance * P.T @ (w * P)
        whole = np.block([[K, B.T], [B, -C]])
        sides = np.unique([square.side(k) for k in range(4)])
        self.kept = np.append(2 * sides[:, None] + [0, 1], len(K))
        self._lost = np.setdiff1d(np.arange(len(whole)), self.kept)
        self._inside = -np.linalg.solve(whole[np.ix_(self._lost, self._lost)], whole[np.ix_(self._lost, self.kept)])
        matrix = whole[np.ix_(self.kept, self.kept)] + whole[np.ix_(self.kept, self._lost)] @ self._inside
        self.matrix = (matrix + matrix.T) / 2

    def mapped(self, at: Array) -> tuple[Array, Array]:
        """Places (n, 2) of places in the square, and their slopes (n, 2, 2), [:, k] along its k-th coordinate."""
        values, slopes = BILINEAR.at(at)
        return values @ self.corners[ORDER], slopes @ self.corners[ORDER]

    def all_unknowns(self, kept: Array) -> Array:
        """All displacements and pressures of the cell from those that are kept."""
        unknowns = np.empty(len(self.kept) + len(self._lost))
        unknowns[self.kept], unknowns[self._lost] = kept, self._inside @ kept
        return unknowns

    def values(self, unknowns: Array, at: Array) -> tuple[Array, Array]:
        """Displacements (n, 2) and stresses 11, 22, 12 (n, 3) at places (n, 2) of the square."""
        shapes, slopes = self.square.at(at)
        count = 2 * shapes.shape[1]
        nodal = unknowns[:count].reshape(-1, 2)
        gradient = np.linalg.solve(self.mapped(at)[1], slopes @ nodal)  # (n, along, component)
        (xx, yx), (xy, yy) = np.moveaxis(gradient, 0, -1)
        rest = self.square.pressures(at) @ unknowns[count:] + SPLIT * (xx + yy)
        return shapes @ nodal, np.stack([rest + 2 * xx, rest + 2 * yy, xy + yx], axis=1)


@dataclass(frozen=True)
class Solution:
    """Displacements and pressures on the half strip.

    Attributes:
        cells: its quadrilaterals.
        unknowns: of each cell: displacements, then pressures.
        work: of the load, twice the energy.
    """

    cells: Sequence[Quadrilateral]
    unknowns: Sequence[Array]
    work: float

    def everywhere(self) -> tuple[Array, ...]:
        """Weights, places x and y, and stresses 11, 22, 12 at all Gauss points; each (points,)."""
        found = [
            np.column_stack([cell.weights, cell.places, cell.values(unknowns, cell.square.gauss[0])[1]])
            for cell, unknowns in zip(self.cells, self.unknowns, strict=True)
        ]
        return tuple(np.concatenate(found).T)


class HalfStrip:
    """The lower half of the strip, 0 < y < MIDDLE: a square whose cells shrink to its corner (0, 0), and a row of cells.

    Args:
        nu: Poisson's ratio, in [0, 0.5].
        degree: of the displacements; >= 3.
        levels: how often cells shrink by `RATIO` towards the corner.

    Attributes:
        lmbda: first Lame modulus over mu; math.inf for nu = 0.5.
        delta: length over which the pressure of N falls, all else does over a fraction of the thickness; 0 for nu = 0.5.
        points: vertices (n, 2).
        cells: the quadrilaterals.

    Raises:
        InputError: nu out of range.
    """

    def __init__(self, nu: float, degree: int = DEGREE, levels: int = LEVELS) -> None:
        self.lmbda = lame_over_mu(nu)
        self.delta = math.sqrt(self.lmbda / 12) if self.lmbda < math.inf else 0.0
        self.square, p = Square(degree), degree
        self.points, corners = self._mesh(levels)
        self.cells = [Quadrilateral(self.square, self.points[one], 1 / (self.lmbda - SPLIT)) for one in corners]
        pairs = np.sort(np.concatenate([corners[:, list(ends)] for ends in SIDES]), axis=1)
        self._sides, number = np.unique(pairs, axis=0, return_inverse=True)
        number = number.reshape(4, len(corners))
        inner = len(self.points) + np.arange(len(self._sides) * (p - 1)).reshape(-1, p - 1)
        self._nodes = np.concatenate([self._sides[:, :1], inner, self._sides[:, 1:]], axis=1)  # of each side
        start, end = np.swapaxes(self.points[self._sides], 0, 1)[:, :, None]
        self._x = np.empty((len(self.points) + inner.size, 2))  # places of the nodes on sides
        self._x[self._nodes] = start + (self.square.nodes[:, None] + 1) / 2 * (end - start)
        kept = []
        for k, (cell, vertices) in enumerate(zip(self.cells, corners, strict=True)):
            nodes = np.full((p + 1) ** 2, -1)
            for side, ends in enumerate(SIDES):
                own = self._nodes[number[side, k]]
                nodes[self.square.side(side)] = own if vertices[ends[0]] < vertices[ends[1]] else own[::-1]
            kept.append(np.append(2 * nodes[:, None] + [0, 1], self._x.size + k)[cell.kept])
        self._kept = np.array(kept)
        n, self._size = self._kept.shape[1], self._x.size + len(self.cells)
        rows, columns = np.repeat(self._kept, n, axis=1).ravel(), np.tile(self._kept, (1, n)).ravel()
        values = np.stack([cell.matrix for cell in self.cells]).ravel()
        self._matrix = sp.csc_matrix((values, (rows, columns)), shape=(self._size, self._size))

    def _mesh(self, levels: int) -> tuple[Array, Numbers]:
        """Vertices (n, 2) and the corners (m, 4) of cells."""
        points, cells = [(0.0, 0.0)], []
        for size in MIDDLE * RATIO ** np.arange(levels, -1, -1.0):  # a square, then pairs of trapezoids around it
            k = len(points)
            points += [(size, 0.0), (0.0, size), (size, size)]
            cells += [[0, 1, 2, 3]] if k == 1 else [[k - 2, k - 1, k + 1, k + 2], [k - 3, k, k - 1, k + 2]]
        right, step = [len(points) - 3, len(points) - 1], MIDDLE
        while points[-1][0] < max(FAR, 24 * self.delta):
            if points[-1][0] > FAR / 2:
                step = max(step, min(1.5 * step, 2 * self.delta))
            x, k = points[-1][0] + step, len(points)
            points += [(x, 0.0), (x, MIDDLE)]
            cells.append([right[0], k, right[1], k + 1])
            right = [k, k + 1]
        return np.array(points), np.array(cells)

    def loaded(self, traction: Callable[[Array], Array], odd: int) -> Solution:
        """The state under tractions on the end, where faces do not move.

        Args:
            traction: function of places (n, 2) -> (n, 2).
            odd: which component is zero on the middle line, 0 or 1.
        """
        load, (points, w) = np.zeros(self._size), legendre.leggauss(self.square.degree + 3)
        values, _ = self.square.line(points)
        for side in np.flatnonzero((self.points[self._sides, 0] == 0).all(axis=1)):
            start, end = self.points[self._sides[side]]
            at = start + (points[:, None] + 1) / 2 * (end - start)
            force = values.T @ (traction(at) * (w * np.linalg.norm(end - start) / 2)[:, None])
            load[2 * self._nodes[side][:, None] + [0, 1]] += force
        x, y = self._x.T
        held = np.zeros(self._size, bool)
        of_nodes = held[: self._x.size].reshape(-1, 2)
        of_nodes[(y == 0) | np.isclose(x, x.max())] = True
        of_nodes[np.isclose(y, MIDDLE), odd] = True
        free, u = np.flatnonzero(~held), np.zeros(self._size)
        u[free] = splu(self._matrix[free][:, free]).solve(load[free])
        unknowns = [cell.all_unknowns(u[kept]) for cell, kept in zip(self.cells, self._kept, strict=True)]
        return Solution(self.cells, unknowns, float(load @ u))


def half_strip(nu: float, degree: int = DEGREE, levels: int = LEVELS) -> FreeEnd:
    """Solve for the constants of a free end; arguments and errors as of `HalfStrip`."""
    strip = HalfStrip(nu, degree, levels)
    lmbda, M = strip.lmbda, strip.lmbda + 2
    # T: u_x is odd in y - 1/2; the end is pushed by mu w, which the uniform strain misses there
    sheared = strip.loaded(lambda x: np.full_like(x, 1.0) * [0, 1], odd=0)
    w, x, y, s11, _, s12 = sheared.everywhere()
    c_T, m_T = 2 * sheared.work, -2 * float(np.sum(w * (s12 * x + s11 * (y - MIDDLE))))
    if nu == 0.5:
        # Poiseuille's flow out of the end, 1/8 - (y - 1/2)^2/2 with the pressure x, has a shear stress on it
        flow = strip.loaded(lambda x: (MIDDLE - x[:, 1:]) * [0, 1], odd=1)
        return FreeEnd(nu, math.inf, math.inf, math.inf, c_T, m_T, 1 / (1 - 24 * flow.work))
    # N: u_y is odd in y - 1/2; the end is pressed by lmbda w, here by 1
    pressed = strip.loaded(lambda x: np.full_like(x, 1.0) * [1, 0], odd=1)
    w, x, y, s11, s22, s12 = pressed.everywhere()
    c_N, rho_N = 2 * pressed.work * lmbda**2 / M, -2 * float(np.sum(w * s11))
    m_N = -2 * lmbda / M * float(np.sum(w * (s22 * x + s12 * (y - MIDDLE))))
    kappa = flow_factor(strip.delta, c_N * M / lmbda - strip.delta) if lmbda else 0.0
    return FreeEnd(nu, c_N, m_N, rho_N, c_T, m_T, kappa)
