"""Deformed structures, drawn by pyvista off screen."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

if not os.environ.get("DISPLAY"):  # without an X server VTK otherwise tries one first, and warns
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")

import numpy as np
import numpy.typing as npt
import pyvista
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from forms.base import is_number
from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError
from thinlayer.output.grid import gather
from thinlayer.output.plotting.picture import Picture, drawn_on_root, require_name
from thinlayer.output.plotting.shapes import Shape, edges, surface

LARGEST = 0.05  # largest drawn displacement, over the size of the structure
VIEWS = {2: (0.0, 0.0, 1.0), 3: (0.55, 0.45, 1.0)}  # dimension -> direction to the viewer
LIFT = 0.004  # shift of lines towards the viewer, over the picture's width, so that surfaces do not hide them
PIXELS = 1400  # length of the longer side of an image
RED: dict[str, Any] = {"color": "crimson", "line_width": 4, "lighting": False}
BLACK: dict[str, Any] = {"color": "black", "line_width": 3, "lighting": False}
GREY: dict[str, Any] = {"color": "dimgrey", "line_width": 8, "lighting": False}
BODY: dict[str, Any] = {"scalars": "u", "cmap": "viridis", "show_scalar_bar": False, "ambient": 0.7, "diffuse": 0.3}


def deformed(
    states: Mapping[str, State] | State,
    *,
    save: str | Path | None = None,
    component: str = "size",
    scale: float | None = None,
    title: str = "",
    unit: str = "",
    zoom: Sequence[float] | None = None,
    view: Sequence[float] | None = None,
    cut: bool = False,
) -> Picture | None:
    """Deformed structures side by side, coloured by displacement, with the layer (or the jump across S) visible.

    The meshed layer has red outlines, a rigid base is grey. Three-dimensional structures are seen in parallel projection.

    Args:
        states: label -> state, or one state. Collective.
        save: PNG file; None: it is not saved.
        component: "size", "x", "y" or "z".
        scale: factor of the displacements (default: the largest is a twentieth of the structure).
        title, unit: text over the picture; unit of the displacements, for the colour bar.
        zoom: (left, right, bottom, top) part to show, in deformed coordinates: in 2D (x_min, x_max, y_min, y_max), in 3D
            lengths to the right and up on the picture, from where the origin is.
        view: in 3D the direction from the structure to the viewer, (3,) (default: the viewer stands in front, z > 0, to
            the right and above). y points up on the picture; from right above, -z does.
        cut: in 3D whether to leave out the half in front of the middle in z, to see S inside.

    Returns:
        The picture on rank 0, which has the fields; None on other ranks.

    Raises:
        ModelError: what is no state, a scale or a window that is no number, no name of a file.
        OSError: the picture could not be written; on all ranks.
        ModelError: unknown component, no direction, view or cut in 2D, nothing in the window.
    """
    panels = dict(states) if isinstance(states, Mapping) else {"": states}
    if not panels:
        raise ModelError("deformed: there is no state to draw")
    for label, one in panels.items():
        if not isinstance(one, State):
            what = f"{label!r} is {one!r}" if label else f"states is {one!r}"
            raise ModelError(f"deformed: {what}; give states, of a history its last one or history.at(t)")
    if scale is not None and not (is_number(scale) and math.isfinite(scale)):
        raise ModelError(f"deformed: scale is {scale!r}; it must be a finite number, the factor of the displacements")
    window = None if zoom is None else _window(zoom)
    require_name(save)
    grids = {label: gather(state) for label, state in panels.items()}
    comm = next(iter(panels.values())).model.comm

    def draw() -> Picture:
        first = next(iter(grids.values()))
        camera = _View.of(first.dim, view, cut)
        largest = max(np.linalg.norm(g.u, axis=1).max() for g in grids.values())
        fitting = LARGEST * np.ptp(first.points, axis=0).max() / largest if largest > 0 else 1.0
        factor = fitting if scale is None else scale
        front = (0.0, 0.0, np.copysign(1.0, camera.towards[2])) if cut else None
        shown = {label: Shape.of(grid, component, factor, front) for label, grid in grids.items()}
        name = ("|u|" if component == "size" else f"u_{component}") + (f" ({unit})" if unit else "")
        figure = _side_by_side(shown, camera, window, f"{name}; drawn displacements x {factor:.3g}")
        if title:
            figure.suptitle(title)
        return figure

    return drawn_on_root(comm, draw, save)


def _window(zoom: Any) -> tuple[float, ...]:
    """The four numbers of a window; raises ModelError."""
    try:
        left, right, bottom, top = window = tuple(float(one) if is_number(one) else math.nan for one in zoom)
        if np.isfinite(window).all() and left < right and bottom < top:
            return window
    except (TypeError, ValueError):
        pass
    raise ModelError(f"zoom is {zoom!r}; it needs (left, right, bottom, top), numbers, left < right and bottom < top")


@dataclass(frozen=True)
class _View:
    """Parallel projection: orthonormal directions on the screen, to the right, upwards and towards the viewer."""

    right: npt.NDArray[np.float64]
    up: npt.NDArray[np.float64]
    towards: npt.NDArray[np.float64]

    @classmethod
    def of(cls, dim: int, view: Sequence[float] | None, cut: bool) -> _View:
        """The projection for a direction; raises ModelError for one in 2D, or for a zero direction."""
        if dim == 2 and (view is not None or cut):
            raise ModelError("view and cut are for three-dimensional structures")
        towards = np.array(VIEWS[dim] if view is None else view, float)
        if towards.shape != (3,) or not np.isfinite(towards).all() or not towards.any():
            raise ModelError(f"view is {view}; it needs three components, not all zero")
        towards /= np.linalg.norm(towards)
        right = np.cross((0.0, 1.0, 0.0) if np.hypot(*towards[::2]) > 1e-6 else (0.0, 0.0, -towards[1]), towards)
        right /= np.linalg.norm(right)
        return cls(right, np.cross(towards, right), towards)

    def on_screen(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """(n, 3) coordinates of points along the three directions."""
        return points @ np.array([self.right, self.up, self.towards]).T


def _side_by_side(shapes: Mapping[str, Shape], view: _View, zoom: Sequence[float] | None, label: str) -> Picture:
    """Picture of structures in a common window, with a common colour bar."""
    x, y, _ = view.on_screen(np.concatenate([shape.points for shape in shapes.values()])).T
    x0, x1, y0, y1 = window = (*_range(x), *_range(y)) if zoom is None else tuple(zoom)
    inside = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
    values = np.concatenate([shape.values for shape in shapes.values()])
    if x.max() < x0 or x.min() > x1 or y.max() < y0 or y.min() > y1:
        raise ModelError(f"nothing to draw in the window {(x0, x1, y0, y1)}")
    seen = values if np.isnan(values[inside]).all() else values[inside]  # a window may lie inside one cell
    limits = (float(np.nanmin(seen)), float(np.nanmax(seen)))
    panel_width, height_per_width = 4.6, (y1 - y0) / (x1 - x0)
    figure = Picture(figsize=(panel_width * len(shapes), panel_width * height_per_width + 1.3), layout="constrained")
    axes = list(figure.subplots(1, len(shapes), squeeze=False)[0])
    for one, (name, shape) in zip(axes, shapes.items(), strict=True):
        one.imshow(_render(shape, limits, view, window), extent=(x0, x1, y0, y1))
        one.set_axis_off()
        one.set_title(name, fontsize=11)
    colours = ScalarMappable(Normalize(*limits), "viridis")
    bar = figure.colorbar(colours, ax=axes, orientation="horizontal", aspect=40, pad=0.02, label=label)
    bar.ax.ticklabel_format(axis="x", style="sci", scilimits=(-3, 4))
    return figure


def _range(x: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Smallest and largest value, with a margin."""
    margin = 0.04 * np.ptp(x)
    return float(x.min() - margin), float(x.max() + margin)


def _render(shape: Shape, limits: tuple[float, float], view: _View, window: Sequence[float]) -> npt.NDArray[np.uint8]:
    """Image of a structure; edges and outlines of bodies black, of the layer's parts red, the base grey."""
    x0, x1, y0, y1 = window
    size = [round(PIXELS * side / max(x1 - x0, y1 - y0)) for side in (x1 - x0, y1 - y0)]
    plotter = pyvista.Plotter(off_screen=True, window_size=size, lighting="none")
    plotter.add_light(pyvista.Light(light_type="headlight"))
    body = BODY | {"clim": limits}
    parts = [(region, body, *((RED, 2) if number < 0 else (BLACK, 1))) for number, region in shape.regions.items()]
    for mesh, look, pen, lift in parts + ([] if shape.base is None else [(shape.base, GREY, GREY, 0)]):
        outside = surface(mesh)
        plotter.add_mesh(outside, **look)
        lines = edges(outside)
        lines.points += lift * LIFT * (x1 - x0) * view.towards
        if lines.n_cells:
            plotter.add_mesh(lines, **pen)
    depth = view.on_screen(shape.points)[:, 2]
    near, far = depth.max() + (x1 - x0), depth.min() - (x1 - x0)
    centre = (x0 + x1) / 2 * view.right + (y0 + y1) / 2 * view.up
    plotter.enable_parallel_projection()
    plotter.camera_position = [centre + near * view.towards, centre + far * view.towards, view.up]
    plotter.camera.parallel_scale = (y1 - y0) / 2
    plotter.camera.clipping_range = (0.0, near - far)
    image = plotter.screenshot(return_img=True)
    plotter.close()
    return image
