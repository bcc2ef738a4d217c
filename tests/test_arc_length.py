"""Equilibrium paths by arc length: closed forms of bars that snap back, blocks, runs that are resumed, errors."""

from __future__ import annotations

import math
import subprocess
import sys
import warnings
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar

import numpy as np
import pytest
import ufl

from forms.law import BulkLaw
from forms.laws import Incompressible, KelvinVoigt, LinearElastic, Maxwell, MohrCoulomb
from forms.traction import TractionLaw
from geometry import block
from tests.arc_length_run import (
    HEIGHT,
    KINKED,
    PATH,
    WIDTH,
    Damage,
    E,
    Trilinear,
    across_and_along,
    bar,
    chosen,
    tilted,
)
from tests.test_parallel import CLEAN, CLONE, mpirun
from thinlayer import (
    ArcLength,
    ModelError,
    OptionError,
    RangeWarning,
    SolveError,
    Structure,
    ThinLayer,
    march,
    piecewise,
    solve,
)

C = HEIGHT / E  # compliance of the bar
STEEP = Trilinear(k=7.0, fall=5.0, w_1=0.11, w_2=0.23, k_T=1.9)
SHARP = Trilinear(k=40.0, fall=400.0, w_1=0.02, w_2=0.0217, k_T=1.9)  # falls back along its rise, but for 2 degrees
FAR = 1.5  # beyond the snap-back of both


def openings(history) -> np.ndarray:
    """Mean displacement of the bar's lower side, which is its opening."""
    model = history.model
    x = model.V.tabulate_dof_coordinates()
    lower = np.flatnonzero(np.isclose(x[:, 1], 0.0))
    return np.array([state.u.x.array.reshape(-1, 2)[lower, 1].mean() for state in history])


def sigma(law, w):
    return law.sigma(w, lambda a, b, x, y: np.where(a < b, x, y))


def turning_points(t, w, law) -> list[tuple[float, float]]:
    """(w, t) where the straight lines of neighbouring branches meet."""
    branch = np.digitize(w, [law.w_1, law.w_2])
    lines = [np.polyfit(w[branch == k], t[branch == k], 1) for k in range(3)]
    meet = [(b[1] - a[1]) / (a[0] - b[0]) for a, b in pairwise(lines)]
    return [(x, np.polyval(line, x)) for x, line in zip(meet, lines[:-1], strict=True)]


# ---------------------------------------------------------------- the bar
@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize(("law", "first"), [(STEEP, 0.05), (STEEP, 0.13), (SHARP, 0.07)])
def test_a_bar_that_snaps_back(law, first, backwards):
    """Rows are on the straight branches of t = w + sigma(w) H/E, in their order, for any step and in both directions."""
    support = (lambda x, t: FAR - t) if backwards else (lambda x, t: t)
    history = march(bar(law, support), ArcLength(end=FAR, first=first))
    t = FAR - history.t if backwards else history.t
    w = openings(history)
    assert t == pytest.approx(w + C * sigma(law, w), abs=1e-11)
    assert (np.diff(w) < 0).all() if backwards else (np.diff(w) > 0).all()
    assert history.last.t == FAR
    turns = [(law.w_1, law.w_1 + C * sigma(law, law.w_1)), (law.w_2, law.w_2 + C * sigma(law, law.w_2))]
    assert turns[0][1] > turns[1][1] + 0.2  # it snaps back
    assert np.array(turning_points(t, w, law)) == pytest.approx(np.array(turns), abs=1e-9)
    table = history.table
    assert np.abs(table["imbalance"]).max() < 1e-9
    assert table["residual"].max() < 1e-9
    assert np.cumsum(table["dt"]) == pytest.approx(history.t, abs=1e-12)
    assert (table["dt"] < 0).any()


def test_a_march_in_time_ends_where_a_path_turns():
    """From both ends: it is the path outside the loop, and has nothing on the falling branch."""
    path = march(bar(STEEP), ArcLength(end=FAR, first=0.05))
    w = openings(path)
    assert ((w > STEEP.w_1) & (w < STEEP.w_2)).sum() > 5
    ends = [x + C * sigma(STEEP, x) for x in (STEEP.w_1, STEEP.w_2)]
    for backwards, end, before in ((False, ends[0], w < STEEP.w_1), (True, ends[1], w > STEEP.w_2)):
        support = (lambda x, t: FAR - t) if backwards else (lambda x, t: t)
        with pytest.raises(SolveError, match="failed, and so did longer ones: Newton's method failed") as caught:
            march(bar(STEEP, support), [0.3, 0.6, 0.9, 1.2, FAR])
        history = caught.value.history
        t = FAR - history.t if backwards else history.t
        assert abs(t[-1] - end) < 1e-3
        order = np.argsort(t)
        inside = before & (path.t >= t.min()) & (path.t <= t.max())
        assert inside.sum() > 5
        in_time = np.interp(path.t[inside], t[order], openings(history)[order])
        assert w[inside] == pytest.approx(in_time, abs=1e-10)


@pytest.mark.parametrize("change", [lambda t: t, lambda t: t + 0.3 * t**2])
def test_a_load_that_has_a_limit(change):
    """The bar under a traction: it rises to the peak of the law, falls, and rises again; t as a load need not be linear."""
    history = march(bar(STEEP, traction=lambda x, t: (0.0, change(t))), ArcLength(end=1.0, first=0.04))
    w = openings(history)
    assert change(history.t) == pytest.approx(sigma(STEEP, w), abs=1e-9)
    assert (np.diff(w) > 0).all()
    assert ((w > STEEP.w_1) & (w < STEEP.w_2)).sum() > 5
    assert np.abs(history.table["imbalance"]).max() < 1e-9


def test_piecewise_supports():
    """A path that would leave the times they are known at ends there with an error; difference quotients do not leave."""
    known = piecewise({0.0: 0.0, 0.3: 0.2, FAR: FAR})
    history = march(bar(STEEP, known), ArcLength(end=FAR, first=0.05))
    w = openings(history)
    ends = np.interp(history.t, [0.0, 0.3, FAR], [0.0, 0.2, FAR])
    assert ends == pytest.approx(w + C * sigma(STEEP, w), abs=1e-9)
    late = piecewise({0.4: 0.4, FAR: FAR})
    with pytest.raises(
        SolveError, match=r"of the path, from t = 0\.4.* a prescribed displacement is not finite at t = 0\."
    ):
        march(bar(STEEP, late), ArcLength(end=FAR, first=0.05), start=0.4)


# ---------------------------------------------------------------- smooth laws
@dataclass(frozen=True)
class Exponential(TractionLaw):
    """k w exp(-w/w_0) across S."""

    k: float
    w_0: float
    k_T: float

    def traction(self, step):
        w = ufl.dot(step.mid, step.n)
        return across_and_along(w, self.k * w * ufl.exp(-w / self.w_0), self.k_T, step)


SMOOTH = Exponential(k=30.0, w_0=0.06, k_T=1.9)


def smooth_turns() -> list[tuple[float, float]]:
    """(w, t) where 1 + C sigma'(w) = 0: (1 - x) exp(-x) = -1/(C k), x = w/w_0, by Newton's method."""
    turns = []
    for x in (1.1, 4.0):
        for _ in range(50):
            value, slope = (1 - x) * math.exp(-x) + 1 / (C * SMOOTH.k), (x - 2) * math.exp(-x)
            x -= value / slope
        w = x * SMOOTH.w_0
        turns.append((w, w + C * SMOOTH.k * w * math.exp(-x)))
    return turns


def observed_turns(w, t) -> list[tuple[float, float]]:
    """Extremes of the cubics through four rows around a change of sign of dt."""
    turns = []
    for k in np.flatnonzero(np.diff(np.sign(np.diff(t)))) + 1:
        rows = slice(k - 2, k + 2) if abs(t[k - 1] - t[k]) < abs(t[k + 1] - t[k]) else slice(k - 1, k + 3)
        shift = w[k]
        cubic = np.polyfit(w[rows] - shift, t[rows], 3)
        roots = np.roots(np.polyder(cubic))
        x = roots[np.argmin(abs(roots))].real
        turns.append((x + shift, np.polyval(cubic, x)))
    return turns


def test_turning_points_of_a_smooth_law():
    """The observed ones converge to 1 + C sigma'(w) = 0; the rows do not depend on the step."""
    errors, exact = [], np.array(smooth_turns())
    assert exact[0, 1] > exact[1, 1] + 0.1
    for first in (0.08, 0.04, 0.02):
        history = march(bar(SMOOTH), ArcLength(end=1.0, first=first))
        w, t = openings(history), history.t
        assert t == pytest.approx(w + C * SMOOTH.k * w * np.exp(-w / SMOOTH.w_0), abs=1e-9)
        found = np.array(observed_turns(w, t))
        assert found.shape == exact.shape
        errors.append(np.abs(found - exact)[:, 1].max())
    assert errors[-1] < 1e-5
    assert math.log2(errors[0] / errors[-1]) / 2 > 1.8


def test_a_law_with_memory():
    """Damage: as the bar unloads, S goes on opening, and remembers; the path is that of its envelope."""
    history = march(bar(Damage(SMOOTH.k, SMOOTH.w_0, SMOOTH.k_T)), ArcLength(end=1.0, first=0.05))
    w, t = openings(history), history.t
    assert t == pytest.approx(w + C * SMOOTH.k * w * np.exp(-w / SMOOTH.w_0), abs=1e-9)
    assert (np.diff(t) < 0).any()
    assert (np.diff(w) > 0).all()
    assert np.array([state.memory["layer"].max() for state in history]) == pytest.approx(w, abs=1e-12)
    assert np.abs(history.table["imbalance"]).max() < 1e-9


# ---------------------------------------------------------------- a block
def test_a_block_that_softens_from_one_side():
    """The path turns several times; it begins as a march in time does, and ends on the law's last branch."""
    history = march(tilted(KINKED), PATH)
    assert np.count_nonzero(np.diff(np.sign(history.table["dt"][1:]))) >= 4
    in_time = march(tilted(KINKED), [0.06, 0.1])
    size = np.abs(history.last.u.x.array).max()
    for t in (0.06, 0.1):
        assert history.at(t).u.x.array == pytest.approx(in_time.at(t).u.x.array, abs=1e-9 * size)
    last = replace(KINKED, w_1=KINKED.w_1 - 1, w_2=KINKED.w_2 - 1)  # the same last branch, from the beginning
    assert history.last.u.x.array == pytest.approx(solve(tilted(last), PATH.end).u.x.array, abs=1e-9 * size)
    assert np.abs(history.table["imbalance"]).max() < 1e-9


def test_rows_of_long_steps_are_on_the_path_of_short_ones():
    """Distances in (t, nodal displacements of S); the second path turns often, and never goes back."""
    law = Trilinear(k=70.0, fall=15.0, w_1=0.011, w_2=0.033, k_T=30.0)
    fine, coarse = (points(march(tilted(law), ArcLength(end=0.15, first=first))) for first in (0.0015, 0.006))
    assert np.count_nonzero(np.diff(np.sign(np.diff(fine[:, 0])))) >= 4
    assert max(distance(p, fine) for p in coarse) < 1e-3


def points(history) -> np.ndarray:
    x = history.model.V.tabulate_dof_coordinates()
    lower = np.flatnonzero(np.isclose(x[:, 1], 0.0))
    return np.array([[state.t, *state.u.x.array.reshape(-1, 2)[lower, 1]] for state in history])


def distance(p, line) -> float:
    a, v = line[:-1], np.diff(line, axis=0)
    share = np.clip(((p - a) * v).sum(axis=1) / (v * v).sum(axis=1), 0, 1)
    return float(np.linalg.norm(a + share[:, None] * v - p, axis=1).min())


# ---------------------------------------------------------------- after the bodies have come apart
@dataclass(frozen=True)
class Cohesive(TractionLaw):
    """k [u] exp(-[u]^2/w_0^2): nothing is left of it far beyond w_0."""

    k: float
    w_0: float
    softens: ClassVar = True

    def traction(self, step):
        return self.k * step.mid * ufl.exp(-ufl.inner(step.mid, step.mid) / self.w_0**2)


@pytest.mark.parametrize(("k", "w_0", "first"), [(5.4, 0.17, 0.22), (0.9, 0.07, 0.05), (31.0, 0.017, 0.1)])
def test_a_path_goes_on_without_force(k, w_0, first):
    """Forces vanish, on one side first: a path that turned round there would go back along itself."""
    history = march(tilted(Cohesive(k, w_0)), ArcLength(end=1.0, first=first))
    assert history.last.t == 1
    assert (np.diff(history.t[history.t > 0.5]) > 0).all()
    x = history.model.V.tabulate_dof_coordinates()
    turned = np.column_stack([0.6 * (0.5 - x[:, 1]), 1 + 0.6 * x[:, 0]])  # the block is free, and as stiff as can be
    assert history.last.u.x.array.reshape(-1, 2) == pytest.approx(turned, abs=1e-6)


# ---------------------------------------------------------------- softening that is not declared
@dataclass(frozen=True)
class Undeclared(Cohesive):
    softens: ClassVar = False


@dataclass(frozen=True)
class Softer(BulkLaw):
    """A body's law that says its stress falls."""

    k: float
    softens: ClassVar = True

    def stress(self, step):
        return self.k * step.e / (1 + ufl.inner(step.e, step.e))


def told(model, times):
    """RangeWarnings of a march, or of a solve at a time; and its result."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = march(model, times) if isinstance(times, list) else solve(model, times)
    return [str(w.message) for w in caught if issubclass(w.category, RangeWarning)], result


def test_softening_is_told_where_it_is_met():
    """Stresses fall beyond w_0/sqrt(2), whatever the unit of length; what rises, or is declared, is not warned of."""
    for unit in (1.0, 1e-3):
        law = Undeclared(0.9, 0.11 * unit)
        model = bar(law, lambda x, t, unit=unit: unit * t)
        messages, history = told(model, [0.05, 0.1, 0.15, 0.2, 0.3])
        (message,) = messages
        falling = openings(history) > law.w_0 / math.sqrt(2)
        assert f"at t = {history.t[falling][0]:g} the stress of Undeclared falls at 2 points" in message
        assert "write softens = True" in message
        assert not falling[:2].any()
        assert told(model, 0.05)[0] == []
        assert len(told(model, 0.3)[0]) == 1
    with pytest.raises(ModelError, match="follow them from rest with march"):
        solve(bar(Cohesive(0.9, 0.11)))


def test_a_step_over_a_loop_is_told():
    """Both states rise, on branches that a fall parts."""
    law = replace(STEEP, fall=0.8)  # too little for the bar to snap back
    ends = [w + C * sigma(law, w) for w in (0.05, 0.105, 0.232)]
    assert told(bar(law), ends[:2])[0] == []
    messages, history = told(bar(law), ends)
    assert openings(history)[1:] == pytest.approx([0.05, 0.105, 0.232], rel=1e-9)
    assert "the stress of Trilinear falls" in messages[0]


def test_bodies_do_not_soften():
    strip = block(WIDTH, HEIGHT, WIDTH, cell="quadrilateral", structured=True)
    with pytest.raises(ModelError, match=r"the stress of Softer falls as strains grow: .* in one row of cells"):
        Structure(strip, body=Softer(3.0), supports={"TOP": 0.0}).interface(ThinLayer(LinearElastic(1.0, 1.0), 0.1))


def test_warnings_are_seen():
    """On standard error, though FFCx sends warnings to a log that has no handler."""
    script = "import ffcx, mpi4py.MPI as M, thinlayer.errors as f; f.warn('jumps exceed eps', M.COMM_WORLD)"
    done = subprocess.run([sys.executable, "-c", script], cwd=CLONE, capture_output=True, text=True, timeout=60)
    assert "RangeWarning: jumps exceed eps" in done.stderr


# ---------------------------------------------------------------- where it ends
def test_steps_and_their_lengths():
    few = ArcLength(end=FAR, first=0.05, steps=7)
    with pytest.raises(SolveError, match=r"at t = 0\.35 after 7 steps, not at end = 1\.5; give more steps") as caught:
        march(bar(STEEP), few)
    assert len(caught.value.history) == 8
    linear = bar(Trilinear(k=7.0, fall=5.0, w_1=9.0, w_2=10.0, k_T=1.9))
    assert march(linear, ArcLength(end=1.0, first=0.3)).t == pytest.approx([0.0, 0.3, 0.6, 0.9, 1.0])
    longer = march(linear, ArcLength(end=1.0, first=0.1, largest=3.0))
    assert longer.t == pytest.approx([0.0, 0.1, 0.3, 0.6, 0.9, 1.0])
    assert march(linear, ArcLength(end=1.0, first=1.0)).t == pytest.approx([0.0, 1.0])
    assert march(linear, ArcLength(end=2.5, first=1.0), start=0.7).t == pytest.approx([0.7, 1.7, 2.5])


def test_back():
    """Without a residual branch the bar comes back to where it was stress-free, and beyond."""
    falling = Trilinear(k=7.0, fall=5.0, w_1=0.11, w_2=9.0, k_T=1.9)
    history = march(bar(falling), ArcLength(end=1.0, first=0.05, back=-0.2))
    assert history.t[-1] < -0.2 <= history.t[:-1].min()
    w = openings(history)
    assert history.t == pytest.approx(w + C * sigma(falling, w), abs=1e-10)
    twice = history.t[np.flatnonzero(np.diff(np.sign(history.t - 0.3)))]
    assert len(twice) == 2
    with pytest.raises(
        SolveError, match=r"has come back to t = -\S+ and has not reached end = 1; give back="
    ) as caught:
        march(bar(falling), ArcLength(end=1.0, first=0.05))
    assert caught.value.history.t[-1] < -1 <= caught.value.history.t[:-1].min()


def test_the_last_state_at_a_time_is_found():
    history = march(bar(STEEP), ArcLength(end=FAR, first=0.05))
    history.states = {k: s for k, s in history.states.items() if k in (2, len(history) - 1)}
    assert history.at(0.1).t == pytest.approx(0.1)
    assert history.at(FAR) is history.last


@pytest.mark.filterwarnings("ignore:Value error in evaluation of function sqrt")
def test_no_step_leads_on():
    """A law that is not defined beyond an opening."""
    with pytest.raises(
        SolveError, match=r"step \d+ of the path, from t = 0\.\d+, failed, and so did longer ones"
    ) as caught:
        march(bar(Torn(k=7.0, k_T=1.9)), ArcLength(end=1.0, first=0.1, smallest=1e-2))
    t = caught.value.history.last.t
    assert 0.1 * (1 + C * 7.0) - 0.002 < t < 0.1 * (1 + C * 7.0)
    with pytest.raises(SolveError, match=r"nothing moves from t = 0 to 0\.1: a path has no direction"):
        march(bar(STEEP, lambda x, t: 0.0), ArcLength(end=1.0, first=0.1))
    with pytest.raises(SolveError, match=r"the first state, at t = 0: .*law failed"):
        march(bar(Torn(k=7.0, k_T=1.9), lambda x, t: 2 + t), ArcLength(end=1.0, first=0.1))


@dataclass(frozen=True)
class Torn(TractionLaw):
    k: float
    k_T: float

    def traction(self, step):
        w = ufl.dot(step.mid, step.n)
        return across_and_along(w, chosen(w, 0.1, self.k * w, ufl.sqrt(-1 - w**2)), self.k_T, step)


# ---------------------------------------------------------------- resumed, on two ranks
def run(ranks: int, *words: str) -> subprocess.CompletedProcess:
    if ranks > 1:
        return mpirun(ranks, "-m", "tests.arc_length_run", *words)
    command = [sys.executable, "-m", "tests.arc_length_run", *words]
    return subprocess.run(command, env=CLEAN | {"PYTHONPATH": str(CLONE)}, cwd=CLONE, capture_output=True, timeout=240)


def rows(out):
    found = {name: np.genfromtxt(out / name / "table.csv", delimiter=",", names=True) for name in ("kinked", "damaged")}
    return {name: np.array([table[c] for c in ("t", "dt", "stored", "size")]) for name, table in found.items()}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    done = run(1, str(out))
    assert done.returncode == 0, done.stderr
    return rows(out)


def test_killed_and_resumed(undisturbed, tmp_path):
    """On two ranks, then on one, with the last state kept or all of them, inside a loop: as if nothing had happened."""
    done = run(2, str(tmp_path), "--kill", "34")
    assert done.returncode != 0
    done = run(1, str(tmp_path), "--resume")
    assert done.returncode == 0, done.stderr
    found = rows(tmp_path)
    for name, table in undisturbed.items():
        assert found[name] == pytest.approx(table, rel=1e-7, abs=1e-9), name


def test_only_the_same_path_is_resumed(tmp_path):
    """More steps may follow; the unit of the arc length is part of the path, and a path is no march in time."""
    whole = march(bar(STEEP), ArcLength(end=FAR, first=0.1))
    with pytest.raises(SolveError, match="after 9 steps"):
        march(bar(STEEP), ArcLength(end=FAR, first=0.1, steps=9), out=tmp_path, keep="last")
    for other in (ArcLength(end=FAR, first=0.05), [0.1, FAR]):
        with pytest.raises(ModelError, match=r"is of another march \(first: 0\.1 there"):
            march(bar(STEEP), other, out=tmp_path, resume=True)
    resumed = march(bar(STEEP), ArcLength(end=FAR, first=0.1), out=tmp_path, keep="last", resume=True)
    assert resumed.t == pytest.approx(whole.t, abs=1e-12)
    assert list(resumed.states) == [len(whole) - 1]
    assert sorted(file.stem for file in (tmp_path / "states").iterdir()) == [f"{len(whole) + k:06d}" for k in (-2, -1)]
    assert len(march(bar(STEEP), ArcLength(end=FAR, first=0.1), out=tmp_path, resume=True)) == len(whole)
    with pytest.raises(ModelError, match=r"is at t = 1\.5; the path is to end before"):
        march(bar(STEEP), ArcLength(end=1.0, first=0.1), out=tmp_path, resume=True)


# ---------------------------------------------------------------- bad input
@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"end": math.inf}, "end is inf; allowed: a number$"),
        ({"first": 0.0}, "first is 0.0; allowed: a number > 0"),
        ({"first": "short"}, "first is 'short'"),
        ({"smallest": -1e-3}, "smallest is -0.001; allowed: a number > 0"),
        ({"largest": math.nan}, "largest is nan"),
        ({"largest": 0.1, "smallest": 0.2}, "largest is 0.1; allowed: >= smallest = 0.2"),
        ({"steps": 0}, "steps is 0; allowed: a whole number > 0"),
        ({"steps": 1.5}, "steps is 1.5"),
        ({"back": math.nan}, "back is nan"),
    ],
)
def test_bad_values(values, message):
    with pytest.raises(ModelError, match=f"ArcLength: {message}"):
        ArcLength(**({"end": 1.0, "first": 0.1} | values))


@pytest.mark.parametrize(
    ("path", "options", "message"),
    [
        (ArcLength(0.0, 0.1), {}, "end is 0; it must come after start = 0"),
        (ArcLength(1.0, 0.1), {"start": math.nan}, "it must come after start = nan"),
        (ArcLength(1.0, 2.0), {}, "first is 2; end - start is 1"),
        (ArcLength(1.0, 0.1, back=0.5), {}, "back is 0.5; it must be less than start = 0"),
        (ArcLength(1.0, 0.1), {"theta": 0.5}, "theta = 1"),
        (ArcLength(1.0, 0.1), {"method": "linear"}, "method is 'linear'; a path is followed by Newton's method"),
        (ArcLength(1.0, 0.1), {"options": {"ksp_nonsense": 1}}, "not read"),
        (ArcLength(1.0, 0.1), {"options": {"pc_type": "nonsense"}}, "pc_type nonsense"),
    ],
)
def test_bad_paths(path, options, message, tmp_path):
    with pytest.raises((ModelError, OptionError), match=message):
        march(bar(STEEP), path, out=tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


@dataclass(frozen=True)
class Creeping(TractionLaw):
    """A spring and a dashpot in series, which declares no rate."""

    k: float
    tau: float
    internal: ClassVar = {"flow": (3,)}

    def evolve(self, step):
        x = step.dt / self.tau
        return {"flow": (step.q["flow"] + x * step.w) / (1 + x)}

    def traction(self, step):
        return self.k * (step.mid - self.evolve(step)["flow"])


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (KelvinVoigt(60.0, 40.0, 0.3, 0.5), "KelvinVoigt depends on the strain rate, and t is no time on a path"),
        (Maxwell(60.0, 40.0, t1=0.7), "Maxwell creeps or relaxes, and t is no time on a path"),
        (Creeping(7.0, 0.3), "Creeping creeps or relaxes"),
        (
            MohrCoulomb(60.0, 40.0, cohesion=0.1, friction_angle=30.0),
            "MohrCoulomb bounds stresses: loads come to their limit",
        ),
    ],
)
def test_laws_that_have_no_path(law, message):
    with pytest.raises(ModelError, match=message):
        march(bar(law), ArcLength(1.0, 0.1))


def test_models_that_have_no_path():
    from forms import HolonomicCoulomb

    strip = block(WIDTH, HEIGHT, WIDTH, cell="quadrilateral", structured=True)
    setup = {"body": LinearElastic.young(E, 0.2), "supports": {"TOP": 0.0}}
    soft = Structure(strip, **setup).interface(ThinLayer(Incompressible(40.0), 0.1))
    with pytest.raises(ModelError, match="Incompressible is incompressible: paths have displacements alone"):
        march(soft, ArcLength(1.0, 0.1))
    contact = Structure(strip, element="Q1", **setup).interface(HolonomicCoulomb(7.0, 3.0, friction=0.4))
    with pytest.raises(ModelError, match="HolonomicCoulomb is a contact law: march in time"):
        march(contact, ArcLength(1.0, 0.1))
