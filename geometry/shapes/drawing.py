"""The class `Shape`, which draws a joint in gmsh and meshes it, and functions for gmsh's surfaces and curved grids."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from math import floor, log10
from typing import Any, ClassVar, NamedTuple, Self

import dolfinx
import numpy as np

from forms.base import InputError, is_number
from geometry.joint import Joint
from geometry.seam import S, Seam
from geometry.shapes.sizing import (
    CELL_TYPES_OF_DIM,
    DEFAULT_CELLS_ACROSS,
    MIN_SIZE_RATIO,
    Grading,
    MeshOptions,
    gmsh,
    require_width,
    scaled_length,
)
from geometry.topology import FACET_TYPES, FloatArray, IntArray, corner_count, is_tensor, vertex_weights

GMSH_FAMILIES = {"interval": "line", "quadrilateral": "quadrangle"}  # gmsh's names, where they differ from DOLFINx
SIZE_GROWTH = 0.3  # growth of the cell size per unit of distance from a refined place
UNIT_DECADES = 3  # powers of ten between units of length such as mm and m


class Drawing(NamedTuple):
    """The entities of a gmsh model by name, and what is needed to mesh them as a grid.

    Attributes:
        bodies: name of a cell region -> tags of its surfaces (2D) or volumes (3D); the lower body comes first.
        facets: name of a facet set -> tags of its curves (2D) or surfaces (3D).
        base_tags: tags of the surfaces on which a grid is made; in 3D they were then swept to volumes.
        gradings: tag of each curve around these surfaces -> the sizes of cells along it.
        seams: name of a seam -> choice of its upper side. {}: one seam "S"; the last of `bodies` is above it, and all
            others are below.
        polar_core: for a polar grid, the numbers of the two coordinates in the circles' plane, and the radius (a
            length) up to which cells stay straight. None for other shapes.
    """

    bodies: dict[str, list[int]]
    facets: dict[str, list[int]]
    base_tags: list[int]
    gradings: dict[int, Grading]
    seams: Mapping[str, Seam] = {}
    polar_core: tuple[list[int], float] | None = None


class SizeRules(NamedTuple):
    """Lengths, and formulas in gmsh's language, from which the cell sizes of a shape follow.

    Attributes:
        min_width: the default cell size is a fraction of this length, such as a tenth.
        span: length of S in 2D, of the longest curve around S in 3D.
        distance_formula: distance from S in a shape in 3D, a formula in x, y and z.
        limit: upper bound of the cell size besides h, a formula in x, y and z; "": none.
    """

    min_width: float
    span: float
    distance_formula: str = "0"
    limit: str = ""


@dataclass(frozen=True)
class Shape(ABC):
    """A joint that gmsh can draw and mesh, described by its dimensions.

    All numbers among the fields of subclasses are lengths, except those named in `angle_fields`.

    Attributes:
        meshing: requested cell sizes and types.
        dim: space dimension.
        angle_fields: names of the fields that are angles, in radians.
    """

    meshing: MeshOptions
    dim: ClassVar[int] = 2
    angle_fields: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        self.meshing.check(self.lengths, self.dim)

    @property
    @abstractmethod
    def lengths(self) -> dict[str, float]:
        """Name of a length in messages -> length of the shape, > 0; no cell size may exceed the largest of these."""

    @property
    @abstractmethod
    def size_rules(self) -> SizeRules:
        """Lengths from which the default cell size and the growth of cells away from S follow."""

    def scaled(self, factor: float) -> Self:
        """Return the shape with all lengths, including cell sizes, multiplied by `factor`."""
        field_values = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in self.angle_fields}
        return replace(self, **{name: _scaled(value, factor) for name, value in field_values.items()})

    @abstractmethod
    def draw(self) -> Drawing:
        """Draw the shape in the current gmsh model and return its entities by name."""

    @property
    def kind(self) -> str:
        """Type of the cells, such as "triangle"; by default the simplex of the shape's dimension."""
        return self.meshing.cell or CELL_TYPES_OF_DIM[self.dim][0]

    @property
    def is_grid(self) -> bool:
        """Whether the mesh is a grid of quadrilaterals or hexahedra, or of simplices that divide these."""
        return self.meshing.structured or is_tensor(self.kind)

    @property
    def sizes(self) -> tuple[float, float, float]:
        """Largest cell size h, cell size h_S at S, and h_ends at the ends of S, lengths, with defaults filled in."""
        h = float(self.meshing.h or self.size_rules.min_width / DEFAULT_CELLS_ACROSS[self.dim])
        h_S = float(self.meshing.h_S or h)
        return h, h_S, float(self.meshing.h_ends or h_S)

    def build(self) -> Joint:
        """Mesh the shape with gmsh and return the joint.

        gmsh's tolerances are absolute lengths. Lengths are therefore scaled by a power of 1000 so that the largest is
        between 1 and 1000. The mesh is then the same in nm, mm, m and km.

        Raises:
            InputError: the thinnest part or the default cell size is too small for gmsh.
        """
        size = max(self.lengths.values())
        require_width("the thinnest part", self.size_rules.min_width, size)
        if self.meshing.h is None and self.sizes[0] < MIN_SIZE_RATIO * size:
            raise InputError(f"the default cell size h is {self.sizes[0]:g}; give h, from {MIN_SIZE_RATIO * size:g} on")
        exponent = UNIT_DECADES * floor(log10(size) / UNIT_DECADES)
        return self.scaled(10.0**-exponent)._build(10.0**exponent)

    def _build(self, unit: float) -> Joint:
        """Return the joint of this shape, drawn and meshed as it is, with all coordinates then multiplied by `unit`."""
        gmsh.initialize(interruptible=False)
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            gmsh.model.add("joint")
            drawing = self.draw()
            *lower_names, upper_name = drawing.bodies
            drawing = drawing._replace(seams=drawing.seams or {S: Seam(tuple(lower_names), (upper_name,))})
            if self.is_grid:
                self._set_grid(drawing)
            else:
                self._set_sizes([tag for name in drawing.seams for tag in drawing.facets[name]])
            gmsh.model.mesh.generate(self.dim)
            if self.meshing.degree > 1:
                gmsh.model.mesh.setOrder(self.meshing.degree)
            make_joint = self._read(drawing, unit)
        finally:
            gmsh.finalize()
        return make_joint()  # now that gmsh's memory is free

    def sweep(self, surfaces: Sequence[int], way: tuple[float, float, float], grading: Grading) -> dict[int, list[int]]:
        """Extrude surfaces of the current gmsh model to volumes; if a grid is requested, in layers of cells.

        Args:
            surfaces: tags of the surfaces.
            way: vector of the extrusion, lengths.
            grading: sizes of the cells along this vector, for a grid.

        Returns:
            Tag of each surface -> [tag of its volume, tag of the surface at the far end].
        """
        kernel, heights = gmsh.model.geo, grading.cell_ends
        grid_options = dict(numElements=[1] * len(heights), heights=heights, recombine=is_tensor(self.kind))
        swept = kernel.extrude([(2, tag) for tag in surfaces], *way, **(grid_options if self.is_grid else {}))
        kernel.synchronize()
        volume_indices = [k for k, (dim, _) in enumerate(swept) if dim == 3]
        return {tag: [swept[k][1], swept[k - 1][1]] for tag, k in zip(surfaces, volume_indices, strict=True)}

    def _set_grid(self, drawing: Drawing) -> None:
        """Prescribe a grid of quadrilaterals, or of triangles that halve them, on the surfaces `drawing.base_tags`.

        The layers of cells in swept volumes are prescribed by `sweep`.

        Args:
            drawing: entities by name.
        """
        for curve, grading in drawing.gradings.items():
            grading.set_on_curve(curve)
        for surface in drawing.base_tags:
            gmsh.model.mesh.setTransfiniteSurface(surface, self.meshing.arrangement)
            if is_tensor(self.kind):
                gmsh.model.mesh.setRecombine(2, surface)

    def _set_sizes(self, s_entities: Sequence[int]) -> None:
        """Prescribe the cell sizes to gmsh: h_ends where S ends or branches, h_S on S, and growth to h away from S.

        Args:
            s_entities: tags of the curves (2D) or surfaces (3D) of S.
        """
        h, h_S, h_ends = self.sizes
        field = gmsh.model.mesh.field
        boundary = gmsh.model.getBoundary([(self.dim - 1, tag) for tag in s_entities], combined=False, oriented=False)
        end_tags = [tag for (_, tag), count in Counter(boundary).items() if count != 2]
        formulas = []
        for dim, entities, size in ((self.dim - 1, s_entities, h_S), (self.dim - 2, end_tags, h_ends)):
            distance = f"({self.size_rules.distance_formula})"
            if dim < 2:  # gmsh measures the distance from curves and points of its built-in kernel, not from surfaces
                distance_field = field.add("Distance")
                field.setNumbers(distance_field, ("PointsList", "CurvesList")[dim], entities)
                field.setNumber(distance_field, "Sampling", min(20000, int(4 * self.size_rules.span / size)))
                distance = f"F{distance_field}"
            if entities:
                formulas.append(f"{size!r} + {SIZE_GROWTH!r} * {distance}")
        size_fields = []
        for formula in [*formulas, *filter(None, [self.size_rules.limit])]:
            size_fields.append(field.add("MathEval"))
            field.setString(size_fields[-1], "F", formula)
        min_field = field.add("Min")
        field.setNumbers(min_field, "FieldsList", size_fields)
        field.setAsBackgroundMesh(min_field)
        gmsh.option.setNumber("Mesh.MeshSizeMax", h)
        for option in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
            gmsh.option.setNumber(f"Mesh.MeshSize{option}", 0)

    def _read(self, drawing: Drawing, unit: float) -> Callable[[], Joint]:
        """Read the mesh from gmsh's memory, and return a function without arguments that makes the joint from it.

        The function does not need gmsh, whose memory can be freed before.

        Args:
            drawing: entities by name.
            unit: factor by which all coordinates are multiplied.
        """
        nodes, x, _ = gmsh.model.mesh.getNodes()
        body_elements = [self._elements(self.kind, tags) for tags in drawing.bodies.values()]
        facet_type = FACET_TYPES[self.kind]
        facets = {name: self._elements(facet_type, tags) for name, tags in drawing.facets.items()}
        node_order = dolfinx.cpp.io.perm_gmsh(dolfinx.mesh.to_type(self.kind), body_elements[0].shape[1])
        used, cells = np.unique(np.concatenate(body_elements)[:, node_order], return_inverse=True)
        all_points = np.empty((int(nodes.max()) + 1, self.dim))
        all_points[nodes] = x.reshape(-1, 3)[:, : self.dim]
        points, cells = all_points[used], cells.reshape(-1, len(node_order))
        if is_tensor(self.kind) and self.meshing.degree == 2 and drawing.polar_core:
            points = curved_points(points, cells, self.kind, *drawing.polar_core)
        region = np.repeat(np.arange(len(body_elements)), [len(body) for body in body_elements])
        facets = {name: np.searchsorted(used, of[:, : corner_count(facet_type)]) for name, of in facets.items()}
        return partial(Joint, points * unit, cells, self.kind, region, tuple(drawing.bodies), facets, drawing.seams)

    def _elements(self, cell_type: str, tags: Sequence[int]) -> IntArray:
        """Return (n, k) gmsh's numbers of the k nodes of each element of one type on some entities, in gmsh's order.

        Args:
            cell_type: type of the elements, such as "triangle".
            tags: tags of the entities.
        """
        mesh = gmsh.model.mesh
        number = mesh.getElementType(GMSH_FAMILIES.get(cell_type, cell_type), self.meshing.degree)
        rows = np.concatenate([mesh.getElementsByType(number, tag)[1] for tag in tags])
        return rows.reshape(-1, mesh.getElementProperties(number)[3])


@dataclass(frozen=True)
class Prism(Shape):
    """A plane shape; in 3D it is swept along z from the side "BACK" (z = 0) to the side "FRONT" (z = depth).

    Attributes:
        depth: size along z, a length > 0; None in 2D.
    """

    depth: float | None

    @property
    def dim(self) -> int:  # type: ignore[override]
        """Space dimension."""
        return 2 if self.depth is None else 3

    @property
    def lengths(self) -> dict[str, float]:
        """Name of a length in messages -> length: {"depth": depth}, or {} in 2D."""
        return {} if self.depth is None else {"depth": self.depth}

    @abstractmethod
    def draw_plane(self) -> Drawing:
        """Draw the plane shape at z = 0 in the current gmsh model and return its entities by name."""

    def draw(self) -> Drawing:
        """Draw the plane shape, and in 3D sweep it over the depth; return the entities by name."""
        plane = self.draw_plane()
        if self.depth is None:
            return plane
        _, h_S, h_ends = self.sizes
        swept = self.sweep(plane.base_tags, (0.0, 0.0, self.depth), Grading.of(self.depth, h_ends, h_S, symmetric=True))
        facets = {name: swept_surfaces(curves, plane.base_tags) for name, curves in plane.facets.items()}
        bodies = {name: [swept[tag][0] for tag in tags] for name, tags in plane.bodies.items()}
        end_sides = {"BACK": plane.base_tags, "FRONT": [front for _, front in swept.values()]}
        return plane._replace(bodies=bodies, facets=facets | end_sides)


def _scaled(value: Any, factor: float) -> Any:
    """Return the value of a field of a shape with all lengths in it multiplied by `factor`.

    Args:
        value: a length, array, tuple or `MeshOptions`, whose lengths are multiplied; any other value is returned as it
            is.
        factor: the factor.
    """
    if isinstance(value, MeshOptions):
        return value.scaled(factor)
    if isinstance(value, tuple):
        return tuple(_scaled(item, factor) for item in value)
    if isinstance(value, np.ndarray):
        return value * factor
    return scaled_length(value, factor) if is_number(value) else value


def swept_surfaces(curves: Sequence[int], surfaces: Sequence[int]) -> list[int]:
    """Return the tags of the surfaces that curves have swept, after the surfaces they bound were swept to volumes.

    Args:
        curves: tags of the curves, on the outer boundary of the swept surfaces.
        surfaces: tags of the surfaces before they were swept, which are left out of the result.
    """
    return [int(tag) for curve in curves for tag in gmsh.model.getAdjacencies(1, curve)[0] if tag not in surfaces]


def add_plane_surface(sides: Sequence[int]) -> int:
    """Add a plane surface to the gmsh model and return its tag.

    Args:
        sides: tags of the curves around it, one after the other; negative where a curve runs backwards.
    """
    kernel = gmsh.model.geo
    return int(kernel.addPlaneSurface([kernel.addCurveLoop(sides)]))


def curved_points(points: FloatArray, cells: IntArray, cell_type: str, axes: list[int], r_core: float) -> FloatArray:
    """Return the points of a polar grid of degree 2, with nodes between vertices moved onto circles about the axis.

    Towards the core of the grid, nodes move less, and inside the core not at all. gmsh itself curves only cells that
    touch a circle of the drawing, which would fold thin cells.

    Args:
        points: (n_points, d) coordinates in d dimensions, lengths.
        cells: (n_cells, n_nodes) numbers of the nodes of each cell, vertices first.
        cell_type: "quadrilateral" or "hexahedron".
        axes: numbers of the two coordinates in the circles' plane.
        r_core: radius of the core, a length; 0: there is no core, and all nodes move onto their circles.

    Returns:
        (n_points, d) coordinates, lengths.
    """
    n_corners = corner_count(cell_type)
    radius = np.hypot(*points[:, axes].T)
    new_radius = radius.copy()
    new_radius[cells[:, n_corners:]] = radius[cells[:, :n_corners]] @ vertex_weights(cell_type, 2)[n_corners:].T
    weight = np.clip((radius - r_core) / (radius.max() - r_core), 0.0, 1.0) if r_core else 1.0
    points = points.copy()
    points[:, axes] *= (1 + weight * (new_radius / np.where(radius > 0, radius, 1.0) - 1))[:, None]
    return points
