"""Stack: sublayers in series."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from forms.base import is_number
from forms.declarations import require_declarations
from forms.fields import Array, Field
from forms.inside import Inside, Sublayers
from forms.law import BulkLaw, LawError, require
from forms.sharing import in_series
from forms.stations import Station
from forms.traits import Traits


def _fraction(a: Any) -> float:
    if not is_number(a):
        raise TypeError(f"a fraction is {a!r}; it must be a number")
    return float(a)


def folded(law: BulkLaw) -> BulkLaw:
    """The law of the sublayers of a Stack if they are linear and all equal, else the law itself."""
    first = law.sublayers[0][1]
    return first if first.traits.linear and all(one == first for _, one in law.sublayers) else law


@dataclass(frozen=True)
class Stack(BulkLaw):
    """Sublayers in series, from the lower to the upper face: common traction and in-plane strain, the jumps add up.

    The meshed layer has cells for each sublayer. On S each point solves for strains e + sym(g_i (x) n) of the
    sublayers with equal tractions and sum a_i g_i = 0, with the history of each law. A layer of equal linear sublayers has
    their law.

    Between linear elastic sublayers the compliances add, K = (sum_i a_i K_i^-1)^-1: for isotropic ones the harmonic means
    of mu and of lmbda + 2 mu. Equation (52) prints these sums as stiffnesses, and averages lmbda alone.

    Attributes:
        fractions: shares of the layer's thickness, > 0; their sum is 1.
        laws: laws of the sublayers. A Stack among them is replaced by its sublayers.

    Raises:
        LawError: fractions out of range, a law that a stack cannot hold.
    """

    fractions: tuple[float, ...]
    laws: tuple[BulkLaw, ...]
    ignored: ClassVar = ("stress", "advance", "energy", "dissipation", "dissipated")

    def __init__(self, *sublayers: tuple[float, BulkLaw]) -> None:
        try:
            given = [(_fraction(a), law) for a, law in sublayers]
        except (TypeError, ValueError) as error:
            raise LawError(f"Stack needs pairs (fraction, law): {error}") from error
        one_by_one = [(a * b, one) for a, law in given for b, one in getattr(law, "sublayers", ((1.0, law),))]
        object.__setattr__(self, "fractions", tuple(a for a, _ in one_by_one))
        object.__setattr__(self, "laws", tuple(law for _, law in one_by_one))
        self.check()
        require_declarations(self)

    def check(self) -> None:
        require(len(self.laws) > 0, self, "number of sublayers", 0, ">= 1")
        require(min(self.fractions) > 0, self, "fractions", self.fractions, "each > 0")
        total = sum(self.fractions)
        require(abs(total - 1) < 1e-12, self, "sum of the fractions", total, "1")
        for law in self.laws:
            allowed = "laws that give a stress for a strain, point by point"
            require(isinstance(law, BulkLaw) and law.traits.in_series, self, "a sublayer", law, allowed)

    @classmethod
    def graded(cls, law: Callable[[float], BulkLaw], n: int) -> Stack:
        """A layer whose law changes through the thickness, as n sublayers of equal thickness.

        Args:
            law: place in the layer -> its law there, from 0 at the lower to 1 at the upper face. Each sublayer has that of
                its middle, so that the error is O(1/n^2).
            n: number of sublayers, >= 1.
        """
        if not (is_number(n) and n >= 1 and n == int(n)):
            raise LawError(f"Stack.graded: the number of sublayers is {n!r}; allowed: whole numbers >= 1")
        return cls(*((1 / int(n), law((k + 0.5) / int(n))) for k in range(int(n))))

    @property
    def sublayers(self) -> tuple[tuple[float, BulkLaw], ...]:
        return tuple(zip(self.fractions, self.laws, strict=True))

    @property
    def break_times(self) -> set[float]:
        return set().union(*(law.break_times for law in self.laws))

    @property
    def memory(self) -> int:
        shares = 3 * len(self.laws) if len(self.laws) > 1 else 0
        return shares + sum(law.memory for law in self.laws)

    @cached_property
    def traits(self) -> Traits:
        found = Traits.of_series(law.traits for law in self.laws)
        return replace(found, varies=True) if self.fields else found

    @property
    def fields(self) -> dict[str, Field]:
        return {f"{k}.{name}": one for k, law in enumerate(self.laws) for name, one in law.fields.items()}

    def fields_at(self, x: Array) -> dict[str, Array]:
        return {f"{k}.{name}": one for k, law in enumerate(self.laws) for name, one in law.fields_at(x).items()}

    def at_places(self, x: Array) -> Iterator[Stack]:
        for laws in zip(*(law.at_places(x) for law in self.laws), strict=True):
            yield self.with_laws(laws)

    def check_at(self, x: Array) -> None:
        for law in self.laws:
            law.check_at(x)

    def eased(self, ease: float) -> Stack:
        return self.with_laws([law.eased(ease) for law in self.laws])

    def stations(self) -> list[Station[Any]]:
        if len(self.laws) == 1:
            return self.laws[0].stations()
        if self.fields:
            raise LawError(
                "order=1 of a Stack with parameters that are functions: the sublayers' shares of the jump would change "
                "along S; use order=0, or mesh the layer (structure.full)"
            )
        return in_series(self.sublayers)

    def inside(self) -> Inside:
        if self.fields:
            return super().inside()
        for law in self.laws:
            law.inside()  # raises errors of laws without one
        return Sublayers.of([(a, *law.elastic_moduli()) for a, law in self.sublayers])

    def with_laws(self, laws: Sequence[BulkLaw]) -> Stack:
        """The same fractions with other laws, unchecked."""
        return self.with_parameters({"laws": tuple(laws)})

    def mapped(self, change: Callable[[Any, float], Any]) -> Stack:
        return self.with_laws([law.mapped(change) for law in self.laws])

    def parameters(self) -> dict[str, Any]:
        """Parameters of all sublayers; "0.mu" is the mu of the lowest one."""
        return {f"{k}.{name}": value for k, law in enumerate(self.laws) for name, value in law.parameters().items()}

    def at(self, x: npt.NDArray[np.float64], t: float) -> dict[str, npt.NDArray[np.float64]]:
        return {f"{k}.{name}": value for k, law in enumerate(self.laws) for name, value in law.at(x, t).items()}

    def check_dimension(self, d: int) -> None:
        for law in self.laws:
            law.check_dimension(d)

    def plane_stress(self) -> Stack:
        return self.with_laws([law.plane_stress() for law in self.laws])
