"""Where the compiled laws of a model act, by the keys that states and files know their memory by."""

from __future__ import annotations

from weakref import WeakKeyDictionary

from forms.work import Term
from thinlayer.discretisation.model import Model
from thinlayer.pointwise.quadrature import Quadrature

LAYER = "layer"  # the key of the layer's memory; of several terms "layer 1", "layer 2", ... from below
_FOUND: WeakKeyDictionary[Model, dict[str, Quadrature]] = WeakKeyDictionary()


def compiled_terms(model: Model) -> dict[str, Term]:
    """The terms whose laws are compiled, by key."""
    terms = [p for p in model.terms if p.law.traits.compiled]
    return {LAYER if len(terms) == 1 else f"{LAYER} {k + 1}": p for k, p in enumerate(terms)}


def quadratures(model: Model) -> dict[str, Quadrature]:
    """The points of compiled laws, by key; made once for a model. Collective."""
    if model not in _FOUND:
        _FOUND[model] = {key: Quadrature(model.V, p, model.origin) for key, p in compiled_terms(model).items()}
    return _FOUND[model]
