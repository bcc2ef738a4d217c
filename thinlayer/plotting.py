"""Pictures: rates and curves from tables (matplotlib), deformed structures (pyvista, off screen)."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

if not os.environ.get("DISPLAY"):  # without an X server VTK otherwise tries one first, and warns
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")

import numpy as np
import numpy.typing as npt
import pyvista
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from mpi4py import MPI

from geometry.parallel import on_root
from thinlayer.fields import Grid, gather
from thinlayer.state import State
from thinlayer.table import Table

SAVED: dict[str, Any] = {"dpi": 150, "bbox_inches": "tight"}
SUBDIVISION = 3  # of curved cells, for drawing
LARGEST = 0.05  # drawn displacement, in units of the structure
COLOURS = ("#1b6ca8", "#d1495b", "#2e933c", "#8f5ea2", "#c77d0a")
MARKERS = ("o", "s", "^", "D", "v")


def rates(
    table: Table | str | Path, *, save: str | Path | None = None, title: str = "", reference: float = 1.0
) -> Figure:
    """Errors of a sweep against eps on logarithmic axes, with a reference slope.

    Args:
        table: a sweep, or the csv file it was committed to.
        save: PNG file.
        title: title of the picture.
        reference: order of the reference line.
    """
    data = table if isinstance(table, Table) else Table.load(table)
    figure, axes = _figure(6, 4.5)
    eps = data["eps"]
    errors = {"traction": data["error_traction"], "jump": data["error_jump"]}
    for (name, error), colour, marker in zip(errors.items(), COLOURS, MARKERS, strict=False):
        axes.loglog(eps, error, marker=marker, color=colour, label=name)
    lowest = min(errors.values(), key=lambda e: e[-1])
    line = 0.6 * lowest[-1] * (eps / eps[-1]) ** reference
    axes.loglog(eps, line, color="0.5", linestyle="--", label=f"slope {reference:g}")
    axes.set(xlabel="layer thickness eps", ylabel="relative difference on S, L2", title=title)
    axes.set_xticks(eps, [f"{e:.4g}" for e in eps])
    axes.minorticks_off()
    axes.grid(color="0.9")
    axes.legend(frameon=False)
    return _finish(figure, save)


def curves(
    lines: Mapping[str, tuple[Any, Any]],
    *,
    xlabel: str,
    ylabel: str,
    title: str = "",
    save: str | Path | None = None,
    styles: Mapping[str, str] | None = None,
    logarithmic: bool = False,
    ylim: tuple[float, float] | None = None,
) -> Figure:
    """Curves over a common axis.

    Args:
        lines: label -> (x, y).
        xlabel, ylabel, title: texts, units included.
        save: PNG file.
        styles: label -> line style (default "-").
        logarithmic: whether both axes are.
        ylim: range of the second axis.
    """
    figure, axes = _figure(6.5, 4.5)
    for k, (label, (x, y)) in enumerate(lines.items()):
        style = (styles or {}).get(label, "-")
        axes.plot(x, y, style, color=COLOURS[k % len(COLOURS)], label=label)
    if logarithmic:
        axes.set(xscale="log", yscale="log")
    axes.set(xlabel=xlabel, ylabel=ylabel, title=title)
    if ylim:
        axes.set_ylim(*ylim)
    axes.grid(color="0.9")
    axes.legend(frameon=False)
    return _finish(figure, save)


def _figure(width: float, height: float) -> tuple[Figure, Axes]:
    """A picture with one set of axes; outside pyplot, so that a notebook keeps its own backend."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots()


def _finish(figure: Figure, save: str | Path | None) -> Figure:
    if save and MPI.COMM_WORLD.rank == 0:
        figure.savefig(_folder(save), **SAVED)
    return figure


def _folder(path: str | Path) -> Path:
    """The path, its folder made."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    return Path(path)


def deformed(
    states: Mapping[str, State] | State,
    *,
    save: str | Path,
    component: str = "size",
    scale: float | None = None,
    title: str = "",
    unit: str = "",
    zoom: Sequence[float] | None = None,
) -> None:
    """Deformed structures side by side, coloured by displacement, with the layer (or the jump across S) visible.

    Args:
        states: label -> state, or one state. Collective.
        save: PNG file.
        component: "size", "x", "y" or "z".
        scale: factor of the displacements (default: the largest is a twentieth of the structure).
        title: text over the picture.
        unit: unit of the displacements, for the colour bar.
        zoom: (x_min, x_max, y_min, y_max) part to show, in deformed coordinates.
    """
    panels = {"": states} if isinstance(states, State) else dict(states)
    grids = {label: gather(state) for label, state in panels.items()}
    comm = next(iter(panels.values())).model.comm
    on_root(comm, lambda: _draw_deformed(grids, component, scale, title, unit, zoom).savefig(_folder(save), **SAVED))


def _draw_deformed(
    grids: Mapping[str, Grid],
    component: str,
    scale: float | None,
    title: str,
    unit: str,
    zoom: Sequence[float] | None,
) -> Figure:
    first = next(iter(grids.values()))
    largest = max(np.linalg.norm(g.u, axis=1).max() for g in grids.values())
    scale = scale or (LARGEST * np.ptp(first.points, axis=0).max() / largest if largest > 0 else 1.0)
    values = {label: _component(grid, component) for label, grid in grids.items()}
    places = np.concatenate([g.points + scale * g.u for g in grids.values()])
    x0, x1, y0, y1 = zoom or (*_range(places[:, 0]), *_range(places[:, 1]))
    x, y = places[:, 0], places[:, 1]
    seen = np.concatenate(list(values.values()))[(x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)]
    if not len(seen):
        raise ValueError(f"nothing to draw in the window {(x0, x1, y0, y1)}")
    limits = (float(seen.min()), float(seen.max()))
    height_per_width = (y1 - y0) / (x1 - x0)
    panel_width = 4.6
    figure = Figure(figsize=(panel_width * len(grids), panel_width * height_per_width + 1.3), layout="constrained")
    axes = list(figure.subplots(1, len(grids), squeeze=False)[0])
    for one, (label, grid) in zip(axes, grids.items(), strict=True):
        one.imshow(_render(grid, values[label], limits, scale, (x0, x1, y0, y1)), extent=(x0, x1, y0, y1))
        one.set_axis_off()
        one.set_title(label, fontsize=11)
    name = ("|u|" if component == "size" else f"u_{component}") + (f" ({unit})" if unit else "")
    colours = ScalarMappable(Normalize(*limits), "viridis")
    figure.colorbar(
        colours,
        ax=axes,
        orientation="horizontal",
        aspect=40,
        pad=0.02,
        label=f"{name}; drawn displacements x {scale:.3g}",
    )
    if title:
        figure.suptitle(title)
    return figure


def _range(x: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Smallest and largest value, with a margin."""
    margin = 0.04 * np.ptp(x)
    return float(x.min() - margin), float(x.max() + margin)


def _component(grid: Grid, component: str) -> npt.NDArray[np.float64]:
    if component == "size":
        return np.linalg.norm(grid.u, axis=1)
    if component not in ("x", "y", "z"):
        raise ValueError(f"unknown component {component!r}; allowed: size, x, y, z")
    return grid.u[:, "xyz".index(component)]


def _render(
    grid: Grid, values: npt.NDArray[np.float64], limits: tuple[float, float], scale: float, window: Sequence[float]
) -> npt.NDArray[np.uint8]:
    """Image of a deformed structure in its plane; outlines of bodies black, of the layer's parts red, the base grey."""
    x0, x1, y0, y1 = window
    pixels = 1400 / max(x1 - x0, y1 - y0)
    plotter = pyvista.Plotter(off_screen=True, window_size=[round(pixels * (x1 - x0)), round(pixels * (y1 - y0))])
    mesh = pyvista.UnstructuredGrid(grid.cells, grid.types, grid.points + scale * grid.u)
    mesh.point_data["u"] = values
    for number in np.unique(grid.region)[::-1]:
        part = mesh.extract_cells(grid.region == number)
        surface = part.extract_surface(algorithm=None, nonlinear_subdivision=SUBDIVISION).clean()
        plotter.add_mesh(surface, scalars="u", clim=limits, cmap="viridis", show_scalar_bar=False, lighting=False)
        outline = surface.extract_feature_edges(
            boundary_edges=True, feature_edges=False, manifold_edges=False, non_manifold_edges=False
        )
        outline.points[:, 2] += 0.01 * (x1 - x0)  # in front of the base, which would cover a very thin layer
        plotter.add_mesh(outline, color="crimson" if number < 0 else "black", line_width=4 if number < 0 else 3)
    if len(grid.base):
        plotter.add_lines(grid.base.reshape(-1, 3), color="dimgrey", width=8)
    plotter.enable_parallel_projection()
    plotter.camera.focal_point = ((x0 + x1) / 2, (y0 + y1) / 2, 0.0)
    plotter.camera.position = ((x0 + x1) / 2, (y0 + y1) / 2, 10 * (x1 - x0))
    plotter.camera.up = (0.0, 1.0, 0.0)
    plotter.camera.parallel_scale = (y1 - y0) / 2
    plotter.camera.clipping_range = (0.1 * (x1 - x0), 100 * (x1 - x0))
    image = plotter.screenshot(return_img=True)
    plotter.close()
    return image
