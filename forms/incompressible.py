"""Incompressible layers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from forms.elastic import LinearElastic, LinearLaw, lame
from forms.ends.constants import free_end
from forms.ends.weights import EndWeights, Strips, of_pressure_at_ends
from forms.inside import Inside, Pressed
from forms.kinematics import Expr
from forms.law import Step, positive
from forms.stations import Station, of_pressure


@dataclass(frozen=True)
class Incompressible(LinearLaw):
    """Incompressible elasticity, stress = 2 mu e + p I with tr e = 0; the pressure p is an unknown field.

    As a layer's law: [u_N] = 0, t_N = p free, t_T = mu [u_T]. The paper gives only the constraint, Eqs. (25)-(29). It is
    not a penalty: tr e = 0 holds weakly, tested with every pressure of degree 1, in the meshed layer and on S. The law of
    order 1 is that of `Rubber` for lmbda to infinity: a slope of p squeezes the layer along S.

    Attributes:
        mu: shear modulus, stress; > 0.

    Raises:
        LawError: mu out of range.
    """

    mu: float
    powers: ClassVar = {"mu": 1}
    constrained: ClassVar = True
    volume_compliance: ClassVar = 0.0

    def check(self) -> None:
        positive(self, "mu")

    def stress(self, step: Step) -> Expr:
        """The stress without p I."""
        return lame(0, self.mu, step.mid)

    def plane_stress(self) -> LinearElastic:
        """Not constrained in the plane: e_33 = -(e_11 + e_22), and sigma_33 = 0 gives p = 2 mu (e_11 + e_22)."""
        return LinearElastic(1.0, 1.0).with_parameters({"lmbda": 2 * self.mu, "mu": self.mu})

    def stations(self) -> list[Station[Any]]:
        """The pressure is a field on S, which flows along S."""
        return of_pressure(self)

    def inside(self) -> Inside:
        return super().inside() if self.fields else Pressed(math.inf, float(self.mu))

    def end_strips(self) -> Strips | None:
        return None if self.fields else Strips.with_pressure(free_end(0.5))

    def stations_at_ends(self, weights: EndWeights) -> list[Station[Any]]:
        return of_pressure_at_ends(self, weights)

    def stiffness(self, n: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        return 2 * float(self.mu) * np.eye(6)
