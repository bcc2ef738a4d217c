"""The accepted steps of a march, their table, and its columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

import numpy as np

from forms.base import Array, InputError, is_finite, require
from forms.tensors import Expr
from thinlayer.discretisation.coefficient import Coordinates, HandedField
from thinlayer.discretisation.layer import BODIES
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State, scalar_field_on
from thinlayer.discretisation.time_functions import FieldInTime
from thinlayer.surface.law_points import layer_shares, seams_with_shares, share_columns
from thinlayer.system.table import Table

TIME_TOLERANCE = 1e-9  # largest difference of times that count as equal, relative to the span of a march
ENERGY_COLUMNS = ("supplied", "stored", "dissipated", "remainder", "imbalance")


@dataclass(frozen=True)
class Snap:
    """A sudden change of a layer and its bodies to another equilibrium, while time and loads stay the same.

    Attributes:
        t: time of the snap.
        row: number of the row in the march's table that has the state after the snap. The previous row has the state
            just before it. That state is stored if the march was called with `keep` = "all".
        lost: energy lost in the snap.
        seams: names of the seams in whose layers volume fractions change: those of phases, or of broken material.
    """

    t: float
    row: int
    lost: float
    seams: tuple[str, ...]


@dataclass(repr=False)
class History:
    """The accepted steps of a march: their table, and those states that are kept.

    Attributes:
        model: the model.
        table: a row for each accepted state, with columns t, dt, iterations, residual, energies of the balance
            (`Audit`) and observed values.
        states: number of a table row -> state, for the states that are kept.
        theta: fraction of each time step after which forces balance.
        step_errors: "displacements", "jumps" or "forces" -> largest error of the kept states, estimated, that is due to
            the length of the time steps, over the largest norm. It is 0 if no energy was dissipated, and NaN if it is
            unknown. The dictionary is empty for laws that are linear or have no history, for adaptive steps and for
            arc-length continuation.
        begun: True: the march began at a given state, which is its first one. False: it began at rest.

    Example:
        >>> from forms import LinearElastic, Maxwell
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, march
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> resin = Maxwell(lmbda=800.0, mu=400.0, t1=20.0)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> history = march(plates.interface(ThinLayer(resin, eps=0.05)), times=[1, 2, 4])
        >>> history
        History(InterfaceModel(Q2, 476 unknowns), 4 steps, t = 0 to 4, 4 states)
        >>> history.t
        array([0., 1., 2., 4.])
        >>> f"{history.at(2).energies()['layer']:.3g}"
        '0.0102'
    """

    model: Model
    table: Table = field(default_factory=Table)
    states: dict[int, State] = field(default_factory=dict)
    theta: float = 1.0
    step_errors: dict[str, float] = field(default_factory=dict)
    begun: bool = False

    def __repr__(self) -> str:
        span_text = f", t = {self.t[0]:g} to {self.t[-1]:g}" if self.table.rows else ""
        return f"History({self.model!r}, {len(self)} steps{span_text}, {len(self.states)} states)"

    def field_on(self, at: Coordinates) -> Expr:
        """Return the scalar field of the states as UFL on the mesh of another model, linear in time. Collective.

        Raises:
            InputError: states were not kept, or times occur twice.
        """
        if len(self.states) < max(len(self), 2) or (np.diff(self.t) <= 0).any():
            raise InputError(f"{self!r} is no field in time: give a march of two states or more, with keep='all'")
        fields = [scalar_field_on(state, at.domain) for state in self]
        if not isinstance(fields[0], HandedField):
            raise InputError(f"{self!r} is of another joint; make both models from one joint, or hand over a state")
        return FieldInTime(fields, self.t, at.clock)

    def identity(self) -> dict[str, Any]:
        """Return data that identify the history: those of its model (`Model.identity`), and the times of its states."""
        return {"history of": self.model.identity(), "t": self.t.tolist()}

    def __len__(self) -> int:
        return len(self.table)

    def __iter__(self) -> Iterator[State]:
        return iter(self.states.values())

    @property
    def last(self) -> State:
        """State at the end of the last accepted step. InputError if no step was accepted."""
        if not self.states:
            raise InputError("the march has no accepted state: its first one failed")
        return self.states[max(self.states)]

    @property
    def t(self) -> Array:
        """Times of all accepted states, (rows,)."""
        return self.table["t"] if self.table.rows else np.empty(0)

    @property
    def snaps(self) -> list[Snap]:
        """Snaps of layers with phases, in order of time: one for each table row with dt = 0, except the first row.

        A phase is a branch of a law whose stress is not monotone. The first row may contain changes of phase under a
        sudden load at the start, which are not snaps.
        """
        if not self.table.rows:
            return []
        t, dt, lost = (self.table[name] for name in ("t", "dt", "dissipated"))
        row_numbers = [int(k) for k in np.flatnonzero(dt == 0) if k > 0]
        return [Snap(float(t[k]), k, float(lost[k]), self._changed_seams(k)) for k in row_numbers]

    def _changed_seams(self, row: int) -> tuple[str, ...]:
        """Return the seams in whose layers volume fractions differ between table rows `row` - 1 and `row`."""
        before, after = (self.table.rows[k] for k in (row - 1, row))
        changed_columns = {column for column in after if after[column] != before[column]}
        seams = seams_with_shares(self.model)
        return tuple(seam for seam in seams if changed_columns & {*fraction_columns(self.model, seam).values()})

    def at(self, t: float) -> State:
        """Return the state at time `t`; the last one, if several have this time.

        Raises:
            InputError: `t` is not finite, no step ended at this time, or its state was not kept.
        """
        require(is_finite(t), "t", t, "it must be a finite number")
        tolerance = TIME_TOLERANCE * max(abs(t), float(np.ptp(self.t)))
        for state in reversed(self.states.values()):
            if abs(state.t - t) <= tolerance:
                return state
        times_text = ", ".join(f"{state.t:g}" for state in self)
        raise InputError(f"no state at t = {t:g} is kept; there are states at {times_text}")


Solution = State | History


def state_at(solution: Solution, t: float | None) -> State:
    """Return the state of a history at a time, or its last one for None; a state is returned as it is.

    Raises:
        InputError: the history has no state at this time, or the state has another time.
    """
    if isinstance(solution, History):
        return solution.last if t is None else solution.at(t)
    if t is not None and not abs(solution.t - t) <= TIME_TOLERANCE * max(abs(solution.t), abs(t)):
        text = f"a state is of t = {solution.t:g}, not of t = {t:g}"
        raise InputError(f"{text}; give the history of a march, for `fit` by run=")
    return solution


# ---------------------------------------------------------------- columns
def column_getters(model: Model) -> dict[str, Callable[[State], float]]:
    """Return the columns of a march's table: name of a column -> function that returns its value in a state.

    Columns "dt" and observed values are missing here. The column "dissipated" has the energy that all layers and bodies
    dissipate in a step. It includes the energy lost in a snap.

    With several seams, each layer with internal variables has a column for its own dissipated energy. So have the
    bodies, if they have internal variables. These columns do not contain the energy lost in a snap. If a law has an
    `elastic_fraction`, the column "elastic share" has the fraction of the load in the springs parallel to it.
    """
    attributes = ("t", "report.iterations", "report.residual", *(f"audit.{name}" for name in ENERGY_COLUMNS))
    getters: dict[str, Callable[[State], float]] = {name.rpartition(".")[2]: attrgetter(name) for name in attributes}
    with_memory = {BODIES, *(name for name, layer in model.layers.items() if layer.remembers)}
    for place in (name for name in model.sums_by_seam_and_bodies({}) if name in with_memory):
        getters[f"dissipated {place}"] = lambda state, place=place: state.dissipated[place]  # type: ignore[misc]
    if any("elastic_fraction" in term.law.parameters() for term in model.terms):
        getters["elastic share"] = attrgetter("elastic_share")
    for seam in seams_with_shares(model):
        getters["energy"] = attrgetter("audit.total")
        for name, column in fraction_columns(model, seam).items():
            getters[column] = lambda state, seam=seam, name=name: layer_shares(state, seam)[name]  # type: ignore[misc]
    return getters


def fraction_columns(model: Model, seam: str) -> dict[str, str]:
    """Return the columns of a layer's volume fractions: name of a fraction in `layer_shares` -> its column.

    Args:
        model: the model.
        seam: name of the layer's seam. It is part of the column's name if several seams have such columns.
    """
    suffix = f" {seam}" if len(seams_with_shares(model)) > 1 else ""
    return {name: name + suffix for name in share_columns(model.layers[seam].law)}
