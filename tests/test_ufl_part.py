"""Forms of one's own beside bodies and layer: foundations, linear and not, their tangents, energies and refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from forms import LinearElastic
from forms.base import InputError
from geometry import sandwich
from tests.orders import taylor_order
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, UflPart, march, solve
from thinlayer.solving.solve import Solver

E, HEIGHT, EPS, P = 100.0, 0.5, 0.1, 0.3
BODY = LinearElastic.young(E, 0.0)
GLUE = LinearElastic(lmbda=0.0, mu=4.0)  # per thickness
JOINT = sandwich(1.0, HEIGHT, HEIGHT, 0.25)
ROLLERS = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
K, CUBIC = 20.0, 3e4
KINDS = ["full", "interface"]


def on_bottom(model):
    return model.ds(model.domain.values("BOTTOM"))


def winkler(u, model):
    """Energy of springs of stiffness K per area under the structure."""
    return K / 2 * u[1] ** 2 * on_bottom(model)


def hardening(u, model):
    return (K / 2 * u[1] ** 2 + CUBIC / 4 * u[1] ** 4) * on_bottom(model)


def dashed(u, v, model):
    """Springs that pull along x where the structure sinks: no energy."""
    return K * (u[1] * v[1] + 0.5 * u[1] * v[0] + u[0] * v[0]) * on_bottom(model)


def column(part, kind="interface", load=-P, law=GLUE, **change):
    """Two blocks and a layer between them on a foundation, pressed from above."""
    loads = {"tractions": {"TOP": (0.0, load) if not callable(load) else load}}
    structure = Structure(JOINT, body=BODY, parts=[part], **({"supports": ROLLERS} | loads | change))
    return getattr(structure, kind)(ThinLayer(law, EPS, at=1.0))


def sinking(state):
    """Mean displacement of the bottom, upwards."""
    return state.integral(state.u[1] * on_bottom(state.model))


@pytest.mark.parametrize("kind", KINDS)
def test_a_column_on_an_elastic_foundation(kind):
    model = column(UflPart(energy=winkler, key="soil"), kind)
    state = solve(model)
    assert state.report.method == "linear"
    assert model.symmetric
    assert sinking(state) == pytest.approx(-P / K, rel=1e-10)
    energies = state.energies()
    assert energies["soil"] == pytest.approx(P**2 / K / 2, rel=1e-10)
    stored = sum(energies[name] for name in ("bodies", "layer", "soil"))
    assert stored == pytest.approx(energies["loads"] / 2, rel=1e-10)
    assert abs(state.audit.imbalance) < 1e-10


@pytest.mark.parametrize("kind", KINDS)
def test_a_foundation_that_hardens(kind):
    """K w + CUBIC w^3 = P, in two steps, each of which balances."""
    history = march(column(UflPart(energy=hardening), kind, load=lambda x, t: (0.0, -P * t)), [0.5, 1.0])
    state = history.last
    w = -sinking(state)
    assert state.report.method == "newton"
    assert pytest.approx(P, rel=1e-9) == K * w + CUBIC * w**3
    assert w < 0.9 * P / K
    assert state.energies()["own form"] == pytest.approx(K / 2 * w**2 + CUBIC / 4 * w**4, rel=1e-9)
    assert np.abs(history.table["imbalance"]).max() < 1e-8


@pytest.mark.parametrize("part", [UflPart(energy=winkler), UflPart(energy=hardening), UflPart(dashed)])
def test_tangents(part):
    with Solver(column(part), method="newton") as solver:
        assert taylor_order(solver) > 1.9


def test_forces_without_energy():
    """The tangent is not symmetric, and the audit does not pretend to know an energy."""
    state = solve(column(UflPart(dashed)))
    assert not state.model.symmetric
    assert sinking(state) == pytest.approx(-P / K, rel=1e-9)
    assert math.isnan(state.energies()["own form"])
    assert math.isnan(state.audit.stored)
    assert not math.isnan(state.audit.supplied)


def test_a_reaction_at_the_end_of_s_leaves_out_the_form():
    """Springs beside the end of S are no traction of the layer."""
    sides = UflPart(energy=lambda u, model: 5.0 * ufl.inner(u, u) * model.ds(model.domain.values("LEFT")))
    state = solve(column(sides, supports={"BOTTOM": 0.0}))
    surface = Surface(state.model)
    jump = surface.jump(state)
    _, traction = surface.profile(surface.traction(state))
    _, expected = surface.profile(GLUE.mu * np.stack([jump[0], 2 * jump[1]]))
    assert traction == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


# ---------------------------------------------------------------- refusals
OTHER = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)


def test_what_is_no_form():
    for part, message in [
        (lambda: UflPart(), "give one function"),
        (lambda: UflPart(dashed, winkler), "give one function"),
        (lambda: UflPart(lambda u, v, model: ufl.inner(u, u) * model.dx), "linear in v"),
        (lambda: UflPart(lambda u, v, model: (ufl.inner(u, v) + ufl.inner(u, u)) * model.dx), "linear in v"),
        (lambda: UflPart(lambda u, v, model: ufl.inner(u, v)), "must be a UFL form"),
        (lambda: UflPart(lambda u, v, model: math.nan * ufl.inner(u, v) * model.dx), "not finite"),
        (lambda: UflPart(lambda u, v, model: model.coordinates.t * ufl.inner(u, v) * model.dx), "depends on the time"),
        (lambda: UflPart(lambda u, v, model: fem.Constant(OTHER, 1.0) * ufl.dx(OTHER)), "another mesh"),
        (lambda: UflPart(energy=lambda u, model: u[0] * model.dx), "do not depend on u"),
        (lambda: 3.0, "parts is 3.0"),
    ]:
        refused(InputError, message, lambda part=part: column(part()))


def test_negative_stiffness():
    with pytest.raises(InputError, match="negative stiffness"):
        solve(column(UflPart(energy=lambda u, model: -1e4 * u[1] ** 2 * model.dx), supports={"BOTTOM": 0.0}))


def test_what_holds_a_structure():
    """Springs across the bottom leave it free to move along; the form tells."""
    refused(InputError, "no support against rigid motion", lambda: column(UflPart(energy=winkler), supports={}))
    everywhere = UflPart(energy=lambda u, model: K / 2 * ufl.inner(u, u) * on_bottom(model))
    assert sinking(solve(column(everywhere, supports={}))) == pytest.approx(-P / K, rel=1e-9)
