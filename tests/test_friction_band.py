"""The layer that slips on planes parallel to S without cohesion is contact on S: columns, errors."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from forms import HolonomicCoulomb, IncrementalCoulomb, MohrCoulombMonodirectional
from studies.bands import DIRECT_PATH
from studies.problems import pressed
from tests.orders import observed_orders
from tests.test_mohr_coulomb_models import LMBDA, MU, check_jumps, column
from thinlayer import Structure, Surface, ThinLayer, compare, solve

# layers whose thickness tends to zero under the same load, and columns of any height
pytestmark = [pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning"), pytest.mark.few(5)]

OMEGA = 25.0
FRICTION = math.tan(math.radians(OMEGA))
BAND = MohrCoulombMonodirectional(LMBDA, MU, 0.0, OMEGA, unilateral=True)
CONTACT = IncrementalCoulomb.of_layer(LMBDA, MU, friction=FRICTION)
MOVES = [  # jumps along S, across it
    (0.0, -0.02),  # pressed
    (0.06, -0.02),  # slips
    (0.06, -0.012),  # slips on as the pressure falls
    (-0.05, -0.012),  # slips back
    (0.0, 0.01),  # opens
    (0.04, 0.01),
    (0.04, -0.015),  # touches again
    (0.05, -0.015),  # sticks
    (0.12, -0.03),
]
TURNING = [(0.0, 0.0, -0.02), (0.06, 0.01, -0.02), (0.06, 0.06, -0.02), (-0.02, 0.07, -0.012), (0.0, 0.0, 0.01)]
CLOSING = [(0.03, 0.02, -0.015), (0.08, -0.03, -0.02)]


ON_COLUMNS = [(MOVES, 0.3, 0.0), (MOVES, 1e-4, 2.5), ([*TURNING, *CLOSING], 0.02, 0.0)]


@pytest.mark.few(1)
@pytest.mark.parametrize(("moves", "eps", "angle"), ON_COLUMNS)
def test_the_band_is_contact_on_columns(moves, eps, angle):
    """Slip to and fro, opening and closing again; in 3D its direction follows the tangential displacement."""
    limit, full, point = column(BAND, np.array(moves), eps, angle, on_s=CONTACT)
    for history in (limit, full):
        check_jumps(history, Surface(limit.model), point)
    assert 3 <= (point.energies[:, 1] > 1e-12).sum() < len(moves)
    assert np.sign(point.tractions[1, 0]) == 1  # the upper body moves towards +x and pulls the lower one along
    if len(moves[0]) == 3:
        (a, b, _), (u, v, _) = point.tractions[2], point.jumps[2]
        assert abs(a * v - b * u) > 1e-3  # traction and jump are not parallel


# ------------------------------------------------------------------------ error O(eps)
@cache
def errors(eps):
    where, setup = pressed(1 / 32, DIRECT_PATH)
    plates = Structure(where, **setup | {"element": "Q1"})
    full = solve(plates.full(ThinLayer(BAND, eps, at=1.0), cells_through=1))
    return compare(full, solve(plates.interface(HolonomicCoulomb.of_layer(LMBDA, MU, friction=FRICTION))))


@pytest.mark.parametrize("name", ["error_traction", "error_jump"])
def test_order_1(name):
    eps = (1 / 64, 1 / 128)
    values = [errors(e)[name] for e in eps]
    *_, order = observed_orders(eps, values)
    assert order == pytest.approx(1.0, abs=0.1)
    assert values[1] < 0.013
