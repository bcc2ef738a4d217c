"""Builders of networks and of a fibre: grains, faults that cross, branch and end, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from math import pi, tau

import numpy as np
import pytest
from scipy.spatial import cKDTree

from forms import LinearElastic
from forms.base import InputError
from geometry import faults, fibre, grains
from geometry.inflating.inflation import inflate
from geometry.joint import Joint
from tests.meshes import check_sound, volumes
from tests.network_cases import springs
from tests.refused import refused
from tests.test_networks import counts
from thinlayer import Structure, solve

SIDES = {"BOTTOM", "TOP", "LEFT", "RIGHT"}
POINTS = [(0.4, 0.3), (1.9, 0.4), (2.6, 1.2), (1.1, 1.4), (0.3, 1.6)]


def check(joint: Joint, area: float) -> None:
    """The mesh fills the area, and its sides are the outer boundary of sound cells."""
    assert volumes(joint).sum() == pytest.approx(area)
    assert set(joint.facets) == SIDES | set(joint.seams)
    check_sound(joint, SIDES)


def shifted(joint: Joint, layer) -> float:
    """Energy of a body whose top is shifted."""
    supports = {"BOTTOM": 0.0, "TOP": {"x": 0.1, "y": -0.05}}
    body = LinearElastic.young(10.0, 0.25)
    energies = solve(Structure(joint, body=body, supports=supports).interface(layer)).energies()
    return energies["bodies"] + energies["layer"]


def ends_on_sides(joint: Joint) -> int:
    """Number of vertices of S on the outer boundary."""
    outer = joint.table.vertices[joint.table.cells[:, 1] < 0]
    return len(np.intersect1d(outer, joint.table.vertices[joint.surface_rows]))


# ---------------------------------------------------------------- grains
@pytest.mark.parametrize(("number", "seed"), [(2, 4), (7, 1), (40, 3)])
def test_grains_meet_by_threes(number, seed):
    """By Euler's formula 2 (n - 1) sides of n grains end, three at a time inside, each by itself on the boundary."""
    joint = grains(3.0, 2.0, number, 2.0 / np.sqrt(number) / 4, seed=seed)
    check(joint, 6.0)
    assert joint.regions == tuple(f"GRAIN {k + 1}" for k in range(number))
    assert joint.split_mesh.pieces.max() + 1 == number
    by_valence = counts(joint)
    assert max(by_valence) <= 3
    assert by_valence.get(3, 0) + ends_on_sides(joint) == 2 * (number - 1)
    assert np.array_equal(grains(3.0, 2.0, number, 2.0 / np.sqrt(number) / 4, seed=seed).points, joint.points)


def test_grains_do_not_depend_on_cells_or_units_but_on_their_seed():
    """They have what is next to their points."""

    def junctions(points=12, **options):
        joint = grains(3.0, 2.0, points, **options)
        return joint.points[joint.split_mesh.component_counts > 2]

    coarse, fine, other = junctions(h=0.15), junctions(h=0.1, h_ends=0.05), junctions(h=0.15, seed=1)
    assert cKDTree(coarse).query(fine)[0] == pytest.approx(0.0, abs=1e-9)
    assert len(other) != len(coarse) or cKDTree(coarse).query(other)[0].max() > 0.01
    square = [(0.75, 0.5), (2.25, 0.5), (0.75, 1.5), (2.25, 1.5)]
    assert junctions(square, h=0.25) == pytest.approx(np.array([[1.5, 1.0]]))
    joint, large = grains(3.0, 2.0, POINTS, 0.15), grains(3e3, 2e3, 1e3 * np.array(POINTS), 150.0)
    assert np.array_equal(cKDTree(POINTS).query(joint.points[joint.cells].mean(axis=1))[1], joint.region)
    assert np.array_equal(large.cells, joint.cells)
    assert large.points == pytest.approx(1e3 * joint.points)
    assert volumes(inflate(joint, 0.01, bodies="extended")).sum() == pytest.approx(6.0)
    refused(InputError, "cannot be moved apart in one piece", inflate, grains(3.0, 2.0, 12, 0.15), 0.01)


def test_seams_between_grains_are_named_by_the_user():
    joint = grains(3.0, 2.0, POINTS, 0.15, seams=lambda a, b: "WITH 1" if a == 1 else "OTHERS")
    check(joint, 6.0)
    assert tuple(joint.seams) == ("OTHERS", "WITH 1")
    for name in joint.seams:
        cells = joint.table.cells[joint.rows_of(name)]
        assert ((joint.region[cells] == 0).any(axis=1) == (name == "WITH 1")).all()
    layer = springs(2.0, 0.7)
    whole = grains(3.0, 2.0, POINTS, 0.15)
    assert shifted(joint, {"OTHERS": layer, "WITH 1": layer}) == pytest.approx(shifted(whole, layer), rel=1e-12)
    assert shifted(joint, {"OTHERS": layer, "WITH 1": springs(1.0, 0.5)}) < 0.99 * shifted(whole, layer)


# ---------------------------------------------------------------- faults
def left_of(joint: Joint, name: str, way) -> np.ndarray:
    """Normals of a seam times the vector to the left of a way."""
    return joint.interface_normals[joint.seam_numbers == list(joint.seams).index(name)] @ (-way[1], way[0])


def test_faults_that_cross_at_an_angle():
    """The layers' crossing is a parallelogram; upper sides are on the left."""
    way = np.array([3.0, 2.0])
    joint = faults(8.0, 6.0, {"A": ((-1.0, 1.0), (9.0, 1.0 + 20 / 3)), "B": ((5.0, 6.0), (5.0, 0.0))}, 0.5)
    check(joint, 48.0)
    assert counts(joint)[4] == 1
    assert left_of(joint, "A", way) == pytest.approx(np.linalg.norm(way))
    assert left_of(joint, "B", (0.0, -1.0)) == pytest.approx(1.0)
    assert joint.regions == ("BLOCK 1", "BLOCK 2", "BLOCK 3", "BLOCK 4")
    x = np.array([joint.points[joint.cells[joint.region == k]].mean(axis=(0, 1)) for k in range(4)])
    assert [row[0] > 5 for row in x] == [False, False, True, True]  # from left to right
    opened = inflate(joint, {"A": 0.01, "B": 0.02}, bodies="extended")
    areas = volumes(opened)[opened.region == opened.regions.index("LAYER/JUNCTIONS")]
    assert areas.sum() == pytest.approx(0.01 * 0.02 / (way[0] / np.linalg.norm(way)), rel=1e-9)


def test_a_fault_that_branches_and_one_that_ends():
    """B ends on A, which has a kink; C has two tips."""
    polylines = {"A": ((0, 1), (4, 2), (8, 5)), "B": ((4, 6), (2, 1.5)), "C": ((5.5, 1), (6.5, 2), (7.5, 1.5))}
    joint = faults(8.0, 6.0, polylines, 0.5)
    check(joint, 48.0)
    assert counts(joint)[3] == 1
    assert joint.points[joint.split_mesh.component_counts == 3][0] == pytest.approx((2.0, 1.5))
    ends = np.setdiff1d(joint.table.vertices[joint.rows_of("C")], np.flatnonzero(joint.split_mesh.component_counts > 1))
    assert np.array(sorted(joint.points[ends].tolist())) == pytest.approx(np.array([(5.5, 1.0), (7.5, 1.5)]))
    assert len(joint.regions) == 3

    layers = {"A": springs(2.0, 0.7), "B": springs(1.0, 0.4), "C": springs(0.5, 0.3)}
    swapped = replace(joint, seams=joint.seams | {"B": joint.seams["B"].reversed()})
    assert shifted(swapped, layers) == pytest.approx(shifted(joint, layers), rel=1e-12)


def test_refused_faults():
    for polylines, message in (
        ({}, "faults is {}; it must be {name: points of the fault}"),
        ({"A": ((0, 1),)}, "the fault 'A' is .*; it must be two points"),
        ({"A": ((0, 1), (0, 1), (2, 1))}, r"'A' turns back at \(0, 1\)"),
        ({"LEFT": ((0, 1), (2, 1))}, "of facets|facets of 'LEFT' lie on the outer boundary"),
        ({"A": ((0, 1), (4, 1), (4, 3), (3, 4), (1, 2.1))}, r"'A' turns back at \(3, 4\)"),
        ({"A": ((-3, 1), (-1, 2))}, "the fault 'A' lies outside the block"),
        ({"A": ((2, 0), (4, 0))}, "the fault 'A' lies outside the block"),
        ({"A": ((0, 1), (8, 1)), "B": ((2, 1), (4, 1))}, "facets are in two seams, 'A' and 'B'"),
        ({"A": ((0, 1), (8, 1)), "B": ((3, 6), (3, 1.1))}, r"nearly touch .* at \(3, 1.05\): 0.1, less than 0.5 cells"),
        ({"A": ((0, 1), (7.9, 1))}, r"nearly touch each other or a side at \(7.95, 1\)"),
    ):
        refused(InputError, message, faults, 8.0, 6.0, polylines, 0.5)


def test_refused_grains():
    for options, message in (
        (dict(grains=1), "grains is 1; it must be a whole number >= 2"),
        (dict(grains=[(1.0, 1.0), (4.0, 1.0)]), r"the point \(4, 1\) of a grain is not inside"),
        (dict(grains=[(1.0, 1.0), (2.0, 1.0), (1.0, 1.0)]), r"two points of grains are the same, \(1, 1\)"),
        (dict(grains=[(0.75, 0.5), (2.25, 0.5), (0.75, 1.5), (2.25, 1.52)]), r"of grains nearly touch .*\(1\."),
        (dict(grains=7, seed=-1), "seed is -1"),
        (dict(grains=7, seams=lambda a, b: "TOP"), "facets of 'TOP' lie on the outer boundary"),
        (dict(grains=7, h=5.0), "cell size h is 5.0"),
    ):
        refused(InputError, message, grains, **{"width": 3.0, "height": 2.0, "h": 0.2} | options)


# ---------------------------------------------------------------- fibre
FIBRES = [(1.0, "triangle", 1), (1.0, "quadrilateral", 2), ((2.0, 3.0), "triangle", 1)]


@pytest.mark.parametrize(("around", "cell", "degree"), FIBRES)
def test_fibre(around, cell, degree):
    joint = fibre(0.4, around, 0.1, cell=cell, degree=degree)
    check_sound(joint, joint.facets.keys() - {"S"})
    size, fit = volumes(joint), 1e-4 if degree == 2 else 0.02
    assert joint.regions == ("FIBRE", "MATRIX")
    assert size[joint.region == 0].sum() == pytest.approx(pi * 0.16, rel=fit)
    assert size.sum() == pytest.approx(pi if cell == "quadrilateral" or around == 1.0 else 6.0, rel=fit)
    n = len(joint.facets["S"])
    assert 20 <= n <= tau * 0.4 / 0.1 + 8
    assert {k: v for k, v in counts(joint).items() if k > 1} == {2: n}
    assert np.hypot(*joint.points[joint.surface.ravel()].T) == pytest.approx(0.4)
    x = joint.points[joint.surface].mean(axis=1)
    assert (joint.interface_normals * x).sum(axis=1).min() > 0.39  # from the fibre to the matrix
    assert set(joint.facets) == {"S"} | ({"OUTSIDE"} if around == 1.0 else SIDES)
    if degree == 1:
        for eps in (0.04, 4e-4):
            inflate(joint, eps, bodies="extended")


def test_refused_fibres():
    for options, message in (
        (dict(around=0.3), "radius is 0.4; it must be less than the radius of the matrix"),
        (dict(around=(2.0, 0.7)), "less than the smaller half side of the matrix"),
        (dict(around=(1.0, 2.0, 3.0)), "around is .*; it must be a radius, or a width and a height"),
        (dict(around=(2.0, 2.0), cell="quadrilateral"), "needs a matrix with an outer circle"),
    ):
        refused(InputError, message, fibre, 0.4, **options)
