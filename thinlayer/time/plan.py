"""Settings of the steps of a march: given times, adaptive steps, or an equilibrium path by arc length."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from forms.base import InputError, is_finite, is_integer, is_number, require
from forms.temperature import real_values
from thinlayer.discretisation.model import Model
from thinlayer.parts.inertia import Inertia
from thinlayer.parts.pressure_part import PressurePart
from thinlayer.solving.equations import Equations
from thinlayer.solving.history import TIME_TOLERANCE
from thinlayer.solving.petsc import Options
from thinlayer.solving.solve import SOFTENING_MESSAGE, Solver
from thinlayer.time.controller import Controller, is_divisible
from thinlayer.time.following import MANY_STEPS, ArcLengthController, PathToTimesController
from thinlayer.time.journal import Journal
from thinlayer.time.stepping import AdaptiveController, PlannedStepsController, SnapController

MIN_RELATIVE_LENGTH = 1e-3  # length of the shortest step before a turning point, relative to the first step
THETA_HINT = "theta = 1"  # the last words of errors
NO_ERROR_MESSAGE = "Adaptive is for laws that depend on time; steps of {} have no error: give the times to stop at"
NO_PATH_REASONS = {
    "releases": "{} is a contact law: a path does not follow contact",
    "bounded": "{} bounds stresses: on a path loads stay at their limit",
    "switches": "{} has pure phases: its equilibria do not form one curve",
    "rate": "{} depends on rates, and t is not a time on a path",
    "inert": "{} has mass, and t is not a time on a path",
}  # reasons, see `PartSum.refuse_traits`


class Plan(ABC):
    """Settings of the steps of a march; base class of the arguments `times` of `march`.

    Its methods check that the settings suit a model, and make the controller of the steps.

    Attributes:
        first: length of the first step; None: it ends at the first of the given times.
        tolerance: largest estimated error of a step, if the length of steps follows from this error. Steps then end at
            the break times of `piecewise` data, too. None: the length of steps does not follow from their error.
        is_path: whether steps follow an equilibrium path for every model. False: only steps to given times follow one,
            and only for models that soften.
    """

    first: float | None  # a value would become the default of fields
    tolerance: float | None = None
    is_path: bool = False

    @abstractmethod
    def targets(self, start: float, breaks: Iterable[float] = ()) -> list[float]:
        """Return the times at which steps must end, increasing.

        Args:
            start: time of the first state.
            breaks: further times at which steps must end, where slopes of data change.

        Raises:
            InputError: the times do not increase from `start`.
        """

    @abstractmethod
    def check_model(self, equations: Equations, theta: float, method: str | None) -> None:
        """Check that the settings suit the model, theta and the method of the solver. Collective.

        Args:
            equations: the equations of the model.
            theta: fraction of each step after which forces balance.
            method: method of the solver that the user chose; None: the default.

        Raises:
            InputError: the settings do not suit them.
        """

    @abstractmethod
    def controller(self, solver: Solver, journal: Journal, targets: list[float], options: Options) -> Controller:
        """Make the controller of the steps, which carries out the march.

        Args:
            solver: solver of the model.
            journal: record of the accepted states.
            targets: times at which steps must end.
            options: PETSc options of the linear solver.
        """


@dataclass(frozen=True)
class PlannedTimes(Plan):
    """Times at which the steps of a march end.

    If a layer softens (its stress falls as jumps grow), the model follows its equilibrium path to these times, in
    shorter steps.

    Attributes:
        times: the times, increasing.

    Raises:
        InputError: the times are not a sequence of numbers.
    """

    times: Sequence[float]
    first = None

    def __post_init__(self) -> None:
        allowed_text = "it must be a sequence of numbers or Adaptive(...)"
        require(not isinstance(self.times, str), "times", self.times, allowed_text)
        try:
            times = real_values([*self.times])
            if times.ndim != 1:
                raise TypeError("it has rows")
        except (TypeError, ValueError) as error:
            raise InputError(f"times is {self.times!r}; {allowed_text}") from error
        object.__setattr__(self, "times", tuple(map(float, times)))

    def targets(self, start: float, breaks: Iterable[float] = ()) -> list[float]:
        return _merge_breaks(self.times, start, breaks)

    def check_model(self, equations: Equations, theta: float, method: str | None) -> None:
        if equations.traits.softens:
            try:
                _require_path_suits(equations, theta, method)
            except InputError as error:
                reason = "the stress of a layer falls, and equilibria in time must be on its path"
                raise InputError(f"{reason}: {error}") from error

    def controller(self, solver: Solver, journal: Journal, targets: list[float], options: Options) -> Controller:
        if solver.equations.traits.softens:
            durations = np.diff([journal.start, *targets])
            first, max_ratio = float(durations[0]), float(durations.max() / durations[0])
            settings = ArcLength(targets[-1], first, MIN_RELATIVE_LENGTH, max_ratio, steps=MANY_STEPS)
            return PathToTimesController(solver, journal, targets, settings, options)
        controller_class = SnapController if solver.equations.traits.switches else PlannedStepsController
        return controller_class(solver, journal, targets)


@dataclass(frozen=True)
class Adaptive(Plan):
    """Steps in time whose length follows from an estimate of their error.

    Each step is made once as a whole and once as two halves. The difference of the two results gives the error of the
    halves. They are accepted if this error is at most the tolerance. Loads that jump within a step are not noticed: put
    the times at which functions jump into `at`. Steps end at the break times of `piecewise` data without this.

    Attributes:
        end: time at which the march ends.
        first: length of the first step.
        tolerance: largest estimated error of a step, > 0. The error is the largest of the relative errors of three
            quantities. These are nodal displacements, jumps (in a meshed layer strains), and nodal forces of the
            bodies' stresses. These forces change with reactions and with tractions on the layer. Norms are Euclidean,
            those of jumps L2. Errors are relative to the largest norms so far. For quantities that are zero before the
            first step, they are relative to the norms at the end of the first step that is tried.
        at: times between start and end at which a step must end.
        smallest: length below which a step is not shortened further (default: first/1e6).
        largest: length of the longest step (default: no limit).

    Raises:
        InputError: a value is out of range.

    Example:
        >>> from forms import LinearElastic, Maxwell
        >>> from geometry import sandwich
        >>> from thinlayer import Adaptive, Structure, ThinLayer, march
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> resin = Maxwell(lmbda=800.0, mu=400.0, t1=20.0)
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
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
        return _merge_breaks(sorted({*self.at, self.end}), start, breaks)

    def check_model(self, equations: Equations, theta: float, method: str | None) -> None:
        equations.refuse_traits({"softens": f"march with Adaptive: {SOFTENING_MESSAGE}", "switches": NO_ERROR_MESSAGE})

    def controller(self, solver: Solver, journal: Journal, targets: list[float], options: Options) -> Controller:
        return AdaptiveController(solver, journal, targets, self)


def _require_numbers(plan: Plan, *positive: str, signed: tuple[str, ...]) -> None:
    """Check numbers among the attributes of settings, and convert them to floats.

    Attributes whose default is None may be None, and `largest` may be infinite.

    Args:
        plan: the settings, which are changed.
        *positive: names of attributes that must be finite and > 0.
        signed: names of attributes that must be finite.

    Raises:
        InputError: an attribute is no such number.
    """
    for name in (*signed, *positive):
        value = getattr(plan, name)
        is_number_allowed = is_finite(value) or (is_number(value) and name == "largest" and value == math.inf)
        is_valid = is_number_allowed and (name in signed or value > 0)
        if not is_valid and not (value is None and getattr(type(plan), name, 0) is None):
            range_text = "" if name in signed else " > 0"
            raise InputError(f"{type(plan).__name__}: {name} is {value!r}; allowed: a number{range_text}")
        object.__setattr__(plan, name, None if value is None else float(value))


@dataclass(frozen=True)
class ArcLength(Plan):
    """Steps by arc length along an equilibrium path, where t is a parameter of loads and supports and may decrease.

    The path starts at the state at t = start, in the direction in which t increases. Each step goes on in the direction
    of the one before. Energies are not compared: stable and unstable equilibria are followed alike. Steps should be
    short compared with bends and loops of the path, as a longer step may pass over them.

    The length of a step is sqrt(|du|^2/U^2 + dt^2/T^2). Here |du| is the Euclidean norm of the change of nodal
    displacements, and dt the change of t. T is `first`, and U is |du| of the first step, scaled to a change `first` of
    t. Step lengths adapt to the number of Newton steps; steps that fail are halved. Where laws have memory, the path
    goes on where it changes: steps on which all unloads, back to rest, fail.

    Attributes:
        end: value of t > start at which the march ends; the last step ends there.
        first: change of t in the first step, > 0.
        smallest: length, relative to the first step, below which a step is not shortened further (default: 1e-6).
        largest: length of the longest step, relative to the first step; steps longer than 1 may pass over loops of the
            path. None: steps are longer than the first only where path, loads and supports are straight, as before and
            after breaking.
        steps: largest number of steps; if the path has not reached `end` then, the march raises a SolveError.
        back: value of t < start; the march also ends, without an error, when t falls below it. None: the march raises a
            SolveError when t falls below 2 start - end. Loads and supports must be defined down to this value.

    Raises:
        InputError: a value is out of range.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import ArcLength, Structure, ThinLayer, march
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> supports = {"BOTTOM": 0, "TOP": {"y": lambda x, t: 0.01 * t}}
        >>> plates = Structure(joint, body=steel, supports=supports)
        >>> path = ArcLength(end=2.0, first=0.5)
        >>> history = march(plates.interface(ThinLayer(glue, eps=0.05)), path)
        >>> history.t
        array([0. , 0.5, 1.5, 2. ])
    """

    end: float
    first: float
    smallest: float = 1e-6
    largest: float | None = None
    steps: int = 1000
    back: float | None = None
    is_path = True

    def __post_init__(self) -> None:
        _require_numbers(self, "first", "smallest", "largest", signed=("end", "back"))
        require(is_integer(self.steps, 1), "ArcLength: steps", self.steps, "allowed: a whole number > 0")
        object.__setattr__(self, "steps", int(self.steps))
        allowed = f"allowed: >= smallest = {self.smallest:g}"
        require(self.largest is None or self.largest >= self.smallest, "ArcLength: largest", self.largest, allowed)

    def lowest(self, start: float) -> float:
        """Return the value of t below which the march ends: `back`, or 2 start - end if `back` is None.

        Args:
            start: value of t at the first state.
        """
        return 2 * start - self.end if self.back is None else float(self.back)

    def targets(self, start: float, breaks: Iterable[float] = ()) -> list[float]:
        if not math.isfinite(start) or not self.end > start:
            raise InputError(f"ArcLength: end is {self.end:g}; it must come after start = {start:g}")
        if not is_divisible(start, start + self.first) or self.first**2 < np.finfo(float).tiny:
            raise InputError(f"ArcLength: first is {self.first:g}: a step from t = {start:g} that is lost in rounding")
        require(self.lowest(start) < start, "ArcLength: back", self.back, f"it must be less than start = {start:g}")
        return [self.end]

    def check_model(self, equations: Equations, theta: float, method: str | None) -> None:
        _require_path_suits(equations, theta, method)

    def controller(self, solver: Solver, journal: Journal, targets: list[float], options: Options) -> Controller:
        return ArcLengthController(solver, journal, targets, self, options)


Times = Sequence[float] | Plan


# ---------------------------------------------------------------- ends of steps
def _merge_breaks(times: Sequence[float], start: float, breaks: Iterable[float]) -> list[float]:
    """Return given times together with break times between them, increasing.

    Break times that differ from given times only by rounding are left out.

    Args:
        times: the given times.
        start: time of the first state; earlier break times are left out.
        breaks: times at which slopes of `piecewise` data change.

    Raises:
        InputError: there are no times, or they are not finite or do not increase from `start`.
    """
    targets, all_times = [*times], np.array([start, *times])
    if not targets or not np.isfinite(all_times).all() or (np.diff(all_times) <= 0).any():
        remedy = "they must be finite, increase, and come after start, which is not one of them"
        raise InputError(f"times is {targets} from start = {start:g}; {remedy}")
    tolerance = TIME_TOLERANCE * max(abs(start), abs(targets[-1]))
    for t in sorted(breaks):
        if start < t < targets[-1] and np.abs(all_times - t).min() > tolerance:
            all_times = np.append(all_times, t)
    return [float(t) for t in np.sort(all_times)[1:]]


# ---------------------------------------------------------------- what models allow
def default_theta(model: Model, times: Times) -> float:
    """Return the fraction of steps after which forces balance by default: 1/2 with mass and without contact, else 1."""
    on_path = (isinstance(times, Plan) and times.is_path) or any(p.law.traits.softens for p in model.terms)
    return 0.5 if any(isinstance(p, Inertia) for p in model.parts) and not (model.contact or on_path) else 1.0


def require_theta_suits(equations: Equations, theta: float, ends: list[float]) -> None:
    """Check that a model can be marched in time with a value of theta. Collective.

    With theta = 1 all models can. With theta < 1, contact laws and laws that switch phases are refused. Models with
    mass have no further conditions. In others, laws that bound stresses are refused. Laws that creep or relax may be
    non-linear. All further laws must declare that they are linear, and parameters of compiled laws must not change in
    time.

    Args:
        equations: the equations of the model.
        theta: fraction of each step after which forces balance.
        ends: start of the march, and the times at which steps end.

    Raises:
        InputError: the model cannot be marched with this theta.
    """
    if theta == 1:
        return
    ends_text = f"theta is {theta}; {{}} holds at the ends of steps: {THETA_HINT}"
    bounds_text = f"theta is {theta}; {{}} bounds stresses, which at the end of a step may exceed it: {THETA_HINT}"
    equations.refuse_traits({"releases": ends_text, "switches": ends_text})
    if equations.traits.inert:  # mass keeps states at the ends of steps from oscillating as those of statics would
        return
    equations.refuse_traits({"bounded": bounds_text})
    for part in equations.parts:
        if name_and_flag := part.instantaneous_nonlinear_law(ends):
            name, varies = name_and_flag
            how = "with parameters that change in time" if varies else "not linearly (linear = True is not declared)"
            text = f"theta is {theta}; {name} answers at once, and {how}"
            raise InputError(f"{text}: states at the ends of steps would oscillate undamped: {THETA_HINT}")


def _require_path_suits(equations: Equations, theta: float, method: str | None) -> None:
    """Check that the equilibrium path of a model can be followed by arc length. Collective.

    It cannot with contact laws, incompressible laws, or laws that bound stresses, switch phases, creep or relax.

    Args:
        equations: the equations of the model.
        theta: fraction of each step after which forces balance; it must be 1.
        method: method of the solver that the user chose; None: the default. Only "newton" is allowed.

    Raises:
        InputError: the path cannot be followed.
    """
    require(theta == 1, "theta", theta, "forces on a path balance at t itself: theta = 1")
    require(method in (None, "newton"), "method", method, "a path is followed by Newton's method")
    remedy = "march in time, with a list of times"
    for name in sorted({*equations.names_with_trait("softens")}):
        remedy = f"{name} softens, which needs a path: both cannot be in one model"
    for part in equations.of_kind(PressurePart):
        for name in part.law_traits():
            raise InputError(f"{name} is incompressible: paths have displacements alone; {remedy}")
    equations.refuse_traits({trait: f"{reason}; {remedy}" for trait, reason in NO_PATH_REASONS.items()})
    for name in filter(None, [part.relaxing_law_name() for part in equations.parts]):
        raise InputError(f"{name} creeps or relaxes, and t is not a time on a path; {remedy}")
