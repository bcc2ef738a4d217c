"""Pictures of cells, coloured by their shares of a sum, such as an error."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from forms.base import Array, InputError, require
from geometry.joint import Joint
from geometry.parallel import default_comm
from geometry.topology import is_tensor
from thinlayer.output.plotting.picture import AxesInput, Picture, draw_on_root, make_panels
from thinlayer.output.plotting.scene import COLOUR_BAR_STYLE, COLOUR_MAP

SHARE_RANGE = 1e4  # largest share of a cell over the smallest with a colour of its own


def cells(
    joint: Joint,
    values: Array,
    label: str = "share of the interval",
    *,
    zoom: tuple[float, float, float, float] | None = None,
    save: str | Path | None = None,
    title: str = "",
    ax: AxesInput = None,
) -> Picture | None:
    """Draw the cells of a joint in 2D, coloured by their shares of a sum, such as of the width of an interval.

    Args:
        joint: bodies, and layers if they are meshed, such as `joint` of `ContinuumBounds`.
        values: (n_cells,) parts of the sum, >= 0, such as `by_cell` of `ContinuumBounds`.
        label: text beside the colour bar.
        zoom: (left, right, bottom, top) of the window; None: the whole structure.
        save: name of a file to save the picture to, .png, .svg or .pdf; None: it is not saved.
        title: text over the picture.
        ax: matplotlib's axes to draw in; None: a new picture is made.

    Returns:
        The new picture on rank 0; None on other ranks, and if `ax` is given.

    Raises:
        InputError: the values are not those of the cells, or the joint is 3D.
        OSError: the file could not be written.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, estimate, plotting, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> plates = Structure(
        ...     sandwich(4, 1, 2, h=0.5),
        ...     body=steel,
        ...     supports={"BOTTOM": 0},
        ...     tractions={"TOP": (3, -10)},
        ... )
        >>> result = estimate(solve(plates.interface(ThinLayer(glue, eps=0.05))))
        >>> bounds = result.continuum()["compliance"]
        >>> picture = plotting.cells(bounds.joint, bounds.by_cell, save="cells.png")
    """
    require(isinstance(joint, Joint), "cells: joint", joint, "give a joint, such as ContinuumBounds.joint")
    parts = np.asarray(values, float)
    is_fit = parts.shape == (len(joint.cells),) and bool((parts >= 0).all())
    require(is_fit, "cells: values", values, f"give a number >= 0 for each of the {len(joint.cells)} cells")
    if joint.dim != 2:
        raise InputError("cells: 3D joints have no such picture; places are joint.points[joint.corners].mean(axis=1)")
    corners = joint.corners[:, [0, 1, 3, 2]] if is_tensor(joint.cell_type) else joint.corners
    shares = parts / (parts.sum() or 1.0)
    largest = float(shares.max()) or 1.0

    def draw() -> Figure:
        (axes,) = make_panels(ax, (1, 1), 1, (6.7, 3.6))
        colours: dict[str, Any] = {"cmap": COLOUR_MAP, "norm": LogNorm(largest / SHARE_RANGE, largest)}
        drawn = PolyCollection([*joint.points[corners]], edgecolors="#444444", linewidths=0.2, **colours)
        drawn.set_array(shares)
        axes.add_collection(drawn)
        axes.set_aspect("equal")
        axes.autoscale_view()
        axes.axis("off")
        if zoom is not None:
            axes.axis(zoom)
        figure: Any = axes.figure
        figure.colorbar(drawn, ax=axes, **COLOUR_BAR_STYLE, extend="min", label=label)
        axes.set_title(title, fontsize=11)
        return figure

    return draw_on_root(default_comm(), draw, save)
