"""The studies of contact: contracts of their tables, checks that hold and that can fail."""

from __future__ import annotations

import pytest

from studies import fig8_friction, performance, relaxation
from thinlayer.running.cli import main


@pytest.mark.long
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
    assert rows[0]["dofs"] == 3 * 7**3
    bench.close()
