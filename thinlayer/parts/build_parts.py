"""Functions that make the parts of a model's balance of forces: one part for the forces of each law or pressure."""

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
from thinlayer.parts.form_part import LinearPart
from thinlayer.parts.mean_stress_part import MeanStressPart
from thinlayer.parts.part import Part
from thinlayer.parts.pressure_part import PressurePart, flows_along_surface
from thinlayer.system.ranks import destroy


def body_parts(model: Model) -> list[Part]:
    """Return the parts of the balance of forces that come from a model's bodies. Collective.

    One part has all laws in UFL forms. Each compiled law has a part of its own. Under a prescribed mean stress, the
    unknown mean strain of the periodic cell is a further part. The parts have different keys, their names in states and
    files.

    The first part is that of the laws in UFL forms, even if there are none. In a model with bodies its matrix `K` has
    the nonzero pattern of the bodies' stiffness.
    """
    form_part = LinearPart("forms", model.V, model.bodies, model.layer_terms)
    parts: list[Part] = [form_part, *_compiled_parts(model, model.bodies)]
    if model.stress:
        parts.append(MeanStressPart(model.V, model.cell_terms, model.stress, model.volume, model.comm))
    return parts


def layer_parts(model: Model, bc_dofs: Indices, from_bodies: Sequence[Part]) -> list[Part]:
    """Return the parts of the balance of forces that come from a model's layers. Collective.

    They are laws in UFL forms, compiled laws, pressures of incompressible layers, and contact laws. The parts have
    different keys, their names in states and files.

    Args:
        model: the model.
        bc_dofs: local numbers of this rank's displacement components that supports prescribe.
        from_bodies: the parts of the bodies, as `body_parts` returns them. The largest stiffness of the layers, or of
            the bodies if layers have none, scales the equations of pressures: residuals have the unit of forces.
    """
    ufl_terms = [p for p in model.layer_terms if not p.law.traits.compiled]
    terms_by_key = {key: [p for p in ufl_terms if p.key == key] for key in dict.fromkeys(p.key for p in ufl_terms)}
    parts: list[Part] = [LinearPart(f"{key}/forms", model.V, key_terms) for key, key_terms in terms_by_key.items()]
    parts += _compiled_parts(model, model.layer_terms)
    if constrained := [p for p in model.layer_terms if p.law.traits.constrained]:
        scale = _largest_stiffness(model, parts) or _largest_stiffness(model, from_bodies) or 1.0
        joint = model.domain.joint  # its vertices are those of the mesh; `model.joint` is the joint before inflating
        masters = joint.masters if joint.periods else None
        parts += [PressurePart(model.V, p, scale, model.origin, _zero_p_points(model, p), masters) for p in constrained]
    for name, law in model.contacts.items():
        parts.append(ContactPart(law, ContactSurface.for_seam(model, name), bc_dofs, model.layers[name].key))
    return parts


def _largest_stiffness(model: Model, parts: Sequence[Part]) -> float:
    """Return the largest diagonal entry of the stiffness of `parts` before loading, force per displacement. Collective.

    It is 0 if no part has any stiffness then.
    """
    diagonal_sums = fem.Function(model.V)  # must outlive its PETSc vector
    return max(0.0, float(sum_diagonals_at_rest(parts, diagonal_sums.x.petsc_vec).max()[1]))


def _compiled_parts(model: Model, terms: Iterable[Term]) -> list[CompiledPart]:
    terms_by_key = compiled_terms(terms).items()
    return [CompiledPart(key, model.V, term, model.origin, symmetric=model.symmetric) for key, term in terms_by_key]


def sum_diagonals_at_rest(parts: Sequence[Part], out: PETSc.Vec) -> PETSc.Vec:
    """Write the diagonal of the stiffness before loading, summed over `parts`, into `out`; return `out`. Collective.

    `out` has an entry, force per displacement, for each displacement component. The stiffness of a part is its matrix
    `K`. Parts of bodies that are not in `K` give their diagonal by their method `sum_diagonals_at_rest`.
    """
    out.set(0.0)  # a subproblem of layers alone has no bodies
    diagonals = [part.K.getDiagonal() for part in parts if part.K is not None]
    diagonals += [diagonal for part in parts if (diagonal := part.diagonal_at_rest()) is not None]
    for diagonal in diagonals:
        out.axpy(1.0, diagonal)
    destroy(*diagonals)
    return out


def _zero_p_points(model: Model, term: Term) -> Array | None:
    """Return coordinates (n, d) of the n vertices of S where a layer's pressure is zero; d: number of dimensions.

    They lie at free ends, where no support holds the side of the layer. Ends whose cells are longer than the length
    over which the pressure falls to zero are left out.

    Args:
        model: the model with the layer.
        term: virtual work of the layer's law.

    Returns:
        The coordinates, on a curved S midway between its sides. None: the law is not an interface law of order 1 with a
        pressure.
    """
    if not flows_along_surface(term):
        return None
    layer = next(layer for layer in model.layers.values() if layer.key == term.key)
    applicability = model.applicability[layer.name]
    return points_on_middle(model.domain.joint)[np.unique(applicability.loose_rim[~applicability.coarse_mask].vertices)]
