"""Views of deformed structures: direction, window, factor of displacements, range of colours, loads and supports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from scipy.spatial import cKDTree

from forms.base import Array, InputError, import_optional, is_finite, require
from forms.temperature import finite_values
from geometry.refusals import place_text
from geometry.topology import IntArray, place_order
from thinlayer.output.paraview.grid import VtkGrid
from thinlayer.output.plotting.picture import AxesInput, make_panels

DRAWN_DISPLACEMENT_RATIO = 0.05  # largest drawn displacement, over the size of the structure
DEFAULT_TOWARDS = {2: (0.0, 0.0, 1.0), 3: (0.55, 0.45, 1.0)}  # dimension -> direction to the viewer
SYMBOL_SPACING = 0.06  # distance of symbols of loads and supports, and length of arrows, over the picture's size
ZERO_FORCE_RATIO = 1e-6  # largest nodal force that counts as zero, over the largest of all
SMALLEST_FORCE_RATIO = 0.1  # smallest nodal force that is drawn, over the median: corners of cells may have little
Style = dict[str, Any]  # arguments of pyvista's add_mesh, or of matplotlib
COLOUR_BAR_STYLE: Style = {"orientation": "horizontal", "aspect": 40, "shrink": 0.6, "pad": 0.02}
# Colours of displacements, edges of bodies, a rigid base, bodies below a field on S and their edges, loads and supports
COLOUR_MAP, EDGE_COLOUR, BASE_COLOUR = "viridis", "black", "dimgrey"
PLAIN_BODY_COLOUR, OUTLINE_COLOUR, SYMBOL_COLOUR = "#ece5da", "#6b6256", "#3b3b3b"

Window = tuple[float, float, float, float]
PANEL_INCHES = 4.6  # width of a structure in a picture, inches


@dataclass(frozen=True)
class View:
    """Settings of pictures of structures: colours, scale of displacements, window and direction of view.

    Attributes:
        component: what the colours show: the component "x", "y" or "z" of the displacement, or "size", its norm. A scalar
            field has no components.
        scale: factor by which drawn displacements are enlarged. None: the largest is drawn as a twentieth of the
            structure's size.
        unit: name of the unit of displacements, or of a scalar field, for the colour bar.
        zoom: (left, right, bottom, top), the bounds of the window, in coordinates of the deformed structure as drawn.
            In 2D these are x and y, in 3D distances from the origin to the right and up in the picture. None: the whole
            structure.
        towards: vector (3,) from the structure to the viewer, only in 3D. None: the viewer is in front, z > 0, to the
            right and above. The axis y points up in the picture; in a view from directly above, -z points up.
        cut: whether to cut a 3D structure at its middle in z and draw only the half away from the viewer. S inside is
            then visible.
        symbols: whether to draw loads as arrows of one length, but not those of scalar fields, and supports. These are
            triangles, in 3D cubes, where they prescribe all components of the displacement; elsewhere circles, in 3D
            balls.

    Raises:
        InputError: a scale that is no finite number, or an invalid window.
    """

    component: str = "size"
    scale: float | None = None
    unit: str = ""
    zoom: Sequence[float] | None = None
    towards: Sequence[float] | None = None
    cut: bool = False
    symbols: bool = True

    def __post_init__(self) -> None:
        require(self.scale is None or is_finite(self.scale), "scale", self.scale, "it must be a finite number")
        if self.zoom is not None:
            _checked_window(self.zoom)


@dataclass(frozen=True)
class SurfaceColours:
    """Colours of S in a picture, at the k corners of its n facets.

    Attributes:
        lower, upper: (n, k, d) drawn coordinates of the corners on both sides of S, in d dimensions.
        values: (n, k) values of a field there.
        colours: map from these values to colours.
        smooth: True: values are linear between the corners. False: each facet is divided into one part around each
            corner, which has the corner's colour. This is for words.
    """

    lower: Array
    upper: Array
    values: Array
    colours: ScalarMappable
    smooth: bool

    def parts(self) -> tuple[Array, Array, Array]:
        """Divide facets into one part around each corner, bounded by p points: 2 of a line, 4 of other facets.

        Returns:
            (n * k, p, d) coordinates of the parts on the lower and on the upper side; (n * k, p, 4) red, green, blue
            and opacity.
        """
        order = [0, 1, 3, 2] if self.values.shape[1] == 4 else [*range(self.values.shape[1])]
        values = interpolate_to_parts(self.values[:, order])
        if not self.smooth:
            values = np.repeat(self.values[:, order, None], values.shape[2], axis=2)
        rgba = self.colours.to_rgba(np.ma.masked_invalid(values.ravel())).reshape(-1, values.shape[2], 4)
        lower, upper = (interpolate_to_parts(x[:, order]) for x in (self.lower, self.upper))
        return lower.reshape(-1, *lower.shape[2:]), upper.reshape(-1, *upper.shape[2:]), rgba


def interpolate_to_parts(values: Array) -> Array:
    """Divide facets into one part around each corner, and interpolate values to the p points that bound each part.

    Lines have p = 2 points in each part, the corner and the middle of the line. Other facets have p = 4: the corner,
    the middle of the next edge, the centre of the facet, and the middle of the edge before.

    Args:
        values: (n, k, ...) values at the k corners of n facets, in the order around the facet.

    Returns:
        (n, k, p, ...) values at the p points of each part.
    """
    centre = np.broadcast_to(values.mean(axis=1, keepdims=True), values.shape)
    edge_means = (values + np.roll(values, -1, axis=1)) / 2
    bounds = [values, centre] if values.shape[1] == 2 else [values, edge_means, centre, np.roll(edge_means, 1, axis=1)]
    return np.stack(bounds, axis=2)


@dataclass(frozen=True)
class Symbols:
    """Places where symbols stand for loads and supports, far enough from one another.

    Attributes:
        length: length of the arrows.
        arrows: (n, 2, 3) first and last points of arrows in the direction of the loads.
        fixed, guided: (m, 3) places where supports prescribe all components of the displacement, or some.
    """

    length: float
    arrows: Array
    fixed: Array
    guided: Array

    @classmethod
    def of(cls, grid: VtkGrid, factor: float, size: float) -> Symbols:
        """Choose the places on a deformed structure.

        Arrows end at nodes that are pushed into their cells, and start at other nodes.

        Args:
            grid: displacements, loads and supports.
            factor: factor of the drawn displacements.
            size: length of the longer side of the picture.
        """
        points, length, cells = grid.points + factor * grid.u, SYMBOL_SPACING * size, grid.nodes_of_cells
        forces, is_fixed = np.linalg.norm(grid.loads, axis=1), grid.is_fixed
        is_loaded = forces > ZERO_FORCE_RATIO * forces.max()
        is_loaded &= forces >= SMALLEST_FORCE_RATIO * np.median(forces[is_loaded]) if is_loaded.any() else False
        masks = is_loaded, is_fixed, (grid.n_supported > 0) & ~is_fixed
        loaded, *supported = (np.flatnonzero(mask)[_far_apart(grid.points[mask], length)] for mask in masks)
        steps = length * grid.loads[loaded] / forces[loaded, None]
        inward = np.zeros_like(points)  # sums of vectors from a node to the centres of its cells
        np.add.at(inward, cells, grid.points[cells].mean(axis=1, keepdims=True) - grid.points[cells])
        is_pushed = np.einsum("ij,ij->i", inward[loaded], steps) > 0
        first = np.where(is_pushed[:, None], points[loaded] - steps, points[loaded])
        return cls(length, np.stack([first, first + steps], axis=1), *(points[nodes] for nodes in supported))


def _far_apart(x: Array, distance: float) -> IntArray:
    """Choose places (n, 3) that have at least a distance from one another; return their positions in `x`."""
    order = place_order(x, distance)
    _, first = np.unique(np.floor(2 * x[order] / distance), axis=0, return_index=True)  # few places of many
    candidates = order[np.sort(first)]
    neighbours = cKDTree(x[candidates]).query_ball_point(x[candidates], distance * (1 - 1e-9)) if len(x) else []
    chosen, is_free = list[int](), np.ones(len(candidates), bool)
    for k, near in enumerate(neighbours):
        if is_free[k]:
            chosen.append(k)
            is_free[near] = False
    return candidates[chosen]


class DeformedShape(Protocol):
    """A deformed structure that can be drawn in axes of matplotlib."""

    @property
    def points(self) -> Array:
        """Drawn coordinates (n, 3), after deformation, of the nodes of the bodies and then of the rigid base."""

    @property
    def colour_values(self) -> Array:
        """Component of the displacement (n,) that colours show, at the nodes of `points`; NaN on the rigid base."""

    def draw(self, axes: Axes, scene: Scene, symbols: Symbols | None, surface: SurfaceColours | None) -> None:
        """Draw the structure in a scene's window, with its loads and supports.

        Args:
            axes: the axes.
            scene: window, range of colours and direction of view.
            symbols: symbols of loads and supports; None: they are not drawn.
            surface: colours of S. Bodies then have one colour, in 3D only edges. None: bodies are coloured by
                displacement.
        """


def _view_axes(dim: int, view: View) -> Array:
    """Return a matrix (3, 3), whose rows are unit vectors to the right, upwards and towards the viewer of a picture.

    Args:
        dim: number of dimensions of the structure.
        view: the user's settings.

    Raises:
        InputError: `view.towards` is invalid; `view` has a direction or a cut, but the structure is 2D.
    """
    if dim == 2 and (view.towards is not None or view.cut):
        raise InputError("towards and cut are for three-dimensional structures")
    towards = finite_values(DEFAULT_TOWARDS[dim] if view.towards is None else view.towards, (3,))
    if towards is None or not towards.any():
        raise InputError(f"towards is {view.towards}; it must have three components, not all zero")
    towards /= np.linalg.norm(towards)
    right = np.cross((0.0, 1.0, 0.0) if np.hypot(*towards[::2]) > 1e-6 else (0.0, 0.0, -towards[1]), towards)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(towards, right), towards])


@dataclass(frozen=True)
class Scene:
    """Common window, scale and range of colours for images of several structures, or of one structure in time.

    Attributes:
        view: the user's settings.
        axes: (3, 3) matrix, whose rows are unit vectors to the right, upwards and towards the viewer.
        displacement_factor: factor of the drawn displacements.
        window: (left, right, bottom, top), the bounds of the images along the first two axes, in deformed coordinates
            as drawn.
        colour_limits: smallest and largest displacement, or component of it, in the range of colours.
        symbol: symbol of what colours show.
        is_deformed: whether displacements are drawn, not a scalar field on undeformed bodies.
    """

    view: View
    axes: Array
    displacement_factor: float
    window: Window = (0.0, 0.0, 0.0, 0.0)
    colour_limits: tuple[float, float] = (0.0, 0.0)
    symbol: str = ""
    is_deformed: bool = True

    @classmethod
    def of(cls, grids: Sequence[VtkGrid], view: View) -> Scene:
        """Choose window, scale and range of colours for displacement fields.

        Args:
            grids: the fields. All of them lie in the window, unless the user has chosen a window, `view.zoom`.
            view: the user's settings.

        Raises:
            InputError: an unknown component; an invalid direction; a direction or cut for a 2D structure; a window with
                no structure in it.
        """
        axes = _view_axes(grids[0].dim, view)
        largest_u = max(np.linalg.norm(grid.u, axis=1).max() for grid in grids)
        factor = DRAWN_DISPLACEMENT_RATIO * np.ptp(grids[0].points, axis=0).max() / largest_u if largest_u > 0 else 1.0
        is_deformed, component = grids[0].value is None, view.component
        symbol = grids[0].symbol if not is_deformed else "|u|" if component == "size" else f"u_{component}"
        scale = (factor if view.scale is None else view.scale) * is_deformed
        scene = cls(view, axes, float(scale), symbol=symbol, is_deformed=is_deformed)
        shapes = [scene.shape(grid) for grid in grids]
        x, y, _ = axes @ np.concatenate([shape.points for shape in shapes]).T
        arrows = [symbols.arrows.reshape(-1, 3) for grid in grids if (symbols := scene.symbols(grid))]
        drawn_x, drawn_y, _ = axes @ np.concatenate([*arrows, *(shape.points for shape in shapes)]).T
        whole = (*_padded(drawn_x), *_padded(drawn_y))
        x0, x1, y0, y1 = window = whole if view.zoom is None else _checked_window(view.zoom)
        is_inside = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
        values = np.concatenate([shape.colour_values for shape in shapes])
        if x.max() < x0 or x.min() > x1 or y.max() < y0 or y.min() > y1:
            raise InputError(f"zoom {place_text(window)} has nothing to draw; the structure is in {place_text(whole)}")
        visible = values if np.isnan(values[is_inside]).all() else values[is_inside]  # a window may lie inside one cell
        return replace(scene, window=window, colour_limits=(float(np.nanmin(visible)), float(np.nanmax(visible))))

    def shape(self, grid: VtkGrid) -> DeformedShape:
        """Return the deformed structure of a displacement field, as matplotlib draws it in 2D and VTK in 3D."""
        if grid.dim == 2:
            from thinlayer.output.plotting.plane_shape import PlaneShape

            return PlaneShape(grid, self.view.component, self.displacement_factor)
        shape: DeformedShape = import_optional("thinlayer.output.plotting.solid_shape").SolidShape.of(grid, self)
        return shape

    def symbols(self, grid: VtkGrid) -> Symbols | None:
        """Return the symbols of loads and supports; None if the user does not want them."""
        if not self.view.symbols:
            return None
        zoom = self.view.zoom
        size = np.ptp(grid.points, axis=0).max() if zoom is None else max(zoom[1] - zoom[0], zoom[3] - zoom[2])
        return Symbols.of(grid, self.displacement_factor, float(size))

    def draw(self, axes: Axes, grid: VtkGrid, surface: SurfaceColours | None = None) -> None:
        """Draw a structure in axes that show this scene's window.

        Args:
            axes: the axes.
            grid: displacements, loads and supports of the structure.
            surface: colours of S, see `DeformedShape.draw`.
        """
        self.shape(grid).draw(axes, self, self.symbols(grid), surface)
        axes.set(xlim=self.window[:2], ylim=self.window[2:], aspect="equal")

    def panels(self, n: int, ax: AxesInput = None) -> list[Axes]:
        """Return axes for `n` structures side by side, those of the user or of a new picture, without frames."""
        x0, x1, y0, y1 = self.window
        inches = (PANEL_INCHES * n, PANEL_INCHES * (y1 - y0) / (x1 - x0) + 1.3)
        panels = make_panels(ax, (1, n), n, inches)
        for axes in panels:
            axes.set_axis_off()
        return panels

    def draw_colour_bar(self, panels: list[Axes]) -> None:
        """Draw a colour bar for the displacements below the panels of a picture."""
        largest = np.abs(self.colour_limits).max()
        power = 0 if largest == 0 or 0.01 <= largest < 1e4 else 3 * int(np.floor(np.log10(largest) / 3))
        unit = f"10^{power} {self.view.unit}" if power else self.view.unit
        quantity = f"{self.symbol} ({unit.strip()})" if unit else self.symbol
        low, high = (limit * 10.0**-power for limit in self.colour_limits)
        mappable = ScalarMappable(Normalize(low, high), COLOUR_MAP)
        panels[0].figure.colorbar(
            mappable, ax=panels, **COLOUR_BAR_STYLE, label="; ".join(filter(None, [quantity, self.factor_text]))
        )

    @property
    def factor_text(self) -> str:
        """Text for the colour bar with the factor of the drawn displacements, as "displacements drawn 50 times"."""
        if not self.is_deformed:
            return ""
        return f"displacements drawn {self.displacement_factor:.3g} times".replace("drawn 1 times", "as they are")


def _padded(x: Array) -> tuple[float, float]:
    """Return the range (smallest, largest) of the values `x`, enlarged at both ends by 4 % of its length."""
    margin = 0.04 * np.ptp(x)
    return float(x.min() - margin), float(x.max() + margin)


def _checked_window(zoom: object) -> Window:
    """Return the user's window `zoom` as (left, right, bottom, top) in floats.

    Raises:
        InputError: it is not four finite numbers with left < right and bottom < top.
    """
    bounds = finite_values(zoom, (4,))
    if bounds is None or not (bounds[0] < bounds[1] and bounds[2] < bounds[3]):
        raise InputError(f"zoom is {zoom!r}; it must be (left, right, bottom, top), left < right and bottom < top")
    left, right, bottom, top = map(float, bounds)
    return left, right, bottom, top
