"""Pictures of snaps: force over displacement with every equilibrium that was followed, and phases along S."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from forms.limits import Bar
from thinlayer import Table, plotting
from thinlayer.output.plotting import COLOURS
from thinlayer.output.plotting.picture import finish
from thinlayer.running.record import Record

Array = npt.NDArray[np.float64]
PURE, RELAXED, BACK = "pure phases", "relaxed law", ", back"
PATHS = (COLOURS[2], COLOURS[3], COLOURS[4])
BY_LAW: dict[str, dict[str, Any]] = {
    PURE: {"color": COLOURS[0], "linewidth": 1.5, "zorder": 3},
    RELAXED: {"color": COLOURS[1], "linewidth": 2.0, "zorder": 2},
}
MESHED: dict[str, Any] = {"color": "black", "linestyle": ":", "linewidth": 1.2, "zorder": 4}


def draw_response(record: Record, bar: Bar) -> None:
    """Force over displacement: the strip with closed forms, and the block."""
    figure = Figure(figsize=(11, 5.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    table = record.load("table_response.csv")
    curves: dict[str, dict[str, Table]] = {"strip": {}, "block": {}}
    for row in table.rows:
        curves[str(row["structure"])].setdefault(str(row["curve"]), Table()).append(row)
    _draw_strip(left, bar, curves["strip"])
    left.set(title="uniform strip, with closed forms")
    _draw_block(right, curves["block"])
    right.set(title="block, pulled more at one end", xlim=(1.0, 2.2))
    for axes in (left, right):
        axes.set(xlabel="delta, displacement of the upper side", ylabel="force")
        axes.grid(color="0.93")
        axes.legend(frameon=False, fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2)
    finish(figure, record.path("response.png"))


def _draw_strip(axes: Axes, bar: Bar, curves: dict[str, Table]) -> None:
    """Paths that turn back, the more sharply the smaller r, and the loop of pure phases, to which they tend."""
    end = curves[PURE]["delta"].max()
    axes.plot(curves[PURE]["delta"], curves[PURE]["force"], **BY_LAW[PURE], label="pure phases, up and down: snaps")
    delta = np.linspace(0, end, 201)
    axes.plot(delta, bar.sigma(delta), **BY_LAW[RELAXED], label="least energy")
    ends = {name: one for name, one in curves.items() if name != PURE}
    names = [name for name in ends if BACK not in name]
    for name, colour in zip(names, PATHS, strict=False):
        vertices = bar.path(float(name.removeprefix("r = ")), end)
        axes.plot(*vertices.T, color=colour, linewidth=1.0)
        axes.plot(ends[name]["delta"], ends[name]["force"], "o", color=colour, markersize=4, label=f"path, {name}")
        back = ends[name + BACK]
        axes.plot(back["delta"], back["force"], "x", color=colour, markersize=5, label=f"{name}, from the other end")
    axes.set(xlim=(0.9, 2.2), ylim=(0.9, 2.5))


def _draw_block(axes: Axes, curves: dict[str, Table]) -> None:
    for name, one in curves.items():
        if name in BY_LAW:
            label = "pure phases, up and down" if name == PURE else "least energy: relaxed law"
            axes.plot(one["delta"], one["force"], **BY_LAW[name], label=label)
        elif name.startswith("r = "):
            axes.plot(one["delta"], one["force"], color=PATHS[0], linewidth=1.5, label=f"path by arc length, {name}")
    thickest = next(name for name in curves if name.startswith(PURE) and name != PURE)
    axes.plot(curves[thickest]["delta"], curves[thickest]["force"], **MESHED, label=thickest)
    axes.set(ylim=(2.3, 4.7))


def draw_phases(record: Record) -> None:
    """The phase along S at some displacements."""
    table = record.load("table_phases.csv")
    parts: dict[str, dict[str, tuple[Array, Array]]] = {}
    for delta in dict.fromkeys(table["delta"]):
        lines = parts.setdefault(f"delta = {delta:g}", {})
        rows = [row for row in table.rows if row["delta"] == delta]
        for name in dict.fromkeys(str(row["curve"]) for row in rows):
            one = Table(row for row in rows if row["curve"] == name)
            lines[name] = one["x"], one["phase"]
    names = list(next(iter(parts.values())))
    plotting.panels(
        parts,
        xlabel="x along S",
        ylabels=dict.fromkeys(parts, "share of phase 1"),
        styles=dict(zip(names, ("-", "--", "-"), strict=True)),
        colours=dict(zip(names, (COLOURS[0], COLOURS[2], COLOURS[1]), strict=True)),
        ylims=dict.fromkeys(parts, (-0.08, 1.08)),
        save=record.path("phases.png"),
    )
