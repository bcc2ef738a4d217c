"""Deformed 3D structures as VTK grids, drawn off screen by pyvista as images."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

if not os.environ.get("DISPLAY"):  # without an X server VTK would try to use one, and warn
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")

import numpy as np
import pyvista
from matplotlib.axes import Axes

from forms.base import Array
from thinlayer.output.paraview.grid import VtkGrid
from thinlayer.output.plotting.curves import LAW_COLOUR, MESHED_COLOUR
from thinlayer.output.plotting.scene import (
    BASE_COLOUR,
    COLOUR_MAP,
    EDGE_COLOUR,
    OUTLINE_COLOUR,
    SYMBOL_COLOUR,
    Scene,
    Style,
    SurfaceColours,
    Symbols,
)  # fmt: skip

LINE_LIFT = 0.004  # shift of lines towards the viewer, over the picture's width, so that surfaces do not hide them
LONG_SIDE_PIXELS = 1400  # length of the longer side of an image
LAYER_STYLE: Style = {"color": MESHED_COLOUR, "line_width": 4, "lighting": False}
SEAM_STYLE: Style = {"color": LAW_COLOUR, "line_width": 3, "lighting": False}  # the two sides of S
EDGE_STYLE: Style = {"color": EDGE_COLOUR, "line_width": 3, "lighting": False}
BASE_STYLE: Style = {"color": BASE_COLOUR, "line_width": 8, "lighting": False}
BODY_STYLE: Style = {"scalars": "u", "cmap": COLOUR_MAP, "show_scalar_bar": False, "ambient": 0.7, "diffuse": 0.3}
OUTLINE_STYLE: Style = {"color": OUTLINE_COLOUR, "line_width": 2, "lighting": False}
SURFACE_STYLE: Style = {"scalars": "rgb", "rgb": True, "lighting": False}
SUPPORT_SIZE_RATIO = 0.4  # size of the symbols of supports, over the length of an arrow

SUBDIVISION_LEVEL = 3  # subdivision level of curved cells
SHARP_ANGLE_DEGREES = 30.0  # least angle between faces whose common edge is drawn, degrees
SPLIT_FACTOR = 0.999  # factor of displacements that separates the two sides of S, so that VTK does not merge them
CUT_OFFSET = 1e-3  # distance of a cut from the middle, over the structure's size, so that it avoids faces of cells


@dataclass(frozen=True)
class SolidShape:
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
    def of(cls, grid: VtkGrid, scene: Scene) -> SolidShape:
        """Make the deformed structure of a displacement field, with a scene's factor of displacements and cut.

        The cut goes through the structure's middle, normal to z, and leaves out the half towards the viewer.
        """
        scale = scene.displacement_factor
        mesh = pyvista.UnstructuredGrid(grid.cells, grid.cell_codes, grid.points + scale * grid.u)
        fields = {"u": grid.component(scene.view.component), "moved": scale * grid.u}
        mesh.point_data.update(fields | {"coincident": grid.is_coincident().astype(float)})
        grids = {int(number): mesh.extract_cells(grid.region == number) for number in np.unique(grid.region)[::-1]}
        n, k = grid.base_x.shape[:2]
        cells = np.insert(np.arange(n * k).reshape(n, k), 0, k, axis=1)
        base = pyvista.UnstructuredGrid(cells, np.full(n, grid.base_code), grid.base_x.reshape(-1, 3)) if n else None
        if base is not None:
            base.point_data.update({"moved": np.zeros(base.points.shape), "coincident": np.zeros(base.n_points)})
        if not scene.view.cut:
            return cls(grids, base)
        normal = (0.0, 0.0, float(np.copysign(1.0, scene.axes[2, 2])))
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

    def draw(self, axes: Axes, scene: Scene, symbols: Symbols | None, surface: SurfaceColours | None) -> None:
        """Draw an image of the structure in the scene's window, see `DeformedShape.draw`."""
        x0, x1, y0, y1 = scene.window
        window_size = [round(LONG_SIDE_PIXELS * side / max(x1 - x0, y1 - y0)) for side in (x1 - x0, y1 - y0)]
        plotter = pyvista.Plotter(off_screen=True, window_size=window_size, lighting="none")
        self.add_to(plotter, scene, symbols, surface)
        axes.imshow(plotter.screenshot(return_img=True), extent=scene.window)
        plotter.close()

    def add_to(
        self, plotter: pyvista.Plotter, scene: Scene, symbols: Symbols | None, surface: SurfaceColours | None
    ) -> None:
        """Add the structure to a plotter without lights, and let its camera show the scene's window.

        Lines are black at edges of bodies, orange around meshed layers, blue at both sides of S; a rigid base is grey.

        Args:
            plotter: the plotter.
            scene, symbols, surface: see `DeformedShape.draw`.
        """
        (right, up, towards), (x0, x1, y0, y1) = scene.axes, scene.window
        plotter.add_light(pyvista.Light(light_type="headlight"))
        edge = EDGE_STYLE if surface is None else OUTLINE_STYLE
        grids = [(region, *((LAYER_STYLE, 2) if tag < 0 else (edge, 1))) for tag, region in self.regions.items()]
        for mesh, line_style, n_lifts in grids:
            outside = outer_surface(mesh)
            if surface is None:
                plotter.add_mesh(outside, clim=scene.colour_limits, **BODY_STYLE)
            lines = sharp_edges(outside)
            lines.points += n_lifts * LINE_LIFT * (x1 - x0) * towards
            nodes = lines.lines.reshape(-1, 3)[:, 1:]
            is_on_seam = lines["coincident"][nodes].min(axis=1) > SPLIT_FACTOR if lines.n_cells else np.zeros(0, bool)
            for is_drawn, style in ((~is_on_seam, line_style), (is_on_seam, line_style if surface else SEAM_STYLE)):
                if is_drawn.any():
                    plotter.add_mesh(lines.extract_cells(is_drawn), **style)
        if surface is not None:
            faces = _faces(surface)
            plotter.add_mesh(faces.clip(**self.cut_plane) if self.cut_plane else faces, **SURFACE_STYLE)
        elif self.base is not None:
            plotter.add_mesh(outer_surface(self.base), **BASE_STYLE)
        if symbols is not None:
            _add_symbols(plotter, symbols)
        depths = self.points @ towards
        near_depth, far_depth = depths.max() + (x1 - x0), depths.min() - (x1 - x0)
        centre = (x0 + x1) / 2 * right + (y0 + y1) / 2 * up
        plotter.enable_parallel_projection()
        plotter.camera_position = [centre + near_depth * towards, centre + far_depth * towards, up]
        plotter.camera.parallel_scale = (y1 - y0) / 2
        plotter.camera.clipping_range = (0.0, near_depth - far_depth)


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


def interactive_plotter(
    scene: Scene, grids: Mapping[str, VtkGrid], surfaces: Mapping[str, SurfaceColours]
) -> pyvista.Plotter:
    """Return a plotter with structures side by side, which turn together.

    Args:
        scene: window, range of colours and direction of view.
        grids: label of a structure -> its displacements, loads and supports.
        surfaces: label -> colours of S, see `DeformedShape.draw`.
    """
    plotter = pyvista.Plotter(shape=(1, len(grids)), lighting="none")
    for k, (label, grid) in enumerate(grids.items()):
        plotter.subplot(0, k)
        SolidShape.of(grid, scene).add_to(plotter, scene, scene.symbols(grid), surfaces.get(label))
        plotter.add_text(label, font_size=10)
    plotter.link_views()
    return plotter


def _faces(surface: SurfaceColours) -> pyvista.PolyData:
    """Make a mesh half-way between the two sides of S, with its colours as point data "rgb"."""
    lower, upper, rgba = surface.parts()
    points = ((lower + upper) / 2).reshape(-1, 3)
    mesh = pyvista.PolyData(points, faces=np.insert(np.arange(len(points)).reshape(-1, 4), 0, 4, axis=1).ravel())
    mesh.point_data["rgb"] = np.asarray(np.rint(255 * rgba[..., :3]), np.uint8).reshape(-1, 3)
    return mesh


def _add_symbols(plotter: pyvista.Plotter, symbols: Symbols) -> None:
    """Add arrows of loads to a plotter, and cubes and balls where supports prescribe all components or some."""
    first, last = symbols.arrows[:, 0], symbols.arrows[:, 1]
    size = SUPPORT_SIZE_RATIO * symbols.length
    cube, ball = pyvista.Cube(x_length=size, y_length=size, z_length=size), pyvista.Sphere(radius=size / 2)
    arrow = pyvista.Arrow(scale=symbols.length)
    for points, geometry, direction in (
        (symbols.fixed, cube, np.zeros_like(symbols.fixed)),
        (symbols.guided, ball, np.zeros_like(symbols.guided)),
        (first, arrow, last - first),
    ):
        if len(points):
            places = pyvista.PolyData(points)
            places["direction"] = direction
            orient = "direction" if geometry is arrow else False
            plotter.add_mesh(places.glyph(orient=orient, scale=False, geom=geometry), color=SYMBOL_COLOUR)
