"""Movies of deformed structures in time, drawn off screen and written by matplotlib's animation writers."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from matplotlib import rc_context
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter

from forms.base import InputError, is_integer, require
from geometry.parallel import on_root
from thinlayer.discretisation.state import State
from thinlayer.output.paraview.grid import gather_grid
from thinlayer.output.plotting.scene import Scene, View
from thinlayer.output.plotting.structures import DEFAULT_VIEW
from thinlayer.solving.history import History
from thinlayer.system.folder import replace_file
from thinlayer.system.progress import track

GIF_EXT, MP4_EXT = ".gif", ".mp4"
FRAME_DPI = 120
MAX_FRAME_RATE = 50  # frames per second, as a gif counts in hundredths of a second


def movie(
    solution: History | Sequence[State],
    view: View = DEFAULT_VIEW,
    *,
    save: str | Path,
    per_second: int = 10,
    title: str = "",
    time_unit: str = "",
) -> Path:
    """Write a movie of a deforming structure, with a frame for each state that a history keeps. Collective.

    All frames have the same window, factor of the displacements and range of colours. All are shown for the same
    duration, whatever the time steps were. The time stands over each frame. A notebook shows the file by IPython's
    `Image` (gif) or `Video` (mp4).

    Args:
        solution: a history, or states of one model in the order of the frames.
        view: direction, window, colours and scale of displacements.
        save: name of the file, .gif or .mp4. An mp4 needs ffmpeg, from the package imageio-ffmpeg or on the PATH.
        per_second: number of frames per second, from 1 to 50.
        title: text over all frames.
        time_unit: unit of the time over each frame.

    Returns:
        The name of the file, on all ranks.

    Raises:
        InputError: no state, or states of several models; an invalid view, as in `deformed`; another ending of the
            name; no ffmpeg.
        OSError: the movie could not be written; on all ranks.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, march, plotting
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> loads = {"TOP": lambda x, t: (t, 0)}
        >>> plates = Structure(joint, body=steel, supports={"BOTTOM": 0}, tractions=loads)
        >>> history = march(plates.interface(ThinLayer(glue, eps=0.05)), times=[1, 2])
        >>> plotting.movie(history, save="slip.gif", time_unit="s").name
        'slip.gif'
    """
    states = list(solution) if isinstance(solution, Iterable) else []
    if not states or not all(isinstance(state, State) for state in states):
        raise InputError(f"movie: {solution!r:.80} has no states; give a history that keeps them, or several states")
    if any(state.model is not states[0].model for state in states):
        raise InputError("movie: the states are of several models; give those of one march")
    if not isinstance(save, (str, Path)) or Path(save).suffix not in (GIF_EXT, MP4_EXT):
        raise InputError(f"save is {save!r}; it must be the name of a movie, which ends in .gif or .mp4")
    is_valid_rate = is_integer(per_second, 1) and per_second <= MAX_FRAME_RATE
    require(is_valid_rate, "per_second", per_second, f"allowed: whole numbers from 1 to {MAX_FRAME_RATE}")
    path, comm = Path(save), states[0].model.comm
    ffmpeg_path = on_root(comm, _ffmpeg_path) if path.suffix == MP4_EXT else ""
    grids = [grid for state in track(states, "movie", "{0.t:.4g}") if (grid := gather_grid(state))]

    def write_movie() -> None:
        scene = Scene.of(grids, view)
        (axes,) = scene.panels(1)
        figure: Any = axes.figure
        scene.draw_colour_bar([axes])
        scene.draw(axes, grids[0])
        axes.set_title(" ", fontsize=11)
        if title:
            figure.suptitle(title)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # keep the layout of the first frame
        writer: AbstractMovieWriter = PillowWriter(per_second) if path.suffix == GIF_EXT else FFMpegWriter(per_second)
        with TemporaryDirectory() as folder, replace_file(path) as file:
            temp_path = Path(folder) / path.name
            with rc_context({"animation.ffmpeg_path": ffmpeg_path}), writer.saving(figure, str(temp_path), FRAME_DPI):
                for state, grid in track([*zip(states, grids, strict=True)], "movie", "a frame"):
                    axes.clear()
                    axes.set_axis_off()
                    scene.draw(axes, grid)
                    axes.set_title(f"t = {state.t:.4g}{f' {time_unit}' if time_unit else ''}", fontsize=11)
                    writer.grab_frame()
            file.write(temp_path.read_bytes())

    on_root(comm, write_movie)
    return path


def _ffmpeg_path() -> str:
    """Return the path of the program ffmpeg; raise InputError if it is not installed."""
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return str(get_ffmpeg_exe())
    except (ImportError, RuntimeError):
        if executable := shutil.which("ffmpeg"):
            return executable
    raise InputError("an mp4 needs ffmpeg: install imageio-ffmpeg (pip install 'thinlayer[movie]'), or save a .gif")
