"""Stresses inside layers that interface laws stand for: against meshed layers, closed forms, and in other frames."""

from __future__ import annotations

import warnings
from functools import cache

import numpy as np
import pytest

from forms import Incompressible, LinearElastic, Rubber, Stack, VonMises
from forms.base import InputError
from geometry import block, disc, sandwich, wall
from studies.problems import FOURIER_LAYER, fourier
from tests.orders import observed_orders
from tests.pictures import assert_drawn
from tests.ranges_told import opened
from tests.refused import refused
from thinlayer import (
    Probe,
    RangeWarning,
    Structure,
    Surface,
    ThinLayer,
    Zoom,
    estimate,
    plotting,
    solve,
)
from thinlayer.output import zooming

pytestmark = pytest.mark.few(5)
FACES = pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # they move as no equilibrium has it

EPS = 0.05
BODY, GLUE = LinearElastic.young(E=70.0, nu=0.2), LinearElastic.shear(3.0, 0.35)
FREE = ThinLayer(GLUE, EPS, order=1, edges="free", at=1.0)
D, Y = (grid.ravel() for grid in np.meshgrid([0.0, 0.1, 0.6, 2.0, 7.0], [-0.4, -0.1, 0.3]))
PLACES = np.concatenate([np.stack([D * EPS, 0 * D], axis=1), np.stack([1.3 - D * EPS, 0 * D], axis=1)])
HEIGHTS = np.concatenate([Y, Y])
STACK = Stack((0.3, LinearElastic(400.0, 20.0)), (0.3, LinearElastic(20.0, 60.0)), (0.4, LinearElastic(60.0, 5.0)))
THIN = (1 / 16, 1 / 32)
STIFF = LinearElastic.young(E=100.0, nu=0.3)


def joint():
    """Two blocks on one another."""
    return sandwich(1.3, 0.3, 0.4, 0.1, cell="quadrilateral", structured=True)


def state(layer=FREE, of=None, turn=None, **setup):
    """The blocks sheared and pulled more on one side."""
    turn = np.eye(2) if turn is None else turn
    pull = {"TOP": tuple(turn @ [0.3, -1.0]), "RIGHT/UPPER": tuple(turn @ [0.1, 0.2])}
    data = {"body": BODY, "supports": {"BOTTOM": 0}, "tractions": pull} | setup
    return solve(Structure(of or joint(), **data).interface(layer))


def relative(actual, expected):
    """Root mean square of a difference, over that of what is known."""
    return np.sqrt(np.mean((actual - expected) ** 2) / np.mean(expected**2))


def places(distances, heights, end=1.0):
    """Places on S at distances from its right end, each at these heights."""
    d, y = (grid.ravel() for grid in np.meshgrid(distances, heights))
    return np.stack([end - d, 0 * d], axis=1), y


# ---------------------------------------------------------------- through the thickness
ORDERS = [(FOURIER_LAYER, 0, 1.0, 0.08), (STACK, 1, 2.0, 0.008), (Rubber.shear(40.0, 0.499), 1, 1.8, 0.01)]


@pytest.mark.parametrize(("law", "order", "rate", "most"), ORDERS)
def test_stresses_have_the_order_of_the_law(law, order, rate, most):
    """In the middle of cells of each sublayer, all components."""
    errors = []
    for eps in THIN:
        base, data = fourier(1 / 16, cell="quadrilateral")
        blocks, layer = Structure(base, **data), ThinLayer(law, eps, order=order, at=1.0)
        full = solve(blocks.full(ThinLayer(law, eps, at=1.0), cells_through=10))
        zoom = Zoom(solve(blocks.interface(layer)), cells_through=10)
        x, y = places(np.linspace(0.15, 0.85, 9) + 0.003, [-0.45, -0.05, 0.35])
        expected = Probe(full).stress(Surface(full.model).in_layer(x, y))
        errors.append(np.abs(zoom.stress(x, y) - expected).max() / np.abs(expected).max())
    assert observed_orders(THIN, errors)[-1] > rate - 0.2
    assert errors[-1] < most


# ---------------------------------------------------------------- free ends
def beside_fine(joint_at, layer, x, y, **setup):
    """A structure, and stresses at places in the layer as they are with cells of a twelfth of the thickness at its ends."""
    load = {"body": STIFF, "supports": {"BOTTOM": 0}, "tractions": {"TOP": (0.3, -1)}} | setup
    coarse, fine = (Structure(joint_at(end), **load) for end in (None, layer.eps / 12))
    full = solve(fine.full(layer, cells_through=12))
    return coarse, Probe(full).stress(Surface(full.model).in_layer(x, y))


@cache
def ended(nu: float, cells: int):
    """Blocks with free ends, S's cells a multiple of eps long; places, and stresses of the layer meshed finely there."""
    eps = 1 / 16
    law = Incompressible(2.0) if nu == 0.5 else (Rubber if nu > 0.49 else LinearElastic).shear(2.0, nu)
    layer = ThinLayer(law, eps, at=1.0)
    x, y = places(eps * np.array([0.1, 0.3, 0.6, 1.0, 1.7, 2.9]), [-0.3, 0.0, 0.3])

    def joint_at(end):
        return sandwich(1.0, 0.5, 0.5, h=1 / 4, h_S=1 / 16 if end else cells * eps, h_ends=end, cell="quadrilateral")

    coarse, stresses = beside_fine(joint_at, layer, x, y)
    return solve(coarse.interface(layer)), x, y, stresses


@FACES
@pytest.mark.parametrize(("nu", "cells", "most"), [(0.3, 2, 0.02), (0.45, 1, 0.02), (0.499, 1, 0.04), (0.5, 1, 0.04)])
def test_stresses_at_free_ends_are_those_of_a_meshed_layer_though_cells_of_s_are_long(nu, cells, most):
    zero, x, y, expected = ended(nu, cells)
    yielded = estimate(zero).better
    better = relative(Zoom(yielded).stress(x, y), expected)
    assert better < most
    assert better < relative(Zoom(zero).stress(x, y), expected)
    if cells == 2:  # cells that are not divided at ends are too long
        assert relative(Zoom(yielded, at_ends=10.0).stress(x, y), expected) > 0.05


@FACES
def test_stresses_of_a_layer_that_yields_at_its_ends():
    """Of one step from rest."""
    layer = ThinLayer(VonMises(4.0, 3.0, 0.8, hardening=2.0), 1 / 16)
    x, y = places(np.array([0.01, 0.06, 0.2, 0.45]), [-0.3, 0.1])
    joint_at = lambda end: sandwich(1.0, 0.5, 0.5, 1 / 8, h_ends=end, cell="quadrilateral")
    coarse, expected = beside_fine(joint_at, layer, x, y)
    zero = solve(coarse.interface(layer))
    zoom = Zoom(estimate(zero).better)
    assert relative(zoom.stress(x, y), expected) < 0.03  # cells of S are twice as long as the layer is thick
    assert relative(Zoom(zero).stress(x, y), expected) > 0.04


# H at the lower corner of a layer between rigid faces over eps^(1 - lambda) times the stress along S (N), or across it (T),
# of a layer without end; by functions of degree 12 on a half strip, to eight digits
STRENGTHS = {0.2: (2.231, 1.277), 0.3: (1.0753, 0.9809), 0.45: (0.3003, 0.7236)}


@FACES
@pytest.mark.parametrize("nu", STRENGTHS)
def test_strengths_of_corners_between_rigid_faces(nu):
    law, w = LinearElastic.shear(3.0, nu), np.array([0.02, 0.01])
    rigid = LinearElastic.young(E=1e4, nu=0.2)
    model = Structure(joint(), body=rigid, supports={"BOTTOM": 0}).interface(ThinLayer(law, EPS))
    H_N, H_T = STRENGTHS[nu]
    for jump, expected in (([0.0, w[1]], H_N * law.lmbda * w[1]), ([w[0], 0.0], H_T * law.mu * w[0])):
        zoom = Zoom(opened(model, lambda x, jump=jump: (jump[0] + 0 * x[0], jump[1] + 0 * x[0])))
        right = {corner.side: corner for corner in zoom.corners if corner.m[0] > 0}
        lower = right["lower"].H[0] * EPS ** (right["lower"].exponent - 1)
        sign = -1 if jump[0] else 1  # axes point away from the end
        assert lower == pytest.approx(sign * expected / EPS, rel=0.01)
        assert pytest.approx(sign * right["lower"].H, rel=1e-3) == right["upper"].H


# ---------------------------------------------------------------- frames, units, kinematics
@pytest.mark.parametrize("angle", [0.3, np.pi])
def test_stresses_turn_with_the_structure(angle):
    c, s = np.cos(angle), np.sin(angle)
    turn, plain = np.array([[c, -s], [s, c]]), Zoom(state())
    turned = Zoom(state(of=joint().rotated(angle), turn=turn))
    plain_stress, turned_stress = plain.stress(PLACES, HEIGHTS), turned.stress(PLACES @ turn.T, HEIGHTS)
    lifted = np.pad(turn, ((0, 1), (0, 1)))
    lifted[2, 2] = 1.0
    np.testing.assert_allclose(turned_stress, lifted @ plain_stress @ lifted.T, atol=1e-8 * np.abs(plain_stress).max())
    for corner in plain.corners:
        (same,) = [other for other in turned.corners if other.m @ turn @ corner.m > 0.99 and other.side == corner.side]
        np.testing.assert_allclose(same.H, corner.H, rtol=1e-7)


def test_a_rigid_rotation_does_not_strain_corners(monkeypatch):
    """Nor does it the law of order 1 without constants of free ends, which are of jumps alone."""
    layer = ThinLayer(GLUE, EPS, order=1, edges="plain", at=1.0)
    rigid = {"BOTTOM": {"x": lambda x, t: -0.2 * x[1], "y": lambda x, t: 0.2 * x[0]}}
    plain, turned = (Zoom(state(layer, **more)).corners for more in ({}, {"supports": rigid}))
    for corner, same in zip(plain, turned, strict=True):
        np.testing.assert_allclose(same.H, corner.H, rtol=1e-9)
    outer = {"lower": LinearElastic.shear(1.5, 0.4), "upper": LinearElastic.shear(1.0, 0.2)}
    plies = Stack((0.4, outer["lower"]), (0.6, outer["upper"]))
    for corner in Zoom(state(ThinLayer(plies, EPS))).corners:  # each of its own sublayer
        assert corner.exponent == Zoom(state(ThinLayer(outer[corner.side], EPS))).corners[0].exponent
    thin, H = state(ThinLayer(Stack((0.2, outer["lower"]), (0.8, outer["upper"])), EPS)), []
    for radius in (0.3, 0.2):  # those of thin sublayers are in them
        monkeypatch.setattr(zooming, "CORNER_ARC_RADIUS", radius)
        H.append(Zoom(thin).corners[0].H)
    assert H[0] == pytest.approx(H[1], rel=1e-9)


def test_three_dimensions_between_rollers_are_plane_strain():
    plain, rollers = Zoom(state()), {"BOTTOM": 0, "FRONT": {"z": 0}, "BACK": {"z": 0}}
    base = sandwich(1.3, 0.3, 0.4, 0.1, depth=0.1, cell="hexahedron", structured=True)
    deep = Zoom(state(of=base, supports=rollers, tractions={"TOP": (0.3, -1.0, 0.0), "RIGHT/UPPER": (0.1, 0.2, 0.0)}))
    x = np.pad(PLACES, ((0, 0), (0, 1)), constant_values=0.037)
    expected = plain.stress(PLACES, HEIGHTS)
    np.testing.assert_allclose(deep.stress(x, HEIGHTS), expected, atol=1e-7 * np.abs(expected).max())
    assert len(deep.corners) == 4
    for corner in plain.corners:
        (same,) = [other for other in deep.corners if other.m[:2] @ corner.m > 0.99 and other.side == corner.side]
        np.testing.assert_allclose(same.H, np.full(len(same.x), corner.H[0]), rtol=1e-6)


@FACES
def test_layers_of_revolution_are_stretched_around_the_axis():
    """As much as along r, where the upper face widens; the shear stress that this brings about balances t_N."""
    plates = Structure(joint(), body=BODY, supports={"BOTTOM": {"y": 0}}, plane="axisymmetric")
    model = plates.interface(ThinLayer(GLUE, EPS, order=1, at=1.0))
    zoom, wide = Zoom(opened(model, lambda x: (0.01 * x[0], 0.002 + 0 * x[0]))), 0.01
    stress = zoom.stress([[0.65, 0.0]] * 3, [-0.5, 0.0, 0.5])
    lmbda, mu = zoom.law.lmbda, zoom.law.mu
    t = lmbda * wide + (lmbda + 2 * mu) * 0.002 / EPS
    assert stress[:, 1, 1] == pytest.approx(t + mu * wide * np.array([1, 0, -1]), rel=1e-5)
    for k in (0, 2):
        assert np.diff(stress[:, k, k]) == pytest.approx(2 * mu * (lmbda + mu) / (lmbda + 2 * mu) * wide, rel=1e-5)


def test_a_rigid_base_is_a_very_stiff_body():
    two = Zoom(state(of=joint(), body={"LOWER": LinearElastic.young(E=7e6, nu=0.2), "UPPER": BODY}))
    upper = block(1.3, 0.4, 0.1, cell="quadrilateral", structured=True)
    pull = {"TOP": (0.3, -1.0), "RIGHT": (0.1, 0.2)}
    based = Zoom(solve(Structure(upper, body=BODY, supports={}, tractions=pull).interface(FREE)))
    expected = two.stress(PLACES, HEIGHTS)
    np.testing.assert_allclose(based.stress(PLACES, HEIGHTS), expected, atol=1e-3 * np.abs(expected).max())
    assert pytest.approx(two.corners[0].H, rel=1e-3) == based.corners[0].H


# ---------------------------------------------------------------- what has no closed form
def test_layers_with_a_weight_a_strain_and_loads_on_their_sides():
    loads = {"body_force": {"S": (0.3, -9.0)}, "tractions": {"TOP": (0.3, -1.0), "RIGHT/LAYER": (5.0, 0.7)}}
    layer = ThinLayer(GLUE, EPS, eigenstrain=-0.01, at=1.0)
    x, y = places(EPS * np.array([0.4, 1.3, 8.0]), [-0.3, 0.2], 1.3)
    joint_at = lambda end: sandwich(1.3, 0.3, 0.4, 0.1, h_ends=end, cell="quadrilateral")
    blocks, expected = beside_fine(joint_at, layer, x, y, body=BODY, **loads)
    assert relative(Zoom(estimate(solve(blocks.interface(layer))).better).stress(x, y), expected) < 0.04


def test_layers_of_a_network_beside_their_junction():
    load = {"supports": {"BOTTOM": 0}, "tractions": {"TOP": (0.3, -1.0)}}
    bricks = Structure(wall(2, 2, (2.0, 1.0), 1 / 4), body=STIFF, **load)
    layer = ThinLayer(LinearElastic.shear(2.0, 0.3), 1 / 16)
    full = solve(bricks.full(layer, cells_through=8))
    x = np.array([[1.0 + 0.15, 1.0], [1.0 - 0.4, 1.0], [1.6, 1.0]])
    expected = Probe(full).stress(Surface(full.model, "BED").in_layer(x, 0.1))
    assert relative(Zoom(estimate(solve(bricks.interface(layer))).better, "BED").stress(x, 0.1), expected) < 0.03


# ---------------------------------------------------------------- refusals
def test_the_layer_is_asked_whether_it_bears_what_the_bodies_do():
    """Faces of order 0 are too far off for a layer that is nearly incompressible; those that have yielded to it are not."""
    layer = ThinLayer(Rubber.shear(2.0, 0.499), 1 / 16, at=1.0)
    with pytest.warns(RangeWarning, match="times too stiff"):
        zero = state(layer)
    with pytest.warns(RangeWarning, match=r"differ by \d+ % from those of the bodies"):
        Zoom(zero)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Zoom(estimate(zero).better)


def test_layers_that_are_not_known_are_refused():
    refused(InputError, "state of an interface or a full model", lambda: Zoom(state().model))
    rollers = {"BOTTOM": 0, "LEFT": {"x": 0}, "RIGHT": {"x": 0}}
    closed = ThinLayer(Incompressible(3.0), EPS, order=1)
    pressed = {"supports": rollers, "tractions": {"TOP": (0.0, -1.0)}}
    refused(InputError, "no side that is free", lambda: Zoom(state(closed, **pressed)))
    refused(InputError, "at_ends is 0", lambda: Zoom(state(), at_ends=0))
    refused(InputError, "seam", lambda: Zoom(state(), "BED"))


def test_places_and_heights_out_of_range_are_refused():
    zoom = Zoom(state())
    for x, y, words in (
        ([[0.5, 0.01]], 0.0, "not on S"),
        ([[0.5, 0.0]], 0.6, "from -1/2 to 1/2"),
        (np.empty((0, 2)), 0.0, "finite coordinates"),
        ([[1.3 - EPS / 20, 0.0]], -0.49, r"\(1.2975, 0\), height -0.49 is too near a corner"),
    ):
        refused(InputError, words, zoom.stress, x, y)


@FACES
def test_corners_that_are_not_known_are_refused_and_stresses_are_not():
    for layer, setup, words in [
        (FREE, {"tractions": {"TOP": (0, -1), "RIGHT/LAYER": (0.4, 0.2)}}, "'RIGHT/LAYER' acts on the layer's side"),
        (ThinLayer(LinearElastic.shear(30.0, 0.3), EPS), {}, "rigid"),
        (FREE, {"plane": "axisymmetric", "supports": {"BOTTOM": 0, "LEFT": {"x": 0}}}, "curved"),
    ]:
        zoom = Zoom(state(layer, **setup))
        assert np.isfinite(zoom.stress([[1.3 - 2 * EPS, 0.0]])).all()
        refused(InputError, words, lambda zoom=zoom: zoom.corners)


def test_curved_ends_have_no_corners():
    round_, pull = disc(1.0, lower=0.3, upper=0.3, h=1.0), {"TOP": (0.0, 0.0, 1.0)}
    curved = Structure(round_, body=BODY, supports={"BOTTOM": 0}, tractions=pull)
    zoom = Zoom(solve(curved.interface(ThinLayer(GLUE, EPS, at=1.0))), cells_through=2, at_ends=1.0)
    assert np.isfinite(zoom.stress(round_.points[np.unique(round_.surface)][:3])).all()
    refused(InputError, "straight", lambda: zoom.corners)


@pytest.mark.long
def test_the_picture_of_an_end(tmp_path):
    structure = Structure(joint(), body=BODY, supports={"BOTTOM": 0}, tractions={"TOP": (0.3, -1.0)})
    zoom = Zoom(solve(structure.interface(FREE)))
    full = solve(structure.full(ThinLayer(GLUE, EPS, at=1.0), cells_through=3))
    picture = plotting.zoomed(zoom, Zoom(full), end=1, component="T", save=tmp_path / "end.png", stress="MPa")
    assert_drawn(tmp_path / "end.png")
    assert [axes.get_title() for axes in picture.axes[:2]] == ["meshed layer", "layer by itself"]
    for options, words in (({"end": 2}, "2 free ends"), ({"component": "X"}, "component"), ({"width": -1}, "width")):
        refused(InputError, words, plotting.zoomed, zoom, **options)
