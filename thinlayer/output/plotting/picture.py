"""Pictures: matplotlib figures that notebooks display, and that scripts save or show in a window."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from matplotlib.text import Text
from mpi4py import MPI

from forms.base import InputError, require
from geometry.parallel import on_root
from thinlayer.system.folder import replace_file

# text width of a page, inches; dots per inch of a saved picture after scaling it down to this width if it is wider
PAGE_INCHES, SAVED_DPI = (6.7, 300)
# Text remains text in vector files, and equal pictures give equal files.
VECTOR_FONTS = ["DejaVu Sans", "Verdana", "Arial"]
VECTOR_RC_PARAMS = {"svg.fonttype": "none", "svg.hashsalt": "thinlayer", "font.sans-serif": VECTOR_FONTS}
UNDATED_METADATA: dict[str, dict[str, None]] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}
# Words that are Greek letters; letters with an index, these letters alone, and powers.
GREEK_PATTERN = "eps|lambda|nu|mu|pi|kappa|rho|psi|omega|Omega|delta|sigma"
SYMBOL_PATTERN = r"(?:\\[A-Za-z]+|\b[A-Za-z]{1,2})_(?:[NTxyz\d]|min)\b|\\[A-Za-z]+|\b(?:10|L)\^-?\d+"
AxesInput = Axes | Sequence[Axes] | np.ndarray | None  # argument `ax`
NOTEBOOK_SAVE_OPTIONS: dict[str, Any] = {"dpi": 100, "bbox_inches": "tight"}


class Picture(Figure):
    """A matplotlib figure whose texts show symbols such as "eps", "t_T" and "10^3" as mathematics.

    A notebook displays the picture if it is the last value of a cell, or by IPython's `display`. `savefig` and all
    other methods are those of a matplotlib figure. It is made without pyplot, so that matplotlib's backend does not
    change.

    Attributes:
        make_plotter: function that returns a plotter of pyvista with the 3D structures of the picture; None: it has none.
    """

    make_plotter: Callable[[], Any] | None = None

    def interactive(self) -> None:
        """Show the structures in the picture by pyvista, so that the mouse turns and enlarges them.

        A script opens a window. A notebook uses pyvista's back end: with trame (pip install 'pyvista[jupyter]') the
        structures turn, otherwise pyvista shows an image and warns.

        Raises:
            InputError: the picture shows no 3D structure.
        """
        if self.make_plotter is None:
            raise InputError("interactive: only pictures of 3D structures, by `deformed` and `on_surface`, can turn")
        self.make_plotter().show()

    def draw(self, renderer: RendererBase) -> None:
        """Draw the figure by a matplotlib renderer, after replacing symbols in its texts by mathematics (`typeset`)."""
        for text in self.findobj(Text):
            text.set_text(typeset(text.get_text()))
        super().draw(renderer)

    def _repr_png_(self) -> bytes:
        buffer = BytesIO()
        self.savefig(buffer, format="png", **NOTEBOOK_SAVE_OPTIONS)
        return buffer.getvalue()

    def show(self, warn: bool = True) -> None:
        """Open the picture in a window, for scripts with a screen, and wait until the user closes it.

        Args:
            warn: without effect; an argument of matplotlib's method.
        """
        from matplotlib import pyplot

        manager = pyplot.figure().canvas.manager
        assert manager is not None, "made by pyplot"
        canvas = manager.canvas
        canvas.figure = self
        self.set_canvas(canvas)
        pyplot.show()


def typeset(text: str) -> str:
    """Return a text in which symbols such as "eps", "t_T" and "10^3" are matplotlib's mathematics, between "$".

    A text that already contains "$" is returned unchanged.
    """
    if "$" in text:
        return text
    text = re.sub(rf"\b({GREEK_PATTERN})(?=\b|_)", r"\\\1", text).replace(r"\eps", r"\varepsilon")
    return re.sub(SYMBOL_PATTERN, lambda match: "$" + re.sub(r"([_^])(-?\w+)", r"\1{\2}", match[0]) + "$", text)


def make_panels(
    ax: AxesInput, shape: tuple[int, int], n: int, inches: tuple[float, float], **sharing: Any
) -> list[Axes]:
    """Return the axes of n panels, of a new picture or those that the user gives.

    Args:
        ax: the user's axes, in any shape; None: a new picture.
        shape: numbers of rows and columns of the new picture.
        n: number of panels.
        inches: width and height of the new picture, inches.
        sharing: which axes the panels of the new picture share, as in matplotlib's `subplots`.

    Raises:
        InputError: `ax` is not that many axes of matplotlib.
    """
    if ax is None:
        picture = Picture(figsize=inches, layout="constrained")
        panels = picture.subplots(*shape, squeeze=False, **sharing).ravel().tolist()
        for panel in panels[n:]:
            panel.remove()
        return panels[:n]
    panels = np.ravel(np.asarray(ax, object)).tolist()
    require(len(panels) == n and all(isinstance(p, Axes) for p in panels), "ax", ax, f"give {n} axes of matplotlib")
    return panels


def finish_picture(
    panels: list[Axes], save: str | Path | None, title: str = "", handles: Collection[Any] = (), ncols: int = 1
) -> Picture | None:
    """Give a picture a legend and a title, save it, and return it. Collective unless `save` is None.

    Args:
        panels: axes of the picture. If they are in a figure of the user, the legend is in the first of them, and None
            is returned: a notebook would show the figure twice.
        save: name of the file to which rank 0 saves the picture; None: it is not saved.
        title: text over the picture; "": none.
        handles: entries of the legend.
        ncols: number of columns of a legend below the picture.
    """
    figure: Any = panels[0].figure
    picture = figure if isinstance(figure, Picture) else None
    if handles and picture:
        picture.legend(handles=handles, loc="outside lower center", ncols=ncols, frameon=False)
    elif handles:
        panels[0].legend(handles=handles)
    if title:
        figure.suptitle(title, fontsize=11)
    if save is not None:
        on_root(None, lambda: save_picture(figure, save))
    return picture


def entry_by_label(
    function: str, argument: str, entries: Mapping[str, Any] | Any, kinds: type | tuple[type, ...], wanted: str
) -> dict[str, Any]:
    """Convert an argument to a mapping, label -> entry; a single entry gets the label "".

    Args:
        function, argument: names of the function that the user has called, and of its argument, for messages.
        entries: the argument.
        kinds: types of entries that are allowed.
        wanted: text that says what to give, for messages.

    Raises:
        InputError: an entry has another type, or the mapping is empty.
    """
    by_label = dict(entries) if isinstance(entries, Mapping) else {"": entries}
    if not by_label:
        raise InputError(f"{function}: {argument} is empty; {wanted}")
    for label, entry in by_label.items():
        require(isinstance(entry, kinds), f"{function}: {label or argument}", entry, wanted)
    return by_label


def draw_on_root(comm: MPI.Intracomm, draw: Callable[[], Figure], save: str | Path | None) -> Picture | None:
    """Draw a picture on rank 0 and return it if it is new; other ranks return None. Collective.

    Args:
        comm: communicator.
        draw: function that makes the picture, or draws in a figure of the user and returns that.
        save: name of a file to which rank 0 saves the picture; None: it is not saved.
    """
    figures: list[Figure] = []
    on_root(comm, lambda: figures.append(draw()))
    if save is not None:
        on_root(comm, lambda: save_picture(figures[0], save))
    return figures[0] if figures and isinstance(figures[0], Picture) else None


def save_picture(figure: Figure, save: str | Path) -> None:
    """Save a picture on this rank; an existing file of this name is replaced only when the new file is complete.

    Curves in .svg and .pdf files are vector graphics. Images in them, and files of other formats, have 300 dots per
    inch of the printed picture. A picture wider than a page's text, 170 mm, is printed with this width.

    Args:
        figure: the picture.
        save: name of the file; without an ending it is a .png.

    Raises:
        InputError: `save` is the name of a folder.
        ValueError: matplotlib does not know the ending of the name.
        OSError: the file could not be written.
    """
    require(isinstance(save, (str, Path)), "save", save, "it must be the name of a picture, or None")
    path = Path(save)
    require(not path.is_dir(), "save", save, "it is a folder; give the name of a picture")
    ext, dpi = path.suffix.removeprefix(".") or "png", SAVED_DPI * min(1.0, PAGE_INCHES / figure.get_size_inches()[0])
    with replace_file(path.with_suffix(f".{ext}")) as file, rc_context(VECTOR_RC_PARAMS):
        figure.savefig(file, format=ext, dpi=dpi, metadata=UNDATED_METADATA.get(ext), bbox_inches="tight")
