"""KernelLaw: a law given by a compiled function of one point."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

from forms.base import InputError
from forms.law import BulkLaw


class KernelLaw(BulkLaw):
    """A law that UFL cannot express, such as an implicit update or a return mapping.

    Subclasses are frozen dataclasses like other laws, with their parameters as fields, and give `kernel`: a function of one
    point that numba can compile,

        kernel(e, e_old, q, dt, theta, n, parameters, stress, tangent, q_new, energies) -> bool

    with strains e (at the end of the step), e_old (6,), stress (6,) at t + theta dt and tangent d stress/d e (6, 6) in
    Mandel's order 11, 22, 33, sqrt2 12, sqrt2 13, sqrt2 23, internal values q, q_new (memory,), which start from zero,
    director n (3,), and the parameters one after the other. It fills stress, tangent and q_new, and energies (3,): stored
    at the end of the step, dissipated in the step, and the rest of stress : (e - e_old), all per unit volume. It
    returns whether it succeeded; a failed point makes the solver take a smaller step.

    Or they give a `source`, a C file with a function

        int kernel(double *out, const void *, const double *in)

    where `in` has e, e_old, q, n, dt, theta and the parameters one after the other, `out`, zero before the call, stress,
    q_new, tangent (36, row by row) and energies. At a point that fails it leaves a NaN in stress[0]; its return value is
    ignored. Other functions of the file are static.

    Attributes:
        memory: number of internal values.
        energetic: whether the kernel fills `energies`.
        isotropic: whether the kernel does not read the director n, so that it can be that of a body.
        relaxes: whether stress or internal values depend on dt, of a law without `rate`.
    """

    ignored: ClassVar = ("stress", "advance", "energy", "dissipation", "dissipated")
    memory: ClassVar[int] = 0
    energetic: ClassVar[bool] = False
    isotropic: ClassVar[bool] = False
    relaxes: ClassVar[bool] = False
    kernel: ClassVar[Callable[..., bool]]
    source: ClassVar[Path | None] = None

    def _traits_of_methods(self) -> dict[str, bool]:
        if not isinstance(self.memory, int) or self.memory < 0:
            raise InputError(f"{type(self).__name__}: memory is {self.memory!r}; allowed: a whole number >= 0")
        own = {"compiled": True, "in_ufl": False, "has_energy": bool(self.energetic), "remembers": self.memory > 0}
        return super()._traits_of_methods() | own
