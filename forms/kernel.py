"""KernelLaw: a law that is written as a C function of one quadrature point."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from forms.base import InputError
from forms.law import BulkLaw


class KernelLaw(BulkLaw):
    """A law that is written in C, because UFL cannot express its implicit update or return mapping.

    Subclasses are frozen dataclasses like other laws, with their parameters as fields. Their `source` is a C file with
    a function that is called at each quadrature point:

        int kernel(double *out, const void *, const double *in)

    The second argument and the return value are not used. The step leads from time t to t + dt, and forces balance at t
    + theta dt (`Step`). `in` contains, one after the other:

    - the strain at the end of the step (6), and that at its beginning (6);
    - the internal variables at the beginning, `memory` numbers, which start from zero;
    - the unit normal of the layer (3), dt, theta, and the parameters.

    `out` is zero before the call. The function writes into it, one after the other:

    - the stress at t + theta dt (6);
    - the internal variables at the end of the step (`memory` numbers);
    - the derivative of the stress by the strain at the end of the step (36, row by row);
    - three energies per unit volume: stored at the end of the step, dissipated in the step, and a remainder.

    The remainder is stress : (change of the strain) minus the increase of the stored energy, minus the dissipated
    energy. Strains, stress and tangent are in Mandel's order 11, 22, 33, sqrt2 12, sqrt2 13, sqrt2 23. If a point
    fails, the function sets stress[0] to NaN, and the solver takes a smaller step. Other functions of the file must be
    static.

    Attributes:
        memory: number of scalar internal variables at a point.
        energetic: whether the function computes the three energies.
        source: path of the C file.
        isotropic: whether the function does not read the normal, so that the law can also be used in a body.
        relaxes: whether stress or internal variables depend on dt although the law does not declare `rate`.
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
