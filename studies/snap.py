"""Instability of a non-monotone layer: snaps of pure phases, the least energy, and a path by arc length.

The upper side of a block on a rigid base is moved up and down, more at one end, so that phases spread along S. Three
laws are compared. Pure phases, one for each facet of S, snap. The relaxed law has the least energy. The third law has
only a part r of the energy gain of mixtures, so that its stress falls as phases mix. Its equilibria form one path,
which turns back where pure phases snap. `fig4_bar` solves a uniform strip with closed forms; `tests/test_arc_length.py`
follows its paths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from forms import LinearElastic, NonMonotone, NonMonotoneUnrelaxed
from forms.base import Array
from forms.non_monotone import PhaseLaw
from forms.tensors import Expr
from geometry import block
from geometry.joint import Joint
from geometry.sheet import vectors_from_segments
from studies.problems import SNAP_LAW_ARGS, phases_on_s
from thinlayer import ArcLength, Structure, Table, ThinLayer, march, piecewise, plotting
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Support
from thinlayer.running.record import Record
from thinlayer.solving.history import History

END = 2.4  # largest prescribed displacement
THICKNESS = 0.02  # thickness; the interface law does not depend on it
MIDDLE, TILT = 1.0, 0.15  # the upper side is moved by delta (1 + TILT (x - MIDDLE))
BODY = LinearElastic.young(E=2.0, nu=0.3)
PURE, RELAXED = "pure phases", "relaxed law"
EPS = (0.02, 0.01)  # thicknesses of the meshed layer
STATE_RTOL = 1e-9  # largest relative difference of states that should be the same
PATH_RTOL = 5e-3  # largest distance of two polygons along one path, relative to its size


# ---------------------------------------------------------------- the block
Motion = Callable[[Expr, Expr], Expr]  # of place and time


def march_block(
    joint: Joint, law: PhaseLaw, delta: Motion, times: Sequence[float] | ArcLength, eps: float = 0, keep: str = "all"
) -> History:
    """March the block on its layer under a prescribed displacement of its upper side.

    The table of the history has the additional column "force", the force that does work in this displacement.

    Args:
        joint: joint of the block.
        law: law of the layer.
        delta: prescribed displacement in the middle of the upper side, a function of place and time.
        times: ends of the time steps, or settings of an arc-length continuation.
        eps: thickness of the meshed layer; 0: the interface law.
        keep: states that the history keeps, "all" or "last".
    """

    def force(state: State) -> float:
        reaction = state.reaction("TOP")
        return float(reaction.force[1] + TILT * reaction.moment)

    top: Support = {"y": lambda x, t: delta(x, t) * (1 + TILT * (x[0] - MIDDLE))}
    structure = Structure(joint, body=BODY, supports={"LEFT": {"x": 0}, "TOP": top})
    layer = ThinLayer(law, eps or THICKNESS, at=1.0)
    model: Model = structure.full(layer, cells_through=1) if eps else structure.interface(layer)
    return march(model, times, observe={"force": force}, keep=keep)


def march_cycle(joint: Joint, steps: int, eps: float = 0) -> History:
    """March the block on a layer of pure phases, up to the displacement 2.4 in equal steps and back.

    Args:
        joint: joint of the block.
        steps: number of steps in each direction.
        eps: thickness of the meshed layer; 0: the interface law.

    Returns:
        The history, with all states.
    """
    times = [END * k / steps for k in range(1, 2 * steps + 1)]
    return march_block(joint, NonMonotoneUnrelaxed(*SNAP_LAW_ARGS), piecewise({0: 0, END: END, 2 * END: 0}), times, eps)


def arc_length_path(joint: Joint, r: float, first_step: float, *, backward: bool = False) -> Table:
    """Follow equilibria by arc length for a law whose mixtures of phases keep only a part of their energy gain.

    Args:
        joint: joint of the block.
        r: fraction of the energy gain of mixtures that the law keeps, 0 to 1.
        first_step: length of the first step.
        backward: False: start at delta = 0, and end at 2.4; True: the other way.

    Returns:
        Table of the equilibria, as of `curve_table`.
    """
    law, arc = NonMonotone(*SNAP_LAW_ARGS, mixing=r), ArcLength(end=END, first=first_step)
    history = march_block(joint, law, lambda x, t: END - t if backward else t, arc, keep="last")
    return curve_table(f"path by arc length, r = {r:g}", history, END - history.t if backward else history.t)


def curve_table(curve: str, history: History, delta: Array) -> Table:
    """Return a table with a row for each state of a march.

    Its columns are "curve", "delta" (prescribed displacement), "force", "energy" and "phase" (fraction of S in phase
    1).

    Args:
        curve: name of the curve, the same in all rows.
        history: the march, with the column "force".
        delta: (states,) prescribed displacements of the states.
    """
    force, energy, phase = (history.table[name] for name in ("force", "energy", "plus"))
    return Table.of({"curve": curve, "delta": delta, "force": force, "energy": energy, "phase": phase})


def delta_at(t: npt.ArrayLike) -> Array:
    """Return the prescribed displacements of the block's upper side at the times `t`: up to 2.4 and back."""
    return np.asarray(END - np.abs(np.asarray(t, float) - END))


def switch_deltas(history: History) -> Array:
    """Return the displacements at which the layer changes phase in a `march_cycle`, on its way up and on its way back.

    `history` is the cycle. The array (facets, 2) has a row for each facet of S. Its first number is for the change to
    phase 1, the second one for the change back.
    """
    phases = np.array([phases_on_s(state)[1] for state in history]) > 0.5
    on_index, off_index = phases.argmax(axis=0), len(phases) - phases[::-1].argmax(axis=0)
    return np.column_stack([history.t[on_index], 2 * END - history.t[off_index]])


def polygon_distances(points: Array, vertices: Array) -> Array:
    """Return the distances (n,) of points from a polygonal line, with coordinates scaled by the line's extents.

    Args:
        points: (n, d) points in d dimensions.
        vertices: (m, d) vertices of the line, in their order.
    """
    extents = np.ptp(vertices, axis=0)
    vectors = vectors_from_segments(points / extents, vertices[:-1] / extents, vertices[1:] / extents)
    return np.asarray(np.linalg.norm(vectors, axis=2).min(axis=1))


# ---------------------------------------------------------------- the study
def run(record: Record, *, quick: bool = False) -> None:
    """Move the upper side of the block up and down, and follow its equilibria by arc length from both ends.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: coarser mesh, a path with a smaller snap-back.
    """
    cells, steps, r, step = (12, 12, 0.4, 0.06) if quick else (32, 48, 0.3, 0.02)
    joint = block(2.0, 1.0, 2.0 / cells, cell="quadrilateral", structured=True)
    snaps, response_table = record.new_table("table.csv"), record.new_table("table_response.csv")

    def add_curve(curve: str, history: History) -> None:
        response_table.extend(curve_table(curve, history, delta_at(history.t)).rows)
        snaps.extend({"curve": curve, "delta": float(delta_at(snap.t)), "lost": snap.lost} for snap in history.snaps)

    pure_history = march_cycle(joint, steps)
    add_curve(PURE, pure_history)
    deltas = sorted({*delta_at(pure_history.t).round(12)} - {0.0})
    relaxed_history = march_block(joint, NonMonotone(*SNAP_LAW_ARGS), lambda x, t: t, deltas)
    response_table.extend(curve_table(RELAXED, relaxed_history, relaxed_history.t).rows)
    response_table.extend(check_path(record, joint, relaxed_history, r, step, quick=quick).rows)
    check_energies(record, pure_history, relaxed_history)
    for eps in EPS[: 1 if quick else None]:
        band_history = march_cycle(joint, steps, eps)
        add_curve(f"{PURE}, layer meshed, eps = {eps:g}", band_history)
        max_delay = np.abs(switch_deltas(band_history) - switch_deltas(pure_history)).max() / eps
        record.check(f"eps = {eps:g}: delta where a column switches, less that on S, over eps", max_delay, high=1.0)


def check_path(record: Record, joint: Joint, relaxed: History, r: float, first_step: float, *, quick: bool) -> Table:
    """Follow the equilibria by arc length, and check the path against other computations.

    These are the path from the other end, a path of shorter steps and, at the end, the relaxed law.

    Args:
        record: record of the run, which receives the checks.
        joint: joint of the block.
        relaxed: march of the relaxed law, whose mixtures have the whole energy gain.
        r: fraction of the energy gain of mixtures that the law keeps, 0 to 1.
        first_step: length of the first step.
        quick: whether to leave out the path of shorter steps.

    Returns:
        Table of the path, as of `curve_table`.
    """
    table, name = arc_length_path(joint, r, first_step), f"r = {r:g}"
    others = {"from the other end": arc_length_path(joint, r, first_step, backward=True)}
    if not quick:
        others["with half the steps"] = arc_length_path(joint, r, first_step / 2)
    for how, other in others.items():
        points, vertices = (np.column_stack([path[c] for c in ("delta", "force", "phase")]) for path in (other, table))
        record.check(f"{name}: distance of the path {how}", polygon_distances(points, vertices).max(), high=PATH_RTOL)
    record.check(f"{name}: delta goes back by", float(np.maximum(-np.diff(table["delta"]), 0).sum()), low=1e-3)
    energy, least = table["energy"][-1], relaxed.table["energy"][-1]
    record.check_near(f"{name}: energy at the end of the path over the least one", energy / least, 1.0, STATE_RTOL)
    work = float(np.trapezoid(table["force"], table["delta"]))
    record.check(f"{name}: work along the path over that energy, less 1", abs(work / energy - 1), high=PATH_RTOL)
    return table


def check_energies(record: Record, pure: History, relaxed: History) -> None:
    """Check the energies of two marches: those lost in snaps, and those of pure against relaxed phases.

    All snaps together lose the area of the loop of force over displacement. At no displacement do relaxed phases have
    more energy than pure phases.

    Args:
        record: record of the run, which receives the checks.
        pure: march with pure phases, up and back.
        relaxed: march with the relaxed law, at the same displacements.
    """
    area = float(np.trapezoid(pure.table["force"], delta_at(pure.t)))
    lost = sum(snap.lost for snap in pure.snaps)
    record.check_near("energy lost in all snaps over the area of the loop", lost / area, 1.0, STATE_RTOL)
    excess = pure.table["energy"] - relaxed.table["energy"][np.searchsorted(relaxed.t, delta_at(pure.t) - STATE_RTOL)]
    record.check("energy of pure phases less the relaxed one, smallest", excess.min(), low=-STATE_RTOL)
    record.check("the same, largest", excess.max(), low=1e-2)


# ---------------------------------------------------------------- pictures
def draw(record: Record) -> None:
    """Draw the force on the block over the displacement of its upper side, for all laws.

    The values are read from table_response.csv in the folder of `record`; the picture is response.svg.
    """
    response = record.load("table_response.csv").split("curve")
    meshed_curve = f"{PURE}, layer meshed, eps = {EPS[0]:g}"  # thinner layers would hide one another
    shown_curves = [curve for curve in response if curve == meshed_curve or "meshed" not in curve]
    curves = {curve: (response[curve]["delta"], response[curve]["force"]) for curve in shown_curves}
    title, save = "a block on a layer that snaps, pulled more at one end", record.path("response.svg")
    look = {"title": title, "colours": {meshed_curve: "black"}, "xlim": (0.9, 2.2), "ylim": (2.3, 4.7)}
    plotting.curves(curves, "delta, displacement of the upper side, over height", "force over E/2", save=save, **look)
