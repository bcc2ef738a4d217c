"""Rollers on inclined and curved sides: turned structures, closed forms, corners, values in time, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem

from forms import LinearElastic
from forms.base import InputError
from geometry import ring, sandwich
from geometry.topology import sum_by_number
from tests.refused import refused
from tests.supports_run import BODY, EPS, GLUE, KINDS, model, out_of_balance, turn
from thinlayer import Pressure, Structure, ThinLayer, solve
from thinlayer.discretisation.boundary import node_normals


def column(kind: str, angle: float, law=GLUE, t: float = 0.0, **change):
    """A column between inclined rollers, pressed by a pressure that grows along its top."""
    joint = sandwich(2.0, 0.5, 0.6, 0.5).rotated(angle) if angle else sandwich(2.0, 0.5, 0.6, 0.5)
    axis = turn(angle) @ np.array([1.0, 0.0])
    sides = {"BOTTOM": {"n": 0.0}, "LEFT": {"n": 0.0}, "RIGHT": {"n": lambda x, t: 0.01 + t}}
    load = {"TOP": Pressure(lambda x, t: 0.4 + 0.1 * (axis[0] * x[0] + axis[1] * x[1]))}
    return model(Structure(joint, body=BODY, **{"supports": sides, "tractions": load} | change), kind, law)


# ---------------------------------------------------------------- the same turned
@pytest.mark.parametrize("kind", KINDS)
def test_turned_columns(kind):
    """Along the axes and turned: the same energies and forces, within rounding."""
    straight, turned = (solve(column(kind, angle), t=0.02) for angle in (0.0, 0.4))
    assert straight.model.constraints.T is None  # normals along the axes need no other unknowns
    assert turned.model.constraints.T is not None
    for name, energy in straight.energies().items():
        assert turned.energies()[name] == pytest.approx(energy, rel=1e-9)
    for place in ("BOTTOM", "LEFT", "RIGHT"):
        reaction, other = straight.reaction(place), turned.reaction(place)
        assert turn(-0.4) @ other.force == pytest.approx(reaction.force, rel=1e-9, abs=1e-9)
        assert other.moment == pytest.approx(reaction.moment, rel=1e-8, abs=1e-9)
    assert out_of_balance(turned) < 1e-10
    same = solve(column(kind, 0.0, supports={"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.03}}), t=0.02)
    assert same.u.x.array == pytest.approx(straight.u.x.array, abs=1e-12)


def test_a_slope_in_three_dimensions():
    """A cube on an inclined plane and against two walls: corners of two and three planes. Turned, the same."""
    about = np.array([1.0, 2.0, -1.0])
    joint = sandwich(1.0, 0.5, 0.6, 0.5, depth=0.8)
    sides = {name: {"n": 0.0} for name in ("BOTTOM", "LEFT", "BACK")}
    states = []
    for cube in (joint, _rotated(joint, about)):
        structure = Structure(cube, body=BODY, supports=sides, tractions={"TOP": Pressure(0.7)}, element="P1")
        states.append(solve(model(structure, "interface")))
    straight, turned = states
    assert turned.energies()["bodies"] == pytest.approx(straight.energies()["bodies"], rel=1e-9)
    size = np.linalg.norm(straight.reaction("BOTTOM").force)
    assert (size, np.linalg.norm(turned.reaction("BOTTOM").force)) == pytest.approx((0.7 * 0.8, size), rel=1e-9)
    assert np.linalg.norm(turned.reaction("BACK").force) < 1e-9
    assert out_of_balance(turned) < 1e-10


def _rotated(joint, axis):
    """A joint in space, turned by .5 about an axis; its normals are found anew from its points."""
    K = np.cross(np.eye(3), axis / np.linalg.norm(axis))
    R = np.eye(3) + np.sin(0.5) * K + (1 - np.cos(0.5)) * K @ K
    return replace(joint, points=joint.points @ R.T)


# ---------------------------------------------------------------- curved sides
def test_lame():
    """A ring whose outer rim is held along its normal alone, pressed from inside: Lame's closed form of its stiffness."""
    a, b, E, nu, p = 1.0, 2.0, 100.0, 0.3, 2.0
    joint = ring(a, 1.5, b, h=0.25, degree=2)
    rightmost = tuple(map(float, joint.points[joint.points[:, 0].argmax()]))
    supports = {"OUTSIDE": {"n": 0.0}, rightmost: {"y": 0.0}}
    structure = Structure(joint, body=LinearElastic.young(E, nu), supports=supports, tractions={"INSIDE": Pressure(p)})
    state = solve(structure.bonded())
    # u = A r + B/r, u(b) = 0, sigma_r(a) = -p
    lmbda, mu = E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))
    B = p / (2 * (lmbda + mu) / b**2 + 2 * mu / a**2)
    assert _mean_radial(state) == pytest.approx(B * (1 / a - a / b**2), rel=2e-4)
    assert np.abs(state.reaction("OUTSIDE").force).max() < 1e-8  # each balances itself


def _mean_radial(state):
    model = state.model
    ds = model.ds(model.domain.values("INSIDE"))
    x = ufl.SpatialCoordinate(model.domain.mesh)
    outward = x / ufl.sqrt(ufl.dot(x, x))
    return state.integral(ufl.dot(state.u, outward) * ds) / state.integral(fem.Constant(model.domain.mesh, 1.0) * ds)


@pytest.mark.parametrize(("cell", "element", "around"), [("tetrahedron", "P1", 6), ("hexahedron", "Q1", 4)])
def test_normals_at_vertices_on_a_sphere(cell, element, around):
    """They are radii, to rounding, where facets of unlike size and shape go all round a vertex."""
    joint = sandwich(1.0, 0.5, 0.6, 0.3, depth=0.8, cell=cell, structured=True)
    x, y, z = joint.points.T * [[1], [1 / 0.6], [1]]
    x, z, centre = x + 0.3 * x**2, z - 0.2 * z**2 + 0.1 * x, np.array([0.5, -1.0, 0.4])
    height = centre[1] + np.sqrt(2.1**2 - (x - centre[0]) ** 2 - (z - centre[2]) ** 2)
    bent = replace(joint, points=np.column_stack([x, y * height, z]))
    model = Structure(bent, body=BODY, supports={"BOTTOM": 0.0}, element=element).bonded()
    blocks, normals = node_normals(model.domain, model.V, "TOP")
    vertices, here = np.unique(blocks, return_inverse=True)
    mean = sum_by_number(here, normals, len(vertices))
    radii = model.V.tabulate_dof_coordinates()[vertices] - centre
    inside = np.bincount(here) == around
    assert inside.sum() >= 4
    assert (mean / np.linalg.norm(mean, axis=1, keepdims=True))[inside] == pytest.approx(radii[inside] / 2.1, abs=1e-12)


# ---------------------------------------------------------------- refused
def test_refused():
    joint = sandwich(2.0, 0.5, 0.6, 0.5)
    squares, roller = sandwich(2.0, 0.5, 0.6, 0.5, cell="quadrilateral"), {"BOTTOM": {"n": 0.0}}
    for case_joint, supports, element, message in (
        (joint, {(0.0, -0.5): {"n": 0.0}}, "P2", "unknown component 'n'"),
        (joint, roller, "P2", "rigid motion of the structure"),
        (ring(1.0, 1.5, 2.0, h=0.5), {"OUTSIDE": {"n": 0.0}}, "P2", r"rigid motion of the structure \(rotation"),
        (squares, roller, "S2", "need nodal displacements, not elements S2"),
    ):
        refused(InputError, message, Structure(case_joint, body=BODY, supports=supports, element=element).bonded)
    turned = joint.rotated(0.3)
    clash = {"BOTTOM": {"n": 0.0, "y": 0.1, "x": 0.0}, "LEFT": {"n": 0.0}}
    message = r"contradictory supports at .* 'LEFT' prescribes n = 0"
    refused(InputError, message, Structure(turned, body=BODY, supports=clash).interface, ThinLayer(GLUE, EPS, at=1.0))
