"""Builders, names and inflation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forms.base import InputError
from geometry import block, sandwich
from geometry.domain import Domain
from geometry.inflating.inflation import inflate
from geometry.joint import Joint
from geometry.topology import FacetTable, node_jacobians
from tests.refused import refused


def areas(joint: Joint) -> np.ndarray:
    corners = np.abs(node_jacobians(joint.points, joint.cells, joint.cell_type))
    return corners.mean(axis=1) / (2 if joint.cell_type == "triangle" else 1)


def sizes_on_s(joint: Joint) -> np.ndarray:
    return np.diff(np.sort(joint.points[np.unique(joint.facets["S"]), 0]))


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_grading(cell):
    """Sizes at S and at its ends are what was asked for, to half (gmsh and whole numbers of cells)."""
    sizes = sizes_on_s(block(2.0, 1.5, 0.5, h_S=0.2, h_ends=0.02, cell=cell))
    assert sizes[[0, -1]] == pytest.approx(0.02, rel=0.5)
    assert sizes.max() == pytest.approx(0.2, rel=0.5)
    assert sizes_on_s(block(2.0, 1.5, 0.25, cell=cell)) == pytest.approx(0.25)


def test_structured_diagonals():
    signs = []
    for arrangement in ("Left", "Right"):
        joint = block(1.0, 1.0, 0.5, structured=True, arrangement=arrangement)
        assert len(joint.cells) == 8
        inner = joint.table.vertices[joint.table.cells[:, 1] >= 0]
        edges = joint.points[inner[:, 1]] - joint.points[inner[:, 0]]
        (sign,) = set(np.sign(edges.prod(axis=1)[np.abs(edges).min(axis=1) > 0.1]))
        signs.append(sign)
    assert signs[0] == -signs[1]


@settings(max_examples=15)
@given(
    eps=st.floats(1e-5, 0.3),
    layers=st.integers(1, 6),
    fractions=st.lists(st.floats(0.05, 1.0), min_size=1, max_size=4),
    angle=st.floats(-3.0, 3.0),
)
def test_inflation_of_any_layer(eps, layers, fractions, angle):
    shares = tuple(f / sum(fractions) for f in fractions)
    base = SANDWICH.rotated(angle)
    joint = inflate(base, eps, cells_through=layers, fractions=shares if abs(sum(shares) - 1) < 1e-13 else ())
    body = areas(joint)[: len(base.cells)]
    assert body == pytest.approx(areas(base), rel=1e-6)
    assert areas(joint)[len(base.cells) :].sum() == pytest.approx(2.0 * eps, rel=1e-6)


SANDWICH = sandwich(2.0, 0.8, 1.1, 0.4)


def test_names():
    domain = Domain.of(inflate(SANDWICH, 0.1))
    assert set(domain.values("LEFT")) == set(domain.values("LEFT/LOWER")) | set(domain.values("LEFT/UPPER"))
    assert not set(domain.values("LEFT")) & set(domain.values("LEFT/LAYER"))
    assert set(domain.values("LEFT", layer_sides=True)) == set(domain.values("LEFT")) | set(domain.values("LEFT/LAYER"))
    assert Domain.of(SANDWICH).values("LEFT/LAYER") == ()
    refused(InputError, r"did you mean 'LEFT'.*RIGHT", lambda: domain.values("LEFTT"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(eps=0.0), "eps is 0.0; it must be > 0"),
        (dict(eps=-0.1), "must be > 0"),
        (dict(eps=float("nan")), "must be > 0"),
        (dict(eps="thin"), "eps is 'thin'; it must be > 0"),
        (dict(eps=True), "eps is True"),
        (dict(fractions="ab"), "fractions .* must be numbers > 0"),
        (dict(cells_through=0), "cells_through is 0; the layer needs a whole number >= 1 of cells"),
        (dict(cells_through=2.5), "cells_through is 2.5"),
        (dict(fractions=(0.5, 0.6)), "add up to 1"),
        (dict(fractions=(1.5, -0.5)), "add up to 1"),
        (dict(bodies="keep"), "did you mean 'kept'"),
        (dict(eps=3.0, bodies="extended"), "turn inside out"),
    ],
)
def test_inflation_errors(change, message):
    refused(InputError, message, lambda: inflate(SANDWICH, **({"eps": 0.1} | change)))


def test_places_and_angles_are_numbers():
    refused(InputError, "angle is nan", lambda: SANDWICH.rotated(float("nan")))
    refused(InputError, r"point 3\.0 is not a place; give 2 coordinates", lambda: SANDWICH.nearest_point(3.0))


def test_s_must_separate_two_bodies():
    table, s = SANDWICH.table, SANDWICH.facets["S"]
    same = np.ptp(SANDWICH.region[table.cells], axis=1) == 0
    inside = table.vertices[(table.cells[:, 1] >= 0) & same][:3]
    for facets, message in (
        ({"S": s[: len(s) // 2]}, r"S ends inside the bodies \(near .*, 0\)\): .*interface model"),
        ({"S": SANDWICH.facets["TOP"]}, "lie on the outer boundary"),
        ({"S": inside}, "same body on both sides"),
        ({"TOP": np.empty((0, 2), np.int64)}, "'TOP' are an empty set"),
        ({"TOP": np.array([[0, 1]])}, "not facets of the mesh"),
    ):
        changed = SANDWICH.facets | facets
        refused(InputError, message, lambda given=changed: inflate(replace(SANDWICH, facets=given), 0.1))
    refused(InputError, "no facets named 'S'", lambda: replace(SANDWICH, facets={"TOP": SANDWICH.facets["TOP"]}))
    refused(InputError, "already", lambda: inflate(inflate(SANDWICH, 0.1), 0.1))


def test_facet_table_refuses_three_cells_at_a_facet():
    with pytest.raises(ValueError, match="more than two cells"):
        FacetTable.of(np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]]), "triangle")


def test_planar_to_seven_digits():
    """Files may hold single precision: such an S still counts as planar, a slightly curved one does not."""
    exact = sandwich(2.0, 0.8, 1.1, 0.4).rotated(0.4)
    rounded = replace(exact, points=exact.points.astype(np.float32).astype(float))
    assert np.ptp(rounded.interface_normals, axis=0).max() > 1e-9
    inflate(rounded, 0.1)
    bent = exact.points + 1e-3 * np.sin(3 * exact.points[:, :1]) * np.array([[0.0, 1.0]])
    refused(InputError, "S is not planar", lambda: inflate(replace(exact, points=bent), 0.1))
