"""Rigid plates: closed forms, work conjugate motions and moments, mixed data, laws of all kinds, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from forms import LinearElastic
from forms.base import InputError
from geometry import block, sandwich
from tests.orders import taylor_order
from tests.refused import refused
from tests.softening_bars import KINKED
from tests.supports_run import BODY, CONTACT, CREEP, EPS, GLUE, KINDS, MORTAR, model, out_of_balance, plate, turn
from tests.test_order1 import apart
from thinlayer import (
    ArcLength,
    LimitLoad,
    RigidPlate,
    Springs,
    Structure,
    Surface,
    ThinLayer,
    estimate,
    march,
    piecewise,
    solve,
)
from thinlayer.discretisation.addition import Addition
from thinlayer.errors import LooseBody
from thinlayer.solving.solvers import Solver

BEAM = LinearElastic.young(100.0, 0.0)


# ---------------------------------------------------------------- closed forms
@pytest.mark.parametrize("kind", KINDS)
def test_a_moment_turns_a_plate(kind):
    """nu = 0, a soft layer without Poisson's effect: pure bending of a short column, whose sections stay plane."""
    width, height, M, N = 2.0, 1.1, 0.7, -0.4
    inertia, glue = width**3 / 12, LinearElastic(0.0, 2.0)
    top = RigidPlate("TOP", force=(0.0, N), moment=M)
    joint = sandwich(width, 0.5, 0.6, 0.25, structured=True)
    state = solve(model(Structure(joint, body=BEAM, supports={"BOTTOM": 0.0}, parts=[top]), kind, glue))
    bodies, soft = height / 100.0, (0.0 if kind == "bonded" else 1 / (2 * glue.mu))
    motion = top.motion_in(state)
    assert motion.rotation == pytest.approx(M / inertia * (bodies + soft), rel=1e-8)
    assert motion.translation[1] == pytest.approx(N / width * (bodies + soft), rel=1e-8)
    energies = state.energies()
    stored = energies["bodies"] + energies["layer"]
    assert stored == pytest.approx((M * motion.rotation + N * motion.translation[1]) / 2, rel=1e-9)
    assert energies["loads"] == pytest.approx(2 * stored, rel=1e-9)
    assert state.audit.supplied == pytest.approx(2 * stored, rel=1e-9)  # backward Euler: all at once
    assert state.reaction("TOP").force == pytest.approx([0.0, N], abs=1e-10)
    assert state.reaction("TOP").moment == pytest.approx(M, rel=1e-10)
    assert out_of_balance(state) < 1e-10


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_given_forces_and_prescribed_motions_are_conjugate(dim, kind):
    """The motion found for forces, prescribed in part or whole, gives the same forces as reactions."""
    top, loaded = plate(dim, kind)
    first = solve(loaded)
    assert out_of_balance(first) < 1e-10
    motion, given = top.motion_in(first), first.reaction("TOP")
    names = "xyz"[:dim]
    turns = ["rotation"] if dim == 2 else [f"rotation {axis}" for axis in names]
    all_motions = dict(zip([*names, *turns], [*motion.translation, *np.atleast_1d(motion.rotation)], strict=True))
    for held in ([*all_motions], ["x", turns[-1]]):
        moved = RigidPlate(
            "TOP", motion={name: float(all_motions[name]) for name in held},
            force=[0.0 if name in held else f for name, f in zip(names, given.force, strict=True)],
            moment=_moment({name: 0.0 for name in held}, turns, given.moment),
        )  # fmt: skip
        structure = loaded.structure
        again = Structure(structure.joint, body=BODY, supports={"BOTTOM": 0}, parts=[moved], element=structure.element)
        state = solve(model(again, kind))
        assert state.reaction("TOP").force == pytest.approx(given.force, rel=1e-7)
        assert state.reaction("TOP").moment == pytest.approx(given.moment, rel=1e-7)
        assert moved.motion_in(state).rotation == pytest.approx(motion.rotation, rel=1e-7)
        assert out_of_balance(state) < 1e-10
    stored = sum(value for name, value in first.energies().items() if name != "loads")
    work = given.force @ motion.translation + np.sum(given.moment * motion.rotation)
    assert stored == pytest.approx(work / 2, rel=1e-9)


def _moment(held, turns, given):
    values = [held.get(name, m) for name, m in zip(turns, np.atleast_1d(given), strict=True)]
    return values[0] if len(values) == 1 else values


def test_turned_structures():
    """On inclined rollers, with the plate: the same as along the axes; moments and rotations do not change."""
    states, motions = [], []
    for angle in (1e-3, 0.3):
        top, turned = plate(2, "interface", angle=angle)
        states.append(solve(turned))
        motions.append(top.motion_in(states[-1]))
    for place in ("TOP", "BOTTOM", "LEFT"):
        one, other = (state.reaction(place) for state in states)
        assert turn(-0.3) @ other.force == pytest.approx(turn(-1e-3) @ one.force, rel=1e-9, abs=1e-10)
        assert other.moment == pytest.approx(one.moment, rel=1e-9, abs=1e-10)
    assert motions[1].rotation == pytest.approx(motions[0].rotation, rel=1e-9)
    assert turn(-0.3) @ motions[1].translation == pytest.approx(turn(-1e-3) @ motions[0].translation, rel=1e-9)


def test_the_point_of_the_moment():
    """The same forces, with their moment about another point: the same motion."""
    joint = sandwich(2.0, 0.5, 0.6, 0.5)
    plates = [
        RigidPlate("TOP", force=(0.3, -2.0), moment=0.7),
        RigidPlate("TOP", force=(0.3, -2.0), moment=0.7 - 2.0 * 1.0 - 0.3 * 0.6, about=(0.0, 0.0)),
    ]
    states = [solve(model(Structure(joint, body=BODY, supports={"BOTTOM": 0}, parts=[p]), "interface")) for p in plates]
    assert states[1].u.x.array == pytest.approx(states[0].u.x.array, abs=1e-10)
    assert plates[1].motion_in(states[1]).rotation == pytest.approx(plates[0].motion_in(states[0]).rotation, rel=1e-9)


# ---------------------------------------------------------------- laws, time, solvers
@pytest.mark.parametrize(("law", "theta"), [(CREEP, 1.0), (CREEP, 0.5), (MORTAR, 1.0)])
def test_in_time(law, theta):
    """The energy balance has the work of given forces and of prescribed motions."""
    ramp = piecewise({0: 0.0, 1: 1.0})
    top = RigidPlate("TOP", force=lambda x, t: (0.02 * ramp(x, t), 0.0), motion={"rotation": lambda x, t: 2e-4 * t})
    joint = sandwich(2.0, 0.5, 0.6, 0.5)
    made = model(Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, parts=[top]), "interface", law)
    assert 1.0 in made.break_times
    history = march(made, [0.2, 0.6, 1.0], theta=theta)
    assert np.abs(history.table["imbalance"]).max() < 1e-8
    assert top.motion_in(history.last).rotation == pytest.approx(2e-4, rel=1e-10)
    assert history.last.reaction("TOP").force == pytest.approx([0.02, 0.0], abs=1e-9)
    assert out_of_balance(history.last) < 1e-8


def test_along_a_path():
    """A plate that is moved up by arc length, and may turn, on a law that softens: to the same forces as a support."""
    joint = block(1.0, 0.5, 0.25, cell="quadrilateral", structured=True)
    given = {"body": BODY, "element": "Q1"}
    top = RigidPlate("TOP", motion={"x": 0.0, "rotation": 0.0, "y": lambda x, t: t})
    plates = Structure(joint, supports={}, parts=[top], **given).interface(KINKED)
    supports = Structure(joint, supports={"TOP": {"x": 0.0, "y": lambda x, t: t}}, **given).interface(KINKED)
    forces = []
    for made in (plates, supports):
        history = march(made, ArcLength(end=0.15, first=0.02))
        forces.append(history.last.reaction("TOP").force[1])
        assert out_of_balance(history.last) < 1e-8
    assert forces[0] == pytest.approx(forces[1], rel=1e-6)


def test_the_limit_load_of_a_plate():
    """Pushed along by a plate that stays level under a pressure: the mortar's C cos + sin p, as of a traction."""
    joint = sandwich(2.0, 0.5, 0.6, 0.5)
    top = RigidPlate("TOP", force=lambda x, t: (t, -0.4), motion={"rotation": 0.0})
    made = model(Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, parts=[top]), "interface", MORTAR)
    with pytest.raises(LimitLoad) as limit:
        march(made, [0.05 * k for k in range(1, 12)])
    expected = 2.0 * 0.05 * np.cos(np.pi / 6) + 0.5 * 0.4
    assert limit.value.t == pytest.approx(expected, rel=5e-3)
    assert limit.value.resultant == pytest.approx((limit.value.t, -0.4), abs=1e-12)


def test_contact_under_a_plate():
    """Pressed by a plate that may turn: S carries the force at its place; the solvers for contact are left out."""
    top = RigidPlate("TOP", force=(0.1, -3.0), moment=0.5)
    joint = block(4.0, 2.0, 0.5, structured=True)
    made = Structure(joint, body=BODY, supports={}, parts=[top], element="P1").interface(CONTACT)
    state = solve(made)
    assert state.report.method == "newton"
    assert out_of_balance(state) < 1e-10
    assert state.reaction("S", about=(2.0, 2.0)).moment == pytest.approx(-0.5, rel=1e-9)
    report = Surface(state.model).contact(state)
    assert report.equilibrium < 1e-10
    assert report.clapeyron < 1e-9
    assert report.normal_force == pytest.approx(3.0, rel=1e-9)
    with pytest.raises(InputError, match=r"method='condensed' needs .* no inclined supports or rigid plates"):
        solve(made, method="condensed")


@pytest.mark.parametrize("theta", [1.0, 0.5])
def test_tangent(theta):
    _, made = plate(2, "interface", angle=0.3, law=MORTAR if theta == 1 else CREEP)
    with Solver(made, method="newton") as solver:
        orders = taylor_order(solver, theta=theta)
    assert orders == float("inf") or orders > 1.9


def test_by_conjugate_gradients():
    """Multigrid knows the rigid motions in the other unknowns: not many more iterations than a support needs."""
    joint = sandwich(2.0, 0.5, 0.6, 0.2, depth=1.0)
    gamg = {"ksp_type": "cg", "pc_type": "gamg", "ksp_rtol": 1e-10}
    parts = {"plate": [RigidPlate("TOP", force=(0.3, -2.0, 0.1))], "none": []}
    found = {}
    for name, part in parts.items():
        tractions = {} if part else {"TOP": (0.15, -1.0, 0.05)}
        structure = Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, tractions=tractions, parts=part, element="P1")
        found[name] = solve(model(structure, "interface"), options=gamg)
        if part:
            direct = solve(found[name].model)
            assert found[name].u.x.array == pytest.approx(direct.u.x.array, abs=1e-8)
    assert found["plate"].report.iterations <= 2 * found["none"].report.iterations


# ---------------------------------------------------------------- what is loose, what is refused
def test_a_plate_that_holds_nothing():
    """Neither a free plate nor its given force prevents a motion; prescribed motions do."""
    joint = sandwich(2.0, 0.5, 0.6, 0.5)
    with pytest.raises(InputError, match="rigid motion of the structure"):
        model(Structure(joint, body=BODY, supports={}, parts=[RigidPlate("TOP", force=(0.0, -1.0))]), "interface")
    with pytest.raises(InputError, match=r"rigid motion of the structure .rotation"):
        model(Structure(joint, body=BODY, supports={}, parts=[RigidPlate("TOP", motion={"x": 0, "y": 0})]), "interface")
    held = RigidPlate("TOP", motion={"x": 0.0, "y": 0.0, "rotation": 0.0})
    structure = Structure(joint, body=BODY, supports={}, parts=[held], tractions={"BOTTOM": (0.1, -0.2)})
    assert solve(model(structure, "interface")).reaction("TOP").force == pytest.approx([-0.2, 0.4], rel=1e-9)
    one = RigidPlate("TOP", motion={"x": 0.0, "rotation": 0.0})
    structure = Structure(joint, body=BODY, supports={}, parts=[one, Springs("BOTTOM", normal=1.0)])
    solve(model(structure, "interface"))


def test_a_body_that_is_loose_beside_a_plate():
    """An open joint below the plate's body: the plate's own freedom is found, the body named."""
    joint = sandwich(2.0, 0.5, 0.6, 0.5)
    structure = Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, parts=[RigidPlate("TOP", motion={"x": 0.0})])
    refused(LooseBody, "body 'UPPER'", lambda: solve(structure.interface({"S": None})))
    held = RigidPlate("TOP", motion={"x": 0.01, "y": 0.0, "rotation": 0.0})
    state = solve(Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, parts=[held]).interface({"S": None}))
    assert state.reaction("TOP").force == pytest.approx([0.0, 0.0], abs=1e-10)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (dict(place="TOB"), "did you mean 'TOP'"),
        (dict(place="S"), "inside, or below a layer"),
        (dict(place="TOP", force=(1.0,)), "2 finite components"),
        (dict(place="TOP", force=(np.complex128(1j), 0.0)), "2 finite components"),
        (dict(place="TOP", force=lambda x, t: (np.complex128(1j), 0.0)), "2 finite components"),
        (dict(place="TOP", about=(True, 0.0)), "a point of 2 finite coordinates"),
        (dict(place="TOP", moment=(1.0, 2.0)), "needs a finite number, or a function"),
        (dict(place="TOP", motion={"z": 0.0}), "unknown motion 'z'"),
        (dict(place="TOP", motion={"x": "fixed"}), "needs a finite number, or a function"),
        (dict(place="TOP", motion={"x": 0.0}, force=(1.0, 0.0)), "the motion 'x' is prescribed, and 1 is given"),
        (dict(place="TOP", force=lambda x, t: (x[0], 0.0)), "depends on the place"),
        (dict(place="TOP", about=(1.0, 2.0, 3.0)), "a point of 2 finite coordinates"),
    ],
)
def test_refused(given, message):
    structure = Structure(sandwich(2.0, 0.5, 0.6, 0.5), body=BODY, supports={"BOTTOM": 0}, parts=[RigidPlate(**given)])
    refused(ValueError, message, lambda: solve(structure.interface(ThinLayer(GLUE, EPS, at=1.0))))


def test_a_plate_at_a_plane_of_symmetry():
    """Half of a symmetric structure: the rollers hold a node of the plate too, as its prescribed motions do."""
    half, whole = (sandwich(width, 0.5, 0.6, 0.5, cell="quadrilateral", structured=True) for width in (1.0, 2.0))
    level = RigidPlate("TOP", force=(0.0, -1.0), motion={"x": 0.0, "rotation": 0.0})
    rollers = {"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}}
    one = solve(model(Structure(half, body=BODY, supports=rollers, parts=[level]), "interface"))
    top = RigidPlate("TOP", force=(0.0, -2.0), motion={"x": 0.0, "rotation": 0.0})
    held = {"BOTTOM": {"y": 0.0}, (1.0, -0.5): {"x": 0.0}}
    other = solve(model(Structure(whole, body=BODY, supports=held, parts=[top]), "interface"))
    assert level.motion_in(one).translation[1] == pytest.approx(top.motion_in(other).translation[1], rel=1e-9)
    assert 2 * one.energies()["layer"] == pytest.approx(other.energies()["layer"], rel=1e-9)
    assert out_of_balance(one) < 1e-10
    moved = RigidPlate("TOP", motion={"x": lambda x, t: t, "rotation": 0.0})
    made = model(Structure(half, body=BODY, supports=rollers, parts=[moved]), "interface")
    solve(made, t=0.0)
    with pytest.raises(
        InputError, match=r"at \(0, .*'LEFT' prescribes x = 0 and the plate TOP prescribes x = 1 at t = 1"
    ):
        solve(made, t=1.0)


def test_a_support_at_a_node_of_a_plate_holds_it_there():
    """It turns about this node, as if its motions were prescribed there; without the support it moves."""
    corner, joint = (0.0, -0.5), sandwich(2.0, 0.5, 0.6, 0.5)
    data = {"body": BODY, "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.3, -0.4)}}
    plates = RigidPlate("LEFT", about=corner), RigidPlate("LEFT", motion={"x": 0.0, "y": 0.0}, about=corner)
    states = [solve(model(Structure(joint, **data, parts=[one]), "interface")) for one in plates]
    held, prescribed = (plate.motion_in(state) for plate, state in zip(plates, states, strict=True))
    assert held.rotation == pytest.approx(prescribed.rotation, rel=1e-9)
    assert np.abs(held.translation).max() < 1e-12
    assert states[0].energies()["layer"] == pytest.approx(states[1].energies()["layer"], rel=1e-9)
    total = [sum(one.force for one in state.reactions_by_place().values()) for state in states]
    assert total[0] == pytest.approx(total[1], rel=1e-9)
    rollers = data | {"supports": {"BOTTOM": {"y": 0.0}, "RIGHT": {"x": 0.0}}}
    state = solve(model(Structure(joint, **rollers, parts=[plates[0]]), "interface"))
    assert abs(plates[0].motion_in(state).translation[0]) > 1e-6


def test_plates_that_share_a_node():
    structure = Structure(
        sandwich(2.0, 0.5, 0.6, 0.5), body=BODY, supports={"BOTTOM": 0.0},
        parts=[RigidPlate("TOP"), RigidPlate("RIGHT/UPPER")],
    )  # fmt: skip
    with pytest.raises(InputError, match=r"plate TOP and plate RIGHT/UPPER share a node"):
        solve(structure.interface(ThinLayer(GLUE, EPS, at=1.0)))


def test_a_plate_across_s_that_turns_has_the_thickness_for_an_arm():
    """The law of order 1 knows that faces stand apart: without the arm its compliance is 11 % too small at eps = 1/16."""
    joint = sandwich(1.0, 0.5, 0.4, 1 / 8, h_S=1 / 16, cell="quadrilateral")
    plate = RigidPlate("LEFT", force=(0.2, -0.3), moment=0.1)
    beam = Structure(joint, body=LinearElastic.young(100.0, 0.3), supports={"RIGHT": 0.0}, tractions={}, parts=[plate])
    errors = []
    for eps in (1 / 8, 1 / 16):
        law = LinearElastic.young(1.0, 0.35).scaled(1 / eps)
        full = solve(beam.full(ThinLayer(law, eps, at=1.0), cells_through=4))
        first, limit = (solve(beam.interface(ThinLayer(law, eps, order=order, at=1.0))) for order in (0, 1))
        errors.append(apart(full, limit)[0])
        assert limit.load_work() == pytest.approx(full.load_work(), rel=1e-3)
        refused(InputError, "plates or inclined supports tie nodes on S", estimate, first)
    assert errors[1] < errors[0] / 3


class Late(RigidPlate):
    def check(self, model):
        pass


class Nothing(Addition):
    key = "nothing"


def test_refused_additions():
    """One whose break times no step would meet, and one that does nothing."""
    force = piecewise({0.0: (0.0, 0.0), 1.0: (0.0, -1.0), 2.0: (0.0, -3.0)})
    data, layer = {"body": LinearElastic.young(30.0, 0.3), "supports": {"BOTTOM": 0.0}}, ThinLayer(CREEP, EPS, at=1.0)
    late = Structure(sandwich(1.0, 0.5, 0.5, 0.5), parts=[Late("TOP", force=force)], **data).interface(layer)
    refused(InputError, r"a part gives it in check\(model\)", lambda: march(late, [1.5, 2.0]))
    made = lambda: Structure(sandwich(1.0, 0.5, 0.5, 0.5), parts=[Nothing()], **data).bonded()
    refused(InputError, "'nothing' does nothing: it has neither part", made)
