"""The free end of a layer between rigid faces: plane strain on the half strip x > 0, 0 < y < 1, and its constants.

The faces y = 0 and y = 1 are moved by -+w/2 across the layer (N) or along it (T), and the end x = 0 is free. Far from
it the strain is uniform; near it the layer is weaker. Lengths are over the thickness of the layer, stresses over mu.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from forms.ends.constants import FreeEnd, flow_factor, lame_over_mu
from forms.ends.quadrilaterals import Array, Grid, Solution

MIDDLE = 0.5  # y of the middle line, where the faces are at 0 and 1
FAR = 14.0  # where what decays over the thickness has gone
RATIO = 0.2  # of the sizes of cells that shrink towards the corner
LEVELS, DEGREE = 11, 12  # how often they shrink, and the degree of displacements: constants to ten digits


def half_strip(nu: float, degree: int = DEGREE, levels: int = LEVELS) -> tuple[FreeEnd, dict[str, float]]:
    """Solve for the constants of a free end.

    Args:
        nu: Poisson's ratio, in [0, 0.5].
        degree: of the displacements.
        levels: how often cells shrink by `RATIO` towards the corner.

    Returns:
        The constants, and second values of some: of c_N and c_T from the tractions on the middle line, which balance those
        of a face, instead of the energy; at nu = 0.5 of kappa from the pressure far from the end.

    Raises:
        LawError: nu out of range.
    """
    lmbda = lame_over_mu(nu)
    delta = pressure_length(lmbda)
    grid = half_grid(lmbda, delta, degree, levels)
    # T: u_x is odd in y - 1/2; the end is pushed by mu w, which the uniform strain misses there
    sheared = loaded(grid, lambda x: np.stack([0 * x[:, 0], 1 + 0 * x[:, 0]], axis=1), odd=0)
    w, x, y, s11, s22, s12 = sheared.everywhere()
    c_T, m_T = 2 * sheared.work, -2 * float(np.sum(w * (s12 * x + s11 * (y - MIDDLE))))
    w, x, y, s11, s22, s12 = sheared.along_top(MIDDLE)
    second = {"c_T": -float(np.sum(w * s12))}
    if nu == 0.5:
        kappa, second["kappa"] = _flow(grid)
        return FreeEnd(nu, math.inf, math.inf, math.inf, c_T, m_T, kappa), second
    # N: u_y is odd in y - 1/2; the end is pressed by lmbda w, here by 1
    pressed = loaded(grid, lambda x: np.stack([1 + 0 * x[:, 0], 0 * x[:, 0]], axis=1), odd=1)
    M = lmbda + 2
    w, x, y, s11, s22, s12 = pressed.everywhere()
    c_N, rho_N = 2 * pressed.work * lmbda**2 / M, -2 * float(np.sum(w * s11))
    m_N = -2 * lmbda / M * float(np.sum(w * (s22 * x + s12 * (y - MIDDLE))))
    w, x, y, s11, s22, s12 = pressed.along_top(MIDDLE)
    second["c_N"] = -lmbda / M * float(np.sum(w * s22))
    kappa = flow_factor(delta, c_N * M / lmbda - delta) if lmbda else 0.0
    return FreeEnd(nu, c_N, m_N, rho_N, c_T, m_T, kappa), second


def pressure_length(lmbda: float) -> float:
    """Length over which the pressure of N falls; 0 if there is no such field, lmbda = math.inf."""
    return math.sqrt(lmbda / 12) if lmbda < math.inf else 0.0


def half_grid(lmbda: float, delta: float, degree: int, levels: int) -> Grid:
    """The lower half of the strip, 0 < y < MIDDLE: a square whose cells shrink to its corner (0, 0), and a row of cells.

    The pressure of N falls over the length `delta`, all else over a fraction of the thickness.
    """
    points, cells = [(0.0, 0.0)], []
    for size in MIDDLE * RATIO ** np.arange(levels, -1, -1.0):  # a square, then pairs of trapezoids around it
        k = len(points)
        points += [(size, 0.0), (0.0, size), (size, size)]
        cells += [[0, 1, 2, 3]] if k == 1 else [[k - 2, k - 1, k + 1, k + 2], [k - 3, k, k - 1, k + 2]]
    right, step = [len(points) - 3, len(points) - 1], MIDDLE
    while points[-1][0] < max(FAR, 24 * delta):
        if points[-1][0] > FAR / 2:
            step = max(step, min(1.5 * step, 2 * delta))
        x, k = points[-1][0] + step, len(points)
        points += [(x, 0.0), (x, MIDDLE)]
        cells.append([right[0], k, right[1], k + 1])
        right = [k, k + 1]
    return Grid(np.array(points), np.array(cells), lmbda, degree)


def loaded(grid: Grid, traction: Callable[[Array], Array], odd: int) -> Solution:
    """The state under tractions on the end, where faces do not move and this component is zero on the middle line."""
    end, face, middle = (grid.on(where) for where in (lambda x: x[:, 0] == 0, lambda x: x[:, 1] == 0, _in_the_middle))
    far = grid.on(lambda x: x[:, 0] == grid.points[:, 0].max())
    held = [grid.unknowns(face, 0, 1), grid.unknowns(far, 0, 1), grid.unknowns(middle, odd)]
    return grid.solve(grid.load(end, traction), np.concatenate(held))


def _in_the_middle(x: Array) -> npt.NDArray[np.bool_]:
    return np.asarray(x[:, 1] == MIDDLE)


def _flow(grid: Grid) -> tuple[float, float]:
    """kappa of an incompressible layer, from the energy and from the pressure, of Poiseuille's flow out of the end.

    With Y = y - 1/2 the flow 1/8 - Y^2/2 with the pressure x has the shear stress -Y on the end, which is taken away. The
    pressure far from the end then is x + 1/kappa - 1.
    """
    flow = loaded(grid, lambda x: np.stack([0 * x[:, 0], MIDDLE - x[:, 1]], axis=1), odd=1)
    w, x, _, s11, s22, _ = flow.everywhere()
    last = x > np.unique(grid.points[:, 0])[-2]
    far = float(np.sum((w * (s11 + s22))[last]) / (2 * np.sum(w[last])))
    return 1 / (1 - 24 * flow.work), 1 / (1 + far)
