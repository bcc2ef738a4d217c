"""Pictures of tables with two axes: cells with a colour for a range of values, and a text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch

from forms.base import InputError
from forms.temperature import real
from thinlayer.output.plotting.picture import Picture, finish

RANGES = ("#5e9bc8", "#b7dfc0", "#fff7b0", "#f8b26a", "#dd5a4d")  # colours of the ranges, from the lowest values
LETTER = 0.04  # inches, of the labels of rows
CELL, MARGIN = (0.36, 0.3), (0.75, 0.8)  # inches: of a cell, and of a panel around its cells


def maps(
    parts: Mapping[str, Any],
    *,
    x: Sequence[str],
    y: Sequence[str],
    texts: Mapping[str, Any],
    levels: Sequence[float],
    names: Sequence[str],
    xlabel: str,
    ylabel: str,
    columns: int = 3,
    title: str = "",
    save: str | Path | None = None,
) -> Picture:
    """Draw values over two axes as cells, in several panels with one legend.

    Args:
        parts: title of a panel -> values (len(y), len(x)), the first row lowest; cells that are not a number stay white.
        x, y: labels of the columns and of the rows.
        texts: title -> what is written into the cells, texts (len(y), len(x)).
        levels: values between the ranges, growing; at most four.
        names: of the ranges, one more than levels.
        xlabel, ylabel: labels of the axes.
        columns: number of panels in a row.
        title: title of the picture.
        save: name of a file to save the picture to.

    Raises:
        InputError: values or texts of another shape, levels that do not grow or are too many, another number of names.
    """
    shape = (len(y), len(x))
    values = {label: real(part).astype(float) for label, part in parts.items()}
    for label, part in values.items():
        given = np.asarray(texts.get(label, "")).shape
        if not part.shape == given == shape:
            raise InputError(f"maps: {label!r} has values {part.shape} and texts {given}, not {shape}")
    if np.any(np.diff(levels) <= 0) or not len(levels) + 1 == len(names) <= len(RANGES):
        raise InputError(f"maps: {len(names)} names for levels {list(levels)}; give up to 4 that grow, and a name more")
    columns = min(columns, len(parts))
    rows = -(-len(parts) // columns)
    width, height = ((n * cell + margin) for n, cell, margin in zip(shape[::-1], CELL, MARGIN, strict=True))
    width += LETTER * max(map(len, y))
    figure = Picture(figsize=(width * columns, height * rows + 0.8), layout="constrained")
    colours = RANGES[: len(names)]
    norm = BoundaryNorm([-np.inf, *levels, np.inf], len(names))
    for k, (label, part) in enumerate(values.items()):
        axes = figure.add_subplot(rows, columns, k + 1)
        axes.pcolormesh(np.ma.masked_invalid(part), cmap=ListedColormap(colours), norm=norm, edgecolors="white")
        for (i, j), text in np.ndenumerate(np.asarray(texts[label])):
            axes.text(j + 0.5, i + 0.5, text, ha="center", va="center", fontsize=6.5)
        axes.set_xticks(np.arange(len(x)) + 0.5, x, rotation=60, fontsize=7)
        axes.set_yticks(np.arange(len(y)) + 0.5, y, fontsize=7)
        axes.tick_params(length=0)
        axes.set_title(label, fontsize=9)
        if k % columns == 0:
            axes.set_ylabel(ylabel, fontsize=8)
        if k >= len(parts) - columns:
            axes.set_xlabel(xlabel, fontsize=8)
    patches = [Patch(color=colour, label=name) for colour, name in zip(colours, names, strict=True)]
    figure.legend(handles=patches, loc="outside lower center", ncols=len(names), frameon=False, fontsize=8)
    if title:
        figure.suptitle(title, fontsize=10)
    return finish(figure, save)
