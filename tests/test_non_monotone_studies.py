"""The studies of non-monotone layers, and what they measure with."""

from __future__ import annotations

import numpy as np
import pytest

from forms import LinearElastic
from geometry import block
from studies.fig4_bar import meet, straight
from studies.measured import MeanJump, SupportForce
from studies.snap_structures import distance
from thinlayer import Structure, Surface, ThinLayer, solve


@pytest.mark.parametrize("kind", [Structure.full, Structure.interface])
def test_force_of_a_support_is_conjugate_to_its_displacement(kind):
    """Clapeyron: half of force times displacement is the energy; the jump of a column follows from its stiffness."""
    joint = block(1.4, 0.8, 0.4, cell="quadrilateral", structured=True)
    body, layer = LinearElastic(3.0, 2.0), ThinLayer(LinearElastic(0.4, 0.7), 0.1, at=1.0)
    shape = lambda x: 1.2 - 0.3 * x[0]
    sides = {"LEFT": {"x": 0}, "RIGHT": {"x": 0}}
    model = kind(Structure(joint, supports=sides | {"TOP": {"y": lambda x, t: 0.05 * shape(x)}}, body=body), layer)
    state = solve(model)
    energies = state.energies()
    force = SupportForce(model, "TOP", "y", shape)(state)
    assert force * 0.05 / 2 == pytest.approx(energies["bodies"] + energies["layer"], rel=1e-9)
    assert abs(SupportForce(model, "TOP", "y")(state) - force) > 0.01 * force

    model = kind(Structure(joint, supports=sides | {"TOP": {"x": 0, "y": 0.05}}, body=body), layer)
    compliances = np.array([0.8 / 7.0, 1 / 1.8])
    stress = 0.05 / compliances.sum()
    surface = Surface(Structure(joint, supports=sides, body=body).interface(layer))
    state = solve(model)
    assert MeanJump(surface)(state) == pytest.approx(stress / 1.8, rel=1e-9)
    assert MeanJump(surface, 0)(state) == pytest.approx(0, abs=1e-12)
    assert SupportForce(model, "TOP", "y")(state) == pytest.approx(1.4 * stress, rel=1e-9)


def test_distance_from_a_polygon():
    """Over the size of each component: 4 and 2 here."""
    polygon = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 2.0]])
    points = np.array([[2.0, 0.0], [2.0, 0.5], [4.4, 1.0], [-0.4, 0.0], [4.0, 2.4]])
    assert distance(points, polygon) == pytest.approx([0, 0.25, 0.1, 0.1, 0.2], abs=1e-14)


def test_straight_lines_meet():
    x = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    y = np.array([1.0, 3.0, 7.0, 6.0, 5.0])  # 1 + 2 x, then 9 - x
    assert meet(straight(x, y, x < 2), straight(x, y, x > 1)) == pytest.approx(8 / 3, rel=1e-12)
