"""The interface law of a layer that is meshed on a part of S only, as a part of the balance of forces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.work import Term, work
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import transfer
from thinlayer.parts.forms import FormPart, matrix

KEY = "interface law"


class LawElsewhere(FormPart):
    """Linear terms of an interface model, between the sides of a gap in another model of the same joint. Collective.

    Body cells of both models have the same degrees of freedom, so that the stiffness is that of the interface model with
    rows and columns numbered anew.

    Args:
        model: the model with the gap.
        other: the interface model.
        terms: its terms where there is the gap.
    """

    def __init__(self, model: Model, other: Model, terms: Sequence[Term]) -> None:
        K = matrix(work(terms, ufl.TrialFunction(other.V), ufl.TestFunction(other.V)))
        R = numbers_of(model, other)
        super().__init__(KEY, fem.Function(model.V), K.ptap(R), kept=True)
        K.destroy()
        R.destroy()


def numbers_of(model: Model, other: Model) -> PETSc.Mat:
    """The matrix that gives displacements of another model for those of a model of the same joint. Collective."""
    (n, first), (rows, _) = (_range(one.V) for one in (model, other))
    numbers = fem.Function(model.V)
    numbers.x.array[:n] = first + np.arange(n)
    numbers.x.scatter_forward()
    columns = np.rint(transfer(numbers, model, other.V, other).x.array[:rows]).astype(PETSc.IntType)
    starts = np.arange(rows + 1, dtype=PETSc.IntType)
    return PETSc.Mat().createAIJ(((rows, None), (n, None)), csr=(starts, columns, np.ones(rows)), comm=model.comm)


def _range(V: fem.FunctionSpace) -> tuple[int, int]:
    """Number of this rank's degrees of freedom, and the first of them."""
    dofmap = V.dofmap
    first, last = dofmap.index_map.local_range
    return (last - first) * dofmap.index_map_bs, first * dofmap.index_map_bs
