"""The next-order interface law: errors and orders, soft and hard layers; what it refuses."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from forms import LinearElastic, Maxwell, Norton
from studies.problems import FOURIER_LAYER, fourier
from studies.rates import HARD_LAWS
from tests import reference
from tests.orders import observed_orders
from thinlayer import Structure, Surface, ThinLayer, march, solve
from thinlayer.errors import RangeWarning

pytestmark = pytest.mark.few(5)


def relative_errors(full, state, where=1.0):
    """Relative errors of an interface law on S: of the mean traction of both faces, and of the jump."""
    surface = Surface(state.model)
    fields = surface.reaction, surface.jump
    return [surface.norm(f(full) - f(state), where) / surface.norm(f(state), where) for f in fields]


def rows(law_at, eps, cell, order=1, h=1 / 32):
    joint, setup = fourier(h, cell=cell)
    errors = []
    for e in eps:
        layer = ThinLayer(law_at(e), e, order=order, at=1.0)
        limit = solve(Structure(joint, **setup).interface(layer))
        errors.append(relative_errors(solve(Structure(joint, **setup).full(layer)), limit))
    return np.transpose(errors)  # (2, eps)


@pytest.mark.few(5)
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_soft_layer(cell):
    eps = [1 / 32, 1 / 64, 1 / 128]
    tractions, jumps = rows(lambda e: FOURIER_LAYER, eps, cell)
    wanted = [reference.next_order_errors(*reference.LAYER, e)[0] for e in eps[:2]]
    assert tractions[:2] == pytest.approx(wanted, rel=1e-2)
    for errors in (tractions, jumps):
        assert observed_orders(eps, errors)[-2:] == pytest.approx([2.0, 2.0], abs=0.1)


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # that the layer alone is too stiff
@pytest.mark.parametrize("nu", [0.3, 0.49, 0.499, 0.4999])
def test_layer_that_keeps_its_volume(nu):
    """Order 2 whatever nu; a law whose displacements are linear through the layer would err 1.2 times as much or more."""
    law, eps = LinearElastic.shear(40.0, nu), (1 / 8, 1 / 16, 1 / 32)
    for k, errors in enumerate(rows(lambda e: law, eps, "quadrilateral", h=1 / 16)):
        right = [reference.next_order_errors(law.lmbda, law.mu, e)[k] for e in eps]
        assert errors == pytest.approx(right, rel=0.05)  # cells are as large as the thickest layer is thick
        assert observed_orders(eps, errors)[-1] == pytest.approx(2.0, abs=0.2)


@pytest.mark.few(5)
@pytest.mark.parametrize("law", HARD_LAWS.values(), ids=HARD_LAWS)
def test_layer_with_moduli_held(law):
    eps = (1 / 32, 1 / 128, 1 / 256, 1 / 512)
    errors = list(rows(lambda e: law.scaled(1 / e), eps, "quadrilateral")[0])
    for e, error in zip(eps, errors, strict=True):  # what the laws leave, less than the error of either model's mesh
        assert error == pytest.approx(reference.next_order_errors(law.lmbda / e, law.mu / e, e)[0], rel=0.02)
    assert all(order >= 2.5 for order in observed_orders(eps, errors)[2:])
    with warnings.catch_warnings(action="ignore", category=RangeWarning):  # of the hard layer
        limit_law = rows(lambda e: law.scaled(1 / e), eps[:1], "quadrilateral", order=0)[0, 0]
    assert errors[0] < 0.1 * limit_law


@pytest.mark.few(2)
@pytest.mark.parametrize("law", [Maxwell(60.0, 40.0, t1=0.7, t2=0.9), Norton(60.0, 40.0, eta=5.0, p=1.5)])
def test_memory_and_rate(law):
    """History at the two points through the thickness: the error is O(eps^2) in time too."""
    joint, setup = fourier(1 / 16, cell="quadrilateral")
    eps, errors, times = (1 / 16, 1 / 32), {0: [], 1: []}, [0.1, 0.2, 0.4]
    for e in eps:
        full = march(Structure(joint, **setup).full(ThinLayer(law, e, at=1.0)), times).last
        for order, order_errors in errors.items():
            limit = Structure(joint, **setup).interface(ThinLayer(law, e, order=order, at=1.0))
            order_errors.append(relative_errors(full, march(limit, times).last)[0])
    assert observed_orders(eps, errors[0])[1] == pytest.approx(1.0, abs=0.1)
    assert observed_orders(eps, errors[1])[1] == pytest.approx(2.0, abs=0.1)
