"""Two strips of unequal expansion, cooled, against closed forms: their layer meshed and as an interface law."""

import pytest

from studies import cure
from thinlayer import Surface, solve


def test_curvature():
    """Of Suhir's with a shear lag, in which the law leaves the layer's part of the arm out; of Timoshenko's if stiff."""
    for mu in (cure.STIFFENING[1], cure.STIFFENING[-1]):
        full, limit = cure.strips(5.0, mu, {(0.0, -cure.HEIGHTS["LOWER"]): {"y": 0.0}}).values()
        surface = Surface(limit)
        for model, eps in ((full, cure.EPS), (limit, 0.0)):
            found = cure.curvature(surface, solve(model))
            assert found == pytest.approx(cure.bent(mu, eps), rel=0.02)
    assert found == pytest.approx(cure.timoshenko(), rel=0.02)
    assert abs(cure.bent(cure.STIFFENING[1]) / cure.timoshenko() - 1) > 0.1


def test_shear_lag():
    """Volkersen's, between smooth plates; another stiffness of the layer has another one."""
    mu = cure.SHEAR[0]
    full, limit = cure.strips(5.0, mu, {"BOTTOM": {"y": 0.0}, "TOP": {"y": 0.0}}).values()
    surface = Surface(limit)
    for model in (full, limit):
        x, t = surface.profile(surface.traction(solve(model)))
        inside = (x[:, 0] > 0.1 * cure.LENGTH) & (x[:, 0] < cure.NEAR_ENDS * cure.LENGTH)
        assert t[inside, 0] == pytest.approx(cure.lag(mu, x[inside, 0]), rel=0.02)
        assert (abs(t[inside, 0] / cure.lag(1.2 * mu, x[inside, 0]) - 1) > 0.02).any()
