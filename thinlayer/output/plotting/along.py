"""Pictures of fields on S as curves over arc length."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from forms.base import require
from thinlayer.discretisation.state import State
from thinlayer.output.contact_fields import PINNED_STATUS, Contact
from thinlayer.output.plotting.curves import LINE_STYLES, colours_by_label, set_symlog
from thinlayer.output.plotting.picture import AxesInput, Picture, entry_by_label, finish_picture, make_panels
from thinlayer.output.surface import Surface
from thinlayer.surface.lines import Line, Plane

FieldOrResults = npt.ArrayLike | Mapping[str, npt.ArrayLike] | State | Contact  # a field, cases of it, or results
COMPONENT_STYLES = ("-", "--", ":")  # line styles of the normal component and of the tangential components
PANEL_INCHES = (5.2, 2.5)  # width and height of a panel, inches; the first is shared by all seams
LOW_PANEL_INCHES = 1.7  # height of a panel in pictures with three or more rows, inches


def along(
    surface: Surface,
    fields: Mapping[str, FieldOrResults] | State | Contact,
    *,
    plane: Plane | None = None,
    save: str | Path | None = None,
    length: str = "",
    stress: str = "",
    unit: str = "",
    log: bool = False,
    ax: AxesInput = None,
) -> Picture | None:
    """Draw fields on S as curves over arc length. Collective; all ranks have the picture.

    The picture has a row of panels for each field, and a column for each seam. If a seam has several separate lines,
    they follow one another in a panel.

    Args:
        surface: S, or a seam.
        fields: what is drawn, in one of three forms.
            1. Fields: label of a row -> field, for one curve; or label of a row -> {label of a curve: field}. A field
            consists of numbers, or of vectors with components along S and along n (see `Surface.frame`).
            2. States: label of a curve -> state, or only a state. Traction, or the flux of a scalar field, and jump are
            drawn.
            3. Results of `Surface.contact`: label of a curve -> result, or only a result. p, t_T, u_T and the opening
            are drawn.
        plane: (point, normal) of a plane that cuts a 3D structure; fields are drawn along the line in which it cuts S.
            None in 2D.
        save: name of a file to save the picture to, .png, .svg or .pdf; None: it is not saved.
        length, stress: names of the units of lengths, and of stresses or fluxes, for the labels.
        unit: name of the unit of a scalar field, for its jumps.
        log: whether the vertical axes are logarithmic on both sides of zero.
        ax: matplotlib's axes to draw in, one for each panel; the legend is in the first. None: a new picture is made.

    Returns:
        The new picture; None if `ax` is given.

    Raises:
        InputError: not a surface, state or field; a plane that does not cut S, or none in 3D.
        OSError: the picture could not be written.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, Surface, ThinLayer, plotting, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> surface = Surface(state.model)
        >>> picture = plotting.along(surface, state, length="mm", stress="MPa")
        >>> [axes.get_ylabel() for axes in picture.axes]
        ['t_N (MPa)', 't_T (MPa)', 'w_N (mm)', 'w_T (mm)']
    """
    require(isinstance(surface, Surface), "along: surface", surface, "give Surface(state.model)")
    unit_texts = [f" ({name})" if name else "" for name in (stress, length, unit)]
    drawn = _fields_by_row(surface, fields, *unit_texts)
    rows = {label: {case: surface.along(f, plane=plane) for case, f in cases.items()} for label, cases in drawn.items()}
    seams, height = list(dict.fromkeys(surface.seams.tolist())), PANEL_INCHES[1] if len(rows) < 3 else LOW_PANEL_INCHES
    inches, shape = (PANEL_INCHES[0] + 2.2 * (len(seams) - 1), len(rows) * height + 0.8), (len(rows), len(seams))
    colours = colours_by_label(list(dict.fromkeys(case for row in rows.values() for case in row)))
    panels = make_panels(ax, shape, len(rows) * len(seams), inches, sharex="col", sharey="row")
    axes_rows = np.reshape(np.asarray(panels, object), shape)
    for (label, row), row_axes in zip(rows.items(), axes_rows, strict=True):
        values = np.concatenate([line.values.ravel() for lines in row.values() for line in lines])
        for axes, seam in zip(row_axes, seams, strict=True):
            _draw_panel(axes, {case: [line for line in row[case] if line.seam == seam] for case in row}, colours)
            if log:
                set_symlog(axes, np.nanmin(values), np.nanmax(values))
        row_axes[0].set_ylabel(label)
    for axes, seam in zip(axes_rows[0], seams, strict=True):
        axes.set_title(seam if len(seams) > 1 else "", fontsize=11)
    for axes in axes_rows[-1]:
        axes.set_xlabel(f"arc length{f' ({length})' if length else ''}")
    panels[0].figure.align_ylabels(panels)
    handles = _legend_handles(rows.values(), colours, surface.joint.dim)
    return finish_picture(panels, save, "", handles, min(len(handles), 5))


def _fields_by_row(
    surface: Surface, fields: Any, stress: str, length: str, value: str
) -> dict[str, Mapping[str, npt.ArrayLike]]:
    """Return label of a row -> {label of a curve: field}, from the argument `fields` of `along` in any of its forms.

    Pressures and tangential tractions are NaN at pinned nodes, where supports exert the force.

    Args:
        surface: the surface.
        fields: the argument of `along`.
        stress, length, value: texts that follow the names of stresses or fluxes, of lengths, and of values of a scalar
            field, such as " (MPa)", " (mm)" and " (K)".
    """
    cases = entry_by_label("along", "fields", fields, object, "give a field, or label -> field")
    if not all(isinstance(case, (State, Contact)) for case in cases.values()):
        return {label: case if isinstance(case, Mapping) else {"": case} for label, case in cases.items()}
    rows: dict[str, dict[str, npt.ArrayLike]] = {}
    for label, case in cases.items():
        if isinstance(case, State) and case.model.n_components == 1:
            case_fields = {f"flux{stress}": surface.flux(case), f"jump{value}": surface.jump(case)[0]}
        elif isinstance(case, State):
            t, w = (surface.frame(f(case)) for f in (surface.traction, surface.jump))
            subscripts = ("N", "T") if len(t) == 2 else ("N", "1", "2")
            case_fields = {f"t_{k}{stress}": f for k, f in zip(subscripts, np.roll(t, 1, axis=0), strict=True)}
            case_fields |= {f"w_{k}{length}": f for k, f in zip(subscripts, np.roll(w, 1, axis=0), strict=True)}
        else:
            nan_if_pinned = np.where(case.status == PINNED_STATUS, np.nan, 1.0)
            t_T, u_T = (v[:, 0] if v.shape[1] == 1 else np.linalg.norm(v, axis=1) for v in (case.t_T, case.u_T))
            case_fields = {f"p{stress}": nan_if_pinned * case.p, f"t_T{stress}": nan_if_pinned * t_T}
            case_fields |= {f"u_T{length}": u_T, f"opening{length}": -case.u_N}
        for name, f in case_fields.items():
            rows.setdefault(name, {})[label] = f
    return {**rows}


def _draw_panel(axes: Axes, curves: Mapping[str, list[Line]], colours: Mapping[str, str]) -> None:
    """Draw one panel with several curves, the values of fields along lines on S.

    Args:
        axes: the panel.
        curves: label of a curve -> its lines, which follow one another on the horizontal axis, with grey lines between.
        colours: label -> colour.
    """
    for number, (case, lines) in enumerate(curves.items()):
        line_start = 0.0
        for line in lines:
            if line_start and not number:
                axes.axvline(line_start, color="0.7", linewidth=0.8)
            components = np.roll(np.atleast_2d(line.values.T), 1, axis=0)  # the normal component was last
            styles = COMPONENT_STYLES if len(components) > 1 else (LINE_STYLES[number % len(LINE_STYLES)],)
            for style, component in zip(styles, components, strict=False):
                axes.plot(line_start + line.s, component, linestyle=style, color=colours[case])
            line_start += line.length
    axes.grid(color="0.9")


def _legend_handles(rows: Collection[Mapping[str, list[Line]]], colours: Mapping[str, str], dim: int) -> list[Line2D]:
    """Return the entries of the legend: line styles of the components of vectors, and colours of the curves.

    Args:
        rows: for each row of panels, label of a curve -> its lines on S.
        colours: label of a curve -> its colour.
        dim: number of dimensions.
    """
    handles = list[Line2D]()
    has_vectors = any(line.values[0].size > 1 for row in rows for lines in row.values() for line in lines)
    if has_vectors:
        components = ["normal", "tangential"] if dim == 2 else ["normal", "tangential 1", "tangential 2"]
        styles = zip(COMPONENT_STYLES, components, strict=False)
        handles += [Line2D([], [], color="0.3", linestyle=style, label=name) for style, name in styles]
    if len(colours) > 1:
        dashes = cycle(("-",) if has_vectors else LINE_STYLES)
        entries = zip(colours.items(), dashes, strict=False)
        handles += [Line2D([], [], color=colour, linestyle=dash, label=case) for (case, colour), dash in entries]
    return handles
