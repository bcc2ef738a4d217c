"""Sweeps over nodes in contact solve the law's equations, hold what is held, and have the least energy."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp
from scipy import linalg
from scipy.optimize import minimize

from forms.contact import Status, Tresca
from tests.contact_laws import EXACT, LAWS
from thinlayer.solving.contact.pairs import ContactPairs

pytestmark = pytest.mark.few(5)


def stiffness(rng, size, spread=1e3):
    """Symmetric and positive definite, eigenvalues from 1 to `spread`."""
    axes = np.linalg.qr(rng.normal(size=(size, size)))[0]
    return (axes * np.geomspace(1, spread, size)) @ axes.T


def pairs_of(law, ends, frames, weights, slip, gap=None, bc_dofs=()):
    """Pairs of nodes, upper and lower one."""
    d = frames.shape[1]
    gap = np.zeros(len(ends)) if gap is None else gap
    nodes = SimpleNamespace(dim=d, global_pairs=ends, frames=frames, weights=weights, gap=gap)
    mask = np.zeros((ends.max() + 1) * d, bool)
    mask[list(bc_dofs)] = True
    return ContactPairs([SimpleNamespace(nodes=nodes, law_now=law, slip=slip)], mask)


def problem(rng, law, ends, d, spread=1e3):
    """Pairs with axes, gaps and slip of their own, a stiffness, and forces that press, pull and shear."""
    count, n = len(ends), ends.max() + 1
    frames = np.linalg.qr(rng.normal(size=(count, d, d)))[0]
    slip, gap, weights = rng.normal(size=(count, d - 1)), rng.normal(size=count), 10 ** rng.uniform(-1, 1, count)
    A = sp.bsr_matrix(stiffness(rng, n * d, spread), blocksize=(d, d))
    return pairs_of(law, ends, frames, weights, slip, gap), A, A @ rng.normal(size=n * d) + 10 * rng.normal(size=n * d)


def residual(pairs, A, g, u):
    """Of the equations of all nodes, relative to the largest of their terms."""
    forces = pairs.forces(pairs.jumps_with_gaps(u))
    return np.abs(A @ u + forces - g).max() / (abs(A) @ np.abs(u) + np.abs(forces) + np.abs(g)).max()


ALONE = np.array([[0, -1]])
TWO = np.array([[0, -1], [0, -1]])  # as where a body meets two others


# ------------------------------------------------------------------ a node
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("ends", [ALONE, TWO], ids=["one pair", "two"])
@pytest.mark.parametrize("stiff", [1.0, 1e3])
@pytest.mark.parametrize("name", LAWS)
def test_a_node_is_solved(name, stiff, ends, d):
    """In all regimes; hardly any nodes with strong friction, which have several solutions or none, stay as they were."""
    rng = np.random.default_rng(d)
    law, statuses, failed = replace(LAWS[name], K_N=3.0 * stiff, K_T=stiff), set(), 0
    for trial in range(300):
        pairs, A, g = problem(rng, law, ends, d)
        u = np.zeros(d)
        if pairs.sweep(A, g, u, 1):
            failed += 1
            assert not u.any()
            continue
        assert residual(pairs, A, g, u) < 10 * EXACT, trial
        statuses |= set(law.status(pairs.jumps_with_gaps(u), pairs._parts[0].slip))
    assert failed <= (9 if name == "strong friction" else 3)
    assert statuses == set(Status) - ({Status.STICK} if name == "no friction" else set())


# ------------------------------------------------------------------ many nodes
@pytest.mark.few(1)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("law", [*LAWS.values(), LAWS["Coulomb"].homotopy(0.3)], ids=[*LAWS, "eased"])
def test_sweeps_converge(law, d):
    """Nodes that meet each other and a base, in one pair or several, in sparse blocks of any order; what is held rests."""
    rng = np.random.default_rng(11)
    ends = np.array([(0, 1), (0, 2), (1, -1), (2, 3), (3, -1), (4, 5), (5, 0), (6, -1), (7, 6)])
    pairs, A, g = problem(rng, law, ends, d, 20.0)
    u = np.zeros(len(g))
    pairs.sweep(A, g, u, 400)
    assert residual(pairs, A, g, u) < 10 * EXACT
    back = np.concatenate([np.arange(a, b)[::-1] for a, b in zip(A.indptr[:-1], A.indptr[1:], strict=True)])
    shuffled = sp.bsr_matrix((A.data[back], A.indices[back], A.indptr), shape=A.shape)
    again = np.zeros(len(g))
    pairs.sweep(shuffled, g, again, 400)
    np.testing.assert_allclose(again, u, rtol=1e-9, atol=1e-9)
    pairs.free[2:] = False
    pairs.free[3, 0] = True
    once = np.full(len(g), 0.5)
    pairs.sweep(A, g, once, 1)
    assert np.array_equal(once != 0.5, pairs.free.ravel())
    assert residual(pairs, A, g, once) > 1e-3


@pytest.mark.parametrize("d", [2, 3])
def test_least_energy(d):
    """The problem with a threshold that does not depend on the pressure is the minimum of a convex energy."""
    rng = np.random.default_rng(2)
    law = Tresca(3.0, 1.0, 0.8)
    pairs, A, g = problem(rng, law, np.column_stack([np.arange(6), np.full(6, -1)]), d, 20.0)
    slip, weights = pairs._parts[0].slip, pairs.weights

    def energy(u):
        w = pairs.jumps_with_gaps(u)
        shear = np.linalg.norm(w[:, :-1] - slip, axis=1)
        beyond = law.bound * (shear - law.bound / (2 * law.K_T))
        huber = np.where(law.K_T * shear <= law.bound, law.K_T * shear**2 / 2, beyond)
        return u @ (A @ u) / 2 - u @ g + weights @ (law.K_N * np.maximum(-w[:, -1], 0) ** 2 / 2 + huber)

    u = np.zeros(len(g))
    pairs.sweep(A, g, u, 400)
    least = minimize(energy, np.zeros(len(g)), method="BFGS", options={"gtol": 1e-6})
    np.testing.assert_allclose(u, least.x, atol=1e-5 * np.abs(u).max())
    assert energy(u) <= least.fun + 1e-9 * abs(least.fun)


def test_numbers_that_are_not_finite():
    """A node without a solution keeps its displacement and is counted; the others are solved."""
    rng = np.random.default_rng(0)
    law, ends = LAWS["Coulomb"], np.array([[0, -1], [1, -1]])
    for d in (2, 3):
        pairs, _, g = problem(rng, law, ends, d)
        A = sp.bsr_matrix(linalg.block_diag(stiffness(rng, d), stiffness(rng, d)), blocksize=(d, d))
        g[0], u = np.nan, np.full(2 * d, 0.5)
        assert pairs.sweep(A, g, u, 1) == 1
        assert (u[:d] == 0.5).all()
        assert (u[d:] != 0.5).all()
