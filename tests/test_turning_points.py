"""Softening layers under displacement control: marches end where the path turns back, and it is followed from there."""

from dataclasses import replace

import numpy as np
import pytest

from forms.base import InputError
from tests.refused import refused
from tests.softening_bars import FAR, C, Damage, Trilinear, bar, openings, sigma
from thinlayer import Adaptive, ArcLength, march, piecewise
from thinlayer.errors import TurningPoint

pytestmark = pytest.mark.few(5)


STEEP = type("Softening", (Trilinear,), {"softens": True})(k=7.0, fall=5.0, w_1=0.11, w_2=0.23, k_T=1.9)


TURN = STEEP.w_1 + C * sigma(STEEP, STEEP.w_1)
GENTLE = replace(STEEP, fall=0.5 / C)  # displacements of the bar's end grow all along its path


@pytest.mark.few(5)
@pytest.mark.parametrize("n", [2, 12])
def test_displacement_control_ends_where_the_path_turns_back(n):
    """However long the steps: none leads beyond the loop. Then the path leads back, and on to the end."""
    with pytest.raises(TurningPoint, match=r"march\(error.history, ArcLength") as caught:
        march(bar(STEEP), [FAR * (k + 1) / n for k in range(n)])
    error, before = caught.value, caught.value.history
    path = march(before if n == 2 else before.last, ArcLength(end=FAR, first=0.05))
    assert before.last.t == error.t
    assert 0 <= TURN - error.t < 2e-3 * FAR / n
    for history in (before, path):
        w = openings(history)
        assert history.t == pytest.approx(w + C * sigma(STEEP, w), abs=1e-11)
        assert (np.diff(w) > 0).all()
        assert np.abs(history.table["imbalance"]).max() < 1e-9
    assert path.t[0] == error.t
    assert path.t.min() == pytest.approx(STEEP.w_2 + C * sigma(STEEP, STEEP.w_2), abs=0.03)
    assert path.last.t == FAR
    assert (np.diff(before.t) > 0).all()


def test_a_peak_that_the_support_can_pass():
    """The tension test of a softening surface: the load falls while the support goes on, to the times asked for."""
    times = [0.3, 0.6, 0.9, 1.2, FAR]
    history = march(bar(GENTLE), times)
    w = openings(history)
    assert history.t == pytest.approx(w + C * sigma(GENTLE, w), abs=1e-11)
    assert set(times) <= set(history.t)
    assert (np.diff(sigma(GENTLE, w)) < 0).any()
    caught = refused(TurningPoint, "", march, bar(GENTLE, traction=lambda x, t: (0.0, t)), [0.5, 1.0])
    assert caught.t == pytest.approx(GENTLE.k * GENTLE.w_1, abs=2e-3)


def test_damage_is_loaded_and_unloaded():
    """A support that goes forth, back and forth again: the path begins anew at the breaks, and unloading is elastic."""
    law = type("Damaged", (Damage,), {"softens": True})(k=5.0, w_0=0.1, k_T=1.9)
    history = march(bar(law, piecewise({0: 0.0, 1: 0.4, 2: 0.1, 3: 0.6})), [0.5, 1.0, 1.5, 2.0, 2.5, 3.0])
    w, t = openings(history), history.t
    stiffness = law.k * np.exp(-np.maximum.accumulate(w) / law.w_0)
    assert np.interp(t, [0, 1, 2, 3], [0.0, 0.4, 0.1, 0.6]) == pytest.approx(w * (1 + C * stiffness), abs=1e-10)
    assert {0.5, 1.0, 1.5, 2.0, 2.5, 3.0} <= set(t)
    assert w.max() > 3 * law.w_0  # far beyond the largest load


def test_a_march_in_time_goes_on_where_it_was_cut(tmp_path):
    """From its files, and from its history."""
    times = [0.3, 0.6, 0.9, 1.2, FAR]
    whole = march(bar(GENTLE), times)
    first = march(bar(GENTLE), times[:3], out=tmp_path / "run")
    again, after = march(bar(GENTLE), times, out=tmp_path / "run", resume=True), march(first, times[3:])
    assert again.t == pytest.approx(whole.t, abs=1e-9)
    assert after.t[0] == times[2]
    for history in (again, after):
        assert np.abs(history.last.u.x.array - whole.last.u.x.array).max() < 1e-10


def test_refused():
    refused(InputError, "march with Adaptive: the stress of", lambda: march(bar(STEEP), Adaptive(end=1.0, first=0.1)))
    refused(InputError, "theta = 1", lambda: march(bar(STEEP), [0.5], theta=0.5))
    state = march(bar(GENTLE), [0.3]).last
    refused(InputError, "it must come after start", lambda: march(state, ArcLength(end=0.2, first=0.1)))
    refused(InputError, r"times is \[0\.2\] from start = 0\.3", lambda: march(state, [0.2]))
    refused(InputError, "omit start= and out=", lambda: march(state, [0.6], out="run"))
    refused(InputError, "a history or a state", lambda: march([state], [0.6]))
