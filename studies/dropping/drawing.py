"""Pictures of effectivities, and of changes along S."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from thinlayer.files.table import Table
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.output.plotting.picture import Picture, finish

FIELDS = ("traction", "jump")
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


def draw_along(table: Table, title: str, save: Path) -> Picture:
    """Squares of the changes of traction and jump along S, and where the change of the compliance comes from."""
    parts = {
        "traction": ("change of t . n", {"true": "meshed", "estimated": "better law"}),
        "jump": ("change of [u] . n", {"true": "meshed", "estimated": "better law"}),
    }
    figure = Picture(figsize=(9.0, 3.4), layout="constrained")
    panels = figure.subplots(1, 3)
    x = table["x"]
    for axes, (name, (ylabel, lines)) in zip(panels, parts.items(), strict=False):
        for k, (column, label) in enumerate(lines.items()):
            axes.plot(x, table[f"{column}_{name}"], ("-", "--")[k], color=("black", COLOURS[1])[k], label=label)
        axes.set_title(ylabel, fontsize=9)
    panels[2].plot(x, table["density"], color=COLOURS[1], label="estimate.density")
    panels[2].plot(x, table["true_density"], color="black", label="meshed")
    panels[2].set_title("density of the change of the compliance", fontsize=9)
    for axes in panels:
        axes.set_xlabel("x along S")
        axes.grid(color="0.9")
        axes.legend(fontsize=8)
    figure.suptitle(title, fontsize=10)
    return finish(figure, save)
