"""Stresses inside layers that interface laws stand for: against meshed layers, closed forms, and in other frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forms import Incompressible, LinearElastic, Rubber, Stack
from forms.base import InputError
from forms.inside import FaceValues, Pressed, Sublayers
from geometry import block, disc, sandwich
from studies.problems import FOURIER_LAYER, fourier
from tests.pictures import assert_drawn
from tests.ranges_told import opened
from tests.refused import refused
from tests.zoom_run import BODY, EPS, FREE, GLUE, HEIGHTS, PLACES, joint, state
from thinlayer import Probe, Structure, Surface, ThinLayer, Zoom, observed_orders, plotting, solve

pytestmark = pytest.mark.few(5)

STACK = Stack((0.3, LinearElastic(400.0, 20.0)), (0.3, LinearElastic(20.0, 60.0)), (0.4, LinearElastic(60.0, 5.0)))

THIN = (1 / 16, 1 / 32)


# ---------------------------------------------------------------- through the thickness
@pytest.mark.parametrize("dim", [2, 3])
def test_sublayers_have_the_jump_and_balance(dim):
    """The strains of the stresses add up to the jump, and tractions balance the stresses along S of uniform gradients."""
    rng = np.random.default_rng(dim)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    n, eps = np.array([0.0, 1.0, 0.0]) if dim == 2 else turn[:, 0], 0.07
    inside = Sublayers(np.array([0.3, 0.5, 0.2]), np.array([40.0, 7.0, 1.0]), np.array([2.0, 6.0, 9.0]))
    P, mask = np.eye(3) - np.outer(n, n), np.diag([1.0, 1.0, dim - 2.0])
    jump, mean, difference = mask @ rng.normal(size=3), *(mask @ rng.normal(size=(3, 3)) @ mask @ P for _ in range(2))
    strains = [(one + one.T) / 2 for one in (mean, difference)]
    y, weights = np.polynomial.legendre.leggauss(6)
    heights = np.concatenate([a + b * (y + 1) / 2 for a, b in ((-0.5, 0.3), (-0.2, 0.5), (0.3, 0.2))])
    shares = np.concatenate([b * weights / 2 for b in (0.3, 0.5, 0.2)])
    faces = FaceValues(*(np.tile(one, (18, *[1] * np.ndim(one))) for one in (n, jump, *strains, 0.0, np.zeros(3))))
    stress = inside.stress(faces, np.full(18, eps), heights)
    lmbda, mu = (np.repeat(one, 6) for one in (inside.lmbda, inside.mu))
    trace = np.trace(stress, axis1=1, axis2=2) / (3 * lmbda + 2 * mu)
    e = (stress - (lmbda * trace)[:, None, None] * np.eye(3)) / (2 * mu)[:, None, None]
    # v_N = <u_N> + Phi_N w_N, whose slope along S is a part of the shear strain
    across, phi = 1 / (lmbda + 2 * mu), []
    for height in heights:
        ends = np.array([-0.5, -0.2, 0.3, 0.5])
        grown = np.concatenate([[0], np.cumsum(np.diff(ends) / inside.M)]) * (1 / (shares @ across))
        phi.append(np.interp(height, ends, grown) - 0.5)
    gradient = mean.T @ n + np.array(phi)[:, None] * (difference.T @ n)
    assert shares @ np.einsum("nij,i,j->n", e, n, n) == pytest.approx(jump @ n / eps, rel=1e-12)
    shear = 2 * (e @ n) @ P - gradient @ P
    np.testing.assert_allclose(shares @ shear, P @ jump / eps, atol=1e-12 * abs(jump / eps).max())


def errors(law, heights, order, components=1.0):
    """Largest errors of stresses along lines in the layer of the Fourier problem, for `THIN`."""
    found = []
    for eps in THIN:
        base, data = fourier(1 / 16, cell="quadrilateral")
        blocks = Structure(base, **data)
        full = solve(blocks.full(ThinLayer(law, eps, at=1.0), cells_through=10))
        zoom = Zoom(solve(blocks.interface(ThinLayer(law, eps, order=order, at=1.0))))
        x, y = (one.ravel() for one in np.meshgrid(np.linspace(0.15, 0.85, 9) + 0.003, heights))
        x = np.stack([x, 0 * x], axis=1)
        known = Probe(full).stress(Surface(full.model).in_layer(x, y))
        found.append(np.abs((zoom.stress(x, y) - known) * components).max() / np.abs(known).max())
    return found


@pytest.mark.parametrize("law", [FOURIER_LAYER, STACK], ids=["one", "stack"])
@pytest.mark.parametrize("order", [0, 1])
def test_stresses_through_the_thickness_have_the_order_of_the_law(law, order):
    """In the middle of cells of each sublayer; all components, and the fifth height is not those of the stations."""
    found = errors(law, np.array([-0.45, -0.05, 0.35]), order)
    rate = observed_orders(THIN, found)[-1]
    assert rate == pytest.approx(order + 1, abs=0.2)
    assert found[-1] < (0.08 if order == 0 else 0.008)


@pytest.mark.few(5)
@pytest.mark.parametrize("law", [Rubber.shear(40.0, 0.499), Incompressible(40.0), Rubber.shear(40.0, 0.4)])
def test_stresses_in_rubber_have_order_two(law):
    """The slope of a pressure of degree 1, in the shear stress, has an error of the mesh."""
    heights = np.array([-0.45, 0.35])
    normal = errors(law, heights, 1, np.eye(3))
    assert (
        observed_orders(THIN, normal)[-1] > 1.6
    )  # the least one where the meshed layer has a pressure of degree 1, too
    assert normal[-1] < 0.005
    assert errors(law, heights, 1)[-1] < 0.005


def test_without_the_slope_of_the_pressure_stresses_in_rubber_are_wrong(monkeypatch):
    whole = Pressed.stress
    monkeypatch.setattr(
        Pressed, "stress", lambda self, faces, eps, y: whole(self, replace(faces, slope=0 * faces.slope), eps, y)
    )
    assert errors(Incompressible(40.0), np.array([-0.45, 0.35]), 1)[-1] > 0.02


def test_without_their_slope_stresses_have_order_one(monkeypatch):
    """As if the stresses of the middle were those of all heights."""
    whole = Sublayers.stress
    monkeypatch.setattr(Sublayers, "stress", lambda self, faces, eps, y: whole(self, faces, eps, 0 * y))
    found = errors(FOURIER_LAYER, np.array([-0.45, 0.35]), 1)
    assert observed_orders(THIN, found)[-1] < 1.2


@pytest.mark.parametrize("order", [0, 1])
def test_the_mean_traction_is_that_of_the_interface_law(order):
    """On rollers, each component to the error of projections to degree 1: of order 2, and 1 in the shear of order 1."""
    found = []
    for h in (1 / 8, 1 / 16):
        base, data = fourier(h, cell="quadrilateral")
        solved = solve(Structure(base, **data).interface(ThinLayer(GLUE, EPS, order=order, at=1.0)))
        surface = Surface(solved.model)
        x, t = surface.profile(surface.traction(solved))
        inner = (x[:, 0] > 0.2) & (x[:, 0] < 0.8)
        apart = np.abs(Zoom(solved).stress(x[inner])[:, :2, 1] - t[inner])
        found.append(apart.max(axis=0) / np.abs(t[inner]).max(axis=0))
    shear, normal = np.log2(found[0] / found[1])
    assert found[1] == pytest.approx([0.0, 0.0], abs=0.01)
    assert shear > (0.95 if order else 1.9)
    assert normal > 1.9


# ---------------------------------------------------------------- free ends
def test_stresses_at_free_ends_are_those_of_a_meshed_layer():
    """On a graded mesh, nu = 0.45; the fields of another ratio, or none, are wrong."""
    found = {"law": [], "none": []}
    for eps in (1 / 8, 1 / 16):
        law = LinearElastic.shear(2.0, 0.45)
        base = sandwich(1.0, 0.5, 0.5, h=1 / 4, h_S=1 / 16, h_ends=eps / 12, cell="quadrilateral")
        blocks = Structure(
            base, body=LinearElastic.young(E=100.0, nu=0.3), supports={"BOTTOM": 0}, tractions={"TOP": (0.3, -1)}
        )
        full = solve(blocks.full(ThinLayer(law, eps, at=1.0), cells_through=12))
        zoom = Zoom(solve(blocks.interface(ThinLayer(law, eps, order=1, edges="free", at=1.0))))
        d, y = (one.ravel() for one in np.meshgrid([0.1, 0.3, 0.6, 1.0, 1.7, 3.0], [-0.3, 0.0, 0.3]))
        x = np.stack([1 - d * eps, 0 * d], axis=1)
        known = Probe(full).stress(Surface(full.model).in_layer(x, y))
        plain = zoom._inside(zoom._known.faces(x), y)
        for name, one in (("law", zoom.stress(x, y)), ("none", plain)):
            found[name].append(np.sqrt(np.mean((one - known) ** 2) / np.mean(known**2)))
    assert found["law"][-1] < 0.02
    assert found["none"][-1] > 0.2
    assert observed_orders([1 / 8, 1 / 16], found["law"])[-1] > 1.0


def test_stresses_at_free_ends_of_rubber_are_those_of_a_meshed_layer():
    """nu = 0.499: the pressure falls over 6.5 eps, as on S, and within one eps otherwise."""
    eps, law = 1 / 16, Rubber.shear(2.0, 0.499)
    base = sandwich(1.0, 0.5, 0.5, h=1 / 4, h_S=1 / 16, h_ends=eps / 8, cell="quadrilateral")
    stiff = LinearElastic.young(E=100.0, nu=0.3)
    blocks = Structure(base, body=stiff, supports={"BOTTOM": 0}, tractions={"TOP": (0.3, -1)})
    full = solve(blocks.full(ThinLayer(law, eps, at=1.0), cells_through=8))
    zoom = Zoom(solve(blocks.interface(ThinLayer(law, eps, order=1, at=1.0))))
    d, y = (one.ravel() for one in np.meshgrid([0.1, 0.3, 0.6, 1.0, 1.7, 2.9, 3.1, 4.0], [-0.3, 0.0, 0.3]))
    x = np.stack([1 - d * eps, 0 * d], axis=1)
    known = Probe(full).stress(Surface(full.model).in_layer(x, y))
    error = np.sqrt(np.mean((zoom.stress(x, y) - known) ** 2) / np.mean(known**2))
    assert error < 0.03
    before, after = zoom.stress([[1 - 2.999 * eps, 0.0], [1 - 3.001 * eps, 0.0]])
    np.testing.assert_allclose(
        before, after, atol=0.04 * np.abs(after).max()
    )  # a curved pressure's share of s_11 - s_22
    assert zoom.ends[0].exponent == pytest.approx(0.5952, abs=1e-3)


def test_the_end_is_free_and_far_from_it_nothing_is_added():
    zoom = Zoom(state())
    end = zoom.stress(PLACES[:1].repeat(3, axis=0), [-0.3, 0.0, 0.3])
    far = zoom.stress([[0.65, 0.0]])
    np.testing.assert_allclose(end[:, 0, :2], 0, atol=1e-4 * np.abs(far).max())
    plain = zoom._inside(zoom._known.faces([[0.65, 0.0]]), np.zeros(1))
    np.testing.assert_allclose(far, plain, atol=1e-6 * np.abs(far).max())


def test_strengths_are_those_of_the_stresses_near_corners():
    zoom = Zoom(state())
    r = 1e-3 * EPS
    for end in zoom.ends:
        for side, H in ((-0.5, end.lower[0]), (0.5, end.upper[0])):
            t_N = zoom.stress(end.x - r * end.m, side)[0, 1, 1]
            assert t_N * r ** (1 - end.exponent) == pytest.approx(H, rel=0.02)


@pytest.mark.parametrize("angle", [0.3, np.pi])
def test_stresses_turn_with_the_structure(angle):
    c, s = np.cos(angle), np.sin(angle)
    turn, plain = np.array([[c, -s], [s, c]]), Zoom(state())
    turned = Zoom(state(of=joint().rotated(angle), turn=turn))
    known, found = plain.stress(PLACES, HEIGHTS), turned.stress(PLACES @ turn.T, HEIGHTS)
    lifted = np.pad(turn, ((0, 1), (0, 1)))
    lifted[2, 2] = 1.0
    np.testing.assert_allclose(found, lifted @ known @ lifted.T, atol=1e-8 * np.abs(known).max())
    for one in plain.ends:
        (same,) = [end for end in turned.ends if end.m @ (turn @ one.m) > 0.99]
        np.testing.assert_allclose([same.lower, same.upper], [one.lower, one.upper], rtol=1e-7)


def test_stresses_do_not_depend_on_units():
    L, E = 25.4, 7.0
    plain = Zoom(state())
    body, glue = (law.with_parameters({k: E * v for k, v in law.parameters().items()}) for law in (BODY, GLUE))
    glue = glue.with_parameters({k: v / L for k, v in glue.parameters().items()})  # per thickness
    pulls = {"TOP": (0.3 * E, -E), "RIGHT/UPPER": (0.1 * E, 0.2 * E)}
    base = sandwich(1.3 * L, 0.3 * L, 0.4 * L, 0.1 * L, cell="quadrilateral", structured=True)
    other = Zoom(state(ThinLayer(glue, EPS * L, order=1, edges="free", at=1.0), base, body=body, tractions=pulls))
    known = plain.stress(PLACES, HEIGHTS)
    np.testing.assert_allclose(other.stress(PLACES * L, HEIGHTS), E * known, atol=1e-8 * E * np.abs(known).max())
    for one, same in zip(plain.ends, other.ends, strict=True):
        assert same.lower == pytest.approx(one.lower * E * L ** (1 - one.exponent), rel=1e-7)


def test_plane_stress_is_plane_strain_of_another_ratio():
    sheet = Zoom(state(plane="stress"))
    strain = Zoom(state(ThinLayer(GLUE.plane_stress(), EPS, order=1, edges="free", at=1.0), body=BODY.plane_stress()))
    found, known = sheet.stress(PLACES, HEIGHTS), strain.stress(PLACES, HEIGHTS)
    np.testing.assert_allclose(found[:, :2, :2], known[:, :2, :2], atol=1e-8 * np.abs(known).max())
    assert not found[:, 2].any()
    assert np.abs(known[:, 2, 2]).max() > 0.1
    assert sheet.ends[0].exponent == pytest.approx(strain.ends[0].exponent) != Zoom(state()).ends[0].exponent


def test_three_dimensions_between_rollers_are_plane_strain():
    plain, rollers = Zoom(state()), {"BOTTOM": 0, "FRONT": {"z": 0}, "BACK": {"z": 0}}
    base = sandwich(1.3, 0.3, 0.4, 0.1, depth=0.1, cell="hexahedron", structured=True)
    pull = {"TOP": (0.3, -1.0, 0.0), "RIGHT/UPPER": (0.1, 0.2, 0.0)}
    deep = Zoom(state(of=base, supports=rollers, tractions=pull))
    x = np.pad(PLACES, ((0, 0), (0, 1)), constant_values=0.037)
    known = plain.stress(PLACES, HEIGHTS)
    np.testing.assert_allclose(deep.stress(x, HEIGHTS), known, atol=1e-7 * np.abs(known).max())
    assert len(deep.ends) == 2
    for one in plain.ends:
        (same,) = [end for end in deep.ends if end.m[:2] @ one.m > 0.99]
        np.testing.assert_allclose(same.lower, np.full(len(same.x), one.lower[0]), rtol=1e-6)


def test_layers_of_revolution_are_stretched_around_the_axis():
    """As much as along r, where the upper face widens; the shear stress that this brings about balances t_N."""
    plates = Structure(joint(), body=BODY, supports={"BOTTOM": {"y": 0}}, plane="axisymmetric")
    model = plates.interface(ThinLayer(GLUE, EPS, order=1, at=1.0))
    zoom, wide = Zoom(opened(model, lambda x: (0.01 * x[0], 0.002 + 0 * x[0])).state), 0.01
    found = zoom.stress([[0.65, 0.0]] * 3, [-0.5, 0.0, 0.5])
    lmbda, mu = zoom.law.lmbda, zoom.law.mu
    t = lmbda * wide + (lmbda + 2 * mu) * 0.002 / EPS
    assert found[:, 1, 1] == pytest.approx(t + mu * wide * np.array([1, 0, -1]), rel=1e-9)
    for k in (0, 2):
        assert np.diff(found[:, k, k]) == pytest.approx(2 * mu * (lmbda + mu) / (lmbda + 2 * mu) * wide, rel=1e-9)


def test_a_rigid_base_is_a_very_stiff_body():
    stiff = LinearElastic.young(E=7e6, nu=0.2)
    bodies = {"LOWER": stiff, "UPPER": BODY}
    two = Zoom(state(of=joint(), body=bodies))
    upper = block(1.3, 0.4, 0.1, cell="quadrilateral", structured=True)
    pull = {"TOP": (0.3, -1.0), "RIGHT": (0.1, 0.2)}
    based = Zoom(solve(Structure(upper, body=BODY, supports={}, tractions=pull).interface(FREE)))
    known = two.stress(PLACES, HEIGHTS)
    np.testing.assert_allclose(based.stress(PLACES, HEIGHTS), known, atol=1e-3 * np.abs(known).max())


# ---------------------------------------------------------------- refusals


def test_layers_that_are_not_known_are_refused():
    refused(InputError, "state of an interface model", lambda: Zoom(state().model))
    warm = ThinLayer(GLUE, EPS, eigenstrain=1e-3, at=1.0)
    refused(InputError, "zoom into the layer: .* eigenstrain", lambda: Zoom(state(warm)))
    refused(InputError, "body force in the layer", lambda: Zoom(state(FREE, body_force={"S": (0, -1)})))


def test_places_and_heights_out_of_range_are_refused():
    zoom = Zoom(state())
    for x, y, words in (
        ([[0.5, 0.01]], 0.0, "not on S"),
        ([[0.5, 0.0]], 0.6, "from -1/2 to 1/2"),
        ([[0.5, 0.0]], [0.1, 0.2], "one number or 1"),
        ([[0.5, np.nan]], 0.0, "finite coordinates"),
        (np.empty((0, 2)), 0.0, "finite coordinates"),
        ([[1.3, 0.0]], -0.5, r"at the corner at \(1.3, 0\), height -0.5, are infinite"),
    ):
        refused(InputError, words, zoom.stress, x, y)
    for end in (-1, 2):
        refused(InputError, f"end {end}: there are 2, numbered from 0", lambda end=end: zoom.axes_of_end(end))
    refused(InputError, "seam", lambda: Zoom(state(), "BED"))


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("layer", "given", "words"),
    [
        (ThinLayer(Stack((0.5, GLUE), (0.5, LinearElastic(1.0, 1.0))), EPS, at=1.0), {}, "one law"),
        (FREE, {"tractions": {"TOP": (0, -1), "RIGHT/LAYER": (0.4, 0.2)}}, "'RIGHT/LAYER' acts on the layer's side"),
        (ThinLayer(GLUE, EPS, profile=lambda x: 1 + x[0] / 5, at=1.0), {}, "varies"),
    ],
)
def test_ends_that_are_not_known_are_refused_and_the_inside_is_not(layer, given, words):
    zoom = Zoom(state(layer, **given))
    assert np.isfinite(zoom.stress([[0.65, 0.0]])).all()
    refused(InputError, words, lambda: zoom.stress([[1.3 - 2 * EPS, 0.0]]))
    with pytest.raises(InputError, match=words):
        _ = zoom.ends


def test_curved_ends_and_corners_of_ends_are_refused():
    round_ = disc(1.0, lower=0.3, upper=0.3, h=0.5)
    pull = {"TOP": (0.0, 0.0, 1.0)}
    zoom = Zoom(
        solve(
            Structure(round_, body=BODY, supports={"BOTTOM": 0}, tractions=pull).interface(ThinLayer(GLUE, EPS, at=1.0))
        )
    )
    on_s = round_.points[np.unique(round_.surface)]
    assert np.isfinite(zoom.stress(on_s[np.linalg.norm(on_s, axis=1).argmin()])).all()
    refused(InputError, "straight", lambda: zoom.stress(on_s[np.linalg.norm(on_s, axis=1).argmax()]))
    deep = Structure(
        sandwich(1.3, 0.3, 0.4, 0.2, depth=0.4), body=BODY, supports={"BOTTOM": 0}, tractions={"TOP": (0, 1, 0)}
    )
    zoom = Zoom(solve(deep.interface(FREE)))
    for end in zoom.ends:
        along = np.abs(end.m[::2]).argmin() * 2  # axis of the edge
        assert np.all((end.x[:, along] > 3 * EPS) & (end.x[:, along] < (1.3, 0, 0.4)[along] - 3 * EPS))
    refused(InputError, "two free ends meet", lambda: zoom.stress([[EPS, 0.0, EPS]]))


@pytest.mark.long
def test_the_picture_of_an_end(tmp_path):
    structure = Structure(joint(), body=BODY, supports={"BOTTOM": 0}, tractions={"TOP": (0.3, -1.0)})
    zoom, full = (
        Zoom(solve(structure.interface(FREE))),
        solve(structure.full(ThinLayer(GLUE, EPS, at=1.0), cells_through=3)),
    )
    picture = plotting.zoomed(zoom, full, end=1, component="T", save=tmp_path / "end.png", stress="MPa")
    assert_drawn(tmp_path / "end.png")
    assert [axes.get_title() for axes in picture.axes[:2]] == ["meshed layer", "interface law, zoomed"]
    for given, words in (({"end": 2}, "2 free ends"), ({"component": "X"}, "component"), ({"width": -1}, "width")):
        refused(InputError, words, plotting.zoomed, zoom, **given)
