"""Forms of one's own beside bodies and layer: foundations, linear and not, their tangents, energies and refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from forms import LinearElastic, Maxwell
from forms.base import InputError
from geometry import sandwich
from tests.orders import taylor_order
from tests.refused import refused
from thinlayer import ArcLength, Structure, Surface, ThinLayer, UflPart, march, solve
from thinlayer.solving.solvers import Solver

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
    form = state.u[1] * on_bottom(state.model)
    return state.integral(form)


@pytest.mark.parametrize("kind", KINDS)
def test_a_column_on_an_elastic_foundation(kind):
    part = UflPart(energy=winkler, key="soil")
    model = column(part, kind)
    state = solve(model)
    assert state.report.method == "linear"
    assert model.symmetric
    assert sinking(state) == pytest.approx(-P / K, rel=1e-10)
    energies = state.energies()
    assert energies["soil"] == pytest.approx(P**2 / K / 2, rel=1e-10)
    assert sum(energies[name] for name in ("bodies", "layer", "soil")) == pytest.approx(
        energies["loads"] / 2, rel=1e-10
    )
    assert abs(state.audit.imbalance) < 1e-10


def test_work_and_energy_are_the_same_foundation():
    """Given by its work the matrix is found to be symmetric, so it has an energy, too."""
    by_work = UflPart(lambda u, v, model: K * u[1] * v[1] * on_bottom(model))
    one, other = solve(column(UflPart(energy=winkler))), solve(column(by_work))
    assert not other.model.symmetric
    assert other.u.x.array == pytest.approx(one.u.x.array, abs=1e-12)
    assert other.energies() == pytest.approx(one.energies(), rel=1e-10)


@pytest.mark.parametrize("kind", KINDS)
def test_a_foundation_that_hardens(kind):
    """K w + CUBIC w^3 = P."""
    state = solve(column(UflPart(energy=hardening), kind))
    w = -sinking(state)
    assert state.report.method == "newton"
    assert pytest.approx(P, rel=1e-9) == K * w + CUBIC * w**3
    assert w < 0.9 * P / K
    assert state.energies()["own form"] == pytest.approx(K / 2 * w**2 + CUBIC / 4 * w**4, rel=1e-9)
    assert abs(state.audit.imbalance) < 1e-8


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


@pytest.mark.parametrize("theta", [1.0, 0.5])
def test_in_a_march(theta):
    """A Maxwell layer creeps above; what is below keeps its displacement, and every step balances."""
    law = Maxwell(lmbda=0.0, mu=4.0, t1=0.5)
    history = march(column(UflPart(energy=winkler), law=law), np.linspace(0.2, 1.0, 5), theta=theta)
    assert [sinking(state) for state in history] == pytest.approx([-P / K] * len(history), rel=1e-9)
    assert np.abs(history.table["imbalance"]).max() < 1e-9


def test_midpoint_refuses_foundations_that_answer_not_linearly():
    law = Maxwell(lmbda=0.0, mu=4.0, t1=0.5)
    with pytest.raises(InputError, match="the part 'own form' answers at once, and not linearly"):
        march(column(UflPart(energy=hardening), law=law), [0.1, 0.2], theta=0.5)


def test_along_a_path():
    """A foundation that softens for a while: p = k w exp(-w/w_0) + k_2 w, through both its turning points."""
    k, w_0, k_2 = 20.0, 0.02, 2.0

    def softening(u, v, model):
        return (k * ufl.exp(u[1] / w_0) + k_2) * u[1] * v[1] * on_bottom(model)

    rising = column(UflPart(softening), load=lambda x, t: (0 * t, -t), supports=ROLLERS | {"TOP": {"x": 0.0}})
    history = march(rising, ArcLength(end=0.3, first=0.01))
    w = np.array([-sinking(state) for state in history])
    assert history.t == pytest.approx((k * np.exp(-w / w_0) + k_2) * w, abs=1e-8)
    assert (np.diff(w) > 0).all()
    assert np.count_nonzero(np.diff(np.sign(np.diff(history.t)))) == 2


def test_a_reaction_at_the_end_of_s_leaves_out_the_form():
    """Springs beside the end of S are no traction of the layer."""
    sides = UflPart(energy=lambda u, model: 5.0 * ufl.inner(u, u) * model.ds(model.domain.values("LEFT")))
    state = solve(column(sides, supports={"BOTTOM": 0.0}))
    surface = Surface(state.model)
    jump = surface.jump(state)
    _, told = surface.profile(surface.traction(state))
    _, expected = surface.profile(GLUE.mu * np.stack([jump[0], 2 * jump[1]]))
    assert told == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


# ---------------------------------------------------------------- refusals
OTHER = mesh.create_unit_square(MPI.COMM_WORLD, 2, 2)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (lambda: UflPart(), "give one function"),
        (lambda: UflPart(dashed, winkler), "give one function"),
        (lambda: UflPart(3.0), "give one function"),
        (lambda: UflPart(lambda u, v, model: ufl.inner(u, u) * model.dx), "linear in v"),
        (lambda: UflPart(lambda u, v, model: ufl.inner(u, v) * ufl.inner(v, v) * model.dx), "linear in v"),
        (lambda: UflPart(lambda u, v, model: (ufl.inner(u, v) + ufl.inner(u, u)) * model.dx), "linear in v"),
        (lambda: UflPart(lambda u, v, model: ufl.sqrt(ufl.inner(v, v)) * model.dx), "linear in v"),
        (lambda: UflPart(lambda u, v, model: ufl.inner(u, v)), "must be a UFL form"),
        (lambda: UflPart(lambda u, v, model: None), "must be a UFL form"),
        (lambda: UflPart(lambda u, v: ufl.inner(u, v)), "TypeError"),
        (lambda: UflPart(lambda u, v, model: u[7] * v[0] * model.dx), "the part 'own form'"),
        (lambda: UflPart(lambda u, v, model: math.nan * ufl.inner(u, v) * model.dx), "not finite"),
        (lambda: UflPart(lambda u, v, model: model.coordinates.t * ufl.inner(u, v) * model.dx), "depends on the time"),
        (lambda: UflPart(lambda u, v, model: fem.Constant(OTHER, 1.0) * ufl.dx(OTHER)), "another mesh"),
        (lambda: UflPart(lambda u, v, model: u[0] * v[0] * model.ds((1, 999))), "which is nothing here"),
        (lambda: UflPart(lambda u, v, model: u[0] * v[0] * model.ds(True)), "tags are whole numbers"),
        (lambda: UflPart(energy=lambda u, model: u[0] * model.dx), "do not depend on u"),
        (lambda: UflPart(energy=lambda u, model: 1.0 * model.dx), "do not depend on u"),
        (lambda: UflPart(lambda u, v, model: v[0] * model.dx), "do not depend on u"),
        (lambda: UflPart(dashed, key="layer"), "called 'layer'"),
        (lambda: 3.0, "one of parts is 3.0"),
    ],
)
def test_what_is_no_form(part, message):
    refused(InputError, message, lambda: column(part()))


def test_negative_stiffness():
    with pytest.raises(InputError, match="negative stiffness"):
        solve(column(UflPart(energy=lambda u, model: -1e4 * u[1] ** 2 * model.dx), supports={"BOTTOM": 0.0}))


def test_two_forms_need_two_keys():
    parts = [UflPart(energy=winkler), UflPart(energy=hardening)]
    with pytest.raises(InputError, match="two parts are called 'own form'"):
        Structure(JOINT, body=BODY, supports=ROLLERS, parts=parts).bonded()
    Structure(JOINT, body=BODY, supports=ROLLERS, parts=[parts[0], UflPart(energy=hardening, key="other")]).bonded()


def test_what_holds_a_structure():
    """Springs across the bottom leave it free to move along; the form tells."""
    refused(InputError, "no support against rigid motion", lambda: column(UflPart(energy=winkler), supports={}))
    everywhere = UflPart(energy=lambda u, model: K / 2 * ufl.inner(u, u) * on_bottom(model))
    assert sinking(solve(column(everywhere, supports={}))) == pytest.approx(-P / K, rel=1e-9)
