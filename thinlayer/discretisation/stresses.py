"""Stresses of a state as UFL expressions: parts of forms, or values of compiled laws at quadrature points."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from forms.kinematics import MANDEL, Expr, from_mandel
from forms.work import Term, stress
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.places import quadratures
from thinlayer.errors import ModelError

Array = npt.NDArray[np.float64]


def stressed(
    model: Model, terms: Iterable[Term], u: fem.Function, stresses: Mapping[str, Array]
) -> Iterator[tuple[Term, Expr, ufl.Measure]]:
    """Terms of bodies or meshed layers, their stresses (3, 3), and the measures to integrate these with. Collective.

    Args:
        model: the model.
        terms: its terms; those of laws in forms may have a mean strain.
        u: displacements.
        stresses: those of compiled laws, by key; without a key they are zero.

    Raises:
        ModelError: a compiled law on S, where stresses are no functions on the model's mesh.
    """
    for p in terms:
        if not p.law.traits.compiled:
            yield p, stress(p, u), p.measure
            continue
        if p.measure.integral_type() != "cell":
            raise ModelError(f"the stress of {type(p.law).__name__} on S is not kept as a field; see Surface.traction")
        key, points = next((key, one) for key, one in quadratures(model).items() if one.term.measure is p.measure)
        values = stresses.get(key, np.zeros((points.count, len(MANDEL))))
        yield p, from_mandel(points.function(values)), points.measure
