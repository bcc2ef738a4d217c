"""The layer that slips on planes parallel to S: columns against a closed form, the meshed band against contact on S.

A column is moved at its top, (d_T, d_N) at the end of each step; the tractions on its sides follow the closed form, so that
stresses are uniform.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from forms import HolonomicCoulomb, IncrementalCoulomb, LinearElastic, MohrCoulombMonodirectional, Stack
from geometry import sandwich
from studies import sweep_friction
from studies.problems import pressed
from tests.orders import observed_orders
from tests.own_laws import layer_of
from thinlayer import Structure, Surface, ThinLayer, compare, march, solve
from thinlayer.discretisation.state import displacements_of

# layers whose thickness tends to zero under the same load, and columns of any height
pytestmark = [pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning"), pytest.mark.few(5)]

BODY = LinearElastic.young(100.0, 0.3)
H = 0.5  # of each body
LMBDA, MU, OMEGA = 60.0, 40.0, 25.0
K_N, K_T, FRICTION = LMBDA + 2 * MU, MU, math.tan(math.radians(OMEGA))
C_N, C_T = 2 * H / (BODY.lmbda + 2 * BODY.mu), 2 * H / BODY.mu  # compliance of both bodies
BAND = MohrCoulombMonodirectional(LMBDA, MU, 0.0, OMEGA, unilateral=True)
PULLED = MohrCoulombMonodirectional(LMBDA, MU, 0.1, OMEGA)  # bilateral
CONTACT = IncrementalCoulomb.of_layer(LMBDA, MU, friction=FRICTION)
MOVES = (  # tangential, normal
    (0.0, -0.02),  # pressed
    (0.06, -0.02),  # slips
    (0.06, -0.012),  # slips on as the pressure falls
    (-0.05, -0.012),  # slips back
    (0.0, 0.01),  # opens
    (0.04, 0.01),
    (0.04, -0.015),  # touches again
    (0.05, -0.015),  # sticks
    (0.12, -0.03),
)
TURNING = ((0.0, 0.0, -0.02), (0.06, 0.01, -0.02), (0.06, 0.06, -0.02), (-0.02, 0.07, -0.012), (0.0, 0.0, 0.01))
CLOSING = ((0.03, 0.02, -0.015), (0.08, -0.03, -0.02))
EXACT = 1e-9


# ------------------------------------------------------------------------ columns
def closed_form(layer, moves):
    """Tractions, jumps (n, d), tangential components first, and the layer's stress along S, (n,).

    A stack is an elastic sublayer below a slipping one with h = 0, and the same ratio of moduli.
    """
    (share, elastic), (rest, law) = layer.sublayers if isinstance(layer, Stack) else ((0.0, BODY), (1.0, layer))
    soft_N, soft_T = share / (elastic.lmbda + 2 * elastic.mu), share / elastic.mu
    h, c_N, c_T, k_N, k_T = law.elastic_fraction, C_N + soft_N, C_T + soft_T, K_N / rest, K_T / rest
    tractions, jumps, along = [], [], []
    slip = np.zeros(len(moves[0]) - 1)
    for *d_T, d_N in moves:
        opens = law.unilateral and d_N > 0
        w_N = d_N / (1 + c_N * k_N * (h if opens else 1))
        plastic_N = 0.0 if opens else k_N * w_N
        bound = max(law.cohesion - math.tan(math.radians(law.friction_angle)) * plastic_N, 0.0)
        w_T = (np.array(d_T) + c_T * (1 - h) * k_T * slip) / (1 + c_T * k_T)
        plastic_T = k_T * (w_T - slip)
        if np.linalg.norm(plastic_T) > bound:
            direction = np.array(d_T) - (1 + c_T * h * k_T) * slip
            plastic_T = bound * direction / np.linalg.norm(direction)
            w_T = (np.array(d_T) - c_T * (1 - h) * plastic_T) / (1 + c_T * h * k_T)
            slip = w_T - plastic_T / k_T
        t_T, t_N = (1 - h) * plastic_T + h * k_T * w_T, (1 - h) * plastic_N + h * k_N * w_N
        tractions.append([*t_T, t_N])
        jumps.append([*(w_T + soft_T * t_T), w_N + soft_N * t_N])
        along.append(LMBDA / K_N * t_N)
    return np.array(tractions), np.array(jumps), np.array(along)


@cache
def joint(dim, angle=0.0):
    where = {2: {"cell": "quadrilateral"}, 3: {"cell": "hexahedron", "depth": 1.0}}[dim]
    return sandwich(1.0, H, H, 0.5, structured=True, **where).rotated(angle)


def column(law, moves, angle=0.0):
    """Data of the models, times, and the closed form in global axes: tractions, jumps (n, d)."""
    d = len(moves[0])
    c, s = np.cos(angle), np.sin(angle)
    axes = np.array([[c, s], [-s, c]]) if d == 2 else np.eye(3)[[0, 2, 1]]  # rows: tangents, then n
    n = axes[-1]
    tractions, jumps, along = closed_form(law, moves)
    t, w, top = tractions @ axes, jumps @ axes, np.array(moves) @ axes
    bodies, layers = [], []
    for vector, stress in zip(t, along, strict=True):
        normal = vector @ n
        a = (vector - normal * n) / BODY.mu + normal * n / (BODY.lmbda + 2 * BODY.mu)
        e = (np.outer(a, n) + np.outer(n, a)) / 2
        bodies.append(BODY.lmbda * np.trace(e) * np.eye(d) + 2 * BODY.mu * e)
        shear = vector - normal * n
        both = np.outer(shear, n) + np.outer(n, shear)
        layers.append(both + normal * np.outer(n, n) + stress * (np.eye(d) - np.outer(n, n)))
    outwards = {"LEFT": -axes[0], "RIGHT": axes[0]}
    if d == 3:
        outwards |= {"BACK": -axes[1], "FRONT": axes[1]}
    loads = {}
    for side, outward in outwards.items():
        for region, stresses in (("LOWER", bodies), ("UPPER", bodies), ("LAYER", layers)):
            loads[f"{side}/{region}"] = in_steps([stress @ outward for stress in stresses])
    moved = {"xyz"[k]: in_steps(top[:, k]) for k in range(d)}
    setup = {"body": BODY, "supports": {"BOTTOM": 0.0, "TOP": moved}, "tractions": loads}
    setup |= {"element": "Q1"}
    return joint(d, angle), setup, [k + 1.0 for k in range(len(moves))], t, w


def in_steps(values):
    """A load or displacement with these values at the ends of steps of length 1, zero at first: a polynomial in time."""
    values = np.array([np.zeros_like(values[0]), *values])
    middle = (len(values) - 1) / 2
    powers = np.linalg.solve(np.vander(np.arange(len(values)) / middle - 1), values)

    def at(_, t):
        time, rows = t / middle - 1, powers.reshape(len(values), -1).tolist()
        found = rows[0]
        for row in rows[1:]:
            found = [time * high + low for high, low in zip(found, row, strict=True)]
        return found if values.ndim == 2 else found[0]

    return at


def check_column(law, eps, moves=MOVES, angle=0.0, on_s=None):
    """Both models against the closed form at every step."""
    where, setup, times, tractions, jumps = column(law, moves, angle)
    limit = march(Structure(where, **setup).interface(layer_of(on_s or law, eps)), times)
    full = march(Structure(where, **setup).full(ThinLayer(law, eps, at=1.0), cells_through=1), times)
    surface = Surface(limit.model)
    assert np.abs(tractions).max() > 1
    for k, time in enumerate(times):
        one, other = limit.at(time), full.at(time)
        u = one.u.x.array
        assert np.abs(displacements_of(other, limit.model).x.array - u).max() < EXACT * np.abs(u).max(), time
        _, jump = surface.profile(surface.jump(one))
        assert np.abs(jump - jumps[k]).max() < EXACT * np.abs(jumps).max(), time
    for history in (limit, full):
        _, traction = surface.profile(surface.traction(history.last))
        assert np.abs(traction - tractions[-1]).max() < EXACT * np.abs(tractions).max(), history.model
    return limit, full


@pytest.mark.parametrize(
    ("law", "eps"),
    [
        (PULLED, 0.3),
        (PULLED, 1e-4),
        (replace(PULLED, elastic_fraction=0.2), 1e-2),
        (replace(BAND, cohesion=0.1), 1e-4),
        (replace(BAND, cohesion=0.1, elastic_fraction=0.2), 0.3),
    ],
    ids=lambda value: (
        f"eps={value}"
        if isinstance(value, float)
        else f"{value.unilateral} C={value.cohesion} h={value.elastic_fraction}"
    ),
)
def test_columns(law, eps):
    """Slip to and fro, opening and closing again: interface = layer = closed form."""
    limit, full = check_column(law, eps)
    for history in (limit, full):
        largest = np.abs(history.table["supplied"]).max()
        left = [history.table[name] for name in ("supplied", "stored", "dissipated", "remainder")]
        assert np.abs(left[0] - sum(left[1:])).max() < 1e-9 * largest
        assert (history.table["dissipated"] > -1e-9 * largest).all()
        assert history.table["dissipated"].max() > 0.1 * largest


@pytest.mark.few(5)
@pytest.mark.parametrize("eps", [0.3, 1e-2, 1e-4])
def test_the_band_is_contact_on_columns(eps):
    check_column(BAND, eps, on_s=CONTACT)


def test_rotated_columns():
    check_column(BAND, 0.05, angle=2.5, on_s=CONTACT)


def test_slip_that_turns_in_three_dimensions():
    """The direction of slip follows the tangential displacement; the component across it is not clipped by itself."""
    _, full = check_column(BAND, 0.02, moves=(*TURNING, *CLOSING), on_s=CONTACT)
    t, w, _ = closed_form(BAND, TURNING)
    assert abs(t[2, 0] * w[2, 1] - t[2, 1] * w[2, 0]) > 1e-3  # traction and jump are not parallel
    assert full.table["dissipated"].max() > 0.01


def test_stacked_columns():
    """Beside an elastic sublayer compliances add; the threshold is on the traction of both (Eqs. 54-55)."""
    elastic = LinearElastic(1.5 * LMBDA, 1.5 * MU)
    check_column(Stack((0.4, elastic), (0.6, replace(PULLED, cohesion=0.2))), 0.05)


# ------------------------------------------------------------------------ signs
def test_opening_and_closing():
    """Pulled, the unilateral layer carries nothing and the bilateral one what an elastic one does; pressed, they agree."""
    where, setup, *_ = column(PULLED, ((0.0, 0.0),))
    sides = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    expected = {True: {0.01: 0.0, -0.01: -1.0}, False: {0.01: 1.0, -0.01: -1.0}}
    for law in (BAND, PULLED):
        for move, factor in expected[law.unilateral].items():
            setup |= {"supports": {"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": move}, **sides}, "tractions": {}}
            pulled, layer = Structure(where, **setup), ThinLayer(law, 0.02, at=1.0)
            for model in (pulled.full(layer, cells_through=1), pulled.interface(layer)):
                surface = Surface(pulled.interface(layer))
                force = surface.integral(surface.traction(solve(model))[1])
                assert force == pytest.approx(factor * 0.01 / (1 / K_N + C_N), rel=1e-9, abs=1e-12)


def test_friction_pulls_the_lower_side_along():
    """The upper body moved towards +x: t_T > 0 on the lower side, and the other way round."""
    for way in (1, -1):
        t, w, _ = closed_form(BAND, ((0.0, -0.1), (way * 0.5, -0.1)))
        assert t[1, 0] == pytest.approx(way * FRICTION * 0.1 / (1 / K_N + C_N))
        assert way * w[1, 0] > 0


# ------------------------------------------------------------------------ error O(eps)
def errors(eps, band=BAND, on_s=None, cells=32):
    where, setup = pressed(1 / cells, sweep_friction.ONCE)
    setup |= {"element": "Q1"}
    on_s = on_s or HolonomicCoulomb.of_layer(LMBDA, MU, friction=FRICTION)
    plates = Structure(where, **setup)
    full = solve(plates.full(ThinLayer(band, eps, at=1.0), cells_through=1))
    return compare(full, solve(plates.interface(layer_of(on_s, eps))))


@cache
def right(eps):
    return errors(eps)


@pytest.mark.parametrize("name", ["error_traction", "error_jump"])
def test_order_1(name):
    eps = (1 / 64, 1 / 128)
    *_, order = observed_orders(eps, [right(e)[name] for e in eps])
    assert order == pytest.approx(1.0, abs=0.1)


@pytest.mark.few(5)
@pytest.mark.parametrize(
    ("wrong", "floor"),
    [
        (HolonomicCoulomb.of_layer(LMBDA, MU, friction=math.sin(math.radians(OMEGA))), 0.02),
        (replace(BAND, unilateral=False), 0.15),
    ],
    ids=["sin(Omega)", "bilateral"],
)
def test_wrong_laws_leave_an_error(wrong, floor):
    for eps in (1 / 64, 1 / 256):
        row = errors(eps, on_s=wrong)
        assert min(row["error_traction"], row["error_jump"]) > floor
    assert max(right(1 / 256)["error_traction"], right(1 / 256)["error_jump"]) < floor / 3
