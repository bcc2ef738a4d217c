"""Eigenstrains of layers: free and held shrinkage, histories, layers that remember or yield, the next order in eps."""

import pytest
import ufl

from forms import Incompressible, KelvinVoigt, LinearElastic, Maxwell, Rubber, Stack
from geometry import sandwich
from studies.problems import FOURIER_LAYER, fourier
from tests.orders import observed_orders
from tests.own_laws import layer_of
from thinlayer import (
    Structure,
    Surface,
    ThermalExpansion,
    ThinLayer,
    march,
    piecewise,
    solve,
)

pytestmark = pytest.mark.few(5)

STEEL, EPS, WIDTH = LinearElastic.young(3e4, 0.3), 0.1, 2.0
GLUE = LinearElastic(70.0, 50.0)  # per thickness
KINDS = ("full", "interface")
JOINT = sandwich(WIDTH, 0.5, 0.75, 0.5, cell="quadrilateral", structured=True)
SLIDING = {"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}  # the upper body is free to come down
HELD = SLIDING | {"TOP": {"y": 0.0}}


def model(kind, law, eigenstrain, supports=SLIDING, plane="strain", **data):
    plates = Structure(JOINT, body=STEEL, supports=supports, plane=plane, **data)
    return getattr(plates, kind)(ThinLayer(law, EPS, eigenstrain=eigenstrain, at=1.0))


def across(state):
    """Mean normal traction and jump on S."""
    structure = Structure(JOINT, body=STEEL, supports=SLIDING, plane=state.model.plane)
    surface = Surface(structure.interface(layer_of(GLUE, EPS)))
    t, w = surface.traction(state), surface.jump(state)
    return surface.integral(t[1]) / WIDTH, surface.integral(w[1]) / WIDTH


# ---------------------------------------------------------------- free
SHRINKING = zip(KINDS, [Maxwell(70.0, 50.0, t1=0.7, t2=0.9), Stack((0.3, GLUE), (0.7, FOURIER_LAYER))], strict=True)


@pytest.mark.parametrize(("kind", "law"), SHRINKING)
def test_a_layer_that_shrinks_freely_has_no_stress(kind, law):
    """It closes by eps e; what is left are roundings of (lmbda + 2 mu) e."""
    state = solve(model(kind, law, ((0.0, 0.0), (0.0, -3e-3))))
    assert across(state) == pytest.approx((0.0, -3e-3 * EPS), rel=1e-12, abs=1e-13)
    energies = state.energies()
    assert energies["bodies"] + energies["layer"] < 1e-18
    assert across(solve(model(kind, law, ((0.0, 0.0), (0.0, -3e-3)), HELD)))[0] > 0.01


@pytest.mark.parametrize("plane", ["strain", "stress"])
def test_uniform_shrinkage_on_s_is_resisted_along_s(plane):
    """The plates keep the layer's length: it closes by (3 lmbda + 2 mu)/(lmbda + 2 mu), in plane stress by 1 + nu."""
    nu = GLUE.lmbda / (2 * (GLUE.lmbda + GLUE.mu))
    factor = (3 * 70 + 2 * 50) / (70 + 2 * 50) if plane == "strain" else 1 + nu
    state = solve(model("interface", GLUE, -3e-3, plane=plane))
    assert across(state) == pytest.approx((0.0, -3e-3 * EPS * factor), rel=1e-9, abs=1e-12)


# ---------------------------------------------------------------- held, in time
@pytest.mark.few(5)
@pytest.mark.parametrize("kind", KINDS)
def test_the_stress_of_a_held_layer_follows_the_history_of_its_shrinkage(kind):
    """C e of an elastic one, the relaxing integral of a Maxwell one step by step; plates and layer in series."""
    M = (170.0 * EPS, 310.0 * EPS)  # lmbda + 2 mu, 3 lmbda + 2 mu
    plates = (STEEL.lmbda + 2 * STEEL.mu) / 1.25
    series = plates / (plates + M[0] / EPS)
    times, shrinkage = [0.5, 1.0, 2.0], piecewise({0: 0.0, 1: -2e-3, 2: -3e-3})
    for law in (GLUE, Maxwell(70.0, 50.0, t1=1e12)):
        history = march(model(kind, law, ThermalExpansion(1.0, shrinkage), HELD), times)
        stresses = [across(state)[0] for state in history][1:]
        near = 2e-2 if kind == "full" else 1e-7  # the meshed layer also shrinks along S, at its free ends
        assert stresses == pytest.approx([M[1] * e * series for e in (1e-3, 2e-3, 3e-3)], rel=near)
        assert max(abs(state.audit.imbalance) for state in history) < 1e-10
    t1 = 0.8
    relaxing = march(model("interface", Maxwell(70.0, 50.0, t1=t1), ThermalExpansion(1.0, shrinkage), HELD), times)
    stress, before = [0.0], 0.0
    for dt, e in ((0.5, 1e-3), (0.5, 2e-3), (1.0, 3e-3)):
        # s + s dt/t1 = s_old + M1 de - M0/eps dw with dw = -s/plates
        grown = M[1] * (e - before)
        stiff = M[0] / EPS / plates
        stress.append((stress[-1] * (1 + stiff) + grown) / (1 + dt / t1 + stiff))
        before = e
    assert [across(state)[0] for state in relaxing] == pytest.approx(stress, rel=1e-7, abs=1e-13)
    assert max(abs(state.audit.imbalance) for state in relaxing) < 1e-10


def test_a_rate_law_answers_to_the_rate_of_shrinkage():
    """Kelvin-Voigt between rigid plates: elastic stress plus theta times the rate; none of a strain that always was."""
    law = KelvinVoigt(70.0, 50.0, theta_lmbda=0.3, theta_mu=0.2)
    stiff = Structure(JOINT, body=LinearElastic.young(3e9, 0.3), supports=HELD)
    for shrinkage, e, rate in ((lambda x, t: -1e-3 * t, 5e-4, 1e-3), (-1e-3, 1e-3, 0.0)):
        history = march(stiff.interface(ThinLayer(law, EPS, eigenstrain=shrinkage, at=1.0)), [0.5, 1.0])
        surface, viscous = Surface(history.last.model), rate * (3 * 70 * 0.3 + 2 * 50 * 0.2)
        first, last = (surface.integral(surface.traction(history.at(t))[1]) / WIDTH for t in (0.5, 1.0))
        assert first == pytest.approx(EPS * (e * (3 * 70 + 2 * 50) + viscous), rel=1e-5)
        assert last == pytest.approx(EPS * (1e-3 * (3 * 70 + 2 * 50) + viscous), rel=1e-5)
        assert max(abs(state.audit.imbalance) for state in history) < 1e-9


@pytest.mark.parametrize(("kind", "theta"), zip(KINDS, (1.0, 0.5), strict=True))
def test_an_incompressible_layer_that_expands(kind, theta):
    """It keeps the volume that its expansion gives it: 3 e eps across, as the plates hold it along S; energies balance."""
    stiff = Structure(JOINT, body=LinearElastic.young(3e7, 0.3), supports=SLIDING)
    rubber = ThinLayer(Incompressible(50.0), EPS, eigenstrain=ThermalExpansion(2e-3, lambda x, t: 0.5 + t / 2), at=1.0)
    history = march(getattr(stiff, kind)(rubber), [0.5, 1.0], theta=theta)
    assert across(history.last) == pytest.approx((0.0, 3 * 2e-3 * EPS), rel=1e-7, abs=1e-6)
    assert max(abs(state.audit.imbalance) for state in history) < 1e-7  # rounding of stiff plates
    pressed = march(getattr(Structure(JOINT, body=STEEL, supports=HELD), kind)(rubber), [0.5, 1.0], theta=theta)
    series = 3 * 2e-3 * EPS * (STEEL.lmbda + 2 * STEEL.mu) / 1.25
    assert across(pressed.last)[0] == pytest.approx(-series, rel=1e-7 if kind == "interface" else 0.05)
    assert max(abs(state.audit.imbalance) for state in pressed) < 1e-9


# ---------------------------------------------------------------- orders in eps
def varying(size):
    """A strain that varies along S as the loads of the Fourier problem do."""

    def strain(x, t):
        c, s = ufl.cos(ufl.pi * x[0]), ufl.sin(ufl.pi * x[0])
        return [[0.3 * size * c, 0.5 * size * s, 0], [0.5 * size * s, 0.7 * size * c, 0], [0, 0, 0.2 * size * c]]

    return strain


OF_ORDER_1 = [(FOURIER_LAYER, False), (FOURIER_LAYER, True), (Rubber(600.0, 40.0), True)]


@pytest.mark.few(5)
@pytest.mark.parametrize(("law", "scaled"), OF_ORDER_1, ids=["fixed", "over eps", "rubber, over eps"])
def test_the_next_order_knows_the_eigenstrain(law, scaled):
    """Rate 2 with order 1, for strains that are fixed, of order eps in tractions, and for those over eps; 1 without."""
    joint, setup = fourier(1 / 16, cell="quadrilateral")
    eps, errors = (1 / 16, 1 / 32), {"order 1": [], "order 0": [], "none": []}
    for e in eps:
        strain, structure = varying(1e-3 / e if scaled else 2e-2), Structure(joint, **setup)
        full = solve(structure.full(ThinLayer(law, e, eigenstrain=strain, at=1.0)))
        for name, order, eigenstrain in (("order 1", 1, strain), ("order 0", 0, strain), ("none", 1, None)):
            layer = ThinLayer(law, e, order, eigenstrain=eigenstrain, at=1.0)
            surface = Surface((limit := solve(structure.interface(layer))).model)
            t = surface.reaction(limit)
            errors[name].append(surface.norm(surface.reaction(full) - t) / surface.norm(t))
    orders = {name: observed_orders(eps, values)[-1] for name, values in errors.items()}
    assert orders["order 1"] == pytest.approx(2.0, abs=0.12)
    assert orders["order 0"] == pytest.approx(1.0, abs=0.15)
    assert orders["none"] == pytest.approx(0.0 if scaled else 1.0, abs=0.12)
