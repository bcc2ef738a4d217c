"""`march`: checks its arguments, and runs a march in time or along a path."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from forms.base import InputError, require
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError
from thinlayer.solving.equations import Equations
from thinlayer.solving.history import History
from thinlayer.solving.petsc import Options
from thinlayer.solving.ranges import warn_of_model, warn_of_states, warn_of_steps, warn_of_strains
from thinlayer.solving.solvers import SOFTENS, Solver, comm_of
from thinlayer.system.folder import owned
from thinlayer.system.identity import Resume, require_resume
from thinlayer.system.progress import telling
from thinlayer.system.ranks import on_all, require_same
from thinlayer.time.checkpoint import Pace
from thinlayer.time.following import PathFollowing, PathInTime
from thinlayer.time.journal import OBSERVING, Journal, Observe, columns
from thinlayer.time.plan import HALVINGS, Adaptive, ArcLength, Plan, require_choices, require_ends, require_path
from thinlayer.time.stepping import QUANTITIES, ErrorEstimate, TimeStepping

TOLD = 0.02  # least error of the steps that leads to a warning
FEWEST = 8  # planned steps whose number can be halved; fewer are made again as this many or more
IDLE = 1e-12  # dissipation over the work of the loads, that is none
NO_ERROR = "Adaptive is for laws that depend on time; steps of {} have no error: give the times to stop at"


def march(
    model: Model,
    times: Sequence[float] | Adaptive | ArcLength,
    *,
    start: float = 0.0,
    theta: float = 1.0,
    observe: Observe | None = None,
    keep: str = "all",
    out: str | Path | None = None,
    resume: Resume = False,
    options: Options | None = None,
    method: str | None = None,
) -> History:
    """Follow a model in time, from rest just before `start`. Collective.

    The loads may be sudden at `start`. If every law of the layer answers at once (elastic, Maxwell), the first accepted
    state is this response, at `start`. With a rate (Kelvin-Voigt, Norton, a stack with one of them, own parts such as
    inertia) the first state is at rest, and the response to sudden loads is in the first step. A step that fails is halved.
    If a law or a part has a memory, steps also end at the breaks of `piecewise` data, and the table has rows for them.

    A layer whose stress falls as jumps grow (`softens`) is followed along its path, in steps that are as short as the path
    needs, as long as the path leads on in time: so displacements of supports take it beyond the largest load. Where it
    turns back the march ends with a `TurningPoint`, and `follow` goes on.

    A layer of pure phases (`forms.NonMonotoneUnrelaxed`) follows a local minimum of the energy until one of its columns has
    a phase that is not the one of lowest energy. The march stops there. It keeps two states at the same t: before and after
    this column and all columns that follow it have switched (`History.snaps`). If loads or temperatures are not linear in
    time within a step, the march tests seven times within the step: a column may leave its phase of lowest energy and
    return to it unnoticed between two of them. Switches by a sudden load at `start` are no snaps: the first state is the
    one after them. Let loads grow from zero to see these snaps.

    Args:
        model: the model.
        times: ends of the steps, increasing, > start; or `Adaptive`; or `ArcLength`, to follow an equilibrium path, where
            t is the parameter of loads and supports alone, and may go back. It starts from the sudden load at `start`.
        start: time of the first state.
        theta: forces balance at t + theta dt: 1 is backward Euler, order 1; 1/2 is the midpoint rule, order 2 (from rest
            its first step is made of two steps of backward Euler, which damp the oscillation after a sudden load). Values
            below 1 are allowed for laws that creep or relax and whose response to a sudden strain, if there is one, is
            linear. Parameters that vary in time are taken at t + theta dt.
        observe: name of a column -> function of a state that gives a number, the same on all ranks; evaluated at every
            accepted state.
        keep: "all": keep all states; "last": keep only the last one.
        out: folder for table.csv and the files from which to resume, written at every accepted step. Only one march at a
            time may use it.
        resume: True: continue the march in `out`, if there is one; times may be added. Its numbers, names and mesh must be
            the same, and no file of your own may have changed in which functions and laws stand. "anyway": continue it even
            so. False: the files of the same march are replaced; files of another march are an error.
        options, method: of the solver, see `solve`.

    Warns:
        RangeWarning: as in `solve`; for the states that are kept, once, at the end, of strains of bodies also where the
            march fails. A resumed march has passed one of the times without a step that ended there. Planned steps leave an
            estimated error above 2 % (`History.step_errors`) under a law that is not linear and has a history (yield,
            friction, damage): such marches are made again with half as many steps, of less than eight as 8 to 14.
            Before the march: planned steps are not well below a relaxation or retardation time of a law.

    Raises:
        InputError: times, theta, names or loads out of range, before the first solve; theta < 1 with a contact law, or a
            law that yields, has phases, or answers at once and not linearly; files of another march in `out`; an `out` that
            cannot be written, or that another march uses.
        OSError: a file could not be written; on all ranks.
        SolveError: the shortest step fails, too; accepted states are in `out` and in the error's `history`.
        TurningPoint: a layer softens, and the equilibria lead back in time.
        LimitLoad: the same for a layer that yields, or for contact, if loads change and displacements run away as weak
            springs at all nodes are softened; the error has the last loads with an equilibrium.
    """
    with on_all(comm_of(model)):
        start, theta = _number("start", start), _number("theta", theta)
        _check(model, theta, keep, out, resume, observe)
        if isinstance(times, ArcLength):
            times.check(start)
            require_choices(theta, method)
        elif not isinstance(times, Adaptive):
            times = Plan.of(times, start, set()).targets
    choices = {"start": start, "theta": theta, "keep": keep, "out": out and str(out), "resume": resume}
    require_same(model.comm, times=times, **choices, observe={*(observe or {})})
    folder = Path(out) if out else None
    with Solver(model, options=options, method=method) as solver, owned(folder, model.comm):
        equations, traits = solver.equations, solver.equations.traits
        keeping = partial(Journal, equations, dict(observe or {}), keep, folder)
        if isinstance(times, ArcLength):
            require_path(equations)
            return _on_path(solver, times, start, keeping, options, resume)
        ends_at_breaks = traits.remembers or traits.rate or traits.softens or isinstance(times, Adaptive)
        plan = Plan.of(times, start, model.break_times if ends_at_breaks else set())
        adaptive = plan.adaptive
        if traits.softens:
            _require_path(equations, plan, theta, method)
            return _on_path(solver, plan, start, keeping, options, resume)
        if adaptive:
            equations.refuse({"switches": NO_ERROR})
        choices = {"start": start, "theta": theta, "tolerance": adaptive and adaptive.tolerance}
        equations.check_times([start, *plan.targets])
        require_ends(equations, theta, [start, *plan.targets])
        journal = keeping(Pace(adaptive.first if adaptive else None), choices)
        warn_of_model(model, plan.lasting(start))
        if not adaptive:
            warn_of_steps(model, start, plan.targets, theta)
        try:
            history = TimeStepping(solver, journal, plan, start, theta).run(resume)
        except SolveError as error:
            warn_of_strains(list(error.history or ()))
            raise
        tell_steps(solver, history, plan, start, theta)
    warn_of_states(list(history), start)
    return history


def follow(
    begun: History | State,
    path: ArcLength,
    *,
    observe: Observe | None = None,
    keep: str = "all",
    options: Options | None = None,
) -> History:
    """Follow the equilibria of a model on by arc length, from the last state of a march, or from a state. Collective.

    Where a march of a softening layer has ended with a `TurningPoint`, the path leads on, back in time at first.

    Args:
        begun: a history, such as `error.history`, which keeps its last state; or a state that a solve or a march has found.
        path: the path's end, after the time of the state, and the change of t in its first step.
        observe, keep, options: as in `march`.

    Returns:
        The states of the path, and the one that it begins with.

    Raises:
        InputError: neither a history nor a state; laws whose paths cannot be followed, see `march`; `path` out of range.
        SolveError: as in `march`.
    """
    if not isinstance(begun, (History, State)) or not isinstance(path, ArcLength):
        raise InputError(f"follow takes a history or a state, and ArcLength(...), not {begun!r:.80} and {path!r:.80}")
    *earlier, last = [begun] if isinstance(begun, State) else begun
    before = earlier[-1] if earlier else None
    model = last.model
    with on_all(model.comm):
        _check(model, 1.0, keep, None, False, observe)
        path.check(last.t)
    require_same(model.comm, times=path, start=last.t, keep=keep, observe={*(observe or {})})
    with Solver(model, options=options) as solver:
        require_path(solver.equations)
        keeping = partial(Journal, solver.equations, dict(observe or {}), keep, None)
        return _on_path(solver, path, last.t, keeping, options, begun=(before, last))


def _on_path(
    solver: Solver,
    path: ArcLength | Plan,
    start: float,
    keeping: Callable[..., Journal],
    options: Options | None,
    resume: Resume = False,
    begun: tuple[State | None, State] | None = None,
) -> History:
    """Run a march along a path, to its end, or to given times."""
    ends = [path.end] if isinstance(path, ArcLength) else path.targets
    first = path.first if isinstance(path, ArcLength) else ends[0] - start
    solver.equations.check_times([start, *ends])
    choices = {"start": start, "theta": 1.0, "tolerance": None, "first": first}
    journal = keeping(Pace(None), choices, directed=True)
    warn_of_model(solver.model)
    if begun:
        journal.start(*begun)
    if isinstance(path, ArcLength):
        history = PathFollowing(solver, journal, path, start, options).run(resume)
    else:
        history = PathInTime(solver, journal, path.targets, start, options).run(resume)
    warn_of_states(list(history))
    return history


def _require_path(equations: Equations, plan: Plan, theta: float, method: str | None) -> None:
    """Raise InputError unless a march of a softening layer can go along its path. Collective."""
    if plan.adaptive:
        equations.refuse({"softens": f"march with Adaptive: {SOFTENS}"})
    try:
        require_choices(theta, method)
        require_path(equations)
    except InputError as error:
        raise InputError(f"the stress of a layer falls, and equilibria in time must be on its path: {error}") from error


def _number(name: str, value: Any) -> float:
    require(not np.ndim(value) and np.asarray(value).dtype.kind in "iuf", name, value, "it must be a number")
    return float(value)


def _check(model: Any, theta: float, keep: str, out: Any, resume: Resume, observe: Any) -> None:
    require(isinstance(model, Model), "model", model, "march takes what Structure.full or Structure.interface returns")
    require(observe is None or isinstance(observe, Mapping), "observe", observe, "give {name of a column: function}")
    for name, function in (observe or {}).items():
        require(isinstance(name, str) and callable(function), f"observe[{name!r}]", function, OBSERVING)
        if name in columns(model):
            raise InputError(f"observe: column {name!r} is there already; give it another name")
    if not 0.5 <= theta <= 1:
        raise InputError(f"theta is {theta}; allowed: 1/2 (midpoint rule) to 1 (backward Euler)")
    require(keep in ("all", "last"), "keep", keep, "allowed: 'all', 'last'")
    require_resume(resume)
    if resume and out is None:
        raise InputError(f"resume={resume!r} needs out=, the folder of the march")
    require(out is None or (isinstance(out, (str, Path)) and str(out)), "out", out, "it must be the name of a folder")


# ---------------------------------------------------------------- what planned steps leave undetermined
def tell_steps(solver: Solver, history: History, plan: Plan, start: float, theta: float) -> None:
    """Estimate the errors of planned steps at the end of a march, and warn of large ones. Collective.

    Laws that are not linear and have a history, as of yield, friction or damage, are marched again with half as many steps:
    half as many solves again. Less than eight steps are made again as 8 to 14. Breaks of the data remain ends of steps. The
    difference gives the error of the whole march to leading order; one halved step would tell what it adds alone. A march
    that has dissipated nothing is not made again.
    """
    if plan.adaptive or not depends_on_steps(solver.equations):
        return
    dissipated, supplied = (np.array(history.table[name], float) for name in ("dissipated", "supplied"))
    if np.abs(dissipated).sum() <= IDLE * np.abs(supplied).sum():  # not if a law does not declare its energy
        history.step_errors = dict.fromkeys(QUANTITIES, 0.0)
        return
    again = _other(plan.targets, start, solver.model.break_times)
    length = float(np.diff([start, *again]).min()) / 2**HALVINGS
    journal = Journal(solver.equations, {}, "last", None, Pace(None), {"theta": theta})
    remedy = "take more steps, or times=Adaptive(end=..., first=..., tolerance=...)"
    try:
        with telling("error of the steps"):
            other = TimeStepping(solver, journal, Plan(again, None, length), start, theta).run(False).last
    except SolveError as error:
        history.step_errors = dict.fromkeys(QUANTITIES, np.nan)
        history.model.warn(
            "no step error",
            f"the error of the march's steps is not known: with {len(again)} steps {error.reason}; {remedy}",
            *plan.targets,
        )
        return
    order = 2 if theta == 0.5 else 1
    gain = abs((len(plan.targets) / len(again)) ** order - 1)
    shares = ErrorEstimate(solver.equations).shares(other, history.last) / gain
    history.step_errors = dict(zip(QUANTITIES, map(float, shares), strict=True))
    if shares.max() > TOLD:
        told = ", ".join(f"{share:.2g} in {name}" for name, share in history.step_errors.items())
        history.model.warn(
            "step error",
            f"the {len(plan.targets)} steps of this march leave estimated relative errors of {told} at its end (march with "
            f"{len(again)} steps): the law depends on its history; {remedy}",
            *plan.targets,
        )


def depends_on_steps(equations: Equations) -> bool:
    """Whether a part is not linear and has a history; phases that switch have steps of their own."""
    each = [part.traits for part in equations.parts]
    return any((has.remembers or has.rate) and has.nonlinear and not has.switches for has in each)


def _other(targets: Sequence[float], start: float, breaks: set[float]) -> list[float]:
    """Every second target, counted from the end, and breaks; where few would be left, all steps in parts."""
    last = len(targets) - 1
    coarse = [t for k, t in enumerate(targets) if (last - k) % 2 == 0 or t in breaks]
    if len(targets) >= FEWEST and 4 * len(coarse) <= 3 * len(targets):
        return coarse
    parts = max(2, math.ceil(FEWEST / len(targets)))
    return [b - (b - a) * k / parts for a, b in pairwise([start, *targets]) for k in reversed(range(parts))]
