"""The law of a layer's material whose interface law of order 1 is the nearest one."""

from __future__ import annotations

from functools import singledispatch

from forms.elastic import LARGEST_NU, ROUNDING, LinearElastic
from forms.law import BulkLaw
from forms.rubber import Rubber


@singledispatch
def for_next_order(law: BulkLaw) -> BulkLaw:
    """The law itself, unless it has a variant with a pressure that flows along S."""
    return law


@for_next_order.register
def _(law: LinearElastic) -> BulkLaw:
    """`Rubber` where the pressure evens out over more than the thickness, for nu > 0.45."""
    if law.fields or law.lmbda / (law.lmbda + law.mu) / 2 <= LARGEST_NU + ROUNDING:
        return law
    return Rubber(law.lmbda, law.mu)
