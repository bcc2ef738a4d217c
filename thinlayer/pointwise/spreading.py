"""Integrals spread over the nodes of displacements."""

from __future__ import annotations

from typing import Any

import dolfinx.fem.petsc
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.kinematics import Expr


def add_spread(density: Expr, V: fem.FunctionSpace, measure: ufl.Measure, out: PETSc.Vec, maps: Any = None) -> None:
    """Add the integral of a density to the first components of displacements, in shares by shape functions. Collective.

    On S they are those of the upper side; shape functions add up to one.
    """
    v = ufl.TestFunction(V)
    v = v("+") if measure.integral_type() == "interior_facet" else v
    found = dolfinx.fem.petsc.assemble_vector(fem.form(density * v[0] * measure, entity_maps=maps))
    found.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
    out.axpy(1.0, found)
    found.destroy()
