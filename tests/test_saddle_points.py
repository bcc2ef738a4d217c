"""Layers with a pressure on S, solved iteratively: against factorising, for all Poisson's ratios."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl

from forms import Incompressible, LinearElastic, Rubber
from forms.base import InputError
from geometry import block, sandwich
from tests.on_ranks import on_ranks
from tests.refused import refused
from thinlayer import SolveError, Structure, Surface, ThinLayer, solve
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.solving import linear_solvers

BLOCKS, FACTORS = {"pc_type": "fieldsplit"}, {"pc_type": "cholesky"}
MU, EPS = 1.3, 0.6  # MPa, mm: of the rubber
LOWER, UPPER = LinearElastic.young(2.1e5, 0.3), LinearElastic.young(40.0, 0.2)  # steel, and a body as soft as 30 mu


def bearing(nu: float, *, upper: LinearElastic = UPPER, displaced: bool = False) -> Model:
    """Two bodies, 5.2 mm x 3.7 mm, with a rubber layer; its right and front ends are free, the others symmetric.

    Args:
        nu: Poisson's ratio of the rubber; 0: an elastic layer of ratio 0.3.
        upper: the law of the upper body.
        displaced: whether the upper body is moved by its upper side; else a load there presses and turns it.
    """
    joint = sandwich(5.2, 1.1, 0.8, 1.1, depth=3.7, cell="hexahedron", structured=True)
    sides: dict[str, Any] = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "BACK": {"z": 0.0}}
    if displaced:
        setup: dict[str, Any] = {"supports": {**sides, "TOP": {"x": 0.0, "y": -0.02, "z": 0.0}}}
    else:
        setup = {"supports": sides, "tractions": {"TOP": lambda x, t: (0.02, -0.1 - 0.05 * x[0], 0.03 * x[2])}}
    return Structure(joint, body={"LOWER": LOWER, "UPPER": upper}, **setup).interface(layer(nu))


def layer(nu: float) -> ThinLayer:
    law = LinearElastic.shear(MU, 0.3) if nu == 0 else Incompressible(MU) if nu == 0.5 else Rubber.shear(MU, nu)
    return ThinLayer(law, EPS, order=1)


def measured(state: State) -> dict[str, float]:
    surface = Surface(state.model)
    return {
        "u": state.integral(ufl.inner(state.u, state.u) * ufl.dx),
        "traction": surface.norm(surface.traction(state)),
        "jump": surface.norm(surface.jump(state)),
        "energy": state.energies()["layer"],
        "reaction": float(np.linalg.norm(state.reaction("BOTTOM").force)),
    }


def numbers(options: dict[str, str] = BLOCKS) -> dict[str, float]:
    values = {}
    for nu in (0.4, 0.5):
        values |= {f"{name}, nu = {nu}": value for name, value in measured(solve(bearing(nu), options=options)).items()}
    return values


# ends that cells do not resolve
pytestmark = [pytest.mark.filterwarnings("ignore::thinlayer.RangeWarning"), pytest.mark.few(5)]
NUS = (0.3, 0.45, 0.49, 0.499, 0.4999, 0.5)
SOLVED = 1e-8  # residuals are 1e-10 of the forces, and soft layers move far under small ones


def distance(state, other) -> float:
    """Largest relative difference of displacements and pressures."""
    pairs = [(state.u, other.u), *((state.fields[key], other.fields[key]) for key in other.fields)]
    return max(float(np.abs(f.x.array - g.x.array).max() / np.abs(g.x.array).max()) for f, g in pairs)


def soft(law, order: int = 1) -> ThinLayer:
    return ThinLayer(law, 0.1, order=order)


PLATES = sandwich(3.0, 1.0, 1.2, 0.5)
PRESSED = {"tractions": {"TOP": lambda x, t: (0.2 * t + 0.1, -1.0 - x[0] * t)}}


@pytest.mark.few(5)
@pytest.mark.parametrize(("displaced", "upper"), [(True, LOWER), (False, LOWER), (False, UPPER)])
def test_all_ratios_take_the_same_iterations(displaced, upper):
    """They find what a factorisation finds, and need hardly more iterations than multigrid with an elastic layer."""
    elastic = bearing(0, displaced=displaced, upper=upper)
    usual, counts = solve(elastic, options={"pc_type": "gamg"}).report.iterations, []
    for nu in NUS:
        model = elastic.with_layer(layer(nu))
        state = solve(model, options=BLOCKS)
        assert distance(state, solve(model, options=FACTORS)) < SOLVED, nu
        assert state.report.residual < 1e-9
        counts.append(state.report.iterations)
    assert max(counts) <= 2 * min(counts)
    assert 10 < max(counts) < 1.5 * usual


@pytest.mark.long
@on_ranks(numbers, 2)
def test_on_two_ranks(there):
    assert there == pytest.approx(numbers(FACTORS), rel=SOLVED)


def test_large_models_are_solved_iteratively(monkeypatch):
    """And by factorising where that fails, or where unknowns are others than displacements and pressures on S."""
    model = bearing(0.45)
    assert solve(model).report.iterations == 1
    monkeypatch.setitem(linear_solvers.MIN_MULTIGRID_UNKNOWNS, 3, 100)
    iterative = solve(model)
    assert 10 < iterative.report.iterations < 100
    monkeypatch.setitem(linear_solvers.FIELD_SPLIT_OPTIONS, "ksp_max_it", 2)
    factored = solve(model)
    assert factored.report.iterations == 1
    assert measured(iterative) == pytest.approx(measured(factored), rel=SOLVED)
    refused(SolveError, "DIVERGED", solve, model, options=BLOCKS)
    assert solve(model.structure.full(layer(0.45))).report.iterations == 1


def test_refused():
    joint = sandwich(3.0, 1.0, 1.2, 0.5)
    structure = Structure(joint, body=LOWER, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.0, -1.0)})
    model = structure.interface(layer(0.499))
    with pytest.raises(InputError, match="gamg cannot solve for the pressures of a layer, too; use pc_type fieldsplit"):
        solve(model, options={"pc_type": "gamg", "ksp_type": "cg"})
    with pytest.raises(InputError, match="displacements and pressures on S, not for 'pressure'"):
        solve(structure.full(layer(0.499)), options=BLOCKS)


OTHERS = [
    (PLATES, {"BOTTOM": 0.0}, soft(Rubber.shear(1.2, 0.499), order=0)),
    (PLATES, {"BOTTOM": 0.0}, soft(Incompressible(1.2), order=0)),
    (block(3.0, 1.0, 0.5), {"LEFT": {"x": 0.0}}, soft(Rubber.shear(1.2, 0.499))),
    (PLATES.rotated(0.3), {"BOTTOM": {"n": 0.0}, "LEFT": {"n": 0.0}}, soft(Incompressible(1.2))),
]


@pytest.mark.parametrize(("joint", "supports", "thin_layer"), OTHERS)
def test_other_pressures_on_S(joint, supports, thin_layer):
    model = Structure(joint, body=LOWER, supports=supports, **PRESSED).interface(thin_layer)
    assert distance(solve(model, 0.7, options=BLOCKS), solve(model, 0.7, options=FACTORS)) < SOLVED


def test_options_of_the_blocks():
    """Blocks have PETSc options of their own: with an exact solver of the displacements few iterations are left."""
    model = Structure(PLATES, body=LOWER, supports={"BOTTOM": 0.0}, **PRESSED).interface(soft(Rubber.shear(1.2, 0.499)))
    exact = solve(model, options={**BLOCKS, "fieldsplit_u_pc_type": "cholesky"})
    assert exact.report.iterations < 15
    diagonal = {"ksp_type": "minres", "ksp_pc_side": "left", "pc_fieldsplit_schur_fact_type": "diag"}
    assert distance(solve(model, options={**BLOCKS, **diagonal}), exact) < SOLVED
