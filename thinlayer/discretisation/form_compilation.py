"""Compilation of users' forms, and of laws whose parameters are functions of the place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from itertools import chain

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh, MeshTags, exterior_facet_indices
from mpi4py import MPI
from petsc4py import PETSc

from forms.base import Array, InputError, require
from forms.kinematics import Kinematics
from forms.law import BulkLaw
from forms.tensors import Expr
from forms.traits import restore_warnings
from forms.work import Term
from geometry.domain import Domain, column_numbers
from geometry.inflating.inflation import offset_to_middle, points_on_middle
from thinlayer.discretisation.coefficient import Coordinates, has_finite_numbers, time_constants
from thinlayer.discretisation.key import BODY_KIND, LAYER_KIND, Key
from thinlayer.pointwise.quadrature import MEASURE_NAMES, MeshOrigin, Quadrature, assemble_matrix
from thinlayer.system.compat import compiled, integrals_by_domain
from thinlayer.system.ranks import errors_on_all

restore_warnings()  # users' warnings too

TAGS_TEXT_OF_MEASURE = {"dx": "model.domain.region_tags(name)", "dS": "dS(k + 1) is the k-th of joint.seams"}


def checked_user_form(form: ufl.Form, domain: Domain, kinematics: Kinematics, what: str = "a form") -> ufl.Form:
    """Check a user's form on a model's mesh, and return it with the factor 2 pi r in axisymmetry. Collective.

    Args:
        form: the form.
        domain: the model's distributed mesh.
        kinematics: the model's kinematics, on this mesh.
        what: first words of error messages.

    Raises:
        InputError: an object that is no form, or a form that depends on the time; numbers that are not finite or not
            real; a tag that no cell or facet has.
    """
    require(isinstance(form, ufl.Form), what, form, "it must be a UFL form, such as f * model.dx")
    if time_constants(form):
        raise InputError(f"{what} depends on the time; only loads and supports may")
    is_real = all(np.isrealobj(constant.value) and np.isfinite(constant.value).all() for constant in form.constants())
    if not (is_real and all(has_finite_numbers(part.integrand()) for part in form.integrals())):
        raise InputError(f"{what} has a number that is not finite, or not real: {str(form)[:80]}")
    for integral in form.integrals():
        kind = integral.integral_type()
        name, ids = MEASURE_NAMES.get(kind, kind), [*np.atleast_1d(np.array(integral.subdomain_id(), object))]
        if any(isinstance(tag, bool) for tag in ids):
            raise InputError(f"{what} integrates over {name}{(*ids,)}; tags are whole numbers")
        # the sides of such facets are arbitrary
        if name == "dS" and ids == ["everywhere"] and integral.subdomain_data() is not None:
            raise InputError(f"{what} integrates over all inner facets; seams: {TAGS_TEXT_OF_MEASURE[name]}")
        data = form.subdomain_data()[integral.ufl_domain()][kind]
        present = domain.comm.allgather(
            {"everywhere", "otherwise"}.union(*(_tags(item, kind, domain.mesh) for item in data))
        )
        if missing := ", ".join(str(tag) for tag in ids if tag not in set[object]().union(*present)):
            tags_text = TAGS_TEXT_OF_MEASURE.get(name, "model.domain.values(name)")
            raise InputError(f"{what} integrates over {name}({missing}), which is nothing here; tags: {tags_text}")
    factor = kinematics.factor
    return ufl.Form([part.reconstruct(integrand=factor * part.integrand()) for part in form.integrals()])


def _tags(data: MeshTags | Iterable[tuple[object, Array]] | None, kind: str, mesh: Mesh) -> set[object]:
    """Return the tags that cells or facets of this rank have in the subdomain data of a measure.

    Args:
        data: the subdomain data: tags of a mesh, or pairs of a tag and its entities; None: no tags.
        kind: type of the measure's integral in UFL. For "exterior_facet" (ds) only facets on the boundary count.
        mesh: the mesh of the tags.
    """
    if data is None:
        return set()
    if not isinstance(data, MeshTags):
        return {tag for tag, entities in data if len(entities)}
    tags = data.values
    if kind == "exterior_facet":
        topology = mesh.topology
        topology.create_connectivity(topology.dim - 1, topology.dim)
        tags = tags[np.isin(data.indices, exterior_facet_indices(topology))]
    return {*tags.tolist()}


def compiled_summands(form: Expr) -> list[fem.Form]:
    """Return compiled forms that add up to a form, one for each set of tags in its measures.

    Layers on several seams with equal laws then share compiled code.
    """
    return [compiled(ufl.Form(integrals)) for integrals in integrals_by_domain(form).values()]


def zero_matrix(V: fem.FunctionSpace, form: Expr) -> PETSc.Mat:
    """Return a matrix over V, filled with zeros, that has entries for bilinear forms on the region of `form`.

    This region is all cells and facets over which `form` integrates.
    """
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    one_sided, two_sided = ufl.inner(u, v), ufl.inner(u("+") + u("-"), v("+") + v("-"))
    integrals = {}
    for integral in form.integrals():
        integrand = two_sided if integral.integral_type() == "interior_facet" else one_sided
        key = integral.integral_type(), id(integral.subdomain_data()), integral.subdomain_id()
        # PETSc keeps zeros that are inserted, and only these: one point will do
        integrals[key] = integral.reconstruct(integrand=integrand, metadata={"quadrature_degree": 0})
    A = assemble_matrix(compiled(ufl.Form(list(integrals.values()))))
    A.zeroEntries()
    return A


def compiled_functionals(form: Expr) -> list[fem.Form]:
    """Return compiled forms that add up to a form without arguments, one for each of its integrals.

    FFCx confuses the points of two quadrature rules if both are in the integrand of a form without arguments.
    """
    integrals = chain.from_iterable(integrals_by_domain(form).values())
    return [compiled(ufl.Form([integral])) for integral in integrals]


def unit_values(comm: MPI.Intracomm, form: Expr, constant: fem.Constant) -> Array:
    """Return the values (k,) of a form without arguments, linear in a Constant (k,), for each of k unit vectors.

    Collective. The Constant is changed.

    Args:
        comm: communicator of the mesh.
        form: the UFL form.
        constant: the Constant in the form, which becomes one unit vector after the other.
    """
    forms, values = compiled_functionals(form), np.zeros(len(constant.value))
    for k in range(len(values)):
        constant.value[:] = np.eye(len(values))[k]
        values[k] = comm.allreduce(sum(map(fem.assemble_scalar, forms)))
    return values


def mesh_origin(domain: Domain) -> MeshOrigin:
    """Return how a distributed mesh is related to its joint: numbers of its cells and facets, and coordinates."""
    joint, x = domain.joint, Coordinates.of_domain(domain).x
    find_columns = partial(column_numbers, joint)
    if joint.parted is None:
        return MeshOrigin(domain.comm, x, domain.numbers, find_columns)
    x_on_s = x + domain.cellwise_function(("DG", joint.degree, (joint.dim,)), offset_to_middle(joint))
    return MeshOrigin(domain.comm, x, domain.numbers, find_columns, x_on_s, points_on_middle(joint))


def checked_term(term: Term, V: fem.FunctionSpace, origin: MeshOrigin) -> Term:
    """Check parameters of a term's law at its quadrature points, and return the term with them. Collective.

    Only parameters that are functions of the place are checked. In a law in UFL forms they become a DOLFINx function
    with values at the points. A compiled law is unchanged, because it evaluates them itself.

    Args:
        term: the term.
        V: displacement space.
        origin: relation of the mesh to the joint, in whose coordinates parameters are functions.

    Raises:
        InputError: a function fails, or a value is out of range. The message has the place. Raised on all ranks.
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
    f = points.mesh_function(np.column_stack([values[name] for name in law.fields]))
    expressions = dict(zip(law.fields, f, strict=True))
    return replace(term, law=law_with_expressions(law, V.mesh, expressions), measure=points.measure)


def law_with_expressions(law: BulkLaw, mesh: Mesh, values: Mapping[str, Expr]) -> BulkLaw:
    """Return a law with UFL expressions as parameters: `values` (name -> expression), and Constants for the others."""
    return law_with_constants(law.with_parameters(dict.fromkeys(values, 1.0)), mesh).with_parameters(values)


def compiled_terms(terms: Iterable[Term]) -> dict[str, Term]:
    """Return, by key, those terms whose laws are compiled functions of a point, not parts of UFL forms.

    Keys are "layer", "layer BED" on a seam BED, or "body STEEL" in a region STEEL. Several terms with the same key get
    numbers, for example sublayers, from the lower face on: "layer 1", "layer 2", or on a seam "layer BED/1".
    """
    by_key: dict[str, list[Term]] = {}
    for p in terms:
        if p.law.traits.compiled:
            by_key.setdefault(p.key or (BODY_KIND if p.n is None else LAYER_KIND), []).append(p)
    numbered: dict[str, Term] = {}
    for name, group in by_key.items():
        numbered |= {str(Key.parse(name).numbered(k)) if len(group) > 1 else name: p for k, p in enumerate(group, 1)}
    return numbered


def law_with_constants(law: BulkLaw, mesh: Mesh) -> BulkLaw:
    """Return a law whose parameters are DOLFINx Constants, so that forms are compiled once for all their values.

    A compiled law is returned unchanged. So is a law with parameters that are functions, as `checked_term` evaluates
    them.
    """
    if law.fields or law.traits.compiled:
        return law
    return law.mapped(lambda value, _: fem.Constant(mesh, np.asarray(value, float)))
