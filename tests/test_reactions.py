"""Reactions: sums with the loads in every kind of model, closed forms, what belongs to whom, files, ranks, errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forms import Incompressible, VonMises
from forms.base import InputError
from geometry import block, sandwich
from tests.refused import refused
from tests.supports_run import BODY, CONTACT, CREEP, EPS, GLUE, KINDS, MORTAR, loaded, on_base, out_of_balance
from thinlayer import RangeWarning, RigidPlate, Springs, Structure, ThinLayer, march, solve
from thinlayer.discretisation import rigid_motions

BALANCED = 1e-10  # residual at which solvers stop


# ---------------------------------------------------------------- sums
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dim", [2, 3])
def test_reactions_and_loads_add_up_to_zero(dim, kind):
    state = solve(loaded(dim, kind), t=1.5)
    assert out_of_balance(state) < BALANCED
    assert set(state.reactions_by_place()) == {"LEFT", "RIGHT/LOWER", "BOTTOM"}


@pytest.mark.parametrize(("law", "theta"), [(CREEP, 1.0), (CREEP, 0.5), (MORTAR, 1.0), (Incompressible(40.0), 0.5)])
def test_layers_on_a_rigid_base(law, theta):
    """The base is one of what holds the structure; it carries the pressure, whatever the law and the time scheme."""
    state = march(on_base(law), [0.1, 0.2, 0.4], theta=theta).last
    assert out_of_balance(state) < BALANCED
    base = state.reaction("S")
    assert base.force[1] == pytest.approx(4 * 0.2 + 0.05 * 8, rel=1e-9)
    assert base.at((0.0, 0.0)).moment == pytest.approx(state.reaction("S", about=(0.0, 0.0)).moment, rel=1e-12)
    assert base.force[0] + state.reaction("RIGHT").force[0] == pytest.approx(-0.4 * 0.02 * 4, rel=1e-8)


@pytest.mark.parametrize("method", ["condensed", "multigrid", "newton"])
def test_contact(method):
    state = solve(on_base(CONTACT, contact=True), method=method)
    assert out_of_balance(state) < BALANCED
    assert state.reaction("S").force[1] == pytest.approx(4.0, rel=1e-9)


def test_a_centroid_is_computed_once_for_all_states(monkeypatch):
    """Reactions are observed at each step of a march, about the same point."""
    calls, unit_values = [], rigid_motions.unit_values
    monkeypatch.setattr(rigid_motions, "unit_values", lambda *args: calls.append(args) or unit_values(*args))
    model = loaded(2, "interface")
    observe = {
        "left": lambda state: state.reaction("LEFT").moment,
        "bottom": lambda state: state.reaction("BOTTOM").moment,
    }
    history = march(model, [0.5, 1.0, 1.5], observe=observe)
    assert len(calls) == 2
    centre = rigid_motions.centroid(model.domain, "LEFT")
    assert history.last.reaction("LEFT", about=centre).moment == history.table["left"][-1]


# ---------------------------------------------------------------- what belongs to whom
@pytest.mark.parametrize("kind", KINDS)
def test_a_column_between_rollers(kind):
    """Uniaxial strain: closed forms of all reactions, and of the moment of a linear pressure about its middle."""
    sides = {"LEFT": {"x": 0}, "RIGHT": {"x": 0.0}, "BOTTOM": {"y": 0.0}}
    joint = sandwich(2.0, 0.5, 0.6, 0.5)
    structure = Structure(joint, body=GLUE.scaled(EPS), supports=sides, tractions={"TOP": (0.0, -0.7)})
    state = solve(getattr(structure, kind)(*[ThinLayer(GLUE, EPS, at=1.0)] * (kind != "bonded")))
    lmbda, mu = GLUE.scaled(EPS).lmbda, GLUE.scaled(EPS).mu
    side = 0.7 * lmbda / (lmbda + 2 * mu) * {"full": 1.2, "interface": 1.1, "bonded": 1.1}[kind]
    assert state.reaction("BOTTOM").force == pytest.approx([0.0, 1.4], abs=1e-9)
    assert state.reaction("BOTTOM").moment == pytest.approx(0.0, abs=1e-9)
    assert state.reaction("LEFT").force == pytest.approx([side, 0.0], abs=1e-9)
    assert state.reaction("RIGHT").force == pytest.approx([-side, 0.0], abs=1e-9)
    assert state.reaction("BOTTOM", about=(0.0, 0.0)).moment == pytest.approx(1.4, rel=1e-9)
    assert state.applied(about=(0.0, 0.0)).moment == pytest.approx(-1.4, rel=1e-9)


def test_a_corner_of_two_supports():
    """Each component's force belongs to the support that prescribes it; if both do, they share it."""
    joint, pull = sandwich(1.0, 0.5, 0.5, 0.5), {"TOP": (0.4, -0.3)}
    state = solve(Structure(joint, body=BODY, supports={"BOTTOM": {"y": 0}, "LEFT": {"x": 0}}, tractions=pull).bonded())
    assert state.reaction("BOTTOM").force == pytest.approx([0.0, 0.3], abs=1e-10)
    assert state.reaction("LEFT").force == pytest.approx([-0.4, 0.0], abs=1e-10)
    twice = Structure(joint, body=BODY, supports={"BOTTOM": 0.0, "LEFT/LOWER": 0.0}, tractions=pull)
    assert out_of_balance(solve(twice.bonded())) < BALANCED


def test_parts_of_a_side_and_springs():
    joint = sandwich(1.0, 0.5, 0.5, 0.5)
    beds = [Springs("TOP", normal=2.0), Springs("LEFT", normal=3.0)]
    supports = {"RIGHT/LOWER": 0.0, "RIGHT/UPPER": {"y": 0.0}, (0.0, 0.5): {"y": -0.01}}
    structure = Structure(joint, body=BODY, supports=supports, tractions={"TOP": (0.4, -0.3)}, parts=beds)
    state = solve(structure.interface(ThinLayer(GLUE, EPS, at=1.0)))
    parts = [state.reaction(f"RIGHT/{name}", about=(1, 0)) for name in ("LOWER", "UPPER")]
    whole = state.reaction("RIGHT")
    assert whole.about == pytest.approx([1.0, 0.0])
    assert whole.force == pytest.approx(parts[0].force + parts[1].force, rel=1e-12)
    assert whole.moment == pytest.approx(parts[0].moment + parts[1].moment, rel=1e-12)
    pressed = state.integral(-2.0 * state.u[1] * state.model.ds(state.model.domain.values("TOP")))
    assert state.reaction("TOP").force == pytest.approx([0.0, pressed], rel=1e-12)
    corner = state.reaction((0.0, 0.5))
    assert corner.about == pytest.approx([0.0, 0.5])
    assert corner.moment == pytest.approx(0.0, abs=1e-12)
    assert out_of_balance(state) < BALANCED


def test_a_resumed_march_has_what_all_its_parts_remember(tmp_path):
    """Bodies that yield and are heated, a layer that creeps and shrinks, springs and a plate: as if it was never cut."""
    metal = VonMises(60.0, 40.0, strength=0.02, hardening=5.0)
    parts = [RigidPlate("TOP", force=lambda x, t: (0.02 * t, -0.1)), Springs("BOTTOM", normal=20.0, tangential=7.0)]

    def made(law=metal, heat=1e-3):
        hot = {"LOWER": lambda x, t: heat * t, "UPPER": 0.0}
        blocks = Structure(sandwich(2.0, 0.5, 0.6, 0.5), body=law, supports={}, parts=parts, eigenstrain=hot)
        return blocks.interface(ThinLayer(CREEP, EPS, eigenstrain=lambda x, t: -heat * t, at=1.0))

    times = [0.2, 0.6, 1.0]
    whole = march(made(), times)
    march(made(), times[:2], out=tmp_path)
    again = march(made(), times, out=tmp_path, resume=True)
    assert again.at(0.6).report.method == "resumed"
    for state, other in ((again.at(t), whole.at(t)) for t in times[1:]):
        assert out_of_balance(state) < 1e-8
        assert state.energies() == pytest.approx(other.energies(), rel=1e-8)
        assert dict(state.stored) == pytest.approx(dict(other.stored), rel=1e-8)
        assert state.dissipated == pytest.approx(other.dissipated, rel=1e-8)
        assert parts[0].motion_in(state).rotation == pytest.approx(parts[0].motion_in(other).rotation, rel=1e-8)
        assert state.memory.keys() == other.memory.keys() >= {"layer", "body LOWER", "body UPPER"}
        for kept, expected in ((state.memory, other.memory), (state.stresses, other.stresses)):
            for key, value in expected.items():
                assert np.abs(value).max() > 0
                assert kept[key] == pytest.approx(value, abs=1e-9 * np.abs(value).max())
        assert state.reactions == pytest.approx(other.reactions, abs=1e-9 * np.abs(other.reactions).max())
    for changed in (made(replace(metal, hardening=4.0)), made(heat=2e-3)):
        refused(InputError, "another march", march, changed, times, out=tmp_path, resume=True)


# ---------------------------------------------------------------- ranks
def numbers() -> dict[str, list[float]]:
    """Reactions in space, to lines, points, springs, pressures and a layer's weight."""
    state = solve(loaded(3, "interface"), t=1.5)
    return {str(place): [*reaction.force, *reaction.moment] for place, reaction in state.reactions_by_place().items()}


# ---------------------------------------------------------------- refused
def test_a_support_of_the_side_of_a_layer_that_is_not_meshed_holds_nothing():
    """Meshed it holds what bodies move there, and laws leave this out, which is told."""
    joint, supports = block(1.0, 1.0, 0.5), {"TOP": 0.0, "LEFT": {"y": 0.0}, "LEFT/LAYER": {"x": 0.0}}
    setup, layer = Structure(joint, body=BODY, supports=supports), ThinLayer(GLUE, EPS, at=1.0)
    with pytest.warns(RangeWarning, match=r"holds the side of the layer alone, at \(0, 0\)"):
        state = solve(setup.interface(layer))
    assert state.reaction("LEFT/LAYER").force == pytest.approx([0.0, 0.0])


def test_a_free_side_has_no_reaction():
    structure = Structure(block(1.0, 1.0, 0.5), body=BODY, supports={"TOP": 0.0})
    state = solve(structure.interface(ThinLayer(GLUE, EPS, at=1.0)))
    refused(InputError, r"nothing holds 'LEFT': it is free .* held are: 'TOP', 'S'", lambda: state.reaction("LEFT"))
    refused(InputError, r"about is .* a point of 2 finite coordinates", lambda: state.reaction("TOP", about=(0.0,)))


def test_contradictory_supports():
    """Numbers when the model is made, functions when their values are known; both values and the place are told."""
    for supports, message in [
        ({"BOTTOM": {"y": lambda x, t: t * x[0], "x": 0.0}, "RIGHT": {"y": 0.0}}, "y = 2 .*y = 0 .*at t = 2"),
        ({"TOP": 0.0, (1.0, 0.5): {"x": 0.1}}, r"\(1, 0.5\): 'TOP' prescribes x = 0 and \(1.0, 0.5\) prescribes x"),
    ]:
        joint = sandwich(1.0, 0.5, 0.5, 0.5)
        with pytest.raises(InputError, match=message):
            solve(Structure(joint, body=BODY, supports=supports).interface(ThinLayer(GLUE, EPS, at=1.0)), t=2.0)
