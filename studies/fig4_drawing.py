"""Pictures of the bar of section 6.2: energies and their slopes, force over displacement, elongation and phase boundary."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from forms.limits import Bar
from thinlayer import Table
from thinlayer.output.plotting import COLOURS
from thinlayer.output.plotting.curves import MARKERS
from thinlayer.output.plotting.picture import finish
from thinlayer.running.record import Record

Array = npt.NDArray[np.float64]
LIMIT = (0.1, 0.05, 0.0)  # thicknesses that are shown side by side
CUTS = (1.0, 1.6, 2.0)  # delta of the three intersections
ELEMENTS = 8
FINE = 401
COMPUTED: dict[str, Any] = {"linestyle": "none", "markerfacecolor": "white", "zorder": 4}
FAINT: dict[str, Any] = {"color": "0.75", "linewidth": 0.9, "zorder": 1}


def draw_energies(record: Record, bar: Bar) -> None:
    """Energies of the layer over its elongation, as in Fig. 4; their slopes, which meet the body's force at three delta."""
    figure = Figure(figsize=(10, 4.8), layout="constrained")
    energies, slopes = figure.subplots(1, 2)
    U = np.linspace(0, 1.35, FINE, dtype=np.float64)
    (_, pure, _), (force, envelope, _) = bar.layer(U, 0), bar.layer(U, 1)
    first = bar.kbar / bar.l * U**2 / 2
    second = first - bar.alpha * U + bar.l * bar.cbar
    energies.plot(U, first, "--", color=COLOURS[0], label="W_1, phase 0")
    energies.plot(U, second, "--", color=COLOURS[2], label="W_2, phase 1")
    energies.plot(U, pure, color="black", linewidth=1.2, label="W_min")
    energies.plot(U, envelope, color=COLOURS[1], linewidth=2, label="CW_min, its convex envelope")
    energies.set(ylabel="energy of the layer", ylim=(0, 2.2))
    slopes.plot(U, np.where(first < second, bar.kbar / bar.l * U, np.nan), **FAINT, label="W_min'")
    slopes.plot(U, np.where(first > second, bar.kbar / bar.l * U - bar.alpha, np.nan), **FAINT)
    slopes.plot(U, force, color=COLOURS[1], linewidth=2, label="CW_min'")
    table = of(record.load("table.csv"), bar.eps)
    for delta, style in zip(CUTS, ("-", "--", ":"), strict=True):
        body = bar.K / (bar.l * (1 - bar.eps)) * (delta - U)
        slopes.plot(U, body, style, color=COLOURS[0], linewidth=1.2, label=f"W', delta = {delta:g}")
    at = np.isclose(table["delta"][:, None], CUTS).any(axis=1)
    slopes.plot(table["U"][at], table["sigma"][at], "o", color="black", zorder=4, label=f"computed, eps = {bar.eps:g}")
    slopes.set(ylabel="force", ylim=(0, 3.2))
    for axes in (energies, slopes):
        axes.set(xlabel="U, elongation of the layer", xlim=(U[0], U[-1]))
        axes.legend(frameon=False, fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=3)
    _finish(record, figure, "energies.png")


def draw_response(record: Record, bar: Bar) -> None:
    """Force over displacement: least energy, the loop of pure phases, and the equilibria of some elements."""
    figure = Figure(figsize=(7.5, 5.2), layout="constrained")
    axes = figure.subplots()
    relaxed = of(record.load("table.csv"), bar.eps)
    loop = of(record.load("table_loop.csv"), bar.eps)
    delta = np.linspace(0, relaxed["delta"].max(), FINE)
    states = bar.layouts(delta, ELEMENTS)
    for m, sigma in enumerate(np.where(states.local, states.sigma, np.nan).T):
        axes.plot(delta, sigma, **FAINT, label="_" if m else f"pure phases in {ELEMENTS} elements, all equilibria")
    axes.plot(delta, bar.sigma(delta), color=COLOURS[1], linewidth=2, label="least energy, closed form")
    axes.plot(relaxed["delta"], relaxed["sigma"], "o", color=COLOURS[1], **COMPUTED, label="relaxed law, computed")
    _draw_loop(axes, bar, loop)
    axes.set(xlabel="delta, displacement of the end", ylabel="sigma, force", xlim=(0, delta[-1]), ylim=(0, 2.7))
    _finish(record, figure, "response.png", axes)


def _draw_loop(axes: Axes, bar: Bar, loop: Table) -> None:
    """The branches of the layer in one phase while it holds, an arrow for each snap, and what was computed."""
    after = np.flatnonzero(~np.isnan(loop["lost"]))
    end = float(loop["delta"].max())
    branches = [np.array([0, bar.up]), np.array([bar.down, end])]
    x = np.concatenate([branches[0], [np.nan], branches[1]])
    y = np.concatenate([bar.branch(branches[0], 0).sigma, [np.nan], bar.branch(branches[1], 1).sigma])
    axes.plot(x, y, color=COLOURS[0], linewidth=1.2, label="one phase, kept while it holds, closed form")
    axes.plot(loop["delta"], loop["sigma"], "s", color=COLOURS[0], markersize=4, **COMPUTED, label="the same, computed")
    for k in after:
        before, state = ((float(loop["delta"][i]), float(loop["sigma"][i])) for i in (k - 1, k))
        axes.annotate("", state, before, arrowprops={"arrowstyle": "->", "color": COLOURS[0], "linestyle": "--"})
        up, text = state[1] > before[1], f"snap, energy lost: {loop['lost'][k]:.4f}"
        offset, side = (0, -6 if up else 6), "top" if up else "bottom"
        axes.annotate(text, before, offset, textcoords="offset points", ha="center", va=side, fontsize="small")


def draw_limit(record: Record, bar: Bar) -> None:
    """Elongation of the layer and position of the phase boundary over displacement, for all thicknesses."""
    figure = Figure(figsize=(10, 4.4), layout="constrained")
    elongation, boundary = figure.subplots(1, 2)
    table = record.load("table.csv")
    delta = np.linspace(0, table["delta"].max(), FINE)
    for k, eps in enumerate(LIMIT):
        one, rows = replace(bar, eps=eps), of(table, eps)
        name = f"eps = {eps:g}" if eps else "eps -> 0, interface law"
        for axes, exact, found in (
            (elongation, one.U(delta), rows["U"]),
            (boundary, 1 - one.phase(delta), 1 - rows["phase"]),
        ):
            axes.plot(delta, exact, color=COLOURS[k], linewidth=1.2, label=f"{name}, closed form")
            axes.plot(rows["delta"], found, MARKERS[k], color=COLOURS[k], **COMPUTED, label=f"{name}, computed")
    elongation.set(ylabel="U, elongation of the layer")
    boundary.set(ylabel="phase boundary: height over the layer's thickness")
    for axes in (elongation, boundary):
        axes.set(xlabel="delta, displacement of the end", xlim=(0, delta[-1]))
    _finish(record, figure, "elongation.png", elongation)


def of(table: Table, eps: float) -> Table:
    """The rows of a thickness."""
    return Table(row for row in table.rows if row["eps"] == eps)


def _finish(record: Record, figure: Figure, name: str, *with_legend: Axes) -> None:
    for axes in figure.axes:
        axes.grid(color="0.93")
    for axes in with_legend:
        axes.legend(frameon=False, fontsize="small", loc="upper left")
    finish(figure, record.path(name))
