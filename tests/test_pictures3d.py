"""Pictures of three-dimensional structures."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.image import imread

from forms import LinearElastic
from geometry import block, sandwich
from tests.refused import refused
from thinlayer import Structure, ThinLayer, plotting, solve
from thinlayer.output.paraview.grid import gather_grid
from thinlayer.output.plotting.scene import DEFAULT_TOWARDS, Scene
from thinlayer.output.plotting.solid_shape import SolidShape, outer_surface, sharp_edges

BODY = LinearElastic.young(E=100.0, nu=0.3)
EPS = 0.015
LAYER = ThinLayer(LinearElastic.young(E=1.0, nu=0.3), EPS)
SIZE = (1.5, 0.4, 0.8)  # of a body: width, height, depth


def both(joint, **setup):
    boxes = Structure(joint, body=BODY, **setup)
    return {"meshed": solve(boxes.full(LAYER, cells_through=1)), "law": solve(boxes.interface(LAYER))}


@pytest.fixture(scope="module")
def pulled():
    joint = sandwich(1.5, 0.4, 0.4, 0.4, depth=0.8, cell="hexahedron")
    return both(joint, supports={"BOTTOM": 0}, tractions={"TOP": (0, 2, 0)})


@pytest.fixture(scope="module")
def pushed():
    return both(block(1.5, 0.4, 0.4, depth=0.8), supports={}, tractions={"TOP": (-1, 0.5, -1)})


def picture(path, states, title="", **options):
    plotting.deformed(states, plotting.View(**options), save=path, title=title)
    return imread(path)[..., :3]


def halves(image):
    return np.split(image[:, : image.shape[1] // 2 * 2], 2, axis=1)


def near(image, colour):
    return np.abs(image - colour).max(axis=2) < 0.1


def test_jump_opens_as_a_gap(pulled, tmp_path):
    image = picture(tmp_path / "a.png", pulled["law"], towards=(0, 0, 1), scale=1.0)
    column = near(image, (1, 1, 1))[:, image.shape[1] // 2]
    changes = np.flatnonzero(np.diff(column.astype(int)))
    gap = column[changes[1] + 1 : changes[2] + 1]  # changes: into the upper body, out of it, into the lower body
    assert gap.all()
    assert len(gap) > 0.02 * (changes[2] - changes[0])


def test_rigid_base_is_grey_and_stays(pushed, tmp_path):
    _, law = halves(picture(tmp_path / "a.png", pushed))
    grey = (0.412, 0.412, 0.412)  # dimgrey
    assert near(law, grey).sum() > 2000
    for state, y in zip(pushed.values(), (-EPS, 0.0), strict=True):
        base = gather_grid(state).base_x
        assert base.shape[1:] == (3, 3)
        np.testing.assert_allclose(base[..., 1], y, atol=1e-12)
        area = np.linalg.norm(np.cross(base[:, 1] - base[:, 0], base[:, 2] - base[:, 0]), axis=1).sum() / 2
        assert area == pytest.approx(1.5 * 0.8)


def test_view_zoom_and_cut(pulled, tmp_path):
    law = pulled["law"]
    default = picture(tmp_path / "a.png", law)
    np.testing.assert_array_equal(default, picture(tmp_path / "b.png", law, towards=2 * np.array(DEFAULT_TOWARDS[3])))
    for k, option in enumerate([{"towards": (0, 1, 0)}, {"zoom": (0.2, 0.9, -0.4, 0.4)}, {"cut": True}]):
        other = picture(tmp_path / f"{k}.png", law, **option)
        assert other.shape != default.shape or np.abs(other - default).max() > 0.5


def check_box(region, *size):
    outside = outer_surface(region)
    a, b, c = size
    assert outside.area == pytest.approx(2 * (a * b + b * c + a * c), rel=0.02)
    assert sharp_edges(outside).compute_cell_sizes()["Length"].sum() == pytest.approx(4 * (a + b + c), rel=0.02)


def shape_of(grid, **options):
    return SolidShape.of(grid, Scene.of([grid], plotting.View(scale=0.01, **options)))


@pytest.mark.parametrize("name", ["pulled", "pushed"])
def test_bodies_have_twelve_edges_and_no_inner_faces(request, name):
    w, h, d = SIZE
    for state in request.getfixturevalue(name).values():
        for number, region in shape_of(gather_grid(state)).regions.items():
            check_box(region, w, h if number >= 0 else EPS, d)


def test_cut_leaves_the_half_behind(pulled):
    w, h, d = SIZE
    grid = gather_grid(pulled["meshed"])
    for front in (1.0, -1.0):
        shape = shape_of(grid, cut=True, towards=(0.5, 0.5, front))
        assert front * (shape.points[:, 2].mean() - d / 2) < 0
        for number, region in shape.regions.items():  # the lower one's fixed nodes are in the middle of the cut
            check_box(region, w, h if number >= 0 else EPS, d / 2)


def test_errors(pulled, tmp_path):
    plane = sandwich(1.0, 0.4, 0.4, 0.4)
    flat = solve(Structure(plane, body=BODY, supports={"BOTTOM": 0}, tractions={"TOP": (1, 0)}).interface(LAYER))
    for state, words, options in (
        (pulled["law"], "three components", {"towards": (0, 0, 0)}),
        (pulled["law"], "three components", {"towards": (1, np.nan, 0)}),
        (pulled["law"], "nothing to draw", {"zoom": (5, 6, 5, 6)}),
        (flat, "for three-dimensional structures", {"towards": (0, 0, 1)}),
        (flat, "for three-dimensional structures", {"cut": True}),
    ):
        refused(ValueError, words, plotting.deformed, state, plotting.View(**options))
