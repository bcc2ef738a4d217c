"""Contact does not depend on proportional steps, mirrors, turns, or which body is the lower one."""

from __future__ import annotations

import numpy as np
import pytest

from forms import HolonomicCoulomb, IncrementalCoulomb
from studies.problems import sliding_bar
from tests.contact_bars import SOLVERS, solved, stacked
from thinlayer import Structure, Surface, march

pytestmark = pytest.mark.few(5)


@pytest.mark.parametrize("kind", [HolonomicCoulomb, IncrementalCoulomb])
def test_one_step_is_ten_proportional_steps(kind):
    joint, setup = sliding_bar(12)
    law = kind(4e5, 6e4, 0.6)
    once = solved(joint, law, setup)
    growing = {"LEFT": lambda x, t: (100 * t, 0), "TOP": lambda x, t: (0, -50 * t)}
    history = march(Structure(joint, **setup | {"tractions": growing}).interface(law), [0.1 * k for k in range(1, 11)])
    last = Surface(history.last.model).contact(history.last)
    assert last.u_T == pytest.approx(once.u_T, rel=1e-7, abs=1e-11)
    assert (last.status == once.status).all()
    if kind is IncrementalCoulomb:
        table = history.table
        assert np.nanmax(np.abs(table["imbalance"])) < 1e-9
        assert (table["dissipated"] > -1e-12).all()
        assert table["dissipated"][-1] > 0


@pytest.mark.parametrize("method", SOLVERS)
def test_swapped_bodies(method):
    """Calling the upper body the lower one turns n: the same jumps, seen from the other side."""
    law = HolonomicCoulomb(7e4, 2e4, 0.5)
    joint, setup = stacked()
    original = solved(joint, law, setup, method=method)
    swapped = solved(joint.swapped(), law, setup, method=method)
    assert {"separated", "sliding"} <= {*original.status}
    at = np.argsort(original.x[:, 0]), np.argsort(swapped.x[:, 0])
    assert swapped.p[at[1]] == pytest.approx(original.p[at[0]], rel=1e-7, abs=1e-7)
    assert np.abs(swapped.u_T[at[1]]) == pytest.approx(np.abs(original.u_T[at[0]]), rel=1e-7, abs=1e-11)
    assert (swapped.status[at[1]] == original.status[at[0]]).all()
    assert swapped.force == pytest.approx(-original.force, rel=1e-7)


@pytest.mark.parametrize("angle", [0.4, 2.5])
def test_rotated_structure(angle):
    """Frames of nodes: the same answer when everything is turned, supports by coordinates apart."""
    joint, setup = stacked("triangle")
    setup["supports"] = {"BOTTOM": 0.0}
    law = HolonomicCoulomb(7e4, 2e4, 0.5)
    setup["tractions"] = {"TOP": (5.0, -12.0)}
    original = solved(joint, law, setup)
    c, s = np.cos(angle), np.sin(angle)
    turned = joint.rotated(angle), law, setup | {"tractions": {"TOP": (5 * c + 12 * s, 5 * s - 12 * c)}}
    rotated = solved(*turned)
    assert rotated.force == pytest.approx(np.array([[c, -s], [s, c]]) @ original.force, rel=1e-6)
    assert solved(*turned, method="relaxation").u_T == pytest.approx(rotated.u_T, rel=1e-6, abs=1e-9)
    for report in (original, rotated):
        (line,) = report.surface.along(report.p)
        assert line.length == pytest.approx(6.0)
    way = slice(None, None, 1 if np.cos(angle) > 0 else -1)  # a report starts at the lower coordinates
    assert rotated.p[way] == pytest.approx(original.p, rel=1e-6, abs=1e-6)
    assert rotated.u_T[way] == pytest.approx(original.u_T, rel=1e-6, abs=1e-10)
