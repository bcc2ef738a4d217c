"""Pictures of stresses inside a layer near its free end, from a `Zoom`, compared with those of a full model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from forms.base import Array, InputError, is_number, require
from forms.kinematics import PLANE_STRAIN
from geometry.refusals import require_known
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.output.plotting.picture import AxesInput, Picture, draw_on_root, make_panels
from thinlayer.output.zooming import CORNER_EXCLUSION, Zoom

STRESS_INDICES = {"N": (1, 1), "T": (0, 1), "S": (0, 0)}  # indices of stresses in the axes of an end: inward, n
COMPONENT_LABELS = {"N": "normal traction t_N", "T": "shear traction t_T", "S": "stress along S"}
N_GRID_POINTS = (121, 61)  # along S and through the thickness
MAX_HEIGHT_RATIO = 0.495  # largest drawn height, over the thickness
CLIPPED_FRACTION = 0.02  # share of values beyond each end of the range of colours, as values at corners are extreme


def zoomed(
    zoom: Zoom,
    full: Zoom | None = None,
    *,
    end: int = 0,
    width: float = 3.0,
    component: str = "N",
    save: str | Path | None = None,
    stress: str = "",
    ax: AxesInput = None,
) -> Picture | None:
    """Draw a stress component in a 2D layer near a free end, as a map and along three lines parallel to S. Collective.

    Args:
        zoom: `Zoom` of a state of an interface model.
        full: `Zoom` of a state of the full model with the same layer, to compare with; None: no comparison.
        end: position of the end in the list `zoom.ends`, from 0.
        width: length of the drawn part of the layer from its end, divided by the layer's thickness, > 1/16.
        component: "N": normal traction. "T": shear stress between two axes, the first along S and inward from the end,
            the second n. "S": normal stress along S.
        save: name of a file to save the picture to, .png, .svg or .pdf; None: it is not saved.
        stress: name of the unit of stresses, for the labels.
        ax: matplotlib's axes to draw in, one for each map and one for the lines; None: a new picture is made.

    Returns:
        The new picture on rank 0; None on other ranks, and if `ax` is given.

    Raises:
        InputError: a 3D model; not a `Zoom`; no such end, component or width.
        OSError: the file could not be written.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, Zoom, plotting, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> picture = plotting.zoomed(Zoom(state), save="inside.png")
    """
    for candidate in (zoom,) if full is None else (zoom, full):
        require(isinstance(candidate, Zoom), "zoomed: a zoom", candidate, "give Zoom(state)")
    require_known("component", component, STRESS_INDICES)
    allowed = f"allowed: > {CORNER_EXCLUSION:g}, over the thickness"
    require(is_number(width) and CORNER_EXCLUSION < width < np.inf, "zoomed: width", width, allowed)
    if zoom.state.model.joint.dim != 2:
        raise InputError("zoomed: pictures of ends are for two dimensions; in 3D take zoom.stress")
    zoom.state.model.kinematics.require(PLANE_STRAIN.unknown, "zoomed")
    require(end in range(len(zoom.ends)), "zoomed: end", end, f"S has {len(zoom.ends)} free ends")
    (straight_end, (end_point, *_)), axes = zoom.ends[end], zoom.ends[end][0].axes
    # the grid is finer towards the end and the faces, but excludes corners, where stresses are infinite
    d = CORNER_EXCLUSION + (width - CORNER_EXCLUSION) * (1 - np.cos(np.linspace(0, np.pi / 2, N_GRID_POINTS[0])))
    D, Y = np.meshgrid(d, MAX_HEIGHT_RATIO * np.sin(np.linspace(-np.pi / 2, np.pi / 2, N_GRID_POINTS[1])))
    x, heights = end_point - D.ravel()[:, None] * zoom.eps * straight_end.m, Y.ravel()
    i, j = STRESS_INDICES[component]
    meshed_stress = {} if full is None else {"meshed layer": full.stress(x, heights)}
    fields = meshed_stress | {"layer by itself": zoom.stress(x, heights)}
    values = {name: np.einsum("i,nij,j->n", axes[i], sigma, axes[j]).reshape(D.shape) for name, sigma in fields.items()}
    return draw_on_root(zoom.state.model.comm, lambda: _draw_stress(values, D, Y, component, stress, ax), save)


def _draw_stress(values: dict[str, Array], D: Array, Y: Array, component: str, unit: str, ax: AxesInput) -> Figure:
    low, high = np.quantile(next(iter(values.values())), [CLIPPED_FRACTION, 1 - CLIPPED_FRACTION])
    n, ratios = len(values) + 1, [*[1.0] * len(values), 1.5]
    panels = make_panels(ax, (n, 1), n, (7.2, 1.9 * len(values) + 3.0), height_ratios=ratios, sharex=True)
    figure: Any = panels[0].figure
    for axes, (name, field) in zip(panels[:-1], values.items(), strict=True):
        colour_mesh = axes.pcolormesh(D, Y, field, shading="gouraud", vmin=low, vmax=high, cmap="viridis")
        axes.set(title=name, ylabel="height/eps", ylim=(-0.5, 0.5))
    quantity = f"{COMPONENT_LABELS[component]}{f' ({unit})' if unit else ''}"
    figure.colorbar(colour_mesh, ax=list(panels[:-1]), label=quantity, extend="both")
    for colour, height in zip(COLOURS, (0.45, 0.0, -0.45), strict=False):
        row = int(np.abs(Y[:, 0] - height).argmin())
        for style, (name, field) in zip(("--", "-"), [*values.items()][::-1], strict=False):
            label = f"{name}, height {height:g} eps"
            panels[-1].plot(D[row], field[row], style, color=colour, linewidth=1.5, label=label)
    span = high - low
    panels[-1].set(xlabel="distance from the end, over eps", ylabel=quantity, ylim=(low - span / 3, high + span / 3))
    panels[-1].grid(color="0.9")
    handles, labels = panels[-1].get_legend_handles_labels()
    if isinstance(figure, Picture):
        figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    else:
        panels[-1].legend(handles, labels)
    return figure
