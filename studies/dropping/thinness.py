"""The thickness from which on a layer may be dropped: told without meshing it, and found by meshing it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from scipy.optimize import brentq

from forms import LinearElastic, Rubber
from studies.dropping.case import Case
from studies.dropping.known import STEEL
from studies.dropping.measuring import Dropped
from studies.dropping.structures import displaced, free
from thinlayer import RangeWarning, Structure, ThinLayer, goals, thin_enough
from thinlayer.running.record import Record

FINEST = 1 / 64  # for which the mesh is fine enough
ACROSS = 2.0  # by which the thickness found by meshing may differ from what is told
SAME = 2e-3  # of thicknesses found by meshing


@dataclass(frozen=True)
class Question:
    """How thin must a layer be to be dropped?

    Attributes:
        name: of the question.
        structure: makes the structure; its mesh does for all thicknesses.
        law: with real moduli, which stay.
        tolerance: of the relative change.
        goal: "traction", "jump" or a goal.
    """

    name: str
    structure: Callable[[], Structure]
    law: LinearElastic | Rubber
    tolerance: float
    goal: Any

    def told(self) -> float:
        """The thickness without meshing the layer."""
        with warnings.catch_warnings(action="ignore", category=RangeWarning):
            layer = ThinLayer(self.law, FINEST)
            return float(thin_enough(self.structure(), layer, self.tolerance, goal=self.goal).eps)

    def by_meshing(self, near: float, record: Record | None = None) -> float:
        """The thickness at which the true change is the tolerance; `near` is close to it."""
        asked = () if isinstance(self.goal, str) else (self.goal,)

        def excess(log: float) -> float:
            case = Case(self.name, lambda _: self.structure(), self._layer, asked=asked)
            one = Dropped.of(case, math.exp(log), record)
            truth = one.truth
            size = truth[self.goal] if isinstance(self.goal, str) else truth[self.goal.name]
            if not isinstance(self.goal, str):
                size = abs(size / self.goal.value(one.full, one.found.better.model))
            return math.log(size / self.tolerance)

        return math.exp(brentq(excess, math.log(near / ACROSS), math.log(near * ACROSS), xtol=SAME))

    def _layer(self, eps: float) -> ThinLayer:
        return ThinLayer(self.law, eps)


def questions() -> list[Question]:
    """The questions."""
    polymer = LinearElastic.young(E=3.0, nu=0.35)
    return [
        Question("traction, free ends", lambda: free(FINEST), polymer, 0.02, "traction"),
        Question("jump, free ends", lambda: free(FINEST), polymer, 0.08, "jump"),
        Question("compliance, free ends", lambda: free(FINEST, load=(1.0, 0.0)), polymer, 0.03, goals.Compliance()),
        Question(
            "reaction, rubber bearing",
            lambda: displaced(FINEST, body=STEEL),
            Rubber.shear(1.0, 0.49),
            0.1,
            goals.Reaction("TOP", (0.0, 1.0)),
        ),
    ]
