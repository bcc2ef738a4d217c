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

    It prints the answer in sentences, and writes estimate.csv, thin_enough.csv if tolerances are given, and pictures of
    the change along S.

    Args:
        record: the folder of results.
        description: content of the input file.
        file: the input file, whose hash is stored.

    Raises:
        InputError: a wrong entry of the input file, or a model that cannot be estimated.
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
    """Return rows with the thickness below which each quantity changes by less than its tolerance, and print them.

    `name` is what replaces the meshed layer, its interface law (`LAW`) or a bond (`BOND`).
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
    """Draw the change of each goal as a density on S if it is known, and print its percentage near the ends of S.

    `name` is what replaces the meshed layer, its interface law (`LAW`) or a bond (`BOND`).
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
    """Text with the percentages of a goal's change that arise within 4 and 8 thicknesses of the ends of S.

    It is "" if S has no ends or the goal does not change.

    Args:
        estimate: the estimate.
        goal: name of the goal.
        density: nodal values of its change per area of S.
    """
    surface, error, shares = Surface(estimate.better.model), estimate.goals[goal], []
    if error.zero or error.fixed or not np.isfinite(surface.distance_to_ends).any():
        return ""
    for distance in np.array(END_DISTANCES) * max(layer.layer.eps for layer in estimate.layers.values()):
        near = surface.integral(surface.at_points(density) * (surface.distance_to_ends < distance))
        shares.append(f"{100 * near / error.change:.2g} % within {distance:.3g} of the ends of S")
    return f"of its change {' and '.join(shares)}"
