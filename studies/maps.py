"""Pictures of tables with two axes: cells with a colour for a range of values, and a text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

from thinlayer.output.plotting.picture import Picture, finish

RANGES = ("#5e9bc8", "#b7dfc0", "#fff7b0", "#f8b26a", "#dd5a4d")  # colours of the ranges, from the lowest values
LETTER = 0.04  # inches, of the labels of rows
CELL, MARGIN = (0.36, 0.3), (0.75, 0.8)  # inches: of a cell, and of a panel around its cells
Axis = tuple[str, Sequence[str]]  # its label, those of its columns or rows


def maps(
    parts: Mapping[str, tuple[Any, Any]],
    x: Axis,
    y: Axis,
    ranges: Mapping[str, float],
    *,
    columns: int = 3,
    title: str = "",
    save: str | Path | None = None,
) -> Picture:
    """Draw values over two axes as cells, in several panels with one legend.

    Args:
        parts: title of a panel -> values (rows, columns), the first row lowest, and what is written into the cells; cells
            that are not a number stay white.
        x, y: the axes.
        ranges: name of a range of values -> its upper end, growing; at most five.
        columns: number of panels in a row.
        title: title of the picture.
        save: name of a file to save the picture to.
    """
    columns = min(columns, len(parts))
    rows = -(-len(parts) // columns)
    width, height = (len(axis[1]) * cell + margin for axis, cell, margin in zip((x, y), CELL, MARGIN, strict=True))
    width += LETTER * max(map(len, y[1]))
    figure = Picture(figsize=(width * columns, height * rows + 0.8), layout="constrained")
    colours = RANGES[: len(ranges)]
    norm = BoundaryNorm([-np.inf, *ranges.values()], len(ranges))
    for k, (label, (values, texts)) in enumerate(parts.items()):
        axes = figure.add_subplot(rows, columns, k + 1)
        cells = np.ma.masked_invalid(np.asarray(values, float))
        axes.pcolormesh(cells, cmap=ListedColormap(colours), norm=norm, edgecolors="white")
        for (i, j), text in np.ndenumerate(texts):
            axes.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=6.5)
        axes.set_xticks(np.arange(len(x[1])) + 0.5, x[1], rotation=60, fontsize=7)
        axes.set_yticks(np.arange(len(y[1])) + 0.5, y[1], fontsize=7)
        axes.tick_params(length=0)
        axes.set_title(label, fontsize=9)
        axes.set_ylabel(y[0] if k % columns == 0 else "", fontsize=8)
        axes.set_xlabel(x[0] if k >= len(parts) - columns else "", fontsize=8)
    patches = [Patch(color=colour, label=name) for colour, name in zip(colours, ranges, strict=True)]
    figure.legend(handles=patches, loc="outside lower center", ncols=len(ranges), frameon=False, fontsize=8)
    figure.suptitle(title, fontsize=10)
    return finish(figure, save)
