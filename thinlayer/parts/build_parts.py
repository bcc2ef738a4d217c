"""Construction of the parts of a model's balance of forces."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from forms.base import Array
from forms.work import Term
from geometry.inflating.inflation import points_on_middle
from geometry.topology import Indices
from thinlayer.discretisation.contact_nodes import ContactSurface
from thinlayer.discretisation.form_compilation import compiled_terms
from thinlayer.discretisation.model import Model
from thinlayer.parts.compiled_part import CompiledPart
from thinlayer.parts.contact_part import ContactPart
from thinlayer.parts.form_part import LawFormPart
from thinlayer.parts.mean_stress_part import MeanStressPart
from thinlayer.parts.part import Part
from thinlayer.parts.pressure_part import PressurePart, flows_along_surface
from thinlayer.system.ranks import destroy


def body_parts(model: Model) -> list[Part]:
    """Parts of the balance of forces that come from a model's bodies, each with its own key. Collective.

    They are the laws in UFL forms, the compiled laws, and the unknown mean strain of a periodic cell under a mean
    stress. In a model with bodies, the matrix `K` of the first part has the nonzero pattern of the bodies' stiffness.
    """
    form_part = LawFormPart("forms", model.V, model.bodies, model.layer_terms)
    parts: list[Part] = [form_part, *_compiled_parts(model, model.bodies)]
    if model.stress:
        parts.append(MeanStressPart(model.V, model.solids, model.stress, model.volume, model.comm))
    return parts


def layer_parts(model: Model, bc_dofs: Indices, bodies: Sequence[Part]) -> list[Part]:
    """Parts of the balance of forces that come from a model's layers, each with its own key. Collective.

    They are the laws in UFL forms, the compiled laws, the pressures of incompressible layers, and contact.

    Args:
        model: the model.
        bc_dofs: local numbers of this rank's displacement components that supports prescribe.
        bodies: the parts of the bodies, as `body_parts` returns them; equations of pressures are scaled by them.
    """
    in_forms = [p for p in model.layer_terms if not p.law.traits.compiled]
    terms = {key: [p for p in in_forms if p.key == key] for key in dict.fromkeys(p.key for p in in_forms)}
    parts: list[Part] = [LawFormPart(f"{key}/forms", model.V, key_terms) for key, key_terms in terms.items()]
    parts += _compiled_parts(model, model.layer_terms)
    if constrained := [p for p in model.layer_terms if p.law.traits.constrained]:
        scale = _largest_stiffness(model, bodies or parts)
        joint = model.domain.joint  # its vertices are those of the mesh; `model.joint` is the joint before inflating
        masters = joint.masters if joint.periods else None
        parts += [PressurePart(model.V, p, scale, model.origin, _free_vertices(model, p), masters) for p in constrained]
    for name, law in model.contacts.items():
        parts.append(ContactPart(law, ContactSurface.of(model, name), bc_dofs, model.layers[name].key))
    return parts


def _largest_stiffness(model: Model, parts: Sequence[Part]) -> float:
    """Stiffness, force per displacement, with which equations of pressures are scaled to forces. Collective.

    It is the largest diagonal entry of the parts' stiffness at rest, non-linear laws in UFL included. It is 1 if no
    part has any stiffness at rest.
    """
    sums = fem.Function(model.V)  # must outlive its PETSc vector
    largest = float(diagonal_at_rest(parts, sums.x.petsc_vec).max()[1])
    tangents = [part.largest_stiffness() for part in parts if isinstance(part, LawFormPart)]
    return max(largest, *tangents) or 1.0


def _compiled_parts(model: Model, terms: Iterable[Term]) -> list[CompiledPart]:
    keys = compiled_terms(terms).items()
    return [CompiledPart(key, model.V, term, model.origin, symmetric=model.symmetric) for key, term in keys]


def diagonal_at_rest(parts: Sequence[Part], out: PETSc.Vec) -> PETSc.Vec:
    """Write into `out` the diagonal of the stiffness at rest of some parts, and return `out`. Collective.

    It is the sum of the diagonals of the matrices `Part.K` and of the vectors `Part.diagonal_at_rest`.
    """
    out.set(0.0)  # a subproblem of layers alone has no bodies
    diagonals = [part.K.getDiagonal() for part in parts if part.K is not None]
    diagonals += [diagonal for part in parts if (diagonal := part.diagonal_at_rest()) is not None]
    for diagonal in diagonals:
        out.axpy(1.0, diagonal)
    destroy(*diagonals)
    return out


def _free_vertices(model: Model, term: Term) -> Array | None:
    """Coordinates (n, d) of the vertices of S at free ends where a layer's pressure is set to zero.

    None: the term is not an interface law of order 1 with a pressure. Ends with cells longer than the length over
    which the pressure falls are left out.
    """
    if not flows_along_surface(term):
        return None
    layer = next(layer for layer in model.layers.values() if layer.key == term.key)
    applicability = model.applicability[layer.name]
    return points_on_middle(model.domain.joint)[np.unique(applicability.open_rim[~applicability.is_coarse].vertices)]
