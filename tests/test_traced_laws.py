"""Laws of one's own are what they compute now: what they read, what they must not decide, what they leave out."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import ClassVar

import basix.ufl
import numpy as np
import pytest
import ufl

from forms import BulkLaw, KernelLaw, LinearElastic, TractionLaw, check
from forms.base import InputError
from geometry import sandwich
from tests.own_laws import Slipping, Swelling, layer_of
from tests.refused import refused
from thinlayer import SolveError, Structure, ThinLayer, drive, march, solve

pytestmark = pytest.mark.few(5)

FACTOR, OF_NUMBA = 1.0, 1.0
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


@dataclass(frozen=True)
class KernelReadsGlobals(KernelLaw):
    k: float
    powers: ClassVar = {"k": 1}

    @staticmethod
    def kernel(e, e_old, q, dt, theta, n, parameters, stress, tangent, q_new, energies):
        for i in range(6):
            stress[i] = 2 * OF_NUMBA * parameters[0] * e[i]
            tangent[i, i] = 2 * OF_NUMBA * parameters[0]
        return True


def shear(law: BulkLaw) -> float:
    return float(drive(law, STEP).tractions[0, 0])


@pytest.mark.few(5)
@pytest.mark.parametrize(
    ("law", "name"),
    [(ReadsGlobals(5.0), "FACTOR"), (JumpsReadGlobals(5.0), "FACTOR"), (KernelReadsGlobals(5.0), "OF_NUMBA")],
    ids=lambda given: type(given).__name__,
)
def test_what_a_law_reads_is_what_it_is_now(law, name, monkeypatch):
    """The third time it is what it was the first time, and nothing new is compiled."""
    for value in (1.0, 3.0, 1.0):
        monkeypatch.setitem(globals(), name, value)
        assert shear(law) == pytest.approx(5.0 * 0.01 * value, rel=1e-14)


def test_attributes_and_closures_too(monkeypatch):
    law = ReadsGlobals(5.0)
    assert shear(law) == pytest.approx(0.05)
    monkeypatch.setattr(ReadsGlobals, "share", 0.5)
    assert shear(law) == pytest.approx(0.025)
    object.__setattr__(law, "extra", 4.0)
    assert shear(law) == pytest.approx(0.1)
    monkeypatch.setattr(ReadsGlobals, "stress", lambda self, step: 7 * self.k * step.mid)
    assert shear(law) == pytest.approx(3.5 * 0.05)


def test_a_march_reads_them_again(monkeypatch):
    moved = []
    for value in (1.0, 10.0):
        monkeypatch.setitem(globals(), "FACTOR", value)
        moved.append(of_blocks(ReadsGlobals(5.0)))
    assert moved[0] > 2 * moved[1]


def of_blocks(law: BulkLaw, **more) -> float:
    """Largest displacement of a pulled joint."""
    joint = sandwich(1.0, 0.5, 0.5, 0.5, cell="quadrilateral", structured=True)
    setup = {"body": LinearElastic(60.0, 40.0), "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.0, 1.0)}}
    model = Structure(joint, element="Q1", **setup | more).interface(layer_of(law, 0.1))
    return float(np.abs(march(model, [1.0]).last.u.x.array).max())


# ---------------------------------------------------------------- decisions
@dataclass(frozen=True)
class Deciding(BulkLaw):
    """Branches by numbers in Python: UFL would compare how expressions are written."""

    k: float
    n: float = 3.0
    powers: ClassVar = {"k": 1}

    def decision(self, step):
        return self.n == 3

    def stress(self, step):
        return 2 * (2 * self.k if self.decision(step) else self.k) * step.mid


@dataclass(frozen=True)
class DecidingJumps(TractionLaw):
    k: float
    n: float = 3.0

    def decision(self, step):
        return self.n == 3

    def traction(self, step):
        return (2 * self.k if self.decision(step) else self.k) * step.mid


DECISIONS = {
    "equal": lambda self, step: self.n == 3,
    "unequal": lambda self, step: self.n != 3,
    "computed": lambda self, step: 2 * self.n + 1 == 7,
    "true": lambda self, step: self.n,
    "not": lambda self, step: not self.n,
    "in": lambda self, step: self.n in (1, 2, 3),
    "greater": lambda self, step: self.n > 2,
    "float": lambda self, step: float(self.n) == 3,
    "int": lambda self, step: int(self.n) == 3,
    "round": lambda self, step: round(self.n) == 3,
    "math": lambda self, step: math.sqrt(self.n) > 1,
}


PARENTS = (Deciding, DecidingJumps, "with memory")


@pytest.mark.few(1)
@pytest.mark.parametrize(("decision", "parent"), zip(DECISIONS, itertools.cycle(PARENTS)))
def test_laws_that_decide_by_a_number(parent, decision):
    names = {"decision": DECISIONS[decision], "__module__": __name__, "__annotations__": {}}
    if parent == "with memory":
        parent, names = Deciding, names | {"internal": {"last": (3, 3)}, "advance": lambda self, step: {"last": step.e}}
    law = dataclass(frozen=True)(type("Mine", (parent,), names))(5.0, 0.0 if decision in ("true", "not") else 3.0)
    refused(InputError, r"^Mine\.(stress|traction): .*ufl\.conditional\(ufl\.", lambda: check(law))


def test_decisions_by_a_parameter_that_varies_are_told():
    """Where it is zero somewhere on S."""
    law = type("Mine", (Deciding,), {"decision": DECISIONS["true"]})(5.0, lambda x: x[0])
    refused(InputError, r"^Mine\.stress: .*ufl\.conditional", lambda: check(law))


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

    refused(
        InputError, r"Placed contains x, a SpatialCoordinate; a compiled law knows", lambda: drive(Placed(1.0), STEP)
    )


# ---------------------------------------------------------------- eigenstrains


class Affine(Swelling):
    """`linear`, in that its tangent is constant."""

    linear = True


def column(kind: str, law: BulkLaw, body: BulkLaw, **more):
    """A column of height 1 that can neither widen nor lengthen."""
    joint = sandwich(1.0, 0.5, 0.5, 0.5, cell="quadrilateral", structured=True)
    sides = {"BOTTOM": 0.0, "TOP": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    return getattr(Structure, kind)(
        Structure(joint, body=body, supports=sides, **more), law if law.traits.of_jumps else ThinLayer(law, 0.1, at=1.0)
    )


@pytest.mark.parametrize("kind", ["interface", "full"])
@pytest.mark.parametrize("how", [solve, lambda model: march(model, [0.5, 1.0], theta=0.7).last])
def test_an_affine_law_that_says_linear(kind, how):
    """The layer would open by `free`; t_N = K (w_N - free) presses the bodies, of height 1 in all, together by -w_N."""
    law, body, own = Affine(7.0, 4.0, 0.03), LinearElastic(60.0, 40.0), 0.03
    K = 7.0 + 2 * 4.0
    free = own * (3 * 7.0 + 2 * 4.0) / K
    state = how(column(kind, law, body))
    t = -free / (1 / K + 1 / 140.0)
    assert np.abs(state.u.x.array).max() == pytest.approx(-t * 0.5 / 140.0, rel=1e-9)
    e = t / K + free  # of the layer, times its thickness
    layer = (15.0 * (e - own) ** 2 + 2 * (7.0 + 4.0) * own**2 * 2 - 2 * 2 * 7.0 * own * (e - own)) / 2
    assert state.energies()["bodies"] == pytest.approx(t * t / 140.0 / 2, rel=1e-9)
    assert state.energies()["layer"] == pytest.approx(layer, rel=1e-9)
    if how is not solve:
        assert abs(state.audit.imbalance) < 1e-9


def test_bodies_that_swell_under_contact():
    """Methods that know a matrix alone would drop the swelling."""
    from forms import HolonomicCoulomb

    law = HolonomicCoulomb(15.0, 4.0, friction=0.3)
    joint = sandwich(1.0, 0.5, 0.5, 0.5, cell="quadrilateral", structured=True)
    sides = {"BOTTOM": 0.0, "TOP": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    model = Structure(joint, body=Swelling(60.0, 40.0, 0.01), supports=sides, element="Q1").interface(law)
    state = solve(model)
    free = 0.01 * (3 * 60.0 + 80.0) / 140.0  # strain of a column that may lengthen
    t = -free / (1 / 140.0 + 1 / 15.0)
    assert np.abs(state.u.x.array).max() == pytest.approx(-t / 15.0 / 2, rel=1e-9)
    refused(ValueError, "needs linear bodies without stresses at rest", lambda: solve(model, method="condensed"))


# ---------------------------------------------------------------- declarations
def test_parameters_of_classes_without_postponed_annotations():
    namespace: dict = {}
    exec(
        "from dataclasses import dataclass\nfrom typing import Optional\nfrom forms import BulkLaw\n"
        "@dataclass(frozen=True)\nclass Bare(BulkLaw):\n    k: float\n    m: float | None = None\n"
        "    n: Optional[float] = None\n    i: int = 1\n    C: list = (1.0, 2.0)\n",
        namespace,
    )
    Bare = namespace["Bare"]
    assert Bare(1.0, 2.0, 3.0, 4, [5.0, 6.0]).C == [5.0, 6.0]
    for given in ({"k": [1.0, 2.0]}, {"k": 1.0, "m": [1.0]}, {"k": 1.0, "n": [1.0]}, {"k": 1.0, "i": [1]}):
        refused(InputError, r"^Bare: \w is \[.*\]; allowed: a number$", Bare, **given)


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


@pytest.mark.few(1)
@pytest.mark.parametrize("eps", [np.int64(10), np.int32(10), 10, np.float32(10)])
def test_whole_thicknesses(eps):
    assert ThinLayer(LinearElastic(60.0, 40.0), 1, at=eps).material == LinearElastic(6.0, 4.0)


def test_jump_laws_in_plane_stress():
    """They know no plane: of bodies without a Poisson's ratio both planes are the same."""
    law, body = Slipping(70.0, 30.0, 12.0, 90.0), LinearElastic.young(100.0, 0.0)
    moved = [of_blocks(law, body=body, plane=plane) for plane in ("strain", "stress")]
    assert moved[1] == pytest.approx(moved[0], rel=1e-9)


def test_a_profile_of_a_law_of_jumps():
    with pytest.raises(InputError, match="Slipping is a law on S without a thickness: give it alone"):
        ThinLayer(Slipping(70.0, 30.0, 12.0, 90.0), 0.1, profile=lambda x: 1 + x[0], at=1.0)


def test_a_law_without_energy_has_none_to_tell():
    @dataclass(frozen=True)
    class Plain(BulkLaw):
        k: float

        def stress(self, step):
            return 2 * self.k * step.mid

    layer = ThinLayer(Plain(5.0), 0.1, at=1.0)
    state = solve(column("interface", layer.law, LinearElastic(60.0, 40.0), body_force=(0.0, 1.0)))
    energies = state.energies()
    assert math.isnan(energies["layer"])
    assert energies["bodies"] > 0
    refused(InputError, "Plain declares no energy", lambda: Plain(5.0).energy(None))


@dataclass(frozen=True)
class Rooted(TractionLaw):
    """An infinite slope at rest; NaN where it is pulled."""

    k: float
    shift: float

    def traction(self, step):
        w = ufl.dot(step.mid, step.n)
        return self.k * ufl.sqrt(self.shift - w) * step.n + self.k * step.mid


@pytest.mark.few(1)
@pytest.mark.parametrize(("shift", "what"), [(0.0, r"tangent \(the slope of the stress\)"), (-1.0, "stress")])
def test_a_failing_law_says_what_and_where(shift, what):
    message = rf"failed at \d+ points: the {what} of Rooted is not finite at x = \(0\.\d+, 0"
    refused(SolveError, message, lambda: of_blocks(Rooted(3.0, shift)))


@dataclass(frozen=True)
class AtRest(BulkLaw):
    """Laws that have no number, or no slope, where the strain e is zero."""

    k: float
    way: str
    powers: ClassVar = {"k": 1}

    def parameters(self):
        return {"k": self.k}

    def stress(self, step):
        square = ufl.inner(step.e, step.e)
        ways = {
            "size": lambda: 1 + ufl.sqrt(square),
            "root": lambda: 1 / square**0.25,
            "cubic": lambda: square,
            "smooth": lambda: 1 + ufl.sqrt(square + 1e-12),
        }
        return self.k * step.e * ways[self.way]()


@pytest.mark.few(5)
@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of soft bodies
@pytest.mark.parametrize(
    ("way", "message"),
    [
        ("size", r"the tangent \(the slope of the stress\) of AtRest is not finite at the start .* e is zero: write"),
        ("root", r"the stress of AtRest is not finite at the start of the step; .* e is zero: write ufl.sqrt"),
        ("cubic", "the tangent at the start of the step is singular; .* A stress without a linear part"),
    ],
)
def test_a_law_that_is_not_finite_at_rest_is_told(way, message):
    """In bodies and in a meshed layer; on S the bodies help a tangent that vanishes."""
    joint = sandwich(1.0, 0.5, 0.5, 0.5, cell="quadrilateral", structured=True)
    setup = {"supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.3, 1.0)}, "element": "Q1"}
    elastic, law = LinearElastic(60.0, 40.0), AtRest(20.0, way)
    for build, layer, body in (
        (Structure.full, law, elastic),
        (Structure.interface, elastic, law),
        *([(Structure.interface, law, elastic)] if way != "cubic" else []),
    ):
        with pytest.raises(SolveError, match=message):
            solve(build(Structure(joint, body=body, **setup), ThinLayer(layer, 0.1, at=1.0)))
    solve(Structure(joint, body=elastic, **setup).full(ThinLayer(AtRest(20.0, "smooth"), 0.1, at=1.0)))
