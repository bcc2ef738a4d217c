"""Results of joints that break: energies, mode mix and crack fronts on S and meshed; failure loads and their errors."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from forms import Breaking, Cohesive, CohesiveFriction, LinearElastic, Stack, VonMises
from forms.base import InputError
from geometry import block, sandwich
from tests.on_ranks import on_ranks
from tests.refused import refused
from thinlayer import (
    ArcLength,
    Structure,
    Surface,
    Table,
    ThinLayer,
    failure_load,
    march,
    plotting,
    sensitivity,
)  # fmt: skip

STEEL = LinearElastic.young(70e3, 0.3)
JOINT = Cohesive(K_N=1e4, K_T=6e3, t_N=20.0, t_T=30.0, G_I=0.3, G_II=0.9, eta=2.0)
GLUE = Breaking(lmbda=400.0, mu=300.0, t_N=20.0, t_T=30.0, G_I=3.0, G_II=9.0, eta=2.0)
EPS = 0.1


@cache
def moved(kind, u_x, u_y, law=None, steps=4):
    """Two blocks, as stiff as rigid ones, of which the upper one moves along (u_x, u_y) in equal steps."""
    joint = sandwich(2.0, 0.5, 0.5, 0.5, cell="quadrilateral", structured=True)
    ends = {"BOTTOM": 0, "TOP": {"x": lambda x, t: t * u_x, "y": lambda x, t: t * u_y}}
    structure = Structure(joint, body=LinearElastic.young(1e12, 0.0), supports=ends)
    layer = ThinLayer(law or GLUE, EPS) if kind == "meshed" else law or JOINT
    model = structure.full(layer, cells_through=1) if kind == "meshed" else structure.interface(layer)
    return march(model, np.linspace(0, 1, steps + 1)[1:])


def integrals(history):
    surface = Surface(history.model)
    return np.array([surface.integral(step) for step in surface.dissipated(history)])


# ---------------------------------------------------------------- fields on S
@pytest.mark.parametrize(("kind", "degrees"), [("S", 0), ("S", 60), ("S", 90), ("meshed", 30)])
def test_mode_mix_and_energy_of_a_ray(kind, degrees):
    """B = K_T tan^2/(K_N + K_T tan^2), and the toughness at B where all is broken."""
    sine, cosine = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    history = moved(kind, 0.09 * sine, 0.09 * cosine)
    K_N, K_T = (1e4, 6e3) if kind == "S" else (1e4, 3e3)
    B = K_T * sine**2 / (K_N * cosine**2 + K_T * sine**2)
    surface = Surface(history.model)
    middle = np.abs(surface.x[0].mean(axis=1) - 1) < 0.6  # away from the free ends of a meshed layer
    for state in (history.states[1], history.last):
        assert surface.mode_mix(state)[middle] == pytest.approx(B, abs=1e-9 if kind == "S" else 2e-5)
    assert np.isnan(surface.mode_mix(history.states[0])).all()
    spent = surface.dissipated(history)
    assert spent.shape == (5, 4, 1)
    assert spent.sum(axis=0)[middle] == pytest.approx(0.3 + 0.6 * B**2, rel=1e-9 if kind == "S" else 1e-4)


@cache
def peeled(kind):
    """A double cantilever beam with a crack of 12."""
    ends = {(0, s * 2.0): {"y": lambda x, t, s=s: s * t} for s in (1, -1)} | {(24, s): {"x": 0.0} for s in (2.0, -2.0)}
    joint = sandwich(24, 2, 2, h=2, h_S=1, cell="quadrilateral", structured=True)
    structure = Structure(joint, body=STEEL, supports=ends)
    glue = Breaking(0.0, 500.0, 20.0, 30.0, 3.0, 9.0, eta=2.0, cracked=lambda x: 1.0 * (x[0] < 12))
    layer = ThinLayer(glue, EPS)
    model = structure.full(layer, cells_through=1) if kind == "meshed" else structure.interface(layer)
    return march(model, ArcLength(end=0.3, first=0.05), observe={"P": lambda state: state.reaction((0, 2.0)).force[1]})


@pytest.mark.parametrize("kind", ["S", "meshed"])
def test_energy_and_front_of_a_crack_that_peels(kind):
    """The toughness where it has passed, none ahead, and the table's column in each step; the front is where d is 1."""
    history = peeled(kind)
    surface = Surface(history.model)
    spent = surface.dissipated(history)
    assert integrals(history) == pytest.approx(history.table["dissipated"], abs=1e-14)
    d, x = surface.internal(history.last, "d")[:, 0], surface.x[0].mean(axis=1)
    total = spent.sum(axis=0)[:, 0]
    assert total[(d == 1) & (x > 12)] == pytest.approx(0.3, rel=1e-9)
    assert (total[(d == 0) | (x < 12)] == 0).all()
    ((front, _),), ((sound, _),) = surface.crack_front(history.last), surface.crack_front(history.last, d=0)
    assert front == pytest.approx(24 * history.table["broken"][-1], abs=1e-9)
    assert sound - front == pytest.approx(24 * history.table["breaking"][-1], abs=1e-9)
    assert 14 < front < sound < 24
    assert np.nanmax(surface.mode_mix(history.last)) < 1e-9


def oblique(x):
    return 1.0 * (x[0] < 3 + 0.5 * x[2])


@cache
def in_space():
    """A double cantilever beam with a broken part whose edge is oblique."""
    joint = sandwich(6, 1, 1, 1, depth=3, cell="hexahedron", structured=True)
    ends = {"LEFT/UPPER": {"y": lambda x, t: t}, "LEFT/LOWER": {"y": lambda x, t: -t}, "RIGHT": 0}
    structure = Structure(joint, body=STEEL, supports=ends)
    return march(structure.interface(Cohesive(1e4, 1e4, 20, 20, 0.3, 0.3, cracked=oblique)), [0.01])


def fronts():
    history = in_space()
    return Surface(history.model).crack_front(history.last).ravel().tolist(), integrals(history).tolist()


@on_ranks(fronts, 2)
def test_an_oblique_front_in_space(there):
    """Between facets of size 1, in order along its line; also on two ranks."""
    points, energies = fronts()
    x, y, z = np.reshape(points, (-1, 3)).T
    assert x == pytest.approx(3 + z / 2, abs=0.31)
    assert x[1:-1] == pytest.approx(3 + z[1:-1] / 2, abs=1e-9)
    assert not y.any()
    assert (np.diff(z) > 0).all()
    assert (z[0], z[-1]) == (0, 3)
    assert energies == pytest.approx(in_space().table["dissipated"], rel=1e-12)
    assert there[0] == pytest.approx(points, abs=1e-12)
    assert there[1] == pytest.approx(energies, rel=1e-9)


def test_energies_of_other_laws():
    """Friction after breaking, plastic yielding, and a sudden load: what the table has."""
    rubbing = CohesiveFriction(1e4, 6e3, 20.0, 30.0, 0.3, 0.9, friction=0.5)
    for law in (rubbing, ThinLayer(VonMises.young(2e3, 0.3, 20.0), EPS)):
        history = moved("S", 0.05, -0.001, law)
        assert integrals(history) == pytest.approx(history.table["dissipated"], rel=1e-12)
        assert history.table["dissipated"].max() > 0


# ---------------------------------------------------------------- failure load
def largest(t_T=1.0, G_II=1.0):
    """Force of a bar of 8 x .1 and EA = 1000 on springs that soften, for multiples of their strength and toughness."""
    start, slope = 0.01 * t_T, t_T / (0.1 * G_II / t_T - 0.01 * t_T)
    m, w = math.sqrt(0.1), math.sqrt(slope / 1000)

    def minus_force(zone):
        elastic = 1000 * m * start * math.tanh(m * (8 - zone))
        return -(t_T / w * math.sin(w * zone) + elastic * math.cos(w * zone))

    return -minimize_scalar(minus_force, bounds=(0, 8), method="bounded", options={"xatol": 1e-10}).fun


def force(state):
    return state.reaction("RIGHT").force[0]


@cache
def pulled_out(h, first, lift=0.0):
    layer = Cohesive(100.0, 100.0, 1.0, 1.0, 0.05, 0.05, closure="bilateral")
    joint = block(8.0, 0.1, h, cell="quadrilateral", structured=True)
    supports = {"RIGHT": {"x": lambda x, t: t, **({"y": lift} if lift else {})}}
    structure = Structure(joint, body=LinearElastic.young(1e4, 0.0), supports=supports)
    return march(structure.interface(layer), ArcLength(end=0.06, first=first), observe={"force": force})


@pytest.mark.parametrize("first", [0.01, 0.006])
def test_the_failure_load_and_its_errors(first):
    """The true one is between the highest state and the bound by steps and mesh, which falls with the steps."""
    coarse, fine = (failure_load(pulled_out(h, first), "force") for h in (0.8, 0.4))
    both = failure_load(pulled_out(0.4, first), "force", coarser=pulled_out(0.8, first))
    assert (both.value, both.by_steps) == (fine.value, fine.by_steps)
    assert both.by_mesh == pytest.approx(abs(fine.value - coarse.value) + coarse.by_steps)
    assert abs(both.value - largest()) < both.error < 0.1 * largest()
    assert fine.value < largest() < fine.value + fine.by_steps
    assert f"{fine.value:.4g}, errors" in str(fine)


def test_errors_by_steps_of_peaks_of_a_known_shape():
    """Pointed: the lines meet in the peak, whatever the steps. Round, 1 - t^2: above the peak, with the square of steps."""
    history = pulled_out(0.8, 0.01)

    def peak(t, P):
        rows = Table.of({"t": t, "P": P})
        return failure_load(type(history)(history.model, rows), "P")

    for start in (-1.0, -0.83, -0.71):
        t = start + 0.3 * np.arange(8)
        pointed = peak(t, np.minimum(2 + t, 2 - 3 * t))
        assert pointed.value + pointed.by_steps == pytest.approx(2.0)
        rounds = [peak(t * h, 1 - (t * h) ** 2) for h in (1.0, 0.5)]
        assert all(a.value + a.by_steps + 1e-12 >= 1 for a in rounds)
        assert 4 * rounds[1].by_steps == pytest.approx(rounds[0].by_steps)


def test_derivatives_of_the_failure_load():
    """Against the closed form; and forces grow with all stiffnesses, strengths and toughnesses together.

    Wrong twin: derivatives at the highest state alone, which another parameter moves away from the peak.
    """
    history = pulled_out(0.8, 0.01)
    peak = failure_load(history, "force")
    slopes = peak.derivatives(force, ["S.K_T", "S.t_T", "S.G_II", "BODY.mu"])
    assert largest() == pytest.approx(7.09807771, abs=1e-6)  # by Runge and Kutta's method
    assert sum(slopes.values()) == pytest.approx(largest(), rel=0.02)
    exact = {name: (largest(**{name: 1.0001}) - largest(**{name: 0.9999})) / 2e-4 for name in ("t_T", "G_II")}
    assert {name: slopes[f"S.{name}"] for name in exact} == pytest.approx(exact, rel=0.1)
    assert peak.derivatives(force, ["support RIGHT x"])["support RIGHT x"] == pytest.approx(0, abs=1e-9)
    alone = sensitivity(history, ["S.t_T"]).of(force, history.t[peak.row])["S.t_T"]
    assert abs(alone / exact["t_T"] - 1) > 0.1


def test_a_kink_behind_the_peak(monkeypatch):
    """The two states before serve, if the second is near the peak, else none."""
    peaks = [failure_load(pulled_out(0.8, first), "force") for first in (0.01, 0.006)]

    def kinked(history, *arguments, **options):
        if len(history) > 1 + next(peak.row for peak in peaks if peak.history.model is history.model):
            raise InputError("a kink")
        return sensitivity(history, *arguments, **options)

    monkeypatch.setattr("thinlayer.estimating.failure_load.sensitivity", kinked)
    exact = (largest(t_T=1.0001) - largest(t_T=0.9999)) / 2e-4
    assert peaks[0].derivatives(force, ["S.t_T"])["S.t_T"] == pytest.approx(exact, rel=0.05)
    refused(InputError, "no slopes of both signs", peaks[1].derivatives, force, ["S.t_T"])


def test_a_picture_of_loads_over_displacements(tmp_path):
    history = peeled("S")
    beams = Table.of({"t": [0.0, 0.1], "P": [0.0, 3.0]})
    picture = plotting.load_displacement(
        {"S": history, "beams": beams}, "t", {"force": "P", "energy": "dissipated"}, "t"
    )
    drawn = [{line.get_label(): line.get_xydata() for line in axes.lines} for axes in picture.figure.axes]
    assert drawn[0]["S"] == pytest.approx(np.column_stack([history.table["t"], history.table["P"]]))
    assert [sorted(lines) for lines in drawn] == [["S", "beams"], ["S"]]
    refused(InputError, "no path has this column", plotting.load_displacement, beams, "t", "Q", "t")
    refused(InputError, "give a history or a table", plotting.load_displacement, [1.0], "t", "P", "t")


def test_refused_results():
    history = peeled("S")
    surface, last = Surface(history.model), history.last
    thin = march(history.model, [0.01, 0.02], observe={"t_2": lambda state: state.t}, keep="last")
    refused(InputError, "keep='all'", surface.dissipated, thin)
    refused(InputError, "give a history", surface.dissipated, last)
    refused(InputError, "from 0 to below 1", surface.crack_front, last, 1.0)
    refused(InputError, "in row 2 of 3", failure_load, thin, "t_2")
    refused(InputError, "unknown column 'Q'", failure_load, history, "Q")
    loaded = pulled_out(0.8, 0.01)
    heavy = replace(loaded, model=loaded.model.with_loads(body_force=(0.0, -1.0)))
    refused(InputError, "compare two runs", failure_load(heavy, "force").derivatives, force, ["S.t_T"])
    lifted = pulled_out(0.8, 0.01, 1e-3)
    refused(InputError, "in proportion", failure_load(lifted, "force").derivatives, force, ["S.t_T"])
    elastic = moved("S", 0.01, 0.0, ThinLayer(STEEL, EPS), steps=1)
    refused(InputError, "no layer", Surface(elastic.model).mode_mix, elastic.last)
    refused(InputError, "internal variable", Surface(elastic.model).crack_front, elastic.last)
    stack = moved("S", 0.01, 0.0, ThinLayer(Stack((0.5, GLUE), (0.5, STEEL)), EPS), steps=1)
    refused(InputError, "Stack", Surface(stack.model).mode_mix, stack.last)
