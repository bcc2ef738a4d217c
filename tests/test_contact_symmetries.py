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
    one = solved(joint, law, setup, method=method)
    two = solved(joint.swapped(), law, setup, method=method)
    assert {"separated", "sliding"} <= {*one.status}
    at = np.argsort(one.x[:, 0]), np.argsort(two.x[:, 0])
    assert two.p[at[1]] == pytest.approx(one.p[at[0]], rel=1e-7, abs=1e-7)
    assert np.abs(two.u_T[at[1]]) == pytest.approx(np.abs(one.u_T[at[0]]), rel=1e-7, abs=1e-11)
    assert (two.status[at[1]] == one.status[at[0]]).all()
    assert two.force == pytest.approx(-one.force, rel=1e-7)


@pytest.mark.parametrize("angle", [0.4, 2.5])
def test_rotated_structure(angle):
    """Frames of nodes: the same answer when everything is turned, supports by coordinates apart."""
    joint, setup = stacked("triangle")
    setup["supports"] = {"BOTTOM": 0.0}
    law = HolonomicCoulomb(7e4, 2e4, 0.5)
    setup["tractions"] = {"TOP": (5.0, -12.0)}
    one = solved(joint, law, setup)
    c, s = np.cos(angle), np.sin(angle)
    turned = joint.rotated(angle), law, setup | {"tractions": {"TOP": (5 * c + 12 * s, 5 * s - 12 * c)}}
    two = solved(*turned)
    assert two.force == pytest.approx(np.array([[c, -s], [s, c]]) @ one.force, rel=1e-6)
    assert solved(*turned, method="relaxation").u_T == pytest.approx(two.u_T, rel=1e-6, abs=1e-9)
    for report in (one, two):
        (line,) = report.surface.along(report.p)
        assert line.length == pytest.approx(6.0)
    way = slice(None, None, 1 if np.cos(angle) > 0 else -1)  # a report starts at the lower coordinates
    assert two.p[way] == pytest.approx(one.p, rel=1e-6, abs=1e-6)
    assert two.u_T[way] == pytest.approx(one.u_T, rel=1e-6, abs=1e-10)
