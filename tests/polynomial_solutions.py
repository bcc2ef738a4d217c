"""Exact polynomial solutions of elastic boxes of straight cells, their finite element solutions, and their bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import basix
import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from forms.tensors import isotropic_tensor
from geometry.topology import lagrange
from thinlayer.bounding.cells import StraightCells, mass_matrix
from thinlayer.bounding.loops import TractionImprovement
from thinlayer.bounding.stresses import Stresses
from thinlayer.bounding.subcells import Subcells
from thinlayer.bounding.tractions import CellLoads, TractionBalance

TRIANGLES = np.array([[0, 1, 3], [0, 2, 3]])
TETRAHEDRA = np.array([[0, 1, 3, 7], [0, 1, 5, 7], [0, 2, 3, 7], [0, 2, 6, 7], [0, 4, 5, 7], [0, 4, 6, 7]])


def box(counts, sizes, jitter, rng, cell_type=None):
    """Return points and corners of a box of simplices or quadrilaterals, with inner points moved at random."""
    d = len(counts)
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, n + 1) for n in counts], indexing="ij"), axis=-1).reshape(-1, d)
    inner = ((grid > 0) & (grid < 1)).all(axis=1)
    x = grid + jitter * inner[:, None] * rng.uniform(-0.3, 0.3, grid.shape) / np.array(counts)
    strides = np.array([int(np.prod(np.array(counts[k + 1 :]) + 1)) for k in range(d)])
    first = np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), axis=-1).reshape(-1, d) @ strides
    cube = np.array([[(k >> (d - 1 - i)) & 1 for i in range(d)] for k in range(2**d)]) @ strides
    if cell_type == "quadrilateral":
        return x * sizes, first[:, None] + cube
    return x * sizes, (first[:, None] + cube)[:, TRIANGLES if d == 2 else TETRAHEDRA].reshape(-1, d + 1)


class Polynomial:
    """A vector polynomial (d components) that vanishes where the supports of the box hold it."""

    def __init__(self, d, degree, rollers, rng):
        self.exponents = np.array([a for a in np.ndindex(*(degree + 1,) * d) if sum(a) <= degree])
        self.factors = rng.normal(size=(d, len(self.exponents)))
        for c in range(d):  # component c is zero on the plane x_c = 0, or all of them on x_0 = 0
            self.factors[c, self.exponents[:, c if rollers else 0] == 0] = 0.0

    def __call__(self, x, *derivatives):
        exponents, factor = self.exponents.astype(float), np.ones(len(self.exponents))
        for k in derivatives:
            factor = factor * exponents[:, k]
            exponents = exponents - (np.arange(exponents.shape[1]) == k)
        powers = np.prod(x[..., None, :] ** np.maximum(exponents, 0), axis=-1)
        return (powers * factor) @ self.factors.T


@dataclass
class Problem:
    """A box under the loads of an exact solution: cells, loads, displacements of the cells' nodes, and the solution."""

    cells: StraightCells
    loads: CellLoads
    U: np.ndarray
    exact: Polynomial
    K: object
    is_held: np.ndarray

    def stress(self, x, *derivatives):
        """Exact stresses (..., nv) at places inside cells, one row of places for each cell, or their derivatives."""
        d = self.cells.d
        gradient = np.stack([self.exact(x, k, *derivatives) for k in range(d)], axis=-1)
        return np.einsum("c...ij,rij,crs->c...s", gradient, self.cells.basis, self.cells.C)

    def solved(self, loads):
        """Displacements of the cells' nodes, and the vector of all nodes, under other loads."""
        cells = self.cells
        b = np.zeros((len(cells.node_vertices), cells.d))
        np.add.at(b, cells.nodes, cells.nodal_loads(loads.body_force))
        np.add.at(b, cells.facet_nodes, loads.moments.reshape(*cells.facet_nodes.shape, cells.d))
        free = ~self.is_held & np.repeat(np.isin(np.arange(len(b)), cells.nodes)[:, None], cells.d, axis=1)
        u, free = np.zeros(b.size), free.ravel()
        u[free] = scipy.sparse.linalg.spsolve(self.K[free][:, free].tocsc(), b.ravel()[free])
        return u.reshape(b.shape)[cells.nodes]

    def stress_in_equilibrium(self, U, loads, steps=8):
        """The seed, the stress in equilibrium and the balance."""
        subcells, stress = Subcells(self.cells, loads.is_free), self.cells.stress(U)
        moments, balance = TractionBalance(self.cells, loads.is_free).moments(stress, loads, U)
        stress, loads, stresses = subcells.stress(stress, U), subcells.loads(loads), Stresses(subcells.cells)
        seed, moments = stresses.of(stress), subcells.moments(moments, stress, loads)
        is_layer = np.zeros(len(subcells.cells.corners), bool)
        improvement = TractionImprovement(stresses, subcells.is_free, is_layer)
        return stresses, seed, improvement.improved(loads, moments, seed, steps), balance

    def squared_error(self):
        """Squared energy norm of the error of the finite element solution."""
        subcells = Subcells(self.cells, self.loads.is_free)
        cells = subcells.cells
        x, w = basix.make_quadrature(basix.CellType[cells.cell_type], 6)
        error = replace(self, cells=cells).stress(places(cells, x))
        error -= cells.stress_values(x) @ cells.stress(subcells.displacements(self.U))
        return float(np.einsum("cqr,crs,cqs,q,c->", error, cells.compliance, error, w, cells.J))


def places(cells, x):
    """Places (nc, k, d) in all cells of points `x` (k, d) of the reference cell."""
    return lagrange(cells.cell_type, 1).tabulate(0, x)[0, :, :, 0] @ cells.points[cells.corners]


def random_problem(d, rng, degree=None, rollers=None, cell_type=None):
    """Return a box with a random exact polynomial solution of one degree more than its cells."""
    p = degree or int(rng.choice([1, 2, 2]))
    counts = rng.integers(2, 6 if d == 2 else 3, size=d)
    points, corners = box([*counts], rng.uniform(0.3, 2, size=d), rng.uniform(0, 0.9), rng, cell_type)
    E, nu, nv = 10 ** rng.uniform(-2, 4), rng.uniform(0, 0.45), 3 * (d - 1)
    pick = [0, 1, 3] if d == 2 else [*range(6)]
    C = isotropic_tensor(E * nu / (1 + nu) / (1 - 2 * nu), E / 2 / (1 + nu))[np.ix_(pick, pick)]
    if rng.random() < 0.3:
        Q = rng.normal(size=(nv, nv))
        C = C + E * 0.5 * Q @ Q.T
    cell_type = cell_type or ("triangle" if d == 2 else "tetrahedron")
    cells = StraightCells(points, corners, cell_type, p, np.broadcast_to(C, (len(corners), nv, nv)))
    rollers = bool(rng.random() < 0.5) if rollers is None else rollers
    exact = Polynomial(d, p + 1, rollers, rng)
    n, m = cells.nodes.shape[1], cells.facet_nodes.shape[1]
    problem = Problem(cells, None, None, exact, None, None)
    at = places(cells, lagrange(cells.cell_type, p).points)
    f = -np.einsum("kcqr,rik->cqi", np.stack([problem.stress(at, k) for k in range(d)]), cells.basis)
    moments, mass = np.zeros((len(cells.facets), m, d)), mass_matrix(cells.facet_type, p)
    centres, is_free = points[cells.facets], np.repeat(~cells.is_outer[:, None], d, axis=1)
    for k in range(d):
        side = cells.is_outer & (np.abs(centres[:, :, k]) < 1e-12).all(axis=1)
        if rollers:
            is_free[side, k] = True
        elif k == 0:
            is_free[side] = True
    for facet in range(cells.sign.shape[1]):
        x = places(cells, cells.facet_points(facet))
        t = np.einsum("cqr,rij,cj->cqi", problem.stress(x), cells.basis, cells.area_vectors[:, facet])
        outer = cells.is_outer[cells.cell_facets[:, facet]]
        moments.reshape(-1, d)[cells.moment_rows[outer, facet]] = (mass @ t)[outer]
    moments[np.repeat(is_free[:, None], m, axis=1)] = 0.0
    loads = CellLoads(f, moments.reshape(-1, d), is_free, np.zeros((len(f), nv)))
    eye = np.eye(n * d).reshape(n * d, n, d)
    element = np.stack(
        [cells.nodal_forces(cells.stress(np.broadcast_to(e, f.shape))).reshape(len(f), -1) for e in eye], axis=2
    )
    dofs = (cells.nodes[:, :, None] * d + np.arange(d)).reshape(len(f), -1)
    size = len(cells.node_vertices) * d
    rows, columns = np.repeat(dofs, n * d, axis=1), np.tile(dofs, (1, n * d))
    K = scipy.sparse.csr_matrix((element.ravel(), (rows.ravel(), columns.ravel())), (size, size))
    is_held = np.zeros((len(cells.node_vertices), d), bool)
    for c in range(d):
        is_held[cells.facet_nodes[is_free[:, c] & cells.is_outer], c] = True
    problem = replace(problem, loads=loads, K=K, is_held=is_held)
    return replace(problem, U=problem.solved(loads))
