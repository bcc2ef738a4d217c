"""Builders of networks and of a fibre: grains, faults that cross, branch and end, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from math import pi, tau

import numpy as np
import pytest
from scipy.spatial import cKDTree

from forms import LinearElastic
from forms.base import InputError
from geometry import faults, fibre, grains, periodic
from geometry.inflating.inflation import inflate
from geometry.joint import Joint
from tests.meshes import check_sound, volumes
from tests.network_cases import springs
from tests.refused import refused
from tests.test_networks import counts, cut_at
from thinlayer import Structure, homogenised_stiffness, solve

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
    found = solve(Structure(joint, body=LinearElastic.young(10.0, 0.25), supports=supports).interface(layer)).energies()
    return found["bodies"] + found["layer"]


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
    assert joint.splitting.pieces.max() + 1 == number
    found = counts(joint)
    assert max(found) <= 3
    assert found.get(3, 0) + ends_on_sides(joint) == 2 * (number - 1)
    again = grains(3.0, 2.0, number, 2.0 / np.sqrt(number) / 4, seed=seed)
    assert np.array_equal(again.points, joint.points)


def test_grains_do_not_depend_on_cells_but_on_their_seed():
    def junctions(**given):
        joint = grains(3.0, 2.0, 12, **given)
        return joint.points[joint.splitting.valence == 3]

    coarse, fine, other = junctions(h=0.15), junctions(h=0.1, h_ends=0.05), junctions(h=0.15, seed=1)
    assert cKDTree(coarse).query(fine)[0] == pytest.approx(0.0, abs=1e-9)
    assert len(other) != len(coarse) or cKDTree(coarse).query(other)[0].max() > 0.01


def test_grains_have_what_is_next_to_their_points():
    joint = grains(3.0, 2.0, POINTS, 0.15)
    check(joint, 6.0)
    middles = joint.points[joint.cells].mean(axis=1)
    assert np.array_equal(cKDTree(POINTS).query(middles)[1], joint.region)
    large = grains(3e3, 2e3, 1e3 * np.array(POINTS), 150.0)
    assert np.array_equal(large.cells, joint.cells)
    assert large.points == pytest.approx(1e3 * joint.points)


def test_four_grains_meet_where_their_points_are_square():
    joint = grains(3.0, 2.0, [(0.75, 0.5), (2.25, 0.5), (0.75, 1.5), (2.25, 1.5)], 0.25)
    assert counts(joint)[4] == 1
    assert max(counts(joint)) == 4
    assert joint.points[joint.splitting.valence == 4][0] == pytest.approx((1.5, 1.0))


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


def test_layers_between_grains_are_meshed():
    opened = inflate(grains(3.0, 2.0, POINTS, 0.15), 0.01, bodies="extended")
    assert volumes(opened).sum() == pytest.approx(6.0)
    refused(InputError, "cannot be moved apart in one piece", lambda: inflate(grains(3.0, 2.0, 12, 0.15), 0.01))


# ---------------------------------------------------------------- faults
CROSSING = {"FLAT": ((0.0, 4.0), (8.0, 4.0)), "STEEP": ((4.0, 0.0), (4.0, 8.0))}


def test_faults_that_cross():
    joint = faults(8.0, 8.0, CROSSING, 1.0)
    check(joint, 64.0)
    found = counts(joint)
    assert (found[2], found[4], max(found)) == (16, 1, 4)
    assert joint.regions == ("BLOCK 1", "BLOCK 2", "BLOCK 3", "BLOCK 4")
    centres = [joint.points[joint.cells[joint.region == k]].mean(axis=(0, 1)) for k in range(4)]
    assert np.array(centres) == pytest.approx(np.array([[2, 2], [2, 6], [6, 2], [6, 6]]), abs=0.5)


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
    opened = inflate(joint, {"A": 0.01, "B": 0.02}, bodies="extended")
    areas = volumes(opened)[opened.region == opened.regions.index("LAYER/JUNCTIONS")]
    assert areas.sum() == pytest.approx(0.01 * 0.02 / (way[0] / np.linalg.norm(way)), rel=1e-9)


def test_a_fault_that_branches_and_one_that_ends():
    """B ends on A, which has a kink; C has two tips. The same network is made by hand on one region."""
    given = {
        "A": ((0.0, 1.0), (4.0, 2.0), (8.0, 5.0)),
        "B": ((4.0, 6.0), (2.0, 1.5)),
        "C": ((5.5, 1.0), (6.5, 2.0), (7.5, 1.5)),
    }
    joint = faults(8.0, 6.0, given, 0.5)
    check(joint, 48.0)
    assert counts(joint)[3] == 1
    assert joint.points[joint.splitting.valence == 3][0] == pytest.approx((2.0, 1.5))
    tips = joint.points[
        np.setdiff1d(joint.table.vertices[joint.rows_of("C")], np.flatnonzero(joint.splitting.valence > 1))
    ]
    assert np.array(sorted(tips.tolist())) == pytest.approx(np.array([(5.5, 1.0), (7.5, 1.5)]))
    assert len(joint.regions) == 3

    def along(name):
        a, b = np.array(given[name][:-1]), np.array(given[name][1:])
        length = np.linalg.norm(b - a, axis=1)
        across = np.abs(b - a)[:, ::-1] / length[:, None]

        def on(x, n):  # n: sizes of the components of the normal
            detour = np.linalg.norm(x[:, None] - a, axis=2) + np.linalg.norm(x[:, None] - b, axis=2) - length
            return ((detour < 1e-9) & (np.abs(n[:, None] - across).max(axis=2) < 1e-6)).any(axis=1)

        (x, y), (u, v) = given[name][0], given[name][-1]
        return on, (y - v, u - x)

    by_hand = cut_at(joint, {name: along(name) for name in given})
    layers = {"A": springs(2.0, 0.7), "B": springs(1.0, 0.4), "C": springs(0.5, 0.3)}
    assert shifted(joint, layers) == pytest.approx(shifted(by_hand, layers), rel=1e-12)
    swapped = replace(joint, seams=joint.seams | {"B": joint.seams["B"].reversed()})
    assert shifted(swapped, layers) == pytest.approx(shifted(joint, layers), rel=1e-12)


def test_faults_do_not_depend_on_units_or_order():
    small = faults(8.0, 8.0, CROSSING, 1.0)
    large = faults(8e3, 8e3, {name: 1e3 * np.array(x) for name, x in CROSSING.items()}, 1e3)
    assert np.array_equal(small.cells, large.cells)
    layers = {"FLAT": springs(2.0, 0.7), "STEEP": springs(1.0, 0.4)}
    turned = faults(8.0, 8.0, {name: CROSSING[name][::-1] for name in ("STEEP", "FLAT")}, 1.0)
    assert shifted(turned, layers) == pytest.approx(shifted(small, layers), rel=0.01)  # another mesh


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "faults is {}; it must be {name: points of the fault}"),
        ({"A": ((0, 1),)}, "the fault 'A' is .*; it must be two points"),
        ({"A": ((0, 1), (2, "x"))}, "it must be two points"),
        ({"A": ((0, 1), (0, 1), (2, 1))}, "two points of the fault 'A' that follow each other are the same"),
        ({"LEFT": ((0, 1), (2, 1))}, "'LEFT' cannot be the name of a fault"),
        ({"A": ((0, 1), (4, 1), (4, 3), (3, 4), (1, 2.1))}, r"'A' turns back at \(3, 4\)"),
        ({"A": ((-3, 1), (-1, 2))}, r"the fault 'A' lies outside the block \(0, 8\) x \(0, 6\)"),
        ({"A": ((0, 1), (8, 1)), "B": ((2, 1), (4, 1))}, r"'A' and 'B' lie on each other at \(3, 1\)"),
        ({"A": ((2, 0), (4, 0))}, r"'BOTTOM' and 'A' lie on each other at \(3, 0\)"),
        ({"A": ((0, 1), (8, 1)), "B": ((3, 6), (3, 1.1))}, r"nearly touch .* at \(3, 1.05\): 0.1, less than 0.5 cells"),
        ({"A": ((0, 1), (7.9, 1))}, r"nearly touch each other or a side.* at \(7.95, 1\)"),
        ({"A": ((3, 3), (3.1, 3))}, r"nearly touch .*or are as short, at \(3.05, 3\)"),
        ({"A": ((0, 1), (8, 1)), "B": ((0, 0.7), (8, 1.3))}, r"meet each other or a side at 4.29 degrees at \(4, 1\)"),
    ],
)
def test_refused_faults(given, message):
    refused(InputError, message, lambda: faults(8.0, 6.0, given, 0.5))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (dict(grains=1), "grains is 1; it must be a whole number >= 2"),
        (dict(grains=2.5), "grains is 2.5"),
        (dict(grains=[(1.0, 1.0)]), "two points"),
        (dict(grains=[(1.0, 1.0), (4.0, 1.0)]), r"the point \(4, 1\) of a grain is not inside"),
        (dict(grains=[(1.0, 1.0), (2.0, 1.0), (1.0, 1.0)]), r"two points of grains are the same, \(1, 1\)"),
        (
            dict(grains=[(0.75, 0.5), (2.25, 0.5), (0.75, 1.5), (2.25, 1.52)]),
            r"boundaries of grains nearly touch .*\(1\.",
        ),
        (dict(grains=7, seed=-1), "seed is -1"),
        (dict(grains=7, seams=lambda a, b: "TOP"), "'TOP' cannot be the name of a seam"),
        (dict(grains=7, h=5.0), "cell size h is 5.0"),
        (dict(grains=7, width=-1.0), "width is -1.0; it must be > 0"),
    ],
)
def test_refused_grains(given, message):
    refused(InputError, message, lambda: grains(**{"width": 3.0, "height": 2.0, "h": 0.2} | given))


# ---------------------------------------------------------------- fibre
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize(("around", "cell"), [(1.0, "triangle"), (1.0, "quadrilateral"), ((2.0, 3.0), "triangle")])
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


def test_fibres_in_a_square_repeat():
    """The sides of the square match; of one law with stiff springs the cell is homogeneous."""
    cell = periodic(fibre(0.4, (1.0, 1.5), 0.15, degree=2), ("LEFT", "RIGHT"), ("BOTTOM", "TOP"))
    law = LinearElastic.young(2.0, 0.3)
    found = homogenised_stiffness(Structure(cell, body=law, supports={}).interface(springs(2e9, 1e9)))
    exact = law.lmbda * np.array([[1, 1, 0], [1, 1, 0], [0, 0, 0]]) + law.mu * np.diag([2, 2, 1])
    assert found == pytest.approx(exact, rel=1e-6, abs=1e-6)


def test_refused_fibres():
    for given, message in (
        (dict(around=0.3), "radius is 0.4; it must be less than the radius of the matrix, 0.3"),
        (dict(around=(2.0, 0.7)), "less than the smaller half side of the matrix, 0.35"),
        (dict(around=(1.0, 2.0, 3.0)), "around is .*; it must be a radius, or a width and a height"),
        (dict(around=(2.0, 2.0), cell="quadrilateral"), "needs a matrix with an outer circle"),
        (dict(around=1.0, degree=3), "degree is 3"),
    ):
        refused(InputError, message, fibre, 0.4, **given)
