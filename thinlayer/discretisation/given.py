"""Strains that are given beside those of displacements: their values at a time, over a step, and in all times."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from ufl.core.terminal import Terminal
from ufl.corealg.traversal import unique_pre_traversal

from forms.kinematics import Expr
from forms.work import Term
from thinlayer.discretisation.load_curves import Moment, clock_of

Array = npt.NDArray[np.float64]


def at_time(terms: Iterable[Term], t: float) -> list[Term]:
    """The terms, their given strains at a time."""
    terms = list(terms)
    clock = clock_of(*(p.given for p in terms if p.given is not None))
    moment = None if clock is None else Moment(clock, t)
    return [p if moment is None or p.given is None else replace(p, given=moment.of(p.given)) for p in terms]


def added(terms: Iterable[Term], strain: Expr) -> list[Term]:
    """The terms, a strain (3, 3) added to those that are given."""
    return [replace(p, given=strain if p.given is None else summed(p.given, strain)) for p in terms]


def summed(*strains: Expr) -> Expr:
    """The sum of strains (3, 3), component by component, so that zeros stay zeros."""
    return ufl.as_tensor([[sum(one[i, j] for one in strains) for j in range(3)] for i in range(3)])


class OverStep:
    """Given strains over a step: at its ends, and where forces balance, as constants that compiled forms read.

    At rest there are none: in the first step they come suddenly, as loads do.

    Args:
        mesh: the mesh.
        terms: the terms with given strains.

    Attributes:
        grows: whether one of them is another one at the end of the step.
    """

    def __init__(self, mesh: Mesh, terms: Iterable[Term]) -> None:
        clock = clock_of(*(p.given for p in terms if p.given is not None))
        self._clock, self.grows = clock, True
        self._before, self._theta, self._present = (fem.Constant(mesh, 1.0) for _ in range(3))
        if clock is not None:
            self._old, self._new, self._now = (Moment(clock, 0.0) for _ in range(3))

    def begin(self, old: float, new: float, theta: float, *, at_rest: bool) -> None:
        """Begin a step from one time, or from rest, to another, in which forces balance at theta of it."""
        self._before.value, self._theta.value = 0.0 if at_rest else 1.0, theta
        self.grows = at_rest or self._clock is not None
        if self._clock is not None:
            self._old.set(old)
            self._new.set(new)

    def balanced(self, f: Expr) -> Expr:
        """theta f(new) + (1 - theta) f(old), as displacements have it where forces balance."""
        new, old = self._ends(f)
        return f if clock_of(f) is None else self._theta * new + (1 - self._theta) * self._before * old

    def growth(self, f: Expr) -> Expr:
        """f(new) - f(old)."""
        new, old = self._ends(f)
        return new - self._before * old

    def _ends(self, f: Expr) -> tuple[Expr, Expr]:
        return (f, f) if clock_of(f) is None else (self._new.of(f), self._old.of(f))

    def now(self, f: Expr) -> Expr:
        """f where `look_at` looks."""
        return self._present * (f if clock_of(f) is None else self._now.of(f))

    def look_at(self, t: float, *, at_rest: bool = False) -> None:
        """Look at a time, or at rest."""
        self._present.value = 0.0 if at_rest else 1.0
        if self._clock is not None:
            self._now.set(t)


class GivenInTime:
    """The given strains of terms at any time, to see whether they are finite, and how they change. Collective.

    Args:
        mesh: the mesh.
        terms: the terms.
    """

    def __init__(self, mesh: Mesh, terms: Iterable[Term]) -> None:
        found = [p for p in terms if p.given is not None and _varies(p.given)]
        clock = clock_of(*(p.given for p in found))
        self._moment = None if clock is None else Moment(clock, 0.0)
        q = ufl.TestFunction(fem.functionspace(mesh, ("DG", 0, (3, 3)))) if found else None
        self._forms = [(p, fem.form(self._integral(p, q))) for p in found]

    def _integral(self, p: Term, q: Any) -> Expr:
        side = q("+") if p.measure.integral_type() == "interior_facet" else q
        given = p.given if self._moment is None else self._moment.of(p.given)
        return ufl.inner(given, side) * p.measure

    def at(self, t: float) -> list[tuple[Term, Array]]:
        """Terms whose given strain varies in place or time, and its integrals over this rank's cells or facets."""
        if self._moment is not None:
            self._moment.set(t)
        return [(p, np.asarray(fem.assemble_vector(form).array)) for p, form in self._forms]


def _varies(given: Expr) -> bool:
    """Whether an expression has other terminals than numbers, which are checked where they are given."""
    fixed = (fem.Constant, ufl.constantvalue.ConstantValue, ufl.core.multiindex.MultiIndex)
    nodes = [node for node in unique_pre_traversal(given) if isinstance(node, Terminal)]
    return not all(isinstance(node, fixed) for node in nodes)
