"""Solvers of a model, for one equilibrium or step after step."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

from thinlayer.contact.solver import METHODS, ContactSolver, check_method, contact_problem, default_method
from thinlayer.discretisation.kinds import InterfaceModel
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import Report, State
from thinlayer.errors import ModelError, SolveError, warn
from thinlayer.parallel.agreement import on_all, require_same
from thinlayer.parts.contact import ContactPart
from thinlayer.parts.part import Interval
from thinlayer.solving.continuation import Continuation
from thinlayer.solving.equations import Equations
from thinlayer.solving.equilibrium import Equilibrium
from thinlayer.solving.linear_solvers import failed_in_petsc, linear_solvers
from thinlayer.solving.newton import FLAT, NEWTON, YIELDING
from thinlayer.solving.options import (
    PREFIX,
    OptionError,
    OptionValue,
    defaults,
    is_set,
    require_all_read,
    require_known_values,
)
from thinlayer.solving.ranges import warn_of_model, warn_of_states
from thinlayer.solving.restraint import Restraint
from thinlayer_base import is_number

SEARCHES = ("bt", "l2")  # Newton's line searches where a law yields


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

    Warns:
        RangeWarning: an interface model, or its result, is outside the range of its law.

    Raises:
        SolveError: no convergence, or no unique solution. OptionError: a PETSc option that the solver does not read.
        ModelError: a law without an instantaneous response; loads that are not finite; `like` of another joint.
        ValueError: unknown method, or a linear solve of a non-linear law.
    """
    with on_all(comm_of(model)):
        _require_model(model)
        slow = [type(p.law).__name__ for p in model.terms if p.law.traits.rate]
        if slow:
            raise ModelError(
                f"{slow[0]} depends on the strain rate: no equilibrium without time; use march(model, times)"
            )
        if not is_number(t) or not math.isfinite(t):
            raise ModelError(f"t is {t!r}; it must be a finite number")
        require_hardening(model, "solve")
    require_same(model.comm, t=t)
    with Solver(model, options=options, method=method, like=like) as solver:
        warn_of_model(model)
        try:
            state = solver.step(solver.rest(t), t)
        except SolveError as error:
            if not solver.yields:
                raise
            advice = "loads on a layer that yields may have a limit: let them grow in time, and march in small steps"
            raise SolveError(error.reason, residuals=error.residuals, advice=advice) from error
    warn_of_states([state])
    return state


def require_hardening(model: Model, what: str) -> None:
    """Raise ModelError if the layer's law softens: at the same loads there may be several equilibria."""
    if isinstance(model, InterfaceModel) and model.layer_law and model.layer_law.traits.softens:
        raise ModelError(
            f"{what}: the stress of {model.layer_law!r} falls as jumps grow, and an equilibrium may be one of several; "
            "follow them from rest with march(model, ArcLength(...))"
        )


def comm_of(model: Any) -> MPI.Intracomm:
    """Communicator of a model; the world, if it is none."""
    return model.comm if isinstance(model, Model) else MPI.COMM_WORLD


def _require_model(model: Any) -> None:
    if not isinstance(model, Model):
        raise ModelError(f"model is {model!r}; give what Structure.full or Structure.interface returns")


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
    if model.contact is None or not isinstance(like.model, InterfaceModel) or like.model.element != model.element:
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
        with on_all(comm_of(model)):
            _require_model(model)
            model.require_same_laws()
            self.model, self.method = model, _default_method(model) if method is None else method
            self._check(method, like)
            named = options is None or (isinstance(options, Mapping) and all(isinstance(name, str) for name in options))
            if not named:
                raise OptionError(f"options is {options!r}; it must be {{name without prefix: value}}")
        self._given = dict(options or {})
        marks = {"models": model.mark, "like": like and [like.model.mark, like.t]}
        require_same(model.comm, **marks, options=self._given, method=self.method)
        self._choices = [{}] if self.method in METHODS else linear_solvers(model)
        if len(self._choices) > 1 and (is_set("ksp_type", self._given) or is_set("pc_type", self._given)):
            self._choices = self._choices[:1]
        self.equations = Equations(model)
        self._finder = self._contact_solver(like) if self.method in METHODS else self._equilibrium()
        self._told = False  # whether a law that softens has been told
        self._settled = False  # whether a contact solver has read its options, which it does once

    def _check(self, method: Any, like: Any) -> None:
        """Raise an error unless the method is one for the model, and so is the state to begin from."""
        model, allowed = self.model, ("newton", *METHODS) if self.model.contact else ("linear", "newton")
        if self.method not in allowed:
            check_method(model, self.method)
            raise ValueError(f"unknown method {method!r}; allowed: {', '.join(allowed)}")
        check_method(model, self.method)
        _check_like(model, like)
        if self.method == "linear" and not model.linear:
            raise ValueError("method='linear' cannot solve a non-linear law; use method='newton'")

    def __enter__(self) -> Solver:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _equilibrium(self) -> Equilibrium:
        own_test = not (is_set("snes_atol", self._given) or is_set("snes_rtol", self._given))
        advice = f"a smaller step or load, {self._advice}"
        curved = self.method == "newton"
        return Equilibrium(self.equations, curved=curved, own_test=own_test, yields=self.yields, advice=advice)

    def _contact_solver(self, like: State | None) -> ContactSolver:
        equations = self.equations
        (contact,) = equations.of_kind(ContactPart)
        return ContactSolver(contact_problem(contact.nodes, equations.K, equations.held), self.method, like)

    def close(self) -> None:
        """Free matrices and factors."""
        self._finder.close()
        self.equations.destroy()
        self.model.laws_were_read()

    def rest(self, t: float) -> State:
        """The model before anything happened."""
        return self.equations.rest(t)

    def step(self, old: State, t: float, theta: float = 1.0, thorough: bool = True, *, held: bool = False) -> State:
        """State at a time t >= old.t, with the balance of forces at old.t + theta (t - old.t). Collective.

        With t = old.t it is the response to a sudden load. Errors as in `solve`. Where Newton's method fails with a law
        that yields, it is tried with another line search and then through laws that are easier, if `thorough`. Phases that
        columns of the layer change are changed, and the equilibrium is found again, until none does; not if `held`.
        """
        start = time.perf_counter()
        self.equations.begin(Interval(old, t, t - old.t, theta))
        x, iterations, residual, eased = self._find(old, thorough)
        while not held and self.equations.switch():
            x, more, residual, again = self._find(old, thorough)
            iterations, eased = iterations + more, eased + again
        return self._accept(x, Report(self.method, iterations, residual, time.perf_counter() - start, eased))

    def seek(self, old: State, t: float, theta: float = 1.0) -> State:
        """The state at the end of a step that `step` does not find, by weak springs at all nodes. Collective.

        Raises:
            NoEquilibrium: displacements run away as the springs soften. SolveError: nothing is found.
        """
        start = time.perf_counter()
        restraint = Restraint(self.equations, {**self._choices[0], **self._given})
        try:
            x, iterations, residual = restraint.follow(
                self.rest(t), Interval(old, t, t - old.t, theta), lambda begin: self._nearest(old, begin)
            )
        finally:
            restraint.close()
        return self._accept(x, Report(self.method, iterations, residual, time.perf_counter() - start))

    def _nearest(self, old: State, begin: PETSc.Vec) -> tuple[PETSc.Vec, int, float]:
        """Unknowns at the end of the step near some, iterations, residual."""
        for search in self._searches:
            try:
                return self._solve(old, search, begin)
            except SolveError as error:
                failed = error
        raise failed

    def _accept(self, x: PETSc.Vec, report: Report) -> State:
        state = self.equations.accept(x, report)
        self._tell_softening(state.t)
        return state

    def _tell_softening(self, t: float) -> None:
        """Warn, once, where the stress of a law falls that does not say so: at the same loads there may be other states."""
        if self._told:
            return
        found = next(filter(None, (part.undeclared_softening() for part in self.equations.parts)), None)
        if found:
            name, where = found
            self._told = True
            warn(
                f"at t = {t:g} the stress of {name} falls {where} as jumps or strains grow: this equilibrium "
                "may be one of several, and steps may pass over others; write softens = True in the class and follow "
                "them on S with march(model, ArcLength(...))",
                self.model.comm,
            )

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
        if not (thorough and self.equations.traits.eases):
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
        assert isinstance(self._finder, Equilibrium)
        found.copy(self._finder.x)
        found.destroy()
        return self._finder.x, spent, residual, way.solves

    def _solve(self, old: State, search: str | None, begin: PETSc.Vec | None = None) -> tuple[PETSc.Vec, int, float]:
        """Unknowns at the end of the step, with one of the linear solvers; iterations, residual."""
        if isinstance(self._finder, ContactSolver):
            found = self._with_options(self._finder.advance, old, self.equations.loads, self.equations.prescribed)
            self._settled = True
            return found
        while True:
            try:
                return self._with_options(self._finder.advance, begin, search=search)
            except SolveError:
                reused = self._finder.reused
                self._finder.drop_factor()
                if not reused and len(self._choices) == 1:
                    raise
                if not reused:
                    self._choices.pop(0)

    def _with_options(
        self, advance: Callable[..., tuple[PETSc.Vec, int, float]], *given: Any, search: str | None = None
    ) -> tuple[PETSc.Vec, int, float]:
        """What a solver finds with our PETSc options and the user's, all of which it must read."""
        ours = {**self._choices[0], **self._newton_options(search)}
        with defaults({**ours, **self._given}):
            try:
                found = advance(*given)
            except PETSc.Error as error:
                require_known_values(error, ours.keys() - self._given.keys())
                raise failed_in_petsc(error) from error
            if not (self._settled or (isinstance(self._finder, Equilibrium) and self._finder.reused)):
                require_all_read(self.method, ours.keys() - self._given.keys())
            return found

    @property
    def yields(self) -> bool:
        """Whether the layer's law bounds stresses, so that loads may have a limit."""
        return any(p.law.traits.bounded for p in self.model.layer_terms)

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
        options = NEWTON | YIELDING if self.yields else NEWTON | FLAT if self.equations.traits.singular else NEWTON
        return options | ({"snes_linesearch_type": search} if search else {})

    @property
    def _advice(self) -> str:
        if self.model.contact:
            return "another method, supports (is a body pulled off, or pushed harder than friction holds?)"
        return "a larger elastic fraction" if self.yields else f"-{PREFIX}snes_linesearch_type basic"
