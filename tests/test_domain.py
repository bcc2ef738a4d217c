"""Joints distributed over MPI ranks."""

from __future__ import annotations

import pytest

from tests.domain_run import compare_tags
from tests.test_parallel import mpirun


def test_tags():
    """Those that DOLFINx distributes."""
    compare_tags()


@pytest.mark.parametrize("ranks", [2, 3])
def test_tags_on_several_ranks(ranks):
    done = mpirun(ranks, "-m", "tests.domain_run")
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "same tags"
