"""What is in pictures: their lines are the data."""

from __future__ import annotations

import numpy as np
import pytest

from tests.contact_bars import bar, coulomb
from thinlayer import Table, plotting


def test_rates_have_the_slope_they_say():
    eps = [0.4, 0.2, 0.05]
    table = Table({"eps": e, "error_traction": 3 * e**1.5, "error_jump": 2 * e} for e in eps)
    (axes,) = plotting.rates(table, reference=1.5).axes
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    assert lines["traction"] == pytest.approx(np.column_stack([eps, table["error_traction"]]))
    assert lines["jump"] == pytest.approx(np.column_stack([eps, table["error_jump"]]))
    slopes = np.diff(np.log(lines["slope 1.5"]), axis=0)
    assert slopes[:, 1] / slopes[:, 0] == pytest.approx(1.5)


def test_contact_along_s():
    """Pressure, both displacements over the way along S; openings are upwards; status cells meet half-way."""
    report = bar(8, coulomb("soft"))
    strip, tractions, sliding, opening = plotting.contact(report).axes
    for axes, k, values in ((tractions, 0, report.p), (sliding, 0, report.u_T[:, 0]), (opening, 0, -report.u_N)):
        x, y = axes.lines[k].get_xydata().T
        known = np.isfinite(y)
        assert x == pytest.approx(report.along)
        assert y[known] == pytest.approx(values[known])
        assert known.sum() >= len(y) - 1
    s = report.along
    edges = np.concatenate([s[:1], (s[1:] + s[:-1]) / 2, s[-1:]])
    assert [patch.get_x() for patch in strip.patches] == pytest.approx(edges[:-1])
    assert [patch.get_width() for patch in strip.patches] == pytest.approx(np.diff(edges))
