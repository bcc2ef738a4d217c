"""Pictures of deformed structures, coloured by displacement or by a field on S, drawn by pyvista off screen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyvista
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize, SymLogNorm
from matplotlib.patches import Patch

from forms.base import Array, InputError
from thinlayer.discretisation.state import State
from thinlayer.output.paraview.grid import gather_grid
from thinlayer.output.plotting.curves import COLOURS, SYMLOG_RATIO
from thinlayer.output.plotting.picture import Picture, draw_on_root, entry_by_label
from thinlayer.output.plotting.scene import COLOUR_BAR_STYLE, Scene, View
from thinlayer.output.surface import Surface

SurfaceField = np.ndarray | Callable[[Surface, State], np.ndarray]
STATUS_COLOURS = {  # statuses that occur together also differ as greys
    "elastic": "#bcc3ca", "stick": "#0072B2", "sliding": "#D55E00", "crushed": "#7b1113", "torn": "#CC79A7",
    "open": "#56B4E9", "separated": "#56B4E9", "pinned": "#009E73", "bonded": "#7f5539",
    "no layer": "#111111", "no contact law": "#c9c9c9",
}  # fmt: skip
NAN_COLOUR = "#c9c9c9"  # colour of NaN
DEFAULT_VIEW = View()


def deformed(
    states: Mapping[str, State] | State, view: View = DEFAULT_VIEW, *, save: str | Path | None = None, title: str = ""
) -> Picture | None:
    """Draw deformed structures side by side, coloured by displacement. Collective.

    A meshed layer and the two sides of S have red outlines, so that jumps are visible; a rigid base is grey. 3D
    structures are drawn in parallel projection.

    Args:
        states: label of a structure's panel -> state, or one state.
        view: direction, window, colours and scale of displacements, such as `View(zoom=..., unit="mm")`.
        save: name of a file to save the picture to, .png, .svg or .pdf; None: it is not saved.
        title: text over the picture.

    Returns:
        The picture on rank 0, which gathers the fields; None on other ranks.

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
    labelled = _state_by_label(states, "deformed")
    return _draw_panels(labelled, view, lambda *_: None, Scene.draw_colour_bar, title, save)


def on_surface(
    states: Mapping[str, State] | State,
    field: SurfaceField,
    view: View = DEFAULT_VIEW,
    *,
    seam: str = "S",
    save: str | Path | None = None,
    title: str = "",
    quantity: str = "",
    log: bool = False,
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
        title: text over the picture.
        quantity: name of the field, for the legend.
        log: whether the scale of colours for numbers is logarithmic on both sides of zero.

    Returns:
        The picture on rank 0; None on other ranks.

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
    labelled = _state_by_label(states, "on_surface")
    surfaces = {label: Surface(state.model, seam) for label, state in labelled.items()}
    values = {label: field(surfaces[label], state) if callable(field) else field for label, state in labelled.items()}
    words, fields = number_words({label: np.asarray(f) for label, f in values.items()})
    displacements = {label: s.side_values(labelled[label].u, s.model, s.corner_points) for label, s in surfaces.items()}
    corner_values = {label: surfaces[label].at_corners(f) for label, f in fields.items()}
    if wrong_counts := [f.shape[2] for f in corner_values.values() if f.ndim > 2]:
        raise InputError(f"on_surface: the field has {wrong_counts[0]} components; give one of them")
    colours = _make_mappable(words, np.concatenate([f.ravel() for f in corner_values.values()]), log=log)

    def mesh_s(scene: Scene, label: str) -> list[pyvista.PolyData]:
        x = surfaces[label].joint.points[surfaces[label].corners]
        lower, upper = x + scene.displacement_factor * np.moveaxis(displacements[label], 1, -1)
        return _mesh_s(colours, corner_values[label], lower, upper, smooth=not words)

    def draw_legend(scene: Scene, figure: Picture, axes: list[Axes]) -> None:
        text = "; ".join(filter(None, [quantity, scene.factor_text]))
        if not words:
            figure.colorbar(colours, ax=axes, **COLOUR_BAR_STYLE, label=text)
            return
        patches = [Patch(color=word_colour(word, words), label=word) for word in words]
        columns = min(len(patches), 4 * len(labelled))
        figure.legend(handles=patches, loc="outside lower center", ncols=columns, frameon=False, title=text)

    return _draw_panels(labelled, replace(view, component="size"), mesh_s, draw_legend, title, save)


def _state_by_label(states: Mapping[str, State] | State, function_name: str) -> dict[str, State]:
    """Convert the user's states to a mapping, label -> state; a single state gets the label "".

    Args:
        states: the mapping or the state.
        function_name: name of the function that the user has called, for messages.

    Raises:
        InputError: an entry is not a state, or the mapping is empty.
    """
    panels = entry_by_label(f"{function_name}: states", states, "state")
    for label, state in panels.items():
        if not isinstance(state, State):
            received = f"{label!r} is {state!r}" if label else f"states is {state!r}"
            raise InputError(f"{function_name}: {received}; give states, of a history its last one or history.at(t)")
    return panels


MeshS = Callable[[Scene, str], list[pyvista.PolyData] | None]
DrawLegend = Callable[[Scene, Picture, list[Axes]], None]


def _draw_panels(
    cases: Mapping[str, State], view: View, mesh_s: MeshS, draw_legend: DrawLegend, title: str, save: str | Path | None
) -> Picture | None:
    """Draw images of states side by side with one legend, on rank 0; other ranks return None. Collective.

    Args:
        cases: label of a panel -> state.
        view: the user's settings of the view.
        mesh_s: function of the scene and a panel's label; returns meshes of S that are drawn in addition, or None.
        draw_legend: function of the scene, the picture and the axes of all panels; draws the legend.
        title: text over the picture.
        save: name of a file to save the picture to; None: it is not saved.
    """
    grids = {label: grid for label, state in cases.items() if (grid := gather_grid(state))}

    def make_plotter(scene: Scene) -> pyvista.Plotter:
        plotter = pyvista.Plotter(shape=(1, len(grids)), lighting="none")
        for k, (label, grid) in enumerate(grids.items()):
            plotter.subplot(0, k)
            scene.add_to(plotter, grid, mesh_s(scene, label))
            plotter.add_text(label, font_size=10)
        plotter.link_views()
        return plotter

    def draw() -> Picture:
        scene = Scene.of(list(grids.values()), view)
        figure, axes_list = scene.make_panels(len(grids))
        draw_legend(scene, figure, axes_list)
        figure.make_plotter = lambda: make_plotter(scene)
        for axes, (label, grid) in zip(axes_list, grids.items(), strict=True):
            axes.imshow(scene.render(grid, mesh_s(scene, label)), extent=scene.window)
            axes.set_title(label, fontsize=11)
        if title:
            figure.suptitle(title, fontsize=11)
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
        raise InputError(f"names on S are those of facets, (n, 1), or nodes, (m,), not {wrong_shapes[0]}")
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


def _mesh_s(colours: ScalarMappable, values: Array, lower: Array, upper: Array, smooth: bool) -> list[pyvista.PolyData]:
    """Make meshes of the deformed S, with colours that show a field as point data "rgb".

    Args:
        colours: map from values of the field to colours.
        values: (n, k) values at the k corners of n facets.
        lower, upper: (n, k, d) drawn coordinates of these corners on both sides of S, in d dimensions.
        smooth: True: values are linear between the corners. False: each facet is divided into one part around each
            corner, which has the corner's colour. This is for words.

    Returns:
        In 3D one mesh half-way between the sides. In 2D two meshes: the areas between the sides, and the lines half-way
        between them.
    """
    k, d = lower.shape[1:]
    corner_order = [0, 1, 3, 2] if k == 4 else [*range(k)]
    mid_x, values = ((lower + upper) / 2)[:, corner_order], values[:, corner_order]
    n_points = 2 if k == 2 else 4
    point_values = _interpolate_to_parts(values) if smooth else np.repeat(values[:, :, None], n_points, axis=2)
    flat_rgb = colours.to_rgba(np.ma.masked_invalid(point_values.ravel()))[:, :3]  # (n, k, 4) would count as an image
    rgb = np.asarray(np.rint(255 * flat_rgb), np.uint8).reshape(*point_values.shape, 3)
    if d == 3:
        return [_make_rgb_mesh(_interpolate_to_parts(mid_x), rgb, "faces")]
    lower_points, upper_points = _interpolate_to_parts(lower), _interpolate_to_parts(upper)
    gap_points = np.concatenate([lower_points, upper_points[:, :, ::-1]], axis=2)
    gap_rgb = np.concatenate([rgb, rgb[:, :, ::-1]], axis=2)
    return [_make_rgb_mesh(gap_points, gap_rgb, "faces"), _make_rgb_mesh(_interpolate_to_parts(mid_x), rgb, "lines")]


def _interpolate_to_parts(values: Array) -> Array:
    """Divide facets into one part around each corner, and interpolate values to the p points that bound each part.

    Lines have p = 2 points in each part, the corner and the middle of the line. Other facets have p = 4: the corner,
    the middle of the next edge, the centre of the facet, and the middle of the edge before.

    Args:
        values: (n, k, ...) values at the k corners of n facets, in the order around the facet.

    Returns:
        (n, k, p, ...) values at the p points of each part.
    """
    centre = np.broadcast_to(values.mean(axis=1, keepdims=True), values.shape)
    edge_means = (values + np.roll(values, -1, axis=1)) / 2
    bounds = [values, centre] if values.shape[1] == 2 else [values, edge_means, centre, np.roll(edge_means, 1, axis=1)]
    return np.stack(bounds, axis=2)


def _make_rgb_mesh(x: Array, rgb: npt.NDArray[np.uint8], cell_kind: str) -> pyvista.PolyData:
    """Make a coloured VTK mesh of n * k lines or faces, k on each of n facets of S.

    Args:
        x: (n, k, p, d) coordinates of the p points that bound each line or face, in d dimensions.
        rgb: (n, k, p, 3) colours at these points.
        cell_kind: "lines" or "faces".
    """
    p, d = x.shape[2:]
    points = np.pad(x.reshape(-1, d), ((0, 0), (0, 3 - d)))
    cells = np.insert(np.arange(len(points)).reshape(-1, p), 0, p, axis=1)
    mesh = pyvista.PolyData(points, **{cell_kind: cells.ravel()})
    mesh.point_data["rgb"] = rgb.reshape(-1, 3)
    return mesh
