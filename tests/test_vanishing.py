"""Equilibria in which displacements or forces vanish, and steps after PETSc has met an error."""

from __future__ import annotations

import numpy as np
import pytest

from forms import HolonomicCoulomb, IncrementalCoulomb, LinearElastic, Maxwell, VonMises
from forms.base import InputError
from geometry import periodic, sandwich
from tests.refused import refused
from tests.test_periodic import laminate
from thinlayer import Adaptive, Structure, Surface, march, solve
from thinlayer.parts.compiled_part import CompiledPart
from thinlayer.solving.newton import NewtonSolver
from thinlayer.solving.solve import Solver

pytestmark = pytest.mark.few(5)

ROUNDED = 1e-9
FLAT = periodic(sandwich(2.0, 1.0, 0.5, 0.5), ("LEFT", "RIGHT"), ("BOTTOM", "TOP"))
CELLS = {2: FLAT, 3: laminate("hexahedron", 0.25, depth=0.75)}
LMBDA, MU, TAU = 60.0, 40.0, 2.0


# ---------------------------------------------------------------- displacements vanish
@pytest.mark.parametrize(("d", "unit", "dt"), [(2, 1.0, 1e-3), (3, 1e6, 0.5), (2, 1e6, 20.0)])
def test_a_uniform_cell_that_relaxes(d, unit, dt):
    """u is zero, the stress that of the implicit Euler scheme: G falls by 1/(1 + dt/tau) in each step."""
    strain = np.zeros((d, d))
    strain[0, 1] = strain[1, 0] = 1.5e-3
    law = Maxwell(LMBDA * unit, MU * unit, TAU)
    last = march(Structure(CELLS[d], body=law, supports={}, strain=strain.tolist()).bonded(), [dt, 2 * dt]).last
    assert last.mean_stress()[0, 1] == pytest.approx(2 * MU * unit * 1.5e-3 / (1 + dt / TAU) ** 2, rel=ROUNDED)
    assert np.abs(last.u.x.array).max() < 1e-12 * 1.5e-3


@pytest.mark.parametrize("law", [LinearElastic(LMBDA, MU), Maxwell(LMBDA, MU, TAU)])
def test_a_body_that_is_held_all_around_and_heated(law):
    slab = Structure(sandwich(2.0, 1.0, 0.5, 0.25), body=law, supports={s: 0.0 for s in ("LEFT", "RIGHT", "TOP", "BOTTOM")},
                     eigenstrain=1e-3)  # fmt: skip
    assert np.abs(march(slab.bonded(), [0.5]).last.u.x.array).max() < 1e-12 * 1e-3


# ---------------------------------------------------------------- forces vanish
SHRUNK = {"BOTTOM": {"y": 0.0}, "TOP": {"y": 0.0}, "LEFT": {"x": 0.0}}
NU = 0.25


SHRINKING = [
    (HolonomicCoulomb, "condensed", 1.0, 0.0),
    (IncrementalCoulomb, "multigrid", 1e9, 0.01),
    (HolonomicCoulomb, "newton", 1e9, 0.0),
    (IncrementalCoulomb, "newton", 1.0, 0.01),
]


@pytest.mark.parametrize(("kind", "method", "unit", "initial"), SHRINKING)
def test_bodies_that_shrink_away_from_each_other(kind, method, unit, initial):
    """The gap opens by (1 + nu) e h in plane strain, beside an initial one, and all forces vanish."""
    bodies = LinearElastic.young(1e4 * unit, NU)
    structure = Structure(sandwich(10.0, 4.0, 6.0, 2.0), body=bodies, supports=SHRUNK, eigenstrain=-1e-3, element="P1")
    state = solve(structure.interface(kind(1e5 * unit, 8e4 * unit, friction=0.3, gap=initial)), method=method)
    largest = np.abs(state.u.x.array.reshape(-1, 2)[:, 1]).max()
    assert largest == pytest.approx((1 + NU) * 1e-3 * 6.0, rel=1e-8)  # of the upper side of S, from TOP
    assert np.abs(Surface(state.model).contact(state).normal_force) < 1e-9 * 1e4 * unit * 1e-3 * 10.0


# ---------------------------------------------------------------- far beyond yield, and errors within Newton's method
E, Y = 1e4, 15.0
SHEET = sandwich(10.0, 2.0, 4.0, 3.0)
IDEAL = VonMises.young(E, 0.3, strength=Y)


def sheet(supports, law=IDEAL, grows=False):
    strain = ((1e-3, 0.0), (0.0, 2e-3))
    eigenstrain = (lambda x, t: [[c * t for c in row] for row in strain]) if grows else strain
    return Structure(SHEET, body=law, supports=supports, eigenstrain=eigenstrain, plane="stress").bonded()


HELD = [({"BOTTOM": 0}, True), ({"BOTTOM": {"y": 0}, "LEFT": {"x": 0.0}}, False)]


@pytest.mark.parametrize(("supports", "grows"), HELD)
def test_a_first_step_far_beyond_yield(supports, grows):
    """In one step or in short ones: the loads are far from a limit, and the answer is nearly the same."""
    model = sheet(supports, grows=grows)
    once = march(model, [1.0]).last
    audit, worked = once.audit, Y * 2e-3 * 60.0
    assert abs(audit.supplied - audit.stored - audit.dissipated - audit.remainder) < 1e-8 * worked
    if grows:
        often = march(model, Adaptive(end=1.0, first=0.25, tolerance=1e-2)).last
        assert np.abs(once.u.x.array - often.u.x.array).max() < 0.05 * np.abs(once.u.x.array).max()


def test_an_error_of_a_law_within_newtons_method_is_told(monkeypatch):
    """As it was raised, not as an error of PETSc's; the same solver then finds the equilibrium."""
    model, tangents, calls = sheet({"BOTTOM": 0.0}), CompiledPart.tangents, iter(range(99))

    def failing(self, relative_residual):
        if next(calls, 0) == 2:
            raise InputError("told by a law")
        return tangents(self, relative_residual)

    monkeypatch.setattr(CompiledPart, "tangents", failing)
    with Solver(model) as solver:
        refused(InputError, "told by a law", lambda: solver.step(solver.rest_state(0.0), 0.0))
        assert solver.step(solver.rest_state(0.0), 0.0).report.residual < 1e-8
        assert isinstance(solver._solver, NewtonSolver)
