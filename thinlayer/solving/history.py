"""History: the accepted steps of a march."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from forms.base import Array, InputError, is_number, require
from thinlayer.discretisation.layer import BODIES
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.parts.phases import seams_with_phases
from thinlayer.system.table import Table

SAME_TIME = 1e-9  # largest difference of times that count as equal, relative to the span of a march


@dataclass(frozen=True)
class Snap:
    """A jump of a layer and its bodies to another equilibrium at the same loads.

    Attributes:
        t: time of the snap.
        row: row of the state after the snap; the row before has the state just before it (if `keep` is "all").
        lost: energy lost in the snap.
        seams: names of the seams whose layers have other shares of phases after it.
    """

    t: float
    row: int
    lost: float
    seams: tuple[str, ...]


def dissipated_columns(model: Model) -> dict[str, str]:
    """Column of what the layer of a seam dissipates in a step -> its name; for layers that remember, of several seams.

    If bodies remember there is a column "dissipated bodies" too. What is lost in a snap, by layers and bodies together, is
    in the column "dissipated" alone.
    """
    seams = {name for name, one in model.layers.items() if one.remembers}
    return {f"dissipated {name}": name for name in model.by_place({}) if name in {*seams, BODIES}}


def phase_columns(model: Model, seam: str) -> dict[str, str]:
    """Name of a share of `phase_shares` of a seam -> its column, which has the seam's name if several have phases."""
    of_seam = f" {seam}" if len(seams_with_phases(model)) > 1 else ""
    return {name: name + of_seam for name in ("plus", "minus", "boundary")}


@dataclass(repr=False)
class History:
    """The accepted steps of a march.

    Attributes:
        model: the model.
        table: a row for each accepted state: t, dt, iterations, residual, energy balance (`Audit`), observed values.
        states: row -> state, for the states that are kept.
        theta: forces balance at t + theta dt of each step.
        step_errors: "displacements", "jumps", "forces" -> estimated relative error of the last state by the planned steps;
            0 if nothing was dissipated, NaN if it is not known, empty for laws that are linear or have no history, for
            adaptive steps and for paths.
    """

    model: Model
    table: Table = field(default_factory=Table)
    states: dict[int, State] = field(default_factory=dict)
    theta: float = 1.0
    step_errors: dict[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        span = f", t = {self.t[0]:g} to {self.t[-1]:g}" if self.table.rows else ""
        return f"History({self.model!r}, {len(self)} steps{span}, {len(self.states)} states)"

    def identity(self) -> dict[str, Any]:
        """The model's identity and the times."""
        return {"history of": self.model.identity(), "t": self.t.tolist()}

    def __len__(self) -> int:
        return len(self.table)

    def __iter__(self) -> Iterator[State]:
        return iter(self.states.values())

    @property
    def last(self) -> State:
        """State of the last accepted step. InputError: there is none."""
        if not self.states:
            raise InputError("the march has no accepted state: its first one failed")
        return self.states[max(self.states)]

    @property
    def t(self) -> Array:
        """Times of all accepted states."""
        return self.table["t"] if self.table.rows else np.empty(0)

    @property
    def snaps(self) -> list[Snap]:
        """The snaps of a layer whose columns switch phase, in order of time: rows after the first with dt = 0.

        Switches by a sudden load at the start are no snaps; the first row is the state after them.
        """
        if not self.table.rows:
            return []
        t, dt, lost = (self.table[name] for name in ("t", "dt", "dissipated"))
        rows = [int(k) for k in np.flatnonzero(dt == 0) if k > 0]
        return [Snap(float(t[k]), k, float(lost[k]), self._changed(k)) for k in rows]

    def _changed(self, row: int) -> tuple[str, ...]:
        """The seams whose layers have other shares of phases in a row than in the one before it."""
        shares = {
            seam: [self.table[phase_columns(self.model, seam)[name]][row - 1 : row + 1] for name in ("plus", "minus")]
            for seam in seams_with_phases(self.model)
        }
        return tuple(seam for seam, both in shares.items() if np.diff(both).any())

    def at(self, t: float) -> State:
        """The state at a time, the last of several. InputError: no step ended there, or its state was not kept."""
        require(is_number(t) and math.isfinite(t), "t", t, "it must be a finite number")
        near = SAME_TIME * max(abs(t), float(np.ptp(self.t)))
        rows = [row for row in self.states if abs(self.states[row].t - t) <= near]
        if not rows:
            kept = ", ".join(f"{state.t:g}" for state in self)
            raise InputError(f"no state at t = {t:g} is kept; there are states at {kept}")
        return self.states[rows[-1]]


Solution = State | History
