"""Limit loads of layers that yield, and eased laws where Newton's method fails."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import ufl

from forms import (
    Anisotropic,
    IncrementalCoulomb,
    LinearElastic,
    MohrCoulomb,
    MohrCoulombMonodirectional,
    Stack,
    VonMises,
)
from forms.traction import TractionLaw
from geometry import sandwich
from tests.limit_load_run import FULL, SLIDING, dragged, sheared
from tests.own_laws import layer_of
from tests.refused import refused
from thinlayer import Adaptive, SolveError, Structure, Surface, ThinLayer, march, solve
from thinlayer.errors import LimitLoad
from thinlayer.parts.compiled_part import CompiledPart
from thinlayer.running.cli import main as command
from thinlayer.running.process import OK, UNFINISHED
from thinlayer.running.record import Record
from thinlayer.solving.solve import Solver
from thinlayer.solving.weak_springs import WeakSprings

pytestmark = pytest.mark.few(5)

TAN, SIN, COS = np.tan(np.pi / 6), np.sin(np.pi / 6), np.cos(np.pi / 6)
LIMITS = {SLIDING: 0.1 + TAN, FULL: 0.1 * COS + SIN}  # of the mean shear traction under a mean pressure of 1
TIMES = [0.5, 0.8, 1.1]
SMALLEST = 0.3 / 1024


def limit(model, times=TIMES, **choices) -> LimitLoad:
    return refused(LimitLoad, "", march, model, times, **choices)


# ---------------------------------------------------------------- the limit load
@pytest.mark.few(2)
@pytest.mark.parametrize(("law", "kind"), [(SLIDING, "S"), (FULL, "band")], ids=["S", "band"])
def test_the_limit_of_a_sheared_block(law, kind, tmp_path):
    """The traction of every point is at its bound there, so that the mean is, wherever the pressure is."""
    error = limit(sheared(kind, law), out=tmp_path, keep="all" if kind == "S" else "last")
    again = limit(sheared(kind, law), out=tmp_path, keep="all" if kind == "S" else "last", resume=True)
    assert (again.t, again.failed_at) == (error.t, error.failed_at)
    assert error.t < LIMITS[law] < error.failed_at == pytest.approx(error.t + SMALLEST, abs=1e-9)
    assert error.resultant == pytest.approx((error.t, -1.0), abs=1e-12)
    assert f"at t = {error.t:.10g}, where the loads on the bodies add up to ({error.t:.6g}, -1)" in str(error)
    assert f"at t = {error.failed_at:.10g} none was found" in str(error)
    assert error.history.t[-1] == error.history.last.t == error.t
    assert np.abs(error.history.table["imbalance"]).max() < 1e-8
    before = march(sheared(kind, law), list(error.history.t[1:]))
    assert before.last.u.x.array == pytest.approx(error.history.last.u.x.array, rel=1e-6, abs=1e-9)


def test_adaptive_steps_and_stacks():
    law = Stack((0.4, LinearElastic(30.0, 50.0)), (0.6, SLIDING))
    error = limit(sheared("S", law), Adaptive(1.0, first=0.2, tolerance=0.2, smallest=1e-3))
    assert error.failed_at == pytest.approx(LIMITS[SLIDING], abs=2e-2)


def test_a_moved_block_passes_the_limit_and_stays_there():
    model = sheared("S", tractions={"TOP": (0.0, -1.0)}, supports={"TOP": {"x": lambda x, t: 0.02 * t}})
    surface = Surface(model)
    observe = {"shear": lambda state: surface.integral(surface.traction(state)[0])}
    shear = march(model, [1.0, 2.0, 5.0, 50.0], observe=observe).table["shear"]
    assert shear[1] < 0.99 * LIMITS[SLIDING]
    assert shear[3:] == pytest.approx(LIMITS[SLIDING], rel=1e-9)


def test_an_elastic_fraction_has_no_limit():
    law = MohrCoulombMonodirectional(60.0, 40.0, cohesion=0.1, friction_angle=30.0, elastic_fraction=0.02)
    assert march(sheared("S", law), TIMES).last.t == TIMES[-1]


def test_what_was_seen_farther_on_stays_a_sign(monkeypatch):
    """Newton's method may cycle just beyond the limit, where the weak springs matter most."""
    seek, farthest = Solver.solve_regularised, 0.05

    def cycles_nearby(solver, old, t, theta):
        if t - old.t < farthest:
            raise SolveError("it cycles")
        return seek(solver, old, t, theta)

    monkeypatch.setattr(Solver, "solve_regularised", cycles_nearby)
    error = limit(sheared("S"))
    assert error.t < LIMITS[SLIDING] < error.t + farthest <= error.failed_at
    farthest = 1.0
    assert not isinstance(refused(SolveError, "need not be a limit", march, sheared("S"), TIMES), LimitLoad)


def test_one_step_beyond_the_limit():
    refused(SolveError, "loads may have a limit", solve, sheared("S"), 0.7)
    refused(SolveError, r"the sudden load at t = 0\.7: ", lambda: march(sheared("S"), [0.8], start=0.7))


def test_a_study_ends_with_status_3(tmp_path, monkeypatch, capsys):
    import studies.rates as study

    def run(record: Record, **_) -> None:
        record.march(sheared("S"), TIMES, "sheared")

    monkeypatch.setattr(study, "run", run)
    assert command(["run", "rates", "--out", str(tmp_path)]) == UNFINISHED != OK
    assert re.search(r"limit load: .*\nresults so far are kept in", capsys.readouterr().err)
    assert "limit load" in json.loads((tmp_path / "run.json").read_text())["error"]
    rows = list(csv.DictReader((tmp_path / "unfinished" / "sheared" / "table.csv").open()))
    assert 0.677 < float(rows[-1]["t"]) < LIMITS[SLIDING]


# ---------------------------------------------------------------- its sign
@pytest.mark.few(5)
@pytest.mark.parametrize(("kind", "law"), [("band", SLIDING), ("S", FULL)])
def test_newton_cut_short_is_no_limit(kind, law):
    """With two steps of Newton's method: what they miss is found by other means, up to the limit itself."""
    error = limit(sheared(kind, law), options={"snes_max_it": 2})
    assert error.t == pytest.approx(LIMITS[law], rel=3e-3)
    assert error.t < LIMITS[law] < error.failed_at * (1 + 1e-4)  # just below it an equilibrium is very far away
    assert error.growth > 100
    assert f"displacements run away, {error.growth:.3g} times as far as with an elastic layer" in str(error)
    assert error.history.table["residual"].max() < 1e-9
    assert np.abs(error.history.table["imbalance"]).max() < 1e-8


def test_adaptive_steps_that_shrink_at_the_limit():
    """Displacements of the last steps grow too fast for the tolerance, before an equilibrium is missing."""
    error = limit(sheared("S", FULL), Adaptive(1.0, first=0.2, tolerance=1e-2, smallest=1e-3))
    assert "its estimated error stays above the tolerance" in str(error)
    assert error.t < LIMITS[FULL] < error.failed_at < LIMITS[FULL] + 0.02
    assert error.growth > 1e3


@dataclass(frozen=True)
class Tearing(TractionLaw):
    """Springs that are not defined beyond an opening, of a law that says it bounds stresses."""

    k: float
    bounded: ClassVar = True

    def traction(self, step):
        return ufl.conditional(ufl.lt(step.mid[1], 0.013), 1.0, ufl.sqrt(-1 - step.mid[1] ** 2)) * self.k * step.mid


@pytest.mark.filterwarnings("ignore:Value error in evaluation of function sqrt")
def test_steps_that_fail_without_the_sign():
    model = sheared("S", Tearing(70.0), tractions={"TOP": lambda x, t: (0.0, t)})
    caught = refused(SolveError, r"need not be a limit of the loads: try other times", march, model, TIMES)
    assert not isinstance(caught, LimitLoad)
    assert caught.history.t[-1] == pytest.approx(0.013 * 70.0, rel=2e-2)


class Tried(WeakSprings):
    """Residuals that are known at some lengths of a step."""

    def __init__(self, sizes):
        self.sizes, self.lengths = sizes, []

    def _residual_norm(self, x):
        self.lengths.append(x)
        return self.sizes[x]


def test_lengths_of_a_step_with_weak_springs():
    """The equations are left at the length that is chosen."""
    for sizes, at in [
        ({1.0: 2.0, 0.5: 0.96, 0.25: 0.9}, 0.25),  # the first that falls by a tenth of its length
        ({1.0: 2.0, 0.5: 1.5, 0.25: 1.2, 0.125: 1.1, 0.0625: 1.3, 0.03125: 1.4}, 0.125),  # the least, where none does
    ]:
        springs = Tried(sizes)
        assert springs._line_search(0.0, 1.0, 1.0) == (at, sizes[at])
        assert springs.lengths[-1] == at


# ---------------------------------------------------------------- eased laws
@pytest.mark.parametrize("kind", ["S", "band"])
def test_continuation_finds_what_newton_finds(kind):
    """Newton's method, allowed fewer steps than it needs, is helped by easier laws."""
    law = MohrCoulomb(60.0, 40.0, cohesion=0.05, friction_angle=30.0, elastic_fraction=0.02)
    model = dragged(law, far=0.06, eps=1 / 16, kind=kind)
    direct = solve(model)
    continued = solve(model, options={"snes_max_it": 3})
    assert direct.report.homotopy_steps == 0 < continued.report.homotopy_steps
    assert direct.report.iterations <= 7 < continued.report.iterations
    assert continued.u.x.array == pytest.approx(direct.u.x.array, abs=1e-8 * np.abs(direct.u.x.array).max())
    for memory, other in zip(direct.memory.values(), continued.memory.values(), strict=True):
        assert other == pytest.approx(memory, abs=1e-7 * np.abs(memory).max())
    assert vars(continued.audit) == pytest.approx(vars(direct.audit), rel=1e-7)


def test_continuation_finds_what_newton_does_not_find():
    with Solver(dragged(MohrCoulombMonodirectional(60.0, 40.0, cohesion=0.0, friction_angle=30.0), far=0.25)) as solver:
        refused(SolveError, "Newton's method failed", lambda: solver.step(solver.rest_state(0.0), 0.0, 1.0, False))
        state = solver.step(solver.rest_state(0.0), 0.0)
    assert state.report.homotopy_steps > 1
    assert state.report.residual < 1e-8
    assert abs(state.audit.imbalance) < 1e-8 * state.audit.supplied
    assert state.audit.dissipated > 0


def test_eased_laws_leave_no_trace():
    """After a failure too: the next step is the law's own."""
    with Solver(sheared("S")) as solver:
        expected = solver.step(solver.rest_state(0.3), 0.3)
        parameters = [p.points.material.parameters.copy() for p in solver.equations.of_kind(CompiledPart)]
        refused(SolveError, "", solver.step, expected, 0.7)
        for p, before in zip(solver.equations.of_kind(CompiledPart), parameters, strict=True):
            assert (p.points.material.parameters == before).all()
        again = solver.step(solver.rest_state(0.3), 0.3)
    assert (again.u.x.array == expected.u.x.array).all()


# ---------------------------------------------------------------- beside larger forces
def pushed_along(law, ratio: float, **data):
    """A light block, pressed and pushed along on a clamped one, which bears larger forces by a ratio; the limit is 1."""
    joint, light = sandwich(1.0, 2.0, 0.5, h=0.5, h_S=0.25), LinearElastic.young(E=300.0, nu=0.0)
    heavy = LinearElastic.young(E=300.0 * max(1.0, ratio / 1e3), nu=0.0)
    tractions = {"RIGHT/UPPER": lambda x, t: (t * 0.05 / 0.5, 0), "TOP": (0, -0.1)}
    data = {"body_force": {"LOWER": (0, -0.05 * ratio)}, "element": "P1", "tractions": tractions} | data
    return Structure(joint, body={"LOWER": heavy, "UPPER": light}, supports={"BOTTOM": 0}, **data).interface(law)


RUBS = MohrCoulombMonodirectional(0.0, 10.0, 0.0, friction_angle=np.degrees(np.arctan(0.5)), unilateral=True)
PUSHED = {
    "slides": layer_of(RUBS, 0.01),
    "yields": layer_of(VonMises(0.0, 10.0, strength=0.05 * 3**0.5), 0.01),
    "contact": IncrementalCoulomb(K_N=1e3, K_T=1e3, friction=0.5),
}


@pytest.mark.few(12)
@pytest.mark.parametrize("ratio", [1.0, 1e6])
@pytest.mark.parametrize("law", PUSHED)
def test_larger_forces_elsewhere_do_not_hide_a_limit(law, ratio):
    """Residuals of a millionth of all forces were more than the force that was missing."""
    error = limit(pushed_along(PUSHED[law], ratio), [0.5, 0.9, 1.1, 1.5])
    assert error.t == pytest.approx(1.0, abs=0.01)
    assert error.history.t[-1] <= 1.002


def test_pressure_does_not_hide_a_limit():
    """A layer a million times weaker than the pressure on it: steps beyond its limit stalled at residuals below 1e-6."""
    weak = layer_of(VonMises(0.0, 10.0, strength=1e-7 * 3**0.5), 0.01)
    load = {"RIGHT/UPPER": lambda x, t: (2e-7 * t, 0.0), "TOP": (0.0, -0.1)}
    assert limit(pushed_along(weak, 1.0, tractions=load), [0.5, 0.9, 1.1, 1.5, 3.0]).t == pytest.approx(1.0, abs=0.002)


def test_weak_springs_that_hold_stiff_bodies_are_right():
    """A stiff wall on springs 1e7 times softer turns by the moment of its load; residuals are rounding of its stiffness."""
    load, K, high = 0.02, 30.0, 8.0
    data = {"body": LinearElastic.young(E=1e8, nu=0.2), "supports": {"BOTTOM": 0}, "tractions": {"TOP": (load, 0.0)}}
    made = Structure(sandwich(1.0, 0.5, high, h=0.5), **data)
    state = solve(made.interface(ThinLayer(Anisotropic.springs(K, K / 3), 1.0)))
    surface = Surface(state.model)
    moment = surface.integral(surface.jump(state)[1] * (surface.x[0] - 0.5)) * K
    assert abs(moment) == pytest.approx(load * high, rel=3e-5)
    assert np.ptp(surface.nodal(surface.jump(state)[1])) == pytest.approx(12 * load * high / K, rel=3e-5)
