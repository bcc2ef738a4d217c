"""Errors of dropping a layer: exact identity, effectivity, sentences, what is refused, ranks and units."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
import ufl

from forms import LinearElastic, Maxwell, Norton, Rubber, Stack
from forms.base import InputError
from geometry import faults, sandwich
from geometry.sheet import Rim
from tests.estimate_run import EPS, GLUE, KINDS, LOWER, estimated, several, structure, total
from tests.on_ranks import on_ranks
from tests.pictures import assert_drawn
from tests.refused import refused
from thinlayer import (
    Bond,
    RangeWarning,
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
from thinlayer.estimating.result import GoalError, _said
from thinlayer.estimating.thickness import _search

TWO = {"A": [(0.0, 0.3), (1.0, 0.4)], "B": [(0.0, 0.7), (1.0, 0.65)]}

pytestmark = [pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning"), pytest.mark.few(5)]


# ---------------------------------------------------------------- the identity
@pytest.mark.parametrize("kind", KINDS)
def test_the_densities_of_goals_add_up_to_their_changes(kind):
    """Whatever the goal."""
    found = estimated(kind)
    for name, goal in found.goals.items():
        least = 1e-11 * max(abs(goal.value), abs(goal.better))
        assert total(found, name) == pytest.approx(goal.change, rel=1e-8, abs=least), name


@pytest.mark.parametrize("dim", [2, 3], ids=["revolution", "tetrahedra"])
def test_in_three_dimensions_too(dim):
    if dim == 3:
        found = estimated("between", 3)
    else:
        tube = sandwich(1.3, 0.3, 0.4, 0.3, h_ends=0.15).moved((0.8, 0.0))
        made = Structure(tube, body=LOWER, supports={"BOTTOM": 0}, tractions={"TOP": (0.3, -1.0)}, plane="axisymmetric")
        found = estimate(solve(made.interface(ThinLayer(GLUE, EPS, at=1.0))))
    for name, goal in found.goals.items():
        assert total(found, name) == pytest.approx(goal.change, rel=1e-8, abs=1e-11 * abs(goal.value)), name


@pytest.mark.parametrize("kind", ["between", "base"])
def test_the_mean_traction_is_that_of_the_load(kind):
    """What is pulled along (0.3, -1) bears it, between bodies and on a rigid base."""
    found = next(goal for name, goal in estimated(kind).goals.items() if name.startswith("mean traction"))
    assert [found.value, found.better] == pytest.approx([math.hypot(0.3, 1.0)] * 2, rel=1e-9)


def test_the_mean_traction_has_nothing_of_supports_at_ends_of_s():
    """Over nodes that nothing holds: within a cell's share of the mean of the law's tractions."""
    held = Structure(structure("between").joint, body=LOWER, supports={"LEFT": 0}, tractions={"TOP": (0.3, -1.0)})
    state = solve(held.interface(ThinLayer(GLUE, EPS, at=1.0)))
    surface = Surface(state.model)
    for k, stiffness in enumerate((GLUE.mu, GLUE.lmbda + 2 * GLUE.mu)):
        mean = surface.integral(surface.jump(state)[k]) * stiffness / surface.integral(1.0)
        found = goals.MeanTraction((1 - k, k)).value(state, state.model)
        assert found == pytest.approx(mean, rel=0.04), k


def test_a_goal_that_is_not_linear_has_a_density_to_first_order():
    square = goals.Functional("square", lambda u, model: ufl.inner(u, u) * model.dx)
    found = estimate(solve(structure("between").interface(ThinLayer(GLUE, EPS, at=1.0))), goals=[square])
    change, relative = found.goals["square"].change, found.goals["square"].relative
    assert total(found, "square") == pytest.approx(change, rel=relative)
    assert total(found, "square") != pytest.approx(change, rel=0.01 * relative)


# ---------------------------------------------------------------- effectivity
def graded() -> Structure:
    """Cells at the ends of S as large as a fifth of the thickness."""
    joint = sandwich(1.3, 0.3, 0.4, 0.15, h_ends=EPS / 10)
    loads = {"TOP": lambda x, t: (0.3 * t, -t)}
    return Structure(joint, body=LOWER, supports={"BOTTOM": 0}, tractions=loads)


def test_the_estimate_is_the_error():
    """On all of S, at free ends too, beside a law of order 1 without their constants, which finds a sixth less."""
    made, layer = graded(), ThinLayer(GLUE, EPS / 2, at=1.0)
    limit, full = (solve(model, 1.0) for model in (made.interface(layer), made.full(layer)))
    found = estimate(limit)
    true = compare(full, limit)
    assert (found.traction, found.jump) == pytest.approx((true["error_traction"], true["error_jump"]), rel=0.01)
    true = full.energies()["loads"] - limit.energies()["loads"]
    assert found.goals["compliance"].change == pytest.approx(true, rel=0.002)
    plain = solve(made.interface(ThinLayer(GLUE, layer.eps, order=1, edges="plain", at=1.0)), 1.0)
    assert plain.energies()["loads"] - limit.energies()["loads"] < 0.88 * true


def between_rollers() -> Structure:
    """No free ends."""
    sides = {"BOTTOM": 0, "LEFT": {"x": 0}, "RIGHT": {"x": 0}}
    loads = {"TOP": lambda x, t: (0, -t * x[0])}
    return Structure(sandwich(1.3, 0.3, 0.4, 0.15), body=LOWER, supports=sides, tractions=loads)


def test_a_history_is_marched_again():
    """Of a layer that creeps: at once, as if it had only its elastic moduli, half of the change is found."""
    layer, made = ThinLayer(Norton(lmbda=1.2, mu=2.0, eta=0.7, p=1.5), EPS / 2, at=1.0), between_rollers()
    limit, full = (march(model, [0.3, 0.8]) for model in (made.interface(layer), made.full(layer)))
    found = estimate(limit)
    assert found.better.t == 0.8
    true = full.last.energies()["loads"] - limit.last.energies()["loads"]
    assert found.goals["compliance"].change == pytest.approx(true, rel=1e-4)
    assert total(found, "compliance") == pytest.approx(found.goals["compliance"].change, rel=0.02)  # to first order
    at_once = estimate(solve(made.interface(ThinLayer(LinearElastic(1.2, 2.0), EPS / 2, at=1.0)), 0.8))
    assert at_once.goals["compliance"].change / true < 0.6
    with pytest.raises(InputError, match="marched with theta"):
        estimate(march(made.interface(layer), [0.5, 1.0], theta=0.5))
    with pytest.raises(InputError, match="goes on from a state"):
        estimate(march(limit, [0.9]))


def test_equal_sublayers_are_one_law():
    one, two = (
        estimate(solve(graded().interface(ThinLayer(law, EPS, at=1.0)), 1.0))
        for law in (GLUE, Stack((0.4, GLUE), (0.6, LinearElastic.shear(3.0, 0.35))))
    )
    assert two.traction == pytest.approx(one.traction, rel=1e-3)  # other cells through the layer
    assert two.goals["compliance"].change == pytest.approx(one.goals["compliance"].change, rel=1e-3)


def test_a_pressure_between_held_ends_flows_along_s():
    """Short waves on rollers at nu = 0.45: order 1 without a pressure finds 0.6 of the true error in traction."""
    load = {"TOP": lambda x, t: (x[0] * (1 - x[0]), ufl.cos(2 * np.pi * x[0]))}
    sides = {"LEFT": {"x": 0}, "RIGHT": {"x": 0}, "BOTTOM": 0}
    joint, layer = (
        sandwich(1.0, 0.5, 0.5, 1 / 16, cell="quadrilateral"),
        ThinLayer(LinearElastic.shear(5.0, 0.45), 1 / 16, at=1.0),
    )
    held = Structure(joint, body=LinearElastic.young(1e3, 0.3), supports=sides, tractions=load)
    state = solve(held.interface(layer))
    true = compare(solve(held.full(layer, cells_through=4)), state)["error_traction"]
    assert estimate(state).traction == pytest.approx(true, rel=0.03)  # without the pressure 0.4


# ---------------------------------------------------------------- words
def test_sentences():
    said = estimated("between").sentences
    assert said[0].startswith("order 0: ")
    assert "% in traction" in said[0]
    assert "no change in reaction BOTTOM" in said[0]  # equilibrium gives it
    assert said[1].startswith("for these cells of the bodies, and 4 cells through the layer")
    assert estimated("bonded").sentences[0].startswith("perfect bond: ")
    assert math.isnan(estimated("bonded").jump)
    assert isinstance(estimated("rubber").layers["S"].layer.law, Rubber)  # its pressure is not lost


def test_goals_that_are_zero():
    """A reaction across symmetric loads is rounding, and so is its relative change."""
    made = Structure(graded().joint, body=LOWER, supports={"BOTTOM": 0}, tractions={"TOP": (0, -1)})
    found = estimate(solve(made.interface(ThinLayer(GLUE, EPS, at=1.0))), goals=[goals.Reaction("BOTTOM", (1, 0))])
    (goal,) = found.goals.values()
    assert goal.zero
    assert math.isnan(goal.relative)
    assert "reaction BOTTOM along (1, 0) is zero" in str(found)


def test_reactions_to_loads_without_a_resultant_are_zero():
    loads = {"LEFT/UPPER": (0.3, 0.1), "RIGHT/UPPER": (-0.3, -0.1)}
    made = Structure(graded().joint, body=LOWER, supports={"BOTTOM": 0}, tractions=loads)
    (goal,) = estimate(
        solve(made.interface(ThinLayer(GLUE, EPS, at=1.0))), goals=[goals.Reaction("BOTTOM", (0, 1))]
    ).goals.values()
    assert goal.zero


def test_a_functional_whose_parts_cancel_is_zero():
    joint = sandwich(1.2, 0.3, 0.4, 0.2, cell="quadrilateral", structured=True)
    made = Structure(joint, body=LOWER, supports={"BOTTOM": 0}, tractions={"TOP": (0, -1)})
    lean = goals.Functional("lean", lambda u, model: u[0] * model.dx)
    (goal,) = estimate(solve(made.interface(ThinLayer(GLUE, EPS, at=1.0))), goals=[lean]).goals.values()
    assert goal.zero
    assert goal.scale > 5e-4  # of displacements of 0.001 along x on each half


def test_a_goal_that_equilibrium_gives_does_not_change():
    fixed, clear = GoalError(1.0, 1.0 + 1e-13, 2.0), GoalError(1.0, 1.02, 2.0)
    assert (fixed.relative, _said("it", fixed)) == (0.0, "no change in it")
    assert (clear.at_most, _said("it", clear)) == (pytest.approx(0.02 / 1.02), "2 % in it")


def test_rigid_motions_do_not_matter():
    """Displacements a million times the jump, and a traction a million times less than the layer's stiffness times them."""
    joint, load = graded().joint, {"TOP": (0.3, -1.0)}
    found = []
    for x in (0.0, 1e5):
        made = Structure(joint, body=LOWER, supports={"BOTTOM": {"x": x, "y": 0}}, tractions=load)
        found.append(estimate(solve(made.interface(ThinLayer(GLUE, EPS, at=1.0)))))
    assert found[1].traction == pytest.approx(found[0].traction, rel=1e-5)


# ---------------------------------------------------------------- places
def test_distances_from_edges_and_not_from_their_lines():
    """Against the nearest of many points of two edges that end in space."""
    points = np.array([[0.0, 0.1, 0.0], [0.7, 0.1, 0.2], [0.7, 0.9, 0.2]])
    edges, share = np.array([[0, 1], [1, 2]]), np.linspace(0, 1, 2001)[:, None]
    x = np.random.default_rng(4).uniform(-1, 2, (50, 3))
    along = np.concatenate([points[a] + share * (points[b] - points[a]) for a, b in edges])
    wanted = np.linalg.norm(x[:, None] - along, axis=2).min(axis=1)
    found = Rim(edges, *[np.zeros(len(edges))] * 4).distance(points, x)
    assert found == pytest.approx(wanted, abs=1e-3)


def test_the_compliance_of_supports_that_move_knows_no_path():
    held = {"BOTTOM": 0, "TOP": {"x": lambda x, t: 0.01 * t, "y": -0.02}}
    made = Structure(sandwich(1.3, 0.3, 0.4, 0.3), body=LOWER, supports=held, body_force=(0, -1))
    model = made.interface(ThinLayer(GLUE, EPS, at=1.0))
    changes = []
    for given in (solve(model, 2.0), march(model, [1.0, 2.0])):
        found = estimate(given)
        changes += [found.goals["compliance"].change, total(found, "compliance")]
    assert changes == pytest.approx(changes[:1] * 4, rel=1e-8)


# ---------------------------------------------------------------- thin enough
def test_thin_enough_is_where_the_estimate_is_the_tolerance():
    joint = sandwich(1.3, 0.3, 0.4, 0.3, h_ends=0.15)
    made = Structure(joint, body=LOWER, supports={"BOTTOM": 0}, tractions={"TOP": (0.3, -1.0)})
    found = thin_enough(made, ThinLayer(GLUE, EPS, at=1.0), 0.01, goals.Compliance())
    layer = ThinLayer(GLUE, found.eps, at=found.eps / EPS)
    assert layer.material.mu == pytest.approx(GLUE.scaled(EPS).mu)
    error = estimate(solve(made.interface(layer))).goals["compliance"].relative
    assert 0.98 * 0.01 < error <= 0.01
    assert f"thinner than {found.eps:.3g}" in str(found)
    assert len(found.table) <= 15


def test_thin_enough_goes_on_below_a_change_of_sign():
    """The error x - 12 x^2 is 0.011 at 0.071, but larger than 0.015 from 0.0196 to 0.064."""
    rows = {}
    eps, found = _search(lambda x: abs(x - 12 * x * x), 0.1, 0.015, rows)
    assert found
    first, second, third = sorted(rows, reverse=True)[:3]
    assert rows[second] < 0.015 < min(rows[first], rows[third])
    assert eps == pytest.approx((1 - math.sqrt(1 - 48 * 0.015)) / 24, rel=0.01)


def test_thin_enough_does_not_depend_on_where_it_begins():
    joint = sandwich(1.0, 0.4, 0.5, 0.2, h_S=0.1, h_ends=0.05)
    made = Structure(joint, body=LOWER, supports={"BOTTOM": 0}, tractions={"TOP": (0.3, -1.0)})
    glue = LinearElastic.young(3.0, 0.3)
    found = [thin_enough(made, ThinLayer(glue, eps), 0.04) for eps in (0.05, 0.003)]
    assert found[0].eps == pytest.approx(found[1].eps, rel=1e-9)
    widest = thin_enough(made, ThinLayer(glue, 0.05), 0.9)
    assert not widest.found
    assert widest.eps == pytest.approx(0.4)  # as high as the thinner body


def test_thin_enough_passes_on_what_its_estimate_says(monkeypatch):
    """The caveats and the warnings of the thickness that it answers; not those of others that it tried."""

    def warned(state, *given, **options):
        warnings.warn(f"tried {state.model.layers['S'].thin.eps:.6g}", RangeWarning, stacklevel=1)
        return estimate(state, *given, **options)

    monkeypatch.setattr(thickness, "estimate", warned)
    sides = {"BOTTOM": 0, "LEFT": {"x": 0}, "RIGHT": {"x": 0}}
    made = Structure(sandwich(1.3, 0.3, 0.4, 0.3), body=LOWER, supports=sides, tractions={"TOP": (0, -1.0)})
    with pytest.warns(RangeWarning) as heard:
        found = thin_enough(made, ThinLayer(Maxwell(3.0, 2.0, 0.5), EPS, at=1.0), 0.9, goals.Compliance())
    assert [str(one.message) for one in heard if "tried" in str(one.message)] == [f"tried {found.eps:.6g}"]
    assert "t = 0+" in str(found)


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("tolerance", "goal", "message"),
    [(1.5, "traction", "tolerance is 1.5"), (0.1, "stress", "goal is 'stress'"), (0.001, "jump", "hardly falls")],
)
def test_thin_enough_refuses(tolerance, goal, message):
    layer = ThinLayer(LinearElastic.young(30.0, 0.3), EPS)
    refused(InputError, message, lambda: thin_enough(structure("between"), layer, tolerance, goal))


# ---------------------------------------------------------------- refused
def test_what_has_no_estimate():
    made, layer = structure("between"), ThinLayer(GLUE, EPS, at=1.0)
    limit = solve(made.interface(layer))
    two = Structure(faults(1.0, 1.0, TWO, 0.3), body=LOWER, supports={"BOTTOM": 0}, tractions={"TOP": (0.3, -1.0)})
    for given, message in [
        (lambda: estimate(3), "takes a state"),
        (lambda: estimate(limit, layer), "layer= is for"),
        (lambda: estimate(solve(made.bonded())), "give layer="),
        (lambda: estimate(solve(made.full(layer))), "nothing dropped"),
        (
            lambda: estimate(solve(two.interface({"A": layer, "B": Bond()})), layer, seam="A"),
            "'A' has a layer beside bonds",
        ),
        (lambda: estimate(limit, goals=["traction"]), "is no goal"),
        (lambda: estimate(limit, goals=[goals.Compliance(), goals.Compliance()]), "two goals"),
        (lambda: estimate(limit, goals=[goals.Reaction("BOTTOM", (0, 0))]), "direction"),
        (lambda: estimate(limit, goals=[goals.Displacement((9.0, 0.0), (0, 1))]), "in no cell"),
        (lambda: estimate(limit, goals=[goals.MeanTraction((0, 1), seam="GLUE")]), "GLUE"),
        (lambda: estimate(limit).density("traction"), "no goal"),
        (lambda: estimate(limit, goals=[goals.Functional("mean", 3)]), "must be a function"),
        (lambda: estimate(limit, goals=[goals.Functional("mean", lambda u, model: u[5] * model.dx)]), "fails"),
        (lambda: estimate(limit, goals=[goals.Functional("m", lambda u, model: 1j * u[0] * model.dx)]), "not real"),
        (lambda: thin_enough(limit.model, layer, 0.1), "takes a Structure"),
        (lambda: thin_enough(made, layer, 0.1, bonded=True, bodies="extended"), "meet on S"),
    ]:
        refused(InputError, message, given)


# ---------------------------------------------------------------- pictures, units, ranks
def test_the_picture_of_a_density(tmp_path):
    flat, solid = estimated("between"), estimated("base", 3)
    surface, values = Surface(flat.better.model), flat.density()
    plotting.along(surface, {"compliance": values}, save=tmp_path / "a.png", length="mm", log=True)
    plotting.on_surface(solid.better, solid.density(), save=tmp_path / "b.png", quantity="compliance", log=True)
    assert_drawn(tmp_path / "a.png", tmp_path / "b.png")


def test_units_do_not_matter():
    """Lengths in thousandths, stresses in millionths: relative errors are the same."""
    found = []
    for length, stress in ((1.0, 1.0), (1e3, 1e-6)):
        joint = sandwich(*(length * x for x in (1.3, 0.3, 0.4, 0.3)), h_ends=0.15 * length)
        body, glue = (LinearElastic.shear(law.mu * stress, 0.3) for law in (LOWER, GLUE))
        glue = glue.scaled(1 / length)
        made = Structure(joint, body=body, supports={"BOTTOM": 0}, tractions={"TOP": (0.3 * stress, -stress)})
        one = estimate(solve(made.interface(ThinLayer(glue, EPS * length, at=1.0))))
        found.append([one.traction, one.jump, one.goals["compliance"].relative])
    assert found[0] == pytest.approx(found[1], rel=1e-9)


@pytest.mark.long
@on_ranks(several, 2)
def test_ranks_do_not_matter(there):
    here = several()
    assert there.keys() == here.keys()
    sizes = {name.split(" ")[0]: 0.0 for name in here}
    for name, value in here.items():
        sizes[name.split(" ")[0]] = max(sizes[name.split(" ")[0]], abs(value))
    for name, value in here.items():
        assert there[name] == pytest.approx(value, rel=1e-8, abs=1e-11 * sizes[name.split(" ")[0]]), name


def test_states_and_supports_that_have_no_estimate():
    joint = sandwich(1.3, 0.3, 0.4, 0.3, h_ends=0.15)
    given = {"body": LOWER, "tractions": {"TOP": (0.3, -1.0)}}
    creeping = Structure(joint, supports={"BOTTOM": 0}, **given).interface(
        ThinLayer(Maxwell(3.0, 2.0, 0.5), EPS, at=1.0)
    )
    refused(InputError, "give the history", lambda: estimate(march(creeping, [0.4]).last))
    tied = Structure(joint.rotated(0.3), supports={"BOTTOM": 0, "LEFT": {"n": 0}}, **given)
    refused(InputError, "tie nodes on S", lambda: estimate(solve(tied.interface(ThinLayer(GLUE, EPS, at=1.0)))))
    both = Structure(joint, supports={"BOTTOM": 0, "LEFT": 0, "LEFT/LAYER": 0}, **given)
    assert estimate(solve(both.interface(ThinLayer(GLUE, EPS, at=1.0)))).traction > 0  # the bodies are held there, too
    free = Structure(joint, body=LOWER, supports={"BOTTOM": {"y": 0}, (0.0, -0.3): {"x": 0}}, eigenstrain=0.01)
    found = estimate(solve(free.interface(ThinLayer(GLUE, EPS, at=1.0))), goals=[])
    assert math.isnan(found.traction)  # both bodies expand alike, and the layer bears nothing
