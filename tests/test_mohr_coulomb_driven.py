"""A point driven by jumps and tractions follows closed formulas of friction to the law's limit; bad paths are refused."""

from __future__ import annotations

import numpy as np
import pytest

from forms import Incompressible, MohrCoulomb, Norton, formulas
from forms.base import InputError
from tests import closed_forms
from tests.mohr_coulomb_points import LAW, LAWS, LMBDA, MONO, MU, OMEGA, C
from tests.refused import refused
from thinlayer.errors import SolveError
from thinlayer.pointwise.drive import drive


def closing_and_shearing(law, steps, end=0.03, w_N=-0.01):
    path = [{"w_T": 0.0, "w_N": w_N}, *({"w_T": w, "w_N": w_N} for w in np.linspace(0, end, steps + 1)[1:])]
    return drive(law, path)


def test_opening_held():
    """Order 1 to the closed form, whose number is known; slip on planes parallel to S alone gives another one."""
    expected = np.array([0.573611999372, -1.12276731876])
    exact = formulas.mohr_coulomb_fixed_opening(LMBDA, MU, C, OMEGA, -0.01, np.array(0.03))
    assert exact == pytest.approx(expected, rel=1e-11)
    ends = [closing_and_shearing(LAW, steps).tractions[-1] for steps in (100, 200, 400)]
    errors = [np.abs(t - exact) for t in ends]
    assert np.log2(errors[1] / errors[2]) == pytest.approx([1, 1], abs=0.01)
    assert 2 * ends[2] - ends[1] == pytest.approx(exact, abs=5e-6)
    for law in (MONO, MohrCoulomb(LMBDA, MU, C, OMEGA, dilatancy_angle=10.0), MohrCoulomb(LMBDA, MU, C, 29.9)):
        assert np.abs(closing_and_shearing(law, 400).tractions[-1] - exact).max() > 5e-4


def test_friction_of_the_layer():
    """First yield, lasting friction for several psi, and tan(Omega) while the pressure is taken away."""
    law = MohrCoulomb(LMBDA, MU, 0.0, OMEGA)
    first = formulas.first_yield_ratio(0.3, OMEGA)
    assert first == pytest.approx(0.3 / 1.4, rel=1e-12)
    for share, flows in ((1 - 1e-9, False), (1 + 1e-9, True)):
        history = drive(law, [{"w_T": 0.0, "w_N": -0.01}, {"w_T": share * first * 1.4 / MU, "w_N": -0.01}])
        assert history.memory[-1].any() == flows
    assert formulas.first_yield_ratio(0.2, OMEGA) == 0.0
    for psi, value in ((0.0, 0.5), (10.0, 0.539221272), (20.0, 0.566769624), (30.0, 0.577350269)):
        assert formulas.apparent_friction(OMEGA, psi) == pytest.approx(value, rel=2e-9)
        dilatant = MohrCoulomb(LMBDA, MU, 0.0, OMEGA, dilatancy_angle=psi)
        traction = drive(dilatant, [{"w_T": w, "t_N": -1.4} for w in np.linspace(0, 2.0, 60)]).tractions[-1]
        assert traction == pytest.approx([1.4 * value, -1.4], rel=1e-7)
    pressed = [{"w_T": w, "w_N": -0.01} for w in np.linspace(0, 0.3, 50)]
    t = drive(law, [*pressed, *({"w_T": 0.3, "w_N": w} for w in np.linspace(-0.01, -0.002, 400))]).tractions
    assert t[49, 0] / -t[49, 1] == pytest.approx(0.5, rel=1e-8)
    assert (t[:, 0] / -t[:, 1]).max() == pytest.approx(np.tan(np.radians(OMEGA)), rel=2e-5)


def test_drive_under_a_constant_normal_stress():
    """The tractions asked for are there, the closed formula gives them at the jumps found, and energies balance."""
    history = drive(LAW, [{"w_T": 0.0, "t_N": -1.0}, *({"t_T": t, "t_N": -1.0} for t in (0.2, 0.4, 0.55, -0.5, 0.3))])
    assert history.tractions[:, 0] == pytest.approx([0.0, 0.2, 0.4, 0.55, -0.5, 0.3], abs=1e-11)
    assert history.tractions[:, 1] == pytest.approx(-np.ones(6), abs=1e-11)
    assert (history.parts == 1).all()
    w_old = s = np.zeros(2)
    for w, t in zip(history.jumps, history.tractions, strict=True):
        expected, s = closed_forms.mohr_coulomb(LMBDA, MU, C, OMEGA, w, w_old, s)
        assert t == pytest.approx(expected, rel=1e-11)
        w_old = w
    work = np.sum(history.tractions * np.diff(history.jumps, axis=0, prepend=0), axis=1)
    stored, dissipated, remainder = history.energies.T
    assert work == pytest.approx(np.diff(stored, prepend=0) + dissipated + remainder, rel=1e-10)
    assert history.stress[:, 1, 1] == pytest.approx(history.tractions[:, 1], rel=1e-12)
    assert history.stress[:, 2, 2] == pytest.approx(LMBDA * history.jumps[:, 1], rel=1e-10)
    assert history.table["w_T"] == pytest.approx(history.jumps[:, 0])


def test_traction_beyond_the_limit():
    """The steps before are kept, up to them all is as without the step too many."""
    path = [{"w_T": 0.0, "t_N": -1.0}, *({"t_T": t, "t_N": -1.0} for t in (0.3, 0.58, 0.59))]
    assert 0.58 < C * np.cos(np.radians(OMEGA)) + np.sin(np.radians(OMEGA)) < 0.59
    caught = refused(SolveError, r"step 4 of 4 \(t_T = 0.59, t_N = -1\): no jump has", drive, LAW, path)
    kept = caught.history
    assert len(kept) == 3
    assert kept.jumps == pytest.approx(drive(LAW, path[:3]).jumps)
    with pytest.raises(SolveError, match="Beyond the law's limit") as caught:
        drive(MONO, [{"t_T": 0.0, "t_N": -1.0}, {"t_T": C + np.tan(np.radians(OMEGA)) + 1e-3, "t_N": -1.0}])
    assert len(caught.value.history) == 1
    refused(SolveError, "step 1 of 1", drive, LAWS["unilateral"], [{"w_T": 0.0, "t_N": 0.01}])


def test_what_drive_refuses():
    for change, message in [
        ({"steps": []}, "at least one step"),
        ({"steps": [(0.0, 1.0)]}, r"step 1 is \(0.0, 1.0\); it must be a dictionary with w_T or t_T, w_N or t_N"),
        ({"steps": [{"w_T": 0.0, "w_N": 0.0, "t_N": 1.0}]}, "step 1 has both of w_N"),
        ({"steps": [{"w_T": 0.0, "w_n": 0.0}]}, "step 1 has 'w_n'; allowed in 2D: w_T or t_T, w_N or t_N"),
        ({"steps": [{"w_T": 0.0, "w_N": float("nan")}]}, "step 1: w_N is nan; it must be a finite number"),
        ({"n": (0, 1, 0)}, "allowed in 3D: w_T1 or t_T1, w_T2 or t_T2, w_N or t_N"),
        ({"n": (0, 0)}, r"the normal n is \(0, 0\)"),
        ({"dt": -1.0}, "dt is -1.0"),
        ({"theta": 0.4}, "theta is 0.4; allowed: 0.5 to 1"),
        ({"law": Incompressible(1.0)}, r"law is Incompressible\(mu=1.0\)"),
        ({"law": Norton(LMBDA, MU, 5.0, 1.5), "dt": 0}, "dt is 0 in step 1; Norton lets no jump change at once"),
    ]:
        refused(InputError, message, drive, **{"law": LAW, "steps": [{"w_T": 0.0, "w_N": 0.0}]} | change)
