"""A point driven by jumps or tractions follows the closed formulas, switches at thresholds, and shares with sublayers."""

from __future__ import annotations

import numpy as np
import pytest

from forms import NonMonotone
from tests.closed_forms import NonMonotoneLimit
from tests.non_monotone_points import (
    ALPHA,
    CHI2,
    CHI3,
    LMBDA,
    MU,
    PATHS,
    PURE,
    C,
    from_layer_axes,
    in_layer_axes,
    pulled,
)
from thinlayer import drive


@pytest.mark.parametrize("n", [(0, 1), (0, -1), (3, -4), (0, 1, 0), (0, -1, 0), (1, 2, -2)], ids=str)
def test_drive_is_the_closed_formula(n):
    """Along jumps, and with mixing = 1 along tractions, which have one jump each."""
    d = len(n)
    chi, path = (CHI2, CHI3)[d - 2], np.array(PATHS[d])
    limit = NonMonotoneLimit(LMBDA, MU, ALPHA, C, chi, np.eye(d)[1])
    for mixing in (0.4, 1.0):
        law = NonMonotone(LMBDA, MU, ALPHA, C, chi, mixing=mixing)
        history = drive(law, pulled("w", path), n)
        t, phase = limit.relaxed(in_layer_axes(path), mixing)
        assert history.tractions == pytest.approx(from_layer_axes(t), rel=1e-12, abs=1e-13)
        assert history.memory[:, 0] == pytest.approx(phase, abs=1e-13)
        energy = limit.energy(in_layer_axes(path), phase, mixing)
        assert history.energies[:, 0] == pytest.approx(energy, rel=1e-11)
        work = np.sum(history.tractions * np.diff(path, axis=0, prepend=0), axis=1)
        assert work == pytest.approx(np.diff(energy, prepend=0) + history.energies[:, 2], rel=1e-10, abs=1e-14)
        assert {-1, 0, 1} <= set(phase)
        assert mixing < 1 or any(0.1 < abs(z) < 0.9 for z in phase)
    back = drive(law, pulled("t", history.tractions), n)
    assert back.jumps == pytest.approx(path, rel=1e-9, abs=1e-11)
    assert back.tractions == pytest.approx(history.tractions, rel=1e-9, abs=1e-11)
    assert back.memory == pytest.approx(history.memory, abs=1e-9)


def test_pure_phases_have_the_closed_formula():
    """Where each of them holds, and no other one."""
    law, path = PURE["2D"], np.array(PATHS[2])
    history = drive(law, pulled("w", path))
    t, z = history.tractions, history.memory[:, 0]
    assert set(z) == {-1, 0, 1}
    for phase in (-1, 0, 1):
        formula, holds = NonMonotoneLimit(LMBDA, MU, ALPHA, C, CHI2, np.eye(2)[1]).pure(path, phase)
        assert (holds == (z == phase)).all()
        assert t[holds] == pytest.approx(formula[holds], rel=1e-12)


def test_pure_phases_switch_at_the_jump_where_their_energies_are_equal():
    """alpha chi:E = C, up and back, both signs; a jump at the threshold keeps the phase that was there."""
    law, direction = PURE["2D"], np.array([0.3, 1.0])
    threshold = C / (ALPHA * direction @ CHI2[:, 1])
    sizes = np.array([1 - 1e-9, 1, 1 + 1e-9, 1, 1 - 1e-9, -1 + 1e-9, -1, -1 - 1e-9, -1, 3, 0, -3, 1e-3])
    phases = [0, 0, 1, 1, 0, 0, 0, -1, -1, 1, 0, -1, 0]
    assert drive(law, pulled("w", threshold * sizes[:, None] * direction)).memory[:, 0].tolist() == phases
    assert drive(law, pulled("w", threshold * sizes[:, None] * direction), (-0.6, 0.8)).memory[:, 0].tolist() == phases


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", ["2D", "n (x) n", "sym(tangent (x) n)", "3D"])
def test_hysteresis_under_prescribed_traction(name, sign):
    """Up at alpha chi n.K^-1 t = C, down where it is C - g_n; g_n = alpha^2 chi n.K^-1 chi n is lost, half each way."""
    law = PURE[name]
    d = len(law.chi)
    K = MU * np.eye(d) + (LMBDA + MU) * np.diag(np.eye(d)[1])
    b = ALPHA * law.chi[:, 1]
    g_n = b @ np.linalg.solve(K, b)
    direction = np.array([0.4, 1.0, 0.3])[:d]
    drive_of = b @ np.linalg.solve(K, direction)
    up, down = C / drive_of, (C - g_n) / drive_of
    if name == "n (x) n":
        assert (up, down) == pytest.approx((140 * C / ALPHA, 140 * C / ALPHA - ALPHA))
    least = 1e-9 * abs(up)
    sizes = np.array([up - least, up + least, 2 * up, up, down + least, down - least, down + least, up - least, 0])
    path = sign * sizes[:, None] * direction
    history = drive(law, pulled("t", from_layer_axes(path)), np.eye(d)[1])
    assert history.memory[:, 0].tolist() == [0, sign, sign, sign, sign, 0, 0, 0, 0]
    expected = np.linalg.solve(K, path.T).T + history.memory[:, :1] * np.linalg.solve(K, b)
    assert in_layer_axes(history.jumps) == pytest.approx(expected, rel=1e-9, abs=1e-12)
    stored, dissipated, remainder = history.energies.T
    t, change = history.tractions, np.diff(history.jumps, axis=0, prepend=0)
    work = np.sum(t * change, axis=1)
    assert work == pytest.approx(np.diff(stored, prepend=0) + dissipated + remainder, abs=1e-13)
    assert (dissipated == 0).all()
    assert remainder[[1, 5]] == pytest.approx(g_n / 2 * np.ones(2), rel=1e-6)
    middles = t - np.diff(t, axis=0, prepend=0) / 2
    assert np.sum(middles * change) == pytest.approx(g_n, rel=1e-6)
