"""Closed forms of rubber bearings: numbers, limits, digits that are not lost, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad, solve_bvp

from forms import LinearElastic, formulas
from forms.base import InputError
from tests.closed_forms import rubber_annulus, rubber_strip_tilted, strip_stiffness
from tests.refused import refused

MU, EPS = 1.2, 3.0  # MPa, mm
STRIP = 30.0  # half-width, mm
RADIUS = 30.0
ANNULUS = (12.0, 40.0)
NUMBERS = {  # nu: strip, tilted strip, disc, annulus
    0.45: (4.0882309, 63822.466, 3.8041054, 3.7329922),
    0.49: (16.439776, 196522.85, 13.332822, 12.123202),
    0.499: (82.768723, 484006.04, 43.775276, 30.126165),
    0.4999: (146.79731, 577540.27, 58.494617, 35.692272),
}
INCOMPRESSIBLE = (160.8, 590400.0, 60.8, 36.444691)


def bearings(lmbda, mu=MU, eps=EPS, scale=1.0):
    return (
        strip_stiffness(lmbda, mu, eps, STRIP * scale),
        rubber_strip_tilted(lmbda, mu, eps, STRIP * scale),
        formulas.disc_stiffness(lmbda, mu, eps, RADIUS * scale),
        rubber_annulus(lmbda, mu, eps, ANNULUS[0] * scale, ANNULUS[1] * scale),
    )


def test_numbers():
    for nu, numbers in NUMBERS.items():
        assert bearings(LinearElastic.shear(MU, nu).lmbda) == pytest.approx(numbers, rel=5e-8), nu


def test_incompressible_layers_are_squeezed_films():
    """The leading terms are 4 mu S^2 and 6 mu S^2 of Gent and Lindley, S the loaded over the free area."""
    assert bearings(math.inf) == pytest.approx(INCOMPRESSIBLE, rel=2e-8)
    strip, _, disc, _ = bearings(math.inf)
    assert strip - 2 * MU / EPS == pytest.approx(4 * MU * (STRIP / EPS) ** 2 / EPS, rel=1e-14)
    assert disc - 2 * MU / EPS == pytest.approx(6 * MU * (RADIUS / (2 * EPS)) ** 2 / EPS, rel=1e-14)
    assert bearings(1e12)[:3] == pytest.approx(bearings(math.inf)[:3], rel=3e-8)


def test_ends_matter_to_nothing_in_wide_layers():
    """Bearings much wider than delta, without overflow: the law of order 0, (lmbda + 2 mu)/eps."""
    strip, tilted, disc, annulus = bearings(0.03, scale=1e4)
    wanted = (0.03 + 2 * MU) / EPS
    assert (strip, disc, annulus) == pytest.approx((wanted,) * 3, rel=1e-4)
    assert tilted == pytest.approx(wanted * 2 * (STRIP * 1e4) ** 3 / 3, rel=1e-4)


def test_annulus_solves_the_equation_of_the_pressure():
    """Against a collocation of (eps/lmbda) p - (r eps^3/(12 mu) p')'/r = 1."""
    lmbda = LinearElastic.shear(MU, 0.499).lmbda
    flow = EPS**3 / (12 * MU)
    slopes = lambda r, y: np.array([y[1], (EPS / lmbda * y[0] - 1) / flow - y[1] / r])
    at_ends = lambda a, b: np.array([a[0], b[0]])
    solution = solve_bvp(slopes, at_ends, np.linspace(*ANNULUS, 50), np.zeros((2, 50)), tol=1e-9)
    force, _ = quad(lambda r: 2 * r * solution.sol(r)[0], *ANNULUS)
    mean = force / (ANNULUS[1] ** 2 - ANNULUS[0] ** 2)
    assert mean + 2 * MU / EPS == pytest.approx(rubber_annulus(lmbda, MU, EPS, *ANNULUS), rel=1e-6)


def test_refused():
    for lmbda, mu, a in ((-1.0, MU, STRIP), (5.0, 0.0, STRIP), (math.nan, MU, STRIP), (5.0, MU, 0.0)):
        refused(InputError, "allowed: > 0", strip_stiffness, lmbda, mu, EPS, a)
