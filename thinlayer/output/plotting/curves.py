"""Pictures of curves, and of errors over the layer's thickness, drawn by matplotlib."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MultipleLocator

from forms.base import Array, InputError, require
from geometry.refusals import require_known
from thinlayer.output.plotting.picture import AxesInput, Picture, entry_by_label, finish_picture, make_panels, typeset
from thinlayer.output.sweep import needed_columns
from thinlayer.solving.harmonic import HarmonicResponse
from thinlayer.solving.history import History
from thinlayer.system.table import Table

CurvesByLabel = Mapping[str, tuple[npt.ArrayLike, npt.ArrayLike]]  # label -> (x, y)
AxisRange = tuple[float, float] | None
StyleChoice = str | Sequence[str] | Mapping[str, str] | None  # one for all curves, several in turn, or by label
# Styles of curves, in turn: colours for colour-blind readers (Okabe and Ito); line styles and markers for grey prints.
LAW_COLOUR, MESHED_COLOUR = "#0072B2", "#D55E00"  # an interface law and a meshed layer, in all pictures
COLOURS = (LAW_COLOUR, MESHED_COLOUR, "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
Dash = str | tuple[int, tuple[int, ...]]  # matplotlib's line style
LINE_STYLES: tuple[Dash, ...] = ("-", "--", "-.", ":", (0, (8, 2)), (0, (4, 1, 1, 1, 1, 1)), (0, (1, 3)))
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
MAX_SUBTICK_RATIO = 1e4  # ratio of the ends of a logarithmic axis above which it has ticks at powers of ten alone
SYMLOG_RATIO = 1e-3  # smallest visible value, over the largest, on an axis that is logarithmic on both sides of zero
# sizes in a legend, inches: width of a letter, width of the line and the margins of an entry, height of a row
LETTER_INCHES, LINE_INCHES, ROW_INCHES = (0.075, 0.75, 0.21)
ERROR_COLUMNS = {"traction": "error_traction", "jump": "error_jump"}  # label -> column of a sweep's table


def rates(
    table: Table | str | Path | Mapping[str, Table | str | Path],
    *,
    save: str | Path | None = None,
    title: str = "",
    reference: float = 1.0,
    errors: Mapping[str, str] | None = None,
    ax: Axes | None = None,
) -> Picture | None:
    """Draw the errors in the tables of sweeps over the thickness eps, on logarithmic axes, with a reference line.

    Collective if the picture is saved or a file is read, which rank 0 does.

    Args:
        table: table of a sweep, or name of its csv file; for several sweeps, label -> table or name.
        save: name of a file to save the picture to, .png, .svg or .pdf; None: it is not saved.
        title: text over the picture.
        reference: slope of the reference line, the rate of convergence to compare with.
        errors: label of a curve -> column of the tables; None: errors of traction (or flux) and jump.
        ax: matplotlib's axes to draw in; None: a new picture is made.

    Returns:
        The new picture; None if `ax` is given.

    Raises:
        InputError: a table without rows or without these columns.
        OSError: the picture could not be written.

    Example:
        >>> from thinlayer import Table, plotting
        >>> errors = {"error_traction": [0.04, 0.02], "error_jump": [0.03, 0.02]}
        >>> table = Table.of({"eps": [0.2, 0.1]} | errors)
        >>> picture = plotting.rates(table, save="rates.svg")
    """
    tables = entry_by_label("rates", "table", table, (Table, str, Path), "give what sweep returns")
    lines, styles, colours = dict[str, tuple[Array, Array]](), {}, {}
    for j, (case, source) in enumerate(tables.items()):
        data = source if isinstance(source, Table) else Table.load(source)
        columns = errors or {name.removeprefix("error_"): name for name in needed_columns(data.columns)[1:]}
        if lacking := [name for name in ("eps", *columns.values()) if name not in data.columns]:
            subject = f"the table {case!r}" if case else "the table"
            raise InputError(f"rates: {subject} has no row, or no column {', '.join(lacking)}; give what sweep returns")
        for k, (name, column) in enumerate(columns.items()):
            label = f"{case}: {name}" if case else name
            lines[label] = data["eps"], data[column]
            styles[label] = MARKERS[k % len(MARKERS)] + ("--" if k % 2 else "-")
            colours[label] = COLOURS[(j if len(tables) > 1 else k) % len(COLOURS)]  # one colour for each case
    eps, lowest_errors = min(lines.values(), key=lambda line: float(line[1][-1]))
    slope_label = f"slope {reference:g}"
    lines[slope_label] = eps, 0.6 * lowest_errors[-1] * (eps / eps[-1]) ** reference
    figure = curves(
        lines, "layer thickness eps", "relative difference on S, L^2",
        title=title, styles=styles | {slope_label: ":"}, colours=colours, log="xy", ax=ax,
    )  # fmt: skip
    axes: Any = figure.axes[0] if figure and ax is None else ax
    axes.set_xticks(eps, [as_fraction(e) for e in eps])
    low, high = axes.get_ylim()
    axes.yaxis.set_major_locator(
        LogLocator(subs=(1.0, 2.0, 5.0) if high < MAX_SUBTICK_RATIO * low else (1.0,), numticks=16)
    )
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.minorticks_off()
    return finish_picture([axes], save)


def curves(
    lines: CurvesByLabel | Mapping[str, CurvesByLabel],
    xlabel: str,
    ylabel: str | Mapping[str, str] = "",
    *,
    title: str = "",
    save: str | Path | None = None,
    styles: StyleChoice = None,
    colours: StyleChoice = None,
    log: str = "",
    xlim: AxisRange | Mapping[str, AxisRange] = None,
    ylim: AxisRange | Mapping[str, AxisRange] = None,
    columns: int = 3,
    levels: Mapping[str, Sequence[str]] | None = None,
    ax: AxesInput = None,
) -> Picture | None:
    """Draw curves in one panel or in several panels, with one legend below.

    Curves with the same label have the same style and colour in all panels.

    Args:
        lines: curves of one panel, label of a curve -> (x, y), two arrays of the same length. For several panels, title
            of a panel -> its curves.
        xlabel: label of the x axes, units included.
        ylabel: label of the y axes, units included; or title of a panel -> its label.
        title: text over the picture.
        save: name of a file to save the picture to, .png, .svg or .pdf; None: it is not saved.
        styles, colours: matplotlib's styles ("o--") and colours: one for all curves, several that are used in turn, or
            label of a curve -> style or colour. None: all curves differ.
        log: which axes are logarithmic, "x", "y" or "xy"; "": none.
        xlim, ylim: (smallest, largest) number on the axes, or title of a panel -> such a pair. None: the whole range of
            the curves.
        columns: number of panels in a row.
        levels: title of a panel -> words that replace the numbers 0, 1, ... at its y axis, for curves of such numbers.
            None: all y axes show numbers.
        ax: matplotlib's axes to draw in, one for each panel; the legend is in the first. None: a new picture is made.

    Returns:
        The new picture; None if `ax` is given.

    Raises:
        InputError: `lines` is no mapping.
        ValueError: x and y of a curve have different lengths.

    Example:
        >>> from thinlayer import plotting
        >>> w, axes = [0, 1, 2], ("jump w_N (mm)", "traction t_N (MPa)")
        >>> lines = {"law": (w, [0, 3, 4]), "meshed": (w, [0, 2.9, 3.8])}
        >>> picture = plotting.curves(lines, *axes, save="pull.svg")
    """
    require(isinstance(lines, Mapping), "curves", lines, "give {label: (x, y)}, or {title: {label: (x, y)}}")
    has_panels = bool(lines) and all(isinstance(entry, Mapping) for entry in lines.values())
    panels: Any = lines if has_panels else {title: lines}
    columns = min(columns, len(panels))
    panel_rows, scale = -(-len(panels) // columns), 1.0 if columns > 2 else 1.4
    width, height = (3.1 * scale * columns, 2.6 * scale * panel_rows + 0.6) if has_panels else (6.5, 4.5)
    labels = list(dict.fromkeys(label for curves_in_panel in panels.values() for label in curves_in_panel))
    entry_inches = LINE_INCHES + LETTER_INCHES * max(map(len, labels), default=0)
    legend_rows = max(1, math.ceil(len(labels) / max(1, width // entry_inches)))
    inches = width, height + ROW_INCHES * (legend_rows - 1)
    axes_list = make_panels(ax, (panel_rows, columns), len(panels), inches)
    slope_colours = {label: "0.5" for label in labels if label.startswith("slope")}
    styles, colours = _by_label(labels, styles), colours_by_label(labels) | slope_colours | _by_label(labels, colours)
    dashes, plotted = dict(zip(labels, cycle(LINE_STYLES), strict=False)), dict[str, Line2D]()
    for axes, (name, curves_in_panel) in zip(axes_list, panels.items(), strict=True):
        for label, line in curves_in_panel.items():
            # points without a line are open markers, which do not hide one another
            marker: dict[str, Any] = {"ms": 6, "mfc": "none"} if styles.get(label) in MARKERS else {"ms": 4}
            (plotted[label],) = axes.plot(*line, styles.get(label, "-"), color=colours[label], label=label, **marker)
            if label not in styles:
                plotted[label].set_linestyle(dashes[label])
        axes.grid(color="0.9")
        axes.set(xscale="log" if "x" in log else "linear", yscale="log" if "y" in log else "linear")
        axes.set(xlabel=xlabel, ylabel=_for_panel(ylabel, name))
        axes.set(xlim=_for_panel(xlim, name), ylim=_for_panel(ylim, name))
        axes.set_title(name, fontsize=11)
        if levels and name in levels:
            axes.set_yticks(range(len(levels[name])), map(typeset, levels[name]))
    handles = [*plotted.values()] if len(plotted) > 1 else []
    return finish_picture(axes_list, save, title if has_panels else "", handles, math.ceil(len(plotted) / legend_rows))


def load_displacement(
    paths: Mapping[str, History | Table] | History | Table,
    displacement: str,
    load: str | Mapping[str, str],
    xlabel: str,
    ylabel: str = "",
    **options: Any,
) -> Picture | None:
    """Draw loads over displacements: the states of histories as dots on lines, and tables, as of closed forms, as lines.

    Args:
        paths: a history or a table; for several, label of a curve -> history or table.
        displacement: column of the tables with the displacements; "t" if the time of a march is one.
        load: column with the loads; for several panels, title of a panel -> its column. A path without it is left out.
        xlabel, ylabel: labels of the axes, units included.
        options: further options of `curves`, such as save, title, styles, colours, xlim and ax.

    Returns:
        The new picture; None if `ax` is given.

    Raises:
        InputError: a path is neither a history nor a table, or no path has the columns.

    Example:
        >>> from thinlayer import Table, plotting
        >>> beams = Table.of({"opening": [0, 1, 2], "force": [0, 6, 5]})
        >>> axes = "opening (mm)", "force (N/mm)"
        >>> picture = plotting.load_displacement(
        ...     {"beams": beams}, "opening", "force", *axes
        ... )
    """
    sources = entry_by_label("load_displacement", "paths", paths, (History, Table), "give a history or a table")
    tables = {label: path.table if isinstance(path, History) else path for label, path in sources.items()}
    panels = dict[str, CurvesByLabel]()
    for title, column in (load if isinstance(load, Mapping) else {"": load}).items():
        by_label = {label: table for label, table in tables.items() if column in table.columns}
        require(by_label, "load_displacement: load", column, "no path has this column")
        panels[title] = {label: (table[displacement], table[column]) for label, table in by_label.items()}
    styles = {label: ".-" if isinstance(path, History) else "-" for label, path in sources.items()}
    lines = panels if isinstance(load, Mapping) else panels[""]
    return curves(lines, xlabel, ylabel, **{"styles": styles, **options})


def response(
    responses: Mapping[str, HarmonicResponse] | HarmonicResponse,
    quantity: str,
    xlabel: str,
    ylabel: str,
    *,
    resonances: Mapping[str, tuple[Array, Array]] | tuple[Array, Array] | None = None,
    save: str | Path | None = None,
    title: str = "",
    ax: AxesInput = None,
    **options: Any,
) -> Picture | None:
    """Draw how large an observed quantity is under harmonic loads of each frequency, and by how much it lags behind.

    Amplitudes have a logarithmic axis; phases, below them, are in degrees, and negative where the quantity lags.

    Args:
        responses: what `harmonic` returns; for several, label of a curve -> response.
        quantity: name of an observed quantity of all of them.
        xlabel: label of the frequencies, in cycles per time: "frequency (Hz)" if times are in seconds.
        ylabel: label of the amplitudes, unit included.
        resonances: angular frequencies and loss factors to mark, as `Modes.loss` returns them; for several responses,
            label -> such a pair. None: no marks.
        save: name of a file to save the picture to, .png, .svg or .pdf; None: it is not saved.
        title: text over the picture.
        ax: two axes of matplotlib to draw in; None: a new picture is made.
        options: further options of `curves`, such as styles, colours and log.

    Returns:
        The new picture; None if `ax` is given.

    Raises:
        InputError: not a response; a response has no such quantity; resonances of none of the responses; `ax` is not
            two axes.

    Example:
        >>> import numpy as np
        >>> from thinlayer import plotting
        >>> from thinlayer.solving.harmonic import HarmonicResponse
        >>> omega = np.linspace(500, 2000, 151)
        >>> tip = 0.02 / (1 - (omega / 1e3) ** 2 + 0.1j)
        >>> picture = plotting.response(
        ...     HarmonicResponse(omega, {"tip": tip}),
        ...     "tip",
        ...     "frequency (Hz)",
        ...     "deflection (mm)",
        ...     resonances=(np.array([1e3]), np.array([0.1])),
        ... )
    """
    by_label = entry_by_label("response", "responses", responses, HarmonicResponse, "give what harmonic returns")
    marks = resonances if isinstance(resonances, Mapping) else dict.fromkeys(by_label, resonances)
    for label, pair in marks.items():
        require_known("response", label, by_label, "resonances")
        is_pair = isinstance(pair, Sequence) and len(pair) == 2 and np.ndim(pair[0]) == np.ndim(pair[1]) == 1
        require(
            is_pair or pair is None, "resonances", pair, "give frequencies and loss factors, as Modes.loss returns them"
        )
    amplitudes, phases = dict[str, tuple[Array, Array]](), dict[str, tuple[Array, Array]]()
    for label, answer in by_label.items():
        require_known("observed quantity", quantity, answer.values)
        order = np.argsort(answer.omega)
        hertz, values = answer.omega[order] / (2 * math.pi), answer.values[quantity][order]
        amplitudes[label], phases[label] = (hertz, abs(values)), (hertz, np.degrees(np.unwrap(np.angle(values))))
    panels = make_panels(ax, (2, 1), 2, (6.5, 5.5), sharex=True, height_ratios=(2, 1))
    labels = {"amplitude": ylabel, "phase": "phase (degrees)"}
    options["colours"] = colours_by_label([*by_label]) | _by_label(by_label, options.get("colours"))
    curves({"amplitude": amplitudes, "phase": phases}, xlabel, labels, ax=panels, **options)
    panels[0].set(yscale="log", title="", xlabel="")
    panels[0].autoscale(axis="y")
    turns = np.concatenate([phase for _, phase in phases.values()]) / 90
    panels[1].set(title="", ylim=(90 * math.floor(turns.min()) - 10, 90 * math.ceil(turns.max()) + 10))
    panels[1].yaxis.set_major_locator(MultipleLocator(90))
    low, high = panels[0].get_xlim()
    for k, (label, pair) in enumerate(marks.items()):
        for omega, loss in zip(*pair, strict=True) if pair is not None else ():
            if low <= (hertz := omega / (2 * math.pi)) <= high:
                style: dict[str, Any] = {"color": options["colours"][label]}
                for panel in panels:
                    panel.axvline(hertz, lw=0.8, ls=":", **style)
                style |= {"xycoords": ("data", "axes fraction"), "xytext": (-1, 4), "textcoords": "offset points"}
                box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.5}
                text, at = f"loss {loss:.2g}", (hertz, k % 3 / 5)  # below the peaks, in turn at three heights
                panels[0].annotate(text, at, rotation=90, ha="right", fontsize=8, bbox=box, **style)
    return finish_picture(panels, save, title)


def as_fraction(x: float) -> str:
    """Return a number as text: 1/4, 1/8, 1/16, ... as fractions, others as decimals with four significant digits."""
    return f"1/{1 / x:.0f}" if x <= 1 / 4 and math.frexp(x)[0] == 0.5 else f"{x:.4g}"


def _for_panel(setting: Any, name: str) -> Any:
    """Return the value of a setting for the panel with the title `name`.

    If `setting` is a mapping, title of a panel -> value, it is this panel's entry, or None; otherwise it is `setting`.
    """
    return setting.get(name) if isinstance(setting, Mapping) else setting


def colours_by_label(labels: Sequence[str]) -> dict[str, str]:
    """Return the default colours of curves: orange for the first of a meshed layer, for others all colours in turn."""
    meshed = next((label for label in labels if "meshed" in label), None)
    others = cycle(colour for colour in COLOURS if meshed is None or colour != MESHED_COLOUR)
    return {label: MESHED_COLOUR if label == meshed else next(others) for label in labels}


def _by_label(labels: Iterable[str], styles: StyleChoice) -> dict[str, str]:
    if isinstance(styles, Mapping):
        return dict(styles)
    return dict(zip(labels, cycle([styles] if isinstance(styles, str) else styles or []), strict=False))


def set_symlog(axes: Axes, low: float, high: float) -> None:
    """Make the y axis logarithmic on both sides of zero, with ticks at zero and at powers of ten.

    Args:
        axes: the panel.
        low, high: smallest and largest value to draw; if both are 0, the axis stays linear.
    """
    if not (largest := max(-low, high)) > 0:
        return
    top_exponent = math.floor(math.log10(largest))
    powers = [10.0**k for k in range(top_exponent + int(math.log10(SYMLOG_RATIO)) + 1, top_exponent + 1)]
    axes.set_yscale("symlog", linthresh=powers[0], linscale=0.5)
    axes.set_yticks([*(-power for power in reversed(powers)), 0.0, *powers])
    axes.set_ylim(1.5 * min(low, 0.0), 1.5 * max(high, 0.0))  # the ticks' range leaves a half empty for one sign
    axes.minorticks_off()
