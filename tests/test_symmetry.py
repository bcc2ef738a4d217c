"""A tangent or a stress that is not symmetric is told, unless the law says that it is not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import pytest
import ufl

from forms import BulkLaw, LawError, LinearElastic, Stack
from forms.kinematics import lift
from geometry import sandwich
from tests.laws_at_points import ELASTIC
from thinlayer import Structure, ThinLayer, solve


@dataclass(frozen=True)
class Sheared(BulkLaw):
    """Pressure that grows with shear, shear that does not grow with closing: no symmetry, whatever the class says."""

    k: float
    g: float
    powers: ClassVar = {"k": 1, "g": 1}
    linear: ClassVar = True

    def stress(self, step):
        n = lift(step.n)
        return 2 * self.k * step.mid + self.g * step.mid[0, 1] * ufl.outer(n, n)


@dataclass(frozen=True)
class Triangle(BulkLaw):
    k: float
    powers: ClassVar = {"k": 1}

    def stress(self, step):
        return 2 * self.k * step.mid + ufl.as_tensor([[0, step.mid[0, 0], 0], [0, 0, 0], [0, 0, 0]])


MEMORY = {"internal": {"last": (3, 3)}, "advance": lambda self, step: {"last": step.e}}
ShearedWithMemory = type("ShearedWithMemory", (Sheared,), MEMORY)
TriangleWithMemory = type("TriangleWithMemory", (Triangle,), MEMORY)
SaysSo = type("SaysSo", (ShearedWithMemory,), {"symmetric": False})


def of_blocks(law, kind="S", **choices):
    build = Structure.interface if kind == "S" else Structure.full
    joint = sandwich(1.0, 0.5, 0.5, 0.25, cell="quadrilateral", structured=True)
    supports = {"BOTTOM": 0.0, "TOP": {"x": 0.02, "y": -0.01}}
    return build(
        Structure(joint, body=LinearElastic(60.0, 40.0), supports=supports, element="Q1", **choices),
        ThinLayer(law, 0.1, at=1.0),
    )


@pytest.mark.parametrize("kind", ["S", "band"])
@pytest.mark.parametrize(
    "law", [Sheared(3.0, 2.0), ShearedWithMemory(3.0, 2.0), Stack((0.4, Sheared(3.0, 2.0)), (0.6, ELASTIC))]
)
def test_a_tangent_that_is_not_symmetric_is_told(law, kind):
    """Cholesky's factor would be of another matrix: half of it is lost."""
    with pytest.raises(
        LawError, match=rf"^(Stack|{type(law).__name__}|Sheared): the tangent is not symmetric.* symmetric = False"
    ):
        solve(of_blocks(law, kind))


@pytest.mark.parametrize("g", [0.0, 2.0])
def test_one_that_says_so_is_solved(g):
    state = solve(of_blocks(SaysSo(3.0, g)))
    assert state.report.residual < 1e-8
    if g == 0:
        assert solve(of_blocks(ShearedWithMemory(3.0, 0.0))).u.x.array == pytest.approx(state.u.x.array, rel=1e-10)


@pytest.mark.parametrize("law", [Triangle(3.0), TriangleWithMemory(3.0)])
def test_a_stress_that_is_not_symmetric_is_told(law):
    with pytest.raises(LawError, match=rf"^{type(law).__name__}\.stress is not symmetric"):
        solve(of_blocks(law))
