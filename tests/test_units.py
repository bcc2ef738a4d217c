"""No result depends on units: the same structures in other units of length, stress and time, and under scaled loads.

The tolerance 1e-6 is that of Newton's method, 1e-10 of the forces, times how much softer than the bodies a layer is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from forms import (
    Anisotropic,
    HolonomicCoulomb,
    Incompressible,
    IncrementalCoulomb,
    KelvinVoigt,
    LinearElastic,
    Maxwell,
    MohrCoulomb,
    MohrCoulombMonodirectional,
    NonMonotone,
    NonMonotoneUnrelaxed,
    Norton,
    Stack,
    TractionLaw,
    Tresca,
)
from geometry import sandwich
from tests.own_laws import Slipping
from thinlayer import Adaptive, ArcLength, Structure, ThinLayer, march, piecewise, solve


@dataclass(frozen=True)
class Units:
    """How many units a millimetre, a megapascal and an hour are, and a factor of loads and of thresholds of stress."""

    length: float = 1.0
    stress: float = 1.0
    time: float = 1.0
    load: float = 1.0

    @property
    def stiffness(self):
        """A megapascal per millimetre."""
        return self.stress / self.length


SI = Units(1e-3, 1e6, 3600.0)
MICRO = Units(1e3, 1.0, 3.6e9)  # micrometres, megapascals, microseconds
KM = Units(1e-6, 1e-3, 1.0)  # kilometres, gigapascals
SYSTEMS = {"m-Pa-s": SI, "um-MPa-us": MICRO, "km-GPa-h": KM}
LOADS = {"loads 1e-9": Units(load=1e-9), "loads 1e9": Units(load=1e9)}


def elastic(u, k=1.0):
    return LinearElastic(60.0 * k * u.stiffness, 40.0 * k * u.stiffness)


def norton(u, rest=None):
    named = {} if rest is None else {"rest": rest / u.time}
    return Norton(50.0 * u.stiffness, 10.0 * u.stiffness, 30.0 * u.stress * (u.time / u.length) ** 0.5, 1.5, **named)


CHI = [[0.2, 0.5], [0.5, 1.0]]


def yielding(u, make=MohrCoulomb, **more):
    return make(60.0 * u.stiffness, 40.0 * u.stiffness, 0.3 * u.stress * u.load, 30, elastic_fraction=0.05, **more)


def phases(u, make, d=2):
    chi = np.zeros((d, d))
    chi[:2, :2] = CHI
    C = (0.5 * u.load) ** 2 * u.stress * u.length / 60.0
    return make(60.0 * u.stiffness, 40.0 * u.stiffness, 0.5 * u.stress * u.load, C, chi.tolist())


LAWS = {
    "elastic": elastic,
    "anisotropic": lambda u: Anisotropic(np.diag([0, 100.0, 0, 40.0, 0, 40.0]) * u.stiffness, "layer"),
    "incompressible": lambda u: Incompressible(40.0 * u.stiffness),
    "Kelvin-Voigt": lambda u: KelvinVoigt(60.0 * u.stiffness, 40.0 * u.stiffness, 1.5 * u.time, 0.8 * u.time),
    "Maxwell": lambda u: Maxwell(60.0 * u.stiffness, 40.0 * u.stiffness, 2.0 * u.time, 3.0 * u.time),
    "Mohr-Coulomb": lambda u: yielding(u, dilatancy_angle=5.0),
    "monodirectional": lambda u: yielding(u, MohrCoulombMonodirectional),
    "non-monotone": lambda u: phases(u, NonMonotone),
    "pure phases": lambda u: phases(u, NonMonotoneUnrelaxed),
    "stack": lambda u: Stack((0.4, elastic(u)), (0.6, elastic(u, 1e4))),
    "yielding stack": lambda u: Stack((0.4, elastic(u)), (0.6, yielding(u))),
    "slipping": lambda u: Slipping(
        100.0 * u.stiffness, 40.0 * u.stiffness, 90.0 * u.stiffness * u.time, 20.0 * u.stiffness / u.length / u.load
    ),
    "holonomic": lambda u: HolonomicCoulomb(100.0 * u.stiffness, 40.0 * u.stiffness, 0.5, 0.05 * u.stress * u.load),
    "incremental": lambda u: IncrementalCoulomb(100.0 * u.stiffness, 40.0 * u.stiffness, 0.5),
    "Tresca": lambda u: Tresca(100.0 * u.stiffness, 40.0 * u.stiffness, 0.4 * u.stress * u.load),
}
IN_SPACE = LAWS | {"non-monotone": lambda u: phases(u, NonMonotone, 3)}


def loads(u):
    """Pressed, pushed along and bent; a break of the slopes in between."""
    p = u.stress * u.load
    grow = piecewise({0: 0.4, u.time: 1.0, 2 * u.time: 0.7})
    return {"TOP": lambda x, t: (0.7 * p * grow(x, t), -(1.0 + 0.02 * x[0] / u.length) * p * grow(x, t))}


def structure(u, law, kind="interface", depth=None, **more):
    a = u.length
    size = {} if depth is None else {"depth": depth * a, "cell": "hexahedron"}
    joint = sandwich(20 * a, 4 * a, 6 * a, h=(2.5 if depth is None else 5.0) * a, structured=depth is None, **size)
    d = joint.dim
    contact = not isinstance(law, (ThinLayer,)) and hasattr(law, "K_N")
    layer = law if contact or isinstance(law, TractionLaw) else ThinLayer(law, 0.5 * a, **more.pop("layer", {}))
    body = LinearElastic.young(E=1e3 * u.stress, nu=0.3)
    supports = {"BOTTOM": 0, "RIGHT": {"x": 0}} | ({"BACK": {"z": 0}} if d == 3 else {})
    element = "P1" if contact else "P2"
    if d == 3:
        element = "Q1" if contact or "element" not in more else more.pop("element")
    push = loads(u)["TOP"]
    tractions = {"TOP": (lambda x, t: (*push(x, t), 0.1 * u.stress * u.load * t / u.time)) if d == 3 else push}
    make = getattr(Structure, kind)
    return make(Structure(joint, body=body, supports=supports, tractions=tractions, element=element, **more), layer)


def measured(model, state, u, energy=True):
    """Displacements at the vertices of the mesh and the energies, in millimetres, megapascals and loads."""
    a, d = u.length * u.load, model.joint.dim
    values = state.u.x.array.reshape(-1, d) / a
    order = np.lexsort(np.round(model.V.tabulate_dof_coordinates()[: len(values)] / u.length, 6).T)
    out = [
        np.abs(values).max(axis=0),
        (values**2).sum(axis=0) ** 0.5,
        values[order[:: max(len(order) // 7, 1)]].ravel(),
    ]
    if energy:
        unit = u.stress * u.load**2 * u.length**d
        audit = state.audit
        out.append(np.array([audit.supplied, audit.stored, audit.dissipated, audit.remainder, audit.total]) / unit)
    return np.concatenate(out)


@cache
def run(name, u, kind="interface", depth=None):
    law = (IN_SPACE if depth else LAWS)[name](u)
    model = structure(u, law, kind, depth)
    if name == "elastic":
        return measured(model, solve(model, 2 * u.time), u)
    history = march(model, [0.5 * u.time, 1.5 * u.time, 2 * u.time])
    return np.concatenate([measured(model, state, u) for state in (history.at(1.5 * u.time), history.last)])


def same(found, expected, rel=1e-6):
    """Each block of numbers is compared with its own largest one: single entries may vanish by symmetry."""
    assert np.array_equal(np.isnan(found), np.isnan(expected))
    size = np.nanmax(np.abs(expected))
    assert np.nanmax(np.abs(found - expected)) <= rel * size
    big = np.abs(expected) > 1e-3 * size
    assert found[big] == pytest.approx(expected[big], rel=10 * rel)


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("name", LAWS)
def test_units(name, system):
    same(run(name, SYSTEMS[system]), run(name, Units()))


@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize("name", LAWS)
def test_scaled_loads(name, load):
    """Loads and thresholds times a number: so are displacements; energies go with its square."""
    same(run(name, LOADS[load]), run(name, Units()))


def test_norton():
    """The viscosity is a stress times (time/length)^(p - 1); the law's own rest rate needs no units."""

    def found(u):
        model = structure(u, norton(u))
        return measured(model, march(model, [0.5 * u.time, u.time, 1.5 * u.time]).last, u)

    for u in SYSTEMS.values():
        same(found(u), found(Units()))


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("name", ["elastic", "Mohr-Coulomb", "pure phases", "incompressible"])
def test_meshed_layers(name, system):
    same(run(name, SYSTEMS[system], "full"), run(name, Units(), "full"))


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("name", ["Mohr-Coulomb", "holonomic", "non-monotone"])
def test_three_dimensions(name, system):
    same(run(name, SYSTEMS[system], depth=10), run(name, Units(), depth=10))


@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("method", ["condensed", "multigrid", "newton", "relaxation"])
def test_solvers_of_contact(method, system):
    def found(u):
        model = structure(u, LAWS["holonomic"](u))
        return measured(model, solve(model, u.time, method=method), u, energy=False)

    same(found(SYSTEMS[system]), found(Units()))


@pytest.mark.parametrize("system", SYSTEMS)
def test_next_order_and_profiles(system):
    def found(u):
        flat = structure(u, elastic(u), layer={"order": 1})
        wedge = structure(u, elastic(u), layer={"profile": lambda x: 1 + 0.02 * x[0] / u.length})
        return np.concatenate([measured(m, solve(m, u.time), u) for m in (flat, wedge)])

    same(found(SYSTEMS[system]), found(Units()))


@pytest.mark.parametrize("system", {**SYSTEMS, **LOADS})
def test_adaptive_steps(system):
    """The same steps are taken."""

    def found(u):
        model = structure(u, LAWS["Maxwell"](u))
        history = march(model, Adaptive(end=2 * u.time, first=0.2 * u.time, tolerance=1e-3))
        return np.concatenate([np.array(history.t) / u.time, measured(model, history.last, u)])

    same(found((SYSTEMS | LOADS)[system]), found(Units()))


def test_paths():
    """An equilibrium path over a snap, whose parameter is no time: the same steps."""

    def found(u):
        law = NonMonotone(
            0.0, 10.0 * u.stiffness, 1.5 * u.stress * u.load, 0.15 * u.load**2 * u.stress * u.length, [[0, 0], [0, 1]],
            mixing=0.5,
        )  # fmt: skip
        a = u.length
        joint = sandwich(20 * a, 4 * a, 6 * a, h=10 * a, structured=True)
        pull = {"y": lambda x, t: t * u.load * a * (0.5 + 0.02 * x[0] / a), "x": 0}
        body = LinearElastic.young(E=1e2 * u.stress, nu=0.3)
        model = Structure(joint, body=body, supports={"BOTTOM": 0, "TOP": pull}).interface(ThinLayer(law, a))
        history = march(model, ArcLength(end=0.3, first=0.15))
        return np.concatenate([np.array(history.t), measured(model, history.last, u)])

    same(found(Units(1e-3, 1e6, 3600.0, 1e-9)), found(Units()))
