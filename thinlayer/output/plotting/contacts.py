"""Pictures of contact: status of the nodes of S, tractions and displacements there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from thinlayer.discretisation.contact_nodes import Array
from thinlayer.errors import ModelError
from thinlayer.output.contact_report import PINNED, ContactReport
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.output.plotting.picture import Picture, finish

GAP = 0.04  # way between parts of S that do not touch, over the length of S
MOST_NAMED = 12  # number of parts of S that do not touch, up to which they are named
STATUS = {"separated": "#d7d7d7", "sliding": "#f0a202", "stick": "#1b6ca8", "pinned": "#222222"}
FLAT = 1e-6  # sine of the largest angle between normals of an S that counts as planar
NAMED = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.8}  # behind the names of parts of S
ARROWS = 18  # number of arrows along each side of a map


def contact(
    reports: Mapping[str, ContactReport] | ContactReport,
    *,
    save: str | Path | None = None,
    title: str = "",
    length: str = "",
    stress: str = "",
) -> Picture:
    """Contact along S: in 2D a status strip, tractions and displacements; in 3D maps of status and tractions.

    Args:
        reports: label -> report, or one report (of several seams, with the name of its seam); all in 2D or all in 3D.
        save: PNG file.
        title: text over the picture.
        length, stress: units, for the labels.

    Raises:
        ModelError: no report, reports of both dimensions, a curved S in 3D.
    """
    cases = {reports.label: reports} if isinstance(reports, ContactReport) else reports
    if not isinstance(cases, Mapping) or not all(isinstance(report, ContactReport) for report in cases.values()):
        raise ModelError("contact pictures take a ContactReport, or {label: ContactReport}")
    dimensions = {report.x.shape[1] for report in cases.values()}
    if len(dimensions) != 1:
        raise ModelError("contact pictures need one report or more, all of one dimension")
    units = [f" ({unit})" if unit else "" for unit in (length, stress)]
    figure = (_curves if dimensions == {2} else _maps)(cases, *units)
    if title:
        figure.suptitle(title)
    return finish(figure, save)


def _curves(cases: Mapping[str, ContactReport], length: str, stress: str) -> Picture:
    strip = 0.32 * len(cases)
    heights = [strip, 2.4, 2.4, 1.8]
    figure = Picture(figsize=(6.8, sum(heights) + 1.4), layout="constrained")
    axes: Sequence[Axes] = figure.subplots(4, 1, sharex=True, gridspec_kw={"height_ratios": heights})
    for row, (name, report) in enumerate(cases.items()):
        ways, starts = _ways(report)
        for left, right, status in _cells(report, ways):
            axes[0].barh(-row, right - left, left=left, height=0.8, color=STATUS[status], linewidth=0)
        for k in starts if 1 < len(starts) <= MOST_NAMED else []:
            x, y = report.x[k]
            axes[0].text(ways[k], -row, f" from ({x:.3g}, {y:.3g})", fontsize=7, va="center", bbox=NAMED)
        colour = COLOURS[row % len(COLOURS)]
        known = np.where(report.status == PINNED, np.nan, 1.0)  # the force there is the support's
        for k, piece in enumerate(report.pieces):
            s, style = ways[piece], dict[str, Any](color=colour, label="" if k else name)
            axes[1].plot(s, (known * report.p)[piece], **style)
            axes[1].plot(s, (known * report.t_T[:, 0])[piece], "--", **style)
            axes[2].plot(s, report.u_T[piece, 0], **style)
            axes[3].plot(s, -report.u_N[piece], **style)
    axes[0].set_yticks(-np.arange(len(cases)), list(cases))
    axes[0].tick_params(left=False)
    axes[0].set_xlim(0, max(float(_ways(report)[0][-1]) for report in cases.values()))
    for side in ("top", "right", "left", "bottom"):
        axes[0].spines[side].set_visible(False)
    seen = {str(s) for report in cases.values() for s in report.status}
    patches = [Patch(color=colour, label=name) for name, colour in STATUS.items() if name in seen]
    axes[0].legend(handles=patches, loc="lower left", bbox_to_anchor=(0, 1.02), ncols=4, frameon=False)
    axes[1].set_ylabel(f"tractions{stress}")
    styles = [Line2D([], [], color="0.3", linestyle=s, label=t) for s, t in (("-", "pressure"), ("--", "tangential"))]
    axes[1].legend(handles=styles, frameon=False)
    axes[2].set_ylabel(f"u_T{length}")
    axes[3].set(xlabel=f"way along S{length}", ylabel=f"opening{length}")
    if len(cases) > 1:
        axes[2].legend(frameon=False)
    for one in axes[1:]:
        one.grid(color="0.9")
    figure.align_ylabels(axes[1:])
    return figure


def _ways(report: ContactReport) -> tuple[Array, list[int]]:
    """(n,) way along S to each node, with short gaps between parts that do not touch; the first nodes of these."""
    steps = np.diff(report.along)
    last = [int(piece[-1]) for piece in report.pieces[:-1]]
    length = steps.sum() - steps[last].sum()
    parted = [k for k in last if steps[k] > FLAT * length]
    steps[parted] = GAP * length
    return np.concatenate([[0.0], np.cumsum(steps)]), [0, *(k + 1 for k in parted)]


def _cells(report: ContactReport, ways: Array) -> list[tuple[float, float, str]]:
    """Start, end and status of the part of S around each node."""
    cells = []
    for piece in report.pieces:
        s = ways[piece]
        edges = np.concatenate([s[:1], (s[1:] + s[:-1]) / 2, s[-1:]])
        cells += [(float(edges[k]), float(edges[k + 1]), str(report.status[node])) for k, node in enumerate(piece)]
    return cells


def _maps(cases: Mapping[str, ContactReport], length: str, stress: str) -> Picture:
    plans = {name: _Plan(report) for name, report in cases.items()}
    first = next(iter(plans.values()))
    ratio = np.ptp(first.x[:, 1]) / np.ptp(first.x[:, 0])
    height = min(max(4.2 * ratio, 1.6), 9.0) * len(cases) + 1.4
    figure = Picture(figsize=(9.6, height), layout="constrained")
    axes = figure.subplots(len(cases), 2, squeeze=False)
    seen = {str(s) for report in cases.values() for s in report.status}
    for (left, right), (name, report) in zip(axes, cases.items(), strict=True):
        plan = plans[name]
        plan.draw(left, [to_rgba(STATUS[str(status)]) for status in report.status])
        left.set_title(f"{name}: status" if name else "status", fontsize=11)
        colours = ScalarMappable(Normalize(0.0, max(float(report.p.max()), 1e-300)), "viridis")
        pressures = np.asarray(colours.to_rgba(report.p))
        pressures[report.status == PINNED] = to_rgba(STATUS[PINNED])
        plan.draw(right, pressures.tolist())
        plan.arrows(right, report)
        right.set_title("pressure, arrows: friction on the lower side", fontsize=11)
        figure.colorbar(colours, ax=right, label=f"p{stress}")
        for one in (left, right):
            one.set(xlabel=f"{plan.names[0]}{length}", ylabel=f"{plan.names[1]}{length}")
    patches = [Patch(color=colour, label=name) for name, colour in STATUS.items() if name in seen]
    figure.legend(handles=patches, loc="outside lower center", ncols=4, frameon=False)
    return figure


class _Plan:
    """A planar S seen along its normal: places of its nodes, and the part of S around each."""

    def __init__(self, report: ContactReport) -> None:
        if np.abs(report.frames[:, -1] @ report.frames[0, :-1].T).max() > FLAT:
            raise ModelError("maps of contact in three dimensions are for a planar S")
        if np.ptp(report.x @ report.frames[0, -1]) > FLAT * np.ptp(report.x, axis=0).max():
            raise ModelError(
                f"maps of contact in three dimensions are for one plane, and {report.seam!r} lies in several; give each a "
                "seam of its own"
            )
        axes = report.frames[0, :-1]
        self.x = report.x @ axes.T
        along = [np.flatnonzero(np.abs(axis - 1) < FLAT) for axis in axes]
        self.names = ["xyz"[k[0]] if len(k) else f"tangent {i + 1}" for i, k in enumerate(along)]
        corners = [0, 1, 2] if report.facets.shape[1] == 3 else [0, 1, 3, 2]
        ring = report.facets[:, corners]
        xs = self.x[ring]
        centre = xs.mean(axis=1)
        pieces, owners = [], []
        for k in range(len(corners)):
            before, after = (xs[:, k - 1] + xs[:, k]) / 2, (xs[:, k] + xs[:, (k + 1) % len(corners)]) / 2
            pieces.append(np.stack([xs[:, k], after, centre, before], axis=1))
            owners.append(ring[:, k])
        self.pieces, self.owners = np.concatenate(pieces), np.concatenate(owners)

    def draw(self, axes: Axes, colours: Sequence[Any]) -> None:
        """The part of S around each node in the node's colour."""
        table = np.array(colours)[self.owners]
        axes.add_collection(PolyCollection(list(self.pieces), facecolors=table, edgecolors=table, linewidths=0.3))
        low, high = self.x.min(axis=0), self.x.max(axis=0)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")

    def arrows(self, axes: Axes, report: ContactReport) -> None:
        """Draw tangential tractions as arrows, at no more nodes than can be distinguished in the picture."""
        axis = report.frames[0, :-1]
        t: Array = np.einsum("nk,nkj->nj", report.t_T, report.frames[:, :-1]) @ axis.T
        span = np.ptp(self.x, axis=0).max() / ARROWS
        cells = np.floor((self.x - self.x.min(axis=0)) / span).astype(int)
        _, shown = np.unique(cells, axis=0, return_index=True)
        largest = np.linalg.norm(t, axis=1).max()
        if largest > 0:
            axes.quiver(
                *self.x[shown].T,
                *t[shown].T,
                color="white",
                edgecolor="black",
                linewidth=0.4,
                angles="xy",
                scale_units="xy",
                scale=largest / (1.6 * span),
            )
