"""Parameters of laws that are functions of the place: their values at the quadrature points of a term."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh

from forms.kinematics import Expr
from forms.law import BulkLaw
from forms.work import Term
from thinlayer.discretisation.layer import constants
from thinlayer.parallel.agreement import on_all
from thinlayer.pointwise.quadrature import Origin, Quadrature


def placed(term: Term, V: fem.FunctionSpace, origin: Origin) -> Term:
    """A term whose law's parameters are functions, with these checked at its quadrature points. Collective.

    The parameters of a law in forms become a function with values there; compiled laws evaluate theirs themselves.

    Raises:
        LawError: a function fails, or a value is out of range, with the place; on all ranks.
    """
    law = term.law
    if not law.fields:
        return term
    points = Quadrature(V, term, origin)
    with on_all(points.comm):
        law.check_at(points.joint_x)
        values = law.fields_at(points.joint_x)
    if law.traits.compiled:
        return term
    f = points.function(np.column_stack([values[name] for name in law.fields]))
    return replace(term, law=known_at(law, V.mesh, dict(zip(law.fields, f, strict=True))), measure=points.measure)


def known_at(law: BulkLaw, mesh: Mesh, values: Mapping[str, Expr]) -> BulkLaw:
    """A law with UFL expressions for the parameters that are functions, and Constants for the others."""
    return constants(law.with_parameters(dict.fromkeys(values, 1.0)), mesh).with_parameters(values)
