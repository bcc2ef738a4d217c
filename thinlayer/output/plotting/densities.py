"""Pictures of densities on S: curves by arc length in 2D, coloured facets in 3D."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import SymLogNorm

from geometry.seam import S
from thinlayer.errors import ModelError
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.output.plotting.picture import Picture, finish, require_name
from thinlayer.output.surface import Surface

Array = npt.NDArray[np.float64]
PANEL = (5.6, 3.4)  # width and height of a panel, inches
SHOWN = 1e-3  # values over the largest that still have a colour of their own
COLOUR_MAP = "RdBu_r"


def density(
    surface: Surface,
    f: Array,
    *,
    save: str | Path | None = None,
    title: str = "",
    length: str = "",
    quantity: str = "density",
) -> Picture:
    """A density on S, a panel for each layer: by arc length in 2D, as colours in the plane of the seam in 3D.

    Args:
        surface: S, or one seam.
        f: (n, q) field on it, as `Estimate.map` returns it for `Surface(estimate.better.model)`.
        save: PNG file; None: it is not saved.
        title: text over the picture.
        length: unit of length, for the labels.
        quantity: label of the values.

    Raises:
        ModelError: no field; a seam in 3D that is not planar. OSError: the picture could not be written.
    """
    if not isinstance(surface, Surface):
        raise ModelError(
            f"density: {surface!r:.80} is no Surface; give Surface(estimate.better.model), and a field on it"
        )
    require_name(save)
    model = surface.model
    seams, d = [name for name in model.layers if surface.seam in (S, name)], model.joint.dim
    if bent := [name for name in seams if d == 3 and not model.layers[name].sheet.planar]:
        raise ModelError(f"pictures of densities in 3D are for planar seams, and {bent[0]!r} is curved")
    figure = Picture(figsize=(PANEL[0] * len(seams), PANEL[1]), layout="constrained")
    draw = _by_arc_length if d == 2 else _coloured
    for axes, name in zip(figure.subplots(1, len(seams), squeeze=False)[0], seams, strict=True):
        draw(figure, axes, surface, f, name, f" ({length})" if length else "", quantity)
        axes.set_title(name if len(seams) > 1 else "", fontsize=11)
    if title:
        figure.suptitle(title, fontsize=11)
    return finish(figure, save)


def _by_arc_length(
    figure: Picture, axes: Axes, surface: Surface, f: Array, name: str, unit: str, quantity: str
) -> None:
    start, lines = 0.0, surface.along(f)
    for number, line in enumerate(one for one in lines if one.seam == name):
        if number:
            axes.axvline(start, color="0.7", linewidth=0.8)
        axes.fill_between(start + line.s, line.values, color=COLOURS[0], alpha=0.25, linewidth=0)
        axes.plot(start + line.s, line.values, ".-", color=COLOURS[0], markersize=3)
        start += line.length
    _scale(axes, max(float(np.abs(line.values).max()) for line in lines))
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    axes.grid(color="0.9")
    axes.set_xlabel(f"arc length{unit}")
    axes.set_ylabel(quantity)


def _scale(axes: Axes, largest: float) -> None:
    """A logarithmic axis on both sides of zero, with ticks at powers of ten that do not lie on one another."""
    if not largest:
        return
    top = math.floor(math.log10(largest))
    powers = [10.0**k for k in range(top + int(math.log10(SHOWN)) + 1, top + 1)]
    axes.set_yscale("symlog", linthresh=powers[0], linscale=0.5)
    axes.set_yticks([*(-one for one in reversed(powers)), 0.0, *powers])
    axes.minorticks_off()


def _least(largest: float) -> float:
    """The size below which values are drawn in proportion: a power of ten, so that no label is close to that of zero."""
    return float(10.0 ** math.ceil(math.log10(SHOWN * largest))) if largest else 1.0


def _coloured(figure: Picture, axes: Axes, surface: Surface, f: Array, name: str, unit: str, quantity: str) -> None:
    joint, values = surface.joint, (f * surface.weights).sum(axis=1) / surface.weights.sum(axis=1)
    first, second = _axes_of(surface.model.layers[name].sheet.mean_normal)
    largest = float(np.abs(values).max()) or 1.0
    here = joint.seam_numbers[surface.rows] == list(joint.seams).index(name)
    x = joint.points[surface.corners[here]] @ np.column_stack([first, second])
    from_centre = x - x.mean(axis=1, keepdims=True)
    ring = np.arctan2(from_centre[..., 1], from_centre[..., 0]).argsort(axis=1)
    facets: Any = PolyCollection(
        [*np.take_along_axis(x, ring[..., None], axis=1)],
        array=values[here],
        cmap=COLOUR_MAP,
        edgecolor="face",
    )
    facets.set_norm(SymLogNorm(_least(largest), vmin=-largest, vmax=largest))
    axes.add_collection(facets)
    axes.set_aspect("equal")
    axes.autoscale_view()
    for label, direction in ((axes.set_xlabel, first), (axes.set_ylabel, second)):
        label(f"along ({', '.join(f'{c:.3g}' for c in direction + 0.0)}){unit}")
    figure.colorbar(facets, ax=axes, label=quantity)


def _axes_of(n: Array) -> tuple[Array, Array]:
    """Two unit vectors in the plane across n, the first one along a coordinate axis as far as it can be."""
    axis = np.eye(3)[int(np.abs(n).argmin())]
    first = axis - (axis @ n) * n
    first = first / np.linalg.norm(first)
    second = np.cross(n, first)
    return first, second if second.sum() > 0 else -second
