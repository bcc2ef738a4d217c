"""Pictures of cells, coloured by their parts of the width of an interval."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from forms.base import InputError, require
from geometry.topology import is_tensor
from thinlayer.discretisation.full_model import LayerModel
from thinlayer.estimating.continuum import ContinuumBounds
from thinlayer.estimating.result import Estimate
from thinlayer.output.plotting.picture import AxesInput, Picture, draw_on_root, make_panels
from thinlayer.output.plotting.scene import COLOUR_BAR_STYLE, COLOUR_MAP

SHARE_RANGE = 1e4  # largest share of a cell over the smallest with a colour of its own


def cells(
    estimate: Estimate,
    bounds: ContinuumBounds,
    *,
    zoom: tuple[float, float, float, float] | None = None,
    save: str | Path | None = None,
    title: str = "",
    ax: AxesInput = None,
) -> Picture | None:
    """Draw the cells of bodies and layers, coloured by their shares of the width of an interval for any mesh, in 2D.

    Args:
        estimate: the estimate, such as `solve_to(...).estimate`.
        bounds: the bounds of a goal, by its method `continuum` or from `solve_to(...).bounds`.
        zoom: (left, right, bottom, top) of the window; None: the whole structure.
        save: name of a file to save the picture to, .png, .svg or .pdf; None: it is not saved.
        title: text over the picture.
        ax: matplotlib's axes to draw in; None: a new picture is made.

    Returns:
        The new picture on rank 0; None on other ranks, and if `ax` is given.

    Raises:
        InputError: not an estimate and its bounds, or a 3D structure.
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
        >>> picture = plotting.cells(result, bounds, save="cells.png")
    """
    require(
        isinstance(estimate, Estimate), "cells: estimate", estimate, "give estimate(state), or solve_to(...).estimate"
    )
    model = estimate.inside.model
    assert isinstance(model, LayerModel)
    joint = model.inflated_joint
    is_fit = isinstance(bounds, ContinuumBounds) and len(bounds.by_cell) == len(joint.cells)
    require(is_fit, "cells: bounds", bounds, "give those of a goal, by the method continuum of this estimate")
    if joint.dim != 2:
        raise InputError("cells: pictures of cells are for two dimensions; in 3D take bounds.by_cell")
    corners = joint.corners[:, [0, 1, 3, 2]] if is_tensor(joint.cell_type) else joint.corners
    shares = bounds.by_cell / (bounds.by_cell.sum() or 1.0)
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
        figure.colorbar(drawn, ax=axes, **COLOUR_BAR_STYLE, extend="min", label="share of the interval")
        axes.set_title(title, fontsize=11)
        return figure

    return draw_on_root(estimate.state.model.comm, draw, save)
