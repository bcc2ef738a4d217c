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
from geometry.joint import Joint
from geometry.topology import IntArray, is_tensor
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError
from thinlayer.output.contact_report import ContactReport
from thinlayer.output.grid import at_corners
from thinlayer.output.layer_report import CRUSHED, ELASTIC, NO_LAYER, OPEN, SLIDING, TORN, LayerReport
from thinlayer.output.plotting.contacts import STATUS
from thinlayer.output.plotting.picture import Picture, drawn_on_root, require_name

Array = npt.NDArray[np.float64]
STATES = {
    "stick": STATUS["stick"],
    ELASTIC: "#9aa5b1",
    SLIDING: STATUS["sliding"],
    CRUSHED: "#c1121f",
    TORN: "#8f5ea2",
    OPEN: "#2ec4ff",
    "separated": "#2ec4ff",
    "pinned": "#6a994e",
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
    """Deformed bodies side by side in 2D, the facets of S coloured by their status. Collective.

    It is that of a `LayerReport`; with a contact law each half of a facet has that of its node (`ContactReport`). Open
    joints without a layer are black; gaps between the bodies have the colour of their layer.

    Args:
        states: label -> state of an interface model, or one state.
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
    for label, one in panels.items():
        if not isinstance(one, State) or not isinstance(one.model, InterfaceModel):
            raise ModelError(f"layers: {label!r} is {one!r:.80}; give states of interface models")
        if one.model.joint.dim != 2:
            raise ModelError("pictures of layers are for two dimensions; in 3D look at LayerReport, or ContactReport")
    found = {label: _statuses(state) for label, state in panels.items()}
    moved = {label: at_corners(state) for label, state in panels.items()}
    comm = next(iter(panels.values())).model.comm

    def draw() -> Picture:
        size = max(float(np.ptp(one.model.joint.points, axis=0).max()) for one in panels.values())
        largest = max(float(np.linalg.norm(u, axis=2).max()) for u in moved.values())
        factor = scale if scale is not None else LARGEST * size / largest if largest else 1.0
        first = next(iter(panels.values())).model.joint.points
        ratio = float(np.ptp(first[:, 1]) / np.ptp(first[:, 0]))
        figure = Picture(figsize=(5.2 * len(panels), 5.2 * ratio + 1.2), layout="constrained")
        for axes, (label, one) in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True):
            _draw(axes, one.model.joint, *found[label], factor * moved[label])
            axes.set_title(label, fontsize=11)
        seen = [name for name in STATES if any(name in status for _, status in found.values())]
        figure.legend(
            handles=[Patch(color=STATES[name], label=name) for name in seen], loc="outside lower center",
            ncols=len(seen), frameon=False, title=f"layers; drawn displacements x {factor:.3g}",
        )  # fmt: skip
        if title:
            figure.suptitle(title)
        return figure

    return drawn_on_root(comm, draw, save)


def _statuses(state: State) -> tuple[IntArray, npt.NDArray[np.str_]]:
    """Rows (n,) in `Joint.surface` of the facets of S, seam after seam, and the statuses (n, 2) of their halves."""
    joint, found = state.model.joint, []
    for name in joint.seams:
        if name not in state.model.contacts:
            found.append(np.repeat(LayerReport(state, name).status[:, None], 2, axis=1))
            continue
        report = ContactReport(state, name)
        nodes = np.where(report.corners < 0, report.corners[:, ::-1], report.corners)  # tips as the other half
        found.append(report.status[nodes])
    rows = np.concatenate([joint.rows_of(name) for name in joint.seams])
    return np.searchsorted(joint.surface_rows, rows), np.concatenate(found)


def _draw(axes: Axes, joint: Joint, rows: IntArray, status: npt.NDArray[np.str_], moved: Array) -> None:
    """One structure, with displacements (cells, corners, 2) that are drawn as they are; others as in `_statuses`."""
    x = joint.points[joint.corners] + moved
    ring = [0, 1, 3, 2] if is_tensor(joint.cell_type) else [0, 1, 2]
    axes.add_collection(PolyCollection([*x[:, ring]], facecolor=BODY, edgecolor=BODY, linewidth=0.3))
    (below, above), ends = joint.surface_cells[rows].T, joint.surface[rows, :2]
    upper = _at(x, joint.corners, above, ends)
    lower = np.where((below < 0)[:, None, None], joint.points[ends], _at(x, joint.corners, below, ends))
    outer = np.flatnonzero(joint.table.cells[:, 1] < 0)
    rim = _at(x, joint.corners, joint.table.cells[outer, 0], joint.table.vertices[outer])
    axes.add_collection(LineCollection([*rim, *upper, *lower], color=OUTLINE, linewidth=0.8))
    lower, upper = (np.stack([side, side.mean(axis=1)[:, None].repeat(2, axis=1)], axis=2) for side in (lower, upper))
    for name, colour in STATES.items():
        here = status == name  # halves, from their corner to the middle
        if here.any():
            gaps = np.concatenate([lower[here], upper[here][:, ::-1]], axis=1)
            axes.add_collection(PolyCollection([*gaps], facecolor=colour, edgecolor="none"))
            middle = (lower[here] + upper[here]) / 2
            axes.add_collection(LineCollection(middle, color=colour, linewidth=WIDTH, capstyle="butt"))
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_axis_off()


def _at(
    x: Array, corners: npt.NDArray[np.int64], cells: npt.NDArray[np.int64], vertices: npt.NDArray[np.int64]
) -> Array:
    """Places (n, 2, 2) of vertices (n, 2) as corners of cells (n,)."""
    corner = (corners[cells][:, None, :] == vertices[:, :, None]).argmax(axis=2)
    return np.asarray(x[cells[:, None], corner])
