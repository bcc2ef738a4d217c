"""Pictures of effectivities, and of changes along S."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from thinlayer.files.table import Table
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.output.plotting.picture import Picture, finish

FIELDS = ("traction", "jump")
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
