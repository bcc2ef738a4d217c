"""Base class of a part of the balance of forces: bodies, layers, pressures, contact and users' parts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from difflib import get_close_matches
from typing import Protocol, runtime_checkable

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from forms.base import Array, InputError
from forms.law import Law
from forms.traits import accept_renamed
from geometry.topology import IntArray
from thinlayer.discretisation.state import Configuration
from thinlayer.discretisation.time_functions import StepStrains
from thinlayer.errors import former_names
from thinlayer.pointwise.quadrature import assemble_values

Memory = Array | Mapping[str, fem.Function]  # (n, values) at entities, or functions by name
Softening = tuple[str, str]  # name of a law whose stress falls, and the place
DISPLACEMENT_KEY = "u"  # the key of the unknowns that all parts share
MISSPELT_SIMILARITY = 0.9  # ratio of two names (difflib) from which on one counts as the other misspelt


@dataclass(frozen=True)
class TimeStep:
    """A time step from the configuration `old` to the time t = old.t + dt; forces balance at old.t + theta dt."""

    old: Configuration
    t: float
    dt: float
    theta: float

    @property
    def balanced(self) -> float:
        """The time old.t + theta dt at which forces balance; for theta = 1 exactly t, without rounding."""
        return self.t - (1 - self.theta) * self.dt


@dataclass(frozen=True)
class PartTraits:
    """Properties of a part. Several parts together have a flag if one of them has it.

    Attributes:
        rate: the forces depend on velocities or strain rates: `march` begins at rest, and `solve` refuses the part.
        remembers: the forces depend on the history before the step.
        nonlinear: the forces are not proportional to the displacements.
        bounded: stresses are bounded, so that loads may have a limit.
        softens: stresses fall as jumps grow, so that loads may have several equilibria.
        weakens: the part may resist less than its tangent predicts: it flows, yields or softens, or its tangent may
            vanish.
        releases: the part may resist a body in one step and release it in the next, as contact does.
        singular: the tangent may be singular for some strains although there is an energy.
        saddle: the tangent, with supports applied, may have eigenvalues of both signs.
        has_homotopy: the part has a homotopy law for continuation, which its method `set_homotopy` selects.
        switches: phases are fixed while an equilibrium is computed, and change after it.
        inner: rigid motions of a whole body cause no forces.
        unchecked: stresses are not checked at each point; a NaN appears only in the summed forces.
    """

    rate: bool = False
    remembers: bool = False
    nonlinear: bool = False
    bounded: bool = False
    softens: bool = False
    weakens: bool = False
    releases: bool = False
    singular: bool = False
    saddle: bool = False
    has_homotopy: bool = False
    switches: bool = False
    inner: bool = False
    unchecked: bool = False

    def __or__(self, other: PartTraits) -> PartTraits:
        return PartTraits(*(a or b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @classmethod
    def of(cls, law: Law) -> PartTraits:
        """Traits of a part that consists of one law."""
        same = ("rate", "remembers", "bounded", "softens", "singular", "has_homotopy", "switches")
        has = {name: getattr(law.traits, name) for name in same}
        weakens = has["rate"] or has["bounded"] or has["singular"] or has["softens"]
        return cls(nonlinear=not law.traits.linear, weakens=weakens, **has)


@dataclass(frozen=True)
class Block:
    """A matrix that a part adds to the tangent.

    Attributes:
        matrix: the matrix.
        factor: the block is `factor` times the matrix.
        row: key of the equations: a part's key, or `DISPLACEMENT_KEY`.
        column: key of the unknowns by which they are differentiated, likewise.
        kept: True: the part keeps the matrix; False: the caller destroys it.
    """

    matrix: PETSc.Mat
    factor: float = 1.0
    row: str = DISPLACEMENT_KEY
    column: str = DISPLACEMENT_KEY
    kept: bool = False


@dataclass(frozen=True)
class StepOutcome:
    """Energies of a part over an accepted step (NaN if a law declares none), and its memory.

    Attributes:
        before, after: energy stored at the beginning and at the end of the step.
        dissipated: energy dissipated in the step.
        remainder: work, `supplied` included, less the change of stored energy and less `dissipated`. It is caused by
            the time scheme or by varying parameters.
        memory: memory at the end of the step, as in `Part.rest`; None: the part has no memory.
        supplied: work done on the part by prescribed strains, in addition to the work of loads and supports.
        stress: (n, components) stresses at the end of the step; None: the part keeps no stresses.
        kept: whether the state keeps `after` under the part's key. False for parts whose energy the state computes
            itself, as for bodies and layers with laws in UFL forms.
    """

    before: float = 0.0
    after: float = 0.0
    dissipated: float = 0.0
    remainder: float = 0.0
    memory: Memory | None = None
    kept: bool = True
    supplied: float = 0.0
    stress: Array | None = None


@dataclass(frozen=True)
class FileOrder:
    """Order of values in files: by the number of their cell, facet or vertex in the joint.

    Attributes:
        numbers: (cells,) numbers of the cells, facets or vertices in the joint.
        order: (cells, k) local indices of each cell's values, in an order that does not depend on the distribution.
        n_owned: this rank writes the values of the first `n_owned` cells; None: of all cells.
    """

    numbers: IntArray
    order: IntArray
    n_owned: int | None = None

    @property
    def width(self) -> int:
        """Number of values per cell, k."""
        return int(self.order.shape[1])

    @classmethod
    def by_place(cls, numbers: IntArray, indices: IntArray, x: Array) -> FileOrder:
        """Order the values of each cell by the projections of their points x (n, d) on `SORTING_DIRECTION`."""
        along = x @ np.array(SORTING_DIRECTION[: x.shape[1]])
        return cls(numbers, np.take_along_axis(indices, np.argsort(along[indices], axis=1), axis=1))

    def ordered(self, values: Array) -> Array:
        """Values (n, v) as rows (cells, k v)."""
        return values[self.order].reshape(len(self.numbers), self.width * values.shape[1])

    def put(self, out: Array, rows: Array) -> None:
        """Fill `out` (n, v) from rows (cells, k v): the inverse of `ordered`."""
        out[self.order.ravel()] = rows.reshape(self.order.size, out.shape[1])


# An irrational direction: points of a facet have distinct projections on it, so that their order depends on no rank.
SORTING_DIRECTION = (0.5403023058681398, 0.2926817141205163, 0.7890437903507289)


class Part(ABC):
    """A part of the balance of forces. All methods are collective.

    A step starts with `begin`. A solver then tries unknowns: it passes the displacements to `evaluate`, and all other
    methods refer to the last evaluation. `commit` is called once, when the step is accepted. Four methods are
    compulsory: `evaluate`, `add_forces`, `tangents` and `commit`. A part with the methods of `SwitchesPhases` or of
    `MeasuresError` has this ability, too.

    Attributes:
        key: name of the part's memory, energy and unknowns, in states and in files.
        traits: properties of the part.
        failed: number of points on all ranks at which the last evaluation failed.
        K: matrix of the forces that are linear in the displacements; None: there is no such matrix.
        field: own unknowns of a `FieldPart`; None for other parts.
        distance: largest prescribed distance of bodies, such as an initial gap: displacements have rounding errors of
            its size.
        cancelling: norm of the diagonal of a stiffness that is not in K and acts on differences of displacements.
        stress_width: number of stress components that states keep at each point of the memory.
        interval: the present step.

    Raises:
        InputError: when a subclass is defined: a method's name is nearly that of an optional method, or only some
            methods of an ability are defined.
    """

    key: str
    traits = PartTraits()
    failed: int = 0
    K: PETSc.Mat | None = None
    field: fem.Function | None = None
    distance: float = 0.0
    cancelling: float = 0.0
    stress_width: int = 0
    interval: TimeStep

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        accept_renamed(cls, {"ease": "set_homotopy", "own_held": "own_prescribed"})
        abilities, members = [_public_names(kind) for kind in (SwitchesPhases, MeasuresError)], vars(cls)
        expected = set[str]().union(*abilities, *map(_public_names, cls.__mro__[1:]))
        for name in sorted(_public_names(cls) - expected):
            if callable(members[name]) or isinstance(members[name], property):
                for meant in get_close_matches(name, expected - members.keys(), 1, MISSPELT_SIMILARITY):
                    raise InputError(f"{cls.__name__} defines {name!r}; did you mean {meant!r}?")
        for names in abilities:
            missing = names.difference(dir(cls))
            if missing and missing != names:
                raise InputError(f"{cls.__name__} has {min(names - missing)!r} without {min(missing)!r}; define both")

    def begin(self, interval: TimeStep) -> None:
        """Begin a step from the configuration `interval.old`."""
        self.interval = interval

    def add_fixed(self, out: PETSc.Vec) -> None:
        """Add the nodal forces that do not depend on the unknowns of the step."""

    def at_time(self, t: float) -> None:
        """Set the parameters to their values at time t; InputError: a parameter is out of range."""

    def parameters(self) -> list[Array]:
        """The arrays on this rank that vary in time, at the time of the last `at_time`."""
        return []

    def set_homotopy(self, parameter: float) -> None:
        """Set the law to the homotopy law of a continuation parameter: 0 is the law itself, 1 an elastic law."""

    @abstractmethod
    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        """Take the displacements u at the end of the step, and mid = old + theta (u - old), at which forces balance.

        The caller owns both functions and leaves them unchanged until the next evaluation.
        """

    def failure(self) -> str:
        """Text that says what failed in the last evaluation and where; "" if nothing failed."""
        return ""

    @abstractmethod
    def add_forces(self, out: PETSc.Vec) -> float:
        """Add the nodal forces of the last evaluation; return their norm if it enters the force scale, else 0."""

    def add_work_in(self, z: fem.Function, out: PETSc.Vec) -> None:
        """Add the work of the last stresses in displacements z, distributed to nodes; by default nodal forces times z."""
        forces = out.duplicate()
        forces.set(0.0)
        self.add_forces(forces)
        forces.pointwiseMult(forces, z.x.petsc_vec)
        out.axpy(1.0, forces)
        forces.destroy()

    def add_forces_in(self, state: Configuration, out: PETSc.Vec) -> None:
        """Add the nodal forces of the stresses of bodies in a state, for the error of a step."""

    @abstractmethod
    def tangents(self, relative_residual: float) -> list[Block]:
        """Tangent blocks of the last evaluation: derivatives of the forces, and of the part's own equations.

        They are derivatives by the unknowns at the end of the step.

        Args:
            relative_residual: norm of the last residual divided by the forces; 0 unless a tangent may be singular.
        """

    def resisting(self, relative_residual: float, rounding: PETSc.Vec) -> list[Block]:
        """Tangent blocks that resist rigid motions; a nodal force of at most `rounding` at its node counts as zero."""
        return self.tangents(relative_residual)

    @abstractmethod
    def commit(self) -> StepOutcome:
        """Energies and memory at the end of the step, for the last evaluation."""

    def undeclared_softening(self) -> Softening | None:
        """A law whose stress falls in the last evaluation without the trait `softens`; None: there is no such law."""
        return None

    def rest(self) -> Memory | None:
        """Memory at rest; None: the part has no memory.

        It is an array (n, values) at entities such as points or vertices, which files keep in the `file_order`. Or it
        is a mapping from names to functions on the model's mesh, such as velocities, which files keep cell by cell.
        """
        return None

    @property
    def file_order(self) -> FileOrder | None:
        """The order in files of a memory that is an array."""
        return None

    def named(self) -> dict[str, PartTraits]:
        """Traits by the names that error messages use: names of laws, or of the part itself."""
        return {f"the part {self.key!r}": self.traits}

    def diagonal_at_rest(self) -> PETSc.Vec | None:
        """Diagonal of the tangent at rest of bodies that are not in K, a scale of forces; the caller destroys it."""
        return None

    def takes_time(self) -> str:
        """Name of a law whose response depends on the length of the step; "" without such a law."""
        return ""

    def answers_at_once(self, times: Sequence[float]) -> tuple[str, bool] | None:
        """Name of a law with a non-linear instantaneous response; None: there is no such law.

        The second value is whether parameters that vary in time are the reason.
        """
        return next(((name, False) for name, has in self.named().items() if has.nonlinear and not has.rate), None)

    def destroy(self) -> None:
        """Free the matrices."""


@runtime_checkable
class SwitchesPhases(Protocol):
    """Ability of a part whose columns switch phases."""

    def excess(self) -> float:
        """Largest gain of energy by a change of phase in a column."""

    def switch(self) -> bool:
        """Change columns to the phases of lowest energy in the last evaluation; return whether any column changed."""


@runtime_checkable
class MeasuresError(Protocol):
    """Ability of a part to measure its strains or jumps, for the error of a step."""

    def error_measure(self, u: fem.Function) -> Array:
        """Strains or jumps (n,) at u; the sum of their squares is an integral."""

    def unit_jump_measure(self) -> float:
        """Estimate of this sum for a unit jump across the layer."""


def _public_names(kind: type) -> set[str]:
    """Public names that a class itself defines."""
    return {name for name in vars(kind) if not name.startswith("_")}


class FieldPart(Part):
    """A part with its own unknowns in addition to the displacements, such as a pressure or a mean strain.

    Attributes:
        field: the own unknowns, in the solver's units.
        unit: value in states divided by value of the unknown.
        load: prescribed forces (own_size,) in the part's own equations; `own_residual` subtracts them.
        on_S: whether the own unknowns are on S, so that block preconditioners suit them.
        hint: clause for error messages that says how the part may make a linear solve fail; "" if it does not.
    """

    field: fem.Function
    unit: float = 1.0
    load: Array
    on_S: bool = False
    hint: str = ""

    def begin(self, interval: TimeStep) -> None:
        super().begin(interval)
        self.load, theta = self.load_at(interval.t), interval.theta
        if theta < 1:
            self.load = theta * self.load + (1 - theta) * self.load_at(interval.old.t)

    @abstractmethod
    def own_residual(self) -> Array:
        """Residual of the part's own equations on this rank, for the last evaluation."""

    def load_at(self, t: float) -> Array:
        """Prescribed forces (own_size,) in the own equations at time t."""
        return np.zeros(self.own_size)

    def at_time(self, t: float) -> None:
        """As in `Part`."""
        self._t = t

    def parameters(self) -> list[Array]:
        """Prescribed forces and prescribed own unknowns at the time of the last `at_time`."""
        return [self.load_at(self._t), self.own_prescribed(self._t)[1]]

    def own_start(self, old: Configuration) -> Array:
        """Own unknowns on this rank at the start of a step from `old`."""
        values = old.fields.get(self.key)
        return np.zeros(self.own_size) if values is None else np.asarray((values.x.array / self.unit)[: self.own_size])

    def own_prescribed(self, t: float | None) -> tuple[IntArray, Array]:
        """Numbers of this rank's prescribed own unknowns, and their values at time t; 0 if t is None."""
        return np.empty(0, np.int64), np.empty(0)

    def _strain_forces(self, over: StepStrains, form: fem.Form | None) -> tuple[Array, Array]:
        """Forces (own_size,) of prescribed strains in the own equations, at the end and at the start of the step.

        Args:
            over: the prescribed strains.
            form: linear form of the strains `over.now`; None: there are none.
        """
        old = self.interval.old
        over.look_at(self.interval.t)
        new = assemble_values(form, self.own_size)
        over.look_at(old.t, at_rest=old.at_rest)
        return new, assemble_values(form, self.own_size)

    def own_result(self) -> fem.Function:
        """Own unknowns at the end of the step, in the units of the state, for the last evaluation."""
        values = self.field.copy()
        values.x.array[:] *= self.unit
        return values

    @property
    def own_size(self) -> int:
        """Number of own unknowns of this rank."""
        dofmap = self.field.function_space.dofmap
        return int(dofmap.index_map.size_local * dofmap.index_map_bs)

    @property
    @abstractmethod
    def own_file_order(self) -> FileOrder:
        """Order of the own unknowns in files, ghosts included."""


__getattr__ = former_names(__name__, {"Interval": TimeStep, "Outcome": StepOutcome})
