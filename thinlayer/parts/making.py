"""The parts of a model's balance of forces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from thinlayer.discretisation.contact_nodes import ContactSurface
from thinlayer.discretisation.model import Model
from thinlayer.parts.compiled import CompiledPart
from thinlayer.parts.contact import ContactPart
from thinlayer.parts.forms import LawForms
from thinlayer.parts.mean_stress import MeanStressPart
from thinlayer.parts.part import Part
from thinlayer.parts.places import compiled_terms
from thinlayer.parts.pressure import PressurePart


def parts_of(model: Model, held: npt.NDArray[np.int32]) -> list[Part]:
    """The parts of a model, each with another key, the bodies first. Collective.

    Args:
        model: the model.
        held: displacements of this rank that supports prescribe (local, unrolled).
    """
    forms = LawForms(model.V, model.terms, model.strain)
    parts: list[Part] = [forms]
    parts += [
        CompiledPart(key, model.V, term, model.origin, symmetric=model.symmetric)
        for key, term in compiled_terms(model.terms).items()
    ]
    constrained = [p for p in model.terms if p.law.traits.constrained]
    if constrained:  # meshed layers of several seams have one pressure: their strains are of one kind
        tags = tuple(tag for p in constrained for tag in np.atleast_1d(p.measure.subdomain_id()).tolist())
        whole = replace(constrained[0], measure=constrained[0].measure.reconstruct(subdomain_id=tags))
        one = whole if len(constrained) > 1 else constrained[0]
        parts.append(PressurePart(model.V, one, forms.largest, model.origin))
    if model.stress:
        parts.append(MeanStressPart(model.V, model.bodies, model.stress, model.comm))
    for name, law in model.contacts.items():
        parts.append(ContactPart(law, ContactSurface.of(model, name), held, model.layers[name].key))
    return parts + [addition.part(model) for addition in model.parts]
