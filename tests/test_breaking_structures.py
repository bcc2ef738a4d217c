"""Structures that break: an identity of each step, a crack front in 3D, a peeled arm, a fault on a user's mesh."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from forms import Cohesive, LinearElastic
from geometry import block, read, sandwich
from studies import dcb, delamination, enf, lap_failure, mmb
from studies.delamination import ON_S, Beams
from tests.meshes import drawing, stack
from tests.on_ranks import on_ranks
from thinlayer import ArcLength, Structure, Surface, march
from thinlayer.surface.law_points import layer_points, match_law_points


# ---------------------------------------------------------------- every step of the studies
def damage_and_jumps(state):
    """(2, facets, points) parts of the stiffness that are lost along and across S, jumps, and weights of the points."""
    surface = Surface(state.model)
    ((points, facets),) = layer_points(surface, state)
    rule = surface.rule(points.quadrature.degree)
    lower, upper = surface.side_values(state.u, state.model, rule)
    d, w = points.internal()[0]["d"][match_law_points(rule, facets, points)], upper - lower
    return np.array([d * np.ones_like(w[0]), d * (w[1] >= 0)]), w, rule.weights


def secant_errors(states, force, displacement, K):
    """How far the work is from u_0.(K_0 - K_1) u_1 in each step (row 0), and from u_1.(K_0 - K_1) u_1 (row 1)."""
    points, errors = [damage_and_jumps(state) for state in states], []
    for k, ((lost, w, _), (lost_new, w_new, weights)) in enumerate(pairwise(points)):
        work = force[k] * displacement[k + 1] - force[k + 1] * displacement[k]
        broken = [np.einsum("i,ifq,ifq,ifq,fq", K, a, w_new, lost_new - lost, weights) for a in (w, w_new)]
        errors.append(np.abs(np.array(broken) - work))
    return np.array(errors).T / (force.max() * displacement.max())


STUDIES = {  # path, and stiffnesses along S and across it
    "dcb": (lambda: dcb.peel(ON_S, 2.0), (5e3, 1e4)),
    "enf": (lambda: enf.bend(1.0), (1e5, 1e5)),
    "mmb": (lambda: mmb.bend(80.0, 1.0, 0.2, 30), (1e5, 1e5)),
    "lap": (lambda: lap_failure.pull(lap_failure.lap(1.0), 0.2, kind=ON_S), ()),
}


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.long][: name != "dcb"]) for name in STUDIES])
def test_what_breaks_in_a_step_is_the_work_of_its_secants(name, monkeypatch):
    """(F_0 u_1 - F_1 u_0) = u_0.(K_0 - K_1) u_1, as bodies are linear and each damage is a secant, in any step."""
    for module in (dcb, enf, mmb, lap_failure):
        monkeypatch.setattr(module, "march", lambda *args, **options: march(*args, **{**options, "keep": "all"}))
    path, K = STUDIES[name]
    history = path()
    if name == "lap":
        law = lap_failure.data_sheet(bond_line=0.2)
        K = np.array([law.mu, law.lmbda + 2 * law.mu]) / 0.2
    u = history.t if name == "lap" else history.table["displacement"]
    right, wrong = secant_errors(history, history.table["force"], u, K)
    assert right.max() < (1e-9 if name in ("enf", "mmb") else 1e-10)  # Newton stops sooner where cracks close
    assert wrong.max() > 1e-4


# ---------------------------------------------------------------- arms
BEAMS = {  # force and displacement as the crack begins to grow
    "dcb": (dcb.ARMS, 6.505887, 1.077956), "enf": (enf.HALVES, 874.834357 / 25, 3.5555216),
    "mmb 30": (mmb.halves(30.0), 392.785 / 25, None), "mmb 80": (mmb.halves(80.0), 91.1748 / 25, None),
}  # fmt: skip


@pytest.mark.parametrize("name", BEAMS)
def test_beams_on_glue(name, monkeypatch):
    """Independent programs' closed forms, and finite elements where modes mix; sharp cracks bear more."""
    monkeypatch.setattr(delamination, "ROWS", 4)
    beams, force, displacement = BEAMS[name]
    table = beams.envelope(beams.crack + 0.2)
    assert table["force"][4] == pytest.approx(force, rel=1e-3)
    assert displacement is None or table["displacement"][4] == pytest.approx(displacement, rel=1e-3)
    assert beams.sharp(beams.crack)["force"] > 1.05 * force


def test_a_peeled_arm():
    """An arm on a rigid base is half of a double cantilever beam: forces within 1 % of beams."""
    glue = Cohesive(
        1e4, 1.0, 20.0, 0.5, 0.15, 1.0, cracked=lambda x: 1.0 * (x[0] < 30)
    )  # the base does not hold it back
    arm = Structure(
        block(48.0, 3.0, 1.5, h_S=1.0, cell="quadrilateral", structured=True), body=LinearElastic.young(70e3, 0.0),
        supports={(0, 3.0): {"y": lambda x, t: t}, (48.0, 3.0): {"x": 0.0}})  # fmt: skip
    observe = {"force": lambda state: state.reaction((0, 3.0)).force[1]}
    rows = march(arm.interface(glue), ArcLength(end=0.7, first=0.1), observe=observe, keep="last").table
    whole = Cohesive(5e3, 5e3, 20.0, 20.0, 0.3, 0.3)
    expected = Beams(whole, 70e3, 3.0, 48.0, 30.0, opening=1.0, shear=35e3 * 3 * 5 / 6).envelope(36.0)
    forces = np.interp(2 * rows["t"], expected["displacement"], expected["force"])
    assert rows["force"] == pytest.approx(forces, rel=0.01, abs=0.01)


@pytest.mark.long
def test_an_end_loaded_split():
    """A clamped beam with a crack at its loaded end, which closes: the largest force within 3 % of beams."""
    joint = sandwich(50.0, 1.5, 1.5, 1.5, h_S=1.0, cell="quadrilateral", structured=True)
    supports = {"RIGHT": 0.0, (0, 1.5): {"y": lambda x, t: -t}}
    model = Structure(joint, body=LinearElastic.young(enf.E, 0.0), supports=supports).interface(enf.GLUE)
    observe = {"force": lambda state: -state.reaction((0, 1.5)).force[1]}
    rows = march(model, ArcLength(end=14.0, first=0.7, largest=2, steps=60), observe=observe, keep="last").table
    beams = Beams(enf.GLUE, enf.E, 1.5, 50.0, 25.0, bending=2.0)
    largest = rows["force"][50 * rows["broken"] < 30].max()  # it grows again as the crack nears the clamp
    assert largest == pytest.approx(beams.envelope(30.0)["force"].max(), rel=0.03)
    assert largest < 0.9 * beams.sharp(25.0)["force"]


@cache
def peeled_front():
    """Half of a wide arm is lifted from its base: the glue that is lost along strips, edge first; forces, energy."""
    glue = Cohesive(50.0, 50.0, 1.0, 1.0, 0.1, 0.1, cracked=lambda x: 1.0 * (x[0] < 4))
    supports = {"LEFT": {"y": lambda x, t: t}, "FRONT": {"z": 0.0}, "RIGHT": {"x": 0.0}}
    joint = block(12.0, 1.0, 1.0, depth=4.0, cell="hexahedron", structured=True)
    model = Structure(joint, body=LinearElastic.young(1e3, 0.3), supports=supports).interface(glue)
    history, surface = march(model, ArcLength(end=1.2, first=0.3, largest=2), keep="last"), Surface(model)
    z, lost = surface.x[2].mean(axis=1), (surface.weights * surface.internal(history.last, "d")).sum(axis=1)
    strips = [float(lost[(z > k) & (z < k + 1)].sum()) for k in range(4)]
    return [*strips, history.last.prescribed_work, float(history.table["dissipated"].sum())]


@on_ranks(peeled_front, 2)
def test_a_crack_front_in_3d(there):
    """The arm bends across, too, so that the crack is longer in the middle of its width; on ranks as on one."""
    assert there == pytest.approx(peeled_front(), rel=1e-9)
    strips = there[:4]
    assert strips == sorted(strips)
    assert strips[3] > 1.03 * strips[0]


# ---------------------------------------------------------------- a user's mesh
@pytest.mark.long
def test_a_cracked_fault_on_a_mesh_from_a_file(tmp_path):
    """Two blocks slide on a fault with a precrack, on a mesh of gmsh and on the package's own: within 2 %."""
    fault, values = Cohesive(1e3, 1e3, 1.0, 1.0, 0.01, 0.01, cracked=lambda x: 1.0 * (x[0] < 0.4)), []
    supports = {"BOTTOM": 0.0, "TOP": {"x": lambda x, t: t, "y": 0.0}}
    with drawing() as occ:
        stack(occ, tmp_path / "fault.msh", h=0.2)
    file = read(tmp_path / "fault.msh", upper="UPPER", names={"BOTTOM": lambda x: x[1] < -1 + 1e-6})
    for joint in (file, sandwich(2.0, 1.0, 1.0, 0.2)):
        model = Structure(joint, body=LinearElastic.young(100.0, 0.3), supports=supports, element="P1").interface(fault)
        path = ArcLength(end=0.09, first=0.01, largest=4, back=-0.01)
        rows = march(model, path, observe={"force": lambda state: state.reaction("TOP").force[0]}, keep="last").table
        values.append([rows["force"].max(), rows["dissipated"].sum()])
    assert values[0] == pytest.approx(values[1], rel=0.02)
    assert values[0][1] == pytest.approx(0.01 * 1.6, rel=1e-6)
