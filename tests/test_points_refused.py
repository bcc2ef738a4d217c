"""Laws refuse parameters out of range, results of another shape and declarations that fit no parameter, by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import ufl
from mpi4py import MPI

from forms import BulkLaw, KernelLaw, TractionLaw
from forms.base import InputError
from forms.law import Step
from forms.planes import PLANES
from forms.traction import JumpStep
from tests.at_points import E2, respond
from tests.laws_at_points import KELVIN, LAWS
from tests.refused import refused
from thinlayer.discretisation.layer import real_law
from thinlayer.pointwise.material import Material


def test_jumps_know_no_plane():
    law = LAWS["traction"]
    assert real_law(law, PLANES["stress"]).parameters() == law.parameters()


def test_a_traction_law_has_no_powers_of_eps():
    @dataclass(frozen=True)
    class Scaled(TractionLaw):
        k: float
        powers: ClassVar = {"k": 1}

    refused(InputError, "Scaled: a traction law has no powers of eps", lambda: Scaled(1.0))


@dataclass(frozen=True)
class Remembering(BulkLaw):
    """A law in order, to be spoiled."""

    mu: float
    internal: ClassVar = {"old": (3, 3)}

    def stress(self, step):
        return 2 * self.mu * step.e

    def advance(self, step):
        return {"old": step.e}


def spoiled(**changes) -> type[BulkLaw]:
    return type("Spoiled", (Remembering,), changes)


@dataclass(frozen=True)
class PlaneTraction(TractionLaw):
    k: float

    def traction(self, step: JumpStep):
        return self.k * ufl.as_vector([step.w[0], step.w[1]])


def in_plane(a):
    return ufl.as_tensor([[a[i, j] for j in range(2)] for i in range(2)])


SPOILED = {
    "stress (2, 2)": spoiled(stress=lambda self, step: in_plane(step.e)),
    "stress (4, 4)": spoiled(stress=lambda self, step: ufl.Identity(4)),
    "stress (3,)": spoiled(stress=lambda self, step: ufl.dot(step.e, step.n)),
    "stress ()": spoiled(stress=lambda self, step: ufl.tr(step.e)),
    "stress a number": spoiled(stress=lambda self, step: 0.0),
    "stress None": spoiled(stress=lambda self, step: None),
    "other name": spoiled(advance=lambda self, step: {"new": step.e}),
    "name missing": spoiled(advance=lambda self, step: {}),
    "advance None": spoiled(advance=lambda self, step: None),
    "() for (3, 3)": spoiled(advance=lambda self, step: {"old": ufl.tr(step.e)}),
    "(2, 2) for (3, 3)": spoiled(advance=lambda self, step: {"old": in_plane(step.e)}),
    "(3, 3) for ()": spoiled(internal={"old": ()}),
    "(3, 3) for (3,)": spoiled(internal={"old": (3,)}),
    "declared (2,)": spoiled(internal={"old": (2,)}),
    "traction (2,)": PlaneTraction,
}


@pytest.mark.parametrize("name", SPOILED)
def test_a_law_that_gives_something_else_than_it_must(name):
    """The message names the law."""
    kind = SPOILED[name]
    refused(InputError, kind.__name__, lambda: Material(MPI.COMM_SELF, kind(1.0).of_strains()))


def test_the_law_in_order_is_accepted():
    e = np.arange(6.0)[None]
    assert respond(Remembering(2.0), e, 0 * e, np.zeros((1, 6)), E2[None]).stress == pytest.approx(4 * e)


def test_a_rate_that_is_not_declared():
    """Step.rate outside a march: a law must declare rate = True."""
    refused(InputError, "rate = True", lambda: KELVIN.stress(Step(ufl.Identity(3), e_old=ufl.Identity(3))))


# ---------------------------------------------------------------- declarations and kernels
def declared(body: str, decorated: bool = True):
    """A law's class from source."""
    names = {"BulkLaw": BulkLaw, "KernelLaw": KernelLaw, "dataclass": dataclass, "np": np}
    decorator = "@dataclass(frozen=True)\n" if decorated else ""
    exec(f"{decorator}class Mine(BulkLaw):\n    k: float = 30.0\n" + body, names)
    return names["Mine"]


@pytest.mark.parametrize(
    ("body", "decorated", "message"),
    [
        ('    powers = {"K": 1}\n', True, "powers has 'K'; parameters: k"),
        ('    powers = {"k": float("nan")}\n', True, "power of k is nan"),
        ('    powers = ["k"]\n', True, r"powers is \{parameter: power\}"),
        ('    internal = ["a"]\n', True, r"internal is \{name: shape\}"),
        ('    powers = {"k": 1}\n', False, r"not a dataclass: write @dataclass\(frozen=True\)"),
    ],
)
def test_what_a_class_declares_fits_its_parameters(body, decorated, message):
    refused(InputError, message, lambda: declared(body, decorated)())
