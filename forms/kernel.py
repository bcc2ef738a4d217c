"""KernelLaw: a law given by a function of one point in C."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from forms.base import InputError
from forms.law import BulkLaw


class KernelLaw(BulkLaw):
    """A law that UFL cannot express, such as an implicit update or a return mapping.

    Subclasses are frozen dataclasses like other laws, with their parameters as fields, and give a `source`, a C file with a
    function of one point

        int kernel(double *out, const void *, const double *in)

    where `in` has, one after the other, the strains e (at the end of the step) and e_old (6,) in Mandel's order 11, 22, 33,
    sqrt2 12, sqrt2 13, sqrt2 23, internal values q (memory,), which start from zero, the director n (3,), dt, theta and the
    parameters. `out`, zero before the call, has the stress (6,) at t + theta dt, new internal values, the tangent
    d stress/d e (36, row by row) and energies (3,): stored at the end of the step, dissipated in the step, and the rest of
    stress : (e - e_old), all per unit volume. At a point that fails the function leaves a NaN in stress[0], and the solver
    takes a smaller step; its return value is ignored. Other functions of the file are static.

    Attributes:
        memory: number of internal values.
        energetic: whether the kernel fills `energies`.
        source: the C file.
        isotropic: whether the kernel does not read the director n, so that it can be that of a body.
        relaxes: whether stress or internal values depend on dt, of a law without `rate`.
    """

    ignored: ClassVar = ("stress", "advance", "energy", "dissipation", "dissipated")
    memory: ClassVar[int] = 0
    energetic: ClassVar[bool] = False
    isotropic: ClassVar[bool] = False
    relaxes: ClassVar[bool] = False
    source: ClassVar[Path | None] = None

    def _traits_of_methods(self) -> dict[str, bool]:
        if not isinstance(self.memory, int) or self.memory < 0:
            raise InputError(f"{type(self).__name__}: memory is {self.memory!r}; allowed: a whole number >= 0")
        traits = {"compiled": True, "in_ufl": False, "has_energy": bool(self.energetic), "remembers": self.memory > 0}
        return super()._traits_of_methods() | traits
