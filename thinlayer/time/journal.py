"""Journal of a march: adds accepted states to its history, evaluates functions of users, writes and reads files."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from forms.base import InputError, ThinlayerError
from thinlayer.discretisation.state import State
from thinlayer.solving.equations import Equations
from thinlayer.solving.history import History, column_getters
from thinlayer.system.fingerprint import Resume, code_part, describe
from thinlayer.system.progress import logger
from thinlayer.system.ranks import errors_on_all, free_petsc_objects
from thinlayer.system.table import Row
from thinlayer.time.checkpoint import Checkpoint, Pace

Observers = Mapping[str, Callable[[State], float]]
OBSERVER_HINT = "it must be a function of a state that returns a real number"
# Largest relative difference of an observed value between ranks. Rounding is much smaller; values from one rank's part
# of the mesh alone differ by more.
OBSERVED_TOLERANCE = 1e-6


@dataclass(eq=False)
class Journal:
    """Record of the accepted states of a march, which also writes and reads its files. All methods are collective.

    Attributes:
        equations: the equations of the model.
        arguments: name of an argument of the march -> its value; among them are "start" and "theta". A march can only
            be resumed with the same values.
        observe: name of a column of the table -> function of a state that returns a number.
        keep: "all": keep all states; "last": keep only the last one.
        out: folder for the table and the files from which to resume; None: no files.
        history: table and states of the march so far.
        pace: data from which the length of the next step follows; written to the files.
        previous: the state before the last one, from which the direction of a path follows; None: there is none.
        start: time of the first state.
    """

    equations: Equations
    arguments: Mapping[str, float | None]
    observe: Observers = field(default_factory=dict)
    keep: str = "last"
    out: Path | None = None

    def __post_init__(self) -> None:
        self.model = self.equations.model
        names = self.model.comm.bcast([*self.observe])  # one order of the columns on all ranks
        self._observers = {name: self.observe[name] for name in names}
        self._column_functions = column_getters(self.model)
        self._log = logger("march", self.model.comm)
        self.start, theta = (float(self.arguments[name] or 0.0) for name in ("start", "theta"))
        self.history, self.pace = History(self.model, theta=theta), Pace()
        self.previous: State | None = None
        self._checkpoint, self._n_written_rows = None, 0
        if self.out:
            # `march_id` has only the code of observing functions, because the values that they collect change
            codes = {name: code_part(describe(function)) for name, function in self._observers.items()}
            march_id = json.loads(json.dumps({**self.model.identity(), "observe": codes, **self.arguments}))
            self._checkpoint = Checkpoint(self.out, self.equations, march_id)

    def read(self, resume: Resume) -> bool:
        """Read the march in the folder `out`, so that it can be continued.

        Args:
            resume: whether the march is to be continued; "anyway": also if it is another march.

        Returns:
            Whether a march has been read. False: there is none, or `resume` is False.

        Raises:
            InputError: the folder has another march, or march.json is damaged; or the march is to be continued, and the
                file of a state is damaged.
        """
        saved_march = self._checkpoint.read(resume, 2 if self.keep == "last" else 0) if self._checkpoint else None
        if saved_march is None:
            return False
        self.history.table, states, self.pace = saved_march
        self._n_written_rows, last_row = len(self.history), len(self.history) - 1
        self.previous = states.get(last_row - 1)
        self.history.states = states if self.keep == "all" else {last_row: states[last_row]}
        return True

    def begin(self, states: Sequence[State]) -> None:
        """Add the first state of a march that continues from states of another march.

        Args:
            states: states of the other march. The last of them is the first state of this one. The state before it, if
                there is one, gives the direction of an equilibrium path.
        """
        self.add_state(states[-1])
        self.history.begun = True
        self.previous = states[-2] if len(states) > 1 else None

    def accept(self, states: Sequence[State]) -> None:
        """Add accepted states to the history, each with a row of the table, and write them to the files."""
        for state in states:
            self.add_state(state)
        if self._checkpoint:
            last_row, states_to_keep = len(self.history) - 1, dict(self.history.states)
            if self.previous:
                states_to_keep[last_row - 1] = self.previous
            self._checkpoint.write(self.history.table, states_to_keep, self.pace, self._n_written_rows)
            self._n_written_rows = len(self.history)
        free_petsc_objects(self.equations.comm)

    def add_state(self, state: State) -> None:
        """Add a state and its row of the table to the history, but not to the files.

        The next call of `accept` writes them to the files, too.
        """
        history, report = self.history, state.report
        self.previous = history.last if history.states else None
        log_values = state.t, report.method, report.iterations, report.residual
        self._log.info("t = %g: %s, %d steps, residual %.1e", *log_values)
        row: Row = {"t": state.t, "dt": state.t - self.previous.t if self.previous else 0.0}
        values = {name: function(state) for name, function in self._column_functions.items()}
        row |= {name: None if math.isnan(value) else value for name, value in values.items()}
        row |= {name: self._observed_value(name, state) for name in self._observers}
        history.table.append({name: row[name] for name in history.table.columns or row})
        if self.keep == "last":
            history.states.clear()
        history.states[len(history) - 1] = state

    def _observed_value(self, name: str, state: State) -> float:
        """Return the value of one of the functions in `observe` at a state, as rank 0 has computed it.

        Args:
            name: name of the function's column in the table.
            state: the state.

        Raises:
            InputError: the function fails, or its values on several ranks differ by more than rounding.
        """
        place = f"observe[{name!r}] at t = {state.t:g}"
        try:
            with errors_on_all(self.model.comm):
                value = float(np.asarray(self._observers[name](state)).astype(float, casting="same_kind"))
        except Exception as error:
            kind = "" if isinstance(error, (ThinlayerError, TypeError, ValueError)) else f"{type(error).__name__}: "
            raise InputError(f"{place}: {kind}{error}; {OBSERVER_HINT}") from error
        values = np.array(self.model.comm.allgather(value))
        if not np.allclose(values, values[0], rtol=OBSERVED_TOLERANCE, atol=0.0, equal_nan=True):
            listed = ", ".join(f"{value:.6g}" for value in values)
            raise InputError(f"{place}: the ranks find {listed}; let it return the sum, or the largest, of all ranks")
        return float(values[0])
