"""Marching in time: steps that are accepted, halved or adapted, recorded, and resumed."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from thinlayer.failure import LimitLoad, SolveError
from thinlayer.loads import ModelError
from thinlayer.model import Model
from thinlayer.options import OptionValue
from thinlayer.progress import track
from thinlayer.rigid import rigid_motions
from thinlayer.solvers import Solver
from thinlayer.state import State
from thinlayer.table import Row
from thinlayer.time.checkpoint import Checkpoint, Pace, fingerprint
from thinlayer.time.history import SAME_TIME, History
from thinlayer.time.plan import Adaptive, Plan

Observe = Mapping[str, Callable[[State], float]]
SAME_LOADS = 1e-12  # relative change
SAFETY, LEAST, MOST = 0.9, 0.2, 3.0  # of the change of an adaptive step


def march(
    model: Model,
    times: Sequence[float] | Adaptive,
    *,
    start: float = 0.0,
    theta: float = 1.0,
    observe: Observe | None = None,
    keep: str = "all",
    out: str | Path | None = None,
    resume: bool = False,
    options: Mapping[str, OptionValue] | None = None,
    method: str | None = None,
) -> History:
    """Follow a model in time, from rest just before `start`. Collective.

    The loads may be sudden at `start`. If every law of the layer answers at once (elastic, Maxwell), the first accepted
    state is this response, at `start`. With a law that has a rate (Kelvin-Voigt, Norton, a stack with one of them) the
    first state is the one at rest, and what jumps does so within the first step. A step that fails is halved.

    Args:
        model: the model.
        times: ends of the steps, increasing, > start; or `Adaptive`.
        start: time of the first state.
        theta: the balance of forces holds at t + theta dt: 1 is backward Euler, order 1; 1/2 the midpoint rule, order 2
            (from rest its first step is made of two of backward Euler, which damp what the sudden load excites).
        observe: name of a column -> function of a state that gives a number, the same on all ranks; evaluated at every
            accepted state.
        keep: "all" states, or "last" alone.
        out: folder for table.csv and the files to resume from, written at every accepted step.
        resume: continue the march in `out`, if there is one; times may be added. The model must be the same: numbers are
            compared, functions are not. Without it the files of the same march are replaced, those of another one refused.
        options, method: of the solver, see `solve`.

    Raises:
        ModelError: times, theta, names or loads out of range, before anything is solved; a checkpoint that does not fit.
        SolveError: a step that fails however short; what was accepted is kept in `out` and in the error's `history`.
        LimitLoad: the same with a layer that yields, as loads change; it tells the last loads with an equilibrium.
    """
    start, theta = _number("start", start), _number("theta", theta)
    _check(model, theta, keep, out, resume, observe)
    plan = Plan.of(times, start, model.break_times)
    with Solver(model, options=options, method=method) as solver:
        solver.equations.check_times([start, *plan.targets])
        return _March(solver, plan, start, theta, dict(observe or {}), keep, Path(out) if out else None).run(resume)


COLUMNS = ("t", "dt", "iterations", "residual", "supplied", "stored", "dissipated", "remainder", "imbalance")


def _number(name: str, value: Any) -> float:
    if (not isinstance(value, Real) and np.ndim(value)) or not np.issubdtype(np.asarray(value).dtype, np.number):
        raise ModelError(f"{name} is {value!r}; it must be a number")
    return float(value)


def _check(model: Any, theta: float, keep: str, out: Any, resume: bool, observe: Any) -> None:
    if not isinstance(model, Model):
        raise ModelError(f"model is {model!r}; march takes what Model.full or Model.interface returns")
    if observe is not None and not isinstance(observe, Mapping):
        raise ModelError(f"observe is {observe!r}; it must be {{name of a column: function of a state}}")
    for name, function in (observe or {}).items():
        if not isinstance(name, str) or not callable(function):
            raise ModelError(
                f"observe[{name!r}] is {function!r}; it must be a function of a state that returns a number"
            )
        if name in COLUMNS:
            raise ModelError(f"observe: column {name!r} is there already; give it another name")
    if not 0.5 <= theta <= 1:
        raise ModelError(f"theta is {theta}; allowed: 1/2 (midpoint rule) to 1 (backward Euler)")
    if model.contact and theta != 1:
        raise ModelError(f"theta is {theta}; contact laws hold at the ends of steps: theta = 1")
    if keep not in ("all", "last"):
        raise ModelError(f"keep is {keep!r}; allowed: 'all', 'last'")
    if resume and out is None:
        raise ModelError("resume=True needs out=, the folder of the march")
    if out is not None:
        _check_folder(model, out)


def _check_folder(model: Model, out: Any) -> None:
    """Raise ModelError unless files can be written there. Collective."""
    if not isinstance(out, (str, Path)) or not str(out):
        raise ModelError(f"out is {out!r}; it must be the name of a folder")
    problem = None
    if model.comm.rank == 0:
        there = next(path for path in (Path(out).absolute(), *Path(out).absolute().parents) if path.exists())
        if not there.is_dir():
            problem = f"out: {str(there)!r} is a file; give a folder"
        elif not os.access(there, os.W_OK):
            problem = f"out: no files can be written in {str(there)!r}"
    if problem := model.comm.bcast(problem):
        raise ModelError(problem)


class _March:
    """A march under way."""

    def __init__(
        self, solver: Solver, plan: Plan, start: float, theta: float, observe: dict[str, Callable[[State], float]],
        keep: str, out: Path | None,
    ) -> None:  # fmt: skip
        self.solver, self.plan, self.start, self.theta = solver, plan, start, theta
        self.observe, self.keep, self.out = observe, keep, out
        self.comm = solver.model.comm
        self.checkpoint = Checkpoint(out, solver.equations) if out else None
        adaptive = plan.adaptive
        self.mark = fingerprint(
            solver.model, start=start, theta=theta, observe=sorted(observe), tolerance=adaptive and adaptive.tolerance
        )
        self.pace = Pace(adaptive.first if adaptive else None)
        self.history = History(solver.model)
        self._written = 0
        self._failed_at: float | None = None  # earliest end of a step that failed, still ahead
        self._shortest = False  # whether the step cannot be shortened further

    @property
    def _sudden(self) -> bool:
        """Whether the layer answers a sudden load at once."""
        return not any(p.law.rate for p in self.solver.model.points)

    def run(self, resume: bool) -> History:
        found = self.checkpoint.read(self.mark, self.keep, resume) if self.checkpoint else None
        if found:
            self.history, self.pace = found
            self._written = len(self.history)
            last, end = self.history.last.t, self.plan.targets[-1]
            if last > end + SAME_TIME * max(abs(end), abs(self.start)):
                raise ModelError(f"the march in {self.out} is at t = {last:g}; times end before")
            self._write_table()
        else:
            self._begin()
        for target in track(self.plan.after(self.history.last.t), "march", "t = {:g}"):
            self._reach(target)
        return self.history

    def _begin(self) -> None:
        """The first state. One at rest is written together with the first step: until then nothing has been solved."""
        rest = self.solver.rest(self.start)
        if not self._sudden:
            self._note(rest)
            return
        try:
            self._accept([self.solver.step(rest, self.start)])
        except SolveError as error:
            advice = "let the loads grow from less, as functions (x, t) or piecewise" if self.solver.yields else None
            reason = error.reason if advice else str(error)
            raise SolveError(f"the sudden load at t = {self.start:g}: {reason}", self.history, advice=advice) from error

    def _reach(self, target: float) -> None:
        """Step to a time, in shorter steps where need be."""
        while self.history.last.t != target:
            old = self.history.last
            left = target - old.t
            planned = self.pace.step or left
            dt = min(planned, left)
            end = target if left - dt < 1e-3 * dt else old.t + dt
            try:
                states, factor = self._try(old, end)
            except SolveError as error:
                self._fail(old, end, error)
                continue
            if not states:
                self._shorten(
                    (end - old.t) * factor, old, end, SolveError("its estimated error stays above the tolerance")
                )
                continue
            passed = self._failed_at is None or end >= self._failed_at
            if self.plan.adaptive:
                step = (end - old.t) * factor
                if end == target:  # a step cut short for the target says nothing against a longer one
                    step = max(step, planned)
                self.pace.step = min(step, self.plan.adaptive.largest)
            elif self.pace.step is not None:
                self.pace.step = None if end == target else 2 * dt if passed or not self.solver.yields else dt
            if passed:
                self._failed_at = None
            self._shortest = False
            self._accept(states)

    @property
    def _smallest(self) -> float:
        return self.plan.smallest * (1 - SAME_TIME)

    @property
    def _thorough(self) -> bool:
        """Whether a step is worth every effort: a planned one, the shortest one, one after another that took it."""
        whole = self._failed_at is None and (self.pace.step is None or self.plan.adaptive is not None)
        return whole or self._shortest or self.history.last.report.eased > 0

    def _fail(self, old: State, end: float, error: SolveError) -> None:
        """Shorten a step whose solve failed; the shortest one is tried again with every effort."""
        dt, thorough = (end - old.t) / 2, self._thorough
        self._failed_at = end if self._failed_at is None else min(end, self._failed_at)
        if self.solver.yields and not thorough and dt < self._smallest:
            self._shortest = True
        else:
            self._shorten(dt, old, end, error)

    def _shorten(self, dt: float, old: State, end: float, error: SolveError) -> None:
        if dt >= self._smallest:
            self.pace.step = dt
            return
        if self.solver.yields and self._failed_at is not None and self._loads_change(old.t, end):
            raise LimitLoad(error.reason, old.t, end, self._resultant(old.t), self.history) from error
        raise SolveError(
            f"step {len(self.history)}, from t = {old.t:g} to {end:g}, failed, and so did longer ones: {error}",
            self.history,
        ) from error

    def _loads_change(self, before: float, after: float) -> bool:
        a, b = (self.solver.equations.loads_at(t) for t in (before, after))
        size = b.norm()
        b.axpy(-1.0, a)
        change = b.norm()
        a.destroy()
        b.destroy()
        return bool(change > SAME_LOADS * size)

    def _resultant(self, t: float) -> list[float]:
        """Tractions and body forces on the bodies at a time, their sum."""
        model, loads = self.solver.model, self.solver.equations.loads_at(t)
        translations = [*rigid_motions(model.V, model.joint).values()][: model.joint.dim]
        forces = [float(loads.dot(motion.x.petsc_vec)) for motion in translations]
        loads.destroy()
        return forces

    def _try(self, old: State, end: float) -> tuple[list[State], float]:
        """States of a step, none if its error is too large, and by how much the next step may be longer or shorter."""
        theta = 1.0 if len(self.history) == 1 and not self._sudden else self.theta
        middle = (old.t + end) / 2
        adaptive = self.plan.adaptive
        if not adaptive:
            ends = [middle, end] if theta != self.theta else [end]
            return [*self._chain(old, ends, theta)], 1.0
        whole = self.solver.step(old, end, theta, self._thorough)
        halves = [*self._chain(old, [middle, end], theta)]
        order = 2 if theta == 0.5 else 1
        size = max(float(halves[-1].u.x.petsc_vec.norm()), self.pace.largest)
        difference = halves[-1].u.x.petsc_vec.copy()
        difference.axpy(-1.0, whole.u.x.petsc_vec)
        error = difference.norm() / (2**order - 1) / size if size else 0.0
        ratio = (adaptive.tolerance / error) ** (1 / (order + 1)) if error else MOST
        factor = float(np.clip(SAFETY * ratio, LEAST, MOST))
        return (halves if error <= adaptive.tolerance else []), factor

    def _chain(self, state: State, ends: list[float], theta: float) -> Iterator[State]:
        for t in ends:
            state = self.solver.step(state, t, theta, self._thorough)
            yield state

    def _accept(self, states: list[State]) -> None:
        for state in states:
            self._note(state)
        if self.checkpoint:
            if self._written == 0:
                self.checkpoint.forget()
            self.checkpoint.write(self.mark, self.history, self.pace, self._written)
            self._write_table()
            self._written = len(self.history)
        self.solver.equations.collect()

    def _note(self, state: State) -> None:
        before = self.history.last.t if self.history.states else state.t
        self.history.table.append(self._row(state, state.t - before))
        if self.keep == "last":
            self.history.states.clear()
        self.history.states[len(self.history) - 1] = state
        self.pace.largest = max(self.pace.largest, float(state.u.x.petsc_vec.norm()))

    def _write_table(self) -> None:
        if self.out and self.comm.rank == 0:
            self.history.table.write(self.out / "table.csv")

    def _row(self, state: State, dt: float) -> Row:
        values: dict[str, Any] = {"t": state.t, "dt": dt}
        for name in COLUMNS[len(values) :]:
            value = getattr(state.report if hasattr(state.report, name) else state.audit, name)
            values[name] = None if math.isnan(value) else value
        return values | {name: self._observed(name, state) for name in self.observe}

    def _observed(self, name: str, state: State) -> float:
        """What rank 0 observes: a function of a state is to give the same on all ranks."""
        try:
            value = float(self.observe[name](state))
        except (TypeError, ValueError) as error:
            raise ModelError(
                f"observe[{name!r}] at t = {state.t:g}: {error}; it must be a function of a state that returns a number"
            ) from error
        return float(self.comm.bcast(value))
