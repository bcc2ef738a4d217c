"""Surface: profiles in order along S, fields on S, what is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from forms import LinearElastic, NonMonotoneUnrelaxed
from forms.base import InputError
from geometry import block, ring, sandwich
from studies.problems import FOURIER_LAYER, fourier
from tests.meshes import renumbered
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, march, solve
from thinlayer.discretisation.state import Audit, Report, State

STEEL = LinearElastic(3.0, 2.0)
PURE = NonMonotoneUnrelaxed(60.0, 40.0, 1.2, 0.05, np.diag([0.3, 0.7]))
RADIUS = 1.2


def on(joint, law=FOURIER_LAYER):
    held = "INSIDE" if "INSIDE" in joint.facets else "TOP"
    return Structure(joint, body=STEEL, supports={held: 0.0}).interface(ThinLayer(law, 0.1, at=1.0))


def polar(x):
    return np.unwrap(np.arctan2(x[:, 1], x[:, 0]))


@cache
def state():
    joint, setup = fourier(1 / 8)
    return solve(Structure(joint, **setup).interface(ThinLayer(FOURIER_LAYER, 0.1, at=1.0)))


@pytest.mark.parametrize("degree", [1, 2])
def test_profile_around_a_circle(degree):
    """Once round from the place with the lowest x, not from side to side; straight edges and curved ones."""
    joint = ring(0.8, RADIUS, 2.0, 0.5, degree=degree)
    found = []
    for one in (joint, renumbered(joint)):
        surface = Surface(on(one))
        x, y = surface.profile(surface.x[1])
        steps = np.diff(polar(x))
        assert (np.abs(steps) < 0.4).all()
        assert (np.sign(steps) == np.sign(steps[0])).all()
        assert np.hypot(*x.T) == pytest.approx(RADIUS)
        assert len(x) == len(np.unique(one.table.vertices[one.surface_rows]))
        assert x[1, 1] < 0 < x[-1, 1]  # towards the lower of the first one's neighbours
        assert x[0] == pytest.approx(x[np.lexsort(np.rint(x[:, ::-1] * 1e9).T)[0]])
        assert y == pytest.approx(x[:, 1], abs=0.05 if degree == 2 else 1e-12)
        found.append(x)
    assert found[1] == pytest.approx(found[0], abs=1e-14)


def test_profile_of_an_arc():
    """From end to end, though x grows and falls."""
    surface = Surface(on(ring(0.8, RADIUS, 2.0, 0.5, angle=3.0)))
    x, _ = surface.profile(surface.n)
    assert np.abs(np.diff(polar(x))).sum() == pytest.approx(3.0)


def test_fronts_around_a_circle():
    """Phases that grow with y on a closed S: more than half where y > .3, which is between neighbours in two places."""
    model = on(ring(0.8, RADIUS, 2.0, 0.3), PURE)
    ((key, quadrature),) = model.quadratures.items()
    memory = np.zeros((quadrature.count, sum(int(np.prod(s)) for s in PURE.internal.values())))
    memory[:, list(PURE.internal).index("phase")] = 0.5 + (quadrature.joint_x[1] - 0.3) / 1.6
    state = State(None, 0.0, {key: memory}, model=model, report=Report("newton", 0, 0.0, 0.0))
    surface = Surface(model)
    phase = surface.phase(state)
    assert phase[:, 0] == pytest.approx(0.5 + (surface.x[1].mean(axis=1) - 0.3) / 1.6, abs=1e-3)
    (line,) = surface.along(phase)
    fronts = line.crossings(0.5)
    assert fronts[:, 1] == pytest.approx(0.3, abs=0.3)  # a facet is that long
    assert sorted(np.sign(fronts[:, 0])) == [-1, 1]
    assert np.hypot(*fronts.T) == pytest.approx(RADIUS)


def test_scalars_are_components():
    surface = Surface(state().model)
    jump = surface.jump(state())
    places, values = surface.profile(jump)
    for k in range(2):
        x, found = surface.profile(jump[k])
        assert np.array_equal(x, places)
        assert found == pytest.approx(values[:, k], abs=1e-12 * np.abs(values).max())
    assert surface.integral(surface.x[0] > 0.25) == pytest.approx(0.75, abs=0.1)
    assert surface.norm(jump[0]) ** 2 + surface.norm(jump[1]) ** 2 == pytest.approx(surface.norm(jump) ** 2)


def test_what_is_no_surface():
    model = state().model
    joint, setup = fourier(1 / 8)
    other = Structure(joint, **setup).interface(ThinLayer(FOURIER_LAYER, 0.1, at=1.0))
    for thing, message in (
        (None, "Surface needs a model, not None"),
        (state(), "Surface needs a model, not State.*: give the state's model"),
    ):
        refused(InputError, message, Surface, thing)
    surface = Surface(model)
    for thing, message in (
        (march(model, [1.0]), r"takes a state, as solve returns it or history\.last is, not History"),
        (None, "not None"),
        (replace(state(), model=other), "another joint than the surface"),
    ):
        for field in (surface.jump, surface.traction, surface.displacements):
            refused(InputError, message, field, thing)


def test_all_models_of_a_joint_have_one_surface():
    """States of other elements are compared, to P1's error."""
    one, (_, setup) = state(), fourier(1 / 8)
    surface, structure = Surface(one.model), Structure(one.model.joint, **setup)
    for model in (structure.bonded(), structure.full(one.model.on_seams)):
        assert np.array_equal(Surface(model).traction(one), surface.traction(one))
    linear = solve(Structure(one.model.joint, **setup, element="P1").interface(one.model.on_seams))
    for field in (surface.jump, surface.traction):
        assert surface.norm(field(linear)) == pytest.approx(surface.norm(field(one)), rel=0.2)


@pytest.mark.parametrize(
    ("field", "message"),
    [
        (lambda s: state(), "State.* is no field on S; give an array"),
        (lambda s: state().u, "is no field on S"),
        (lambda s: s.nodal(s.jump(state())), r"is no field on S.* \(\.\.\., 8, 3\)"),
        (lambda s: np.arange(3.0), r"an array \(3,\) is no field on S"),
        (lambda s: None, "None is no field on S"),
        (lambda s: Surface(on(block(1, 1, 1.0))).n, "is no field on S"),
    ],
)
def test_what_is_no_field_on_s(field, message):
    surface = Surface(state().model)
    refused(InputError, message, lambda: surface.profile(field(surface)))


def test_scalars_have_no_frame():
    surface = Surface(state().model)
    refused(InputError, "frame needs a vector field", lambda: surface.frame(surface.jump(state())[0]))


def test_loads_of_one_body_in_the_states_of_a_march():
    """Of each state its own: what the upper body weighs at that time goes through S, and does the work."""
    joint = sandwich(1.0, 0.5, 0.7, 0.25)
    setup = {"body": STEEL, "supports": {"BOTTOM": 0.0}, "body_force": {"UPPER": lambda x, t: (0.0, t)}}
    for build in (Structure.interface, Structure.full):
        history = march(build(Structure(joint, **setup), ThinLayer(FOURIER_LAYER, 0.1, at=1.0)), [1.0, 2.0])
        energies = [one.energies() for one in history]
        assert [2 * (one["bodies"] + one["layer"]) for one in energies] == pytest.approx(
            [one["loads"] for one in energies], rel=1e-9
        )
        assert energies[2]["loads"] == pytest.approx(4 * energies[1]["loads"], rel=1e-9)
        if build == Structure.interface:
            surface = Surface(history.model)
        for one in history:
            assert surface.integral(surface.traction(one)[1]) == pytest.approx(0.7 * one.t, rel=1e-9)


@pytest.mark.parametrize("depth", [None, 1.0])
def test_frame_of_s(depth):
    """Tangents (n_2, -n_1) in 2D, the first and the third axis in 3D; the normal is last."""
    joint = sandwich(1.0, 0.5, 0.7, 0.5, depth=depth, cell="hexahedron" if depth else "quadrilateral").rotated(0.3)
    held = Structure(joint, body=STEEL, supports={"BOTTOM": 0.0}, element="Q1")
    surface = Surface(held.interface(ThinLayer(FOURIER_LAYER, 0.1, at=1.0)))
    n, along = np.array([-np.sin(0.3), np.cos(0.3)]), np.array([np.cos(0.3), np.sin(0.3)])
    f = 2 * along + 5 * n
    known = [2.0, 5.0]
    if depth:
        f, known = np.append(f, 3.0), [2.0, 3.0, 5.0]
    _, found = surface.profile(surface.frame(f[:, None, None] + 0 * surface.n))
    assert np.abs(found) == pytest.approx(np.tile(known, (len(found), 1)))
    assert found[:, -1] == pytest.approx(5.0)


def test_imbalance():
    """What is supplied less where it went, over the largest of the terms and of the energy that is stored."""
    assert Audit(supplied=2.0, stored=1.0, dissipated=0.5, remainder=0.25).imbalance == pytest.approx(0.125)
    assert Audit(supplied=1.0, stored=2.0, dissipated=0.5, remainder=0.0).imbalance == pytest.approx(-0.75)
    assert Audit(supplied=1.0, stored=0.8, total=10.0).imbalance == pytest.approx(0.02)
    assert Audit().imbalance == 0.0
    assert np.isnan(Audit(supplied=1.0, stored=float("nan")).imbalance)
