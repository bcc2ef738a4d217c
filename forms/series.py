"""Stack: sublayers in series."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from forms.declarations import require_declarations
from forms.law import Law, LawError, require
from forms.traits import Traits
from thinlayer_base import is_number


def _fraction(a: Any) -> float:
    if not is_number(a):
        raise TypeError(f"a fraction is {a!r}; it must be a number")
    return float(a)


def parts(law: Law) -> tuple[Law, ...]:
    """The laws of a Stack, from the lower to the upper face; of another law itself alone."""
    return law.laws if isinstance(law, Stack) else (law,)


@dataclass(frozen=True)
class Stack(Law):
    """Sublayers in series, from the lower to the upper face: common traction and in-plane strain, the jumps add up.

    The meshed layer has a stratum for each sublayer. On S each point solves for the sublayers' shares g_i of the jump,
    strains e + sym(g_i (x) n) with equal tractions and sum a_i g_i = 0, with the history of each law; any laws will do.

    Between linear elastic sublayers the compliances add, K = (sum_i a_i K_i^-1)^-1: for isotropic ones the harmonic means
    of mu and of lmbda + 2 mu. Equation (52) prints these sums as stiffnesses, and averages lmbda alone.

    Attributes:
        sublayers: (fraction, law) of each sublayer; fractions of the layer's thickness, > 0, adding up to 1. A Stack
            among them is taken apart.

    Raises:
        LawError: fractions out of range, a law that a stack cannot hold.
    """

    sublayers: tuple[tuple[float, Law], ...]
    ignored: ClassVar = ("stress", "advance", "energy", "dissipation", "dissipated", "holds")

    def __init__(self, *sublayers: tuple[float, Law]) -> None:
        try:
            given = [(_fraction(a), law) for a, law in sublayers]
        except (TypeError, ValueError) as error:
            raise LawError(f"Stack needs pairs (fraction, law): {error}") from error
        flat: list[tuple[float, Law]] = []
        for a, law in given:
            flat += [(a * b, part) for b, part in law.sublayers] if isinstance(law, Stack) else [(a, law)]
        object.__setattr__(self, "sublayers", tuple(flat))
        self.check()
        require_declarations(self)

    def check(self) -> None:
        require(len(self.sublayers) > 0, self, "number of sublayers", 0, ">= 1")
        require(min(self.fractions) > 0, self, "fractions", self.fractions, "each > 0")
        total = sum(self.fractions)
        require(abs(total - 1) < 1e-12, self, "sum of the fractions", total, "1")
        for law in self.laws:
            allowed = "laws that give a stress for a strain, at each point by itself"
            require(isinstance(law, Law) and law.traits.in_series, self, "a sublayer", law, allowed)

    @property
    def fractions(self) -> tuple[float, ...]:
        """Thickness fractions, from the lower to the upper face."""
        return tuple(a for a, _ in self.sublayers)

    @property
    def laws(self) -> tuple[Law, ...]:
        """Laws, from the lower to the upper face."""
        return tuple(law for _, law in self.sublayers)

    @cached_property
    def traits(self) -> Traits:
        return Traits.of_series(law.traits for law in self.laws)

    def eased(self, ease: float) -> Stack:
        return self.with_laws([law.eased(ease) for law in self.laws])

    def with_laws(self, laws: Sequence[Law]) -> Stack:
        """The same fractions with other laws, unchecked."""
        return self.with_parameters({"sublayers": tuple(zip(self.fractions, laws, strict=True))})

    def mapped(self, change: Callable[[Any, float], Any]) -> Stack:
        return self.with_laws([law.mapped(change) for law in self.laws])

    def parameters(self) -> dict[str, Any]:
        """Those of the sublayers, "0.mu" that of the lowest one."""
        return {f"{k}.{name}": value for k, law in enumerate(self.laws) for name, value in law.parameters().items()}

    def at(self, x: npt.NDArray[np.float64], t: float) -> dict[str, npt.NDArray[np.float64]]:
        return {f"{k}.{name}": value for k, law in enumerate(self.laws) for name, value in law.at(x, t).items()}

    def check_dimension(self, d: int) -> None:
        for law in self.laws:
            law.check_dimension(d)

    def plane_stress(self) -> Stack:
        return self.with_laws([law.plane_stress() for law in self.laws])
