"""The next-order law of sublayers in series: moments, errors and orders, planes, what it refuses."""

from __future__ import annotations

import numpy as np
import pytest

from forms import Anisotropic, Incompressible, LinearElastic, Maxwell, MohrCoulomb, Stack
from forms.base import InputError
from forms.series import sublayer_stations
from geometry import sandwich
from studies.problems import FOURIER_BODY, FOURIER_LAYER, fourier
from tests import reference
from tests.orders import observed_orders
from tests.refused import refused
from tests.test_order1 import relative_errors
from thinlayer import Structure, ThinLayer, solve

pytestmark = pytest.mark.few(5)

TWO = [(0.3, 60.0, 40.0), (0.7, 600.0, 20.0)]  # fraction, lmbda, mu of the sublayers, per thickness
THREE = [(0.3, 400.0, 20.0), (0.3, 20.0, 60.0), (0.4, 60.0, 5.0)]
UNEQUAL = [(0.4, 60.0, 80.0), (0.6, 10.0, 8.0)]
EPS = (1 / 16, 1 / 32, 1 / 64)
MESH = {"cell": "quadrilateral"}


def stack(sublayers):
    return Stack(*((a, LinearElastic(lmbda, mu)) for a, lmbda, mu in sublayers))


def error_rows(law):
    """Errors (traction, jump, compliance) of the interface law against the meshed layer."""
    joint, setup = fourier(1 / 16, **MESH)
    structure, rows = Structure(joint, **setup), []
    for e in EPS:
        full = solve(structure.full(ThinLayer(law, e, at=1.0)))
        state = solve(structure.interface(ThinLayer(law, e, order=1, at=1.0)))
        works = [solution.energies()["loads"] for solution in (full, state)]
        rows.append((*relative_errors(full, state), abs(works[0] / works[1] - 1)))
    return rows


def orders(rows, eps=EPS):
    return [observed_orders(eps, errors)[-1] for errors in zip(*rows, strict=True)]


# ---------------------------------------------------------------- moments, and laws written down elsewhere
MOMENTS = [(TWO, 0.004963, 0.181034, 0.784821), (THREE, -0.095552, -0.160266, None)]


@pytest.mark.parametrize(("sublayers", "A", "B", "lateral"), MOMENTS)
def test_moments(sublayers, A, B, lateral):
    """Means of r Phi_T, of Phi_N and of r, from an independent program; K_N and K_T are those of order 0."""
    law = sublayer_stations(stack(sublayers).sublayers)[0].law
    assert (law.mean_r_phi_t, law.mean_phi_n) == pytest.approx((A, B), abs=5e-7)
    assert lateral is None or law.mean_r == pytest.approx(lateral, abs=5e-7)
    assert law.mu == pytest.approx(1 / sum(a / mu for a, _, mu in sublayers), rel=1e-14)
    assert law.lmbda + 2 * law.mu == pytest.approx(1 / sum(a / (lam + 2 * mu) for a, lam, mu in sublayers), rel=1e-14)


# ---------------------------------------------------------------- models
@pytest.mark.few(5)
@pytest.mark.parametrize("sublayers", [TWO, THREE], ids=["two", "three"])
def test_sublayers(sublayers):
    """Order 2 with the errors of the transfer matrices."""
    rows = error_rows(stack(sublayers))
    for row, e in zip(rows, EPS, strict=True):
        wanted = reference.errors(reference.stacked(sublayers, e), reference.in_series(sublayers, e))
        assert row == pytest.approx(wanted, rel=0.03)
    assert orders(rows) == pytest.approx([2.0] * 3, abs=0.1)


def test_a_graded_layer():
    """Sublayers of equal thickness with the law of their middles; many of them tend to the layer that they stand for."""
    graded = lambda y: LinearElastic(60.0 * (1 + 8 * y), 40.0 * (1 + y))
    assert [law.mu for law in Stack.graded(graded, 2).laws] == pytest.approx([50.0, 70.0])
    joint, setup = fourier(1 / 8, **MESH)
    structure = Structure(joint, **setup)
    layers = [ThinLayer(Stack.graded(graded, n), 0.1, 1, at=1.0) for n in (8, 16, 32)]
    jumps = [solve(structure.interface(layer)).energies()["layer"] for layer in layers]
    assert np.log2((jumps[1] - jumps[0]) / (jumps[2] - jumps[1])) == pytest.approx(2.0, abs=0.1)
    for n in (0, 2.5, "2"):
        refused(InputError, "number of sublayers", Stack.graded, graded, n)


@pytest.mark.few(5)
@pytest.mark.parametrize(("plane", "sublayers"), [("stress", UNEQUAL), ("axisymmetric", THREE)])
def test_planes(plane, sublayers):
    """Order 2 against the meshed layer, on sides that slide."""
    joint = sandwich(1.0, 0.5, 0.5, 1 / 16, **MESH)
    supports = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    loads = {"TOP": lambda x, t: (x[0] * (1 - x[0]), x[0] ** 2 * (3 - 2 * x[0]))}
    structure = Structure(joint, body=FOURIER_BODY, supports=supports, tractions=loads, plane=plane)
    rows = []
    for e in EPS[1:]:
        full = solve(structure.full(ThinLayer(stack(sublayers), e, at=1.0)))
        rows.append(relative_errors(full, solve(structure.interface(ThinLayer(stack(sublayers), e, order=1, at=1.0)))))
    assert orders(rows, EPS[1:]) == pytest.approx([2.0, 2.0], abs=0.15)


# ---------------------------------------------------------------- ranks, refusals
def test_refused():
    for law in [Maxwell(60.0, 40.0, t1=0.7), MohrCoulomb(60.0, 40.0, 0.1, 30.0), Anisotropic.springs(60.0, 40.0)]:
        both = Stack((0.4, FOURIER_LAYER), (0.6, law))
        words = rf"order=1 of a Stack with the sublayer {type(law).__name__}.*use order=0, or mesh"
        refused(InputError, words, ThinLayer, both, 0.1, order=1)
    refused(InputError, "a sublayer", lambda: Stack((0.5, FOURIER_LAYER), (0.5, Incompressible(3.0))))
    varying = Stack((0.4, FOURIER_LAYER), (0.6, LinearElastic(lambda x: 60 + x[0], 40.0)))
    refused(InputError, "order=1 of a Stack with parameters that are functions", ThinLayer, varying, 0.1, order=1)
