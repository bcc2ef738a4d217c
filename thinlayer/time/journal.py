"""The journal of a march: it adds accepted states to the history, observes, writes and reads them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from forms.base import InputError, ThinlayerError
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.parts.phases import phase_shares, seams_with_phases
from thinlayer.solving.equations import Equations
from thinlayer.solving.history import History, dissipated_columns, phase_columns
from thinlayer.system.identity import Resume, code_of, described
from thinlayer.system.progress import logger
from thinlayer.system.ranks import collect, on_all
from thinlayer.system.table import Row
from thinlayer.time.checkpoint import Checkpoint, Pace

Observe = Mapping[str, Callable[[State], float]]
OBSERVING = "it must be a function of a state that returns a number"
COLUMNS = ("t", "dt", "iterations", "residual", "supplied", "stored", "dissipated", "remainder", "imbalance")
# Largest relative difference of an observed value between ranks. Rounding is much smaller; values of one rank's part of the
# mesh differ by more.
SAME_VALUE = 1e-6


class Journal:
    """Keeps the accepted states of a march. All methods are collective.

    Args:
        equations: the equations of the model.
        observe: name of a column -> function of a state.
        keep: "all": keep all states; "last": keep only the last one.
        out: folder for the table and the files from which to resume; None: no files.
        pace: pace of the first step.
        choices: further arguments of the march that must be the same to resume it.
        directed: True: the next step depends on the direction of the last one, so that two states are kept.

    Attributes:
        history: the accepted states.
        pace: the pace of the next step; written with the states.
        before: the state before the last, if the march is directed.
    """

    def __init__(
        self,
        equations: Equations,
        observe: Observe,
        keep: str,
        out: Path | None,
        pace: Pace,
        choices: Mapping[str, Any],
        *,
        directed: bool = False,
    ) -> None:
        self.model, self._equations = equations.model, equations
        names = self.model.comm.bcast([*observe])  # one order of the columns on all ranks
        self._observe, self._keep, self.out = {name: observe[name] for name in names}, keep, out
        self._directed = directed
        self._log = logger("march", self.model.comm)
        self.before: State | None = None
        # of observing functions it is known by what stays as they collect values
        observed = {name: code_of(described(function)) for name, function in self._observe.items()}
        mark = json.loads(json.dumps({**self.model.identity(), "observe": observed, **choices}))
        self._checkpoint = Checkpoint(out, equations, mark, 2 if directed else 1) if out else None
        self._written = 0
        self.history, self.pace = History(self.model, theta=float(choices["theta"])), pace

    def read(self, resume: Resume) -> bool:
        """Take over the march in the folder. False: there is no march, or `resume` is False.

        Raises:
            InputError: the folder has another march, or files that are damaged and to be resumed.
        """
        pace = self._checkpoint.read(self.history, self._keep, resume) if self._checkpoint else None
        if pace is None:
            return False
        self.pace = pace
        self._written = len(self.history)
        states, last = self.history.states, len(self.history) - 1
        if self._directed:
            self.before = states.get(last - 1)
            if self._keep == "last":
                self.history.states = {last: states[last]}
        return True

    def start(self, before: State | None, last: State) -> None:
        """Start from a state that another march has found, and from the one before it, which tells the direction."""
        self.note(last)
        self.before = before

    def accept(self, states: list[State]) -> None:
        """Add states to the history and write them."""
        for state in states:
            self.note(state)
        if self._checkpoint:
            self._checkpoint.write(self.history, self.pace, self._written, self.before)
            self._written = len(self.history)
        collect(self._equations.comms)

    def note(self, state: State) -> None:
        """Add a row and a state to the history; the next `accept` writes them."""
        before, report = self.history.last if self.history.states else None, state.report
        found = state.t, report.method, report.iterations, report.residual
        self._log.info("t = %g: %s, %d steps, residual %.1e", *found)
        row = self._row(state, state.t - before.t if before else 0.0)
        self.history.table.append({name: row[name] for name in self.history.table.columns or row})
        if self._directed:
            self.before = before
        if self._keep == "last":
            self.history.states.clear()
        self.history.states[len(self.history) - 1] = state

    def _row(self, state: State, dt: float) -> Row:
        values: dict[str, Any] = {"t": state.t, "dt": dt}
        for name in COLUMNS[len(values) :]:
            values[name] = getattr(state.report if hasattr(state.report, name) else state.audit, name)
        values |= {column: state.dissipated[seam] for column, seam in dissipated_columns(self.model).items()}
        if seams := seams_with_phases(self.model):
            values["energy"] = state.audit.total
        for seam in seams:
            shares = phase_shares(state, seam)
            values |= {column: shares[name] for name, column in phase_columns(self.model, seam).items()}
        known = {name: None if math.isnan(value) else value for name, value in values.items()}
        return known | {name: self._observed(name, state) for name in self._observe}

    def _observed(self, name: str, state: State) -> float:
        """The value of an observing function on rank 0. InputError: the function fails, or ranks find other values."""
        comm, place = self.model.comm, f"observe[{name!r}] at t = {state.t:g}"
        try:
            with on_all(comm):
                found = self._observe[name](state)
                if np.iscomplexobj(found):
                    raise TypeError(f"it gives {found!r}, no real number")
                value = float(found)
        except Exception as error:
            raise InputError(f"{place}: {_problem(error)}") from error
        values = np.array(comm.allgather(value))
        if not np.allclose(values, values[0], rtol=SAME_VALUE, atol=0.0, equal_nan=True):
            numbers = ", ".join(f"{value:.6g}" for value in values)
            advice = "let the function return the sum, or the largest, of the values of all ranks"
            raise InputError(f"{place}: the ranks find {numbers}; {advice}")
        return float(values[0])


def columns(model: Model) -> set[str]:
    """Names of the columns of a march beside those that are observed."""
    of_phases = [phase_columns(model, seam).values() for seam in seams_with_phases(model)]
    energy = ["energy"] if of_phases else []
    return {*COLUMNS, *energy, *dissipated_columns(model)}.union(*of_phases)


def _problem(error: Exception) -> str:
    """Text of an error in an observing function; errors of thinlayer already say what is allowed."""
    if isinstance(error, ThinlayerError):
        return str(error)
    kind = "" if isinstance(error, (TypeError, ValueError)) else f"{type(error).__name__}: "
    return f"{kind}{error}; {OBSERVING}"
