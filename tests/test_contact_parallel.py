"""Contact on 1, 2 and 3 ranks: the same status, and displacements to 1e-8; marches resumed on another number of ranks."""

from __future__ import annotations

import numpy as np
import pytest

from tests.contact_bars import contact
from tests.contact_run import content, contents, resumed, to_and_fro
from tests.on_ranks import on_ranks


@pytest.fixture(scope="module")
def serial():
    return contents()


def require_same(first, second):
    assert first["status"] == second["status"]
    assert first["clapeyron"] == pytest.approx(second["clapeyron"], rel=1e-6, abs=1e-8)
    size = np.abs(first["u_T"]).max() + np.abs(first["u_N"]).max()
    for name in ("u_T", "u_N"):
        assert np.abs(np.subtract(first[name], second[name])).max() <= 1e-8 * size
    for name in ("p", "t_T"):
        assert np.abs(np.subtract(first[name], second[name])).max() <= 1e-6 * np.abs(first["p"]).max()


@pytest.mark.long
@on_ranks(contents, 2, 3)
def test_same_contact(serial, there):
    assert there.keys() == serial.keys()
    for name in there:
        require_same(serial[name], there[name])
    for method in ("newton", "multigrid"):
        require_same(serial["bar None"], serial[f"bar {method}"])


@pytest.mark.long
@on_ranks(resumed, 2)
def test_a_march_goes_on_with_its_slip(serial, there):
    """Stopped on one rank while it slides forth, resumed on two: the slip at the nodes has been kept."""
    require_same(serial["to and fro"], there)
    stopped = content(contact(to_and_fro(last=2.5).last))
    assert np.abs(np.subtract(stopped["u_T"], there["u_T"])).max() > 1e-3
