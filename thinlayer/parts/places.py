"""Terms and quadrature points of the compiled laws of a model, by the keys of their memory in states and files."""

from __future__ import annotations

from weakref import WeakKeyDictionary

from forms.work import Term
from thinlayer.discretisation.model import Model
from thinlayer.pointwise.quadrature import Quadrature

LAYER = "layer"  # key of the layer's memory; several terms have "layer 1", "layer 2", ... from below
_FOUND: WeakKeyDictionary[Model, dict[str, Quadrature]] = WeakKeyDictionary()


def compiled_terms(model: Model) -> dict[str, Term]:
    """The terms whose laws are compiled, by key."""
    terms = [p for p in model.terms if p.law.traits.compiled]
    return {LAYER if len(terms) == 1 else f"{LAYER} {k + 1}": p for k, p in enumerate(terms)}


def quadratures(model: Model) -> dict[str, Quadrature]:
    """The quadrature points of compiled laws, by key; made once per model. Collective."""
    if model not in _FOUND:
        _FOUND[model] = {key: Quadrature(model.V, p, model.origin) for key, p in compiled_terms(model).items()}
    return _FOUND[model]
