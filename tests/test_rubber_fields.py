"""Rubber whose moduli are functions of the place: against numbers, a closed form, a collocation and meshed layers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad, solve_bvp

from forms import Incompressible, Rubber
from tests.test_rubber_bearings import layer, modulus, stiffness, structure
from tests.test_rubber_closed_forms import EPS, MU, STRIP
from thinlayer import solve

pytestmark = pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of layers thicker than the plates

SLOPE = 0.8  # of mu along the strip, relative to half its width


def mu(x):
    return MU * (1 + SLOPE * x[0] / STRIP)


def lmbda(x):
    """Stiffer in the middle."""
    return modulus(0.499) * (1 - 0.7 * (x[0] / STRIP) ** 2)


def collocated():
    """Mean traction per opening, of (eps/lmbda) p - (eps^3/(12 mu) p')' = 1 with p = 0 at both ends."""
    flow = lambda x: EPS**3 / (12 * mu([x]))
    slopes = lambda x, y: np.array([y[1] / flow(x), EPS / lmbda([x]) * y[0] - 1])  # of p and its flow
    at_ends = lambda a, b: np.array([a[0], b[0]])
    solution = solve_bvp(slopes, at_ends, np.linspace(-STRIP, STRIP, 50), np.zeros((2, 50)), tol=1e-9)
    return quad(lambda x: solution.sol(x)[0], -STRIP, STRIP)[0] / (2 * STRIP) + 2 * MU / EPS


def test_incompressible_strip():
    """4 mu a^2/eps^3 (1 - g^2/3) + 2 mu/eps for mu (1 + g x/a): p' = -12 mu (x - x_0)/eps^3 with x_0 = g a/3."""
    wanted = 4 * MU * STRIP**2 / EPS**3 * (1 - SLOPE**2 / 3) + 2 * MU / EPS
    whole = structure("strip")
    assert stiffness("strip", solve(whole.interface(layer(Incompressible(mu))))) == pytest.approx(wanted, rel=1e-3)
    model = structure("strip", h_ends=0.1).full(layer(Incompressible(mu), 0), cells_through=8)
    assert stiffness("strip", solve(model)) == pytest.approx(wanted, rel=0.012)


def test_strip():
    wanted = collocated()
    uniform = Rubber(modulus(0.499), MU)
    for law, near in (
        (Rubber(lmbda, mu), True),
        (uniform, False),
        (Rubber(lmbda, MU), False),
        (Rubber(uniform.lmbda, mu), False),
    ):
        computed = stiffness("strip", solve(structure("strip").interface(layer(law))))
        assert (computed == pytest.approx(wanted, rel=2e-3)) == near
    meshed = solve(structure("strip", h_ends=0.1).full(layer(Rubber(lmbda, mu), 0), cells_through=8))
    assert stiffness("strip", meshed) == pytest.approx(wanted, rel=0.012)
