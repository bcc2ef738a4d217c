"""Marching in time: steps that are accepted, halved or adapted, recorded, and resumed."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from thinlayer.loads import ModelError
from thinlayer.model import Model
from thinlayer.options import OptionValue
from thinlayer.progress import track
from thinlayer.solvers import SolveError, Solver
from thinlayer.state import State
from thinlayer.table import Row, Table
from thinlayer.time.checkpoint import Checkpoint, Pace, fingerprint
from thinlayer.time.history import SAME_TIME, History

Observe = Mapping[str, Callable[[State], float]]
HALVINGS = 10
SAFETY, LEAST, MOST = 0.9, 0.2, 3.0  # of the change of an adaptive step


@dataclass(frozen=True)
class Adaptive:
    """Steps whose length follows an estimate of their error.

    Each step is taken once as a whole and once as two halves; the halves are accepted if the displacements differ by no
    more than the tolerance.

    Attributes:
        end: last time.
        first: length of the first step.
        tolerance: of the estimated error of a step's displacements, relative to the largest displacements so far (L2
            norms of nodal values).
        at: times between start and end that a step must end at.
        smallest: length below which a step is not shortened further (default: first/1e6).
        largest: length of the longest step (default: no limit).

    Raises:
        ModelError: values out of range.
    """

    end: float
    first: float
    tolerance: float = 1e-3
    at: Sequence[float] = ()
    smallest: float | None = None
    largest: float = math.inf

    def __post_init__(self) -> None:
        for name in ("first", "tolerance", "largest"):
            value = getattr(self, name)
            if not value > 0:
                raise ModelError(f"Adaptive: {name} is {value}; allowed: > 0")
        if self.at and max(self.at) > self.end:
            raise ModelError(f"Adaptive: at has t = {max(self.at):g}; times increase to end = {self.end:g}")

    @property
    def targets(self) -> list[float]:
        """Times that a step ends at."""
        return sorted({*map(float, self.at), float(self.end)})


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
        observe: name of a column -> function of a state, evaluated at every accepted state.
        keep: "all" states, or "last" alone.
        out: folder for table.csv and the files to resume from, written at every accepted step.
        resume: continue the march in `out`, if there is one; the model must be the same, times may differ.
        options, method: of the solver, see `solve`.

    Raises:
        ModelError: times, theta, names or loads out of range, before anything is solved; a checkpoint that does not fit.
        SolveError: a step that fails however short; what was accepted is kept in `out` and in the error's `history`.
    """
    plan = _Plan.of(times, start)
    _check(theta, keep, out, resume, observe or {})
    with Solver(model, options=options, method=method) as solver:
        solver.equations.check_times([start, *plan.targets])
        return _March(solver, plan, theta, dict(observe or {}), keep, Path(out) if out else None).run(start, resume)


COLUMNS = ("t", "dt", "iterations", "residual", "supplied", "stored", "dissipated", "remainder", "imbalance")


def _check(theta: float, keep: str, out: str | Path | None, resume: bool, observe: Observe) -> None:
    for name in COLUMNS:
        if name in observe:
            raise ModelError(f"observe: column {name!r} is there already; give it another name")
    if not 0.5 <= theta <= 1:
        raise ModelError(f"theta is {theta}; allowed: 1/2 (midpoint rule) to 1 (backward Euler)")
    if keep not in ("all", "last"):
        raise ModelError(f"keep is {keep!r}; allowed: 'all', 'last'")
    if resume and out is None:
        raise ModelError("resume=True needs out=, the folder of the checkpoint")
    if out is not None and Path(out).is_file():
        raise ModelError(f"out: {str(out)!r} is a file; give a folder")


@dataclass(frozen=True)
class _Plan:
    """Times to reach, and how long steps may be."""

    targets: list[float]
    adaptive: Adaptive | None
    smallest: float

    @classmethod
    def of(cls, times: Sequence[float] | Adaptive, start: float) -> _Plan:
        adaptive = times if isinstance(times, Adaptive) else None
        try:
            targets = adaptive.targets if adaptive else [float(t) for t in times]  # type: ignore[union-attr]
        except (TypeError, ValueError) as error:
            raise ModelError(f"times is {times!r}; it must be a sequence of numbers or Adaptive(...)") from error
        whole = np.array([start, *targets])
        if not targets or not np.isfinite(whole).all() or (np.diff(whole) <= 0).any():
            raise ModelError(f"times is {targets} from start = {start:g}; they must be finite and increase from start")
        if adaptive:
            return cls(targets, adaptive, adaptive.smallest or adaptive.first / 1e6)
        return cls(targets, None, float(np.diff(whole).min()) / 2**HALVINGS)

    def after(self, t: float) -> list[float]:
        """Targets still to reach."""
        near = SAME_TIME * max(abs(self.targets[-1]), abs(self.targets[0]))
        return [target for target in self.targets if target > t + near]


class _March:
    """A march under way."""

    def __init__(
        self, solver: Solver, plan: _Plan, theta: float, observe: dict[str, Callable[[State], float]], keep: str,
        out: Path | None,
    ) -> None:  # fmt: skip
        self.solver, self.plan, self.theta, self.observe, self.keep = solver, plan, theta, observe, keep
        self.root = solver.model.comm.rank == 0
        self.table_path = out / "table.csv" if out and self.root else None
        self.checkpoint = Checkpoint(out, solver.equations) if out else None
        self.mark = fingerprint(solver.model, theta=theta, observe=sorted(observe), adaptive=plan.adaptive is not None)
        self.pace = Pace(plan.adaptive.first if plan.adaptive else None)
        self.history = History(solver.model)

    @property
    def _sudden(self) -> bool:
        """Whether the layer answers a sudden load at once."""
        return not any(p.law.rate for p in self.solver.model.points)

    def run(self, start: float, resume: bool) -> History:
        found = self.checkpoint.read(self.mark, self.keep) if resume and self.checkpoint else None
        if found:
            restored, self.pace = found
            self.history = replace(restored, table=Table(restored.table.rows, self.table_path))
        else:
            self.history.table = Table(path=self.table_path)
            if self.checkpoint:
                self.checkpoint.forget()
            self._begin(start)
        for target in track(self.plan.after(self.history.last.t), "march", "t = {:g}"):
            self._reach(target)
        return self.history

    def _begin(self, start: float) -> None:
        rest = self.solver.rest(start)
        try:
            self._accept([self.solver.step(rest, start) if self._sudden else rest])
        except SolveError as error:
            raise SolveError(f"the sudden load at t = {start:g}: {error}", self.history) from error

    def _reach(self, target: float) -> None:
        """Step to a time, in shorter steps where need be."""
        while self.history.last.t != target:
            old = self.history.last
            left = target - old.t
            dt = min(self.pace.step or left, left)
            end = target if left - dt < 1e-3 * dt else old.t + dt
            try:
                states, factor = self._try(old, end)
            except SolveError as error:
                self._shorten((end - old.t) / 2, old, end, error)
                continue
            if not states:
                self._shorten(
                    (end - old.t) * factor, old, end, SolveError("its estimated error stays above the tolerance")
                )
                continue
            if self.plan.adaptive:
                step = (end - old.t) * factor
                if (
                    end == target and self.pace.step
                ):  # a step cut short for the target says nothing against a longer one
                    step = max(step, self.pace.step)
                self.pace.step = min(step, self.plan.adaptive.largest)
            elif self.pace.step is not None:
                self.pace.step = None if end == target else 2 * dt
            self._accept(states)

    def _shorten(self, dt: float, old: State, end: float, error: SolveError) -> None:
        if dt < self.plan.smallest:
            raise SolveError(
                f"step {len(self.history)}, from t = {old.t:g} to {end:g}, failed, and so did longer ones: {error}",
                self.history,
            ) from error
        self.pace.step = dt

    def _try(self, old: State, end: float) -> tuple[list[State], float]:
        """States of a step, none if its error is too large, and by how much the next step may be longer or shorter."""
        theta = 1.0 if len(self.history) == 1 and not self._sudden else self.theta
        middle = (old.t + end) / 2
        adaptive = self.plan.adaptive
        if not adaptive:
            ends = [middle, end] if theta != self.theta else [end]
            return [*self._chain(old, ends, theta)], 1.0
        whole = self.solver.step(old, end, theta)
        halves = [*self._chain(old, [middle, end], theta)]
        order = 1 if theta == 1 else 2
        size = max(float(halves[-1].u.x.petsc_vec.norm()), self.pace.largest)
        difference = halves[-1].u.x.petsc_vec.copy()
        difference.axpy(-1.0, whole.u.x.petsc_vec)
        error = difference.norm() / (2**order - 1) / size if size else 0.0
        ratio = (adaptive.tolerance / error) ** (1 / (order + 1)) if error else MOST
        factor = float(np.clip(SAFETY * ratio, LEAST, MOST))
        return (halves if error <= adaptive.tolerance else []), factor

    def _chain(self, state: State, ends: list[float], theta: float) -> Iterator[State]:
        for t in ends:
            state = self.solver.step(state, t, theta)
            yield state

    def _accept(self, states: list[State]) -> None:
        for state in states:
            before = self.history.last.t if self.history.states else state.t
            self.history.table.append(self._row(state, state.t - before))
            if self.keep == "last":
                self.history.states.clear()
            self.history.states[len(self.history) - 1] = state
            self.pace.largest = max(self.pace.largest, float(state.u.x.petsc_vec.norm()))
        if self.checkpoint:
            rows = range(len(self.history) - len(states), len(self.history))
            self.checkpoint.write(self.mark, self.history, self.pace, list(rows))

    def _row(self, state: State, dt: float) -> Row:
        values: dict[str, Any] = {"t": state.t, "dt": dt}
        for name in COLUMNS[len(values) :]:
            value = getattr(state.report if hasattr(state.report, name) else state.audit, name)
            values[name] = None if math.isnan(value) else value
        return values | {name: float(function(state)) for name, function in self.observe.items()}
