"""Initial gaps and interferences of contact laws: closed forms, all solvers, networks, time, ranks; what is refused."""

import numpy as np
import pytest

from forms import HolonomicCoulomb, IncrementalCoulomb, LinearElastic
from forms.base import InputError
from geometry import ring, sandwich, wall
from tests.contact_bars import contact
from tests.refused import refused
from thinlayer import Structure, Surface, march, solve

pytestmark = pytest.mark.few(5)

LOWER, UPPER = LinearElastic.young(30.0, 0.3), LinearElastic.young(50.0, 0.2)


def CURVED(x):
    """A crown of radius 20."""
    return (x[0] - 1.1) ** 2 / 40


def curved(kind=HolonomicCoulomb, gap=CURVED):
    joint = sandwich(2.0, 0.5, 0.75, 0.125, structured=True)
    supports = {"BOTTOM": 0.0, "TOP": {"x": lambda x, t: 0.008 * t, "y": lambda x, t: -0.01 * t}}
    structure = Structure(joint, body={"LOWER": LOWER, "UPPER": UPPER}, supports=supports, element="P1")
    return structure.interface(kind(K_N=400.0, K_T=150.0, friction=0.3, gap=gap))


METHODS = ("condensed", "multigrid", "newton", "relaxation")
SIDES = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}, "BOTTOM": 0.0}
K = 400.0
COMPLIANCE = 1 / K + 0.5 / (LOWER.lmbda + 2 * LOWER.mu) + 0.75 / (UPPER.lmbda + 2 * UPPER.mu)  # of `column`


def column(law, dim=2, *, shift=None, load=None):
    """Two blocks between smooth walls, pressed by a shift or a load of the top."""
    cell, deep = ("triangle", {}) if dim == 2 else ("hexahedron", {"depth": 1.0})
    joint = sandwich(2.0, 0.5, 0.75, 0.25 * (dim - 1), cell=cell, structured=True, **deep)
    supports = SIDES | ({"FRONT": {"z": 0.0}, "BACK": {"z": 0.0}} if dim == 3 else {})
    supports |= {} if shift is None else {"TOP": {"y": shift}}
    tractions = {} if load is None else {"TOP": (0.0, load, 0.0)[:dim]}
    bodies, element = {"LOWER": LOWER, "UPPER": UPPER}, "P1" if dim == 2 else "Q1"
    return Structure(joint, body=bodies, supports=supports, tractions=tractions, element=element).interface(law)


def across(state):
    """Mean normal jump and traction on S."""
    surface = Surface(state.model)
    w, t = surface.jump(state), surface.traction(state)
    area = surface.integral(1.0)
    return surface.integral(w[1]) / area, surface.integral(t[1]) / area


# ---------------------------------------------------------------- closed forms
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("gap", [0.03, -0.03])
def test_blocks_over_a_gap(gap, method, dim):
    """w = -gap - p/K under a load; under a shift S and both blocks are in series for what is left of it."""
    law = HolonomicCoulomb(K_N=K, K_T=150.0, friction=0.3, gap=gap)
    assert across(solve(column(law, dim, load=-0.8), method=method)) == pytest.approx((-gap - 0.8 / K, -0.8), rel=1e-9)
    p = (0.05 - gap) / COMPLIANCE
    assert across(solve(column(law, dim, shift=-0.05), method=method)) == pytest.approx((-gap - p / K, -p), rel=1e-9)


@pytest.mark.few(1)
@pytest.mark.parametrize("method", ["condensed", "multigrid"])
def test_a_ring_shrunk_on_a_hollow_shaft(method):
    """Lame's pressure for an interference, in plane stress, as K grows; S is a polygon, whose error falls with h."""
    inner, middle, outer, interference, stiffness = 10.0, 15.0, 20.0, 0.02, 1e7
    shaft, hub = LinearElastic.young(210e3, 0.3), LinearElastic.young(70e3, 0.33)
    grown = [(outer**2 + middle**2) / (outer**2 - middle**2), (middle**2 + inner**2) / (middle**2 - inner**2)]
    compliance = middle * ((grown[0] + 0.33) / 70e3 + (grown[1] - 0.3) / 210e3) + 1 / stiffness
    errors = []
    for h in (2.0, 1.0):
        joint = ring(inner, middle, outer, h)
        at = {(inner, 0.0): {"y": 0.0}, (-inner, 0.0): {"y": 0.0}, (0.0, inner): {"x": 0.0}}
        data = {"body": {"INNER": shaft, "OUTER": hub}, "supports": at, "plane": "stress", "element": "P1"}
        law = HolonomicCoulomb(K_N=stiffness, K_T=1e4, friction=0.1, gap=-interference)
        report = contact(solve(Structure(joint, **data).interface(law), method=method))
        errors.append(report.normal_force / (2 * np.pi * middle) / (interference / compliance) - 1)
    assert abs(errors[1]) < 0.02
    assert abs(errors[1]) < 0.4 * abs(errors[0])


# ---------------------------------------------------------------- all solvers
@pytest.mark.parametrize("kind", [HolonomicCoulomb, IncrementalCoulomb])
def test_solvers_agree_on_a_crowned_block(kind):
    """A gap that grows along S, closed in part, and slid."""
    states = [solve(curved(kind), 1.0, method=method) for method in METHODS]
    for state in states[1:]:
        assert np.abs(state.u.x.array - states[0].u.x.array).max() < 1e-7 * np.abs(states[0].u.x.array).max()
    counts = Surface(states[0].model).contact(states[0]).counts
    assert min(counts["separated"], counts["sliding"]) > 2
    flat = solve(curved(kind, gap=0.0), 1.0)
    assert Surface(flat.model).contact(flat).counts["separated"] < counts["separated"]


def test_networks_have_a_gap_for_each_seam():
    """Heads that are open at first close under pressure from the side."""
    joint = wall(3, 2, (1.0, 0.5), 0.125, cell="quadrilateral")
    supports = {"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}, "RIGHT": {"x": -0.03}}
    structure = Structure(joint, body=LOWER, supports=supports, tractions={"TOP": (0.0, -0.3)}, element="Q1")
    forces = []
    for gap in (0.0, 0.01):
        laws = {"BED": HolonomicCoulomb(K_N=200.0, K_T=80.0, friction=0.5, gap=-0.001)}
        laws["HEAD"] = HolonomicCoulomb(100.0, 40.0, friction=0.3, gap=lambda x, gap=gap: gap + 0 * x[0])
        state, other = (solve(structure.interface(laws), method=method) for method in ("condensed", "newton"))
        assert np.abs(state.u.x.array - other.u.x.array).max() < 1e-7 * np.abs(state.u.x.array).max()
        forces.append(Surface(state.model, "HEAD").contact(state).normal_force)
    assert 0 < forces[1] < 0.8 * forces[0]


# ---------------------------------------------------------------- time, files, ranks
def test_a_march_closes_a_gap_and_balances_its_energy():
    """Before contact nothing is stored; afterwards energies balance, and an interference does work at the start."""
    law = IncrementalCoulomb(K_N=K, K_T=150.0, friction=0.3, gap=0.03)
    history = march(column(law, shift=lambda x, t: -0.05 * t), [0.5, 1.0])
    assert [state.audit.total > 1e-15 for state in history] == [False, False, True]
    assert history.at(0.5).stored["contact"] == 0.0
    law = IncrementalCoulomb(K_N=K, K_T=150.0, friction=0.3, gap=-0.01)
    pressed = march(column(law, shift=lambda x, t: -0.05 * t), [0.6, 1.0])
    for state in (*history, *pressed):
        assert state.audit.total < 1e-15 or abs(state.audit.imbalance) < 1e-11
        energies = state.energies()
        assert state.audit.total == pytest.approx(energies["bodies"] + energies["layer"], rel=1e-10, abs=1e-15)
    assert pressed.at(0.0).audit.supplied > 0
    assert pressed.last.audit.supplied == pytest.approx(0.06 / COMPLIANCE * 0.02 * 2.0, rel=1e-9)  # force times move


def test_refused():
    for gap, match in [
        (np.nan, "gap is nan"),
        (lambda x: x, r"places \(d, n\) with n lengths"),
        (lambda x: np.full(x.shape[1], np.inf), r"is inf at x = \("),
        (lambda x: x[0] > 0, "not real numbers"),
    ]:
        refused(InputError, match, lambda gap=gap: solve(curved(gap=gap), 1.0))
