"""Movies of marches: a frame for each state, of one window and one range of colours, with its time."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from forms import LinearElastic
from forms.base import InputError
from geometry import sandwich
from tests.refused import refused
from thinlayer import Structure, ThinLayer, march, plotting


def pulled(times=(0.5, 1.0, 2.0)):
    """A strip that is pulled away and along, more and more."""
    joint = sandwich(2.0, 0.5, 0.5, 0.5)
    load = {"TOP": lambda x, t: (0.3 * t, 0.5 * t)}
    structure = Structure(joint, body=LinearElastic(60.0, 40.0), supports={"BOTTOM": 0}, tractions=load)
    return march(structure.interface(ThinLayer(LinearElastic(3.0, 2.0), 0.1, at=1.0)), list(times))


@pytest.fixture(scope="module")
def history():
    return pulled()


def frames(path):
    with Image.open(path) as movie:
        images = []
        for number in range(movie.n_frames):
            movie.seek(number)
            images.append(np.asarray(movie.convert("RGB"), float) / 255)
        return images, movie.info["duration"]


def test_a_gif_has_a_frame_for_each_state(history, tmp_path):
    options = {"save": tmp_path / "a.gif", "per_second": 5, "title": "strip", "time_unit": "h"}
    images, duration = frames(plotting.movie(history, plotting.View(unit="mm", symbols=False), **options))
    assert len(images) == 4 == len(list(history))
    assert duration == 200
    assert [path.name for path in tmp_path.iterdir()] == ["a.gif"]
    for image in images:
        assert image.std() > 0.05
    # colours are common: at rest nothing is yellow but the colour bar, at the end a corner is
    yellow = [((image[..., 0] > 0.85) & (image[..., 1] > 0.8) & (image[..., 2] < 0.35)).sum() for image in images]
    assert yellow[0] == pytest.approx(yellow[1], rel=0.3)  # each frame has a palette of its own
    assert yellow[3] > 1.5 * yellow[0]
    # so is the window: the lower side is held and stays where it is, the upper side moves up
    drawn = [np.flatnonzero(image[:, int(0.3 * image.shape[1])].min(axis=1) < 0.9) for image in images]
    assert len({rows[rows < int(0.8 * len(images[0]))].max() for rows in drawn}) == 1
    tops = [rows.min() for rows in drawn]
    assert tops[0] > tops[1] > tops[3]


def test_an_mp4_has_as_many(history, tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = plotting.movie(history, plotting.View("y"), save=str(tmp_path / "deep" / "a.mp4"), per_second=4)
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    assert (count, seconds) == (4, pytest.approx(1.0, abs=0.05))
    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["size"]
    pixels = [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]
    assert all(image.std() > 10 for image in pixels)
    assert np.abs(pixels[-1].astype(float) - pixels[0]).max() > 100


def test_what_is_no_movie(history, tmp_path):
    gif, two = {"save": tmp_path / "a.gif"}, [history.last, pulled([1.0]).last]
    for words, solution, options in (
        ("give a history that keeps them, or several states", history.last, gif),
        ("give a history that keeps them, or several states", [], gif),
        ("of several models", two, gif),
        (r"ends in \.gif or \.mp4", history, {"save": "a.avi"}),
        ("whole numbers from 1 to 50", history, gif | {"per_second": 2.5}),
        ("unknown component", history, gif | {"view": plotting.View("z")}),
    ):
        refused(InputError, words, plotting.movie, solution, **options)
    assert not [*tmp_path.iterdir()]
