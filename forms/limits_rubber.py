"""Closed forms of rubber bearings: a thin layer between rigid plates, under the law of `Rubber` or `Incompressible`.

Plates that do not stretch part by w_N. The pressure p of the layer between them is zero on the free ends, and solves

    (eps/lmbda) p - div_S(eps^3/(12 mu) grad_S p) = w_N.

With delta = eps sqrt(lmbda/(12 mu)) it is lmbda w_N/eps times one less the solution of delta^2 lap_S v = v that is one on
the free ends. For lmbda to infinity this is Stefan's squeeze film and has the leading term of Gent and Lindley (Proc. Inst.
Mech. Eng. 173, 1959): eps times the stiffness is 4 mu s^2 of a strip and 6 mu s^2 of a disc, where s is the loaded over
the free area. All moduli are real ones, not per thickness; lmbda = math.inf is an incompressible layer.
Models never use these formulas, tests and studies compare with them.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.special import ive, kve

from forms.declarations import LawError

SHORT = 1e-3  # width over delta below which differences of Bessel functions lose digits


def rubber_strip(lmbda: float, mu: float, eps: float, a: float) -> float:
    """Mean normal traction per opening of a strip |x| < a in plane strain, stress per length.

    [lmbda (1 - tanh(x)/x) + 2 mu]/eps with x = a/delta; 4 mu a^2/eps^3 + 2 mu/eps for an infinite lmbda.

    Args:
        lmbda: first Lame modulus of the layer, stress; > 0 or math.inf.
        mu: its shear modulus, stress; > 0.
        eps: its thickness, length; > 0.
        a: half the width of the strip, length; > 0.

    Raises:
        LawError: an argument out of range.
    """
    _require_positive(mu=mu, eps=eps, a=a)
    return (_held(lmbda, mu, a / eps, 0.5) + 2 * mu) / eps


def rubber_strip_tilted(lmbda: float, mu: float, eps: float, a: float) -> float:
    """Moment about the middle per rotation of a strip |x| < a in plane strain, per length out of the plane; a force.

    w_N = theta x gives p = (lmbda theta/eps) (x - a sinh(x/delta)/sinh(a/delta)), and with 2 mu w_N/eps the moment.
    Arguments and errors as of `rubber_strip`.
    """
    _require_positive(mu=mu, eps=eps, a=a)
    return (_held(lmbda, mu, a / eps, 1.5) + 2 * mu) / eps * 2 * a**3 / 3


def rubber_disc(lmbda: float, mu: float, eps: float, radius: float) -> float:
    """Mean normal traction per opening of a disc, stress per length.

    [lmbda (1 - 2 I_1(x)/(x I_0(x))) + 2 mu]/eps with x = radius/delta; 3 mu radius^2/(2 eps^3) + 2 mu/eps for an infinite
    lmbda. Arguments and errors as of `rubber_strip`.
    """
    _require_positive(mu=mu, eps=eps, radius=radius)
    return (_held(lmbda, mu, radius / eps, 1.0) + 2 * mu) / eps


def rubber_disc_pressure(
    lmbda: float, mu: float, eps: float, radius: float, r: npt.ArrayLike
) -> npt.NDArray[np.float64]:
    """Pressure p per opening of a disc at the radii r <= radius, tension > 0, stress per length, of the shape of r.

    (lmbda/eps) (1 - I_0(r/delta)/I_0(radius/delta)); 3 mu (radius^2 - r^2)/eps^3 for an infinite lmbda. The normal traction
    is p + 2 mu/eps. The relative error is 1e-6 at most. Arguments and errors as of `rubber_strip`.
    """
    _require_positive(mu=mu, eps=eps, radius=radius)
    r = np.asarray(r, float)
    if _stiffer_than_flow(lmbda, mu, radius / eps):
        return np.asarray(3 * mu * (radius**2 - r**2) / eps**3, float)
    delta = _length(lmbda, mu, eps)
    share = ive(0, r / delta) / ive(0, radius / delta) * np.exp((r - radius) / delta)
    return np.asarray(lmbda / eps * (1 - share))


def rubber_annulus(lmbda: float, mu: float, eps: float, inner: float, outer: float) -> float:
    """Mean normal traction per opening of an annulus inner < r < outer, free at both ends, stress per length.

    For an infinite lmbda (3 mu/(2 eps^3)) (outer^2 + inner^2 - (outer^2 - inner^2)/ln(outer/inner)) + 2 mu/eps. For a
    finite one the relative error is 1e-8 at most.

    Args:
        lmbda: first Lame modulus of the layer, stress; > 0 or math.inf.
        mu: its shear modulus, stress; > 0.
        eps: its thickness, length; > 0.
        inner: inner radius, length; > 0.
        outer: outer radius, length; > inner.

    Raises:
        LawError: an argument out of range.
    """
    _require_positive(mu=mu, eps=eps, inner=inner, width=outer - inner)
    flow = 1.5 * mu / eps**2 * (outer**2 + inner**2 - (outer**2 - inner**2) / math.log(outer / inner))
    if _stiffer_than_flow(lmbda, mu, (outer - inner) / eps):
        # in series with the volume's compliance; the factor is 6/5 of a strip to 4/3 of a disc, where it is a millionth
        return (1 / (1 / flow + 6 / 5 / lmbda) + 2 * mu) / eps
    delta = _length(lmbda, mu, eps)
    ends = np.array([inner, outer]) / delta
    # both solutions are scaled to be of order one at the end where they are largest
    rising, falling = np.exp(ends - ends[1]), np.exp(ends[0] - ends)
    at_ends = np.transpose([ive(0, ends) * rising, kve(0, ends) * falling])
    integrals = [np.diff(ends * ive(1, ends) * rising)[0], -np.diff(ends * kve(1, ends) * falling)[0]]
    lost = 2 * float(np.linalg.solve(at_ends, np.ones(2)) @ integrals) / (ends[1] ** 2 - ends[0] ** 2)
    return (lmbda * (1 - lost) + 2 * mu) / eps


def _held(lmbda: float, mu: float, slenderness: float, k: float) -> float:
    """lmbda times the share I_(k+1)(x)/I_(k-1)(x) = 1 - 2 k I_k(x)/(x I_(k-1)(x)) of the load that flow leaves.

    k = 1/2, 3/2 of strips (opened, tilted), 1 of a disc. Written like this it loses no digits for any x.
    """
    if lmbda == math.inf:
        return 3 * mu * slenderness**2 / (k * (k + 1))
    _require_positive(lmbda=lmbda)
    x = slenderness / _length(lmbda, mu, 1.0)
    return float(lmbda * ive(k + 1, x) / ive(k - 1, x))


def _length(lmbda: float, mu: float, eps: float) -> float:
    return eps * math.sqrt(lmbda / (12 * mu))


def _stiffer_than_flow(lmbda: float, mu: float, slenderness: float) -> bool:
    """Whether the volume hardly changes: the width over delta is below `SHORT`."""
    if lmbda != math.inf:
        _require_positive(lmbda=lmbda)
    return slenderness**2 * 12 * mu < SHORT**2 * lmbda


def _require_positive(**lengths_and_moduli: float) -> None:
    for name, value in lengths_and_moduli.items():
        if not (math.isfinite(value) and value > 0):
            raise LawError(f"{name} = {value}: a finite number > 0")
