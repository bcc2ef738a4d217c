"""Sweeps over contact nodes solve the law's equations, have the least energy, and agree with the law written in UFL."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc
from mpi4py import MPI
from scipy.optimize import minimize

from forms.contact import HolonomicCoulomb, Status, Tresca
from tests.contact_laws import EXACT, LAWS
from thinlayer.solving.contact.gauss_seidel import sweep_nodes

pytestmark = pytest.mark.few(5)


def stiffness(rng, size, spread=1e3):
    """Symmetric and positive definite, eigenvalues from 1 to `spread`."""
    axes = np.linalg.qr(rng.normal(size=(size, size)))[0]
    return (axes * np.geomspace(1, spread, size)) @ axes.T


def problem(rng, n, d):
    """n contact nodes with axes of their own, a moved base and forces that press, pull and shear: keywords."""
    frames = np.linalg.qr(rng.normal(size=(n, d, d)))[0]
    base, A = rng.normal(size=(n, d)), stiffness(rng, n * d)
    g = (A @ base.ravel()).reshape(n, d) + 10 * rng.normal(size=(n, d))
    return {"matrix": A, "g": g, "base": base, "frames": frames, "weights": 10 ** rng.uniform(-1, 1, n)}


def jumps(case, u):
    return np.einsum("nij,nj->ni", case["frames"], u - case["base"])


def forces(case, law, u, slip=None):
    """Of S on the nodes, in global axes, with the other sign."""
    t = law.traction(jumps(case, u), slip)
    return np.einsum("nji,nj->ni", case["frames"], t) * case["weights"][:, None]


def residual(case, law, u, slip=None):
    """Of the equations of all nodes, relative to the largest of their terms."""
    A, held = case["matrix"], forces(case, law, u, slip)
    terms = np.abs(A) @ np.abs(u.ravel()) + np.abs(held).ravel() + np.abs(case["g"]).ravel()
    return np.abs(A @ u.ravel() + (held - case["g"]).ravel()).max() / terms.max()


def solved(case, law, sweeps=1, **given):
    u = np.zeros_like(case["g"])
    change = sweep_nodes(u=u, numbers=law.numbers, sweeps=sweeps, **case, **given)
    assert np.isfinite(change)
    return u


# ------------------------------------------------------------------ a node


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("stiff", [1.0, 1e3, 1e9])
@pytest.mark.parametrize("name", LAWS)
def test_a_node_is_solved(name, stiff, d):
    """500 nodes in all regimes: the law's traction at the solution balances the forces."""
    rng = np.random.default_rng(d)
    law = replace(LAWS[name], K_N=3.0 * stiff, K_T=stiff)
    found = set()
    for trial in range(500):
        case = problem(rng, 1, d)
        slip = rng.normal(size=(1, d - 1)) if trial % 2 else None
        u = solved(case, law, slip=slip)
        # of the nodes that touch, the displacement has the rounding of the base's, which stiff springs multiply
        noise = 1e-16 * stiff * 30
        assert residual(case, law, u, slip) < EXACT + noise, trial
        found.add(law.status(jumps(case, u), slip)[0])
    assert found == set(Status) - ({Status.STICK} if name == "no friction" else set())


@pytest.mark.parametrize("d", [2, 3])
def test_a_stiff_node_without_a_base(d):
    """With a base at rest nothing is lost by rounding, however stiff the springs are."""
    rng = np.random.default_rng(7)
    for law in (HolonomicCoulomb(3e9, 1e9, 0.4), HolonomicCoulomb(3e9, 1e9, 3.0), Tresca(3e9, 1e9, 2.0)):
        for _ in range(500):
            case = problem(rng, 1, d) | {"base": np.zeros((1, d)), "g": 10 * rng.normal(size=(1, d))}
            case["frames"] = np.eye(d)[None]
            assert residual(case, law, solved(case, law)) < EXACT


@pytest.mark.parametrize("d", [2, 3])
def test_what_is_not_the_solution(d):
    """The residual sees a wrong sign of the normal, a lost weight, slip, base or threshold, and another cohesion."""
    rng = np.random.default_rng(3)
    law = HolonomicCoulomb(3.0, 1.0, 0.4, 1.0)
    worst = dict.fromkeys(["right", "normal", "weight", "slip", "base", "cohesion"], 0.0)
    for _ in range(50):
        case = problem(rng, 1, d)
        slip = rng.normal(size=(1, d - 1))
        flipped = case["frames"] * np.array([1.0] * (d - 1) + [-1.0])[:, None]
        twins = {
            "right": solved(case, law, slip=slip),
            "normal": solved(case | {"frames": flipped}, law, slip=slip),
            "weight": solved(case | {"weights": np.ones(1)}, law, slip=slip),
            "slip": solved(case, law, slip=-slip),
            "base": solved(case | {"base": -case["base"]}, law, slip=slip),
            "cohesion": solved(case, replace(law, cohesion=0.0), slip=slip),
        }
        worst = {name: max(worst[name], residual(case, law, u, slip)) for name, u in twins.items()}
    assert worst.pop("right") < EXACT
    assert min(worst.values()) > 1e-3, worst


@pytest.mark.few(1)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("name", LAWS)
def test_many_nodes(name, d):
    """Sweeps converge; both layouts of the matrix give the same; a sweep moves only what may move."""
    rng = np.random.default_rng(11)
    n, law = 12, LAWS[name]
    case = problem(rng, n, d) | {"matrix": stiffness(rng, n * d, 20.0)}
    slip = rng.normal(size=(n, d - 1))
    u = solved(case, law, sweeps=400, slip=slip)
    assert residual(case, law, u, slip) < EXACT
    in_blocks = case | {"matrix": sp.bsr_matrix(case["matrix"], blocksize=(d, d))}
    np.testing.assert_allclose(solved(in_blocks, law, slip=slip), solved(case, law, slip=slip), rtol=1e-11, atol=1e-11)
    moves = rng.uniform(size=n) < 0.5
    once = solved(case, law, moves=moves)
    assert (once[~moves] == 0).all()
    assert (once[moves] != 0).all()


def test_sparse_blocks():
    """Rows of different lengths, in any order of their columns."""
    rng = np.random.default_rng(5)
    n, d = 30, 3
    A = sp.random(n * d, n * d, 0.02, random_state=1)
    A = (A + A.T + sp.diags(np.full(n * d, 8.0))).toarray()
    rows = sp.bsr_matrix(A, blocksize=(d, d))
    assert len(rows.indices) < n * n / 2
    back = np.concatenate([np.arange(a, b)[::-1] for a, b in zip(rows.indptr[:-1], rows.indptr[1:], strict=True)])
    case = problem(rng, n, d) | {"matrix": A}
    shuffled = sp.bsr_matrix((rows.data[back], rows.indices[back], rows.indptr), shape=A.shape)
    law = LAWS["Coulomb"]
    u = solved(case | {"matrix": shuffled}, law, sweeps=50)
    np.testing.assert_allclose(u, solved(case, law, sweeps=50), rtol=1e-11, atol=1e-11)
    assert residual(case, law, u) < EXACT


@pytest.mark.parametrize("d", [2, 3])
def test_least_energy(d):
    """The problem with a threshold that does not depend on the pressure is the minimum of a convex energy."""
    rng = np.random.default_rng(2)
    n, law = 6, Tresca(3.0, 1.0, 0.8)
    case = problem(rng, n, d) | {"matrix": stiffness(rng, n * d, 20.0)}
    case["g"] = 3 * rng.normal(size=(n, d)) + (case["matrix"] @ case["base"].ravel()).reshape(n, d)
    slip, bound = rng.normal(size=(n, d - 1)), law.bound

    def energy(x):
        u = x.reshape(n, d)
        w = jumps(case, u)
        shear = np.linalg.norm(w[:, :-1] - slip, axis=1)
        huber = np.where(law.K_T * shear <= bound, law.K_T * shear**2 / 2, bound * shear - bound**2 / (2 * law.K_T))
        springs = law.K_N * np.maximum(-w[:, -1], 0) ** 2 / 2 + huber
        return x @ case["matrix"] @ x / 2 - x @ case["g"].ravel() + case["weights"] @ springs

    u = solved(case, law, sweeps=400, slip=slip)
    least = minimize(energy, np.zeros(n * d), method="BFGS", options={"gtol": 1e-6})
    np.testing.assert_allclose(u.ravel(), least.x, atol=1e-5 * np.abs(u).max())
    assert energy(u.ravel()) <= least.fun + 1e-9 * abs(least.fun)
    assert len(set(law.status(jumps(case, u), slip))) == 3


def test_numbers_that_are_not_finite():
    """A node without a solution keeps its displacement and says so; the others are solved."""
    rng = np.random.default_rng(0)
    law = LAWS["Coulomb"]
    for key, value in (("g", np.nan), ("matrix", np.inf), ("weights", np.nan), ("base", np.nan)):
        for d in (2, 3):
            case = problem(rng, 2, d)
            case["matrix"][:d, d:] = case["matrix"][d:, :d] = 0
            case[key] = case[key].copy()
            case[key][0] = value
            if key == "matrix":
                case[key][0, d:] = 0
            u = np.full((2, d), 0.5)
            assert np.isnan(sweep_nodes(u=u, numbers=law.numbers, **case))
            assert (u[0] == 0.5).all()
            assert (u[1] != 0.5).all()


# ------------------------------------------------------------------ a finite element problem written in UFL


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize(
    "law", [HolonomicCoulomb(60.0, 20.0, 0.5, 0.02), Tresca(60.0, 20.0, 0.8)], ids=["Coulomb", "Tresca"]
)
def test_against_ufl(law, d):
    """The law in UFL with vertex quadrature: traction times weights, and no residual at the solution of the sweeps."""
    comm = MPI.COMM_SELF
    domain = mesh.create_unit_square(comm, 12, 4) if d == 2 else mesh.create_unit_cube(comm, 3, 3, 2)
    V = fem.functionspace(domain, ("Lagrange", 1, (d,)))
    facets = mesh.locate_entities_boundary(domain, d - 1, lambda x: np.isclose(x[d - 1], 0))
    tags = mesh.meshtags(domain, d - 1, np.sort(facets), np.full(len(facets), 1, np.int32))
    dS = ufl.Measure("ds", domain, subdomain_data=tags)(1)
    vertices = dS(metadata={"quadrature_rule": "vertex", "quadrature_degree": 1})
    u, v, x = fem.Function(V), ufl.TestFunction(V), ufl.SpatialCoordinate(domain)

    p = law.K_N * ufl.max_value(-u[d - 1], 0.0)
    bound = ufl.as_ufl(law.bound) if isinstance(law, Tresca) else law.cohesion + law.friction * p
    elastic = [law.K_T * u[i] for i in range(d - 1)]
    size = ufl.sqrt(sum(t**2 for t in elastic))
    shorter = ufl.conditional(ufl.le(size, bound), 1.0, bound / ufl.conditional(ufl.gt(size, 0.0), size, 1.0))
    contact = ufl.inner(ufl.as_vector([shorter * t for t in elastic] + [-p]), v) * vertices
    strain = ufl.sym(ufl.grad(u))
    load = ufl.as_vector([20 * x[0]] + [4.0] * (d - 2) + [60 * (x[0] - 0.7)])
    density = 25 * ufl.inner(strain, strain) + 20 * ufl.div(u) ** 2 + 200 * ufl.inner(u, u) - ufl.inner(load, u)
    inside = ufl.derivative(density * ufl.dx, u, v)

    dofs = fem.locate_dofs_topological(V, d - 1, facets)
    area = petsc.assemble_vector(fem.form(ufl.inner(ufl.as_vector([1.0] * d), v) * dS)).array.reshape(-1, d)[dofs, 0]
    rng = np.random.default_rng(4)
    u.x.array[:] = 0.03 * rng.normal(size=len(u.x.array))
    by_ufl = petsc.assemble_vector(fem.form(contact)).array.reshape(-1, d)
    w = u.x.array.reshape(-1, d)[dofs]
    np.testing.assert_allclose(by_ufl[dofs], law.traction(w) * area[:, None], atol=1e-14)
    np.testing.assert_allclose(np.delete(by_ufl, dofs, axis=0), 0.0, atol=1e-14)
    assert len(set(law.status(w))) == 3
    for wrong in (law.traction(-w), law.traction(w)):
        assert np.abs(by_ufl[dofs] - wrong).max() > 1e-3

    # the stiffness condensed to the contact dofs, and the displacement of the others afterwards
    A = petsc.assemble_matrix(fem.form(ufl.derivative(inside, u)))
    A.assemble()
    K = A[:, :]
    u.x.array[:] = 0.0
    b = -petsc.assemble_vector(fem.form(inside)).array
    c = (dofs[:, None] * d + np.arange(d)).ravel()
    o = np.setdiff1d(np.arange(len(b)), c)
    lift = np.linalg.solve(K[np.ix_(o, o)], np.column_stack([K[np.ix_(o, c)], b[o]]))
    condensed, g = K[np.ix_(c, c)] - K[np.ix_(c, o)] @ lift[:, :-1], b[c] - K[np.ix_(c, o)] @ lift[:, -1]
    now = np.zeros((len(dofs), d))
    frames, base = np.tile(np.eye(d), (len(dofs), 1, 1)), np.zeros((len(dofs), d))
    sweep_nodes(condensed, g.reshape(-1, d), now, base, frames, area, law.numbers, sweeps=2000)
    u.x.array[c] = now.ravel()
    u.x.array[o] = lift[:, -1] - lift[:, :-1] @ now.ravel()
    left = petsc.assemble_vector(fem.form(inside + contact)).array
    assert np.abs(left).max() < 1e-11 * np.abs(b).max()
    assert len(set(law.status(now))) == 3
