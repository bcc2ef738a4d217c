"""ArcLength: the settings of a march along an equilibrium path, and checks of the models that allow one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Integral

import numpy as np

from forms.base import is_number
from thinlayer.errors import ModelError
from thinlayer.parts.pressure import PressurePart
from thinlayer.solving.equations import Equations
from thinlayer.time.plan import distinct


@dataclass(frozen=True)
class ArcLength:
    """An equilibrium path of a model, followed by arc length; t is the parameter of loads and supports and may decrease.

    The path starts at the state of t = start, with t increasing, and goes on in the direction of its last increment.
    Energies are not compared: stable and unstable equilibria are followed alike. Steps should be short compared with the
    features of the path, as events within a step go unnoticed.

    The length of a step is sqrt(|du|^2/U^2 + dt^2/T^2), with the L2 norm of the change du of nodal displacements,
    T = `first`, and U from the first step. Step lengths adapt to the number of Newton steps; steps that fail are halved.
    `smallest` and `largest` are relative to the length of the first step.

    Attributes:
        end: time > start at which the march ends; the last step ends there.
        first: change of t in the first step, > 0.
        smallest: length below which a step is not shortened further (default: 1e-6).
        largest: length of the longest step (default: 1; longer steps may pass over loops of the path).
        steps: largest number of steps; a longer path is a SolveError.
        back: time < start below which the march ends, too. Without it a path that comes back to start - (end - start) is
            a SolveError. Loads and supports are evaluated at such times.

    Raises:
        ModelError: values out of range.
    """

    end: float
    first: float
    smallest: float = 1e-6
    largest: float = 1.0
    steps: int = 1000
    back: float | None = None

    def __post_init__(self) -> None:
        for name in ("end", "first", "smallest", "largest", "back"):
            value = getattr(self, name)
            if value is None and name == "back":
                continue
            signed = name in ("end", "back")
            number = float(value) if is_number(value) else math.nan
            if not (math.isfinite(number) or (name == "largest" and number > 0)) or not (signed or number > 0):
                raise ModelError(f"ArcLength: {name} is {value!r}; allowed: a number" + " > 0" * (not signed))
        if not isinstance(self.steps, Integral) or isinstance(self.steps, bool) or self.steps < 1:
            raise ModelError(f"ArcLength: steps is {self.steps!r}; allowed: a whole number > 0")
        if self.largest < self.smallest:
            raise ModelError(f"ArcLength: largest is {self.largest:g}; allowed: >= smallest = {self.smallest:g}")

    def lowest(self, start: float) -> float:
        """The time below which the march ends."""
        return 2 * start - self.end if self.back is None else float(self.back)

    def check(self, start: float) -> None:
        """Raise ModelError unless the path can begin at the time `start`."""
        if not math.isfinite(start) or not self.end > start:
            raise ModelError(f"ArcLength: end is {self.end:g}; it must come after start = {start:g}")
        if self.first > self.end - start:
            raise ModelError(f"ArcLength: first is {self.first:g}; end - start is {self.end - start:g}")
        if not distinct(start, start + self.first) or self.first**2 < np.finfo(float).tiny:
            raise ModelError(f"ArcLength: first is {self.first:g}: a step from t = {start:g} that is lost in rounding")
        if not self.lowest(start) < start:
            raise ModelError(f"ArcLength: back is {self.back:g}; it must be less than start = {start:g}")


def require_choices(theta: float, method: str | None) -> None:
    """Raise ModelError unless a path is followed by Newton's method, with forces that balance at t itself."""
    if theta != 1:
        raise ModelError(f"theta is {theta}; forces on a path balance at t itself: theta = 1")
    if method not in (None, "newton"):
        raise ModelError(f"method is {method!r}; a path is followed by Newton's method")


def require_path(equations: Equations) -> None:
    """Raise ModelError unless paths of the model can be followed: no part has a rate or bounds. Collective."""
    refused = {
        "releases": "{} is a contact law: march in time instead of ArcLength",
        "bounded": "{} bounds stresses: on a path loads stay at their limit; march in time, which finds the limit",
        "switches": "{} has pure phases: its equilibria do not form one curve; march in time, which finds the snaps",
        "rate": "{} depends on rates, and t is no time on a path: march in time",
    }
    for part in equations.of_kind(PressurePart):
        for name in part.named():
            raise ModelError(f"{name} is incompressible: paths have displacements alone, no pressures; march in time")
    equations.refuse(refused)
    for name in filter(None, equations.ask("takes_time")):
        raise ModelError(f"{name} creeps or relaxes, and t is no time on a path: march in time")
