"""Rubbery layers: the interface law with a pressure, against transfer matrices, its own closed form and meshed layers."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ufl
from scipy.linalg import expm

from forms import Incompressible, LinearElastic, Rubber
from geometry import sandwich
from studies.problems import fourier
from tests.ranges_told import with_warnings
from thinlayer import Structure, Surface, ThinLayer, compare, march, solve

K = np.pi  # wave number of the Fourier problem: bodies of height .5, E = 100, nu = .3, top traction (.5 sin, cos)
NUS = [0.3, 0.45, 0.49, 0.499, 0.5]


def of(mu: float, nu: float) -> tuple[float, float]:
    """Lame moduli; nu = 1/2 is an infinite one."""
    return (2 * nu / (1 - 2 * nu) * mu if nu < 0.5 else math.inf), mu


def law_of(lmbda: float, mu: float, eps: float) -> Rubber | Incompressible:
    return (Rubber(lmbda, mu) if math.isfinite(lmbda) else Incompressible(mu)).scaled(1 / eps)


def transfer(lmbda: float, mu: float) -> np.ndarray:
    """d/dy of (U, V, S, T) of a Fourier mode in an isotropic layer."""
    if math.isinf(lmbda):
        ratio, soft, stiff = 1.0, 0.0, 4 * K**2 * mu
    else:
        ratio, soft = lmbda / (lmbda + 2 * mu), 1 / (lmbda + 2 * mu)
        stiff = 4 * K**2 * mu * (lmbda + mu) * soft
    return np.array([[0, K, 1 / mu, 0], [-ratio * K, 0, 0, soft], [stiff, 0, 0, ratio * K], [0, 0, -K, 0]])


def law_on_s(lmbda: float, mu: float, eps: float) -> np.ndarray:
    """Stiffness (4, 4) of the law for (jumps U, V, means U, V), its pressure eliminated."""
    compliance = (0.0 if math.isinf(lmbda) else eps / lmbda) + eps**3 * K**2 / (12 * mu)
    sheet = 2 * mu if math.isinf(lmbda) else 2 * lmbda * mu / (lmbda + 2 * mu)
    rows = [
        ([0, 1, eps * K, 0], 1 / compliance),
        ([0, 0, K, 0], 2 * mu * eps),
        ([0, 1 / eps, 0, 0], 2 * mu * eps),
        ([1 / eps, 0, 0, -K], mu * eps),
        ([K, 0, 0, 0], eps / 12 * (sheet + 2 * mu)),
    ]
    return sum(weight * np.outer(row, row) for row, weight in rows)


def jumps(layer: np.ndarray) -> np.ndarray:
    """Amplitudes of the jump of the Fourier problem, for the transfer matrix of the layer."""
    body = expm(transfer(*of(100 / 2.6, 0.3)) * 0.5)
    whole = body @ layer @ body
    below = body @ np.append([0.0, 0.0], np.linalg.solve(whole[2:, 2:], [0.5, 1.0]))
    return (layer @ below - below)[:2]


def of_law(lmbda: float, mu: float, eps: float) -> np.ndarray:
    to_sides = np.block([[-np.eye(2), np.eye(2)], [np.eye(2) / 2, np.eye(2) / 2]])
    k = to_sides.T @ law_on_s(lmbda, mu, eps) @ to_sides
    moved, forced = -np.linalg.solve(k[:2, 2:], k[:2, :2]), -np.linalg.inv(k[:2, 2:])
    return jumps(np.block([[moved, forced], [k[2:, :2] + k[2:, 2:] @ moved, k[2:, 2:] @ forced]]))


def jump_amplitudes(model) -> np.ndarray:
    """Amplitudes of the jump."""
    state = solve(model)
    assert abs(state.audit.imbalance) < 1e-10
    energies = state.energies()
    assert energies["bodies"] + energies["layer"] == pytest.approx(energies["loads"] / 2, rel=1e-10)
    return amplitudes(Surface(model), state)


def amplitudes(surface, state) -> np.ndarray:
    x = K * surface.x[0]
    return surface.integral(2 * surface.jump(state) * (np.sin(x), np.cos(x)))


@pytest.mark.parametrize(("cell", "allowed"), [("quadrilateral", 3e-4), ("triangle", 4e-4)])
def test_closed_form_of_the_law(cell, allowed):
    """The discretised law is the law: errors of the mesh alone, at all Poisson's ratios."""
    joint, setup = fourier(1 / 16, cell=cell)
    for nu in NUS:
        eps = 1 / 8
        lmbda, mu = of(40 * eps, nu)
        model = Structure(joint, **setup).interface(ThinLayer(law_of(lmbda, mu, eps), eps, order=1, at=1.0))
        wanted = of_law(lmbda, mu, eps)
        assert np.linalg.norm(jump_amplitudes(model) - wanted) < allowed * np.linalg.norm(wanted), nu


def test_error_of_the_law_is_of_order_two_for_all_ratios():
    """Bounded by eps^2 uniformly, where the error of linear displacements through the layer is not."""
    for nu in (*np.linspace(0.02, 0.48, 20), 0.49, 0.499, 0.49999, 0.5):
        ratios = []
        for eps in (1 / 8, 1 / 16, 1 / 32, 1 / 64, 1 / 128):
            lmbda, mu = of(40 * eps, nu)
            exact = jumps(expm(transfer(lmbda, mu) * eps))
            ratios.append(np.linalg.norm(of_law(lmbda, mu, eps) - exact) / np.linalg.norm(exact) / eps**2)
        assert max(ratios) < 0.82 * 1.05, nu


def test_errors_against_the_meshed_layer():
    """Those of transfer matrices."""
    joint, setup = fourier(1 / 32, cell="quadrilateral")
    eps, structure = 1 / 8, Structure(joint, **setup)
    for nu in (0.3, 0.499):
        lmbda, mu = of(40 * eps, nu)
        law = Rubber(lmbda, mu).scaled(1 / eps)
        full = solve(structure.full(ThinLayer(law, eps, at=1.0), cells_through=4))
        exact, limit = jumps(expm(transfer(lmbda, mu) * eps)), of_law(lmbda, mu, eps)
        state = solve(structure.interface(ThinLayer(law, eps, order=1, at=1.0)))
        wanted = np.linalg.norm(limit - exact) / np.linalg.norm(limit)
        assert compare(full, state)["error_jump"] == pytest.approx(wanted, rel=0.03), nu


def test_meshed_layer_does_not_lock():
    """Two rows of cells with a pressure at nu = .4999; as many elastic ones are ten times further off."""
    joint, setup = fourier(1 / 16)
    eps = 1 / 16
    lmbda, mu = of(40 * eps, 0.4999)
    wanted = jumps(expm(transfer(lmbda, mu) * eps))
    structure = Structure(joint, **setup)
    surface = Surface(structure.interface(ThinLayer(LinearElastic(1.0, 1.0), eps, at=1.0)))
    errors = []
    for law in (Rubber, LinearElastic):
        state = solve(structure.full(ThinLayer(law(lmbda, mu), eps), cells_through=2))
        errors.append(np.linalg.norm(amplitudes(surface, state) - wanted) / np.linalg.norm(wanted))
    assert errors[0] < 2e-4
    assert errors[1] > 5 * errors[0]


def test_free_ends():
    """The pressure is zero at free ends that cells resolve, and at those alone."""
    joint = sandwich(1.0, 0.5, 0.5, 1 / 8, h_S=1 / 16, h_ends=1 / 40)
    stiff = LinearElastic.young(1e5, 0.3)
    layer = ThinLayer(Rubber.young(2.98, 0.49), 1 / 16, order=1)  # mu = 1
    for sides, zero in (
        ({}, (True, True)),
        ({"LEFT": {"x": 0.0}}, (False, True)),
        ({"LEFT/LAYER": 0.0}, (False, True)),
    ):
        structure = Structure(joint, body=stiff, supports={"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": -0.01}, **sides})
        state, said = with_warnings(lambda structure=structure: solve(structure.interface(layer)))
        assert ["holds the side of the layer alone" in message for message in said] == [True] * ("LEFT/LAYER" in sides)
        x = state.p.function_space.tabulate_dof_coordinates()[:, 0]
        ends = np.abs(state.p.x.array[[np.argmin(x), np.argmax(x)]]) < 1e-12 * np.abs(state.p.x.array).max()
        assert tuple(ends) == zero


def test_march():
    """Steps in time find the states of single solves, and their energy balance closes."""
    joint, setup = fourier(1 / 8)
    setup["tractions"] = {"TOP": lambda x, t: (0.5 * t * ufl.sin(K * x[0]), t * ufl.cos(K * x[0]))}
    model = Structure(joint, **setup).interface(ThinLayer(Rubber(90.0, 3.0), 0.1, order=1, at=1.0))
    history = march(model, [0.25, 1.0], theta=0.5)
    at_once = solve(model, t=1.0)
    for state in history:
        assert abs(state.audit.imbalance) < 1e-10
    assert history.last.energies() == pytest.approx(at_once.energies(), rel=1e-9)
