"""Laws of joints that break: at points, in bars, beams and blocks on S and meshed; what results say of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from typing import ClassVar

import numpy as np
import pytest
import ufl

from forms import Breaking, Cohesive, LinearElastic, Stack
from forms.base import InputError
from forms.breaking import BilinearSoftening, ExponentialSoftening, LinearSoftening, SofteningCurve
from geometry import block, sandwich
from studies import enf
from tests.at_points import respond
from tests.on_ranks import on_ranks
from tests.ranges_told import with_warnings
from tests.refused import refused
from thinlayer import Adaptive, ArcLength, Structure, Surface, ThinLayer, drive, march, solve
from thinlayer.errors import TurningPoint

JOINT = Cohesive(K_N=1e4, K_T=6e3, t_N=20.0, t_T=30.0, G_I=0.3, G_II=0.9, eta=2.0)
GLUE = Breaking(lmbda=700.0, mu=500.0, t_N=20.0, t_T=30.0, G_I=3.0, G_II=9.0, eta=2.0)
TWO_DIRECTIONS = np.array([0.36, 0.48, 0.8])
N = {"y": [0.0, 1.0, 0.0], "oblique": TWO_DIRECTIONS}


@dataclass(frozen=True)
class Trapezoidal(Cohesive):
    """Energy dissipated by the trapezoidal rule, of which long steps make nonsense."""

    def dissipated(self, step):
        Y, Y_old = (sum(self._released(w, step.n)) for w in (step.w, step.w_old))
        return (Y + Y_old) / 2 * (self._new_damage(step) - step.q["d"])


class Plateau(SofteningCurve):
    """The stress stays at the strength up to x = (k + 1)/2, and is then zero."""

    def damage(self, x):
        return ufl.conditional(ufl.lt(x, (self.k + 1) / 2), 1 - 1 / x, 1.0)

    def energy(self, d):
        return ufl.conditional(ufl.lt(d, 1), d / ufl.max_value(1 - d, 1e-9), self.k)


@dataclass(frozen=True)
class Dugdale(Cohesive):
    """A user's cohesive law: a curve and a toughness of its own."""

    def softening_curve(self, k):
        return Plateau(k)

    def toughness(self, B):
        return self.G_I + (self.G_II - self.G_I) * B / (2 - B)


@dataclass(frozen=True)
class Shrinking(Breaking):
    """Its toughness per volume stays, so that the one per area falls with the thickness: wrong beside moduli that fall."""

    powers: ClassVar = {"lmbda": 1, "mu": 1}


def made(cls, law):
    """The parameters of a law in another class."""
    return cls(**law.parameters(), **dict(law.choices()))


# ---------------------------------------------------------------- at a point
def along(law, *corners, steps=1):
    """The law along straight legs between jumps (w_T, w_N), each in equal steps: its history, and its work in II and I."""
    path, start = [], np.zeros(2)
    for corner in np.array(corners, float):
        path += [start + (corner - start) * k / steps for k in range(1, steps + 1)]
        start = corner
    history = drive(law, [{"w_T": w_T, "w_N": w_N} for w_T, w_N in path])
    t, w = (np.vstack([[0.0, 0.0], a]) for a in (history.tractions, history.jumps))
    return history, ((t[1:] + t[:-1]) / 2 * np.diff(w, axis=0)).sum(axis=0)


def direction(degrees):
    return np.array([math.sin(math.radians(degrees)), math.cos(math.radians(degrees))])


RAYS = {  # angle: toughness, and works in shear and opening
    0: (0.3, (0.0, 0.3)), 30: (0.3 + 0.6 / 36, (0.05277778, 0.26388889)),
    60: (0.3 + 0.6 * 81 / 196, (0.35225947, 0.19569971)), 90: (0.9, (0.9, 0.0)),
}  # fmt: skip


@pytest.mark.parametrize(("degrees", "G", "in_modes"), [(degrees, *values) for degrees, values in RAYS.items()])
def test_a_ray_costs_the_toughness_of_its_mode_mixity(degrees, G, in_modes):
    """In three steps as in many. Wrong twin: 90 to 800 times too much, in one step."""
    for steps in (3, 400):
        history, work = along(JOINT, 0.08 * direction(degrees), steps=steps)
        assert history.energies[:, 1].sum() == pytest.approx(G, rel=1e-9)
        assert (history.energies[:, 1] >= 0).all()
    assert work == pytest.approx(in_modes, abs=1e-4)
    wrong, _ = along(made(Trapezoidal, JOINT), 0.2357 * direction(degrees))
    assert wrong.energies[0, 1] > 50 * G


@pytest.mark.few(2)
@pytest.mark.parametrize("criterion", ["BK", "power"])
@pytest.mark.parametrize("softening", ["linear", "bilinear", "exponential"])
def test_stress_and_energy_on_a_ray(softening, criterion):
    """Closed forms at 30 degrees, where B = 1/6, with any exponent."""
    G = {"BK": 0.3 + 0.6 / 6**1.7, "power": ((5 / 1.8) ** 1.7 + (1 / 5.4) ** 1.7) ** (-1 / 1.7)}[criterion]
    d = direction(30) * [6e3, 1e4]  # traction per jump
    w_0 = 1 / np.linalg.norm(d / [30.0, 20.0])
    Y_0 = d @ direction(30) * w_0**2 / 2
    k, x = G / Y_0, np.array([0.9, 1.4, 2.5, 6.0, 9.5])
    s = {
        "linear": lambda x: (k - x) / (k - 1),
        "exponential": lambda x: np.exp(-2 * (x - 1) / (k - 1)),
        "bilinear": lambda x: np.maximum(1 - (x - 1) / (0.6 * (k - 1)), (1 + 1.8 * (k - 1) - x) / (4.2 * (k - 1))),
    }[softening]
    left = lambda x: np.where(x < 1, x, s(np.maximum(x, 1.0)).clip(0.0))
    history, _ = along(
        replace(JOINT, softening=softening, criterion=criterion, eta=1.7), *np.outer(x * w_0, direction(30))
    )
    assert history.tractions == pytest.approx(np.outer(left(x), d * w_0), abs=1e-9 * d.max() * w_0)
    grid = [np.linspace(0, end, 200001) for end in x]
    spent = [Y_0 * (2 * np.trapezoid(left(of), of) - left(of)[-1] * of[-1]) for of in grid]
    assert history.energies[:, 1].cumsum() == pytest.approx(spent, abs=1e-6 * G)
    assert history.energies[:, 0] == pytest.approx(Y_0 * left(x) * x, abs=1e-9 * G)


TURNS = [
    ([(0, 0.015), (0.2, 0.015)], 0.461308),
    ([(0.03, 0), (0.03, 0.1)], 0.755167),
    ([(0.03, 0), (0, 0), (0, 0.1)], 0.589087),
]


@pytest.mark.parametrize(("corners", "expected"), TURNS)
def test_turning_paths(corners, expected):
    """Opening, then shear, and the reverse: own integration; with the square of the steps."""
    errors = [sum(along(JOINT, *corners, steps=n)[1]) - expected for n in (50, 100, 400)]
    assert abs(errors[2]) < 2e-5
    assert 3 < errors[0] / errors[1] < 6
    assert along(JOINT, *corners, steps=400)[0].energies[:, 1].sum() == pytest.approx(expected, abs=1e-4)


def test_a_loop_without_growth_does_no_work():
    """Through closing and shear, from an opening that has damaged, and back."""
    history, work = along(JOINT, (0.01, 0.02), steps=8)
    loop = (0.004, 0.002), (-0.003, -0.002), (0.005, -0.001), (0.01, 0.0), (0.01, 0.02)
    after, round_trip = along(JOINT, (0.01, 0.02), *loop, steps=8)
    assert after.memory[-1] == history.memory[-1] > 0.5
    assert round_trip.sum() == pytest.approx(work.sum(), rel=1e-12)
    assert after.energies[8:, 1].max() == 0.0


PLACES = np.array([[0.4, 0.3], [1.6, 2.1], [1.2, -1.4], [0.6, 0.9], [4.0, 17.0], [0.4, -0.3]])  # slip, opening over w_0


@pytest.mark.few(3)
@pytest.mark.parametrize("n", N)
@pytest.mark.parametrize("law", [JOINT, GLUE, replace(GLUE, softening="bilinear", criterion="power"),
    replace(JOINT, softening="exponential", closure="bilateral"), made(Dugdale, JOINT)])  # fmt: skip
def test_the_tangent_is_the_derivative_of_the_stress(law, n):
    """On all branches: sound, growing in opening and closing, unloading, broken. Wrong twin: that at fixed damage."""
    normal = np.array(N[n])
    tangent = np.cross(normal, [0.6, 0.0, -0.8])
    w_0 = 0.004 if isinstance(law, Cohesive) else 0.03
    w = w_0 * (PLACES[:, :1] * tangent + PLACES[:, 1:] * normal) / np.linalg.norm(tangent)
    tensors = (w[:, :, None] * normal + w[:, None] * normal[:, None]) / 2
    tensors[:, 0, 0] += 0.1 * w_0  # along S, too, which jumps ignore
    e = np.array([[a[0, 0], a[1, 1], a[2, 2], *(2**0.5 * np.array([a[0, 1], a[0, 2], a[1, 2]]))] for a in tensors])
    q, at = np.array([[0.0], [0.0], [0.0], [0.7], [0.0], [0.1]]), np.tile(normal, (len(e), 1))
    answer, h = respond(law, e, 0 * e, q, at), 1e-6 * w_0
    sides = [[respond(law, e + s * h * v, 0 * e, q, at) for s in (1, -1)] for v in np.eye(6)]
    quotients = np.stack([(a.stress - b.stress) / (2 * h) for a, b in sides], axis=-1)
    assert answer.tangent == pytest.approx(quotients, abs=1e-7 * np.abs(answer.tangent).max())
    frozen = [[respond(law, e + s * h * v, e, answer.q, at).stored for s in (1, -1)] for v in np.eye(6)]
    stress = np.stack([(a - b) / (2 * h) for a, b in frozen], axis=-1)
    resting = np.abs(answer.q[:, 0] - [0.0, 0.0, 0.0, 0.7, 1.0, 0.1]) < 1e-12  # else damage would grow
    assert stress[resting] == pytest.approx(answer.stress[resting], abs=1e-6 * np.abs(answer.stress).max())
    secant = respond(law, e, e, answer.q + 1e-9, at).tangent
    grown = (answer.q > q)[:, 0] & (answer.q < 1)[:, 0]
    assert (np.abs(secant - answer.tangent)[grown].max(axis=(1, 2)) > 1e-2 * np.abs(secant).max()).all()


def test_a_law_without_toughness_breaks_at_its_strength():
    """Where scaling leaves less toughness than elastic energy; the formula alone would have d < 0: it never breaks."""
    law = ThinLayer(made(Shrinking, replace(GLUE, G_I=1.0, G_II=2.0)), 0.1, at=1.0).material
    history, _ = along(law, (0.02, 0.1), (0.02, 0.2), (0.04, 0.4), (0.02, 0.2))
    assert (history.memory[:, 0] == [0, 1, 1, 1]).all()
    assert np.abs(history.tractions[1:]).max() < 1e-9
    assert history.energies[1, 1] == pytest.approx(400 / 340, rel=0.02)  # the elastic energy at the strength


def test_a_bilateral_joint_breaks_in_shear_alone():
    law = replace(JOINT, closure="bilateral")
    history, _ = along(law, (0.0, 0.5), (0.0, -0.5), (0.2, 0.01))
    assert history.tractions[:, 1] == pytest.approx([5e3, -5e3, 100.0])
    assert history.energies[:, 1] == pytest.approx([0, 0, 0.9])


def test_plane_stress_keeps_strength_and_toughness():
    law, elastic = GLUE.plane_stress(), LinearElastic(700.0, 500.0).plane_stress()
    history, _ = along(law, (0.0, 0.01), (0.0, 20 / (elastic.lmbda + 1000)), (0.0, 1.0))
    assert history.tractions[:, 1] == pytest.approx([0.01 * (elastic.lmbda + 1000), 20, 0], abs=1e-9)
    assert history.energies[:, 1].sum() == pytest.approx(3.0)


# ---------------------------------------------------------------- bars and beams
E, SIGMA, G_C = 30000.0, 3.0, 0.1  # of code_aster V1.01.359, a bar cut in the middle


def bar(L, K):
    """Half of it: the opening and the toughness are halves, the stiffness is doubled."""
    supports = {"TOP": {"y": lambda x, t: t}, "LEFT": {"x": 0.0}}
    joint = block(L / 4, L, L / 4, cell="quadrilateral", structured=True)
    return Structure(joint, body=LinearElastic.young(E, 0.0), supports=supports).interface(
        Cohesive(2 * K, 2 * K, SIGMA, SIGMA, G_C / 2, G_C / 2)
    )


def pulled(model, plan, L):
    return march(model, plan, observe={"stress": lambda state: state.reaction("TOP").force[1] / (L / 4)})


@pytest.mark.parametrize("K", [1e4, 1e6])
def test_a_bar_of_code_aster(K):
    """Its closed form, at its end displacement .0199."""
    L, end = 99.5, 0.0199
    U_c, U_f = L * SIGMA / E + SIGMA / K / 2, G_C / SIGMA
    stress = SIGMA * (U_f - end) / (U_f - U_c)
    assert pulled(bar(L, K), [end], L).table["stress"][-1] == pytest.approx(stress, rel=1e-6)


def test_a_long_bar_snaps_back():
    """It turns where it cracks, and goes back on a straight line to G/sigma, where nothing is left."""
    model, turn = bar(500.0, 1e4), 0.05 + 1.5e-4
    assert refused(TurningPoint, "turn back", march, model, [0.02, 0.06]).history.t.max() > 0.98 * turn
    table = pulled(model, ArcLength(end=0.06, first=0.01), 500.0).table
    t, stress = table["t"], table["stress"]
    (on_return,) = np.nonzero((np.diff(t, append=1.0) < 0) & (stress < 0.98 * SIGMA))
    assert len(on_return) >= 3
    assert t[np.flatnonzero(np.diff(t) < 0)[0]] == pytest.approx(turn, rel=1e-2)
    line = SIGMA * (t[on_return] - G_C / SIGMA) / (turn - G_C / SIGMA)
    assert stress[on_return] == pytest.approx(line, abs=1e-6 * SIGMA)
    assert table["dissipated"].sum() == pytest.approx(G_C / 2 * 125.0, rel=1e-9)


def cracked(x):
    return 1.0 * (x[0] < 30)


def beams(h_S=1.0):
    """A double cantilever beam, arms of 3, with a crack of 30."""
    ends = {(0, s * 3.0): {"y": lambda x, t, s=s: s * t} for s in (1, -1)} | {
        (48, s * 3.0): {"x": 0.0} for s in (1, -1)
    }
    joint = sandwich(48, 3, 3, h=1.5, h_S=h_S, cell="quadrilateral", structured=True)
    return Structure(joint, body=LinearElastic.young(70e3, 0.3), supports=ends)


BEAM_GLUE = Breaking(0.0, 500.0, 20.0, 30.0, 3.0, 9.0, eta=2.0, cracked=cracked)


@cache
def opened(kind, first, end=0.7):
    layer = ThinLayer(BEAM_GLUE, 0.1)
    model = beams().full(layer, cells_through=1) if kind == "meshed" else beams().interface(layer)
    return march(model, ArcLength(end=end, first=first), observe={"P": lambda state: state.reaction((0, 3.0)).force[1]})


TIMOSHENKO = {1.077956: 6.505887, 1.269884: 5.993563, 1.337372: 5.840228}  # opening: force, of beams on such a layer


def test_a_double_cantilever_beam():
    """Within 1 % of beams, with 4 facets in the fracture zone; meshed as on S; any steps dissipate the same."""
    fine, on_s, meshed = opened("S", 0.05).table, opened("S", 0.1).table, opened("meshed", 0.1).table
    assert np.interp([*TIMOSHENKO], 2 * fine["t"], fine["P"]) == pytest.approx([*TIMOSHENKO.values()], rel=0.01)
    assert meshed["P"][-1] == pytest.approx(on_s["P"][-1], rel=1e-3)
    assert len(fine["t"]) > 1.5 * len(on_s["t"])
    assert on_s["dissipated"].sum() == pytest.approx(fine["dissipated"].sum(), rel=1e-9)
    assert meshed["dissipated"].sum() == pytest.approx(on_s["dissipated"].sum(), rel=1e-3)
    sharp = math.sqrt(70e3 / 0.91 * 2.25 * 0.3) / 33  # of a sharp crack of 33, a wrong twin
    assert abs(sharp / 5.993563 - 1) > 0.1


def test_trapezoidal_work_of_a_beam():
    """Less what is stored and dissipated, of order 2 in the steps. Wrong twin: forces at their ends, of order 1."""
    errors = []
    for first in (0.1, 0.05):
        table = opened("S", first).table
        P, t = 2 * table["P"], table["t"]  # both arms are moved
        cost = table["energy"][-1] + table["dissipated"].sum()
        works = np.trapezoid(P, t), (P[1:] * np.diff(t)).sum()
        errors.append([abs(work - cost) for work in works])
    ratios = np.divide(*errors)
    assert errors[0][0] < 0.01 * cost
    assert ratios[0] > 3.0 > 2.5 > ratios[1]


def test_a_crack_that_closes_starts_from_rest(monkeypatch):
    """Contact at the end of the crack alone, which Newton's method finds facet by facet."""
    monkeypatch.setattr(enf, "END", 0.6)
    table, beams = enf.bend(1.0).table, enf.HALVES.envelope(enf.CRACK)
    stiffness = table["force"][1:] / table["t"][1:]
    assert stiffness == pytest.approx(beams["force"][1] / beams["displacement"][1] * np.ones(len(stiffness)), rel=0.01)
    assert np.ptp(stiffness[:2]) < 1e-6


def forces(kind):
    table = opened(kind, 0.2, 0.6).table
    return [*table["P"].tolist(), float(table["dissipated"].sum())]


def forces_of_both():
    return [forces("S"), forces("meshed")]


@on_ranks(forces_of_both, 2)
def test_beams_on_several_ranks(there):
    for values, expected in zip(there, forces_of_both(), strict=True):
        assert values == pytest.approx(expected, rel=1e-9)


# ---------------------------------------------------------------- blocks, on S and meshed
Y_0 = 1 / 280  # energy at the strength in both modes, per thickness
BLOCK = Breaking(60.0, 40.0, 1.0, math.sqrt(80 * Y_0), 6 * Y_0, 6 * Y_0)


def lifted(n, cell="quadrilateral"):
    """A block on its layer, between rollers, whose top is moved unevenly."""
    top = {"x": lambda x, t: t * ufl.sin(math.pi * x[0]) / 2, "y": lambda x, t: t * (0.8 + ufl.cos(math.pi * x[0]))}
    supports = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}, "TOP": top}
    joint = block(1.0, 0.25, 1 / n, cell=cell, structured=True)
    return Structure(joint, body=LinearElastic.young(100.0, 0.3), supports=supports)


def in_numbers(history):
    """Forces at times, and what is dissipated up to then."""
    spent = np.cumsum(history.table["dissipated"])
    return {
        round(state.t, 6): (state.prescribed_work / state.t, E)
        for state, E in zip(history, spent, strict=True)
        if state.t
    }


ON_S = {0.008: (0.770697, 0.000919012), 0.02: (0.539299, 0.006653066)}
LATE = {0.03: (0.411455, 0.010367576), 0.04: (0.443148, 0.011904550), 0.06: (0.582298, 0.013472858)}


@pytest.mark.parametrize("times", [[0.008, 0.02], pytest.param(np.linspace(0.002, 0.06, 30), marks=pytest.mark.long)])
def test_a_block_on_s(times):
    """An independent program's forces and energies; what is stored is half of the work of the forces, as of secants."""
    history = march(lifted(40).interface(ThinLayer(BLOCK, 0.1, at=1.0)), times)
    values = in_numbers(history)
    for t, expected in (ON_S if len(times) == 2 else ON_S | LATE).items():
        assert values[t] == pytest.approx(expected, rel=1e-5)
    assert history.last.audit.total == pytest.approx(values[times[-1]][0] * times[-1] / 2, rel=1e-10)


@pytest.mark.long
@pytest.mark.parametrize(
    ("law", "converges"),
    [(BLOCK, True), (made(Shrinking, replace(BLOCK, G_I=96 * Y_0, G_II=96 * Y_0)), False)],
)
def test_meshed_blocks_converge_to_the_law_on_s(law, converges):
    """Jumps, forces and energy, at the rate 1; not where the toughness per area shrinks with the thickness."""
    times, structure = np.linspace(0.002, 0.06, 30), lifted(40)

    def numbers(model):
        history = march(model, times)
        values, surface = in_numbers(history), Surface(model)
        jumps = [surface.jump(history.at(t)) for t in (0.012, 0.06)]
        return jumps, np.array([values[0.008][0], values[0.03][0], values[0.06][1]]), surface

    jumps, expected, _ = numbers(structure.interface(ThinLayer(BLOCK, 0.1, at=1.0)))
    errors = []
    for eps in (1 / 16, 1 / 32):
        thin, values, surface = numbers(structure.full(ThinLayer(law, eps, at=1.0), cells_through=1))
        jump_errors = [surface.norm(a - b) / surface.norm(b) for a, b in zip(thin, jumps, strict=True)]
        errors.append([*jump_errors, *np.abs(values / expected - 1)])
    rates = np.log2(np.divide(*errors))
    assert (rates.min() > 0.95) == converges


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_meshed_and_sound_is_elastic(cell):
    laws = LinearElastic(60.0, 40.0), replace(BLOCK, t_N=1e3, t_T=2e3, G_I=1e6, G_II=3e6)
    models = [lifted(8, cell).full(ThinLayer(law, 0.05), cells_through=1) for law in laws]
    elastic, sound = (march(model, [0.01]).last.u.x.array for model in models)
    assert sound == pytest.approx(elastic, abs=1e-11 * np.abs(elastic).max())


def test_a_sublayer_that_breaks():
    """A stack with one, meshed as on S; several are refused."""
    stack, structure = Stack((0.4, BLOCK), (0.6, LinearElastic(80.0, 20.0))), lifted(8)
    models = structure.interface(ThinLayer(stack, 0.1, at=1.0)), structure.full(ThinLayer(stack, 1 / 64, at=1.0))
    on_s, meshed = (in_numbers(march(model, [0.008, 0.02]))[0.02] for model in models)
    assert meshed == pytest.approx(on_s, rel=0.02)
    refused(InputError, "Breaking and Breaking; allowed: at most one", Stack, (0.5, BLOCK), (0.5, BLOCK))


PEELED = {
    "3D": ({"depth": 2.0, "cell": "hexahedron"}, {}, "LEFT/UPPER"),
    "revolution": ({"h_S": 0.5, "cell": "quadrilateral"}, {"plane": "axisymmetric"}, "RIGHT/UPPER"),
}


@pytest.mark.long
@pytest.mark.parametrize("name", PEELED)
def test_peeling_in_3d_and_of_a_revolution(name):
    """Half of the layer has gone; what remains, and what it cost, is as on S."""
    of_joint, of_structure, side = PEELED[name]
    supports = {"BOTTOM": 0.0, side: {"y": lambda x, t: t}} | ({"LEFT/UPPER": {"x": 0.0}} if of_structure else {})
    joint, body = sandwich(8.0, 1.0, 1.0, h=1.0, **of_joint), LinearElastic.young(1000.0, 0.3)
    structure = Structure(joint, body=body, supports=supports, **of_structure)
    layer = ThinLayer(Breaking(20.0, 15.0, 2.0, 1.5, 0.4, 0.8, eta=1.5), 0.1)
    values = []
    for model in (structure.interface(layer), structure.full(layer, cells_through=1)):
        history = march(model, ArcLength(end=0.2, first=0.03, largest=3))
        row, d = history.table.rows[-1], Surface(model).internal(history.last, "d")
        assert d.max() == 1.0 > d.min() == 0.0
        values.append([row["broken"], history.last.prescribed_work, history.table["dissipated"].sum()])
    assert values[1] == pytest.approx(values[0], rel=0.02)
    assert 0.2 < values[0][0] < 0.8


# ---------------------------------------------------------------- what results and messages say
@pytest.mark.parametrize("kind", ["S", "meshed"])
def test_results_of_a_beam(kind):
    history = opened(kind, 0.2, 0.6)
    surface, row = Surface(history.model), history.table.rows[-1]
    d, area = surface.internal(history.last, "d"), surface.weights.sum(axis=1)
    assert d.shape == (48, 1)
    assert area @ d[:, 0] / 48 == pytest.approx(row["broken"] + 0.75 * row["breaking"], abs=0.3 * row["breaking"])
    assert row["broken"] > 0.5 > row["breaking"] > 2 / 48
    (columns,) = surface.table(history.last).rows
    assert (columns["broken"], columns["breaking"]) == pytest.approx((row["broken"], row["breaking"]), abs=1 / 48)
    refused(InputError, "unknown internal variable 'D', did you mean 'd'", surface.internal, history.last, "D")
    if kind == "S":
        words, x = surface.status(history.last)[:, 0], surface.x[0].mean(axis=1)
        assert (words[x < 30] == "broken").all()
        assert {*words} == {"elastic", "breaking", "broken"}
        assert sum(columns[name] for name in ("elastic", "breaking", "broken")) == pytest.approx(1.0)


@pytest.mark.parametrize(("strength", "warns"), [(1, False), pytest.param(2.0, True, marks=pytest.mark.long)])
def test_a_fracture_zone_of_few_facets_is_warned_of(strength, warns):
    law = replace(BEAM_GLUE, t_N=20.0 * strength, t_T=30.0 * strength, G_II=20.0)

    model = beams(1.5).interface(ThinLayer(law, 0.1))
    warnings = with_warnings(lambda: march(model, ArcLength(end=0.57, first=0.1)))[1]
    assert [w.partition(":")[0] for w in warnings] == ["fracture zone"] * warns
    assert not warns or "and facets 1.5: fewer than two" in warnings[0]


DATA = {"strength": (40.0, 30.0), "toughness": (0.4, 1.6), "eta": 2.0}


def test_glue_knows_its_bond_line():
    """It divides toughness per area by it, and layers of another thickness warn."""
    glue = Breaking.glue(2e3, 0.4, **DATA, bond_line=0.2)
    assert np.array([glue.G_I, glue.G_II]) == pytest.approx([2.0, 8.0])
    assert 0.2 * along(glue, (0.6, 0.0))[0].energies[0, 1] == pytest.approx(1.6)
    assert glue.mu == LinearElastic.young(2e3, 0.4).mu
    march_with = lambda layer: with_warnings(lambda: march(lifted(4).interface(layer), [1e-3]))[1]
    run = lambda layer: [w for w in march_with(layer) if w.startswith("bond line")]
    assert run(ThinLayer(glue, 0.2)) == run(ThinLayer(glue, 0.1, at=0.2)) == []
    (warning,) = run(ThinLayer(glue, 0.1))
    assert "per area it is 0.5 times that of the tests; give bond_line=0.1, or ThinLayer(..., at=0.2)" in warning
    wedge = lambda x: 1 + x[0] / x[0].max()
    tapered = [Breaking.glue(2e3, 0.4, **DATA, bond_line=line) for line in (0.2, lambda x: 0.2 * wedge(x))]
    (warning,), silence = (run(ThinLayer(law, 0.2, profile=wedge)) for law in tapered)
    assert ("its thickness 0.4 at (" in warning, silence) == (True, [])


REFUSED = [
    ({"G_I": 0.019}, r"toughness is \(0.019, 0.9\); allowed: more than .* it is 0.947 times that at the mode mixity 0.01"),
    ({"eta": 0.0}, "eta is 0.0; allowed: > 0"), ({"cracked": 1.1}, "cracked is 1.1; allowed: from 0"),
    ({"t_T": -1.0}, "t_T is -1.0"), ({"softening": "cubic"}, "softening is cubic; allowed: 'linear' or"),
    ({"knee_jump": 0.8}, r"knee_jump is 0.8; allowed: > 0, < 1/\(1 \+ knee_stress\) = 0.75"),
    ({"criterion": "B"}, "criterion is B"), ({"closure": "no"}, "closure is no"), ({"K_N": 0.0}, "K_N is 0.0"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "words"), REFUSED)
def test_parameters_out_of_range(changes, words):
    refused(InputError, words, replace, JOINT, **changes)


def test_data_of_glue_out_of_range():
    glue = partial(Breaking.glue, 2e3, 0.45, bond_line=0.2)
    for name, pair in (("strength", 40.0), ("strength", "40"), ("toughness", (1, 2, 3))):
        refused(InputError, f"{name} is .*; allowed: two values, in opening and in shear", glue, **DATA | {name: pair})
    refused(InputError, "bond_line is '0.2'", glue, **DATA, bond_line="0.2")
    brittle = glue((40.0, 40.0), (0.05, 1.6))
    refused(InputError, "it is 0.784 times that at the mode mixity 0", brittle.plane_stress)


@pytest.mark.parametrize("criterion", ["BK", "power"])
def test_pure_modes_have_their_toughness(criterion):
    """Also for exponents whose slope there is infinite. Wrong twin: a mixity of at least 1e-12, which makes .3 to .47."""
    law = Cohesive(1e4, 1e4, 2.0, 2.0, 0.3, 3.0, 0.1, criterion=criterion)
    assert along(law, (0.0, 4.0))[0].energies[0, 1] == pytest.approx(0.3, rel=1e-9)
    assert along(law, (4.0, 0.0))[0].energies[0, 1] == pytest.approx(3.0, rel=1e-9)


WRONG_CURVES = {
    "damage is 0.1 at x = 1,": {"damage": lambda curve, x: 1 - 0.9 / x},
    "stress over strength is 1.00.*; allowed: at most 1": {"damage": lambda curve, x: 1 - ufl.sqrt(ufl.as_ufl(1 / x))},
    "damage is 1.*; allowed: at most 1": {"damage": lambda curve, x: 1.2 * LinearSoftening.damage(curve, x)},
    "damage is .* allowed: no less than before": {"damage": lambda curve, x: (x - 1) * (3 - x) / 4 / x},
    "allowed: the integral of x.2 over": {"energy": lambda curve, d: d * curve.k},
}


@pytest.mark.parametrize("words", WRONG_CURVES)
def test_softening_curves_are_checked(words):
    """Stress falls from the strength, and the energy is the area below; those of the package pass from k = 1 to 1e4."""
    curve = type("Mine", (LinearSoftening,), WRONG_CURVES[words])
    law = type("Curved", (Cohesive,), {"softening_curve": lambda self, k: curve(k)})
    refused(InputError, words, law, **{f.name: getattr(JOINT, f.name) for f in fields(JOINT)})
    for k in (1.001, 3.0, 1e4):
        for right in (LinearSoftening(k), ExponentialSoftening(k), BilinearSoftening(k, 0.4, 1 / 3)):
            right.check()


def test_uses_that_are_refused():
    layer, structure = ThinLayer(BLOCK, 0.1), lifted(4)
    model = structure.interface(layer)
    refused(InputError, "falls as jumps grow", solve, model)
    refused(InputError, "falls as jumps grow", march, model, Adaptive(end=0.05, first=0.01))
    refused(InputError, "theta is 0.5", march, model, [0.01], theta=0.5)
    refused(InputError, "order=1 of Breaking", replace, layer, order=1)
    refused(
        InputError,
        "let a layer soften|depends on the normal",
        Structure,
        block(1.0, 0.25, 0.25),
        body=BLOCK,
        supports={},
    )
    varying = ThinLayer(replace(BLOCK, cracked=lambda x: 2 * x[0]), 0.1)
    refused(InputError, r"cracked is 1.75; allowed: .*, at x = \(0.875, 0\)", structure.interface, varying)
