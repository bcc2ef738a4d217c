"""Adaptive steps of what grows from rest, and steps that are too short for the digits of their times."""

from __future__ import annotations

import numpy as np
import pytest
import ufl

from forms import Norton
from tests.refused import refused
from tests.viscous_joints import JOINT, SETUP, SLOW, SUDDEN, interface
from thinlayer import Adaptive, SolveError, Structure, ThinLayer, march, piecewise

pytestmark = pytest.mark.few(5)

LOADS = {
    "ramp": lambda x, t: (0.0, t),
    "square": lambda x, t: (0.0, t**2),
    "late": piecewise({0.0: (0.0, 0.0), 0.3: (0.0, 0.0), 2.0: (0.0, 1.7)}),
    "after little": piecewise({0.0: (0.0, 1e-9), 0.3: (0.0, 1e-9), 2.0: (0.0, 1.7)}),
}
NORTON = Norton(60.0, 40.0, eta=5.0, p=2.0)
MOVED = {"TOP": {"x": 0.0, "y": lambda x, t: 0.02 * t}}
CASES = [
    (SLOW, "square", 0.5, "interface"),
    (SLOW, "late", 0.5, "interface"),
    (SLOW, "after little", 1.0, "interface"),
    (NORTON, "ramp", 0.5, "interface"),
    (SLOW, "moved", 1.0, "interface"),
    (SLOW, "ramp", 0.5, "full"),
]


@pytest.mark.parametrize(("law", "load", "theta", "kind"), CASES)
def test_what_grows_from_rest(law, load, theta, kind):
    """Jumps of a layer with a rate grow as t^2 or slower; the error at the end is that of few steps."""
    tolerance, end = 2e-3, 0.8
    supports = SETUP["supports"] | (MOVED if load == "moved" else {})
    data = SETUP | {"supports": supports, "tractions": {} if load == "moved" else {"TOP": LOADS[load]}}
    model = getattr(Structure, kind)(Structure(JOINT, **data), ThinLayer(law, 0.1, at=1.0))
    at = 0.3 + 0.5 * np.arange(1, 65) / 64 if "late" in load else end * np.arange(1, 65) / 64
    fine = march(model, [*map(float, at)], theta=0.5, keep="last").last
    history = march(model, Adaptive(end, first=0.1, tolerance=tolerance), theta=theta, keep="last")
    change = np.linalg.norm(history.last.u.x.array - fine.u.x.array) / np.linalg.norm(fine.u.x.array)
    assert change < (1.5 if theta == 0.5 else 5.0) * tolerance
    assert len(history) < (50 if theta == 0.5 else 200)


# ---------------------------------------------------------------- digits of times
def test_steps_that_are_lost_in_rounding_fail():
    for times, start in [([1.0, 1.0 + 4e-16], 0.0), ([1e17 + 16], 1e17), (Adaptive(1e17 + 64, first=16.0), 1e17)]:
        refused(SolveError, "lost in rounding", march, interface(), times, start=start)


@pytest.mark.few(1)
@pytest.mark.parametrize("law", [SLOW, SUDDEN])
def test_a_march_of_steps_that_get_lost_in_rounding_ends(law):
    """The error that is asked for needs steps that are shorter than the digits of their times allow."""
    model = interface(law, {"TOP": lambda x, t: (0.0, ufl.sin(3e3 * (t - 1e6)))})
    with pytest.raises(SolveError, match="stays above the tolerance"):
        march(model, Adaptive(1e6 + 1, first=1e-3, tolerance=1e-15), start=1e6)
