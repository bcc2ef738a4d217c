"""Joints with several seams, a layer on each: columns whose layers act in series, on rigid bases too."""

from __future__ import annotations

import gmsh
import numpy as np
import pytest

from forms import LinearElastic, NonMonotone
from geometry import read
from tests.meshes import boxes, drawing, save, sides
from thinlayer import Structure, Surface, ThinLayer, march, solve

BODY = LinearElastic(30.0, 20.0)
SOFT, STIFF = LinearElastic(3.0, 1.0), LinearElastic(5.0, 2.0)  # per thickness
SHARE = 1 / 5 + 1 / 9  # compliance of both layers against a normal traction without strain along S
STACK = {"ONE": (0, 1), "TWO": (0, 1)}
ROLLERS = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Three blocks of height 1 on one another, (0, 2) x (0, 3)."""
    with drawing() as occ:
        parts = boxes(occ, (0, 0, 2, 1), (0, 1, 2, 1), (0, 2, 2, 1))
        groups = {(2, name): [part] for name, part in zip(("A", "B", "C"), parts, strict=True)}
        lines = {"BOTTOM": (0, 0, 2, 0), "ONE": (0, 1, 2, 0), "TWO": (0, 2, 2, 0), "TOP": (0, 3, 2, 0)}
        lines |= {"LEFT": (0, 0, 0, 3), "RIGHT": (2, 0, 0, 3)}
        groups |= {(1, name): sides(*where) for name, where in lines.items()}
        yield save(tmp_path_factory.mktemp("column") / "a.msh", 2, groups)
    assert not gmsh.isInitialized()


@pytest.mark.parametrize("seams", [["TWO", "ONE"], {"ONE": ("B", "A"), "TWO": (0.2, -1)}])
def test_layers_in_series(path, seams):
    """Each seam has its own layer; which side is the upper one makes no difference."""
    structure = Structure(read(path, S=seams), body=BODY, supports={"BOTTOM": {"y": 0.0}, "TOP": {"y": 0.1}, **ROLLERS})
    state = solve(structure.interface({"ONE": ThinLayer(SOFT, 0.01, at=1.0), "TWO": ThinLayer(STIFF, 0.02, at=1.0)}))
    t = 0.1 / (3 / 70 + SHARE)
    for name, stiffness in (("ONE", 5), ("TWO", 9)):
        surface = Surface(state.model, name)
        w = surface.jump(state)
        assert surface.norm(w - t / stiffness * surface.n) < 1e-9 * surface.norm(w)
        x, traction = surface.profile(surface.traction(state))
        assert x[:, 1] == pytest.approx({"ONE": 1.0, "TWO": 2.0}[name])
        assert np.abs(traction) == pytest.approx(np.tile([0.0, t], (len(x), 1)), abs=1e-9 * t)
    assert state.energies()["layer"] == pytest.approx(2 * t**2 * SHARE / 2, rel=1e-9)


def test_phases_of_one_layer_of_two(path):
    """The report is of the seam whose layer has phases."""
    structure = Structure(read(path, S=STACK), body=BODY, supports={"BOTTOM": 0.0, "TOP": {"y": 0.5}, **ROLLERS})
    phases = NonMonotone(3.0, 1.0, 0.5, 0.07, [[0.2, 0.5], [0.5, 1.0]])
    layers = {"ONE": ThinLayer(STIFF, 0.02, at=1.0), "TWO": ThinLayer(phases, 0.01, at=1.0)}
    history = march(structure.interface(layers), [1.0])
    surface = Surface(history.model)
    phase, has = surface.phase(history.last)[:, 0], surface.seams == "TWO"
    assert surface.x[1].mean(axis=1)[has] == pytest.approx(2.0)
    assert phase[has] == pytest.approx(history.table["plus"][-1], rel=1e-6)
    assert 0 < phase[has][0] <= 1
    assert np.isnan(phase[~has]).all()
    assert [row["plus"] for row in surface.table(history.last).rows] == [None, history.table["plus"][-1]]
