"""Pictures of deformed structures, coloured by displacement or by a field on S: by matplotlib in 2D, pyvista in 3D."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize, SymLogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from forms.base import Array, InputError
from thinlayer.discretisation.state import State
from thinlayer.output.paraview.grid import gather_grid
from thinlayer.output.plotting.curves import COLOURS, SYMLOG_RATIO
from thinlayer.output.plotting.picture import AxesInput, Picture, draw_on_root, entry_by_label
from thinlayer.output.plotting.scene import COLOUR_BAR_STYLE, Scene, SurfaceColours, View
from thinlayer.output.surface import Surface

SurfaceField = np.ndarray | Callable[[Surface, State], np.ndarray]
STATUS_COLOURS = {  # statuses that occur together also differ as greys
    "elastic": "#bcc3ca", "stick": "#0072B2", "sliding": "#D55E00", "crushed": "#7b1113", "torn": "#CC79A7",
    "open": "#56B4E9", "separated": "#56B4E9", "pinned": "#009E73", "bonded": "#7f5539",
    "no layer": "#111111", "no contact law": "#c9c9c9",
}  # fmt: skip
NAN_COLOUR = "#c9c9c9"  # colour of NaN
DEFAULT_VIEW = View()
WANTED_STATES = "give states, of a history its last one or history.at(t)"


def deformed(
    states: Mapping[str, State] | State,
    view: View = DEFAULT_VIEW,
    *,
    save: str | Path | None = None,
    title: str = "",
    ax: AxesInput = None,
) -> Picture | None:
    """Draw deformed structures side by side, coloured by displacement. Collective.

    Of a scalar field such as a temperature, undeformed structures are drawn, coloured by its values. Lines are orange
    around meshed layers and blue at both sides of S, so that jumps are visible; a rigid base is grey. 3D structures are
    drawn in parallel projection.

    Args:
        states: label of a structure's panel -> state, or one state.
        view: direction, window, colours and scale of displacements, such as `View(zoom=..., unit="mm")`.
        save: name of a file to save the picture to, .png, .svg or .pdf; None: it is not saved.
        title: text over the picture.
        ax: matplotlib's axes to draw in, one for each state; None: a new picture is made.

    Returns:
        The new picture on rank 0, which gathers the fields; None on other ranks, and if `ax` is given.

    Raises:
        InputError: not a state; `save` is no name of a file; a view with an unknown component, an invalid direction, a
            direction or cut in 2D, or nothing in its window.
        OSError: the picture could not be written; on all ranks.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, plotting, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> view = plotting.View("y", unit="mm")
        >>> picture = plotting.deformed({"glue": state}, view, save="plates.png")
    """
    labelled = entry_by_label("deformed", "states", states, State, WANTED_STATES)
    return _draw_panels(labelled, view, None, Scene.draw_colour_bar, title, save, ax)


field = deformed  # of a scalar field, which deforms nothing


def on_surface(
    states: Mapping[str, State] | State,
    field: SurfaceField,
    view: View = DEFAULT_VIEW,
    *,
    seam: str = "S",
    save: str | Path | None = None,
    quantity: str = "",
    log: bool = False,
    ax: AxesInput = None,
) -> Picture | None:
    """Draw deformed structures side by side, with S coloured by a field. Collective.

    Args:
        states: label of a structure's panel -> state, or one state.
        field: a scalar field on S, the same for all states, or a function that returns the field of a state. The
            arguments of the function are `Surface(state.model, seam)` and the state. Examples are `Surface.status` and
            `lambda surface, state: surface.contact(state).p`. For n facets and m nodes of S, the field may have these
            shapes: (n, q), numbers at q quadrature points of each facet; (n, 1), numbers or words on facets; (m,),
            numbers or words at nodes.
        view: direction, window and scale of displacements; its component and unit are ignored.
        seam: name of a seam; "S": all seams.
        save: name of a file to save the picture to, .png, .svg or .pdf; None: it is not saved.
        quantity: name of the field, for the legend.
        log: whether the scale of colours for numbers is logarithmic on both sides of zero.
        ax: matplotlib's axes to draw in, one for each state; None: a new picture is made.

    Returns:
        The new picture on rank 0; None on other ranks, and if `ax` is given.

    Raises:
        InputError: not a state; no scalar field on S; a view with an invalid direction, a direction or cut in 2D, or
            nothing in its window.
        OSError: the picture could not be written; on all ranks.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, plotting, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> def normal_traction(surface, state):
        ...     return surface.frame(surface.traction(state))[-1]
        >>> picture = plotting.on_surface(state, normal_traction, save="t_N.png")
    """
    labelled = entry_by_label("on_surface", "states", states, State, WANTED_STATES)
    surfaces = {label: Surface(state.model, seam) for label, state in labelled.items()}
    values = {label: field(surfaces[label], state) if callable(field) else field for label, state in labelled.items()}
    words, fields = number_words({label: np.asarray(f) for label, f in values.items()})
    displacements = {label: s.side_values(labelled[label].u, s.model, s.corner_points) for label, s in surfaces.items()}
    corner_values = {label: surfaces[label].at_corners(f) for label, f in fields.items()}
    if wrong_counts := [f.shape[2] for f in corner_values.values() if f.ndim > 2]:
        raise InputError(f"on_surface: the field has {wrong_counts[0]} components; give one of them")
    colours = _make_mappable(words, np.concatenate([f.ravel() for f in corner_values.values()]), log=log)

    def colour_s(scene: Scene, label: str) -> SurfaceColours:
        x = surfaces[label].joint.points[surfaces[label].corners]
        lower, upper = x + scene.displacement_factor * np.moveaxis(displacements[label], 1, -1)
        return SurfaceColours(lower, upper, corner_values[label], colours, smooth=not words)

    def draw_legend(scene: Scene, panels: list[Axes]) -> None:
        text = "; ".join(filter(None, [quantity, scene.factor_text]))
        figure: Any = panels[0].figure
        if not words:
            figure.colorbar(colours, ax=panels, **COLOUR_BAR_STYLE, label=text)
            return
        patches = [Patch(color=word_colour(word, words), label=word) for word in words]
        columns = min(len(patches), 4 * len(labelled))
        figure.legend(handles=patches, loc="outside lower center", ncols=columns, frameon=False, title=text)

    return _draw_panels(labelled, replace(view, component="size"), colour_s, draw_legend, "", save, ax)


ColourS = Callable[[Scene, str], SurfaceColours]
DrawLegend = Callable[[Scene, list[Axes]], None]


def _draw_panels(
    cases: Mapping[str, State], view: View, colour_s: ColourS | None, draw_legend: DrawLegend, title: str,
    save: str | Path | None, ax: AxesInput,
) -> Picture | None:  # fmt: skip
    """Draw states side by side with one legend, on rank 0; other ranks return None. Collective.

    Args:
        cases: label of a panel -> state.
        view: the user's settings of the view.
        colour_s: function of the scene and a panel's label; returns the colours of S. None: S has no colours.
        draw_legend: function of the scene and the axes of all panels; draws the legend.
        title: text over the picture.
        save: name of a file to save the picture to; None: it is not saved.
        ax: the user's axes, one for each state; None: a new picture.
    """
    grids = {label: grid for label, state in cases.items() if (grid := gather_grid(state))}

    def draw() -> Figure:
        scene = Scene.of(list(grids.values()), view)
        panels = scene.panels(len(grids), ax)
        surfaces = {label: colour_s(scene, label) for label in grids} if colour_s else {}
        draw_legend(scene, panels)
        for axes, (label, grid) in zip(panels, grids.items(), strict=True):
            scene.draw(axes, grid, surfaces.get(label))
            axes.set_title(label, fontsize=11)
        figure: Any = panels[0].figure
        if title:
            figure.suptitle(title, fontsize=11)
        if isinstance(figure, Picture) and next(iter(grids.values())).dim == 3:
            from thinlayer.output.plotting.solid_shape import interactive_plotter

            figure.make_plotter = lambda: interactive_plotter(scene, grids, surfaces)
        return figure

    return draw_on_root(next(iter(cases.values())).model.comm, draw, save)


def number_words(fields: Mapping[str, np.ndarray]) -> tuple[list[str], dict[str, np.ndarray]]:
    """Replace words in fields on S, such as statuses, by numbers.

    Args:
        fields: label -> field of words, or of numbers, for each of several structures.

    Returns:
        The list of all different words, and label -> field of positions in this list. Fields of numbers are returned
        unchanged, with an empty list.

    Raises:
        InputError: words that are neither on facets, (n, 1), nor at nodes, (m,).
    """
    if not any(f.dtype.kind == "U" for f in fields.values()):
        return [], dict(fields)
    if wrong_shapes := [f.shape for f in fields.values() if f.ndim > 1 and f.shape[-1] != 1]:
        raise InputError(f"words on S are those of facets, (n, 1), or nodes, (m,), not {wrong_shapes[0]}")
    unique_words = {*np.concatenate([f.ravel() for f in fields.values()]).tolist()}
    words = [*(word for word in STATUS_COLOURS if word in unique_words), *sorted(unique_words - {*STATUS_COLOURS})]
    return words, {label: np.vectorize(words.index, otypes=[int])(f) for label, f in fields.items()}


def word_colour(word: str, words: list[str]) -> str:
    """Return the colour of a word in a field: a status has its own, any other word that of its position in `words`.

    Args:
        word: the word.
        words: all words of the picture.
    """
    return STATUS_COLOURS.get(word) or COLOURS[words.index(word) % len(COLOURS)]


def _make_mappable(words: list[str], values: Array, *, log: bool) -> ScalarMappable:
    """Make matplotlib's map from the values of a field on S to colours.

    Args:
        words: list of the words of the field, whose values are then positions in this list; empty for a field of
            numbers.
        values: all values in the picture. The range of colours for numbers extends over them and zero.
        log: whether colours of numbers have a scale that is logarithmic on both sides of zero.
    """
    if words:
        colours = ListedColormap([word_colour(word, words) for word in words])
        return ScalarMappable(Normalize(-0.5, len(words) - 0.5), colours)
    finite = values[np.isfinite(values)]
    low, high = float(finite.min(initial=0.0)), float(finite.max(initial=0.0))
    peak = max(-low, high) or 1.0
    signed = low < 0 < high
    linthresh, low, high = (10.0 ** np.ceil(np.log10(SYMLOG_RATIO * peak)), *((-peak, peak) if signed else (low, high)))
    norm = SymLogNorm(linthresh, vmin=low, vmax=high) if log else Normalize(low, high)
    mappable = ScalarMappable(norm, "RdBu_r" if signed else "viridis")
    mappable.get_cmap().set_bad(NAN_COLOUR)
    return mappable
