"""Coupling of two models: temperatures in mechanics, conductances from openings, heat of currents and dissipation."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import pytest
import ufl

from forms import Conductance, Conduction, FluxLaw, Heat, KelvinVoigt, LinearElastic
from geometry import block, sandwich
from studies import cure, gap
from tests.refused import refused
from thinlayer import (
    InputError,
    JouleHeat,
    SolveError,
    Structure,
    Surface,
    SurfaceSource,
    ThermalExpansion,
    ThinLayer,
    coupled,
    derivative,
    estimate,
    goals,
    march,
    solve,
)

KINDS = ("interface", "full")
EPS, ALPHA, LMBDA, MU = 0.05, 1e-3, 3.0, 2.0
OPENING = (3 * LMBDA + 2 * MU) / (LMBDA + 2 * MU) * ALPHA * EPS  # of a layer between rigid faces, per degree
JOINT = sandwich(0.2, 0.5, 0.5, 0.1, cell="quadrilateral")
HELD = {"BOTTOM": 0, "TOP": {"y": 0}, "LEFT": {"x": 0}, "RIGHT": {"x": 0}}
FREE = {place: support for place, support in HELD.items() if place != "TOP"}
HEATED = Structure(JOINT, body={"LOWER": Conduction(1.0), "UPPER": Conduction(3.0)}, supports={"BOTTOM": 0, "TOP": 2})
STIFF = LinearElastic(1e7, 1e7)


def layer(T, order=1, **data):
    hot = ThermalExpansion(ALPHA, T, **data)
    return ThinLayer(LinearElastic(LMBDA, MU), EPS, order=order, eigenstrain=hot)


def mean_jump(state, axis=1):
    return float(Surface(state.model).jump(state)[axis].mean())


# ---------------------------------------------------------------- temperatures in mechanics
@pytest.mark.parametrize("bodies", ["kept", "extended"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_heated_layer_opens(kind, bodies):
    """It opens by eps alpha (3 lambda + 2 mu)/(lambda + 2 mu) <T>, with T of both sides; bodies keep their own T."""
    warm = solve(getattr(HEATED, kind)(ThinLayer(Conduction(EPS), EPS), bodies=bodies))
    lower, upper = Surface(warm.model).displacements(warm)[:, 0].mean(axis=(1, 2))
    assert upper - lower > 1
    for order in (0, 1):
        plates = Structure(JOINT, body=STIFF, supports=FREE)
        state = solve(getattr(plates, kind)(layer(warm, order, reference=0.5), bodies=bodies))
        assert mean_jump(state) == pytest.approx(OPENING * ((lower + upper) / 2 - 0.5), rel=1e-5)


def test_the_layer_has_the_temperature_of_its_stations():
    """Held between stiff plates, its energy has the change of T through the thickness: not so at order 0."""
    energies = {}
    for kind, order in (("full", 1), ("interface", 1), ("interface", 0)):
        warm = solve(getattr(HEATED, kind)(ThinLayer(Conduction(EPS), EPS)))
        state = solve(getattr(Structure(JOINT, body=STIFF, supports=FREE), kind)(layer(warm, order, reference=0)))
        energies[kind, order] = state.energies()["layer"]
    assert energies["interface", 1] == pytest.approx(energies["full", 1], rel=1e-5)
    assert energies["interface", 0] < 0.97 * energies["full", 1]


def test_a_rigid_base_has_the_temperature_zero():
    joint = block(0.2, 0.5, 0.1, cell="quadrilateral")
    warm = solve(Structure(joint, body=Conduction(1.0), supports={"TOP": 2}).interface(ThinLayer(Conduction(EPS), EPS)))
    supports = {place: support for place, support in FREE.items() if place != "BOTTOM"}
    for T, mean in ((warm, 2 / 3), (2.0, 2.0)):
        data = {} if T == 2.0 else {"reference": 0}
        state = solve(Structure(joint, body=STIFF, supports=supports).interface(layer(T, **data)))
        assert mean_jump(state) == pytest.approx(OPENING * mean, rel=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_a_history_is_linear_between_its_times(kind):
    heated = Structure(JOINT, body=Heat(1.0, 1.0), supports={"BOTTOM": 0, "TOP": 2}, initial=0)
    warm = march(getattr(heated, kind)(ThinLayer(Conduction(EPS), EPS)), [0.1, 0.2, 0.4])
    plates = Structure(JOINT, body=STIFF, supports=FREE)
    history = march(getattr(plates, kind)(layer(warm, reference=0)), [0.1, 0.15, 0.2])
    T = [Surface(warm.model).displacements(warm.at(t)).mean() for t in (0.1, 0.2)]
    for t, expected in ((0.1, T[0]), (0.15, sum(T) / 2), (0.2, T[1])):
        assert mean_jump(history.at(t)) == pytest.approx(OPENING * expected, rel=1e-4)
    assert max(abs(history.table["imbalance"])) < 1e-7
    refused(InputError, "not finite at t = 0.5", march, history.model, [0.2, 0.5])


# ---------------------------------------------------------------- solved in turn
@pytest.mark.parametrize("case", [*gap.CASES][:2])
def test_a_gap_conducts_by_its_opening(case):
    """In turn alone, the values run away for s < -1."""
    lower, upper, cold = case
    exchange = lambda state: cold + gap.SURFACE.jump(state)[1]
    pair = coupled(gap.heat, partial(gap.expand, lower, upper), exchange, begin=0.003)
    assert pair.steps <= 7
    assert pair.s == pytest.approx(gap.CASES[case], rel=2e-3)
    assert pair.value == pytest.approx(np.full(pair.value.shape, exchange(pair.second)), rel=1e-5)
    assert gap.closed_opening(pair.value.mean(), *case) == pytest.approx(pair.value.mean(), rel=1e-5)
    turns = [0.003]
    for _ in range(60):
        turns.append(gap.closed_opening(turns[-1], *case))
    assert (abs(turns[-1] / pair.value.mean() - 1) < 1e-3) == (gap.CASES[case] > -1)


def test_unstable_equilibria_are_refused():
    step = partial(gap.closed_opening, lower=gap.UNSTABLE[0], upper=gap.UNSTABLE[1], cold=gap.UNSTABLE[2])
    same = lambda value: value
    refused(SolveError, r"s = 1\.\d+ > 1", coupled, float, step, same, 0.00145)
    assert coupled(float, step, same, -0.003).value == pytest.approx(-0.00350602, abs=1e-8)
    assert coupled(float, step, same, 0.0014).value == pytest.approx(-0.00350602, abs=1e-8)
    assert coupled(float, step, same, 0.005).value == pytest.approx(0.00465078, abs=1e-8)
    refused(SolveError, r"s = 1\.88 > 1", coupled, same, lambda x: 1.88 * x - 1, same, 0.0)
    refused(SolveError, "no agreement after 3 steps", coupled, same, np.cos, same, 0.0, max_steps=3)
    refused(InputError, "must be finite", coupled, same, lambda x: x * np.nan, same, np.ones(2))
    refused(InputError, r"shape.* \(3,\)", coupled, same, lambda x: np.ones(3), same, np.ones(2))
    refused(InputError, "first is 3", coupled, 3, same, same, 0.0)


def test_several_values_are_relaxed_together():
    """A linear map with s from -4 to 0.8 needs as many steps as it has eigenvalues, and two."""
    rng = np.random.default_rng(1)
    Q = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    A, b = Q @ np.diag([-4.0, -0.5, 0.3, 0.8]) @ Q.T, rng.normal(size=4)
    pair = coupled(lambda x: x, lambda x: A @ x + b, lambda y: y, np.zeros(4))
    assert pair.value == pytest.approx(np.linalg.solve(np.eye(4) - A, b), rel=1e-5)
    assert pair.steps <= 7
    assert pair.s == pytest.approx(-4.0, rel=1e-3)


def test_marches_are_coupled_at_all_their_times():
    """Long after the start, the opening is that of the steady state."""
    times, case = [0.05, 2.0, 40.0], next(iter(gap.CASES))
    rows, shape = np.r_[0.0, times], (len(times) + 1, *gap.SURFACE.weights.shape)
    heated = Structure(gap.JOINT, body=Heat(1.0, 1.0), supports={"BOTTOM": 0, "TOP": 1}, initial=0)

    def heat(openings):
        h = gap.SURFACE.function(np.broadcast_to(gap.conductance(openings), shape), rows)
        return march(heated.interface(Conductance(h)), times)

    def mechanics(warm):
        return march(gap.bars(case[0], case[1], warm), times)

    openings = lambda history: np.stack([case[2] + gap.SURFACE.jump(state)[1] for state in history])
    pair = coupled(heat, mechanics, openings, 0.003)
    assert pair.steps <= 8
    assert gap.closed_opening(pair.value[-1].mean(), *case) == pytest.approx(pair.value[-1].mean(), rel=1e-3)
    assert pair.value[1].mean() > 2 * pair.value[-1].mean()


@dataclass(frozen=True)
class Piezoelectric(FluxLaw):
    """A dielectric with the polarisation P across the layer, which the strain causes."""

    k: float
    P: float
    linear = True

    def flux(self, step):
        return self.k * step.g - self.P * step.n


def test_a_piezoelectric_layer():
    """Under a pull, between electrodes; closed form of the column, for s = -3.9."""
    C, k, e, pull, area = 2 * MU, 0.5, 4.0, 0.3, 0.1  # the area of the bodies' resistance: height over permittivity

    def electric(strain):
        P = SURFACE.function(e * strain)
        bodies = Structure(JOINT, body=Conduction(10.0), supports={"BOTTOM": 0, "TOP": 0.2})
        return solve(bodies.interface(ThinLayer(Piezoelectric(k, P), EPS, order=0)))

    def mechanics(potential):
        pulled = Structure(JOINT, body=STIFF, supports=FREE, tractions={"TOP": (0, pull)})
        strain = ThermalExpansion((0, -e / C / EPS, 0), SURFACE.function(SURFACE.jump(potential)[0]), reference=0)
        return solve(pulled.interface(ThinLayer(LinearElastic(0, MU), EPS, eigenstrain=strain)))

    pair = coupled(electric, mechanics, lambda state: SURFACE.jump(state)[1] / EPS, 0.0)
    # C E + e V/eps = pull, D = e E - k V/eps, V - area D = 0.2 with the strain E and the jump V
    strain, V = np.linalg.solve([[C, e / EPS], [-area * e, 1 + area * k / EPS]], [pull, 0.2])
    assert pair.value.mean() == pytest.approx(strain, rel=1e-5)
    assert mean_jump(pair.first, 0) == pytest.approx(V, rel=1e-5)
    assert pair.s == pytest.approx(-(e**2) / C * area / EPS / (1 + area * k / EPS), rel=1e-3)
    assert pair.steps <= 4


SURFACE = Surface(HEATED.bonded())


# ---------------------------------------------------------------- heat from elsewhere
@pytest.mark.parametrize("kind", KINDS)
def test_heat_of_a_current(kind):
    """All of its power flows out; the column's temperature is the same on S and meshed."""
    wires = Structure(JOINT, body=Conduction(1e3), supports={"BOTTOM": 0, "TOP": 0.1})
    current = solve(getattr(wires, kind)(ThinLayer(Conduction(1.0), EPS)))
    plates = Structure(JOINT, body=Conduction(0.05), supports={"BOTTOM": 0}, parts=[JouleHeat(current)])
    state = solve(getattr(plates, kind)(ThinLayer(Conduction(2e-4), EPS)))
    power = 0.1 * current.reaction("TOP").flow
    assert -state.reaction("BOTTOM").flow == pytest.approx(power, rel=1e-9)
    q = 0.1 / (1 / 1e3 + EPS)  # current per area
    lower, upper, inside = q**2 * 0.5 / 1e3, q**2 * 0.5 / 1e3, q**2 * EPS  # heat per area
    top = (lower / 2 + inside + upper) * 0.5 / 0.05 + (inside / 2 + upper) * EPS / 2e-4 + upper / 2 * 0.5 / 0.05
    T = state.integral(state.u[0] * state.model.ds(state.model.domain.values("TOP"))) / 0.2
    assert pytest.approx(top, rel=1e-8) == T


def test_derivatives_in_the_heat_of_a_current():
    """That of the compliance is refused, as the work of this heat has no weights."""
    wires = Structure(JOINT, body=Conduction(1e3), supports={"BOTTOM": 0, "TOP": 0.1})
    parts = [JouleHeat(solve(wires.interface(ThinLayer(Conduction(1.0), EPS))))]
    model = Structure(JOINT, body=Conduction(0.05), supports={"BOTTOM": 0}, parts=parts).interface(
        ThinLayer(Conduction(2e-4), EPS)
    )
    state, hottest = solve(model), goals.PointValue((0.0, 0.5))
    by_all = derivative(state, hottest, ["LOWER.k", "UPPER.k", "S.k"]).by
    assert sum(by_all.values()) == pytest.approx(-hottest.value(state, model), rel=1e-6)
    refused(InputError, "give other goals", derivative, state, goals.Compliance(), ["S.k"])
    refused(InputError, "give other goals", estimate, state)


@pytest.mark.parametrize("z", [-0.5, 0.0, 0.3])
def test_a_source_at_a_height(z):
    plates = Structure(
        JOINT, body=Conduction(0.05), supports={"BOTTOM": 0, "TOP": 0}, sources={"S": SurfaceSource(0.1, z)}
    )
    layer_of_heat, R = ThinLayer(Conduction(2e-3), EPS), EPS / 2e-3
    below, above = 0.5 / 0.05 + (0.5 + z) * R, 0.5 / 0.05 + (0.5 - z) * R
    flow = -0.02 * above / (below + above)
    assert solve(plates.interface(layer_of_heat)).reaction("BOTTOM").flow == pytest.approx(flow, rel=1e-9)
    if z:
        refused(InputError, "of a meshed layer", plates.full, layer_of_heat)
    else:
        assert solve(plates.full(layer_of_heat)).reaction("BOTTOM").flow == pytest.approx(flow, rel=1e-9)


def test_viscous_cycles_heat_the_bodies():
    """What the layer dissipates is stored as heat, or flows out."""
    times = np.linspace(0.1, 2.0, 20)
    load = {"TOP": lambda x, t: (ufl.sin(2 * ufl.pi * t) * (1 + x[0]), 0)}
    plates = Structure(JOINT, body=LinearElastic.young(1e4, 0.3), supports={"BOTTOM": 0}, tractions=load)
    history = march(plates.interface(ThinLayer(KelvinVoigt(10.0, 10.0, 3.0, 3.0), EPS)), times)
    surface = Surface(history.model)
    per_time = surface.dissipated(history) / np.r_[1.0, np.diff(history.t)][:, None, None]
    power, c = surface.function(per_time * np.ones(surface.weights.shape), history.t), 3.6
    source = {"S": SurfaceSource(power, 0.2)}
    heated = Structure(JOINT, body=Heat(0.05, c), sources=source, supports={"BOTTOM": 20}, initial=20)
    warm = march(heated.interface(Conductance(2e-3)), times)
    stored = c * warm.last.integral((warm.last.u[0] - 20) * warm.last.model.dx)
    out = -sum(state.reaction("BOTTOM").flow * dt for state, dt in zip([*warm][1:], np.diff(warm.t), strict=True))
    assert stored + out == pytest.approx(history.table["dissipated"].sum(), rel=1e-8)
    assert out > 1e-3 * stored > 0


@pytest.mark.filterwarnings("error:.*fluxes run against gradients")  # of rounding
def test_resin_that_cures_on_s_and_meshed():
    """A law of the user's: the cure's error is of the order of eps^2 at order 1, and of a higher one at order 2."""
    times, errors = np.linspace(75, 300, 4), []
    for eps in (2.0, 1.0):
        marches = [cure.cure(name, eps, times) for name in cure.MODELS]
        X, *on_s = [Surface(warm.model).internal(warm.last, "X").mean() for warm in marches]
        errors.append(abs(X - on_s))
    assert X > 0.4
    (linear, quadratic), (half_linear, half_quadratic) = errors
    assert half_linear < 0.35 * linear < 0.005
    assert half_quadratic < 0.08 * quadratic < 1e-7
    history = cure.mechanics("order 1", 1.0, marches[1])
    assert Surface(history.model).traction(history.last)[1].min() > 0.01


# ---------------------------------------------------------------- refusals
WARM = solve(HEATED.interface(Conductance(1.0)))
COLD = solve(Structure(JOINT, body=STIFF, supports=HELD).bonded())
BAD = {
    "reference is None": lambda: layer(WARM),
    "reference is 'cold'": lambda: layer(3.0, reference="cold"),
    "state of a displacement": lambda: Structure(JOINT, body=STIFF, supports=FREE).interface(layer(COLD, reference=0)),
    "same cells_through": lambda: Structure(JOINT, body=STIFF, supports=FREE).full(layer(WARM, reference=0)),
    "h is -1": lambda: Conductance(-1.0),
    r"h\(x, t\) is -1": lambda: solve(HEATED.interface(Conductance(lambda x, t: -1 + 0 * x[0]))),
    "law of a scalar field": lambda: Structure(JOINT, body=STIFF, supports=FREE).interface(Conductance(1.0)),
    "height of a SurfaceSource": lambda: SurfaceSource(1.0, 0.7),
    "power of a SurfaceSource": lambda: SurfaceSource("hot"),
    "electric potential": lambda: JouleHeat(COLD),
    "from one joint": lambda: Structure(
        sandwich(0.2, 0.5, 0.5, 0.1), body=Conduction(1.0), supports={"TOP": 0}, parts=[JouleHeat(WARM)]
    ).bonded(),
    "times is": lambda: SURFACE.function(np.ones((2, *SURFACE.weights.shape)), [1.0, 0.0]),
    "2 times": lambda: SURFACE.function(1.0, [0.0, 1.0]),
    "a source of a scalar field": lambda: Structure(
        JOINT, body=STIFF, supports=FREE, body_force={"S": SurfaceSource(1.0)}
    ).interface(layer(1.0)),
}


@pytest.mark.parametrize("words", BAD)
def test_bad_input_is_refused(words):
    refused(InputError, words, BAD[words])
