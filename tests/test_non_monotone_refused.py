"""Non-monotone laws refuse bad parameters and places where they cannot be, and take what is just allowed."""

from __future__ import annotations

import pytest

from forms import NonMonotone, Stack
from forms.base import InputError
from forms.non_monotone import lamination_gain
from geometry import sandwich
from tests.non_monotone_points import ALPHA, CHI2, LMBDA, MU, PURE, RELAXED, STEEP, STIFF, TABLE, C, pulled
from tests.refused import refused
from thinlayer import Structure, ThinLayer, drive

GOOD = {"lmbda": LMBDA, "mu": MU, "alpha": ALPHA, "transformation_energy": C, "chi": CHI2}
BOUND = ALPHA**2 * lamination_gain(LMBDA, MU, CHI2) / 2
BAD = [
    ({"alpha": TABLE}, r"alpha needs T; give T, a number or a function \(x, t\)"),
    ({"alpha": TABLE, "T": 41.0}, r"alpha\(T\): T is 41; the table knows 0 to 40"),
    ({"transformation_energy": lambda T: -T, "T": 2.0}, "transformation_energy is -2; allowed: > 0"),
    ({"transformation_energy": 0.999 * BOUND}, rf"transformation_energy is .* mixing alpha\^2 G/2 = {BOUND:g}: phases"),
    ({"transformation_energy": 0.499 * BOUND, "mixing": 0.5}, "transformation_energy is .*: phases 1 and -1 would mix"),
    ({"transformation_energy": lambda T: 0.999 * BOUND + 0 * T, "T": 20.0}, "transformation_energy is .*: phases 1"),
]


@pytest.mark.parametrize(("change", "message"), BAD)
def test_bad_parameters(change, message):
    refused(InputError, f"^NonMonotone: {message}", lambda: NonMonotone(**{**GOOD, **change}))


def test_parameters_that_are_just_allowed():
    """C = g/2 to rounding; a chi whose symmetry is lost by rounding; whole numbers; an unrelaxed law of any C."""
    at_bound = NonMonotone(**GOOD | {"transformation_energy": BOUND})
    assert drive(at_bound, [{"w_T": 0.0, "w_N": 0.0}]).tractions == pytest.approx(0, abs=1e-14)
    assert NonMonotone(**{**GOOD, "transformation_energy": BOUND / 2, "mixing": 0.5}).mixing == 0.5
    chi = CHI2.copy()
    law = NonMonotone(LMBDA, MU, ALPHA, C, chi)
    chi[:] = 0
    assert (law.chi == CHI2).all()


def test_where_the_laws_have_no_place():
    """Columns that switch are not points in series; softening localises; dimensions."""
    pure, relaxed = PURE["2D"], RELAXED["2D"]
    refused(InputError, "Stack: a sublayer is NonMonotoneUnrelaxed", lambda: Stack((0.5, STIFF), (0.5, pure)))
    refused(InputError, "order=1 of NonMonotoneUnrelaxed", lambda: ThinLayer(pure, 0.1, order=1, at=1.0))
    refused(InputError, r"shape of chi is \(3, 3\); allowed: \(2, 2\) in plane stress", RELAXED["3D"].plane_stress)
    for law, n in ((relaxed, (0, 1, 0)), (RELAXED["3D"], (0, 1)), (Stack((0.5, STIFF), (0.5, relaxed)), (0, 0, 1))):
        d = len(n)
        words = rf"NonMonotone: shape of chi is .*allowed: \({d}, {d}\) in a model of dimension"
        refused(InputError, words, drive, law, pulled("w", [(0.0,) * d]), n)
    plates = sandwich(1.0, 0.5, 0.5, 0.5, cell="quadrilateral", structured=True)
    setup = dict(supports={"BOTTOM": 0.0}, element="Q1")
    for build, law, message in (
        (Structure.interface, RELAXED["3D"], r"chi is \(3, 3\); allowed: \(2, 2\) in a model of"),
        (Structure.full, STEEP, "falls as strains grow.*take mixing=1, or NonMonotoneUnrelaxed"),
    ):
        make = lambda b=build, law=law: b(Structure(plates, body=STIFF, **setup), ThinLayer(law, 0.1, at=1.0))
        refused(InputError, message, make)
