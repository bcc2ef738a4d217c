"""Deformed 2D structures as triangles, lines and polygons, drawn by matplotlib."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import ListedColormap
from matplotlib.tri import Triangulation

from forms.base import Array
from geometry.topology import BoolArray, IntArray
from thinlayer.output.paraview.grid import VtkGrid
from thinlayer.output.plotting.curves import LAW_COLOUR, MESHED_COLOUR
from thinlayer.output.plotting.scene import (
    BASE_COLOUR,
    COLOUR_MAP,
    EDGE_COLOUR,
    OUTLINE_COLOUR,
    PLAIN_BODY_COLOUR,
    SYMBOL_COLOUR,
    Scene,
    Style,
    SurfaceColours,
    Symbols,
)  # fmt: skip

# number of nodes of a cell -> its nodes on the boundary in turn, in VTK's order; triangles that cover the cell
BOUNDARY_NODES = {3: (0, 1, 2), 4: (0, 1, 2, 3), 6: (0, 3, 1, 4, 2, 5), 9: (0, 4, 1, 5, 2, 6, 3, 7)}
TRIANGLES = {
    3: [(0, 1, 2)],
    4: [(0, 1, 2), (0, 2, 3)],
    6: [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)],
    9: [(8, 0, 4), (8, 4, 1), (8, 1, 5), (8, 5, 2), (8, 2, 6), (8, 6, 3), (8, 3, 7), (8, 7, 0)],
}
# widths of lines, points: edges of bodies, meshed layers, the two sides of S, a rigid base, S coloured by a field
EDGE_WIDTH, LAYER_WIDTH, SIDE_WIDTH, BASE_WIDTH, SURFACE_WIDTH = 0.7, 1.0, 0.8, 2.2, 2.8
SUPPORT_POINTS = 4.5  # size of the symbols of supports, points


class PlaneShape:
    """A deformed 2D structure; drawn displacements are those of the state times a factor, see `DeformedShape`.

    Args:
        grid: the displacement field.
        component: component of the displacement that colours show: "x", "y" or "size", the norm.
        scale: factor of the drawn displacements.
    """

    def __init__(self, grid: VtkGrid, component: str, scale: float) -> None:
        self._grid, self._values = grid, grid.component(component)
        self._x = (grid.points + scale * grid.u)[:, :2]
        self._cells = grid.nodes_of_cells

    @property
    def points(self) -> Array:
        """Drawn coordinates (n, 3), after deformation, of the nodes of the bodies and then of the rigid base."""
        return np.concatenate([np.pad(self._x, ((0, 0), (0, 1))), self._grid.base_x.reshape(-1, 3)])

    @property
    def colour_values(self) -> Array:
        """Component of the displacement (n,) that colours show, at the nodes of `points`; NaN on the rigid base."""
        return np.pad(self._values, (0, len(self.points) - len(self._values)), constant_values=np.nan)

    def draw(self, axes: Axes, scene: Scene, symbols: Symbols | None, surface: SurfaceColours | None) -> None:
        """Draw the structure in the scene's window, see `DeformedShape.draw`.

        Lines are black at edges of bodies, orange around meshed layers, blue at both sides of S; a rigid base is grey.
        """
        triangles = self._cells[:, TRIANGLES[self._cells.shape[1]]].reshape(-1, 3)
        low, high = scene.colour_limits
        colours: Style = {"cmap": COLOUR_MAP if surface is None else ListedColormap([PLAIN_BODY_COLOUR])}
        colours |= {"shading": "gouraud", "vmin": low, "vmax": high, "rasterized": True}
        axes.tripcolor(Triangulation(self._x[:, 0], self._x[:, 1], triangles), self._values, **colours)
        ends = self._grid.base_x[:, :2, :2]  # in VTK's order the ends of an edge come first
        axes.add_collection(LineCollection([*ends], colors=BASE_COLOUR, linewidths=BASE_WIDTH))
        edges, is_of_layer, is_on_seam = self._edges()
        for mask, colour, width in (
            (~is_of_layer & ~is_on_seam, EDGE_COLOUR if surface is None else OUTLINE_COLOUR, EDGE_WIDTH),
            (is_on_seam & ~is_of_layer, LAW_COLOUR if surface is None else OUTLINE_COLOUR, SIDE_WIDTH),
            (is_of_layer, MESHED_COLOUR, LAYER_WIDTH),
        ):
            lines = LineCollection([*self._x[edges[mask]]], colors=colour, linewidths=width, capstyle="round")
            axes.add_collection(lines)
        if surface is not None:
            _draw_surface(axes, surface)
        if symbols is not None:
            _draw_symbols(axes, symbols)

    def _edges(self) -> tuple[IntArray, BoolArray, BoolArray]:
        """Return the edges (n, 2) of regions, and masks (n,) of those of meshed layers and of those on S."""
        loop = list(BOUNDARY_NODES[self._cells.shape[1]])
        pairs = np.sort(np.stack([self._cells[:, loop], self._cells[:, np.roll(loop, -1)]], axis=-1), axis=-1)
        region = np.broadcast_to(self._grid.region[:, None, None], (*pairs.shape[:2], 1))
        keys, counts = np.unique(np.concatenate([region, pairs], axis=-1).reshape(-1, 3), axis=0, return_counts=True)
        edges = keys[counts == 1]
        return edges[:, 1:], edges[:, 0] < 0, self._grid.is_coincident()[edges[:, 1:]].all(axis=1)


def _draw_surface(axes: Axes, surface: SurfaceColours) -> None:
    """Draw the areas between the two sides of S, and lines half-way between them, each part in its mean colour."""
    lower, upper, rgba = surface.parts()
    colours, areas = rgba.mean(axis=1), np.concatenate([lower, upper[:, ::-1]], axis=1)
    axes.add_collection(PolyCollection([*areas], facecolors=colours, edgecolors=colours, linewidths=0.2))
    axes.add_collection(LineCollection([*(lower + upper) / 2], colors=colours, linewidths=SURFACE_WIDTH))


def _draw_symbols(axes: Axes, symbols: Symbols) -> None:
    """Draw arrows of loads, and triangles and circles where supports prescribe all components or some."""
    first, last = symbols.arrows[:, 0, :2].T, symbols.arrows[:, 1, :2].T
    arrow: Style = {"angles": "xy", "scale_units": "xy", "scale": 1, "units": "inches", "width": 0.014}
    axes.quiver(*first, *(last - first), color=SYMBOL_COLOUR, zorder=3, **arrow)
    support: Style = {"markersize": SUPPORT_POINTS, "color": "white", "markeredgecolor": SYMBOL_COLOUR, "zorder": 3}
    for points, marker in ((symbols.fixed, "^"), (symbols.guided, "o")):
        axes.plot(*points[:, :2].T, marker, **support)
