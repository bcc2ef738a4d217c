"""Contact laws at single nodes: values by hand, tangents, continuity, memory, errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from forms import HolonomicCoulomb, IncrementalCoulomb, Tresca
from forms.base import InputError
from forms.contact import ContactLaw, Status
from tests.refused import refused

K_N, K_T, F, C = 37.0, 11.0, 0.7, 0.4
LAWS = [
    HolonomicCoulomb(K_N, K_T, F),
    HolonomicCoulomb(K_N, K_T, F, C),
    IncrementalCoulomb(K_N, K_T, F, C),
    Tresca(K_N, K_T, 0.9),
]


def one(*w: float) -> np.ndarray:
    return np.array([w])


def test_separated_nodes_carry_nothing():
    for law in (LAWS[0], IncrementalCoulomb(K_N, K_T, F)):
        for w in (one(0.3, 1e-12), one(-0.2, 0.5, 0.1)):
            assert not law.traction(w).any()
            assert law.status(w) == Status.SEPARATED


def test_stick_and_sliding_by_hand():
    law = HolonomicCoulomb(K_N, K_T, F)
    assert law.traction(one(0.01, -0.02)) == pytest.approx(one(0.11, -0.74))
    assert law.status(one(0.01, -0.02)) == Status.STICK
    assert law.traction(one(-0.3, -0.02)) == pytest.approx(one(-F * 0.74, -0.74))
    assert law.status(one(-0.3, -0.02)) == Status.SLIDING
    w = one(0.3, -0.4, -0.02)
    assert law.traction(w) == pytest.approx(one(F * 0.74 * 0.6, -F * 0.74 * 0.8, -0.74))


def test_cohesion_adds():
    law = HolonomicCoulomb(K_N, K_T, F, C)
    assert law.traction(one(5.0, -0.02))[0, 0] == pytest.approx(F * 0.74 + C)
    assert law.traction(one(5.0, 0.3))[0] == pytest.approx([C, 0.0])
    assert law.status(one(5.0, 0.3)) == Status.SEPARATED


def test_traction_is_continuous_where_it_separates():
    for law in LAWS[:3]:
        gap = 1e-12
        near = law.traction(one(5.0, -gap)) - law.traction(one(5.0, gap))
        assert np.abs(near).max() <= 2 * K_N * gap


def test_tresca_holds_without_pressure():
    law = Tresca(K_N, K_T, 0.9)
    assert law.traction(one(5.0, 0.1)) == pytest.approx(one(0.9, 0.0))
    assert law.traction(one(0.01, 0.1)) == pytest.approx(one(0.11, 0.0))


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
@pytest.mark.parametrize("d", [2, 3])
def test_tangent_is_the_derivative(law, d):
    """Second order remainder in a Taylor test, away from the kinks."""
    rng = np.random.default_rng(3)
    w, v = rng.normal(size=(400, d)) * 0.05, rng.normal(size=(400, d))
    slip = rng.normal(size=(400, d - 1)) * 0.02
    predicted = np.einsum("nij,nj->ni", law.tangent(w, slip), v)
    same = law.status(w, slip) == law.status(w + 1e-4 * v, slip)
    same &= law.threshold_rate(law.pressure(w)) == law.threshold_rate(law.pressure(w + 1e-4 * v))
    errors = []
    for h in (1e-4, 1e-5):
        remainder = law.traction(w + h * v, slip) - law.traction(w, slip) - h * predicted
        errors.append(np.abs(remainder[same]).max())
    assert same.sum() > 300
    assert errors[1] <= max(0.02 * errors[0], 1e-14)


def test_coulomb_tangent_is_not_symmetric_but_tresca_is():
    sliding = one(0.3, -0.02)
    assert LAWS[0].tangent(sliding)[0, 0, 1] == pytest.approx(-F * K_N)
    assert LAWS[0].tangent(sliding)[0, 1, 0] == 0
    tangent = Tresca(K_N, K_T, 0.01).tangent(one(0.3, 0.2, -0.02))[0]
    assert tangent == pytest.approx(tangent.T)
    assert (LAWS[0].traits.symmetric, Tresca(1.0, 1.0, 1.0).traits.symmetric) == (False, True)


def test_slip_memory():
    """Slide forth, turn: the return starts elastic, with twice the threshold to go."""
    law = IncrementalCoulomb(K_N, K_T, F)
    pressure, bound = 0.74, F * 0.74
    slip = law.slip_after(one(0.3, -0.02), np.zeros((1, 1)))
    assert slip[0, 0] == pytest.approx(0.3 - bound / K_T)
    back = one(0.3 - bound / K_T, -0.02)
    assert law.traction(back, slip)[0, 0] == pytest.approx(0.0, abs=1e-12)
    far = law.traction(one(-0.3, -0.02), slip)
    assert far == pytest.approx(one(-bound, -pressure))
    holonomic = HolonomicCoulomb(K_N, K_T, F)
    assert holonomic.traction(back)[0, 0] == pytest.approx(bound)
    assert holonomic.slip_after(one(0.3, -0.02), np.zeros((1, 1))) == pytest.approx(0.0)


def test_slip_follows_an_open_node():
    law = IncrementalCoulomb(K_N, K_T, F)
    slip = law.slip_after(one(0.4, 0.1), np.zeros((1, 1)))
    assert slip[0, 0] == pytest.approx(0.4)
    assert not law.traction(one(0.4, -0.02), slip)[0, 0]


@given(
    st.lists(st.floats(-1, 1), min_size=3, max_size=3),
    st.lists(st.floats(-1, 1), min_size=2, max_size=2),
    st.floats(0, 3),
    st.floats(0, 2),
)
def test_threshold_and_dissipation(w, slip, friction, cohesion):
    law = IncrementalCoulomb(K_N, K_T, friction, cohesion)
    jump, old = np.array([w]), np.array([slip])
    t = law.traction(jump, old)
    p = -t[0, -1]
    assert p >= 0
    assert np.linalg.norm(t[0, :-1]) <= (friction * p + cohesion) * (1 + 1e-12) + 1e-15
    stored, dissipated = law.energies(jump, old)
    assert stored >= 0
    assert dissipated >= -1e-14
    again = law.traction(jump, law.slip_after(jump, old))
    assert again == pytest.approx(t, abs=1e-12)


@pytest.mark.parametrize("w", [(0.02, -0.3), (-0.01, 0.02, -0.4), (0.5, 0.2)])
def test_tractions_are_the_slope_of_what_is_stored(w):
    """Where nothing slides, and where S is open."""
    law, w = IncrementalCoulomb(K_N, K_T, F), np.array([w])
    slip, h = np.zeros((1, w.shape[1] - 1)), 1e-5
    if w[0, -1] > 0:
        slip = law.slip_after(w, slip)  # no traction is left
    for k, t in enumerate(law.traction(w, slip)[0]):
        d = h * np.eye(w.shape[1])[k]
        slope = (law.energies(w + d, slip)[0] - law.energies(w - d, slip)[0]) / (2 * h)
        assert slope[0] == pytest.approx(t, rel=1e-7, abs=1e-9)


def test_stiffness_of_a_layer():
    law = HolonomicCoulomb.of_layer(15.0, 5.0, friction=0.3)
    assert (law.K_N, law.K_T, law.friction, law.cohesion) == (25.0, 5.0, 0.3, 0.0)
    assert IncrementalCoulomb.of_layer(lmbda=0.0, mu=5.0, friction=0.3, cohesion=2.0).K_N == 10.0
    assert Tresca.of_layer(15.0, 5.0, bound=2.0).bound == 2.0


@dataclass(frozen=True)
class Own(ContactLaw):
    number: int

    @property
    def kind(self):
        return ("right", "changes", "negative", "nan", "short", "number", "integers")[self.number]

    def threshold(self, p):
        if self.kind == "changes":
            p *= 0.3
            return p
        values = {
            "negative": -0.3 * p,
            "nan": np.nan * p,
            "short": p[1:],
            "number": 0.3,
            "integers": np.ones(len(p), int),
        }
        return values.get(self.kind, 0.3 * p)

    def threshold_rate(self, p):
        return 0.3 * np.ones_like(p)


@dataclass(frozen=True)
class Other(HolonomicCoulomb):
    def threshold(self, p):
        return 0.1 * p**2


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (Own(K_N, K_T, 1), "changes p"),
        (Own(K_N, K_T, 2), "finite, >= 0"),
        (Own(K_N, K_T, 3), "finite, >= 0"),
        (Own(K_N, K_T, 4), "array of 11 floats"),
        (Own(K_N, K_T, 5), "array of 11 floats"),
        (Own(K_N, K_T, 6), "array of 11 floats"),
        (ContactLaw(K_N, K_T), "has no threshold"),
        (Other(K_N, K_T, F), "numbers = None"),
    ],
    ids=lambda x: getattr(x, "kind", None),
)
def test_laws_of_ones_own_are_checked(law, words):
    refused(InputError, words, law.check_threshold)
    Own(K_N, K_T, 0).check_threshold()
