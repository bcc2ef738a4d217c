"""Dry walls: all solvers find the same equilibrium, bricks are balanced, loose ones are named, friction remembers."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp
import ufl

from forms import HolonomicCoulomb, IncrementalCoulomb, LinearElastic, Stack
from forms.base import InputError
from geometry import bond_cell, periodic, sandwich, wall
from geometry.seam import Seam
from tests.dry_walls import dry_wall, imbalance
from tests.network_cases import BED, HEAD, square, three_bricks
from tests.on_ranks import on_ranks
from tests.refused import refused
from thinlayer import Springs, Structure, Surface, ThinLayer, march, piecewise, solve
from thinlayer.errors import LimitLoad, LooseBody, SolveError
from thinlayer.solving.contact import condensation
from thinlayer.solving.contact.condensation import Condensation
from thinlayer.solving.contact.condensed import MAX_COARSE_RATIO, every_second_point

pytestmark = pytest.mark.few(5)

ROUNDED = 1e-7  # relative, of displacements: solvers stop at 1e-10 of all forces, and soft joints slide far


def require_equal(state, other):
    assert np.abs(state.u.x.array - other.u.x.array).max() < ROUNDED * np.abs(state.u.x.array).max()


# ---------------------------------------------------------------- equilibrium
@pytest.mark.parametrize(("push", "stiffer"), [(0.0, 1.0), (0.3, 1.0), (0.4, 1.0), (0.3, 100.0)])
def test_solvers_agree_on_a_wall(push, stiffer):
    """14 bricks, from pure pressure to beds that slide; forces and moments of each brick vanish."""
    model = dry_wall(stiffer=stiffer)
    state, other = (solve(model, push, method=method) for method in ("condensed", "newton"))
    require_equal(state, other)
    assert max(imbalance(state), imbalance(other)) < 1e-12
    sliding = Surface(state.model, "BED").contact(state).counts["sliding"]
    assert sliding > 15 if push else sliding == 0
    assert solve(model, push).report.method == "condensed"  # the default
    assert state.report.iterations <= 9
    assert not state.report.homotopy_steps
    assert bool(other.report.homotopy_steps) == (push == 0.4 or stiffer > 1)  # plain Newton finds no equilibrium
    state.u.x.array[:] *= 1.001
    assert imbalance(state) > 1e-6


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_a_wall_in_space(cell):
    model = dry_wall(lambda x, t: 0.3, bricks=2, courses=3, h=0.25, depth=0.3, cell=cell, stiffer=5.0)
    state, other = (solve(model, method=method) for method in ("condensed", "newton"))
    require_equal(state, other)
    assert imbalance(state) < 1e-11  # where Newton's method may stop
    assert imbalance(other) < 1e-10
    counts = Surface(state.model, "HEAD").contact(state).counts
    assert {"sliding", "separated"} <= {name for name, n in counts.items() if n}


def test_a_wall_of_many_joints_of_two_cells():
    """Starts from nodes at their ends, of which no fewer can be left."""
    model = dry_wall(bricks=6, courses=8, h=0.25)
    require_equal(*(solve(model, 0.2, method=method) for method in ("condensed", "newton")))


def test_a_support_that_moves():
    """Held nodes in contact: the sole of the right brick is held along x, the left one is pushed by its side."""
    joint = three_bricks(4, "quadrilateral")
    data = {"supports": {"BOTTOM": 0.0, "LEFT": {"x": lambda x, t: 0.01 * x[1]}}, "tractions": {"TOP": (0.0, -1.0)}}
    structure = Structure(joint, body=LinearElastic.young(50.0, 0.2), element="Q1", **data)
    model = structure.interface({"BED": BED, "HEAD": HEAD})
    require_equal(*(solve(model, method=method) for method in ("condensed", "newton")))


def on_a_floor():
    """Nothing but contact holds the wall."""
    joint = dry_wall(h=0.25).joint
    facets = {"FLOOR" if name == "BOTTOM" else name: rows for name, rows in joint.facets.items()}
    joint = replace(joint, facets=facets, seams=joint.seams | {"FLOOR": Seam()})
    loads = {"TOP": (0.2, -1.0)}
    structure = Structure(joint, body=LinearElastic.young(50.0, 0.2), supports={}, tractions=loads, element="Q1")
    return structure.interface({"BED": BED, "HEAD": HEAD, "FLOOR": HEAD})


def test_a_wall_that_stands_on_a_rigid_floor():
    """Its weight and the push pass into the floor."""
    model = on_a_floor()
    state, other = (solve(model, method=method) for method in ("condensed", "newton"))
    require_equal(state, other)
    assert imbalance(state) < 1e-12
    assert Surface(state.model, "FLOOR").contact(state).force == pytest.approx([-0.6, 3.0], rel=1e-12)


def walls(method=None):
    """The methods, and sums of displacements; some nodes slide, and some joints are stiffer than the cells beside them."""
    space = {"bricks": 2, "courses": 3, "h": 0.25, "depth": 0.3, "cell": "hexahedron"}
    models = dry_wall(lambda x, t: 0.35, stiffer=100.0, **space), on_a_floor()
    states = [solve(model, method=method) for model in models]
    return [state.report.method for state in states], [square(state) for state in states]


@on_ranks(walls, 2)
def test_multigrid_solves_networks_on_several_ranks(there):
    """Ranks share bricks, and nodes in contact on both sides of S."""
    methods, squares = there
    assert methods == ["multigrid"] * 2
    wanted = pytest.approx(walls("condensed")[1], rel=ROUNDED)
    assert squares == wanted
    assert walls("multigrid")[1] == wanted


# ---------------------------------------------------------------- pieces of the solver
@pytest.mark.parametrize(("d", "together"), [(2, 400), (3, 5)])
def test_bodies_are_condensed_one_by_one(d, together, monkeypatch):
    """The same as the Schur complement of the whole, for floating bodies and for one without unknowns that stay."""
    monkeypatch.setattr(condensation, "MAX_GROUP_UNKNOWNS", together)
    rng = np.random.default_rng(2)
    bodies = []
    for n, floats in ((7, 2), (4, 0), (5, 1)):
        root = rng.normal(size=(n * d, n * d - floats))
        bodies.append(root @ root.T)
    K = scipy.linalg.block_diag(*bodies)
    kept = np.sort(rng.permutation(7 * d)[: 3 * d])
    kept = np.concatenate([kept, 11 * d + np.arange(0, 5 * d, 2)])
    inner = np.setdiff1d(np.arange(16 * d), kept)
    A = sp.bsr_matrix(K, blocksize=(d, d)).tocsr()
    rows = A.indptr, A.indices, A.data
    schur = Condensation(rows, np.zeros(16 * d, bool), kept, rng.normal(size=(16, d)), np.arange(d), len(bodies))
    moved = np.linalg.solve(K[np.ix_(inner, inner)], K[np.ix_(inner, kept)])
    whole = K[np.ix_(kept, kept)] - K[np.ix_(kept, inner)] @ moved
    np.testing.assert_allclose(schur.stiffness @ np.eye(len(kept)), whole, atol=1e-11 * np.abs(K).max())
    b = K @ (u := rng.normal(size=len(K)))
    np.testing.assert_allclose(schur.condense(b), whole @ u[kept], atol=1e-10 * np.abs(K).max())
    out = np.zeros(len(K))
    schur.expand(b, u[kept], out)
    np.testing.assert_allclose(out, u, atol=1e-8)
    schur.close()


def test_every_second_place_along_curves():
    """Two curves that branch and two rings, uneven: others lie between their two neighbours, and what meets still meets."""
    rng, chain = np.random.default_rng(3), lambda *way: [*pairwise(way)]
    x = np.cumsum(rng.uniform(0.5, 1.5, (22, 2)), axis=0)
    lines = [*chain(*range(7)), *chain(3, 7, 8, 9, 10), *chain(*range(11, 16), 11), *chain(*range(16, 22), 16)]
    kept, shares, coarser = every_second_point(x, np.array(lines))
    assert len(kept) <= MAX_COARSE_RATIO * len(x)
    np.testing.assert_array_equal(shares[kept].toarray(), np.eye(len(kept)))
    for place in np.setdiff1d(np.arange(len(x)), kept):
        near = [a + b - place for a, b in lines if place in (a, b)]
        weights = shares[[place]].toarray()[0, np.searchsorted(kept, near)]
        assert weights.sum() == pytest.approx(1)
        assert np.ptp(weights * np.linalg.norm(x[near] - x[place], axis=1)) == pytest.approx(0, abs=1e-12)
    meeting = dict(zip(kept.tolist(), np.bincount(coarser.ravel()), strict=True))
    assert meeting == dict.fromkeys(kept.tolist(), 2) | {0: 1, 3: 3, 6: 1, 10: 1}


# ---------------------------------------------------------------- bricks that nothing holds
def lifted(method, up, head):
    """Three bricks, the left one under a pull along y."""
    data = {"tractions": {"TOP": lambda x, t: (0.0, ufl.conditional(ufl.lt(x[0], 1.0), up, -1.0))}, "element": "Q1"}
    data |= {"body": LinearElastic.young(50.0, 0.2), "supports": {"BOTTOM": 0.0}}
    structure = Structure(three_bricks(4, "quadrilateral"), **data)
    return solve(structure.interface({"BED": BED, "HEAD": head}), method=method)


@pytest.mark.few(2)
@pytest.mark.parametrize("method", ["condensed", "newton"])
def test_a_brick_that_is_lifted_is_named(method):
    """Its neighbour, which the pressure makes wider, touches it at a dry head; an open one holds nothing."""
    free = r"can (move along \(-0.\d+, 1\)|turn in the plane xy)"  # the search may end before or after it turns
    error = refused(LooseBody, rf"no equilibrium found .*body 'LEFT BRICK' {free}", lifted, method, 0.3, HEAD)
    assert "pulled off" in str(error)
    assert len(error.residuals) > 1
    refused(LooseBody, "'LEFT BRICK' can move and turn freely", lifted, method, 0.3, None)
    assert imbalance(lifted(method, -0.3, HEAD)) < 1e-12


def test_a_neighbour_that_touches_by_rounding_holds_no_brick():
    """Bricks without friction may slide. By multigrid two nodes of a head end with 1e-11 of the forces."""
    law, springs = HolonomicCoulomb(1e3, 3e2, friction=0.0, gap=0.01), Springs("RIGHT", normal=2.0, tangential=1.0)
    data = {"body": LinearElastic.young(100.0, 0.3), "supports": {"BOTTOM": 0}, "tractions": {"TOP": (0.0, -0.6)}}
    structure = Structure(wall(2, 2, (2, 1), 0.5), element="Q1", parts=[springs], eigenstrain=2e-3, **data)
    for method in ("condensed", "multigrid", "newton"):
        model = structure.interface({"BED": law, "HEAD": law})
        refused(LooseBody, r"'COURSE 2'.*along \(1, 0\)", solve, model, method=method)


@pytest.mark.long
@pytest.mark.parametrize("method", ["condensed", "newton"])
def test_a_wall_ends_at_its_limit_and_names_the_seams_that_slide(method):
    """All beds carry 0.5 of the pressure above them, least the uppermost one, which carries a course of weight 0.035."""
    with pytest.raises(LimitLoad, match=r"jumps at the seams 'BED' 9\d%, 'HEAD' \d%\. ") as error:
        march(dry_wall(h=0.25, weight=0.07, kind=IncrementalCoulomb), [0.3, 0.6], method=method)
    limit = error.value
    assert limit.t < 0.5 * 1.035 < limit.failed_at == pytest.approx(limit.t + 0.3 / 1024)
    beds = Surface(limit.history.last.model, "BED").contact(limit.history.last)
    assert limit.history.last.t == limit.t
    assert beds.friction_force == pytest.approx(3 * 3.0 * limit.t, rel=1e-9)


@pytest.mark.parametrize("method", ["condensed", pytest.param("newton", marks=pytest.mark.long)])
def test_bricks_without_weight_are_no_limit_and_have_no_one_place(method):
    """The beds of one slide at once before the load's limit, which tends to 0.5 with the weight."""
    times = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    with pytest.raises(SolveError, match=r"body 'COURSE 2' .* a weightless body has no one place") as error:
        march(dry_wall(bricks=2, courses=3, h=0.25, kind=IncrementalCoulomb), times, method=method)
    assert not isinstance(error.value, LimitLoad)
    assert error.value.history.last.t < 0.5
    with pytest.raises(LimitLoad) as limit:
        march(dry_wall(bricks=2, courses=3, h=0.25, kind=IncrementalCoulomb, weight=0.01), times, method=method)
    assert limit.value.t < 0.5 * 1.005 < limit.value.failed_at < limit.value.t + 2e-4


# ---------------------------------------------------------------- friction that remembers
def test_forth_and_back():
    """The wall keeps a part of its slip; energies balance; both solvers go the same way."""
    push = piecewise({0.0: 0.0, 1.0: 0.2, 2.0: 0.3, 3.0: 0.1, 4.0: -0.2, 5.0: 0.0})
    times = [1.0, 2.0, 3.0, 4.0, 5.0]
    walls = [dry_wall(push, h=0.25, kind=IncrementalCoulomb) for _ in range(2)]
    states, other = ([*march(wall, times, method=m)] for wall, m in zip(walls, ("condensed", "newton"), strict=True))
    stored = states[-1].audit.total
    for state, again in zip(states, other, strict=True):
        require_equal(state, again)
        assert imbalance(state) < 1e-11
        assert abs(state.audit.imbalance) < 1e-11 * stored
        assert state.audit.dissipated == pytest.approx(again.audit.dissipated, rel=1e-7, abs=1e-9 * stored)
    assert all(state.audit.dissipated > 0 for state in states[2:])
    there, back = states[2].u.x.array, states[-1].u.x.array  # under the same pressure without a push at rest
    assert np.abs(back - states[0].u.x.array).max() > 0.02 * np.abs(there).max()


# ---------------------------------------------------------------- what is refused
def test_refused():
    model = dry_wall(h=0.25)
    refused(InputError, "'relaxation' is for one seam without branches", solve, model, method="relaxation")
    stack = ThinLayer(Stack((0.5, LinearElastic(0.5, 1.0)), (0.5, LinearElastic(0.2, 1.5))), 0.01, at=1.0)
    stacked = model.structure.interface({"BED": BED, "HEAD": stack})  # whose stiffness is in no form
    refused(InputError, "linear, symmetric parts and layers", solve, stacked, method="condensed")
    cell = Structure(bond_cell((1.0, 0.5), 0.125), body=LinearElastic.young(50.0, 0.2), supports={}, element="Q1",
                     strain=((0.0, 0.0), (0.0, -0.01)))  # fmt: skip
    strip = periodic(sandwich(1.0, 0.5, 0.5, 0.25), ("LEFT", "RIGHT"))
    below = Structure(strip, body=LinearElastic.young(50.0, 0.2), supports={"BOTTOM": 0.0}, element="P1")
    for model in (cell.interface({"BED": BED, "HEAD": HEAD}), below.interface(BED)):
        for method in ("condensed", "multigrid"):
            refused(InputError, f"method='{method}' is not for periodic joints", solve, model, method=method)
