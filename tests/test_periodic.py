"""Periodic cells: which places are one, mean strains, mean stresses, homogenised stiffness, what is refused."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import ufl

from forms import Incompressible, KelvinVoigt, LinearElastic
from forms.base import InputError
from geometry import bond_cell, periodic, sandwich, wall
from geometry.joint import Joint
from tests.meshes import renumbered
from tests.network_cases import springs
from tests.own_laws import Stiffening
from tests.refused import refused
from thinlayer import (
    PointLoad,
    SolveError,
    Springs,
    Structure,
    Surface,
    ThinLayer,
    homogenised_stiffness,
    march,
    piecewise,
    solve,
)
from thinlayer.discretisation.state import State
from thinlayer.output.nodal_forces import nodal_forces

pytestmark = pytest.mark.few(5)

SIDES = (("LEFT", "RIGHT"), ("BOTTOM", "TOP"))
ROCK = LinearElastic.young(10.0, 0.25)


BRICK = (2.0, 1.0)
STRESS = np.array([[0.3, 0.2], [0.2, -1.0]])
MORTAR = {"BED": springs(5.0, 2.1), "HEAD": springs(3.0, 1.3)}
BOND = {  # Young's modulus of bricks -> A_1111, A_2222, A_1212, A_1122
    1e2: (7.472714907, 4.771972123, 1.56705223, 8.56e-2),
    1e3: (8.032298032, 4.976126106, 1.637118965, 9.59e-3),
    1e6: (8.0999317, 4.999976, 1.6453525, 9.7e-6),
}


def bond(E: float = 1e3, *, cell: str = "quadrilateral", element: str | None = None, **options) -> Structure:
    """A running bond of bricks 2 x 1."""
    joint = bond_cell(BRICK, 0.25, cell=cell)
    return Structure(joint, body=LinearElastic.young(E, 0.2), supports={}, element=element, **options)


def stiffness(joint: Joint, E: float, element: str | None = None) -> np.ndarray:
    structure = Structure(joint, body=LinearElastic.young(E, 0.2), supports={}, element=element)
    return homogenised_stiffness(structure.interface(MORTAR))


def laminate(cell: str = "quadrilateral", h: float = 0.25, **options) -> Joint:
    """A layer in bodies of height 1 in all, repeated in all directions."""
    sides = [("LEFT", "RIGHT"), ("BOTTOM", "TOP"), ("BACK", "FRONT")]
    joint = wall(1, 2, (1.0, 0.5), h, cell=cell, **options)
    facets = {name: rows for name, rows in joint.facets.items() if name not in joint.seams}
    joint = replace(joint, facets=facets | {"S": joint.facets["BED"]}, seams={"S": joint.seams["BED"]})
    return periodic(joint, *sides[: joint.dim])


# ---------------------------------------------------------------- which places are one
def test_components_on_the_torus():
    """A bond has one T at each end of a head, and no free ends: 2 x 2 of three components."""
    joint = bond_cell(BRICK, 0.25)
    assert bond(element="Q2").bonded().V.dofmap.index_map.size_global == 256
    number, times = np.unique(joint.split_mesh.component_counts, return_counts=True)
    counted = dict(zip(number.tolist(), times.tolist(), strict=True))
    assert {k: v for k, v in counted.items() if k} == {1: 42, 2: 18, 3: 4}
    assert joint.split_mesh.pieces.max() + 1 == 2  # bricks


# ---------------------------------------------------------------- homogenised stiffness
@pytest.mark.few(1)
@pytest.mark.parametrize("E", BOND)
def test_stiffness_of_a_running_bond(E):
    """The numbers of an independent program; they tend to those of bricks that move rigidly and turn under a shear."""
    A, (A11, A22, A66, A12) = stiffness(bond_cell(BRICK, 0.25), E), BOND[E]
    (b, a), (X, Y) = BRICK, (1.3 * BRICK[0] + 5.0 * BRICK[0] ** 2 / (4 * BRICK[1]), 2.1 * BRICK[1])
    rigid = (3.0 * b + 2.1 * b**2 / (4 * a), 5.0 * a, X * Y / (X + Y))
    assert (A[0, 0], A[1, 1], A[2, 2]) == pytest.approx(rigid, rel=10 / E)
    assert (A[0, 0], A[1, 1], A[2, 2]) == pytest.approx((A11, A22, A66), rel=4e-8 if E == 1e6 else 1e-9)
    assert A[0, 1] == pytest.approx(A12, rel=6e-3)
    assert pytest.approx(A.T, abs=1e-13 * E) == A
    assert np.abs(A[2, :2]).max() < 1e-13 * E


def test_a_cell_cut_elsewhere_or_with_other_numbers_is_the_same():
    A = stiffness(bond_cell(BRICK, 0.25), 1e3)
    for cut in ((0.125, 0.25), (0.875, 0.5)):
        assert stiffness(bond_cell(BRICK, 0.25, cut=cut), 1e3) == pytest.approx(A, rel=1e-9, abs=1e-11)
    joint = bond_cell(BRICK, 0.25, cell="triangle")
    other = periodic(periodic(renumbered(replace(joint, periods=None)), *SIDES[:1]), *SIDES[1:])
    A = stiffness(joint, 1e2)
    assert stiffness(other, 1e2) == pytest.approx(A, rel=1e-11, abs=1e-12)
    assert stiffness(joint.swapped(), 1e2) == pytest.approx(A, rel=1e-11, abs=1e-12)


def layered(body: LinearElastic, K_N: float, K_T: float, d: int) -> np.ndarray:
    """Stiffness (k, k) of a body with a layer in each unit of its height: springs in series with it."""
    lmbda, mu = body.lmbda, body.mu
    M = lmbda + 2 * mu
    normal, shear, ratio = 1 / (1 / M + 1 / K_N), 1 / (1 / mu + 1 / K_T), lmbda / M
    along, across = M - lmbda * ratio + ratio**2 * normal, lmbda - lmbda * ratio + ratio**2 * normal
    side = ratio * normal
    if d == 2:
        return np.array([[along, side, 0], [side, normal, 0], [0, 0, shear]])
    out = np.diag([along, normal, along, shear, mu, shear])
    out[:3, :3] += [[0, side, across], [side, 0, side], [across, side, 0]]
    return out


@pytest.mark.few(1)
@pytest.mark.parametrize(("cell", "depth"), [("triangle", None), ("hexahedron", 1.0)])
def test_a_laminate_is_in_series(cell, depth):
    joint = laminate(cell, 0.25, depth=depth)
    structure = Structure(joint, body=ROCK, supports={})
    A = homogenised_stiffness(structure.interface(springs(4.0, 1.5)))
    assert pytest.approx(layered(ROCK, 4.0, 1.5, joint.dim), rel=1e-11, abs=1e-11) == A
    whole = homogenised_stiffness(structure.bonded())
    assert pytest.approx(layered(ROCK, 1e15, 1e15, joint.dim), rel=1e-11, abs=1e-11) == whole


def test_a_stiffness_that_is_not_symmetric_is_told(monkeypatch):
    """As of a wrong law; by a hundred millionth of it."""
    whole = State.mean_stress
    monkeypatch.setattr(State, "mean_stress", lambda self: (sigma := whole(self)) + 1e-7 * np.diag([sigma[1, 1], 0.0]))
    words = r"not symmetric: entries of 8\.0e\+00 differ by 5\.0e-07"
    refused(SolveError, words, stiffness, bond_cell(BRICK, 0.25), 1e3)


def test_a_load_at_a_periodic_place_may_be_named_by_either_of_its_copies():
    """On top of one course, which is the bottom of the other: one node of one body."""
    forces = []
    for y, body in product((0.0, 1.0), ("COURSE 1", "COURSE 2")):
        load = PointLoad((0.5, y), (0.3, -1.0), body=body)
        model = Structure(laminate(), body=ROCK, supports={}, loads=[load]).interface(springs(4.0, 1.5))
        forces.append(nodal_forces(model.V, model.external_work(ufl.TestFunction(model.V), 0.0)).x.array)
    assert np.sort(forces[0])[[0, 1, -2, -1]] == pytest.approx([-1.0, 0.0, 0.0, 0.3], abs=1e-12)
    np.testing.assert_allclose(forces, forces[:1] * 4, atol=1e-12)


# ---------------------------------------------------------------- loads
def test_energy_is_that_of_the_homogenised_cell():
    """Half of E : A : E per volume, whether E comes at once or in steps; the work supplied is stored."""
    E = np.array([[1e-3, 2e-3], [2e-3, -1e-3]])
    A = stiffness(bond_cell(BRICK, 0.25), 1e3)
    e = np.array([E[0, 0], E[1, 1], 2 * E[0, 1]])
    state = solve(bond(strain=E).interface(MORTAR))
    energies = state.energies()
    assert energies["bodies"] + energies["layer"] == pytest.approx(4.0 * e @ A @ e / 2, rel=1e-10)
    assert energies["loads"] == 0.0
    stress = state.mean_stress()
    assert [stress[0, 0], stress[1, 1], stress[0, 1]] == pytest.approx(A @ e, rel=1e-10)
    bed = Surface(state.model, "BED")  # each bed runs across the whole cell
    assert bed.integral(bed.traction(state)) / 4.0 == pytest.approx(stress[:, 1], rel=1e-9)
    table = piecewise({0: 0.0, 1: 0.7, 2: 1.0})
    growing = bond(strain=lambda x, t: [[c * table(x, t) for c in row] for row in E]).interface(MORTAR)
    assert growing.break_times == {0.0, 1.0, 2.0}
    stresses = np.array([s.mean_stress() for s in march(growing, [1.0, 2.0])][1:])
    assert stresses == pytest.approx(np.array([0.7 * stress, stress]), rel=1e-9)
    audits = [s.audit for s in march(growing, [1.0, 2.0])]
    assert max(abs(audit.imbalance) for audit in audits) < 1e-11
    assert audits[-1].total == pytest.approx(4.0 * e @ A @ e / 2, rel=1e-10)
    remainder = sum(4.0 * s**2 * e @ A @ e / 2 for s in (0.7, 0.3))
    assert sum(audit.remainder for audit in audits) == pytest.approx(remainder, rel=1e-9)


def test_mean_stress_as_a_load():
    """The mean strain is the compliance times the stress; forces of the mean stress do the work."""
    A, S = stiffness(bond_cell(BRICK, 0.25), 1e3), STRESS
    e = np.linalg.solve(A, [S[0, 0], S[1, 1], S[0, 1]])
    state = solve(bond(stress=S).interface(MORTAR))
    E = np.array([[e[0], e[2] / 2], [e[2] / 2, e[1]]])
    assert state.mean_strain() == pytest.approx(E, rel=1e-10)
    assert state.mean_stress() == pytest.approx(S, rel=1e-10)
    energies, stored = state.energies(), 4.0 * (S * E).sum() / 2
    assert energies["bodies"] + energies["layer"] == pytest.approx(stored, rel=1e-10)
    growing = bond(stress=lambda x, t: [[c * t for c in row] for row in S]).interface(MORTAR)
    audits = [s.audit for s in march(growing, [0.7, 1.0])]
    assert max(abs(audit.imbalance) for audit in audits) < 1e-11
    assert audits[-1].total == pytest.approx(stored, rel=1e-10)
    assert sum(audit.supplied for audit in audits) == pytest.approx(stored * (1 + 0.7**2 + 0.3**2), rel=1e-9)
    creeping = dict.fromkeys(MORTAR, ThinLayer(KelvinVoigt(6.0, 4.0, theta_lmbda=3.0, theta_mu=5.0), 0.1))
    within = march(bond(stress=lambda x, t: (t * S).tolist()).interface(creeping), [0.7, 1.0], theta=0.75).last
    assert within.mean_stress() == pytest.approx(S, rel=1e-9)


def test_mean_stress_in_space():
    joint, stress = laminate("hexahedron", depth=1.0), np.diag([0.1, 1.0, 0.2]) + 0.3
    state = solve(Structure(joint, body=ROCK, supports={}, stress=stress).interface(springs(4.0, 1.5)))
    e = np.linalg.solve(layered(ROCK, 4.0, 1.5, 3), [0.4, 1.3, 0.5, 0.3, 0.3, 0.3])
    assert np.diag(state.mean_strain()) == pytest.approx(e[:3], rel=1e-10)
    assert 2 * state.mean_strain()[[1, 0, 0], [2, 2, 1]] == pytest.approx(e[3:], rel=1e-10)


def test_bodies_that_are_not_linear():
    """Without a layer the strain is E everywhere; with one, stress and jump are in series."""
    law, e = Stiffening(0.0, 3.0, 6e3), 0.02
    joint = laminate()

    def strain(x, t):
        return ((0.0, e * t), (e * t, 0.0))

    structure = Structure(joint, body=law, supports={}, strain=strain)
    whole = solve(structure.bonded(), 1.0)
    expected = 6.0 * (1 + 1e3 * 2 * e**2) * e
    assert whole.mean_stress() == pytest.approx(np.array([[0, expected], [expected, 0]]), rel=1e-10, abs=1e-12)
    assert np.abs(whole.u.x.array).max() < 1e-12
    assert whole.energies()["bodies"] == pytest.approx(3.0 * (2 * e**2 + 1e3 * (2 * e**2) ** 2 / 2), rel=1e-10)
    history = march(structure.interface(springs(4.0, 1.5)), [0.5, 1.0])
    stress = history.last.mean_stress()[0, 1]
    inside = np.roots([12.0e3, 0.0, 6.0, -stress])
    inside = float(inside[np.abs(inside.imag) < 1e-12].real[0])
    assert 2 * inside + stress / 1.5 == pytest.approx(2 * e, rel=1e-9)
    assert history.last.energies()["layer"] == pytest.approx(stress**2 / 1.5 / 2, rel=1e-9)
    assert max(abs(state.audit.imbalance) for state in history) < 1e-9


@pytest.mark.filterwarnings("error")  # S has no free ends: it goes on at the other side
@pytest.mark.parametrize("load", ["strain", "stress"])
def test_an_incompressible_layer_does_not_open(load):
    value = np.array([[0.0, 0.05], [0.05, -0.04]])
    structure = Structure(laminate(), body=ROCK, supports={}, **{load: value})
    state = solve(structure.interface(ThinLayer(Incompressible(mu=1.5), 0.01, at=1.0)))
    A, (e, s) = layered(ROCK, 1e15, 1.5, 2), (state.mean_strain(), state.mean_stress())
    assert [s[0, 0], s[1, 1], s[0, 1]] == pytest.approx(A @ [e[0, 0], e[1, 1], 2 * e[0, 1]], rel=1e-9, abs=1e-12)
    assert {"strain": e, "stress": s}[load] == pytest.approx(value, rel=1e-9, abs=1e-12)


def test_a_strip_that_repeats_in_one_direction():
    """Supports and tractions on the other sides as usual: a column between rollers that may also slide."""
    joint = periodic(sandwich(1.0, 0.5, 0.5, 0.25, cell="quadrilateral"), ("LEFT", "RIGHT"))
    structure = Structure(joint, body=ROCK, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.3, -1.0)})
    model = structure.interface(springs(4.0, 1.5))
    state, M = solve(model), ROCK.lmbda + 2 * ROCK.mu
    assert not model.supports.anchor_axes
    assert state.energies()["loads"] == pytest.approx(0.3**2 * (1 / ROCK.mu + 1 / 1.5) + 1 / M + 1 / 4.0, rel=1e-11)
    assert state.mean_stress()[:, 1] == pytest.approx([0.3, -1.0], rel=1e-11)


def test_only_free_translations_are_held():
    assert bond().interface(MORTAR).supports.anchor_axes == ("x", "y")
    strip = periodic(sandwich(1.0, 0.5, 0.5, 0.25, cell="quadrilateral"), ("LEFT", "RIGHT"))
    rolling = Structure(strip, body=ROCK, supports={"BOTTOM": {"y": 0.0}}, tractions={"TOP": (0.0, -1.0)})
    assert rolling.interface(springs(4.0, 1.5)).supports.anchor_axes == ("x",)
    on_springs = Structure(strip, body=ROCK, supports={}, parts=[Springs("BOTTOM", normal=1.0, tangential=2.0)])
    assert on_springs.interface(springs(4.0, 1.5)).supports.anchor_axes == ()
    pushed = Structure(strip, body=ROCK, supports={"BOTTOM": {"y": 0.0}}, tractions={"TOP": (0.1, -1.0)})
    words = r"add up to 0\.1 along x at t = 0, and nothing balances them"
    refused(InputError, words, solve, pushed.interface(springs(4.0, 1.5)))
    box = periodic(sandwich(1.0, 0.5, 0.5, 0.25, depth=1.0, cell="hexahedron"), ("LEFT", "RIGHT"))
    turns = Structure(box, body=ROCK, supports={}, element="Q1")
    words = r"rigid motion of the structure \(rotation about \(1, 0, 0\)\)"
    refused(InputError, words, turns.interface, springs(4.0, 1.5))


# ---------------------------------------------------------------- what is refused
def test_refused_joints():
    joint = sandwich(1.0, 0.5, 0.5, 0.25, cell="quadrilateral")
    refused(InputError, "unknown side 'LEFTT', did you mean 'LEFT'", lambda: periodic(joint, ("LEFTT", "RIGHT")))
    refused(InputError, "'LEFT' is in two pairs", lambda: periodic(joint, ("LEFT", "RIGHT"), ("LEFT", "TOP")))
    refused(InputError, "'LEFT' is in two pairs", periodic, periodic(joint, ("LEFT", "RIGHT")), ("LEFT", "TOP"))
    refused(InputError, r"'LEFT' and 'TOP' do not match: 'LEFT' has a node at \(", periodic, joint, ("LEFT", "TOP"))
    moved = joint.points.copy()
    moved[np.isclose(joint.points, (1.0, 0.25)).all(axis=1), 1] += 0.01
    words = r"has a node at \(0, 0.25\), and 'RIGHT' has none at \(1, 0.25\)"
    refused(InputError, words, periodic, replace(joint, points=moved), ("LEFT", "RIGHT"))
    refused(InputError, "do not match any more", lambda: replace(periodic(joint, ("LEFT", "RIGHT")), points=moved))
    words = r"needs three cells or more between its sides \('LEFT' and 'RIGHT'\)"
    strip1, strip2, strip3 = (sandwich(0.25 * n, 0.5, 0.5, 0.25, cell="quadrilateral") for n in (1, 2, 3))
    refused(InputError, words, periodic, strip1, ("LEFT", "RIGHT"))
    refused(InputError, words, periodic, strip2, ("LEFT", "RIGHT"))
    periodic(strip3, ("LEFT", "RIGHT"))
    words = "the seam 'S' cannot be a periodic side.*cut the periodic cell through"
    refused(InputError, words, periodic, joint, ("S", "TOP"))
    for cut in ((0.5, 0.5), (0.25, 0.0), (0.25, 0.99)):
        refused(InputError, r"along a joint|between 0 and 1", bond_cell, BRICK, 0.25, cut=cut)


def test_refused_structures():
    layer = springs(4.0, 1.5)

    def model(**options):
        return Structure(laminate(), **({"body": ROCK, "supports": {}} | options)).interface(layer)

    for options, message in (
        (dict(supports={"LEFT": 0.0}), "support on 'LEFT': this side is identified with another one"),
        (dict(tractions={"TOP/COURSE 2": (0.0, 1.0)}), "traction on 'TOP/COURSE 2': this side is identified"),
        (dict(strain=(1e-3, 0.0, 0.0)), "needs 2 x 2 finite components"),
        (dict(strain=np.eye(2), stress=np.eye(2)), "a mean strain or a mean stress, not both"),
        (dict(stress=np.eye(2), body=Stiffening(0.0, 3.0, 6e3)), "mean stress needs linear bodies"),
        (dict(strain=((0.0, 1e-3), (0.0, 0.0))), "at t = 0 is not symmetric"),
        (dict(strain=lambda x, t: ((x[0], 0.0), (0.0, 0.0))), "depends on the place"),
    ):
        refused(InputError, message, model, **options)
    joint = periodic(sandwich(1.0, 0.5, 0.5, 0.25), ("LEFT", "RIGHT"))
    strip = Structure(joint, body=ROCK, supports={}, stress=np.eye(2))
    refused(InputError, "needs a joint periodic in 2 directions", lambda: strip.interface(layer))
    refused(InputError, "the loads of the periodic joint add up to", lambda: solve(model(body_force=(0.0, -1.0))))
    plain = Structure(laminate(), body=ROCK, supports={}, strain=np.eye(2))
    of_order_1 = ThinLayer(LinearElastic(1.0, 1.0), 0.01, order=1, at=1.0)
    refused(InputError, "order=1, whose strains along S", plain.interface, of_order_1)
    alone = Structure(sandwich(1.0, 0.5, 0.5, 0.25), body=ROCK, supports={"BOTTOM": 0.0}, strain=np.eye(2))
    refused(InputError, "the mean strain needs a periodic joint; see geometry.periodic", alone.interface, layer)
    plain = Structure(alone.joint, body=ROCK, supports={"BOTTOM": 0.0}).interface(layer)
    refused(InputError, "needs a model of a periodic joint", homogenised_stiffness, plain)
    stiffens = Structure(laminate(), body=Stiffening(0.0, 3.0, 6e3), supports={}).interface(layer)
    refused(InputError, "is not linear, or has stresses without strains", homogenised_stiffness, stiffens)
