"""Derivatives by parameters: Taylor's remainders, marches with memory, sensitivities, fields, what is refused, ranks."""

from __future__ import annotations

import contextlib
import io
import runpy
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
import ufl

from forms import (
    HolonomicCoulomb,
    Incompressible,
    KelvinVoigt,
    LinearElastic,
    Maxwell,
    MohrCoulomb,
    NonMonotoneUnrelaxed,
    Norton,
    NortonCreep,
    Rubber,
    Stack,
    VonMises,
)
from forms.base import InputError
from geometry import sandwich
from tests.on_ranks import on_ranks
from tests.own_laws import Skew, Slipping, StandardSolid, layer_of
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, derivative, goals, march, sensitivity, solve
from thinlayer.estimating.parameters import Parameters
from thinlayer.parts.compiled_part import CompiledPart
from thinlayer.solving.adjoint import Adjoint

pytestmark = pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")

BODIES = {"LOWER": LinearElastic.young(E=70.0, nu=0.2), "UPPER": LinearElastic.young(E=110.0, nu=0.31)}
GLUE, EPS, JOINT = LinearElastic.young(E=2.0, nu=0.4), 0.2, sandwich(2.0, 0.5, 0.7, 0.5)
OWN_KERNEL = Path(__file__).parent / "own_scripts/own_kernel.py"
TIMES = [k / 8 for k in range(1, 9)]


def structure(**data):
    standard_data = {"supports": {"RIGHT/LOWER": 0, "LEFT/UPPER": {"y": 0.003}}, "tractions": {"TOP": (0.3, -1.0)}}
    standard_data |= {"body_force": (0.2, -0.4), "eigenstrain": {"UPPER": 0.002}}
    return Structure(JOINT, body=BODIES, **(standard_data | data))


def top(u, model):
    return (u[0] - 0.3 * u[1] + 50 * u[0] ** 2) * model.ds(model.domain.values("TOP"))


GOALS = {
    "functional": goals.Functional("functional", top),
    "compliance": goals.Compliance(),
    "reaction": goals.Reaction("RIGHT/LOWER", (0.3, 1)),
    "traction": goals.MeanTraction((0.2, 1)),
    "displacement": goals.Displacement((0.35, 0.4), (1, 0.5)),
}


def own_kernel():
    """The law in C of a page, with the source in the working directory."""
    with contextlib.redirect_stdout(io.StringIO()):
        law = runpy.run_path(str(OWN_KERNEL))["Mises"](kappa=8.0, mu=4.0, limit=0.6)
    return ThinLayer(law, EPS)


def last_of(solution):
    return getattr(solution, "last", solution)


def orders(model, result, run, weights, hs=(1e-2, 1e-3)):
    """Order of the remainder of Taylor's expansion, with all parameters changed at once; inf where it is rounding."""
    changes, remainders = Parameters(model), []
    for h in hs:
        changed = model
        for name, weight in weights.items():
            changed = changes[name](changed, 1 + h * weight)
        linear = result.value + h * sum(weight * result.by[name] for name, weight in weights.items())
        remainders.append(abs(result.goal.value(last_of(run(changed)), changed) - linear))
    size = abs(result.value) + sum(map(abs, result.by.values()))
    return np.inf if remainders[-1] < 1e-10 * size else np.log10(remainders[0] / remainders[1])


def weighted(names):
    """A weight of its own for each parameter: errors of two do not cancel."""
    return {name: np.cos(1.0 + 3.7 * k) for k, name in enumerate(names)}


# ---------------------------------------------------------------- states
LAYERS = {
    "order 0": ThinLayer(GLUE, EPS, eigenstrain=0.01),
    "order 1": ThinLayer(GLUE, EPS, order=1, eigenstrain=0.01),
    "pressure": ThinLayer(Rubber(20.0, 5.0), EPS, order=1),
    "no volume": ThinLayer(Incompressible(5.0), EPS, order=1),
    "stack": ThinLayer(Stack((0.3, GLUE), (0.7, LinearElastic(3.0, 2.0))), EPS),
    "friction": ThinLayer(MohrCoulomb(6.0, 4.0, 0.3, 30.0), EPS),
    "yielding": ThinLayer(VonMises(6.0, 4.0, 0.1, 2.0), EPS, order=1),
    "jumps": Slipping(11.0, 7.0, 0.5, 3.0),
    "skew": ThinLayer(Skew(6.0, 2.0), EPS),
    "kernel": own_kernel,
}
ROWS = {
    "order 0": ("functional reaction", "S.nu S.eps LOWER.nu"),
    "order 1": ("compliance displacement", "S.E S.nu S.eps"),
    "pressure": ("functional traction", "S.mu S.lmbda S.eps UPPER.E"),
    "no volume": ("compliance reaction", "S.mu S.eps UPPER.lmbda"),
    "stack": ("traction displacement", "S/1.nu S/2.mu S.eps"),
    "friction": ("functional compliance", "S.mu S.cohesion S.friction_angle"),
    "yielding": ("functional reaction", "S.strength S.hardening LOWER.E"),
    "jumps": ("compliance reaction", "S.k_N S.k_T S.closed"),
    "skew": ("functional displacement", "S.mu S.c S.eps"),
    "kernel": ("displacement traction", "S.kappa S.mu S.limit S.eps"),
}
DATA = ["eigenstrain UPPER", "load TOP", "body force", "support LEFT/UPPER y"]


@pytest.mark.few(4)
@pytest.mark.parametrize("kind", ROWS)
def test_the_remainder_is_quadratic(kind, tmp_path, monkeypatch):
    """By parameters of layers, bodies, loads and supports; each is that of the linearised state, too."""
    monkeypatch.chdir(tmp_path)
    layer, (goal_names, names) = LAYERS[kind], ROWS[kind]
    model = structure().interface(layer() if callable(layer) else layer)
    state, names = solve(model), [*names.split(), *DATA, *["eigenstrain S"][: kind.startswith("order")]]
    linearised = sensitivity(state, names)
    for goal in (GOALS[name] for name in goal_names.split()):
        result = derivative(state, goal, names)
        assert min(map(abs, result.by.values())) > 0
        assert orders(model, result, solve, weighted(names)) > 1.9, goal.name
        assert linearised.of(goal) == pytest.approx(result.by, rel=3e-6, abs=1e-8 * abs(result.value))


def test_all_parameters_are_those_of_layers_bodies_loads_and_supports():
    result = derivative(solve(structure().interface(LAYERS["order 0"])), GOALS["compliance"])
    laws = {f"{place}.{name}" for place in ("S", *BODIES) for name in ("E", "nu")}  # not the same again by lmbda, mu
    assert result.by.keys() == laws | {"S.eps", "eigenstrain S", *DATA}
    lame = derivative(solve(structure().interface(LAYERS["order 0"])), GOALS["compliance"], ["S.lmbda", "S.mu"])
    assert result.by["S.E"] == pytest.approx(sum(lame.by.values()), rel=1e-7)
    stiffer = {"E": lambda f: ThinLayer(LinearElastic.young(E=2.0 * f, nu=0.4), EPS, eigenstrain=0.01)}
    state = solve(structure().interface(LAYERS["order 0"]))
    assert derivative(state, GOALS["compliance"], of=stiffer).by == pytest.approx({"E": result.by["S.E"]}, rel=1e-8)


def test_the_tangent_is_transposed(monkeypatch):
    """That of a friction is not symmetric."""
    state = solve(structure().interface(LAYERS["friction"]))
    results = [derivative(state, GOALS["functional"], ["S.cohesion", "S.mu"])]
    solve_system = Adjoint._solve
    monkeypatch.setattr(Adjoint, "_solve", lambda self, q, x, transposed: solve_system(self, q, x, transposed=False))
    results.append(derivative(state, GOALS["functional"], ["S.cohesion", "S.mu"]))
    assert results[1].by["S.mu"] != pytest.approx(results[0].by["S.mu"], rel=1e-2)


def test_a_column_as_in_closed_form():
    """Its compliance is t^2 (eps/M + heights over moduli), t the load, M = lmbda + 2 mu."""
    rollers = {"BOTTOM": 0, "LEFT": {"x": 0}, "RIGHT": {"x": 0}}
    column = Structure(JOINT, body=BODIES, supports=rollers, tractions={"TOP": (0, -1.3)})
    names = ["S.eps", "S.lmbda", "load TOP", "LOWER.E", "UPPER.E"]
    result = derivative(solve(column.interface(ThinLayer(GLUE, EPS))), goals.Compliance(), names)
    M, work = GLUE.lmbda + 2 * GLUE.mu, 2.0 * 1.3**2
    expected = {"S.eps": work * EPS / M, "S.lmbda": -work * EPS * GLUE.lmbda / M**2, "load TOP": 2 * result.value}
    for name, height in (("LOWER", 0.5), ("UPPER", 0.7)):
        law = BODIES[name]
        expected[f"{name}.E"] = -work * height / (law.lmbda + 2 * law.mu)
    assert {name: result.by[name] for name in expected} == pytest.approx(expected, abs=4e-8 * result.value)
    assert "% (S.eps)" in str(result)
    assert result.table()["relative"][0] == pytest.approx(next(iter(result.by.values())) / result.value)


# ---------------------------------------------------------------- marches
def marched(law, **data):
    """Eight steps with unloading, and a support that moves."""
    way = lambda t: ufl.conditional(ufl.lt(t, 0.6), t, 1.2 - t)
    supports = {"RIGHT/LOWER": 0, "LEFT/UPPER": {"y": lambda x, t: 0.003 * t}}
    tractions = {"TOP": lambda x, t: (0.9 * way(t), -0.3 * t)}
    data = {"supports": supports, "tractions": tractions, "body_force": None, "eigenstrain": None} | data
    return structure(**data).interface(law if isinstance(law, Slipping) else ThinLayer(law, EPS))


def run(model):
    return march(model, TIMES)


MARCHES = {
    law: names
    for law, names in [
        (VonMises(6.0, 4.0, 0.3, hardening=2.0), "mu strength hardening eps"),
        (Norton(6.0, 4.0, 3.0, 1.7), "mu eta p eps"),
        (Maxwell(6.0, 4.0, 0.5, 0.8), "mu t1 t2 eps"),
        (KelvinVoigt(6.0, 4.0, 0.5, 0.8), "mu theta_lmbda theta_mu eps"),
        (NortonCreep(6.0, 4.0, 0.3, 3.0), "mu A n eps"),
        (MohrCoulomb(6.0, 4.0, 0.9, 30.0, hardening=1.5), "mu cohesion friction_angle hardening"),
        (StandardSolid(6.0, 4.0, 3.0, 0.5), "mu_1 t_1 eps"),
        (Slipping(11.0, 7.0, 0.5, 3.0), "k_N k_T viscosity closed"),
    ]
}


@cache
def history(law):
    return run(marched(law))


@pytest.mark.few(4)
@pytest.mark.parametrize("law", MARCHES)
def test_marches_that_remember(law):
    names = [f"S.{name}" for name in MARCHES[law].split()] + ["LOWER.E", "support LEFT/UPPER y"]
    solution = history(law)
    linearised = sensitivity(solution, names)
    for goal in (GOALS["functional"], [*GOALS.values()][[*MARCHES].index(law) % 5]):
        result = derivative(solution, goal, names)
        assert linearised.of(goal) == pytest.approx(result.by, rel=1e-7, abs=1e-8 * abs(result.value)), goal.name
        assert orders(solution.model, result, run, weighted(names)) > 1.9, goal.name


LAWS = {type(law).__name__: law for law in MARCHES}


@pytest.mark.parametrize(("law", "name", "forgotten"), [("VonMises", "strength", 1), ("Norton", "eta", 0)])
def test_what_a_step_passes_to_the_one_before(law, name, forgotten, monkeypatch):
    """Twins without the memory, and without the strains at the start of the step."""
    solution, pullback = history(LAWS[law]), CompiledPart.pullback
    exact = derivative(solution, GOALS["functional"], [f"S.{name}"]).by

    def forgetful(self, weights, z):
        forces, before = pullback(self, weights, z)
        return (forces, 0 * before) if forgotten else (0 * forces, before)

    monkeypatch.setattr(CompiledPart, "pullback", forgetful)
    assert derivative(solution, GOALS["functional"], [f"S.{name}"]).by != pytest.approx(exact, rel=1e-2)


def test_a_history_without_memory_is_its_last_state():
    solution = march(marched(GLUE), TIMES[:4:3])
    results = [derivative(s, GOALS["compliance"], ["S.mu", "LOWER.E"]).by for s in (solution, solution.last)]
    assert results[0] == pytest.approx(results[1], rel=1e-12)
    change = sensitivity(solution, ["S.mu"])
    half = derivative(solution.at(0.125), GOALS["functional"], ["S.mu"]).by
    assert change.of(GOALS["functional"], t=0.125) == pytest.approx(half, rel=1e-7)
    assert np.abs(change.displacement("S.mu", 0.5).x.array).max() > 0
    refused(InputError, "t = 0.3 is kept; there are states at 0, 0.125, 0.5", change.of, GOALS["functional"], 0.3)


def test_where_a_law_yields_and_loads_stay():
    """Slopes on both sides of the kink differ: derivatives would be 30 times too large."""
    stay = lambda x, t: (1.2 * ufl.min_value(t, 0.5), -0.3 * ufl.min_value(t, 0.5))
    solution = march(marched(LAWS["VonMises"], supports={"BOTTOM": 0}, tractions={"TOP": stay}), TIMES[:6])
    message = r"has a kink in the step to t = 0.\d+, as where it yields and loads stay"
    refused(InputError, message, derivative, solution, GOALS["functional"], ["S.mu"])
    refused(InputError, message, sensitivity, solution, ["S.mu"])


# ---------------------------------------------------------------- fields
@pytest.mark.parametrize("name", ["mu", "strength"])
def test_a_field_is_the_derivative_by_a_parameter_that_varies(name):
    law = VonMises(6.0, 4.0, 0.1, hardening=2.0)
    state = solve(structure().interface(ThinLayer(law, EPS)))
    result, surface, direction = derivative(state, GOALS["functional"], [f"S.{name}"]), Surface(state.model), (0.4, 0.7)
    density = result.field(f"S.{name}")
    assert surface.integral(density) == pytest.approx(result.by[f"S.{name}"], rel=1e-9)
    slope = surface.integral(density * (direction[0] + direction[1] * JOINT.points[surface.vertices, 0]))
    remainders = []
    for s in (1e-2, 1e-3):
        varied = lambda x, s=s: getattr(law, name) * (1 + s * (direction[0] + direction[1] * x[0]))
        model = structure().interface(ThinLayer(replace(law, **{name: varied}), EPS))
        remainders.append(abs(GOALS["functional"].value(solve(model), model) - result.value - s * slope))
    assert np.log10(remainders[0] / remainders[1]) > 1.8


# ---------------------------------------------------------------- refused
def test_what_has_no_derivative():
    state = solve(structure().interface(ThinLayer(GLUE, EPS)))
    clamped = {"supports": {"BOTTOM": 0}, "eigenstrain": None}
    of = lambda layer, names=None, **data: derivative(
        solve(structure(**data).interface(layer)), GOALS["compliance"], names
    )
    out = state.u.copy()
    out.x.array[:] *= 1.01
    phases = NonMonotoneUnrelaxed(3.0, 2.0, 0.5, 0.08, [[0.2, 0.5], [0.5, 1.0]])
    model = marched(LAWS["Norton"])
    asked = lambda solution, names=("S.mu",), goal=GOALS["compliance"]: derivative(solution, goal, names)
    for call, message in [
        (lambda: asked(3), "the solution is 3"),
        (lambda: asked(state, goal=3), "the goal is 3"),
        (lambda: asked(state, "S.mu"), "parameters is 'S.mu'"),
        (lambda: asked(state, ["S.my"]), "did you mean 'S.mu'.*known: LOWER.E, .*S.nu.*support LEFT/UPPER y"),
        (lambda: asked(state, goal=goals.Reaction("BOTTOM", (0, 1))), "nothing holds 'BOTTOM'"),
        (lambda: asked(solve(structure(**clamped).full(ThinLayer(GLUE, EPS)))), "a full model"),
        (lambda: of(HolonomicCoulomb(200.0, 80.0, 0.5), **clamped), "contact has kinks"),
        (lambda: of(layer_of(phases, EPS), **clamped), "phases of NonMonotoneUnrelaxed switch"),
        (lambda: of(ThinLayer(GLUE, EPS, at=1.0), ["S.eps"]), "moduli follow eps"),
        (lambda: of(ThinLayer(MohrCoulomb(6.0, 4.0, 0.3, 30.0), EPS), ["S.dilatancy_angle"]), "it is 0"),
        (lambda: asked(replace(state, u=out)), "out of balance by"),
        (lambda: asked(run(model).last), "Norton remembers, .*; give the history"),
        (lambda: asked(march(model, [0.5, 1.0], theta=0.5)), "theta = 1"),
        (lambda: asked(march(model, [0.5, 1.0], keep="last")), "keep='all'"),
        (lambda: asked(march(march(model, [0.5]), [1.0])), "start at rest"),
        (lambda: asked(history(LAWS["Norton"])).field("S.mu"), "a layer remembers"),
        (lambda: asked(state).field("S.nu"), "give S.mu|one of S.mu"),
        (lambda: asked(state, ["load TOP"]).field("load TOP"), "not act through stresses of layers alone"),
        (lambda: of(LAYERS["pressure"], ["S.mu"]).field("S.mu"), "equations of a part"),
    ]:
        refused(InputError, message, call)


# ---------------------------------------------------------------- ranks
def numbers():
    """Derivatives of a state with a pressure, and of a march."""
    state, solution = solve(structure().interface(LAYERS["pressure"])), history(LAWS["VonMises"])
    linear = solve(structure().interface(LAYERS["order 0"]))
    field = derivative(linear, GOALS["functional"], ["S.mu"]).field("S.mu")
    names = ["S.strength", "S.eps", "support LEFT/UPPER y"]
    return [
        *(value for goal in GOALS.values() for value in derivative(state, goal, ["S.mu", *DATA]).by.values()),
        *sensitivity(state, ["S.nu", "support LEFT/UPPER y"]).of(GOALS["traction"]).values(),
        *derivative(solution, GOALS["functional"], names).by.values(),
        *sensitivity(solution, names).of(GOALS["functional"]).values(),
        *sorted(map(float, field)),
    ]


@on_ranks(numbers, 2)
def test_two_ranks_give_the_same(there):
    expected = numbers()
    assert there == pytest.approx(expected, rel=1e-8, abs=3e-9 * max(map(abs, expected)))


def test_where_the_correction_of_free_ends_sets_in():
    """It exists up to nu = 0.45, where no derivative by nu exists."""
    layer = ThinLayer(LinearElastic.young(E=2.0, nu=0.45), EPS, order=1)
    free = Structure(JOINT, body=BODIES, supports={"BOTTOM": 0}, tractions={"TOP": (0.3, -1.3)})
    state = solve(free.interface(layer))
    assert "corrected" in str(state.model.remarks)
    for call in (partial(derivative, state, goals.Compliance(), ["S.nu"]), partial(sensitivity, state, ["S.nu"])):
        refused(InputError, "correction of free ends sets in", call)
    assert derivative(state, goals.Compliance(), ["S.E"]).by["S.E"] < 0
