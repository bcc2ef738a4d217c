"""Builders, names and inflation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geometry import Domain, GeometryError, Joint, block, inflate, sandwich
from geometry.topology import FacetTable, node_jacobians
from tests.refused import refused

SHAPES = {
    "block": lambda **kw: block(2.0, 1.5, 0.5, **kw),
    "graded block": lambda **kw: block(2.0, 1.5, 0.5, h_S=0.2, h_ends=0.05, **kw),
    "sandwich": lambda **kw: sandwich(2.0, 0.8, 1.1, 0.4, **kw),
    "graded sandwich": lambda **kw: sandwich(2.0, 0.8, 1.1, 0.4, h_S=0.1, h_ends=0.03, **kw),
}


def areas(joint: Joint) -> np.ndarray:
    corners = np.abs(node_jacobians(joint.points, joint.cells, joint.cell_type))
    return corners.mean(axis=1) / (2 if joint.cell_type == "triangle" else 1)


def sizes_on_s(joint: Joint) -> np.ndarray:
    return np.diff(np.sort(joint.points[np.unique(joint.facets["S"]), 0]))


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("shape", SHAPES)
def test_builders(shape, cell):
    joint = SHAPES[shape](cell=cell)
    assert areas(joint).sum() == pytest.approx(2.0 * (1.5 if "block" in shape else 1.9))
    expected = {"S", "TOP", "LEFT", "RIGHT"} | (set() if "block" in shape else {"BOTTOM"})
    assert set(joint.facets) == expected
    outer = (joint.table.cells[:, 1] < 0).sum()
    assert outer == sum(len(f) for name, f in joint.facets.items() if name != "S" or "block" in shape)
    assert joint.interface_normals == pytest.approx(np.tile([0.0, 1.0], (len(joint.facets["S"]), 1)))


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_grading(cell):
    """Sizes at S and at its ends are what was asked for, to half (gmsh and whole numbers of cells)."""
    sizes = sizes_on_s(block(2.0, 1.5, 0.5, h_S=0.2, h_ends=0.02, cell=cell))
    assert sizes[[0, -1]] == pytest.approx(0.02, rel=0.5)
    assert sizes.max() == pytest.approx(0.2, rel=0.5)
    assert sizes_on_s(block(2.0, 1.5, 0.25, cell=cell)) == pytest.approx(0.25)


def test_structured_diagonals():
    right = block(1.0, 1.0, 0.5, structured=True, arrangement="Right")
    left = block(1.0, 1.0, 0.5, structured=True, arrangement="Left")
    assert len(right.cells) == len(left.cells) == 8
    diagonals = {}
    for name, joint in (("right", right), ("left", left)):
        inner = joint.table.vertices[joint.table.cells[:, 1] >= 0]
        edges = joint.points[inner[:, 1]] - joint.points[inner[:, 0]]
        slanted = edges[np.abs(edges).min(axis=1) > 0.1]
        diagonals[name] = set(np.sign(slanted[:, 0] * slanted[:, 1]))
    assert diagonals["right"] != diagonals["left"]
    assert all(len(signs) == 1 for signs in diagonals.values())


@pytest.mark.parametrize("bodies", ["kept", "extended"])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("shape", SHAPES)
def test_inflation(shape, cell, bodies):
    base = SHAPES[shape](cell=cell).rotated(0.4)
    counts = set()
    for eps in (0.1, 1e-2, 1e-4):
        joint = inflate(base, eps, fractions=(0.25, 0.75), bodies=bodies)
        n = len(base.cells)
        whole, layer = areas(joint).sum(), areas(joint)[n:]
        assert layer.sum() == pytest.approx(2.0 * eps)
        assert whole == pytest.approx(areas(base).sum() + (2.0 * eps if bodies == "kept" else 0.0))
        lower = joint.region[n:] == joint.regions.index("LAYER/1")
        assert layer[lower].sum() == pytest.approx(0.25 * 2.0 * eps)
        sides = len(joint.facets["LEFT/LAYER"])
        assert sides == len(joint.facets["RIGHT/LAYER"]) == 4
        low = joint.facets["BASE" if base.rigid_base else "LOWER_FACE"]
        assert len(low) == len(joint.facets["UPPER_FACE"]) == len(base.facets["S"])
        gap = joint.points[joint.facets["UPPER_FACE"]].mean(axis=(0, 1)) - joint.points[low].mean(axis=(0, 1))
        assert gap == pytest.approx(eps * base.interface_normals[0], abs=1e-12)
        counts.add((len(joint.cells), len(joint.points)))
        assert (joint.table.cells[joint.table.index(joint.facets["TOP"]), 1] < 0).all()
        outer = (joint.table.cells[:, 1] < 0).sum()
        names = [f for name, f in joint.facets.items() if name not in ("UPPER_FACE", "LOWER_FACE")]
        assert outer == sum(map(len, names))
    assert len(counts) == 1  # thin layers cost no more cells than thick ones


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
    refused(GeometryError, r"did you mean 'LEFT'.*RIGHT", lambda: domain.values("LEFTT"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(eps=0.0), "eps is 0.0; it must be > 0"),
        (dict(eps=-0.1), "must be > 0"),
        (dict(eps=float("nan")), "must be > 0"),
        (dict(cells_through=0), "cells_through is 0"),
        (dict(cells_through=2.5), "cells_through is 2.5"),
        (dict(fractions=(0.5, 0.6)), "add up to 1"),
        (dict(fractions=(1.5, -0.5)), "add up to 1"),
        (dict(bodies="keep"), "did you mean 'kept'"),
        (dict(eps=3.0, bodies="extended"), "turn inside out"),
    ],
)
def test_inflation_errors(change, message):
    refused(GeometryError, message, lambda: inflate(SANDWICH, **({"eps": 0.1} | change)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(width=0.0, height=1.0), "width is 0.0"),
        (dict(width=1.0, height=float("inf")), "height of BODY is inf"),
        (dict(width=1.0, height=1.0, h=-1.0), "cell size h is -1.0; allowed"),
        (dict(width=1.0, height=1.0, h_ends=1e-7), "cell size h_ends"),
        (dict(width=1.0, height=1.0, cell="triangel"), "did you mean 'triangle'"),
        (dict(width=1.0, height=1.0, h_end=0.1), "unknown keyword 'h_end', did you mean 'h_ends'"),
        (dict(width=1.0, height=1.0, structured=True, arrangement="Up"), "known: AlternateLeft"),
    ],
)
def test_builder_errors(arguments, message):
    refused(GeometryError, message, lambda: block(**arguments))


def test_s_must_separate_two_bodies():
    half = SANDWICH.facets["S"][: len(SANDWICH.facets["S"]) // 2]
    with pytest.raises(GeometryError, match=r"S ends inside the bodies \(near .*, 0\)\): .*interface model"):
        inflate(replace(SANDWICH, facets={**SANDWICH.facets, "S": half}), 0.1)
    with pytest.raises(GeometryError, match="lie on the outer boundary"):
        replace(SANDWICH, facets={**SANDWICH.facets, "S": SANDWICH.facets["TOP"]})
    inside = SANDWICH.table.vertices[
        (SANDWICH.table.cells[:, 1] >= 0) & (np.ptp(SANDWICH.region[SANDWICH.table.cells], axis=1) == 0)
    ]
    with pytest.raises(GeometryError, match="same body on both sides"):
        replace(SANDWICH, facets={**SANDWICH.facets, "S": inside[:3]})
    refused(GeometryError, "no facets named 'S'", lambda: replace(SANDWICH, facets={"TOP": SANDWICH.facets["TOP"]}))
    with pytest.raises(GeometryError, match="'TOP' are an empty set"):
        replace(SANDWICH, facets={**SANDWICH.facets, "TOP": np.empty((0, 2), np.int64)})
    with pytest.raises(GeometryError, match="not facets of the mesh"):
        replace(SANDWICH, facets={**SANDWICH.facets, "TOP": np.array([[0, 1]])})
    refused(GeometryError, "already", lambda: inflate(inflate(SANDWICH, 0.1), 0.1))


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
    refused(GeometryError, "S is not planar", lambda: inflate(replace(exact, points=bent), 0.1))
