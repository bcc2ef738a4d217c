"""Layers of a scalar field of order 2: their own mean value on S, against closed forms, columns and meshed layers."""

import math
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
import ufl

from forms import AnisotropicConduction, Conduction, FluxLaw, Heat, LinearElastic
from geometry import sandwich
from tests.fourier import K, blocks, compliance
from tests.on_ranks import on_ranks
from tests.orders import observed_orders
from tests.refused import refused
from thinlayer import (
    InputError,
    Probe,
    RangeWarning,
    Structure,
    Surface,
    SurfaceSource,
    ThermalExpansion,
    ThinLayer,
    derivative,
    estimate,
    goals,
    march,
    solve,
)


def _compliance(across, along, eps, law):
    """Return the compliance of two blocks and a layer under the flux cos(K x)."""
    h, G = across / eps, eps * along * K**2
    y = G / h  # (kappa eps)^2 k_T/k_n
    mean, jump = {
        "exact": (math.tanh(y**0.5 / 2) / (y**0.5 / 2), y**0.5 / 2 / math.tanh(y**0.5 / 2)),
        "order 1": (1.0, 1 + y / 12),
        "order 2": ((1 + y / 60) / (1 + y / 10), 1 + y / 12),
    }[law]
    G, h = G * mean, h * jump
    return compliance(np.linalg.solve([[-G / 2, 1.0], [h, -0.5]], [[G / 2, 1.0], [h, 0.5]]))


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of a short length of variation
def test_a_foil_converges_to_its_closed_form():
    """It conducts 300 times as well along S as across: order 1 is off by 10 times the error of order 2."""
    across, along, eps, sizes = 0.1, 30.0, 1 / 32, (1 / 4, 1 / 8)
    closed = {law: _compliance(across, along, eps, law) for law in ("exact", "order 1", "order 2")}
    foil, errors = ThinLayer(AnisotropicConduction.layered(along, across), eps, order=2), []
    for h in sizes:
        state = solve(blocks(h).interface(foil))
        errors.append(abs(state.load_work() - closed["order 2"]))
    assert observed_orders(sizes, errors)[-1] > 3.8
    assert errors[-1] < 0.05 * abs(closed["order 1"] - closed["exact"])
    assert 10 * abs(closed["order 2"] - closed["exact"]) < abs(closed["order 1"] - closed["exact"])
    energies = state.energies()
    assert energies["bodies"] + energies["layer"] == pytest.approx(energies["loads"] / 2, rel=1e-9)


@dataclass(frozen=True)
class Reacting(FluxLaw):
    """Conduction with the source Q exp(g T)."""

    k: float
    Q: float
    g: float
    symmetric = False

    def flux(self, step):
        return self.k * step.g

    def sink(self, step):
        return -self.Q * ufl.exp(self.g * step.T)


def test_a_source_that_grows_with_the_value():
    """Between blocks of resistance 1/2 to 0: means of faces and layer from the column's equation; order 1 misses both."""
    eps, exact = 1 / 8, (0.30702920, 0.41042725)
    plates = Structure(
        sandwich(0.5, 0.5, 0.5, h=0.25, cell="quadrilateral"), body=Conduction(1.0), supports={"BOTTOM": 0, "TOP": 0}
    )
    values = {}
    for order in (1, 2):
        with pytest.warns(RangeWarning, match="move its mean value.*use order=2") if order == 1 else nullcontext():
            state = solve(plates.interface(ThinLayer(Reacting(eps, 1 / eps, 0.5), eps, order=order)))
        surface = Surface(state.model)
        values[order] = surface.displacements(state).mean(), surface.value_in_layer(state).mean()
    assert values[2] == pytest.approx(exact, rel=2e-5)
    assert values[2] != pytest.approx(exact, rel=1e-7)
    assert abs(values[1][0] / exact[0] - 1) > 0.05
    assert abs(values[1][1] / exact[1] - 1) > 0.25


def test_gradients_of_both_signs_in_a_layer(recwarn):
    """The conductivity is that of the gradient at each height, not of the jump's alone, to which one flux is opposite."""
    joint = sandwich(0.5, 0.5, 0.5, h=0.5, cell="quadrilateral")
    plates = Structure(joint, body=Conduction(1.0), supports={"BOTTOM": 0, "TOP": 0.1})
    solve(plates.interface(ThinLayer(Reacting(1 / 8, 8.0, 0.5), 1 / 8, order=2)))
    assert not any("the conductivity of" in str(warning.message) for warning in recwarn)


def test_sources_within_a_column():
    """One uniform through the layer gives its parabola. One at a height gives the mean through the layer."""
    Q, k, eps = 3.0, 0.05, 0.2
    joint = sandwich(1, 0.4, 0.6, h=0.2, cell="quadrilateral")
    data = {"body": Conduction(1.3), "supports": {"BOTTOM": 0, "TOP": 1.0}}
    plates, layer = Structure(joint, **data, sources={"S": Q}), ThinLayer(Conduction(k), eps, order=2)
    state, full = (solve(model) for model in (plates.interface(layer), plates.full(layer)))
    surface = Surface(state.model)
    for height in (-0.5, -0.2, 0.3):
        inside = Probe(full).value(Surface(full.model).in_layer([(0.4, 0.0)], [height]))
        assert surface.value_in_layer(state, height) == pytest.approx(float(inside[0]), rel=1e-8)
    assert state.load_work() == pytest.approx(full.load_work(), rel=1e-9)
    error = estimate(state, goals=goals.Compliance()).goals["compliance"]
    assert error.better == pytest.approx(error.value, rel=1e-9)
    goal = goals.Compliance()
    layers = [ThinLayer(Conduction(k * factor), eps, order=2) for factor in (1.001, 0.999)]
    ends = [goal.value_in(solve(plates.interface(near))) for near in layers]
    slope = derivative(state, goal, ["S.k"]).by["S.k"]
    assert slope == pytest.approx((ends[0] - ends[1]) / 2e-3, rel=1e-5)
    for z in (0.3, -0.5, 0.5):
        at_height = solve(Structure(joint, **data, sources={"S": SurfaceSource(Q, z)}).interface(layer))
        rise = surface.value_in_layer(at_height) - surface.displacements(at_height)[:, 0].mean(axis=0)
        assert rise == pytest.approx(Q * eps / k * (1 / 4 - z**2) / 2, rel=1e-9, abs=1e-12)
    refused(InputError, "take Probe", surface.value_in_layer, full)
    refused(InputError, "height is 0.6", surface.value_in_layer, state, 0.6)


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of short steps
def test_a_march_from_a_steady_state_stays_there():
    """With the mean of the layer, which a source has moved; a state of other laws is no state of the march."""
    joint, data = (
        sandwich(1, 0.4, 0.6, h=0.2, cell="quadrilateral"),
        {"supports": {"BOTTOM": 0.2}, "sources": {"S": 3.0}},
    )
    steady = solve(Structure(joint, body=Conduction(1.3), **data).interface(ThinLayer(Conduction(0.05), 0.2, order=2)))
    layer = ThinLayer(Heat(0.05, 0.7), 0.2, order=2)
    last = march(Structure(joint, body=Heat(1.3, 0.9), **data, initial=steady).interface(layer), [0.01, 0.03]).last
    wanted = Surface(steady.model).value_in_layer(steady)
    assert Surface(last.model).value_in_layer(last) == pytest.approx(wanted, rel=1e-9)
    moved = replace(steady, model=Structure(joint, body=Heat(1.3, 0.9), **data).interface(layer))
    refused(InputError, "initial=state", march, moved, [0.01])


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of order 1
@pytest.mark.parametrize(("k", "c", "orders"), [(1, 0, (1, 2)), (0, 0, (2, 5)), (-1, -1, (2, 6))])
def test_heat_that_is_released_in_a_layer_in_time(k, c, orders):
    """A source of 1 per area, with k and c proportional to eps^k and eps^c: orders of the mean on S, at orders 1 and 2."""
    joint, sizes, errors = sandwich(0.5, 0.5, 0.5, h=1 / 8, h_S=1 / 2, cell="quadrilateral"), (1 / 8, 1 / 16), []
    for eps in sizes:
        data = {"fluxes": {"TOP": 1.0}, "sources": {"S": 1 / eps}, "supports": {"BOTTOM": 0}, "initial": 0}
        plates, layer = Structure(joint, body=Heat(1.0, 1.0), **data), partial(ThinLayer, Heat(eps**k, eps**c), eps)
        models = plates.full(layer(), cells_through=6), *(plates.interface(layer(order=order)) for order in (1, 2))
        lasts = [march(model, [0.05, 0.1, 0.15]).last for model in models]
        exact, *means = (Surface(last.model).displacements(last).mean() for last in lasts)
        errors.append(np.abs(np.subtract(means, exact)))
    assert [observed_orders(sizes, column)[-1] for column in np.transpose(errors)] == pytest.approx(orders, abs=0.4)
    assert (errors[0][1] < 0.02 * errors[0][0]).all()


ROUGH = {
    "taper": (
        sandwich(1, 0.4, 0.6, h=0.25, cell="quadrilateral"),
        {"plane": "axisymmetric"},
        {"profile": lambda x: 1 + 0.4 * np.cos(2 * x[0])},
        {"bodies": "extended"},
    ),
    "space": (sandwich(1, 0.4, 0.6, h=0.5, depth=0.5, cell="hexahedron"), {"supports": {"RIGHT": 0.5}}, {}, {}),
}


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of a thick layer, and of short steps
@pytest.mark.parametrize("case", ROUGH)
def test_a_thick_layer_beside_its_mesh(case):
    """Heat that is stored and set free in the layer, along a rim that is held, or in a taper: 1/17 of the error."""
    joint, data, shape, bodies = ROUGH[case]
    load = {"TOP": lambda x, t: 1 + ufl.cos(ufl.pi * x[0])}
    data = {"supports": {}, "fluxes": load, "sources": {"S": 2.0}, "initial": 0.3} | data
    plates, values = Structure(joint, body=Heat(1.0, 1.0), **data), []
    for model, order in ((plates.full, 1), (plates.interface, 1), (plates.interface, 2)):
        layer = ThinLayer(Heat(0.03, 1.3), 0.25, order=order, **shape)
        last = march(model(layer, **bodies), [0.02, 0.06, 0.1], theta=0.5).last
        surface = Surface(last.model)
        values.append(surface.displacements(last).mean(axis=0)[0])
    exact, *errors = values[0], *(surface.norm(value - values[0]) for value in values[1:])
    assert errors[1] < 0.06 * errors[0]
    assert errors[0] > 0.01 * surface.norm(exact)


# ---------------------------------------------------------------- files and ranks
JOINT, TIMES = sandwich(1, 0.4, 0.6, h=0.25), [0.1, 0.2, 0.3, 0.4]
HEATED = {"body": Heat(1.0, 1.0), "supports": {"RIGHT": 0.5}, "sources": {"S": 2.0}, "initial": 0.3}
LAYER = ThinLayer(Heat(0.3, 1.3), 0.25, order=2)


def _resumed(folder):
    """March to half of the times, go on from the files, and return norms of what the last state has."""
    model = Structure(JOINT, **HEATED).interface(LAYER)
    march(model, TIMES[:2], out=folder)
    last = march(model, TIMES, out=folder, resume=True).last
    surface = Surface(model)
    fields = surface.displacements(last).mean(axis=0)[0], surface.value_in_layer(last, 0.1), surface.traction(last)
    return [*map(surface.norm, fields), last.load_work()]


@on_ranks(_resumed, 2)
def test_marches_from_files_on_two_ranks(there, tmp_path):
    values = _resumed(tmp_path)
    assert there == pytest.approx(values, rel=1e-9)
    plates = Structure(JOINT, **HEATED)
    history = march(plates.interface(LAYER), TIMES)
    surface = Surface(history.model)
    assert surface.norm(surface.value_in_layer(history.last, 0.1)) == pytest.approx(values[1], rel=1e-10)
    refused(InputError, "order 2 has none", derivative, history, goals.PointValue((0.5, 0.3)), ["S.k"])


def test_the_mean_of_the_layer_expands_it():
    """A layer of uniform strain along S opens by eps alpha (1 + nu)/(1 - nu) T; the twin takes the faces' temperature."""
    joint, eps, alpha, nu = sandwich(10, 2, 2, h=1, h_S=0.5), 0.2, 1e-4, 0.3
    data = {"supports": {"BOTTOM": 20, "TOP": 20}, "sources": {"S": 0.05}}
    heated = solve(Structure(joint, body=Conduction(0.2), **data).interface(ThinLayer(Conduction(1e-3), eps, order=2)))
    surface = Surface(heated.model)
    mean = surface.function(surface.value_in_layer(heated))
    bodies, jumps = Structure(joint, body=LinearElastic.young(70e3, nu), supports={"BOTTOM": 0}), []
    for T in (mean, heated):
        hot = ThinLayer(
            LinearElastic.young(100, nu), eps, order=1, eigenstrain=ThermalExpansion(alpha, T, reference=20)
        )
        state = solve(bodies.interface(hot))
        jumps.append(Surface(state.model).jump(state)[1].mean())
    rise = 0.05 * eps / 2 * 2 / 0.2 + 0.05 * eps**2 / (12 * 1e-3)  # of the faces, and of the mean above them
    assert jumps[0] == pytest.approx(eps * alpha * (1 + nu) / (1 - nu) * rise, rel=1e-3)
    assert jumps[1] < 0.3 * jumps[0]
