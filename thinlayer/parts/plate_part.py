"""The motion of a rigid plate as unknowns of the balance of forces."""

from __future__ import annotations

import basix.ufl
import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from thinlayer.discretisation.addition import Host
from thinlayer.discretisation.broken import Keys, broken_space
from thinlayer.discretisation.reactions import Array, count
from thinlayer.discretisation.state import Configuration
from thinlayer.parts.part import Block, FileOrder, Interval, Outcome, Part
from thinlayer.parts.plate_data import PlateData
from thinlayer.parts.plate_nodes import require_agreement, tie


class PlatePart(Part):
    """The motions q of a plate, rotations times a length, and its given forces and moments, these over the length."""

    def __init__(self, given: PlateData, model: Host) -> None:
        self.key, self._given, self._model = given.key, given, model
        self._dim, mesh = model.joint.dim, model.V.mesh
        element = basix.ufl.element("DG", mesh.basix_cell(), 0, shape=(count(self._dim),))
        whole = fem.functionspace(mesh, element)
        one = np.zeros(np.shape(whole.dofmap.list), np.int64)
        self.field = fem.Function(broken_space(model.comm, Keys(whole, one, one)))
        self._scale = np.ones(count(self._dim))
        self._scale[self._dim :] = given.size(model)
        self.tie = tie(given, model, given.point(model), given.size(model))
        self._load: Array = np.zeros(0)

    # ---------------------------------------------------------------- a step
    def at_time(self, t: float) -> None:
        self._t = t

    def parameters(self) -> list[Array]:
        motions = self._given.motions(self._model, self._t)
        return [self._given.resultants(self._model, self._t), np.array([*motions.values()])]

    def begin(self, interval: Interval) -> None:
        super().begin(interval)
        new = old = self.own_load_at(interval.t)
        if interval.theta < 1:
            old = self.own_load_at(interval.old.t)
        self._load = interval.theta * new + (1 - interval.theta) * old

    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        pass

    def add_forces(self, out: PETSc.Vec) -> float:
        return 0.0

    def own_load(self) -> Array:
        return self._load

    def own_load_at(self, t: float) -> Array:
        return (self._given.resultants(self._model, t) / self._scale)[: self.own_size]

    def own_residual(self) -> Array:
        return -self._load

    def tangents(self, relative_residual: float) -> list[Block]:
        return []

    def commit(self) -> Outcome:
        assert self.field is not None
        change = self.field.x.array[: self.own_size] - self.own_start(self.interval.old)
        comm = self.field.function_space.mesh.comm
        return Outcome(kept=False, supplied=float(comm.allreduce(float(self._load @ change), MPI.SUM)))

    @property
    def resists_rigid(self) -> bool:
        """False: a plate follows the body that it is bonded to."""
        return False

    # ---------------------------------------------------------------- own unknowns
    def own_held(self, t: float | None) -> tuple[npt.NDArray[np.int64], Array]:
        numbers = np.array(self._given.motions_held(self._model), np.int64)
        values = np.zeros(len(numbers))
        if t is not None:
            motions = self._given.motions(self._model, t)
            values[:] = [motions[k] for k in numbers]
            require_agreement(self._given, self._model, motions, t)
        first = self.own_size if not self.own_size else len(numbers)
        return numbers[:first], (values * self._scale[numbers])[:first]

    def own_start(self, old: Configuration) -> Array:
        q = old.fields.get(self.key)
        return super().own_start(old) if q is None else q.x.array[: self.own_size] * self._scale[: self.own_size]

    def own_result(self) -> fem.Function:
        assert self.field is not None
        q = self.field.copy()
        q.x.array[:] /= self._scale
        return q

    @property
    def own_file_order(self) -> FileOrder:
        """One row for the whole plate."""
        return FileOrder(np.zeros(1, np.int64), np.arange(count(self._dim))[None, :])
