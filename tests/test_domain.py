"""Joints distributed over MPI ranks."""

from __future__ import annotations

import pytest

from studies import setup_time
from tests.domain_run import compare_tags
from tests.ranks import mpirun


def test_tags():
    """Those that DOLFINx distributes."""
    compare_tags()


@pytest.mark.parametrize("ranks", [2, 3])
def test_tags_on_several_ranks(ranks):
    done = mpirun(ranks, "-m", "tests.domain_run")
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "same tags"


def test_benchmark():
    rows = setup_time.compare("2D", 20, 1)
    assert [row["work"] for row in rows] == ["joint", "structure", "model", "stiffness", "plain script"]
    assert rows[0]["dofs"] == 2 * 21 * 22
