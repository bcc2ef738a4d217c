"""Friction on the broken share of a joint: loops at a point, what breaks under pressure, and a bar that is pulled out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from forms import Cohesive, CohesiveFriction
from forms.base import InputError
from studies import pull_out
from tests.at_points import respond
from tests.refused import refused
from thinlayer import drive

PARAMETERS = {"K_N": 1e4, "K_T": 6e3, "t_N": 20.0, "t_T": 30.0, "G_I": 0.3, "G_II": 0.9, "eta": 2.0}
JOINT = CohesiveFriction(**PARAMETERS, friction=0.5)
PRESSED = -1e-3  # with the pressure 10, and the friction 5
LOOP = (0.0, 0.1, -0.1, 0.0)


@dataclass(frozen=True)
class BornAtRest(CohesiveFriction):
    """A wrong balance: breaking costs the toughness, as without pressure."""

    def dissipated(self, step):
        slip, d = self._new_slip(step) - step.q["slip"], (self._old_damage(step) + self._new_damage(step)) / 2
        return Cohesive.dissipated(self, step) + d * self._largest_friction(step.w, step.n) * (slip**2) ** 0.5


def legs(corners, n):
    return [a + (b - a) * k / n for a, b in pairwise(corners) for k in range(1, n + 1)]


def pressed(law, corners, n=1, **more):
    """Pressed, then slid along straight legs."""
    return drive(law, [{"w_T": w, "w_N": PRESSED} for w in (0.0, *legs(corners, n))], **more)


def work(history):
    t, w = (np.vstack([[0.0, 0.0], a]) for a in (history.tractions, history.jumps))
    return float(((t[1:] + t[:-1]) / 2 * np.diff(w, axis=0)).sum())


def test_a_loop_of_friction():
    """An independent program's energies; errors fall with the square of the steps, and nothing costs less than zero."""
    results = {}
    for n in (100, 200, 1600):
        history = pressed(JOINT, LOOP, n)
        d, slip, _, _ = history.memory.T
        friction = 5.0 * float(np.abs(np.diff(slip)) @ (d[1:] + d[:-1])) / 2
        stored, spent = history.energies[-1, 0], float(history.energies[:, 1].sum())
        results[n] = np.array([work(history), spent, friction, spent - friction, stored])
        assert history.energies[:, 1].min() >= 0
    expected = np.array([2.82056315, 0.89791667 + 1.91556315, 1.91556315, 0.89791667, 0.00708333])
    extrapolated = results[200] + (results[200] - results[100]) / 3
    assert results[1600] == pytest.approx(expected, abs=2e-5)
    assert extrapolated[1:] == pytest.approx(expected[1:], abs=1e-5)
    assert 3.5 < (results[100] - expected)[1] / (results[200] - expected)[1] < 4.5
    assert results[1600][0] - results[1600][1] - results[1600][4] == pytest.approx(0.0, abs=2e-5)
    assert expected[3] == pytest.approx(0.9 - 5.0**2 / (2 * 6e3))


def test_what_breaks_under_pressure_costs_less():
    """Wrong twin: the balance is off by the energy with which the broken share begins."""
    wrong = pressed(BornAtRest(**PARAMETERS, friction=0.5), LOOP, 1600)
    left = work(wrong) - wrong.energies[-1, 0] - wrong.energies[:, 1].sum()
    assert left == pytest.approx(-(5.0**2) / (2 * 6e3), abs=3e-5)


def test_broken_sides_rub_and_part():
    """f p against the slip from any history, nothing when open; the rates of steps and the sense do not count."""
    history = pressed(JOINT, LOOP)
    assert history.tractions[-2:, 0] == pytest.approx([-5.0, 5.0])
    mirrored = pressed(JOINT, np.negative(LOOP), 7, dt=1e3)
    assert mirrored.tractions[:, 0] == pytest.approx(-pressed(JOINT, LOOP, 7, dt=1e-3).tractions[:, 0], abs=1e-12)
    assert mirrored.energies == pytest.approx(pressed(JOINT, LOOP, 7).energies, abs=1e-14)
    parted = drive(replace(JOINT, cracked=1.0), [{"w_T": 0.1, "w_N": w} for w in (PRESSED, 0.01, 2 * PRESSED)])
    assert parted.tractions == pytest.approx(np.array([[5.0, -10.0], [0.0, 0.0], [0.0, -20.0]]))
    assert parted.energies[:, 1] == pytest.approx([5.0 / 2 * (0.1 - 5 / 6e3), 5.0 / 2 * 5 / 6e3, 0.0])
    assert parted.memory[:, 1] == pytest.approx([0.1 - 5 / 6e3, 0.1, 0.1])


def test_without_friction_it_is_cohesive():
    path = [{"w_T": 0.01, "w_N": 0.002}, {"w_T": 0.02, "w_N": PRESSED}, {"w_T": -0.03, "w_N": 0.004}]
    rubbing, smooth = drive(replace(JOINT, friction=0.0), path), drive(Cohesive(**PARAMETERS), path)
    assert rubbing.tractions == pytest.approx(smooth.tractions, abs=1e-10)
    assert rubbing.energies[:, :2] == pytest.approx(smooth.energies[:, :2], abs=1e-12)


def test_breaking_and_sliding_never_cost_less_than_nothing():
    """On any path in 3D with a friction of at most the strength in shear, 30."""
    random = np.random.default_rng(3)
    for _ in range(5):
        w = np.cumsum(random.normal(scale=0.008, size=(40, 3)), axis=0)
        w[:, 2] = random.uniform(-6e-3, 2e-3, size=40)
        path = [dict(zip(("w_T1", "w_T2", "w_N"), row, strict=True)) for row in w]
        history = drive(JOINT, path, n=(0.36, 0.48, 0.8))
        assert history.energies[:, 1].min() >= 0 < history.memory[-1, 0]


PLACES = np.array([[9.0, -0.05], [1.8, -0.1], [1.8, -4.0], [-0.5, -0.1], [1.6, 0.4], [0.3, -0.2]])  # over w_0


@pytest.mark.parametrize("n", [[0.0, 1.0, 0.0], [0.36, 0.48, 0.8]])
def test_the_tangent_is_the_derivative_of_the_stress(n):
    """Sliding and sticking, broken, growing, unloading, open and sound. Stick and slip have different tangents."""
    normal, w_0 = np.array(n), 0.004
    tangent = np.cross(normal, [0.6, 0.0, -0.8])
    w = w_0 * (PLACES[:, :1] * tangent + PLACES[:, 1:] * normal) / np.linalg.norm(tangent)
    tensors = (w[:, :, None] * normal + w[:, None] * normal[:, None]) / 2
    e = np.array([[a[0, 0], a[1, 1], a[2, 2], *(2**0.5 * np.array([a[0, 1], a[0, 2], a[1, 2]]))] for a in tensors])
    q, at = np.zeros((len(e), 4)), np.tile(normal, (len(e), 1))
    q[:, 0], q[:, 1:] = [0.2, 0.0, 0.3, 0.7, 0.4, 0.0], 0.2 * w_0 * np.cross(normal, tangent)
    answer, h = respond(JOINT, e, 0 * e, q, at), 1e-6 * w_0
    sides = [[respond(JOINT, e + s * h * v, 0 * e, q, at).stress for s in (1, -1)] for v in np.eye(6)]
    quotients = np.stack([(a - b) / (2 * h) for a, b in sides], axis=-1)
    assert answer.tangent == pytest.approx(quotients, abs=1e-7 * np.abs(answer.tangent).max())
    slid = np.linalg.norm(answer.q[:, 1:] - q[:, 1:], axis=1) > 1e-9
    assert slid.tolist() == [True, True, False, True, True, True]


PULLED = {0.0: (7.09807771, 0.0395975, 4.735019, 0.4), 0.2: (7.77213634, 0.0419290, 6.504278, 0.595651)}


@pytest.mark.parametrize("friction", PULLED)
def test_a_bar_that_is_pulled_out(friction):
    """Largest force and that at .06, plateau f p l, and energies, of a bar on springs by Runge and Kutta's method."""
    largest, at_largest, later, spent = PULLED[friction]
    table, exact = pull_out.pull(friction).table, pull_out.bar(friction)
    t, force = table["t"], table["force"]
    assert exact["force"].max() == pytest.approx(largest, rel=5e-5)
    assert np.interp(0.06, exact["displacement"], exact["force"]) == pytest.approx(later, rel=1e-5)
    k = int(force.argmax())
    assert (force[k], t[k]) == (pytest.approx(largest, rel=3e-3), pytest.approx(at_largest, abs=1e-3))
    assert np.interp(0.06, t, force) == pytest.approx(later, rel=1e-3)
    assert force[-1] == pytest.approx(8 * friction, abs=1e-9)
    assert ((force[1:] + force[:-1]) / 2) @ np.diff(t) == pytest.approx(spent, rel=5e-3)
    stored = 8 * (8 * friction) ** 2 / 6e3 + 8 * friction**2 / 200  # of the bar, and of the layer that slides
    assert table["dissipated"].sum() == pytest.approx(spent - stored, rel=1e-3 if friction else 1e-9)


def test_parameters_out_of_range():
    refused(InputError, "friction is -0.1; allowed: >= 0", replace, JOINT, friction=-0.1)
    refused(InputError, "toughness is", replace, JOINT, G_I=0.019)
