"""The studies' own means: contracts of their tables, checks that hold and that can fail, lines and polygons."""

from __future__ import annotations

import re

import numpy as np
import pytest

from studies import fig8_friction, friction_cost, performance, relaxation, worth_it
from studies.by_hand import CHOLESKY, K_N, LOAD, TwoBlocks, by_hand
from studies.dropped import ignore_range_warnings
from studies.other_programs import ngsolve, scikit_fem
from studies.problems import FOURIER_LAYER, layer_fn
from studies.snap import polygon_distances
from studies.sweeping import Sweep
from tests.documents import PAGES
from thinlayer.running.cli import main
from thinlayer.running.record import Record


def test_a_short_study_holds_what_it_promises(tmp_path):
    """Stiff laws bond and those without tangential stiffness slide; `tests/test_validation.py` runs others."""
    assert main(["run", "limits", "--quick", "--out", str(tmp_path)]) == 0


@pytest.mark.long
def test_figure_8_on_one_mesh_fails_its_checks_with_other_numbers(tmp_path, monkeypatch):
    monkeypatch.setattr(fig8_friction, "FRICTION", 0.95)
    assert main(["run", "fig8_friction", "--out", str(tmp_path)]) == 1


def test_a_sweep_has_the_errors_of_further_laws(tmp_path):
    """Those of order 0 beside those of order 1."""
    row = Sweep(layer_fn(FOURIER_LAYER, order=1), h=(1 / 8, 1 / 8), layer_variants={"_order0": layer_fn(FOURIER_LAYER)})
    with Record("rates", tmp_path, {}) as record:
        table = row.compare_all(record, "elastic", [1 / 16], quick=True, pictured=False)
    for name in ("error_traction", "error_jump"):
        assert table[f"{name}_order0"][0] > 3 * table[name][0]


def test_sweeps_and_failures():
    assert relaxation.count_sweeps(8, 15e4, 5e4, 1.8, 1.0) == (90, True)  # independent code: 90, and 621
    assert relaxation.count_sweeps(8, 15.0, 5.0, 1.9, 1.0) == (621, True)  # forces balance some sweeps later
    sweeps, converged = relaxation.count_sweeps(8, 15e8, 5e8, 1.95, 1.95)
    assert not converged
    assert sweeps < relaxation.MAX_SWEEPS


@pytest.mark.parametrize("dim", [2, 3])
def test_the_script_by_hand_has_the_energy_of_the_interface_model(dim):
    script, law, stiffer = by_hand(4, dim, CHOLESKY), *(performance.on_s(4, dim, k, {}) for k in (1.0, 1.1))
    assert script["energy"] == pytest.approx(law["energy"], rel=1e-9)
    assert script["energy"] != pytest.approx(stiffer["energy"], rel=1e-3)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(("module", "program"), [("ngsolve", ngsolve), ("skfem", scikit_fem)])
def test_other_programs_have_the_energy_of_the_script(module, program, dim):
    pytest.importorskip(module)
    assert program(4, dim)["energy"] == pytest.approx(by_hand(4, dim, CHOLESKY)["energy"], rel=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_arrays_for_other_programs(dim):
    """The work of springs as the upper block is lifted by 1, the load, the supports."""
    blocks = TwoBlocks(4, dim)
    numbers, lift = np.arange(blocks.points.size).reshape(-1, dim)[::-1], np.zeros(blocks.points.size)
    lift[numbers[len(numbers) // 2 :, 1]] = 1.0
    rows, columns, values = blocks.spring_entries(numbers)
    assert np.sum(lift[rows] * values * lift[columns]) == pytest.approx(K_N, rel=1e-12)
    assert blocks.load.sum(axis=0) == pytest.approx(LOAD[:dim], rel=1e-12)
    assert blocks.is_fixed.sum(axis=0).tolist() == [(5 + 2 * 5) * 5 ** (dim - 2), *[5 ** (dim - 1)] * (dim - 1)]


def test_benchmark_runs(monkeypatch):
    """Its rows, not its times."""
    bench = friction_cost.Bench(friction_cost.bar(6, depth=True))
    rows = bench.compare("friction 3D", 1, 1.3)
    assert [row["work"] for row in rows] == ["friction 3D", "friction 3D, status predicted"]
    assert rows[0]["unknowns"] == 3 * 7**3
    bench.close()
    monkeypatch.setattr(friction_cost, "BRICKS", (1, 2, (1.0, 0.5)))
    (row,) = friction_cost.friction("friction in 217 bricks", 4, 1)
    assert row["unknowns"] == 2 * (9 * 5 + 2 * 5 * 5)


def test_distance_from_a_polygon():
    """Over the size of each component: 4 and 2 here."""
    polygon = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 2.0]])
    points = np.array([[2.0, 0.0], [2.0, 0.5], [4.4, 1.0], [-0.4, 0.0], [4.0, 2.4]])
    assert polygon_distances(points, polygon) == pytest.approx([0, 0.25, 0.1, 0.1, 0.2], abs=1e-14)


def test_the_page_on_worth_has_the_numbers_of_the_study(tmp_path):
    """Unknowns and errors of the lap joint, of two digits; its checks hold."""
    text = PAGES["thinlayer/docs/theory/worth_it.md"]
    printed = re.findall(r"^ {4}.{16}  (.{17}) +(\S+) +\S+ +(\S+) +(\S+) +(\S+)$", text, re.MULTILINE)
    with Record("worth_it", tmp_path, {}) as record, ignore_range_warnings():
        rows = worth_it.compare_models(record, "lap joint", 1)
    for (label, row), words in zip(rows.items(), printed[1:], strict=False):
        errors = [100 * row[f"error {name}"] for name in ("energy", "traction", "traction inside")]
        assert words[0].strip() == label
        assert [float(word) for word in words[1:]] == pytest.approx([row["unknowns"], *errors], rel=0.06), label
    assert len(rows) == 6
    assert len(printed) == 1 + 2 * 6 + 2 * 5
    assert not record.failures
