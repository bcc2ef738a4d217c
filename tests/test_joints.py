"""Joints: turned, swapped, sublayers, a thickness that varies, bodies that cannot make room."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import ufl

from forms import LinearElastic
from forms.base import InputError
from geometry import sandwich
from geometry.inflating.inflation import inflate
from geometry.joint import Joint
from geometry.seam import Seam
from tests.refused import refused
from thinlayer import Structure, ThinLayer
from thinlayer.output.nodal_forces import nodal_forces

QUADS = np.array([[0, 1, 2, 3], [2, 3, 4, 5]])


def two_quadrilaterals(low=(0.0, -1.0), top=(1.0, 1.0)):
    """One above the other, S from (0, 0) to (1, 0); the lower left and the upper right corner."""
    points = np.array([low, (1, -1), (0, 0), (1, 0), (0, 1), top], float)
    regions = np.array([0, 1]), ("LOW", "UP")
    return Joint(points, QUADS, "quadrilateral", *regions, {"S": np.array([[2, 3]])}, {"S": Seam(("LOW",), ("UP",))})


def test_s_inside_one_body_swapped_and_rotated():
    """The direction of the upper side turns with the body, and round when sides are swapped."""
    two = sandwich(2.0, 0.8, 1.1, 0.5)
    joint = replace(two, region=0 * two.region, regions=("BODY",), seams={"S": Seam(direction=(0.3, 1.0))})
    assert joint.interface_normals == pytest.approx(two.interface_normals)
    assert joint.swapped().interface_normals == pytest.approx(-two.interface_normals)
    for angle in (1.0, 2.5, -2.0):
        assert joint.rotated(angle).interface_normals == pytest.approx(two.rotated(angle).interface_normals)


@pytest.mark.parametrize(("fractions", "cells"), [((0.05, 0.95), (1, 4)), ((0.45, 0.1, 0.45), (2, 1, 2)), ((), (4,))])
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
    points, facets = np.array(points, float), {"S": np.array([[0, 1]])}
    joint = Joint(points, np.array(cells), "triangle", region, ("C",), facets, {"S": Seam()})
    inflate(joint, 0.9)
    refused(InputError, r"no room for a layer of thickness 1\.2 at \(2\.1, -1\)", lambda: inflate(joint, 1.2))
    longer = replace(joint, points=np.vstack([joint.points[:-1], [4.5, -1.0]]))
    inflate(longer, 1.1)  # the end of S comes upon the arm, which slopes, at -10/9
    refused(InputError, r"no room for a layer of thickness 1\.12 at \(4, 0\)", lambda: inflate(longer, 1.12))


def test_sides_of_the_layer():
    """Supports of a side hold the side of the layer too, tractions do not load it; NAME/LAYER does."""
    joint, law = sandwich(2.0, 0.8, 1.1, 0.5, cell="quadrilateral"), LinearElastic(3.0, 2.0)
    supports, eps = {"LEFT": {"x": 0.0}, "BOTTOM": 0.0}, 0.2
    for name, height in (("RIGHT", 1.9), ("RIGHT/LAYER", eps), ("RIGHT/UPPER", 1.1)):
        structure = Structure(joint, body=law, supports=supports, tractions={name: (0.0, 3.0)})
        model = structure.full(ThinLayer(law, eps, at=1.0))
        load = nodal_forces(model.V, model.external_work(ufl.TestFunction(model.V), t=0.0))
        assert load.x.array.sum() == pytest.approx(3 * height)
        x, y = model.V.tabulate_dof_coordinates()[np.unique(model.supports.bc_dofs_in(model.V) // 2), :2].T
        assert ((x < 1e-12) & (np.abs(y) < 0.49 * eps)).sum() == 2 * 4 - 1
