"""What is in pictures: their lines are the data."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from tests.contact_bars import bar, coulomb
from thinlayer import ModelError, Table, plotting


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


def test_maps_have_a_colour_for_each_range():
    """Cells by the range of their value, the first row lowest, with their texts; what is no number stays white."""
    values = [[0.5, 1.5, np.nan], [2.5, 0.2, 7.0]]
    texts = [["a", "b", ""], ["c", "d", "e"]]
    given = {"x": ["1", "2", "3"], "y": ["low", "high"], "xlabel": "x", "ylabel": "y"}
    picture = plotting.maps({"one": values}, texts={"one": texts}, levels=(1, 2), names=list("LMH"), **given)
    (axes,) = picture.axes
    (mesh,) = axes.collections
    colours = mesh.to_rgba(mesh.get_array()).reshape(2, 3, 4)
    low, middle, high = (to_rgba(patch.get_facecolor()) for patch in picture.legends[0].get_patches())
    assert colours[0, :2].tolist() == [list(low), list(middle)]
    assert colours[1].tolist() == [list(high), list(low), list(high)]
    assert colours[0, 2, 3] == 0
    assert {text.get_text(): text.get_position() for text in axes.texts} == {
        "a": (0.5, 0.5), "b": (1.5, 0.5), "": (2.5, 0.5), "c": (0.5, 1.5), "d": (1.5, 1.5), "e": (2.5, 1.5)
    }  # fmt: skip
    for wrong in ({"levels": (2, 1)}, {"names": ["L", "H"]}, {"x": ["1", "2"]}, {"texts": {}}):
        with pytest.raises(ModelError, match="maps"):
            plotting.maps(
                {"one": values}, **({"texts": {"one": texts}, "levels": (1, 2), "names": list("LMH")} | given | wrong)
            )
