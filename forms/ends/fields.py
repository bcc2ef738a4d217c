"""Stresses near a free end of a layer: what a stress field that goes on as if there were no end lacks there.

Inside a layer between much stiffer faces stresses are those of a strip without end, plus fields that take their tractions
off the free side and fade within a few thicknesses. Between faces that do not move further these fields are those of the
half strip (`forms.ends.half_strip`). The tractions are linear through the thickness, so there are four fields.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from forms.ends.constants import lame_over_mu
from forms.ends.corner import LEAST_NU, Corner
from forms.ends.half_strip import DEGREE, LEVELS, MIDDLE, half_grid, loaded, pressure_length
from forms.ends.places import values_at
from forms.ends.quadrilaterals import Array, Solution

RADIUS = 0.3  # of the arc from which strengths are taken
# each field: powers of the height y of the stresses 11 and 12 on the end that it takes away, as (component, power), and
# which displacement is zero on the middle line
LOADS = ((0, 0, 1), (1, 0, 0), (0, 1, 0), (1, 1, 1))
EVEN = np.array([1.0, -1.0, -1.0, 1.0])  # whether the mirror image, at y -> -y, of a field is itself
SIGNS = np.array([1.0, 1.0, -1.0])  # of stresses 11, 22, 12 in a mirror


@dataclass(frozen=True)
class EndFields:
    """The fields of the free end of an isotropic layer; lengths over the thickness, plane strain.

    The layer is 0 < x, -1/2 < y < 1/2, its end x = 0. The fields belong to the stresses 11 and 12 that there would be on
    the end: s_11 = a_0 + a_2 y, s_12 = a_1 + a_3 y.

    Attributes:
        nu: Poisson's ratio, in [0, 0.5]; in plane stress nu/(1 + nu) of the layer.
        degree, levels: as in `half_strip`.
    """

    nu: float
    degree: int = DEGREE
    levels: int = LEVELS

    def __post_init__(self) -> None:
        lame_over_mu(self.nu)  # raises errors of ratios out of range

    @cached_property
    def _solutions(self) -> list[Solution]:
        lmbda = lame_over_mu(self.nu)
        grid = half_grid(lmbda, pressure_length(lmbda), self.degree, self.levels)
        solutions = []
        for component, power, odd in LOADS:

            def traction(x: Array, component: int = component, power: int = power) -> Array:
                return np.eye(2)[component] * ((x[:, 1] - MIDDLE) ** power)[:, None]

            solutions.append(loaded(grid, traction, odd))
        return solutions

    @cached_property
    def corner(self) -> Corner:
        """The singular field at its corners."""
        return Corner(self.nu)

    def stresses(self, x: Array, y: Array) -> Array:
        """Stresses 11, 22, 12 at places, (4, n, 3), of the field of each amplitude; they fade for large x.

        Args:
            x: (n,) distances from the end, >= 0.
            y: (n,) heights, from -1/2 to 1/2.
        """
        lower = np.stack([x, MIDDLE - np.abs(y)], axis=1)
        found = values_at(self._solutions, lower)[1]
        mirrored = found * (EVEN[:, None, None] * SIGNS)
        return np.where((y > 0)[:, None], mirrored, found)

    @cached_property
    def strengths(self) -> Array:
        """H at the lower corner for each amplitude, (4,); at the upper one times `EVEN`. nan for nu < `LEAST_NU`."""
        if self.nu < LEAST_NU:
            return np.full(4, np.nan)
        corner, arc = self.corner, self.corner.arc(RADIUS)
        found = []
        for u, stress, (component, power, _) in zip(*values_at(self._solutions, arc), LOADS, strict=True):
            load = np.eye(2)[component]
            found.append(corner.strength(RADIUS, u, stress, load * (-MIDDLE) ** power, load * power))
        return np.array(found)


@lru_cache(maxsize=16)
def end_fields(nu: float) -> EndFields:
    """The fields of a Poisson's ratio, which are kept: about two seconds for the first call.

    Raises:
        LawError: nu is not in [0, 0.5].
    """
    return EndFields(nu)
