"""The Fourier problem against transfer matrices: discretisation orders, and the layer's error as eps -> 0."""

from __future__ import annotations

import numpy as np
import pytest

from studies.problems import FOURIER_BODY, FOURIER_LAYER, fourier
from tests import reference
from tests.orders import observed_orders
from thinlayer import Structure, Surface, ThinLayer, compare, solve

pytestmark = pytest.mark.few(5)

# (U, V, S, T) on both sides of S from an independent code
BELOW = (-4.3703519223243e-4, 2.1589413886969e-3, -0.13658692636385, 0.60452444282214)
ABOVE = (-3.8517083513286e-3, 6.4769731231408e-3, -0.13658692636385, 0.60452444282214)
CELLS = {"P2": "triangle", "Q2": "quadrilateral"}


def test_reference_states():
    """The transfer matrices give the independent numbers, and their moduli are the studies'."""
    _, below, above, top = reference.interface_states()
    assert below == pytest.approx(BELOW, rel=1e-12)
    assert above == pytest.approx(ABOVE, rel=1e-12)
    assert top == pytest.approx([6.0789121939743e-3, 9.6575357750085e-3, 0.5, 1.0], rel=1e-12)
    assert (FOURIER_BODY.lmbda, FOURIER_BODY.mu) == pytest.approx(reference.BODY)
    assert (FOURIER_LAYER.lmbda, FOURIER_LAYER.mu) == reference.LAYER


def interface_errors(h: float, element: str) -> list[float]:
    """Relative L2(S) errors of u-, u+ and K [u] of the interface model."""
    joint, setup = fourier(h, cell=CELLS[element])
    state = solve(Structure(joint, element=element, **setup).interface(ThinLayer(FOURIER_LAYER, 0.1, at=1.0)))
    surface = Surface(state.model)
    s, c = np.sin(np.pi * surface.x[0]), np.cos(np.pi * surface.x[0])
    lmbda, mu = reference.LAYER

    def exact(z):
        return np.array([z[0] * s, z[1] * c])

    w, (lower, upper) = surface.jump(state), surface.displacements(state)
    t = np.array([mu * w[0], (lmbda + 2 * mu) * w[1]])
    pairs = [(lower, exact(BELOW[:2])), (upper, exact(ABOVE[:2])), (t, exact(BELOW[2:]))]
    return [surface.norm(computed - wanted) / surface.norm(wanted) for computed, wanted in pairs]


@pytest.mark.few(5)
@pytest.mark.parametrize(("element", "h"), [("P2", 1 / 96), ("Q2", 1 / 64)])
def test_interface_model(element, h):
    fine = np.array(interface_errors(h, element))
    coarse = np.array(interface_errors(2 * h, element))
    assert (fine <= 1e-6).all()
    assert np.log2(coarse / fine) == pytest.approx([3.0] * 3, abs=0.15)


EPS = (1 / 8, 1 / 16, 1 / 32, 1 / 64)


@pytest.mark.few(5)
@pytest.mark.parametrize("bodies", ["kept", "extended"])
def test_sweep(bodies):
    """P2 at h = 1/16: errors as the transfer matrices have them, to 1 % (h-errors are a hundredth of that)."""
    joint, setup = fourier(1 / 16)
    rows = []
    for eps in EPS:
        layer = ThinLayer(FOURIER_LAYER, eps, at=1.0)
        limit = solve(Structure(joint, **setup).interface(layer))
        row = compare(solve(Structure(joint, **setup).full(layer, bodies=bodies)), limit)
        expected = reference.sweep_errors(eps, bodies)
        assert (row["error_traction"], row["error_jump"]) == pytest.approx(expected, rel=1e-2)
        rows.append(row)
    if bodies == "kept":
        assert [row["error_jump"] for row in rows] == pytest.approx([0.1030, 0.0508, 0.0250, 0.0124], rel=5e-3)
    first = 1 if bodies == "kept" else 2
    for name in ("error_traction", "error_jump"):
        orders = observed_orders(EPS, [row[name] for row in rows])[first:]
        assert orders == pytest.approx([1.0] * len(orders), abs=0.05)
