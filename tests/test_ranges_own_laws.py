"""What is told, and refused, of laws of one's own: as of the laws that compute the same and declare their stiffness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest
import ufl

from forms import Anisotropic, BulkLaw, Incompressible, KelvinVoigt, LinearElastic, Maxwell, Stack
from forms.base import InputError
from forms.elastic import lame_stress
from forms.law_tangents import tangent_after, tangent_at_rest
from geometry import sandwich
from studies.problems import FOURIER_LAYER, fourier
from tests import ranges_told
from tests.own_laws import Mises, Springs, StandardSolid, layer_of
from tests.refused import refused
from thinlayer import Structure, ThinLayer, solve
from thinlayer.discretisation.model import Model

pytestmark = pytest.mark.few(5)

STIFF = LinearElastic.young(1e5, 0.3)


@dataclass(frozen=True)
class Own(BulkLaw):
    """Isotropic elasticity that says nothing of its stiffness."""

    a: float
    b: float
    powers: ClassVar = {"a": 1, "b": 1}
    linear: ClassVar = True

    def stress(self, step):
        return lame_stress(self.a, self.b, step.e)


class Remembering(Own):
    internal: ClassVar = {"nothing": ()}

    def advance(self, step):
        return {"nothing": step.q["nothing"]}


def range_warnings(action):
    """The messages of its RangeWarnings."""
    return ranges_told.with_warnings(action)[1]


# ---------------------------------------------------------------- tangents at rest
@pytest.mark.parametrize("kind", [Own, Remembering])
def test_tangent_of_own_laws(kind):
    for n in (np.array([0.28, 0.96]), np.array([0.48, -0.64, 0.6])):
        wanted = LinearElastic(6.0, 2.5).stiffness(n)
        assert tangent_at_rest(kind(6.0, 2.5), n) == pytest.approx(wanted, abs=1e-9)  # of the rounding of differences


def test_tangent_over_a_step():
    """What has come of the springs: a step of backward Euler divides a relaxing one by 1 + dt/t."""
    n, dt = np.array([0.28, 0.96]), 0.3
    wanted = {
        StandardSolid(6.0, 2.5, 1.5, 0.4): (6.0 - 2 / 3 * 1.5 / 1.75, 2.5 + 1.5 / 1.75),
        Remembering(6.0, 2.5): (6.0, 2.5),
        Maxwell(6.0, 2.5, 0.4): (6.0 / 1.75, 2.5 / 1.75),
        KelvinVoigt(6.0, 2.5, 0.7, 0.2): (6.0 * (1 + 7 / 3), 2.5 * (1 + 2 / 3)),
    }
    for law, (lmbda, mu) in wanted.items():
        assert tangent_after(law, n, dt) == pytest.approx(LinearElastic(lmbda, mu).stiffness(n), abs=1e-12 * lmbda)
    assert tangent_after(Mises(6.0, 2.5, 1.0), n, dt) is None


# ---------------------------------------------------------------- thick, hard, nearly incompressible


@pytest.mark.parametrize("stiffer", [LinearElastic.young(1e3, 0.3), LinearElastic.young(1.0, 0.3)])
def test_as_hard_as_the_bodies(stiffer):
    """Own laws are told as those that declare their stiffness; not beside a body that holds the other one on S."""
    joint, setup = fourier(1 / 8, cell="quadrilateral")
    e = LinearElastic.young(1.0, 0.3)
    two = {"body": {"LOWER": stiffer, "UPPER": e}}
    structure = Structure(joint, **setup | two)
    reported = [
        range_warnings(lambda law=law: solve(structure.interface(ThinLayer(law, 0.01))))
        for law in (e, Own(e.lmbda, e.mu))
    ]
    assert reported[0] == reported[1]
    assert [message.partition(":")[0] for message in reported[0]] == ["order 0"] * (stiffer.mu < 1)


def test_incompressible_with_free_ends():
    """[u_N] = 0 is told of where the layer's side is free, and nowhere else."""
    joint = sandwich(1.0, 0.5, 0.5, 0.25)
    layer = ThinLayer(Incompressible(40.0), 0.1, at=1.0)
    for sides, messages in (({"LEFT": {"x": 0.0}}, 1), ({"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}, 0)):
        data = {"body": STIFF, "supports": {"BOTTOM": 0.0, **sides}, "tractions": {"TOP": (0.0, -1.0)}}
        reported = range_warnings(lambda data=data: solve(Structure(joint, **data).interface(layer)))
        assert (
            sum("incompressible: the layer is incompressible: its law holds" in text for text in reported) == messages
        )
        assert bool(reported) == bool(messages)


# ---------------------------------------------------------------- negative stiffness
def model_of(layer: BulkLaw, kind: Any = Structure.interface, body: BulkLaw = STIFF, **data: Any) -> Model:
    joint, setup = fourier(1 / 8, cell="quadrilateral")
    return kind(Structure(joint, **setup | {"body": body} | data), layer_of(layer, 0.1))


NEGATIVE = [Own(-6.0, 2.5), Remembering(-6.0, -2.5), Stack((0.4, Own(6.0, 2.5)), (0.6, Own(9.0, -2.5)))]


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", [Structure.interface, Structure.full])
@pytest.mark.parametrize("law", NEGATIVE)
def test_negative_layer(law, kind):
    """lmbda + 2 mu or mu, whichever is lower; parameters per thickness are told as real ones."""
    wrong = law.laws[1] if isinstance(law, Stack) else law
    a, b = wrong.a, wrong.b
    lowest = min(0.1 * b, 0.1 * (a + 2 * b))
    refused(InputError, rf"stiffness at rest is negative, .*\(of n\.C\.n\) is {lowest:g},", model_of, law, kind)


def test_negative_body():
    """A layer takes lmbda + 2 mu/3 < 0, a body does not: its bulk modulus is negative."""
    model_of(Own(-2.0, 2.5))
    with pytest.raises(InputError, match=r"Own: the stiffness at rest is negative.*\(of C\)"):
        model_of(FOURIER_LAYER, body=Own(-2e4, 1.5e4))
    model_of(FOURIER_LAYER, body=Own(-0.9e4, 1.5e4))


@dataclass(frozen=True)
class Hill(BulkLaw):
    """Falls from the beginning, and rises later."""

    k: float
    powers: ClassVar = {"k": 1}

    def stress(self, step):
        return self.k * step.e * (ufl.inner(step.e, step.e) - 1)


def test_which_laws_are_refused():
    for law in (Springs(-3.0, -3.0), Hill(5.0)):
        refused(InputError, "stiffness at rest is negative", model_of, law)
    said = type("Said", (Hill,), {"softens": True})(5.0)
    for law in (Springs(3.0, 3.0), Springs(0.0, 0.0), said, Anisotropic.springs(7.0, 0.0)):
        model_of(law)
