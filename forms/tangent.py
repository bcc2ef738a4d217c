"""Stiffness of a law at rest and after a time, to recognise soft, hard and nearly incompressible layers."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives

from forms.base import Array, InputError
from forms.kinematics import MANDEL, ROOT2
from forms.kinematics import mandel as in_mandel
from forms.law import BulkLaw
from forms.trace import numbers, reads, symbolic

SMALL_STRAIN = 1e-6 * np.array([1.0, -0.7, 0.4, 0.5, -0.3, 0.6])  # too small for yielding; at none a norm has no slope
UNCOUPLED = 1e-9  # share of a traction, or component of a unit normal, below which it counts as zero
NEGATIVE = 1e-6  # a negative eigenvalue beyond this share of the tangent's largest entry is not a rounding error
LONG = 1e30  # length of a time step in which rates become zero


def tangent_at_rest(law: BulkLaw, n: Array) -> Array | None:
    """d stress/d strain of a law for small strains from rest, (6, 6) in Mandel's order; None if it cannot be evaluated.

    For a law with memory it is the instantaneous tangent, for a law with a rate the tangent when rates are zero. For an
    incompressible layer the stress is without the pressure. If the law declares no stiffness, its stress is
    differentiated, which takes some milliseconds.

    Args:
        law: the law, with numbers for parameters.
        n: director, (d,).
    """
    if law.in_space is not law:
        C = tangent_at_rest(law.in_space, n)
        return None if C is None else law.condensed(C)
    declared = law.stiffness(n)
    if declared is not None:
        return declared
    return _computed(law, n, LONG if law.traits.rate else 0.0)


def tangent_over(law: BulkLaw, n: Array, dt: float) -> Array | None:
    """d stress/d strain, (6, 6), of a linear law over one step of length dt from rest, at its end.

    It is the effective stiffness of a law that creeps or relaxes, under loads that last for dt. None if the law is not
    linear, or cannot be evaluated.

    Args:
        law: a compiled law, with numbers for parameters.
        n: director, (d,).
        dt: time > 0.
    """
    if not law.traits.linear:
        return None
    if law.in_space is not law:
        C = tangent_over(law.in_space, n, dt)
        return None if C is None else law.condensed(C)
    return _computed(law, n, dt)


def _computed(law: BulkLaw, n: Array, dt: float) -> Array | None:
    """The tangent at the end of a step from rest, the mean of those of two small opposite strains; None without numbers."""
    n3 = np.pad(n, (0, 3 - len(n)))
    if not law.traits.in_ufl:
        return _of_kernel(law, n3, dt)
    rest = np.zeros(6 + law.memory)
    try:
        given = law.mapped(lambda value, _: np.asarray(getattr(value, "value", value), float))
        point = symbolic(given, d=3 if law.traits.compiled else len(n))
        stress = in_mandel(point.law.stress(point.law.own_step(point.step)))
        tangent: Any = expand_derivatives(ufl.diff(stress, point.strain))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # UFL warns of roots of negative numbers
            inputs = [
                np.concatenate([e, rest, n3, [dt, 1.0], given.parameter_values()])
                for e in (SMALL_STRAIN, -SMALL_STRAIN)
            ]
            C = np.mean([numbers(tangent, {point.numbers: one}) for one in inputs], axis=0)
    except Exception:  # whatever a law contains that has no number: the model says what is wrong with it
        return None
    return np.asarray(C) if np.isfinite(C).all() else None


def needs_director(law: BulkLaw) -> bool:
    """Whether the stress of a law depends on the director n; a kernel says so itself (`KernelLaw.isotropic`)."""
    one: Any = law.in_space
    return reads(one, "n") if one.traits.in_ufl else not one.isotropic


def takes_time(law: BulkLaw) -> bool:
    """Whether a law creeps or relaxes: its response depends on the length of the step. A kernel says so itself."""
    one: Any = law.in_space
    return bool(one.traits.rate or (reads(one, "dt") if one.traits.in_ufl else one.relaxes))


def _of_kernel(law: Any, n: Array, dt: float) -> Array | None:
    """Tangent from the uncompiled kernel of a law in a step from rest; None if the kernel is written in C or fails."""
    if law.source is not None:
        return None
    tangent, zero, memory = np.zeros((6, 6)), np.zeros(6), np.zeros(law.memory)
    given = zero, zero.copy(), memory, dt, 1.0, n, law.parameter_values()
    try:
        with np.errstate(all="ignore"):
            type(law).kernel(*given, np.zeros(6), tangent, memory.copy(), np.zeros(3))
    except Exception:  # the model will report the error
        return None
    return tangent if np.isfinite(tangent).all() else None


def is_checked_at_rest(law: BulkLaw) -> bool:
    """Whether the tangent of a layer's law at rest is computed, by `tangent_at_rest`, and must not be negative.

    It may be negative for laws that declare `softens`. It is not computed for laws with both memory and rate, nor
    for non-linear laws of jumps, because the size of a small jump is not known.
    """
    at_jumps = law.traits.of_jumps and not law.traits.linear
    return not (law.traits.softens or (law.traits.rate and law.internal) or at_jumps)


def across(C: Array, n: Array) -> Array:
    """n.C.n of a tangent, (d, d): the traction of a jump over the thickness."""
    N = np.array([mandel((np.outer(v, n) + np.outer(n, v)) / 2) for v in np.eye(len(n))])
    return np.asarray(N @ C @ N.T)


def known_at_rest(law: BulkLaw, n: Array) -> Array | None:
    """The tangent (6, 6) of a law at rest, computed or else declared; None: it is not known. As in `tangent_at_rest`."""
    return tangent_at_rest(law, n) if is_checked_at_rest(law) else law.stiffness(n)


def require_stable(law: BulkLaw, C: Array | None, n: Array | None = None, slots: Sequence[int] = ()) -> None:
    """Raise InputError if a tangent at rest has a negative eigenvalue; does nothing if it is not known.

    Eigenvalues are those of the matrix itself: without an energy its symmetric part may be indefinite, and it still stable.

    Args:
        law: the law.
        C: its tangent, (6, 6); None: not known.
        n: director (d,) of a layer, whose n.C.n is tested.
        slots: components of the strains of a body, if it is none.
    """
    if C is None or not np.isfinite(C).all():
        return
    A, what = (C[np.ix_(slots, slots)], "(of C)") if n is None else (across(C, n), "across the layer (of n.C.n)")
    lowest, size = float(np.linalg.eigvals(A).real.min()), float(np.abs(C).max())
    if lowest < -NEGATIVE * size:
        raise InputError(
            f"{type(law).__name__}: the stiffness at rest is negative, the smallest eigenvalue {what} is {lowest:.4g}, the "
            f"largest entry of C {size:.4g}; allowed: >= 0. Check the signs of the stress and of the parameters (real ones)"
        )


def mandel(a: Array) -> Array:
    """A symmetric tensor of numbers, (2, 2) or (3, 3), as a vector (6,) in Mandel's order."""
    a = np.pad(a, (0, 3 - len(a)))
    return np.array([a[i, j] if i == j else ROOT2 * a[i, j] for i, j in MANDEL])


def average_lame(C: Array) -> tuple[float, float]:
    """Moduli lmbda, mu of the isotropic tensor nearest to C (6, 6): its averages over all directions."""
    bulk = C[:3, :3].sum() / 9
    mu = (np.trace(C) - 3 * bulk) / 10
    return float(bulk - 2 * mu / 3), float(mu)


def is_isotropic(C: Array) -> bool:
    """Whether a tangent (6, 6) is that of an isotropic material."""
    lmbda, mu = average_lame(C)
    same = 2 * mu * np.eye(6)
    same[:3, :3] += lmbda
    return bool(np.abs(C - same).max() <= UNCOUPLED * np.abs(C).max())


def in_plane_modulus(C: Array, n: Array) -> float:
    """Stiffness of a sheet against strains in its plane where its faces are free; in 3D the mean over directions.

    For an isotropic law it is E/(1 - nu^2).

    Args:
        C: (6, 6) in Mandel's order.
        n: (d,) normal of the sheet.
    """
    normal = np.pad(n, (0, 3 - len(n)))
    frame = np.linalg.svd(normal[None])[2]  # first row: n
    along = frame[1:] if len(n) == 3 else np.array([[n[1], -n[0], 0.0]])
    out = np.array([mandel((np.outer(normal, a) + np.outer(a, normal)) / 2) for a in frame])
    condensed = C - (out @ C).T @ np.linalg.pinv(out @ C @ out.T) @ (out @ C)
    return float(np.mean([mandel(np.outer(a, a)) @ condensed @ mandel(np.outer(a, a)) for a in along]))
