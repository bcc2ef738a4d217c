"""Forms with measures with and without tags of the mesh, and quadrature points: origin, parameters of laws, keys."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh, exterior_facet_indices
from mpi4py import MPI
from petsc4py import PETSc
from ufl.algorithms import estimate_total_polynomial_degree
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives

from forms.base import Array, InputError, require
from forms.law import BulkLaw
from forms.tensors import Expr
from forms.traits import show_warnings
from forms.work import Term
from geometry.domain import Domain
from geometry.inflating.inflation import offset_to_middle, points_on_middle
from geometry.partition import column_numbers
from thinlayer.discretisation.coefficient import Coordinates, has_finite_numbers
from thinlayer.discretisation.layer import BODY_KIND, LAYER_KIND, law_with_constants
from thinlayer.discretisation.mesh_functions import cellwise_function
from thinlayer.discretisation.time_functions import time_constants
from thinlayer.pointwise.quadrature import MEASURE_OF_INTEGRAL, MeshOrigin, Quadrature, assemble_matrix
from thinlayer.system.compat import by_domain, compiled, without_cycles
from thinlayer.system.ranks import errors_on_all

show_warnings()  # those of users too

TAGS_OF_INTEGRAL = {
    "dx": "model.domain.cell_values(name)",
    "ds": "model.domain.values(name)",
    "dS": "dS(k + 1) is the k-th of joint.seams",
}


def whole_structure_form(form: Any, model: Any, what: str = "a form") -> ufl.Form:
    """A form that a user writes on a model's mesh, over the whole structure: in axisymmetry with the factor 2 pi r.

    Raises:
        InputError: no form, or one that depends on the time; numbers that are not finite or not real; a tag that no cell
            or facet has. Collective.
    """
    require(isinstance(form, ufl.Form), what, form, "it must be a UFL form, such as f * model.dx")
    if time_constants(form):
        raise InputError(f"{what} depends on the time; only loads and supports may")
    constants = [constant.value for constant in form.constants()]
    real = all(np.isrealobj(value) and np.isfinite(value).all() for value in constants)
    if not (real and all(has_finite_numbers(part.integrand()) for part in form.integrals())):
        raise InputError(f"{what} has a number that is not finite, or not real: {str(form)[:80]}")
    for integral in form.integrals():
        kind = integral.integral_type()
        name, asked = MEASURE_OF_INTEGRAL.get(kind, kind), [*np.atleast_1d(np.array(integral.subdomain_id(), object))]
        if any(isinstance(tag, bool) for tag in asked):
            raise InputError(f"{what} integrates over {name}{(*asked,)}; tags are whole numbers")
        data = form.subdomain_data()[integral.ufl_domain()][kind]
        present = model.comm.allgather({"everywhere", "otherwise"}.union(*(_tags(item, kind, model) for item in data)))
        missing = [str(tag) for tag in asked if tag not in set[Any]().union(*present)]
        if missing:
            where = f"{name}({', '.join(missing)})"
            tags = TAGS_OF_INTEGRAL.get(name, TAGS_OF_INTEGRAL["ds"])
            raise InputError(f"{what} integrates over {where}, which is nothing here; tags: {tags}")
    factor = model.kinematics.factor
    return ufl.Form([part.reconstruct(integrand=factor * part.integrand()) for part in form.integrals()])


def _tags(data: Any, kind: str, model: Any) -> set[Any]:
    """Tags of a measure's cells or facets on this rank that it reads: ds the outer ones."""
    if data is None:
        return set()
    if not hasattr(data, "values"):
        return {tag for tag, rows in data if len(rows)}
    values = data.values
    if kind == "exterior_facet":
        topology = model.domain.mesh.topology
        topology.create_connectivity(topology.dim - 1, topology.dim)
        values = values[np.isin(data.indices, exterior_facet_indices(topology))]
    return {*values.tolist()}


def compiled_summands(form: Expr) -> list[fem.Form]:
    """Compiled forms whose sum is a form, one for each set of tags: equal laws of several seams have one code."""
    return [compiled(ufl.Form(integrals)) for integrals in by_domain(form).values()]


def zero_matrix(V: fem.FunctionSpace, form: Expr) -> PETSc.Mat:
    """A matrix of zeros, with places for bilinear forms over the cells and facets that a form integrates over."""
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    same, across = ufl.inner(u, v), ufl.inner(u("+") + u("-"), v("+") + v("-"))
    parts = {}
    for integral in form.integrals():
        integrand = across if integral.integral_type() == "interior_facet" else same
        key = integral.integral_type(), id(integral.subdomain_data()), integral.subdomain_id()
        parts[key] = integral.reconstruct(integrand=integrand, metadata={})
    A = assemble_matrix(compiled(ufl.Form(list(parts.values()))))
    A.zeroEntries()
    return A


def compiled_scalars(form: Expr) -> list[fem.Form]:
    """Compiled forms whose sum is a form without arguments, each with one rule of quadrature.

    In a form without arguments FFCx takes the places of one rule for those of another where both are in its integrand.
    """
    if len(form.integrals()) == 1:  # estimating a degree takes as long as a signature
        return [compiled(form)]
    by_rule: dict[Any, list[Any]] = {}
    for domain, integrals in by_domain(form).items():
        for integral in integrals:
            rule = f"{sorted(integral.metadata().items())} {_degree(integral)}"
            by_rule.setdefault((domain, rule), []).append(integral)
    return [compiled(ufl.Form(integrals)) for integrals in by_rule.values()]


def per_unit(comm: MPI.Intracomm, form: Expr, constant: fem.Constant) -> Array:
    """Values (k,) of a UFL form without arguments, linear in a constant (k,), for each unit value of this. Collective."""
    forms, values = compiled_scalars(form), np.zeros(len(constant.value))
    for k in range(len(values)):
        constant.value[:] = np.eye(len(values))[k]
        values[k] = comm.allreduce(sum(map(fem.assemble_scalar, forms)))
    return values


@without_cycles()
def _degree(integral: Any) -> Any:
    """Degree of quadrature that UFL estimates; the integrand itself where it cannot."""
    if "quadrature_degree" in integral.metadata():
        return ""
    try:
        return estimate_total_polynomial_degree(apply_algebra_lowering(apply_derivatives(integral.integrand())))
    except Exception:  # UFL's, whatever a user's form contains: then each integrand by itself
        return integral.integrand()


def origin_of(domain: Domain) -> MeshOrigin:
    """The joint that a domain was made from."""
    joint, x = domain.joint, Coordinates.of(domain).x
    columns = partial(column_numbers, joint)
    if joint.parted is None:
        return MeshOrigin(domain.comm, x, domain.numbers, columns)
    on_s = x + cellwise_function(domain, ("DG", joint.degree, (joint.dim,)), offset_to_middle(joint))
    return MeshOrigin(domain.comm, x, domain.numbers, columns, on_s, points_on_middle(joint))


def checked_term(term: Term, V: fem.FunctionSpace, origin: MeshOrigin) -> Term:
    """A term whose law's parameters are functions, with these checked at its quadrature points. Collective.

    The parameters of a law in forms become a function with values there; compiled laws evaluate theirs themselves.

    Raises:
        InputError: a function fails, or a value is out of range, with the place; on all ranks.
    """
    law = term.law
    if not law.fields:
        return term
    points = Quadrature(V, term, origin)
    with errors_on_all(points.comm):
        law.check_at(points.joint_x)
        values = law.fields_at(points.joint_x)
    if law.traits.compiled:
        return term
    f = points.function(np.column_stack([values[name] for name in law.fields]))
    return replace(
        term, law=law_with_expressions(law, V.mesh, dict(zip(law.fields, f, strict=True))), measure=points.measure
    )


def law_with_expressions(law: BulkLaw, mesh: Mesh, values: Mapping[str, Expr]) -> BulkLaw:
    """A law with UFL expressions for the parameters that are functions, and Constants for the others."""
    return law_with_constants(law.with_parameters(dict.fromkeys(values, 1.0)), mesh).with_parameters(values)


def compiled_terms(terms: Iterable[Term]) -> dict[str, Term]:
    """The terms whose laws are compiled, by key: that of their layer or body, or "layer", or "body".

    Several of one key are numbered in their order (sublayers from below): "layer 1", "layer 2", ..., "layer BED/1", ...
    """
    by_key: dict[str, list[Term]] = {}
    for p in terms:
        if p.law.traits.compiled:
            by_key.setdefault(p.key or (BODY_KIND if p.n is None else LAYER_KIND), []).append(p)
    keys: dict[str, Term] = {}
    for name, some in by_key.items():
        start = f"{name} " if name in (BODY_KIND, LAYER_KIND) else f"{name}/"
        keys |= {f"{start}{k}" if len(some) > 1 else name: p for k, p in enumerate(some, 1)}
    return keys
