"""Surface: profiles in order along S, fields on S, what is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from forms import LinearElastic, NonMonotoneUnrelaxed
from forms.base import InputError
from geometry import block, ring
from studies.problems import FOURIER_LAYER, fourier
from tests.meshes import renumbered
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, march, solve
from thinlayer.discretisation.state import Report, State

STEEL = LinearElastic(3.0, 2.0)
PURE = NonMonotoneUnrelaxed(60.0, 40.0, 1.2, 0.05, np.diag([0.3, 0.7]))
RADIUS = 1.2


def on(joint, law=FOURIER_LAYER):
    fixed_side = "INSIDE" if "INSIDE" in joint.facets else "TOP"
    return Structure(joint, body=STEEL, supports={fixed_side: 0.0}).interface(ThinLayer(law, 0.1, at=1.0))


def polar(x):
    return np.unwrap(np.arctan2(x[:, 1], x[:, 0]))


@cache
def state():
    joint, setup = fourier(1 / 8)
    return solve(Structure(joint, **setup).interface(ThinLayer(FOURIER_LAYER, 0.1, at=1.0)))


def test_profile_around_a_circle():
    """Once round from the place with the lowest x, not from side to side; an arc from end to end."""
    arc = Surface(on(ring(0.8, RADIUS, 2.0, 0.5, angle=3.0)))
    assert np.abs(np.diff(polar(arc.profile(arc.n)[0]))).sum() == pytest.approx(3.0)
    degree = 2
    joint = ring(0.8, RADIUS, 2.0, 0.5, degree=degree)
    profiles = []
    for variant in (joint, renumbered(joint)):
        surface = Surface(on(variant))
        x, y = surface.profile(surface.x[1])
        steps = np.diff(polar(x))
        assert (np.abs(steps) < 0.4).all()
        assert (np.sign(steps) == np.sign(steps[0])).all()
        assert np.hypot(*x.T) == pytest.approx(RADIUS)
        assert len(x) == len(np.unique(variant.table.vertices[variant.surface_rows]))
        assert x[1, 1] < 0 < x[-1, 1]  # towards the lower of the first one's neighbours
        assert x[0] == pytest.approx(x[np.lexsort(np.rint(x[:, ::-1] * 1e9).T)[0]])
        assert y == pytest.approx(x[:, 1], abs=0.05 if degree == 2 else 1e-12)
        profiles.append(x)
    assert profiles[1] == pytest.approx(profiles[0], abs=1e-14)


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
    (heights,) = surface.along(surface.places[:, 1])  # linear between nodes
    assert heights.crossings(0.3)[:, 1] == pytest.approx([0.3, 0.3])


def test_what_is_no_surface():
    model = state().model
    joint, setup = fourier(1 / 8)
    other = Structure(joint, **setup).interface(ThinLayer(FOURIER_LAYER, 0.1, at=1.0))
    refused(InputError, "Surface needs a model, not State.*: give the state's model", Surface, state())
    surface = Surface(model)
    for thing, message in (
        (march(model, [1.0]), r"takes a state, as solve returns it or history\.last is, not History"),
        (replace(state(), model=other), "another joint than the surface"),
    ):
        refused(InputError, message, surface.jump, thing)
        refused(InputError, message, surface.traction, thing)
    refused(InputError, "frame needs a vector field", surface.frame, surface.jump(state())[0])
    for field, message in (
        (state(), "State.* is not a field on S; give an array"),
        (surface.nodal(surface.jump(state())), r"is not a field on S.* \(\.\.\., 8, 3\)"),
        (np.arange(3.0), r"an array \(3,\) is not a field on S"),
        (None, "None is not a field on S"),
        (Surface(on(block(1, 1, 1.0))).n, "is not a field on S"),
    ):
        refused(InputError, message, surface.profile, field)
