"""Laminated bearings: several layers of rubber between shims, meshed and by the law with a pressure: springs in series."""

from __future__ import annotations

import math
from functools import cache

import pytest

from forms import Incompressible, Rubber, formulas
from geometry import faults
from tests.closed_forms import strip_stiffness
from tests.test_rubber_bearings import PLATES, modulus
from thinlayer import Structure, Surface, ThinLayer, compare, solve

MU, A, SHIM = 1.2, 20.0, 10.0  # MPa; half-width or radius, and thickness of shims, mm
OPENING = 0.01  # mm
RUBBER, SOFT = Rubber(modulus(0.499), MU), Rubber(modulus(0.49), 0.5)
LAYERS = {"LOW": (3.0, RUBBER), "MIDDLE": (2.0, SOFT), "HIGH": (2.5, Incompressible(0.9))}  # thickness, law
AREAS = {"strain": A, "axisymmetric": math.pi * A**2}
STIFFNESS = {"strain": strip_stiffness, "axisymmetric": formulas.disc_stiffness}


def stiffness(name, plane):
    """Mean traction per opening of one layer."""
    eps, law = LAYERS[name]
    return STIFFNESS[plane](law.lmbda if isinstance(law, Rubber) else float("inf"), law.mu, eps, A)


def layers(order, law=None):
    """Those of closed forms, which do not know ends."""
    options = {"order": order, "edges": "plain"}
    return {name: ThinLayer(law or layer_law, eps, **options) for name, (eps, layer_law) in LAYERS.items()}


@cache
def bearing(plane):
    """Half of it, from the plane of symmetry or the axis."""
    cuts = {name: ((-1.0, SHIM * k), (A + 1, SHIM * k)) for k, name in enumerate(LAYERS, 1)}
    joint = faults(A, SHIM * (len(LAYERS) + 1), cuts, 5.0, h_S=1.0, h_ends=0.1)
    sides = {"LEFT": {"x": 0.0}} if plane == "strain" else {}
    supports = {"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": OPENING}, **sides}
    return Structure(joint, body=PLATES, supports=supports, plane=plane)


@pytest.mark.parametrize("plane", STIFFNESS)
def test_layers_between_shims_are_springs_in_series(plane):
    whole, each = bearing(plane), {name: stiffness(name, plane) for name in LAYERS}
    wanted, area = 1 / sum(1 / k for k in each.values()), AREAS[plane]
    limit = solve(whole.interface(layers(1)))
    full = solve(whole.full(layers(0), cells_through=4))
    for state, near in ((limit, 2e-3), (full, 0.015)):
        assert state.reaction("TOP").force[1] / (area * OPENING) == pytest.approx(wanted, rel=near)
        assert abs(state.audit.imbalance) < 1e-7 * state.audit.supplied  # saddle points, nu near 1/2
        stored = state.energies()
        for name, k in each.items():
            surface = Surface(limit.model, name)
            assert surface.integral(surface.jump(state)[1]) / area == pytest.approx(OPENING * wanted / k, rel=near)
            assert stored[f"layer {name}"] == pytest.approx(area * (OPENING * wanted) ** 2 / k / 2, rel=near)
        assert {f"pressure {name}" for name in LAYERS} <= set(state.fields)
    for name in LAYERS:
        assert compare(full, limit, seam=name, where=lambda x: x[0] < 0.8 * A)["error_traction"] < 0.02
