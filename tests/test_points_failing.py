"""Points that have no answer fail and are counted; a step at rest or at once is answered or refused."""

from __future__ import annotations

import numpy as np
import pytest

from forms import Stack
from tests.at_points import E2, at_rest, jump_strain, respond
from tests.laws_at_points import ELASTIC, KELVIN, MU, NORTON_15
from tests.own_laws import Fragile


def test_failed_points_are_counted_and_have_no_stress():
    fragile, e = Fragile(MU), np.zeros((5, 6))
    e[:, 0] = [0.1, 0.7, 0.2, 0.9, 0.3]
    for law in (fragile, Stack((0.5, ELASTIC), (0.5, fragile))):
        answer = respond(law, e, 0 * e, at_rest(law, 5), np.tile(E2, (5, 1)))
        assert answer.failed == 2
        assert np.isnan(answer.stress[:, 0]).tolist() == [False, True, False, True, False]
        assert law is not fragile or answer.stress[[0, 2, 4]] == pytest.approx(MU * e[[0, 2, 4]])


def test_laws_with_a_rate_have_no_answer_to_a_sudden_load():
    e, n = jump_strain(np.array([[0.1, 0.2, 0.0]]), E2[None]), E2[None]
    for law in (KELVIN, NORTON_15):
        assert respond(law, e, 0 * e, np.zeros((1, 0)), n, dt=0.0).failed == 1


def test_norton_starts_from_rest():
    """p < 2 at a rate of zero: no stress, a finite tangent that is the largest there is."""
    e, n = np.zeros((1, 6)), E2[None]
    rest = respond(NORTON_15, e, e, np.zeros((1, 0)), n)
    assert rest.failed == 0
    assert not rest.stress.any()
    assert rest.tangent[0, 3, 3] > 1e3 * respond(NORTON_15, e + 1e-3, e, np.zeros((1, 0)), n).tangent[0, 3, 3]
