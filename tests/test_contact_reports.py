"""Reports of contact give zones, forces, tractions and pictures; a similar state saves steps; bad models are refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from forms import LinearElastic
from forms.base import InputError
from studies.problems import sliding_bar
from tests.contact_bars import bar, contact, coulomb, solved, stacked
from tests.pictures import assert_coloured, assert_drawn
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, plotting, solve
from thinlayer.discretisation.contact_nodes import normal_frames
from thinlayer.output.plotting.scene import interpolate_to_parts


# ------------------------------------------------------------------------ reports and pictures
def test_report():
    report = bar(31, coulomb("stiff"))
    assert [z.status for z in report.zones] == ["separated", "sliding", "stick", "pinned"]
    assert (sum(z.size for z in report.zones), report.zones[1].size) == pytest.approx((40.0, 15 * 40 / 31))
    assert report.normal_force == pytest.approx(1954.37527, rel=1e-7)  # independent code
    assert report.friction_force[0] == pytest.approx(1080.22163, rel=1e-7)
    assert report.force == pytest.approx([-1080.22163, 1954.37527], rel=1e-7)
    assert report.table.columns == ["x", "y", "u_T", "u_N", "p", "t_T", "status"]
    assert "3 separated, 15 sliding, 13 stick, 1 pinned" in str(report)
    joint, setup = stacked()  # a support that holds one side alone pins no node
    setup["supports"] = {"BOTTOM": 0.0, "RIGHT/UPPER": 0.0}
    assert solved(joint, coulomb("middle"), setup).counts["pinned"] == 0


@pytest.mark.parametrize("make", [lambda: sliding_bar(12), stacked], ids=["base", "bodies"])
def test_traction_of_the_surface_is_that_of_the_nodes(make):
    joint, setup = make()
    state = solve(Structure(joint, **setup).interface(coulomb("middle")))
    surface, report = Surface(state.model), Surface(state.model).contact(state)
    x, t = surface.profile(surface.frame(surface.traction(state)))
    assert x == pytest.approx(report.x, abs=1e-9)
    assert -t[:, 1] == pytest.approx(report.p, rel=1e-7, abs=1e-7)
    assert t[:, 0] == pytest.approx(report.t_T[:, 0], rel=1e-7, abs=1e-7)  # at the last node, that a support holds, too


def test_frames_in_three_dimensions():
    """The smallest rotation that takes e_2 to the normal, and a half turn where there is none."""
    normals = np.random.default_rng(5).normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    for n, frame in zip(normals, normal_frames(normals), strict=True):
        axis = np.cross((0.0, 1.0, 0.0), n)
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.arccos(n[1])).as_matrix()
        assert frame == pytest.approx(turn[:, [0, 2, 1]].T, abs=1e-12)
    axes = np.array([(-1, 0, 0), (0, 0, 1), (0, -1, 0)])
    assert normal_frames(np.array([[0.0, -1.0, 0.0]]))[0] == pytest.approx(axes)


def test_pictures(tmp_path):
    middle, soft = bar(12, coulomb("middle")), bar(12, coulomb("soft"))
    options = {"save": tmp_path / "two.png", "length": "mm", "stress": "MPa"}
    plotting.along(middle.surface, {"a": middle, "b": soft}, **options)
    joint, setup = sliding_bar(4, depth=True)
    solid = solve(Structure(joint, **setup).interface(coulomb("middle")))
    report = contact(solid)
    picture = plotting.on_surface(solid, lambda surface, state: report.status, save=tmp_path / "solid.png")
    assert_coloured(picture, {*report.status.tolist()})
    plotting.on_surface({"p": solid}, report.p, save=tmp_path / "p.png", quantity="p")
    assert_drawn(tmp_path / "two.png", tmp_path / "solid.png", tmp_path / "p.png")
    refused(InputError, "along: fields is empty", lambda: plotting.along(middle.surface, {}))
    refused(InputError, "3 components", lambda: plotting.on_surface(solid, Surface.jump))
    refused(InputError, "is not a field on S", lambda: plotting.on_surface(solid, np.array(["a"])))
    refused(InputError, "states is empty", lambda: plotting.on_surface({}, Surface.status))


def test_colours_of_a_corner_fill_the_quarter_of_the_facet_around_it():
    square = np.array([[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]])
    for corner, part in zip(square[0], interpolate_to_parts(square)[0], strict=True):
        assert part.mean(axis=0) == pytest.approx(corner / 2 + 1 / 4)


# ------------------------------------------------------------------------ status known before
@pytest.mark.parametrize("method", ["condensed", "multigrid"])
def test_a_similar_state_saves_steps(method):
    joint, setup = sliding_bar(31)
    near = setup | {"tractions": {"LEFT": (97.0, 0.0), "TOP": (0.0, -50.0)}}
    like = solve(Structure(joint, **near).interface(coulomb("stiff")), method=method)
    model = Structure(joint, **setup).interface(coulomb("stiff"))
    cold, warm = solve(model, method=method), solve(model, method=method, like=like)
    assert warm.report.iterations <= cold.report.iterations
    assert warm.u.x.array == pytest.approx(cold.u.x.array, rel=1e-8, abs=1e-10)


# ------------------------------------------------------------------------ bad input
def test_refused_models():
    joint, setup = sliding_bar(4)
    law = coulomb("middle")
    refused(InputError, "alone", lambda: ThinLayer(law, 0.1, profile=lambda x: 1 + x[0], at=1.0))
    refused(InputError, "contact law", lambda: contact(solve(Structure(joint, **setup).bonded())))
    two, data = stacked()
    refused(InputError, "rigid motion", lambda: Structure(two, **data | {"supports": {}}).interface(law))


def test_refused_solves():
    joint, setup = sliding_bar(4)
    model = Structure(joint, **setup).interface(coulomb("middle"))
    elastic = Structure(joint, **setup).interface(ThinLayer(LinearElastic(1.0, 1.0), 0.1, at=1.0))
    askew = Structure(joint.rotated(0.3), **setup | {"supports": {"RIGHT": {"x": 0.0}}}).interface(coulomb("middle"))
    squared = Structure(joint, **setup | {"element": "P2"}).interface(elastic.on_seams)
    other, data = sliding_bar(5)
    rows = [
        (ValueError, "condensed", model, {"method": "linear"}),
        (InputError, "supports along the axes of S at its nodes", askew, {"method": "relaxation"}),
        (InputError, "like", model, {"like": 3}),
        (InputError, "same element and bonds", elastic.structure.bonded(), {"like": solve(elastic)}),
        (InputError, "same element and bonds", elastic, {"like": solve(squared)}),
        (InputError, "same joint", model, {"like": solve(Structure(other, **data).interface(coulomb("middle")))}),
    ]
    for kind, words, case_model, choices in rows:
        refused(kind, words, solve, case_model, **choices)
    for name, value in {"omega": 2.5, "tolerance": 0.0, "max_sweeps": 0}.items():
        refused(InputError, "allowed", solve, model, method="relaxation", options={f"relaxation_{name}": value})
    for name in ("snes_max_it", "relaxation_omga", "ksp_type"):
        refused(InputError, "not read", solve, model, method="condensed", options={name: "many"})
