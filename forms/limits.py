"""Closed forms of layers and bodies in numpy: friction of the full Mohr-Coulomb law here, others in `forms/limits_*.py`.

They are independent of the models; studies compare both. Barred parameters (per thickness) throughout; w is the jump [u], n
the unit normal from the lower to the upper body.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from forms.declarations import LawError
from forms.limits_bar import Bar as Bar
from forms.limits_non_monotone import NonMonotoneLimit as NonMonotoneLimit
from forms.limits_non_monotone import lamination as lamination
from forms.limits_plastic import PlasticCylinder as PlasticCylinder
from forms.limits_plastic import prandtl_pressure as prandtl_pressure
from forms.limits_plastic import von_mises_shear as von_mises_shear
from forms.limits_rubber import rubber_annulus as rubber_annulus
from forms.limits_rubber import rubber_disc as rubber_disc
from forms.limits_rubber import rubber_disc_pressure as rubber_disc_pressure
from forms.limits_rubber import rubber_strip as rubber_strip
from forms.limits_rubber import rubber_strip_tilted as rubber_strip_tilted

Array = npt.NDArray[np.float64]


def mohr_coulomb_fixed_opening(
    lmbda: float,
    mu: float,
    cohesion: float,
    friction_angle: float,
    w_N: float,
    w_T: Array,
    s: tuple[float, float] | None = None,
) -> Array:
    """Tractions (..., 2) of the full law, psi = 0, under a shear w_T that grows from a state at fixed w_N. Exact in time.

    Elastic until |s| = R, then t_T = R tanh(mu (w_T - w_y)/R + artanh(s_y/R)) and t_N = p +- R sech(same), where s_y is the
    shear stress at first yield, at w_y, and the sign is that of s_N: the normal part of the deviator fades, and t_T tends
    to R = C cos(Omega) - p sin(Omega), not to the C - t_N tan(Omega) of Eqs. (34)-(37).

    Args:
        lmbda, mu, cohesion, friction_angle: parameters of the law; C and Omega in the formulas, Omega in degrees.
        w_N: the jump held.
        w_T: shear since the start, of one sign and monotone.
        s: (s_T, s_N) at the start; default: (0, mu w_N), elastic compression.

    Raises:
        LawError: the start is beyond the yield surface.
    """
    angle, p, x = np.radians(friction_angle), (lmbda + mu) * w_N, np.asarray(w_T, float)
    R = cohesion * np.cos(angle) - p * np.sin(angle)
    s_T, s_N = (0.0, mu * w_N) if s is None else s
    if not (R > 0 and np.hypot(s_T, s_N) <= R * (1 + 1e-12)):
        raise LawError(f"|s| = {np.hypot(s_T, s_N):g} at the start exceeds R = {R:g}")
    sign = -1.0 if np.any(x < 0) else 1.0
    first = sign * np.sqrt(max(R**2 - s_N**2, 0.0))
    beyond = (s_T + mu * x - first) / R  # from first yield on
    with np.errstate(divide="ignore"):
        angle_y = beyond + np.arctanh(first / R)
    yields = sign * beyond > 0
    t_T = np.where(yields, R * np.tanh(angle_y), s_T + mu * x)
    return np.stack([t_T, p + np.where(yields, np.sign(s_N) * R / np.cosh(np.minimum(np.abs(angle_y), 300)), s_N)], -1)


def first_yield_ratio(nu: float, friction_angle: float) -> float:
    """t_T/|t_N| of the full law at first yield under shear, after elastic compression; C = 0.

    sqrt(sin^2(Omega) - (1 - 2 nu)^2)/(2 (1 - nu)); 0 for nu <= (1 - sin(Omega))/2, where compression alone makes
    the layer yield.
    """
    return float(np.sqrt(max(np.sin(np.radians(friction_angle)) ** 2 - (1 - 2 * nu) ** 2, 0.0)) / (2 * (1 - nu)))


def apparent_friction(friction_angle: float, dilatancy_angle: float) -> float:
    """Limit of t_T/|t_N| of the full law under lasting shear for C = 0: sin(Omega) cos(psi)/(1 - sin(Omega) sin(psi)).

    Davis' friction coefficient: sin(Omega) for psi = 0, and tan(Omega), the coefficient of Eq. (37), for psi = Omega alone.
    """
    friction_angle, dilatancy_angle = np.radians(friction_angle), np.radians(dilatancy_angle)
    return float(
        np.sin(friction_angle) * np.cos(dilatancy_angle) / (1 - np.sin(friction_angle) * np.sin(dilatancy_angle))
    )
