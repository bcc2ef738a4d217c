"""The times at which steps of a march end, and the lengths of steps."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from forms.base import is_number
from forms.temperature import real
from thinlayer.errors import ModelError
from thinlayer.time.history import SAME_TIME

HALVINGS = 10  # largest number of times that a planned step is halved
MOST_SHORTENED = 1e6  # length of the first adaptive step relative to that of the shortest, by default


@dataclass(frozen=True)
class Adaptive:
    """Steps whose length follows an estimate of their error.

    Each step is made once as a whole and once as two halves; the halves are accepted if displacements, the layer's jumps
    and the bodies' forces differ by no more than the tolerance. Jumps of loads between these times go unnoticed: put the
    times at which functions jump into `at`. The breaks of `piecewise` loads are added to them.

    Attributes:
        end: last time.
        first: length of the first step.
        tolerance: largest estimated error of a step. The error is the largest of three relative errors in L2 norms: of
            nodal displacements, of jumps (in a meshed layer strains), and of nodal forces of the bodies' stresses, with
            reactions and tractions on the layer. They are relative to the largest values so far or, after rest, to those
            at the end of the first step that is tried.
        at: times between start and end at which a step must end.
        smallest: length below which a step is not shortened further (default: first/1e6).
        largest: length of the longest step (default: no limit).

    Raises:
        ModelError: values out of range.
    """

    end: float
    first: float
    tolerance: float = 1e-3
    at: Sequence[float] = ()
    smallest: float | None = None
    largest: float = math.inf

    def __post_init__(self) -> None:
        for name in ("end", "first", "tolerance", "smallest", "largest"):
            value = getattr(self, name)
            if value is None and name == "smallest":
                continue
            good = is_number(value) and (float(value) > 0 or (name == "end" and math.isfinite(float(value))))
            if not good:
                raise ModelError(f"Adaptive: {name} is {value!r}; allowed: a number" + " > 0" * (name != "end"))
        if isinstance(self.at, str) or not isinstance(self.at, Iterable) or not all(is_number(t) for t in self.at):
            raise ModelError(f"Adaptive: at is {self.at!r}; allowed: a sequence of times")
        object.__setattr__(self, "at", tuple(map(float, self.at)))
        if self.at and max(self.at) > self.end:
            raise ModelError(f"Adaptive: at has t = {max(self.at):g}; times increase to end = {self.end:g}")

    @property
    def targets(self) -> list[float]:
        """Times at which a step must end."""
        return sorted({*map(float, self.at), float(self.end)})


@dataclass(frozen=True)
class Plan:
    """The plan of a march.

    Attributes:
        targets: times at which steps must end.
        adaptive: settings of adaptive steps; None: each step ends at the next target.
        smallest: length below which a step is not shortened further.
    """

    targets: list[float]
    adaptive: Adaptive | None
    smallest: float

    @classmethod
    def of(cls, times: Sequence[float] | Adaptive, start: float, breaks: set[float]) -> Plan:
        """The plan for `times`; steps must also end at `breaks` between them."""
        adaptive = times if isinstance(times, Adaptive) else None
        if isinstance(times, str):
            raise ModelError(f"times is {times!r}; it must be a sequence of numbers or Adaptive(...)")
        try:
            given = real([*(adaptive.targets if adaptive else times)])  # type: ignore[misc]
            if given.ndim != 1:
                raise TypeError("it has rows")
            targets = [float(t) for t in given]
        except (TypeError, ValueError) as error:
            raise ModelError(f"times is {times!r}; it must be a sequence of numbers or Adaptive(...)") from error
        whole = np.array([start, *targets])
        if not targets or not np.isfinite(whole).all() or (np.diff(whole) <= 0).any():
            raise ModelError(
                f"times is {targets} from start = {start:g}; they must be finite, increase, "
                "and come after start, which is not one of them"
            )
        _require_steps(whole, adaptive)
        targets = _with_breaks(start, targets, breaks)
        if adaptive:
            return cls(targets, adaptive, adaptive.smallest or adaptive.first / MOST_SHORTENED)
        return cls(targets, None, float(np.diff([start, *targets]).min()) / 2**HALVINGS)

    def lasting(self, start: float) -> list[float]:
        """Durations, at the first, a middle (logarithmic mean) and the last time, of loads that are sudden at `start`."""
        last = self.targets[-1] - start
        first = min(self.adaptive.first if self.adaptive else last, self.targets[0] - start)
        return list(dict.fromkeys([first, math.sqrt(first * last), last]))

    def after(self, t: float) -> list[float]:
        """The targets after time t."""
        near = min(SAME_TIME * max(abs(self.targets[-1]), abs(self.targets[0])), self.smallest)
        return [target for target in self.targets if target > t + near]


def distinct(start: float, end: float) -> bool:
    """Whether the two halves of a step are not lost in rounding."""
    return start < (start + end) / 2 < end


def _require_steps(times: npt.NDArray[np.float64], adaptive: Adaptive | None) -> None:
    """Raise ModelError if steps between times, or the shortest parts of them, are lost in rounding."""
    tiny = np.finfo(float).tiny  # smaller numbers lose digits
    if adaptive:
        start, first = float(times[0]), min(adaptive.first, float(times[-1] - times[0]))
        if not distinct(start, start + first) or (adaptive.smallest or first / MOST_SHORTENED) < tiny:
            raise ModelError(f"Adaptive: first is {first:g}: a step from t = {start:g} that is lost in rounding")
        if adaptive.largest < np.spacing(np.abs(times).max()) * 2:
            raise ModelError(
                f"Adaptive: largest is {adaptive.largest:g}: such steps to t = {times[-1]:g} are lost in rounding"
            )
    dt = np.diff(times)
    near = np.maximum(np.spacing(np.maximum(np.abs(times[1:]), np.abs(times[:-1]))), tiny)
    lost = np.flatnonzero(dt < near * (1 if adaptive else 2**HALVINGS))
    if len(lost):
        a, b = times[lost[0]], times[lost[0] + 1]
        raise ModelError(f"times has {b!r} after {a!r}: the step between them, or its parts, are lost in rounding")


def _with_breaks(start: float, targets: list[float], breaks: set[float]) -> list[float]:
    """Targets and the breaks before the last target, without times that differ from others only by rounding."""
    near = SAME_TIME * max(abs(start), abs(targets[-1]))
    found = np.array([start, *targets])
    for t in sorted(t for t in breaks if start < t < targets[-1]):
        if np.abs(found - t).min() > near:
            found = np.append(found, t)
    return [float(t) for t in np.sort(found)[1:]]
