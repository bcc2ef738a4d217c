"""Constants of free ends: a solver of the half strip, the table that comes with the package, and independent numbers."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.linalg import solveh_banded

from forms.base import InputError
from forms.ends import free_end
from forms.ends.constants import TABLE_COLUMNS, flow_factor
from forms.ends.corner import CornerField
from studies.free_ends import compute_free_end
from tests.refused import refused

DEGREE, LEVELS = 8, 8  # errors below 1e-8: the corner's energy is r^1.4 to r^1.2, r = 0.5 * 0.2^8
ROUGH = 1e-7

# nu: c_N, m_N/c_N, rho_N, c_T, m_T/c_T, kappa, from another program with rectangles and without pressures
INDEPENDENT = {
    0.1: (0.0057054, 2.09121, 0.46214, 0.1884879, 0.29156, 0.12656),
    0.2: (0.0310086, 1.17740, 0.49614, 0.1743609, 0.31741, 0.27692),
    0.25: (0.0580806, 1.01155, 0.52273, 0.1665238, 0.33398, 0.36432),
    0.3: (0.1030566, 0.91874, 0.56109, 0.1580654, 0.35394, 0.46250),
    0.35: (0.1800097, 0.88064, 0.62085, 0.1488812, 0.37843, 0.57396),
    0.4: (0.3231996, 0.90673, 0.72720, 0.1388367, 0.40915, 0.70111),
    0.45: (0.6566173, 1.08395, 0.98087, 0.1277548, 0.44882, 0.84725),
    0.475: (1.1062059, 1.40878, 1.35135, 0.1217526, 0.47333, 0.93127),
    0.49: (1.935362, 2.11514, 2.09657, 0.1179827, 0.48999, 0.99003),
    0.499: (6.4548514, 6.47851, 6.50670, 0.1156552, 0.50080, 1.03871),
    0.4999: (20.4471393, 20.41987, 20.46350, 0.1154197, 0.50192, 1.04941),
}


@pytest.mark.parametrize("nu", [0.07, 0.33, 0.4985, 0.5])
def test_the_table_is_what_the_half_strip_gives(nu):
    """Where volumes stay the same the constants of openings are infinite, in both."""
    computed, table = compute_free_end(nu, DEGREE, LEVELS), free_end(nu)
    for name in (*TABLE_COLUMNS, "kappa"):
        assert getattr(computed, name) == pytest.approx(getattr(table, name), rel=ROUGH), name
    assert math.isinf(table.c_N) == (nu == 0.5)


def test_constants_are_those_of_another_program():
    for nu, numbers in INDEPENDENT.items():
        end = free_end(nu)
        values = end.c_N, end.m_N / end.c_N, end.rho_N, end.c_T, end.m_T / end.c_T, end.kappa
        # its strip is 8 long, and moments lack up to 3e-5; near nu = 1/2 displacements alone leave 3e-6 in shear
        error = np.abs(np.array(values) - numbers) / values
        written = 5.1 * np.array([1e-8, 1e-6, 1e-6, 1e-8, 1e-6, 1e-6])  # the digits above
        assert np.all(error < np.maximum([6e-7, 3e-5, 5e-6, 3e-6, 1e-6, 1e-5], written / values)), nu


def test_near_one_half_the_ends_are_those_of_a_film():
    """c_N, m_N/c_N and rho_N tend to the length eps sqrt(lmbda/(12 mu)) over which a film's pressure falls."""
    nu = 0.5 - 1e-9
    end, delta = free_end(nu), math.sqrt(2 * nu / (1 - 2 * nu) / 12)
    for value in (end.c_N, end.m_N / end.c_N, end.rho_N):
        assert value == pytest.approx(delta, rel=1e-4)
    assert end.kappa == pytest.approx(free_end(0.5).kappa, rel=1e-4)
    assert end.c_N - delta == pytest.approx(1 - 1 / free_end(0.5).kappa, rel=1e-3)


def test_the_factor_of_the_flow():
    """Against the film's equation by finite differences, with 0.46 of the flow in the first thickness."""
    delta, factor, n = 0.35, 0.46, 4000
    h = 8.0 / n
    flow = delta**2 * np.where((np.arange(n) + 0.5) * h < 1, factor, 1.0) / h
    main, off_diagonal = h + flow + np.append(flow[1:], 0.0), np.append(0.0, -flow[1:])
    p = solveh_banded(np.stack([off_diagonal, main]), np.full(n, h))
    assert flow_factor(delta, h / 2 + h * np.sum(1 - p) - delta) == pytest.approx(factor, rel=1e-4)


def test_other_ratios_are_refused():
    for nu, solve in itertools.product((-0.1, 0.51, math.nan), (free_end, compute_free_end, CornerField)):
        refused(InputError, r"from 0 to 0\.5", solve, nu)
