"""Through the instability of a non-monotone layer: snaps of pure phases, the least energy, and paths by arc length.

A uniform strip, which has closed forms, and a block that is pulled more at one end, so that phases spread along S. Both
stand on a rigid base, and their upper side is moved. Three laws: pure phases, one for each facet of S, which snap; the
relaxed one, whose energy is least; and one whose stress falls as phases mix, with a part r of the gain that mixtures have:
its equilibria make one path, which turns back where the others snap.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

from forms import LinearElastic, NonMonotone, NonMonotoneUnrelaxed
from forms.base import Array
from forms.non_monotone import Phases
from geometry import block
from geometry.joint import Joint
from studies.fig4_bar import BAR, EXACT, meet, straight
from studies.problems import phases_on_s
from thinlayer import ArcLength, Structure, Table, ThinLayer, march, piecewise, plotting
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Support
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.running.record import Record
from thinlayer.solving.history import History
from thinlayer.system.progress import track
from thinlayer.system.table import Row

END = 2.4  # largest prescribed displacement
LIMIT = replace(BAR, eps=0.0)  # the bar with its interface law
THIN = 0.02  # thickness; the interface law does not depend on it
PURE, RELAXED, BACK = "pure phases", "relaxed law", ", back"
OTHER_STEPS = (7, 33)
MIXINGS = (0.4, 0.2, 0.1)  # mixing r of the strip's paths; they tend to pure phases as r -> 0
FIRST = (0.1, 0.037)  # first steps of these paths
EPS = (0.02, 0.01)  # thicknesses of the block's meshed layer
SHOWN = (1.32, 1.45, 1.61)  # displacements at which phases are drawn
SAME = 1e-8  # largest relative difference of snaps and turning points that should be the same
ROUNDING = 1e-9  # largest relative difference of states that should be the same
ALONG = 5e-3  # largest distance of two polygons along one path, relative to its size
TITLES = {"strip": "uniform strip, with closed forms", "block": "block, pulled more at one end"}


# ---------------------------------------------------------------- structures
@dataclass(frozen=True)
class Block:
    """A block on a rigid base, on rollers on its left; its upper side is moved by delta (1 + tilt (x - middle)) across S.

    Attributes:
        name: for tables.
        joint: the block and S.
        body: its law.
        layer: parameters of the layer's law, at the thickness 1.
        middle: of the upper side.
        tilt: 0: all of it is moved by the same.
    """

    name: str
    joint: Joint
    body: LinearElastic
    layer: dict[str, Any]
    middle: float = 0.0
    tilt: float = 0.0

    def march(
        self, law: type[Phases], delta: Any, times: Any, eps: float | None = None, keep: str = "all", **choices: Any
    ) -> History:
        """March, with delta(x, t), on the interface law or a meshed layer that is eps thick; observes delta's force."""

        def top(x: Any, t: Any) -> Any:
            return delta(x, t) * (1 + self.tilt * (x[0] - self.middle))

        def force(state: State) -> float:
            given = state.reaction("TOP")
            return float(given.force[1] + self.tilt * given.moment)

        layer = ThinLayer(law(**self.layer, **choices), eps or THIN, at=1.0)
        supports: dict[str, Support] = {"LEFT": {"x": 0}, "TOP": {"y": top}}
        structure = Structure(self.joint, body=self.body, supports=supports)
        model: Model = structure.full(layer, cells_through=1) if eps else structure.interface(layer)
        return march(model, times, observe={"force": force}, keep=keep)

    def cycle(self, steps: int, stops: Sequence[float] = (), eps: float | None = None) -> History:
        """Pure phases, up to END in equal steps and back, with stops at some displacements."""
        delta = piecewise({0: 0, END: END, 2 * END: 0})
        up = sorted({*(END * k / steps for k in range(1, steps + 1)), *stops})
        return self.march(NonMonotoneUnrelaxed, delta, [*up, *(2 * END - d for d in up[-2::-1]), 2 * END], eps)

    def path(self, r: float, first: float, *, back: bool = False) -> Table:
        """Equilibria from delta = 0 to END, or from END to 0, by arc length."""
        arc = ArcLength(end=END, first=first)
        history = self.march(NonMonotone, lambda x, t: END - t if back else t, arc, keep="last", mixing=r)
        return self.rows(f"r = {r:g}" + BACK * back, history, END - history.t if back else history.t)

    def least(self, delta: Iterable[float]) -> History:
        """The relaxed law, at increasing displacements > 0."""
        return self.march(NonMonotone, lambda x, t: t, sorted(delta))

    def rows(self, curve: str, history: History, delta: Array) -> Table:
        """Displacement, force, energy and share of phase 1 of all states of a march."""
        columns = {"force": "force", "energy": "energy", "phase": "plus"}
        values = {name: history.table[column] for name, column in columns.items()}
        return Table.of({"structure": self.name, "curve": curve, "delta": delta, **values})


def strip() -> Block:
    """The bar of section 6.2 in its limit."""
    joint = block(1.0, LIMIT.l, LIMIT.l, cell="quadrilateral", structured=True)
    mu, C = LIMIT.kbar / LIMIT.l / 2, LIMIT.l * LIMIT.cbar
    layer = {"lmbda": 0.0, "mu": mu, "alpha": LIMIT.alpha, "transformation_energy": C, "chi": np.diag([0.0, 1.0])}
    return Block("strip", joint, LinearElastic(0.0, LIMIT.K / 2), layer)


def pulled_block(cells: int) -> Block:
    """A block, 2 x 1, on a layer that changes phase as it opens and is sheared; cells along S."""
    joint = block(2.0, 1.0, 2.0 / cells, cell="quadrilateral", structured=True)
    chi = np.array([[0.0, 0.3], [0.3, 1.0]])
    layer = {"lmbda": 1.0, "mu": 1.0, "alpha": 1.2, "transformation_energy": 0.9, "chi": chi}
    return Block("block", joint, LinearElastic.young(E=2.0, nu=0.3), layer, middle=1.0, tilt=0.15)


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


# ---------------------------------------------------------------- the study
def run(record: Record, *, quick: bool = False) -> None:
    """Move the upper side up and down, and follow paths from both ends.

    Args:
        record: where to write.
        quick: coarser mesh, a path with less of a snap-back.
    """
    cells, steps, r, step = (12, 12, 0.4, 0.06) if quick else (32, 48, 0.3, 0.02)
    bar, body = strip(), pulled_block(cells)
    names = ("table.csv", "table_response.csv", "table_phases.csv")
    snaps, response, phases = (record.table(name) for name in names)

    pure = bar.cycle(steps)
    note(snaps, response, bar, PURE, pure)
    response.extend(follow_strip(record, bar, pure, quick=quick))

    pure = body.cycle(steps, SHOWN)
    note(snaps, response, body, PURE, pure)
    relaxed = body.least({*moved(pure.t).round(12)} - {0.0})
    response.extend(body.rows(RELAXED, relaxed, relaxed.t).rows)
    response.extend(follow_block(record, body, relaxed, r, step, quick=quick))
    check_steps(record, body, pure)
    check_energies(record, pure, relaxed)
    for eps in EPS[: 1 if quick else None]:
        band = body.cycle(steps, eps=eps)
        note(snaps, response, body, f"{PURE}, layer meshed, eps = {eps:g}", band)
        late = np.abs(switches(band) - switches(pure)).max() / eps
        record.check(f"block, eps = {eps:g}: delta where a column switches, less that on S, over eps", late, high=1.0)
    for delta in SHOWN:
        there, back = pure.at(delta), pure.at(2 * END - delta)
        for name, state in {f"{PURE}, up": there, f"{PURE}, down": back, RELAXED: relaxed.at(delta)}.items():
            x, phase = phases_on_s(state)
            phases.extend(Table.of({"delta": delta, "curve": name, "x": x, "phase": phase}))
    largest = max(pure.snaps, key=lambda snap: snap.lost)
    states = {"just before": pure.states[largest.row - 1], "just after": pure.states[largest.row]}
    title = f"largest snap, delta = {moved(largest.t):.4f}, energy lost: {largest.lost:.4f}"
    plotting.deformed(states, save=record.path("largest_snap.png"), scale=0.2, title=title)


def note(snaps: Table, response: Table, structure: Block, curve: str, history: History) -> None:
    """The snaps of a cycle, a row for each, and its response."""
    response.extend(structure.rows(curve, history, moved(history.t)).rows)
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
        error = np.abs(np.divide(turns[-1], exact[1:3, 0]) - 1).max()
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
    back = np.maximum(-np.diff(path["delta"]), 0).sum()
    record.check(f"{name}: delta goes back by", float(back), low=1e-3)
    energy, least = path["energy"][-1], relaxed.table["energy"][-1]
    record.check_near(f"{name}: energy at the end of the path over the least one", energy / least, 1.0, EXACT)
    work = float(np.trapezoid(path["force"], path["delta"]))
    record.check(f"{name}: work along the path over that energy, less 1", abs(work / energy - 1), high=ALONG)
    return path.rows


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


# ---------------------------------------------------------------- pictures
def draw(record: Record) -> None:
    """Draw force over displacement with every equilibrium that was followed, and phases along S at some displacements."""
    by_name = record.load("table_response.csv").split("structure")
    parts: dict[str, dict[str, tuple[Any, Any]]] = {}
    for name, title in TITLES.items():
        curves = by_name[name].split("curve")
        parts[title] = {curve: (rows["delta"], rows["force"]) for curve, rows in curves.items()}
    strip, delta = parts[TITLES["strip"]], np.linspace(0, END, 201, dtype=np.float64)
    strip[RELAXED] = delta, LIMIT.sigma(delta)
    styles: dict[str, str] = {}
    colours = {PURE: COLOURS[0], RELAXED: COLOURS[1]}
    paths = [curve for curve in strip if curve.startswith("r = ") and BACK not in curve]
    for curve, colour in zip(paths, COLOURS[2:], strict=False):
        vertices, exact = LIMIT.path(float(curve.removeprefix("r = ")), END), f"{curve}, closed form"
        strip[exact] = vertices[:, 0], vertices[:, 1]
        styles |= {curve: "o", curve + BACK: "x"}
        colours |= dict.fromkeys((curve, curve + BACK, exact), colour)
    others = [curve for curve in parts[TITLES["block"]] if curve not in (PURE, RELAXED)]
    meshed, *finer = [curve for curve in others if "meshed" in curve]
    for curve in finer:  # they hide one another
        del parts[TITLES["block"]][curve]
    styles[meshed] = ":"
    colours |= dict.fromkeys(others, COLOURS[2]) | {meshed: "black"}
    end, save = "delta, displacement of the upper side", record.path("response.png")
    forces = {TITLES["strip"]: (0.9, 2.5), TITLES["block"]: (2.3, 4.7)}
    plotting.curves(parts, end, "force", styles=styles, colours=colours, xlim=(0.9, 2.2), ylim=forces, save=save)
    parts = {
        f"delta = {delta:g}": {curve: (rows["x"], rows["phase"]) for curve, rows in part.split("curve").items()}
        for delta, part in record.load("table_phases.csv").split("delta").items()
    }
    styles, save = {f"{PURE}, down": "--"}, record.path("phases.png")
    plotting.curves(parts, "x along S", "share of phase 1", styles=styles, ylim=(-0.08, 1.08), save=save)
