"""Where equilibrium paths end: steps and their lengths, the way back, failures, and which runs are resumed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import ufl

from forms.base import InputError
from forms.traction import TractionLaw
from tests.refused import refused
from tests.softening_bars import FAR, STEEP, C, Trilinear, across_and_along, bar, chosen, openings, sigma
from thinlayer import ArcLength, SolveError, march


# ---------------------------------------------------------------- where it ends
def test_steps_and_their_lengths():
    few = ArcLength(end=FAR, first=0.05, steps=np.int64(7))
    with pytest.raises(
        SolveError, match=r"at t = 0\.67\d+ after 7 steps, not at end = 1\.5; give more steps"
    ) as caught:
        march(bar(STEEP), few)
    assert len(caught.value.history) == 8
    linear = bar(Trilinear(k=7.0, fall=5.0, w_1=9.0, w_2=10.0, k_T=1.9))
    assert march(linear, ArcLength(end=1.0, first=0.3)).t == pytest.approx([0.0, 0.3, 0.9, 1.0])
    assert march(linear, ArcLength(end=1.0, first=0.3, largest=1)).t == pytest.approx([0.0, 0.3, 0.6, 0.9, 1.0])
    assert march(linear, ArcLength(end=1.0, first=0.1, largest=3.0)).t == pytest.approx([0.0, 0.1, 0.3, 0.6, 0.9, 1.0])
    assert march(linear, ArcLength(end=0.3, first=0.3, largest=0.5)).t == pytest.approx([0.0, 0.15, 0.3])
    assert march(linear, ArcLength(end=2.5, first=1.0), start=0.7).t == pytest.approx([0.7, 1.7, 2.5])


def test_back():
    """Without a residual branch the bar comes back to where it was stress-free, and beyond."""
    falling = Trilinear(k=7.0, fall=5.0, w_1=0.11, w_2=9.0, k_T=1.9)
    history = march(bar(falling), ArcLength(end=1.0, first=0.05, back=-0.2))
    assert history.t[-1] < -0.2 <= history.t[:-1].min()
    w = openings(history)
    assert history.t == pytest.approx(w + C * sigma(falling, w), abs=1e-10)
    assert len(history.t[np.flatnonzero(np.diff(np.sign(history.t - 0.3)))]) == 2
    words = r"has come back to t = -0\.5\d+ and has not reached end = 1; give back="  # 2 start - end
    refused(SolveError, words, march, bar(falling), ArcLength(end=1.0, first=0.05), start=0.25)


@pytest.mark.filterwarnings("ignore:Value error in evaluation of function sqrt")
def test_no_step_leads_on():
    """A law that is not defined beyond an opening."""
    words = r"step \d+ of the path, from t = 0\.\d+, failed, and so did longer ones"
    caught = refused(SolveError, words, march, bar(Torn(k=7.0, k_T=1.9)), ArcLength(end=1.0, first=0.1, smallest=1e-2))
    t = caught.history.last.t
    assert 0.1 * (1 + C * 7.0) - 0.002 < t < 0.1 * (1 + C * 7.0)
    with pytest.raises(SolveError, match=r"nothing moves from t = 0 to 0\.1: the path has no direction"):
        march(bar(STEEP, lambda x, t: 0.0), ArcLength(end=1.0, first=0.1))
    with pytest.raises(SolveError, match=r"the first state, .* at t = 0: .*the law of 'layer' failed"):
        march(bar(Torn(k=7.0, k_T=1.9), lambda x, t: 2 + t), ArcLength(end=1.0, first=0.1))


@dataclass(frozen=True)
class Torn(TractionLaw):
    k: float
    k_T: float

    def traction(self, step):
        w = ufl.dot(step.mid, step.n)
        return across_and_along(w, chosen(w, 0.1, self.k * w, ufl.sqrt(-1 - w**2)), self.k_T, step)


def test_only_the_same_path_is_resumed(tmp_path):
    """More steps may follow; the unit of the arc length is part of the path, and a path is no march in time."""
    path, model = ArcLength(end=FAR, first=0.1), bar(STEEP)
    whole = march(model, path)
    refused(SolveError, "after 9 steps", march, model, replace(path, steps=9), out=tmp_path, keep="last")
    for other in (replace(path, first=0.05), [0.1, FAR]):
        refused(InputError, r"is of another march \(first: 0\.1 there", march, model, other, out=tmp_path, resume=True)
    resumed = march(model, path, out=tmp_path, keep="last", resume=True)
    assert resumed.t == pytest.approx(whole.t, abs=1e-12)
    assert list(resumed.states) == [len(whole) - 1]
    assert sorted(file.stem for file in (tmp_path / "states").iterdir()) == [f"{len(whole) + k:06d}" for k in (-2, -1)]
    with pytest.raises(InputError, match=r"is at t = 1\.5, and is to end before"):
        march(model, replace(path, end=1.0), out=tmp_path, resume=True)
