"""The pressure of rubber on S against closed forms of bearings, and meshed layers against exact numbers."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from forms import Incompressible, LinearElastic, Rubber, formulas
from forms.ends import free_end
from geometry import sandwich
from tests.closed_forms import rubber_annulus, rubber_strip_tilted, strip_stiffness
from tests.test_rubber_closed_forms import ANNULUS, EPS, MU, RADIUS, STRIP
from thinlayer import Structure, Surface, ThinLayer, solve

PLATES = LinearElastic.young(3.6e6, 0.3)  # MPa, a million times that of the layers
HALF = 0.5  # Poisson's ratio of incompressible layers
SPANS = {"strip": (-STRIP, STRIP), "disc": (0.0, RADIUS), "annulus": ANNULUS}
OPENING = 0.01  # mm

# of layers thicker than the plates
pytestmark = [pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning"), pytest.mark.few(5)]


def closed_form(bearing, lmbda):
    stiffness = {"strip": strip_stiffness, "disc": formulas.disc_stiffness, "annulus": rubber_annulus}[bearing]
    return stiffness(lmbda, MU, EPS, *(ANNULUS if bearing == "annulus" else SPANS[bearing][1:]))


def modulus(nu):
    return LinearElastic.shear(MU, nu).lmbda if nu < HALF else math.inf


@cache
def joint(bearing, h_ends):
    """Plates of a third of the layer's thickness, held outside as a whole: they do not bend."""
    start, end = SPANS[bearing]
    return sandwich(end - start, 1.0, 1.0, 2.0, h_S=1.0, h_ends=h_ends, cell="quadrilateral").moved((start, 0.0))


def structure(bearing, *, motion=(0.0, OPENING), h_ends=0.2, body=PLATES):
    plane = "strain" if bearing == "strip" else "axisymmetric"
    supports = {"BOTTOM": 0.0, "TOP": dict(zip("xy", motion, strict=True))}
    return Structure(joint(bearing, h_ends), body=body, supports=supports, plane=plane)


def layer(law, order=1, edges="plain"):
    return ThinLayer(law, EPS, order=order, edges=edges)


def rubber(nu):
    return Rubber(modulus(nu), MU) if nu < HALF else Incompressible(MU)


def area(bearing):
    start, end = SPANS[bearing]
    return end - start if bearing == "strip" else np.pi * (end**2 - start**2)


def stiffness(bearing, state):
    """Force of the plate on the layer over its area and its motion."""
    return state.reaction("TOP").force[1] / (area(bearing) * OPENING)


# ---------------------------------------------------------------- the interface law
@pytest.mark.few(8)
@pytest.mark.parametrize("nu", [0.3, 0.45, 0.499, HALF])
@pytest.mark.parametrize("bearing", SPANS)
def test_stiffness_of_bearings(bearing, nu):
    """To 0.1 %, of cells of degree 1 for the pressure and plates that are not rigid."""
    state = solve(structure(bearing).interface(layer(rubber(nu))))
    wanted = closed_form(bearing, modulus(nu))
    assert stiffness(bearing, state) == pytest.approx(wanted, rel=1e-3)
    surface = Surface(state.model)
    force, opening = (surface.integral(f[1]) for f in (surface.traction(state), surface.jump(state)))
    assert force / opening == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize("nu", [0.45, HALF])
def test_moment_of_a_tilted_strip(nu):
    rotation = 1e-3
    # about a point eps/2 below the upper face, in the middle of the layer, so that there is no shear
    motion = (-rotation * (1.0 + EPS / 2), lambda x, t: rotation * x[0])
    state = solve(structure("strip", motion=motion).interface(layer(rubber(nu))))
    wanted = rubber_strip_tilted(modulus(nu), MU, EPS, STRIP)
    assert state.reaction("TOP").at((0.0, 0.0)).moment / rotation == pytest.approx(wanted, rel=2e-3)
    surface = Surface(state.model)
    assert surface.integral(surface.x[0] * surface.traction(state)[1]) / rotation == pytest.approx(wanted, rel=2e-3)


# stiffness of layers between rigid plates, from elements of degree 4 and more in graded grids, by another program
EXACT = {  # nu: strip, disc, annulus: from elements graded into the corners of the layer
    0.3: (3.463930 * MU / EPS, None, None),
    0.45: (10.277722 * MU / EPS, 3.8418105, 3.7839791),
    0.49: (41.130942 * MU / EPS, 13.337616, 12.197906),
    0.499: (205.854698 * MU / EPS, 43.421577, 30.239282),
    0.4999: (364.064818 * MU / EPS, 57.913672, 35.838211),
}
BETWEEN_RIGID = [("strip", 0.45), ("strip", 0.49), ("strip", 0.499), ("disc", 0.45), ("annulus", 0.45)]


@pytest.mark.parametrize(("bearing", "nu"), BETWEEN_RIGID)
def test_bearings_whose_ends_are_known(bearing, nu):
    """Closer to the layer itself than closed forms are, where these are off by more than the curvature of ends leaves."""
    wanted = EXACT[nu][list(SPANS).index(bearing)]
    state = solve(structure(bearing).interface(layer(rubber(nu), edges="free")))
    assert stiffness(bearing, state) == pytest.approx(wanted, rel=1.5e-3)
    if nu in (0.45, 0.499):
        assert abs(closed_form(bearing, modulus(nu)) / wanted - 1) > 4e-3
    if nu == 0.45:
        stiff, free = (layer(LinearElastic(modulus(nu), MU), edges=edges) for edges in ("plain", "free"))
        errors = [stiffness(bearing, solve(structure(bearing).interface(pad))) / wanted - 1 for pad in (stiff, free)]
        assert errors[0] > 0.07
        assert abs(errors[1]) < 0.1 * errors[0]


def test_narrow_or_soft_bearings_have_the_flow_of_an_infinite_layer():
    """Nearly incompressible rubber: with the flow of an end it would be 1.2 % too soft five thicknesses from the middle."""
    plates = sandwich(10 * EPS, 1.0, 1.0, 2.0, h_S=0.5, h_ends=0.2, cell="quadrilateral")
    setup = {"supports": {"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": OPENING}}}
    model = Structure(plates, body=PLATES, **setup).interface(layer(rubber(0.499), edges="free"))
    assert solve(model).reaction("TOP").force[1] / (10 * EPS * OPENING) == pytest.approx(82.427496 * MU / EPS, rel=4e-3)
    end = free_end(0.499)
    assert end.kappa > 1
    shares = [(1 / end.for_spreading_length(x).kappa - 1) / (1 / end.kappa - 1) for x in (7.9, 8.5, 9.9, 10.1)]
    assert shares == pytest.approx([0.0, 0.25, 0.95, 1.0])
    assert free_end(0.45).for_spreading_length(1.0) == free_end(0.45)
    for factor, end_flow in ((0.5, False), (0.55, True)):
        # half-spaces give way to a pressure of wave number k as the layer does where (eps k)^3 = 48 (1 - nu^2) mu/E
        soft = LinearElastic.young(factor * 48 * (1 - 0.3**2) * 1e3 * MU, 0.3)
        wide = structure("strip", body=soft).interface(layer(rubber(0.499), edges="free"))
        assert (wide.applicability["S"].weights.constants.kappa > 1) == end_flow


# ---------------------------------------------------------------- the meshed layer
@pytest.mark.parametrize("nu", EXACT)
@pytest.mark.parametrize("bearing", SPANS)
def test_meshed_rubber(bearing, nu):
    """Against exact numbers, and against the closed form: annuli are 9.3, others 20 thicknesses wide."""
    state = solve(structure(bearing, h_ends=0.1).full(layer(rubber(nu), 0), cells_through=8))
    computed, exact = stiffness(bearing, state), EXACT[nu][list(SPANS).index(bearing)]
    if exact:
        assert computed == pytest.approx(exact, rel=2e-3)
    assert computed == pytest.approx(closed_form(bearing, modulus(nu)), rel=0.016 if bearing == "annulus" else 0.012)
