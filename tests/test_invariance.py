"""No result knows left and right, or how a mesh is numbered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forms import LinearElastic
from geometry import sandwich
from tests.meshes import renumbered
from thinlayer import Structure, ThinLayer, compare, solve

STEEL, GLUE = LinearElastic.young(E=210e3, nu=0.3), LinearElastic.young(E=2e3, nu=0.4)


def answers(joint, eps, load):
    """Errors on S, their sizes and the energies of both models."""
    layer = ThinLayer(GLUE, eps)
    structure = Structure(joint, body=STEEL, supports={"RIGHT": 0.0}, tractions={"LEFT/UPPER": tuple(load)})
    full, limit = solve(structure.full(layer)), solve(structure.interface(layer))
    return np.array([*compare(full, limit).values(), *full.energies().values(), *limit.energies().values()])


def test_mirrors_and_numbers():
    """Quadrilaterals, whose layer has no diagonals; solvers' rounding."""
    joint, load = sandwich(40.0, 4.0, 6.0, 4.0, cell="quadrilateral").rotated(0.3), np.array([-60.0, 5.0])
    expected = answers(joint, 0.2, load)
    flip = np.array([-1.0, 1.0])
    assert answers(replace(joint, points=joint.points * flip), 0.2, load * flip) == pytest.approx(expected, rel=1e-9)
    assert answers(joint.swapped(), 0.2, load) == pytest.approx(expected, rel=1e-9)  # tractions are of both sides alike
    assert answers(renumbered(joint), 0.2, load) == pytest.approx(expected, rel=1e-9)
