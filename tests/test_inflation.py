"""Inflation in three dimensions, of curved S and of curved cells: volumes, counts, names, room."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from forms.base import InputError
from geometry import block, disc, ring, sandwich
from geometry.inflating.inflation import inflate
from geometry.joint import Joint
from geometry.sheet import volume_of
from tests.meshes import check_sound, grid, in_layer, volumes
from tests.refused import refused

pytestmark = pytest.mark.few(5)

SIZES = (1e-1, 1e-2, 1e-3, 1e-4)
BOX, TUBE = dict(depth=0.8, h_S=0.2), dict(angle=np.pi / 2, depth=0.6)
FINE = dict(h_S=0.2, h_ends=0.05)
JOINTS = {
    "square, triangles": lambda: block(2.0, 1.5, 0.5, **FINE).rotated(0.4),
    "square, quadrilaterals": lambda: sandwich(2.0, 0.8, 1.1, 0.4, cell="quadrilateral", **FINE).rotated(0.4),
    "box, tetrahedra": lambda: sandwich(1.0, 0.5, 0.6, 0.4, **BOX),
    "box, hexahedra": lambda: sandwich(1.0, 0.5, 0.6, 0.4, cell="hexahedron", **BOX),
    "base, tetrahedra": lambda: block(1.0, 0.6, 0.3, depth=0.8),
    "disc, tetrahedra": lambda: disc(1.0, 0.5, 0.4, 0.4),
    "disc, curved tetrahedra": lambda: disc(1.0, 0.5, 0.4, 0.4, degree=2),
    "disc, curved hexahedra": lambda: disc(1.0, 0.5, 0.4, 0.4, cell="hexahedron", degree=2, hole=0.3),
    "ring": lambda: ring(1.0, 1.5, 2.0, 0.3),
    "ring, curved": lambda: ring(1.0, 1.5, 2.0, 0.3, degree=2),
    "ring, curved quadrilaterals": lambda: ring(1.0, 1.5, 2.0, 0.3, cell="quadrilateral", degree=2),
    "tube, curved tetrahedra": lambda: ring(1.0, 1.5, 2.0, 0.4, degree=2, **TUBE),
    "tube, curved hexahedra": lambda: ring(1.0, 1.5, 2.0, 0.3, degree=2, cell="hexahedron", **TUBE),
    "tube, hexahedra": lambda: ring(1.0, 1.5, 2.0, 0.3, cell="hexahedron", **TUBE),
}
PLANAR = [name for name in JOINTS if name.split(",")[0] in ("box", "base", "disc", "square")]


@cache
def joint_of(name: str) -> Joint:
    return JOINTS[name]()


def check(base: Joint, opened: Joint, eps: float, area: float, kept_volume: float) -> None:
    """What holds for every layer of uniform thickness: nothing folded, volumes, faces, names."""
    n = len(base.cells)
    assert volume_of(base, np.ones(n, bool)) == pytest.approx(volumes(base).sum(), rel=0.02)  # of faces alone
    check_sound(opened, opened.facets.keys() - {"LOWER_FACE", "UPPER_FACE"}, base)
    cell_volumes = volumes(opened)
    assert cell_volumes[n:].sum() == pytest.approx(eps * area, rel=0.02)
    extra = cell_volumes[n:].sum() if opened.band.bodies == "kept" else 0.0
    assert cell_volumes.sum() == pytest.approx(volumes(base).sum() + extra, rel=kept_volume)
    low = opened.facets["BASE" if base.rigid_base else "LOWER_FACE"]
    assert len(low) == len(opened.facets["UPPER_FACE"]) == len(base.surface)
    for rows in (rows for name, rows in opened.facets.items() if name.endswith("/LAYER")):
        assert in_layer(opened)[opened.table.cells[opened.table.index(rows), 0]].all()


@pytest.mark.few(8)
@pytest.mark.parametrize(("name", "bodies"), [*((n, "kept") for n in PLANAR), *((n, "extended") for n in JOINTS)])
def test_any_joint(name, bodies):
    base = joint_of(name)
    size = 0.8 if base.dim == 3 and "box" in name else 1.0
    area = {"square": 2.0, "box": 0.8, "base": 0.8, "ring": 3 * np.pi, "tube": 0.75 * np.pi * 0.6}
    area["disc"] = np.pi * (0.91 if "hexa" in name else 1.0)
    smooth_only = name in ("disc, tetrahedra", "disc, curved tetrahedra")  # facets of their sides incline to the axis
    counts = set()
    for eps in SIZES:
        opened = inflate(base, eps * size, cells_through=2, bodies=bodies)
        check(base, opened, eps * size, area[name.split(",")[0]], 1e-4 if smooth_only else 1e-9)
        counts.add((len(opened.cells), len(opened.points)))
    assert len(counts) == 1


def test_side_faces_continue_their_names():
    opened = inflate(joint_of("box, tetrahedra"), 0.05, cells_through=3)
    for name, axis, value in (("LEFT", 0, 0.0), ("RIGHT", 0, 1.0), ("BACK", 2, 0.0), ("FRONT", 2, 0.8)):
        x = opened.points[opened.facets[f"{name}/LAYER"]]
        assert x[..., axis] == pytest.approx(value)
        assert np.ptp(x[..., 1]) == pytest.approx(0.05)
    opened = inflate(joint_of("tube, hexahedra"), 0.05, cells_through=3, bodies="extended")
    assert opened.points[opened.facets["START/LAYER"]][..., 1] == pytest.approx(0.0, abs=1e-12)
    assert opened.points[opened.facets["END/LAYER"]][..., 0] == pytest.approx(0.0, abs=1e-12)
    assert "INSIDE/LAYER" not in opened.facets


@pytest.mark.parametrize("name", ["ring, curved", "ring, curved quadrilaterals", "tube, curved hexahedra"])
def test_curved_cells_stay_curved(name):
    """All nodes of the layer lie on circles, those half-way too, and the outer sides do not move.

    Nodes half-way between two vertices of S get the mean of their thicknesses, as the interface model has it.
    """
    base, eps = joint_of(name), 0.1
    opened = inflate(base, eps, cells_through=2, bodies="extended")
    radius = np.hypot(*opened.points[:, :2].T)
    levels = np.unique(np.round((radius[opened.cells[in_layer(opened)]] - 1.5) / eps, 3))
    assert levels == pytest.approx([-0.5, -0.25, 0.0, 0.25, 0.5], abs=2e-3)  # P2 circles: fourth order in the cell size
    for side, value in (("INSIDE", 1.0), ("OUTSIDE", 2.0)):
        nodes = opened.table.nodes(opened.table.index(opened.facets[side]), opened.cells, opened.cell_type)
        assert radius[nodes] == pytest.approx(value, abs=1e-6)
    eps, profile = 1e-3, lambda x: 1 + 0.5 * np.sin(x[0] + 2 * x[-1] + 0.3)
    opened = inflate(base, eps, cells_through=1, bodies="extended", profile=profile)
    corners = base.surface[:, : len(opened.facets["UPPER_FACE"][0])]
    out = np.hypot(*opened.points[:, :2].T)[: len(base.points)] - np.hypot(*base.points[:, :2].T)  # S's nodes go up
    assert 2 * out[corners] == pytest.approx(eps * profile(np.moveaxis(base.points[corners], -1, 0)), rel=1e-3)
    along = base.surface[:, 2] if base.dim == 2 else base.surface[:, 4]  # half-way along the facet's first edge
    assert out[along] == pytest.approx(out[corners[:, :2]].mean(axis=1), rel=1e-3)


@pytest.mark.few(1)
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron", "quadrilateral", "triangle"])
def test_edges_and_corners_of_s(cell):
    """A cube in a block: every facet of S gets its thickness, however many facets meet at a corner."""
    dim = 3 if cell in ("hexahedron", "tetrahedron") else 2
    base = grid([np.linspace(0.0, 1.0, 4)] * dim, lambda x: (np.abs(x - 0.5) < 0.2).all(axis=1), cell)
    eps = 0.01
    opened = inflate(base, eps, cells_through=1, bodies="extended")
    out = opened.points[base.surface] - base.points[base.surface]  # S's nodes become those of the upper face
    assert np.einsum("fkd,fkd->fk", out, base.node_normals) == pytest.approx(eps / 2, rel=1e-9)
    area, edge = 2 * dim * 3.0 ** (1 - dim), {2: 0.0, 3: 12 / 3}[dim]
    assert volumes(opened)[len(base.cells) :].sum() == pytest.approx(eps * area, rel=2e-3 if edge else 1e-9)


@pytest.mark.few(1)
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron", "quadrilateral"])
def test_no_room_between_aligned_grids(cell):
    """The lower body is a C that reaches over the upper one: moved apart, they would meet."""
    y = np.array([-1.0, 0.0, 1.0, 1.1, 2.0])
    axes = [np.array([0.0, 1.0, 2.0, 3.0]), y, *([np.array([0.0, 1.0])] if cell != "quadrilateral" else [])]
    gap = lambda x: (x[:, 1] > 0) & (x[:, 1] < 1.1) & (x[:, 0] > 1)  # beside the back of the C
    block_in_it = lambda x: (x[:, 0] > 2) & (x[:, 1] > 0) & (x[:, 1] < 1)
    joint = grid(axes, block_in_it, cell, keep=lambda x: ~gap(x) | block_in_it(x))
    inflate(joint, 0.05)
    refused(InputError, r"no room for a layer of thickness 0.2 at \(", lambda: inflate(joint, 0.2))
