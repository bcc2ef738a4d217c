"""May you drop the layer? What leaving out its mesh changes: estimated, and in truth, in 33 structures."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studies.dropping.cases import COARSE, FINE, further_cases, known_cases, refused_cases
from studies.dropping.measuring import (
    FIELDS,
    PLACES,
    Dropped,
    along,
    cost,
    effectivities,
    from_known,
    questions,
    unknowns,
)
from thinlayer.files.progress import track
from thinlayer.files.table import Table
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.output.plotting.picture import Picture, finish
from thinlayer.running.record import Record

THICKNESSES = (COARSE, FINE)
BAND = 0.1  # of effectivities about 1
SAME = 0.02  # of effectivities that another program found
THIN = 0.05  # of the thickness from which on a layer may be dropped
SOLVES = 1.2  # as many solves of the interface model may an estimate cost
DRAWN = "two stiffnesses"


def run(record: Record, *, quick: bool = False) -> None:
    """Estimate what changes from the law of order 0 to the layer itself, and mesh the layer to see it.

    effectivities.csv has the true changes, relative, and estimated over true ones, of tractions and jumps on S further than
    three thicknesses from free ends; goals.csv other numbers; refused.csv what is said where there is no number;
    thin_enough.csv the thickness from which on the layer may be dropped; costs.csv times.

    Args:
        record: where to write.
        quick: without structures in three dimensions, one question of thickness, fewer times.
    """
    _effectivities(record, quick=quick)
    _refusals(record)
    _thin_enough(record, quick=quick)
    _costs(record, quick=quick)


def _effectivities(record: Record, *, quick: bool) -> None:
    known, further = known_cases(), further_cases()
    cases = [(case, eps) for case in (*known, *further) for eps in THICKNESSES if not (quick and case.solid)]
    table, goals = record.table("effectivities.csv"), record.table("goals.csv")
    for case, eps in track(cases, "may_i_drop", "{0[0].name}, {0[1]:g}"):
        one = Dropped.of(case, eps, record)
        row, asked = effectivities(one)
        here: dict[str, float | str] = {"case": case.name, "eps": eps}
        size, complete = (
            unknowns(one.found.better.model),
            float(not any(a.law.lacks for a in one.found.layers.values())),
        )
        table.append({**here, "unknowns": size, **row, "complete": complete, "from_known": from_known(one)})
        for goal in asked:
            goals.append(here | goal)
        if (case.name, eps) == (DRAWN, COARSE):
            record.write("along.csv", along(one))
    record.say(table)
    record.say(goals)
    own = {case.name for case in further}
    _check(record, table, goals, np.array([row["case"] in own for row in table.rows]))


def _check(record: Record, table: Table, goals: Table, own: np.ndarray) -> None:
    """Own cases, those that know their free ends, and goals whose changes do not cancel."""
    fine, complete = table["eps"] == FINE, table["complete"] > 0
    for name in FIELDS:
        distance = np.abs(table[name] - 1)
        for which, rows in {"further cases": own, "cases with all terms": complete}.items():
            record.check(
                f"largest distance of the {name}'s effectivity from 1, {which}", distance[rows].max(), high=BAND
            )
        ratio = float(np.median(distance[own & fine]) / np.median(distance[own & ~fine]))
        record.check(f"its median at eps = 1/64 over that at 1/16, {name}", ratio, high=0.5)
    known = table["from_known"]
    record.check("largest distance from effectivities that another program found", np.nanmax(known), high=0.04)
    record.check("share of them further away than .02", np.mean(known[~np.isnan(known)] > SAME), high=0.1)
    told = np.abs(goals["effectivity"] - 1)[goals["told"] > 0]
    record.check("median distance of a told goal's effectivity from 1", np.median(told), high=0.02)
    record.check("largest distance of a told goal's effectivity from 1", told.max(), high=0.3)


def _refusals(record: Record) -> None:
    table = record.table("refused.csv")
    missing = 0
    for case in track(refused_cases(), "may_i_drop", "{0.name}"):
        words, silent = case.told()
        missing += (case.says not in words) or (silent != case.silent)
        table.append({"case": case.name, "number": float(not silent), "says": words})
        record.say(f"{case.name}: {words}")
    record.check("cases that do not say what they have to", missing, high=0)


def _thin_enough(record: Record, *, quick: bool) -> None:
    table = record.table("thin_enough.csv")
    for question in track(questions()[: 1 if quick else None], "may_i_drop", "{0.name}"):
        told = question.told()
        meshed = question.by_meshing(told, record)
        table.append({"case": question.name, "tolerance": question.tolerance, "told": told, "meshed": meshed})
    record.say(table)
    record.check(
        "largest distance of thin_enough from meshing", np.abs(table["told"] / table["meshed"] - 1).max(), high=THIN
    )


def _costs(record: Record, *, quick: bool) -> None:
    table = record.table("costs.csv")
    for name in track([*PLACES][: 1 if quick else None], "may_i_drop", "costs, {}"):
        table.append(cost(name))
    record.say(table)
    if not quick:
        record.check("largest number of further solves", table["further_solves"].max(), high=SOLVES)


# ---------------------------------------------------------------- pictures
LABELS = ("meshed layer", "estimate")
ROW = 0.21  # inches
RANGE = (0.8, 1.2)


def draw_effectivities(table: Table, save: Path) -> Picture:
    """A row of dots for each case: estimated over true changes of traction and jump, for two thicknesses."""
    cases = list(dict.fromkeys(str(row["case"]) for row in table.rows))
    figure = Picture(figsize=(9.0, ROW * len(cases) + 1.2), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    marks = dict(zip(sorted(set(table["eps"]), reverse=True), (("o", "white"), ("o", None)), strict=False))
    for axes, name, colour in zip(panels, FIELDS, COLOURS, strict=False):
        axes.axvspan(0.9, 1.1, color="0.93", zorder=0)
        axes.axvline(1.0, color="0.6", linewidth=0.8, zorder=1)
        for eps, (marker, face) in marks.items():
            rows = [row for row in table.rows if row["eps"] == eps]
            y = [cases.index(str(row["case"])) for row in rows]
            x = np.array([float(row[name]) for row in rows])  # type: ignore[arg-type]
            shown = np.clip(x, *RANGE)
            label = f"eps = 1/{round(1 / eps)}"
            axes.plot(
                shown, y, marker, color=colour, markerfacecolor=face or colour, markersize=5, label=label, zorder=3
            )
            for value, at in zip(x, y, strict=True):
                if not RANGE[0] <= value <= RANGE[1]:
                    side = "right" if value > 1 else "left"
                    axes.annotate(
                        f"{value:.2f}",
                        (np.clip(value, *RANGE), at),
                        (-6 if value > 1 else 6, -3),
                        textcoords="offset points",
                        ha=side,
                        fontsize=7,
                    )
        axes.set_xlim(RANGE[0] - 0.01, RANGE[1] + 0.01)
        axes.set_title(f"{name}: estimated over true change", fontsize=9)
        axes.grid(axis="y", color="0.92")
        axes.legend(fontsize=8, loc="lower right")
    panels[0].set_yticks(range(len(cases)), cases, fontsize=8)
    panels[0].invert_yaxis()
    return finish(figure, save)


def draw_along(table: Table, title: str, near: float, save: Path) -> Picture:
    """Changes of traction and jump along S, and where the change of the compliance comes from.

    Args:
        table: of `mapping.along`.
        title: of the picture.
        near: distance from the ends of S, x = 0 and 1, within which the estimate says nothing.
        save: file.
    """
    panels = {
        "change of t . n": ("true_traction", "estimated_traction"),
        "change of [u] . n": ("true_jump", "estimated_jump"),
        "where the compliance changes": ("true_density", "density"),
    }
    figure = Picture(figsize=(9.0, 3.2), layout="constrained")
    x = table["x"]
    shown = (x > near / 8) & (x < 1 - near / 8)
    for axes, (name, columns) in zip(figure.subplots(1, 3), panels.items(), strict=True):
        for column, label, style, colour in zip(columns, LABELS, ("-", "--"), ("black", COLOURS[1]), strict=True):
            axes.plot(x[shown], table[column][shown], style, color=colour, label=label)
        for ends in ((0, near), (1 - near, 1)):
            axes.axvspan(*ends, color="0.93", zorder=0)
        axes.set_title(name, fontsize=9)
        axes.set_xlabel("x along S; grey: not known")
        axes.set_xlim(0, 1)
        axes.grid(color="0.9")
        axes.legend(fontsize=8)
    figure.suptitle(title, fontsize=10)
    return finish(figure, save)


def draw(record: Record) -> None:
    """Draw the effectivities of all cases, and changes along S of one of them, from the tables."""
    draw_effectivities(record.load("effectivities.csv"), record.path("effectivities.png"))
    draw_along(record.load("along.csv"), f"{DRAWN}, eps = 1/16", 3 * COARSE, record.path("along.png"))
