"""Through the instability of a non-monotone layer: snaps of pure phases, the least energy, and paths by arc length.

A uniform strip, which has closed forms, and a block that is pulled more at one end, so that phases spread along S. Both
stand on a rigid base, and their upper side is moved. Three laws: pure phases, one for each facet of S, which snap; the
relaxed one, whose energy is least; and one whose stress falls as phases mix, with a part r of the gain that mixtures have:
its equilibria make one path, which turns back where the others snap.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import numpy.typing as npt

from studies.fig4_bar import EXACT, meet, straight
from studies.measured import phases_on_s
from studies.snap_drawing import PURE, RELAXED, draw_phases, draw_response
from studies.snap_structures import END, LIMIT, Block, distance, moved, pulled_block, strip, switches
from thinlayer import History, Table, plotting
from thinlayer.files.progress import track
from thinlayer.files.table import Row
from thinlayer.running.record import Record

Array = npt.NDArray[np.float64]
OTHER_STEPS = (7, 33)
MIXINGS = (0.4, 0.2, 0.1)  # mixing r of the strip's paths; they tend to pure phases as r -> 0
FIRST = (0.1, 0.037)  # first steps of these paths
EPS = (0.02, 0.01)  # thicknesses of the block's meshed layer
SHOWN = (1.32, 1.45, 1.61)  # displacements at which phases are drawn
SAME = 1e-8  # largest relative difference of snaps and turning points that should be the same
ROUNDING = 1e-9  # largest relative difference of states that should be the same
ALONG = 5e-3  # largest distance of two polygons along one path, relative to its size


def run(record: Record, *, quick: bool = False) -> None:
    """Move the upper side up and down, and follow paths from both ends.

    Args:
        record: where to write.
        quick: coarser mesh, a path with less of a snap-back.
    """
    cells, steps, r, step = (12, 12, 0.4, 0.06) if quick else (32, 48, 0.3, 0.02)
    bar, body = strip(), pulled_block(cells)
    record.parameters = {"strip": str(LIMIT), "block": str(body.layer), "cells": cells, "steps": steps, "r": r}
    snaps, response, phases = Table(), Table(), Table()

    pure = bar.cycle(steps)
    note(snaps, response, bar, PURE, pure)
    for row in follow_strip(record, bar, pure, quick=quick):
        response.append(row)

    pure = body.cycle(steps, SHOWN)
    note(snaps, response, body, PURE, pure)
    relaxed = body.least({*moved(pure.t).round(12)} - {0.0})
    for row in (
        *body.rows(RELAXED, relaxed, relaxed.t).rows,
        *follow_block(record, body, relaxed, r, step, quick=quick),
    ):
        response.append(row)
    check_steps(record, body, pure)
    check_energies(record, pure, relaxed)
    for eps in EPS[: 1 if quick else None]:
        band = body.cycle(steps, eps=eps)
        note(snaps, response, body, f"{PURE}, layer meshed, eps = {eps:g}", band)
        late = np.abs(switches(band) - switches(pure)).max()
        record.check(
            f"block, eps = {eps:g}: delta where a column switches, less that on S, over eps", late / eps, high=1.0
        )
    for delta in SHOWN:
        there, back = pure.at(delta), pure.at(2 * END - delta)
        for name, state in {f"{PURE}, up": there, f"{PURE}, down": back, RELAXED: relaxed.at(delta)}.items():
            for place, value in zip(*phases_on_s(state), strict=True):
                phases.append({"delta": delta, "curve": name, "x": place, "phase": value})
    record.write("table.csv", snaps)
    record.write("table_response.csv", response)
    record.write("table_phases.csv", phases)
    record.say(snaps)
    largest = max(pure.snaps, key=lambda snap: snap.lost)
    states = {"just before": pure.states[largest.row - 1], "just after": pure.states[largest.row]}
    title = f"largest snap, delta = {moved(largest.t):.4f}, energy lost: {largest.lost:.4f}"
    plotting.deformed(states, save=record.path("largest_snap.png"), scale=0.2, title=title)


def note(snaps: Table, response: Table, structure: Block, curve: str, history: History) -> None:
    """The snaps of a cycle, a row for each, and its response."""
    for row in structure.rows(curve, history, moved(history.t)).rows:
        response.append(row)
    for snap in history.snaps:
        before, after = (history.table.rows[k] for k in (snap.row - 1, snap.row))
        row = {"structure": structure.name, "curve": curve, "t": snap.t, "delta": float(moved(snap.t))}
        row |= {"force before": before["force"], "force after": after["force"]}
        row |= {"phase before": before["plus"], "phase after": after["plus"]}
        snaps.append(row | {"lost": snap.lost})


def follow_strip(record: Record, bar: Block, pure: History, *, quick: bool) -> list[Row]:
    """Check paths of the strip, from both ends, against closed forms; their turning points tend to the snaps as r -> 0."""
    rows, turns, mixings = [], [], MIXINGS[-2 if quick else 0 :]
    for r in track(mixings, "snap", "strip, r = {:g}"):
        exact = LIMIT.path(r, END)
        errors = []
        for first, back in product(FIRST[: 1 if quick else None], (False, True)):
            path = bar.path(r, first, back=back)
            errors.append(distance(np.column_stack([path["delta"], path["force"]]), exact).max())
            rows += path.rows if first == FIRST[0] else []
        record.check(f"strip, r = {r:g}: distance of paths from the closed form", max(errors), high=ROUNDING)
        turns.append(turning_points(path))
        error = np.abs(np.divide(turns[-1], LIMIT.turning_points(r)) - 1).max()
        record.check(f"strip, r = {r:g}: relative error of turning points", error, high=ROUNDING)
    (more, less), a, b = mixings[-2:], *np.array(turns[-2:])
    snaps = moved([snap.t for snap in pure.snaps])
    error = np.abs((more * b - less * a) / (more - less) / snaps - 1).max()  # they are linear in r
    record.check("strip: turning points extrapolated to r = 0 over snaps, less 1", error, high=SAME)
    return rows


def turning_points(path: Table) -> tuple[float, float]:
    """The displacements at which the straight parts of a uniform layer's path meet."""
    delta, force, phase = (path[name] for name in ("delta", "force", "phase"))
    pure = (phase < ROUNDING, phase > 1 - ROUNDING)
    first, mixed, last = (straight(force, delta, part) for part in (pure[0], ~pure[0] & ~pure[1], pure[1]))
    up, down = (float(np.polyval(line, meet(line, mixed))) for line in (first, last))
    return up, down


def follow_block(record: Record, body: Block, relaxed: History, r: float, step: float, *, quick: bool) -> list[Row]:
    """Check that the path is the same from both ends and with shorter steps, and ends where the relaxed law does."""
    path, shown, name = body.path(r, step), ("delta", "force", "phase"), f"block, r = {r:g}"
    others = {"from the other end": body.path(r, step, back=True)}
    if not quick:
        others["with half the steps"] = body.path(r, step / 2)
    vertices = np.column_stack([path[column] for column in shown])
    for how, other in others.items():
        gap = distance(np.column_stack([other[column] for column in shown]), vertices).max()
        record.check(f"{name}: distance of the path {how}", gap, high=ALONG)
    record.check(f"{name}: delta goes back by", turns_back(path), low=1e-3)
    energy, least = path["energy"][-1], relaxed.table["energy"][-1]
    record.check_near(f"{name}: energy at the end of the path over the least one", energy / least, 1.0, EXACT)
    work = float(np.trapezoid(path["force"], path["delta"]))
    record.check(f"{name}: work along the path over that energy, less 1", abs(work / energy - 1), high=ALONG)
    return path.rows


def turns_back(path: Table) -> float:
    """Sum of all decreases of delta along a path."""
    return float(np.maximum(-np.diff(path["delta"]), 0).sum())


def check_steps(record: Record, body: Block, pure: History) -> None:
    """Check that the energy lost is the area of the loop, and that other steps give the same snaps."""
    area = float(np.trapezoid(pure.table["force"], moved(pure.t)))
    lost = sum(snap.lost for snap in pure.snaps)
    record.check_near("block: energy lost in all snaps over the area of the loop", lost / area, 1.0, EXACT)
    for steps in OTHER_STEPS:
        other = body.cycle(steps).snaps
        record.check(f"block: snaps, {steps} steps", len(other), low=len(pure.snaps), high=len(pure.snaps))
        gaps = [max(abs(a.t - b.t), abs(a.lost - b.lost)) for a, b in zip(pure.snaps, other, strict=False)]
        record.check(f"block: difference of snaps, {steps} steps", max(gaps), high=SAME)


def check_energies(record: Record, pure: History, relaxed: History) -> None:
    """Check that the relaxed energy is never above that of pure phases, and equal where all of S is in one phase."""
    same = np.searchsorted(relaxed.t, moved(pure.t) - ROUNDING)
    found = {name: (pure.table[name], relaxed.table[name][same]) for name in ("energy", "force", "plus")}
    excess = np.subtract(*found["energy"])
    record.check("block: energy of pure phases less the relaxed one, smallest", excess.min(), low=-ROUNDING)
    record.check("block: the same, largest", excess.max(), low=1e-2)
    a, b = found["plus"]
    one_phase = ((a < ROUNDING) & (b < ROUNDING)) | ((a > 1 - ROUNDING) & (b > 1 - ROUNDING))
    for way, inside in {"up": pure.t <= END, "down": pure.t >= END}.items():
        outside = one_phase & inside
        record.check(f"block, {way}: states outside the loop", outside.sum(), low=5)
        gap = max(np.abs(np.subtract(*found[name])[outside]).max() for name in ("energy", "force"))
        record.check(f"block, {way}: difference of both laws there", gap, high=ROUNDING)


def draw(record: Record) -> None:
    """Draw the tables."""
    draw_response(record, LIMIT)
    draw_phases(record)
