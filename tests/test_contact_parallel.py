"""Contact on 1, 2 and 3 ranks: the same status, and displacements to 1e-8; marches resumed on another number of ranks."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.contact_run import content, reports, to_and_fro
from tests.ranks import mpirun
from thinlayer.output.contact_report import ContactReport


def run(ranks: int, *arguments: str):
    done = mpirun(ranks, "-m", "tests.contact_run", *arguments)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def serial():
    return {name: content(report) for name, report in reports().items()}


def require_same(one, two):
    assert one["status"] == two["status"]
    size = np.abs(one["u_T"]).max() + np.abs(one["u_N"]).max()
    for name in ("u_T", "u_N"):
        assert np.abs(np.subtract(one[name], two[name])).max() <= 1e-8 * size
    for name in ("p", "t_T"):
        assert np.abs(np.subtract(one[name], two[name])).max() <= 1e-6 * np.abs(one["p"]).max()


@pytest.mark.parametrize("ranks", [2, 3])
def test_same_contact(serial, ranks):
    found = run(ranks)
    assert found.keys() == serial.keys()
    for name in found:
        require_same(serial[name], found[name])
    for method in ("newton", "multigrid"):
        require_same(serial["bar None"], serial[f"bar {method}"])


def test_a_march_goes_on_with_its_slip(serial, tmp_path):
    """Stopped while it slides forth, resumed on two ranks: the slip at the nodes has been kept."""
    stopped = content(ContactReport(to_and_fro(tmp_path, 2.5).last))
    resumed = run(2, str(tmp_path), "4")["resumed"]
    require_same(serial["to and fro"], resumed)
    assert np.abs(np.subtract(stopped["u_T"], resumed["u_T"])).max() > 1e-3
