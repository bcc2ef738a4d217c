"""Curved S and thickness varying along S."""

from __future__ import annotations

import numpy as np
import pytest
import ufl

from forms import Anisotropic, LinearElastic
from forms.base import InputError
from geometry import ring
from geometry.seam import Seam
from studies.problems import FOURIER_LAYER, fourier
from tests.cylinders import lame
from tests.meshes import part_of
from tests.orders import observed_orders
from tests.refused import refused
from thinlayer import RangeWarning, Structure, Surface, ThinLayer, compare, estimate, goals, solve

pytestmark = pytest.mark.few(5)

INNER, OUTER = LinearElastic.young(200.0, 0.3), LinearElastic.young(70.0, 0.33)
GLUE = LinearElastic(lmbda=3.0, mu=2.0)
RADII = (1.0, 1.5, 2.0)
PRESSURE, SHEAR = 1.3, 0.7
EPS = (0.1, 0.05, 0.025)


def radial(x):
    return ufl.as_vector([x[0], x[1]]) / ufl.sqrt(x[0] ** 2 + x[1] ** 2)


def pressed(joint) -> dict:
    """A quarter of a tube, free outside, under pressure from inside."""
    load = lambda x, t: tuple(PRESSURE * radial(x)[k] for k in range(2))
    supports = {"START": {"y": 0.0}, "END": {"x": 0.0}}
    return {"body": {"INNER": INNER, "OUTER": OUTER}, "supports": supports, "tractions": {"INSIDE": load}}


def twisted(joint) -> dict:
    """A tube held inside, under a torque from outside."""
    load = lambda x, t: (-SHEAR * radial(x)[1], SHEAR * radial(x)[0])
    return {"body": {"INNER": INNER, "OUTER": OUTER}, "supports": {"INSIDE": 0.0}, "tractions": {"OUTSIDE": load}}


def test_pressed_tube():
    """Interface model against Lame's solution; curved cells are needed for that, straight ones have another S."""
    exact, R = lame(RADII, (INNER, OUTER), (GLUE.lmbda + 2 * GLUE.mu,), PRESSURE), RADII[1]
    traction, jump = exact.stress(0, R), exact.displacement(1, R) - exact.displacement(0, R)
    errors = []
    for degree in (1, 2):
        joint = ring(*RADII, 0.125, angle=np.pi / 2, degree=degree)
        state = solve(Structure(joint, **pressed(joint)).interface(ThinLayer(GLUE, 0.1, at=1.0)))
        surface = Surface(state.model)
        r = surface.x / np.hypot(*surface.x)
        errors.append(surface.norm(surface.jump(state) - jump * r) / surface.norm(jump * r))
        assert surface.norm(surface.traction(state) - traction * r) < 1e-2 * abs(traction)
    assert errors[0] < 1e-2
    assert errors[1] < 5e-5  # 4.0e-5


LOADS = [(pressed, "quadrilateral", 2), (twisted, "triangle", 1), (pressed, "triangle", 2)]


@pytest.mark.parametrize(("load", "cell", "degree"), LOADS)
def test_error_is_of_first_order(load, cell, degree):
    joint = ring(*RADII, 0.25, angle=np.pi / 2 if load is pressed else 2 * np.pi, cell=cell, degree=degree)
    rows = []
    for eps in EPS:
        layer = ThinLayer(GLUE, eps, at=1.0)
        limit = solve(Structure(joint, **load(joint)).interface(layer))
        full = solve(Structure(joint, **load(joint)).full(layer, bodies="extended"))
        rows.append(compare(full, limit))
    # statics fix the torque's traction
    for name in ("error_traction", "error_jump") if load is pressed else ("error_jump",):
        assert observed_orders(EPS, [row[name] for row in rows])[1:] == pytest.approx([1.0, 1.0], abs=0.1)


def test_material_frame_follows_s():
    """In torsion a layer with K_N = 50 K_T gives t_T / K_T all around, in the meshed layer too."""
    joint = ring(*RADII, 0.25, degree=2)
    layer = ThinLayer(Anisotropic.springs(K_N=100.0, K_T=2.0), 1e-3, at=1.0)
    limit = solve(Structure(joint, **twisted(joint)).interface(layer))
    full = solve(Structure(joint, **twisted(joint)).full(layer, bodies="extended"))
    surface = Surface(limit.model)
    r = surface.x / np.hypot(*surface.x)
    around = np.array([-r[1], r[0]])
    traction = SHEAR * RADII[2] ** 2 / RADII[1] ** 2
    for state in (limit, full):
        difference = surface.jump(state) - traction / 2.0 * around
        assert surface.norm(difference) < 2e-3 * surface.norm(traction / 2.0 * around), state.model


def test_rigid_base_takes_all_of_eps():
    """A layer between a hub and a rigid shaft: the base stays on S."""
    whole = ring(*RADII, 0.25)
    hub = part_of(whole, whole.region == whole.regions.index("OUTER"), seams={"S": Seam()})
    setup = {"body": OUTER, "supports": {}, "tractions": twisted(hub)["tractions"]}
    rows = []
    for eps in EPS:
        layer = ThinLayer(GLUE, eps, at=1.0)
        limit = solve(Structure(hub, **setup).interface(layer))
        rows.append(compare(solve(Structure(hub, **setup).full(layer, bodies="extended")), limit))
    assert observed_orders(EPS, [row["error_jump"] for row in rows])[1:] == pytest.approx([1.0, 1.0], abs=0.1)


def test_bodies_are_kept_on_shallow_arcs():
    """They move apart in one piece, and bounds contain the goals of the meshed layer."""
    joint, layer = ring(*RADII, 0.25, angle=0.5, degree=2), ThinLayer(GLUE, 0.02)
    structure = Structure(joint, **pressed(joint) | {"tractions": {"OUTSIDE": (0.4, 0.3)}})
    with pytest.warns(RangeWarning, match=r"its thickness is 0\.978 to 1\.010 of eps"):
        meshed = solve(structure.full(layer))
    goal = goals.Displacement((2.0, 0.0), (1.0, 0.3))
    result = estimate(solve(structure.interface(layer)), goals=[goal])
    bounds, value = result.goals[goal.name], goal.value(meshed, result.better.model)
    assert bounds.lower <= value <= bounds.upper < bounds.lower + 1e-3 * abs(bounds.better - bounds.value)


# ---------------------------------------------------------------------------------------------- varying thickness
def wedge(x):
    return 0.5 + x[0]


def test_wedge():
    joint, setup = fourier(1 / 16, cell="quadrilateral")
    eps, rows, uniform = (1 / 16, 1 / 32, 1 / 64), [], []
    for e in eps:
        layer = ThinLayer(FOURIER_LAYER, e, profile=wedge, at=1.0)
        full = solve(Structure(joint, **setup).full(layer, bodies="extended"))
        rows.append(compare(full, solve(Structure(joint, **setup).interface(layer))))
        other = solve(Structure(joint, **setup).interface(ThinLayer(FOURIER_LAYER, e, at=1.0)))
        refused(InputError, "the same profile", compare, full, other)
        surface = Surface(other.model)
        jump = surface.jump(other)
        uniform.append(surface.norm(surface.jump(full) - jump) / surface.norm(jump))
    for name in ("error_traction", "error_jump"):
        assert observed_orders(eps, [row[name] for row in rows])[1:] == pytest.approx([1.0, 1.0], abs=0.1)
    assert min(uniform) > 0.2  # the mean thickness alone is another law


def test_profiles_are_checked():
    joint, setup = fourier(1 / 4)
    plates = Structure(joint, **setup)
    for profile, message in (
        (lambda x: x[0] - 0.5, r"profile is -0.5 at \(0, 0\); it must be > 0"),
        (lambda x: np.full(x.shape[1], np.nan), "profile is nan"),
        (lambda x: np.ones(3), "fails for an array of shape"),
        (lambda x: x[0] >= 0, "it gives bool"),
        (lambda x: 1j * x[0], "it must be a numpy function"),
        (lambda x, y: x, "it must be a numpy function"),
        (lambda x: ufl.sin(x[0]), "it must be a numpy function"),
    ):
        layer = ThinLayer(GLUE, 0.01, profile=profile, at=1.0)
        refused(InputError, message, plates.interface, layer)
        refused(InputError, message, plates.full, layer, bodies="extended")
    tapered = ThinLayer(GLUE, 0.01, profile=wedge)
    refused(InputError, r"thickness varies along S.*bodies='extended'", plates.full, tapered)
    refused(InputError, "give a function of x", lambda: ThinLayer(GLUE, 0.01, profile=2.0, at=1.0))
