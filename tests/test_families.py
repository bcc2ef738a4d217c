"""Models of a family, made by with_layer and with_loads, have the results of models made by themselves."""

from __future__ import annotations

import numpy as np
import pytest

from forms import HolonomicCoulomb, Incompressible, KelvinVoigt, LinearElastic, MohrCoulomb, Norton
from forms.base import InputError
from geometry import sandwich
from tests.refused import refused
from thinlayer import RigidPlate, Springs, Structure, ThinLayer, march, piecewise, solve
from thinlayer.solving.solvers import Solver

JOINT = sandwich(width=2.0, lower=0.5, upper=0.7, h=0.25, structured=True)
STEEL = LinearElastic.young(E=900.0, nu=0.3)
SUPPORTS = {"BOTTOM": 0, "TOP": {"x": 0.003}}
PULL, OTHER = {"TOP": (0.0, -0.8)}, {"TOP": (0.0, 0.5), "RIGHT": (0.2, 0.1)}
GLUE, SOFT = ThinLayer(LinearElastic(60.0, 40.0), 0.01, at=1.0), ThinLayer(LinearElastic(20.0, 30.0), 0.03, at=1.0)


def joined(tractions=PULL, **data) -> Structure:
    return Structure(JOINT, body=STEEL, tractions=tractions, **{"supports": SUPPORTS} | data)


def apart(one, other) -> float:
    return float(np.abs(one.u.x.array - other.u.x.array).max() / np.abs(other.u.x.array).max())


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of free ends of an incompressible layer
@pytest.mark.parametrize(
    "layer",
    [
        SOFT,
        ThinLayer(LinearElastic(60.0, 40.0), 0.01, order=1, at=1.0),
        ThinLayer(Incompressible(mu=40.0), 0.01, at=1.0),
        ThinLayer(MohrCoulomb(60.0, 40.0, cohesion=0.2, friction_angle=30.0), 0.01, at=1.0),
        {"S": SOFT},
    ],
)
def test_another_layer_is_as_in_a_model_of_its_own(layer):
    first = joined().interface(GLUE)
    solve(first)
    own = joined().interface(layer)
    for _ in range(2):  # the second time with what the family keeps
        derived = first.with_layer(layer)
        assert derived.made_from == own.made_from
        assert derived.V is first.V
        assert apart(solve(derived), solve(own)) < 1e-10
    assert apart(solve(first), solve(joined().interface(GLUE))) < 1e-12  # the first one is what it was


def test_contact_after_glue_and_glue_after_contact():
    law = HolonomicCoulomb(60.0, 40.0, friction=0.3)
    pressed = joined(element="P1" if JOINT.cell_type == "triangle" else "Q1")
    model = pressed.interface(GLUE)
    assert apart(solve(model.with_layer(law)), solve(pressed.interface(law))) < 1e-10
    assert apart(solve(model.with_layer(law).with_layer(SOFT)), solve(pressed.interface(SOFT))) < 1e-10


@pytest.mark.parametrize("kind", ["interface", "full", "bonded"])
def test_other_loads_are_as_in_a_model_of_its_own(kind):
    layer = () if kind == "bonded" else (GLUE,)
    supports = {"BOTTOM": 0, "TOP": {"x": lambda x, t: -0.001 * x[0]}}
    springs = (Springs("RIGHT", normal=3.0, tangential=1.0),)
    first = getattr(joined(parts=springs), kind)(*layer)
    own = getattr(joined(OTHER, supports=supports, body_force=(0.1, -0.2), parts=springs), kind)(*layer)
    for _ in range(2):
        derived = first.with_loads(tractions=OTHER, supports=supports).with_loads(body_force=(0.1, -0.2))
        assert derived.made_from == own.made_from
        assert apart(solve(derived), solve(own)) < 1e-11
    other = first.with_loads(tractions=PULL)
    assert apart(solve(other), solve(first)) < 1e-12


def test_the_factor_stays_under_other_loads_and_goes_with_the_layer():
    first = joined().interface(GLUE)
    derived = first.with_loads(tractions=OTHER)
    found = []
    for model in (derived, first, derived.with_layer(SOFT), first):
        with Solver(model) as solver:
            before = solver.equations.factor.of
            solver.step(solver.rest(0.0), 0.0)
            found.append(before is not None)
    assert found == [False, True, False, False]


def test_two_solvers_of_a_family_at_once():
    first = joined().interface(GLUE)
    second = first.with_loads(tractions=OTHER)
    alone = [solve(model) for model in (first, second)]
    with Solver(first) as a, Solver(second) as b:
        states = [one.step(one.rest(0.0), 0.0) for one in (a, b, a)]
    assert max(apart(state, alone[k]) for state, k in zip(states, (0, 1, 0), strict=True)) < 1e-12


@pytest.mark.parametrize(
    "law", [KelvinVoigt(60.0, 40.0, theta_lmbda=0.3, theta_mu=0.5), Norton(60.0, 40.0, eta=300.0, p=2.0)]
)
def test_marches_of_a_family(law):
    first = joined().interface(GLUE)
    layer, times = ThinLayer(law, 0.02, at=1.0), [0.1, 0.3]
    for _ in range(2):
        own = march(joined(OTHER).interface(layer), times).last
        assert apart(march(first.with_layer(layer).with_loads(tractions=OTHER), times).last, own) < 1e-10


def test_a_meshed_layer_keeps_its_shape():
    first = joined().full(GLUE)
    same = ThinLayer(LinearElastic(20.0, 30.0), 0.01, at=1.0)
    assert apart(solve(first.with_layer(same)), solve(joined().full(same))) < 1e-11
    with pytest.raises(
        InputError, match=r"made room for a layer 'S' of .* \(0\.01, None, \(\)\), not \(0\.03, None, \(\)\)"
    ):
        first.with_layer(SOFT)
    with pytest.raises(InputError, match="is a law on S, without a thickness"):
        first.with_layer(HolonomicCoulomb(60.0, 40.0, friction=0.3))


def test_supports_keep_their_places():
    first = joined().interface(GLUE)
    with pytest.raises(InputError, match=r"supports hold .*those of the model .*build another structure"):
        first.with_loads(supports={"BOTTOM": 0, "TOP": {"y": 0.003}})
    refused(InputError, "traction on 'TOP' is", lambda: first.with_loads(tractions={"TOP": (1.0,)}))


def test_break_times_are_those_of_ones_own_loads():
    first = joined().interface(ThinLayer(KelvinVoigt(60.0, 40.0, theta_lmbda=0.3, theta_mu=0.5), 0.01, at=1.0))
    broken = first.with_loads(tractions={"TOP": piecewise({0: (0.0, 0.1), 0.35: (0.0, -0.6), 1: (0.0, 0.0)})})
    assert broken.break_times == {0.0, 0.35, 1.0}
    assert broken.with_loads(tractions=OTHER).break_times == first.break_times == set()
    assert [len(march(model, [0.5, 1.0])) for model in (first, broken)] == [3, 4]


def test_supports_of_a_derived_model_that_contradict_a_plate():
    cap = RigidPlate("TOP", motion={"x": 0, "y": -0.001, "rotation": 0})
    data = {"parts": (cap,), "tractions": {}}
    supports = [{"BOTTOM": 0, "LEFT/UPPER": {"x": value}} for value in (0.0, 0.002)]
    first = joined(supports=supports[0], **data).interface(GLUE)
    solve(first.with_loads(body_force=(0.0, -0.1)))
    for model in (first.with_loads(supports=supports[1]), joined(supports=supports[1], **data).interface(GLUE)):
        refused(InputError, r"'LEFT/UPPER' prescribes x = 0\.002 and the plate TOP", solve, model)


def test_other_motions_of_supports_beside_a_plate():
    cap, moved = RigidPlate("TOP", force=(0.2, -0.8)), {"BOTTOM": {"x": 0.0, "y": 0.002}}
    data = {"parts": (cap,), "tractions": {}}
    first = joined(supports={"BOTTOM": 0}, **data).interface(GLUE)
    solve(first)
    assert apart(solve(first.with_loads(supports=moved)), solve(joined(supports=moved, **data).interface(GLUE))) < 1e-11
