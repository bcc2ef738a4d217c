"""Surface: profiles in order along S, expressions on S, what is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import ufl

from forms import LinearElastic
from geometry import block, ring
from studies.problems import FOURIER_LAYER, fourier
from tests.test_non_monotone_models import PURE
from thinlayer import Model, ModelError, PhaseReport, Surface, ThinLayer, march, solve
from thinlayer.state import Report, State

STEEL = LinearElastic(3.0, 2.0)
RADIUS = 1.2


def on(joint, law=FOURIER_LAYER):
    held = "INSIDE" if "INSIDE" in joint.facets else "TOP"
    return Model.interface(joint, layer=ThinLayer(law, 0.1), body=STEEL, supports={held: 0.0})


def renumbered(joint, seed=3):
    """The joint with its nodes and cells in another order."""
    random = np.random.default_rng(seed)
    nodes, cells = random.permutation(len(joint.points)), random.permutation(len(joint.cells))
    points = np.empty_like(joint.points)
    points[nodes] = joint.points
    facets = {name: nodes[rows] for name, rows in joint.facets.items()}
    return replace(joint, points=points, cells=nodes[joint.cells[cells]], region=joint.region[cells], facets=facets)


def polar(x):
    return np.unwrap(np.arctan2(x[:, 1], x[:, 0]))


@cache
def state():
    joint, setup = fourier(1 / 8)
    return solve(Model.interface(joint, layer=ThinLayer(FOURIER_LAYER, 0.1), **setup))


@pytest.mark.parametrize("degree", [1, 2])
def test_profile_around_a_circle(degree):
    """Once round from the place with the lowest x, not from side to side; straight edges and curved ones."""
    joint = ring(0.8, RADIUS, 2.0, 0.5, degree=degree)
    found = []
    for one in (joint, renumbered(joint)):
        surface = Surface(on(one))
        x, y = surface.profile(ufl.SpatialCoordinate(surface.model.domain.mesh)[1])
        steps = np.diff(polar(x))
        assert (np.abs(steps) < 0.4).all()
        assert (np.sign(steps) == np.sign(steps[0])).all()
        assert np.hypot(*x.T) == pytest.approx(RADIUS)
        assert len(x) == len(np.unique(one.table.vertices[one.surface_rows]))
        assert x[0] == pytest.approx(x[np.lexsort(np.rint(x[:, ::-1] * 1e9).T)[0]])
        assert y == pytest.approx(x[:, 1], abs=0.05 if degree == 2 else 1e-12)
        found.append(x)
    assert found[1] == pytest.approx(found[0], abs=1e-14)


def test_profile_of_an_arc():
    """From end to end, though x grows and falls."""
    surface = Surface(on(ring(0.8, RADIUS, 2.0, 0.5, angle=3.0)))
    x, _ = surface.profile(surface.sides.n)
    assert np.abs(np.diff(polar(x))).sum() == pytest.approx(3.0)


def test_fronts_around_a_circle():
    """Phase 1 where y > .3 on a closed S: two fronts, each between neighbours."""
    model = on(ring(0.8, RADIUS, 2.0, 0.3), PURE)
    (quadrature,) = model.quadratures
    memory = np.zeros((quadrature.count, sum(int(np.prod(s)) for s in PURE.internal.values())))
    x = quadrature.columns.centres[quadrature.columns.of]
    memory[:, list(PURE.internal).index("phase")] = x[:, 1] > 0.3
    report = PhaseReport(State(model, None, 0.0, Report("newton", 0, 0.0, 0.0), memory=(memory,)))
    places, phase = report.profile()
    assert (np.abs(np.diff(polar(places))) < 0.4).all()
    assert phase == pytest.approx((places[:, 1] > 0.3).astype(float))
    assert report.fronts[:, 1] == pytest.approx(0.3, abs=0.15)
    assert sorted(np.sign(report.fronts[:, 0])) == [-1, 1]
    assert np.hypot(*report.fronts.T) == pytest.approx(RADIUS, rel=0.03)


def test_scalars_are_components():
    surface = Surface(state().model)
    jump = surface.jump(state())
    places, values = surface.profile(jump)
    for k in range(2):
        x, found = surface.profile(jump[k])
        assert np.array_equal(x, places)
        assert found == pytest.approx(values[:, k], abs=1e-12 * np.abs(values).max())
    part = ufl.SpatialCoordinate(surface.model.domain.mesh)[0] > 0.25
    assert surface.integral(part) == pytest.approx(0.75, abs=0.1)
    assert surface.norm(jump[0]) ** 2 + surface.norm(jump[1]) ** 2 == pytest.approx(surface.norm(jump) ** 2)


def test_what_is_no_surface():
    model = state().model
    joint, setup = fourier(1 / 8)
    other = Model.interface(joint, layer=ThinLayer(FOURIER_LAYER, 0.1), **setup)
    for thing, message in (
        (None, "Surface needs an interface model, not None"),
        (state(), "Surface needs an interface model, not State.*: give the state's model"),
        (Model.bonded(joint, **setup), r"not Model\.bonded"),
    ):
        with pytest.raises(ModelError, match=message):
            Surface(thing)
    surface = Surface(model)
    for thing, message in (
        (march(model, [1.0]), r"takes a state, as solve returns it or history\.last is, not History"),
        (None, "not None"),
        (replace(state(), model=other), "another joint than the surface"),
    ):
        for field in (surface.jump, surface.traction, surface.displacement):
            with pytest.raises(ModelError, match=message):
                field(thing)
    linear = solve(Model.interface(model.joint, layer=model.layer, **setup, element="P1"))
    with pytest.raises(ModelError, match="has elements P1, the surface's model P2"):
        surface.jump(linear)
    sizes = [surface.norm(surface.traction(one)) for one in (linear, state())]
    assert sizes[0] == pytest.approx(sizes[1], rel=0.2)  # tractions can be compared, to P1's error


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        (lambda s: state(), "State.* is no UFL expression on S"),
        (lambda s: state().u, "field that jumps there; say on which side"),
        (lambda s: s.nodal(s.jump(state())), "field that jumps there"),
        (lambda s: ufl.as_vector([1.0, 2.0, 3.0]), r"shape \(3,\); allowed: that of a vector, \(2,\) or of a scalar"),
        (lambda s: ufl.SpatialCoordinate(on(block(1, 1, 1.0)).domain.mesh), "of another model's mesh"),
        (lambda s: ufl.FacetNormal(s.model.domain.mesh), "cannot be integrated over S: .*must be restricted"),
    ],
)
def test_what_is_no_expression_on_s(expression, message):
    surface = Surface(state().model)
    with pytest.raises(ModelError, match=message):
        surface.profile(expression(surface))


def test_forces_are_refused_as_integrands():
    surface = Surface(state().model)
    with pytest.raises(ModelError, match=r"shape \(2,\); allowed: that of a scalar"):
        surface.integral(surface.traction(state()))
    with pytest.raises(ModelError, match=r"shape \(\); allowed: that of a vector, \(2,\)"):
        surface.frame(surface.jump(state())[0])


def test_a_rigid_base_has_one_side():
    """There a field has its only value."""
    model = Model.interface(
        block(1.0, 0.5, 0.25), layer=ThinLayer(FOURIER_LAYER, 0.1), body=STEEL, supports={"TOP": {"y": 0.1}, "LEFT": 0}
    )
    found, surface = solve(model), Surface(model)
    assert surface.profile(found.u)[1] == pytest.approx(surface.profile(surface.jump(found))[1], abs=1e-14)
