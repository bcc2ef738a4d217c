"""The paper's bar in contact has the numbers of independent codes, in two dimensions and three, by every solver."""

from __future__ import annotations

import numpy as np
import pytest

from forms import HolonomicCoulomb, IncrementalCoulomb, LinearElastic
from forms.base import InputError
from geometry import block, sandwich
from studies.problems import sliding_bar
from tests.contact_bars import SOLVERS, STIFFNESS, bar, contact, coulomb, solved, stacked
from tests.refused import refused
from thinlayer import Probe, RangeWarning, Structure, solve

COUNTS = {"stiff": (3, 15, 13), "middle": (2, 14, 15), "soft": (0, 0, 31)}  # separated, sliding, stick: Fig. 8
U_A = {"stiff": 1.456232e-2, "middle": 1.458569e-2, "soft": 4.094504e-2}  # independent code, same mesh
# independent code, 32 squares, Right diagonals: x -> u_T, u_N (mm), p, t (MPa)
PROFILE = {
    ("stiff", 10.0): (6.6257076e-3, 1.36591234e-8, 34.1478085, 34.1478085),
    ("stiff", 22.5): (1.18242437e-7, 2.6739011e-8, 66.8475279, 59.1212185),
    ("middle", 10.0): (6.7069911e-3, 1.39763293e-4, 34.9408232, 34.9408232),
    ("soft", 0.0): (4.09465749e-2, 9.73901949e-2, 2.43475487, 0.204732874),
}


def counts(report):
    return tuple(report.counts[name] for name in ("separated", "sliding", "stick"))


# ------------------------------------------------------------------------ section 8.2
@pytest.mark.parametrize("method", SOLVERS)
@pytest.mark.parametrize("case", STIFFNESS)
def test_figure_8(case, method):
    report = bar(31, coulomb(case), method=method)
    assert counts(report) == COUNTS[case]
    assert report.counts["pinned"] == 1
    assert report.u_T[0, 0] == pytest.approx(U_A[case], rel=1e-6)
    assert report.equilibrium < 1e-9
    assert report.clapeyron < 1e-9
    assert (np.abs(report.t_T[:, 0]) <= report.p * (1 + 1e-12)).all()


@pytest.mark.parametrize("case", STIFFNESS)
def test_profiles_on_another_mesh(case):
    report = bar(32, coulomb(case))
    for (name, x), values in PROFILE.items():
        if name == case:
            at = np.argmin(np.abs(report.x[:, 0] - x))
            computed = (report.u_T[at, 0], report.u_N[at], report.p[at], report.t_T[at, 0])
            assert computed == pytest.approx(values, rel=2e-6)
    assert np.abs(np.subtract(counts(report), COUNTS[case])).max() <= 1


@pytest.mark.parametrize("case", ["stiff", "middle"])
def test_a_long_bar_starts_from_shorter_lists_of_nodes(case):
    """From bonded springs Newton's method takes 4 or 5 steps, and more on finer meshes."""
    joint, setup = sliding_bar(128)
    assert solve(Structure(joint, **setup).interface(coulomb(case)), method="condensed").report.iterations <= 3


# ------------------------------------------------------------------------ three dimensions, curved S
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_three_dimensions(cell):
    """The cube loaded as the bar and held in z is in plane strain in the middle of its depth only; methods agree."""
    joint, setup = sliding_bar(5, depth=True)
    if cell == "hexahedron":
        joint, setup = block(40, 40, 8, depth=40, cell="hexahedron"), setup | {"element": "Q1"}
    reports = [solved(joint, coulomb("middle", 0.7), setup, method=method) for method in SOLVERS]
    for report in reports:
        assert report.u_T == pytest.approx(reports[0].u_T, rel=1e-7, abs=1e-10)
        assert (report.status == reports[0].status).all()
        assert (np.linalg.norm(report.t_T, axis=1) <= 0.7 * report.p * (1 + 1e-9)).all()
        assert report.equilibrium < 1e-9
    assert len({*reports[0].status}) >= 2
    assert np.abs(reports[0].t_T[:, 1]).max() > 1e-3 * np.abs(reports[0].t_T).max()
    columns = [reports[0].table[f"{name}_T_{k}"] for name in "ut" for k in (1, 2)]
    assert np.array_equal(columns, [*reports[0].u_T.T, *reports[0].t_T.T])


# ------------------------------------------------------------------------ elements of degree 2
CELLS = [("triangle", "strain"), ("triangle", "axisymmetric"), ("quadrilateral", "strain"), ("hexahedron", "strain")]


@pytest.mark.parametrize(("cell", "plane"), CELLS)
def test_a_uniform_pressure_passes_elements_of_degree_2(cell, plane):
    """The patch test, on meshes that do not repeat along S; the sides are apart by a gap before."""
    d, along_z = (3, {"depth": 2.0}) if cell == "hexahedron" else (2, {})
    supports = {"BOTTOM": {"y": 0}, "LEFT": {"x": 0}} | ({"BACK": {"z": 0}} if d == 3 else {})
    setup = {"body": LinearElastic.young(900.0, 0.0), "supports": supports, "tractions": {"TOP": (0, -5.0, 0)[:d]}}
    law = HolonomicCoulomb(800.0, 300.0, friction=0.4, gap=0.02)
    report = solved(sandwich(7.0, 2.0, 3.0, h=1.1, cell=cell, **along_z), law, setup | {"plane": plane})
    assert report.p == pytest.approx(5.0, rel=1e-10)
    assert report.u_N == pytest.approx(5.0 / 800, rel=1e-10)
    area = {"strain": 7.0 * 2.0 ** (d - 2), "axisymmetric": 49 * np.pi}[plane]
    assert report.normal_force == pytest.approx(5.0 * area, rel=1e-10)


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_solvers_agree_in_elements_of_degree_2(cell):
    """Where nodes separate, slide and stick; the forces, of middles too, balance the loads."""
    joint, setup = stacked(cell)
    model = Structure(joint, **setup | {"element": None}).interface(coulomb("middle"))
    states = [solve(model, method=method) for method in SOLVERS]
    for state in states:
        assert state.u.x.array == pytest.approx(states[0].u.x.array, abs=1e-9 * np.abs(states[0].u.x.array).max())
        report = contact(state)
        assert counts(report) == (5, 2, 6)
        assert report.force[1] == pytest.approx(72.0, rel=1e-9)  # of the load on top
        assert report.clapeyron < 1e-9


@pytest.mark.parametrize(("cell", "length"), [("triangle", 100.0), ("hexahedron", 50.0)])
def test_leaves_of_one_cell_bend_as_beams(cell, length):
    """Two leaves share the load at the tip: P L^3 / (6 E I). In degree 1 the tip moves a fifth of it."""
    along_z = {"depth": 4.0} if cell == "hexahedron" else {}
    joint = sandwich(length, 4.0, 4.0, h=4.0, cell=cell, structured=True, **along_z)
    load = {"supports": {"LEFT": 0}, "tractions": {"RIGHT/UPPER": (0, -2.5, 0)[: joint.dim]}}
    law = IncrementalCoulomb(K_N=1e6, K_T=1.0, friction=0.0)
    state = solve(Structure(joint, body=LinearElastic.young(210e3, 0.0), **load).interface(law))
    tip = Probe(state).displacement((length, -4.0, 2.0)[: joint.dim])[1]
    assert -tip == pytest.approx(2.5 * length**3 / (6 * 210e3 * 4.0**2 / 12), rel=5e-3)


def test_nearly_incompressible_bodies_lock_in_degree_1_alone_and_are_told():
    """A bonded block on a smooth base: an independent code has 2.4517 on a fine mesh."""
    joint, law = block(40.0, 20.0, h=4.0), IncrementalCoulomb(K_N=1e5, K_T=1.0, friction=0.0)
    setup = {"body": LinearElastic.young(1.4, 0.4995), "supports": {"TOP": {"x": 0, "y": -0.5}}}
    assert solve(Structure(joint, **setup).interface(law)).reaction("TOP").force[1] == pytest.approx(-2.4517, rel=0.015)
    with pytest.warns(RangeWarning, match="0.4995, and P1 locks .* use element='P2'"):
        assert solve(Structure(joint, **setup, element="P1").interface(law)).reaction("TOP").force[1] < -3
    solid = {"body": LinearElastic.young(1.4, 0.3), "supports": {"TOP": 0}}
    refused(InputError, "in P2 vertices .* hexahedra", Structure(block(4, 2, h=2, depth=2), **solid).interface, law)
