"""The largest load on a path of a joint that breaks, its errors by steps and mesh, and its derivatives by parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from forms.base import Array, InputError, require
from thinlayer.discretisation.state import State
from thinlayer.estimating.derivative import LayerOfFactor, chosen_changes, steps_of
from thinlayer.estimating.goals import Goal
from thinlayer.estimating.sensitivity import sensitivity
from thinlayer.solving.history import History
from thinlayer.solving.petsc import Options
from thinlayer.system.table import Table

LOADS = ("load ", "body force", "eigenstrain ")  # first words of parameters that may drive a path beside supports
MAX_SHARE = 1.25  # largest distance of a peak from the first of two states, over the second's, as slopes tell
PARALLEL = 1e-9  # sine of the angle of two lines below which they count as parallel


@dataclass(frozen=True)
class FailureLoad:
    """Largest load of a path and its errors, the result of `failure_load`.

    Attributes:
        value: largest load of all states.
        by_steps: how much larger it may be between states.
        by_mesh: its distance from the largest load on a coarser mesh, and the latter's `by_steps`; nan: not known.
        row: row of the largest load in the history's table.
        history: the history.
    """

    value: float
    by_steps: float
    by_mesh: float
    row: int
    history: History

    @property
    def error(self) -> float:
        """Sum of both errors, without that by the mesh if it is not known."""
        return self.by_steps + (0.0 if math.isnan(self.by_mesh) else self.by_mesh)

    def derivatives(
        self,
        load: Goal | Callable[[State], float],
        parameters: Sequence[str] | None = None,
        *,
        of: Mapping[str, LayerOfFactor] | None = None,
        options: Options | None = None,
    ) -> dict[str, float]:
        """Return the changes p dP/dp of the largest load P per relative change of parameters p, by name. Collective.

        At given displacements the change of a load is that of the peak, minus the slope of the path times its shift. Two
        states yield both: one before and one behind the peak, or two before it if the slope at the second is small. The
        path follows supports whose displacements grow together, without other loads. Otherwise compare two runs.

        Args:
            load: the load, a goal or a function of a state as in `march(..., observe=...)`.
            parameters, of, options: as in `sensitivity`.

        Raises:
            InputError: loads act; no such states, as where t turns back at the peak; as in `sensitivity`, such as a kink
                of a law before the peak, which other steps may avoid.
        """
        model, _ = steps_of(self.history)
        every = [*chosen_changes(model, None, {})]
        moved = [name for name in every if name.startswith("support ")]
        if not moved or model.structure.loads or any(name.startswith(LOADS) for name in every):
            raise InputError("derivatives: loads act, or no support moves; compare two runs")
        a, b = (self.history.states[k].u.x.array[model.bc_dofs_in(model.V)] for k in (self.row, self.row + 1))
        a_a, b_b, a_b = model.comm.allreduce(np.array([a @ a, b @ b, a @ b]))
        if not a_b**2 >= (1 - PARALLEL) * a_a * b_b:
            raise InputError("derivatives: supports do not move in proportion to each other; compare two runs")
        wanted = every if parameters is None else list(parameters)
        names, ends = [*dict.fromkeys([*wanted, *moved])], self.row + 1
        try:
            slopes = sensitivity(_cut(self.history, ends), names, of=of, options=options)
        except InputError:  # points begin to soften together beyond a peak, which is a kink
            ends = self.row
            slopes = sensitivity(_cut(self.history, ends), names, of=of, options=options)
        at = [slopes.of(load, self.history.t[k]) for k in range(self.row - 1, ends + 1)]
        along = [sum(by[name] for name in moved) for by in at]
        shares = [a / (a - b) if a > max(b, 0.0) else math.inf for a, b in pairwise(along)]
        k = min(range(len(shares)), key=lambda k: abs(shares[k] - 0.5))
        if not shares[k] <= MAX_SHARE:
            raise InputError("derivatives: no slopes of both signs beside the peak, or one near 0; compare two runs")
        return {
            name: float(at[k][name] + shares[k] * (at[k + 1][name] - at[k][name])) for name in (*wanted, *(of or {}))
        }

    def __str__(self) -> str:
        mesh = "the mesh is not judged" if math.isnan(self.by_mesh) else f"{self.by_mesh:.2g} by the mesh"
        return f"{self.value:.4g}, errors: {self.by_steps:.2g} by the steps, {mesh}"


def failure_load(
    history: History, load: str, displacement: str = "t", *, coarser: History | None = None
) -> FailureLoad:
    """Return the largest load of a path, how much larger it may be between its states, and its error by the mesh.

    Between two states the path is taken to lie below the lines through them and the states beside them, as for peaks
    that are round or pointed. Where these lines do not meet, the error is the fall of the load to the next state.

    Args:
        history: history of a march with arc length, or in times.
        load: column of the history's table with the load, such as one that `march(..., observe=...)` adds.
        displacement: column of the displacement over which the load has a peak, not one in proportion to the load.
        coarser: history of the same joint on a mesh with cells about twice as large.

    Raises:
        InputError: no such column; the largest load is in one of the first two rows, or of the last two.

    Example:
        >>> from forms import Cohesive, LinearElastic
        >>> from geometry import block
        >>> from thinlayer import ArcLength, Structure, failure_load, march
        >>> joint = block(1, 1, 0.5, cell="quadrilateral", structured=True)
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = Cohesive(K_N=1e4, K_T=1e4, t_N=20, t_T=20, G_I=0.3, G_II=0.3)
        >>> pull = {"TOP": {"y": lambda x, t: t}, "LEFT": {"x": 0}}
        >>> model = Structure(joint, body=steel, supports=pull).interface(glue)
        >>> observe = {"force": lambda state: state.reaction("TOP").force[1]}
        >>> history = march(model, ArcLength(end=0.01, first=5e-4), observe=observe)
        >>> print(round(failure_load(history, "force").value))
        20
    """
    require(isinstance(history, History), "failure_load", history, "give a history, as march returns it")
    P, u = history.table[load], history.table[displacement]
    row = int(P.argmax())
    if not 2 <= row < len(P) - 2:
        text = f"failure_load: the largest {load!r} is in row {row} of {len(P)}"
        raise InputError(f"{text}, and two are needed on both sides; let the path be longer, or take shorter steps")
    points = np.column_stack([u / (np.ptp(u) or 1.0), P / np.ptp(P)])
    by_steps = max(_rise(*points[k : k + 4]) for k in (row - 2, row - 1)) * float(np.ptp(P))
    by_mesh = math.nan
    if coarser is not None:
        other = failure_load(coarser, load, displacement)
        by_mesh = abs(float(P[row]) - other.value) + other.by_steps
    return FailureLoad(float(P[row]), by_steps, by_mesh, row, history)


def _cut(history: History, row: int) -> History:
    """Return a history up to a row of its table, with the states that are kept up to there."""
    states = {k: state for k, state in history.states.items() if k <= row}
    return replace(history, table=Table(history.table.rows[: row + 1]), states=states)


def _rise(before: Array, start: Array, end: Array, after: Array) -> float:
    """Return how far a path between two points may rise above both, by lines through them and the points beside them.

    Args:
        before, start, end, after: successive points (2,) of the path, whose second coordinates are loads.
    """
    a, b = start - before, end - after
    area = float(a[1] * b[0] - a[0] * b[1])  # start + x a = end + y b
    gap, sizes = end - start, float(np.linalg.norm(a) * np.linalg.norm(b))
    if abs(area) > PARALLEL * sizes:
        x, y = (float(gap[1] * v[0] - gap[0] * v[1]) / area for v in (b, a))
        if min(x, y) >= -PARALLEL:
            return max(float(start[1] + x * a[1] - max(start[1], end[1])), 0.0)
    return abs(float(gap[1]))
