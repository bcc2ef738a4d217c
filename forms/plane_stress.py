"""PlaneStress: a law of strains in three dimensions as one of strains in the plane, without stress out of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from forms.fields import Field
from forms.law import BulkLaw, require
from forms.traits import Traits

Array = npt.NDArray[np.float64]
OUT = "out_of_plane"  # internal variable: strains 33, 13 and 23 in Mandel's components
IN_PLANE, OUT_OF_PLANE = [0, 1, 3], [2, 4, 5]  # Mandel's components


@dataclass(frozen=True, eq=False)
class PlaneStress(BulkLaw):
    """A law whose strains out of the plane are those at which the stresses there are zero, at t + theta dt.

    They are found point by point by Newton's method in compiled code (`thinlayer/pointwise/response.c`) and kept as
    internal values after those of the law, which gets all strains, old and new ones. Tangents are condensed; energies are
    those of the law. A point where there are no such strains fails, and the solver takes a smaller step.

    Attributes:
        law: the law in three dimensions.
    """

    law: BulkLaw
    ignored: ClassVar = ("stress", "advance", "energy", "dissipation", "dissipated")

    def __post_init__(self) -> None:
        """Nothing: the law has been checked."""

    @cached_property
    def traits(self) -> Traits:
        varies = self.law.traits.varies or bool(self.law.fields)  # and areas are free to change, whatever flows
        return replace(self.law.traits, compiled=True, varies=varies, isochoric=False)

    @property
    def powers(self) -> Mapping[str, float]:  # type: ignore[override]
        return self.law.powers

    @property
    def internal(self) -> Mapping[str, tuple[int, ...]]:  # type: ignore[override]
        return {**self.law.internal, OUT: (3,)}

    @property
    def memory(self) -> int:
        return self.law.memory + 3

    @property
    def break_times(self) -> set[float]:
        return self.law.break_times

    @property
    def in_space(self) -> BulkLaw:
        return self.law

    @property
    def fields(self) -> dict[str, Field]:
        return self.law.fields

    def fields_at(self, x: Array) -> dict[str, Array]:
        return self.law.fields_at(x)

    def check(self) -> None:
        self.law.check()

    def parameters(self) -> dict[str, Any]:
        return self.law.parameters()

    def choices(self) -> tuple[tuple[str, Any], ...]:
        return ("law", type(self.law)), *self.law.choices()

    def with_parameters(self, values: Mapping[str, Any]) -> Self:
        return self._of(self.law.with_parameters(values))

    def mapped(self, change: Callable[[Any, float], Any]) -> Self:
        return self._of(self.law.mapped(change))

    def eased(self, ease: float) -> Self:
        return self._of(self.law.eased(ease))

    def _of(self, law: BulkLaw) -> Self:
        """The same for a law with other parameters, unchecked."""
        return super().with_parameters({"law": law})

    def at(self, x: Array, t: float) -> dict[str, Array]:
        return self.law.at(x, t)

    def check_dimension(self, d: int) -> None:
        require(d == 2, self, "dimension of the model", d, "2")
        self.law.check_dimension(d)

    def plane_stress(self) -> Self:
        return self

    def condensed(self, C: Array) -> Array:
        """C (6, 6) condensed; the rows out of the plane are those of the isotropic tensor nearest to it in plane stress."""
        bulk = C[:3, :3].sum() / 9
        mu = (np.trace(C) - 3 * bulk) / 10
        lmbda = bulk - 2 * mu / 3
        lmbda *= 2 * mu / (lmbda + 2 * mu) if lmbda + 2 * mu > 0 else 0.0
        volume = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
        out = lmbda * np.outer(volume, volume) + 2 * mu * np.eye(6)
        coupling = C[np.ix_(IN_PLANE, OUT_OF_PLANE)]
        inner = np.linalg.pinv(C[np.ix_(OUT_OF_PLANE, OUT_OF_PLANE)])
        out[np.ix_(IN_PLANE, IN_PLANE)] = (
            C[np.ix_(IN_PLANE, IN_PLANE)] - coupling @ inner @ C[np.ix_(OUT_OF_PLANE, IN_PLANE)]
        )
        return np.asarray(out)
