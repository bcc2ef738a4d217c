"""Values along S by arc length: pieces of seams, closed ones, junctions, cuts in 3D."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from forms import LinearElastic
from forms.base import InputError
from geometry import grains, ring, sandwich, wall
from tests.fields_run import BODY, EPS, K, axes, uniform
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, solve
from thinlayer.surface.lines import Line

LAYER = ThinLayer(K, EPS, at=1.0)
PULLED = {"supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.05, -0.1)}}


def interface(joint, layer=LAYER, **data):
    return Structure(joint, body=BODY, **(PULLED | data)).interface(layer)


def test_a_straight_seam():
    surface = Surface(interface(sandwich(2.0, 0.5, 0.7, 0.25).rotated(0.4)))
    t = surface.traction(solve(surface.model))
    (line,) = surface.along(t)
    x, values = surface.profile(t)
    assert (line.seam, line.closed) == ("S", False)
    assert line.x == pytest.approx(x, abs=1e-12)
    assert line.values == pytest.approx(values, rel=1e-12)
    assert line.s == pytest.approx(x @ axes(2)[0], abs=1e-12)
    (normal,) = surface.along(surface.frame(t)[1])
    assert normal.values == pytest.approx(values @ axes(2)[1], rel=1e-9, abs=1e-12)
    assert line.length == pytest.approx(2.0)


def test_a_line_as_a_csv_file(tmp_path):
    x, values = np.array([[1.0, 2.0], [1.5, 2.0]]), np.array([[3.0, -1.0], [4.0, 7.0]])
    line = Line("S", np.array([0.0, 0.5]), x, values, False)
    line.table("t").write(tmp_path / "along.csv")
    rows = ["s,x,y,t x,t y", "0.0,1.0,2.0,3.0,-1.0", "0.5,1.5,2.0,4.0,7.0"]
    assert (tmp_path / "along.csv").read_text().splitlines() == rows
    assert replace(line, values=line.values[:, 0]).table("t_N").columns == ["s", "x", "y", "t_N"]


def test_a_closed_seam():
    """A circle of curved facets: the arc, not its chords; it starts at its lowest place and comes back to it."""
    joint = ring(1.0, 1.5, 2.0, h=0.4, degree=2)
    model = interface(joint, supports={"INSIDE": 0.0}, tractions={"OUTSIDE": lambda x, t: (0.1 * x[0], 0.05 * x[1])})
    (line,) = (surface := Surface(model)).along(surface.x)
    assert line.closed
    assert line.length == pytest.approx(2 * np.pi * 1.5, rel=1e-4)
    assert line.length != pytest.approx(np.linalg.norm(np.diff(line.x, axis=0), axis=1).sum(), rel=1e-4)
    assert line.x[0] == pytest.approx(line.x[-1])
    assert line.values[0] == pytest.approx(line.values[-1])
    assert line.x[:, 0].argmin() in (0, len(line.x) - 1)
    angle = np.unwrap(np.arctan2(line.x[:, 1], line.x[:, 0]))
    assert np.abs(angle - angle[0]) * 1.5 == pytest.approx(line.s, rel=1e-4, abs=1e-6)
    assert line.values == pytest.approx(line.x, rel=2e-2, abs=2e-2)  # a projection of a curve to degree 1


def test_beds_and_heads_of_a_wall():
    """Beds are whole, with two rows where a head meets them and the traction jumps; sums of forces are the load."""
    joint = wall(2, 3, brick=(2.0, 1.0), h=0.5)
    surface = Surface(interface(joint, {"BED": LAYER, "HEAD": ThinLayer(LinearElastic(1.0, 0.7), 0.2, at=1.0)}))
    lines = surface.along(surface.traction(solve(surface.model)))
    beds = [line for line in lines if line.seam == "BED"]
    assert [line.x[0, 1] for line in beds] == pytest.approx([1.0, 2.0])
    for line in beds:
        assert line.length == pytest.approx(4.0)
        twice = np.flatnonzero(np.diff(line.s) == 0)
        assert line.x[twice, 0] == pytest.approx([1.0, 2.0, 3.0])
        assert (np.abs(np.diff(line.values, axis=0)[twice]).max(axis=1) > 1e-6).all()
        assert np.trapezoid(line.values, line.s, axis=0) == pytest.approx([0.05 * 4, -0.1 * 4], rel=1e-9)
    assert [line.length for line in lines if line.seam == "HEAD"] == pytest.approx([1.0] * 4)
    assert len(lines) == 2 + 4


def test_grains_meet_at_the_ends_of_lines():
    surface = Surface(interface(grains(3.0, 2.0, 6, h=0.3, seed=2)))
    lines = surface.along(surface.x)
    assert sum(line.length for line in lines) == pytest.approx(surface.integral(1.0))
    joint = surface.model.joint
    _, times = np.unique(joint.table.vertices[joint.surface_rows], return_counts=True)
    triple = int((times == 3).sum())
    assert 2 * len(lines) == 3 * triple + int((times == 1).sum())
    assert triple > 2
    starts = [tuple(line.x[0].round(9)) for line in lines]
    assert starts == sorted(starts)


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_cut_of_a_plane(cell):
    """Between nodes, along them, along both sides of S."""
    joint = sandwich(2.0, 0.5, 0.7, 0.5, depth=1.0, cell=cell, structured=True)
    surface = Surface(interface(joint, supports={"BOTTOM": 0}, tractions={"TOP": (0.05, -0.1, 0.02)}))
    for z in (0.3, 0.5, 0.0, 1.0):
        (line,) = surface.along(surface.x, plane=((0, 0, z), (0, 0, 2.0)))
        assert line.s == pytest.approx(line.x[:, 0], abs=1e-12)
        assert line.length == pytest.approx(2.0)
        assert line.values == pytest.approx(line.x, abs=1e-9)
        assert (np.diff(line.s) > 0).all()
    (tilted,) = surface.along(surface.x[0], plane=((0.5, 0, 0), (1.0, 0.3, 0.5)))
    assert tilted.length == pytest.approx(np.hypot(1.0, 0.5))
    assert tilted.values == pytest.approx(tilted.x[:, 0], abs=1e-9)
    assert tilted.values.ndim == 1


def test_cut_of_a_cylinder():
    surface = Surface(interface(ring(1.0, 1.5, 2.0, h=0.6, depth=1.0), supports={"INSIDE": 0.0}, tractions={}))
    (line,) = surface.along(surface.x, plane=((0, 0, 0.4), (0, 0, 1)))
    assert line.closed
    assert line.x[:, 2] == pytest.approx(0.4)
    assert line.length == pytest.approx(2 * np.pi * 1.5, rel=2e-2)
    assert line.x[0] == pytest.approx(line.x[-1])
    halves = surface.along(surface.x, plane=((0, 0, 0), (0.0, 1.0, 0.0)))
    assert [half.length for half in halves] == pytest.approx([1.0, 1.0])


def test_what_is_no_line():
    plane = Surface(interface(sandwich(2.0, 0.5, 0.7, 0.5)))
    refused(InputError, "in 2D S is a line", lambda: plane.along(plane.x, plane=((0, 0, 0), (1, 0, 0))))
    refused(InputError, "'traction' is not a field on S", lambda: plane.along("traction"))
    solid = Surface(uniform(3)[0].interface(LAYER))
    refused(InputError, "cuts by a plane", lambda: solid.along(solid.x))
    for wrong in (((0, 0), (1, 0)), ((0, 0, 0), (0, 0, 0)), "z"):
        refused(InputError, r"it must be \(point, normal\)", solid.along, solid.x, plane=wrong)
    refused(InputError, "does not cut S", lambda: solid.along(solid.x, plane=((0, 0, 5), (0, 0, 1))))


def numbers() -> dict[str, list]:
    tables = {}
    flat = Surface(interface(wall(2, 3, brick=(2.0, 1.0), h=0.5)))
    solid = Surface(uniform(3)[0].interface(LAYER))
    for name, surface, plane in (("flat", flat, None), ("solid", solid, ((1.0, 0, 0.3), (0.2, 0.1, 1.0)))):
        for k, line in enumerate(surface.along(surface.jump(solve(surface.model)), plane=plane)):
            tables[f"{name} {k}"] = np.column_stack([line.s, line.x, line.values]).tolist()
    return tables
