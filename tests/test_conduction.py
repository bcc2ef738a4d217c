"""Scalar fields: laws of conduction on S and in meshed layers against closed forms, in steady problems and in time."""

import math
import warnings
from dataclasses import dataclass

import numpy as np
import pytest
import ufl

from forms import Conduction, FluxLaw, Heat
from geometry import sandwich
from tests.fourier import K, blocks, compliance, transfer
from tests.orders import observed_orders
from tests.refused import refused
from thinlayer import InputError, RangeWarning, Structure, Surface, ThinLayer, march, solve


def _closed_compliance(k, eps, law):
    """Return the compliance under the flux cos(K x) of blocks and layer."""
    if law == "meshed":
        return compliance(transfer(k, eps))
    across, along = k / eps, eps * k * K**2  # (q_lower + q_upper)/2 = h [T], q_upper - q_lower = G <T>
    h, G = {"order 1": (across + along / 12, along), "order 0": (across, 0.0), "lumped": (across, along)}[law]
    return compliance(np.linalg.solve([[-G / 2, 1.0], [h, -0.5]], [[G / 2, 1.0], [h, 0.5]]))


@pytest.mark.parametrize("k", [1 / 16, 3.0, 16.0])
def test_both_models_converge_to_their_closed_forms(k):
    eps, sizes, errors = 1 / 16, (1 / 4, 1 / 8), []
    for h in sizes:
        plates, layer = blocks(h), ThinLayer(Conduction(k), eps)
        models = {"meshed": plates.full(layer), "order 1": plates.interface(layer)}
        errors.append([solve(model).load_work() - _closed_compliance(k, eps, law) for law, model in models.items()])
    for column in np.transpose(errors):
        assert observed_orders(sizes, abs(column))[-1] > 3.9


def test_no_mean_of_the_layer_replaces_the_twelfth():
    """On a fine mesh S has the closed form of order 1, and not that without the energy of the jump's gradient."""
    plates, eps, k = blocks(1 / 16), 1 / 16, 1 / 16
    value = solve(plates.interface(ThinLayer(Conduction(k), eps))).load_work()
    assert value == pytest.approx(_closed_compliance(k, eps, "order 1"), abs=1e-6)
    assert value != pytest.approx(_closed_compliance(k, eps, "lumped"), abs=1e-5)


@pytest.mark.filterwarnings("ignore::thinlayer.RangeWarning")  # of order 0, which leaves its range
def test_order_1_is_uniform_in_the_ratio_of_conductivities():
    """C/(1 + K^2 delta^2) <= C_S <= C for K = pi and delta = eps/sqrt(12), for any ratio; order 0 breaks it."""
    eps, plates = 1 / 16, blocks()
    model = plates.interface(ThinLayer(Conduction(1.0), eps))
    zeroth = plates.interface(ThinLayer(Conduction(1.0), eps, order=0))
    broken = []
    for k in np.logspace(-4, 4, 9):
        exact, slack = _closed_compliance(k, eps, "meshed"), 3e-6
        lowest = exact / (1 + (math.pi * eps) ** 2 / 12)
        assert lowest - slack < solve(model.with_layer(ThinLayer(Conduction(k), eps))).load_work() < exact + slack
        value = solve(zeroth.with_layer(ThinLayer(Conduction(k), eps, order=0))).load_work()
        broken.append(not lowest - slack < value < exact + slack)
    assert sum(broken) > 4


@dataclass(frozen=True)
class Exponential(FluxLaw):
    """A conductivity k exp(a T)."""

    k: float
    a: float
    symmetric = False
    powers = {"k": 1}

    def flux(self, step):
        return self.k * ufl.exp(self.a * step.T) * step.g


@pytest.mark.parametrize("order", [0, 1])
def test_a_conductivity_that_varies_with_the_value(order):
    """Between blocks of resistance 1/2 the exact flux is 1.2476843816 (a = 1/2); k(<T>) would give 2.2e-3 less."""
    joint, eps = sandwich(0.5, 0.5, 0.5, h=0.25, cell="quadrilateral"), 1 / 16
    plates = Structure(joint, body=Conduction(1.0), supports={"BOTTOM": 0, "TOP": 2})
    layer = ThinLayer(Exponential(eps, 0.5), eps, order=order)
    full, limit = (solve(model).reaction("TOP").flow / 0.5 for model in (plates.full(layer), plates.interface(layer)))
    assert full == pytest.approx(1.2476843816, rel=2e-8)
    assert limit == pytest.approx(full, rel=2e-6)
    assert limit != pytest.approx(full, rel=1e-7)  # two stations, not the integral


def _heated(law, eps):
    joint = sandwich(1, 0.5, 0.5, h=1 / 16, h_S=1 / 2, cell="quadrilateral")
    plates = Structure(joint, body=Heat(1.0, 1.0), supports={"BOTTOM": 0}, fluxes={"TOP": 1.0}, initial=0)
    return plates.full(ThinLayer(law, eps)), plates.interface(ThinLayer(law, eps))


def test_a_sudden_flux_in_time():
    """T on top at t = 1/2 is .95262694 meshed and .95246850 on S, from 1D elements and modes; order 2 in time."""
    eps, steps, errors = 1 / 16, (20, 40), []
    exact = 0.95262694, 0.95246850
    for n in steps:
        times = np.linspace(0, 0.5, n + 1)[1:]
        values = [march(model, times, theta=0.5).last.u.x.array.max() for model in _heated(Heat(eps, 1.0), eps)]
        errors.append(np.subtract(values, exact))
    for column in np.transpose(errors):
        assert observed_orders([1 / n for n in steps], abs(column))[-1] > 1.9
        assert abs(column[-1]) < 5e-5
    no_capacity = march(_heated(Conduction(eps), eps)[1], times, theta=0.5).last.u.x.array.max()
    assert abs(no_capacity - exact[0]) > 1e-3


def test_an_initial_field_is_a_function_of_places_or_of_places_and_time():
    values = []
    for initial in (
        lambda x, t: 2 + ufl.sin(x[0]) * x[1],
        lambda x: 2 + ufl.sin(x[0]) * x[1],
        lambda x: 2 + np.sin(x[0]) * x[1],
    ):
        joint = sandwich(1, 0.5, 0.5, h=1 / 4, cell="quadrilateral")
        plates = Structure(joint, body=Heat(1.0, 1.0), supports={"BOTTOM": 0}, initial=initial)
        values.append(march(plates.full(ThinLayer(Heat(0.1, 1.0), 1 / 16)), [0.1]).last.u.x.array)
    assert values[1] == pytest.approx(values[0], rel=1e-12)
    assert values[2] == pytest.approx(values[0], rel=1e-12)
    assert np.ptp(values[0]) > 0.1


@pytest.mark.filterwarnings("ignore:.*body LOWER")
def test_a_conductivity_that_is_negative_where_the_solution_is():
    """A warning says where, how much, and what to do; there is none where it is positive."""

    @dataclass(frozen=True)
    class Falling(FluxLaw):
        a: float
        symmetric = False

        def flux(self, step):
            return (1 - self.a * step.T) * step.g

    def heated(lower, upper):
        joint = sandwich(1, 0.5, 0.5, h=1 / 4, cell="quadrilateral")
        return Structure(joint, body=Falling(0.5), supports={"BOTTOM": lower, "TOP": upper}, initial=lower)

    for kind in ("full", "interface"):
        words = r"conductivity of body UPPER is -0.9\d* near .*, for the value 3.9.*: fluxes run.*other loads"
        with pytest.warns(RangeWarning, match=words):
            solve(getattr(heated(3, 4), kind)(ThinLayer(Conduction(0.1), 0.05)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solve(heated(0, 1).interface(ThinLayer(Falling(0.1), 0.05)))


@pytest.mark.parametrize("kind", ["full", "interface"])
def test_a_structure_that_nothing_holds_keeps_its_heat(kind):
    """Its content grows by the flux times the time, with the layer's capacity on S in it."""
    joint, eps, c = sandwich(1, 0.5, 0.5, h=1 / 8, h_S=1 / 2, cell="quadrilateral"), 1 / 16, 1.5
    fluxes = {"TOP": lambda x, t: 3.0 + x[0]}
    plates = Structure(joint, body=Heat(1.0, 2.0), supports={}, fluxes=fluxes, initial=5)
    model = getattr(plates, kind)(ThinLayer(Heat(0.1, c), eps))
    state = march(model, [0.1, 0.2, 0.4], theta=0.5).last
    content = sum(2.0 * state.integral(state.u[0] * model.dx(model.domain.region_tags(name))) for name in joint.bodies)
    if kind == "full":
        (layer,) = {*model.domain.joint.regions} - {*joint.bodies}
        content += c * state.integral(state.u[0] * model.dx(model.domain.region_tags(layer)))
    else:
        surface = Surface(model)
        content += c * eps * surface.integral(surface.displacements(state).mean(axis=0)[0])
    assert content == pytest.approx(5 * (2.0 + c * eps) + 0.4 * 3.5, rel=1e-10)
    uniform = Structure(joint, body=Heat(1.0, 2.0), supports={"BOTTOM": 5}, initial=5)
    table = march(getattr(uniform, kind)(ThinLayer(Heat(0.1, c), eps)), [0.1, 0.2]).table
    assert abs(table["imbalance"]).max() < 1e-8  # also where all energies are rounding
    steady = Structure(joint, body=Conduction(1.0), supports={}, fluxes=fluxes)
    refused(InputError, "nothing holds the field", steady.bonded)
