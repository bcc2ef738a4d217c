"""What a picture must show."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from thinlayer.output.plotting.structures import STATUS_COLOURS


def assert_drawn(*paths: Path) -> None:
    """Pictures with more than a frame and its labels, which are grey: many colours that are not."""
    for path in paths:
        image = (matplotlib.image.imread(path)[..., :3] * 255).astype(int)
        assert min(image.shape[:2]) > 200, path
        assert len(np.unique(image[np.ptp(image, axis=2) > 10] @ [1, 256, 65536])) > 50, path


def assert_coloured(picture: Figure | None, names: set[str]) -> None:
    """A picture whose image has the colour of each name, and whose legend has the names."""
    assert picture is not None
    canvas = FigureCanvasAgg(picture)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3].reshape(-1, 3)
    colours = {*map(tuple, np.unique(pixels, axis=0).tolist())}
    assert {tuple(round(255 * c) for c in to_rgb(STATUS_COLOURS[name])) for name in names} <= colours
    assert {text.get_text() for text in picture.legends[0].get_texts()} == names
