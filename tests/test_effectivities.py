"""Estimates of what dropping a layer's mesh changes, against meshed layers, beside wrong estimates."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import ufl
from dolfinx import fem

from forms import LinearElastic
from geometry import faults
from studies.dropped import free_pair, ignore_range_warnings, published_cases, top_loaded
from studies.may_i_drop import SolvedCase, effectivities, solve_case
from thinlayer import Probe, RangeWarning, Surface, ThinLayer, ThinlayerError, estimate, goals, solve

COARSE = 1 / 16
KNOWN = {case.name: case for case in published_cases()}


@cache
def dropped(name):
    """A case by its name."""
    return SolvedCase.from_case(KNOWN[name], COARSE)


def _ratios(dropped: SolvedCase, state) -> tuple[float, float]:
    """Changes of traction and jump to a state over the true ones, on the inner half of S."""
    inner = (lambda x: abs(x[0] - 0.5) < 0.25) if dropped.case.name.startswith("free ends") else 1.0
    # measured as in the other program
    changes, truth = (dropped.changes(changed, inner, Surface.reaction) for changed in (state, dropped.full))
    return changes["traction"] / truth["traction"], changes["jump"] / truth["jump"]


def _with_layer(dropped: SolvedCase, **choices):
    """The state with another law of order 1 in place of the better one."""
    layer = dropped.estimate.state.model.layers["S"].thin_layer
    with warnings.catch_warnings(action="ignore", category=RangeWarning):
        return solve_case(dropped.case, dropped.estimate.state.model.with_layer(replace(layer, order=1, **choices)))


def test_between_rollers_changes_are_those_to_the_meshed_layer():
    """Those to order 1 alone are numbers of exact layers and laws, by transfer matrices.

    Leading terms of the compliance cancel: 1.26 of order 1 alone.
    """
    dropped_case = dropped("between rollers: nu = 0.3")
    row, (compliance, _) = effectivities(dropped_case)
    traction, jump = _ratios(dropped_case, _with_layer(dropped_case))
    assert (traction, jump) == (pytest.approx(0.993799, abs=2e-4), pytest.approx(1.007739, abs=2e-4))
    assert (row["traction"], row["jump"], compliance["effectivity"]) == pytest.approx((1, 1, 1), abs=0.01)


def test_free_ends_are_in_the_estimate_and_without_them_it_is_too_low():
    dropped_case = dropped("free ends: nu = 0.3")
    row, _ = effectivities(dropped_case)
    assert (row["traction"], row["jump"]) == pytest.approx((1, 1), abs=0.01)
    traction, jump = _ratios(dropped_case, _with_layer(dropped_case))
    assert (traction, jump) == (pytest.approx(0.965, abs=0.02), pytest.approx(0.987, abs=0.02))  # of another program
    traction, jump = _ratios(dropped_case, _with_layer(dropped_case, edges="plain"))
    assert (traction, jump) == (pytest.approx(0.83, abs=0.02), pytest.approx(0.95, abs=0.02))


def test_goals_change_as_to_the_meshed_layer():
    _, rows = effectivities(dropped("free ends: nu = 0.3"))
    assert {row["goal"] for row in rows} == {goal.name for goal in KNOWN["free ends: nu = 0.3"].qois}
    for row in rows:
        assert row["effectivity"] == pytest.approx(1, abs=0.005), row["goal"]
        assert row["told"]


def test_a_rubbery_layer_needs_its_pressure():
    """Without it the law of order 1 does not know the flow along S: its jump is 14 % off."""
    dropped_case = dropped("between rollers: nu = 0.499")
    row, _ = effectivities(dropped_case)
    assert (row["traction"], row["jump"]) == pytest.approx((1, 1), abs=0.02)
    traction, jump = _ratios(dropped_case, _with_layer(dropped_case))
    assert max(abs(traction - 1), abs(jump - 1)) > 0.1


def test_displacements_of_meshed_bodies_are_those_of_the_same_point():
    """Full models have their bodies apart: a place of the interface model is another one there."""
    case = replace(KNOWN["free ends: nu = 0.3"], qois=(goals.Displacement((0.3, 0.4), (0.0, 1.0)),))
    dropped = SolvedCase.from_case(case, COARSE)
    (goal,) = case.qois
    shifted = goals.Displacement((0.3, 0.4 + COARSE / 2), (0.0, 1.0))
    # the same point, by its own place
    there = shifted.value(replace(dropped.full, model=dropped.full.model), dropped.full.model)
    assert goal.value(dropped.full, dropped.estimate.better.model) == pytest.approx(there, rel=1e-9)


def test_where_there_is_no_number_a_sentence_says_why():
    fault = top_loaded(faults(1.0, 1.0, {"CUT": ((-0.1, 0.5), (0.6, 0.5))}, 1 / 8), (0.3, -1.0))
    layer, elastic = partial(ThinLayer, eps=COARSE, at=1.0), LinearElastic.shear(30.0, 0.3)
    for structure, law, words in [
        (fault, layer(elastic), "tip"),
        (free_pair(COARSE), layer(elastic, profile=lambda x: 1 + 0.3 * x[0]), "extended"),
    ]:
        with ignore_range_warnings():
            try:
                said = str(estimate(solve(structure.interface(law))))
            except ThinlayerError as error:
                said = str(error)
        assert words in said


def test_the_compliance_changes_where_the_density_says():
    """The density is the work per area of S that makes the change, as the meshed layer tells it.

    Let t, u be of order 0, and v the layer's equilibrium between faces moved by u. The change is int_S t . [u_meshed] - int
    stress_meshed : strain(v), for v and any other such displacements; the estimate knows neither stress nor jump.
    """
    solved = dropped("free ends: nu = 0.3")
    result, full, problem = solved.estimate, solved.full, solved.estimate._subproblem
    surface, V = Surface(result.better.model), full.model.V
    Q = fem.functionspace(full.model.domain.mesh, ("Lagrange", 1))
    v, q, x = fem.Function(V), ufl.TestFunction(Q), V.tabulate_dof_coordinates()[:, :2]
    nodes = np.flatnonzero(np.abs(x[:, 1]) <= COARSE / 2 * (1 + 1e-9))
    faces = problem.to_layers(result.state.u.x.array)
    probe = Probe(problem.state(problem.dirichlet_displacements(faces, problem.load, problem.side_u)))
    v.x.array.reshape(-1, 2)[nodes] = probe.displacement(x[nodes])
    (term,) = full.layers
    work = ufl.inner(full.stress(term), term.strain(v)) * term.weight * q * term.measure
    places, on_S = surface.profile((surface.traction(result.state) * surface.jump(full)).sum(axis=0))
    near = np.abs(Q.tabulate_dof_coordinates()[:, 0] - places[:, :1]) < 1e-9
    true_density = on_S - near @ fem.assemble_vector(fem.form(work)).array / surface.areas
    error = np.abs(result.density() - true_density)  # largest at the singular corners, where both meshes differ
    assert error.max() < 0.05 * np.abs(true_density).max()
    assert np.sort(error)[len(error) // 2] < 0.005 * np.abs(true_density).max()
