"""Assembled forms: matrices, nodal forces, and integrals spread over the nodes of displacements. All is collective."""

from __future__ import annotations

from typing import Any

import dolfinx.fem.petsc
import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.kinematics import Expr


def matrix_of(form: fem.Form) -> PETSc.Mat:
    """The matrix of a bilinear form, without supports."""
    A = dolfinx.fem.petsc.assemble_matrix(form)
    A.assemble()
    return A


def forces_of(first: fem.Form, *others: fem.Form) -> PETSc.Vec:
    """The sum of linear forms at the nodes; the caller destroys the vector."""
    b = dolfinx.fem.petsc.assemble_vector(first)
    for form in others:
        dolfinx.fem.petsc.assemble_vector(b, form)
    b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
    return b


def add_forces_of(out: PETSc.Vec, *forms: fem.Form) -> float:
    """Add the sum of linear forms at the nodes to a vector; returns its norm."""
    b = forces_of(*forms)
    out.axpy(1.0, b)
    size = float(b.norm())
    b.destroy()
    return size


def values_of(form: fem.Form | None, count: int) -> Any:
    """The values (count,) of a linear form at the nodes of this rank; zeros for None."""
    if form is None:
        return np.zeros(count)
    b = forces_of(form)
    values = b.array_r.copy()
    b.destroy()
    return values


def add_spread(density: Expr, V: fem.FunctionSpace, measure: ufl.Measure, out: PETSc.Vec, maps: Any = None) -> None:
    """Add the integral of a density to the first components of displacements, in shares by shape functions.

    On S they are those of the upper side; shape functions add up to one.
    """
    v = ufl.TestFunction(V)
    v = v("+") if measure.integral_type() == "interior_facet" else v
    add_forces_of(out, fem.form(density * v[0] * measure, entity_maps=maps))
