"""The loads and the supports of a model over time."""

from __future__ import annotations

from collections.abc import Callable

import dolfinx.fem.petsc
import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from forms.kinematics import Expr
from forms.work import Term
from thinlayer.discretisation.clock import readings
from thinlayer.discretisation.given import of_place
from thinlayer.discretisation.measures import compiled
from thinlayer.discretisation.model import Model
from thinlayer.errors import ModelError

Array = npt.NDArray[np.float64]
LINEARITY = 1e-9  # relative deviation from a straight line in time that still counts as rounding
BALANCE = 1e-10  # sum of the loads along an axis, over the sum of their sizes, that still counts as rounding
SAMPLE_FRACTIONS = (0.21, 0.5, 0.83)  # fractions of a time interval at which linearity is tested


class LoadHistory:
    """Loads at nodes, prescribed displacements and given strains as functions of time. Collective, as all methods are."""

    def __init__(self, model: Model) -> None:
        self.model, self.comm = model, model.comm
        self._clock = model.coordinates.clock
        self._work = compiled(model.forces.work(ufl.TestFunction(model.V)))
        self._constraints = model.constraints
        varying = [
            (p, p.given) for p in model.terms if p.given is not None and (readings(p.given) or of_place(p.given))
        ]
        self._strains = [(p, _integrals(p, given, model)) for p, given in varying]

    @property
    def held(self) -> npt.NDArray[np.int32]:
        """Unknowns of this rank that are prescribed."""
        return self._constraints.held

    def loads_at(self, t: float) -> PETSc.Vec:
        """Nodal forces of the loads at a time; the caller destroys the vector.

        Raises:
            ModelError: loads that are not finite, or that nothing balances in a periodic joint.
        """
        with self._clock.at(t):
            b = dolfinx.fem.petsc.assemble_vector(self._work)
        b.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        if not np.isfinite(b.norm()):
            names = self.model.forces.not_finite(t)
            raise ModelError(": ".join([f"the loads are not finite at t = {t:g}", *names]))
        self._require_balance(b, t)
        b.array[:] += self._constraints.loads_at(t)
        return b

    def _require_balance(self, b: PETSc.Vec, t: float) -> None:
        """Raise ModelError if nodal forces move a periodic joint that only an anchored vertex holds."""
        supports, size = self.model.supports, float(b.norm(PETSc.NormType.NORM_1))
        if not supports.anchored or not size:
            return
        total = self.comm.allreduce(b.array_r.reshape(-1, len(supports.axes)).sum(axis=0))
        for axis in supports.anchored:
            if abs(force := float(total[supports.axes.index(axis)])) > BALANCE * size:
                raise ModelError(
                    f"the loads of the periodic joint add up to {force:g} along {axis} at t = {t:g}, and nothing balances "
                    "them; add supports, or loads whose sum is zero"
                )

    def prescribed_at(self, t: float) -> Array:
        """Prescribed displacements at a time, in the order of `held`.

        Raises:
            ModelError: one of them is not finite.
        """
        prescribed = self._constraints.values(t)
        if self.comm.allreduce(int(not np.isfinite(prescribed).all())):
            raise ModelError(f"a prescribed displacement is not finite at t = {t:g}")
        return prescribed

    def given_at(self, t: float) -> list[Array]:
        """Loads, prescribed displacements and given strains at a time, on this rank."""
        loads = self.loads_at(t)
        given = [loads.array_r.copy(), self.prescribed_at(t), *self.strains_at(t)]
        loads.destroy()
        return given

    def strains_at(self, t: float) -> list[Array]:
        """Integrals over this rank's cells or facets of the strains that are given and vary, at a time.

        Raises:
            ModelError: one of them is not finite or not symmetric.
        """
        if self.model.strain:
            self.model.strain.at(t)
        with self._clock.at(t):
            integrals = [np.asarray(fem.assemble_vector(form).array) for _, form in self._strains]
        for (p, _), values in zip(self._strains, integrals, strict=True):
            if self.comm.allreduce(int(not np.isfinite(values).all())):
                what = "layer" if p.n is not None else "bodies"
                raise ModelError(f"the eigenstrain of the {p.key or what} is not finite at t = {t:g}")
        return integrals


def linear_in_time(given_at: Callable[[float], list[Array]], start: float, end: float, comm: MPI.Intracomm) -> bool:
    """Whether values of all ranks are linear in time between two times, tested at a few times between. Collective."""
    first, last = given_at(start), given_at(end)
    for share in SAMPLE_FRACTIONS:
        now = given_at(start + share * (end - start))
        for a, b, c in zip(first, last, now, strict=True):
            apart = np.abs((1 - share) * a + share * b - c).max(initial=0.0)
            size = np.abs([a, b, c]).max(initial=0.0)
            if comm.allreduce(float(apart), max) > LINEARITY * comm.allreduce(float(size), max):
                return False
    return True


def _integrals(p: Term, given: Expr, model: Model) -> fem.Form:
    """The integrals of a given strain over cells or facets."""
    q = ufl.TestFunction(fem.functionspace(model.domain.mesh, ("DG", 0, (3, 3))))
    return fem.form(ufl.inner(given, q("+") if p.measure.integral_type() == "interior_facet" else q) * p.measure)
