"""Derivatives by parameters: Taylor's remainders, marches with memory, sensitivities, fields, what is refused, ranks."""

from __future__ import annotations

import runpy
from dataclasses import replace
from functools import cache, partial, reduce
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
from tests import mixtures
from tests.capabilities import slopes
from tests.mixtures import Mixture
from tests.on_ranks import on_ranks
from tests.own_laws import Skew, Slipping, StandardSolid, layer_of
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, derivative, goals, march, sensitivity, solve
from thinlayer.estimating.derivative import chosen_changes
from thinlayer.estimating.parameters import Parameters
from thinlayer.parts.compiled_part import CompiledPart
from thinlayer.solving.adjoint import Adjoint
from thinlayer.solving.history import state_at

pytestmark = pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")

BODIES = {"LOWER": LinearElastic.young(E=70.0, nu=0.2), "UPPER": LinearElastic.young(E=110.0, nu=0.31)}
GLUE, EPS, JOINT = LinearElastic.young(E=2.0, nu=0.4), 0.2, sandwich(2.0, 0.5, 0.7, 0.5)
GLUED, YIELDING = Stack((0.3, GLUE), (0.7, LinearElastic(3.0, 2.0))), VonMises(6.0, 4.0, 0.1, hardening=2.0)
FRICTION, SOIL = MohrCoulomb(6.0, 4.0, 0.3, 30.0), MohrCoulomb(6.0, 4.0, 0.3, 30.0, hardening=1.5)
SLIPPING = Slipping(11.0, 7.0, 0.5, 3.0)
OWN_KERNEL = str(Path(__file__).parent / "own_scripts/own_kernel.py")
TIMES = [0.3, 0.6, 0.8, 1.0]


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


LAYERS = {
    "order 0": (ThinLayer(GLUE, EPS, eigenstrain=0.01), "functional", "S.nu S.eps LOWER.nu"),
    "order 1": (ThinLayer(GLUE, EPS, order=1, eigenstrain=0.01), "compliance", "S.E S.nu S.eps"),
    "pressure": (ThinLayer(Rubber(20.0, 5.0), EPS, order=1), "traction", "S.mu S.lmbda S.eps UPPER.E"),
    "no volume": (ThinLayer(Incompressible(5.0), EPS, order=1), "reaction", "S.mu S.eps UPPER.lmbda"),
    "stack": (ThinLayer(GLUED, EPS), "displacement", "S/1.nu S/2.mu S.eps"),
    "friction": (ThinLayer(FRICTION, EPS), "functional", "S.mu S.cohesion S.friction_angle"),
    "yielding": (ThinLayer(YIELDING, EPS, order=1), "reaction", "S.strength S.hardening LOWER.E"),
    "jumps": (SLIPPING, "compliance", "S.k_N S.k_T S.closed"),
    "skew": (ThinLayer(Skew(6.0, 2.0), EPS), "displacement", "S.mu S.c S.eps"),
    "kernel": (None, "traction", "S.kappa S.mu S.limit S.eps"),
}
MARCHES = {
    "VonMises": (VonMises(6.0, 4.0, 0.3, hardening=2.0), "functional", "S.mu S.strength S.hardening S.eps"),
    "Norton": (Norton(6.0, 4.0, 3.0, 1.7), "reaction", "S.mu S.eta S.p S.eps"),
    "Maxwell": (Maxwell(6.0, 4.0, 0.5, 0.8), "traction", "S.mu S.t1 S.t2 S.eps"),
    "KelvinVoigt": (KelvinVoigt(6.0, 4.0, 0.5, 0.8), "displacement", "S.mu S.theta_lmbda S.theta_mu S.eps"),
    "NortonCreep": (NortonCreep(6.0, 4.0, 0.3, 3.0), "compliance", "S.mu S.A S.n S.eps"),
    "MohrCoulomb": (SOIL, "functional", "S.mu S.cohesion S.friction_angle S.hardening"),
    "StandardSolid": (StandardSolid(6.0, 4.0, 3.0, 0.5), "traction", "S.mu_1 S.t_1 S.eps"),
    "Slipping": (SLIPPING, "displacement", "S.k_N S.k_T S.viscosity S.closed"),
}
DATA = ["eigenstrain UPPER", "load TOP", "body force", "support LEFT/UPPER y"]
run = partial(march, times=TIMES)


def marched(law, **data):
    """Steps with unloading, and a support that moves."""
    way = lambda t: ufl.conditional(ufl.lt(t, 0.6), t, 1.2 - t)
    supports = {"RIGHT/LOWER": 0, "LEFT/UPPER": {"y": lambda x, t: 0.003 * t}}
    tractions = {"TOP": lambda x, t: (0.9 * way(t), -0.3 * t)}
    data = {"supports": supports, "tractions": tractions, "body_force": None, "eigenstrain": None} | data
    return structure(**data).interface(law if isinstance(law, Slipping) else ThinLayer(law, EPS))


@cache
def solution_of(kind):
    if kind in MARCHES:
        return run(marched(MARCHES[kind][0]))
    # the kernel is the law in C of a page, with the source in the working directory
    layer = LAYERS[kind][0] or ThinLayer(runpy.run_path(OWN_KERNEL)["Mises"](kappa=8.0, mu=4.0, limit=1.3), EPS)
    return solve(structure().interface(layer))


@pytest.mark.few(5)
@pytest.mark.parametrize("kind", [*LAYERS, *MARCHES])
def test_the_remainder_is_quadratic(kind, tmp_path, monkeypatch):
    """All parameters are changed at once, by weights of their own, so that errors of two do not cancel.

    Derivatives are those of the linearised states, too.
    """
    monkeypatch.chdir(tmp_path)
    of_march, (_, goal_name, words) = kind in MARCHES, (LAYERS | MARCHES)[kind]
    names = words.split() + (["LOWER.E", DATA[-1]] if of_march else DATA[len(kind) % 2 :: 2])
    names += ["eigenstrain S"] * kind.startswith("order")
    solution, weights = solution_of(kind), {name: np.cos(1.0 + 3.7 * k) for k, name in enumerate(names)}
    goal, model, remainders = GOALS[goal_name], solution.model, []
    result, linearised = derivative(solution, goal, names), sensitivity(solution, names).of(goal)
    assert min(map(abs, result.by.values())) > 0
    # steps in time add errors of powers of stresses that pass through zero
    assert linearised == pytest.approx(result.by, rel=3e-6, abs=(1e-6 if of_march else 1e-8) * abs(result.value))
    for h in (1e-2, 1e-3):
        changed = reduce(lambda model, name: Parameters(model)[name](model, 1 + h * weights[name]), names, model)
        value = goal.value_in(state_at((run if of_march else solve)(changed), None))
        remainders.append(abs(value - result.value - h * sum(weights[name] * result.by[name] for name in names)))
    is_rounding = remainders[1] < 1e-10 * (abs(result.value) + sum(map(abs, result.by.values())))
    assert is_rounding or np.log10(remainders[0] / remainders[1]) > 1.9


def test_all_parameters_are_those_of_layers_bodies_loads_and_supports():
    of = lambda *names, **words: derivative(solution_of("order 0"), GOALS["compliance"], *names, **words).by
    by = of()
    laws = {f"{place}.{name}" for place in ("S", *BODIES) for name in ("E", "nu")}  # not the same again by lmbda, mu
    assert by.keys() == laws | {"S.eps", "eigenstrain S", *DATA}
    assert by["S.E"] == pytest.approx(sum(of(["S.lmbda", "S.mu"]).values()), rel=1e-7)
    stiffer = {"E": lambda f: ThinLayer(LinearElastic.young(E=2.0 * f, nu=0.4), EPS, eigenstrain=0.01)}
    assert of(of=stiffer) == pytest.approx({"E": by["S.E"]}, rel=1e-8)


TWINS = {  # a tangent that is not transposed; steps that pass neither memory, nor strains, to the step before
    "friction": ("mu", Adjoint, "_solve", lambda exact: lambda *words, transposed: exact(*words, transposed=False)),
    "VonMises": ("strength", CompiledPart, "pullback", lambda exact: lambda *of: (exact(*of)[0], 0 * exact(*of)[1])),
    "Norton": ("eta", CompiledPart, "pullback", lambda exact: lambda *of: (0 * exact(*of)[0], exact(*of)[1])),
}


@pytest.mark.parametrize("kind", TWINS)
def test_the_test_sees_what_is_left_out(kind, monkeypatch):
    name, owner, method, twin = TWINS[kind]
    by = lambda: derivative(solution_of(kind), GOALS["functional"], [f"S.{name}"]).by
    exact = by()
    monkeypatch.setattr(owner, method, twin(getattr(owner, method)))
    assert by() != pytest.approx(exact, rel=1e-2)


def test_a_column_as_in_closed_form():
    """Its compliance is t^2 (eps/M + heights over moduli), t the load, M = lmbda + 2 mu."""
    rollers = {"BOTTOM": 0, "LEFT": {"x": 0}, "RIGHT": {"x": 0}}
    column = Structure(JOINT, body=BODIES, supports=rollers, tractions={"TOP": (0, -1.3)})
    names = ["S.eps", "S.lmbda", "load TOP", "LOWER.E", "UPPER.E"]
    result = derivative(solve(column.interface(ThinLayer(GLUE, EPS))), goals.Compliance(), names)
    M, work = {name: law.lmbda + 2 * law.mu for name, law in (BODIES | {"S": GLUE}).items()}, 2.0 * 1.3**2
    expected = {"S.eps": work * EPS / M["S"], "S.lmbda": -work * EPS * GLUE.lmbda / M["S"] ** 2}
    expected |= {"load TOP": 2 * result.value, "LOWER.E": -work * 0.5 / M["LOWER"], "UPPER.E": -work * 0.7 / M["UPPER"]}
    assert result.by == pytest.approx(expected, abs=4e-8 * result.value)
    assert "% (S.eps)" in str(result)
    assert result.table()["relative"][0] == pytest.approx(next(iter(result.by.values())) / result.value)


# ---------------------------------------------------------------- marches
def test_a_history_without_memory_is_its_last_state():
    solution, functional = march(marched(GLUE), [0.125, 0.5]), GOALS["functional"]
    of = lambda solution: derivative(solution, functional, ["S.mu", "LOWER.E"]).by
    assert of(solution) == pytest.approx(of(solution.last), rel=1e-12)
    change = sensitivity(solution, ["S.mu", "LOWER.E"])
    assert change.of(functional, t=0.125) == pytest.approx(of(solution.at(0.125)), rel=1e-7)
    assert np.abs(change.displacement("S.mu", 0.5).x.array).max() > 0


def refused_both_ways(words, solution, name):
    for call in (partial(derivative, solution, GOALS["compliance"]), partial(sensitivity, solution)):
        refused(InputError, words, call, [name])


def test_where_a_law_yields_and_loads_stay():
    """Slopes on both sides of the kink differ: derivatives would be 30 times too large."""
    stay = lambda x, t: (1.2 * ufl.min_value(t, 0.5), -0.3 * ufl.min_value(t, 0.5))
    model = marched(MARCHES["VonMises"][0], supports={"BOTTOM": 0}, tractions={"TOP": stay})
    words = r"has a kink in the step to t = 0.\d+, as where it yields and loads stay"
    refused_both_ways(words, march(model, TIMES[:3]), "S.mu")


# ---------------------------------------------------------------- fields
@pytest.mark.parametrize("name", ["mu", "strength"])
def test_a_field_is_the_derivative_by_a_parameter_that_varies(name):
    goal, variation = GOALS["functional"], lambda x: 0.4 + 0.7 * x
    state = solve(structure().interface(ThinLayer(YIELDING, EPS)))
    result, surface, remainders = derivative(state, goal, [f"S.{name}"]), Surface(state.model), []
    density = result.field(f"S.{name}")
    assert surface.integral(density) == pytest.approx(result.by[f"S.{name}"], rel=1e-9)
    slope = surface.integral(density * variation(JOINT.points[surface.vertices, 0]))
    for s in (1e-2, 1e-3):
        law = replace(YIELDING, **{name: lambda x, s=s: getattr(YIELDING, name) * (1 + s * variation(x[0]))})
        changed = solve(structure().interface(ThinLayer(law, EPS)))
        remainders.append(abs(goal.value_in(changed) - result.value - s * slope))
    assert np.log10(remainders[0] / remainders[1]) > 1.8


# ---------------------------------------------------------------- structures at random
NONE = {17: "depends on the mean strain that the mean stress causes", 38: "contact has kinks"}


@pytest.mark.few(10)
@pytest.mark.parametrize("seed", [14, 0, 3, 4, 8, 9, 30, 15, 17, 18, 20, 26, 27, 12, 32, 34, 36, 38, 39, 50])
def test_structures_at_random(seed):
    """Derivatives of an energy and a traction, by parameters at random, are differences of whole marches."""
    mixture, follow = Mixture(seed), partial(march, times=mixtures.TIMES)
    model = mixture.structure.interface(mixture.layers, bodies=mixture.bodies)
    asked = [goals.Compliance(), goals.MeanTraction((0.6, -0.8, 0.3)[: model.joint.dim])]
    changes, solution = chosen_changes(model, None, {}), follow(model)
    names = [str(name) for name in np.random.default_rng(seed).choice([*changes], 2, replace=False)]
    if seed in NONE:
        refused(InputError, NONE[seed], derivative, solution, asked[0], names)
        return
    results = [derivative(solution, goal, names) for goal in asked]
    for name in names:
        for result, slope in zip(results, slopes(changes[name], model, follow, asked), strict=True):
            assert result.by[name] == pytest.approx(slope, rel=1e-6, abs=1e-6 * abs(result.value)), name


# ---------------------------------------------------------------- refused
@pytest.mark.filterwarnings("ignore:invalid value")  # no seam is left for the mean traction
def test_what_has_no_derivative():
    state, clamped = solution_of("order 0"), structure(supports={"BOTTOM": 0}, eigenstrain=None)
    phases = layer_of(NonMonotoneUnrelaxed(3.0, 2.0, 0.5, 0.08, [[0.2, 0.5], [0.5, 1.0]]), EPS)
    creeping = marched(MARCHES["Norton"][0])
    asked = lambda solution, names=("S.mu",), goal=GOALS["compliance"]: lambda: derivative(solution, goal, names)
    of = lambda layer, *names: asked(solve(clamped.interface(layer)), *names)()
    field = lambda solution, name: asked(solution, [name])().field(name)
    out = state.u.copy()
    out.x.array[:] *= 1.01
    wide = clamped.interface(ThinLayer(GLUE, EPS), bodies="extended")
    for call, message in [
        (asked(3), "the solution is 3"),
        (asked(state, goal=3), "the goal is 3"),
        (asked(state, "S.mu"), "parameters is 'S.mu'"),
        (asked(state, ["S.my"]), "did you mean 'S.mu'.*known: LOWER.E, .*S.nu.*support LEFT/UPPER y"),
        (asked(state, goal=goals.Reaction("BOTTOM", (0, 1))), "nothing holds 'BOTTOM'"),
        (asked(replace(state, u=out)), "out of balance by"),
        (lambda: asked(solve(clamped.full(ThinLayer(GLUE, EPS))))(), "a full model"),
        (lambda: of(HolonomicCoulomb(200.0, 80.0, 0.5)), "contact has kinks"),
        (lambda: of(phases), "phases of NonMonotoneUnrelaxed switch"),
        (lambda: of(ThinLayer(GLUE, EPS, at=1.0), ["S.eps"]), "moduli follow eps"),
        (asked(solution_of("friction"), ["S.dilatancy_angle"]), "it is 0"),
        (asked(solution_of("Norton").last), "Norton remembers, .*; give the history"),
        (lambda: asked(march(creeping, [0.5, 1.0], theta=0.5))(), "theta = 1"),
        (lambda: asked(march(creeping, [0.5, 1.0], keep="last"))(), "keep='all'"),
        (lambda: asked(march(march(creeping, [0.5]), [1.0]))(), "start at rest"),
        (lambda: field(solution_of("Norton"), "S.mu"), "a layer remembers"),
        (lambda: asked(state)().field("S.nu"), "give S.mu|one of S.mu"),
        (lambda: field(state, "load TOP"), "not act through stresses of layers alone"),
        (lambda: field(solution_of("pressure"), "S.mu"), "equations of a part"),
        (lambda: asked(solve(wide), ["S.eps"])(), "bodies made room"),
        (
            lambda: asked(solve(clamped.bonded()), ["load TOP"], GOALS["traction"])(),
            "mean traction.*S must have a layer",
        ),
    ]:
        refused(InputError, message, call)


# ---------------------------------------------------------------- ranks
def numbers():
    """Derivatives of a state with a pressure, and of a march."""
    state, solution = solution_of("pressure"), march(marched(MARCHES["VonMises"][0]), TIMES[:2])
    names, functional = ["S.strength", "S.eps", "support LEFT/UPPER y"], GOALS["functional"]
    results = [derivative(state, goal, ["S.mu"]).by for goal in GOALS.values()]
    results += [sensitivity(state, ["S.nu", names[-1]]).of(GOALS["traction"])]
    results += [derivative(solution, functional, names).by, sensitivity(solution, names).of(functional)]
    field = derivative(solution_of("order 0"), functional, ["S.mu"]).field("S.mu")
    return [*(value for by in results for value in by.values()), *sorted(map(float, field))]


@on_ranks(numbers, 2)
def test_two_ranks_give_the_same(there):
    expected = numbers()
    assert there == pytest.approx(expected, rel=1e-8, abs=3e-9 * max(map(abs, expected)))


def test_where_the_correction_of_free_ends_sets_in():
    """It exists up to nu = 0.45, where no derivative by nu exists."""
    free = Structure(JOINT, body=BODIES, supports={"BOTTOM": 0}, tractions={"TOP": (0.3, -1.3)})
    state = solve(free.interface(ThinLayer(LinearElastic.young(E=2.0, nu=0.45), EPS, order=1)))
    assert "corrected" in str(state.model.remarks)
    refused_both_ways("correction of free ends sets in", state, "S.nu")
    assert derivative(state, goals.Compliance(), ["S.E"]).by["S.E"] < 0
