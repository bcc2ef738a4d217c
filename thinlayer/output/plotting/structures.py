"""Deformed structures, drawn by pyvista off screen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError
from thinlayer.output.grid import gather
from thinlayer.output.plotting.picture import Picture, drawn_on_root, require_name
from thinlayer.output.plotting.scene import Look, Scene


def deformed(
    states: Mapping[str, State] | State,
    *,
    save: str | Path | None = None,
    component: str = "size",
    scale: float | None = None,
    title: str = "",
    unit: str = "",
    zoom: Sequence[float] | None = None,
    view: Sequence[float] | None = None,
    cut: bool = False,
) -> Picture | None:
    """Deformed structures side by side, coloured by displacement, with the layer (or the jump across S) visible.

    The meshed layer has red outlines, a rigid base is grey. Three-dimensional structures are seen in parallel projection.

    Args:
        states: label -> state, or one state. Collective.
        save: PNG file; None: it is not saved.
        component: "size", "x", "y" or "z".
        scale: factor of the displacements (default: the largest is a twentieth of the structure).
        title, unit: text over the picture; unit of the displacements, for the colour bar.
        zoom: (left, right, bottom, top) part to show, in deformed coordinates: in 2D (x_min, x_max, y_min, y_max), in 3D
            lengths to the right and up on the picture, from where the origin is.
        view: in 3D the direction from the structure to the viewer, (3,) (default: the viewer stands in front, z > 0, to
            the right and above). y points up on the picture; from right above, -z does.
        cut: in 3D whether to leave out the half in front of the middle in z, to see S inside.

    Returns:
        The picture on rank 0, which has the fields; None on other ranks.

    Raises:
        ModelError: what is no state, a scale or a window that is no number, no name of a file.
        OSError: the picture could not be written; on all ranks.
        ModelError: unknown component, no direction, view or cut in 2D, nothing in the window.
    """
    panels = dict(states) if isinstance(states, Mapping) else {"": states}
    if not panels:
        raise ModelError("deformed: there is no state to draw")
    for label, one in panels.items():
        if not isinstance(one, State):
            what = f"{label!r} is {one!r}" if label else f"states is {one!r}"
            raise ModelError(f"deformed: {what}; give states, of a history its last one or history.at(t)")
    look = Look(component, scale, unit, zoom, view, cut)
    require_name(save)
    grids = {label: gather(state) for label, state in panels.items()}

    def draw() -> Picture:
        scene = Scene.of(list(grids.values()), look)
        figure, places = scene.panels(len(grids))
        scene.bar(figure, places)
        for axes, (label, grid) in zip(places, grids.items(), strict=True):
            axes.imshow(scene.image(grid), extent=scene.window)
            axes.set_title(label, fontsize=11)
        if title:
            figure.suptitle(title)
        return figure

    return drawn_on_root(next(iter(panels.values())).model.comm, draw, save)
