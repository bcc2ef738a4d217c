"""Command `estimate`: estimates the change of results if a layer is not meshed; writes tables and pictures."""

from __future__ import annotations

import re
from collections.abc import Mapping
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
from thinlayer.estimating.estimate import estimate
from thinlayer.estimating.result import Estimate
from thinlayer.estimating.thickness import thin_enough
from thinlayer.output.surface import Surface
from thinlayer.running.case import DescribedCase
from thinlayer.running.description import Arguments, Description
from thinlayer.running.record import Record
from thinlayer.solving.history import History
from thinlayer.solving.solve import solve
from thinlayer.system.folder import hash_of
from thinlayer.system.table import Row, Table
from thinlayer.time.marching import march

LAW, BOND = "law", "bond"  # replacements of the meshed layer
END_DISTANCES = (4, 8)  # distances from the ends of S, in thicknesses, for which shares of the change are printed
QUESTION_TEXTS = {
    LAW: "May you drop the layer's mesh, with its interface law instead?",
    BOND: "May you ignore the layer altogether, with its bodies bonded?",
}


def run(record: Record, description: Description, file: Path) -> None:
    """Estimate how quantities of a structure change if its layer is not meshed. Collective.

    The answer is printed in sentences. The folder gets the table estimate.csv and pictures of the change along S. With
    tolerances it also gets thin_enough.csv, with the thicknesses below which the changes are allowed.

    Args:
        record: record of the run, with the folder of the results.
        description: content of the input file.
        file: path of the input file, whose hash is stored with the results.

    Raises:
        InputError: an entry of the input file is wrong, or no estimate exists for the model.
        SolveError: a solve did not converge.
    """
    case = DescribedCase.of(description)
    files = {str(f): on_root(default_comm(), partial(hash_of, f)) for f in (Path(description.mesh["path"]), file)}
    record.parameters = {"files": files, "description": description.section.values}
    estimates = {LAW: _estimate(record, case, case.model())}
    if description.bonded:
        estimates[BOND] = _estimate(record, case, case.structure.bonded(), layer=case.layer)
    rows = [{"instead": name, **row} for name, answer in estimates.items() for row in answer.table.rows]
    # NaN marks a missing number
    table = Table([{key: None if value != value else value for key, value in row.items()} for row in rows])
    record.write("estimate.csv", table)
    for name, answer in estimates.items():
        quantities = [row for row in table.rows if row["instead"] == name]
        record.results[name] = {"sentences": answer.sentences, "cost": answer.cost, "quantities": quantities}
    if description.units:
        record.say("lengths in {}, stresses in {}".format(*description.units))
    thicknesses = []
    for name, answer in estimates.items():
        record.say("\n".join([QUESTION_TEXTS[name], *(f"  {sentence}" for sentence in answer.sentences)]))
        thicknesses += _thicknesses(record, case, name)
    record.say(f"\n{table}\n")
    if thicknesses:
        record.results["thin_enough"] = thicknesses
        record.write("thin_enough.csv", Table(thicknesses))
    for name, answer in estimates.items():
        _draw(record, case, name, answer)


def _estimate(record: Record, case: DescribedCase, model: Model, layer: Layers | None = None) -> Estimate:
    state: State | History = march(model, case.description.times) if case.description.times else solve(model)
    for step in state if isinstance(state, History) else [state]:
        record.solved(step)
    result = estimate(state, goals=case.goals, layer=layer)
    record.solved(result.better)
    return result


def _thicknesses(record: Record, case: DescribedCase, name: str) -> list[Row]:
    """Compute and print the thickness below which each quantity changes by less than its tolerance.

    Args:
        record: record of the run, through which text is printed.
        case: structure, layer and goals, with the tolerances.
        name: model whose results are compared with those of the meshed layer: `LAW`, with an interface law, or `BOND`,
            with the bodies bonded.

    Returns:
        Rows of a table, one for each quantity and seam; the entry "eps" is the thickness, or None if no layer is thin
        enough.
    """
    goals, rows = {goal.name: goal for goal in case.goals}, list[Row]()
    seams = [*case.layer] if isinstance(case.layer, Mapping) else [S]
    description = case.description
    options: Arguments = {"times": description.times or None, "bodies": description.bodies, "bonded": name == BOND}
    for (quantity, tolerance), seam in product(description.tolerance.items(), seams):
        if name == BOND and quantity == "jump":
            continue  # bonded bodies have no jump
        of = {"seam": seam} if len(seams) > 1 else {}
        try:
            goal = goals.get(quantity, quantity)
            thin = thin_enough(case.structure, case.layer, tolerance, goal, seam=seam, **options)
            eps, words = thin.eps, str(thin)
        except InputError as error:  # an answer too: no thickness is thin enough
            eps, words = None, str(error).removeprefix("thin_enough: ")
        rows.append({"instead": name, **of, "quantity": quantity, "tolerance": tolerance, "eps": eps})
        record.say(f"  {f'{seam}: ' if of else ''}{words}")
    return rows


def _draw(record: Record, case: DescribedCase, name: str, estimate: Estimate) -> None:
    """Draw how the change of each goal is distributed over S, and print the percentage that arises near the ends of S.

    A goal whose change has no known distribution is named in a message instead.

    Args:
        record: record of the run, with the folder of the pictures; text is printed through it.
        case: the input, for the unit of lengths.
        name: model that is used without the layer's mesh: `LAW`, with an interface law, or `BOND`, with the bodies
            bonded.
        estimate: changes of the goals.
    """
    stems = list[str]()
    for goal in estimate.goals:
        try:
            density = estimate.density(goal)
        except InputError as error:
            record.say(f"no picture of {goal}: {error}")
            continue
        stem = "_".join(["map", name, *re.findall(r"\w+", goal)])
        while stem in stems:  # as for "a b" and "a-b"
            stem += "_"
        stems.append(stem)
        if shares := _near_ends(estimate, goal, density):
            record.say(f"  {goal}: {shares}")
        path, length = record.path(f"{stem}.png"), case.description.units[0] if case.description.units else ""
        shown = goal.replace("$", r"\$")  # a plain dollar sign, no formula
        label, surface = f"change of {shown}, per area of S", Surface(estimate.better.model)
        if surface.joint.dim == 2:
            plotting.along(surface, {label: density}, save=path, length=length, log=True)
        else:
            plotting.on_surface(estimate.better, density, plotting.View(scale=0.0), save=path, quantity=label, log=True)


def _near_ends(estimate: Estimate, goal: str, density: Array) -> str:
    """Return a text with the percentages of a goal's change that arise within 4 and 8 thicknesses of the ends of S.

    It is "" if S has no ends or the goal does not change.

    Args:
        estimate: changes of the goals of a model.
        goal: name of the goal.
        density: change of the goal per area of S, at each node of S.
    """
    surface, error, shares = Surface(estimate.better.model), estimate.goals[goal], []
    if error.zero or error.fixed or not np.isfinite(surface.distance_to_ends).any():
        return ""
    for distance in np.array(END_DISTANCES) * max(layer.layer.eps for layer in estimate.layers.values()):
        near = surface.integral(surface.at_points(density) * (surface.distance_to_ends < distance))
        shares.append(f"{100 * near / error.change:.2g} % within {distance:.3g} of the ends of S")
    return f"of its change {' and '.join(shares)}"
