"""The midpoint rule: of second order with laws that creep or relax, refused with those that it says nothing of."""

from __future__ import annotations

import numpy as np
import pytest

from forms import (
    Incompressible,
    IncrementalCoulomb,
    KelvinVoigt,
    LinearElastic,
    MohrCoulomb,
    NonMonotone,
    NonMonotoneUnrelaxed,
    Stack,
)
from forms.base import InputError
from tests.own_laws import (
    AgeingFluid,
    AgeingSpring,
    Cubic,
    Mises,
    layer_of,
)
from tests.refused import refused
from tests.softening_bars import Undeclared
from tests.viscous_joints import BODY, JOINT
from thinlayer import Structure, Surface, ThinLayer, march, piecewise

pytestmark = pytest.mark.few(5)

SUPPORTS = {"BOTTOM": 0.0, "LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}}
ELASTIC, CREEP = LinearElastic(60.0, 40.0), KelvinVoigt(60.0, 40.0, theta_lmbda=0.3, theta_mu=0.5)
LOAD = piecewise({0.0: 0.1, 0.5: 1.7, 1.0: 1.7, 1.5: -0.4})  # up, held, turned back


def model(law, kind=Structure.interface, **change):
    setup = {"body": BODY, "supports": SUPPORTS, "tractions": {"TOP": lambda x, t: (LOAD(x, t), 0.0)}} | change
    return kind(Structure(JOINT, **setup), layer_of(law, 0.1))


def of_order_1(structure, layer):
    return structure.interface(ThinLayer(layer.law, layer.eps, order=1, at=1.0))


MODELS = [(Structure.interface, 0.6), (of_order_1, 0.0), (Structure.full, 0.6)]


@pytest.mark.parametrize(("kind", "growth"), MODELS, ids=["S", "order 1", "full"])
def test_parameters_that_vary_in_time_are_those_where_forces_balance(kind, growth):
    """A column under a dead load p, in closed form: w - f = p/2mu(t), df/dt = p/(2mu(t) tau(t)); w at the end of all steps.

    Twice as many steps have a quarter of the error (0.27: fourth powers of steps), also of the energy (w - f) p/2.
    """
    p, mu, tau, end = 1.7, 20.0, 0.8, 2.0
    supports = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    column = model(AgeingFluid(mu, tau, growth), kind, supports=supports, tractions={"TOP": (0.0, p)})
    surface = Surface(model(ELASTIC))

    def error(parts):
        history = march(column, [end * (k + 1) / parts for k in range(parts)], theta=0.5)
        t = np.array(history.t)
        elastic = p / (2 * mu * (1 + growth * t))
        w = elastic + p / (2 * mu * tau) * np.log((1 + growth * t) / (1 + t)) / (growth - 1)
        jumps = np.array([surface.integral(surface.jump(state)[1]) for state in history])
        stored = [state.energies()["layer"] for state in history]
        return np.abs(jumps / w - 1).max(), np.abs(stored / (elastic * p / 2) - 1).max()

    coarse, fine = error(12), error(24)
    assert fine[0] < 0.27 * coarse[0] < 0.01
    assert fine[1] < max(0.29 * coarse[1], 1e-9)
    assert coarse[1] < 0.1


def test_elastic_layers_have_no_error():
    """Equilibria within steps and at their ends are the same ones, pressures too; also where moduli vary along S."""
    for law in (ELASTIC, Incompressible(40.0), AgeingSpring(40.0, 0.0, along=0.8)):
        column = model(law, Structure.full if law.traits.constrained else Structure.interface)
        midpoint, euler = (march(column, [0.2, 0.5, 0.9, 1.0], theta=theta).last for theta in (0.5, 1.0))
        assert midpoint.u.x.array == pytest.approx(euler.u.x.array, rel=1e-8, abs=1e-12)
        if law.traits.constrained:
            assert midpoint.p.x.array == pytest.approx(euler.p.x.array, rel=1e-7, abs=1e-9)


CHI = [[0.0, 0.5], [0.5, 1.0]]
YIELDING = (60.0, 40.0, 0.3, 30.0)
HEATED = NonMonotone(60.0, 40.0, lambda T: 1.5 - T / 10, 0.15, CHI, T=lambda x, t: t + 0 * x[0])
REFUSED = {
    "MohrCoulomb": (MohrCoulomb(*YIELDING), "MohrCoulomb bounds stresses"),
    "stacked": (Stack((0.5, CREEP), (0.5, MohrCoulomb(*YIELDING))), "MohrCoulomb bounds stresses"),
    "NonMonotone": (NonMonotone(60.0, 40.0, 1.5, 0.15, CHI), "NonMonotone answers at once, and not linearly"),
    "pure phases": (NonMonotoneUnrelaxed(60.0, 40.0, 1.5, 0.15, CHI), "NonMonotoneUnrelaxed holds at the ends"),
    "elastic": (Cubic(20.0, 50.0), "Cubic answers at once, and not linearly"),
    "plasticity of one's own": (Mises(60.0, 40.0, 0.6), "Mises answers at once, and not linearly"),
    "ageing": (AgeingSpring(40.0, 0.3), "AgeingSpring answers at once, and with parameters that change in time"),
    "heated": (HEATED, "NonMonotone answers at once"),
    "jumps": (Undeclared(20.0, 1e-7), "Undeclared answers at once, and not linearly"),
}


@pytest.mark.few(1)
@pytest.mark.parametrize("name", REFUSED)
def test_refused(name, tmp_path):
    """Before anything is solved; limit loads would come out too high, and steps beyond them find states that are none."""
    law, reason = REFUSED[name]
    with pytest.raises(InputError, match=rf"theta is 0\.75; {reason}.*theta = 1"):
        march(model(law), [0.5, 1.0], theta=0.75, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_bodies_that_are_not_linear_and_contact_are_refused():
    bent = {"LOWER": BODY, "UPPER": Cubic(100.0, 50.0)}
    refused(InputError, "Cubic answers at once", lambda: march(model(CREEP, body=bent), [1.0], theta=0.5))
    contact = model(IncrementalCoulomb(100.0, 80.0, 0.3), element="P1")
    refused(InputError, "Coulomb holds at the ends of steps: theta = 1", lambda: march(contact, [1.0], theta=0.5))
