"""How long steps are: errors that adaptive ones keep, and where those of a layer with memory end."""

from __future__ import annotations

import numpy as np
import pytest

from forms import HolonomicCoulomb, IncrementalCoulomb, LinearElastic, Maxwell, MohrCoulomb, Stack
from geometry import sandwich
from tests.limit_load_run import SLIDING, sheared
from tests.own_laws import Mises, StandardSolid
from tests.refused import refused
from tests.test_limit_load import LIMITS
from tests.viscous_joints import JOINT, SETUP, SLOW, SUDDEN, interface
from thinlayer import Adaptive, Structure, Surface, ThinLayer, march, piecewise
from thinlayer.errors import LimitLoad
from thinlayer.solving.solve import Solver
from thinlayer.time.stepping import ErrorEstimate

pytestmark = pytest.mark.few(5)

# ---------------------------------------------------------------- where loads break
PEAK = piecewise({0.0: 0.0, 1.5: 3.0, 3.0: 0.3})


def test_a_peak_between_two_times_is_met():
    """Loads pass their limit on the way to a peak, and are below it at the times that were given."""
    law, model = SLIDING, sheared("S", SLIDING, tractions={"TOP": lambda x, t: (PEAK(x, t), -1.0)})
    caught = refused(LimitLoad, "", march, model, [0.1, 3.0])
    assert PEAK(None, caught.t) < LIMITS[law] < PEAK(None, caught.failed_at)
    assert caught.failed_at < 1.5


REMEMBERING = {
    "rate": SLOW,
    "relaxing": SUDDEN,
    "plastic": MohrCoulomb(60.0, 40.0, cohesion=9.0, friction_angle=30.0),
    "of one's own": Mises(60.0, 40.0, 9.0),
    "stacked": Stack((0.5, LinearElastic(60.0, 40.0)), (0.5, SUDDEN)),
    "elastic": LinearElastic(60.0, 40.0),
}


@pytest.mark.parametrize("name", REMEMBERING)
def test_steps_of_a_layer_with_memory_end_where_loads_break(name):
    """And are in the table; times that differ from a break by rounding stay as they are."""
    load = piecewise({0.0: 0.0, 0.1 + 0.2: 1.0, 0.5: 1.5, 1.0: 0.0})
    history = march(interface(REMEMBERING[name], {"TOP": lambda x, t: (0.0, load(x, t))}), [0.3, 1.0])
    assert history.t.tolist() == ([0.0, 0.3, 1.0] if name == "elastic" else [0.0, 0.3, 0.5, 1.0])


@pytest.mark.parametrize(("law", "stops"), [(HolonomicCoulomb, False), (IncrementalCoulomb, True)])
def test_contact_that_remembers_its_slip(law, stops):
    supports = {"BOTTOM": 0.0, "TOP": {"x": piecewise({0: 0.0, 2: 0.06, 4: -0.06}), "y": -0.02}}
    model = Structure(JOINT, body=SETUP["body"], supports=supports, element="P1").interface(law(100.0, 80.0, 0.3))
    assert (2.0 in march(model, [1.0, 4.0]).t) is stops


# ---------------------------------------------------------------- adaptive steps
HELD = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}, "TOP": {"x": 0.0, "y": 0.03}}


def column(law, joint=JOINT, **supports):
    return Structure(joint, body=SETUP["body"], supports=HELD | supports).interface(ThinLayer(law, 0.1, at=1.0))


def pull(model):
    surface = Surface(model)
    return {"pull": lambda state: surface.integral(surface.frame(surface.traction(state))[1])}


@pytest.mark.parametrize(("soft", "theta"), [(1.0, 1.0), (1e-2, 0.5), (1e-5, 1.0)])
def test_a_layer_that_relaxes_under_bodies_that_hardly_move(soft, theta):
    """The traction's error is that of the tolerance, however soft the layer; errors of steps add up."""
    model, tolerance = column(Maxwell(60.0 * soft, 40.0 * soft, t1=0.7)), 2e-3
    history = march(model, Adaptive(2.0, first=1.0, tolerance=tolerance), theta=theta, observe=pull(model))
    stiffness = SETUP["body"].lmbda + 2 * SETUP["body"].mu  # of a body 1 long in all
    exact = history.table["pull"][0] * np.exp(-stiffness / (stiffness + 140.0 * soft) / 0.7 * history.t)
    largest = np.abs(history.table["pull"] / history.table["pull"][0] - exact / exact[0]).max()
    assert largest < (2.5 if theta == 0.5 else 8.0) * tolerance
    assert len(history) < (20 if theta == 0.5 else 60)


def test_no_jump_and_no_force_have_no_error():
    """Both bodies are moved alike, far: what is left of jumps and forces is rounding."""
    moved = {"BOTTOM": {"x": 0.0, "y": lambda x, t: 5 * t}, "TOP": {"x": 0.0, "y": lambda x, t: 5 * t}}
    assert len(march(column(Maxwell(6e-3, 4e-3, t1=0.7), **moved), Adaptive(2.0, first=0.1, tolerance=1e-4))) < 12


@pytest.mark.parametrize(("theta", "length"), [(1.0, 0.02), (0.5, 0.1)])
def test_the_estimate_is_the_error(theta, length):
    """A step is taken if the tolerance is a little above the error of its halves, and not if it is a little below."""
    model = column(StandardSolid(60.0, 40.0, 50.0, 0.6), sandwich(1.0, 0.5, 0.5, 0.5))
    with Solver(model) as solver:
        begin = solver.step(solver.rest_state(0.0), 0.0)

        def reached(parts, theta):
            state = begin
            for k in range(parts):
                state = solver.step(state, length * (k + 1) / parts, theta)
            return state

        halves, exact = reached(2, theta), reached(64, 0.5)
        estimate = ErrorEstimate(solver.equations)
        error = float(estimate.differences(exact, halves, estimate.state_norms(begin)).max())
    assert error > 1e-6
    for factor, taken in ((1.15, True), (0.85, False)):
        history = march(model, Adaptive(length, first=length, tolerance=factor * error), theta=theta)
        assert (history.t.tolist() == [0.0, length / 2, length]) is taken
