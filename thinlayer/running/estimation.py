"""Command `estimate`: estimates the change of results if a layer is not meshed; writes tables and pictures."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from forms.base import Array, InputError
from geometry.parallel import default_comm, on_root
from geometry.seam import S
from thinlayer import plotting
from thinlayer.discretisation.layer import Layers
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.estimating.derivative import chosen_changes, derivative
from thinlayer.estimating.estimate import estimate
from thinlayer.estimating.frequencies import estimate_frequencies
from thinlayer.estimating.goals import Goal
from thinlayer.estimating.result import Estimate
from thinlayer.estimating.thickness import thin_enough
from thinlayer.output.surface import Surface
from thinlayer.running.case import DescribedCase
from thinlayer.running.description import Arguments, Description
from thinlayer.running.record import Record
from thinlayer.solving.history import History
from thinlayer.solving.modes import Modes
from thinlayer.solving.solve import solve
from thinlayer.system.folder import file_hash
from thinlayer.system.table import Row, Table
from thinlayer.system.units import percent
from thinlayer.time.marching import march

LAW, BOND = "law", "bond"  # replacements of the meshed layer
END_DISTANCE_RATIOS = (4, 8)  # distances from the ends of S, in thicknesses, for which shares of the change are printed
QUESTION_TEXTS = {
    LAW: "May you drop the layer's mesh, with its interface law instead?",
    BOND: "May you ignore the layer altogether, with its bodies bonded?",
}


def run(record: Record, description: Description, path: Path) -> None:
    """Estimate how quantities of a structure change if its layer is not meshed. Collective.

    The answer is printed in sentences. The folder gets the table estimate.csv and pictures of the change along S. With
    tolerances it also gets thin_enough.csv, with the thicknesses below which the changes are allowed; with
    sensitivities also sensitivities.csv.

    Args:
        record: record of the run, with the folder of the results.
        description: content of the input file.
        path: path of the input file, whose hash is stored with the results.

    Raises:
        InputError: an entry of the input file is wrong, or no estimate exists for the model.
        SolveError: a solve did not converge.
    """
    case = DescribedCase.from_description(description)
    hashes = {str(f): on_root(default_comm(), partial(file_hash, f)) for f in (Path(description.mesh["path"]), path)}
    record.parameters = {"files": hashes, "description": description.file_table.values}
    model, chosen = case.make_model(), description.sensitivities
    names = None if isinstance(chosen, bool) else chosen
    if chosen:
        chosen_changes(model, names, {})  # names are checked before anything is solved
    natural_modes = case.modes(model)
    solution, law_estimate = _solve_and_estimate(record, case, model)
    estimates = {LAW: law_estimate}
    if description.bonded:
        _, estimates[BOND] = _solve_and_estimate(record, case, case.structure.bonded(), layer=case.layer)
    rows = [{"instead": instead, **row} for instead, answer in estimates.items() for row in answer.table.rows]
    # NaN marks a missing number
    table = Table([{key: None if value != value else value for key, value in row.items()} for row in rows])
    record.write("estimate.csv", table)
    for instead, answer in estimates.items():
        quantity_rows = [row for row in table.rows if row["instead"] == instead]
        record.results[instead] = {"sentences": answer.sentences, "cost": answer.cost, "quantities": quantity_rows}
    if description.units:
        record.say("lengths in {}, stresses in {}".format(*description.units))
    thickness_rows = []
    for instead, answer in estimates.items():
        record.say("\n".join([QUESTION_TEXTS[instead], *(f"  {sentence}" for sentence in answer.sentences)]))
        if description.continuum:
            _bound_goals(record, instead, answer)
        thickness_rows += _find_thicknesses(record, case, instead)
    record.say(f"\n{table}\n")
    if thickness_rows:
        record.results["thin_enough"] = thickness_rows
        record.write("thin_enough.csv", Table(thickness_rows))
    if natural_modes:
        _write_modes(record, natural_modes)
    if description.sensitivities:
        _write_sensitivities(record, solution, case.goals, names)
    for instead, answer in estimates.items():
        _draw_changes(record, case, instead, answer)


def _bound_goals(record: Record, instead: str, answer: Estimate) -> None:
    """Print bounds of the goals for any mesh, or why a goal has none; `instead` is `LAW` or `BOND`."""
    results: dict[str, Mapping[str, float]] = {}
    record.results[f"{instead}, for any mesh"] = results
    for name in answer.goals:
        try:
            bounds = answer.continuum([name])[name]
        except InputError as error:
            record.say(f"  {name}: {error}")
            continue
        results[name] = {"lower": bounds.lower, "upper": bounds.upper}
        record.say(f"  {name}: {bounds.lower:.6g} to {bounds.upper:.6g}, {bounds}")


def _write_modes(record: Record, natural_modes: Modes) -> None:
    """Print frequencies, shares of energy, and estimates with the layer meshed, or why there are none; write a table."""
    table = natural_modes.table
    record.say(f"Natural modes, with shares of kinetic and strain energy:\n{table}\n")
    try:
        better = estimate_frequencies(natural_modes).table
        record.say(f"With the layer meshed, for these cells of the bodies:\n{better}\n")
        table = Table({**row, **estimated} for row, estimated in zip(table.rows, better.rows, strict=True))
    except InputError as error:
        record.say(f"{error}\n")
    record.results["modes"] = table.rows
    record.write("modes.csv", table)


def _write_sensitivities(
    record: Record, solution: State | History, goals: Sequence[Goal], names: Sequence[str] | None
) -> None:
    """Print which parameters matter most for each goal, and write their derivatives to a table."""
    table = record.new_table("sensitivities.csv")
    for goal in goals:
        result = derivative(solution, goal, names)
        record.say(f"  {result}")
        table.extend({"quantity": goal.name, **row} for row in result.table().rows)


def _solve_and_estimate(
    record: Record, case: DescribedCase, model: Model, layer: Layers | None = None
) -> tuple[State | History, Estimate]:
    solution: State | History = march(model, case.description.times) if case.description.times else solve(model)
    for step_state in solution if isinstance(solution, History) else [solution]:
        record.add_report(step_state)
    result = estimate(solution, goals=case.goals, layer=layer)
    record.add_report(result.better)
    return solution, result


def _find_thicknesses(record: Record, case: DescribedCase, instead: str) -> list[Row]:
    """Compute and print the thickness below which each quantity changes by less than its tolerance.

    Args:
        record: record of the run, through which text is printed.
        case: structure, layer and goals, with the tolerances.
        instead: model whose results are compared with those of the meshed layer: `LAW`, with an interface law, or `BOND`,
            with the bodies bonded.

    Returns:
        Rows of a table, one for each quantity and seam; the entry "eps" is the thickness, or None if no layer is thin
        enough.
    """
    goals_by_name, rows = {goal.name: goal for goal in case.goals}, list[Row]()
    seams = [*case.layer] if isinstance(case.layer, Mapping) else [S]
    description = case.description
    options: Arguments = {"times": description.times or None, "bodies": description.bodies, "bonded": instead == BOND}
    for (quantity, tolerance), seam in product(description.tolerance.items(), seams):
        if instead == BOND and quantity == "jump":
            continue  # bonded bodies have no jump
        if quantity == "traction":  # stands for the flux of a scalar field
            quantity = case.structure.kinematics.quantities.traction
        seam_entry = {"seam": seam} if len(seams) > 1 else {}
        try:
            goal = goals_by_name.get(quantity, quantity)
            limit = thin_enough(case.structure, case.layer, tolerance, goal, seam=seam, **options)
            eps, sentence = limit.eps, str(limit)
        except InputError as error:  # an answer too: no thickness is thin enough
            eps, sentence = None, str(error).removeprefix("thin_enough: ")
        rows.append({"instead": instead, **seam_entry, "quantity": quantity, "tolerance": tolerance, "eps": eps})
        record.say(f"  {f'{seam}: ' if seam_entry else ''}{sentence}")
    return rows


def _draw_changes(record: Record, case: DescribedCase, instead: str, answer: Estimate) -> None:
    """Draw how the change of each goal is distributed over S, and print the percentage that arises near the ends of S.

    A goal whose change has no known distribution is named in a message instead.

    Args:
        record: record of the run, with the folder of the pictures; text is printed through it.
        case: the input, for the unit of lengths.
        instead: model that is used without the layer's mesh: `LAW`, with an interface law, or `BOND`, with the bodies
            bonded.
        answer: changes of the goals.
    """
    file_stems = list[str]()
    for goal in answer.goals:
        try:
            density = answer.density(goal)
        except InputError as error:
            record.say(f"no picture of {goal}: {error}")
            continue
        file_stem = "_".join(["map", instead, *re.findall(r"\w+", goal)])
        while file_stem in file_stems:  # as for "a b" and "a-b"
            file_stem += "_"
        file_stems.append(file_stem)
        if shares_text := _end_shares_text(answer, goal, density):
            record.say(f"  {goal}: {shares_text}")
        path, unit = record.path(f"{file_stem}.png"), case.description.units[0] if case.description.units else ""
        goal_text = goal.replace("$", r"\$")  # a plain dollar sign, no formula
        label, surface = f"change of {goal_text}, per area of S", Surface(answer.better.model)
        if surface.joint.dim == 2:
            plotting.along(surface, {label: density}, save=path, length=unit, log=True)
        else:
            plotting.on_surface(answer.better, density, plotting.View(scale=0.0), save=path, quantity=label, log=True)


def _end_shares_text(answer: Estimate, goal: str, density: Array) -> str:
    """Return a text with the percentages of a goal's change that arise within 4 and 8 thicknesses of the ends of S.

    It is "" if S has no ends or the goal does not change.

    Args:
        answer: changes of the goals of a model.
        goal: name of the goal.
        density: change of the goal per area of S, at each node of S.
    """
    surface, goal_change, texts = Surface(answer.better.model), answer.goals[goal], []
    if goal_change.zero or goal_change.fixed or not np.isfinite(surface.distance_to_ends).any():
        return ""
    for distance in np.array(END_DISTANCE_RATIOS) * max(layer.layer.eps for layer in answer.layers.values()):
        end_change = surface.integral(surface.at_points(density) * (surface.distance_to_ends < distance))
        texts.append(f"{percent(end_change / goal_change.change)} within {distance:.3g} of the ends of S")
    return f"of its change {' and '.join(texts)}"
