"""How stiff a law is at rest: what tells soft layers from hard ones, and nearly incompressible ones from others."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms import expand_derivatives

from forms.kinematics import MANDEL, ROOT2
from forms.law import Law, Step

Array = npt.NDArray[np.float64]
SMALL = 1e-6  # strain of the divided differences: far from yielding, and far from their rounding
LONG = 1e30  # time step in which what depends on rates has come to rest


def tangent_at_rest(law: Law, n: Array) -> Array | None:
    """d stress/d strain of a law for small strains from rest, (6, 6) in Mandel's order; None if it cannot be evaluated.

    A law with memory answers at once, as to a sudden load; of a law with a rate it is what remains when all is at rest.
    Laws that declare no stiffness are evaluated, which takes up to a second.

    Args:
        law: with numbers for parameters.
        n: director, (d,).
    """
    declared = law.stiffness(n)
    if declared is not None:
        return declared
    columns = []
    for i, j in MANDEL:
        e = np.zeros((3, 3))
        e[i, j] = e[j, i] = SMALL if i == j else SMALL / ROOT2
        up, down = (_stress(law, sign * e, n) for sign in (1, -1))
        if up is None or down is None:
            return None
        columns.append((up - down) / (2 * SMALL))
    C = np.column_stack(columns)
    return C if np.isfinite(C).all() else None


def _stress(law: Law, e: Array, n: Array) -> Array | None:
    """Stress (6,) of a strain after rest; None if the law is not written in UFL, or has no number there."""
    zero = ufl.as_matrix(np.zeros((3, 3)).tolist())
    shapes: dict[tuple[int, ...], Any] = {(): ufl.as_ufl(0.0), (3,): ufl.as_vector([0.0] * 3)}
    q = {name: shapes.get(shape, zero) for name, shape in law.internal.items()}
    dt = ufl.as_ufl(LONG if law.rate else 0.0)
    try:
        named = law.mapped(lambda value, _: ufl.as_tensor(value.tolist()) if np.ndim(value) else float(value))
        step = Step(ufl.as_matrix(e.tolist()), ufl.as_vector(n.tolist()), zero, q, dt, 1.0)
        stress: Any = expand_derivatives(ufl.as_ufl(named.stress(step)))
        return mandel(np.array([[float(stress((0.0,), component=(i, j))) for j in range(3)] for i in range(3)]))
    except Exception:  # whatever a law contains that has no number: the model says what is wrong with it
        return None


def mandel(a: Array) -> Array:
    """A symmetric (3, 3) tensor of numbers as a vector (6,) in Mandel's order."""
    return np.array([a[i, j] if i == j else ROOT2 * a[i, j] for i, j in MANDEL])


def average_lame(C: Array) -> tuple[float, float]:
    """Moduli lmbda, mu of the isotropic tensor nearest to C (6, 6): its averages over all directions."""
    bulk = C[:3, :3].sum() / 9
    mu = (np.trace(C) - 3 * bulk) / 10
    return float(bulk - 2 * mu / 3), float(mu)


def in_plane_modulus(C: Array, n: Array) -> float:
    """Stiffness of a sheet against strains in its plane where its faces are free; in 3D the mean over directions.

    Of an isotropic law E/(1 - nu^2).

    Args:
        C: (6, 6) in Mandel's order.
        n: (d,) normal of the sheet.
    """
    normal = np.pad(n, (0, 3 - len(n)))
    frame = np.linalg.svd(normal[None])[2]  # its first row is along n
    along = frame[1:] if len(n) == 3 else np.array([[n[1], -n[0], 0.0]])
    out = np.array([mandel((np.outer(normal, a) + np.outer(a, normal)) / 2) for a in frame])
    condensed = C - (out @ C).T @ np.linalg.pinv(out @ C @ out.T) @ (out @ C)
    return float(np.mean([mandel(np.outer(a, a)) @ condensed @ mandel(np.outer(a, a)) for a in along]))
