"""Points that have no answer fail and are counted; a step at rest or at once is answered or refused; so are bad kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from forms import KernelLaw, Stack
from forms.base import InputError
from tests.at_points import DT, E2, jump_strain, material, respond
from tests.laws_at_points import ELASTIC, KELVIN, LMBDA, MU, NORTON_15
from tests.own_laws import Fragile
from tests.refused import refused


def test_failed_points_are_counted_and_have_no_stress():
    law = Fragile(LMBDA, MU, 1.0)
    e = np.zeros((5, 6))
    e[:, 0] = [0.1, 0.7, 0.2, 0.9, 0.3]
    answer = respond(law, e, 0 * e, np.zeros((5, 6)), np.tile(E2, (5, 1)))
    assert answer.failed == 2
    assert np.isnan(answer.stress[:, 0]).tolist() == [False, True, False, True, False]
    assert answer.stress[[0, 2, 4]] == pytest.approx(MU * e[[0, 2, 4]])


def test_failed_points_of_a_stack():
    law = Stack((0.5, ELASTIC), (0.5, Fragile(LMBDA, MU, 1.0)))
    e = np.zeros((3, 6))
    e[:, 0] = [0.1, 0.7, 0.2]
    answer = respond(law, e, 0 * e, np.zeros((3, material(law).memory)), np.tile(E2, (3, 1)))
    assert answer.failed == 1
    assert np.isnan(answer.stress[:, 0]).tolist() == [False, True, False]


def test_laws_with_a_rate_have_no_answer_to_a_sudden_load():
    e, n = jump_strain(np.array([[0.1, 0.2, 0.0]]), E2[None]), E2[None]
    for law in (KELVIN, NORTON_15):
        assert respond(law, e, 0 * e, np.zeros((1, 0)), n, dt=0.0).failed == 1


def test_norton_starts_from_rest():
    """p < 2 at a rate of zero: no stress, a finite tangent that is the largest there is."""
    e, n = np.zeros((1, 6)), E2[None]
    rest = respond(NORTON_15, e, e, np.zeros((1, 0)), n)
    assert rest.failed == 0
    assert not rest.stress.any()
    moved = respond(NORTON_15, e + 1e-3, e, np.zeros((1, 0)), n)
    assert rest.tangent[0, 3, 3] > 1e3 * moved.tangent[0, 3, 3]


def spoiled_kernel(body: str, memory: object = 0):
    names: dict = {"np": np}
    arguments = "e, e_old, q, dt, theta, n, parameters, stress, tangent, q_new, energies"
    exec(f"def kernel({arguments}):\n" + body, names)
    return dataclass(frozen=True)(
        type("Spoiled", (KernelLaw,), {"kernel": staticmethod(names["kernel"]), "memory": memory})
    )


@pytest.mark.parametrize(
    ("body", "memory", "message"),
    [
        ("    q_new[3] = 1.0\n    return True\n", 0, "IndexError"),
        ("    stress[0] = nonsense\n    return True\n", 0, "NameError"),
        ("    stress[0] = 1.0\n", 0, "returns None"),
        ("    return True\n", "6", "memory is '6'; allowed: a whole number"),
    ],
)
def test_mistakes_in_kernels_are_found_before_they_are_compiled(body, memory, message):
    refused(InputError, message, lambda: material(spoiled_kernel(body, memory)()))


def test_errors_in_a_compiled_kernel_are_failed_points():
    law = spoiled_kernel(
        "    stress[0] = parameters.sum() + e[0]\n"
        "    if e[0] > 0.5:\n        raise ValueError('beyond')\n"
        "    tangent[0, 0] = 1 / (e[0] - 0.25)\n    return True\n"
    )()
    e = np.zeros((3, 6))
    e[1, 0], e[2, 0] = 0.25, 0.75
    stress, _, _, _, failed = material(law).update(range(6), e, 0 * e, np.zeros((3, 0)), np.tile(E2, (3, 1)), DT, 1.0)
    assert failed == 2
    assert np.isnan(stress[:, 0]).tolist() == [False, True, True]
