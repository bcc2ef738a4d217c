"""Errors of solves that do not converge, warnings of results that may mislead, and deprecated names."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pydoc import locate
from typing import Any, ClassVar

from mpi4py import MPI

from forms.base import InputError as InputError
from forms.base import ThinlayerError as ThinlayerError
from forms.traits import RangeWarning as RangeWarning
from forms.traits import restore_warnings, warn_caller, warn_of_range

MIN_NAMED_FRACTION = 0.005  # least share of the squared jumps at which a message names a seam


def warn(key: str, message: str, comm: MPI.Intracomm) -> None:
    """Issue a RangeWarning, which only rank 0 shows. Collective over `comm`.

    If a warning filter turns it into an error, all ranks raise this error.

    Args:
        key: short name of the violated condition, stored in the warning's attribute `key`.
        message: text of the warning.
        comm: communicator of the model.
    """
    restore_warnings()  # before the filters are read
    original_showwarning = warnings.showwarning
    try:
        if comm.rank:
            warnings.showwarning = lambda *_, **__: None
        warn_of_range(key, message)
    finally:
        warnings.showwarning = original_showwarning


def warn_of_deprecated(name: str, since: str, instead: str) -> None:
    """Issue a DeprecationWarning at the user's line: the next major version removes a public name or argument.

    Python shows the warning once for each line of a script. For lines of imported modules it does so only with
    `python3 -W default`.

    Args:
        name: the name or argument, as the user writes it.
        since: version that deprecated it.
        instead: what the user should write.
    """
    warn_caller(DeprecationWarning(f"{name} is deprecated since thinlayer {since}; use {instead}"))


def make_module_getattr(module: str, renamed: Mapping[str, Callable[..., object] | str]) -> Callable[[str], Any]:
    """Make a module's `__getattr__` function, which accepts names of version 1.0 with a DeprecationWarning.

    Args:
        module: name of the module, for messages.
        renamed: deprecated name -> the function or class that now has another name, or its full name if its module
            is another one; the warning tells the user its new name.

    Returns:
        A function that returns the function or class for a deprecated name, and raises AttributeError for other names.
    """

    def find_present_object(name: str) -> Any:
        if name not in renamed:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        target = renamed[name]
        present: Any = locate(target) if isinstance(target, str) else target
        warn_of_deprecated(f"{module}.{name}", "1.1", f"{present.__module__}.{present.__name__}")
        return present

    return find_present_object


class FormerNames:
    """Base class of objects whose attributes can also be read by deprecated names of version 1.0.

    Reading such a name issues a DeprecationWarning.

    Attributes:
        former_names: deprecated name of an attribute -> its present name.
    """

    former_names: ClassVar[Mapping[str, str]] = {}

    def __getattr__(self, name: str) -> Any:
        if name not in self.former_names:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        warn_of_deprecated(f"{type(self).__name__}.{name}", "1.1", self.former_names[name])
        return getattr(self, self.former_names[name])


@dataclass(frozen=True)
class Violation:
    """A condition of a law or a method that a model does not fulfil, with the reason and a remedy.

    Attributes:
        key: short name of the condition.
        reason: why the condition is not fulfilled, for messages.
        remedy: what the user may do instead, for messages.
    """

    key: str
    reason: str
    remedy: str = "mesh the layer (structure.full)"

    def __str__(self) -> str:
        return f"{self.reason}; {self.remedy}"

    def error(self, prefix: str = "") -> InputError:
        """Return an InputError about this condition, for the caller to raise; its `key` is that of the condition.

        Args:
            prefix: text before the reason and the remedy in the message.
        """
        error = InputError(f"{prefix}{self}")
        error.key = self.key
        return error


class SolveError(ThinlayerError, RuntimeError):
    """Error of a solve that did not converge; its message has the reason, the last residual, and what to try.

    Attributes:
        reason: the message without the advice.
        history: `History` of the accepted steps of a march; None for other solves.
        residuals: norm of the residual after each iteration of Newton's method or of a contact solver, divided by the
            norm of the forces.
    """

    history: Any  # its class is of a folder above

    def __init__(self, reason: str, history: object = None, residuals: Sequence[float] = (), advice: str = "") -> None:
        super().__init__(f"{reason}; {advice}" if advice else reason)
        self.reason, self.history, self.residuals = reason, history, residuals

    def __reduce__(self) -> tuple[object, ...]:
        """Return what pickle needs to restore the error without `history`, as pickle cannot send the meshes in it."""
        return Exception.__new__, (type(self), *self.args), vars(self) | {"history": None}


class LooseBody(SolveError):
    """Error of a solve in which a body can move freely, as neither supports nor the layer resist its motion.

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
    """Error of a time step at whose end no equilibrium exists.

    This is tested with weak springs at all nodes, with which an equilibrium exists. As the springs are softened, its
    displacements grow without bound.

    Attributes:
        growth: norm of the change of displacements with the softest springs. It is divided by the norm of the
            displacements that the step's change of loads causes if all layers are elastic and all contacts stick.
        shares: name of a seam -> its fraction of the integral of the squared jump over all seams, in the equilibrium
            with the softest springs. Only seams whose law limits tractions count, by yielding or contact. Squared
            tangential jumps count half in layers that yield. The largest fraction is first. Empty if there is only one
            seam.
    """

    def __init__(self, growth: float, shares: Mapping[str, float]) -> None:
        super().__init__(f"displacements run away, {growth:.3g} times as far as those of an elastic layer")
        self.growth, self.shares = growth, shares


class LimitLoad(SolveError):
    """Error of a march whose loads exceed the limit load of a yielding layer or of contact.

    Even the shortest step has no equilibrium. This is tested with weak springs at all nodes, with which an equilibrium
    exists. If its displacements grow without bound as the springs are softened, no equilibrium exists without springs.
    A step that fails for another reason raises a plain SolveError.

    Attributes:
        t: time of the last equilibrium.
        failed_at: earliest time at which no equilibrium was found.
        resultant: (d,) sum of the tractions and body forces on the bodies at the time t, a force, in d dimensions.
        growth: norm of the change of displacements from t to `failed_at` with the softest springs. It is divided by the
            norm of the displacements that the same change of loads causes if the layers are elastic. If the layer's
            flow is associated, this ratio would be at least as large in an equilibrium without springs.
        shares: name of a seam -> its fraction of the integral of the squared jump of displacements, in the equilibrium
            with the softest springs. Only seams whose law limits tractions count, by yielding or contact. Squared
            tangential jumps count half in layers that yield. The seams that fail have the largest fractions, and are
            first. Empty if there is only one seam.
        history: `History` of the accepted steps.
    """

    def __init__(
        self, reason: str, t: float, failed_at: float, resultant: Sequence[float], cause: NoEquilibrium, history: object
    ) -> None:
        self.t, self.failed_at, self.resultant = t, failed_at, tuple(resultant)
        self.growth, self.shares = cause.growth, dict(cause.shares)
        loads_text = ", ".join(f"{component:.6g}" for component in resultant)
        named = ", ".join(f"{name!r} {share:.0%}" for name, share in self.shares.items() if share >= MIN_NAMED_FRACTION)
        seams_text = f", with jumps at the seams {named}" if named else ""  # which open or slide most
        super().__init__(
            f"limit load: the last equilibrium was found at t = {t:.10g}, where the loads on the bodies add up to "
            f"({loads_text}); at t = {failed_at:.10g} none was found (last attempt: {reason}): displacements run away, "
            f"{self.growth:.3g} times as far as with an elastic layer{seams_text}. The states before it are kept",
            history,
        )
