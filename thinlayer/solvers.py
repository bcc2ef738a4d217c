"""Solvers of a model, for one equilibrium or step after step."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from numbers import Real
from typing import Any

from dolfinx import fem
from petsc4py import PETSc

from thinlayer.contact.solver import METHODS, ContactSolver, check_method, contact_problem, default_method
from thinlayer.continuation import Continuation
from thinlayer.equations import Equations, Interval
from thinlayer.failure import SolveError
from thinlayer.linear_solvers import linear_solvers, mark, tell_multigrid
from thinlayer.loads import ModelError
from thinlayer.model import Model
from thinlayer.newton import LARGEST_RESIDUAL, NEWTON, YIELDING, newton, reason_name
from thinlayer.options import PREFIX, OptionError, OptionValue, defaults, is_set, require_all_read, require_known_values
from thinlayer.state import Report, State

REFINED_RESIDUAL = {True: 1e-15, False: 1e-10}  # of direct solvers, of Krylov methods
WORTH_REFINING = {True: 1e-6, False: 0.5}  # Krylov methods converge in the preconditioned norm: singular systems too
SEARCHES = ("bt", "l2")  # Newton's line searches where a law yields
FARTHEST = 1e4  # displacements of a first step over the old ones
OVERSHOOT = 10.0  # residual of a first step over the forces


def solve(
    model: Model,
    t: float = 0.0,
    *,
    options: Mapping[str, OptionValue] | None = None,
    method: str | None = None,
    like: State | None = None,
) -> State:
    """Equilibrium of a model at a time; of a layer with memory, its response to the sudden load. Collective.

    Args:
        model: the model.
        t: the time that loads and supports are taken at.
        options: PETSc options without prefix, over our defaults; options given to PETSc as -thinlayer_NAME come first.
        method: "linear" (default if every law is linear) or "newton". Of contact laws "condensed" (to the jumps on S;
            default on one rank while S is narrow), "multigrid" (default otherwise), "newton" (default if a body is not
            linear, or for a law of one's own) or "relaxation" (the paper's, for comparison).
        like: under a contact law, a state of the same joint with a similar contact status, such as that of another load or
            thickness; it saves "condensed" and "multigrid" Newton steps, the other methods do not use it.

    Raises:
        SolveError: no convergence, or no unique solution. OptionError: a PETSc option that the solver does not read.
        ModelError: a law without an instantaneous response; loads that are not finite; `like` of another joint.
        ValueError: unknown method, or a linear solve of a non-linear law.
    """
    _require_model(model)
    slow = [type(p.law).__name__ for p in model.points if p.law.rate]
    if slow:
        raise ModelError(f"{slow[0]} depends on the strain rate: no equilibrium without time; use march(model, times)")
    if not isinstance(t, Real) or not math.isfinite(t):
        raise ModelError(f"t is {t!r}; it must be a finite number")
    with Solver(model, options=options, method=method, like=like) as solver:
        try:
            return solver.step(solver.rest(t), t)
        except SolveError as error:
            if not solver.yields:
                raise
            advice = "loads on a layer that yields may have a limit: let them grow in time, and march in small steps"
            raise SolveError(error.reason, residuals=error.residuals, advice=advice) from error


def _require_model(model: Any) -> None:
    if not isinstance(model, Model):
        raise ModelError(f"model is {model!r}; give what Model.full or Model.interface returns")


def _default_method(model: Model) -> str:
    if model.contact:
        return default_method(model)
    return "linear" if model.linear else "newton"


def _check_like(model: Model, like: Any) -> None:
    if like is None:
        return
    if not isinstance(like, State) or like.model.joint is not model.joint:
        given = f"a state of a model of another joint ({like.model!r})" if isinstance(like, State) else repr(like)[:200]
        raise ModelError(f"like is {given}; it must be a state of a model of the same joint")
    if model.contact is None or like.model.kind != "interface" or like.model.element != model.element:
        raise ModelError("like is for contact laws: a state of an interface model with the same element")


class Solver:
    """Solves a model step after step; keeps matrices, and their factors as long as they stay the same.

    Arguments and errors as in `solve`. Use it in a `with` statement, or call `close`.
    """

    def __init__(
        self,
        model: Model,
        *,
        options: Mapping[str, OptionValue] | None = None,
        method: str | None = None,
        like: State | None = None,
    ) -> None:
        _require_model(model)
        self.model, self.method = model, _default_method(model) if method is None else method
        allowed = ("newton", *METHODS) if model.contact else ("linear", "newton")
        if self.method not in allowed:
            check_method(model, self.method)
            raise ValueError(f"unknown method {method!r}; allowed: {', '.join(allowed)}")
        check_method(model, self.method)
        _check_like(model, like)
        if self.method == "linear" and not model.linear:
            raise ValueError("method='linear' cannot solve a non-linear law; use method='newton'")
        if options is not None and not isinstance(options, Mapping):
            raise OptionError(f"options is {options!r}; it must be {{name without prefix: value}}")
        self._given = dict(options or {})
        self._choices = [{}] if self.method in METHODS else linear_solvers(model)
        if len(self._choices) > 1 and (is_set("ksp_type", self._given) or is_set("pc_type", self._given)):
            self._choices = self._choices[:1]
        if self.method not in METHODS:
            self._own_test = not (is_set("snes_atol", self._given) or is_set("snes_rtol", self._given))
        self.equations = Equations(model)
        self._contact = self._contact_solver(like) if self.method in METHODS else None
        self._ksp: PETSc.KSP | None = None
        self._factored: tuple[float, float] | None = None
        self._reused = False  # whether the last step took the factor of an earlier one
        self._vectors = [self.equations.vector() for _ in range(4)]

    def __enter__(self) -> Solver:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _contact_solver(self, like: State | None) -> ContactSolver:
        equations = self.equations
        assert equations.contact is not None
        return ContactSolver(contact_problem(equations.contact.nodes, equations.K, equations.held), self.method, like)

    def close(self) -> None:
        """Free matrices and factors."""
        if self._contact:
            self._contact.close()
        self._drop_factor()
        for vector in self._vectors:
            vector.destroy()
        self.equations.destroy()

    def _drop_factor(self) -> None:
        if self._ksp is not None:
            self._ksp.destroy()
        self._ksp = self._factored = None

    def rest(self, t: float) -> State:
        """The model before anything happened."""
        report = Report("rest", 0, 0.0, 0.0)
        return State(self.model, fem.Function(self.model.V), t, report, memory=self.equations.rest())

    def step(self, old: State, t: float, theta: float = 1.0, thorough: bool = True) -> State:
        """State at a time t >= old.t, with the balance of forces at old.t + theta (t - old.t). Collective.

        With t = old.t it is the response to a sudden load. Errors as in `solve`. Where Newton's method fails with a law
        that yields, it is tried with another line search and then through laws that are easier, if `thorough`.
        """
        start = time.perf_counter()
        self.equations.begin(Interval(old, t, t - old.t, theta))
        x, iterations, residual, eased = self._find(old, thorough)
        memory, audit = self.equations.audit(x)
        report = Report(self.method, iterations, residual, time.perf_counter() - start, eased)
        return State(self.model, self.equations.u.copy(), t, report, self._pressure(old, theta), memory, audit)

    def _find(self, old: State, thorough: bool) -> tuple[PETSc.Vec, int, float, int]:
        """Unknowns at the end of the step, all iterations, residual, number of solves that continuation took."""
        spent, first = 0, None
        for search in self._searches if thorough else self._searches[:1]:
            try:
                x, iterations, residual = self._solve(old, search)
            except SolveError as error:
                first = first or error
                spent += len(error.residuals)
            else:
                return x, spent + iterations, residual, 0
        assert first is not None
        if not (thorough and self.equations.can_ease):
            raise first
        try:
            x, iterations, residual, solves = self._continue(old)
        except SolveError as error:
            raise first from error
        return x, spent + iterations, residual, solves

    def _continue(self, old: State) -> tuple[PETSc.Vec, int, float, int]:
        """The same through eased laws. Strains and internal values at the beginning of the step stay what they are."""
        way, spent, residual = Continuation(), 0, math.nan

        def solve(ease: float, begin: PETSc.Vec | None) -> PETSc.Vec:
            nonlocal spent, residual
            self.equations.ease(ease)
            try:
                x, iterations, residual = self._solve(old, self._searches[-1], begin)
            except SolveError as error:
                spent += len(error.residuals)
                raise
            spent += iterations
            return x

        try:
            found = way.follow(solve)
        finally:
            self.equations.ease(0.0)
        x = self._vectors[0]
        found.copy(x)
        found.destroy()
        return x, spent, residual, way.solves

    def _solve(self, old: State, search: str | None, begin: PETSc.Vec | None = None) -> tuple[PETSc.Vec, int, float]:
        """Unknowns at the end of the step, with one of the linear solvers; iterations, residual."""
        while True:
            ours = {**self._choices[0], **self._newton_options(search)}
            try:
                with defaults({**ours, **self._given}):
                    try:
                        found = self._advance(old, begin)
                    except PETSc.Error as error:
                        require_known_values(error, ours.keys() - self._given.keys())
                        raise
                    if not self._reused:
                        require_all_read(self.method, ours.keys() - self._given.keys())
                    self._reused |= self._contact is not None  # its solvers read their options once
                    return found
            except SolveError:
                reused, self._reused = self._reused, False
                self._drop_factor()
                if self._contact or (not reused and len(self._choices) == 1):
                    raise
                if not reused:
                    self._choices.pop(0)

    @property
    def yields(self) -> bool:
        """Whether the layer's law bounds stresses, so that loads may have a limit."""
        return any(p.law.yields for p in self.model.layer_points)

    @property
    def _searches(self) -> tuple[str | None, ...]:
        """Line searches to try in turn; None: the one of the options."""
        if self.yields and not is_set("snes_linesearch_type", self._given):
            return SEARCHES
        return (None,)

    def _newton_options(self, search: str | None) -> dict[str, OptionValue]:
        if self.method != "newton":
            return {}
        if self.model.contact:
            search = "basic"
        options = NEWTON | YIELDING if self.yields else NEWTON
        return options | ({"snes_linesearch_type": search} if search else {})

    @property
    def _advice(self) -> str:
        if self.model.contact:
            return "another method, supports (is a body pulled off, or pushed harder than friction holds?)"
        return "a larger elastic fraction" if self.yields else f"-{PREFIX}snes_linesearch_type basic"

    def _pressure(self, old: State, theta: float) -> fem.Function | None:
        """Pressure at the end of the step; the balance of forces has the one at t + theta dt."""
        if self.equations.pressure is None:
            return None
        p = self.equations.pressure.copy()
        if theta < 1 and old.p is not None:
            p.x.array[:] = (p.x.array - (1 - theta) * old.p.x.array) / theta
        return p

    # ---------------------------------------------------------------- one step
    def _advance(self, old: State, begin: PETSc.Vec | None = None) -> tuple[PETSc.Vec, int, float]:
        """Unknowns at the end of the step: a linear step from the old ones, then Newton if need be.

        With `begin` Newton starts from there.
        """
        if self._contact:
            return self._contact.advance(old, self.equations.loads, self.equations.prescribed)
        equations = self.equations
        x, r, d, move = self._vectors
        if begin is not None:
            begin.copy(x)
            equations.residual(x, r)
            return self._newton(x, r)
        n, held = equations.n_displacements, equations.held
        for vector in self._vectors:
            vector.set(0.0)
        x.array[:n] = old.u.x.array[:n]
        if old.p is not None:
            x.array[n:] = old.p.x.array[: equations.n_pressures]
        move.array[held] = equations.prescribed - x.array_r[held]
        if self.method == "linear":
            x.axpy(1.0, move)
        equations.residual(x, r)
        if equations.failed:
            raise SolveError(f"the layer's law failed at {equations.failed} points at the start of the step")
        forces = equations.scale
        r.scale(-1.0)
        if self.method == "linear":
            r.array[held] = 0.0
            self._prepare()
        else:
            self._prepare(move, r)
        iterations = self._solve_linear(r, d)
        if self.yields and x.norm() > 0 and not d.norm() <= FARTHEST * x.norm():  # where all yields nothing resists
            self._elastic_step(x, r, d, move)
        if self.method == "newton":
            d.array[held] = move.array_r[held]
        x.axpy(1.0, d)
        equations.residual(x, r)
        if self.method == "newton":
            self._retreat(x, r, d, move, forces)
            return self._newton(x, r)
        return x, iterations, self._refine(x, r, d)

    def _elastic_step(self, x: PETSc.Vec, r: PETSc.Vec, d: PETSc.Vec, move: PETSc.Vec) -> None:
        """The first step with the stiffness of an elastic layer."""
        equations, ease = self.equations, self.equations.eased
        equations.residual(x, r)
        r.scale(-1.0)
        equations.ease(1.0)
        try:
            equations.residual(x, d)
        finally:
            equations.ease(ease)
        self._prepare(move, r)
        self._solve_linear(r, d)

    def _retreat(self, x: PETSc.Vec, r: PETSc.Vec, d: PETSc.Vec, move: PETSc.Vec, forces: float) -> None:
        """Shorten a first step that a law which stiffens with its rate has made far too long; supports stay moved."""
        d.axpy(-1.0, move)
        for _ in range(40):
            if not forces or self._free_norm(r) <= OVERSHOOT * forces:
                return
            x.axpy(-0.75, d)
            d.scale(0.25)
            self.equations.residual(x, r)

    def _prepare(self, move: PETSc.Vec | None = None, b: PETSc.Vec | None = None) -> None:
        """Matrix and factor of the step; displacements `move` of supports, if any, into the right-hand side b."""
        equations = self.equations
        key = (float(f"{equations.interval.dt:.12g}"), equations.interval.theta)  # equal steps differ by rounding
        self._reused = move is None and self._factored == key
        if self._reused:
            return
        A = equations.tangent()
        A.zeroRowsColumns(equations.held_rows, 1.0, move, b)
        mark(A, self.model, saddle=self.equations.constraint is not None)
        self._drop_factor()
        self._ksp = ksp = PETSc.KSP().create(self.model.comm)
        ksp.setOptionsPrefix(PREFIX)
        ksp.setOperators(A)
        ksp.setFromOptions()
        tell_multigrid(ksp, A, self.model)
        self._factored = key

    def _solve_linear(self, b: PETSc.Vec, x: PETSc.Vec) -> int:
        assert self._ksp is not None
        self._ksp.solve(b, x)
        return int(self._ksp.getIterationNumber())

    def _refine(self, x: PETSc.Vec, r: PETSc.Vec, d: PETSc.Vec) -> float:
        """Steps of iterative refinement after a linear solve; the relative residual, checked."""
        equations, ksp = self.equations, self._ksp
        assert ksp is not None
        reason = ksp.getConvergedReason()
        direct = ksp.getType() == "preonly"
        residual = self._relative(r)
        while REFINED_RESIDUAL[direct] < residual < WORTH_REFINING[direct]:
            r.scale(-1.0)
            ksp.solve(r, d)
            x.axpy(1.0, d)
            equations.residual(x, r)
            refined = self._relative(r)
            if refined >= residual / 2:
                if refined > residual:
                    x.axpy(-1.0, d)
                break
            residual = refined
        if not residual < LARGEST_RESIDUAL:
            few = ", or S has too few cells for the pressures of its layer" if equations.constraint else ""
            raise SolveError(
                f"linear solve failed: {reason_name(PETSc.KSP.ConvergedReason, reason)}, relative residual {residual:.1e}; "
                "a body without supports and without a stiff enough layer can move freely, or a law is not as linear as it "
                f"says{few}; with an iterative solver try -{PREFIX}ksp_max_it or -{PREFIX}pc_type cholesky"
            )
        return residual

    def _relative(self, r: PETSc.Vec) -> float:
        """Residual where nothing is held, over the forces."""
        return self._free_norm(r) / max(self.equations.scale, 1e-300)

    def _free_norm(self, r: PETSc.Vec) -> float:
        r.array[self.equations.held] = 0.0
        return float(r.norm())

    def _newton(self, x: PETSc.Vec, r: PETSc.Vec) -> tuple[PETSc.Vec, int, float]:
        advice = f"a smaller step or load, {self._advice}"
        steps, residual = newton(self.equations, x, r, own_test=self._own_test, hopeless=self.yields, advice=advice)
        return x, steps + 1, residual
