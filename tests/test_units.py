"""No result depends on units: the same structures in other units of length, stress and time, and under scaled loads.

The tolerance 1e-6 is that of Newton's method, 1e-10 of the forces, times how much softer than the bodies a layer is.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from forms import (
    HolonomicCoulomb,
    Incompressible,
    IncrementalCoulomb,
    LinearElastic,
    NonMonotone,
    TractionLaw,
)
from geometry import sandwich
from tests.test_units_of_laws import LAWS as OF_POINTS
from tests.test_units_of_laws import Units
from thinlayer import Adaptive, ArcLength, Structure, ThinLayer, march, piecewise, solve
from thinlayer.parts.pressure_part import PressurePart
from thinlayer.solving.solve import Solver

pytestmark = pytest.mark.few(5)

OTHER = Units(L=1.7e-4, P=1.3e6, T=1.1e3, size=1.9e-9)  # changes all four


CONTACT = {
    "holonomic": lambda u: HolonomicCoulomb(100.0 * u.P / u.L, 40.0 * u.P / u.L, 0.5, 0.05 * u.P * u.size),
    "incremental": lambda u: IncrementalCoulomb(100.0 * u.P / u.L, 40.0 * u.P / u.L, 0.5),
    "incompressible": lambda u: Incompressible(40.0 * u.P / u.L),
}
HARDENING, PURE = "Mohr-Coulomb, hardening", "non-monotone, pure"
TAKEN = ("elastic", "Kelvin-Voigt", "Maxwell", "Norton's creep", "non-monotone", "user, jumps", HARDENING, PURE)
LAWS = {name: OF_POINTS[name] for name in (*TAKEN, "stack, elastic")} | CONTACT


def loads(u):
    """Pressed, pushed along and bent; a break of the slopes in between."""
    p = u.P * u.size
    grow = piecewise({0: 0.4, u.T: 1.0, 2 * u.T: 0.7})
    return {"TOP": lambda x, t: (0.7 * p * grow(x, t), -(1.0 + 0.02 * x[0] / u.L) * p * grow(x, t))}


def structure(u, law, kind="interface", depth=None, **more):
    a = u.L
    size = {} if depth is None else {"depth": depth * a, "cell": "hexahedron"}
    joint = sandwich(20 * a, 4 * a, 6 * a, h=(2.5 if depth is None else 5.0) * a, structured=depth is None, **size)
    d = joint.dim
    contact = hasattr(law, "K_N")
    layer = law if contact or isinstance(law, TractionLaw) else ThinLayer(law, 0.5 * a, at=1.0, **more.pop("layer", {}))
    body = LinearElastic.young(E=1e3 * u.P, nu=0.3)
    supports = {"BOTTOM": 0, "RIGHT": {"x": 0}} | ({"BACK": {"z": 0}} if d == 3 else {})
    element = "Q1" if d == 3 else "P1" if contact else "P2"
    push = loads(u)["TOP"]
    tractions = {"TOP": (lambda x, t: (*push(x, t), 0.1 * u.P * u.size * t / u.T)) if d == 3 else push}
    make = getattr(Structure, kind)
    return make(Structure(joint, body=body, supports=supports, tractions=tractions, element=element, **more), layer)


def measured(model, state, u, energy=True):
    """Displacements at the vertices of the mesh and the energies, in millimetres, megapascals and loads."""
    a, d = u.L * u.size, model.joint.dim
    values = state.u.x.array.reshape(-1, d) / a
    order = np.lexsort(np.round(model.V.tabulate_dof_coordinates()[: len(values)] / u.L, 6).T)
    some = values[order[:: max(len(order) // 7, 1)]]
    out = [np.abs(values).max(axis=0), (values**2).sum(axis=0) ** 0.5, some.ravel()]
    if energy:
        unit = u.P * u.size**2 * u.L**d
        audit = state.audit
        out.append(np.array([audit.supplied, audit.stored, audit.dissipated, audit.remainder, audit.total]) / unit)
    return np.concatenate(out)


@cache
def run(name, u, kind="interface", depth=None):
    model = structure(u, LAWS[name](u), kind, depth)
    if name == "elastic":
        return measured(model, solve(model, 2 * u.T), u)
    history = march(model, [0.5 * u.T, 1.5 * u.T, 2 * u.T])
    return np.concatenate([measured(model, state, u) for state in (history.at(1.5 * u.T), history.last)])


def same(actual, expected, rel=1e-6):
    """Each block of numbers is compared with its own largest one: single entries may vanish by symmetry."""
    assert np.array_equal(np.isnan(actual), np.isnan(expected))
    size = np.nanmax(np.abs(expected))
    assert np.nanmax(np.abs(actual - expected)) <= rel * size
    big = np.abs(expected) > 1e-3 * size
    assert actual[big] == pytest.approx(expected[big], rel=10 * rel)


CASES = [(name, "interface", None) for name in LAWS]
CASES += [(name, "full", None) for name in ("elastic", HARDENING, PURE, "incompressible")]
CASES += [(name, "interface", 10) for name in (HARDENING, "holonomic")]


@pytest.mark.parametrize(("name", "kind", "depth"), CASES)
def test_units_and_loads(name, kind, depth):
    """Loads and thresholds times a number: so are displacements; energies go with its square."""
    same(*(run(name, u, kind, depth) for u in (OTHER, Units())))


@pytest.mark.parametrize("kind", ["interface", "full"])
def test_equations_of_pressures_are_scaled_by_the_stiffness_of_layers(kind):
    """`unit` is a pressure over a length, so that a volume times it is a force."""

    def unit(u):
        with Solver(structure(u, LAWS["incompressible"](u), kind)) as solver:
            (part,) = solver.equations.of_kind(PressurePart)
            return part.unit

    assert unit(OTHER) == pytest.approx(unit(Units()) * OTHER.P / OTHER.L, rel=1e-6)


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["condensed", "multigrid", "newton", "relaxation"])
def test_solvers_of_contact(method):
    def response(u):
        model = structure(u, LAWS["holonomic"](u))
        return measured(model, solve(model, u.T, method=method), u, energy=False)

    same(response(OTHER), response(Units()))


def test_next_order_and_profiles():
    def response(u):
        flat = structure(u, LAWS["elastic"](u), layer={"order": 1})
        wedge = structure(u, LAWS["elastic"](u), layer={"profile": lambda x: 1 + 0.02 * x[0] / u.L})
        return np.concatenate([measured(m, solve(m, u.T), u) for m in (flat, wedge)])

    same(response(OTHER), response(Units()))


def test_adaptive_steps():
    """The same steps are taken."""

    def response(u):
        model = structure(u, LAWS["Maxwell"](u))
        history = march(model, Adaptive(end=2 * u.T, first=0.2 * u.T, tolerance=1e-3))
        return np.concatenate([np.array(history.t) / u.T, measured(model, history.last, u)])

    same(response(OTHER), response(Units()))


def test_paths():
    """An equilibrium path over a snap, whose parameter is no time: the same steps."""

    def response(u):
        a, energy = u.L, 0.15 * u.size**2 * u.P * u.L
        law = NonMonotone(0.0, 10.0 * u.P / u.L, 1.5 * u.P * u.size, energy, [[0, 0], [0, 1]], mixing=0.5)
        joint = sandwich(20 * a, 4 * a, 6 * a, h=10 * a, structured=True)
        pull = {"y": lambda x, t: t * u.size * a * (0.5 + 0.02 * x[0] / a), "x": 0}
        body = LinearElastic.young(E=1e2 * u.P, nu=0.3)
        model = Structure(joint, body=body, supports={"BOTTOM": 0, "TOP": pull}).interface(ThinLayer(law, a, at=1.0))
        history = march(model, ArcLength(end=0.3, first=0.15))
        return np.concatenate([np.array(history.t), measured(model, history.last, u)])

    same(response(OTHER), response(Units()))
