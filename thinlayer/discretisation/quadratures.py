"""Quadrature points of a model's laws: their origin in the joint, parameters there, and those of compiled laws by key."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.mesh import Mesh

from forms.kinematics import Expr
from forms.law import BulkLaw
from forms.work import Term
from geometry.domain import Domain
from geometry.inflating.parting import points_on_middle, to_middle
from geometry.joint import Joint
from thinlayer.discretisation.given import Coordinates
from thinlayer.discretisation.layer import BODY, LAYER, constants
from thinlayer.discretisation.mesh_functions import cellwise
from thinlayer.pointwise.quadrature import Origin, Quadrature
from thinlayer.system.ranks import on_all

Array = npt.NDArray[np.float64]


def origin_of(domain: Domain) -> Origin:
    """The joint that a domain was made from."""
    joint, x = domain.joint, Coordinates.of(domain).x
    columns = partial(column_numbers, joint)
    if joint.parted is None:
        return Origin(domain.comm, x, domain.numbers, columns)
    on_s = x + cellwise(domain, ("DG", joint.degree, (joint.dim,)), to_middle(joint))
    return Origin(domain.comm, x, domain.numbers, columns, on_s, points_on_middle(joint))


def column_numbers(joint: Joint) -> tuple[npt.NDArray[np.int64], Array]:
    """The column of every cell of an inflated joint (-1 outside the layer), or of every facet; and their centres.

    Returns:
        Numbers (cells or facets,), and the centres (columns, d) of the facets of S in the joint before inflating.
    """
    if joint.band is None:
        rows = joint.surface_rows
        numbers = np.full(len(joint.table.vertices), -1, np.int64)
        numbers[rows] = np.arange(len(rows))
        return numbers, joint.points[joint.table.vertices[rows]].mean(axis=1)
    regions = [joint.regions.index(name) for name in joint.band.regions]
    layer = np.flatnonzero(np.isin(joint.region, regions))
    places, place = np.unique(joint.reference, axis=0, return_inverse=True)
    below = np.sort(place.ravel()[joint.corners[layer]], axis=1)  # the facet's vertices, some of them twice
    below[:, 1:][below[:, 1:] == below[:, :-1]] = -1
    facets, column = np.unique(np.sort(below, axis=1), axis=0, return_inverse=True)
    numbers = np.full(len(joint.cells), -1, np.int64)
    numbers[layer] = column.ravel()
    vertices = (facets >= 0)[:, :, None]
    return numbers, (places[facets] * vertices).sum(axis=1) / vertices.sum(axis=1)


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


def compiled_terms(terms: Iterable[Term]) -> dict[str, Term]:
    """The terms whose laws are compiled, by key: that of their layer or body, or "layer", or "body".

    Several of one key are numbered in their order (sublayers from below): "layer 1", "layer 2", ..., "layer BED/1", ...
    """
    found: dict[str, list[Term]] = {}
    for p in terms:
        if p.law.traits.compiled:
            found.setdefault(p.key or (BODY if p.n is None else LAYER), []).append(p)
    keys: dict[str, Term] = {}
    for name, some in found.items():
        start = f"{name} " if name in (BODY, LAYER) else f"{name}/"
        keys |= {f"{start}{k}" if len(some) > 1 else name: p for k, p in enumerate(some, 1)}
    return keys
