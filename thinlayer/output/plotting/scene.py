"""Scenes: deformed structures with a direction of view, a window, a factor of displacements and a range of colours."""

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

DRAWN_DISPLACEMENT_SHARE = 0.05  # largest drawn displacement, over the size of the structure
DEFAULT_VIEWS = {2: (0.0, 0.0, 1.0), 3: (0.55, 0.45, 1.0)}  # dimension -> direction to the viewer
LINE_LIFT = 0.004  # shift of lines towards the viewer, over the picture's width, so that surfaces do not hide them
IMAGE_PIXELS = 1400  # length of the longer side of an image
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
    """View of structures in pictures; checked on every rank.

    Attributes:
        component: component of the displacement that colours show: "size", "x", "y" or "z".
        scale: factor of the displacements (default: the largest is a twentieth of the structure).
        unit: unit of the displacements, for the colour bar.
        zoom: (left, right, bottom, top) of the window, in deformed coordinates: in 2D (x_min, x_max, y_min, y_max), in
            3D distances from the origin to the right and up in the picture.
        towards: in 3D the direction from the structure to the viewer, (3,) (default: the viewer is in front, z > 0, to
            the right and above). y points up in the picture; in a view from directly above, -z points up.
        cut: in 3D whether to leave out the half in front of the middle in z, to show S inside.

    Raises:
        InputError: a scale that is no finite number, an invalid window.
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
            _window(self.zoom)


@dataclass(frozen=True)
class DeformedShape:
    """A deformed structure to draw.

    Attributes:
        regions: region number -> its cells, the layer's last. Point data are "u", a component of the displacement,
            "moved", (n, 3) the drawn displacement, and "double", 1 for nodes on S.
        base: facets of the rigid base; None between two bodies.
        plane: plane of the cut, as arguments of `clip`; None: the structure is not cut.
    """

    regions: dict[int, pyvista.UnstructuredGrid]
    base: pyvista.UnstructuredGrid | None
    plane: dict[str, Any] | None = None

    @classmethod
    def of(cls, grid: VtkGrid, component: str, scale: float, cut: Sequence[float] | None = None) -> DeformedShape:
        """The structure with displacements times `scale`, without the half to which the unit vector `cut` points."""
        mesh = pyvista.UnstructuredGrid(grid.cells, grid.types, grid.points + scale * grid.u)
        # the factor pi avoids coordinates half-way between two decimals, which rounding errors would separate
        places = np.round(np.pi / np.ptp(grid.points) * grid.points, PLACE_DECIMALS)
        _, place, count = np.unique(places, axis=0, return_inverse=True, return_counts=True)
        double = (count[place.ravel()] > 1).astype(float)
        mesh.point_data.update({"u": grid.component(component), "moved": scale * grid.u, "double": double})
        parts = {int(number): mesh.extract_cells(grid.region == number) for number in np.unique(grid.region)[::-1]}
        n, k = grid.base.shape[:2]
        facets = np.insert(np.arange(n * k).reshape(n, k), 0, k, axis=1)
        base = pyvista.UnstructuredGrid(facets, np.full(n, grid.base_type), grid.base.reshape(-1, 3)) if n else None
        if base is not None:
            base.point_data.update({"moved": np.zeros(base.points.shape), "double": np.zeros(base.n_points)})
        if cut is None:
            return cls(parts, base)
        low, high = grid.points.min(axis=0), grid.points.max(axis=0)
        plane = {"normal": cut, "origin": (low + high) / 2 + CUT_OFFSET * (high - low).max() * np.asarray(cut)}
        regions = {number: behind for number, part in parts.items() if (behind := part.clip(**plane)).n_cells}
        return cls(regions, base.clip(**plane) if base is not None else None, plane)

    @property
    def points(self) -> Array:
        """(n, 3) nodes of the regions and then of the base."""
        return np.concatenate([mesh.points for mesh in (*self.regions.values(), self.base) if mesh is not None])

    @property
    def values(self) -> Array:
        """(n,) "u" at `points`; NaN on the base."""
        values = np.concatenate([part["u"] for part in self.regions.values()])
        return np.pad(values, (0, 0 if self.base is None else self.base.n_points), constant_values=np.nan)


def outer_surface(mesh: pyvista.UnstructuredGrid) -> pyvista.PolyData:
    """Outer surface of a mesh (in 2D the mesh itself), curved cells subdivided."""
    return mesh.extract_surface(algorithm=None, nonlinear_subdivision=SUBDIVISION_LEVEL)


def sharp_edges(surface: pyvista.PolyData) -> pyvista.PolyData:
    """Outlines of a surface, and edges that are sharp before deformation, in their deformed positions."""
    still = surface.copy()
    still.points -= SPLIT_FACTOR * surface["moved"]
    if not surface.n_lines:
        still = still.compute_normals(point_normals=False)  # orients faces consistently, for their angles
    lines = still.extract_feature_edges(SHARP_ANGLE_DEGREES, manifold_edges=False, non_manifold_edges=False)
    if lines.n_cells:
        lines.points += SPLIT_FACTOR * lines["moved"]
    return lines


def _axes(dim: int, view: View) -> Array:
    """Unit vectors (3, 3) to the right, upwards and towards the viewer; raise InputError for an invalid direction."""
    if dim == 2 and (view.towards is not None or view.cut):
        raise InputError("towards and cut are for three-dimensional structures")
    towards = finite_values(DEFAULT_VIEWS[dim] if view.towards is None else view.towards, (3,))
    if towards is None or not towards.any():
        raise InputError(f"towards is {view.towards}; it must have three components, not all zero")
    towards /= np.linalg.norm(towards)
    right = np.cross((0.0, 1.0, 0.0) if np.hypot(*towards[::2]) > 1e-6 else (0.0, 0.0, -towards[1]), towards)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(towards, right), towards])


@dataclass(frozen=True)
class Scene:
    """One view of several grids: of structures side by side, or of one structure in time.

    Attributes:
        view: the requested view.
        axes: (3, 3) unit vectors to the right, upwards and towards the viewer.
        factor: factor of the drawn displacements.
        window: left, right, bottom, top on the screen.
        limits: smallest and largest value of the colours.
    """

    view: View
    axes: Array
    factor: float
    window: Window = (0.0, 0.0, 0.0, 0.0)
    limits: tuple[float, float] = (0.0, 0.0)

    @classmethod
    def of(cls, grids: Sequence[VtkGrid], view: View) -> Scene:
        """The scene in which all grids are visible.

        Raises:
            InputError: an unknown component, an invalid direction, a direction or cut in 2D, nothing in the window.
        """
        axes = _axes(grids[0].dim, view)
        largest = max(np.linalg.norm(grid.u, axis=1).max() for grid in grids)
        fitting = DRAWN_DISPLACEMENT_SHARE * np.ptp(grids[0].points, axis=0).max() / largest if largest > 0 else 1.0
        scene = cls(view, axes, float(fitting if view.scale is None else view.scale))
        shapes = [scene.shape(grid) for grid in grids]
        x, y, _ = axes @ np.concatenate([shape.points for shape in shapes]).T
        x0, x1, y0, y1 = window = (*_range(x), *_range(y)) if view.zoom is None else _window(view.zoom)
        inside = (x >= x0) & (x <= x1) & (y >= y0) & (y <= y1)
        values = np.concatenate([shape.values for shape in shapes])
        if x.max() < x0 or x.min() > x1 or y.max() < y0 or y.min() > y1:
            raise InputError(f"nothing to draw in the window {(x0, x1, y0, y1)}")
        seen = values if np.isnan(values[inside]).all() else values[inside]  # a window may lie inside one cell
        return replace(scene, window=window, limits=(float(np.nanmin(seen)), float(np.nanmax(seen))))

    def shape(self, grid: VtkGrid) -> DeformedShape:
        """The deformed structure of a grid."""
        front = (0.0, 0.0, float(np.copysign(1.0, self.axes[2, 2]))) if self.view.cut else None
        return DeformedShape.of(grid, self.view.component, self.factor, front)

    def panels(self, n: int) -> tuple[Picture, list[Axes]]:
        """A picture with axes for `n` structures side by side."""
        x0, x1, y0, y1 = self.window
        figure = Picture(figsize=(PANEL_INCHES * n, PANEL_INCHES * (y1 - y0) / (x1 - x0) + 1.3), layout="constrained")
        axes = list(figure.subplots(1, n, squeeze=False)[0])
        for panel in axes:
            panel.set_axis_off()
        return figure, axes

    def bar(self, figure: Picture, axes: list[Axes]) -> None:
        """Draw the colour bar of all displacements."""
        size = np.abs(self.limits).max()
        power = 0 if size == 0 or 0.01 <= size < 1e4 else 3 * int(np.floor(np.log10(size) / 3))
        unit = f"10^{power} {self.view.unit}" if power else self.view.unit
        name = "|u|" if self.view.component == "size" else f"u_{self.view.component}"
        label = f"{name} ({unit.strip()}); {self.scaled}" if unit else f"{name}; {self.scaled}"
        low, high = (limit * 10.0**-power for limit in self.limits)
        figure.colorbar(ScalarMappable(Normalize(low, high), "viridis"), ax=axes, **COLOUR_BAR_STYLE, label=label)

    @property
    def scaled(self) -> str:
        """The factor of the displacements, in words."""
        return f"displacements drawn {self.factor:.3g} times".replace("drawn 1 times", "as they are")

    def image(self, grid: VtkGrid, on_s: Sequence[pyvista.PolyData] | None = None) -> npt.NDArray[np.uint8]:
        """Image of a structure; edges and outlines of bodies are black, of the layer's parts red, and the base is grey.

        With meshes `on_s`, which have point data "rgb", bodies are not coloured, and in 3D only their outlines are
        drawn.
        """
        shape, (right, up, towards) = self.shape(grid), self.axes
        x0, x1, y0, y1 = self.window
        size = [round(IMAGE_PIXELS * side / max(x1 - x0, y1 - y0)) for side in (x1 - x0, y1 - y0)]
        plotter = pyvista.Plotter(off_screen=True, window_size=size, lighting="none")
        plotter.add_light(pyvista.Light(light_type="headlight"))
        body = DISPLACEMENT_STYLE | {"clim": self.limits} if on_s is None else PLAIN_BODY_STYLE
        edge, only_outlines = EDGE_STYLE if on_s is None else OUTLINE_STYLE, on_s is not None and grid.dim == 3
        parts = [(region, body, *((LAYER_STYLE, 2) if tag < 0 else (edge, 1))) for tag, region in shape.regions.items()]
        if shape.base is not None and not only_outlines:
            parts.append((shape.base, BASE_STYLE, BASE_STYLE, 0))
        for mesh, look, pen, lift in parts:
            outside = outer_surface(mesh)
            if not only_outlines:
                plotter.add_mesh(outside, **look)
            lines = sharp_edges(outside)
            lines.points += lift * LINE_LIFT * (x1 - x0) * towards
            ends = lines.lines.reshape(-1, 3)[:, 1:]
            on_seam = lines["double"][ends].min(axis=1) > SPLIT_FACTOR if lines.n_cells else np.zeros(0, bool)
            for part, look in ((~on_seam, pen), (on_seam, pen if on_s else SEAM_STYLE)):
                if part.any():
                    plotter.add_mesh(lines.extract_cells(part), **look)
        for mesh in on_s or ():
            if shape.plane is not None:
                mesh = mesh.clip(**shape.plane)
            mesh.points += (3 if grid.dim == 2 else 0) * LINE_LIFT * (x1 - x0) * towards
            plotter.add_mesh(mesh, **SURFACE_STYLE)
        depth = shape.points @ towards
        near, far = depth.max() + (x1 - x0), depth.min() - (x1 - x0)
        centre = (x0 + x1) / 2 * right + (y0 + y1) / 2 * up
        plotter.enable_parallel_projection()
        plotter.camera_position = [centre + near * towards, centre + far * towards, up]
        plotter.camera.parallel_scale = (y1 - y0) / 2
        plotter.camera.clipping_range = (0.0, near - far)
        image = plotter.screenshot(return_img=True)
        plotter.close()
        return image


def _range(x: Array) -> tuple[float, float]:
    """Smallest and largest value, with a margin."""
    margin = 0.04 * np.ptp(x)
    return float(x.min() - margin), float(x.max() + margin)


def _window(zoom: object) -> Window:
    """The four numbers of a window; raise InputError if they are invalid."""
    sides = finite_values(zoom, (4,))
    if sides is None or not (sides[0] < sides[1] and sides[2] < sides[3]):
        raise InputError(f"zoom is {zoom!r}; it must be (left, right, bottom, top), left < right and bottom < top")
    left, right, bottom, top = map(float, sides)
    return left, right, bottom, top
