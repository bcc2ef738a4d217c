"""Finds laws in UFL forms whose stress falls as jumps grow although they do not declare `softens`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from forms.kinematics import jump_strain
from forms.law import BulkLaw, Step
from forms.trace import variable
from forms.work import Term
from thinlayer.discretisation.layer import LAYER
from thinlayer.parallel.communicator import communicator
from thinlayer.pointwise.quadrature import quadrature_degree

FALLING = 1e-3  # least negative slope that is no rounding, relative to the size of the tangent or of the changes
TINY = np.finfo(float).tiny / np.finfo(float).eps ** 2  # smaller tangents may have lost digits by underflow


def may_soften(law: BulkLaw) -> bool:
    """Whether the stress of a law is tested for softening.

    Laws are not tested if they declare `softens`, are linear or not symmetric, have a rate, bound stresses or switch
    phases: their stress falls for other reasons, or never.
    """
    has = law.traits
    return has.symmetric and not (has.softens or has.linear or has.rate or has.bounded or has.switches)


class Softening:
    """The layer's laws in UFL forms that may soften, of some terms. All methods are collective."""

    def __init__(self, V: fem.FunctionSpace, terms: Iterable[Term]) -> None:
        self.comm = communicator(V.mesh)
        self._u, self._old = fem.Function(V), fem.Function(V)
        self._places = [_Place.of(p, self._u, self._old) for p in terms if p.n is not None and may_soften(p.law)]

    def found(self, u: fem.Function, old: fem.Function) -> tuple[str, str] | None:
        """Name of a law whose stress falls at displacements u or since `old`, and on which part of its layer."""
        for place in self._places:
            self._u.x.array[:], self._old.x.array[:] = u.x.array, old.x.array
            if share := place.share(self.comm):
                return place.name, f"on {share:.3g} of the {place.layer}"
        return None


@dataclass(frozen=True)
class _Place:
    """The region of a law.

    Attributes:
        name: class of the law.
        layer: its layer.
        falls: form whose value is the size of the region where stresses fall.
        everywhere: constant in `falls`; 1: the form's value is the size of the whole region.
    """

    name: str
    layer: str
    falls: fem.Form
    everywhere: fem.Constant

    @classmethod
    def of(cls, p: Term, u: fem.Function, old: fem.Function) -> _Place:
        V = u.function_space
        degree = dict(p.measure.metadata()).get("quadrature_degree", quadrature_degree(V, p.measure))
        everywhere = fem.Constant(V.mesh, 0.0)
        one = ufl.conditional(falling(p, u, old), 1.0, everywhere)
        measure = p.measure.reconstruct(metadata={"quadrature_degree": degree})
        return cls(type(p.law).__name__, p.key or LAYER, fem.form(one * measure), everywhere)

    def share(self, comm: MPI.Intracomm) -> float:
        size = self._measured(comm, 0.0)
        return size / self._measured(comm, 1.0) if size else 0.0

    def _measured(self, comm: MPI.Intracomm, everywhere: float) -> float:
        self.everywhere.value = everywhere
        return float(comm.allreduce(fem.assemble_scalar(self.falls)))


def falling(p: Term, u: Any, old: Any) -> Any:
    """UFL condition: the stress falls for a jump in some direction, or has fallen since displacements `old`.

    A is the tangent of the traction with respect to jumps. A + FALLING |A| I is not positive definite if one of its leading
    minors is negative. NaNs fulfil no condition.
    """
    assert p.n is not None
    e = variable(p.step(u).e)
    stress = p.law.stress(Step(e, p.n))
    d = p.n.ufl_shape[0]
    directions = [jump_strain(ufl.as_vector([float(i == k) for i in range(d)]), p.n) for k in range(d)]
    slopes = [ufl.diff(ufl.inner(stress, a), e) for a in directions]
    A = [[ufl.inner(slope, a) for a in directions] for slope in slopes]
    size = sum(abs(A[i][j]) for i in range(d) for j in range(d))
    over = ufl.conditional(ufl.gt(size, TINY), size, 1.0)
    B = ufl.as_matrix([[A[i][j] / over + (FALLING if i == j else 0.0) for j in range(d)] for i in range(d)])
    minors = [ufl.det(ufl.as_matrix([[B[i, j] for j in range(k)] for i in range(k)])) for k in range(2, d + 1)]
    change, of_stress = p.strain(u) - p.strain(old), stress - p.law.stress(p.step(old))
    sizes = ufl.sqrt(ufl.inner(change, change) * ufl.inner(of_stress, of_stress))
    found = ufl.Or(ufl.lt(B[0, 0], 0.0), ufl.lt(ufl.inner(change, of_stress), -FALLING * sizes))
    for minor in minors:
        found = ufl.Or(found, ufl.lt(minor, 0.0))
    return found
