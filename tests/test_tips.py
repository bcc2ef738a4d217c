"""S that ends inside the bodies: cracks filled with a soft layer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forms import HolonomicCoulomb, LinearElastic
from forms.base import InputError
from geometry import ring, sandwich
from geometry.inflating.inflation import inflate
from geometry.joint import Joint
from geometry.seam import Seam
from tests.meshes import volumes
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, solve
from thinlayer.discretisation.model import Model

BODY = LinearElastic.young(100.0, 0.3)
E_STRAIN = 100.0 / (1 - 0.3**2)
SOFT = LinearElastic(lmbda=1e-6, mu=1e-6)


def partly(joint: Joint, inside) -> Joint:
    """The joint with S where `inside` (of the facets' centres) holds."""
    s = joint.facets["S"]
    return replace(joint, facets={**joint.facets, "S": s[inside(joint.points[s].mean(axis=1))]})


def in_one_body(joint: Joint, direction: tuple[float, ...]) -> Joint:
    """The same mesh as one region."""
    region = np.zeros(len(joint.cells), np.int64)
    return replace(joint, region=region, regions=("ROCK",), seams={"S": Seam(direction=direction)})


def pulled(joint: Joint, layer: ThinLayer, **options) -> tuple[Model, Surface]:
    n = (0.0, 1.0, 0.0)[: joint.dim]
    tractions = {"TOP": n, "BOTTOM": tuple(-c for c in n)}
    corners = joint.points.min(axis=0), joint.points.max(axis=0)
    low = tuple(corners[0])
    right = (corners[1][0], *low[1:])
    supports = {low: 0.0, right: {"y": 0.0, "z": 0.0} if joint.dim == 3 else {"y": 0.0}}
    if joint.dim == 3:
        supports[(low[0], low[1], corners[1][2])] = {"y": 0.0}
    model = Structure(joint, body=BODY, supports=supports, tractions=tractions, **options).interface(layer)
    return solve(model), Surface(model)


def test_griffith_crack():
    """A crack of length 2a in a large plate opens by 4 sqrt(a^2 - x^2)/E', so by pi a^2 * 2/E' in area."""
    size = 20.0
    joint = sandwich(size, size / 2, size / 2, 1.0, h_S=0.1)
    joint = partly(joint, lambda x: np.abs(x[:, 0] - size / 2) < 1.0)
    a = np.ptp(joint.points[joint.facets["S"]][..., 0]) / 2
    state, surface = pulled(joint, ThinLayer(SOFT, 1e-3, at=1.0))
    opening = surface.integral(surface.frame(surface.jump(state))[1])
    finite_plate = 1 + 0.5948 * (2 * a / size) ** 2  # Tada's correction for a plate of finite width, first term
    assert opening == pytest.approx(2 * np.pi * a**2 / E_STRAIN * finite_plate, rel=2e-2)


@pytest.mark.parametrize(("cell", "depth"), [("triangle", None), ("hexahedron", 2.0)])
def test_inside_one_body(cell, depth):
    """The same crack between two bodies and inside one is the same model."""
    joint = sandwich(2.0, 1.0, 1.0, 0.5, depth=depth, cell=cell)
    joint = partly(joint, lambda x: np.linalg.norm(x[:, ::2] - 1.0, axis=1) < 0.7)
    layer = ThinLayer(LinearElastic(lmbda=30.0, mu=20.0), 0.01, at=1.0)
    up = (0.3, 1.0, -0.2)[: joint.dim]
    results = []
    for variant in (joint, in_one_body(joint, up), in_one_body(joint, tuple(-c for c in up))):
        state, surface = pulled(variant, layer)
        jump, traction = surface.jump(state), surface.traction(state)
        normal = surface.integral(surface.frame(jump)[-1])
        results.append((surface.norm(jump), surface.norm(traction), normal, state.energies()["layer"]))
    assert results[0][2] > 0
    assert results[1] == pytest.approx(results[0], rel=1e-9)
    assert results[2] == pytest.approx(results[0], rel=1e-9)


def test_traction_up_to_the_tip():
    """The reaction is K [u], to first order in h, the element at the tip included."""
    errors = []
    for h in (0.2, 0.1):
        joint = partly(sandwich(2.0, 1.0, 1.0, h, structured=True), lambda x: x[:, 0] < 1.0)
        state, surface = pulled(joint, ThinLayer(LinearElastic(lmbda=30.0, mu=20.0), 0.01, at=1.0))
        w = surface.jump(state)
        law = np.stack([20 * w[0], 70 * w[1]])
        errors.append(surface.norm(surface.reaction(state) - law) / surface.norm(law))
    assert errors[1] < 0.02
    assert np.log2(errors[0] / errors[1]) > 0.9


def test_directions_are_checked():
    whole = sandwich(1.0, 0.5, 0.5, 0.25)
    merged = in_one_body(whole, (0.0, 1.0))
    for joint, seam, message in (
        (merged, Seam(direction=(1.0, 0.0)), r"\(1.0, 0.0\) of 'S' lies in the facet near .*; give one across it"),
        (merged, Seam(direction=(0.0, 0.0)), "needs 2 components, not all zero"),
        (
            whole,
            replace(whole.seams["S"], direction=(0.0, 1.0)),
            "'S': a direction tells the upper side, or regions do",
        ),
        (merged, Seam(("ROCK",), ("ROCK",)), "on both sides of 'S'; give a direction to"),
        (merged, Seam(), "have one region on both sides; give the direction of the upper side"),
    ):
        refused(InputError, message, replace, joint, seams={"S": seam})
    refused(InputError, " of 'S' lies in the facet near", in_one_body, ring(0.5, 1.0, 2.0, 0.2), (0.1, 1.0))


def test_upper_side_that_changes():
    """A direction out of the circle above and into it below: the same interface model, and the same meshed layer."""
    two, results, values = ring(0.5, 1.0, 2.0, 0.2), [], []
    merged = in_one_body(two, (0.0, 1.0))
    assert set(np.rint((merged.interface_normals * two.interface_normals).sum(axis=1))) == {-1, 1}
    for joint in (two, merged):
        data = {"body": BODY, "supports": {"INSIDE": 0.0}, "tractions": {"OUTSIDE": (3.0, 1.0)}}
        state = solve(Structure(joint, **data).interface(ThinLayer(LinearElastic(lmbda=30.0, mu=20.0), 0.01, at=1.0)))
        surface = Surface(state.model)
        results.append([surface.norm(surface.jump(state)), *state.energies().values()])
        x, t = surface.profile(surface.frame(surface.traction(state))[1])
        values.append({tuple(np.round(at, 9)): value for at, value in zip(x, t, strict=True)})
    assert results[1] == pytest.approx(results[0], rel=1e-9)
    assert len(x) == 32 + 2  # where the upper side changes, two of the bodies' nodes lie on it
    assert values[1] == pytest.approx(values[0], abs=0.03 * max(map(abs, values[0].values())))
    opened = [inflate(joint, 0.01, bodies="extended") for joint in (two, merged)]
    assert [np.sort(volumes(joint)) for joint in opened][1] == pytest.approx(np.sort(volumes(opened[0])), rel=1e-9)
    words, shares = r"the upper side changes at \(.*: sublayers do not meet", (0.3, 0.7)
    refused(InputError, words, inflate, merged, 0.01, bodies="extended", fractions=shares)
    law = HolonomicCoulomb(30.0, 10.0, 0.3)  # the pair of nodes there is two, each with the normal of its own facets
    pressed = {"body": BODY, "supports": {"INSIDE": 0.0}, "tractions": {"OUTSIDE": (0.5, -0.3)}, "element": "P1"}
    first, second = (solve(Structure(j, **pressed).interface(law), method="newton").energies() for j in (two, merged))
    assert [second[k] for k in ("bodies", "loads")] == pytest.approx([first[k] for k in ("bodies", "loads")], rel=1e-3)
