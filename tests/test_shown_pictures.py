"""Pictures that are not saved: what functions return, in notebooks and in windows."""

from __future__ import annotations

from io import BytesIO

import numpy as np
import pytest
import pyvista
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread

from forms import LinearElastic
from geometry import sandwich
from tests.contact_bars import bar, coulomb
from tests.refused import refused
from thinlayer import InputError, Structure, Surface, Table, ThinLayer, plotting, solve


def strip():
    joint = sandwich(2.0, 0.5, 0.5, 0.5)
    structure = Structure(joint, body=LinearElastic(60.0, 40.0), supports={"BOTTOM": 0}, tractions={"TOP": (0.2, 0.5)})
    return solve(structure.interface(ThinLayer(LinearElastic(3.0, 2.0), 0.1, at=1.0)))


@pytest.fixture(scope="module")
def pictures():
    """One of each function."""
    state, pressed = strip(), bar(8, coulomb("soft"))
    table = Table({"eps": e, "error_traction": 3 * e, "error_jump": 2 * e} for e in (0.4, 0.2, 0.1))
    line = {"a": ([0, 1], [0, 1])}
    return {
        "deformed": plotting.deformed(state),
        "on_surface": plotting.on_surface(state, Surface.status),
        "along": plotting.along(pressed.surface, pressed),
        "rates": plotting.rates(table),
        "curves": plotting.curves(line, xlabel="x", ylabel="y"),
        "panels": plotting.curves({"t": line}, xlabel="x", ylabel="y"),
    }


def test_pictures_are_figures_that_notebooks_display(pictures):
    for name, picture in pictures.items():
        assert isinstance(picture, Figure), name
        assert imread(BytesIO(picture._repr_png_()))[..., :3].std() > 0.01, name
    assert not pyplot.get_fignums()  # pyplot knows of none, and does not show or close them


def test_structures_open_in_a_window_where_they_turn(monkeypatch):
    """It has what the picture has, from the same side."""
    shown, state = [], strip()
    monkeypatch.setattr(pyvista, "OFF_SCREEN", True)
    monkeypatch.setattr(pyvista.Plotter, "show", lambda self: shown.append(self))
    picture = plotting.deformed({"a": state, "b": state})
    picture.interactive()
    shown[0].window_size = picture.axes[0].images[0].get_array().shape[1::-1]
    for k, axes in enumerate(picture.axes[:2]):
        shown[0].subplot(0, k)
        assert shown[0].camera.parallel_scale == pytest.approx(np.diff(axes.get_ylim())[0] / 2)
        assert shown[0].camera.focal_point[:2] == pytest.approx([np.mean(axes.get_xlim()), np.mean(axes.get_ylim())])
    image = shown[0].screenshot(return_img=True).astype(int)
    assert len(np.unique(image[np.ptp(image, axis=2) > 10] @ [1, 256, 65536])) > 50  # displacements, in colours
    refused(InputError, "shows curves", plotting.curves({"a": ([0, 1], [0, 1])}, "x").interactive)


def test_pictures_are_drawn_into_axes_of_the_user(tmp_path):
    """They return nothing, as a notebook would show the figure twice; curves that are there stay."""
    state, figure = strip(), Figure()
    surface, (top, *others) = Surface(state.model), figure.subplots(5, 1)
    top.plot([0.1, 0.4], [0.1, 0.3], label="measured")
    table = Table({"eps": e, "error_traction": 3 * e, "error_jump": 2 * e} for e in (0.4, 0.2, 0.1))
    assert plotting.rates(table, ax=top, save=tmp_path / "a.png") is None
    assert [line.get_label() for line in top.lines] == ["measured", "traction", "jump", "slope 1"]
    assert len(top.get_legend().get_texts()) == 3
    assert plotting.along(surface, state, ax=others) is None
    assert [axes.get_ylabel() for axes in others] == ["t_N", "t_T", "w_N", "w_T"]
    assert plotting.along(surface, {"p": {"a": state.t + surface.weights, "b": surface.weights}}, ax=others[0]) is None
    assert plotting.curves({"a": {"x": ([0, 1], [2, 3])}, "b": {"x": ([0, 1], [2, 3])}}, "x", ax=others[:2]) is None
    assert not figure.legends
    assert (tmp_path / "a.png").stat().st_size > 300
    for ax in (others[:3], top.lines[0], "top"):
        refused(InputError, "give 4 axes of matplotlib", plotting.along, surface, state, ax=ax)


def test_a_picture_opens_in_a_window(pictures, monkeypatch):
    """The window's canvas has the picture."""
    shown = []
    pyplot.close(pyplot.figure())  # pyplot chooses its backend
    monkeypatch.setattr(FigureCanvasAgg, "required_interactive_framework", "tk")
    monkeypatch.setattr(pyplot, "show", lambda: shown.append(pyplot.get_current_fig_manager().canvas.figure))
    pictures["curves"].show()
    assert shown == [pictures["curves"]]
    pyplot.close("all")
