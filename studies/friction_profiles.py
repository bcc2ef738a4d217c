"""Tractions and status along S of a frictional band and of contact, tables and a picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from thinlayer import State, Surface, Table, plotting
from thinlayer.output.plotting.contacts import STATUS
from thinlayer.output.plotting.picture import finish
from thinlayer.running.record import Record

NO_PRESSURE = 1e-3  # pressure, relative to the largest one, below which a node counts as separated
AT_LIMIT = 1e-2  # relative distance from the threshold at which a node counts as sliding
CONTACT: dict[str, Any] = {"color": "black", "linewidth": 1.8, "label": "contact on S"}


def profile_of(band: State, contact: State, friction: float) -> Table:
    """Place x, pressure, tangential traction and status of both models at the nodes of S, in 2D. Collective."""
    surface = Surface(contact.model)
    columns: dict[str, Any] = {}
    for name, state in (("band", band), ("contact", contact)):
        x, t = surface.profile(surface.frame(surface.traction(state)))
        columns |= {"x": x[:, 0], f"p_{name}": -t[:, 1], f"t_T_{name}": t[:, 0]}
        columns |= {f"status_{name}": statuses(t, friction)}
    return Table({name: values[k] for name, values in columns.items()} for k in range(len(columns["x"])))


def statuses(t: npt.NDArray[np.float64], friction: float) -> list[str]:
    """Status of nodes, from their tractions (n, 2) in the frame of S.

    It is found in the same way for both models. In a meshed layer zones end between two cells of different status.
    """
    p, shear = -t[:, 1], np.abs(t[:, 0])
    slides = shear >= (1 - AT_LIMIT) * friction * p
    found = np.where(p <= NO_PRESSURE * p.max(), "separated", np.where(slides, "sliding", "stick"))
    return [str(one) for one in found]


def profile_name(case: str, eps: float) -> str:
    """Name of the table for a case and a thickness."""
    return f"profile_{case}_{eps:g}.csv" if case else f"profile_{eps:g}.csv"


def draw_profiles(record: Record, cases: Mapping[str, str]) -> None:
    """Draw along_S.png: for each case (-> title) status, tractions, and how far apart they are, along S."""
    figure = Figure(figsize=(10.5, 9.0), layout="constrained")
    axes = figure.subplots(4, len(cases), sharex=True, squeeze=False, gridspec_kw={"height_ratios": [3, 5, 5, 4]})
    for column, (case, title) in zip(axes.T, cases.items(), strict=True):
        table = record.load(f"table_{case}.csv" if case else "table.csv")
        profiles = {float(e): record.load(profile_name(case, float(e))) for e in table["eps"]}
        _draw_column(column, profiles)
        column[0].set_title(title)
    patches: list[Any] = [Patch(color=STATUS[name], label=name) for name in ("stick", "sliding", "separated")]
    lines = axes[1, 0].get_legend_handles_labels()[0]
    figure.legend(handles=[*patches, *lines], loc="outside lower center", ncols=4, frameon=False)
    axes[1, 0].set_ylabel("pressure")
    axes[2, 0].set_ylabel("tangential traction")
    axes[3, 0].set_ylabel("tangential traction,\nband less contact")
    figure.align_ylabels(axes[:, 0])
    finish(figure, record.path("along_S.png"))


def _draw_column(axes: npt.NDArray[Any], profiles: Mapping[float, Table]) -> None:
    strip, above, middle, below = axes
    contact = next(iter(profiles.values()))
    rows = {"contact": (contact, "contact")} | {f"eps = {e:.4g}": (table, "band") for e, table in profiles.items()}
    for row, (table, model) in enumerate(rows.values()):
        _draw_strip(strip, -row, table, model)
    strip.set_yticks(-np.arange(len(rows)), list(rows))
    strip.tick_params(left=False)
    for side in ("top", "right", "left", "bottom"):
        strip.spines[side].set_visible(False)
    for part, name in ((above, "p"), (middle, "t_T")):
        for (e, table), colour in zip(profiles.items(), plotting.COLOURS, strict=False):
            part.plot(table["x"], table[f"{name}_band"], color=colour, linewidth=1.2, label=f"band, eps = {e:.4g}")
        part.plot(contact["x"], contact[f"{name}_contact"], "--", **CONTACT)
        part.grid(color="0.9")
    for (_, table), colour in zip(profiles.items(), plotting.COLOURS, strict=False):
        below.plot(table["x"], table["t_T_band"] - contact["t_T_contact"], color=colour, linewidth=1.2)
    below.grid(color="0.9")
    below.set(xlabel="x along S", xlim=(contact["x"][0], contact["x"][-1]))


def _draw_strip(axes: Axes, row: int, table: Table, model: str) -> None:
    """The status around each node, as a row of colours."""
    x = table["x"]
    edges = np.concatenate([x[:1], (x[1:] + x[:-1]) / 2, x[-1:]])
    colours = [STATUS[str(one[f"status_{model}"])] for one in table.rows]
    axes.barh(np.full(len(x), row), np.diff(edges), left=edges[:-1], height=0.8, color=colours, linewidth=0)
