"""Solution of a model: the function `solve` for one equilibrium, the class `Solver` for a sequence of time steps."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field, replace
from typing import TypedDict

from mpi4py import MPI
from petsc4py import PETSc

from forms.base import InputError, is_finite, require
from geometry.parallel import default_comm
from geometry.refusals import require_known
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import Report, State, displacements_of
from thinlayer.errors import LooseBody, SolveError
from thinlayer.parts.part import TimeStep
from thinlayer.solving.contact.methods import SOLVER_OF_METHOD, default_method, why_unsuited
from thinlayer.solving.equations import Equations
from thinlayer.solving.linear_solvers import solver_options
from thinlayer.solving.newton import (
    CONTACT_HOMOTOPY_OPTIONS,
    CONTACT_OPTIONS,
    NEWTON_OPTIONS,
    SINGULAR_TANGENT_OPTIONS,
    YIELDING_OPTIONS,
    EquilibriumSolver,
    NewtonSolver,
    StepSolution,
)
from thinlayer.solving.petsc import (
    PREFIX,
    OptionDict,
    Options,
    db_options,
    faster_products,
    require_options_read,
    set_options,
    user_has_set,
    user_value,
)
from thinlayer.solving.ranges import warn_of_model, warn_of_no_time, warn_of_states
from thinlayer.solving.weak_springs import WeakSprings
from thinlayer.system.progress import logger
from thinlayer.system.ranks import errors_on_all, free_petsc_objects, require_same

# a reason, see `PartSum.refuse_traits`
SOFTENING_MESSAGE = "the stress of {} falls as jumps grow, with several equilibria; follow them by march(model, times)"
FIRST_DECREMENT, MIN_DECREMENT = 0.5, 1 / 64  # decrements of the continuation parameter
MAX_HOMOTOPY_SOLVES = 30  # number of solves after which a homotopy is given up
FAIL_FAST_OPTIONS = OptionDict(snes_max_it=30, snes_max_linear_solve_fail=1)  # if another method follows
DIVERGENCE_RATIO = 1e5  # displacements, relative to an elastic layer's, above which no equilibrium is expected


def solve(
    model: Model,
    t: float = 0.0,
    *,
    options: Options | None = None,
    method: str | None = None,
    like: State | None = None,
) -> State:
    """Solve a model for its equilibrium under the loads of one time, applied suddenly. Collective.

    Laws with memory or relaxation respond as they do just after sudden loads on the model at rest.

    Args:
        model: the model.
        t: time at which loads, prescribed displacements and parameters are taken.
        options: {name of a PETSc option without its prefix: value}; they override the defaults of this package. An
            option -thinlayer_NAME in PETSc's database, as from the command line, overrides both.
        method: name of the method; None: the default.

            - Without contact laws "linear" is one linear solve, and "newton" is Newton's method. The default is
              "linear" if every law is linear, else "newton".
            - With contact laws "newton" is Newton's method for all unknowns. It is the default if a body is not linear,
              or a seam has no contact law. It is also the default for user-defined laws, inclined supports, rigid
              plates and periodic joints.
            - "condensed", for contact on one rank, condenses the bodies to the nodes of S. It is the default in all
              other cases if S has few nodes.
            - "multigrid", for contact, is Newton's method with a multigrid preconditioner. It is the default in all
              remaining cases.
            - "relaxation", for contact of one seam without branches on one rank, is the method of the paper. It serves
              for comparison.
        like: a state of an interface model of the same joint, for example with another load, thickness or law. Without
            contact laws Newton's method starts from its displacements. With contact laws "condensed" and "multigrid"
            start from its jumps on S, and the other methods ignore it. A solve that fails from there starts again from
            the model at rest.

    Warns:
        RangeWarning: an interface model, or its result, is outside the range in which its law is valid; strains of
            bodies are not small; elements of bodies lock; a law relaxes (Maxwell), and the result is its response just
            after sudden loads. A warning about the model is issued in its first solve only. A warning about a result is
            issued once for each seam and time.

    Raises:
        SolveError: no convergence, or no unique solution; its subclass LooseBody if a body can move freely.
        InputError: an unknown or unsuitable method; a PETSc option that the solver does not read; a law that depends on
            rates or softens; loads that are not finite; `like` of another joint.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> print(state.reaction("BOTTOM").force.round(6))
        [-12.  40.]
    """
    with Solver(model, options=options, method=method, like=like) as solver:
        with errors_on_all(model.comm):
            require(is_finite(t), "t", t, "it must be a finite number")
        require_same(model.comm, t=t)
        reason = "{} depends on rates: no equilibrium without time; use march(model, times)"
        reason += model.kinematics.quantities.steady_remedy
        solver.equations.refuse_traits({"softens": f"solve: {SOFTENING_MESSAGE}", "rate": reason})
        warn_of_model(model)
        warn_of_no_time(model)
        state = solver.solve_sudden(float(t))
    warn_of_states([state])
    return state


class SolverChoices(TypedDict, total=False):
    """Keyword arguments `options` and `method` of `solve`, as a march passes them to its solver."""

    options: Options | None
    method: str | None


def comm_of(model: object) -> MPI.Intracomm:
    """Return the MPI communicator of a model, or the package's default one if `model` is not a Model."""
    return model.comm if isinstance(model, Model) else default_comm()


def _check_like(model: Model, like: State) -> None:
    require(isinstance(like, State), "like", like, "it must be a state of a model of the same joint")
    source = like.model
    require(source.joint is model.joint, "the model of like", source, "it must be a model of the same joint")
    if not (model.broken and source.broken) or (model.element, model.bonds) != (source.element, source.bonds):
        raise InputError("like must be a state of an interface model with the same element and bonds as this model")


SolverConfig = tuple[str, OptionDict]  # a method, and PETSc options of its linear solver


@dataclass(frozen=True)
class SolveAttempt:
    """One way of solving a time step, which is tried until one succeeds: a method with its options.

    Attributes:
        name: name of the attempt in the log.
        config: pair of the method's name and the PETSc options of its linear solver, {name without prefix: value}.
        options: PETSc options of Newton's method, {name without prefix: value}.
        uses_homotopy: whether the step is solved by continuation: first with an elastic law, at last with the given
            law.
    """

    name: str
    config: SolverConfig
    options: Options = field(default_factory=dict)
    uses_homotopy: bool = False


class Solver(AbstractContextManager["Solver"]):
    """Solver of a model for one time step after another, which keeps matrices and factors between the steps.

    A factor is used again while its matrix stays the same. Use the solver in a `with` statement, or call `close`.

    Args:
        model: the model.
        options: {name of a PETSc option without its prefix: value}.
        method: name of the method, see `solve`; None: the default for the model.
        like: a state of an interface model of the same joint, whose displacements are the initial guess; None: the
            guess is the state before a step.

    Attributes:
        yields: whether a law bounds stresses, so that loads may have a limit.
        limited: whether loads may have a limit: a law bounds stresses, or seams in contact slide or open.

    Raises:
        InputError: an unknown or unsuitable method; options that are not a dictionary; `like` of another joint.
    """

    def __init__(
        self, model: Model, *, options: Options | None = None, method: str | None = None, like: State | None = None
    ) -> None:
        with errors_on_all(comm_of(model)):
            require(isinstance(model, Model), "model", model, "give what Structure.full or Structure.interface returns")
            default_name = default_method(model) if model.contact else "linear" if model.linear else "newton"
            self.model, self.method = model, default_name if method is None else method
            self._check_method()
            if like is not None:
                _check_like(model, like)
            is_mapping = isinstance(options or {}, Mapping) and all(isinstance(name, str) for name in options or {})
            require(is_mapping, "options", options, "it must be {name without prefix: value}")
        self._user_options, self._like = dict(options or {}), like
        hashes = {"models": model.data_hash, "like": like and [like.model.data_hash, like.t]}
        require_same(model.comm, **hashes, options=self._user_options, method=self.method)
        self._log = logger("solve", model.comm)
        for line in model.remarks:
            self._log.info(line)
        self.equations = Equations(model)
        traits = self.equations.traits
        self.yields, self.limited = traits.bounded, traits.bounded or traits.releases
        self._warned_of_softening = False  # whether the user was warned of a law that softens
        self._configs = self._configs_of(self.method)  # later without the ways that failed before one succeeded
        if method is None and self.method == "multigrid" and not (self._user_options or db_options()):
            self._configs += self._configs_of("newton")
        self._solvers = dict[str, EquilibriumSolver]()
        self._solver = self._solver_of(self.method)

    def _check_method(self) -> None:
        """Raise InputError unless the method suits the model."""
        if self.method not in tuple(SOLVER_OF_METHOD):  # it may be anything, also not hashable
            allowed = ("newton", *SOLVER_OF_METHOD) if self.model.contact else ("linear", "newton")
            require_known("method", self.method, allowed)
        elif reason := why_unsuited(self.model, self.method):
            raise InputError(f"method={self.method!r} {reason}")
        if self.method == "linear" and not self.model.linear:
            raise InputError("method='linear' cannot solve a non-linear law; use method='newton'")

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:  # an error may have occurred on one rank only, and `free_petsc_objects` is collective
            free_petsc_objects(self.equations.comm)
        self.close()

    def _configs_of(self, method: str) -> list[SolverConfig]:
        """Return the linear solvers of a method, in the order in which they are tried.

        Args:
            method: name of the method.

        Returns:
            Pairs of the method's name and the PETSc options of a linear solver, {name without prefix: value}. Methods
                of contact choose their options themselves: for them there is one pair without options.
        """
        if method in SOLVER_OF_METHOD:
            return [(method, {})]
        linear_options = solver_options(self.model, self.equations.parts, user_value("pc_type", self._user_options))
        user_chooses = user_has_set("ksp_type", self._user_options) or user_has_set("pc_type", self._user_options)
        return [(method, options) for options in (linear_options[:1] if user_chooses else linear_options)]

    def _solver_of(self, method: str) -> EquilibriumSolver:
        """Return the solver object of the method with the name `method`; it is created at its first use."""
        if method not in self._solvers:
            cls = SOLVER_OF_METHOD.get(method)
            self._solvers[method] = cls(self.equations, self._like) if cls else self._newton_solver(method)
        return self._solvers[method]

    def _newton_solver(self, method: str) -> NewtonSolver:
        own_test = not (user_has_set("snes_atol", self._user_options) or user_has_set("snes_rtol", self._user_options))
        advice = "a march from less (loads may have a limit)" if self.yields else f"-{PREFIX}snes_linesearch_type basic"
        if self.model.contact:
            advice = "another method, supports (is a body pulled off, or pushed harder than friction holds?)"
        nonlinear, advice = method == "newton", f"a smaller step or load, {advice}"
        return NewtonSolver(self.equations, nonlinear=nonlinear, force_test=own_test, yields=self.yields, advice=advice)

    def close(self) -> None:
        """Free matrices and factors."""
        for solver in self._solvers.values():
            solver.close()
        self.equations.destroy()

    def rest_state(self, t: float) -> State:
        """Return the state at rest at time `t`, before the first step: displacements are zero, and stresses too."""
        return self.equations.rest_state(t)

    def solve_sudden(self, t: float) -> State:
        """Return the equilibrium right after the loads of time `t` act suddenly on the model at rest. Collective.

        Inertia is neglected. No time passes, so that nothing creeps or relaxes.

        Raises:
            SolveError: no convergence, or no unique solution.
        """
        return self.step(self.rest_state(t), t)

    def step(self, old: State, t: float, theta: float = 1.0, homotopy: bool = True, keep_phases: bool = False) -> State:
        """Solve a time step, and return the state at its end. Collective.

        A step of length 0 is the response to a sudden change of the loads.

        Args:
            old: the state before the step.
            t: time at the end of the step, >= old.t.
            theta: fraction of the step after which forces balance, at old.t + theta (t - old.t); 1: backward Euler.
            homotopy: whether, if Newton's method fails, a continuation is tried that starts from an elastic law.
            keep_phases: whether laws with phases keep the phases of `old`. Otherwise the step is solved again until
                each column has the phase of lowest energy. A column is a facet of S, or the cells above it in a meshed
                layer.

        Raises:
            SolveError: no convergence, or no unique solution.
            InputError: loads that are not finite, or a PETSc option that the solver does not read.
        """
        start_time = time.perf_counter()
        self.equations.begin(TimeStep(old, t, t - old.t, theta))
        attempts = [attempt for attempt in self._attempts() if homotopy or not attempt.uses_homotopy]
        solutions = [self._solve_from_like(attempts[0], old) or self._try_in_turn(attempts)]
        while not keep_phases and self.equations.switch():
            self._log.info("t = %g: columns change their phase; the equilibrium is found again", t)
            solutions.append(self._try_in_turn(attempts))
        last, iterations = solutions[-1][0], sum(solution.iterations for solution, _ in solutions)
        seconds, homotopy_steps = time.perf_counter() - start_time, sum(steps for _, steps in solutions)
        return self._accept(last.x, Report(self.method, iterations, last.residual, seconds, homotopy_steps))

    def solve_regularised(self, old: State, t: float, theta: float = 1.0) -> State:
        """Solve a time step for which `step` has failed, with weak springs at all nodes; return its state. Collective.

        The springs soften until Newton's method converges without them, see `WeakSprings`.

        Args:
            old: the state before the step.
            t: time at the end of the step.
            theta: fraction of the step after which forces balance.

        Raises:
            NoEquilibrium: displacements grow without bound as the springs soften.
            SolveError: no convergence.
        """
        start_time = time.perf_counter()
        attempts = [attempt for attempt in self._attempts() if not attempt.uses_homotopy]
        self._log.info("t = %g: weak springs at all nodes are tried", t)
        # methods for contact have no options of a linear solver
        linear_options = self._configs[0][1] or solver_options(self.model, self.equations.parts)[0]
        springs = WeakSprings(self.equations, {**linear_options, **self._user_options})

        def soften_to(end: float) -> StepSolution:
            step = TimeStep(old, end, end - old.t, theta)
            return springs.soften(self.rest_state(end), step, lambda begin: self._try_in_turn(attempts, begin))[0]

        solution = soften_to(t)
        report = Report(self.method, solution.iterations, solution.residual, time.perf_counter() - start_time)
        try:
            return self._accept(solution.x, report)
        except LooseBody:  # the loads may be exactly at their limit: then slightly higher loads have no equilibrium
            with suppress(InputError):  # tables of loads may end before this time
                soften_to(2 * t - old.t)
            raise

    def _solve_from_like(self, attempt: SolveAttempt, old: State) -> tuple[StepSolution, int] | None:
        """Solve the step by Newton's method from the displacements of the state `like` that the constructor was given.

        Args:
            attempt: method and options of the solve.
            old: the state before the step.

        Returns:
            The solution, and 0 as the number of its solves by continuation. None: Newton's method failed, there is no
                `like`, the method is not "newton", or the model has contact laws.
        """
        if self._like is None or self.method != "newton" or self.model.contact:
            return None
        equations, start = self.equations, self.equations.create_vector()
        equations.put_state(replace(old, u=displacements_of(self._like, self.model)), start)
        start.array[equations.bc_dofs] = equations.prescribed
        try:
            return self._try(attempt, start), 0
        except SolveError as error:
            self._log.info("t = %g: Newton's method from like failed: %s", equations.interval.t, error.reason)
            return None

    def _accept(self, x: PETSc.Vec, report: Report) -> State:
        """Return the state at the end of the step, from its unknowns `x` and the solver's report.

        A warning follows, once, if the stress of a law falls although the law does not declare `softens`.
        """
        state = self.equations.accept(x, report)
        softenings = [] if self._warned_of_softening else [part.undeclared_softening() for part in self.equations.parts]
        for name, where in [*filter(None, softenings)][:1]:
            self._warned_of_softening = True
            text = f"at t = {state.t:g} the stress of {name} falls {where} as jumps or strains grow: there may be other"
            remedy = "write softens = True in the class, and follow them by march(model, ArcLength(...))"
            self.model.warn("softens", f"{text} equilibria, over which steps may pass; {remedy}", state.t)
        return state

    # ---------------------------------------------------------------- attempts
    def _attempts(self) -> list[SolveAttempt]:
        """Return the ways of solving a step, in the order in which they are tried.

        Each method is tried with each of its linear solvers. A continuation from an elastic law comes last, if laws
        have one.
        """
        traits, attempts = self.equations.traits, list[SolveAttempt]()
        contact_options = CONTACT_OPTIONS if self.model.contact else {}
        law_options = YIELDING_OPTIONS if self.yields else SINGULAR_TANGENT_OPTIONS if traits.singular else {}
        newton_options = {**NEWTON_OPTIONS, **law_options, **contact_options}
        for method, linear_options in self._configs:
            name = ", ".join(filter(None, (method, str(linear_options.get("pc_type", "")))))
            options = newton_options if method == "newton" else FAIL_FAST_OPTIONS if len(self._configs) > 1 else {}
            attempts.append(SolveAttempt(name, (method, linear_options), options))
        if traits.has_homotopy and self._solver.has_homotopy:
            options = {**attempts[-1].options, **(CONTACT_HOMOTOPY_OPTIONS if contact_options else {})}
            attempts.append(replace(attempts[-1], name="homotopy", options=options, uses_homotopy=True))
        return attempts

    def _try_in_turn(self, attempts: list[SolveAttempt], start: PETSc.Vec | None = None) -> tuple[StepSolution, int]:
        """Solve the step by the first of several attempts that succeeds.

        An attempt that fails is not made in later steps if one with another method or linear solver succeeds.

        Args:
            attempts: the attempts, in order.
            start: unknowns from which attempts without continuation start; None: those of the state before the step.

        Returns:
            The solution, and the number of its solves by continuation (0 without). The iterations of the solution
                include those of failed attempts with the last method and linear solver.

        Raises:
            SolveError: all attempts failed. The error is that of the first attempt with the last method and linear
                solver, or a LooseBody of the continuation.
        """
        why, errors = "", list[SolveError]()
        for attempt in attempts:
            if attempt.config not in self._configs:
                continue
            if why:
                self._log.info("t = %g: %s is tried, as %s", self.equations.interval.t, attempt.name, why)
            try:
                solution, solves = self._homotopy(attempt) if attempt.uses_homotopy else (self._try(attempt, start), 0)
            except SolveError as error:
                why = f"{attempt.name} failed: {error.reason}"
                if attempt.config == self._configs[-1]:
                    errors.append(error.with_traceback(None))  # else a reference cycle: error, traceback, frame, errors
            else:
                self.method, self._configs = attempt.config[0], self._configs[self._configs.index(attempt.config) :]
                return replace(solution, iterations=solution.iterations + sum(len(e.residuals) for e in errors)), solves
        if isinstance(errors[-1], LooseBody) and len(errors) > 1:
            errors[-1].residuals = (*errors[0].residuals, *errors[-1].residuals)
            raise errors.pop()
        raise errors.pop(0) from (errors.pop() if errors else None)

    def _try(self, attempt: SolveAttempt, start: PETSc.Vec | None = None) -> StepSolution:
        """Solve the step by one attempt.

        The PETSc options of the attempt are set. Those of the user override them, and all of these must be read. If the
        attempt fails with the factor of an earlier step, it is repeated with a new factor.

        Args:
            attempt: method and options of the solve.
            start: initial unknowns; None: those of the state before the step.
        """
        start_time, defaults = time.perf_counter(), {**attempt.config[1], **attempt.options}
        self._solver = self._solver_of(attempt.config[0])
        while True:
            try:
                with set_options(defaults, self._user_options), faster_products(serial=self.equations.comm.size == 1):
                    solution = self._solver.solve_step(start)
                    if not self._solver.reused_solver:
                        require_options_read(attempt.config[0], defaults.keys() - self._user_options.keys())
            except SolveError as error:
                self._log.debug("%s: failed after %d iterations: %s", attempt.name, len(error.residuals), error.reason)
                if not self._solver.reset():
                    raise
            else:
                summary = attempt.name, solution.iterations, solution.residual, time.perf_counter() - start_time
                self._log.debug("%s: %d iterations, residual %.1e of the forces, %.2g s", *summary)
                return solution

    def _homotopy(self, attempt: SolveAttempt) -> tuple[StepSolution, int]:
        """Solve the step by continuation from an elastic layer to the given law.

        The parameter of the continuation falls from 1, an elastic layer, to 0, the given law. Its decrement is doubled
        after a solve that converges, and halved after one that fails. Each solve starts from the unknowns of the last
        that converged. The strains and memory before the step stay the same.

        Args:
            attempt: method and options of the solves.

        Returns:
            The solution, and the number of solves.

        Raises:
            SolveError: the solve with a law of the continuation fails, or displacements grow without bound.
            LooseBody: a body has been released.
        """
        last_x, limit_u = self.equations.create_vector(), math.inf
        last_parameter, parameter, decrement, n_solves, iterations = 1.0, 1.0, FIRST_DECREMENT, 0, 0
        initial_x: PETSc.Vec | None = None
        try:
            while True:
                n_solves += 1
                self.equations.set_homotopy(parameter)
                try:
                    solution = self._try(replace(attempt, name=f"{attempt.name} at {parameter:g}"), initial_x)
                except SolveError as error:
                    iterations, decrement = iterations + len(error.residuals), (last_parameter - parameter) / 2
                    if initial_x is None or decrement < MIN_DECREMENT or n_solves >= MAX_HOMOTOPY_SOLVES:
                        raise
                else:
                    iterations, peak = iterations + solution.iterations, float(solution.x.norm(PETSc.NormType.INFINITY))
                    solution.x.copy(last_x)
                    if peak > limit_u:
                        raise SolveError(f"displacements are {DIVERGENCE_RATIO:g} times those of an elastic layer")
                    if not parameter:
                        return replace(solution, iterations=iterations), n_solves
                    if initial_x is None:
                        initial_x, limit_u = last_x, DIVERGENCE_RATIO * peak
                    else:
                        last_parameter, decrement = parameter, 2 * decrement
                parameter = max(last_parameter - decrement, 0.0)
        except SolveError as error:
            if not self.equations.traits.releases:
                raise
            self.equations.set_homotopy(0.0)
            self.equations.residual(last_x, self.equations.create_vector())
            try:
                self.equations.require_unique()
            except LooseBody as loose:
                advice = "is it pulled off, or pushed harder than friction holds? Give it supports or a smaller load"
                reason = f"no equilibrium found ({error.reason}): where the search ended, {loose.motion}"
                raise LooseBody(reason, loose.motion, advice, error.residuals) from error
            raise
        finally:
            self.equations.set_homotopy(0.0)
