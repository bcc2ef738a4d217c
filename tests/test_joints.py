"""Joints: turned, swapped, sublayers, a thickness that varies, bodies that cannot make room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import ufl

from forms import LinearElastic
from forms.base import InputError
from geometry import disc, faults, ring, sandwich
from geometry.inflating.inflation import inflate
from geometry.joint import Joint
from geometry.seam import Seam
from geometry.topology import lagrange
from tests.refused import refused
from thinlayer import Structure, ThinLayer
from thinlayer.output.nodal_forces import nodal_forces

QUADS = np.array([[0, 1, 2, 3], [2, 3, 4, 5]])


def two_quadrilaterals(low=(0.0, -1.0), top=(1.0, 1.0)):
    """One above the other, S from (0, 0) to (1, 0); the lower left and the upper right corner."""
    points = np.array([low, (1, -1), (0, 0), (1, 0), (0, 1), top], float)
    regions = np.array([0, 1]), ("LOW", "UP")
    return Joint(points, QUADS, "quadrilateral", *regions, {"S": np.array([[2, 3]])}, {"S": Seam(("LOW",), ("UP",))})


@pytest.mark.parametrize("depth", [None, 1.0])
def test_rotated_turns_counter_clockwise(depth):
    joint = sandwich(2.0, 0.8, 1.1, 0.9, depth=depth, structured=True)
    turned = joint.rotated(np.pi / 2)
    x, y = joint.points[:, :2].T
    assert turned.points[:, 0] == pytest.approx(-y, abs=1e-15)
    assert turned.points[:, 1] == pytest.approx(x, abs=1e-15)
    assert (turned.points[:, 2:] == joint.points[:, 2:]).all()


def test_s_inside_one_body_swapped_and_rotated():
    """The direction of the upper side turns with the body, and round when sides are swapped."""
    two = sandwich(2.0, 0.8, 1.1, 0.5)
    seams = {"S": Seam(direction=(0.3, 1.0))}
    joint = replace(two, region=0 * two.region, regions=("BODY",), seams=seams)
    assert joint.interface_normals == pytest.approx(two.interface_normals)
    assert joint.swapped().interface_normals == pytest.approx(-two.interface_normals)
    for angle in (1.0, 2.5, -2.0):
        assert joint.rotated(angle).interface_normals == pytest.approx(two.rotated(angle).interface_normals)


def test_thickness_in_the_middle_of_curved_edges():
    """Linear between the vertices of S; the copies of a node in the layer are that far apart, to second order in eps."""
    joint, eps = ring(0.8, 1.2, 2.0, 0.5, angle=1.5, degree=2), 0.02

    def profile(x):
        return 1 + 0.5 * x[0] ** 2

    found, (a, b, middle) = joint.relative_thickness(profile), joint.surface.T
    assert found[a] == pytest.approx(profile(joint.points[a].T))
    assert found[middle] == pytest.approx((found[a] + found[b]) / 2)
    layer = inflate(joint, eps, profile=profile, cells_through=2, bodies="extended")
    for node in middle:
        copies = layer.points[(layer.reference == joint.points[node]).all(axis=1)]
        radii = np.hypot(*copies.T)
        assert np.ptp(radii) == pytest.approx(eps * found[node], rel=0.003)


@pytest.mark.parametrize(("fractions", "cells"), [((0.3, 0.7), (1, 3)), ((0.45, 0.1, 0.45), (2, 1, 2)), ((), (4,))])
def test_cells_of_sublayers(fractions, cells):
    """The share of the number of cells that is nearest to the sublayer's share of the thickness, at least one."""
    layer = inflate(two_quadrilaterals(), 0.2, cells_through=4, fractions=fractions)
    assert tuple(np.bincount(layer.region)[2:]) == cells


def test_a_cell_folded_at_some_corners():
    """Its right side is shorter than what it must give way, its left side is not."""
    joint = two_quadrilaterals(top=(1.0, 0.1))
    inflate(joint, 0.15, bodies="extended")
    with pytest.raises(InputError, match=r"1 cells turn inside out, the first at \(0\.5, 0\.275\)"):
        inflate(joint, 0.3, bodies="extended")


def test_a_scarf_with_cells_too_small_for_the_layer():
    """What the error asks for helps: larger cells at the sharp ends, a smaller eps, kept bodies."""
    scarf = {h: faults(100.0, 10.0, {"A": ((20.0, 0.0), (80.0, 10.0))}, h=h) for h in (1.0, 4.0)}
    with pytest.raises(InputError, match=r"smaller eps, larger cells there .*, or on planar seams bodies='kept'"):
        inflate(scarf[1.0], 0.8, bodies="extended")
    inflate(scarf[4.0], 0.8, bodies="extended")
    inflate(scarf[1.0], 0.2, bodies="extended")
    inflate(scarf[1.0], 0.8, bodies="kept")


def test_an_outer_face_nearly_along_s():
    """The body has to give way along it: 87.7 degrees from the normal of S are refused, 79 are not."""
    inflate(two_quadrilaterals(low=(-5.0, -1.0)), 0.01, bodies="extended")
    with pytest.raises(InputError, match=r"an outer face touches S at \(0, 0\) and is nearly parallel to it"):
        inflate(two_quadrilaterals(low=(-25.0, -1.0)), 0.01, bodies="extended")


def test_a_corner_of_the_fixed_body_in_the_way():
    """A layer on a rigid base grows down onto the tip of an arm below it, which no node of S would meet."""
    points = [(1, 0), (4, 0), (1, 1), (4, 1), (-1, 1), (-1, 0), (0, 0), (-1, -3), (0, -3), (0, -2), (2.1, -1)]
    cells = [[0, 1, 2], [1, 3, 2], [5, 6, 4], [6, 0, 2], [6, 2, 4], [7, 8, 9], [7, 9, 5], [5, 9, 6], [8, 10, 9]]
    region = np.zeros(len(cells), np.int64)
    joint = Joint(
        np.array(points, float), np.array(cells), "triangle", region, ("C",), {"S": np.array([[0, 1]])}, {"S": Seam()}
    )
    inflate(joint, 0.9)
    refused(InputError, r"no room for a layer of thickness 1\.2 at \(2\.1, -1\)", lambda: inflate(joint, 1.2))


def test_sides_of_the_layer():
    """Supports of a side hold the side of the layer too, tractions do not load it; NAME/LAYER does."""
    joint, law = sandwich(2.0, 0.8, 1.1, 0.5, cell="quadrilateral"), LinearElastic(3.0, 2.0)
    supports, eps = {"LEFT": {"x": 0.0}, "BOTTOM": 0.0}, 0.2
    for name, height in (("RIGHT", 1.9), ("RIGHT/LAYER", eps), ("RIGHT/UPPER", 1.1)):
        model = Structure(joint, body=law, supports=supports, tractions={name: (0.0, 3.0)}).full(
            ThinLayer(law, eps, at=1.0)
        )
        load = nodal_forces(model.V, model.external_work(ufl.TestFunction(model.V), t=0.0))
        assert load.x.array.sum() == pytest.approx(3 * height)
        x, y = model.V.tabulate_dof_coordinates()[np.unique(model.supports.held(model.V) // 2), :2].T
        assert ((x < 1e-12) & (np.abs(y) < 0.49 * eps)).sum() == 2 * 4 - 1


def test_vertices_of_a_point_on_s():
    """A place on S is one vertex of each side; in the meshed layer there are the levels between them too."""
    joint, law = sandwich(2.0, 0.8, 1.1, 0.5), LinearElastic(3.0, 2.0)
    bodies, layer = Structure(joint, body=law, supports={"BOTTOM": 0.0}), ThinLayer(law, 0.2, at=1.0)
    number = joint.nearest_point((0.0, 0.0))
    assert len(bodies.full(layer, cells_through=3).domain.vertices(number)) == 4
    assert len(bodies.interface(layer).domain.vertices(number)) == 1


def test_the_square_amid_a_disc_has_straight_edges():
    """Nodes of degree 2 are in the middle of their edges there."""
    joint = disc(1.0, 0.5, 0.4, 0.3, cell="hexahedron", degree=2)
    between = lagrange("hexahedron", 1).tabulate(0, lagrange("hexahedron", 2).points)[0, :, :, 0]
    straight = between @ joint.points[joint.corners]
    middle = np.hypot(*joint.points[joint.corners][..., [0, 2]].mean(axis=1).T) < 0.3
    assert middle.any()
    assert joint.points[joint.cells[middle]] == pytest.approx(straight[middle], abs=1e-12)
    assert np.abs(joint.points[joint.cells] - straight).max() > 1e-3
