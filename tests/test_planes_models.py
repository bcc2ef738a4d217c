"""Models in plane stress and of bodies of revolution, in time."""

from __future__ import annotations

import numpy as np
import pytest

from forms import (
    Incompressible,
    KelvinVoigt,
    LinearElastic,
    Maxwell,
    MohrCoulomb,
    MohrCoulombMonodirectional,
    NonMonotoneUnrelaxed,
    Norton,
    Stack,
    VonMises,
)
from studies.problems import fourier
from tests.columns_in_time import check_same, column, joint
from tests.orders import taylor_order
from tests.test_plane_stress import Pressed, Stiffening
from thinlayer import SolveError, Structure, Surface, ThinLayer, march, solve
from thinlayer.solving.solve import Solver

pytestmark = pytest.mark.few(5)


L, M, EPS = 6.0, 4.0, 0.05
SHEET = 2 * L * M / (L + 2 * M)  # lmbda of plane stress
EXACT = 1e-9
LAWS = {
    "Kelvin-Voigt": KelvinVoigt(L, M, 0.3, 0.5),
    "Maxwell": Maxwell(L, M, 0.7, 1.5),
    "Norton 1.5": Norton(L, M, 5.0, 1.5),
    "Mohr-Coulomb": MohrCoulomb(L, M, 0.3, 30.0, 0.05),
    "monodirectional": MohrCoulombMonodirectional(L, M, 0.3, 30.0, 0.05),
    "Stack": Stack((0.4, Maxwell(L, M, 0.7)), (0.6, MohrCoulomb(L, M, 0.3, 30.0, 0.05))),
    "incompressible": Incompressible(M),
    "phases": NonMonotoneUnrelaxed(L, M, 0.5, 0.04, np.array([[0.0, 0.0], [0.0, 1.0]])),
}


def sheet(mode="normal", **ends) -> Structure:
    return Structure(joint(), **column(mode, **ends), plane="stress")


# ---------------------------------------------------------------- columns: both models agree
@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("mode", ["normal", "shear"])
def test_both_models_agree_on_a_sheet(name, mode):
    structure, layer = sheet(mode, move=lambda x, t: 0.2 * t), ThinLayer(LAWS[name], EPS, at=1.0)
    times = [0.1, 0.2, 0.4]
    check_same(*(march(model, times) for model in (structure.interface(layer), structure.full(layer))))


def test_traction_of_a_sheet():
    """t_N = (lmbda' + 2 mu) w_N with lmbda' of plane stress, 4 mu w_N if incompressible: E/(1 - nu^2) for both."""
    for law, stiffness in ((LinearElastic(L, M), SHEET + 2 * M), (Incompressible(M), 4 * M)):
        state = solve(sheet(load=0.7).interface(ThinLayer(law, EPS, at=1.0)))
        surface = Surface(state.model)
        assert surface.profile(surface.jump(state))[1][:, 1] == pytest.approx(0.7 / stiffness, rel=EXACT)


def test_tangents_of_models_are_those_of_the_residual():
    mesh, setup = fourier(1 / 2)
    structure = Structure(mesh, **setup | {"body": Stiffening(3.0, 1.7, 3.0)}, plane="stress")
    thinning, stiffening = (ThinLayer(law, EPS, at=1.0) for law in (Norton(L, M, 5.0, 3.0), Stiffening(3.0, 1.7, 9.0)))
    for model in (structure.interface(thinning), structure.full(stiffening)):
        with Solver(model) as solver:
            assert taylor_order(solver) > 1.9


def test_where_no_strain_out_of_the_plane_is_found_the_error_says_so():
    with pytest.raises(SolveError, match=r"Pressed .* or no strain out of the plane makes the stresses there zero"):
        solve(sheet(load=0.7).interface(ThinLayer(Pressed(M), EPS, at=1.0)))


# ---------------------------------------------------------------- bodies
def test_a_bar_of_metal_in_plane_stress():
    """Pulled along: e = s/E + (s - Y)/H, contracting alike in both directions."""
    body, pull = VonMises(60.0, 50.0, strength=1.0, hardening=30.0), 1.4
    E = 2 * 50.0 * (1 + 60.0 / 220.0)
    data = {"supports": {"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}}, "tractions": {"TOP": lambda x, t: (0.0, pull * t)}}
    state = march(Structure(joint(), body=body, plane="stress", **data).bonded(), [0.5, 1.0]).last
    assert np.abs(state.u.x.array).max() == pytest.approx(pull / E + (pull - 1.0) / 30.0, rel=1e-8)
    plastic = state.memory["body LOWER"]
    assert plastic[:, 0] == pytest.approx(plastic[:, 2], rel=1e-8)  # 11 and 33
