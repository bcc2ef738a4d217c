"""Parameters of non-monotone laws that depend on temperature: tables, fields, thickness, functions that are refused."""

from __future__ import annotations

import numpy as np
import pytest

from forms import NonMonotone, NonMonotoneUnrelaxed, Tabulated
from forms.base import InputError
from forms.kinematics import PLANE_STRAIN
from tests.at_points import E2, jump_strain, material, traction
from tests.closed_forms import NonMonotoneLimit
from tests.non_monotone_points import ALPHA, CHI2, EPS, LMBDA, MU, TABLE, C
from tests.refused import refused
from thinlayer import ThinLayer, drive
from thinlayer.discretisation.layer import law_with_numbers


def test_a_table_is_linear_in_between():
    assert TABLE(5.0) == pytest.approx(1.5)
    assert TABLE(np.array([0.0, 10.0, 25.0, 40.0])) == pytest.approx([2.0, 1.0, 2.5, 4.0])
    assert TABLE([[0, 40]]).shape == (1, 2)
    assert Tabulated(iter([(1, 2), (3, 4)])).values == ((1.0, 2.0), (3.0, 4.0))


def test_a_bad_table():
    for values in [
        [(1.0, 2.0)], [(2.0, 1.0), (1.0, 1.0)], [(1.0, np.nan), (2.0, 1.0)], [1.0, 2.0], None, [("cold", 1.0), ("hot", 2.0)]
    ]:  # fmt: skip
        refused(InputError, r"Tabulated needs .*pairs \(T, value\)", Tabulated, values)


@pytest.mark.parametrize(("T", "named"), [(-0.1, "-0.1"), (np.array([20.0, 41.0]), "41"), (np.nan, "nan")])
def test_temperatures_outside_the_table(T, named):
    refused(InputError, f"T is {named}; the table knows 0 to 40", lambda: TABLE(T))


def test_the_layer_switches_only_above_a_temperature():
    """alpha chi:E = C(T) at T = 20; alpha depends on T too."""
    jump, reached = [{"w_T": 0.0, "w_N": 0.03}], ALPHA * 0.9 * 0.03
    falling = Tabulated([(0.0, 2 * reached), (40.0, 1e-9)])
    for T, phase in ((0.0, 0), (19.9, 0), (20.1, 1)):
        law = NonMonotoneUnrelaxed(LMBDA, MU, ALPHA, falling, CHI2, T=T)
        number = NonMonotoneUnrelaxed(LMBDA, MU, ALPHA, float(falling(T)), CHI2)
        assert drive(law, jump).memory[0, 0] == phase
        assert drive(law, jump).tractions == pytest.approx(drive(number, jump).tractions, rel=1e-14)
    grown = NonMonotoneUnrelaxed(LMBDA, MU, Tabulated([(0.0, 1.0), (40.0, 2.0)]), reached, CHI2, T=20.0)
    assert grown.parameters()["alpha"] == pytest.approx(1.5)
    assert drive(grown, jump).memory[0, 0] == 1


def test_a_field_of_temperatures():
    """Each point has its parameters; and eps is that of the layer, whose real C is C/eps."""
    law = NonMonotone(LMBDA, MU, ALPHA, lambda T: 0.01 + 0.001 * T, CHI2, T=lambda x, t: 10 * x[0] + t)
    assert law.traits.varies
    x = np.array([[0.0, 1.0, 2.0], [0.0, 0.0, 0.0]])
    values = law.at(x, 3.0)
    assert values["T"] == pytest.approx([3.0, 13.0, 23.0])
    assert values["transformation_energy"] == pytest.approx([0.013, 0.023, 0.033])
    assert values["alpha"] == pytest.approx(3 * [ALPHA])
    real = law_with_numbers(ThinLayer(law, EPS, at=1.0), PLANE_STRAIN)
    assert real.at(x, 3.0)["transformation_energy"] == pytest.approx(values["transformation_energy"] / EPS)
    assert real.scaled(1 / EPS).at(x, 3.0)["transformation_energy"] == pytest.approx(values["transformation_energy"])
    w = np.array([[0.0, 0.02, 0.0]] * 3)
    n = np.tile(E2, (3, 1))
    points = material(real)
    points.set_parameters_at(x, 3.0)
    e = jump_strain(w, n) / EPS
    stress, _, q, _, failed = points.update(range(6), e, 0 * e, np.zeros((3, 2)), n, 1.0, 1.0)
    assert failed == 0
    for k, C_k in enumerate((0.013, 0.023, 0.033)):
        t, phase = NonMonotoneLimit(LMBDA, MU, ALPHA, C_k, CHI2, np.eye(2)[1]).relaxed(w[k, :2])
        assert traction(stress, n)[k, :2] == pytest.approx(t, rel=1e-11, abs=1e-13)
        assert q[k, 0] == pytest.approx(phase, abs=1e-11)
    assert len(set(q[:, 0])) == 3
    words = "a function of the place, or of time; a point needs numbers"
    refused(InputError, words, drive, law, [{"w_T": 0.0, "w_N": 0.1}])


X = np.array([[0.0, 1.0], [0.0, 0.5]])


def test_functions_that_are_none():
    for alpha, energy, T, message in [
        (lambda T: 1 / 0, C, None, r"alpha\(T\) fails .*ZeroDivisionError"),
        (lambda T: 1 + 1j * T, C, None, r"alpha\(T\) fails .*it gives complex128 values"),
        (ALPHA, C, lambda x, t: x[0] > 0, r"T fails .*it gives bool values"),
        (ALPHA, lambda T: np.nan * T, None, r"transformation_energy\(T\) is nan at T = 5"),
        (ALPHA, lambda T: 5 - T, None, r"transformation_energy at x = \(1, 0.5\), t = 0.5 is -5; allowed: > 0"),
        (lambda T: 0.3 * T, C, None, r"transformation_energy at x = .* is 0.02; allowed: >= mixing alpha\^2 G/2 = "),
        (TABLE, C, lambda x, t: 50 * x[0], r"alpha\(T\): T is 50; the table knows 0 to 40"),
        (ALPHA, C, lambda x, t: np.zeros(3), r"T fails for an array of shape \(2, 2\)"),
        (ALPHA, C, lambda x, t: np.where(x[0] > 0, np.inf, 1.0), r"T is inf at x = \(1, 0.5\), t = 0.5"),
    ]:
        law = NonMonotone(LMBDA, MU, alpha, energy, CHI2, T=T or (lambda x, t: 5 + 5 * x[0]))
        refused(InputError, f"^NonMonotone: {message}", law.at, X, 0.5)
