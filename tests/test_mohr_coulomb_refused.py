"""Mohr-Coulomb laws refuse parameters out of range, by name and with what is allowed."""

from __future__ import annotations

import pytest

from forms import LawError, MohrCoulomb, MohrCoulombMonodirectional
from tests.mohr_coulomb_points import LAW, LMBDA, MU


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: MohrCoulomb(LMBDA, MU, -0.1, 30.0), "MohrCoulomb: cohesion is -0.1; allowed: >= 0"),
        (lambda: MohrCoulomb(LMBDA, MU, float("inf"), 30.0), "cohesion is inf"),
        (lambda: MohrCoulomb(LMBDA, MU, 0.1, 90.0), "friction_angle is 90.0; allowed: 0 <= friction_angle < 90 degrees"),
        (lambda: MohrCoulomb(LMBDA, MU, 0.1, -1.0), "friction_angle is -1.0"),
        (lambda: MohrCoulomb(LMBDA, MU, 0.1, float("nan")), "friction_angle is nan"),
        (lambda: MohrCoulomb(LMBDA, MU, 0.0, 0.0), "cohesion is 0.0; allowed: > 0 where friction_angle = 0"),
        (lambda: MohrCoulomb(LMBDA, MU, 0.1, 30.0, dilatancy_angle=31.0),
            "dilatancy_angle is 31.0; allowed: 0 <= dilatancy_angle <= friction_angle = 30 degrees",
        ),
        (lambda: MohrCoulomb(LMBDA, MU, 0.1, 30.0, dilatancy_angle=-1.0), "dilatancy_angle is -1.0"),
        (lambda: MohrCoulomb(LMBDA, MU, 0.1, 30.0, elastic_fraction=1.0),
            "elastic_fraction is 1.0; allowed: 0 <= elastic_fraction < 1",
        ),
        (lambda: MohrCoulomb(LMBDA, MU, 0.1, 30.0, elastic_fraction=-0.1), "elastic_fraction is -0.1"),
        (lambda: MohrCoulomb(LMBDA, 0.0, 0.1, 30.0), "mu is 0.0; allowed: > 0"),
        (lambda: MohrCoulomb(-30.0, MU, 0.1, 30.0), "lmbda is -30.0"),
        (lambda: MohrCoulomb(LMBDA, MU, "0.1", 30.0), "cohesion is '0.1'; allowed: a number"),
        (lambda: MohrCoulombMonodirectional(LMBDA, MU, -0.1, 30.0), "MohrCoulombMonodirectional: cohesion is -0.1"),
        (lambda: MohrCoulombMonodirectional(LMBDA, MU, 0.1, 95.0), "friction_angle is 95.0"),
        (lambda: MohrCoulombMonodirectional(LMBDA, MU, 0.1, 30.0, unilateral=1), "unilateral is 1; allowed: True or False"),
        (lambda: MohrCoulombMonodirectional(LMBDA, MU, 0.1, 30.0, unilateral="no"), "unilateral is 'no'"),
        (lambda: MohrCoulombMonodirectional(LMBDA, MU, 0.1, 30.0, dilatancy_angle=1.0), "no parameter 'dilatancy_angle'"),
        (lambda: LAW.eased(1.5), "ease is 1.5; allowed: 0 to 1"),
        (lambda: LAW.eased("a bit"), "ease is 'a bit'; allowed: 0 to 1"),
    ],
)  # fmt: skip
def test_what_the_laws_refuse(build, message):
    with pytest.raises(LawError, match=message):
        build()
