"""The command `estimate`: solves, tells what dropping the layer costs, and keeps tables and pictures."""

from __future__ import annotations

from geometry.parallel import on_root, world
from thinlayer.describing.case import Case
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.estimating.estimate import Estimate, estimate
from thinlayer.files.table import Table, hash_of
from thinlayer.output import plotting
from thinlayer.running.asked import Asked
from thinlayer.running.record import Record
from thinlayer.solving.solvers import solve
from thinlayer.time.history import History
from thinlayer.time.marching import march

QUESTIONS = {
    "law": "May you drop the layer's mesh, for an interface law?",
    "bond": "May you ignore the layer altogether, for a perfect bond?",
}


def run(record: Record, asked: Asked) -> None:
    """Answer what was asked: estimate.csv, pictures of where on S the change comes from, sentences. Collective.

    Raises:
        InputError, SolveError: as the description, the models and the solves raise them.
    """
    record.parameters = {
        "files": {str(path): on_root(world(), lambda path=path: hash_of(path)) for path in asked.files},  # type: ignore[misc]
        "description": asked.description.section.values if asked.description else None,
    }
    case = asked.case()
    found = {"law": _of_law(record, case)}
    if case.bonded:
        found["bond"] = _of_bond(record, case)
    rows = [{"instead": name, **row} for name, one in found.items() for row in one.table.rows]
    record.write("estimate.csv", table := Table(rows))
    for name, one in found.items():
        _draw(record, case, name, one)
        record.say("\n".join([QUESTIONS[name], *(f"  {sentence}" for sentence in one.sentences)]))
    record.say(f"\n{table}\n")
    record.results = {
        name: {"sentences": one.sentences, "laws": one.laws, "cost": one.cost} for name, one in found.items()
    }
    if case.tolerance:
        _tell_thickness(record, case)


def _of_law(record: Record, case: Case) -> Estimate:
    state = _solved(record, case, case.structure.interface(case.layer, bodies=case.bodies))
    return _noted(record, estimate(state, goals=case.goals))


def _of_bond(record: Record, case: Case) -> Estimate:
    state = _solved(record, case, case.structure.bonded())
    return _noted(record, estimate(state, layer=case.layer, goals=case.goals))


def _solved(record: Record, case: Case, model: Model) -> State | History:
    if not case.times:
        return record.solved(solve(model))
    history = march(model, case.times)
    for state in history:
        record.solved(state)
    return history


def _noted(record: Record, found: Estimate) -> Estimate:
    record.solved(found.better)
    return found


def _draw(record: Record, case: Case, name: str, found: Estimate) -> None:
    """A map for each goal."""
    if not hasattr(plotting, "estimate"):
        return
    for goal in found.goals:
        file = f"map_{name}_{'_'.join(goal.split())}.png".replace("/", "_")
        plotting.estimate(found, save=record.path(file), goal=goal)


def _tell_thickness(record: Record, case: Case) -> None:
    """The thickness below which each quantity changes by less than its tolerance."""
    goals = {goal.name: goal for goal in case.goals}
    unit = f" {case.units[0]}" if case.units else ""
    rows = []
    for name, tolerance in case.tolerance.items():
        from thinlayer import thin_enough

        thin = thin_enough(case.structure, case.layer, tolerance, goals.get(name, name))
        rows.append({"quantity": name, "tolerance": tolerance, "eps": thin.eps})
        record.say(f"thinner than {thin.eps:.3g}{unit} the layer changes {name} by less than {tolerance:.3g}")
    record.write("thin_enough.csv", Table(rows))
