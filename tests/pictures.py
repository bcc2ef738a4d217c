"""What a picture must show."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np


def assert_drawn(*paths: Path) -> None:
    """Pictures with more than a frame and its labels, which are grey: many colours that are not."""
    for path in paths:
        image = (matplotlib.image.imread(path)[..., :3] * 255).astype(int)
        assert min(image.shape[:2]) > 200, path
        coloured = image[np.ptp(image, axis=2) > 10]
        assert len(np.unique(coloured @ [1, 256, 65536])) > 50, path
