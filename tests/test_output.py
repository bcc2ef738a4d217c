"""Tables, files and pictures."""

from __future__ import annotations

import re
import sys
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from forms.base import InputError
from studies.problems import FOURIER_LAYER, fourier
from tests.refused import refused
from thinlayer import Structure, Surface, Table, ThinLayer, fields, march, plotting, solve, sweep
from thinlayer.output.paraview.grid import gather_grid
from thinlayer.output.plotting.curves import LAW_COLOUR, MESHED_COLOUR
from thinlayer.solving.history import History

pytestmark = pytest.mark.few(5)


def test_rows_are_committed_one_by_one(tmp_path):
    seen = []

    def run(eps):
        seen.append((tmp_path / "t.csv").read_text() if seen else "")
        if len(seen) == 3:
            raise RuntimeError("the third run fails")
        return {"eps": eps, "error_traction": eps**2, "error_jump": 3 * eps, "note": 1.0}

    refused(RuntimeError, "third", lambda: sweep(run, [0.1, 0.4, 0.2], tmp_path / "t.csv"))
    assert seen[2].count("\n") == 3
    table = Table.load(tmp_path / "t.csv")
    assert table.columns == ["eps", "error_traction", "error_jump", "order_traction", "order_jump", "note"]
    assert list(table["eps"]) == [0.4, 0.2]
    assert (table["order_traction"][1], table["order_jump"][1]) == pytest.approx((2.0, 1.0))
    assert np.isnan(table["order_jump"][0])


def test_a_resumed_sweep_keeps_its_rows(tmp_path):
    """Rows are there already: they stay while others are computed, and orders are those of the whole table."""
    seen = []

    def run(eps):
        seen.append(eps)
        if eps == 0.05:
            raise RuntimeError("killed")
        return {"eps": eps, "error_traction": eps**2, "error_jump": 3 * eps}

    path = tmp_path / "t.csv"
    sweep(run, [0.4, 0.1], path)
    refused(RuntimeError, "", sweep, run, [0.4, 0.2, 0.1, 0.05], path, resume=True)
    assert list(Table.load(path)["eps"]) == [0.4, 0.2, 0.1]
    table = sweep(run, [0.2], path, resume=True)
    assert seen == [0.4, 0.1, 0.2, 0.05]
    assert list(table["eps"]) == [0.4, 0.2, 0.1]
    assert table["order_traction"][1:] == pytest.approx([2.0, 2.0])
    for bad in (None, 5, (1, 2)):
        refused(InputError, r"returns is .* it must be a mapping", sweep, lambda e, bad=bad: bad, [0.2])


@pytest.mark.few(1)
@pytest.mark.parametrize("eps", [[], [0.1, 0.1], [0.0, 0.1], [float("inf")], "12", [True], ["1"], None, 0.1])
def test_sweep_refuses_bad_thicknesses(eps):
    refused(InputError, "different thicknesses > 0", lambda: sweep(lambda e: {}, eps))


def test_table():
    table = Table([{"a": 1.0, "b": "x"}, {"a": 2.0, "b": None}])
    assert "a" in str(table)
    refused(ValueError, "does not fit", lambda: table.append({"a": 1.0}))
    refused(KeyError, "unknown column 'c'; known: a, b", lambda: table["c"])


def test_rows_of_a_table_by_the_values_of_a_column():
    rows = [{"law": "soft", "eps": 0.2}, {"law": "hard", "eps": 0.2}, {"law": "soft", "eps": 0.1}]
    parts = Table(rows).split("law")
    assert [*parts] == ["soft", "hard"]
    assert parts["soft"]["eps"] == pytest.approx([0.2, 0.1], rel=1e-15)
    assert [len(part) for part in Table(rows).split("eps").values()] == [2, 1]
    refused(KeyError, "unknown column 'x'; known: eps, law", lambda: Table(rows).split("x"))


def test_a_table_of_columns(tmp_path):
    table = Table(path=tmp_path / "t.csv")
    table.extend(Table.of({"law": "soft", "eps": np.array([0.2, 0.1]), "error": [0.03, None]}))
    assert table.rows == Table.load(tmp_path / "t.csv").rows
    assert table.rows[1] == {"law": "soft", "eps": 0.1, "error": None}
    refused(InputError, "not a 2, b 3", lambda: Table.of({"a": [1, 2], "b": [1, 2, 3]}))


def test_tables_are_printed_as_they_are():
    table = Table([{"slip [mm]": 1.0, "a": "x"}, {"slip [mm]": 0.123456, "a": None}])
    assert str(table).splitlines() == ["slip [mm]  a", "        1  x", "   0.1235"]
    whole = Table([{"unknowns": 56830, "E": 2.1e11, "eps": -2.5e-9}])
    assert str(whole).splitlines()[1].split() == ["56830", "2.1e+11", "-2.5e-09"]
    refused(InputError, "must be texts, not 1", lambda: Table([{1: 2.0}]))


def test_tables_in_notebooks(monkeypatch):
    table = Table([{"a<b": 1.0, "law": "x"}, {"a<b": None, "law": "y & z"}])
    cells = re.findall("<(t[rdh])>([^<]*)", table._repr_html_())
    assert cells == [("tr", ""), ("th", "a&lt;b"), ("th", "law"), ("tr", ""), ("td", "1"), ("td", "x"),
                     ("tr", ""), ("td", ""), ("td", "y &amp; z")]  # fmt: skip
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=lambda rows, columns: (rows, columns)))
    assert table.to_pandas() == (table.rows, ["a<b", "law"])


@pytest.mark.few(1)
@pytest.mark.parametrize("text", ["x,y", "x\ny", "x\ry", "x\r\ny", "x\u2028y", "x\x0cy", "x\x85y", '"', " x "])
def test_texts_are_read_as_they_were_written(tmp_path, text):
    table = Table([{"a": text, "b": 1.5}, {"a": None, "b": 2.0}])
    path = tmp_path / "t.csv"
    table.write(path)
    assert Table.load(path).rows == table.rows


@pytest.fixture(scope="module", params=[("triangle", "P1"), ("triangle", "P2"), ("quadrilateral", "S2")])
def states(request):
    cell, element = request.param
    joint, setup = fourier(1 / 8, cell=cell)
    layer = ThinLayer(FOURIER_LAYER, 0.1, at=1.0)
    structure = Structure(joint, element=element, **setup)
    return [solve(structure.full(layer)), solve(structure.interface(layer))]


def test_gathered_field_keeps_the_jump(states):
    full, limit = states
    grid = gather_grid(limit)
    at_s = grid.u[np.abs(grid.points[:, 1]) < 1e-12]
    x = grid.points[np.abs(grid.points[:, 1]) < 1e-12][:, 0]
    assert len(x) == 2 * len(np.unique(x.round(12)))
    surface = Surface(limit.model)
    place, jump = surface.profile(surface.jump(limit))
    first = at_s[np.lexsort((at_s[:, 1], x.round(12)))][:2]
    assert abs(first[1, 1] - first[0, 1]) == pytest.approx(abs(jump[0, 1]), rel=2e-2)
    assert place[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert set(np.unique(gather_grid(full).region)) == {0, 1, -1}


def test_states_stay_what_they_are_as_they_are_written(states, tmp_path):
    history = march(states[0].model, [1.0, 2.5])
    for k, state in enumerate(history):
        state.u.x.array[:] *= k + 1.5
        state.u.name = "mine"
    before = [state.u.x.array.copy() for state in history]
    fields.write(history, tmp_path / "history.pvd")
    for state, values in zip(history, before, strict=True):
        assert np.array_equal(state.u.x.array, values)
        assert state.u.name == "mine"


@pytest.mark.few(1)
def test_there_must_be_something_to_draw_and_to_write(states, tmp_path):
    history = march(states[1].model, [1.0])
    for words, call, nothing in (
        (r"deformed: .* is ", plotting.deformed, ({}, history, {"a": history})),
        (r"rates: (table is empty|.*no row, or no column .*error_traction)", plotting.rates, ({}, Table())),
        (r"is nothing to write|give a state or a history", partial(fields.write, path=tmp_path / "a.pvd"),
         (History(history.model), {"a": states[1]})),
    ):  # fmt: skip
        for thing in nothing:
            refused(InputError, words, call, thing)
    assert len(repr(history)) < 120
    assert len(repr(states[0])) < 120


@pytest.mark.few(5)
def test_pictures(states, tmp_path):
    full, limit = states
    plotting.deformed({"meshed": full, "law": limit}, plotting.View("y"), save=tmp_path / "d.png", title="t")
    image = imread(tmp_path / "d.png")[..., :3]
    orange, blue = (np.abs(image - to_rgb(colour)).max(axis=2) < 0.1 for colour in (MESHED_COLOUR, LAW_COLOUR))
    half = image.shape[1] // 2
    assert orange[:, :half].sum() > 500  # the outline of the meshed layer
    assert blue[:, half:].sum() > 500  # the sides of S
    assert not orange[:, half:].any()
    with pytest.raises(ValueError, match="allowed: size, x, y"):
        plotting.deformed(full, plotting.View("normal"), save=tmp_path / "e.png")
    refused(ValueError, "nothing to draw", lambda: plotting.deformed(full, plotting.View(zoom=(5, 6, 5, 6))))
    assert not (tmp_path / "e.png").exists()
