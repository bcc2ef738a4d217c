"""Functions that return ready-made joints: stacked bodies, discs, rings, a fibre, brick walls, grains and faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import tau
from typing import Unpack

from geometry.joint import Joint
from geometry.parallel import Comm, on_root
from geometry.periodic import periodic
from geometry.shapes.boxes import Boxes, repeated_bond, running_bond
from geometry.shapes.cuts import faulted_rectangle, grain_rectangle
from geometry.shapes.rounds import Discs, Fibre, Rings
from geometry.shapes.sizing import CurvedArgs, GridArgs, MeshOptions, SizeArgs

Size = float | None  # a length; None: the default
Cell = str | None  # type of the cells; None: the default
Pair = tuple[float, float]  # width and height, or a place (x, y)
Paths = Mapping[str, Sequence[Pair]]  # name -> points of a line


def block(
    width: float, height: float, h: Size = None, *, depth: Size = None, comm: Comm = None, **cells: Unpack[GridArgs]
) -> Joint:
    """Return the joint of one body, (0, width) x (0, height), on a rigid base. Collective.

    In 3D the body is (0, width) x (0, height) x (0, depth). S is the bottom side of the body, at y = 0.

    Args:
        width, height: size, lengths > 0.
        h: largest cell size, a length (default: a tenth of the smallest side in 2D, a fifth in 3D).
        depth: size along z, a length > 0, which makes the body three-dimensional (default: 2D).
        h_S: cell size at S, a length (default: h).
        h_ends: cell size, a length, at the ends of S, in 3D at the edges of S (default: h_S).
        cell: "triangle" (default) or "quadrilateral", in 3D "tetrahedron" (default) or "hexahedron"; quadrilaterals and
            hexahedra are always structured.
        structured: whether triangles or tetrahedra are parts of the rectangles or boxes of a grid (default: no). The
            sizes of these vary along each axis independently.
        arrangement: which diagonals halve the grid's rectangles in the x-y plane. "Right": from lower left to upper
            right (default). "Left": from upper left to lower right. "AlternateLeft": both in turn, "Right" in the lower
            left corner. "AlternateRight": both in turn, "Left" in the lower left corner.
        comm: communicator whose rank 0 runs gmsh (default: MPI.COMM_WORLD).

    Returns:
        A joint with the region "BODY" and the facet sets "S", "TOP", "LEFT", "RIGHT", in 3D also "BACK" (z = 0) and
        "FRONT" (z = depth).

    Raises:
        InputError: a size is not positive, a keyword, cell type or arrangement is unknown, a cell type is not one of
            this dimension.

    Example:
        >>> from geometry import block
        >>> joint = block(4, 1, h=0.25, cell="quadrilateral")
        >>> [*joint.facets]
        ['LEFT', 'RIGHT', 'TOP', 'S']
    """
    return on_root(comm, Boxes(MeshOptions.of(h, cells, GridArgs), depth, width, (("BODY", height),)).build)


def sandwich(
    width: float,
    lower: float,
    upper: float,
    h: Size = None,
    *,
    depth: Size = None,
    comm: Comm = None,
    **cells: Unpack[GridArgs],
) -> Joint:
    """Return the joint of two stacked bodies (0, width) x (-lower, 0) and (0, width) x (0, upper). Collective.

    S is where they meet, at y = 0. In 3D both bodies also have the size (0, depth) along z.

    Args:
        width, lower, upper: width of both bodies, height of the lower and of the upper one, lengths > 0.
        h: largest cell size, a length (default: a tenth of the smallest side in 2D, a fifth in 3D).
        depth: size along z, a length > 0, which makes the bodies three-dimensional (default: 2D).
        h_S: cell size at S, a length (default: h).
        h_ends: cell size, a length, at the ends of S, in 3D at the edges of S (default: h_S).
        cell: "triangle" (default) or "quadrilateral", in 3D "tetrahedron" (default) or "hexahedron"; quadrilaterals and
            hexahedra are always structured.
        structured: whether triangles or tetrahedra are parts of the rectangles or boxes of a grid (default: no).
        arrangement: which diagonals halve the grid's rectangles in the x-y plane. "Right": from lower left to upper
            right (default). "Left": from upper left to lower right. "AlternateLeft": both in turn, "Right" in the lower
            left corner. "AlternateRight": both in turn, "Left" in the lower left corner.
        comm: communicator whose rank 0 runs gmsh (default: MPI.COMM_WORLD).

    Returns:
        A joint with the regions "LOWER", "UPPER" and the facet sets "S", "BOTTOM", "TOP", "LEFT", "RIGHT", in 3D also
        "BACK" (z = 0) and "FRONT" (z = depth).

    Raises:
        InputError: a size is not positive, a keyword, cell type or arrangement is unknown, a cell type is not one of
            this dimension.

    Example:
        >>> from geometry import sandwich
        >>> joint = sandwich(width=4, lower=1, upper=2, h=0.5, h_S=0.25)
        >>> [*joint.bodies], [*joint.facets]
        (['LOWER', 'UPPER'], ['LEFT', 'RIGHT', 'TOP', 'S', 'BOTTOM'])
    """
    bodies = ("LOWER", lower), ("UPPER", upper)
    return on_root(comm, Boxes(MeshOptions.of(h, cells, GridArgs), depth, width, bodies).build)


def disc(
    radius: float,
    lower: float,
    upper: float,
    h: Size = None,
    *,
    hole: float = 0.0,
    comm: Comm = None,
    **cells: Unpack[CurvedArgs],
) -> Joint:
    """Return the joint of two cylinders, stacked along the y axis, which is the axis of both. Collective.

    S is the disc at y = 0 where they meet. With a hole, S is a ring, and the bodies are tubes.

    Args:
        radius, lower, upper: radius of both bodies, height of the lower and of the upper one, lengths > 0.
        h: largest cell size, a length. Default: a fifth of the smallest of three lengths, the two heights and the
            radius; if there is a hole, radius - hole takes the place of the radius.
        hole: radius of a hole along the axis, a length less than the radius (default: none).
        h_S: cell size at S, a length (default: h).
        h_ends: cell size, a length, at the circles that bound S (default: h_S).
        cell: "tetrahedron" (default) or "hexahedron"; hexahedra form a polar grid, around a square grid if there is no
            hole.
        degree: polynomial degree of the cells' geometry, 1 (straight, default) or 2 (curved; the error of circles falls
            as h^4).
        comm: communicator whose rank 0 runs gmsh (default: MPI.COMM_WORLD).

    Returns:
        A joint with the regions "LOWER", "UPPER" and the facet sets "S", "BOTTOM", "TOP", "SIDE", with a hole also
        "HOLE". Whatever h is, about 20 cells or more go round a circle.

    Raises:
        InputError: a size is not positive, the hole does not fit, a keyword or cell type is unknown, the degree is not
            1 or 2.

    Example:
        >>> from geometry import disc
        >>> joint = disc(radius=10, lower=4, upper=6, h=2)
        >>> joint.bodies, sorted(joint.facets)
        (('LOWER', 'UPPER'), ['BOTTOM', 'S', 'SIDE', 'TOP'])
    """
    return on_root(comm, Discs(MeshOptions.of(h, cells, CurvedArgs), radius, lower, upper, hole).build)


def ring(
    inner: float,
    interface: float,
    outer: float,
    h: Size = None,
    *,
    angle: float = tau,
    depth: Size = None,
    comm: Comm = None,
    **cells: Unpack[CurvedArgs],
) -> Joint:
    """Return the joint of two concentric rings about the origin, or of sectors of them. Collective.

    S is where they meet. In 3D they are tubes along the z axis.

    Args:
        inner, interface, outer: radii, increasing lengths > 0; S is the circle or cylinder r = interface.
        h: largest cell size, a length. Default: in 2D a tenth of the smaller radial width of the two rings; in 3D a
            fifth of the smallest of these widths and the depth.
        angle: angle of the sector that starts at the x axis, in radians, > 0 and at most 2 pi (default: the full
            circle).
        depth: size along z, a length > 0, which makes the rings three-dimensional (default: 2D).
        h_S: cell size at S, a length (default: h).
        h_ends: cell size, a length, at the ends of S, in 3D at the curves that bound it (default: h_S); in 2D a full
            circle has none.
        cell: "triangle" (default) or "quadrilateral", in 3D "tetrahedron" (default) or "hexahedron"; quadrilaterals and
            hexahedra form a polar grid, whose cell sizes vary along the radius, along the circles and along z
            independently.
        degree: polynomial degree of the cells' geometry, 1 (straight, default) or 2 (curved; the error of circles falls
            as h^4).
        comm: communicator whose rank 0 runs gmsh (default: MPI.COMM_WORLD).

    Returns:
        A joint with the regions "INNER" (the lower body), "OUTER" (the upper body) and the facet sets "S", "INSIDE" (r
        = inner), "OUTSIDE" (r = outer). A sector also has "START" (on the x axis) and "END"; in 3D there are also
        "BACK" (z = 0) and "FRONT" (z = depth). Whatever h is, about 20 cells or more go round a circle.

    Raises:
        InputError: a size is not positive, the radii do not grow, or the angle is out of range; a keyword or cell type
            is unknown or not one of this dimension, or the degree is not 1 or 2.

    Example:
        >>> from geometry import ring
        >>> joint = ring(inner=2, interface=3, outer=5, h=1)
        >>> [*joint.facets], [*joint.bodies]
        (['INSIDE', 'S', 'OUTSIDE'], ['INNER', 'OUTER'])
    """
    return on_root(comm, Rings(MeshOptions.of(h, cells, CurvedArgs), depth, inner, interface, outer, angle).build)


def fibre(
    radius: float, around: float | Pair, h: Size = None, *, comm: Comm = None, **cells: Unpack[CurvedArgs]
) -> Joint:
    """Return the plane joint of a fibre, the disc r < radius about the origin, in its matrix. Collective.

    S is the circle between fibre and matrix.

    Args:
        radius: radius of the fibre, a length > 0.
        around: radius of the matrix's outer circle, or (width, height) of its rectangle about the origin, lengths that
            leave room for the fibre.
        h: largest cell size, a length (default: a tenth of the smaller of the radius and the least width of the matrix
            around the fibre).
        h_S: cell size at S, a length (default: h).
        cell: "triangle" (default) or, in a round matrix, "quadrilateral"; quadrilaterals form a polar grid around a
            square grid.
        degree: polynomial degree of the cells' geometry, 1 (straight, default) or 2 (curved; the error of circles falls
            as h^4).
        comm: communicator whose rank 0 runs gmsh (default: MPI.COMM_WORLD).

    Returns:
        A joint with the regions "FIBRE" (the lower body), "MATRIX" (the upper body) and the facet sets "S", and
        "OUTSIDE" (round matrix) or "BOTTOM", "TOP", "LEFT", "RIGHT" (rectangle). Whatever h is, about 20 cells or more
        go round S.

    Raises:
        InputError: a size is not positive, the fibre has no room, a keyword or cell type is unknown; quadrilaterals are
            asked for in a rectangle, the degree is not 1 or 2.

    Example:
        >>> from geometry import fibre
        >>> joint = fibre(radius=1, around=2, h=0.5)
        >>> joint.bodies, sorted(joint.facets)
        (('FIBRE', 'MATRIX'), ['OUTSIDE', 'S'])
    """
    lengths = around if isinstance(around, tuple) else (around,)
    return on_root(comm, lambda: Fibre(MeshOptions.of(h, cells, CurvedArgs), radius, lengths).build())


def wall(
    bricks: int, courses: int, brick: Pair, h: Size = None, *, depth: Size = None, cell: Cell = None, comm: Comm = None
) -> Joint:
    """Return the joint of a brick wall in running bond, whose left lower corner is the origin. Collective.

    S consists of the surfaces that stand for the layers of mortar.

    Args:
        bricks: number of bricks along a course; every second course begins and ends with half a brick.
        courses: number of courses.
        brick: (width, height) of a brick with its mortar, lengths > 0.
        h: largest cell size, a length (default: a quarter of the smallest side of a brick).
        depth: size of a brick along z, a length > 0, which makes the wall three-dimensional (default: 2D).
        cell: "quadrilateral" (default) or "triangle", in 3D "hexahedron" (default) or "tetrahedron"; they form, or
            divide, the cells of a grid.
        comm: communicator whose rank 0 makes the mesh (default: MPI.COMM_WORLD).

    Returns:
        A joint with the seams "BED" (mortar between courses, upper side above) and "HEAD" (mortar between bricks of a
        course, upper side on the right), as far as they exist. Its regions are "COURSE 1", "COURSE 2", ... from below.
        Its outer facet sets are "BOTTOM", "TOP", "LEFT", "RIGHT", in 3D also "BACK" (z = 0) and "FRONT" (z = depth).

    Raises:
        InputError: a size is not positive, bricks or courses is not a whole number >= 1, a cell type is not one of
            this dimension.

    Example:
        >>> from geometry import wall
        >>> joint = wall(2, 3, brick=(4, 2), h=1)
        >>> [*joint.seams]
        ['BED', 'HEAD']
    """
    size = tuple(brick) if depth is None else (*brick, depth)
    return on_root(comm, lambda: running_bond(MeshOptions(h, cell=cell), size, bricks, courses))


def bond_cell(
    brick: Pair, h: Size = None, *, depth: Size = None, cut: Pair = (0.25, 0.5), cell: Cell = None, comm: Comm = None
) -> Joint:
    """Return the periodic joint of one cell of a running bond: one brick wide and two courses high. Collective.

    The left lower corner of the cell is the origin. S consists of the surfaces that stand for the layers of mortar.
    The outer boundary of the cell cuts through bricks. Left and right sides are identified with each other, and so are
    bottom and top.

    Args:
        brick: (width, height) of a brick with its mortar, lengths > 0.
        h: largest cell size, a length (default: a quarter of the smallest side of a brick). Whatever h is, half the
            width of a brick and its height are divided into at least two cells each.
        depth: size of a brick along z, a length > 0, which makes the cell three-dimensional (default: 2D); "BACK" and
            "FRONT" are then not periodic.
        cut: place of the cell's left lower corner in a brick, as fractions of the brick's width and height. It is
            rounded to whole cells. The behaviour of the periodic cell as a whole does not depend on it.
        cell: "quadrilateral" (default) or "triangle", in 3D "hexahedron" (default) or "tetrahedron"; they form, or
            divide, the cells of a grid.
        comm: communicator whose rank 0 makes the mesh (default: MPI.COMM_WORLD).

    Returns:
        A joint with the seams "BED" (mortar between courses, upper side above) and "HEAD" (mortar between bricks of a
        course, upper side on the right). Its regions are "COURSE 1" (one part at the bottom, the other at the top) and
        "COURSE 2". Its outer facet sets are "BOTTOM", "TOP", "LEFT", "RIGHT", in 3D also "BACK" (z = 0) and "FRONT"
        (z = depth).

    Raises:
        InputError: a size is not positive, a cell type is not one of this dimension, the cut is along a layer
            of mortar.

    Example:
        >>> from geometry import bond_cell
        >>> cell = bond_cell((4, 2), h=1)
        >>> cell.bodies, sorted(cell.seams)
        (('COURSE 1', 'COURSE 2'), ['BED', 'HEAD'])
    """
    size = tuple(brick) if depth is None else (*brick, depth)
    joint = on_root(comm, lambda: repeated_bond(MeshOptions(h, cell=cell), size, cut))
    return periodic(joint, ("LEFT", "RIGHT"), ("BOTTOM", "TOP"))


def grains(
    width: float,
    height: float,
    grains: int | Sequence[Pair],
    h: Size = None,
    *,
    seed: int = 0,
    seams: Callable[[int, int], str] | None = None,
    comm: Comm = None,
    **cells: Unpack[SizeArgs],
) -> Joint:
    """Return the joint of the rectangle (0, width) x (0, height), filled with Voronoi grains. Collective.

    S consists of all boundaries between grains.

    Args:
        width, height: size, lengths > 0.
        grains: points (x, y) in the rectangle, one for each grain, or the number of grains, at least 2. A grain
            consists of all places nearest to its point. From a number, points are chosen at random and moved to the
            centroids of their grains three times. In at most 100 further steps, sides of grains shorter than 0.12 times
            the square root of the mean area of a grain are lengthened.
        h: largest cell size, a length (default: a tenth of the square root of the mean area of a grain). Grains do not
            depend on it.
        seed: whole number >= 0 for the random points; the same seed gives the same grains.
        seams: function of the numbers, from 1, of two grains that touch, the smaller number first; it returns the name
            of the seam between them (default: all are "S").
        h_S: cell size at S, a length (default: h).
        h_ends: cell size, a length, where boundaries of grains meet and end (default: h_S).
        comm: communicator whose rank 0 runs gmsh (default: MPI.COMM_WORLD).

    Returns:
        A joint of triangles with the regions "GRAIN 1", "GRAIN 2", ... in the order of the points. The grain with the
        larger number is on the upper side of S. The outer facet sets are "BOTTOM", "TOP", "LEFT", "RIGHT".

    Raises:
        InputError: a size or number is out of range; points lie outside, or two points coincide; a seam has the name of
            a side; a side of a grain is shorter than half a cell (the message names the place).

    Example:
        >>> from geometry import grains
        >>> joint = grains(4, 2, 6, h=0.5, seed=1)
        >>> [*joint.bodies]
        ['GRAIN 1', 'GRAIN 2', 'GRAIN 3', 'GRAIN 4', 'GRAIN 5', 'GRAIN 6']
    """
    options = MeshOptions.of(h, cells, SizeArgs)
    return on_root(comm, lambda: grain_rectangle(options, width, height, grains, seed, seams).build())


def faults(
    width: float, height: float, faults: Paths, h: Size = None, *, comm: Comm = None, **cells: Unpack[SizeArgs]
) -> Joint:
    """Return the joint of the block (0, width) x (0, height), which is cut by faults. Collective.

    S consists of all faults. Faults may cross, branch, and end inside or outside the block.

    Args:
        width, height: size, lengths > 0.
        faults: name -> points (x, y) of a fault, from one end to the other, joined by straight lines. Parts outside the
            block are cut off. A fault may branch from another: its first or last point then lies on the other, to
            1e-6 of the block's size, and the fault ends there.
        h: largest cell size, a length (default: a tenth of the smallest side).
        h_S: cell size at S, a length (default: h).
        h_ends: cell size, a length, where faults meet and end (default: h_S).
        comm: communicator whose rank 0 runs gmsh (default: MPI.COMM_WORLD).

    Returns:
        A joint of triangles with a seam for each fault. The upper side of a fault is on the left, seen from its first
        to its last point. The regions "BLOCK 1", "BLOCK 2", ... are the parts between faults, numbered by their
        centroids from left to right, then upwards. The outer facet sets are "BOTTOM", "TOP", "LEFT", "RIGHT".

    Raises:
        InputError: a size is out of range; a fault has fewer than two points, turns back, lies outside, on another
            fault or on a side, or has the name of a side; a fault ends within half a cell of another fault or a side
            without touching it (the message names the place).

    Example:
        >>> from geometry import faults
        >>> joint = faults(4, 2, {"A": [(0, 0.5), (4, 1.5)], "B": [(2, 2), (2, 1)]}, h=0.5)
        >>> [*joint.seams]
        ['A', 'B']
    """
    return on_root(comm, lambda: faulted_rectangle(MeshOptions.of(h, cells, SizeArgs), width, height, faults).build())
