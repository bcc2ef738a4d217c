"""Laws refuse parameters out of range: one table, by law and parameter; messages say which one, its value and the range."""

from __future__ import annotations

import numpy as np
import pytest

from forms import (
    Anisotropic,
    HolonomicCoulomb,
    Incompressible,
    KelvinVoigt,
    LinearElastic,
    Maxwell,
    MohrCoulomb,
    MohrCoulombMonodirectional,
    NonMonotone,
    NonMonotoneUnrelaxed,
    Norton,
    NortonCreep,
    Rubber,
    Stack,
    Tresca,
    VonMises,
)
from forms.base import InputError
from forms.non_monotone import lamination_gain
from tests.refused import refused

NAN, INF = float("nan"), float("inf")
MODULI = {"lmbda": 3.0, "mu": 2.0}
CHI = np.array([[0.3, -0.5], [-0.5, 0.8]])
PHASES = MODULI | {"alpha": 1.3, "transformation_energy": 0.9, "chi": CHI}
BOUND = 1.3**2 * lamination_gain(3.0, 2.0, CHI) / 2  # of the transformation energy
SOIL = MODULI | {"cohesion": 0.1, "friction_angle": 30.0}
SPRINGS = {"K_N": 5.0, "K_T": 2.0}
GOOD = {
    LinearElastic: MODULI,
    Rubber: MODULI,
    Incompressible: {"mu": 2.0},
    KelvinVoigt: MODULI | {"theta_lmbda": 0.3, "theta_mu": 0.5},
    Maxwell: MODULI | {"t1": 1.0, "t2": 2.0},
    Norton: MODULI | {"eta": 5.0, "p": 1.5},
    NortonCreep: MODULI | {"A": 0.1, "n": 3.0},
    MohrCoulomb: SOIL,
    MohrCoulombMonodirectional: SOIL,
    VonMises: MODULI | {"strength": 0.4},
    NonMonotone: PHASES,
    NonMonotoneUnrelaxed: PHASES,
    HolonomicCoulomb: SPRINGS | {"friction": 0.3},
    Tresca: SPRINGS | {"bound": 0.3},
    Anisotropic: {"C": np.eye(6)},
    LinearElastic.young: {"E": 5.0, "nu": 0.3},
    VonMises.young: {"E": 5.0, "nu": 0.3, "strength": 0.4},
    Anisotropic.springs: {"K_N": 5.0, "K_T": 2.0},
    HolonomicCoulomb.of_layer: MODULI | {"friction": 0.3},
}
POSITIVE, AT_LEAST_0 = (0.0, -1.0, NAN, INF, "1", None, [1.0, 2.0]), (-1e-3, NAN, INF, "1")
BULK = (-1.34, NAN, INF, "1")  # lmbda > -2 mu/3
ANGLE = (-1.0, 90.0, NAN)
HARDENING = {"hardening": AT_LEAST_0, "saturation": (0.1, *AT_LEAST_0)}
SHAPES = (np.ones((2, 3)), np.eye(4), 1.0, np.ones(6), [[1.0, 2.0], [3.0]], [["1", "2"], ["2", "1"]], None)
CHIS = (*SHAPES, [[1.0, 1e-6], [0.0, 1.0]], np.zeros((2, 2)), np.eye(2) * NAN, lambda T: np.eye(2))
ENERGY = (*POSITIVE, 1j, True)
OUT = {
    LinearElastic: {"lmbda": BULK, "mu": POSITIVE},
    Rubber: {"lmbda": POSITIVE, "mu": POSITIVE},
    Incompressible: {"mu": POSITIVE},
    KelvinVoigt: {"lmbda": BULK, "mu": POSITIVE, "theta_mu": POSITIVE, "theta_lmbda": (-1.0, NAN)},
    Maxwell: {"lmbda": BULK, "mu": POSITIVE, "t1": POSITIVE[:-2], "t2": (0.64, -1.0, NAN, INF)},  # >= 3 nu t1/(1 + nu)
    Norton: {"mu": POSITIVE, "eta": POSITIVE, "p": (1.0, 0.5, NAN), "rest": AT_LEAST_0},
    NortonCreep: {"mu": POSITIVE, "A": POSITIVE, "n": (0.9, NAN)},
    MohrCoulomb: {
        "lmbda": BULK, "mu": POSITIVE, "cohesion": AT_LEAST_0, "friction_angle": ANGLE, "dilatancy_angle": (-1.0, 31.0),
        "elastic_fraction": (-0.1, 1.0), **HARDENING,
    },
    MohrCoulombMonodirectional: {"cohesion": AT_LEAST_0, "friction_angle": ANGLE, "unilateral": (1, "no")},
    VonMises: {"mu": POSITIVE, "strength": POSITIVE, "kinematic": AT_LEAST_0, **HARDENING},
    NonMonotone: {
        "lmbda": BULK, "mu": (*POSITIVE, lambda T: T), "alpha": ENERGY, "chi": CHIS, "T": ("warm", NAN),
        "transformation_energy": (*ENERGY, 0.999 * BOUND, lambda T: T), "mixing": (0.0, -0.5, 1.0001, NAN, "all", None),
    },
    NonMonotoneUnrelaxed: {"alpha": (*ENERGY, lambda T: T), "transformation_energy": ENERGY, "chi": CHIS},
    HolonomicCoulomb: {"K_N": POSITIVE, "K_T": POSITIVE, "friction": AT_LEAST_0, "cohesion": AT_LEAST_0},
    Tresca: {"bound": AT_LEAST_0},
    Anisotropic: {"C": (np.eye(3), np.eye(6) + np.diag([0.5], 5), -np.eye(6), NAN * np.eye(6)), "frame": ("local",)},
    LinearElastic.young: {"E": POSITIVE[:-2], "nu": (0.5, -1.0, NAN, "1")},
    VonMises.young: {"E": POSITIVE[:-2]},
    Anisotropic.springs: {"K_N": (0.0, -1.0, NAN)},
    HolonomicCoulomb.of_layer: {"lmbda": ("1",), "mu": (-5.0,)},
}  # fmt: skip


@pytest.mark.parametrize(("law", "name"), [(law, name) for law, names in OUT.items() for name in names])
def test_parameters_out_of_range(law, name):
    """They are named; where a saturation has no strain that strain is."""
    law(**GOOD[law])
    named = "saturation(_strain)?" if name == "saturation" else f"(shape of |smallest eigenvalue of )?{name}"
    for value in OUT[law][name]:
        refused(InputError, rf"\b{named} (is .*allowed: |needs T; give T)", law, **GOOD[law] | {name: value})


SPRING, CREEPING = LinearElastic(**MODULI), Maxwell(**GOOD[Maxwell])


def test_young_s_modulus_is_that_of_another_constructor():
    refused(InputError, r"of E and nu: LinearElastic\.young\(E, nu\)", lambda: LinearElastic(E=3.0, nu=0.2))


def test_sublayers_that_a_stack_cannot_hold():
    for sublayers, message in [
        ([], "number of sublayers"),
        ([(0.5, CREEPING), (0.4, SPRING)], "sum of the fractions is 0.9; allowed: 1"),
        ([(1.5, SPRING), (-0.5, SPRING)], "each > 0"),
        ([CREEPING], r"Stack needs pairs \(fraction, law\)"),
        ([("all", CREEPING)], r"Stack needs pairs \(fraction, law\)"),
        ([(1.0, "glue")], "a sublayer is glue; allowed: laws that give a stress for a strain"),
    ]:
        refused(InputError, message, Stack, *sublayers)
