"""A part of the balance of forces: what `Equations` asks of bodies, layers, pressures, contact and additions alike."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from forms.law import Law
from thinlayer.discretisation.state import State

Array = npt.NDArray[np.float64]
DISPLACEMENTS = "u"  # the key of the unknowns that all parts share


@dataclass(frozen=True)
class Interval:
    """A time step: from a state to the time t = old.t + dt, with the balance of forces at old.t + theta dt."""

    old: State
    t: float
    dt: float
    theta: float

    @property
    def balanced(self) -> float:
        """The time old.t + theta dt; for theta = 1 the end itself, not rounded."""
        return self.t - (1 - self.theta) * self.dt


@dataclass(frozen=True)
class PartTraits:
    """What a part is like. Every flag is False unless it is set; several parts together have the flags that any one has.

    Attributes:
        uses_dt: the tangent depends on the length of the step.
        weakens: the part may resist less than its tangent does: it flows, yields or softens, or its tangent may vanish.
        releases: the part may let go of a body from one step to the next, as contact does.
        singular: the tangent may be singular for some strains although there is an energy.
        saddle: the tangent with supports has eigenvalues of both signs.
        eases: the part can be replaced by an easier one, see `Part.ease`.
        switches: phases are held while an equilibrium is found, and switched after it.
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
        factor: what it is multiplied by.
        row, column: keys of the unknowns whose equations and derivatives these are: of a part, or `DISPLACEMENTS`.
        kept: whether the part keeps the matrix; otherwise whoever asked for it destroys it.
    """

    matrix: PETSc.Mat
    factor: float = 1.0
    row: str = DISPLACEMENTS
    column: str = DISPLACEMENTS
    kept: bool = False


@dataclass(frozen=True)
class Outcome:
    """What an accepted step has done to a part: energies (NaN where a law declares none), and what it remembers.

    Attributes:
        before, after: energy stored at the beginning and at the end of the step.
        dissipated: energy dissipated in the step.
        remainder: what is left of the work: what the time scheme adds, or parameters that vary.
        memory: (n, values) internal values at the end of the step; None of a part without memory.
        kept: whether the state keeps `after` by the part's key; not of bodies and forms, whose energies it finds itself.
    """

    before: float = 0.0
    after: float = 0.0
    dissipated: float = 0.0
    remainder: float = 0.0
    memory: Array | None = None
    kept: bool = True


@dataclass(frozen=True)
class FileOrder:
    """The order in which values are kept in files: by the number of a cell, facet or vertex in the joint.

    Attributes:
        numbers: (cells,) original numbers.
        order: (cells, k) local index of the values of each of them, in an order that the distribution has no part in.
    """

    numbers: npt.NDArray[np.int64]
    order: npt.NDArray[np.int64]

    @property
    def width(self) -> int:
        """Number of places of a cell."""
        return int(self.order.shape[1])

    @classmethod
    def by_place(cls, numbers: npt.NDArray[np.int64], indices: npt.NDArray[np.int64], x: Array) -> FileOrder:
        """The values of a cell in the order of their places x (n, d) along a direction that no two of them share."""
        along = x @ np.array(DIRECTION[: x.shape[1]])
        return cls(numbers, np.take_along_axis(indices, np.argsort(along[indices], axis=1), axis=1))

    def ordered(self, values: Array) -> Array:
        """Values (n, v) as rows (cells, k v)."""
        return values[self.order].reshape(len(self.numbers), self.order.shape[1] * values.shape[1])

    def put(self, out: Array, rows: Array) -> None:
        """The way back: fill (n, v)."""
        out[self.order.ravel()] = rows.reshape(self.order.size, out.shape[1])


DIRECTION = (0.5403023058681398, 0.2926817141205163, 0.7890437903507289)  # no two points of a facet project to one


class Part(ABC):
    """A part of the balance of forces. Collective, as all methods are.

    A step begins with `begin`. Then unknowns are tried: `evaluate` is told the displacements (and finds its own unknowns in
    `field`), and the others answer for them. `commit` answers once, when the step is accepted.

    Attributes:
        key: names the part's memory, energy and unknowns, in states and in files.
        traits: what the part is like.
        field: the part's own unknowns beside the displacements, as the solver has them; None if there are none.
        failed: number of points of all ranks where the last evaluation failed.
        K: matrix of the forces that are linear in the displacements; None if there are none.
        cancelling: norm of the diagonal of a stiffness that is not in K and acts on differences of displacements: rounding
            of the displacements changes these forces by so much.
    """

    key: str
    traits = PartTraits()
    field: fem.Function | None = None
    failed: int = 0
    K: PETSc.Mat | None = None
    cancelling: float = 0.0
    interval: Interval

    # ---------------------------------------------------------------- a step
    def begin(self, interval: Interval) -> None:
        """Begin a step, from the state `interval.old`."""
        self.interval = interval

    @abstractmethod
    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        """Take displacements at the end of the step and where forces balance, mid = old + theta (u - old).

        Both stay the caller's, and stay as they are until the next evaluation.
        """

    @abstractmethod
    def add_forces(self, out: PETSc.Vec) -> float:
        """Add the nodal forces of the last evaluation; their size, if it says how small a residual must be, else 0."""

    @abstractmethod
    def tangents(self, lack: float) -> list[Block]:
        """Derivatives of the forces (and of `own_residual`) of the last evaluation by the unknowns at the end of the step.

        Args:
            lack: norm of the last residual over the size of the forces; 0 unless a part's tangent may be singular.
        """

    @abstractmethod
    def commit(self) -> Outcome:
        """Energies and memory at the end of the step, for the last evaluation."""

    def failure(self) -> str:
        """What failed in the last evaluation, and where; "" if nothing did."""
        return ""

    # ---------------------------------------------------------------- memory, time, laws
    def rest(self) -> Array | None:
        """Internal values (n, values) before anything happened; None of a part without memory."""
        return None

    def at_time(self, t: float) -> None:
        """Take the parameters of a time; raises LawError if one is out of range."""

    def parameters(self) -> list[Array]:
        """The parameters that vary in time, as taken last, on this rank."""
        return []

    def ease(self, ease: float) -> None:
        """Answer from now on as a part between this one (0) and an elastic one (1)."""

    @property
    def excess(self) -> float:
        """Of columns whose phases are held, by how much another phase is lower in energy; <= 0: by nothing."""
        return -np.inf

    def switch(self) -> bool:
        """Change to the phases of lowest energy in the last evaluation; whether any changes."""
        return False

    # ---------------------------------------------------------------- own unknowns
    def own_residual(self) -> Array:
        """Residual of the part's own equations on this rank, for the last evaluation."""
        return np.empty(0)

    def own_start(self, old: State) -> Array:
        """Own unknowns on this rank that a step from a state starts with."""
        return np.zeros(self.own_size)

    def own_result(self) -> fem.Function:
        """Own unknowns of the last evaluation as the state keeps them, at the end of the step."""
        assert self.field is not None
        return self.field.copy()

    @property
    def own_size(self) -> int:
        """Number of own unknowns of this rank."""
        if self.field is None:
            return 0
        dofmap = self.field.function_space.dofmap
        return int(dofmap.index_map.size_local * dofmap.index_map_bs)

    # ---------------------------------------------------------------- what is asked about it
    @property
    def resists_rigid(self) -> bool:
        """Whether a rigid motion of a whole body may bring about forces, as it does in layers and springs."""
        return True

    @property
    def unchecked(self) -> Sequence[str]:
        """Names of laws whose answers are not looked at point by point: what is not finite is seen in the sum alone."""
        return ()

    @property
    def hint(self) -> str:
        """What of this part may be why a linear solve fails, a part of a sentence."""
        return ""

    def undeclared_softening(self) -> tuple[str, str] | None:
        """Name of a law that says nothing of softening and whose stress falls in the last evaluation, and where it does."""
        return None

    def takes_time(self) -> str:
        """Name of a law whose answer depends on how long a step takes; "" if none does."""
        return ""

    def answers_at_once(self, times: Sequence[float]) -> tuple[str, bool] | None:
        """Name of a law that answers at once and not linearly, and whether as its parameters change at these times."""
        return None

    def seen(self, u: fem.Function, forces: PETSc.Vec) -> Array:
        """What the error of a step is measured in: strains or jumps (n,) at u, weighted so that their squares integrate.

        A part that has neither adds its nodal forces at u to `forces` instead.
        """
        return np.empty(0)

    def seen_of_unit_jump(self) -> float:
        """Sum of the squares that `seen` may have, about, where displacements of size 1 differ by 1 across the layer."""
        return 0.0

    # ---------------------------------------------------------------- files
    @property
    def file_order(self) -> FileOrder | None:
        """The order of the memory in files; None of a part without memory."""
        return None

    @property
    def own_file_order(self) -> FileOrder | None:
        """The order of the own unknowns, ghosts included, in files."""
        return None

    # ---------------------------------------------------------------- end
    @property
    def comms(self) -> list[MPI.Intracomm]:
        """Communicators of PETSc objects that belong to the part."""
        return []

    def destroy(self) -> None:
        """Free the matrices."""
