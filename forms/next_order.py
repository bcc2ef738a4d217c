"""The law of a layer's material whose interface law of order 1 is the nearest one."""

from __future__ import annotations

from functools import singledispatch

from forms.elastic import LARGEST_NU, ROUNDING, LinearElastic
from forms.law import BulkLaw
from forms.rubber import Rubber


@singledispatch
def for_next_order(law: BulkLaw, ends: bool = True) -> BulkLaw:
    """The law itself, unless it has a variant with a pressure that flows along S; `ends`: whether S has free ends."""
    return law


@for_next_order.register
def _(law: LinearElastic, ends: bool = True) -> BulkLaw:
    """`Rubber`; beside free ends, whose constants need no fine mesh for nu up to 0.45, for larger nu only."""
    if law.fields or law.lmbda <= 0 or (ends and law.lmbda / (law.lmbda + law.mu) / 2 <= LARGEST_NU + ROUNDING):
        return law
    return Rubber(law.lmbda, law.mu)
