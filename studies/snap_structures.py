"""Structures on a non-monotone layer, moved up and down or followed along their equilibria: a uniform strip and a block."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from forms import LinearElastic, NonMonotone, NonMonotoneUnrelaxed
from forms.non_monotone import Phases
from geometry import Joint, block
from studies.fig4_bar import BAR
from studies.measured import SupportForce, phases_on_s
from studies.snap_drawing import BACK
from thinlayer import ArcLength, History, Model, Structure, Table, ThinLayer, march, piecewise
from thinlayer.discretisation.supports import Support

Array = npt.NDArray[np.float64]
END = 2.4  # largest prescribed displacement
LIMIT = replace(BAR, eps=0.0)  # the bar with its interface law
THIN = 0.02  # thickness; the interface law does not depend on it


@dataclass(frozen=True)
class Block:
    """A block on a rigid base, on rollers on its left; its upper side is moved by delta shape(x) across S.

    Attributes:
        name: for tables.
        joint: the block and S.
        body: its law.
        layer: parameters of the layer's law, at the thickness 1.
        shape: function of coordinates, UFL or numpy; its mean over the upper side is 1.
    """

    name: str
    joint: Joint
    body: LinearElastic
    layer: dict[str, Any]
    shape: Callable[[Any], Any]

    def model(
        self, law: type[Phases], delta: Callable[[Any, Any], Any], eps: float | None = None, **choices: Any
    ) -> Model:
        """The model with its interface law, or with a meshed layer that is eps thick, and with delta(x, t)."""
        layer = ThinLayer(law(**self.layer, **choices), eps or THIN, at=1.0)
        supports: dict[str, Support] = {"LEFT": {"x": 0}, "TOP": {"y": lambda x, t: delta(x, t) * self.shape(x)}}
        moved = Structure(self.joint, body=self.body, supports=supports)
        return moved.full(layer, cells_through=1) if eps else moved.interface(layer)

    def march(self, model: Model, times: Sequence[float] | ArcLength, keep: str = "all") -> History:
        """March that observes the force conjugate to delta."""
        return march(model, times, observe={"force": SupportForce(model, "TOP", "y", self.shape)}, keep=keep)

    def cycle(self, steps: int, stops: Sequence[float] = (), eps: float | None = None) -> History:
        """Pure phases, up to END in equal steps and back, with stops at some displacements."""
        model = self.model(NonMonotoneUnrelaxed, piecewise({0: 0, END: END, 2 * END: 0}), eps)
        up = sorted({*(END * k / steps for k in range(1, steps + 1)), *stops})
        return self.march(model, [*up, *(2 * END - delta for delta in up[-2::-1]), 2 * END])

    def path(self, r: float, first: float, *, back: bool = False) -> Table:
        """Equilibria from delta = 0 to END, or from END to 0, by arc length."""
        model = self.model(NonMonotone, lambda x, t: END - t if back else t, mixing=r)
        history = self.march(model, ArcLength(end=END, first=first), "last")
        return self.rows(f"r = {r:g}" + BACK * back, history, END - history.t if back else history.t)

    def least(self, delta: Iterable[float]) -> History:
        """The relaxed law, at increasing displacements > 0."""
        return self.march(self.model(NonMonotone, lambda x, t: t), sorted(delta))

    def rows(self, curve: str, history: History, delta: Array) -> Table:
        """Displacement, force, energy and share of phase 1 of all states of a march."""
        columns = {"force": "force", "energy": "energy", "phase": "plus"}
        found = Table()
        for x, row in zip(delta, history.table.rows, strict=True):
            found.append({"structure": self.name, "curve": curve, "delta": x} | {k: row[v] for k, v in columns.items()})
        return found


def strip() -> Block:
    """The bar of section 6.2 in its limit."""
    joint = block(1.0, LIMIT.l, LIMIT.l, cell="quadrilateral", structured=True)
    mu, C = LIMIT.kbar / LIMIT.l / 2, LIMIT.l * LIMIT.cbar
    layer = {"lmbda": 0.0, "mu": mu, "alpha": LIMIT.alpha, "transformation_energy": C, "chi": np.diag([0.0, 1.0])}
    return Block("strip", joint, LinearElastic(0.0, LIMIT.K / 2), layer, lambda x: 1 + 0 * x[0])


def pulled_block(cells: int) -> Block:
    """A block, 2 x 1, on a layer that changes phase as it opens and is sheared; cells along S."""
    joint = block(2.0, 1.0, 2.0 / cells, cell="quadrilateral", structured=True)
    layer = {
        "lmbda": 1.0,
        "mu": 1.0,
        "alpha": 1.2,
        "transformation_energy": 0.9,
        "chi": np.array([[0.0, 0.3], [0.3, 1.0]]),
    }
    return Block("block", joint, LinearElastic.young(E=2.0, nu=0.3), layer, lambda x: 0.85 + 0.15 * x[0])


def moved(t: npt.ArrayLike) -> Array:
    """The prescribed displacement delta at times of a cycle."""
    return np.asarray(END - np.abs(np.asarray(t, float) - END))


def switches(history: History) -> Array:
    """Displacements (columns, 2) at which each column of a cycle changes to phase 1, and back."""
    phases = np.array([phases_on_s(state)[1] for state in history]) > 0.5
    first, last = phases.argmax(axis=0), len(phases) - phases[::-1].argmax(axis=0)
    return np.column_stack([history.t[first], 2 * END - history.t[last]])


def distance(points: Array, vertices: Array) -> Array:
    """Distances (n,) of points (n, d) from a polygon (m, d), over the size of its components."""
    size = np.ptp(vertices, axis=0)
    points, vertices = points / size, vertices / size
    starts, sides = vertices[:-1], np.diff(vertices, axis=0)
    from_start = points[:, None] - starts
    length2 = np.maximum(np.sum(sides**2, axis=1), np.finfo(float).tiny)
    along = np.clip(np.sum(from_start * sides, axis=2) / length2, 0, 1)
    return np.linalg.norm(from_start - along[:, :, None] * sides, axis=2).min(axis=1)
