"""A part of the balance of forces: the common base of bodies, layers, pressures, contact and additions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import astuple, dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from forms.law import Law
from thinlayer.discretisation.state import Configuration

Array = npt.NDArray[np.float64]
DISPLACEMENTS = "u"  # the key of the unknowns that all parts share


@dataclass(frozen=True)
class Interval:
    """A time step: from a configuration to the time t = old.t + dt, with the balance of forces at old.t + theta dt."""

    old: Configuration
    t: float
    dt: float
    theta: float

    @property
    def balanced(self) -> float:
        """The time old.t + theta dt; for theta = 1 the end itself, not rounded."""
        return self.t - (1 - self.theta) * self.dt


@dataclass(frozen=True)
class PartTraits:
    """Properties of a part. Several parts together have a flag if one of them has it.

    Attributes:
        uses_dt: the tangent depends on the length of the step. An own part (`Addition`) that says so, such as dashpots, has
            a rate: `march` begins at rest with it, and `solve` refuses it.
        weakens: the part may resist less than its tangent does: it flows, yields or softens, or its tangent may vanish.
        releases: the part may resist a body in one step and release it in the next, as contact does.
        singular: the tangent may be singular for some strains although there is an energy.
        saddle: the tangent with supports may have eigenvalues of both signs.
        eases: the part can be replaced by an eased one, see `Part.ease`.
        switches: phases stay the same while an equilibrium is found, and change after it.
    """

    uses_dt: bool = False
    weakens: bool = False
    releases: bool = False
    singular: bool = False
    saddle: bool = False
    eases: bool = False
    switches: bool = False

    def __or__(self, other: PartTraits) -> PartTraits:
        return PartTraits(*(a or b for a, b in zip(astuple(self), astuple(other), strict=True)))


def may_weaken(law: Law) -> bool:
    """Whether a law may resist less than its tangent does."""
    traits = law.traits
    return traits.rate or traits.bounded or traits.singular or traits.softens


@dataclass(frozen=True)
class Block:
    """A matrix that a part adds to the tangent.

    Attributes:
        matrix: the matrix.
        factor: the block is `factor` times the matrix.
        row, column: keys of the equations, and of the unknowns of the derivative: a part's key, or `DISPLACEMENTS`.
        kept: True: the part keeps the matrix; False: the caller destroys it.
    """

    matrix: PETSc.Mat
    factor: float = 1.0
    row: str = DISPLACEMENTS
    column: str = DISPLACEMENTS
    kept: bool = False


@dataclass(frozen=True)
class Outcome:
    """Energies of a part over an accepted step (NaN if a law declares none), and its memory.

    Attributes:
        before, after: energy stored at the beginning and at the end of the step.
        dissipated: energy dissipated in the step.
        remainder: work, `supplied` included, less the change of stored energy and less `dissipated`: by the time scheme or
            varying parameters.
        memory: (n, values) internal variables at the end of the step; None: the part has no memory.
        supplied: work done on the part by strains that are prescribed, beside that of loads and supports.
        stress: (n, components) stresses at the end of the step; None: the part keeps none.
        kept: whether the state keeps `after` under the part's key; it computes the energies of bodies and laws' forms.
    """

    before: float = 0.0
    after: float = 0.0
    dissipated: float = 0.0
    remainder: float = 0.0
    memory: Array | None = None
    kept: bool = True
    supplied: float = 0.0
    stress: Array | None = None


@dataclass(frozen=True)
class FileOrder:
    """The order in which values are kept in files: by the number of a cell, facet or vertex in the joint.

    Attributes:
        numbers: (cells,) original numbers.
        order: (cells, k) local indices of each cell's values, in an order that does not depend on the distribution.
    """

    numbers: npt.NDArray[np.int64]
    order: npt.NDArray[np.int64]

    @property
    def width(self) -> int:
        """Number of values per cell, k."""
        return int(self.order.shape[1])

    @classmethod
    def by_place(cls, numbers: npt.NDArray[np.int64], indices: npt.NDArray[np.int64], x: Array) -> FileOrder:
        """Order the values of each cell by the projections of their places x (n, d) on DIRECTION."""
        along = x @ np.array(DIRECTION[: x.shape[1]])
        return cls(numbers, np.take_along_axis(indices, np.argsort(along[indices], axis=1), axis=1))

    def ordered(self, values: Array) -> Array:
        """Values (n, v) as rows (cells, k v)."""
        return values[self.order].reshape(len(self.numbers), self.order.shape[1] * values.shape[1])

    def put(self, out: Array, rows: Array) -> None:
        """The inverse of `ordered`: fill `out` (n, v) from rows."""
        out[self.order.ravel()] = rows.reshape(self.order.size, out.shape[1])


# Irrational direction: the points of a facet have different projections on it, so that it orders them on all distributions.
DIRECTION = (0.5403023058681398, 0.2926817141205163, 0.7890437903507289)


class Part(ABC):
    """A part of the balance of forces. All methods are collective.

    A step starts with `begin`. A solver then tries unknowns: `evaluate` gets the displacements, the part's own unknowns are
    in `field`, and `add_forces`, `tangents` and the others refer to the last evaluation. `commit` is called once, when the
    step is accepted.

    Attributes:
        key: name of the part's memory, energy and unknowns, in states and in files.
        traits: properties of the part.
        field: the part's own unknowns beside the displacements, in the solver's units; None: there are none.
        failed: number of points on all ranks at which the last evaluation failed.
        K: matrix of the forces that are linear in the displacements; None: there is no such matrix.
        distance: largest distance of bodies that is given, such as an initial gap. It may be added to displacements, whose
            rounding is then that of the distance.
        cancelling: norm of the diagonal of a stiffness that is not in K and acts on differences of displacements. The
            rounding of these forces is that of the displacements times this stiffness.
        own_mass: matrix of the integral of squares of the own unknowns over S. A multiple of it stands in block
            preconditioners for what displacements add to the own equations. None: these do not suit the own unknowns.
        stress_width: number of stress components that states keep at each point of the memory; 0: none.
    """

    key: str
    traits = PartTraits()
    field: fem.Function | None = None
    failed: int = 0
    K: PETSc.Mat | None = None
    distance: float = 0.0
    cancelling: float = 0.0
    own_mass: PETSc.Mat | None = None
    stress_width: int = 0
    interval: Interval

    # ---------------------------------------------------------------- a step
    def begin(self, interval: Interval) -> None:
        """Begin a step, from `interval.old`."""
        self.interval = interval

    @abstractmethod
    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        """Take the displacements u at the end of the step, and mid = old + theta (u - old), at which forces balance.

        The caller owns both functions and leaves them unchanged until the next evaluation.
        """

    @abstractmethod
    def add_forces(self, out: PETSc.Vec) -> float:
        """Add the nodal forces of the last evaluation; returns their norm if the force scale shall know it, else 0."""

    def add_fixed(self, out: PETSc.Vec) -> None:
        """Add the nodal forces beside those of `K` that do not depend on the unknowns of the step, as of given strains."""

    @abstractmethod
    def tangents(self, relative_residual: float) -> list[Block]:
        """Derivatives of the forces and `own_residual`, at the last evaluation, by the unknowns at the end of the step.

        Args:
            relative_residual: norm of the last residual divided by the forces; 0 unless a tangent may be singular.
        """

    @abstractmethod
    def commit(self) -> Outcome:
        """Energies and memory at the end of the step, for the last evaluation."""

    def add_layer_forces(self, keys: Collection[str], out: PETSc.Vec) -> None:
        """Add the nodal forces of the last evaluation of what has one of these keys."""
        if self.key in keys:
            self.add_forces(out)

    def add_work_in(self, z: fem.Function, out: PETSc.Vec) -> None:
        """Add the work of the stresses of the last evaluation in displacements z, spread over the nodes where it is done.

        The sum over nodes is the work of the nodal forces. Node by node forces . z would be another density, which depends
        on the place from which displacements are counted; it is the default, for forces that act at nodes.
        """
        forces = out.duplicate()
        forces.set(0.0)
        self.add_forces(forces)
        forces.pointwiseMult(forces, z.x.petsc_vec)
        out.axpy(1.0, forces)
        forces.destroy()

    def failure(self) -> str:
        """Text that says what failed in the last evaluation and where; "" if nothing did."""
        return ""

    # ---------------------------------------------------------------- memory, time, laws
    def rest(self) -> Array | None:
        """Memory (n, values) at rest; None: the part has no memory."""
        return None

    def at_time(self, t: float) -> None:
        """Use the parameters at time t from now on. LawError: a parameter is out of range."""

    def parameters(self) -> list[Array]:
        """The parameters that vary in time, at the time of the last `at_time`, on this rank."""
        return []

    def ease(self, ease: float) -> None:
        """From now on use the eased law; 0 is the law itself, 1 an elastic one."""

    @property
    def excess(self) -> float:
        """Largest gain of energy if a column changed its phase; <= 0: no column gains."""
        return -np.inf

    def switch(self) -> bool:
        """Change columns to the phases of lowest energy in the last evaluation. True if any column changes."""
        return False

    # ---------------------------------------------------------------- own unknowns
    def own_residual(self) -> Array:
        """Residual of the part's own equations on this rank, for the last evaluation."""
        return np.empty(0)

    def own_load(self) -> Array:
        """Given forces of the step in `own_residual`, on this rank: that residual is what balances them, less these."""
        return np.zeros(self.own_size)

    def own_load_at(self, t: float) -> Array:
        """The same at a time."""
        return np.zeros(self.own_size)

    def own_start(self, old: Configuration) -> Array:
        """Own unknowns on this rank at the start of a step from `old`."""
        return np.zeros(self.own_size)

    def own_held(self, t: float | None) -> tuple[npt.NDArray[np.int64], Array]:
        """Own unknowns of this rank that are prescribed: their numbers, and values at time t, or 0 without a time."""
        return np.empty(0, np.int64), np.empty(0)

    def own_result(self) -> fem.Function:
        """Own unknowns at the end of the step, in the units of the state, for the last evaluation."""
        assert self.field is not None
        return self.field.copy()

    @property
    def own_size(self) -> int:
        """Number of own unknowns of this rank."""
        if self.field is None:
            return 0
        dofmap = self.field.function_space.dofmap
        return int(dofmap.index_map.size_local * dofmap.index_map_bs)

    # ---------------------------------------------------------------- questions
    def diagonal_at_rest(self) -> PETSc.Vec | None:
        """Diagonal of the tangent at rest of bodies that are not in K, a scale of forces; None: there are none.

        The caller destroys it.
        """
        return None

    @property
    def resists_rigid(self) -> bool:
        """Whether a rigid motion of a whole body may cause forces, as in layers and springs."""
        return True

    @property
    def unchecked(self) -> Sequence[str]:
        """Names of laws whose stresses are not checked point by point: NaNs are found in the summed forces only."""
        return ()

    @property
    def hint(self) -> str:
        """A clause for errors: how this part may make a linear solve fail; "" if it does not."""
        return ""

    def undeclared_softening(self) -> tuple[str, str] | None:
        """Name of a law whose stress falls in the last evaluation although it does not declare `softens`, and the place."""
        return None

    def takes_time(self) -> str:
        """Name of a law whose response depends on the length of the step; "" if there is none."""
        return ""

    def answers_at_once(self, times: Sequence[float]) -> tuple[str, bool] | None:
        """Name of a law with a non-linear instantaneous response, and whether varying parameters are the reason.

        None: there is no such law.
        """
        return None

    def error_measure(self, u: fem.Function) -> Array:
        """Strains or jumps (n,) at u, for the error of a step; the sum of their squares is an integral."""
        return np.empty(0)

    def add_forces_in(self, state: Configuration, out: PETSc.Vec) -> None:
        """Add the nodal forces of bodies' stresses in a state, from which the error of a step is estimated, too."""

    def unit_jump_measure(self) -> float:
        """Estimate of the sum of squares of `error_measure` for a unit jump across the layer."""
        return 0.0

    # ---------------------------------------------------------------- files
    @property
    def file_order(self) -> FileOrder | None:
        """The order of the memory in files; None: the part has no memory."""
        return None

    @property
    def own_file_order(self) -> FileOrder | None:
        """The order of the own unknowns in files, ghosts included; None: there are none."""
        return None

    # ---------------------------------------------------------------- end
    @property
    def comms(self) -> list[MPI.Intracomm]:
        """Communicators of PETSc objects that belong to the part."""
        return []

    def destroy(self) -> None:
        """Free the matrices."""
