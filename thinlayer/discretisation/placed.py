"""Parameters of laws that are functions of the place: their values at the quadrature points of a term."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from dolfinx import fem

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
    known = constants(law, V.mesh).with_parameters({name: f[k] for k, name in enumerate(law.fields)})
    return replace(term, law=known, measure=points.measure)
