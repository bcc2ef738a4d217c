"""Non-monotone layers in models: columns, the bar of section 6.2, orders, heating, phases counted, ranks, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import ufl
from scipy.optimize import brentq

from forms import LinearElastic, NonMonotone, NonMonotoneUnrelaxed, Stack
from geometry import block, sandwich
from studies.phases import CASES, PURE_LAW, JumpPhaseLaw, blocks
from studies.problems import phases_on_s
from tests.closed_forms import NonMonotoneLimit
from tests.columns_in_time import C as COMPLIANCE
from tests.columns_in_time import K as STIFFNESS
from tests.columns_in_time import both, check_balance, check_same, joint, jump_of
from tests.columns_in_time import column as tall_column
from tests.non_monotone_run import CHI, HEATED, models
from tests.non_monotone_run import C as OF_T
from tests.phases_of_bars import BAR
from tests.test_mohr_coulomb_models import PATH, PATH_3D, check_path, column
from thinlayer import Structure, Surface, ThinLayer, march, piecewise, solve
from thinlayer.discretisation.state import displacements_of
from thinlayer.surface.law_points import layer_shares

# layers whose thickness tends to zero under the same load, and columns of any height
pytestmark = [pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning"), pytest.mark.few(5)]

LMBDA, MU, ALPHA = 60.0, 40.0, 1.2
EXACT = 1e-9
CHI3 = np.array([[0.3, 0.5, -0.2], [0.5, 0.9, 0.4], [-0.2, 0.4, -0.6]])
CHIS = {"normal": np.diag([0.0, 0.7]), "shear": np.array([[0.0, 0.4], [0.4, 0.0]])}
RELAXED = NonMonotone(LMBDA, MU, ALPHA, 0.02, CHI)
PURE = NonMonotoneUnrelaxed(LMBDA, MU, ALPHA, 0.05, CHI)
# jumps (w_T, w_N) whose drives are far from C = 0.05 on either side, so that facets do not hold each other back
CLEAR = np.array([[0.0, -0.01], [0.2, -0.01], [0.02, -0.02], [-0.2, 0.01], [0.0, 0.15]])
CLEAR_PHASES = [0, 1, 0, -1, 1]


def quads():
    return sandwich(1.0, 0.5, 0.5, 0.5, cell="quadrilateral", structured=True)


# ---------------------------------------------------------------- columns
@pytest.mark.few(5)
@pytest.mark.parametrize(("eps", "angle"), [(0.3, 0.7), (1e-4, 2.5)])
def test_relaxed_law_in_columns(eps, angle):
    """Mixed and pure phases of both signs, sheared, opened and closed, at several angles; the closed formula on S."""
    limit, full, point = column(RELAXED, PATH, eps, angle)
    check_path(limit, full, point)
    for history in (limit, full):
        assert np.abs(history.table["imbalance"]).max() < 1e-9
        assert np.abs(history.table["dissipated"]).max() < 1e-12 * history.table["energy"].max()
    limit_law = NonMonotoneLimit(LMBDA, MU, ALPHA, RELAXED.transformation_energy, CHI, np.array([0.0, 1.0]))
    t, phases = limit_law.relaxed(point.jumps)
    assert point.tractions == pytest.approx(t, abs=1e-9 * np.abs(t).max())
    for k, phase in enumerate(phases):
        assert layer_shares(limit.at(k + 1.0), "S")["plus"] == pytest.approx(max(phase, 0), abs=1e-9)
        assert layer_shares(full.at(k + 1.0), "S")["minus"] == pytest.approx(max(-phase, 0), abs=1e-9)
    assert {-1, 1} <= {int(np.sign(phase)) for phase in phases if 0 < abs(phase) < 1}


def test_pure_phases_in_columns():
    """The same phases and displacements at the ends of steps, in which facets may switch one after the other."""
    limit, full, point = column(PURE, CLEAR, 1e-4, angle=0.7)
    surface = Surface(limit.model)
    limit_law = NonMonotoneLimit(LMBDA, MU, ALPHA, PURE.transformation_energy, CHI, np.array([0.0, 1.0]))
    for k, phase in enumerate(CLEAR_PHASES):
        t, holds = limit_law.pure(point.jumps[k], phase)
        assert holds
        assert point.tractions[k] == pytest.approx(t, abs=1e-9)
        limit_state, other = limit.at(k + 1.0), full.at(k + 1.0)
        for state in (limit_state, other):
            assert phases_on_s(state)[1] == pytest.approx(phase, abs=1e-14)
        difference = displacements_of(other, limit.model).x.array - limit_state.u.x.array
        assert np.abs(difference).max() < 1e-9 * np.abs(point.jumps).max()
        jump = surface.frame(surface.jump(limit_state)) - np.reshape(point.jumps[k], (-1, 1, 1))
        assert surface.norm(jump) < 1e-9 * np.abs(point.jumps).max()
    for history in (limit, full):
        assert np.abs(history.table["imbalance"]).max() < 1e-9
        assert min(snap.lost for snap in history.snaps) > 0


def test_three_dimensions():
    """Shear whose direction turns in S."""
    limit, full, point = column(NonMonotone(LMBDA, MU, ALPHA, 0.05, CHI3), PATH_3D, 0.02, angle=0.3)
    check_path(limit, full, point)
    check_balance(full)
    clear = np.array([[0.2, 0.0, -0.01], [0.0, 0.0, 0.0], [0.0, -0.2, -0.01]])
    limit, full, point = column(NonMonotoneUnrelaxed(LMBDA, MU, ALPHA, 0.05, CHI3), clear, 0.02, angle=0.3)
    for k, phase in enumerate([1, 0, -1]):
        assert phases_on_s(full.at(k + 1.0))[1] == pytest.approx(phase, abs=1e-14)
        difference = displacements_of(full.at(k + 1.0), limit.model).x.array - limit.at(k + 1.0).u.x.array
        assert np.abs(difference).max() < 1e-9 * np.abs(point.jumps).max()


@pytest.mark.few(5)
@pytest.mark.parametrize(("mode", "element", "eps"), [("normal", "P2", 1e-4), ("shear", "Q2", 1e-2)])
def test_loop(mode, element, eps):
    """Moved forth, back and home: four snaps at the ends of the loops, each losing a^2/(2 (K + 1/C)), a = alpha chi n."""
    K, compliance = STIFFNESS[mode], COMPLIANCE[mode]
    law = NonMonotoneUnrelaxed(LMBDA, MU, ALPHA, 0.02, CHIS[mode])
    a = ALPHA * (CHIS[mode][1, 1] if mode == "normal" else CHIS[mode][0, 1])
    up = law.transformation_energy * (1 + compliance * K) / a
    down, far = up - a * compliance, 2 * up
    move = piecewise({0: 0, 1: far, 3: -far, 4: -0.1 * far})  # it turns within a step
    setup = tall_column(mode, move=move) | {"element": element}
    limit, full = both(joint() if element == "P2" else quads(), ThinLayer(law, eps, at=1.0), setup, [1.0, 2.2, 4.0])
    check_same(limit, full)
    times = [up / far, 2 - down / far, 2 + up / far, 3 + (1 - down / far) / 0.9]
    for history in (limit, full):
        assert [snap.t for snap in history.snaps] == pytest.approx(times, rel=1e-9)
        assert [snap.lost for snap in history.snaps] == pytest.approx([a**2 / (2 * (K + 1 / compliance))] * 4, rel=1e-8)
        rows = [snap.row for snap in history.snaps]
        assert (history.table["plus"] - history.table["minus"])[rows] == pytest.approx([1, 0, -1, 0])
        check_balance(history)
    w = (far + a * compliance) / (1 + compliance * K)
    assert jump_of(limit, mode, limit.at(1.0)) == pytest.approx(w, rel=1e-10)


# ---------------------------------------------------------------- the bar, several cells through a layer that is flat
def test_bar():
    """Phases 0 and 1 in any order through the thickness: no tangent stiffness, but one elongation, energy and boundary."""
    strip = block(1.0, 1.0, 1.0, cell="triangle", structured=True)
    layer = ThinLayer(NonMonotone(0.0, BAR.kbar / 2, BAR.alpha, BAR.cbar, np.diag([0.0, 1.0])), BAR.eps, at=1.0)
    supports = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}, "TOP": {"x": 0.0, "y": lambda x, t: t}}
    bar = Structure(strip, body=LinearElastic(0.0, BAR.K / 2), supports=supports, element="P2")
    limit, full = bar.interface(layer), bar.full(layer, bodies="extended", cells_through=4)
    surface = Surface(limit)
    deltas = np.array([0.9, 1.4, 1.6, 1.8])
    for model, bar in ((limit, replace(BAR, eps=0.0)), (full, BAR)):
        history = march(model, deltas.tolist())
        table, states = history.table, [history.at(delta) for delta in deltas]
        share = bar.phase(deltas)
        assert np.sum((share > 0) & (share < 1)) >= 1
        assert table["energy"][1:] == pytest.approx(bar.energy(deltas), rel=1e-9)
        assert table["plus"][1:] == pytest.approx(share, abs=1e-9)
        assert table["boundary"][1:] == pytest.approx(BAR.eps * (1 - share), abs=1e-10)
        assert [surface.integral(surface.jump(state)[1]) for state in states] == pytest.approx(bar.U(deltas), rel=1e-9)
        tractions = [surface.integral(surface.traction(state)[1]) for state in states]
        assert tractions == pytest.approx(bar.sigma(deltas), rel=1e-9)
        assert np.abs(table["imbalance"]).max() < 1e-9


# ---------------------------------------------------------------- order of the error, wrong laws
@pytest.mark.filterwarnings("ignore:.* the stress of Formula falls")  # with lmbda + mu it does
def test_order_and_wrong_laws():
    """Oblique chi with all phases on S: order 1; a law with lmbda + mu or without phase -1 leaves its error."""
    law, shear, pull = CASES[""]
    where, setup = blocks(1 / 8, shear, pull)
    on_s = {"right": law, "formula": JumpPhaseLaw.of(law), "lmbda + mu": JumpPhaseLaw.of(law, K_N=LMBDA + MU)}
    on_s["one branch"] = JumpPhaseLaw.of(law, minus_factor=0.0)
    surface = Surface(Structure(where, **setup).interface(ThinLayer(law, 1.0)))
    plates = Structure(where, **setup)
    full = {eps: solve(plates.full(ThinLayer(law, eps, at=1.0), cells_through=1)) for eps in (1 / 32, 1 / 64)}
    errors = {}
    for name, law_on_s in on_s.items():
        state = solve(plates.interface(law_on_s if isinstance(law_on_s, JumpPhaseLaw) else ThinLayer(law_on_s, 1.0)))
        fields = [(surface.traction, state), (surface.jump, state)]
        sizes = [surface.norm(field(state)) for field, state in fields]
        differences = {e: [surface.norm(f(full[e]) - f(state)) for f, state in fields] for e in full}
        errors[name] = np.array(list(differences.values())) / sizes
    assert errors["formula"] == pytest.approx(errors["right"], rel=1e-6)
    orders = {name: np.log2(error[0] / error[1]) for name, error in errors.items()}
    assert orders["right"] == pytest.approx([1, 1], abs=0.07)
    assert errors["right"][1].max() < 0.01
    for name in ("lmbda + mu", "one branch"):
        assert orders[name] == pytest.approx([0, 0], abs=0.1)
        assert errors[name][1].min() > 0.12


@pytest.mark.parametrize("case", CASES)
def test_the_studies_have_each_phase_and_mixtures(case):
    law, shear, pull = CASES[case]
    joint, setup = blocks(1 / 8, shear, pull)
    _, phases = phases_on_s(solve(Structure(joint, **setup).interface(ThinLayer(law, 1.0))))
    mixed = (abs(phases) > EXACT) & (abs(phases) < 1 - EXACT)
    assert min(share.mean() for share in (np.maximum(phases, 0), np.maximum(-phases, 0), mixed)) >= 0.15


@pytest.mark.long
def test_columns_snap_where_and_when_the_law_on_s_does():
    """The meshed layer changes phase at the same facets; times and lost energies differ by O(eps)."""
    joint, setup = blocks(1 / 8, shear=0.04, pull=0.03, moved=True)
    plates, times, errors = Structure(joint, **setup), (0.25, 0.5, 0.75, 1.0), []
    limit = march(plates.interface(ThinLayer(PURE_LAW, 1.0)), times)
    on_s, phases = np.array([(snap.t, snap.lost) for snap in limit.snaps]), phases_on_s(limit.last)[1]
    assert len(on_s) >= 5
    for eps in (1 / 16, 1 / 32):
        full = march(plates.full(ThinLayer(PURE_LAW, eps, at=1.0), cells_through=2), times)
        assert np.abs(phases_on_s(full.last)[1] - phases).max() < 0.5
        meshed = np.array([(snap.t, snap.lost) for snap in full.snaps])
        late = np.abs(meshed - on_s)[:, 0].max() / on_s[-1, 0]
        errors.append((late, abs(meshed[:, 1].sum() / on_s[:, 1].sum() - 1)))
    orders = np.log2(np.divide(*errors))
    assert orders.min() > 0.85
    assert np.all(orders < [1.3, 1.6])


# ---------------------------------------------------------------- temperature
def heated(T, mode="normal", kind=NonMonotoneUnrelaxed, alpha=ALPHA):
    return kind(LMBDA, MU, alpha, OF_T, CHIS[mode], T=T)


def test_snap_by_heating():
    """At a displacement that is held, the layer switches as it reaches the temperature where C(T) is the drive."""
    law, K, compliance = heated(lambda x, t: 20 + 75 * t + 0 * x[0]), STIFFNESS["normal"], COMPLIANCE["normal"]
    a, d = ALPHA * 0.7, 0.04
    w = d / (1 + compliance * K)
    hot = brentq(lambda T: float(OF_T(T)) - a * w, 20, 100)
    setup = tall_column("normal", move=lambda x, t: ufl.min_value(d, 10 * d * t))
    limit, full = both(joint(), ThinLayer(law, 0.02, at=1.0), setup, [0.1, 0.5, 1.0])
    check_same(limit, full)
    for history in (limit, full):
        (snap,) = history.snaps
        assert 20 + 75 * snap.t == pytest.approx(hot, rel=1e-9)
        assert layer_shares(history.at(0.1), "S")["plus"] == 0
        assert layer_shares(history.last, "S")["plus"] == pytest.approx(1)
        check_balance(history)
    cold = both(joint(), ThinLayer(heated(hot - 1), 0.02, at=1.0), setup, [0.1, 1.0])
    assert not any(history.snaps for history in cold)
    assert all(len(h.snaps) == 1 for h in both(joint(), ThinLayer(heated(hot + 1), 0.02, at=1.0), setup, [0.1, 1.0]))


# ---------------------------------------------------------------- phases counted
def test_phases_of_sublayers_are_weighted_by_their_thickness():
    """Under a traction beyond the plateau K C/alpha - alpha/2 of one of two sublayers, beside an elastic one."""
    soon, late = (NonMonotone(0.0, MU, ALPHA, C, np.diag([0.0, 1.0])) for C in (0.02, 0.05))
    assert 2 * MU * 0.02 / ALPHA - ALPHA / 2 < 1.5 < 2 * MU * 0.05 / ALPHA - ALPHA / 2
    layer = ThinLayer(Stack((0.2, soon), (0.5, late), (0.3, LinearElastic(0.0, 30.0))), 0.1)
    sides = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    bars = Structure(joint(), body=LinearElastic(0.0, 50.0), supports=sides, tractions={"TOP": (0.0, 1.5)})
    for model in (bars.interface(layer), bars.full(layer)):
        shares = layer_shares(state := solve(model), "S")
        assert shares == pytest.approx({"plus": 0.2 / 0.7, "minus": 0.0, "boundary": 0.5 * 0.1}, rel=1e-9)
        assert Surface(model).phase(state) == pytest.approx(0.2 / 0.7, rel=1e-9)


def test_phases_by_hand():
    """Shares, boundary, profile and fronts of a march against the points of each facet, or column; in the table too."""
    for model in models(HEATED):
        history = march(model, [0.6, 1.0])
        for state in history:
            x, (row,) = model.quadratures["layer"].joint_x[0], Surface(model).table(state).rows
            places, phases = phases_on_s(state)
            by_hand = [state.memory["layer"][np.floor(8 * x).astype(int) == k, 0].mean() for k in range(8)]
            assert places == pytest.approx(np.arange(8) / 8 + 1 / 16)
            assert phases == pytest.approx(by_hand, abs=1e-12)
            assert set(np.round(by_hand, 12)) <= {-1, 0, 1}
            plus, minus = np.sum(phases > 0.5) / 8, np.sum(phases < -0.5) / 8
            assert (row["plus"], row["minus"]) == pytest.approx((plus, minus), abs=1e-9)
            assert row["boundary"] == pytest.approx(0.05 * (1 - plus - minus), abs=1e-9)
            ends = np.flatnonzero(np.diff(np.abs(by_hand) > 0.5)) + 1
            (line,) = Surface(model).along(np.abs(Surface(model).phase(state)))
            assert line.crossings(0.5)[:, 0] == pytest.approx(ends / 8)
        for snap in history.snaps:
            assert (snap.t, snap.lost) == (history.table["t"][snap.row], history.table["dissipated"][snap.row])
            assert history.table["t"][snap.row - 1] == snap.t
            assert history.table["energy"][snap.row] < history.table["energy"][snap.row - 1]
        assert history.table["plus"][-1] == row["plus"]
        assert 0 < history.table["boundary"][-1] < 0.05
