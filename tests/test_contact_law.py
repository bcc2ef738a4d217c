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
COULOMB = [HolonomicCoulomb(K_N, K_T, F), HolonomicCoulomb(K_N, K_T, F, C), IncrementalCoulomb(K_N, K_T, F, C)]
LAWS = [*COULOMB, Tresca(K_N, K_T, 0.9)]


def row(*w: float) -> np.ndarray:
    return np.array([w])


BY_HAND = [  # law, jump, traction, status
    (LAWS[0], (0.3, 1e-12), (0, 0), Status.SEPARATED),
    (IncrementalCoulomb(K_N, K_T, F), (-0.2, 0.5, 0.1), (0, 0, 0), Status.SEPARATED),
    (LAWS[0], (0.01, -0.02), (0.11, -0.74), Status.STICK),
    (LAWS[0], (-0.3, -0.02), (-F * 0.74, -0.74), Status.SLIDING),
    (LAWS[0], (0.3, -0.4, -0.02), (F * 0.74 * 0.6, -F * 0.74 * 0.8, -0.74), Status.SLIDING),
    (LAWS[1], (5.0, -0.02), (F * 0.74 + C, -0.74), Status.SLIDING),
    (LAWS[1], (5.0, 0.3), (C, 0), Status.SEPARATED),
    (LAWS[3], (5.0, 0.1), (0.9, 0), Status.SEPARATED),
    (LAWS[3], (0.01, 0.1), (0.11, 0), Status.SEPARATED),
]


@pytest.mark.few(1)
@pytest.mark.parametrize(("law", "w", "t", "status"), BY_HAND)
def test_tractions_by_hand(law, w, t, status):
    assert law.traction(row(*w)) == pytest.approx(row(*t))
    assert law.status(row(*w)) == status


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("d", [2, 3])
def test_tangent_is_the_derivative(law, d):
    """Second order remainder in a Taylor test, away from the kinks; of the eased law, too, which pulls where it opens."""
    rng = np.random.default_rng(3)
    w, v = rng.normal(size=(400, d)) * 0.05, rng.normal(size=(400, d))
    slip = rng.normal(size=(400, d - 1)) * 0.02
    same = law.status(w, slip) == law.status(w + 1e-4 * v, slip)
    same &= law.threshold_rate(law.pressure(w)) == law.threshold_rate(law.pressure(w + 1e-4 * v))
    assert same.sum() > 300
    for variant in (law, law.homotopy(0.3)):
        predicted = np.einsum("nij,nj->ni", variant.tangent(w, slip), v)
        steps = [(h, variant.traction(w + h * v, slip) - variant.traction(w, slip)) for h in (1e-4, 1e-5)]
        errors = [np.abs((change - h * predicted)[same]).max() for h, change in steps]
        assert errors[1] <= max(0.02 * errors[0], 1e-14)
    elastic_jump = w - np.column_stack([slip, np.zeros(400)])
    bonded = np.einsum("nij,nj->ni", law.bonded(400, d), elastic_jump)
    assert law.homotopy(1.0).traction(w, slip) == pytest.approx(bonded, rel=1e-12)
    assert law.homotopy(0.3).traction(w, slip) == pytest.approx(0.7 * law.traction(w, slip) + 0.3 * bonded, rel=1e-12)


def test_slip_memory():
    """Slide forth, turn: the return starts elastic, with twice the threshold to go."""
    law = IncrementalCoulomb(K_N, K_T, F)
    pressure, bound = 0.74, F * 0.74
    slip = law.slip_after(row(0.3, -0.02), np.zeros((1, 1)))
    assert slip[0, 0] == pytest.approx(0.3 - bound / K_T)
    back = row(0.3 - bound / K_T, -0.02)
    assert law.traction(back, slip)[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert law.traction(row(-0.3, -0.02), slip) == pytest.approx(row(-bound, -pressure))
    holonomic = HolonomicCoulomb(K_N, K_T, F)
    assert holonomic.traction(back)[0, 0] == pytest.approx(bound)
    assert holonomic.slip_after(row(0.3, -0.02), np.zeros((1, 1))) == pytest.approx(0.0)
    assert law.slip_after(row(0.4, 0.1), np.zeros((1, 1)))[0, 0] == pytest.approx(0.4)


def lists(n):
    return st.lists(st.floats(-1, 1), min_size=n, max_size=n)


@given(lists(3), lists(2), st.floats(0, 3), st.floats(0, 2))
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
    assert law.traction(jump, law.slip_after(jump, old)) == pytest.approx(t, abs=1e-12)


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


def law_with_threshold(bound):
    """A law of one's own with a threshold."""
    methods = {"threshold": lambda self, p: bound(p), "threshold_rate": lambda self, p: 0.3 * np.ones_like(p)}
    return type("Own", (ContactLaw,), methods)(K_N, K_T)


@dataclass(frozen=True)
class Other(HolonomicCoulomb):
    def threshold(self, p):
        return 0.1 * p**2


WRONG = [
    (ContactLaw(K_N, K_T), "has no threshold"),
    (Other(K_N, K_T, F), "numbers = None"),
    (law_with_threshold(lambda p: p.__imul__(0.3)), "changes p"),
    (law_with_threshold(lambda p: -0.3 * p), "finite, >= 0"),
    (law_with_threshold(lambda p: np.nan * p), "finite, >= 0"),
    (law_with_threshold(lambda p: p[1:]), "array of 11 floats"),
    (law_with_threshold(lambda p: 0.3), "array of 11 floats"),
    (law_with_threshold(lambda p: np.ones(len(p), int)), "array of 11 floats"),
]


def test_laws_of_ones_own_are_checked():
    for law, words in WRONG:
        refused(InputError, words, law.check_threshold)
    law_with_threshold(lambda p: 0.3 * p).check_threshold()
