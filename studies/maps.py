"""Pictures of choices over two axes: cells with a colour and a letter for each choice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from geometry.topology import IntArray
from thinlayer.output.plotting.picture import Picture, finish_picture

COLOURS = ("#5e9bc8", "#b7dfc0", "#fff7b0", "#f8b26a")  # of the choices, in turn
CELL, MARGIN = (0.37, 0.25), (0.45, 0.35)  # inches: of a cell, and of a panel around its cells
FONT_SIZE = 8  # size of text, points: 6 in print, where two columns fill 170 mm
Axis = tuple[str, Sequence[str]]  # label of the axis, labels of its columns or rows


def maps(panels: Mapping[str, IntArray], x: Axis, y: Axis, labels: Sequence[str], *, title: str, save: Path) -> None:
    """Draw choices over two axes as coloured cells with letters, in panels in two columns with one legend.

    Args:
        panels: title of a panel -> number of the choice in each cell (rows, columns), the first row at the bottom.
        x: label of the horizontal axis, and a label for each column.
        y: label of the vertical axis, and a label for each row.
        labels: texts of the choices, at most four; cells show their first letters.
        title: text over the picture.
        save: path of the file to which the picture is written.
    """
    n_columns = min(2, len(panels))
    n_rows = -(-len(panels) // n_columns)
    width, height = (len(axis[1]) * cell + margin for axis, cell, margin in zip((x, y), CELL, MARGIN, strict=True))
    figure = Picture(figsize=(width * n_columns, height * n_rows + 1.4), layout="constrained")
    colour_map = ListedColormap(COLOURS[: len(labels)])
    for k, (label, choices) in enumerate(panels.items()):
        axes = figure.add_subplot(n_rows, n_columns, k + 1)
        is_bottom = k >= len(panels) - n_columns
        axes.pcolormesh(choices, cmap=colour_map, vmin=0, vmax=len(labels) - 1, edgecolors="white")
        for (i, j), choice in np.ndenumerate(choices):
            axes.text(j + 0.5, i + 0.5, labels[int(choice)][0], ha="center", va="center", fontsize=FONT_SIZE)
        axes.set_xticks(np.arange(len(x[1])) + 0.5, x[1] if is_bottom else [], rotation=60, fontsize=FONT_SIZE)
        axes.set_yticks(np.arange(len(y[1])) + 0.5, y[1] if k % n_columns == 0 else [], fontsize=FONT_SIZE)
        axes.tick_params(length=0)
        axes.set_title(label, fontsize=FONT_SIZE + 1)
        axes.set_ylabel(y[0] if k % n_columns == 0 else "", fontsize=FONT_SIZE + 1)
        axes.set_xlabel(x[0] if is_bottom else "", fontsize=FONT_SIZE + 1)
    patches = [Patch(color=colour, label=label) for colour, label in zip(COLOURS, labels, strict=False)]
    figure.legend(handles=patches, loc="outside lower center", ncols=len(labels), frameon=False, fontsize=FONT_SIZE + 1)
    figure.suptitle(title, fontsize=FONT_SIZE + 2)
    finish_picture(figure.axes, save)
