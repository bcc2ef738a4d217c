"""Tension at which rubber would cavitate is told, against the closed form of a disc; pressure is not."""

from __future__ import annotations

import re

import numpy as np
import pytest

from forms import Incompressible, Rubber
from tests.closed_forms import rubber_disc_pressure
from tests.ranges_told import with_warnings
from tests.test_rubber_bearings import PLATES, joint, layer, modulus
from tests.test_rubber_closed_forms import EPS, MU, RADIUS
from thinlayer import Structure, march, solve

NU = 0.499


def disc(motion):
    """Its plates part by `motion`."""
    supports = {"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": motion}}
    return Structure(joint("disc", 0.2), body=PLATES, supports=supports, plane="axisymmetric")


def tensions(messages):
    matches = [re.search(r"is a tension, ([0-9.]+) times its shear modulus", message) for message in messages]
    return [float(match[1]) for match in matches if match]


@pytest.mark.parametrize("law", [Rubber(modulus(NU), MU), Incompressible(MU)])
def test_disc(law):
    lmbda = law.lmbda if isinstance(law, Rubber) else float("inf")
    opening = MU / rubber_disc_pressure(lmbda, MU, EPS, RADIUS, 0.0)  # at which p = mu on the axis
    for ratio, wanted in ((2.4, []), (2.6, [2.6]), (-5.0, [])):
        _, said = with_warnings(lambda ratio=ratio: solve(disc(ratio * opening).interface(layer(law))))
        assert tensions(said) == pytest.approx(wanted, rel=5e-3)
    _, said = with_warnings(lambda: march(disc(lambda x, t: t * opening).interface(layer(law)), [1.0, 3.0, 5.0]))
    assert tensions(said) == pytest.approx([5.0], rel=5e-3)


def test_modulus_that_varies():
    """Tension over the modulus is largest where the rubber is soft, not where the tension is largest."""
    opening = 0.1  # mm
    law = Rubber(modulus(NU), lambda x: MU * np.where(x[0] > 0.5 * RADIUS, 0.2, 1.0))
    state, said = with_warnings(lambda: solve(disc(opening).interface(layer(law))))
    p = state.p
    x = p.function_space.tabulate_dof_coordinates()[:, 0]
    soft = x > 0.5 * RADIUS * (1 + 1e-9)
    wanted = max((p.x.array[soft] / (0.2 * MU)).max(), (p.x.array[~soft] / MU).max())
    assert tensions(said) == pytest.approx([wanted], rel=0.02)
