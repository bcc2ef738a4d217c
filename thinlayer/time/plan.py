"""Plans of a march: times, adaptive steps, or a path by arc length; which models they suit, and their controllers."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from numbers import Integral

import numpy as np

from forms.base import InputError, is_finite, is_number, require
from forms.temperature import real_values
from thinlayer.parts.pressure_part import PressurePart
from thinlayer.solving.equations import Equations
from thinlayer.solving.history import TIME_TOLERANCE
from thinlayer.solving.petsc import Options
from thinlayer.solving.solve import SOFTENING_ADVICE, Solver
from thinlayer.time.controller import Controller, is_divisible
from thinlayer.time.following import UNLIMITED_STEPS, ArcLengthController, PathToTimesController
from thinlayer.time.journal import Journal
from thinlayer.time.stepping import AdaptiveController, PlannedStepsController, SnapController

MIN_LENGTH = 1e-3  # length of the shortest step before a turning point, relative to the first step
THETA_HINT = "theta = 1"  # the last words of errors
NO_ERROR_MESSAGE = "Adaptive is for laws that depend on time; steps of {} have no error: give the times to stop at"
NO_PATH_REASONS = {
    "releases": "{} is a contact law: march in time instead of ArcLength",
    "bounded": "{} bounds stresses: on a path loads stay at their limit; march in time, which finds the limit",
    "switches": "{} has pure phases: its equilibria do not form one curve; march in time, which finds the snaps",
    "rate": "{} depends on rates, and t is not a time on a path: march in time",
}  # reasons, see `PartSum.refuse`


class Plan(ABC):
    """Plan of the steps of a march. A new kind of steps is a plan with its controller.

    Attributes:
        first: length of the first step; None: it ends at the first time.
        tolerance: largest estimated error of a step, which then ends at breaks of data; None: a march in time estimates
            the error of all its steps at the end.
        is_path: whether steps follow an equilibrium path, for every model.
    """

    first: float | None  # a value would become the default of fields
    tolerance: float | None = None
    is_path: bool = False

    @abstractmethod
    def targets(self, start: float, breaks: Iterable[float] = ()) -> list[float]:
        """Times at which steps must end, with the breaks between them; InputError: they cannot follow `start`."""

    @abstractmethod
    def check_model(self, equations: Equations, theta: float, method: str | None) -> None:
        """Raise InputError if the plan does not suit the model, `theta` or the solver's `method`. Collective."""

    @abstractmethod
    def controller(self, solver: Solver, journal: Journal, targets: list[float], options: Options) -> Controller:
        """The controller of the steps; `options` are PETSc options of the linear solver."""


@dataclass(frozen=True)
class PlannedTimes(Plan):
    """Times at which steps end. A model with a layer that softens follows its equilibrium path to these times.

    Attributes:
        times: the times, increasing.

    Raises:
        InputError: they are not a sequence of numbers.
    """

    times: Sequence[float]
    first = None

    def __post_init__(self) -> None:
        allowed = "it must be a sequence of numbers or Adaptive(...)"
        require(not isinstance(self.times, str), "times", self.times, allowed)
        try:
            values = real_values([*self.times])
            if values.ndim != 1:
                raise TypeError("it has rows")
        except (TypeError, ValueError) as error:
            raise InputError(f"times is {self.times!r}; {allowed}") from error
        object.__setattr__(self, "times", tuple(map(float, values)))

    def targets(self, start: float, breaks: Iterable[float] = ()) -> list[float]:
        return _targets(self.times, start, breaks)

    def check_model(self, equations: Equations, theta: float, method: str | None) -> None:
        if equations.traits.softens:
            try:
                _require_path(equations, theta, method)
            except InputError as error:
                where = "the stress of a layer falls, and equilibria in time must be on its path"
                raise InputError(f"{where}: {error}") from error

    def controller(self, solver: Solver, journal: Journal, targets: list[float], options: Options) -> Controller:
        if solver.equations.traits.softens:
            lengths = np.diff([journal.start, *targets])
            first, largest = float(lengths[0]), float(lengths.max() / lengths[0])
            path = ArcLength(targets[-1], first, MIN_LENGTH, largest, steps=UNLIMITED_STEPS)
            return PathToTimesController(solver, journal, targets, path, options)
        kind = SnapController if solver.equations.traits.switches else PlannedStepsController
        return kind(solver, journal, targets)


@dataclass(frozen=True)
class Adaptive(Plan):
    """Steps whose length follows an estimate of their error.

    Each step is made once as a whole and once as two halves. The halves are accepted if displacements, the layer's
    jumps and the bodies' forces differ by no more than the tolerance. Jumps of loads between these times are not
    noticed: put the times at which functions jump into `at`. The breaks of `piecewise` loads are added to these times.

    Attributes:
        end: last time.
        first: length of the first step.
        tolerance: largest estimated error of a step. The error is the largest of three relative errors in L2 norms: of
            nodal displacements, of jumps (in a meshed layer strains), and of nodal forces of the bodies' stresses, with
            reactions and tractions on the layer. They are relative to the largest values so far or, after rest, to the
            values at the end of the first step that is tried.
        at: times between start and end at which a step must end.
        smallest: length below which a step is not shortened further (default: first/1e6).
        largest: length of the longest step (default: no limit).

    Raises:
        InputError: values out of range.

    Example:
        >>> from forms import LinearElastic, Maxwell
        >>> from geometry import sandwich
        >>> from thinlayer import Adaptive, Structure, ThinLayer, march
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> steel, resin = LinearElastic.young(E=210e3, nu=0.3), Maxwell(lmbda=800.0, mu=400.0, t1=20.0)
        >>> plates = Structure(joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)})
        >>> steps = Adaptive(end=4.0, first=0.1, tolerance=0.01)
        >>> history = march(plates.interface(ThinLayer(resin, eps=0.05)), steps, start=0)
        >>> history.last.t
        4.0
    """

    end: float
    first: float
    tolerance: float = 1e-3
    at: Sequence[float] = ()
    smallest: float | None = None
    largest: float = math.inf

    def __post_init__(self) -> None:
        _require_numbers(self, "first", "tolerance", "smallest", "largest", signed=("end",))
        at = tuple(self.at) if isinstance(self.at, Iterable) and not isinstance(self.at, str) else (None,)
        require(all(map(is_finite, at)), "Adaptive: at", self.at, "allowed: a sequence of times")
        object.__setattr__(self, "at", tuple(map(float, at)))
        if self.at and max(self.at) > self.end:
            raise InputError(f"Adaptive: at has t = {max(self.at):g}; times increase to end = {self.end:g}")

    def targets(self, start: float, breaks: Iterable[float] = ()) -> list[float]:
        return _targets(sorted({*self.at, self.end}), start, breaks)

    def check_model(self, equations: Equations, theta: float, method: str | None) -> None:
        equations.refuse({"softens": f"march with Adaptive: {SOFTENING_ADVICE}", "switches": NO_ERROR_MESSAGE})

    def controller(self, solver: Solver, journal: Journal, targets: list[float], options: Options) -> Controller:
        return AdaptiveController(solver, journal, targets, self)


def _require_numbers(plan: Plan, *positive: str, signed: tuple[str, ...]) -> None:
    """Convert attributes to floats; raise InputError unless they are > 0, finite if in `signed`, or None by default."""
    for name in (*signed, *positive):
        value = getattr(plan, name)
        finite = is_finite(value) or (is_number(value) and name == "largest" and value == math.inf)
        good = finite and (name in signed or value > 0)
        if not good and not (value is None and getattr(type(plan), name, 0) is None):
            above = "" if name in signed else " > 0"
            raise InputError(f"{type(plan).__name__}: {name} is {value!r}; allowed: a number{above}")
        object.__setattr__(plan, name, None if value is None else float(value))


@dataclass(frozen=True)
class ArcLength(Plan):
    """An equilibrium path of a model, followed by arc length; t is the parameter of loads and may decrease.

    Supports depend on the parameter t too. The path starts at the state of t = start, with t increasing, and continues
    in the direction of its last increment. Energies are not compared: stable and unstable equilibria are followed
    alike. Steps should be short compared with the features of the path, as events within a step are not noticed.

    The length of a step is sqrt(|du|^2/U^2 + dt^2/T^2). Here |du| is the L2 norm of the change of nodal displacements,
    T is `first`, and U follows from the first step. Step lengths adapt to the number of Newton steps; steps that fail
    are halved. `smallest` and `largest` are relative to the length of the first step.

    Attributes:
        end: time > start at which the march ends; the last step ends there.
        first: change of t in the first step, > 0.
        smallest: length below which a step is not shortened further (default: 1e-6).
        largest: length of the longest step (default: 1; longer steps may pass over loops of the path).
        steps: largest number of steps; a longer path raises a SolveError.
        back: time < start below which the march ends, too. Without it a path that comes back to start - (end - start)
            raises a SolveError. Loads and supports are evaluated at such times.

    Raises:
        InputError: values out of range.
    """

    end: float
    first: float
    smallest: float = 1e-6
    largest: float = 1.0
    steps: int = 1000
    back: float | None = None
    is_path = True

    def __post_init__(self) -> None:
        _require_numbers(self, "first", "smallest", "largest", signed=("end", "back"))
        if not isinstance(self.steps, Integral) or isinstance(self.steps, bool) or self.steps < 1:
            raise InputError(f"ArcLength: steps is {self.steps!r}; allowed: a whole number > 0")
        object.__setattr__(self, "steps", int(self.steps))
        if self.largest < self.smallest:
            raise InputError(f"ArcLength: largest is {self.largest:g}; allowed: >= smallest = {self.smallest:g}")

    def lowest(self, start: float) -> float:
        """The time below which the march ends."""
        return 2 * start - self.end if self.back is None else float(self.back)

    def targets(self, start: float, breaks: Iterable[float] = ()) -> list[float]:
        if not math.isfinite(start) or not self.end > start:
            raise InputError(f"ArcLength: end is {self.end:g}; it must come after start = {start:g}")
        if not is_divisible(start, start + self.first) or self.first**2 < np.finfo(float).tiny:
            raise InputError(f"ArcLength: first is {self.first:g}: a step from t = {start:g} that is lost in rounding")
        if not self.lowest(start) < start:
            raise InputError(f"ArcLength: back is {self.back:g}; it must be less than start = {start:g}")
        return [self.end]

    def check_model(self, equations: Equations, theta: float, method: str | None) -> None:
        _require_path(equations, theta, method)

    def controller(self, solver: Solver, journal: Journal, targets: list[float], options: Options) -> Controller:
        return ArcLengthController(solver, journal, targets, self, options)


Times = Sequence[float] | Plan


# ---------------------------------------------------------------- ends of steps
def _targets(times: Sequence[float], start: float, breaks: Iterable[float]) -> list[float]:
    """Times and the breaks between them; breaks that differ from times only by rounding are left out.

    Raises:
        InputError: no times, or times that are not finite or do not increase from `start`.
    """
    targets, whole = [*times], np.array([start, *times])
    if not targets or not np.isfinite(whole).all() or (np.diff(whole) <= 0).any():
        remedy = "they must be finite, increase, and come after start, which is not one of them"
        raise InputError(f"times is {targets} from start = {start:g}; {remedy}")
    near = TIME_TOLERANCE * max(abs(start), abs(targets[-1]))
    for t in sorted(breaks):
        if start < t < targets[-1] and np.abs(whole - t).min() > near:
            whole = np.append(whole, t)
    return [float(t) for t in np.sort(whole)[1:]]


# ---------------------------------------------------------------- what models allow
def require_in_time(equations: Equations, theta: float, ends: list[float]) -> None:
    """Raise InputError unless a model can be marched in time. Collective.

    With theta < 1, compiled laws that creep or relax may be non-linear. Other laws must declare `linear`, and
    parameters of compiled laws must not change in time.

    Args:
        equations: the equations of the model.
        theta: as in `march`.
        ends: start of the march, and the times at which steps end.
    """
    if theta == 1:
        return
    at_ends = f"theta is {theta}; {{}} holds at the ends of steps: {THETA_HINT}"
    bounds = f"theta is {theta}; {{}} bounds stresses, which at the end of a step may exceed it: {THETA_HINT}"
    equations.refuse({"releases": at_ends, "switches": at_ends, "bounded": bounds})
    for part in equations.parts:
        if at_once := part.answers_at_once(ends):
            name, changes = at_once
            how = "with parameters that change in time" if changes else "not linearly (linear = True is not declared)"
            what = f"theta is {theta}; {name} answers at once, and {how}"
            raise InputError(f"{what}: states at the ends of steps would oscillate undamped: {THETA_HINT}")


def _require_path(equations: Equations, theta: float, method: str | None) -> None:
    """Raise InputError unless paths of the model can be followed: no part has a rate or bounds. Collective."""
    if theta != 1:
        raise InputError(f"theta is {theta}; forces on a path balance at t itself: theta = 1")
    require(method in (None, "newton"), "method", method, "a path is followed by Newton's method")
    for part in equations.of_kind(PressurePart):
        for name in part.named():
            raise InputError(f"{name} is incompressible: paths have displacements alone; march in time")
    equations.refuse(NO_PATH_REASONS)
    for name in filter(None, [part.takes_time() for part in equations.parts]):
        raise InputError(f"{name} creeps or relaxes, and t is not a time on a path: march in time")
