"""Layers with a pressure, and bodies with projected volume strains, have the same numbers on 1, 2 and 3 ranks."""

from __future__ import annotations

import json

import pytest

from tests.ranks import mpirun
from tests.rubber_run import numbers


@pytest.fixture(scope="module")
def serial():
    return numbers()


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")
@pytest.mark.parametrize("ranks", [2, 3])
def test_same_numbers(serial, ranks):
    done = mpirun(ranks, "-m", "tests.rubber_run")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == pytest.approx(serial, rel=1e-10)
    assert serial["strip Rubber zero pressures"] == 2
    assert serial["held strip Rubber zero pressures"] == 1
