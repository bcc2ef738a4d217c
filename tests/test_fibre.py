"""A fibre in its matrix: closed forms of concentric cylinders, the interface law on a circle, its study."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from forms import LinearElastic
from geometry import fibre
from studies.problems import COATING, FIBRE_RADIUS, GLASS, RESIN, RIM_RADIUS, STRETCH, coated_fibre
from tests.cylinders import MODES, Cylinders
from tests.network_cases import springs
from thinlayer import Structure, ThinLayer, compare, solve

BODY = LinearElastic.young(1.0, 0.2)


def stretched(joint, laws, K_N, K_T, stretch) -> float:
    """Energy of the interface model."""
    rim = {"x": lambda x, t: stretch[0] * x[0], "y": lambda x, t: stretch[1] * x[1]}
    structure = Structure(joint, body=dict(zip(("FIBRE", "MATRIX"), laws, strict=True)), supports={"OUTSIDE": rim})
    energies = solve(structure.interface(springs(K_N, K_T))).energies()
    return energies["bodies"] + energies["layer"]


def test_cylinders_of_one_law_are_one():
    """Uniform strain; stiff springs are bonds."""
    a, b = 0.1, -0.04
    exact = pi / 2 * (BODY.lmbda * (a + b) ** 2 + 2 * BODY.mu * (a**2 + b**2)) * 1.5**2
    for between in (None, (1e12, 1e12)):
        cylinders = Cylinders.stretched((BODY, BODY, BODY), (0.4, 0.7, 1.5), [between, None], (a, b))
        assert cylinders.energy == pytest.approx(exact, rel=1e-9)
        r, theta = 1.1, 0.7
        x, y = r * np.cos(theta), r * np.sin(theta)
        turn = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
        assert cylinders.displacement(2, r, theta) == pytest.approx(turn @ [a * x, b * y])


def test_number_of_an_independent_program():
    cylinders = Cylinders.stretched((BODY, BODY), (0.4, 1.0), [(2.0, 0.7)], (0.1, 0.1))
    assert cylinders.energy == pytest.approx(0.03699068, abs=5e-9)
    error = stretched(fibre(0.4, 1.0, 0.08), (BODY, BODY), 2.0, 0.7, (0.1, 0.1)) / cylinders.energy - 1
    assert error == pytest.approx(-5.5e-4, rel=0.1)  # of a circle with 32 sides, another mesh


def test_curved_cells_follow_the_circle():
    """The closed form to five digits."""
    right = Cylinders.stretched((GLASS, BODY), (0.4, 1.0), [(2.0, 0.7)], (0.1, -0.03)).energy
    energy = stretched(fibre(0.4, 1.0, 0.1, cell="quadrilateral", degree=2), (GLASS, BODY), 2.0, 0.7, (0.1, -0.03))
    assert energy == pytest.approx(right, rel=3e-5)
    assert abs(stretched(fibre(0.4, 1.0, 0.1), (GLASS, BODY), 2.0, 0.7, (0.1, -0.03)) / right - 1) > 1e-3


def test_a_coating_and_its_law_differ_as_their_closed_forms_do():
    eps, (joint, setup) = 0.04, coated_fibre(0.1)
    structure, layer = Structure(joint, **setup), ThinLayer(COATING, eps, at=1.0)
    full = solve(structure.full(layer, bodies="extended"))
    radii, laws = (FIBRE_RADIUS - eps / 2, FIBRE_RADIUS + eps / 2, RIM_RADIUS), (GLASS, COATING.scaled(eps), RESIN)
    coated = Cylinders.stretched(laws, radii, [None, None], (STRETCH, 0.0))
    assert full.energies()["bodies"] + full.energies()["layer"] == pytest.approx(coated.energy, rel=5e-5)
    springs = [(COATING.lmbda + 2 * COATING.mu, COATING.mu)]
    jumps = Cylinders.stretched((GLASS, RESIN), (FIBRE_RADIUS, RIM_RADIUS), springs, (STRETCH, 0.0)).jumps(0)
    inner, outer = (
        np.array([coated.amplitudes(m, k, r)[:2] for m in MODES]) for k, r in ((0, radii[0]), (2, radii[1]))
    )
    weights = np.array([[2.0], [1.0]])  # of the squares of both modes in integrals over the circle
    error = np.sqrt((weights * (outer - inner - jumps) ** 2).sum() / (weights * jumps**2).sum())
    assert compare(full, solve(structure.interface(layer)))["error_jump"] == pytest.approx(error, rel=2e-3)
