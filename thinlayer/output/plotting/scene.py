"""Views of deformed structures: direction, window, factor of displacements and range of colours; images of them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from forms.base import Array, InputError, require

if not os.environ.get("DISPLAY"):  # without an X server VTK would try to use one, and warn
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")

import numpy as np
import numpy.typing as npt
import pyvista
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from forms.base import is_finite
from forms.temperature import finite_values
from thinlayer.output.paraview.grid import VtkGrid
from thinlayer.output.plotting.picture import Picture

DRAWN_DISPLACEMENT_RATIO = 0.05  # largest drawn displacement, over the size of the structure
DEFAULT_TOWARDS = {2: (0.0, 0.0, 1.0), 3: (0.55, 0.45, 1.0)}  # dimension -> direction to the viewer
LINE_LIFT = 0.004  # shift of lines towards the viewer, over the picture's width, so that surfaces do not hide them
LONG_SIDE_PIXELS = 1400  # length of the longer side of an image
Style = dict[str, Any]  # arguments of pyvista's add_mesh, or of matplotlib
LAYER_STYLE: Style = {"color": "crimson", "line_width": 4, "lighting": False}
SEAM_STYLE: Style = LAYER_STYLE | {"line_width": 2}  # the two sides of S
EDGE_STYLE: Style = {"color": "black", "line_width": 3, "lighting": False}
BASE_STYLE: Style = {"color": "dimgrey", "line_width": 8, "lighting": False}
DISPLACEMENT_LIGHT = {"ambient": 0.7, "diffuse": 0.3}
DISPLACEMENT_STYLE: Style = {"scalars": "u", "cmap": "viridis", "show_scalar_bar": False} | DISPLACEMENT_LIGHT
PLAIN_BODY_STYLE: Style = {"color": "#ece5da", "lighting": False}
OUTLINE_STYLE: Style = {"color": "#6b6256", "line_width": 2, "lighting": False}
SURFACE_STYLE: Style = {"scalars": "rgb", "rgb": True, "line_width": 12, "lighting": False}
COLOUR_BAR_STYLE: Style = {"orientation": "horizontal", "aspect": 40, "shrink": 0.6, "pad": 0.02}
PLACE_DECIMALS = 9  # decimals of coordinates, over the structure's size, that distinguish nodes

SUBDIVISION_LEVEL = 3  # subdivision level of curved cells
SHARP_ANGLE_DEGREES = 30.0  # least angle between faces whose common edge is drawn, degrees
SPLIT_FACTOR = 0.999  # factor of displacements that separates the two sides of S, so that VTK does not merge them
CUT_OFFSET = 1e-3  # distance of a cut from the middle, over the structure's size, so that it avoids faces of cells

Window = tuple[float, float, float, float]
PANEL_INCHES = 4.6  # width of a structure in a picture, inches


@dataclass(frozen=True)
class View:
    """Settings of pictures of structures: colours, scale of displacements, window and direction of view.

    Attributes:
        component: what the colours show: the component "x", "y" or "z" of the displacement, or "size", its norm.
        scale: factor by which drawn displacements are enlarged. None: the largest is drawn as a twentieth of the
            structure's size.
        unit: name of the unit of displacements, for the colour bar.
        zoom: (left, right, bottom, top), the bounds of the window, in coordinates of the deformed structure as drawn.
            In 2D these are x and y, in 3D distances from the origin to the right and up in the picture. None: the whole
            structure.
        towards: vector (3,) from the structure to the viewer, only in 3D. None: the viewer is in front, z > 0, to the
            right and above. The axis y points up in the picture; in a view from directly above, -z points up.
        cut: whether to cut a 3D structure at its middle in z and draw only the half away from the viewer. S inside is
            then visible.

    Raises:
        InputError: a scale that is no finite number, or an invalid window.
    """

    component: str = "size"
    scale: float | None = None
    unit: str = ""
    zoom: Sequence[float] | None = None
    towards: Sequence[float] | None = None
    cut: bool = False

    def __post_init__(self) -> None:
        require(self.scale is None or is_finite(self.scale), "scale", self.scale, "it must be a finite number")
        if self.zoom is not None:
            _checked_window(self.zoom)


@dataclass(frozen=True)
class DeformedShape:
    """A deformed structure as VTK grids to draw; drawn displacements are those of the state times a factor.

    Attributes:
        regions: number of a region -> its cells in deformed positions. Regions of meshed layers have negative numbers
            and are last. Data at the n nodes of a grid: "u" (n,), the component of the displacement that colours show;
            "moved" (n, 3), the drawn displacement; "coincident" (n,), 1 where two nodes coincide before deformation, as
            on both sides of S, else 0.
        base: facets where the structure lies on a rigid base; None if there is a body on both sides of S.
        cut_plane: {"normal": unit vector, "origin": point} of the plane that cuts the structure; None: it is not cut.
    """

    regions: dict[int, pyvista.UnstructuredGrid]
    base: pyvista.UnstructuredGrid | None
    cut_plane: dict[str, Any] | None = None

    @classmethod
    def of(cls, grid: VtkGrid, component: str, scale: float, normal: Sequence[float] | None = None) -> DeformedShape:
        """Make the deformed structure of a displacement field.

        Args:
            grid: the displacement field.
            component: component of the displacement that colours show: "x", "y", "z" or "size", the norm.
            scale: factor of the drawn displacements.
            normal: unit vector (3,). The structure is cut through its middle, normal to this vector, and the half to
                which it points is left out. None: the structure is not cut.
        """
        mesh = pyvista.UnstructuredGrid(grid.cells, grid.cell_codes, grid.points + scale * grid.u)
        # the factor pi avoids coordinates half-way between two decimals, which rounding errors would separate
        rounded_points = np.round(np.pi / np.ptp(grid.points) * grid.points, PLACE_DECIMALS)
        _, place_of_node, counts = np.unique(rounded_points, axis=0, return_inverse=True, return_counts=True)
        is_coincident = (counts[place_of_node.ravel()] > 1).astype(float)
        mesh.point_data.update({"u": grid.component(component), "moved": scale * grid.u, "coincident": is_coincident})
        grids = {int(number): mesh.extract_cells(grid.region == number) for number in np.unique(grid.region)[::-1]}
        n, k = grid.base_x.shape[:2]
        cells = np.insert(np.arange(n * k).reshape(n, k), 0, k, axis=1)
        base = pyvista.UnstructuredGrid(cells, np.full(n, grid.base_code), grid.base_x.reshape(-1, 3)) if n else None
        if base is not None:
            base.point_data.update({"moved": np.zeros(base.points.shape), "coincident": np.zeros(base.n_points)})
        if normal is None:
            return cls(grids, base)
        low, high = grid.points.min(axis=0), grid.points.max(axis=0)
        plane = {"normal": normal, "origin": (low + high) / 2 + CUT_OFFSET * (high - low).max() * np.asarray(normal)}
        regions = {number: clipped for number, part in grids.items() if (clipped := part.clip(**plane)).n_cells}
        return cls(regions, base.clip(**plane) if base is not None else None, plane)

    @property
    def points(self) -> Array:
        """Drawn coordinates (n, 3), after deformation, of the nodes of all regions and then of the rigid base."""
        return np.concatenate([mesh.points for mesh in (*self.regions.values(), self.base) if mesh is not None])

    @property
    def colour_values(self) -> Array:
        """Component of the displacement (n,) that colours show, at the nodes of `points`; NaN on the rigid base."""
        values = np.concatenate([part["u"] for part in self.regions.values()])
        return np.pad(values, (0, 0 if self.base is None else self.base.n_points), constant_values=np.nan)


def outer_surface(mesh: pyvista.UnstructuredGrid) -> pyvista.PolyData:
    """Return the outer surface of a 3D mesh, or a 2D mesh itself; each curved face is divided into flat ones."""
    return mesh.extract_surface(algorithm=None, nonlinear_subdivision=SUBDIVISION_LEVEL)


def sharp_edges(surface: pyvista.PolyData) -> pyvista.PolyData:
    """Return the lines to draw on a surface: its boundary, and edges where its faces meet at more than 30 degrees.

    The angle is that between the faces' normals before deformation. The lines are in deformed positions.

    Args:
        surface: flat faces in deformed positions, with the drawn displacements (n, 3) of the nodes as point data
            "moved".
    """
    undeformed = surface.copy()
    undeformed.points -= SPLIT_FACTOR * surface["moved"]
    if not surface.n_lines:
        undeformed = undeformed.compute_normals(point_normals=False)  # orients faces consistently, for their angles
    lines = undeformed.extract_feature_edges(SHARP_ANGLE_DEGREES, manifold_edges=False, non_manifold_edges=False)
    if lines.n_cells:
        lines.points += SPLIT_FACTOR * lines["moved"]
    return lines


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
    """

    view: View
    axes: Array
    displacement_factor: float
    window: Window = (0.0, 0.0, 0.0, 0.0)
    colour_limits: tuple[float, float] = (0.0, 0.0)

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
        scene = cls(view, axes, float(factor if view.scale is None else view.scale))
        shapes = [scene.deformed_shape(grid) for grid in grids]
        x, y, _ = axes @ np.concatenate([shape.points for shape in shapes]).T
        x0, x1, y0, y1 = window = (*_padded(x), *_padded(y)) if view.zoom is None else _checked_window(view.zoom)
        is_inside = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
        values = np.concatenate([shape.colour_values for shape in shapes])
        if x.max() < x0 or x.min() > x1 or y.max() < y0 or y.min() > y1:
            raise InputError(f"nothing to draw in the window {(x0, x1, y0, y1)}")
        visible = values if np.isnan(values[is_inside]).all() else values[is_inside]  # a window may lie inside one cell
        return replace(scene, window=window, colour_limits=(float(np.nanmin(visible)), float(np.nanmax(visible))))

    def deformed_shape(self, grid: VtkGrid) -> DeformedShape:
        """Return the deformed structure of a displacement field, with this scene's factor of displacements and cut."""
        normal = (0.0, 0.0, float(np.copysign(1.0, self.axes[2, 2]))) if self.view.cut else None
        return DeformedShape.of(grid, self.view.component, self.displacement_factor, normal)

    def make_panels(self, n: int) -> tuple[Picture, list[Axes]]:
        """Make an empty picture for `n` structures side by side; return it and the axes of its n panels."""
        x0, x1, y0, y1 = self.window
        figure = Picture(figsize=(PANEL_INCHES * n, PANEL_INCHES * (y1 - y0) / (x1 - x0) + 1.3), layout="constrained")
        axes = list(figure.subplots(1, n, squeeze=False)[0])
        for panel in axes:
            panel.set_axis_off()
        return figure, axes

    def draw_colour_bar(self, figure: Picture, axes: list[Axes]) -> None:
        """Draw a colour bar for the displacements below the panels `axes` of a picture."""
        largest = np.abs(self.colour_limits).max()
        power = 0 if largest == 0 or 0.01 <= largest < 1e4 else 3 * int(np.floor(np.log10(largest) / 3))
        unit = f"10^{power} {self.view.unit}" if power else self.view.unit
        symbol = "|u|" if self.view.component == "size" else f"u_{self.view.component}"
        label = f"{symbol} ({unit.strip()}); {self.factor_text}" if unit else f"{symbol}; {self.factor_text}"
        low, high = (limit * 10.0**-power for limit in self.colour_limits)
        figure.colorbar(ScalarMappable(Normalize(low, high), "viridis"), ax=axes, **COLOUR_BAR_STYLE, label=label)

    @property
    def factor_text(self) -> str:
        """Text for the colour bar with the factor of the drawn displacements, as "displacements drawn 50 times"."""
        return f"displacements drawn {self.displacement_factor:.3g} times".replace("drawn 1 times", "as they are")

    def render(self, grid: VtkGrid, s_meshes: Sequence[pyvista.PolyData] | None = None) -> npt.NDArray[np.uint8]:
        """Draw a structure off screen and return the pixels of the image (height, width, 3), as red, green and blue.

        Args:
            grid, s_meshes: what is drawn, see `add_to`.
        """
        x0, x1, y0, y1 = self.window
        window_size = [round(LONG_SIDE_PIXELS * side / max(x1 - x0, y1 - y0)) for side in (x1 - x0, y1 - y0)]
        plotter = pyvista.Plotter(off_screen=True, window_size=window_size, lighting="none")
        self.add_to(plotter, grid, s_meshes)
        pixels = plotter.screenshot(return_img=True)
        plotter.close()
        return pixels

    def add_to(self, plotter: pyvista.Plotter, grid: VtkGrid, s_meshes: Sequence[pyvista.PolyData] | None) -> None:
        """Add a structure to a plotter of pyvista, and let its camera show this scene's window.

        Lines are black at edges of bodies, and red around meshed layers and at both sides of S; a rigid base is grey.

        Args:
            plotter: a plotter without lights.
            grid: displacement field of the structure.
            s_meshes: meshes of S to draw in addition, in the colours of their point data "rgb". Bodies then have one
                colour and grey-brown edges, in 3D only these edges. None: bodies are coloured by displacement.
        """
        shape, (right, up, towards), (x0, x1, y0, y1) = self.deformed_shape(grid), self.axes, self.window
        plotter.add_light(pyvista.Light(light_type="headlight"))
        body = DISPLACEMENT_STYLE | {"clim": self.colour_limits} if s_meshes is None else PLAIN_BODY_STYLE
        edge, only_outlines = EDGE_STYLE if s_meshes is None else OUTLINE_STYLE, s_meshes is not None and grid.dim == 3
        grids = [(region, body, *((LAYER_STYLE, 2) if tag < 0 else (edge, 1))) for tag, region in shape.regions.items()]
        if shape.base is not None and not only_outlines:
            grids.append((shape.base, BASE_STYLE, BASE_STYLE, 0))
        for mesh, style, line_style, n_lifts in grids:
            surface = outer_surface(mesh)
            if not only_outlines:
                plotter.add_mesh(surface, **style)
            lines = sharp_edges(surface)
            lines.points += n_lifts * LINE_LIFT * (x1 - x0) * towards
            nodes = lines.lines.reshape(-1, 3)[:, 1:]
            is_on_seam = lines["coincident"][nodes].min(axis=1) > SPLIT_FACTOR if lines.n_cells else np.zeros(0, bool)
            for is_drawn, style in ((~is_on_seam, line_style), (is_on_seam, line_style if s_meshes else SEAM_STYLE)):
                if is_drawn.any():
                    plotter.add_mesh(lines.extract_cells(is_drawn), **style)
        for mesh in s_meshes or ():
            if shape.cut_plane is not None:
                mesh = mesh.clip(**shape.cut_plane)
            mesh.points += (3 if grid.dim == 2 else 0) * LINE_LIFT * (x1 - x0) * towards
            plotter.add_mesh(mesh, **SURFACE_STYLE)
        depths = shape.points @ towards
        near_depth, far_depth = depths.max() + (x1 - x0), depths.min() - (x1 - x0)
        centre = (x0 + x1) / 2 * right + (y0 + y1) / 2 * up
        plotter.enable_parallel_projection()
        plotter.camera_position = [centre + near_depth * towards, centre + far_depth * towards, up]
        plotter.camera.parallel_scale = (y1 - y0) / 2
        plotter.camera.clipping_range = (0.0, near_depth - far_depth)


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
