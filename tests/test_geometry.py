"""Builders, names and inflation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from forms.base import InputError
from geometry import sandwich
from geometry.domain import Domain
from geometry.inflating.inflation import inflate
from geometry.joint import Joint
from geometry.topology import node_jacobians
from tests.refused import refused


def areas(joint: Joint) -> np.ndarray:
    corners = np.abs(node_jacobians(joint.points, joint.cells, joint.cell_type))
    return corners.mean(axis=1) / (2 if joint.cell_type == "triangle" else 1)


FRACTIONS = st.lists(st.floats(0.05, 1.0), min_size=1, max_size=4)


@settings(max_examples=15)
@given(eps=st.floats(1e-5, 0.3), layers=st.integers(1, 6), fractions=FRACTIONS, angle=st.floats(-3.0, 3.0))
def test_inflation_of_any_layer(eps, layers, fractions, angle):
    shares = tuple(f / sum(fractions) for f in fractions)
    base = SANDWICH.rotated(angle)
    joint = inflate(base, eps, cells_through=layers, fractions=shares if abs(sum(shares) - 1) < 1e-13 else ())
    body = areas(joint)[: len(base.cells)]
    moved = (joint.points - joint.reference)[joint.cells[: len(base.cells)]]  # the middle of S stays where it is
    assert np.linalg.norm(moved, axis=2) == pytest.approx(eps / 2, rel=1e-6)
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


def test_what_is_refused():
    for change, message in (
        (dict(eps=0.0), "eps is 0.0; it must be > 0"),
        (dict(eps=float("nan")), "must be > 0"),
        (dict(eps="thin"), "eps is 'thin'; it must be > 0"),
        (dict(fractions="ab"), "fractions .* must be numbers > 0"),
        (dict(cells_through=0), "cells_through is 0; the layer needs a whole number >= 1 of cells"),
        (dict(cells_through=2.5), "cells_through is 2.5"),
        (dict(fractions=(0.5, 0.6)), "add up to 1"),
        (dict(fractions=(1.5, -0.5)), "add up to 1"),
        (dict(bodies="keep"), "did you mean 'kept'"),
    ):
        refused(InputError, message, inflate, SANDWICH, **({"eps": 0.1} | change))
    refused(InputError, "angle is nan", lambda: SANDWICH.rotated(float("nan")))
    refused(InputError, r"point 3\.0 is not a place; give 2 coordinates", lambda: SANDWICH.nearest_point(3.0))


def test_s_must_separate_two_bodies():
    table, s = SANDWICH.table, SANDWICH.facets["S"]
    inside = table.vertices[(table.cells[:, 1] >= 0) & (np.ptp(SANDWICH.region[table.cells], axis=1) == 0)][:3]
    for facets, message in (
        ({"S": s[: len(s) // 2]}, r"S ends inside the bodies \(near .*, 0\)\): .*interface model"),
        ({"S": SANDWICH.facets["TOP"]}, "lie on the outer boundary"),
        ({"S": inside}, "same body on both sides"),
        ({"TOP": np.empty((0, 2), np.int64)}, "'TOP' are an empty set"),
        ({"TOP": np.array([[0, 1]])}, "not facets of the mesh"),
    ):
        changed = SANDWICH.facets | facets
        refused(InputError, message, lambda facet_sets=changed: inflate(replace(SANDWICH, facets=facet_sets), 0.1))
    refused(InputError, "unknown set of facets 'S'", lambda: replace(SANDWICH, facets={"TOP": SANDWICH.facets["TOP"]}))
    refused(InputError, "already", lambda: inflate(inflate(SANDWICH, 0.1), 0.1))


def test_planar_to_seven_digits():
    """Files may hold single precision: such an S still counts as planar, a curved one does not."""
    exact = sandwich(2.0, 0.8, 1.1, 0.4).rotated(0.4)
    rounded = replace(exact, points=exact.points.astype(np.float32).astype(float))
    assert np.ptp(rounded.interface_normals, axis=0).max() > 1e-9
    inflate(rounded, 0.1)
    bent = exact.points + 0.2 * np.sin(3 * exact.points[:, :1]) * np.array([[0.0, 1.0]])
    refused(InputError, "S is not planar", lambda: inflate(replace(exact, points=bent), 0.1))
