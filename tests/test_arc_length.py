"""Equilibrium paths by arc length are on the closed forms of bars that snap back, and on one another's for blocks."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tests.refused import refused
from tests.softening_bars import (
    FAR,
    KINKED,
    PATH,
    SHARP,
    STEEP,
    C,
    Damage,
    Fading,
    bar,
    openings,
    sigma,
    tilted,
)
from thinlayer import ArcLength, SolveError, march, piecewise, solve

pytestmark = pytest.mark.few(5)


def turning_points(t, w, law) -> list[tuple[float, float]]:
    """(w, t) where the straight lines of neighbouring branches meet."""
    branch = np.digitize(w, [law.w_1, law.w_2])
    lines = [np.polyfit(w[branch == k], t[branch == k], 1) for k in range(3)]
    meet = [(b[1] - a[1]) / (a[0] - b[0]) for a, b in pairwise(lines)]
    return [(x, np.polyval(line, x)) for x, line in zip(meet, lines[:-1], strict=True)]


# ---------------------------------------------------------------- the bar
SNAPPING = [(STEEP, 0.05, False), (STEEP, 0.13, True), (SHARP, 0.07, False)]


@pytest.mark.parametrize(("law", "first", "backwards"), SNAPPING)
def test_a_bar_that_snaps_back(law, first, backwards):
    """Rows are on the straight branches of t = w + sigma(w) H/E, in their order, for any step and in both directions."""
    support = (lambda x, t: FAR - t) if backwards else (lambda x, t: t)
    history = march(bar(law, support), ArcLength(end=FAR, first=first))
    t = FAR - history.t if backwards else history.t
    w = openings(history)
    assert t == pytest.approx(w + C * sigma(law, w), abs=1e-11)
    assert (np.diff(w) < 0).all() if backwards else (np.diff(w) > 0).all()
    assert history.at(FAR) is history.last
    turns = [(law.w_1, law.w_1 + C * sigma(law, law.w_1)), (law.w_2, law.w_2 + C * sigma(law, law.w_2))]
    assert turns[0][1] > turns[1][1] + 0.2  # it snaps back
    assert np.array(turning_points(t, w, law)) == pytest.approx(np.array(turns), abs=1e-9)
    table = history.table
    assert np.abs(table["imbalance"]).max() < 1e-9
    assert table["residual"].max() < 1e-9
    assert np.cumsum(table["dt"]) == pytest.approx(history.t, abs=1e-12)
    assert (table["dt"] < 0).any()


def test_a_load_that_has_a_limit():
    """The bar under a traction: it rises to the peak of the law, falls, and rises again; t as a load need not be linear."""
    change = lambda t: t + 0.3 * t**2
    history = march(bar(STEEP, traction=lambda x, t: (0.0, change(t))), ArcLength(end=1.0, first=0.04))
    w = openings(history)
    assert change(history.t) == pytest.approx(sigma(STEEP, w), abs=1e-9)
    assert (np.diff(w) > 0).all()
    assert ((w > STEEP.w_1) & (w < STEEP.w_2)).sum() > 5
    assert np.abs(history.table["imbalance"]).max() < 1e-9


def test_piecewise_supports():
    """A path that would leave the times they are known at ends there with an error; difference quotients do not leave."""
    history = march(bar(STEEP, piecewise({0.0: 0.0, 0.3: 0.2, FAR: FAR})), ArcLength(end=FAR, first=0.05))
    w = openings(history)
    assert np.interp(history.t, [0.0, 0.3, FAR], [0.0, 0.2, FAR]) == pytest.approx(w + C * sigma(STEEP, w), abs=1e-9)
    late = piecewise({0.4: 0.4, FAR: FAR})
    words = r"of the path, from t = 0\.4.* a prescribed displacement is not finite at t = 0\."
    refused(SolveError, words, march, bar(STEEP, late), ArcLength(end=FAR, first=0.05), start=0.4)


# ---------------------------------------------------------------- a smooth law
@pytest.mark.few(2)
@pytest.mark.parametrize("first", [0.08, 0.02])
def test_a_law_with_memory(first):
    """Damage: as the bar unloads, S goes on opening, and remembers; the path is that of its envelope, for any step."""
    law = Damage(k=30.0, w_0=0.06, k_T=1.9)
    history = march(bar(law), ArcLength(end=1.0, first=first))
    w, t = openings(history), history.t
    assert t == pytest.approx(w + C * law.k * w * np.exp(-w / law.w_0), abs=1e-9)
    assert (np.diff(w) > 0).all()
    slope = 1 + C * law.k * (1 - w / law.w_0) * np.exp(-w / law.w_0)
    assert np.flatnonzero(np.diff(np.sign(slope))).size == 2  # beyond both turning points
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


@pytest.mark.few(5)
@pytest.mark.parametrize(("k", "w_0", "first"), [(5.4, 0.17, 0.22), (31.0, 0.017, 0.1)])
def test_a_path_goes_on_without_force(k, w_0, first):
    """Forces vanish, on one side first: a path that turned round there would go back along itself."""
    history = march(tilted(Fading(k, w_0)), ArcLength(end=1.0, first=first))
    assert history.last.t == 1
    assert (np.diff(history.t[history.t > 0.5]) > 0).all()
    x = history.model.V.tabulate_dof_coordinates()
    turned = np.column_stack([0.6 * (0.5 - x[:, 1]), 1 + 0.6 * x[:, 0]])  # the block is free, and as stiff as can be
    assert history.last.u.x.array.reshape(-1, 2) == pytest.approx(turned, abs=1e-6)
