"""KernelLaw: a law written as a C function of one quadrature point."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from forms.base import InputError
from forms.law import BulkLaw


class KernelLaw(BulkLaw):
    """A law that UFL cannot express, such as an implicit update or a return mapping, written in C.

    Subclasses are frozen dataclasses like other laws, with their parameters as fields. Their `source` is a C file with
    a function of one quadrature point:

        int kernel(double *out, const void *, const double *in)

    `in` contains, one after the other: the strain e (6,) at the end of the step and e_old (6,) at its beginning; the
    internal variables (memory,), which start from zero; the unit normal n (3,) of the layer; dt, theta and the
    parameters. The step leads from t to t + dt, and theta dt is the time in it after which forces balance (`Step`).

    `out` is zero before the call. It receives, one after the other: the stress (6,) at t + theta dt; the new internal
    variables (memory,); the tangent d stress/d e (36, row by row); three energies per unit volume. The energies are:
    stored at the end of the step; dissipated in the step; the remainder of stress : (e - e_old).

    Strains, stress and tangent are in Mandel's order 11, 22, 33, sqrt2 12, sqrt2 13, sqrt2 23. If a point fails, the
    function sets stress[0] to NaN, and the solver takes a smaller step. The return value is ignored. Other functions of
    the file must be static.

    Attributes:
        memory: number of scalar internal variables.
        energetic: whether the kernel computes the three energies.
        source: path of the C file.
        isotropic: whether the kernel does not read the normal n, so that the law can also be used in a body.
        relaxes: whether stress or internal variables depend on dt although the law declares no `rate`.
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
