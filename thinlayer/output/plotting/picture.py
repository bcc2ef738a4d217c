"""Pictures: matplotlib figures that notebooks display, that can be saved, and shown in a window."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

from matplotlib.figure import Figure
from mpi4py import MPI

from forms.base import require
from geometry.parallel import on_root
from thinlayer.system.folder import replaced

SAVED: dict[str, Any] = {"dpi": 150, "bbox_inches": "tight"}  # options of all pictures that are saved
IN_NOTEBOOK: dict[str, Any] = {"dpi": 100, "bbox_inches": "tight"}


class Picture(Figure):
    """A matplotlib figure, made without pyplot, so that scripts and notebooks keep their backend.

    A notebook displays it where it is the last value of a cell, or by IPython's `display`; `savefig` and all else is
    matplotlib's.
    """

    def _repr_png_(self) -> bytes:
        buffer = BytesIO()
        self.savefig(buffer, format="png", **IN_NOTEBOOK)
        return buffer.getvalue()

    def show(self, warn: bool = True) -> None:
        """Open the picture in a window and wait until it is closed; for scripts where there is a screen."""
        from matplotlib import pyplot

        manager = pyplot.figure().canvas.manager
        assert manager is not None, "made by pyplot"
        canvas = manager.canvas
        canvas.figure = self
        self.set_canvas(canvas)
        pyplot.show()


F = TypeVar("F", bound=Figure)


def finish(figure: F, save: str | Path | None) -> F:
    """Save a picture, if asked to. Collective: rank 0 writes."""
    if save is not None:
        on_root(None, lambda: put(figure, save))
    return figure


def drawn_on_root(comm: MPI.Intracomm, draw: Callable[[], Picture], save: str | Path | None) -> Picture | None:
    """The picture that rank 0 draws, and saves if asked to; None on other ranks. Collective."""
    pictures: list[Picture] = []

    def on_rank_0() -> None:
        pictures.append(draw())
        if save is not None:
            put(pictures[0], save)

    on_root(comm, on_rank_0)
    return pictures[0] if pictures else None


def put(figure: Figure, save: str | Path) -> None:
    """Save a picture on this rank. A file of this name is replaced only when the new one is complete.

    Raises:
        InputError: the name is that of a folder. ValueError: it has an ending that matplotlib does not know.
        OSError: the file could not be written.
    """
    require(isinstance(save, (str, Path)), "save", save, "it must be the name of a picture, or None")
    path = Path(save)
    require(not path.is_dir(), "save", save, "it is a folder; give the name of a picture")
    with replaced(path if path.suffix else path.with_suffix(".png")) as file:
        figure.savefig(file, format=path.suffix.removeprefix(".") or "png", **SAVED)
