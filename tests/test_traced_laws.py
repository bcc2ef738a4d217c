"""Laws of one's own are what they compute now: what they read, what they must not decide, what they leave out."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any, ClassVar

import basix.ufl
import numpy as np
import pytest
import ufl

from forms import BulkLaw, LinearElastic, TractionLaw, check
from forms.base import InputError
from geometry import sandwich
from tests.own_laws import Springs, Swelling
from tests.refused import refused
from thinlayer import SolveError, Structure, ThinLayer, drive, march, solve

pytestmark = pytest.mark.few(5)

FACTOR = 1.0
STEP = [{"w_T": 0.01, "w_N": 0.02}]


def factor():
    return FACTOR


@dataclass(frozen=True)
class ReadsGlobals(BulkLaw):
    k: float
    powers: ClassVar = {"k": 1}
    internal: ClassVar = {"last": (3, 3)}
    share: ClassVar = 1.0

    def advance(self, step):
        return {"last": step.e}

    def stress(self, step):
        return 2 * self.k * self.share * factor() * getattr(self, "extra", 1.0) * step.mid


@dataclass(frozen=True)
class JumpsReadGlobals(TractionLaw):
    k: float

    def traction(self, step):
        return self.k * factor() * step.mid


def shear(law: BulkLaw) -> float:
    return float(drive(law, STEP).tractions[0, 0])


@pytest.mark.parametrize("law", [ReadsGlobals(5.0), JumpsReadGlobals(5.0)])
def test_what_a_law_reads_is_what_it_is_now(law, monkeypatch):
    """The third time it is what it was the first time."""
    for value in (1.0, 3.0, 1.0):
        monkeypatch.setitem(globals(), "FACTOR", value)
        assert shear(law) == pytest.approx(5.0 * 0.01 * value, rel=1e-14)


# ---------------------------------------------------------------- decisions
@dataclass(frozen=True)
class Deciding(BulkLaw):
    """Branches by numbers in Python: UFL would compare how expressions are written."""

    k: float
    n: float = 3.0
    powers: ClassVar = {"k": 1}

    def stress(self, step):
        return 2 * (2 * self.k if self.decision() else self.k) * step.mid


@dataclass(frozen=True)
class DecidingJumps(TractionLaw):
    k: float
    n: float = 3.0

    def traction(self, step):
        return (2 * self.k if self.decision() else self.k) * step.mid


DECISIONS = {
    "equal": lambda self: self.n == 3,
    "computed": lambda self: 2 * self.n + 1 == 7,
    "true": lambda self: self.n,
    "in": lambda self: self.n in (1, 2, 3),
    "float": lambda self: float(self.n) == 3,
    "math": lambda self: math.sqrt(self.n) > 1,
}


@pytest.mark.few(1)
@pytest.mark.parametrize(("decision", "parent"), zip(DECISIONS, itertools.cycle((Deciding, DecidingJumps))))
def test_laws_that_decide_by_a_number(parent, decision):
    law = type("Mine", (parent,), {"decision": DECISIONS[decision]})(5.0, 0.0 if decision == "true" else 3.0)
    refused(InputError, r"^Mine\.(stress|traction): .*ufl\.conditional\(ufl\.", lambda: check(law))


def test_conditions_of_ufl_are_no_decisions():
    @dataclass(frozen=True)
    class Conditional(Deciding):
        def stress(self, step):
            return 2 * ufl.conditional(ufl.eq(self.n, 3), 2 * self.k, self.k) * step.mid

    assert [shear(Conditional(5.0, n)) for n in (3.0, 4.0)] == pytest.approx([0.1, 0.05])


def test_a_law_at_points_knows_its_numbers_alone():
    x = ufl.SpatialCoordinate(ufl.Mesh(basix.ufl.element("P", "triangle", 1, shape=(2,))))

    @dataclass(frozen=True)
    class Placed(TractionLaw):
        k: float

        def traction(self, step):
            return self.k * x[0] * step.mid

    refused(InputError, r"Placed contains x, a SpatialCoordinate; a compiled law knows", drive, Placed(1.0), STEP)


# ---------------------------------------------------------------- eigenstrains


class Affine(Swelling):
    """`linear`, in that its tangent is constant."""

    linear = True


def column(kind: str, law: BulkLaw, body: BulkLaw, **more):
    """A column of height 1 that can neither widen nor lengthen."""
    joint = sandwich(1.0, 0.5, 0.5, 0.5, cell="quadrilateral", structured=True)
    sides = {"BOTTOM": 0.0, "TOP": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    layer = law if law.traits.of_jumps else ThinLayer(law, 0.1, at=1.0)
    return getattr(Structure(joint, body=body, supports=sides, **more), kind)(layer)


AFFINE = [("interface", solve), ("full", lambda model: march(model, [0.5, 1.0], theta=0.7).last)]


@pytest.mark.parametrize(("kind", "how"), AFFINE)
def test_an_affine_law_that_says_linear(kind, how):
    """The layer would open by `free`; t_N = K (w_N - free) presses the bodies, of height 1 in all, together by -w_N."""
    law, body, e_0 = Affine(7.0, 4.0, 0.03), LinearElastic(60.0, 40.0), 0.03
    K = 7.0 + 2 * 4.0
    free = e_0 * (3 * 7.0 + 2 * 4.0) / K
    state = how(column(kind, law, body))
    t = -free / (1 / K + 1 / 140.0)
    assert np.abs(state.u.x.array).max() == pytest.approx(-t * 0.5 / 140.0, rel=1e-9)
    e = t / K + free  # of the layer, times its thickness
    layer = (15.0 * (e - e_0) ** 2 + 2 * (7.0 + 4.0) * e_0**2 * 2 - 2 * 2 * 7.0 * e_0 * (e - e_0)) / 2
    assert state.energies()["bodies"] == pytest.approx(t * t / 140.0 / 2, rel=1e-9)
    assert state.energies()["layer"] == pytest.approx(layer, rel=1e-9)
    if how is not solve:
        assert abs(state.audit.imbalance) < 1e-9


# ---------------------------------------------------------------- declarations
def test_which_parameters_are_one_number():
    """By their annotations, as text or not."""

    def bare(k: Any, **arguments: Any) -> BulkLaw:
        names = {"__annotations__": {"k": float, "m": "float | None", "C": list}, "m": None, "C": (1.0, 2.0)}
        return dataclass(frozen=True)(type("Bare", (BulkLaw,), names))(k, **arguments)

    assert bare(1.0, C=[5.0, 6.0]).C == [5.0, 6.0]
    for arguments in ({"k": [1.0, 2.0]}, {"k": 1.0, "m": [1.0]}):
        refused(InputError, r"^Bare: \w is \[.*\]; allowed: a number$", bare, **arguments)


def test_a_traction_law_that_does_not_evolve():
    @dataclass(frozen=True)
    class Forgetful(TractionLaw):
        k: float
        internal: ClassVar = {"slip": (3,), "path": ()}

        def traction(self, step):
            return self.k * step.mid

    refused(InputError, r"Forgetful gives no new slip, path; .* evolve\(step\)", lambda: drive(Forgetful(1.0), STEP))
    Forgetful.evolve = lambda self, step: {"slip": step.mid}
    with pytest.raises(InputError, match=r"Forgetful\.evolve gives \['slip'\]; it must give \['path', 'slip'\]"):
        drive(Forgetful(1.0), STEP)


def test_a_law_without_energy_has_none_to_tell():
    model = column("interface", Springs(5.0, 7.0), LinearElastic(60.0, 40.0), body_force=(0.0, 1.0))
    energies = solve(model).energies()
    assert math.isnan(energies["layer"])
    assert energies["bodies"] > 0
    refused(InputError, "Deciding declares no energy", lambda: Deciding(5.0).energy(None))


@dataclass(frozen=True)
class Rooted(TractionLaw):
    """An infinite slope at rest; NaN where it is pulled."""

    k: float
    shift: float

    def traction(self, step):
        return self.k * ufl.sqrt(self.shift - ufl.dot(step.mid, step.n)) * step.n + self.k * step.mid


@pytest.mark.few(1)
@pytest.mark.parametrize(("shift", "what"), [(0.0, r"tangent \(the slope of the stress\)"), (-1.0, "stress")])
def test_a_failing_law_says_what_and_where(shift, what):
    message = rf"failed at \d+ points: the {what} of Rooted is not finite at x = \(0\.\d+, 0"
    refused(SolveError, message, solve, column("interface", Rooted(3.0, shift), LinearElastic(60.0, 40.0)))
