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
from thinlayer.errors import make_module_getattr
from thinlayer.pointwise.quadrature import assemble_values

Memory = Array | Mapping[str, fem.Function]  # (n, values) at entities, or functions by name
Softening = tuple[str, str]  # name of a law whose stress falls, and the place
DISPLACEMENT_KEY = "u"  # the key of the unknowns that all parts share
RENAMED_METHODS = {  # names of version 1.0 -> present names
    "takes_time": "relaxing_law_name", "answers_at_once": "instantaneous_nonlinear_law", "named": "law_traits",
    "add_fixed": "add_constant_forces", "resisting": "reliable_tangents", "at_time": "set_time", "excess": "phase_gain",
    "switch": "switch_phases", "load_at": "own_load_at", "own_start": "own_values_before"}  # fmt: skip
MISSPELT_SIMILARITY = 0.9  # ratio of two names (difflib) from which on one counts as the other misspelt


@dataclass(frozen=True)
class TimeStep:
    """Time step from the configuration `old`, at time old.t, to the time t = old.t + dt.

    The configuration has the displacements, the memory and all other unknowns at its time. Forces balance at the time
    old.t + theta dt. For theta = 1 that is the end of the step.
    """

    old: Configuration
    t: float
    dt: float
    theta: float

    @property
    def balance_time(self) -> float:
        """The time old.t + theta dt at which forces balance; for theta = 1 exactly t, without rounding."""
        return self.t - (1 - self.theta) * self.dt


@dataclass(frozen=True)
class PartTraits:
    """Properties of a part of the balance of forces, as flags; `a | b` has each flag that a or b has.

    Attributes:
        rate: the forces depend on velocities or strain rates. The solver `march` then begins at rest, and `solve`
            refuses the part.
        inert: the part has mass. The solver `march` then begins with accelerations that balance the loads, and `solve`
            leaves mass out, as steps without duration have no inertia but that of given accelerations.
        remembers: the forces depend on the history before the step.
        nonlinear: the forces are not proportional to the displacements.
        bounded: stresses are bounded, so that loads may have a limit.
        softens: stresses fall as jumps grow, so that loads may have several equilibria.
        weakens: forces may grow less than the tangent predicts. The part flows, yields or softens, or its tangent may
            vanish.
        releases: the part may resist a body in one step and release it in the next, as contact does.
        singular: the tangent may be singular for some strains although there is an energy.
        saddle: the tangent, with supports applied, may have eigenvalues of both signs.
        has_homotopy: the part has laws for homotopy continuation, which its method `set_homotopy` selects.
        switches: quadrature points have phases, which are fixed while an equilibrium is computed, and change after it.
        within_bodies: the part acts within bodies alone, so that rigid motions of a whole body cause no forces.
    """

    rate: bool = False
    inert: bool = False
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
    within_bodies: bool = False

    def __or__(self, other: PartTraits) -> PartTraits:
        return PartTraits(*(a or b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @classmethod
    def of(cls, law: Law) -> PartTraits:
        """Return the traits of a part that consists of the one law `law`."""
        shared_names = ("rate", "remembers", "bounded", "softens", "singular", "has_homotopy", "switches")
        law_traits = {name: getattr(law.traits, name) for name in shared_names}
        weakens = law_traits["rate"] or law_traits["bounded"] or law_traits["singular"] or law_traits["softens"]
        return cls(nonlinear=not law.traits.linear, weakens=weakens, **law_traits)


@dataclass(frozen=True)
class Block:
    """A matrix, times a factor, that a part adds to one block of the tangent.

    Attributes:
        matrix: the matrix.
        factor: number by which the matrix is multiplied.
        row: key of the block's equations: `DISPLACEMENT_KEY` for the balance of nodal forces, or the key of the part
            whose own equations they are.
        column: key of the unknowns by which they are differentiated: `DISPLACEMENT_KEY`, or the key of a part.
        kept: True: the part uses the matrix again; False: the caller destroys it.
    """

    matrix: PETSc.Mat
    factor: float = 1.0
    row: str = DISPLACEMENT_KEY
    column: str = DISPLACEMENT_KEY
    kept: bool = False


@dataclass(frozen=True)
class StepOutcome:
    """Energies of a part over an accepted step, and its memory at the end; NaN for energies that a law lacks.

    The memory are the internal variables, or other values that the part keeps from step to step.

    Attributes:
        before, after: energy stored at the beginning and at the end of the step.
        dissipated: energy dissipated in the step.
        remainder: error of the step's energy balance: the work of the part's forces plus `supplied`, minus the growth
            of stored energy, minus `dissipated`. It is caused by the time scheme or by varying parameters.
        memory: memory at the end of the step, of the type that `Part.rest` returns; None: the part has no memory.
        supplied: work done on the part by prescribed strains, in addition to the work of loads and supports.
        stress: (n, components) stresses at the end of the step, at the n points of the memory; None: no stresses.
        kept: whether the state stores `after` under the part's key. False if the state can compute the energy
            itself, as for laws in UFL forms.
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
    """Order in which one rank's values at cells, facets or vertices are written to files.

    Cells, facets and vertices are called entities here. A file has one row for each entity, at the entity's number in
    the joint, the undistributed mesh. Each entity has k of the rank's n values, for instance one for each quadrature
    point.

    Attributes:
        file_rows: (entities,) numbers of this rank's entities in the joint.
        value_positions: (entities, k) positions of each entity's k values among the rank's n values. Their order does not
            depend on the distribution of the mesh.
        n_owned: this rank writes the values of its first `n_owned` entities; None: of all.
    """

    file_rows: IntArray
    value_positions: IntArray
    n_owned: int | None = None

    @property
    def width(self) -> int:
        """Number k of values that each cell, facet or vertex has."""
        return int(self.value_positions.shape[1])

    @classmethod
    def by_place(cls, file_rows: IntArray, positions: IntArray, x: Array) -> FileOrder:
        """Return the order in which the values of each cell or facet are sorted by the positions of their points.

        The points are sorted by their projections on the direction `SORTING_DIRECTION`.

        Args:
            file_rows: (entities,) numbers of the cells or facets in the joint, the undistributed mesh.
            positions: (entities, k) positions, among this rank's n values, of the k values of each cell or facet,
                unsorted.
            x: (n, d) coordinates of the points of the n values; d: number of dimensions.
        """
        projections = x @ np.array(SORTING_DIRECTION[: x.shape[1]])
        return cls(file_rows, np.take_along_axis(positions, np.argsort(projections[positions], axis=1), axis=1))

    def to_rows(self, values: Array) -> Array:
        """Return this rank's `values` as the rows (entities, k v) of a file, one row for each cell, facet or vertex.

        `values` is (n, v): v numbers for each of n points. A row contains the k v numbers of the entity's k points.
        """
        return values[self.value_positions].reshape(len(self.file_rows), self.width * values.shape[1])

    def assign(self, out: Array, rows: Array) -> None:
        """Write the `rows` of a file, (entities, k v) as `to_rows` returns them, into this rank's values `out`, (n, v).

        `out` has v numbers for each of n points. A row contains the v numbers of each of the k points of a cell, facet
        or vertex.
        """
        out[self.value_positions.ravel()] = rows.reshape(self.value_positions.size, out.shape[1])


# An irrational direction: points of a facet have distinct projections on it, so that their order depends on no rank.
SORTING_DIRECTION = (0.5403023058681398, 0.2926817141205163, 0.7890437903507289)


class Part(ABC):
    """Base class of a part of the balance of forces, such as bodies, a layer, springs or contact.

    All methods are collective. A step starts with `begin`. A solver then tries values of the unknowns: it passes the
    displacements to `evaluate`. All other methods refer to this last evaluation. `commit` is called once, when the step
    is accepted.

    Subclasses must define `evaluate`, `add_forces`, `tangents` and `commit`. A part whose phases switch also defines
    the methods of `SwitchesPhases`. A part that measures time errors also defines those of `MeasuresError`.

    Attributes:
        key: name of the part's memory, energy and unknowns, in states and in files.
        traits: properties of the part.
        failed: number of points, on all ranks, at which the last evaluation failed.
        K: matrix of the forces that are linear in the displacements; None: there is no such matrix.
        field: unknowns of the part besides the displacements; None: it has none.
        distance: largest prescribed distance between bodies, such as an initial gap. The rounding error of
            displacements is at least that of this length.
        cancelling: norm of the diagonal of a stiffness that is not in K and acts on differences of displacements, such
            as jumps. The rounding error of forces follows from it.
        stress_width: number of stress components that states store at each point of the memory.
        interval: the present step.

    Raises:
        InputError: a subclass is defined in which a method has the misspelt name of an optional method. Or it defines
            only some of the methods of `SwitchesPhases` or of `MeasuresError`.
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
        accept_renamed(cls, {"ease": "set_homotopy", "own_held": "own_prescribed", **RENAMED_METHODS})
        protocol_names, members = [_public_names(protocol) for protocol in (SwitchesPhases, MeasuresError)], vars(cls)
        known_names = set[str]().union(*protocol_names, *map(_public_names, cls.__mro__[1:]))
        for name in sorted(_public_names(cls) - known_names):
            if callable(members[name]) or isinstance(members[name], property):
                for suggestion in get_close_matches(name, known_names - members.keys(), 1, MISSPELT_SIMILARITY):
                    raise InputError(f"{cls.__name__} defines {name!r}; did you mean {suggestion!r}?")
        for names in protocol_names:
            missing = names.difference(dir(cls))
            if missing and missing != names:
                raise InputError(f"{cls.__name__} has {min(names - missing)!r} without {min(missing)!r}; define both")

    def begin(self, interval: TimeStep) -> None:
        """Begin the time step `interval`; its initial data are the configuration `interval.old`."""
        self.interval = interval

    def add_constant_forces(self, out: PETSc.Vec) -> None:
        """Add to `out` those nodal forces that do not depend on the unknowns of the step; by default none."""

    def set_time(self, t: float) -> None:
        """Set the part's parameters to their values at time `t`; raise InputError if one is out of range."""

    def parameters(self) -> list[Array]:
        """Return this rank's values of parameters that vary in time, as a list of arrays; by default [].

        They are the values at the time of the last call of `set_time`.
        """
        return []

    def set_homotopy(self, parameter: float) -> None:
        """Choose a law for homotopy continuation: `parameter` 0 selects the part's own law, 1 an elastic law.

        Values in between select laws between these two.
        """

    @abstractmethod
    def evaluate(self, u: fem.Function, mid: fem.Function) -> None:
        """Compute what the other methods need at trial displacements.

        The caller does not change the functions `u` and `mid` until the next evaluation.

        Args:
            u: displacements at the end of the step.
            mid: displacements old + theta (u - old) at which forces balance; old: displacements at the beginning.
        """

    def failure(self) -> str:
        """Return a message about the first point where the last call of `evaluate` failed; "" if it failed nowhere."""
        return ""

    @abstractmethod
    def add_forces(self, out: PETSc.Vec) -> float:
        """Add the nodal forces of the last call of `evaluate` to `out`, and return a norm of them.

        Solvers compare residuals with a reference force, to which this norm contributes. A part whose forces should not
        contribute to it returns 0.
        """

    def add_work_in(self, z: fem.Function, out: PETSc.Vec) -> None:
        """Add to `out` the work of the present stresses in the displacements `z`, distributed to the nodes.

        The stresses are those of the last call of `evaluate`. By default each entry of `out` grows by a component of
        the nodal forces times that of `z`.
        """
        forces = out.duplicate()
        forces.set(0.0)
        self.add_forces(forces)
        forces.pointwiseMult(forces, z.x.petsc_vec)
        out.axpy(1.0, forces)
        forces.destroy()

    def add_forces_in(self, state: Configuration, out: PETSc.Vec) -> None:
        """Add to `out` the nodal forces of the stresses that bodies have in `state`; by default none.

        Error estimates compare these forces.
        """

    @abstractmethod
    def tangents(self, relative_residual: float) -> list[Block]:
        """Return the blocks of the tangent for the last call of `evaluate`.

        They are the derivatives of the nodal forces, and of the part's own equations, by the unknowns at the end of the
        step.

        Args:
            relative_residual: norm of the last residual over the reference force; 0 unless a tangent may be singular. A
                singular tangent is regularised in proportion to it.
        """

    def reliable_tangents(self, relative_residual: float, rounding: PETSc.Vec) -> list[Block]:
        """Return the blocks of the tangent without resistance that may be mere rounding error.

        Solvers use it to find bodies that nothing holds. By default these blocks are those of `tangents`.

        Args:
            relative_residual: norm of the last residual over the reference force.
            rounding: rounding error of each component of the nodal forces. A resistance is left out if its force is
                smaller.
        """
        return self.tangents(relative_residual)

    @abstractmethod
    def commit(self) -> StepOutcome:
        """Return energies over the accepted step, and memory (internal variables) at its end.

        They belong to the last call of `evaluate`.
        """

    def memory_forces(self, weights: Array) -> PETSc.Vec:
        """Return the derivative, by the displacements at the end of the step, of memory times weights; nodal forces.

        The memory is that at the end of the step. Derivatives of marches need this method and `pullback`.

        Args:
            weights: factors of the memory, of its shape.
        """
        raise InputError(f"derivative: the part {self.key!r} remembers; define its memory_forces and pullback")

    def pullback(self, weights: Array, z: fem.Function) -> tuple[PETSc.Vec, Array]:
        """Return derivatives of memory times weights, minus the work of the stresses in displacements z.

        They are the derivatives by the displacements at the beginning of the step, nodal forces, and by the memory
        there, of the shape of `weights`. Memory and stresses are those at the end of the step.

        Args:
            weights: factors of the memory, of its shape.
            z: the displacements.
        """
        raise InputError(f"derivative: the part {self.key!r} remembers; define its memory_forces and pullback")

    def undeclared_softening(self) -> Softening | None:
        """Find a law whose stress falls in the last call of `evaluate` although the law lacks the trait `softens`.

        Returns:
            Name of the law, and a text that says where its stress falls. None: there is no such law.
        """
        return None

    def rest(self) -> Memory | None:
        """Return the memory (internal variables) before the first step; None: the part has no memory.

        It is an array (n, values) with a row for each quadrature point or node, written to files in the order
        `file_order`. Or it maps names to functions on the model's mesh, such as velocities, which are written cell by
        cell.
        """
        return None

    @property
    def file_order(self) -> FileOrder | None:
        """Order in which the rows of the memory (internal variables) are written to files.

        None: the memory is not an array of values at points, or the part has no memory.
        """
        return None

    def law_traits(self) -> dict[str, PartTraits]:
        """Return the traits of the part's laws, each under the name of the law for error messages.

        By default these are the traits of the whole part, under a name with its key.
        """
        return {f"the part {self.key!r}": self.traits}

    def diagonal_at_rest(self) -> PETSc.Vec | None:
        """Return the diagonal of the tangent before loading, for a body whose stiffness is not in the matrix K.

        It contributes to the reference force. None: the part is no such body. The caller destroys the vector.
        """
        return None

    def relaxing_law_name(self) -> str:
        """Return the name of a law that creeps or relaxes: its response depends on the length of the step.

        The result is "" if the part has no such law.
        """
        return ""

    def instantaneous_nonlinear_law(self, times: Sequence[float]) -> tuple[str, bool] | None:
        """Find a law whose response is instantaneous and not linear.

        Args:
            times: the start, then the ends of the steps. Parameters are checked for changes at and between these times.

        Returns:
            Name of the law, and whether its parameters change in time, which makes a linear law non-linear. None: there
            is no such law.
        """
        return next(((name, False) for name, has in self.law_traits().items() if has.nonlinear and not has.rate), None)

    def destroy(self) -> None:
        """Free the part's PETSc objects."""


@runtime_checkable
class SwitchesPhases(Protocol):
    """Methods of a part of a layer whose columns have phases: branches of a non-monotone law, which may switch.

    A column is a facet of S or, in a meshed layer, the cells above each other through the thickness.
    """

    def phase_gain(self) -> float:
        """Return the largest energy that a column would lose by a change of phase, as a number without unit.

        The energy is divided by that of the transformation, a parameter of the law. If the number is positive, a column
        must change its phase.
        """

    def switch_phases(self) -> bool:
        """Change each column to its phase of lowest energy, and return whether a column changed.

        Energies are those of the last call of `evaluate`.
        """


@runtime_checkable
class MeasuresError(Protocol):
    """Methods of a part that gives its strains or jumps to estimates of the time step's error."""

    def error_measure(self, u: fem.Function) -> Array:
        """Return this rank's strains or jumps (n,) at displacements `u`, times square roots of quadrature weights.

        So the sum of the squares of all entries is the integral of the squared strains or jumps.
        """

    def unit_jump_measure(self) -> float:
        """Estimate the sum of squares of `error_measure`, over all ranks, for a jump of 1 across the layer.

        The result shows how large `error_measure` is for jumps of a given size.
        """


def _public_names(owner: type) -> set[str]:
    """Return the public names that the body of the class `owner` defines, without inherited ones."""
    return {name for name in vars(owner) if not name.startswith("_")}


class FieldPart(Part):
    """Part with unknowns and equations of its own besides the displacements, such as a pressure or a mean strain.

    Attributes:
        field: the part's own unknowns, divided by `unit`. This scaling gives their equations the unit of forces.
        unit: factor by which `field` is multiplied before a state stores it.
        load: (own_size,) forces prescribed in the part's own equations; `own_residual` subtracts them.
        on_S: whether the part's own unknowns are on S; block preconditioners suit them then.
        hint: text for error messages that says why the part may make a linear solve fail; "": none.
    """

    field: fem.Function
    unit: float = 1.0
    load: Array
    on_S: bool = False
    hint: str = ""

    def begin(self, interval: TimeStep) -> None:
        super().begin(interval)
        self.load, theta = self.own_load_at(interval.t), interval.theta
        if theta < 1:
            self.load = theta * self.load + (1 - theta) * self.own_load_at(interval.old.t)

    @abstractmethod
    def own_residual(self) -> Array:
        """Return this rank's residual (own_size,) of the part's own equations, one entry for each of its own unknowns.

        It is that of the last call of `evaluate`.
        """

    def own_load_at(self, t: float) -> Array:
        """Return the forces (own_size,) that are prescribed in the part's own equations at time `t`; by default 0.

        There is one for each of the part's own unknowns on this rank.
        """
        return np.zeros(self.own_size)

    def set_time(self, t: float) -> None:
        """Set the time `t` of the values that `parameters` returns."""
        self._t = t

    def parameters(self) -> list[Array]:
        """Return two arrays at the time set by `set_time`, on this rank.

        The first contains the forces prescribed in the part's own equations, the second the values of its prescribed
        unknowns.
        """
        return [self.own_load_at(self._t), self.own_prescribed(self._t)[1]]

    def own_values_before(self, old: Configuration) -> Array:
        """Return this rank's values (own_size,) of the part's own unknowns, such as pressures, at the start of a step.

        They are taken from the configuration `old` and divided by `unit`; zeros if `old` does not contain them.
        """
        values = old.fields.get(self.key)
        return np.zeros(self.own_size) if values is None else np.asarray((values.x.array / self.unit)[: self.own_size])

    def own_prescribed(self, t: float | None) -> tuple[IntArray, Array]:
        """Return which of the part's own unknowns are prescribed, and their values at time `t`.

        By default none is prescribed.

        Args:
            t: time. None: the values that are returned are zeros.

        Returns:
            Local numbers (k,) of the prescribed unknowns, and their k values.
        """
        return np.empty(0, np.int64), np.empty(0)

    def _strain_forces(self, strains: StepStrains, form: fem.Form | None) -> tuple[Array, Array]:
        """Return the terms of prescribed strains in the part's own equations, at the end and at the start of the step.

        Each of the two arrays has one entry for each of the part's own unknowns on this rank.

        Args:
            strains: the prescribed strains over the step. The method changes the time of `strains.now`.
            form: linear form of the prescribed strains `strains.now`; None: no strains are prescribed.
        """
        old = self.interval.old
        strains.set_now(self.interval.t)
        new = assemble_values(form, self.own_size)
        strains.set_now(old.t, at_rest=old.at_rest)
        return new, assemble_values(form, self.own_size)

    def own_result(self) -> fem.Function:
        """Return the part's own unknowns at the end of the step as a function, `field` times `unit`, for the state."""
        values = self.field.copy()
        values.x.array[:] *= self.unit
        return values

    @property
    def own_size(self) -> int:
        """Number of the part's own unknowns, those besides displacements, that this rank owns."""
        dofmap = self.field.function_space.dofmap
        return int(dofmap.index_map.size_local * dofmap.index_map_bs)

    @property
    @abstractmethod
    def own_file_order(self) -> FileOrder:
        """Order in which the part's own unknowns, those besides displacements, are written to files, with ghosts."""


__getattr__ = make_module_getattr(__name__, {"Interval": TimeStep, "Outcome": StepOutcome})
