"""Builders in 3D and of round joints: shapes, names, normals, sizes, curved cells."""

from __future__ import annotations

from itertools import pairwise
from math import pi, tau

import numpy as np
import pytest

from forms.base import InputError
from geometry import block, disc, ring, sandwich
from geometry.joint import Joint
from geometry.shapes.sizing import Grading
from tests.meshes import check_sound, volumes
from tests.refused import refused

pytestmark = pytest.mark.few(5)

SIDES = {"S", "TOP", "LEFT", "RIGHT", "BACK", "FRONT"}
SOLIDS = ("tetrahedron", "hexahedron")
BOXES = [("tetrahedron", False), ("tetrahedron", True), ("hexahedron", False)]
PLANE = [("triangle", False), ("triangle", True), ("quadrilateral", False)]


def region_volumes(joint: Joint) -> dict[str, float]:
    cells = volumes(joint)
    return {name: cells[joint.region == k].sum() for k, name in enumerate(joint.regions)}


def check(joint: Joint, names: set[str]) -> None:
    """The facets' names; S between bodies apart, they are the outer boundary of sound cells."""
    assert set(joint.facets) == names
    check_sound(joint, names if joint.rigid_base else names - {"S"})


def on(joint: Joint, name: str) -> np.ndarray:
    """Coordinates of the vertices of named facets."""
    return joint.points[np.unique(joint.facets[name])]


@pytest.mark.parametrize(("cell", "structured"), PLANE + BOXES)
def test_boxes(cell, structured):
    depth, names = (1.0, SIDES) if cell in SOLIDS else (None, SIDES - {"BACK", "FRONT"})
    kind = dict(depth=depth, cell=cell, structured=structured)
    for joint in (block(2.0, 1.5, 0.5, **kind), sandwich(2.0, 0.8, 1.1, 0.4, h_S=0.2, h_ends=0.1, **kind)):
        two = len(joint.regions) == 2
        check(joint, names | {"BOTTOM"} if two else names)
        assert joint.cell_type == cell
        assert region_volumes(joint) == pytest.approx({"LOWER": 1.6, "UPPER": 2.2} if two else {"BODY": 3.0})
        assert joint.interface_normals == pytest.approx(np.tile(np.eye(joint.dim)[1], (len(joint.facets["S"]), 1)))
    planes = {"S": (1, 0), "BOTTOM": (1, -0.8), "TOP": (1, 1.1), "LEFT": (0, 0), "RIGHT": (0, 2)}
    for name, (axis, value) in (planes | ({"BACK": (2, 0), "FRONT": (2, 1)} if depth else {})).items():
        assert on(joint, name)[:, axis] == pytest.approx(value, abs=1e-12), name


@pytest.mark.parametrize(("cell", "structured"), BOXES)
def test_grading_of_boxes(cell, structured):
    """Sizes at the edges of S, on it and away from it are what was asked for, to half."""
    x, y, z = sandwich(2.0, 1.0, 1.0, 0.5, depth=2.0, h_S=0.2, h_ends=0.05, cell=cell, structured=structured).points.T
    along_edge = np.diff(np.sort(z[(np.abs(x) < 1e-9) & (np.abs(y) < 1e-9)]))
    if cell == "tetrahedron" and not structured:
        assert along_edge.mean() == pytest.approx(0.05, rel=0.5)
    else:  # graded in one direction each
        assert along_edge[[0, -1]] == pytest.approx(0.05, rel=0.5)
        assert along_edge.max() == pytest.approx(0.2, rel=0.5)
        upwards = np.diff(np.sort(y[(np.abs(x) < 1e-9) & (np.abs(z) < 1e-9)]))
        assert upwards[[0, -1]] == pytest.approx(0.5, rel=0.5)
        assert upwards.min() == pytest.approx(0.2, rel=0.5)


DISCS = [("tetrahedron", 0.0, 2), ("tetrahedron", 0.3, 1), ("hexahedron", 0.3, 2), ("hexahedron", 0.0, 1)]


@pytest.mark.few(1)
@pytest.mark.parametrize(("cell", "hole", "degree"), DISCS)
def test_disc(cell, hole, degree):
    joint = disc(1.0, 0.5, 0.4, 0.3, hole=hole, h_S=0.2, h_ends=0.1, cell=cell, degree=degree)
    check(joint, {"S", "BOTTOM", "TOP", "SIDE"} | ({"HOLE"} if hole else set()))
    area = pi * (1 - hole**2)
    exact = {"LOWER": 0.5 * area, "UPPER": 0.4 * area}
    error = max(abs(volume / exact[name] - 1) for name, volume in region_volumes(joint).items())
    assert error < 1e-5 if degree == 2 else 5e-4 < error < 0.01  # polygons of about 30 sides lose 0.7 %
    assert joint.interface_normals == pytest.approx(np.tile([0.0, 1.0, 0.0], (len(joint.facets["S"]), 1)))
    assert np.hypot(*on(joint, "SIDE")[:, [0, 2]].T) == pytest.approx(1.0)
    for name, y in (("BOTTOM", -0.5), ("S", 0.0), ("TOP", 0.4)):
        assert on(joint, name)[:, 1] == pytest.approx(y, abs=1e-12)
    if hole:
        assert np.hypot(*on(joint, "HOLE")[:, [0, 2]].T) == pytest.approx(hole)


RINGS = [("triangle", tau, 1), ("triangle", 4.0, 2), ("quadrilateral", 1.0, 1), ("quadrilateral", tau, 2),
     ("tetrahedron", 1.0, 2), ("tetrahedron", tau, 1), ("hexahedron", 4.0, 2), ("hexahedron", 1.0, 1)]  # fmt: skip


@pytest.mark.few(1)
@pytest.mark.parametrize(("cell", "angle", "degree"), RINGS)
def test_ring(cell, angle, degree):
    depth = 0.5 if cell in SOLIDS else None
    joint = ring(0.5, 1.0, 2.0, 0.4, angle=angle, depth=depth, h_S=0.2, cell=cell, degree=degree)
    names = {"S", "INSIDE", "OUTSIDE"}
    names |= set() if angle == tau else {"START", "END"}
    check(joint, names | ({"BACK", "FRONT"} if depth else set()))
    assert joint.regions == ("INNER", "OUTER") == joint.seams["S"].lower + joint.seams["S"].upper
    exact = {"INNER": angle / 2 * 0.75 * (depth or 1), "OUTER": angle / 2 * 3 * (depth or 1)}
    error = max(abs(volume / exact[name] - 1) for name, volume in region_volumes(joint).items())
    assert error < 1e-4 if degree == 2 else 1e-3 < error < 0.02  # about 20 to 30 sides to a circle
    for name, radius in (("S", 1.0), ("INSIDE", 0.5), ("OUTSIDE", 2.0)):
        assert np.hypot(*on(joint, name)[:, :2].T) == pytest.approx(radius), name
    corners = joint.table.vertices[joint.surface_rows]
    radial = joint.points[corners].mean(axis=1) * [1.0, 1.0, 0.0][: joint.dim]
    radial /= np.linalg.norm(radial, axis=1)[:, None]
    # exact but for triangles of a cylinder, whose centres are not amid their arcs
    assert (joint.interface_normals * radial).sum(axis=1).min() > (0.99 if cell == "tetrahedron" else 1 - 1e-9)
    if angle < tau:
        assert on(joint, "START")[:, 1] == pytest.approx(0.0, abs=1e-12)
        assert np.arctan2(*on(joint, "END")[:, 1::-1].T) % tau == pytest.approx(angle)
    if depth:
        assert on(joint, "BACK")[:, 2] == pytest.approx(0.0)
        assert on(joint, "FRONT")[:, 2] == pytest.approx(depth)


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_curved_cells_meet_circles_to_fourth_order(cell):
    errors = []
    for h in (0.2, 0.1, 0.05):
        errors.append(abs(region_volumes(ring(0.5, 1.0, 2.0, h, angle=2.0, cell=cell, degree=2))["OUTER"] / 3 - 1))
    assert all(coarse / fine == pytest.approx(16, rel=0.1) for coarse, fine in pairwise(errors))
    assert errors[-1] < 1e-7


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_grading_of_rings(cell):
    joint = ring(0.5, 1.0, 3.0, 0.6, angle=2.0, h_S=0.1, h_ends=0.02, cell=cell)
    turn = np.sort(np.arctan2(*on(joint, "S")[:, ::-1].T))
    assert (np.diff(turn)[[0, -1]], np.diff(turn).max()) == pytest.approx((0.02, 0.1), rel=0.5)
    radius = np.unique(np.round(np.hypot(*on(joint, "START").T), 9))
    assert np.diff(radius).max() == pytest.approx(0.6, rel=0.5)
    if cell == "quadrilateral":
        assert np.diff(radius).min() == pytest.approx(0.1, rel=0.5)


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_thin_curved_cells_do_not_fold(cell):
    """Cells much thinner than the arcs' height over their chords, at circles and next to them."""
    if cell == "hexahedron":
        for hole in (0.0, 0.2):
            joint = disc(1.0, 0.5, 0.5, 0.5, hole=hole, h_S=0.3, h_ends=0.003, cell=cell, degree=2)
            check(joint, {"S", "BOTTOM", "TOP", "SIDE"} | ({"HOLE"} if hole else set()))
    else:
        check(ring(0.9, 1.0, 1.1, 0.01, h_S=0.3, cell=cell, degree=2), {"S", "INSIDE", "OUTSIDE"})


def test_layers():
    """Layers fill their length and are as large as asked for where they begin, or half of the length if that is less."""
    for first, last, symmetric in ((0.1, 0.1, False), (0.01, 0.2, True), (0.2, 0.01, False), (0.05, 3.0, True)):
        sizes = np.diff([0.0, *Grading.of(1.0, first, last, symmetric=symmetric).cell_ends])
        assert sizes.min() > 0
        assert sizes.sum() == pytest.approx(1.0)
        assert sizes[0] == pytest.approx(first, rel=0.5)
        assert sizes[-1] == pytest.approx(sizes[0] if symmetric else min(last, 0.7), rel=0.5)
    assert Grading.of(1.0, 0.01, 0.2, backwards=True).cell_ends[0] == pytest.approx(0.2, rel=0.5)


def test_errors():
    for build, message in (
        (lambda: block(1.0, 1.0, depth=0.0), "depth is 0.0; it must be > 0"),
        (lambda: block(1.0, float("inf")), "height of BODY is inf"),
        (lambda: block(1.0, 1.0, -1.0), "cell size h is -1.0; allowed"),
        (lambda: block(1.0, 1.0, cell="triangel"), "did you mean 'triangle'"),
        (lambda: block(1.0, 1.0, h_end=0.1), "unknown keyword 'h_end', did you mean 'h_ends'"),
        (lambda: block(1.0, 1.0, structured=True, arrangement="Up"), "known: AlternateLeft"),
        (lambda: sandwich(1.0, 1.0, 1.0, depth=1.0, cell="triangle"), "cell in 3D 'triangle'; known: hexahedron, tet"),
        (lambda: block(1.0, 1.0, depth=2.0, h=2.5), "cell size h is 2.5; allowed: 2e-05 to 2"),
        (lambda: disc(1.0, 1.0, 1.0, hole=1.0), r"hole is 1.0; it must be 0 \(no hole\) or a radius less than 1.0"),
        (lambda: disc(1.0, 1.0, 1.0, h_S=1e-6), "cell size h_S"),
        (lambda: disc(1.0, 1.0, 1.0, degree=3), "degree is 3; allowed: 1"),
        (lambda: ring(1.0, 1.0, 2.0), "inner=1.0, interface=1.0, outer=2.0: radii must grow"),
        (lambda: ring(0.5, 1.0, 2.0, angle=0.0), "angle is 0.0; it must be > 0 and at most 2 pi"),
        (lambda: ring(0.5, 1.0, 2.0, angle=6.3), "angle is 6.3"),
        (lambda: sandwich(1.0, 1.0, 1e-8, 0.5, depth=1.0), "height of UPPER is 1e-08; allowed: at least 1e-06"),
        (lambda: block(1e9, 1e9, 1e8, depth=1.0), r"depth is 1; allowed: at least 1000 \(1e-06 of the largest"),
        (lambda: ring(0.5, 1 - 1e-8, 1.0, 0.1), "thinnest part is 1e-08"),
        (lambda: disc(1.0, 1.0, 1.0, 0.5, hole=1e-9, cell="hexahedron"), "hole is 1e-09"),
        (lambda: block(1.0, 2e-5), "default cell size h is 2e-06; give h, from 1e-05 on"),
    ):
        refused(InputError, message, build)
