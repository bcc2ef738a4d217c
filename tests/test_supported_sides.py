"""Reactions and tractions where a support of a side of the bodies meets S."""

from __future__ import annotations

import numpy as np
import pytest

from forms import HolonomicCoulomb, LinearElastic
from geometry import block, sandwich
from thinlayer import Structure, Surface, ThinLayer, compare, solve

pytestmark = pytest.mark.few(5)

BODY = LinearElastic(30.0, 20.0)
LAYER = ThinLayer(LinearElastic(3.0, 2.0), 0.05, at=1.0)
K_N, K_T = 7.0, 2.0
STRESS = np.array([[0.7, 0.2, 0.1], [0.2, -0.9, 0.15], [0.1, 0.15, 0.3]])
EXACT = 1e-9  # relative: rounding, times the condition of the stiffness


def joint(cell="quadrilateral", angle=0.0):
    depth = 0.8 if cell in ("tetrahedron", "hexahedron") else None
    return sandwich(1.6, 0.5, 0.7, 0.4, cell=cell, depth=depth).rotated(angle)


def uniform(joint, angle=0.0, scale=1.0):
    """Supports and loads of a uniform stress: functions of the place for each body, normal -> traction, normal of S."""
    d = joint.dim
    stress = scale * STRESS[:d, :d]
    lmbda, mu = BODY.lmbda, BODY.mu
    strain = (stress - lmbda / (d * lmbda + 2 * mu) * np.trace(stress) * np.eye(d)) / (2 * mu)
    n = np.array([-np.sin(angle), np.cos(angle), 0.0])[:d]
    t = stress @ n
    w = (t @ n) / K_N * n + (t - (t @ n) * n) / K_T

    def lower(k):
        return lambda x, _: sum(float(strain[k, i]) * x[i] for i in range(d))

    def upper(k):
        return lambda x, _: lower(k)(x, _) + float(w[k])

    along = np.array([np.cos(angle), np.sin(angle), 0.0])[:d]
    loads = {"TOP": t, "LEFT/UPPER": -stress @ along, "RIGHT/LOWER": stress @ along}
    if d == 3:
        loads |= {"BACK": -stress[:, 2], "FRONT": stress[:, 2]}
    supports = [{axis: f(k) for k, axis in enumerate("xyz"[:d])} for f in (lower, upper)]
    return supports, {name: tuple(map(float, load)) for name, load in loads.items()}, t


CONTACT = HolonomicCoulomb(K_N, K_T, 0.5)


SIDES = [
    ("quadrilateral", "S2", 0.4, LAYER, 1.0),
    ("triangle", "P2", 0.4, LAYER, 1e-200),  # forces whose squares are no numbers
    ("triangle", "P1", 0.0, LAYER, 1e100),
    ("hexahedron", "Q1", 0.3, LAYER, 1.0),
    ("quadrilateral", "Q1", 0.0, CONTACT, 1.0),
]


@pytest.mark.parametrize("both", [False, True], ids=["one body", "both"])
@pytest.mark.parametrize(("cell", "element", "angle", "layer", "scale"), SIDES)
def test_supports_of_the_sides_take_nothing_from_the_traction(cell, element, angle, layer, scale, both):
    """Uniform stress. Where they hold both bodies reactions do not tell: they go on as beside, uniform if these are."""
    specimen = joint(cell, angle)
    (lower, upper), loads, t = uniform(specimen, angle, scale)
    supports = {"BOTTOM": lower, "LEFT/LOWER": lower, "RIGHT/UPPER": upper}
    if both:
        supports["RIGHT/LOWER"] = lower
        del loads["RIGHT/LOWER"]
    model = Structure(specimen, body=BODY, supports=supports, tractions=loads, element=element).interface(layer)
    surface = Surface(model)
    traction = surface.reaction(solve(model))
    x, values = surface.profile(traction)
    near = 1e-7 if layer is CONTACT else EXACT  # the contact solver's tolerance
    assert values / scale == pytest.approx(np.tile(t / scale, (len(x), 1)), rel=near)
    area = 1.6 * (0.8 if specimen.dim == 3 else 1.0)
    assert surface.integral(traction) / scale == pytest.approx(t * area / scale, rel=near)


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_a_support_that_moves_a_body_on_a_rigid_base(cell):
    """u = w + a y above the base, of one stress."""
    joint = block(1.6, 0.7, 0.4, depth=0.8 if cell == "hexahedron" else None, cell=cell)
    d = joint.dim
    a, n = np.array([0.02, -0.03, 0.01])[:d], np.eye(d)[1]
    strain = (np.outer(a, n) + np.outer(n, a)) / 2
    stress = BODY.lmbda * np.trace(strain) * np.eye(d) + 2 * BODY.mu * strain
    t = stress @ n
    w = t / np.where(n > 0, K_N, K_T)
    moved = {axis: lambda x, _, k=k: float(w[k]) + float(a[k]) * x[1] for k, axis in enumerate("xyz"[:d])}
    normals = {"TOP": n, "RIGHT": np.eye(d)[0]} | ({"BACK": -np.eye(d)[2], "FRONT": np.eye(d)[2]} if d == 3 else {})
    loads = {name: tuple(map(float, stress @ normal)) for name, normal in normals.items()}
    data = {"supports": {"LEFT": moved}, "tractions": loads, "element": "P1" if d == 2 else "Q1"}
    model = Structure(joint, body=BODY, **data).interface(LAYER)
    x, tractions = Surface(model).profile(Surface(model).reaction(solve(model)))
    assert tractions == pytest.approx(np.tile(t, (len(x), 1)), rel=EXACT)


@pytest.mark.parametrize(("build", "cell"), [(Structure.full, "triangle"), (Structure.interface, "hexahedron")])
def test_ends_that_hold_both_bodies_together(build, cell):
    """Stretched along S with a layer of the bodies' material: [u] = 0 and t_N = lmbda e_xx, at the ends as elsewhere.

    The law of order 0 knows nothing of it: by it the traction is zero where nothing jumps.
    """
    specimen = joint(cell)
    supports = {"LEFT": {"x": 0, "y": 0}, "RIGHT": {"x": 0.03, "y": 0}, "TOP": {"y": 0}, "BOTTOM": {"y": 0}}
    supports |= {"BACK": {"z": 0}, "FRONT": {"z": 0}} if specimen.dim == 3 else {}
    layer = ThinLayer(BODY, 0.05, order=1)
    stretched = Structure(specimen, body=BODY, supports=supports)
    surface = Surface(stretched.interface(layer))
    _, tractions = surface.profile(surface.reaction(solve(build(stretched, layer))))
    assert tractions[:, 1] == pytest.approx(BODY.lmbda * 0.03 / 1.6, rel=EXACT)


def test_a_layer_pressed_onto_a_body_between_walls():
    """t_N = -1 of stiff bodies, in both models: at the walls as elsewhere, and in sum."""
    joint = sandwich(4.0, 1.0, 1.0, 0.5)
    walls = {"BOTTOM": 0.0, "LEFT/LOWER": 0.0, "RIGHT/LOWER": 0.0}
    pressed = Structure(joint, body=LinearElastic(3e5, 2e5), supports=walls, tractions={"TOP": (0.0, -1.0)})
    limit, full = solve(pressed.interface(LAYER)), solve(pressed.full(LAYER))
    surface = Surface(limit.model)
    for state, local, total in ((limit, 1e-3, 1e-6), (full, 0.02, 1e-3)):  # the meshed layer bulges at its sides
        t = surface.traction(state)
        assert surface.profile(t[1])[1] == pytest.approx(-1.0, rel=local)
        assert surface.integral(t[1]) == pytest.approx(-4.0, rel=total)
    assert compare(full, limit)["error_traction"] < 0.03
