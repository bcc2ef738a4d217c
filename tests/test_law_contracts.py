"""Laws are told the same in all places, and what they declare is what they do."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np
import pytest
import ufl
from ufl.algorithms import expand_derivatives

import forms
from forms import Anisotropic, BulkLaw, KelvinVoigt, LinearElastic, Maxwell, Stack, TractionLaw
from forms.base import InputError
from forms.check import require_consistent
from forms.elastic import lame_stress
from forms.law import PlaneStressLaw
from forms.law_tangents import evaluate, tangent_at_rest
from forms.tensors import three_dimensional
from forms.viscous import isotropic_energy
from geometry import block, sandwich
from tests.own_laws import Mises
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, drive, march, solve

pytestmark = pytest.mark.few(5)

L, M = 3.0, 2.0  # moduli per thickness; lmbda + 2 mu = 7
EPS, CREEP = 0.1, 0.5
ROUNDED = 1e-9  # relative: the solver's residual
STEEL = LinearElastic.young(E=210e3, nu=0.3)
HELD = {"BOTTOM": 0, "LEFT": {"x": 0}, "RIGHT": {"x": 0}}


def law_of(parent: type[BulkLaw] = BulkLaw, **names) -> BulkLaw:
    """A law of two moduli, of these methods and declarations."""
    powers = {} if parent is TractionLaw else {"powers": {"l": 1, "m": 1}}
    declared = {"__annotations__": {"l": "float", "m": "float"}, **powers} | names
    return dataclass(frozen=True)(type("Own", (parent,), declared))(L, M)


def of_end(law, step):
    return lame_stress(law.l, law.m, step.e)


def of_mid(law, step):
    return lame_stress(law.l, law.m, step.mid)


@cache
def joint():
    return sandwich(width=2, lower=1, upper=1, h=1, cell="quadrilateral")


def column(law, kind=Structure.interface, tractions=(0, 1.0), body=STEEL):
    layer = law if isinstance(law, TractionLaw) else ThinLayer(law, EPS, at=1.0)
    return kind(Structure(joint(), body=body, supports=HELD, tractions={"TOP": tractions}), layer)


def opening(law, kind, theta, steps=4):
    """Mean opening of a column whose load grows as t, at t = 1, and what is not balanced in energy."""
    load = lambda x, t: (0, t)
    history = march(column(law, kind, load), [(k + 1) / steps for k in range(steps)], theta=theta)
    S = Surface(column(law, tractions=load))
    mean = S.integral(S.frame(S.jump(history.last))[1]) / S.integral(ufl.as_ufl(1.0))
    return mean, max(abs(row["imbalance"] or 0.0) for row in history.table.rows)


# ---------------------------------------------------------------- what laws without memory are told
def energy(law, step):
    return isotropic_energy(law.l, law.m, step.e)


def test_a_sublayer_without_memory_answers_where_forces_balance():
    """Written with step.e or step.mid, on S and in the meshed layer, the same law."""
    theta = 0.7
    creeping = KelvinVoigt(L, M, CREEP, CREEP)
    expected, _ = opening(Stack((0.4, LinearElastic(L, M)), (0.6, creeping)), Structure.interface, theta)
    for stress in (of_end, of_mid):
        law = Stack((0.4, law_of(stress=stress, energy=energy, linear=True)), (0.6, creeping))
        for kind in (Structure.interface, Structure.full):
            mean, imbalance = opening(law, kind, theta)
            assert mean == pytest.approx(expected, rel=1e-6)  # the meshed layer's corners are those of S to the solver
            assert imbalance < ROUNDED


@pytest.mark.few(1)
@pytest.mark.parametrize("name", ["e_old", "dt", "rate"])
def test_laws_without_memory_are_told_of_no_step(name):
    """Neither in a form nor at points; the message says what they need."""
    law = law_of(
        stress=lambda law, step: of_mid(law, step) + 0.5 * law.m * ufl.inner(getattr(step, name), step.e) * step.e
    )
    for ask in (lambda: drive(law, [{"w_T": 0.1, "w_N": 0.2}]), lambda: solve(column(law))):
        refused(InputError, r"rate = True", ask)


# ---------------------------------------------------------------- what is not what it says
def evolve_at(place):
    """A tensor with one component of the strain, or of the jump."""

    def new(law, step):
        e = step.w[1] if hasattr(step, "w") else step.e[1, 1]
        return {"q": ufl.as_tensor([[e if (i, j) == place else 0 for j in range(3)] for i in range(3)])}

    return new


def sheared(law, step):
    """Pressure that grows with shear, shear that does not grow with closing."""
    n = three_dimensional(step.n)
    return of_mid(law, step) + law.l * step.mid[0, 1] * ufl.outer(n, n)


def spring(law, step):
    return law.l * step.mid


def stored_by_spring(law, step):
    return law.l / 2 * ufl.inner(step.w, step.w)


LAST = {"internal": {"last": (3, 3)}, "advance": lambda law, step: {"last": step.e}}
CORNER = ufl.as_tensor([[0, 1, 0], [0, 0, 0], [0, 0, 0]])
WRONG = {
    "square": (
        {"linear": True, "stress": lambda law, step: law.m * step.e + law.l * ufl.tr(step.e) ** 2 * ufl.Identity(3)},
        "Own declares linear = True, but its stress is not affine",
    ),
    "no stress": ({"stress": lambda law, step: 0 * step.e}, r"Own\.stress is zero, whatever the strain"),
    "skew stress": (
        {"stress": lambda law, step: of_mid(law, step) + step.mid[0, 0] * CORNER},
        r"Own\.stress is not symmetric: .* use ufl\.sym",
    ),
    "skew tangent": ({"stress": sheared, "linear": True}, "Own: the tangent is not symmetric.* symmetric = False"),
    "skew tangent, memory": (LAST | {"stress": sheared}, "Own: the tangent is not symmetric.* symmetric = False"),
    "energy": (
        {"stress": of_end, "energy": lambda law, step: 5 * energy(law, step)},
        r"the derivative of the energy by the strain is not the stress, it is 4\.0e\+00 of the stress",
    ),
    "decision at theta = 1": (
        LAST | {"stress": lambda law, step: (1 if step.theta == 1 else 2) * of_mid(law, step)},
        r"Own\.stress: a parameter",
    ),
    "jumps, memory": (
        {"traction": spring, "internal": {"q": (3, 3)}, "evolve": evolve_at((1, 0))},
        r"Own\.evolve\['q'\] is not sym",
    ),
    "jumps, energy": (
        {"traction": spring, "energy": lambda law, step: 2 * stored_by_spring(law, step)},
        "the derivative of the energy",
    ),
}
RIGHT = [
    law_of(stress=of_end, energy=energy, linear=True),
    law_of(stress=of_end, energy=lambda law, step: 5 * energy(law, step), symmetric=False),  # a note that nobody uses
    law_of(stress=sheared, linear=True, symmetric=False),
    law_of(stress=lambda law, step: of_mid(law, step) + law.l * ufl.Identity(3), linear=True),  # it swells
    law_of(
        stress=lambda law, step: (1 if law.l == 7 else 2) * of_mid(law, step)
    ),  # with these numbers it does not matter
    law_of(TractionLaw, traction=spring, energy=stored_by_spring, linear=True),
]


@pytest.mark.few(1)
@pytest.mark.parametrize("name", WRONG)
def test_what_a_law_is_not(name):
    names, message = WRONG[name]
    law = law_of(TractionLaw if "traction" in names else BulkLaw, **names)
    for _ in range(2):  # what has failed is not known as right
        refused(InputError, message, lambda: forms.check(law))
    refused(InputError, "is a class; give a law, with its numbers", lambda: forms.check(type(law)))


def test_what_a_law_is():
    for law in RIGHT:
        forms.check(law)
        drive(law, [{"w_T": 0.1, "w_N": 0.2}])


def test_models_and_points_ask_it():
    """On S, in the meshed layer, as a sublayer, in a body and at points."""
    names, message = WRONG["skew tangent"]
    for law in (law_of(**WRONG["skew tangent, memory"][0]), Stack((0.4, law_of(**names)), (0.6, LinearElastic(L, M)))):
        for ask in (
            lambda law=law: solve(column(law)),
            lambda law=law: solve(column(law, Structure.full)),
            lambda law=law: drive(law, [{"w_T": 0.1, "w_N": 0.2}]),
        ):
            refused(InputError, message, ask)
    body = law_of(**WRONG["square"][0])
    refused(InputError, "Own declares linear", lambda: solve(column(LinearElastic(L, M), body=body)))


def test_supports_alone_drive_a_step_from_its_linear_start():
    """A law that hardens takes 6 linear solves. Wrong twin: 9, if rounding of forces cuts the start."""
    body = law_of(stress=lambda law, step: of_mid(law, step) + 1e3 * law.m * ufl.inner(step.mid, step.mid) * step.mid)
    joint = block(1.0, 0.5, 0.25, cell="quadrilateral")
    supports = {"TOP": {"x": 0.02, "y": 0.03}}
    state = solve(Structure(joint, body=body, supports=supports).interface(ThinLayer(LinearElastic(L, M), EPS)))
    assert state.report.iterations <= 7


def test_it_is_asked_again_for_other_numbers():
    law = law_of(stress=lambda law, step: of_mid(law, step) + (law.l - L) * step.mid[0, 1] * ufl.Identity(3))
    forms.check(law)
    refused(InputError, "the tangent is not symmetric", lambda: forms.check(law.with_parameters({"l": L + 1})))


def test_a_law_that_ufl_does_not_take_for_linear():
    """Linear in numbers, by functions that are not."""
    law = law_of(
        stress=lambda law, step: ufl.ln(ufl.exp(law.m * ufl.tr(step.e))) * ufl.Identity(3) + law.m * step.e, linear=True
    )
    refused(InputError, "Own says linear = True, but is not linear, or UFL does not see that it is", solve, column(law))


CHI = [[0, 0], [0, 1]]
OURS = [
    *RIGHT,
    Anisotropic(np.diag([3.0, 4, 5, 1, 2, 3]), "layer"),
    KelvinVoigt(L, M, CREEP, 0.3),
    Maxwell(L, M, CREEP, 0.6),
    forms.Norton(L, M, 1.5, 1.5),
    forms.MohrCoulombMonodirectional(L, M, 0.4, 30, 0.1, unilateral=True),
    forms.NonMonotone(1.0, 10.0, 1.5, 0.15, CHI),
]


def test_laws_of_this_package_are_what_they_say(monkeypatch):
    """They are not asked where they are solved; all that is asked has numbers."""
    value = lambda expression, values=None: evaluate(expand_derivatives(expression), values)
    monkeypatch.setattr(sys.modules["forms.check"], "_evaluated", value)
    for law in OURS:
        require_consistent(law.as_bulk_law())


def test_numbers_are_those_of_ufl():
    """Of a repeated index, of indices in another order, of branches that have no number, and of variables."""
    i, j, k = ufl.indices(3)
    A, B = ufl.as_matrix([[1.0, 2.0], [3.5, -4.0]]), ufl.as_matrix([[0.3, -0.7], [2.0, 5.0]])
    a, none = ufl.variable(A[0, 0] * B[0, 1]), ufl.sqrt(A[1, 1] * A[0, 1])
    chosen = ufl.conditional(ufl.And(ufl.lt(a, 1.0), ufl.Not(ufl.gt(a, 0.0))), ufl.exp(a) + a**3, none)
    for expression in (
        A[i, i],
        ufl.as_tensor(A[i, k] * B[k, j] / ufl.sqrt(B[i, i] + 1), (j, i)),
        ufl.as_tensor(A[j, i] + 2 * A[i, j], (i, j)),
        ufl.as_tensor(abs(A[i, j]) * B[1, k], (k, j, i)),
        chosen * ufl.inv(A) * ufl.dev(B),
    ):
        lowered = expand_derivatives(expression)
        theirs = [lowered((0.0,), component=place) for place in np.ndindex(*lowered.ufl_shape)]
        assert evaluate(lowered).ravel() == pytest.approx(theirs, rel=1e-14)
    assert np.isnan(evaluate(ufl.as_ufl(none)))


# ---------------------------------------------------------------- what belongs to a stress that was replaced
P = 0.5  # stress of heat
NU_E = 2 * L * M / (L + 2 * M)  # lmbda of plane stress
DERIVED = ("stiffness", "stations", "plane_stress")


@dataclass(frozen=True)
class Hot(LinearElastic):
    """stress = C:e - p I."""

    p: float

    def stress(self, step):
        return super().stress(step) - self.p * ufl.Identity(3)

    def energy(self, step):
        return isotropic_energy(self.lmbda, self.mu, step.e) - self.p * ufl.tr(step.e)


@dataclass(frozen=True)
class HotInPlane(Hot):
    """With the stress out of the plane zero, e_33 = (p - lmbda tr e)/(lmbda + 2 mu)."""

    def plane_stress(self):
        share = 2 * self.mu / (self.lmbda + 2 * self.mu)
        return self.with_parameters({"lmbda": self.lmbda * share, "p": self.p * share})


@dataclass(frozen=True)
class Cubic(LinearElastic):
    """Another stiffness."""

    a: float
    powers: ClassVar = {"lmbda": 1, "mu": 1, "a": 1}

    def stress(self, step):
        return super().stress(step) + self.a * step.e


def test_a_plane_stress_is_of_the_stress_beside_it():
    """The law's own, or the one that is found point by point; never that of the elastic law. A free layer opens."""
    assert isinstance(Hot(L, M, P).plane_stress(), PlaneStressLaw)
    for law in (Hot(L, M, P), HotInPlane(L, M, P)):
        free = drive(law.plane_stress(), [{"w_T": 0.0, "t_N": 0.0}])
        assert free.jumps[0, 1] == pytest.approx(P * 2 * M / (L + 2 * M) / (NU_E + 2 * M), rel=ROUNDED)


def test_a_stiffness_is_of_the_stress_beside_it():
    """Refused where it is negative, as of a law that inherits nothing."""
    n = np.array([0.0, 1.0])
    assert tangent_at_rest(Cubic(L, M, 1.5), n)[1] == pytest.approx([L, L + 2 * M + 1.5, L, 0, 0, 0], rel=ROUNDED)
    refused(InputError, "Cubic: the stiffness at rest is negative", lambda: column(Cubic(L, M, -8.0)))
    assert Cubic.stations is BulkLaw.stations is not LinearElastic.stations


def test_what_was_written_for_the_stress_of_a_law_stays():
    """Beside the law's own stress; of a law with more parameters, memory or traits; or written again."""

    def advance(law, step):
        return {"path": step.q["path"] + ufl.tr(step.e - step.e_old)}

    again = {name: getattr(LinearElastic, name) for name in DERIVED}
    twice = {"stress": lambda law, step: 2 * LinearElastic.stress(law, step)}
    memory = {"internal": {"path": ()}, "advance": advance}
    for parent, names in ((HotInPlane, {}), (LinearElastic, memory), (LinearElastic, twice | again)):
        kind = type("Own", (parent,), names)
        assert all(getattr(kind, name) is getattr(parent, name) for name in DERIVED)
        assert kind.energy is parent.energy
    base = type("Base", (BulkLaw,), {"stiffness": lambda law, n: np.eye(6)})  # of any law that follows it
    first = type("First", (base,), {"stress": of_mid})
    assert first.stiffness is base.stiffness
    assert type("Second", (first,), {"stress": of_end}).stiffness is BulkLaw.stiffness
    assert type("Switching", (forms.NonMonotoneUnrelaxed,), {"stress": of_end}).stiffness is BulkLaw.stiffness
    assert tangent_at_rest(forms.MohrCoulomb(L, M, 0.4, 30), np.array([0.0, 1.0])) is not None


def test_energies_that_nobody_checks_are_of_the_stress_beside_them():
    """Of laws with rate or memory: none rather than those of another stress; one that is written stays."""
    twice = type("Own", (KelvinVoigt,), {"stress": lambda law, step: 2 * KelvinVoigt.stress(law, step)})
    history = drive(twice(L, M, CREEP, 0.3), [{"w_T": 0.1, "w_N": 0.05}, {"w_T": 0.2, "w_N": 0.2}], dt=0.25)
    assert np.isnan(history.energies).all()
    assert np.isfinite(history.tractions).all()


# ---------------------------------------------------------------- what would be ignored
@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["stress", "advance", "energy", "dissipation"])
def test_methods_that_a_compiled_law_and_a_stack_never_ask(method):
    def never(law, step):
        return step.e

    with pytest.raises(InputError, match=f"Own has a method {method} that is never called: .* MohrCoulomb"):
        type("Own", (forms.MohrCoulomb,), {method: never})(L, M, 0.4, 30)
    with pytest.raises(InputError, match=f"Own has a method {method} that is never called: .* Stack"):
        type("Own", (Stack,), {method: never})((1.0, LinearElastic(L, M)))
    type("Own", (Mises,), {"source": Mises.source, "stress": never})(L, M, 1.0)  # beside the source: a note


def test_what_nobody_would_ask_of_a_law_is_refused():
    """As the law is made."""
    for parent, names, message in [
        (BulkLaw, {"advance": lambda law, step: {"q": step.e}}, "a method advance but no internal variables"),
        (TractionLaw, {"evolve": lambda law, step: {"q": step.w}}, "a method evolve but no internal variables"),
        (BulkLaw, {"at": lambda law, x, t: {"l": x[0]}, "varies": False}, "a method at, but no parameters vary"),
        (BulkLaw, {"dissipation": lambda law, step: 1.0}, "a dissipation but no energy"),
        (BulkLaw, {"internal": {"q": (2, 2)}}, r"variable 'q' is \(2, 2\); allowed: \(\), \(3,\), \(3, 3\)"),
    ]:
        refused(InputError, message, law_of, parent, **names | {"stress" if parent is BulkLaw else "traction": of_mid})
    conduction = type("Own", (forms.Conduction,), {"end_constants": lambda law: None})
    refused(InputError, "Own has a method end_constants that is never called", conduction, 0.4)
