"""Errors of dropping a layer: sums of densities, effectivity, sentences, what is refused, units."""

from __future__ import annotations

import math
import re
import warnings
from functools import cache

import pytest
import ufl

from forms import Incompressible, LinearElastic, Maxwell, Norton, NortonCreep, VonMises
from forms.base import InputError
from geometry import block, faults, sandwich
from tests.own_laws import Skew
from tests.pictures import assert_drawn
from tests.refused import refused
from thinlayer import (
    Bond,
    RangeWarning,
    RigidPlate,
    Structure,
    Surface,
    ThinLayer,
    compare,
    estimate,
    goals,
    march,
    plotting,
    solve,
    thin_enough,
)
from thinlayer.estimating import thickness
from thinlayer.estimating.result import GoalError, _goal_text
from thinlayer.estimating.thickness import _search_thickness

pytestmark = [pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning"), pytest.mark.few(5)]

LOWER, UPPER = LinearElastic.young(E=70.0, nu=0.2), LinearElastic.young(E=110.0, nu=0.31)
GLUE, EPS, LOAD = LinearElastic.shear(3.0, 0.35), 0.05, (0.3, -1.0)
LAYER = ThinLayer(GLUE, EPS, at=1.0)
JOINT, GRADED = (sandwich(1.3, 0.3, 0.4, h, h_ends=end) for h, end in ((0.3, 0.15), (0.15, EPS / 10)))  # cells at ends
TWO = {"A": [(0.0, 0.3), (1.0, 0.4)], "B": [(0.0, 0.7), (1.0, 0.65)]}
MOVED = {"supports": {"BOTTOM": 0, "TOP": {"y": -0.013, "x": lambda x, t: 0.004 * x[0]}}}
ROLLERS = {"BOTTOM": 0, "LEFT": {"x": 0}, "RIGHT": {"x": 0}}


def structure(joint=JOINT, **data):
    return Structure(joint, **{"body": LOWER, "supports": {"BOTTOM": 0}, "tractions": {"TOP": LOAD}} | data)


def dropped(made, layer=LAYER, **options):
    return estimate(solve(made.interface(layer)), **options)


@cache
def estimated(kind):
    """The estimate of a structure with goals of all kinds."""
    solid = {"solid base": (0.2,)}.get(kind, ())
    goal_list = [goals.Compliance(), goals.MeanTraction((*LOAD, *solid))]
    goal_list += [goals.Functional("mean of u_y", lambda u, model: u[1] * model.dx)]
    goal_list += [goals.Displacement(((0.35, 0.25) if kind == "inclined" else (0.41, 0.17)) + solid, (*LOAD, *solid))]
    if "base" not in kind:
        goal_list += [goals.Reaction({"moved": "TOP", "bonded": "LEFT"}.get(kind, "BOTTOM"), LOAD)]
    bodies = {"body": {"LOWER": LOWER, "UPPER": UPPER}}
    made = {
        "between": lambda: structure(**bodies),
        "skew": lambda: structure(body={"LOWER": Skew(60.0, 40.0), "UPPER": UPPER}),
        "bonded": lambda: structure(supports={"BOTTOM": 0, "LEFT": {"x": 0}}, **bodies),
        "moved": lambda: structure(tractions={"LEFT/UPPER": LOAD}, **bodies, **MOVED),
        "heated": lambda: structure(eigenstrain={"UPPER": 0.002}, **bodies),
        "inclined": lambda: structure(JOINT.rotated(0.3), supports={"BOTTOM": {"n": 0.01}, "LEFT/LOWER": {"x": 0}}),
        "base": lambda: structure(block(1.3, 0.4, 0.3, h_ends=0.15), supports={}),
        "solid base": lambda: structure(
            block(1.3, 0.4, 0.3, h_ends=0.15, depth=0.4, cell="hexahedron"),
            supports={},
            tractions={"TOP": (*LOAD, 0.2)},
        ),
    }[kind]()
    return estimate(solve(made.bonded()), LAYER, goal_list) if kind == "bonded" else dropped(made, goals=goal_list)


def total(result, goal="compliance"):
    """The integral of the density of a goal."""
    return float(Surface(result.better.model).integral(result.density(goal)))


# ---------------------------------------------------------------- goals
@pytest.mark.parametrize("kind", ["inclined", "heated", "base", "solid base", "bonded", "moved", "skew"])
def test_the_densities_of_goals_add_up_to_their_changes(kind):
    """Whatever the goal."""
    result = estimated(kind)
    for name, goal in result.goals.items():
        least = 1e-11 * max(abs(goal.value), abs(goal.better))
        assert total(result, name) == pytest.approx(goal.change, rel=1e-8, abs=least), name


@pytest.mark.parametrize("kind", ["between", "base", "solid base", "skew"])
def test_the_mean_traction_is_that_of_the_load(kind):
    """What is pulled along (0.3, -1) bears it, between bodies and on a rigid base."""
    goal_error = next(goal for name, goal in estimated(kind).goals.items() if name.startswith("mean traction"))
    load = math.hypot(*LOAD, 0.2 * (kind == "solid base"))
    assert [goal_error.value, goal_error.better] == pytest.approx([load] * 2, rel=1e-9)
    surface, better = Surface(estimated(kind).better.model), estimated(kind).better
    forces = [surface.integral(component) for component in surface.traction(better)]
    assert math.hypot(*forces) == pytest.approx(load * surface.integral(1.0), rel=1e-9)


def test_the_better_state_has_no_reactions_of_the_state_before():
    """A goal has them."""
    result = estimated("moved")
    (goal,) = (goal for name, goal in result.goals.items() if name.startswith("reaction"))
    assert abs(goal.change) > 1e-3 * abs(goal.value)
    refused(InputError, r"ask estimate for goals\.Reaction", lambda: result.better.reaction("TOP"))
    assert math.isnan(result.better.prescribed_work)


def test_the_mean_traction_has_nothing_of_supports_at_ends_of_s():
    """Over nodes that nothing holds: within a cell's share of the mean of the law's tractions."""
    state = solve(structure(supports={"LEFT": 0}).interface(LAYER))
    surface = Surface(state.model)
    for k, stiffness in enumerate((GLUE.mu, GLUE.lmbda + 2 * GLUE.mu)):
        mean = surface.integral(surface.jump(state)[k]) * stiffness / surface.integral(1.0)
        value = goals.MeanTraction((1 - k, k)).value(state, state.model)
        assert value == pytest.approx(mean, rel=0.04), k


def test_a_goal_that_is_not_linear_has_a_density_to_first_order():
    square = goals.Functional("square", lambda u, model: ufl.inner(u, u) * model.dx)
    result = dropped(structure(), goals=[square])
    change, relative = result.goals["square"].change, result.goals["square"].relative
    assert total(result, "square") == pytest.approx(change, rel=relative)
    assert total(result, "square") != pytest.approx(change, rel=0.01 * relative)


# ---------------------------------------------------------------- histories
def test_histories_that_are_not_marched_again():
    """From rest, with backward Euler: others are refused."""
    model = structure().interface(ThinLayer(Norton(lmbda=1.2, mu=2.0, eta=0.7, p=1.5), EPS / 2, at=1.0))
    refused(InputError, "marched with theta", lambda: estimate(march(model, [0.5], theta=0.5)))
    refused(InputError, "goes on from a state", lambda: estimate(march(march(model, [0.3]), [0.9])))


def test_a_density_beside_a_support_of_one_side_is_told():
    """Equilibrium gives the reaction, and bonds hold the other side at the end of S, where the density lacks it."""
    bonded = solve(structure(supports={"BOTTOM": {"y": 0}, "LEFT/LOWER": {"x": 0}}).bonded())
    result = estimate(bonded, LAYER, goals.Reaction("LEFT", LOAD))
    with pytest.warns(RangeWarning, match="not to .*, as a support holds one side of a bond's end"):
        result.density(next(iter(result.goals)))


@pytest.mark.parametrize("law", [GLUE, NortonCreep(3.0, 2.0, 0.05, 3.0)])
def test_a_history_may_begin_where_supports_have_moved_what_bears_nothing(law):
    """Its first state is rounding; the last one errs as where nothing has moved."""
    load = {"tractions": {"TOP": lambda x, t: (0.3 * t, -t)}}
    made = [structure(supports={"BOTTOM": shift}, **load) for shift in (0, {"x": 0.004, "y": -0.003})]
    still, moved = (estimate(march(specimen.interface(ThinLayer(law, EPS)), [0.5, 1.0])) for specimen in made)
    assert (moved.traction, moved.jump) == pytest.approx((still.traction, still.jump), rel=1e-6)


def test_a_pressure_beside_a_layer_that_yields_is_no_softening():
    made = structure(faults(1.0, 1.0, TWO, 0.2), supports=ROLLERS, tractions={"TOP": lambda x, t: (0.3, x[0] - 1)})
    yielding, jump_errors = ThinLayer(VonMises(3.0, 2.0, strength=0.3, hardening=0.5), EPS), []
    for law in (Incompressible(2.0), LinearElastic(2e4, 2.0)):
        jump_errors.append(estimate(march(made.interface({"A": ThinLayer(law, EPS), "B": yielding}), [1.0])).jump)
    assert jump_errors[0] == pytest.approx(jump_errors[1], rel=1e-2)


# ---------------------------------------------------------------- words
def test_sentences():
    said = estimated("between").sentences
    assert said[0].startswith("order 0: ")
    assert "% in traction" in said[0]
    assert "no change in reaction BOTTOM" in said[0]  # equilibrium gives it
    assert said[1].startswith("for these cells of the bodies, and 4 cells through the layer")
    assert estimated("bonded").sentences[0].startswith("perfect bond: ")
    shown = estimated("bonded")._repr_html_()  # by notebooks
    assert re.match("perfect bond: .*<br>.*<table>.*<th>better</th>.*<td>traction</td><td></td>", shown)
    assert math.isnan(estimated("bonded").jump)


ASIDE = {"tractions": {"LEFT/UPPER": (0.3, 0.1), "RIGHT/UPPER": (-0.3, -0.1)}}


DOWN, EVEN = {"tractions": {"TOP": (0, -1)}}, sandwich(1.2, 0.3, 0.4, 0.2, cell="quadrilateral", structured=True)
ZERO = [
    (DOWN, goals.Reaction("BOTTOM", (1, 0)), GRADED),
    (ASIDE, goals.Reaction("BOTTOM", (0, 1)), GRADED),  # no resultant
    (DOWN, goals.Functional("lean", lambda u, model: u[0] * model.dx), EVEN),  # parts that cancel
]


@pytest.mark.parametrize(("data", "goal", "joint"), ZERO)
def test_goals_that_are_zero(data, goal, joint):
    """Rounding, and so is their relative change."""
    result = dropped(structure(joint, **data), goals=[goal])
    (goal_error,) = result.goals.values()
    assert goal_error.zero
    assert math.isnan(goal_error.relative)
    assert f"{goal.name} is zero" in str(result)
    assert goal_error.scale > 5e-4  # of displacements of 0.001 along x on each half


def test_a_goal_that_equilibrium_gives_does_not_change():
    fixed, clear = GoalError(1.0, 1.0 + 1e-13, 2.0), GoalError(1.0, 1.02, 2.0)
    assert (fixed.relative, _goal_text("it", fixed)) == (0.0, "no change in it")
    assert (clear.at_most, _goal_text("it", clear)) == (pytest.approx(0.02 / 1.02), "2 % in it")
    wide = GoalError(1.0, 1.02, 2.0, lower=0.98, upper=1.05)
    assert (wide.between, _goal_text("it", wide)) == ((0.0, pytest.approx(1 / 21)), "between 0 % and 4.8 % in it")


def test_flow_of_a_uniform_layer_does_not_change():
    """Its law is exact there, and all that steps towards the mesh could gain is rounding."""
    pressed = structure(sandwich(1.0, 0.5, 0.4, 0.25), supports=ROLLERS, tractions={"TOP": (0, -0.3)})
    result = estimate(march(pressed.interface(ThinLayer(Maxwell(1.2, 2.0, 1.0), EPS)), [0.1, 0.2]))
    assert result.traction == result.jump == 0


def test_a_plate_on_an_incompressible_layer_leaves_no_resultant():
    """Couples leave a little of it in each step, and steps add these up."""
    plate = RigidPlate("TOP", motion={"rotation": 0.01}, force=(0.5, -0.7))
    data = {"body": LinearElastic.young(100.0, 0.3), "tractions": {}, "parts": [plate], "element": "P2"}
    specimen = structure(sandwich(20.0, 0.6, 0.6, 2.5), **data)
    layer = ThinLayer(Incompressible(2.0), 0.015)
    true = compare(solve(specimen.full(layer)), solve(specimen.interface(layer)))["error_traction"]
    assert dropped(specimen, layer).traction == pytest.approx(true, rel=0.1)  # an energy may hide forces


def test_rigid_motions_do_not_matter():
    """Displacements a million times the jump, and a traction a million times less than the layer's stiffness times them."""
    errors = [dropped(structure(GRADED, supports={"BOTTOM": {"x": x, "y": 0}})).traction for x in (0.0, 1e5)]
    assert errors[1] == pytest.approx(errors[0], rel=1e-5)


def test_the_compliance_of_supports_that_move_knows_no_path():
    supports = {"BOTTOM": 0, "TOP": {"x": lambda x, t: 0.01 * t, "y": -0.02}}
    model = structure(supports=supports, tractions={}, body_force=(0, -1)).interface(LAYER)
    results = [estimate(solution) for solution in (solve(model, 2.0), march(model, [1.0, 2.0]))]
    changes = [change for result in results for change in (result.goals["compliance"].change, total(result))]
    assert changes == pytest.approx(changes[:1] * 4, rel=1e-8)


# ---------------------------------------------------------------- thin enough
def test_the_search_goes_on_where_an_error_stays():
    """As that of a nearly incompressible layer does, over a hundredth of the first thickness: 14 %, then in proportion."""
    eps, at_tolerance, _ = _search_thickness(lambda eps: 0.14 * min(eps / 0.05, 1), 5.0, 0.05)
    assert at_tolerance
    assert eps == pytest.approx(0.05 * 0.05 / 0.14, rel=thickness.THICKNESS_TOLERANCE)


def test_thin_enough_is_where_the_estimate_is_the_tolerance():
    result = thin_enough(structure(), LAYER, 0.01, goals.Compliance())
    layer = ThinLayer(GLUE, result.eps, at=result.eps / EPS)
    assert layer.material.mu == pytest.approx(GLUE.scaled(EPS).mu)
    goal = dropped(structure(), layer).goals["compliance"]
    assert 0.98 * 0.01 < goal.relative <= goal.at_most <= 0.01
    assert dict(zip(result.table["eps"], result.table["error"], strict=True))[result.eps] == pytest.approx(goal.at_most)
    assert goal.at_most > goal.relative * (1 + 1e-5)  # so that it is the bound, not the estimate
    assert f"thinner than {result.eps:.3g}" in str(result)
    assert len(result.table) <= 15


def test_thin_enough_goes_on_below_a_change_of_sign():
    """The error x - 12 x^2 is 0.011 at 0.071, but larger than 0.015 from 0.0196 to 0.064."""
    eps, at_tolerance, rows = _search_thickness(lambda x: abs(x - 12 * x * x), 0.1, 0.015)
    assert at_tolerance
    first, second, third = sorted(rows, reverse=True)[:3]
    assert rows[second] < 0.015 < min(rows[first], rows[third])
    assert eps == pytest.approx((1 - math.sqrt(1 - 48 * 0.015)) / 24, rel=0.01)


def test_thin_enough_does_not_depend_on_where_it_begins():
    made, glue = structure(sandwich(1.0, 0.4, 0.5, 0.4, h_S=0.2)), LinearElastic.young(3.0, 0.3)
    thicknesses = [thin_enough(made, ThinLayer(glue, eps), 0.04).eps for eps in (0.05, 0.003)]
    assert thicknesses[0] == pytest.approx(thicknesses[1], rel=1e-9)
    widest = thin_enough(made, ThinLayer(glue, 0.05), 0.9)
    assert not widest.at_tolerance
    assert widest.eps == pytest.approx(0.4)  # as high as the thinner body


def test_thin_enough_passes_on_what_its_estimate_says(monkeypatch):
    """The caveats and the warnings of the thickness that it answers; not those of others that it tried."""

    def warned(state, *args, **options):
        warnings.warn(f"tried {state.model.layers['S'].thin_layer.eps:.6g}", RangeWarning, stacklevel=1)
        return estimate(state, *args, **options)

    monkeypatch.setattr(thickness, "estimate", warned)
    made = structure(supports=ROLLERS, tractions={"TOP": (0, -1.0)})
    with pytest.warns(RangeWarning) as heard:
        result = thin_enough(made, ThinLayer(Maxwell(3.0, 2.0, 0.5), EPS, at=1.0), 0.9, goals.Compliance())
    assert [str(warning.message) for warning in heard if "tried" in str(warning.message)] == [f"tried {result.eps:.6g}"]
    assert "t = 0+" in str(result)


# ---------------------------------------------------------------- refused
def test_what_has_no_estimate():
    limit = solve(structure().interface(LAYER))
    two = structure(faults(1.0, 1.0, TWO, 0.3)).interface({"A": LAYER, "B": Bond()})
    soft = ThinLayer(LinearElastic.young(30.0, 0.3), EPS)
    tied = structure(JOINT.rotated(0.3), supports={"BOTTOM": 0, "LEFT": {"n": 0}})
    asked = lambda *goal_list: estimate(limit, goals=goal_list)
    for call, message in [
        (lambda: estimate(3), "the state is 3"),
        (lambda: estimate(limit, LAYER), "no others: no seam"),
        (lambda: estimate(solve(structure().full(LAYER))), "drops no mesh"),
        (lambda: estimate(solve(two), LAYER, seam="A"), "'A' has a layer, and bonds are at B"),
        (lambda: dropped(tied), "tie nodes on S"),
        (lambda: asked("traction"), "a goal is 'traction'"),
        (lambda: asked(goals.Compliance(), goals.Compliance()), "two goals"),
        (lambda: asked(goals.Reaction("BOTTOM", (0, 0))), "direction"),
        (lambda: asked(goals.Displacement((9.0, 0.0), (0, 1))), "in no cell"),
        (lambda: asked(goals.MeanTraction((0, 1), seam="GLUE")), "GLUE"),
        (lambda: estimate(limit).density("traction"), "unknown goal"),
        (lambda: asked(goals.Functional("mean", 3)), "must be a function"),
        (lambda: asked(goals.Functional("mean", lambda u, model: u[5] * model.dx)), "fails"),
        (lambda: asked(goals.Functional("m", lambda u, model: 1j * u[0] * model.dx)), "not real"),
        (lambda: thin_enough(limit.model, LAYER, 0.1), "takes a Structure"),
        (lambda: thin_enough(structure(), LAYER, 0.1, bonded=True, bodies="extended"), "use bodies='kept'"),
        (lambda: thin_enough(structure(), soft, 1.5), "tolerance is 1.5"),
        (lambda: thin_enough(structure(), soft, 0.1, "stress"), "goal is 'stress'"),
        (lambda: thin_enough(structure(), soft, 0.001, "jump"), "hardly falls"),
    ]:
        refused(InputError, message, call)


def test_sides_that_are_held_and_layers_that_bear_nothing():
    both = structure(supports={"BOTTOM": 0, "LEFT": 0, "LEFT/LAYER": 0})
    assert dropped(both).traction > 0  # the bodies are held there, too
    alike = structure(supports={"BOTTOM": {"y": 0}, (0.0, -0.3): {"x": 0}}, tractions={}, eigenstrain=0.01)
    assert math.isnan(dropped(alike, goals=[]).traction)  # both bodies expand, and the layer bears nothing


# ---------------------------------------------------------------- pictures, units
def test_the_picture_of_a_density(tmp_path):
    flat = estimated("between")
    surface, values = Surface(flat.better.model), flat.density()
    plotting.along(surface, {"compliance": values}, save=tmp_path / "a.png", length="mm", log=True)
    assert_drawn(tmp_path / "a.png")
