"""Pictures of values over two axes: coloured cells with a text, where a colour stands for a range of values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

from thinlayer.output.plotting.picture import Picture, finish_picture

RANGE_COLOURS = ("#5e9bc8", "#b7dfc0", "#fff7b0", "#f8b26a", "#dd5a4d")  # colours of the ranges, from the lowest values
CELL, MARGIN = (0.37, 0.25), (0.45, 0.35)  # inches: of a cell, and of a panel around its cells
FONT_SIZE = 8  # size of text, points: 6 in print, where two columns fill 170 mm
Panel = tuple[npt.ArrayLike, npt.NDArray[np.str_]]  # values of cells, texts of cells
Axis = tuple[str, Sequence[str]]  # label of the axis, labels of its columns or rows


def maps(panels: Mapping[str, Panel], x: Axis, y: Axis, ranges: dict[str, float], *, title: str, save: Path) -> None:
    """Draw values over two axes as coloured cells, in panels in two columns with one legend.

    Args:
        panels: title of a panel -> its values (rows, columns), the first row at the bottom, and the texts in its cells
            (rows, columns). Cells with the value NaN stay white.
        x: label of the horizontal axis, and a label for each column.
        y: label of the vertical axis, and a label for each row.
        ranges: name of a range of values with one colour -> its upper end; at most five, in increasing order.
        title: text over the picture.
        save: path of the file to which the picture is written.
    """
    n_columns = min(2, len(panels))
    n_rows = -(-len(panels) // n_columns)
    width, height = (len(axis[1]) * cell + margin for axis, cell, margin in zip((x, y), CELL, MARGIN, strict=True))
    figure = Picture(figsize=(width * n_columns, height * n_rows + 1.4), layout="constrained")
    colours, norm = RANGE_COLOURS[: len(ranges)], BoundaryNorm([-np.inf, *ranges.values()], len(ranges))
    for k, (label, (values, texts)) in enumerate(panels.items()):
        axes = figure.add_subplot(n_rows, n_columns, k + 1)
        cell_values, is_bottom = np.ma.masked_invalid(np.asarray(values, float)), k >= len(panels) - n_columns
        axes.pcolormesh(cell_values, cmap=ListedColormap(colours), norm=norm, edgecolors="white")
        for (i, j), text in np.ndenumerate(texts):
            axes.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=FONT_SIZE)
        axes.set_xticks(np.arange(len(x[1])) + 0.5, x[1] if is_bottom else [], rotation=60, fontsize=FONT_SIZE)
        axes.set_yticks(np.arange(len(y[1])) + 0.5, y[1] if k % n_columns == 0 else [], fontsize=FONT_SIZE)
        axes.tick_params(length=0)
        axes.set_title(label, fontsize=FONT_SIZE + 1)
        axes.set_ylabel(y[0] if k % n_columns == 0 else "", fontsize=FONT_SIZE + 1)
        axes.set_xlabel(x[0] if is_bottom else "", fontsize=FONT_SIZE + 1)
    patches = [Patch(color=colour, label=name) for colour, name in zip(colours, ranges, strict=True)]
    figure.legend(handles=patches, loc="outside lower center", ncols=len(ranges), frameon=False, fontsize=FONT_SIZE + 1)
    figure.suptitle(title, fontsize=FONT_SIZE + 2)
    finish_picture(figure.axes, save)
