"""Goals mean the same in all places: in states, in their weights, in bounds, beside springs, plates and other seams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from forms import LinearElastic
from geometry import block, sandwich, wall
from tests.on_ranks import on_ranks
from tests.own_scripts.inertia import Inertia
from tests.refused import refused
from thinlayer import (
    Bond,
    InputError,
    Probe,
    RigidPlate,
    Springs,
    Structure,
    Surface,
    ThinLayer,
    estimate,
    goals,
    march,
    solve,
)
from thinlayer.estimating.goals import Displacement
from thinlayer.output.probe import cells_at

BODY, LAYER = LinearElastic.young(100.0, 0.3), ThinLayer(LinearElastic.young(1.3, 0.3), 0.1)
RODS, WALL = sandwich(4.0, 1.5, 1.0, 0.5, cell="quadrilateral"), wall(2, 2, brick=(2.0, 1.0), h=0.25)
TALL = sandwich(1.0, 6.0, 0.5, 0.25)  # of two ranks one has no facet of S
BLOCK, LOAD = block(4.0, 1.5, h=0.5, cell="quadrilateral"), (0.3, -0.5)


def structure(joint=RODS, **overrides):
    return Structure(joint, **{"body": BODY, "supports": {"BOTTOM": 0}, "tractions": {"TOP": LOAD}} | overrides)


SHARED = {"supports": {"BOTTOM": 0, "LEFT/LOWER": {"x": 0}}, "parts": [Springs("LEFT/UPPER", normal=5.0)]}
ROLLER = {"supports": {"BOTTOM": 0, "TOP": {"x": 0}}, "tractions": {"RIGHT/UPPER": LOAD}}
BOTH = [RigidPlate("TOP", force=(0, -0.7)), RigidPlate("BOTTOM", motion={"x": 0, "y": 0, "rotation": 0})]
CORNER = (4.0, 1.0)
HOLDERS = {
    "one of two plates": (ROLLER | {"supports": {"TOP": {"x": 0}}, "parts": BOTH}, "BOTTOM", (0, 1)),
    "supports and springs": (SHARED, "LEFT", (1, 0)),
    "a plate that is moved": (ROLLER | {"parts": [RigidPlate("TOP", motion={"y": 0.01})]}, "TOP", (0, 1)),
    "a support that moves": (ROLLER | {"supports": {"BOTTOM": 0, "TOP": {"y": lambda x, t: 0.01 * t}}}, "TOP", (0, 1)),
    "a plate that is pushed": (ROLLER | {"parts": [RigidPlate("TOP", force=(0, -0.7))]}, "TOP", (0, 1)),
    "a vertex of a plate": (ROLLER | {"supports": {"BOTTOM": 0, CORNER: {"x": 0}}, "parts": BOTH[:1]}, CORNER, (1, 0)),
    "revolution": ({"plane": "axisymmetric"}, "BOTTOM", (1, 1)),
    "a vertex of S": ({"supports": {(4.0, 0.0): 0}, "joint": BLOCK}, (4.0, 0.0), (1, 0)),
}


def test_the_cells_at_a_point_are_searched_once_for_all_models_on_a_mesh(monkeypatch):
    calls, soft = [], structure().interface(LAYER)
    monkeypatch.setattr("thinlayer.estimating.goals.cells_at", lambda *place: calls.append(place) or cells_at(*place))
    states = [solve(model) for model in (soft, soft.with_layer(ThinLayer(BODY, 0.1)))]
    for place, side in [(CORNER, None), ([1.3, 0.0], "upper"), (np.array([1.3, 0.0]), "lower")]:
        values = [Displacement(place, (1, 0), side).value_in(state) for state in [*states, states[0]]]
        probed = [Probe(state).displacement(place, side=side)[0] for state in [*states, states[0]]]
        assert values == pytest.approx(probed, rel=1e-12)
        assert values[0] != values[1]
    assert len(calls) == 3


@pytest.mark.parametrize("kind", HOLDERS)
def test_a_reaction_is_of_all_that_holds_a_place(kind):
    """Its better value, and so bounds, are those of the model whose layer is meshed between the same cells."""
    overrides, place, direction = HOLDERS[kind]
    made, goal = structure(**overrides), goals.Reaction(place, direction)
    limit = solve(made.interface(LAYER), 1.0)
    full, errors = solve(made.full(LAYER), 1.0), estimate(limit, goals=[goal, goals.Compliance()]).goals
    error, meshed = errors[goal.name], goal.value(full, limit.model)
    assert goals.Compliance().value(full, full.model) == pytest.approx(errors["compliance"].better, rel=1e-6)
    assert meshed == pytest.approx(error.better, rel=1e-6)
    assert error.lower <= meshed <= error.upper
    if kind == "revolution":
        assert meshed == pytest.approx(np.pi * 16 * 0.5 / np.sqrt(2), rel=1e-9)
        refused(InputError, "radii", lambda: estimate(limit, goals=[goals.Reaction(place, (1, 0))]))


@dataclass(frozen=True)
class Doubled(Displacement):
    """A goal whose value is not the one that it weighs."""

    def value(self, state, model):
        return 2.0 * super().value(state, model)


def test_a_goal_with_two_definitions_is_refused():
    state = solve(structure().interface(LAYER))
    refused(InputError, "`value` and `dual`", lambda: estimate(state, goals=[Doubled((2.0, 1.0), (0, 1))]))


def of_wall() -> list[float]:
    """Mean tractions on the beds and all of S of a wall under a uniform stress, and bounds of the latter."""
    state = solve(structure(WALL).interface({"BED": LAYER, "HEAD": ThinLayer(LinearElastic.young(2.0, 0.3), 0.1)}))
    every = [goals.MeanTraction(d, seam) for d in ((0, 1), (1, 0)) for seam in ("BED", "S")]
    errors = estimate(state, goals=every).goals
    surface = Surface(state.model)
    whole = surface.integral(surface.traction(state)) / surface.integral(1.0)
    last = errors[every[1].name]
    tall = structure(TALL).interface(LAYER)
    alone = goals.MeanTraction((0, 1)).value(solve(tall), tall)
    turned = ROLLER | {"supports": {"RIGHT/LOWER": 0}, "parts": [RigidPlate("LEFT", moment=0.1)]}
    tied = solve(structure(TALL, **turned).interface(ThinLayer(LAYER.law, 0.1, order=1)))
    refused(InputError, "tie nodes on S", estimate, tied)
    return [*(errors[g.name].value for g in every), *whole, last.lower, last.upper, alone, tied.energies()["layer"]]


@on_ranks(of_wall, 2)
def test_a_mean_traction_where_seams_meet(there):
    """On beds equilibrium gives it; on all seams it is that of the law, to its accuracy near junctions."""
    bed_y, all_y, bed_x, all_x, law_x, law_y, lower, upper, alone, _ = here = of_wall()
    assert (bed_x, bed_y) == pytest.approx(LOAD, rel=1e-9)
    assert alone == pytest.approx(LOAD[1], rel=1e-9)
    assert (all_x, all_y) == pytest.approx((law_x, law_y), rel=5e-3)
    assert lower <= upper
    assert there == pytest.approx(here, rel=1e-6)


def test_what_meets_a_layer_by_itself():
    """Bricks beside another seam would share a node of the layer's face."""
    both = solve(structure(WALL).interface({"BED": LAYER, "HEAD": LAYER}))
    refused(InputError, "BED meets HEAD", lambda: estimate(both, seam="BED"))
    bed, ends = Surface(both.model, "BED"), WALL.points[:, 0]
    distances = np.minimum(bed.x[0] - ends.min(), ends.max() - bed.x[0])
    assert bed.distance_to_ends == pytest.approx(distances)  # not from where HEAD ends
    moving = march(structure(parts=[Inertia(1.0)]).interface(LAYER), [0.1, 0.2])
    refused(InputError, "'inertia' remembers steps beside the layers", estimate, moving.last)


def test_tractions_of_a_layer_that_ends_at_bonds():
    """Singular forces of the bonded bricks are not shared out to it; they were three times as large."""
    state = solve(structure(WALL).interface({"BED": Bond(), "HEAD": LAYER}))
    heads = Surface(state.model, "HEAD")
    of_law, reaction = heads.traction(state), heads.reaction(state)
    assert heads.norm(reaction - of_law) < 0.06 * heads.norm(of_law)
