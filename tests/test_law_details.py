"""Laws at points where small mistakes hide: energies in tension, planes, contrasts, coinciding stresses, angles, drives."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from mpi4py import MPI

from forms import (
    Anisotropic,
    LinearElastic,
    Maxwell,
    MohrCoulomb,
    MohrCoulombMonodirectional,
    Norton,
    Stack,
)
from forms.base import InputError
from forms.traits import RangeWarning
from tests.at_points import E2, respond, tensor, vector
from tests.own_laws import Slipping
from thinlayer import drive
from thinlayer.pointwise.columns import Columns


# ---------------------------------------------------------------- energies
def test_stress_is_the_slope_of_the_stored_energy():
    """Where nothing flows, pressed and pulled alike; differences are exact but for rounding, the energy is quadratic."""
    h, theta = 0.3, 0.7
    law = MohrCoulombMonodirectional(70.0, 40.0, cohesion=5.0, friction_angle=30.0, elastic_fraction=h, unilateral=True)
    random, points = np.random.default_rng(3), 200
    n = random.normal(size=(points, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    e, direction = (0.01 * random.normal(size=(points, 6)) for _ in range(2))
    q = np.zeros((points, 7))
    now = respond(law, e, e, q, n, theta=theta)
    t_N = np.einsum("ki,kij,kj->k", n, tensor(now.stress - h * respond(ELASTIC, e, e, q[:, :0], n).stress), n)
    pulled = np.abs(t_N) < 1e-9
    assert now.failed == 0
    assert not now.dissipated.any()
    assert 50 < pulled.sum() < 150
    up, down = (respond(law, e + sign * 1e-4 * direction, e, q, n).stored for sign in (1, -1))
    slope = (up - down) / 2e-4
    expected = np.sum(now.stress * direction, axis=1)
    close = np.abs(slope - expected) < 1e-9 * np.abs(expected).max()
    assert close.mean() > 0.95  # others change from pulled to pressed
    assert close[pulled].mean() > 0.95


ELASTIC = LinearElastic(70.0, 40.0)


# ---------------------------------------------------------------- Mohr-Coulomb
@pytest.mark.parametrize("pair", [(0, 1), (1, 2)])
@pytest.mark.parametrize("gap", [1e-1, 1e-4, 1e-6])
def test_tangents_next_to_coinciding_stresses(pair, gap):
    """A turn of the principal axes turns the stress: C : (W e - e W) = W s - s W, also just beyond first yield."""
    law = MohrCoulomb(70.0, 40.0, cohesion=0.3, friction_angle=30.0, dilatancy_angle=12.0)
    angle, n = np.radians(30.0), E2[None]
    shape = np.array([1.0, 0.3, -1.0])
    shape[1] = shape[pair[0] if pair == (0, 1) else 2] + (-gap if pair == (0, 1) else gap)
    trial = np.diag(shape)
    strain = (trial - 70.0 / (3 * 70.0 + 80.0) * np.trace(trial) * np.eye(3)) / 80.0
    yields = 0.3 * np.cos(angle) / ((shape[0] - shape[2]) / 2 + (shape[0] + shape[2]) / 2 * np.sin(angle))
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    W = np.zeros((3, 3))
    W[pair], W[pair[::-1]] = 1.0, -1.0
    W = turn @ W @ turn.T
    for beyond in (1 - 0.01 * gap, 1 + 0.01 * gap, 1 + 0.1 * gap):
        e = turn @ strain @ turn.T * yields * beyond
        answer = respond(law, vector(e[None]), np.zeros((1, 6)), np.zeros((1, 7)), n)
        s = tensor(answer.stress)[0]
        turned = vector((W @ e - e @ W)[None])[0]
        stress_rate = answer.tangent[0] @ turned
        assert (answer.dissipated[0] > 0) == (beyond > 1)
        assert stress_rate == pytest.approx(vector((W @ s - s @ W)[None])[0], abs=1e-6 * 80.0 * np.abs(turned).max())


# ---------------------------------------------------------------- columns
def test_means_of_columns_are_weighted():
    of, weights = np.array([1, 0, 1, 0, 1]), np.array([1.0, 3.0, 2.0, 1.0, 5.0])
    columns = Columns(MPI.COMM_SELF, of, 2, weights)
    assert columns.column_means(np.array([1.0, 2.0, 3.0, 4.0, 5.0])) == pytest.approx([10 / 4, 32 / 8], rel=1e-15)


# ---------------------------------------------------------------- sublayers of any contrast
@pytest.mark.parametrize("n", [(0.6, 0.8), (0.3, 0.5, -0.7)])
@pytest.mark.parametrize("stiffer", [1e3, 1e9, 1e16])
def test_elastic_sublayers_of_any_contrast(stiffer, n):
    """The compliances add, to rounding; of prescribed tractions to the 1e-12 that `drive` asks for."""
    stack = Stack((0.4, LinearElastic(60.0, 40.0)), (0.6, LinearElastic(70.0 * stiffer, 30.0 * stiffer)))
    K_T = 1 / (0.4 / 40.0 + 0.6 / (30.0 * stiffer))
    K_N = 1 / (0.4 / 140.0 + 0.6 / (130.0 * stiffer))
    tangential = {"T": 1.0} if len(n) == 2 else {"T1": 0.6, "T2": 0.8}
    for law in (stack, Stack(*reversed(stack.sublayers))):
        t = drive(law, [{f"w_{c}": 0.01 * a for c, a in tangential.items()} | {"w_N": 0.02}] * 2, n).tractions[-1]
        assert [np.linalg.norm(t[:-1]), t[-1]] == pytest.approx([0.01 * K_T, 0.02 * K_N], rel=1e-12)
        w = drive(law, [{f"t_{c}": a for c, a in tangential.items()} | {"t_N": 2.0}], n).jumps[-1]
        assert [np.linalg.norm(w[:-1]), w[-1]] == pytest.approx([1 / K_T, 2 / K_N], rel=1e-10)


def test_springs_in_three_dimensions():
    pushed = drive(Anisotropic.springs(K_N=5.0, K_T=2.0), [{"t_T1": 0.6, "t_T2": 0.8, "t_N": 1.0}], (0.3, 0.5, -0.7))
    assert pushed.jumps[-1] == pytest.approx([0.3, 0.4, 0.2], rel=1e-9)


# ---------------------------------------------------------------- prescribed tractions


@pytest.mark.parametrize("p", [1.2, 1.5])
@pytest.mark.parametrize("rest", [0.0, 1e-6, 1e-18, 1e-30])
def test_tractions_are_those_prescribed(p, rest):
    """However steep the law once was; a rest that is much smaller than the rates changes nothing."""
    law = Norton(5e3, 3e3, 10.0, p, rest)
    path = [{"t_N": -2.0, "t_T": 1.0}] * 20
    history = drive(law, path, dt=0.2)
    assert history.tractions == pytest.approx(np.array([[1.0, -2.0]] * 20), rel=1e-9)
    expected = drive(Norton(5e3, 3e3, 10.0, p), path, dt=0.2)
    assert history.jumps == pytest.approx(expected.jumps, rel=1e-9 if rest != 1e-6 else 0.1)


@pytest.mark.parametrize("law", [Norton(5e3, 3e3, 10.0, 1.5), Maxwell(5e3, 3e3, 1.0), Slipping(70.0, 30.0, 12.0, 90.0)])
def test_laws_that_depend_on_time_need_a_step(law):
    """No length of a step is meant: one of 1 would be another one in another unit."""
    step = {"w_T": 0.01, "w_N": 0.02}
    with pytest.raises(InputError, match=f"dt is missing: {type(law).__name__} depends on the length of the steps"):
        drive(law, [step, step])
    plastic = MohrCoulomb(70.0, 40.0, cohesion=0.3, friction_angle=30.0)
    assert (drive(plastic, [step]).tractions == drive(plastic, [step], dt=7.0).tractions).all()


def test_angles_that_look_like_radians():
    words = r"^MohrCoulomb: friction_angle is 0\.6 degrees.*friction_angle = 34\.38$"
    with pytest.warns(RangeWarning, match=words) as caught:
        MohrCoulomb(70.0, 40.0, cohesion=0.3, friction_angle=0.6)
    assert len(caught) == 1
    with warnings.catch_warnings(action="error"):
        MohrCoulomb(70.0, 40.0, cohesion=0.3, friction_angle=2.0)
