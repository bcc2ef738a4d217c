"""What a step tries in turn, and what the log says of it."""

import logging

import numpy as np
import pytest

from forms import IncrementalCoulomb, LinearElastic, MohrCoulomb
from geometry import sandwich
from tests.refused import refused
from thinlayer import SolveError, Structure, ThinLayer, march, solve
from thinlayer.solving.contact.methods import MAX_CONDENSED_DOFS
from thinlayer.solving.newton import NewtonSolver

JOINT = sandwich(8, 2, 2, h=1.0, structured=True)
STEEL = LinearElastic.young(E=20e3, nu=0.2)


def model(law=None, push=0.3):
    law = law or MohrCoulomb(120.0, 80.0, cohesion=0.2, friction_angle=35)
    supports = {"BOTTOM": 0, "TOP": {"y": -0.02}}
    loads = {"TOP": (lambda x, t: (push * t, 0.0))}
    return Structure(JOINT, body=STEEL, supports=supports, tractions=loads).interface(ThinLayer(law, 1.0))


def failing(monkeypatch, times, after=0):
    """Let some solves fail: so many, after so many others."""
    solves = iter(range(after + times))

    def find(self, start=None, real=NewtonSolver.solve_step):
        if next(solves, -1) >= after:
            raise SolveError("it was told to", residuals=(1.0, 0.5))
        return real(self, start)

    monkeypatch.setattr(NewtonSolver, "solve_step", find)


def messages(caplog, name, level=logging.INFO):
    return [r.getMessage() for r in caplog.records if r.name == name and r.levelno >= level]


def test_what_succeeds_at_once_is_said_to_those_alone_who_ask_for_everything(caplog):
    with caplog.at_level(logging.DEBUG, "thinlayer"):
        solve(model(), 1.0)
    assert not messages(caplog, "thinlayer.solve")
    (line,) = messages(caplog, "thinlayer.solve", logging.DEBUG)
    assert "newton, lu: " in line
    assert "iterations, residual" in line


def test_the_next_attempt_is_told_with_the_reason(caplog, monkeypatch):
    """The same equilibrium, more iterations, and a line for each attempt after the first."""
    straight = solve(model(), 1.0)
    failing(monkeypatch, 1)
    with caplog.at_level(logging.INFO, "thinlayer"):
        state = solve(model(), 1.0)
    assert messages(caplog, "thinlayer.solve") == ["t = 1: homotopy is tried, as newton, lu failed: it was told to"]
    assert state.report.iterations >= 2
    assert state.report.homotopy_steps > 0
    near = 1e-8 * np.abs(straight.u.x.array).max()
    np.testing.assert_allclose(state.u.x.array, straight.u.x.array, rtol=0, atol=near)


def test_shorter_steps_are_told(caplog, monkeypatch):
    """Of a march, with the reason."""
    failing(monkeypatch, 1, after=1)  # the first solve is at the start
    with caplog.at_level(logging.INFO, "thinlayer"):
        history = march(model(LinearElastic.young(E=10.0, nu=0.3)), [1.0])
    lines = messages(caplog, "thinlayer.march")
    assert "t = 0: a step of 1 is shortened to 0.5: it was told to" in lines
    assert [line.partition(":")[0] for line in lines] == ["t = 0", "t = 0", "t = 0.5", "t = 1"]
    assert history.last.t == 1.0


def test_leaves_that_multigrid_does_not_solve_are_solved_by_newton(caplog, monkeypatch):
    """Slender leaves part node by node. Who chose multigrid hears of the other method instead."""
    joint = sandwich(60.0, 3.0, 3.0, h=1.5, structured=True, cell="quadrilateral")
    load = {"supports": {"LEFT": 0}, "tractions": {"RIGHT/UPPER": (0, -2.0)}, "element": "Q1"}
    law = IncrementalCoulomb(K_N=7e5, K_T=1.0, friction=0.0)
    leaves = Structure(joint, body=LinearElastic.young(E=2e5, nu=0.0), **load).interface(law)
    wanted = solve(leaves).u.x.array
    refused(SolveError, "try method='newton'", solve, leaves, method="multigrid", options={"snes_max_it": 3})
    monkeypatch.setitem(MAX_CONDENSED_DOFS, 2, 0)
    with caplog.at_level(logging.INFO, "thinlayer"):
        state = solve(leaves)
    assert state.report.method == "newton"
    assert state.u.x.array == pytest.approx(wanted, abs=1e-8 * np.abs(wanted).max())
    (line,) = messages(caplog, "thinlayer.solve")
    assert line.startswith("t = 0: newton, lu is tried, as multigrid failed: Newton's method for contact failed after")
