"""Rigid plates: closed forms, work conjugate motions and moments, mixed data, laws of all kinds, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forms import LinearElastic
from forms.base import InputError
from geometry import sandwich
from tests.orders import taylor_order
from tests.refused import refused
from tests.supports_run import BODY, CREEP, EPS, GLUE, KINDS, MORTAR, model, out_of_balance, plate
from tests.test_order1 import relative_errors
from thinlayer import (
    LimitLoad,
    Probe,
    RigidPlate,
    Springs,
    Structure,
    ThinLayer,
    march,
    piecewise,
    solve,
)
from thinlayer.discretisation.part_definition import PartDefinition
from thinlayer.errors import LooseBody
from thinlayer.solving.solve import Solver

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
    motion, reaction = top.motion_in(first), first.reaction("TOP")
    names = "xyz"[:dim]
    turns = ["rotation"] if dim == 2 else [f"rotation {axis}" for axis in names]
    all_motions = dict(zip([*names, *turns], [*motion.translation, *np.atleast_1d(motion.rotation)], strict=True))
    for prescribed in ([*all_motions], ["x", turns[-1]]):
        moved = RigidPlate(
            "TOP", motion={name: float(all_motions[name]) for name in prescribed},
            force=[0.0 if name in prescribed else f for name, f in zip(names, reaction.force, strict=True)],
            moment=_moment({name: 0.0 for name in prescribed}, turns, reaction.moment),
        )  # fmt: skip
        structure = loaded.structure
        again = Structure(structure.joint, body=BODY, supports={"BOTTOM": 0}, parts=[moved], element=structure.element)
        state = solve(model(again, kind))
        assert state.reaction("TOP").force == pytest.approx(reaction.force, rel=1e-7)
        assert state.reaction("TOP").moment == pytest.approx(reaction.moment, rel=1e-7)
        assert moved.motion_in(state).rotation == pytest.approx(motion.rotation, rel=1e-7)
        assert out_of_balance(state) < 1e-10
    stored = sum(value for name, value in first.energies().items() if name != "loads")
    work = reaction.force @ motion.translation + np.sum(reaction.moment * motion.rotation)
    assert stored == pytest.approx(work / 2, rel=1e-9)


def _moment(prescribed, turns, moment):
    values = [prescribed.get(name, m) for name, m in zip(turns, np.atleast_1d(moment), strict=True)]
    return values[0] if len(values) == 1 else values


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


def test_the_limit_load_of_a_plate():
    """Pushed along by a plate that stays level under a pressure: the mortar's C cos + sin p, as of a traction."""
    joint = sandwich(2.0, 0.5, 0.6, 0.5)
    top = RigidPlate("TOP", force=lambda x, t: (t, -0.4), motion={"rotation": 0.0})
    made = model(Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, parts=[top]), "interface", MORTAR)
    limit = refused(LimitLoad, "", march, made, [0.05 * k for k in range(1, 12)])
    assert limit.t == pytest.approx(2.0 * 0.05 * np.cos(np.pi / 6) + 0.5 * 0.4, rel=5e-3)
    assert limit.resultant == pytest.approx((limit.t, -0.4), abs=1e-12)


@pytest.mark.parametrize("theta", [1.0, 0.5])
def test_tangent(theta):
    _, made = plate(2, "interface", angle=0.3, law=MORTAR if theta == 1 else CREEP)
    with Solver(made, method="newton") as solver:
        orders = taylor_order(solver, theta=theta)
    assert orders == float("inf") or orders > 1.9


# ---------------------------------------------------------------- what is loose, what is refused
def test_a_plate_that_holds_nothing():
    """Neither a free plate nor its given force prevents a motion; prescribed motions do."""
    joint = sandwich(2.0, 0.5, 0.6, 0.5)
    with pytest.raises(InputError, match="rigid motion of the structure"):
        model(Structure(joint, body=BODY, supports={}, parts=[RigidPlate("TOP", force=(0.0, -1.0))]), "interface")
    with pytest.raises(InputError, match=r"rigid motion of the structure .rotation"):
        model(Structure(joint, body=BODY, supports={}, parts=[RigidPlate("TOP", motion={"x": 0, "y": 0})]), "interface")
    plate = RigidPlate("TOP", motion={"x": 0.0, "y": 0.0, "rotation": 0.0})
    structure = Structure(joint, body=BODY, supports={}, parts=[plate], tractions={"BOTTOM": (0.1, -0.2)})
    assert solve(model(structure, "interface")).reaction("TOP").force == pytest.approx([-0.2, 0.4], rel=1e-9)
    guided_plate = RigidPlate("TOP", motion={"x": 0.0, "rotation": 0.0})
    structure = Structure(joint, body=BODY, supports={}, parts=[guided_plate, Springs("BOTTOM", normal=1.0)])
    solve(model(structure, "interface"))


def test_a_body_that_is_loose_beside_a_plate():
    """An open joint below the plate's body: the plate's own freedom is found, the body named."""
    joint = sandwich(2.0, 0.5, 0.6, 0.5)
    structure = Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, parts=[RigidPlate("TOP", motion={"x": 0.0})])
    refused(LooseBody, "body 'UPPER'", lambda: solve(structure.interface({"S": None})))
    plate = RigidPlate("TOP", motion={"x": 0.01, "y": 0.0, "rotation": 0.0})
    state = solve(Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, parts=[plate]).interface({"S": None}))
    assert state.reaction("TOP").force == pytest.approx([0.0, 0.0], abs=1e-10)


def test_refused():
    for options, message in [
        (dict(place="TOB"), "did you mean 'TOP'"),
        (dict(place="TOP", force=(1.0,)), "2 finite components"),
        (dict(place="TOP", about=(True, 0.0)), "a point of 2 finite coordinates"),
        (dict(place="TOP", moment=(1.0, 2.0)), "needs a finite number, or a function"),
        (dict(place="TOP", motion={"z": 0.0}), "unknown motion 'z'"),
        (dict(place="TOP", motion={"x": 0.0}, force=(1.0, 0.0)), "the motion 'x' is prescribed, and 1 is given"),
        (dict(place="TOP", force=lambda x, t: (x[0], 0.0)), "depends on the place"),
    ]:

        def made(options=options):
            parts = [RigidPlate(**options)]
            structure = Structure(sandwich(2.0, 0.5, 0.6, 0.5), body=BODY, supports={"BOTTOM": 0}, parts=parts)
            return solve(structure.interface(ThinLayer(GLUE, EPS, at=1.0)))

        refused(ValueError, message, made)


def test_a_plate_across_s_that_turns_has_the_thickness_for_an_arm():
    """The law of order 1 knows that faces stand apart: without the arm its compliance is 11 % too small at eps = 1/16."""
    joint = sandwich(1.0, 0.5, 0.4, 1 / 8, h_S=1 / 16, cell="quadrilateral")
    plate = RigidPlate("LEFT", force=(0.2, -0.3), moment=0.1)
    beam = Structure(joint, body=LinearElastic.young(100.0, 0.3), supports={"RIGHT": 0.0}, tractions={}, parts=[plate])
    errors = []
    for eps in (1 / 8, 1 / 16):
        law = LinearElastic.young(1.0, 0.35).scaled(1 / eps)
        full = solve(beam.full(ThinLayer(law, eps, at=1.0), cells_through=4))
        limit = solve(beam.interface(ThinLayer(law, eps, order=1, at=1.0)))
        errors.append(relative_errors(full, limit)[0])
        assert limit.load_work() == pytest.approx(full.load_work(), rel=1e-3)
        thick = ThinLayer(law, 2 * eps, order=1, at=1.0)
        anew, other = (solve(model).load_work() for model in (beam.interface(thick), limit.model.with_layer(thick)))
        assert other == pytest.approx(anew, rel=1e-9)
    assert errors[1] < errors[0] / 3
    top = RigidPlate("TOP", force=(0.2, -0.3), moment=0.1)  # of one body: its own point stays where it is
    of_one = Structure(joint, body=LinearElastic.young(100.0, 0.3), supports={"BOTTOM": 0.0}, parts=[top])
    state = solve(of_one.interface(ThinLayer(law, eps, order=1, at=1.0)))
    motion = top.motion_in(state)
    assert Probe(state).displacement(motion.about) == pytest.approx(motion.translation, rel=1e-9)


class Late(RigidPlate):
    def multi_point_constraint(self, model):
        force = lambda t: model.coordinates.coefficient(LATE, "force", (2,)).at_time(t)
        return replace(super().multi_point_constraint(model), resultant=lambda t: np.append(force(t), 0.0))


LATE = piecewise({0.0: (0.0, 0.0), 1.0: (0.0, -1.0), 2.0: (0.0, -3.0)})


class Nothing(PartDefinition):
    key = "nothing"


def test_refused_additions():
    """One whose break times no step would meet, and one that does nothing."""
    data, layer = {"body": LinearElastic.young(30.0, 0.3), "supports": {"BOTTOM": 0.0}}, ThinLayer(CREEP, EPS, at=1.0)
    late = Structure(sandwich(1.0, 0.5, 0.5, 0.5), parts=[Late("TOP")], **data).interface(layer)
    refused(InputError, r"; give it in check\(model\)", lambda: march(late, [1.5, 2.0]))
    made = lambda: Structure(sandwich(1.0, 0.5, 0.5, 0.5), parts=[Nothing()], **data).bonded()
    refused(InputError, "'nothing' does nothing: it has neither part", made)
