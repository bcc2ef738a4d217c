"""Rubber beside bodies that are hundreds of millions of times stiffer, and beyond what floating point numbers hold."""

from __future__ import annotations

import math

import pytest

from forms import Incompressible, LinearElastic, Rubber
from geometry import sandwich
from tests.closed_forms import strip_stiffness
from tests.test_rubber_bearings import modulus
from thinlayer import SolveError, Structure, Surface, ThinLayer, solve

MU, EPS, A = 1.2, 3.0, 30.0  # MPa, mm, mm
OPENING, PULL = 0.01, 0.1  # mm, MPa

# of layers thicker than the plates
pytestmark = [pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning"), pytest.mark.few(5)]


def strip(E, cell, *, pulled=False):
    """Half of it, with cells of a sixtieth of the thickness at its end; its upper plate is moved, or pulled."""
    joint = sandwich(A, 1.0, 1.0, 2.0, h_S=0.5, h_ends=EPS / 60, cell=cell).moved((-A, 0.0))
    moved = {} if pulled else {"TOP": {"x": 0.0, "y": OPENING}}
    tractions = {"TOP": (0.0, PULL)} if pulled else {}
    supports = {"BOTTOM": 0.0, "RIGHT": {"x": 0.0}, **moved}
    return Structure(joint, body=LinearElastic.young(E, 0.3), supports=supports, tractions=tractions)


@pytest.mark.parametrize("law", [Rubber(modulus(0.499), MU), Incompressible(MU)])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_plates(law, cell):
    """E/mu = 1e10 where they are moved, 1e8 where they are pulled."""
    layer = ThinLayer(law, EPS, order=1, edges="plain")  # as the closed form
    state = solve(strip(1e10 * MU, cell).interface(layer))
    assert state.report.residual < 1e-7
    lmbda = law.lmbda if isinstance(law, Rubber) else math.inf
    stiffness = state.reaction("TOP").force[1] / (A * OPENING)
    assert stiffness == pytest.approx(strip_stiffness(lmbda, MU, EPS, A), rel=1e-3)
    assert solve(strip(1e8 * MU, cell, pulled=True).interface(layer)).report.residual < 1e-7


def test_rounding_is_told_where_it_spoils_the_solution():
    """Plates 1e11 times stiffer move as those 1e10 times stiffer do; at 1e13 rounding moves them by 4e-5."""
    layer = ThinLayer(Rubber(modulus(0.499), MU), EPS, order=1)
    opened = {}
    for contrast in (1e10, 1e11):
        model = strip(contrast * MU, "quadrilateral", pulled=True).interface(layer)
        surface = Surface(model)
        opened[contrast] = surface.integral(surface.jump(solve(model)))[1]
    assert opened[1e11] == pytest.approx(opened[1e10], rel=1e-3)
    with pytest.raises(SolveError, match=r"too stiff for what holds them; take their moduli .* times smaller"):
        solve(strip(1e13 * MU, "quadrilateral", pulled=True).interface(layer))
