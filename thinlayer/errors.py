"""Errors of solves that do not converge, warnings of results that may mislead, and deprecated names."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from mpi4py import MPI

from forms.base import InputError as InputError
from forms.base import ThinlayerError as ThinlayerError
from forms.traits import RangeWarning as RangeWarning
from forms.traits import show_warnings, warn_of_range, warn_outside

MIN_NAMED_SHARE = 0.005  # least share of the squared jumps at which a message names a seam


def warn(key: str, message: str, comm: MPI.Intracomm) -> None:
    """Issue a RangeWarning, which rank 0 shows; if a warning filter makes it an error, all ranks raise it.

    Call it on all ranks of the communicator.

    Args:
        key: key of the condition that is violated, which the warning has as an attribute.
        message: text of the warning.
        comm: communicator of the model.
    """
    show_warnings()  # before the filters are read
    shown = warnings.showwarning
    try:
        if comm.rank:
            warnings.showwarning = lambda *_, **__: None
        warn_of_range(key, message)
    finally:
        warnings.showwarning = shown


def deprecated(what: str, since: str, instead: str) -> None:
    """Warn that the next major version removes a public name or argument (DeprecationWarning at the user's line).

    Python shows the warning once for each line of a script. For lines of imported modules it does so only with
    `python3 -W default`.

    Args:
        what: the name or argument, as the user writes it.
        since: version that deprecated it.
        instead: what the user should write.
    """
    warn_outside(DeprecationWarning(f"{what} is deprecated since thinlayer {since}; use {instead}"))


def former_names(module: str, now: Mapping[str, Callable[..., object]]) -> Callable[[str], Any]:
    """Make a `__getattr__` with which a module keeps deprecated names of version 1.0.

    Args:
        module: name of the module.
        now: deprecated name -> object that it returns, with a DeprecationWarning.
    """

    def find(name: str) -> Any:
        if name not in now:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        deprecated(f"{module}.{name}", "1.1", f"{now[name].__module__}.{now[name].__name__}")
        return now[name]

    return find


class FormerNames:
    """Base class of objects whose attributes can also be read by deprecated names of version 1.0.

    Attributes:
        former_names: deprecated name of an attribute -> present name.
    """

    former_names: ClassVar[Mapping[str, str]] = {}

    def __getattr__(self, name: str) -> Any:
        if name not in self.former_names:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        deprecated(f"{type(self).__name__}.{name}", "1.1", self.former_names[name])
        return getattr(self, self.former_names[name])


@dataclass(frozen=True)
class Violation:
    """A condition on a model or law that does not hold.

    Attributes:
        key: short name of the condition.
        reason: why it does not hold, for messages.
        remedy: what the user may do instead, for messages.
    """

    key: str
    reason: str
    remedy: str = "mesh the layer (structure.full)"

    def __str__(self) -> str:
        return f"{self.reason}; {self.remedy}"

    def error(self, what: str = "") -> InputError:
        """Return an InputError with `what`, the reason and the remedy as its message, and with the condition's key."""
        error = InputError(f"{what}{self}")
        error.key = self.key
        return error


class SolveError(ThinlayerError, RuntimeError):
    """Error of a solve that did not converge; its message has the reason, the last residual, and what to try.

    Attributes:
        reason: the message without the advice.
        history: `History` of the accepted steps of a march; None for other solves.
        residuals: norm of the residual, relative to the forces, at every step of Newton's method or a contact solver.
    """

    history: Any  # its class is of a folder above

    def __init__(self, reason: str, history: object = None, residuals: Sequence[float] = (), advice: str = "") -> None:
        super().__init__(f"{reason}; {advice}" if advice else reason)
        self.reason, self.history, self.residuals = reason, history, residuals

    def __reduce__(self) -> tuple[object, ...]:
        """Data for pickling, without the history: its meshes cannot be sent to another process."""
        return Exception.__new__, (type(self), *self.args), vars(self) | {"history": None}


class LooseBody(SolveError):
    """Error of a solve in which a body can move freely: neither supports nor the layer resist its motion.

    Attributes:
        motion: text that names the body and its free motion.
    """

    def __init__(self, reason: str, motion: str, advice: str, residuals: Sequence[float] = ()) -> None:
        super().__init__(reason, residuals=residuals, advice=advice)
        self.motion = motion


class TurningPoint(SolveError):
    """Error of a march at a limit point of a softening structure, beyond which the loads cannot grow.

    The loads, or the displacements of supports, have a maximum there, so that steps in time cannot continue. Arc-length
    continuation can.

    Attributes:
        t: time of the last equilibrium before this point.
        history: `History` of the accepted steps.
    """

    def __init__(self, t: float, history: object) -> None:
        reason = f"the equilibria turn back at t = {t:.10g}: what is prescribed there cannot grow further"
        advice = "follow them by arc length, march(error.history, ArcLength(end=..., first=...))"
        super().__init__(reason, history, advice=advice)
        self.t = t


class NoEquilibrium(SolveError):
    """Error of a time step without an equilibrium: with weak springs at all nodes, displacements grow without bound.

    The springs, which make an equilibrium possible, are made softer and softer for this test.

    Attributes:
        growth: norm of the displacements with the weakest springs, over their norm with an elastic layer under the same
            change of loads. In this reference, seams in contact neither open nor slide.
        shares: name of a seam -> its fraction of the integral of the squared jumps of these displacements, over seams
            whose law limits tractions. The largest is first; empty if there is only one seam.
    """

    def __init__(self, growth: float, shares: Mapping[str, float]) -> None:
        super().__init__(f"displacements run away, {growth:.3g} times as far as those of an elastic layer")
        self.growth, self.shares = growth, shares


class LimitLoad(SolveError):
    """Error of a march whose loads exceed the limit load of a yielding layer or of contact.

    Even the shortest step has no equilibrium. This is tested with weak springs at all nodes, with which an equilibrium
    exists. If its displacements grow without bound as the springs soften, no equilibrium exists without springs. A step
    that fails for another reason raises a plain SolveError.

    Attributes:
        t: time of the last equilibrium.
        failed_at: earliest time at which no equilibrium was found.
        resultant: (d,) sum in d dimensions of the tractions and body forces on the bodies at the time t, a force.
        growth: norm of the change of displacements from t to `failed_at` with the weakest springs, over this norm with
            an elastic layer. If the layer's flow is associated, an equilibrium without springs would have at least this
            ratio.
        shares: name of a seam -> its fraction of the integral of the squared jumps of these displacements, over layers
            that yield and contact. They show which seams fail, the largest first; empty if there is only one seam.
        history: `History` of the accepted steps.
    """

    def __init__(
        self, reason: str, t: float, failed_at: float, resultant: Sequence[float], cause: NoEquilibrium, history: object
    ) -> None:
        self.t, self.failed_at, self.resultant = t, failed_at, tuple(resultant)
        self.growth, self.shares = cause.growth, dict(cause.shares)
        loads = ", ".join(f"{force:.6g}" for force in resultant)
        most = ", ".join(f"{name!r} {share:.0%}" for name, share in self.shares.items() if share >= MIN_NAMED_SHARE)
        seams = f", with jumps at the seams {most}" if most else ""  # which open or slide most
        super().__init__(
            f"limit load: the last equilibrium was found at t = {t:.10g}, where the loads on the bodies add up to "
            f"({loads}); at t = {failed_at:.10g} none was found (last attempt: {reason}): displacements run away, "
            f"{self.growth:.3g} times as far as with an elastic layer{seams}. The states before it are kept",
            history,
        )
