"""Softening that a law in forms does not say: told from the step on in which its stress falls, on S and in the layer."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import ClassVar

import pytest
import ufl

from forms import BulkLaw, LinearElastic
from forms.kinematics import lift
from geometry import sandwich
from tests import ranges_told
from thinlayer import Structure, ThinLayer, march, solve

EPS = 0.05
STIFF = LinearElastic.young(1e6, 0.3)


@dataclass(frozen=True)
class Falling(BulkLaw):
    """k e exp(-e:e/s^2), which falls beyond e = s/sqrt 2."""

    k: float
    s: float
    powers: ClassVar = {"k": 1, "s": -1}

    def stress(self, step):
        return self.k * step.mid * ufl.exp(-ufl.inner(step.mid, step.mid) / self.s**2)


@dataclass(frozen=True)
class WeakInShear(BulkLaw):
    """From an energy: as the layer opens by e_N = c, nothing resists its slip; across S it never softens."""

    k: float
    c: float
    powers: ClassVar = {"k": 1, "c": -1}

    def stress(self, step):
        e, n = ufl.variable(step.e), lift(step.n)
        e_N = ufl.dot(e * n, n)
        slip = ufl.inner(e * n, e * n) - e_N**2
        return ufl.sym(ufl.diff(self.k * (e_N**2 + e_N**4 + (1 - e_N / self.c) * slip), e))


def told(joint, law, kind, times):
    """RangeWarnings of a march, or of a solve at one time, in which the layer opens by t times its thickness."""
    supports = {"BOTTOM": 0.0, "TOP": {"y": lambda x, t: EPS * t}}
    sides = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}} if joint.dim == 2 else {}
    model = kind(Structure(joint, body=STIFF, supports=supports | sides), ThinLayer(law, EPS))
    return ranges_told.told(lambda: march(model, times) if isinstance(times, list) else solve(model, times))[1]


@pytest.mark.parametrize("kind", [Structure.interface, Structure.full])
@pytest.mark.parametrize(("law", "onset"), [(Falling(3.0, 0.4), 0.4 / math.sqrt(2)), (WeakInShear(3.0, 0.3), 0.3)])
def test_where_stresses_fall(law, onset, kind):
    """Wherever the unit of stress; a march tells it once, at the first step beyond, a solve only beyond."""
    joint = sandwich(2.0, 1.0, 1.0, 1.0, cell="quadrilateral")
    before, after = 0.97 * onset, 1.03 * onset
    (message,) = told(joint, law, kind, [before, after, 1.1 * onset])
    name = type(law).__name__
    assert re.search(rf"at t = {after:g} the stress of {name} falls at \d+ points of the layer as", message)
    assert "write softens = True" in message
    assert told(joint, law, kind, before) == []
    assert len(told(joint, law, kind, after)) == 1
