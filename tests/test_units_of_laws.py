"""Every law at a point in other units, and under loads of any size: the same numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from forms import (
    Adhesion,
    Anisotropic,
    Breaking,
    CohesiveFriction,
    KelvinVoigt,
    LinearElastic,
    Maxwell,
    Microcracked,
    MohrCoulomb,
    MohrCoulombMonodirectional,
    NonMonotone,
    NonMonotoneUnrelaxed,
    Norton,
    NortonCreep,
    Stack,
    VonMises,
)
from tests.own_laws import Slipping, StandardSolid
from thinlayer import drive

EQUAL = 1e-9  # of the largest jump and traction: rounding, and tractions that `drive` finds to 1e-12
CHI = np.array([[0.2, 0.5], [0.5, 1.0]])
TRICLINIC = np.diag([90.0, 120.0, 80.0, 30.0, 25.0, 40.0]) + 5 * (np.ones((6, 6)) - np.eye(6))


class Units(NamedTuple):
    """What a millimetre, a megapascal and an hour are in the units, and the size of loads and strains."""

    L: float = 1.0
    P: float = 1.0
    T: float = 1.0
    size: float = 1.0


OTHERS = {  # factors of primes, so that no power of one is that of another
    "finer, small loads": Units(L=1.7e3, P=1.3e6, T=1.1e4, size=1.9e-9),
    "coarser, large loads": Units(L=2.3e-6, P=2.9e-3, T=3.1e-5, size=3.7e8),
}


def moduli(u: Units, factor: float = 1.0) -> dict[str, float]:
    """lmbda and mu of a layer, stress over length."""
    return {"lmbda": 70.0 * factor * u.P / u.L, "mu": 40.0 * factor * u.P / u.L}


def norton(u: Units, p: float, **more: float) -> Norton:
    return Norton(**moduli(u), eta=3.0 * u.P * (u.T / u.L) ** (p - 1) * u.size ** (2 - p), p=p, **more)


def non_monotone(u: Units, law: type, **more: float) -> NonMonotone | NonMonotoneUnrelaxed:
    """Energy per area of S, C, of the size of that of the jumps."""
    stress = u.P * u.size
    return law(**moduli(u), alpha=1.2 * stress, transformation_energy=0.05 * stress * u.L * u.size, chi=CHI, **more)


def mohr_coulomb(u: Units, law: type = MohrCoulomb, **more: float) -> MohrCoulomb:
    return law(**moduli(u), cohesion=0.3 * u.P * u.size, friction_angle=30.0, elastic_fraction=0.02, **more)


def hardening(u: Units) -> dict[str, float]:
    return {"hardening": 4.0 * u.P / u.L, "saturation": 0.2 * u.P * u.size, "saturation_strain": 0.01 * u.L * u.size}


def breaking(u: Units, **more: str) -> Breaking:
    strength = u.P * u.size
    energy = strength * u.L * u.size
    return Breaking(**moduli(u), t_N=0.8 * strength, t_T=0.6 * strength, G_I=0.05 * energy, G_II=0.1 * energy, **more)


def springs(u: Units) -> dict[str, float]:
    return {"K_N": 150.0 * u.P / u.L, "K_T": 40.0 * u.P / u.L}


def rubbing(u: Units) -> CohesiveFriction:
    strength = u.P * u.size
    toughness = {"G_I": 0.05 * strength * u.L * u.size, "G_II": 0.1 * strength * u.L * u.size}
    return CohesiveFriction(**springs(u), t_N=0.8 * strength, t_T=0.6 * strength, **toughness, friction=0.4)


LAWS = {
    "elastic": lambda u: LinearElastic(**moduli(u)),
    "anisotropic, of the layer": lambda u: Anisotropic(TRICLINIC * u.P / u.L, "layer"),
    "Kelvin-Voigt": lambda u: KelvinVoigt(**moduli(u), theta_lmbda=0.3 * u.T, theta_mu=0.7 * u.T),
    "Maxwell": lambda u: Maxwell(**moduli(u), t1=0.6 * u.T, t2=1.1 * u.T),
    "Norton's creep": lambda u: NortonCreep(**moduli(u), A=3.0 * u.L * u.size / u.T / (u.P * u.size) ** 3.5, n=3.5),
    "Norton 1.5": lambda u: norton(u, 1.5),
    "Norton 3": lambda u: norton(u, 3.0),
    "Norton 1.2, rest": lambda u: norton(u, 1.2, rest=1e-4 * u.L / u.T * u.size),
    "breaking": lambda u: breaking(u),
    "breaking, bilinear": lambda u: breaking(u, softening="bilinear", criterion="power"),
    "breaking, friction": rubbing,
    "adhesion": lambda u: Adhesion(**springs(u), W=0.01 * (e := u.P * u.L * u.size**2), b=0.01 * e * u.T, heals=True),
    "microcracked": lambda u: Microcracked(
        **moduli(u), Y_0=0.01 * (e := u.P * u.L * u.size**2), viscosity=0.1 * e * u.T, rho_0=0.2
    ),
    "Mohr-Coulomb, dilatant": lambda u: mohr_coulomb(u, dilatancy_angle=12.0),
    "Mohr-Coulomb, hardening": lambda u: mohr_coulomb(u, **hardening(u)),
    "von Mises": lambda u: VonMises(
        **moduli(u), strength=0.4 * u.P * u.size, kinematic=5.0 * u.P / u.L, **hardening(u)
    ),
    "unilateral": lambda u: mohr_coulomb(u, MohrCoulombMonodirectional, unilateral=True),
    "non-monotone": lambda u: non_monotone(u, NonMonotone),
    "non-monotone, pure": lambda u: non_monotone(u, NonMonotoneUnrelaxed),
    "stack, elastic": lambda u: Stack((0.3, LinearElastic(**moduli(u))), (0.7, LinearElastic(**moduli(u, 1e9)))),
    "stack, elastic and torn": lambda u: Stack(
        (0.4, LinearElastic(**moduli(u, 3.0))), (0.6, mohr_coulomb(u, MohrCoulombMonodirectional, unilateral=True))
    ),
    "stack, in time": lambda u: Stack(
        (0.2, KelvinVoigt(**moduli(u), theta_lmbda=0.3 * u.T, theta_mu=0.7 * u.T)),
        (0.5, Maxwell(**moduli(u), t1=0.6 * u.T)),
        (0.3, norton(u, 1.5)),
    ),
    "user": lambda u: StandardSolid(**moduli(u), mu_1=25.0 * u.P / u.L, t_1=0.4 * u.T),
    "user, jumps": lambda u: Slipping(
        70.0 * u.P / u.L, 30.0 * u.P / u.L, 12.0 * u.P * u.T / u.L, 90.0 * u.P / u.L**2 / u.size
    ),
}


def followed(name: str, u: Units) -> tuple[np.ndarray, np.ndarray]:
    """Jumps and tractions in mm and MPa along a path that prescribes both, opens, slips, and turns; n is inclined."""
    jumps = [(0.004, -0.006), (0.02, -0.01), (0.03, 0.02), (-0.03, -0.01)]
    path: list[dict[str, float]] = [{"w_T": a * u.L * u.size, "w_N": b * u.L * u.size} for a, b in jumps]
    path.append({"w_T": 0.01 * u.L * u.size, "t_N": -0.6 * u.P * u.size})
    path.append({"t_T": 0.2 * u.P * u.size, "t_N": -0.5 * u.P * u.size})
    history = drive(LAWS[name](u), path, n=(0.6, 0.8), dt=0.1 * u.T)
    return history.jumps / (u.L * u.size), history.tractions / (u.P * u.size)


@pytest.mark.parametrize("name", LAWS)
def test_units_and_loads_of_any_size(name):
    expected = followed(name, Units())
    for units, u in OTHERS.items():
        for actual, right in zip(followed(name, u), expected, strict=True):
            assert actual == pytest.approx(right, abs=EQUAL * np.abs(right).max()), units


JUMPS = np.array([(0.004, -0.006), (0.02, -0.01), (0.03, 0.02), (-0.03, -0.01)])


@pytest.mark.parametrize("name", [name for name, make in LAWS.items() if not make(Units()).traits.of_jumps])
def test_thickness_does_not_change_the_interface_law(name):
    """Real parameters at strains w/eps give the traction and, per volume, 1/eps of the energies of those per thickness."""
    law = LAWS[name](Units())
    thin = drive(law, [{"w_T": a, "w_N": b} for a, b in JUMPS], dt=0.1)
    for eps in (0.5, 0.02):
        real = drive(law.scaled(eps), [{"w_T": a / eps, "w_N": b / eps} for a, b in JUMPS], dt=0.1)
        assert real.tractions == pytest.approx(thin.tractions, abs=1e-10 * np.abs(thin.tractions).max())
        assert eps * real.energies == pytest.approx(thin.energies, abs=1e-10 * np.nanmax(np.abs(thin.energies)))


@pytest.mark.parametrize("p", [1.5, 3.0])
def test_rest_of_the_size_of_the_rates(p):
    """A layer's rest is a rate of the jump, length over time: the interface law is the same at two thicknesses."""
    law, v, w = Norton(7.0, 4.0, eta=5.0, p=p, rest=0.02), np.array([0.03, -0.01]), np.array([0.003, -0.001])
    expected = np.array([4.0, 15.0]) * w + 5.0 * (v[1] ** 2 + v[0] ** 2 / 2 + 0.02**2) ** (p / 2 - 1) * v * [0.5, 1.0]
    assert drive(law, [{"w_T": w[0], "w_N": w[1]}], dt=0.1).tractions[0] == pytest.approx(expected, rel=1e-12)
