"""Errors of solves that did not converge, and warnings of results that may mislead."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI

from forms.base import InputError as InputError
from forms.base import ThinlayerError as ThinlayerError
from forms.traits import RangeWarning as RangeWarning
from forms.traits import show_warnings, warn_of_range, warn_outside

MIN_NAMED_SHARE = 0.005  # of a seam's squares of jumps, to be named in a message


def warn(key: str, message: str, comm: MPI.Intracomm) -> None:
    """Issue a RangeWarning. Call on all ranks: rank 0 shows it; if a filter makes it an error, all ranks raise it."""
    show_warnings()  # before the filters are read
    shown = warnings.showwarning
    try:
        if comm.rank:
            warnings.showwarning = lambda *_, **__: None
        warn_of_range(key, message)
    finally:
        warnings.showwarning = shown


def deprecated(what: str, since: str, instead: str) -> None:
    """Issue a DeprecationWarning at the user's line: the next major version removes a public name or argument.

    Python shows it once for each line of a script; for lines of modules where it is asked to, `python3 -W default`.

    Args:
        what: the name or argument, as the user writes it.
        since: version that deprecated it.
        instead: what the user writes from then on.
    """
    warn_outside(DeprecationWarning(f"{what} is deprecated since thinlayer {since}; use {instead}"))


def former_names(module: str, now: Mapping[str, Any]) -> Callable[[str], Any]:
    """The `__getattr__` of a module whose names of version 1.0 are deprecated: old name -> what it is now."""

    def find(name: str) -> Any:
        if name not in now:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        deprecated(f"{module}.{name}", "1.1", f"{now[name].__module__}.{now[name].__name__}")
        return now[name]

    return find


@dataclass(frozen=True)
class Violation:
    """Why something is not known: the key of the condition that does not hold, the reason, and what to do instead."""

    key: str
    reason: str
    remedy: str = "mesh the layer (structure.full)"

    def __str__(self) -> str:
        return f"{self.reason}; {self.remedy}"

    def error(self, what: str = "") -> InputError:
        """The error of one who asks for it, after some words."""
        error = InputError(f"{what}{self}")
        error.key = self.key
        return error


class SolveError(ThinlayerError, RuntimeError):
    """A solve that did not converge. Says the reason, the last residual, and what to try.

    Attributes:
        reason: the message without the advice.
        history: accepted steps of a march.
        residuals: residual over the forces at every step of Newton's method or of a contact solve.
    """

    def __init__(self, reason: str, history: Any = None, residuals: tuple[float, ...] = (), advice: str = "") -> None:
        super().__init__(f"{reason}; {advice}" if advice else reason)
        self.reason, self.history, self.residuals = reason, history, residuals

    def __reduce__(self) -> tuple[Any, ...]:
        """For another process; its meshes stay in this one, and with them the history."""
        return Exception.__new__, (type(self), *self.args), vars(self) | {"history": None}


class LooseBody(SolveError):
    """A body can move freely: neither supports nor the layer resist its motion.

    Attributes:
        motion: which body can move how.
    """

    def __init__(self, reason: str, motion: str, advice: str, residuals: tuple[float, ...] = ()) -> None:
        super().__init__(reason, residuals=residuals, advice=advice)
        self.motion = motion


class TurningPoint(SolveError):
    """A march in time has come to where the equilibria of a softening layer lead back in time: loads have a maximum there.

    Neither growing loads nor growing displacements of supports can be followed farther; a path can, by arc length.

    Attributes:
        t: time of the last equilibrium before.
        history: the accepted steps.
    """

    def __init__(self, t: float, history: Any) -> None:
        what = f"the equilibria turn back at t = {t:.10g}: what is prescribed there cannot grow further"
        advice = "follow them by arc length, march(error.history, ArcLength(end=..., first=...))"
        super().__init__(what, history, advice=advice)
        self.t = t


class NoEquilibrium(SolveError):
    """A step without an equilibrium: its displacements run away as weak springs soften (`solving/weak_springs.py`).

    Attributes:
        growth: norm of these displacements over that of an elastic layer, or of seams in contact that neither open nor
            slide, under the same change of loads.
        shares: name of a seam -> its share of the squares of the jumps that they cause at seams whose law bounds tractions,
            the largest first; empty if there is one seam only.
    """

    def __init__(self, growth: float, shares: Mapping[str, float]) -> None:
        super().__init__(f"displacements run away, {growth:.3g} times as far as those of an elastic layer")
        self.growth, self.shares = growth, shares


class LimitLoad(SolveError):
    """The loads of a march exceed what a yielding layer, or contact, bears: even the shortest step has no equilibrium.

    This is tested with weak springs at all nodes. With them an equilibrium exists; if its displacements grow without bound
    as the springs soften, there is none without springs. A step that fails for another reason raises a plain SolveError.

    Attributes:
        t: time of the last equilibrium.
        failed_at: earliest time at which no equilibrium was found.
        resultant: (d,) sum of the tractions and body forces on the bodies at t, a force.
        growth: norm of the displacements with the weakest springs from t to `failed_at`, over that of an elastic layer; if
            the layer's flow is associated, an equilibrium is at least this far away.
        shares: of several seams, name -> share of the squares of the jumps that these displacements cause, over the areas
            of layers that yield and of contact; the largest first. They tell which seams give way.
        history: the accepted steps.
    """

    def __init__(
        self, reason: str, t: float, failed_at: float, resultant: Sequence[float], run_away: NoEquilibrium, history: Any
    ) -> None:
        growth, shares = run_away.growth, run_away.shares
        loads = ", ".join(f"{force:.6g}" for force in resultant)
        most = ", ".join(f"{name!r} {share:.0%}" for name, share in shares.items() if share >= MIN_NAMED_SHARE)
        seams = f", with jumps at the seams {most}" if most else ""  # which part or slide most, where there are several
        last = f"the last equilibrium was found at t = {t:.10g}, where the loads on the bodies add up to ({loads})"
        none = f"at t = {failed_at:.10g} none was found (last attempt: {reason})"
        away = f"displacements run away, {growth:.3g} times as far as with an elastic layer{seams}"
        super().__init__(f"limit load: {last}; {none}: {away}. The states before it are kept", history)
        self.t, self.failed_at, self.resultant, self.growth = t, failed_at, tuple(resultant), growth
        self.shares = dict(shares)
