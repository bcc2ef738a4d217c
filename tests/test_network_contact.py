"""Dry walls: all solvers find the same equilibrium, bricks are balanced, loose ones are named, friction remembers."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
import ufl

from forms import IncrementalCoulomb, LinearElastic, Stack
from forms.base import InputError
from geometry import bond_cell
from geometry.seam import Seam
from studies import dry_wall as dry_wall_study
from tests.dry_walls import PUSHES, dry_wall, forth_and_back, imbalance, pair_values
from tests.network_cases import BED, HEAD, three_bricks
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, march, solve
from thinlayer.errors import LimitLoad, LooseBody
from thinlayer.parts.part import Interval
from thinlayer.solving.contact.schur import Condensation
from thinlayer.solving.solvers import Solver

pytestmark = pytest.mark.few(5)

ROUNDED = 1e-8  # relative, of forces: solvers stop at 1e-10 of all forces


def require_equal(one, other):
    for seam in one.model.contacts:
        (status, forces), (again, others) = pair_values(one, seam), pair_values(other, seam)
        assert np.array_equal(status, again)
        assert np.abs(forces - others).max() < ROUNDED * np.abs(forces).max()


# ---------------------------------------------------------------- equilibrium
@pytest.mark.parametrize(("push", "stiffer"), [(0.0, 1.0), (0.3, 1.0), (0.4, 1.0), (0.3, 100.0)])
def test_solvers_agree_on_a_wall(push, stiffer):
    """14 bricks, from pure pressure to beds that slide; forces and moments of each brick vanish."""
    model = dry_wall(stiffer=stiffer)
    one, other = (solve(model, push, method=method) for method in ("condensed", "newton"))
    require_equal(one, other)
    assert max(imbalance(one), imbalance(other)) < 1e-12
    sliding = Surface(one.model, "BED").contact(one).counts["sliding"]
    assert sliding > 15 if push else sliding == 0
    assert solve(model, push).report.method == "condensed"  # the default
    assert one.report.iterations <= 9
    assert not one.report.eased
    assert bool(other.report.eased) == (push == 0.4 or stiffer > 1)  # plain Newton finds no equilibrium


def test_a_wrong_wall_is_not_balanced():
    """Bricks that another friction would hold."""
    state = solve(dry_wall(), 0.3)
    state.u.x.array[:] *= 1.001
    assert imbalance(state) > 1e-6


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_a_wall_in_space(cell):
    model = dry_wall(lambda x, t: 0.3, bricks=2, courses=3, h=0.25, depth=0.3, cell=cell, stiffer=5.0)
    one, other = (solve(model, method=method) for method in ("condensed", "newton"))
    require_equal(one, other)
    assert imbalance(one) < 1e-11  # where Newton's method may stop
    assert imbalance(other) < 1e-10
    assert {"sliding", "separated"} <= {name for name, n in Surface(one.model, "HEAD").contact(one).counts.items() if n}


def test_very_stiff_contact():
    """The residual cannot be smaller than the rounding of the contact forces."""
    model = dry_wall(stiffer=1e7, h=0.25)
    one, other = (solve(model, 0.1, method=method) for method in ("condensed", "newton"))
    assert one.report.residual > 1e-10
    assert one.energies()["bodies"] == pytest.approx(other.energies()["bodies"], rel=1e-6)


def test_contact_beside_a_compiled_law():
    """Its stiffness is in no form, so that the condensed bodies would lack it."""
    joint = dry_wall(h=0.25).joint
    loads = {"TOP": (0.1, -1.0)}
    bricks = Structure(
        joint, body=LinearElastic.young(50.0, 0.2), supports={"BOTTOM": 0.0}, tractions=loads, element="Q1"
    )
    one, other = LinearElastic(0.5, 1.0), LinearElastic(0.2, 1.5)
    series = LinearElastic(2 / (1 / 2.5 + 1 / 3.2) - 2 * 1.2, 1.2)  # lmbda + 2 mu and mu are harmonic means
    stacked = bricks.interface({"BED": BED, "HEAD": ThinLayer(Stack((0.5, one), (0.5, other)), 0.01, at=1.0)})
    plain = bricks.interface({"BED": BED, "HEAD": ThinLayer(series, 0.01, at=1.0)})
    require_equal(solve(stacked), solve(plain, method="newton"))
    refused(InputError, "linear, symmetric parts and layers", solve, stacked, method="condensed")


def test_a_support_that_moves():
    """Held nodes in contact: the sole of the right brick is held along x, the left one is pushed by its side."""
    joint = three_bricks(4, "quadrilateral")
    structure = Structure(
        joint, body=LinearElastic.young(50.0, 0.2), element="Q1", tractions={"TOP": (0.0, -1.0)},
        supports={"BOTTOM": 0.0, "LEFT": {"x": lambda x, t: 0.01 * x[1]}},
    )  # fmt: skip
    model = structure.interface({"BED": BED, "HEAD": HEAD})
    require_equal(*(solve(model, method=method) for method in ("condensed", "newton")))


def test_a_wall_that_stands_on_a_rigid_floor():
    """Nothing but contact holds the wall: its weight and the push pass into the floor."""
    joint = dry_wall(h=0.25).joint
    facets = {"FLOOR" if name == "BOTTOM" else name: rows for name, rows in joint.facets.items()}
    joint = replace(joint, facets=facets, seams=joint.seams | {"FLOOR": Seam()})
    loads = {"TOP": (0.2, -1.0)}
    body = LinearElastic.young(50.0, 0.2)
    model = Structure(joint, body=body, supports={}, tractions=loads, element="Q1").interface(
        {"BED": BED, "HEAD": HEAD, "FLOOR": HEAD}
    )
    one, other = (solve(model, method=method) for method in ("condensed", "newton"))
    require_equal(one, other)
    assert imbalance(one) < 1e-12
    assert Surface(one.model, "FLOOR").contact(one).force == pytest.approx([-0.6, 3.0], rel=1e-12)


# ---------------------------------------------------------------- pieces of the solver
@pytest.fixture
def finder():
    """The condensed solver of a wall, before its first step; stiff joints, some of them eased."""
    with Solver(dry_wall(stiffer=30.0), method="condensed") as solver:
        solver.equations.begin(Interval(solver.rest(0.3), 0.3, 0.0, 1.0))
        yield solver._finder


def test_a_sweep_solves_a_node(finder):
    """After a sweep over one node alone its forces balance, whether two or more bodies meet there or one is held."""
    pairs, system = finder.pairs, finder._system
    rng = np.random.default_rng(1)
    g = rng.normal(size=pairs.free.size) * pairs.free.ravel()
    movable, counts = pairs.free.all(axis=1), np.diff(pairs._begins)
    assert set(counts) == {1, 2}
    for ease in (0.0, 0.7):
        finder.equations.ease(ease)
        for node in [*np.flatnonzero(movable & (counts == 2))[:9], *np.flatnonzero(movable & (counts == 1))[:9]]:
            pairs.free[:] = False
            pairs.free[node] = True
            u = np.where(np.repeat(movable, 2), 0.01 * rng.normal(size=g.size), 0.0)
            before = u.copy()
            pairs.sweep(system._blocks, g, u, 1)
            own = slice(2 * node, 2 * node + 2)
            assert np.array_equal(
                np.delete(u, range(2 * node, 2 * node + 2)), np.delete(before, [2 * node, 2 * node + 1])
            )
            terms = np.abs(g[own]).max() + np.abs(pairs.forces(u)[own]).max()
            assert np.abs(system.residual(u, g)[own]).max() < 1e-10 * terms
            assert np.abs(system.residual(before, g)[own]).max() > 1e-3 * terms


def test_bodies_are_condensed_one_by_one():
    """The same as the Schur complement of the whole; one right-hand side for each unknown of the largest body."""
    rng = np.random.default_rng(2)
    bodies = []
    for n in (7, 4, 5):
        root = rng.normal(size=(n, n - 2))
        bodies.append(root @ root.T)  # floats: two motions without stiffness
    K = sp.block_diag(bodies).toarray()
    kept, inner = np.array([15, 1, 3, 8, 2, 9, 12, 11, 0]), np.array([4, 5, 6, 7, 10, 13, 14])
    found = Condensation(sp.csr_matrix(K), kept, inner)
    whole = K[np.ix_(kept, kept)] - K[np.ix_(kept, inner)] @ np.linalg.solve(
        K[np.ix_(inner, inner)], K[np.ix_(inner, kept)]
    )
    np.testing.assert_allclose(found.stiffness.toarray(), whole, atol=1e-11 * np.abs(K).max())
    assert found.solves == 4
    b, out = K @ (u := rng.normal(size=len(K))), np.zeros(len(K))
    np.testing.assert_allclose(found.condense(b), whole @ u[kept], atol=1e-10 * np.abs(K).max())
    found.expand(b, u[kept], out)
    np.testing.assert_allclose(out, u, atol=1e-9)
    found.close()


@pytest.mark.parametrize("d", [2, 3])
def test_an_eased_law(d):
    """Its tangent by differences; it pulls where the law does not, and with the share 1 it is linear."""
    rng = np.random.default_rng(3)
    law = IncrementalCoulomb(K_N=3.0, K_T=1.1, friction=0.4, cohesion=0.2)
    w, slip = rng.normal(size=(40, d)), 0.3 * rng.normal(size=(40, d - 1))
    eased, step = law.eased(0.3), 1e-6
    for k in range(d):
        shift = step * np.eye(d)[k]
        rate = (eased.traction(w + shift, slip) - eased.traction(w - shift, slip)) / (2 * step)
        np.testing.assert_allclose(eased.tangent(w, slip)[:, :, k], rate, atol=1e-8)
    assert (eased.traction(w, slip)[w[:, -1] > 0, -1] > 0).all()
    linear = law.eased(1.0)
    relative = w - np.column_stack([slip, np.zeros(40)])
    np.testing.assert_allclose(
        linear.traction(w, slip), np.einsum("nij,nj->ni", law.bonded(40, d), relative), rtol=1e-12
    )


# ---------------------------------------------------------------- bricks that nothing holds
def lifted(method, up, head):
    """Three bricks, the left one under a pull along y."""
    structure = Structure(
        three_bricks(4, "quadrilateral"),
        body=LinearElastic.young(50.0, 0.2),
        supports={"BOTTOM": 0.0},
        tractions={"TOP": lambda x, t: (0.0, ufl.conditional(ufl.lt(x[0], 1.0), up, -1.0))},
        element="Q1",
    )
    return solve(structure.interface({"BED": BED, "HEAD": head}), method=method)


@pytest.mark.few(2)
@pytest.mark.parametrize("method", ["condensed", "newton"])
def test_a_brick_that_is_lifted_is_named(method):
    """Its neighbour, which the pressure makes wider, touches it at a dry head; an open one holds nothing."""
    with pytest.raises(
        LooseBody, match=r"no equilibrium found .*body 'LEFT BRICK' can move along \(-0.\d+, 1\)"
    ) as error:
        lifted(method, 0.3, HEAD)
    assert "a body pulled off" in str(error.value)
    assert len(error.value.residuals) > 1
    refused(LooseBody, "'LEFT BRICK' can move and turn freely", lifted, method, 0.3, None)
    assert imbalance(lifted(method, -0.3, HEAD)) < 1e-12


@pytest.mark.few(5)
@pytest.mark.parametrize("method", ["condensed", "newton"])
def test_a_course_that_slides_away_is_named(method):
    """More shear than friction carries: 0.5 of the pressure."""
    with pytest.raises(LooseBody, match=r"body 'COURSE [234]' at \(.*\) can move along \(1, 0\)"):
        solve(dry_wall(h=0.25), 0.55, method=method)


@pytest.mark.long
@pytest.mark.parametrize("method", ["condensed", "newton"])
def test_a_wall_ends_at_its_limit_and_names_the_seams_that_slide(method):
    """All beds carry 0.5 of the pressure above them, least the uppermost one, which carries a course of weight 0.035."""
    with pytest.raises(LimitLoad, match=r"jumps at the seams 'BED' 9\d%, 'HEAD' \d%\. ") as error:
        march(dry_wall(h=0.25, weight=0.07, kind=IncrementalCoulomb), [0.3, 0.6], method=method)
    found = error.value
    assert found.t < 0.5 * 1.035 < found.failed_at == pytest.approx(found.t + 0.3 / 1024)
    beds = Surface(found.history.last.model, "BED").contact(found.history.last)
    assert found.history.last.t == found.t
    assert beds.friction_force == pytest.approx(3 * 3.0 * found.t, rel=1e-9)


# ---------------------------------------------------------------- friction that remembers
def test_forth_and_back():
    """The wall keeps a part of its slip; energies balance; both solvers go the same way."""
    one, other = (list(forth_and_back(method)) for method in ("condensed", "newton"))
    stored = one[-1].audit.total
    assert len(one) == len(other) == len(PUSHES) + 1
    for state, again in zip(one, other, strict=True):
        require_equal(state, again)
        assert imbalance(state) < 1e-11
        assert abs(state.audit.imbalance) < 1e-11 * stored
        assert state.audit.dissipated == pytest.approx(again.audit.dissipated, rel=1e-7, abs=1e-9 * stored)
    assert all(state.audit.dissipated > 0 for state in one[2:])
    there, back = one[2].u.x.array, one[-1].u.x.array  # under the same pressure without a push at rest
    assert np.abs(back - one[0].u.x.array).max() > 0.02 * np.abs(there).max()


# ---------------------------------------------------------------- what is refused
def test_refused():
    model = dry_wall(h=0.25)
    for method in ("multigrid", "relaxation"):
        with pytest.raises(InputError, match=f"method='{method}' is for one seam without branches.*'condensed'"):
            solve(model, method=method)
    cell = Structure(bond_cell((1.0, 0.5), 0.125), body=LinearElastic.young(50.0, 0.2), supports={}, element="Q1",
                     strain=((0.0, 0.0), (0.0, -0.01)))  # fmt: skip
    with pytest.raises(InputError, match="method='condensed' is for one seam without branches, not periodic"):
        solve(cell.interface({"BED": BED, "HEAD": HEAD}), method="condensed")


def test_study():
    """The pieces of the study of costs, on a wall of five bricks."""
    one, other = (
        dry_wall_study.solved(dry_wall_study.dry((2, 2), 60.0, 0.3), method)[0] for method in ("condensed", "newton")
    )
    assert dry_wall_study.difference(one, other) < 1e-8
    assert dry_wall_study.solved(dry_wall_study.bonded((2, 2), 60.0))[1] > 0
