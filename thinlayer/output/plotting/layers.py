"""Pictures of walls and other networks in 2D: bodies as they have moved, layers coloured by what happens in them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import Patch

from forms.base import is_number
from geometry.topology import is_tensor
from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError
from thinlayer.output.grid import at_corners
from thinlayer.output.layer_report import CRUSHED, ELASTIC, NO_LAYER, OPEN, SLIDING, STATUSES, TORN, LayerReport
from thinlayer.output.plotting.picture import Picture, drawn_on_root, require_name

Array = npt.NDArray[np.float64]
STATES = {
    ELASTIC: "#9aa5b1",
    SLIDING: "#f0a202",
    CRUSHED: "#c1121f",
    TORN: "#8f5ea2",
    OPEN: "#2ec4ff",
    NO_LAYER: "#111111",
}
BODY, OUTLINE = "#ece5da", "#6b6256"
LARGEST = 0.05  # largest drawn displacement, over the size of the structure
WIDTH = 3.0  # of the lines of layers, points


def layers(
    states: Mapping[str, State] | State,
    *,
    save: str | Path | None = None,
    scale: float | None = None,
    title: str = "",
) -> Picture | None:
    """Deformed bodies side by side in 2D, the facets of S coloured by their status (`LayerReport`). Collective.

    Open joints without a layer are black; gaps between the bodies have the colour of their layer.

    Args:
        states: label -> state of an interface model without contact, or one state.
        save: PNG file; None: it is not saved.
        scale: factor of the displacements (default: the largest is a twentieth of the structure).
        title: text over the picture.

    Returns:
        The picture on rank 0, None on other ranks.

    Raises:
        ModelError: no state, a state in 3D, errors of `LayerReport`; a scale that is no number. OSError: the picture could
            not be written; on all ranks.
    """
    panels = dict(states) if isinstance(states, Mapping) else {"": states}
    if not panels:
        raise ModelError("layers: there is no state to draw")
    if scale is not None and not (is_number(scale) and math.isfinite(scale)):
        raise ModelError(f"layers: scale is {scale!r}; it must be a finite number, the factor of the displacements")
    require_name(save)
    reports = {label: LayerReport(state) for label, state in panels.items()}
    if any(one.state.model.joint.dim != 2 for one in reports.values()):
        raise ModelError("pictures of layers are for two dimensions; in 3D look at LayerReport(state).table")
    moved = {label: at_corners(state) for label, state in panels.items()}
    comm = next(iter(panels.values())).model.comm

    def draw() -> Picture:
        size = max(float(np.ptp(one.state.model.joint.points, axis=0).max()) for one in reports.values())
        largest = max(float(np.linalg.norm(u, axis=2).max()) for u in moved.values())
        factor = scale if scale is not None else LARGEST * size / largest if largest else 1.0
        first = next(iter(reports.values())).state.model.joint.points
        ratio = float(np.ptp(first[:, 1]) / np.ptp(first[:, 0]))
        figure = Picture(figsize=(5.2 * len(reports), 5.2 * ratio + 1.2), layout="constrained")
        for axes, (label, report) in zip(
            figure.subplots(1, len(reports), squeeze=False)[0], reports.items(), strict=True
        ):
            _draw(axes, report, factor * moved[label])
            axes.set_title(label, fontsize=11)
        seen = [name for name in STATUSES if any(name in one.status for one in reports.values())]
        figure.legend(
            handles=[Patch(color=STATES[name], label=name) for name in seen], loc="outside lower center",
            ncols=len(seen), frameon=False, title=f"layers; drawn displacements x {factor:.3g}",
        )  # fmt: skip
        if title:
            figure.suptitle(title)
        return figure

    return drawn_on_root(comm, draw, save)


def _draw(axes: Axes, report: LayerReport, moved: Array) -> None:
    """One structure, with displacements (cells, corners, 2) that are drawn as they are."""
    joint = report.state.model.joint
    x = joint.points[joint.corners] + moved
    ring = [0, 1, 3, 2] if is_tensor(joint.cell_type) else [0, 1, 2]
    axes.add_collection(PolyCollection([*x[:, ring]], facecolor=BODY, edgecolor=BODY, linewidth=0.3))
    below, above = joint.surface_cells[np.searchsorted(joint.surface_rows, report.rows)].T
    ends = joint.table.vertices[report.rows]
    upper = _at(x, joint.corners, above, ends)
    lower = np.where((below < 0)[:, None, None], joint.points[ends], _at(x, joint.corners, below, ends))
    outer = np.flatnonzero(joint.table.cells[:, 1] < 0)
    rim = _at(x, joint.corners, joint.table.cells[outer, 0], joint.table.vertices[outer])
    axes.add_collection(LineCollection([*rim, *upper, *lower], color=OUTLINE, linewidth=0.8))
    for status in STATUSES:
        here = report.status == status
        if here.any():
            gaps = np.concatenate([lower[here], upper[here][:, ::-1]], axis=1)
            axes.add_collection(PolyCollection([*gaps], facecolor=STATES[status], edgecolor="none"))
            middle = (lower[here] + upper[here]) / 2
            axes.add_collection(LineCollection(middle, color=STATES[status], linewidth=WIDTH, capstyle="butt"))
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_axis_off()


def _at(
    x: Array, corners: npt.NDArray[np.int64], cells: npt.NDArray[np.int64], vertices: npt.NDArray[np.int64]
) -> Array:
    """Places (n, 2, 2) of vertices (n, 2) as corners of cells (n,)."""
    corner = (corners[cells][:, None, :] == vertices[:, :, None]).argmax(axis=2)
    return np.asarray(x[cells[:, None], corner])
