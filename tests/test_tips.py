"""S that ends inside the bodies: cracks filled with a soft layer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import ufl

from forms import LinearElastic
from geometry import GeometryError, Joint, block, inflate, ring, sandwich
from geometry.joint import BONDED
from thinlayer import Model, ModelError, Structure, Surface, ThinLayer, solve

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
    return replace(joint, region=region, regions=("ROCK",), upper=("ROCK",), lower=("ROCK",), direction=direction)


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
    state, surface = pulled(joint, ThinLayer(SOFT, 1e-3))
    opening = surface.integral(surface.frame(surface.jump(state))[1])
    finite_plate = 1 + 0.5948 * (2 * a / size) ** 2  # Tada's correction for a plate of finite width, first term
    assert opening == pytest.approx(2 * np.pi * a**2 / E_STRAIN * finite_plate, rel=2e-2)


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral", "hexahedron", "tetrahedron"])
def test_inside_one_body(cell):
    """The same crack between two bodies and inside one is the same model."""
    depth = 2.0 if cell in ("hexahedron", "tetrahedron") else None
    joint = sandwich(2.0, 1.0, 1.0, 0.2 if depth is None else 0.5, depth=depth, cell=cell)
    joint = partly(joint, lambda x: np.linalg.norm(x[:, ::2] - 1.0, axis=1) < 0.7)
    layer = ThinLayer(LinearElastic(lmbda=30.0, mu=20.0), 0.01)
    up = (0.3, 1.0, -0.2)[: joint.dim]
    found = []
    for one in (joint, in_one_body(joint, up), in_one_body(joint, tuple(-c for c in up))):
        state, surface = pulled(one, layer)
        normal = surface.integral(surface.frame(surface.jump(state))[-1])
        found.append(
            (
                surface.norm(surface.jump(state)),
                surface.norm(surface.traction(state)),
                normal,
                state.energies()["layer"],
            )
        )
    assert found[0][2] > 0
    assert found[1] == pytest.approx(found[0], rel=1e-9)
    assert found[2] == pytest.approx(found[0], rel=1e-9)


def test_closes_at_the_tip():
    joint = partly(sandwich(2.0, 1.0, 1.0, 0.2), lambda x: x[:, 0] < 1.0)
    state, surface = pulled(joint, ThinLayer(SOFT, 1e-3))
    x, jump = surface.profile(surface.jump(state))
    assert np.abs(jump[np.isclose(x[:, 0], 1.0)]).max() < 0.2 * np.abs(jump).max()  # projected to degree 1
    assert len(state.model.domain.facets(BONDED)) == len(joint.bonded) > 0


def test_traction_up_to_the_tip():
    """The reaction is K [u], to first order in h, the element at the tip included."""
    errors = []
    for h in (0.2, 0.1):
        joint = partly(sandwich(2.0, 1.0, 1.0, h, structured=True), lambda x: x[:, 0] < 1.0)
        state, surface = pulled(joint, ThinLayer(LinearElastic(lmbda=30.0, mu=20.0), 0.01))
        w = surface.jump(state)
        law = ufl.as_vector([20 * w[0], 70 * w[1]])
        errors.append(surface.norm(surface.traction(state) - law) / surface.norm(law))
    assert errors[1] < 0.02
    assert np.log2(errors[0] / errors[1]) > 0.9


def test_cut_through_one_body_is_a_layer_like_any():
    whole = sandwich(1.0, 0.5, 0.5, 0.25)
    one = in_one_body(whole, (0.0, 1.0))
    assert len(one.bonded) == 0
    assert (one.side == whole.side).all()
    inflate(one, 0.1)


def test_what_a_tip_refuses():
    joint = partly(sandwich(2.0, 1.0, 1.0, 0.2), lambda x: x[:, 0] < 1.0)
    layer = ThinLayer(SOFT, 1e-3, order=1)
    with pytest.raises(ModelError, match="order=1 needs an S that does not end inside"):
        pulled(joint, layer)
    with pytest.raises(GeometryError, match=r"S ends inside the bodies \(near \(1, 0\)\)"):
        Structure(joint, body=BODY, supports={"BOTTOM": 0.0}).full(ThinLayer(SOFT, 1e-3))


def test_directions_are_checked():
    whole = sandwich(1.0, 0.5, 0.5, 0.25)
    with pytest.raises(GeometryError, match=r"direction \(1.0, 0.0\) does not tell the sides of S: it lies in S near"):
        in_one_body(whole, (1.0, 0.0))
    with pytest.raises(GeometryError, match="needs 2 components, not all zero"):
        in_one_body(whole, (0.0, 0.0))
    with pytest.raises(GeometryError, match="upper and lower are different regions"):
        replace(whole, direction=(0.0, 1.0))
    with pytest.raises(GeometryError, match="on both sides of 'S'; give the direction"):
        replace(in_one_body(whole, (0.0, 1.0)), direction=None)
    with pytest.raises(GeometryError, match="does not tell the sides of S"):
        in_one_body(ring(0.5, 1.0, 2.0, 0.2), (0.1, 1.0))  # out of the circle above, into it below


def test_s_is_s_alone():
    """A set of all outer facets is loaded and supported without S."""
    joint = block(1.0, 0.5, 0.25)
    everything = np.concatenate(list(joint.facets.values()))
    joint = replace(joint, facets={**joint.facets, "ALL": everything})
    assert len(joint.facets["ALL"]) == len(everything) - len(joint.facets["S"])
    opened = inflate(joint, 0.1)
    assert (opened.table.cells[opened.table.index(opened.facets["ALL"]), 1] < 0).all()
    with pytest.raises(GeometryError, match="'UPPER_FACE' cannot be a name"):
        replace(joint, facets={**joint.facets, "UPPER_FACE": joint.facets["TOP"]})
