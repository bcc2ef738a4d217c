"""Paths of joints that break: few steps, no way back to rest, and a run that has ended goes on to the same table."""

from __future__ import annotations

import numpy as np
import pytest

from forms import Cohesive, LinearElastic
from geometry import block, sandwich
from tests.mpirun import Ended, Ending
from tests.refused import refused
from thinlayer import ArcLength, Structure, march


def bar(cells: int):
    """A bar on a layer, b 1, EA 1000, pulled by t at an end; it softens from there."""
    joint = block(20.0, 0.1, 20 / cells, cell="quadrilateral", structured=True)
    setup = {"body": LinearElastic.young(1e4, 0.0), "element": "Q1"}
    supports = {"RIGHT": {"x": lambda x, t: t}, "TOP": {"y": 0.0}}
    return Structure(joint, supports=supports, **setup).interface(Cohesive(100.0, 100.0, 1.0, 1.0, 0.05, 0.05))


def test_a_bar_that_snaps_back():
    """Straight stretches, elastic or along one point that breaks, take few steps; those where it bends are as short."""
    observe = {"F": lambda state: state.reaction("RIGHT").force[0]}
    table = march(bar(200), ArcLength(end=0.25, first=0.02), observe=observe, keep="last").table
    assert len(table["t"]) <= 30
    assert table["F"].max() == pytest.approx(9.98858149, rel=1e-3)
    falling = table["broken"] < 1
    assert table["t"][falling].max() == pytest.approx(0.14838754, rel=1e-3)
    assert table["dissipated"].sum() == pytest.approx(0.05 * 20, rel=1e-9)
    steps = np.diff(table["t"])
    assert steps[-2] > 2 * 0.02  # where all is broken
    assert steps[: np.flatnonzero(falling)[-1]].max() <= 0.02 * 1.01


def lap(G: float, cells: int):
    """A lap joint whose fracture zone is shorter than a facet."""
    joint = sandwich(10.0, 1.0, 1.0, 1.0, h_S=10 / cells, cell="quadrilateral", structured=True)
    supports = {"RIGHT/LOWER": 0.0, "LEFT/UPPER": {"y": 0.0, "x": lambda x, t: -t}}
    setup = {"body": LinearElastic.young(1e3, 0.0), "element": "Q1"}
    return Structure(joint, supports=supports, **setup).interface(Cohesive(100.0, 100.0, 1.0, 1.0, G, G))


@pytest.mark.filterwarnings("ignore:.*fracture zone")
def test_a_path_does_not_lead_back_to_rest():
    """Where all that softens would unload, the path goes on where it breaks; and where all is broken, to larger t.

    Wrong twin: the sign of the angle with the last step, which has led to t = -0.04.
    """
    table = march(lap(0.007, 6), ArcLength(end=0.3, first=0.02)).table
    assert table["t"].min() == 0.0
    assert (table["broken"][-1], table["t"][-1]) == (1.0, pytest.approx(0.3))
    assert table["dissipated"].sum() == pytest.approx(0.007 * 10, rel=1e-6)
    unchanged = (table["dissipated"] < 1e-12) & (np.diff(table["t"], prepend=0.0) < 0)
    assert not unchanged.any()


def test_ended_and_resumed(tmp_path):
    """Amid the snap-back."""
    path, ending = ArcLength(end=0.25, first=0.04), Ending(9, raises=True)
    observed = {"F": lambda state: ending.at_row() or 0.0}
    refused(Ended, "", march, bar(20), path, observe=observed, out=tmp_path, keep="last")
    resumed = march(bar(20), path, observe=observed, out=tmp_path, keep="last", resume=True).table
    whole = march(bar(20), path, observe=observed).table
    for name in ("t", "dt", "supplied", "stored", "dissipated", "broken"):
        assert resumed[name] == pytest.approx(whole[name], rel=1e-12, abs=1e-14), name
