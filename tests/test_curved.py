"""Curved S and thickness varying along S."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import ufl

from forms import Anisotropic, LinearElastic
from forms.base import InputError
from geometry import block, ring, sandwich
from geometry.seam import Seam
from studies.problems import FOURIER_LAYER, fourier
from tests.meshes import part_of
from tests.orders import observed_orders
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, compare, solve

pytestmark = pytest.mark.few(5)

INNER, OUTER = LinearElastic.young(200.0, 0.3), LinearElastic.young(70.0, 0.33)
GLUE = LinearElastic(lmbda=3.0, mu=2.0)
RADII = (1.0, 1.5, 2.0)
PRESSURE, SHEAR = 1.3, 0.7
EPS = (0.1, 0.05, 0.025)


def radial(x):
    return ufl.as_vector([x[0], x[1]]) / ufl.sqrt(x[0] ** 2 + x[1] ** 2)


def pressed(joint) -> dict:
    """A quarter of a tube, free inside, under pressure from outside."""
    load = lambda x, t: tuple(-PRESSURE * radial(x)[k] for k in range(2))
    supports = {"START": {"y": 0.0}, "END": {"x": 0.0}}
    return {"body": {"INNER": INNER, "OUTER": OUTER}, "supports": supports, "tractions": {"OUTSIDE": load}}


def twisted(joint) -> dict:
    """A tube held inside, under a torque from outside."""
    load = lambda x, t: (-SHEAR * radial(x)[1], SHEAR * radial(x)[0])
    return {"body": {"INNER": INNER, "OUTER": OUTER}, "supports": {"INSIDE": 0.0}, "tractions": {"OUTSIDE": load}}


def lame(stiffness: float) -> tuple[float, float]:
    """Radial traction on S and jump of u_r for two tubes (u_r = A r + B / r) with traction = stiffness jump on S."""
    a, R, b = RADII
    rows, right = [], []

    def u(law, r):
        return np.array([r, 1 / r])

    def stress(law, r):
        return np.array([2 * (law.lmbda + law.mu), -2 * law.mu / r**2])

    zero = np.zeros(2)
    rows.append(np.concatenate([stress(INNER, a), zero]))
    right.append(0.0)
    rows.append(np.concatenate([zero, stress(OUTER, b)]))
    right.append(-PRESSURE)
    rows.append(np.concatenate([stress(INNER, R), -stress(OUTER, R)]))
    right.append(0.0)
    rows.append(np.concatenate([stress(INNER, R) + stiffness * u(INNER, R), -stiffness * u(OUTER, R)]))
    right.append(0.0)
    A = np.linalg.solve(rows, right)
    traction = stress(INNER, R) @ A[:2]
    return float(traction), float(u(OUTER, R) @ A[2:] - u(INNER, R) @ A[:2])


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_pressed_tube(cell):
    """Interface model against Lame's solution; curved cells are needed for that, straight ones have another S."""
    traction, jump = lame(GLUE.lmbda + 2 * GLUE.mu)
    errors = []
    for degree in (1, 2):
        joint = ring(*RADII, 0.125, angle=np.pi / 2, cell=cell, degree=degree)
        state = solve(Structure(joint, **pressed(joint)).interface(ThinLayer(GLUE, 0.1, at=1.0)))
        surface = Surface(state.model)
        r = surface.x / np.hypot(*surface.x)
        found = surface.norm(surface.jump(state) - jump * r) / surface.norm(jump * r)
        errors.append(found)
        assert surface.norm(surface.traction(state) - traction * r) < 1e-2 * abs(traction)
    assert errors[0] < 1e-2
    assert errors[1] < 2e-5


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("load", [pressed, twisted])
def test_error_is_of_first_order(load, cell, degree):
    joint = ring(*RADII, 0.25, angle=np.pi / 2 if load is pressed else 2 * np.pi, cell=cell, degree=degree)
    rows = []
    for eps in EPS:
        layer = ThinLayer(GLUE, eps, at=1.0)
        limit = solve(Structure(joint, **load(joint)).interface(layer))
        rows.append(compare(solve(Structure(joint, **load(joint)).full(layer, bodies="extended")), limit))
    for name in (
        ("error_traction", "error_jump") if load is pressed else ("error_jump",)
    ):  # statics fix the torque's traction
        assert observed_orders(EPS, [row[name] for row in rows])[1:] == pytest.approx([1.0, 1.0], abs=0.1)


def test_wrong_law_leaves_a_floor_on_a_ring():
    joint = ring(*RADII, 0.25, angle=np.pi / 2, degree=2)
    wrong = LinearElastic(lmbda=GLUE.lmbda - GLUE.mu, mu=GLUE.mu)
    errors = []
    for eps in EPS:
        full = solve(Structure(joint, **pressed(joint)).full(ThinLayer(GLUE, eps, at=1.0), bodies="extended"))
        limit = solve(Structure(joint, **pressed(joint)).interface(ThinLayer(wrong, eps, at=1.0)))
        errors.append(compare(full, limit)["error_jump"])
    assert errors[0] < errors[1] < errors[2]
    assert errors[2] > 0.09


@pytest.mark.parametrize("degree", [1, 2])
def test_material_frame_follows_s(degree):
    """In torsion a layer with K_N = 50 K_T gives t_T / K_T all around, in the meshed layer too."""
    joint = ring(*RADII, 0.25, degree=degree)
    layer = ThinLayer(Anisotropic.springs(K_N=100.0, K_T=2.0), 1e-3, at=1.0)
    limit = solve(Structure(joint, **twisted(joint)).interface(layer))
    full = solve(Structure(joint, **twisted(joint)).full(layer, bodies="extended"))
    surface = Surface(limit.model)
    r = surface.x / np.hypot(*surface.x)
    around = np.array([-r[1], r[0]])
    traction = SHEAR * RADII[2] ** 2 / RADII[1] ** 2
    assert compare(full, limit)["error_jump"] < 2e-2
    if degree == 2:  # a polygon has corners where springs of such different stiffness feel the kink
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


# ---------------------------------------------------------------------------------------------- varying thickness
def wedge(x):
    return 0.5 + x[0]


@pytest.mark.few(5)
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_wedge(cell):
    joint, setup = fourier(1 / 16, cell=cell)
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


def test_wedge_in_three_dimensions():
    joint = block(1.0, 0.5, 0.25, depth=0.6, cell="hexahedron")
    stiff = LinearElastic.young(1e9, 0.3)
    profile = lambda x: (0.5 + x[0]) * (1 + x[2])
    exact = GLUE.mu / 2 * 0.01**2 * np.log(3) * np.log(1.6)
    layer = ThinLayer(GLUE, 1e-3, profile=profile, at=1.0)
    moved = Structure(joint, body=stiff, supports={"TOP": {"x": 0.01, "y": 0.0, "z": 0.0}})
    for model in (moved.interface(layer), moved.full(layer, bodies="extended")):
        state = solve(model)
        assert state.energies()["layer"] == pytest.approx(exact, rel=1e-2), state.model


@pytest.mark.few(1)
@pytest.mark.parametrize(
    ("profile", "message"),
    [
        (lambda x: x[0] - 0.5, r"profile is -0.5 at \(0, 0\); it must be > 0"),
        (lambda x: np.full(x.shape[1], np.nan), "profile is nan"),
        (lambda x: np.ones(3), r"returns shape \(3,\) for"),
        (lambda x: x[0] >= 0, "it returns bool"),
        (lambda x: 1j * x[0], "is no numpy function"),
        (lambda x, y: x, "is no numpy function"),
        (lambda x: ufl.sin(x[0]), "is no numpy function"),
        (lambda x: "thick", "is no numpy function"),
    ],
)
def test_profiles_are_checked(profile, message):
    joint, setup = fourier(1 / 4)
    plates, layer = Structure(joint, **setup), ThinLayer(GLUE, 0.01, profile=profile, at=1.0)
    refused(InputError, message, lambda: plates.interface(layer))
    refused(InputError, message, lambda: plates.full(layer, bodies="extended"))


def test_what_curved_and_varying_layers_cannot_do():
    joint, setup = fourier(1 / 4)
    with pytest.raises(InputError, match=r"thickness varies along S.*use bodies='extended'"):
        Structure(joint, **setup).full(ThinLayer(GLUE, 0.01, profile=wedge, at=1.0))
    refused(InputError, "must be a function", lambda: ThinLayer(GLUE, 0.01, profile=2.0, at=1.0))


@pytest.mark.few(5)
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_wavy_s_in_three_dimensions(cell):
    """S with both curvatures, on straight cells: first order in traction and jump."""
    flat = sandwich(1.0, 0.5, 0.5, 0.25, depth=1.0, cell=cell, structured=True)
    points = flat.points.copy()
    wave = 0.08 * np.cos(np.pi * points[:, 0]) * np.cos(np.pi * points[:, 2])
    points[:, 1] += wave * (1 - 2 * np.abs(points[:, 1]))
    joint = replace(flat, points=points)
    rollers = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}, "BACK": {"z": 0.0}, "FRONT": {"z": 0.0}}
    load = lambda x, t: (0.5 * ufl.sin(ufl.pi * x[0]), 0.5 + ufl.cos(ufl.pi * x[0]) * ufl.cos(ufl.pi * x[2]), 0)
    setup = {
        "body": LinearElastic.young(100.0, 0.3),
        "supports": {"BOTTOM": 0.0, **rollers},
        "tractions": {"TOP": load},
    }
    eps, rows = (0.04, 0.02), []
    for e in eps:
        layer = ThinLayer(FOURIER_LAYER, e, at=1.0)
        full = Structure(joint, **setup).full(layer, bodies="extended", cells_through=2)
        rows.append(compare(solve(full), solve(Structure(joint, **setup).interface(layer))))
    for name in ("error_traction", "error_jump"):
        assert observed_orders(eps, [row[name] for row in rows])[-1] == pytest.approx(1.0, abs=0.1)
