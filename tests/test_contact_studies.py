"""The studies of contact: contracts of their tables, checks that hold and that can fail."""

from __future__ import annotations

import json

import numpy as np
import pytest

from studies import fig8_friction, performance, relaxation
from thinlayer.files.table import Table
from thinlayer.running.cli import main


def test_figure_8(tmp_path):
    assert main(["run", "fig8_friction", "--out", str(tmp_path)]) == 0
    table = Table.load(tmp_path / "table.csv")
    assert table.columns == ["lmbda", "mu", "x_mm", "u_T_mm", "u_N_mm", "p_MPa", "t_MPa", "status"]
    stiff = [row for row in table.rows if row["lmbda"] == 15e8]
    assert [row["status"] for row in stiff] == ["separated"] * 3 + ["sliding"] * 15 + ["stick"] * 13 + ["pinned"]
    x = [row["x_mm"] for row in stiff]
    assert x == pytest.approx(np.linspace(0, 40, 32), abs=1e-9)
    for row in table.rows:
        assert row["p_MPa"] >= 0
        assert row["p_MPa"] == pytest.approx((row["lmbda"] + 2 * row["mu"]) * max(row["u_N_mm"], 0), rel=1e-12)
        assert abs(row["t_MPa"]) <= row["p_MPa"] * (1 + 1e-12)
    run = json.loads((tmp_path / "run.json").read_text())
    counts = {(c["squares"], c["lmbda"]): (c["separated"], c["sliding"], c["stick"]) for c in run["results"]["counts"]}
    assert [counts[31, lmbda] for lmbda in (15e8, 15e4, 15)] == [(3, 15, 13), (2, 14, 15), (0, 0, 31)]
    for name in ("fig8", "contact", "deformed", "gap"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


def test_figure_8_on_one_mesh_fails_its_checks_with_other_numbers(tmp_path, monkeypatch):
    monkeypatch.setattr(fig8_friction, "FRICTION", 0.95)
    assert main(["run", "fig8_friction", "--out", str(tmp_path)]) == 1


def test_sweeps_and_failures():
    assert relaxation.count(8, 15e4, 5e4, 1.8, 1.0) == (90, True)  # independent code: 90
    sweeps, converged = relaxation.count(8, 15e8, 5e8, 1.95, 1.95)
    assert not converged
    assert sweeps < relaxation.MAX_SWEEPS


def test_benchmark_runs(monkeypatch):
    """Its rows, not its times."""
    bench = performance.Bench(6, depth=True)
    rows = bench.compare("3D", 1)
    assert [row["work"] for row in rows] == ["friction 3D", "friction 3D, status predicted"]
    assert {"work", "dim", "dofs", "seconds", "reference_seconds", "ratio", "peak_mb"} <= rows[0].keys()
    assert rows[0]["dofs"] == 3 * 7**3
    bench.close()
