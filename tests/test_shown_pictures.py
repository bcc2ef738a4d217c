"""Pictures that are not saved: what functions return, in notebooks and in windows."""

from __future__ import annotations

import sys
from io import BytesIO

import numpy as np
import pytest
import pyvista
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread

import thinlayer
from forms import LinearElastic
from geometry import sandwich
from tests.contact_bars import bar, coulomb
from tests.refused import refused
from thinlayer import InputError, Structure, Surface, Table, ThinLayer, plotting, solve


def strip():
    joint = sandwich(2.0, 0.5, 0.5, 0.5)
    structure = Structure(joint, body=LinearElastic(60.0, 40.0), supports={"BOTTOM": 0}, tractions={"TOP": (0.2, 0.5)})
    return solve(structure.interface(ThinLayer(LinearElastic(3.0, 2.0), 0.1, at=1.0)))


def cube():
    joint = sandwich(1.5, 0.4, 0.4, 0.4, depth=0.8, cell="hexahedron")
    pulled = Structure(joint, body=LinearElastic(60.0, 40.0), supports={"BOTTOM": 0}, tractions={"TOP": (0.2, 0.5, 0)})
    return solve(pulled.interface(ThinLayer(LinearElastic(3.0, 2.0), 0.1, at=1.0)))


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


def test_solids_open_in_a_window_where_they_turn(monkeypatch):
    """It has what the picture has, from the same side."""
    shown = []
    monkeypatch.setattr(pyvista, "OFF_SCREEN", True)
    monkeypatch.setattr(pyvista.Plotter, "show", lambda self: shown.append(self))
    state = cube()
    picture = plotting.deformed({"a": state, "b": state}, plotting.View(towards=(0, 0, 1)))
    picture.interactive()
    shown[0].window_size = picture.axes[0].images[0].get_array().shape[1::-1]
    for k, axes in enumerate(picture.axes[:2]):
        shown[0].subplot(0, k)
        assert shown[0].camera.parallel_scale == pytest.approx(np.diff(axes.get_ylim())[0] / 2)
        assert shown[0].camera.focal_point[:2] == pytest.approx([np.mean(axes.get_xlim()), np.mean(axes.get_ylim())])
    image = shown[0].screenshot(return_img=True).astype(int)
    assert len(np.unique(image[np.ptp(image, axis=2) > 10] @ [1, 256, 65536])) > 50  # displacements, in colours
    refused(InputError, "only pictures of 3D structures", plotting.deformed(strip()).interactive)


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
@pytest.mark.parametrize("degree", [1, 2])
def test_plane_structures_have_their_area_and_outline(cell, degree):
    """Triangles that cover all cells, edges around bodies, both sides of S, loads and supports where they are."""
    element = ("P" if cell == "triangle" else "Q") + str(degree)
    structure = Structure(
        sandwich(2.0, 0.5, 0.7, 0.25, cell=cell),
        body=LinearElastic(60.0, 40.0),
        supports={"BOTTOM": 0, "LEFT/LOWER": {"n": 0}, "LEFT/UPPER": {"x": 0}, (0.0, 0.7): {"x": 0}},
        tractions={"TOP": (0.2, 0.5)},
        element=element,
    )
    state = solve(structure.interface(ThinLayer(LinearElastic(3.0, 2.0), 0.1, at=1.0)))
    figure = Figure()
    axes = figure.subplots()
    assert plotting.deformed(state, plotting.View(scale=0.0), ax=axes) is None
    mesh, base, edges, sides, layer = axes.collections[:5]
    triangulation = mesh._triangulation
    corners = np.stack([triangulation.x, triangulation.y], axis=1)[triangulation.triangles]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
    assert np.abs(areas).sum() == pytest.approx(2.0 * 1.2)
    assert (areas > 0).all() or (areas < 0).all()

    def length(lines):
        return sum(np.linalg.norm(np.diff(segment, axis=0)) for segment in lines.get_segments())

    lengths = [length(lines) for lines in (base, edges, sides, layer)]
    assert lengths == pytest.approx([0.0, 2 * 2.0 + 2 * 1.2, 2 * 2.0, 0.0])
    arrows, (fixed, guided) = axes.collections[5], axes.lines
    assert pytest.approx(np.full(arrows.N, 0.7 + 0.06 * 2.0 * 0.5 / np.hypot(0.2, 0.5))) == arrows.Y + arrows.V
    assert np.asarray(fixed.get_ydata()) == pytest.approx(np.full(len(fixed.get_xdata()), -0.5))
    assert np.asarray(guided.get_xdata()) == pytest.approx(np.zeros(len(guided.get_xdata())))
    assert min(len(arrows.X), len(fixed.get_xdata()), len(guided.get_xdata())) >= 4


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


def test_plane_structures_need_no_vtk(monkeypatch):
    """Nor do curves; pictures of 3D structures and files for ParaView name the extra that is missing."""
    flat, thick = strip(), cube()
    for name in [module for module in sys.modules if module.startswith("thinlayer.output.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pyvista", None)
    assert isinstance(thinlayer.plotting.deformed(flat), Figure)
    refused(InputError, r"pyvista is not installed: .*thinlayer\[vtk\]", thinlayer.plotting.deformed, thick)
    refused(InputError, r"pyvista is not installed: .*thinlayer\[vtk\]", getattr, thinlayer, "fields")
