"""The function `march`, which solves a model step by step in time, and estimates of the errors of its steps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Unpack

import numpy as np

from forms.base import InputError, require
from geometry.refusals import require_known
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.errors import SolveError
from thinlayer.solving.flux_ranges import warn_of_layer_times
from thinlayer.solving.history import History, Solution, column_getters
from thinlayer.solving.ranges import (
    warn_of_fracture_zones,
    warn_of_model,
    warn_of_states,
    warn_of_steps,
    warn_of_strains,
)
from thinlayer.solving.solve import Solver, SolverChoices, comm_of
from thinlayer.system.fingerprint import Resume, require_resume
from thinlayer.system.folder import lock_from_root
from thinlayer.system.progress import report
from thinlayer.system.ranks import errors_on_all, require_same
from thinlayer.time.controller import Controller
from thinlayer.time.journal import OBSERVER_HINT, Journal, Observers
from thinlayer.time.plan import Plan, PlannedTimes, Times, default_theta, require_theta_suits
from thinlayer.time.stepping import COMPARED_QUANTITIES, ErrorEstimate

WARN_STEP_ERROR = 0.02  # least error of the steps that leads to a warning
MIN_HALVED_STEPS = 8  # least number of planned steps that is halved; fewer are repeated as this many or more
MIN_DISSIPATION_RATIO = 1e-12  # dissipation over the work of the loads that counts as zero


def march(
    begin: Model | Solution,
    times: Times,
    *,
    start: float | None = None,
    theta: float | None = None,
    observe: Observers | None = None,
    keep: str = "all",
    out: str | Path | None = None,
    resume: Resume = False,
    **solver: Unpack[SolverChoices],
) -> History:
    """Solve a model step by step in time, from rest just before `start` or from a given state. Collective.

    The loads may begin suddenly at `start`. If every law responds to them at once (elastic, Maxwell), the first
    accepted state is this response, at `start`. Other laws and parts depend on rates: Kelvin-Voigt, Norton, a stack
    with one of them, parts such as inertia. With them the first state is at rest, and the response to sudden loads is
    in the first step. A structure with mass begins with accelerations that balance the loads at the start, also from a
    given state, such as a static one under other loads, which then is released. A step that fails is halved. If a law
    or a part has a memory, depends on rates or softens, steps also end at the break times of `piecewise` data, where
    slopes change.

    A layer softens if its stress falls as jumps grow (trait `softens`). A model with such a layer follows its
    equilibrium path, as long as time increases along it. Steps are as short as the path needs. In this way, prescribed
    displacements of supports take the layer beyond the largest load. Where time would decrease along the path, the
    march ends with a `TurningPoint`. It can be continued by `march(error.history, ArcLength(...))`.

    A layer of pure phases (`forms.NonMonotoneUnrelaxed`) follows a local minimum of the energy. It consists of columns,
    each of which has one phase. In a full model a column is the cells above each other through the thickness, in an
    interface model a facet of S. A step ends at the time when a column is no longer in the phase of lowest energy. This
    column switches, and so do all columns that leave their phase of lowest energy as a consequence. Two states are
    recorded at this time, before and after the switches (`History.snaps`). If loads or temperatures are not linear in
    time within a step, columns are tested at seven times within the step. Between two of these times a column may leave
    its phase of lowest energy and return unnoticed. Switches under a sudden load at `start` are not recorded as snaps:
    the first state is the state after them. Let loads grow from zero to see these snaps.

    Args:
        begin: the model, which starts from rest; or a state, or a history, such as `error.history`. The march continues
            from this state, or from the last state of the history, which is then its first row.
        times: ends of the steps, increasing, > start; or `Adaptive`, for steps whose length follows from an estimate of
            their error; or `ArcLength`, to follow an equilibrium path. On a path t is only the parameter of loads and
            supports, and may decrease. A path from a model starts from the response to sudden loads at `start`; a path
            from a history starts in the direction of its last step.
        start: time of the first state (default: 0). It must not be set if `begin` is a state or a history, which has
            its own time.
        theta: fraction of each step after which forces balance. 1 is backward Euler, of first order in the length of
            the steps; 1/2 is the midpoint rule, of second order. None: 1/2 for models with mass (`Inertia`) and without
            contact, else 1. With theta below 1 and without mass, the first step from rest consists of two steps of
            backward Euler, which damp the oscillation after a sudden load. Values below 1 are allowed with mass, where
            laws bound stresses at the times of balance alone. Without mass they are allowed for linear laws. They are
            also allowed for laws that creep or relax, if any response of these laws to sudden strains is linear.
            Parameters that vary in time are taken at the time of balance.
        observe: name of a column to be added to the history's table -> function of a state that returns a number, the
            same on all ranks. It is evaluated at every accepted state.
        keep: "all": keep all states; "last": keep only the last one.
        out: folder for table.csv and the files from which to resume, written after every accepted step; None: no files.
            Only one march at a time may use the folder. A march that continues from a history or a state cannot have
            one.
        resume: True: continue the march in `out`, if there is one; times may be added. The model's numbers, names and
            mesh must be the same, and no user's file with functions or laws may have changed. "anyway": continue it in
            spite of such changes. False: the files of the same march are replaced; files of another march are an error.
        **solver: further arguments of `solve`: `options`, for PETSc, and `method`.

    Warns:
        RangeWarning: a law or state is out of the range of validity that `solve` checks; issued once, at the end, for
            the states that are kept. Warnings of strains of bodies are issued also if the march fails. A second reason
            is that steps to given times leave an estimated error above 2 % (`History.step_errors`). It is estimated
            for laws that are not linear and depend on history (yield, friction, damage, creep). To this end the march
            is repeated with half as many steps; fewer than eight steps are repeated as 8 to 14. A third reason, before
            the march, are steps between given times that are not well below a relaxation or retardation time of a law.

    Raises:
        InputError: times, theta, names or loads are out of range, which is found before the first solve; theta < 1 with
            a contact law, or with a law that yields, has phases, or has a non-linear instantaneous response; `out` has
            files of another march, cannot be written, or is used by another march.
        OSError: a file could not be written; on all ranks.
        SolveError: even the shortest step fails; accepted states are in `out` and in the error's `history`.
        TurningPoint: a layer softens, and time would decrease along its equilibrium path.
        LimitLoad: even the shortest step fails for a layer that yields, or for contact, and loads change in this step.
            With weak springs at all nodes there are equilibria, but as the springs are softened the displacements grow
            without bound. The error has the last loads with an equilibrium.

    Example:
        >>> from forms import LinearElastic, Maxwell
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, march
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> resin = Maxwell(lmbda=800.0, mu=400.0, t1=20.0)
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> history = march(plates.interface(ThinLayer(resin, eps=0.05)), [0.5, 1.0, 2.0])
        >>> f"{history.last.energies()['layer']:.3g}"
        '0.0102'
    """
    with errors_on_all(comm_of(getattr(begin, "model", begin))):
        model, initial_states = _initial_states(begin)
        for name in solver:
            require_known("argument of march", name, SolverChoices.__annotations__)
        if initial_states and (start is not None or out is not None):
            raise InputError("a march goes on from a state at its time, and without files: omit start= and out=")
        start = initial_states[-1].t if initial_states else _to_float("start", start or 0.0)
        theta = default_theta(model, times) if theta is None else _to_float("theta", theta)
        _check(model, theta, keep, out, resume, observe)
        plan = times if isinstance(times, Plan) else PlannedTimes(times)
        plan.targets(start)
    shared_arguments = {"start": start, "theta": theta, "keep": keep, "out": out and str(out), "resume": resume}
    require_same(model.comm, times=plan, **shared_arguments, observe={*(observe or {})})
    folder = Path(out) if out else None
    with Solver(model, **solver) as step_solver, lock_from_root(folder, model.comm):
        equations, traits = step_solver.equations, step_solver.equations.traits
        ends_at_breaks = traits.remembers or traits.rate or traits.softens or plan.tolerance is not None
        targets = plan.targets(start, model.break_times if ends_at_breaks else ())
        on_path, first = plan.is_path or traits.softens, targets[0] - start if plan.first is None else plan.first
        plan.check_model(equations, theta, solver.get("method"))
        if initial_states and (missing := set(model.quadratures) - set(initial_states[-1].memory)):
            text = f"march: the state is one of other laws, without what {min(missing)!r} remembers"
            raise InputError(f"{text}; begin from its own model or, from a steady field, with Structure(initial=state)")
        for t in (start, *targets):
            equations.data_at(t)  # raises errors of data that are out of range
        if not on_path:
            require_theta_suits(equations, theta, [start, *targets])
        identity = {"start": start, "theta": theta, "tolerance": plan.tolerance} | ({"first": first} if on_path else {})
        journal = Journal(equations, identity, observe or {}, keep, folder)
        warn_of_model(model)
        has_planned_steps = not on_path and plan.tolerance is None
        if has_planned_steps:
            warn_of_steps(model, start, targets, theta)
        controller = plan.controller(step_solver, journal, targets, solver.get("options") or {})
        try:
            history = controller.run(resume, initial_states)
        except SolveError as error:
            warn_of_strains(list(error.history or ()))
            warn_of_fracture_zones(list(error.history or ()))
            raise
        part_traits = [part.traits for part in equations.parts]  # laws that switch phases end steps at switches
        has_time_errors = any((has.remembers or has.rate) and has.nonlinear and not has.switches for has in part_traits)
        if has_time_errors and has_planned_steps:
            warn_of_step_errors(controller, theta, initial_states)
    warn_of_states(list(history), None if on_path else start)
    warn_of_layer_times(history)
    return history


def _initial_states(begin: object) -> tuple[Model, list[State]]:
    """Return the model of a march, and the states from which the march continues.

    Args:
        begin: argument of `march`: a model, a history or a state.

    Returns:
        The model. The states: none for a model; a state itself; for a history its last state, after the state before it
        if that is kept.

    Raises:
        InputError: `begin` is no model, history or state.
    """
    if isinstance(begin, History):
        return begin.model, [*filter(None, [begin.states.get(len(begin) - 2)]), begin.last]
    if isinstance(begin, State):
        return begin.model, [begin]
    if isinstance(begin, Model):
        return begin, []
    allowed_text = "march takes what Structure.full or Structure.interface returns, a history or a state"
    raise InputError(f"model is {begin!r:.200}; {allowed_text}")


def _to_float(name: str, value: float) -> float:
    require(not np.ndim(value) and np.asarray(value).dtype.kind in "iuf", name, value, "it must be a number")
    return float(value)


def _check(model: Model, theta: float, keep: str, out: object, resume: Resume, observe: Observers | None) -> None:
    require(observe is None or isinstance(observe, Mapping), "observe", observe, "give {name of a column: function}")
    for name, function in (observe or {}).items():
        require(isinstance(name, str) and callable(function), f"observe[{name!r}]", function, OBSERVER_HINT)
        if name in {"dt", *column_getters(model)}:
            raise InputError(f"observe: column {name!r} exists already; give it another name")
    require(0.5 <= theta <= 1, "theta", theta, "allowed: 1/2 (midpoint rule) to 1 (backward Euler)")
    require(keep in ("all", "last"), "keep", keep, "allowed: 'all', 'last'")
    require_resume(resume)
    named = isinstance(out, (str, Path)) and str(out)
    require(named or (out is None and not resume), "out", out, "it must be the name of a folder, and resume needs one")


# ---------------------------------------------------------------- errors of planned steps
def warn_of_step_errors(controller: Controller, theta: float, initial_states: Sequence[State]) -> None:
    """Estimate the errors of a march with steps to given times, and warn if they are large. Collective.

    The march is repeated with half as many steps, which adds half as many solves. Fewer than eight steps are repeated
    as 8 to 14. The differences of states at common times give the errors of the whole march to leading order, which no
    single halved step would give. They are relative to the largest norms of all these states, so that what fails during
    the march counts. A march that has dissipated nothing is not repeated, and its errors are set to 0. The errors are
    stored in `History.step_errors`.

    Args:
        controller: controller of the march, which has ended.
        theta: fraction of each step after which forces balance.
        initial_states: states from which the march continued; (): it started from rest.
    """
    solver, history, n = controller.solver, controller.journal.history, len(controller.targets)
    dissipated, supplied = (np.abs(np.array(history.table[name], float)).sum() for name in ("dissipated", "supplied"))
    if dissipated <= MIN_DISSIPATION_RATIO * supplied:  # false for NaN, if a law declares no energy
        history.step_errors = dict.fromkeys(COMPARED_QUANTITIES, 0.0)
        return
    targets = _comparison_targets(controller.targets, controller.start, solver.model.break_times)
    remedy = "take more steps, or times=Adaptive(end=..., first=..., tolerance=...)"
    try:
        with report("error of the steps"):
            keep = "all" if len(history.states) > 1 else "last"
            journal = Journal(solver.equations, {"start": controller.start, "theta": theta}, keep=keep)
            coarse = PlannedTimes(targets).controller(solver, journal, targets, {}).run(initial=initial_states)
    except SolveError as error:
        history.step_errors = dict.fromkeys(COMPARED_QUANTITIES, np.nan)
        text = f"the error of the march's steps is not known: with {len(targets)} steps {error.reason}; {remedy}"
        solver.model.warn("no step error", text, *controller.targets)
        return
    error_ratio = abs((n / len(targets)) ** (2 if theta == 0.5 else 1) - 1)
    by_time, estimate = {state.t: state for state in coarse.states.values()}, ErrorEstimate(solver.equations)
    pairs = [(by_time[state.t], state) for state in history.states.values() if state.t in by_time and not state.at_rest]
    largest = np.max([estimate.state_norms(state) for _, state in pairs], axis=0)
    relative_errors = np.max([estimate.differences(*pair, largest) for pair in pairs], axis=0) / error_ratio
    history.step_errors = dict(zip(COMPARED_QUANTITIES, map(float, relative_errors), strict=True))
    if relative_errors.max() > WARN_STEP_ERROR:
        errors_text = ", ".join(f"{error:.2g} in {name}" for name, error in history.step_errors.items())
        text = f"the {n} steps of this march leave estimated relative errors of {errors_text}"
        solver.model.warn("step error", f"{text} (march with {len(targets)} steps); {remedy}", *controller.targets)


def _comparison_targets(targets: Sequence[float], start: float, breaks: set[float]) -> list[float]:
    """Return the ends of steps for a repeated march with half as many steps.

    They are every second time of the march, counted from its end, and the break times. If these are too few, or not
    clearly fewer than before, each step of the march is divided into equal parts instead.

    Args:
        targets: times at which the steps of the march ended.
        start: time at which it started.
        breaks: break times of `piecewise` data, where slopes change.
    """
    last_index = len(targets) - 1
    every_second = [t for k, t in enumerate(targets) if (last_index - k) % 2 == 0 or t in breaks]
    if len(targets) >= MIN_HALVED_STEPS and 4 * len(every_second) <= 3 * len(targets):
        return every_second
    n_parts = max(2, math.ceil(MIN_HALVED_STEPS / len(targets)))
    return [b - (b - a) * k / n_parts for a, b in pairwise([start, *targets]) for k in reversed(range(n_parts))]
