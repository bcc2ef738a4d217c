"""S without ends under the law with a pressure: periodic sides, where it goes on, and closed S."""

from __future__ import annotations

import numpy as np
import pytest
import ufl

from forms import LinearElastic, Rubber
from geometry import periodic, ring, sandwich
from studies.problems import FOURIER_BODY
from tests.orders import observed_orders
from tests.test_order1 import relative_errors
from tests.test_rubber import NUS, K, jump_amplitudes, law_of, of, of_law
from thinlayer import Structure, ThinLayer, solve

pytestmark = pytest.mark.few(5)

EPS = 1 / 8


def wave(shift=0.0, *, n=16):
    """A wave of the length 2, on a cell as long."""
    joint = sandwich(2.0, 0.5, 0.5, 1 / n, cell="quadrilateral", structured=True)
    top = lambda x, t: ((1 + t) * 0.5 * ufl.sin(K * (x[0] - shift)), (1 + t) * ufl.cos(K * (x[0] - shift)))
    cell = periodic(joint, ("LEFT", "RIGHT"))
    return Structure(cell, body=FOURIER_BODY, supports={"BOTTOM": 0.0}, tractions={"TOP": top})


def rubber(nu):
    return ThinLayer(law_of(*of(40 * EPS, nu), EPS), EPS, order=1, at=1.0)


@pytest.mark.parametrize("nu", NUS)
def test_pressure_on_a_periodic_s(nu):
    """The closed form of rollers, wherever the wave is."""
    wanted = of_law(*of(40 * EPS, nu), EPS)
    assert np.linalg.norm(jump_amplitudes(wave().interface(rubber(nu))) / 2 - wanted) < 4e-4 * np.linalg.norm(wanted)
    energies = [solve(wave(shift, n=8).interface(rubber(nu))).energies() for shift in (0.0, 0.25, 0.625)]
    for shifted in energies[1:]:
        assert shifted == pytest.approx(energies[0], rel=1e-11)


def test_periodic_in_space():
    """A wave along one pair of sides, of the same energy wherever it is; the other pair is periodic, too, or free."""
    joint = sandwich(1.0, 0.4, 0.3, 1 / 4, depth=0.75, cell="hexahedron", structured=True)
    pairs = [("LEFT", "RIGHT"), ("FRONT", "BACK")]
    for sides in (pairs[:1], pairs):
        energies = []
        for shift in (0.0, 0.25):
            top = lambda x, t, s=shift: (0.0, ufl.cos(2 * K * (x[0] - s)), 0.3 * ufl.sin(2 * K * (x[0] - s)))
            setup = {"body": LinearElastic(80.0, 50.0), "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": top}}
            layer = ThinLayer(Rubber(1900.0, 2.0), 0.1, order=1, at=1.0)
            energies.append(solve(Structure(periodic(joint, *sides), **setup).interface(layer)).energies())
        assert energies[1] == pytest.approx(energies[0], rel=1e-11)


@pytest.mark.parametrize("nu", [0.499, 0.5])
def test_closed_s(nu):
    """A ring has no ends: errors of order 2 against the meshed layer, both with bodies at their true places."""
    joint = ring(1.0, 1.5, 2.0, 0.2, degree=2, cell="quadrilateral")
    out = lambda x, t: (x[0] * (x[0] ** 2 - x[1] ** 2) / 8 * 0.3 + 0.1 * x[0], 0.05 * x[1] ** 3)
    structure = Structure(joint, body=FOURIER_BODY, supports={"INSIDE": 0.0}, tractions={"OUTSIDE": out})
    eps, errors = (0.1, 0.05), []
    for e in eps:
        layer = ThinLayer(law_of(*of(40 * e, nu), e), e, order=1, at=1.0)
        full = solve(structure.full(layer, bodies="extended", cells_through=2))
        limit = solve(structure.interface(layer, bodies="extended"))
        assert np.count_nonzero(limit.p.x.array == 0) == 0
        errors.append(relative_errors(full, limit))
    orders = [observed_orders(eps, series)[-1] for series in zip(*errors, strict=True)]
    assert orders[0] == pytest.approx(2.06, abs=0.1)
    assert orders[1] > 1.75
    assert errors[1][1] < 2.5e-3
