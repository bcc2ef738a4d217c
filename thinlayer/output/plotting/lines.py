"""Pictures of tractions and jumps along S, by arc length."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.output.plotting.picture import Picture, finish
from thinlayer.output.surface import Surface
from thinlayer.surface.lines import Line, Plane

STYLES = ("-", "--", ":")  # of the normal component and of the tangential ones
PANEL = (5.2, 2.5)  # width and height of a panel, inches; the first is shared by all seams


def along(
    surface: Surface,
    states: Mapping[str, State] | State,
    *,
    plane: Plane | None = None,
    save: str | Path | None = None,
    title: str = "",
    length: str = "",
    stress: str = "",
) -> Picture:
    """Traction and jump in the frame of S against arc length: a column for each seam, its lines one after the other.

    Collective; all ranks have the picture.

    Args:
        surface: S, or a seam.
        states: label -> state of either model of the surface's joint, or one state.
        plane: in 3D a point and the normal of the plane that cuts S (`Surface.along`).
        save: PNG file; None: it is not saved.
        title: text over the picture.
        length, stress: units, for the labels.

    Raises:
        ModelError: no surface, no state; errors of `Surface.along`. OSError: the picture could not be written.
    """
    if not isinstance(surface, Surface):
        raise ModelError(f"along: surface is {surface!r:.80}; give Surface(limit.model)")
    cases = dict(states) if isinstance(states, Mapping) else {"": states}
    if not cases:
        raise ModelError("along: there is no state to draw")
    in_frame = {
        label: [surface.along(surface.frame(f), plane=plane) for f in (surface.traction(state), surface.jump(state))]
        for label, state in cases.items()
    }
    first = next(iter(in_frame.values()))[0]
    seams = list(dict.fromkeys(line.seam for line in first))
    d = first[0].x.shape[1]
    figure = Picture(figsize=(PANEL[0] + 2.2 * (len(seams) - 1), 2 * PANEL[1] + 0.8), layout="constrained")
    rows = figure.subplots(2, len(seams), sharex="col", sharey="row", squeeze=False)
    for row, (letter, unit) in enumerate((("t", stress), ("w", length))):
        for axes, seam in zip(rows[row], seams, strict=True):
            for number, of_case in enumerate(in_frame.values()):
                _draw(axes, [line for line in of_case[row] if line.seam == seam], COLOURS[number % len(COLOURS)])
            axes.grid(color="0.9")
        rows[row, 0].set_ylabel(f"{letter}_N, {letter}_T{f' ({unit})' if unit else ''}")
    for axes, seam in zip(rows[0], seams, strict=True):
        axes.set_title(seam if len(seams) > 1 else "", fontsize=11)
    for axes in rows[1]:
        axes.set_xlabel(f"arc length{f' ({length})' if length else ''}")
    names = ["normal", "tangential"] if d == 2 else ["normal", "tangential 1", "tangential 2"]
    handles = [Line2D([], [], color="0.3", linestyle=STYLES[k], label=name) for k, name in enumerate(names)]
    if len(cases) > 1:
        handles += [Line2D([], [], color=COLOURS[k % len(COLOURS)], label=label) for k, label in enumerate(cases)]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
    if title:
        figure.suptitle(title)
    return finish(figure, save)


def _draw(axes: Axes, lines: list[Line], colour: str) -> None:
    """Components of lines, one line after the other."""
    start = 0.0
    for number, line in enumerate(lines):
        if number:
            axes.axvline(start, color="0.7", linewidth=0.8)
        for k, component in enumerate(np.roll(line.values.T, 1, axis=0)):  # the normal one is the last
            axes.plot(start + line.s, component, STYLES[k], color=colour)
        start += line.length
