"""Terms and quadrature points of compiled laws, by the keys of their memory in states and files."""

from __future__ import annotations

from collections.abc import Iterable
from weakref import WeakKeyDictionary

from forms.work import Term
from thinlayer.discretisation.model import Model
from thinlayer.pointwise.quadrature import Quadrature

LAYER = "layer"  # key of the layer's memory; several terms have "layer 1", "layer 2", ... from below
BODY = "body"  # the same for a law with memory in a body, in a script without a model
_FOUND: WeakKeyDictionary[Model, dict[str, Quadrature]] = WeakKeyDictionary()


def compiled_terms(terms: Iterable[Term]) -> dict[str, Term]:
    """The terms whose laws are compiled, by key."""
    found: dict[str, list[Term]] = {}
    for p in terms:
        if p.law.traits.compiled:
            found.setdefault(BODY if p.n is None else LAYER, []).append(p)
    several = ((name, k, p, len(some)) for name, some in found.items() for k, p in enumerate(some, 1))
    return {name if n == 1 else f"{name} {k}": p for name, k, p, n in several}


def quadratures(model: Model) -> dict[str, Quadrature]:
    """The quadrature points of compiled laws, by key; made once per model. Collective."""
    if model not in _FOUND:
        _FOUND[model] = {key: Quadrature(model.V, p, model.origin) for key, p in compiled_terms(model.terms).items()}
    return _FOUND[model]
