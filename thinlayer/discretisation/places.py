"""Terms and quadrature points of compiled laws, by the keys of their memory in states and files."""

from __future__ import annotations

from collections.abc import Iterable
from weakref import WeakKeyDictionary

from forms.work import Term
from thinlayer.discretisation.layer import BODY, LAYER
from thinlayer.discretisation.model import Model
from thinlayer.pointwise.quadrature import Quadrature

_FOUND: WeakKeyDictionary[Model, dict[str, Quadrature]] = WeakKeyDictionary()


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


def quadratures(model: Model) -> dict[str, Quadrature]:
    """The quadrature points of compiled laws, by key; made once per model. Collective."""
    if model not in _FOUND:
        _FOUND[model] = {key: Quadrature(model.V, p, model.origin) for key, p in compiled_terms(model.terms).items()}
    return _FOUND[model]
