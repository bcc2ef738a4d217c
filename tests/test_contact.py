"""Contact models: the paper's bar, symmetries, memory, what must raise; every solver gives the same answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
import ufl
from dolfinx import fem
from scipy.spatial.transform import Rotation

from forms import BulkLaw, ContactLaw, HolonomicCoulomb, IncrementalCoulomb, LawError, LinearElastic, Tresca
from forms.elastic import lame
from geometry import block, ring, sandwich
from studies.problems import BAR, sliding_bar
from tests.contact_run import to_and_fro
from thinlayer import (
    ModelError,
    OptionError,
    SolveError,
    Structure,
    Surface,
    ThinLayer,
    compare,
    march,
    piecewise,
    plotting,
    solve,
)
from thinlayer.discretisation import contact_nodes as nodes_module
from thinlayer.discretisation.contact_nodes import ContactNodes
from thinlayer.output.contact_report import ContactReport
from thinlayer.solving.contact import dense

SOLVERS = ("condensed", "multigrid", "newton")
STIFFNESS = {"stiff": (15e8, 5e8), "middle": (15e4, 5e4), "soft": (15.0, 5.0)}
COUNTS = {"stiff": (3, 15, 13), "middle": (2, 14, 15), "soft": (0, 0, 31)}  # separated, sliding, stick: Fig. 8
U_A = {"stiff": 1.456232e-2, "middle": 1.458569e-2, "soft": 4.094504e-2}  # independent code, same mesh
# independent code, 32 squares, Right diagonals: x -> u_T, u_N (mm), p, t (MPa)
PROFILE = {
    ("stiff", 10.0): (6.6257076e-3, 1.36591234e-8, 34.1478085, 34.1478085),
    ("stiff", 22.5): (1.18242437e-7, 2.6739011e-8, 66.8475279, 59.1212185),
    ("middle", 10.0): (6.7069911e-3, 1.39763293e-4, 34.9408232, 34.9408232),
    ("middle", 20.0): (1.12851861e-3, 2.40522203e-4, 60.1305509, 56.4259303),
    ("soft", 0.0): (4.09465749e-2, 9.73901949e-2, 2.43475487, 0.204732874),
    ("soft", 17.5): (2.84521249e-2, 8.08906376e-2, 2.02226594, 0.142260624),
}


def solved(joint, law, setup, **choices):
    return ContactReport(solve(Structure(joint, **setup).interface(law), **choices))


def bar(n, law, **choices):
    joint, setup = sliding_bar(n)
    return solved(joint, law, setup, **choices)


def coulomb(name, friction=1.0):
    return HolonomicCoulomb.of_layer(*STIFFNESS[name], friction=friction)


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
            found = (report.u_T[at, 0], report.u_N[at], report.p[at], report.t_T[at, 0])
            assert found == pytest.approx(values, rel=2e-6)
    assert np.abs(np.subtract(counts(report), COUNTS[case])).max() <= 1


def test_wrong_readings_of_section_8_are_rejected():
    lmbda, mu = STIFFNESS["middle"]
    wrong = {
        "K_N without the 2": bar(31, HolonomicCoulomb(lmbda + mu, mu, 1.0)),
        "pulled to the other side": _with_load(-100.0),
        "f = 0.9": bar(31, coulomb("middle", 0.9)),
    }
    for name, report in wrong.items():
        assert abs(report.u_T[0, 0] / U_A["middle"] - 1) > 1e-3, name


def _with_load(x):
    joint, setup = sliding_bar(31)
    return solved(joint, coulomb("middle"), setup | {"tractions": {"LEFT": (x, 0.0), "TOP": (0.0, -50.0)}})


def test_signorini_limit():
    """The limit's own solution, from an independent code on the same mesh, with an error of order 1/K."""
    limit = 1.45623169e-2
    laws = [HolonomicCoulomb.of_layer(3 * k, k, friction=1.0) for k in (5e6, 5e7)]
    errors = [abs(bar(31, law).u_T[0, 0] - limit) for law in laws]
    assert errors[0] < 1e-5
    assert errors[1] < 0.2 * errors[0]


# ------------------------------------------------------------------------ symmetries
@pytest.mark.parametrize(
    "law", [coulomb("middle"), IncrementalCoulomb(4e5, 6e4, 0.6)], ids=lambda law: type(law).__name__
)
def test_twice_the_load_gives_twice_the_displacement(law):
    joint, setup = sliding_bar(12)
    double = {name: tuple(2 * c for c in load) for name, load in setup["tractions"].items()}
    one, two = solved(joint, law, setup), solved(joint, law, setup | {"tractions": double})
    assert two.u_T == pytest.approx(2 * one.u_T, rel=1e-9, abs=1e-12)
    assert two.p == pytest.approx(2 * one.p, rel=1e-8, abs=1e-8)
    assert (two.status == one.status).all()


@pytest.mark.parametrize("kind", [HolonomicCoulomb, IncrementalCoulomb])
def test_one_step_is_ten_proportional_steps(kind):
    joint, setup = sliding_bar(12)
    law = kind(4e5, 6e4, 0.6)
    once = solved(joint, law, setup)
    growing = {"LEFT": lambda x, t: (100 * t, 0), "TOP": lambda x, t: (0, -50 * t)}
    model = Structure(joint, **setup | {"tractions": growing}).interface(law)
    history = march(model, [0.1 * k for k in range(1, 11)])
    last = ContactReport(history.last)
    assert last.u_T == pytest.approx(once.u_T, rel=1e-7, abs=1e-11)
    assert (last.status == once.status).all()
    if kind is IncrementalCoulomb:
        table = history.table
        assert np.nanmax(np.abs(table["imbalance"])) < 1e-9
        assert (table["dissipated"] > -1e-12).all()
        assert table["dissipated"][-1] > 0


def test_mirrored_bar():
    """x -> 40 - x, with the diagonals and the loads."""
    left, setup = sliding_bar(12, arrangement="Left")
    setup |= {
        "supports": {"LEFT": {"x": 0.0}, (0.0, 0.0): 0.0},
        "tractions": {"RIGHT": (-100.0, 0.0), "TOP": (0.0, -50.0)},
    }
    one, two = bar(12, coulomb("middle")), solved(left, coulomb("middle"), setup)
    assert two.u_T[::-1] == pytest.approx(-one.u_T, abs=1e-11)
    assert two.p[::-1] == pytest.approx(one.p, rel=1e-8, abs=1e-8)
    assert (two.status[::-1] == one.status).all()


def lift(x, _):
    """Pulls at the left, presses at the right."""
    return 0.0, 6 - 6 * x[0]


def stacked(cell="quadrilateral"):
    """Two bodies of different stiffness, the upper one pushed onto the lower and to the right."""
    joint = sandwich(6, 3, 2, 0.5, cell=cell, structured=True)
    bodies = {"LOWER": LinearElastic.young(5e3, 0.3), "UPPER": LinearElastic.young(9e3, 0.2)}
    setup = {
        "body": bodies,
        "supports": {"BOTTOM": 0.0, "RIGHT/UPPER": {"x": 0.0}},
        "tractions": {"LEFT/UPPER": (60.0, 0.0), "TOP": lift},
        "element": "Q1" if cell == "quadrilateral" else "P1",
    }
    return joint, setup


@pytest.mark.parametrize("method", SOLVERS)
def test_swapped_bodies(method):
    """Calling the upper body the lower one turns n: the same jumps, seen from the other side."""
    law = HolonomicCoulomb(7e4, 2e4, 0.5)
    joint, setup = stacked()
    one = solved(joint, law, setup, method=method)
    two = solved(joint.swapped(), law, setup, method=method)
    assert {"separated", "sliding"} <= {*one.status}
    at = np.argsort(one.x[:, 0]), np.argsort(two.x[:, 0])
    assert two.p[at[1]] == pytest.approx(one.p[at[0]], rel=1e-7, abs=1e-7)
    assert np.abs(two.u_T[at[1]]) == pytest.approx(np.abs(one.u_T[at[0]]), rel=1e-7, abs=1e-11)
    assert (two.status[at[1]] == one.status[at[0]]).all()
    assert two.force == pytest.approx(-one.force, rel=1e-7)


@pytest.mark.parametrize("method", SOLVERS)
def test_a_rigid_lower_body_is_a_base(method):
    joint, setup = stacked()
    law = HolonomicCoulomb(7e4, 2e4, 0.5)
    rigid = setup | {"body": setup["body"] | {"LOWER": LinearElastic.young(1e12, 0.3)}}
    one = solved(joint, law, rigid, method=method)
    base = block(6, 2, 0.5, cell="quadrilateral")
    loads = {"LEFT": (60.0, 0.0), "TOP": lift}
    alone = {"body": setup["body"]["UPPER"], "supports": {"RIGHT": {"x": 0.0}}, "tractions": loads, "element": "Q1"}
    two = solved(base, law, alone, method=method)
    assert one.u_T == pytest.approx(two.u_T, rel=1e-5, abs=1e-9)
    assert (one.status == two.status).all()


@pytest.mark.parametrize("angle", [0.4, 2.5])
def test_rotated_structure(angle):
    """Frames of nodes: the same answer when everything is turned, supports by coordinates apart."""
    joint, setup = stacked("triangle")
    setup["supports"] = {"BOTTOM": 0.0}
    law = HolonomicCoulomb(7e4, 2e4, 0.5)
    setup["tractions"] = {"TOP": (5.0, -12.0)}
    one = solved(joint, law, setup)
    c, s = np.cos(angle), np.sin(angle)
    two = solved(joint.rotated(angle), law, setup | {"tractions": {"TOP": (5 * c + 12 * s, 5 * s - 12 * c)}})
    assert two.along[-1] == one.along[-1] == pytest.approx(6.0)
    way = slice(None, None, 1 if np.cos(angle) > 0 else -1)  # a report starts at the lower coordinates
    assert two.p[way] == pytest.approx(one.p, rel=1e-6, abs=1e-6)
    assert two.u_T[way] == pytest.approx(one.u_T, rel=1e-6, abs=1e-10)


@pytest.mark.parametrize("joint", [sandwich(6, 3, 2, 1.0).rotated(0.5), ring(10, 15, 20, 3.0)], ids=["rotated", "ring"])
def test_relaxation_where_s_is_not_along_the_axes(joint):
    inner = "BOTTOM" if "BOTTOM" in joint.facets else "INSIDE"
    outer = {"BOTTOM": "TOP", "INSIDE": "OUTSIDE"}[inner]
    loads = {outer: (3.0, -9.0)} if outer == "TOP" else {outer: lambda x, t: (-0.2 * x[0] - 0.1 * x[1], -0.2 * x[1])}
    data = {"body": LinearElastic.young(5e3, 0.3), "supports": {inner: 0.0}, "tractions": loads, "element": "P1"}
    law = HolonomicCoulomb(7e3, 2e3, 0.5)
    one, two = (solved(joint, law, data, method=method) for method in ("relaxation", "condensed"))
    assert one.u_T == pytest.approx(two.u_T, rel=1e-6, abs=1e-9)
    assert (one.status == two.status).all()


# ------------------------------------------------------------------------ closed forms
def rigid_block(law, supports, tractions, **choices):
    joint = block(3.0, 1.0, 0.5, structured=True)
    setup = {"body": LinearElastic.young(1e9, 0.3), "supports": supports, "element": "P1", "tractions": tractions}
    return Structure(joint, **setup).interface(law)


def test_friction_cycle_of_a_rigid_block():
    """Pressed by d, moved to and fro: the loop of an elastic-plastic spring, and the energy in it."""
    K_N, K_T, f, d = 300.0, 80.0, 0.4, 0.02
    law = IncrementalCoulomb(K_N, K_T, f)
    path = {0: 0.0, 1: 0.06, 3: -0.06, 5: 0.06}

    supports = {"TOP": {"x": piecewise(path), "y": -d}}
    model = rigid_block(law, supports, {})
    times = [0.25 * k for k in range(1, 21)]
    history = march(model, times, observe={"t_T": lambda s: ContactReport(s).friction_force[0] / 3.0})
    p, bound = K_N * d, f * K_N * d
    slip, expected, dissipated = 0.0, [], []
    for t in [0.0, *times]:
        g = np.interp(t, list(path), list(path.values()))
        trial = K_T * (g - slip)
        found = np.clip(trial, -bound, bound)
        dissipated.append(3.0 * found * (g - found / K_T - slip))
        slip = g - found / K_T
        expected.append(found)
    assert history.table["t_T"] == pytest.approx(np.array(expected), abs=1e-5)
    assert history.table["dissipated"] == pytest.approx(np.array(dissipated), abs=1e-5)
    assert max(dissipated) > 0.05
    assert ContactReport(history.last).p == pytest.approx(p, rel=1e-5)
    holonomic = march(rigid_block(HolonomicCoulomb(K_N, K_T, f), supports, {}), times)
    unloading = history.at(1.5), holonomic.at(1.5)
    reports = [ContactReport(s).friction_force[0] / 3.0 for s in unloading]
    assert abs(reports[0] - reports[1]) > 0.5 * bound  # the laws differ where slip turns


def test_solvers_agree_on_a_march_that_turns():
    histories = [to_and_fro(method=method) for method in (*SOLVERS, "relaxation")]
    for one in histories[1:]:
        for state, other in zip(one, histories[0], strict=True):
            size = np.abs(other.u.x.array).max()
            assert state.u.x.array == pytest.approx(other.u.x.array, rel=1e-7, abs=1e-7 * size)
            assert state.memory["contact"] == pytest.approx(other.memory["contact"], rel=1e-5, abs=1e-6)
        assert np.abs(one.table["imbalance"]).max() < 1e-6
    assert (np.array(histories[0].table["dissipated"])[-3:] > 1e-3).all()


def test_a_march_over_a_softer_body():
    """Multigrid takes S from its softer side, here the lower one: slip of the steps before comes along."""
    joint, setup = stacked()
    law = IncrementalCoulomb(7e4, 2e4, 0.5)
    setup["tractions"] = {"TOP": lift, "LEFT/UPPER": lambda x, t: (60.0 * (1 - (t - 1) ** 2), 0.0)}
    one, two = (march(Structure(joint, **setup).interface(law), [1.0, 2.0, 3.0], method=m) for m in SOLVERS[:2])
    slip = one.at(1.0).memory["contact"]
    assert np.abs(slip).max() > 1e-4
    for state, other in zip(one, two, strict=True):
        assert state.u.x.array == pytest.approx(other.u.x.array, rel=1e-7, abs=1e-7 * np.abs(one.last.u.x.array).max())
        assert state.memory["contact"] == pytest.approx(
            other.memory["contact"], rel=1e-5, abs=1e-6 * np.abs(slip).max()
        )


def test_uniform_stress_without_any_support():
    """Pressure and shear that S alone carries: the stiffness of the body is singular, the answer is not."""
    law = HolonomicCoulomb(300.0, 80.0, 0.4, 0.2)
    p, q = 5.0, 2.1  # q < f p + C
    loads = {"TOP": (q, -p), "LEFT": (0.0, -q), "RIGHT": (0.0, q)}
    for method in SOLVERS:
        joint = block(3.0, 1.0, 0.5, structured=True)
        data = {"body": LinearElastic.young(1e4, 0.0), "supports": {}, "element": "P1", "tractions": loads}
        report = solved(joint, law, data, method=method)
        assert report.p == pytest.approx(p, rel=1e-7)
        assert report.t_T == pytest.approx(q, rel=1e-7)
        assert report.u_T == pytest.approx(q / 80.0, rel=1e-7)
        assert set(report.status) == {"stick"}


@pytest.mark.parametrize("method", SOLVERS)
def test_more_shear_than_friction_carries_raises(method):
    law = HolonomicCoulomb(300.0, 80.0, 0.4, 0.2)
    p, q = 5.0, 2.3  # q > f p + C
    joint = block(3.0, 1.0, 0.5, structured=True)
    loads = {"TOP": (q, -p), "LEFT": (0.0, -q), "RIGHT": (0.0, q)}
    data = {"body": LinearElastic.young(1e4, 0.0), "supports": {}, "element": "P1", "tractions": loads}
    with pytest.raises(SolveError) as error:
        solved(joint, law, data, method=method)
    assert "support" in str(error.value) or "load" in str(error.value)
    assert len(error.value.residuals) > 1


@pytest.mark.parametrize("method", SOLVERS)
def test_a_body_pulled_off(method):
    joint, setup = sliding_bar(12)
    pulled = setup | {"tractions": {"TOP": (0.0, 50.0)}}
    held = solved(joint, coulomb("middle"), pulled, method=method)
    assert held.counts["separated"] >= 11
    assert held.counts["stick"] == held.counts["sliding"] == 0
    assert not held.p.any()
    with pytest.raises(SolveError):
        solved(joint, coulomb("middle"), pulled | {"supports": {"RIGHT": {"x": 0.0}}}, method=method)


def test_tresca_is_the_inner_problem():
    """With the thresholds of the Coulomb solution at hand, uniform ones here, both laws give the same."""
    p, q = 5.0, 1.7
    joint = block(3.0, 1.0, 0.5, structured=True)
    loads = {"TOP": (q, -p), "LEFT": (0.0, -q), "RIGHT": (0.0, q)}
    data = {"body": LinearElastic.young(1e4, 0.0), "supports": {}, "element": "P1", "tractions": loads}
    for method in SOLVERS:
        one = solved(joint, Tresca(300.0, 80.0, 2.0), data, method=method)
        assert one.u_T == pytest.approx(q / 80.0, rel=1e-7)
    sliding = bar(12, Tresca(4e5, 6e4, 10.0))
    assert np.abs(sliding.t_T).max() == pytest.approx(10.0)


# ------------------------------------------------------------------------ laws and bodies of one's own
@dataclass(frozen=True)
class Saturating(ContactLaw):
    """Friction that grows more and more slowly with the pressure."""

    f: float
    largest: float

    def threshold(self, p):
        return self.largest * np.tanh(self.f * p / self.largest)

    def threshold_rate(self, p):
        return self.f / np.cosh(self.f * p / self.largest) ** 2


@dataclass(frozen=True)
class Stiffening(BulkLaw):
    """A body that stiffens with its strain."""

    E: float

    def stress(self, step):
        linear = lame(0.5 * self.E, 0.4 * self.E, step.e)
        return linear * (1 + 1e3 / self.E * ufl.inner(linear, step.e))


def test_a_law_of_ones_own():
    report = bar(12, Saturating(4e5, 6e4, 1.0, 25.0))
    assert np.abs(report.t_T).max() == pytest.approx(25.0 * np.tanh(report.p / 25.0)[report.status == "sliding"].max())
    assert report.clapeyron < 1e-9
    with pytest.raises(ValueError, match="method='newton'"):
        bar(12, Saturating(4e5, 6e4, 1.0, 25.0), method="condensed")


def test_bodies_that_are_not_linear():
    joint, setup = sliding_bar(8)
    state = solve(Structure(joint, **setup | {"body": Stiffening(1e4)}).interface(coulomb("middle")))
    assert state.report.method == "newton"
    assert ContactReport(state).equilibrium < 1e-9


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


def test_plane_strain_in_three_dimensions():
    """Rollers on both sides in z: one cell deep, the numbers of the two-dimensional bar."""
    flat = block(40, 40, 8, cell="quadrilateral")
    deep = block(40, 40, 8, depth=8, cell="hexahedron")
    data = {"body": BAR, "supports": {"RIGHT": {"x": 0.0}}, "tractions": {"LEFT": (100.0, 0.0), "TOP": (0.0, -50.0)}}
    one = solved(flat, coulomb("middle"), data | {"element": "Q1"})
    data["supports"] |= {"BACK": {"z": 0.0}, "FRONT": {"z": 0.0}}
    data["tractions"] = {"LEFT": (100.0, 0.0, 0.0), "TOP": (0.0, -50.0, 0.0)}
    two = solved(deep, coulomb("middle"), data | {"element": "Q1"})
    front = two.x[:, 2] > 4
    assert two.x[front, 0] == pytest.approx(one.x[:, 0])
    assert two.u_T[front, 0] == pytest.approx(one.u_T[:, 0], rel=1e-7)
    assert two.p[front] == pytest.approx(one.p, rel=1e-7, abs=1e-7)
    assert two.normal_force == pytest.approx(8 * one.normal_force, rel=1e-7)


def test_ring_pressed_onto_its_core():
    """A curved S sticks everywhere under a pressure that is the same all around."""
    joint = ring(10, 15, 20, 1.0)
    setup = {"body": LinearElastic.young(1e5, 0.3), "supports": {"INSIDE": 0.0}, "element": "P1"}
    setup["tractions"] = {"OUTSIDE": lambda x, t: (-4 * x[0] / 20, -4 * x[1] / 20)}
    report = solved(joint, HolonomicCoulomb(1e5, 1e5, 0.3), setup)
    assert set(report.status) == {"stick"}
    assert report.weights.sum() == pytest.approx(2 * np.pi * 15, rel=2e-3)
    assert np.ptp(report.p) < 0.1 * report.p.mean()
    assert np.abs(report.t_T).max() < 0.05 * report.p.mean()


# ------------------------------------------------------------------------ reports and pictures
def test_report():
    report = bar(31, coulomb("stiff"))
    assert [z.status for z in report.zones] == ["separated", "sliding", "stick", "pinned"]
    assert sum(z.size for z in report.zones) == pytest.approx(40.0)
    assert report.zones[1].size == pytest.approx(15 * 40 / 31)
    assert report.normal_force == pytest.approx(1954.37527, rel=1e-7)  # independent code
    assert report.friction_force[0] == pytest.approx(1080.22163, rel=1e-7)
    assert report.force == pytest.approx([-1080.22163, 1954.37527], rel=1e-7)
    assert report.table.columns == ["x", "y", "u_T", "u_N", "p", "t_T", "status"]
    assert "3 separated, 15 sliding, 13 stick, 1 pinned" in str(report)
    assert report.along[-1] == pytest.approx(40.0)


@pytest.mark.parametrize("make", [lambda: sliding_bar(12), stacked], ids=["base", "bodies"])
def test_traction_of_the_surface_is_that_of_the_nodes(make):
    joint, setup = make()
    state = solve(Structure(joint, **setup).interface(coulomb("middle")))
    surface, report = Surface(state.model), ContactReport(state)
    x, t = surface.profile(surface.frame(surface.traction(state)))
    assert x == pytest.approx(report.x, abs=1e-9)
    assert -t[:, 1] == pytest.approx(report.p, rel=1e-7, abs=1e-7)
    assert t[:, 0] == pytest.approx(report.t_T[:, 0], rel=1e-7, abs=1e-7)  # at the last node, that a support holds, too


def test_frames_in_three_dimensions():
    """The smallest rotation that takes e_2 to the normal, and a half turn where there is none."""
    normals = np.random.default_rng(5).normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    for n, frame in zip(normals, nodes_module._frames(normals), strict=True):
        axis = np.cross((0.0, 1.0, 0.0), n)
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.arccos(n[1])).as_matrix()
        assert frame == pytest.approx(turn[:, [0, 2, 1]].T, abs=1e-12)
    assert nodes_module._frames(np.array([[0.0, -1.0, 0.0]]))[0] == pytest.approx(
        np.array([(-1, 0, 0), (0, 0, 1), (0, -1, 0)])
    )


def test_nodes_of_two_bodies_see_the_jump():
    joint, setup = stacked()
    model = Structure(joint, **setup).interface(coulomb("soft"))
    nodes = ContactNodes(model, model.supports.held(model.V))
    u = fem.Function(model.V)
    for body, sign in (("LOWER", -1.0), ("UPPER", 2.0)):
        cells = model.domain.cell_tags.find(model.domain.cell_values(body)[0])
        u.interpolate(lambda x, sign=sign: np.array([sign * x[0], sign * (1 + 3 * x[0])]), cells0=cells)
    w = nodes.jump(u.x.petsc_vec)
    assert w == pytest.approx(np.column_stack([3 * nodes.x[:, 0], 3 + 9 * nodes.x[:, 0]]), abs=1e-12)
    nodes.destroy()


def test_pictures(tmp_path):
    one, two = bar(12, coulomb("middle")), bar(12, coulomb("soft"))
    plotting.contact({"a": one, "b": two}, save=tmp_path / "two.png", length="mm", stress="MPa", title="contact")
    joint, setup = sliding_bar(4, depth=True)
    solid = solved(joint, coulomb("middle"), setup)
    plotting.contact(solid, save=tmp_path / "solid.png", length="mm", stress="MPa")
    for name in ("two", "solid"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    with pytest.raises(ValueError, match="one dimension"):
        plotting.contact({"a": one, "b": solid})
    with pytest.raises(ValueError, match="one report"):
        plotting.contact({})


# ------------------------------------------------------------------------ status known before
def test_an_error_within_newtons_method_is_no_lack_of_equilibrium(monkeypatch):
    """Such as a compiled source that cannot be loaded."""

    def broken(*_, **__):
        raise ImportError("no such library")

    monkeypatch.setattr(dense, "sweep_nodes", broken)
    with pytest.raises(ImportError, match="no such library"):
        bar(4, coulomb("middle"), method="condensed")


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
    with pytest.raises(ModelError, match="element='P1'"):
        Structure(joint, **setup | {"element": "P2"}).interface(law)
    with pytest.raises(LawError, match="has no thickness: give it alone"):
        ThinLayer(law, 0.1, profile=lambda x: 1 + x[0])
    with pytest.raises(ModelError, match="no meshed layer"):
        Structure(joint, **setup).full(law)
    with pytest.raises(ModelError, match="is for layers"):
        Structure(joint, **setup | {"body": law}).interface(law)
    with pytest.raises(ModelError, match="contact law"):
        ContactReport(solve(Structure(joint, **setup).bonded()))
    two, data = stacked()
    with pytest.raises(ModelError, match="rigid motion"):
        Structure(two, **data | {"supports": {}}).interface(law)


def test_refused_solves():
    joint, setup = sliding_bar(4)
    model = Structure(joint, **setup).interface(coulomb("middle"))
    elastic = Structure(joint, **setup).interface(ThinLayer(LinearElastic(1.0, 1.0), 0.1))
    with pytest.raises(ValueError, match="condensed"):
        solve(model, method="linear")
    with pytest.raises(ValueError, match="has none"):
        solve(elastic, method="condensed")
    for name, value in {"relaxation_omega": 2.5, "relaxation_tolerance": 0.0, "relaxation_max_sweeps": 0}.items():
        with pytest.raises(OptionError, match="allowed"):
            solve(model, method="relaxation", options={name: value})
    for options in ({"snes_type": "nonsense"}, {"snes_max_it": "many"}, {"relaxation_omga": 1.5}, {"ksp_type": "cg"}):
        with pytest.raises(OptionError):
            solve(model, method="condensed", options=options)
    with pytest.raises(ModelError, match="theta"):
        march(model, [1.0], theta=0.5)
    with pytest.raises(ModelError, match="like"):
        solve(model, like=3)
    with pytest.raises(ModelError, match="contact"):
        solve(elastic, like=solve(elastic))
    other, data = sliding_bar(5)
    with pytest.raises(ModelError, match="same joint"):
        solve(model, like=solve(Structure(other, **data).interface(coulomb("middle"))))


# ------------------------------------------------------------------------ against the meshed layer
def test_pressed_column_against_its_meshed_layer():
    """Where nothing opens or slides the contact law with the stiffness of a layer is that layer's interface law."""
    glue, eps = LinearElastic(60.0, 40.0), 0.05
    joint = sandwich(1.0, 0.5, 0.5, 0.25, structured=True)
    sides = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    setup = {
        "body": LinearElastic.young(100.0, 0.3),
        "supports": {"BOTTOM": 0.0, **sides},
        "tractions": {"TOP": (0.0, -0.7)},
        "element": "P1",
    }
    full = solve(Structure(joint, **setup).full(ThinLayer(glue, eps)))
    law = HolonomicCoulomb.of_layer(glue.lmbda, glue.mu, friction=0.3)
    row = compare(full, solve(Structure(joint, **setup).interface(law)))
    assert row["error_traction"] < 1e-8
    assert row["error_jump"] < 1e-8
    soft = HolonomicCoulomb(glue.lmbda + glue.mu, glue.mu, 0.3)
    wrong = compare(full, solve(Structure(joint, **setup).interface(soft)))
    assert wrong["error_jump"] > 0.1
