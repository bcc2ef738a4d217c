"""Laws refuse results of another shape and declarations that fit no parameter, by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import ufl
from mpi4py import MPI

from forms import BulkLaw, TractionLaw
from forms.base import InputError
from forms.law import Step
from tests.at_points import E2, respond
from tests.laws_at_points import KELVIN
from tests.refused import refused
from thinlayer.pointwise.compiled_law import CompiledLaw


@dataclass(frozen=True)
class Remembering(BulkLaw):
    """A law in order, to be spoiled."""

    mu: float
    internal: ClassVar = {"old": (3, 3)}

    def stress(self, step):
        return 2 * self.mu * step.e

    def advance(self, step):
        return {"old": step.e}


@dataclass(frozen=True)
class Traction(TractionLaw):
    k: float

    def traction(self, step):
        return self.k * ufl.as_vector([step.w[0], step.w[1]])


def spoiled(**changes) -> type[BulkLaw]:
    return type("Spoiled", (Remembering,), changes)


def in_plane(a):
    return ufl.as_tensor([[a[i, j] for j in range(2)] for i in range(2)])


SPOILED = {
    "stress (2, 2)": (spoiled(stress=lambda self, step: in_plane(step.e)), r"Spoiled\.stress has the shape \(2, 2\)"),
    "stress a number": (spoiled(stress=lambda self, step: 0.0), r"Spoiled\.stress has the shape \(\)"),
    "stress None": (spoiled(stress=lambda self, step: None), r"Spoiled\.stress is None; it must be UFL"),
    "stress fails": (spoiled(stress=lambda self, step: ufl.sin(step.e)), r"Spoiled\.stress: .* Laws are UFL"),
    "other name": (spoiled(advance=lambda self, step: {"new": step.e}), r"Spoiled\.advance gives \['new'\]"),
    "advance None": (spoiled(advance=lambda self, step: None), r"Spoiled\.advance gives None"),
    "() for (3, 3)": (spoiled(advance=lambda self, step: {"old": ufl.tr(step.e)}), r"Spoiled\.advance\['old'\] has"),
    "(3, 3) for (3,)": (spoiled(internal={"old": (3,)}), r"Spoiled\.advance\['old'\] has the shape \(3, 3\)"),
    "traction (2,)": (Traction, r"Traction\.traction has the shape \(2,\)"),
    "powers of eps": (type("Scaled", (Traction,), {"powers": {"k": 1}}), "Scaled: a traction law has no powers of eps"),
    "another's power": (spoiled(powers={"K": 1}), "powers has 'K'; parameters: mu"),
    "no power": (spoiled(powers={"mu": float("nan")}), "power of mu is nan"),
    "no dataclass": (spoiled(__annotations__={"k": float}), r"not a dataclass: write @dataclass\(frozen=True\)"),
}


@pytest.mark.parametrize("name", SPOILED)
def test_a_law_that_gives_something_else_than_it_must(name):
    """The message names the law."""
    kind, message = SPOILED[name]
    refused(InputError, message, lambda: CompiledLaw(MPI.COMM_SELF, kind(1.0).as_bulk_law()))


def test_the_law_in_order_is_accepted():
    e = np.arange(6.0)[None]
    assert respond(Remembering(2.0), e, 0 * e, np.zeros((1, 6)), E2[None]).stress == pytest.approx(4 * e)


def test_a_rate_without_a_time_step():
    """The law declares its rate, so that the message must say more than that it must."""
    refused(InputError, "and a time step", lambda: KELVIN.stress(Step(ufl.Identity(3), e_old=ufl.Identity(3))))
