"""Pictures that are not saved: what functions return, in notebooks and in windows."""

from __future__ import annotations

from io import BytesIO

import pytest
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread

from forms import LinearElastic
from geometry import sandwich
from tests.contact_bars import bar, coulomb
from thinlayer import Structure, Surface, Table, ThinLayer, plotting, solve


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


def test_a_picture_opens_in_a_window(pictures, monkeypatch):
    """The window's canvas has the picture."""
    shown = []
    pyplot.close(pyplot.figure())  # pyplot chooses its backend
    monkeypatch.setattr(FigureCanvasAgg, "required_interactive_framework", "tk")
    monkeypatch.setattr(pyplot, "show", lambda: shown.append(pyplot.get_current_fig_manager().canvas.figure))
    pictures["curves"].show()
    assert shown == [pictures["curves"]]
    pyplot.close("all")
