"""The study of bodies that yield: its parts on coarse meshes, and checks that can fail."""

from __future__ import annotations

import numpy as np
import pytest

from studies import punch
from thinlayer.running.record import Record


@pytest.fixture
def record(tmp_path):
    return Record("punch", tmp_path, {})


def test_the_punch_comes_nearer_to_its_limit(record):
    punch.solve_punch(record, (2, 4))
    nearest, ratio = record.checks
    assert 1 < nearest.value < 1.06
    assert ratio.value < 0.6
    table = record.load("punch.csv")
    assert np.all(np.diff(table["pressure"][table["n"] == 4]) > 0)


def test_both_cylinders_follow_the_closed_form(record):
    punch.solve_cylinders(record, 0.15)
    assert not record.failures
    assert max(check.value for check in record.checks) < 0.008
    assert len(record.load("cylinder.csv")) == 2 * len(punch.PRESSURES)


def test_another_strength_fails(record, monkeypatch):
    """Tresca's strength in tension for von Mises' one: k = Y/2."""
    monkeypatch.setattr(punch, "CYLINDER", punch.CYLINDER._replace(k=punch.YIELD_STRENGTH / 2))
    monkeypatch.setattr(punch, "PRESSURES", (0.7, 1.0))
    punch.solve_cylinders(record, 0.3)
    assert len(record.failures) == 3
