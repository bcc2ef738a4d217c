"""The parts of a model's balance of forces."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc

from forms.work import Term
from geometry.inflating.parting import points_on_middle
from thinlayer.discretisation.contact_nodes import ContactSurface
from thinlayer.discretisation.free_rim import free_of_pressure
from thinlayer.discretisation.layer import LAYER, PRESSURE
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.places import compiled_terms
from thinlayer.errors import ModelError
from thinlayer.parts.compiled import CompiledPart
from thinlayer.parts.contact import ContactPart
from thinlayer.parts.law_forms import LawForms
from thinlayer.parts.mean_stress import MeanStressPart
from thinlayer.parts.part import Part
from thinlayer.parts.pressure import PressurePart, has_flow


def body_parts(model: Model) -> list[Part]:
    """The parts of a model that depend on its mesh and bodies alone, each with another key. Collective.

    The first has a matrix with the nonzero pattern of the bodies.
    """
    parts: list[Part] = [LawForms("forms", model.V, model.bodies), *_compiled(model, model.bodies)]
    if model.stress:
        parts.append(MeanStressPart(model.V, model.solids, model.stress, model.comm))
    return parts


def other_parts(model: Model, held: npt.NDArray[np.int32], bodies: Sequence[Part]) -> list[Part]:
    """The parts of a model's layers and additions, each with another key. Collective.

    Args:
        model: the model.
        held: displacements of this rank that supports prescribe (local, unrolled).
        bodies: those of `body_parts`.
    """
    in_forms = [p for p in model.layer_terms if not p.law.traits.compiled]
    parts: list[Part] = [LawForms("forms of layers", model.V, in_forms)] if in_forms else []
    parts += _compiled(model, model.layer_terms)
    if pressures := _constrained(model.layer_terms):
        diagonal = diagonal_at_rest(bodies)
        largest = float(diagonal.max()[1])
        diagonal.destroy()
        if not largest:  # no law of the bodies is linear, or compiled
            largest = max(part.largest_at_rest() for part in bodies if isinstance(part, LawForms))
        for key, (p, some) in pressures.items():
            parts.append(PressurePart(model.V, p, largest, model.origin, key, some, _free(model, p)))
    for name, law in model.contacts.items():
        parts.append(ContactPart(law, ContactSurface.of(model, name), held, model.layers[name].key))
    return parts + [addition.part(model) for addition in model.parts]


def _compiled(model: Model, terms: Iterable[Term]) -> list[Part]:
    return [
        CompiledPart(key, model.V, term, model.origin, symmetric=model.symmetric)
        for key, term in compiled_terms(terms).items()
    ]


def diagonal_at_rest(parts: Sequence[Part]) -> PETSc.Vec:
    """Diagonal of K and of the tangents at rest of bodies that are not in K; the caller destroys it. Collective."""
    of_K = [part.K.getDiagonal() for part in parts if part.K is not None]
    first, *others = of_K + [one for part in parts if (one := part.diagonal_at_rest()) is not None]
    for other in others:
        first.axpy(1.0, other)
        other.destroy()
    return first


def _free(model: Model, term: Term) -> npt.NDArray[np.float64] | None:
    """Vertices of S where the pressure of a layer of order 1 is zero; None for other terms."""
    if not has_flow(term):
        return None
    one = next(one for one in model.layers.values() if one.key == term.key)
    return points_on_middle(model.domain.joint)[np.unique(free_of_pressure(model, one).vertices)]


def _constrained(terms: Iterable[Term]) -> dict[str, tuple[Term, list[Term]]]:
    """Terms of laws with a pressure, in one and one by one, by its key: meshed layers share it, on S each seam has one."""
    found: dict[object, list[Term]] = {}
    for p in terms:
        if p.law.traits.constrained:
            found.setdefault(p.strain, []).append(p)
    keys: dict[str, tuple[Term, list[Term]]] = {}
    for some in found.values():
        tags = tuple(tag for p in some for tag in np.atleast_1d(p.measure.subdomain_id()).tolist())
        if len(some) > 1 and len({p.key for p in some}) > 1 and any(p.law.volume_compliance for p in some):
            raise ModelError(
                "several meshed seams share one pressure, and one of their laws is Rubber, whose energy would be that of "
                "all; take LinearElastic, or Rubber for one seam alone"
            )
        whole = replace(some[0], measure=some[0].measure.reconstruct(subdomain_id=tags)) if len(some) > 1 else some[0]
        keys[PRESSURE + whole.key.removeprefix(LAYER) if len(found) > 1 else PRESSURE] = whole, some
    return keys
