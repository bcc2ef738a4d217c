"""Files for ParaView, read again: stresses, tractions, jumps and internal variables against closed forms."""

from __future__ import annotations

import resource
from dataclasses import replace

import numpy as np
import pytest
import pyvista

from forms import LinearElastic, MohrCoulombMonodirectional, Stack
from forms.base import InputError
from geometry import faults, sandwich
from tests.fields_run import (
    BODY,
    CASES,
    EPS,
    SIZE,
    STRESS,
    K,
    axes,
    cell,
    on_a_base,
    slipping,
    uniform,
    write_all,
)  # fmt: skip
from tests.on_ranks import on_ranks
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, fields, march, plotting, solve

pytestmark = pytest.mark.few(5)

SIX = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


@pytest.fixture
def written(tmp_path, capfd):
    """Writes a solution and reads the blocks of its last time again; VTK must have nothing to complain of."""

    def write(solution, name="a.pvd"):
        fields.write(solution, tmp_path / name)
        blocks = last(tmp_path / name)
        assert "ERR" not in capfd.readouterr().err
        return blocks

    return write


def last(path):
    reader = pyvista.get_reader(path)
    reader.set_active_time_value(reader.time_values[-1])
    return reader.read()[0]


def packed(stress, nu):
    """Six components of a (d, d) stress; in 2D plane strain."""
    whole = np.zeros((3, 3))
    whole[: len(stress), : len(stress)] = stress
    if len(stress) == 2:
        whole[2, 2] = nu * np.trace(stress)
    return np.array([whole[i, j] for i, j in SIX])


@pytest.mark.few(3)
@pytest.mark.parametrize(("d", "cell_type", "element"), CASES)
def test_uniform_stresses_are_read_again(written, d, cell_type, element):
    """All times; traction and jump by hand; t_N and w_N along n, t_T and w_T along S."""
    structure, stress, jump = uniform(d, cell_type, element)
    blocks = written(march(structure.interface(ThinLayer(K, EPS, at=1.0)), [0.4, 1.0]))
    bodies, on_s = blocks["bodies"], blocks["S"]
    wanted = packed(stress, BODY.lmbda / (2 * (BODY.lmbda + BODY.mu)))
    assert bodies["stress"] == pytest.approx(np.tile(wanted, (bodies.n_cells, 1)), rel=1e-9, abs=1e-10)
    p, s = wanted[:3], wanted[3:]
    mises = np.sqrt(((p - np.roll(p, 1)) ** 2).sum() / 2 + 3 * (s**2).sum())
    assert bodies["von Mises"] == pytest.approx(mises, rel=1e-9)
    assert bodies.volume if d == 3 else bodies.area == pytest.approx(np.prod(SIZE[d]), rel=1e-9)
    assert list(bodies.field_data["regions"]) == ["LOWER", "UPPER"]

    n, t = axes(d)[1], STRESS[d][1] @ axes(d)
    for name, vector in {"traction": t, "jump": jump, "normal": n}.items():
        assert on_s[name][:, :d] == pytest.approx(np.tile(vector, (on_s.n_points, 1)), rel=1e-8, abs=1e-9), name
        assert not on_s[name][:, d:].any()
    assert on_s["u_upper"] - on_s["u_lower"] == pytest.approx(on_s["jump"], abs=1e-12)
    assert on_s["u"] == pytest.approx((on_s["u_upper"] + on_s["u_lower"]) / 2, abs=1e-12)
    assert on_s["t_N"] == pytest.approx(STRESS[d][1, 1], rel=1e-8)
    assert on_s["w_N"] == pytest.approx(STRESS[d][1, 1] / (K.lmbda + 2 * K.mu), rel=1e-8)
    for name, k in (("t_T", 1.0), ("w_T", K.mu)):
        along = STRESS[d][1] * np.array([1.0, 0.0, 1.0])[:d] / k @ axes(d)
        signed = along @ axes(d)[0]  # (n_2, -n_1) is the first turned axis
        wanted_there = np.full(on_s.n_points, signed) if d == 2 else np.tile(along, (on_s.n_points, 1))
        assert on_s[name] == pytest.approx(wanted_there, rel=1e-8, abs=1e-9)
        assert on_s[name] != pytest.approx(-wanted_there, rel=1e-2)
    area = on_s.compute_cell_sizes()["Area" if d == 3 else "Length"].sum()
    assert area == pytest.approx(np.prod(SIZE[d]) / SIZE[d][1], rel=1e-9)


def test_all_times_are_there(written, tmp_path):
    structure, stress, _ = uniform()
    written(march(structure.interface(ThinLayer(K, EPS, at=1.0)), [0.4, 0.7, 1.0]))
    reader = pyvista.get_reader(tmp_path / "a.pvd")
    assert reader.time_values == pytest.approx([0.0, 0.4, 0.7, 1.0])
    reader.set_active_time_value(0.4)
    assert reader.read()[0]["bodies"]["stress"][:, 0] == pytest.approx(0.4 * stress[0, 0], rel=1e-9)
    written(solve(structure.interface(ThinLayer(K, EPS, at=1.0))))
    assert sorted(path.name for path in (tmp_path / "a_pvd").iterdir()) == ["0000", "0000.vtm"]  # no old times


def test_meshed_layer_is_a_block(written):
    """Confined and pressed by p: across p everywhere, along it nu/(1 - nu) p, in bodies and layer."""
    joint = sandwich(2.0, 0.5, 0.7, 0.5)
    rollers = {"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    structure = Structure(joint, body=BODY, supports=rollers, tractions={"TOP": (0.0, -0.3)})
    blocks = written(solve(structure.full(ThinLayer(Stack((0.3, K), (0.7, LinearElastic(1.0, 5.0))), EPS, at=1.0))))
    assert list(blocks.keys()) == ["bodies", "layer"]
    laws = {"LOWER": BODY, "UPPER": BODY, "LAYER/1": K, "LAYER/2": LinearElastic(1.0, 5.0)}
    heights = {"LAYER/1": 0.3 * EPS, "LAYER/2": 0.7 * EPS}
    regions = list(blocks["layer"].field_data["regions"])
    assert sorted(regions) == sorted(laws)
    for part in blocks:
        for number in np.unique(part["region"]):
            name = regions[number]
            here, law = part["region"] == number, laws[name]
            along = -0.3 * law.lmbda / (law.lmbda + 2 * law.mu)
            wanted = np.tile([along, -0.3, along, 0.0, 0.0, 0.0], (here.sum(), 1))
            assert part["stress"][here] == pytest.approx(wanted, rel=1e-8, abs=1e-10), name
            if name in heights:
                assert part.extract_cells(here).area == pytest.approx(2.0 * heights[name])
    assert set(blocks["layer"]["seam"]) == {0}


@pytest.mark.parametrize("stacked", [False, True])
def test_slip_of_a_layer_is_what_its_traction_says(written, stacked):
    """t_T = mu (w_T - slip): the plastic strain in the file against traction and jump, which do not come from the law."""
    law = MohrCoulombMonodirectional(3.0, 2.0, cohesion=0.05, friction_angle=20.0, elastic_fraction=0.1)
    name, fraction = "plastic", 1.0
    if stacked:
        law, name, fraction = Stack((0.4, LinearElastic(4.0, 3.0)), (0.6, law)), "plastic 2", 0.6
    on_s = written(slipping(law=law))["S"]
    names = set(on_s.cell_data)
    assert name in names
    assert ("plastic" in names) != stacked
    assert set(on_s["status"]) <= {0, 1}
    assert list(on_s.field_data["status codes"])[:2] == ["0 elastic", "1 sliding"]
    t_T, w_T, n = (on_s.point_data_to_cell_data()[key] for key in ("t_T", "w_T", "normal"))
    tangent = np.column_stack([n[:, 1], -n[:, 0]])
    e = on_s[name]
    plastic = np.stack([e[:, [0, 3]], e[:, [3, 1]]], axis=1)
    slip = 2 * EPS * fraction * np.einsum("fi,fij,fj->f", tangent, plastic, n[:, :2])
    compliance = 1 / 2.0 if not stacked else 0.4 / 3.0 + 0.6 / 2.0
    inner = slice(2, -2)  # tractions are projected, jumps are of degree 2
    assert np.abs(slip).max() > 0.05
    order = np.argsort(centres_of(on_s))[inner]
    assert 0.9 * slip[order] == pytest.approx((w_T - compliance * t_T)[order], rel=2e-2)  # an elastic fraction of .1
    assert slip[order] != pytest.approx((w_T - compliance * t_T)[order], rel=5e-2)


def centres_of(block):
    """First coordinate of the centres of facets in 2D."""
    return block.points[block.cells_dict[4]][:, [0, -1], 0].mean(axis=1)


def test_contact(written):
    """Status, slip and pressure at nodes, as the report has them; the base does not move."""
    history = on_a_base()
    on_s, report = written(history)["S"], Surface(history.last.model).contact(history.last)
    codes = {code.split()[1]: int(code.split()[0]) for code in on_s.field_data["contact codes"]}
    place = [np.linalg.norm(report.x - x, axis=1).argmin() for x in on_s.points]
    assert [codes[str(status)] for status in report.status[place]] == list(on_s["contact"])
    assert len(set(report.status)) > 1
    free = report.status[place] != "pinned"
    assert -on_s["t_N"][free] == pytest.approx(report.p[place][free], rel=1e-6, abs=1e-9)
    slip = np.einsum("nk,nkj->nj", report.slip, report.frames[:, :-1])
    assert on_s["slip"] == pytest.approx(slip[place], abs=1e-12)
    assert np.abs(slip).max() > 1e-4
    assert not on_s["u_lower"].any()


def test_cells_at_periodic_sides_are_whole(written):
    state = cell()
    bodies = written(state)["bodies"]
    assert bodies.area == pytest.approx(np.prod(np.ptp(state.model.joint.points, axis=0)), rel=1e-9)
    sizes = bodies.compute_cell_sizes()["Area"]
    mean = (bodies["stress"] * sizes[:, None]).sum(axis=0) / sizes.sum()
    assert mean[[0, 1, 3]] == pytest.approx(state.mean_stress()[[0, 1, 0], [0, 1, 1]], rel=1e-9)


@pytest.mark.long
@on_ranks(write_all, 2)
def test_files_do_not_depend_on_the_ranks(tmp_path, there, their_folder):
    """To rounding, and in the same order."""
    write_all(tmp_path)
    for path in sorted(tmp_path.glob("*.pvd")):
        serial, two = last(path), last(their_folder / path.name)
        assert serial.keys() == two.keys()
        for a, b in zip(serial, two, strict=True):
            assert np.array_equal(a.cells, b.cells)
            assert a.points == pytest.approx(b.points, abs=1e-12)
            assert sorted(a.array_names) == sorted(b.array_names)
            for name in [*a.point_data, *a.cell_data]:
                size = np.nanmax(np.abs(a[name]))
                assert a[name] == pytest.approx(b[name], rel=1e-9, abs=1e-10 * size, nan_ok=True), name


def test_a_full_disk(tmp_path):
    """VTK's own writers end the process, or say nothing."""
    state = solve(uniform()[0].interface(ThinLayer(K, EPS, at=1.0)))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        refused(OSError, "too large", fields.write, state, tmp_path / "a.pvd")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
    for path in (tmp_path / "u.xdmf", None):
        refused(InputError, r"a file that ends in \.pvd", fields.write, state, path)


def test_names_in_any_language(written, tmp_path):
    """Of regions, seams and sides: in files for ParaView, tables, checkpoints and pictures."""
    joint = faults(1.3, 1.0, {"Stoßfuge": ((0.0, 0.4), (1.3, 0.4)), "шов": ((0.0, 0.7), (1.3, 0.7))}, 0.3)
    names = {"BLOCK 1": "Größe", "BLOCK 2": "层", "BLOCK 3": "ό"}
    facets = {{"TOP": "côté"}.get(name, name): rows for name, rows in joint.facets.items()}
    joint = replace(joint, regions=tuple(names[name] for name in joint.regions), facets=facets)
    structure = Structure(joint, body=K, supports={"BOTTOM": 0}, tractions={"côté": lambda x, t: (0.1 * t, 0.3)})
    model = structure.interface(ThinLayer(K, EPS, at=1.0))
    for case in (model, structure.full(ThinLayer(K, EPS, at=1.0))):
        history = march(case, [0.5, 1.0], observe={"größte": lambda state: 1.0}, out=tmp_path / f"ü{case.name}")
        mesh = written(history)
        assert {*names.values()} <= {*map(str, mesh[0].field_data["regions"])}
        assert "Stoßfuge" in map(str, mesh[-1 if case is model else 0].field_data["seams"])
        history.table.write(tmp_path / "größe.csv")
        assert "größte" in (tmp_path / "größe.csv").read_text(encoding="utf-8")
        march(case, [0.5, 1.0, 1.5], observe={"größte": lambda state: 1.0}, out=tmp_path / f"ü{case.name}", resume=True)
    surface = Surface(model)
    plotting.along(surface, {"größte": surface.traction(solve(model, 1.0))}, save=tmp_path / "层.png")
