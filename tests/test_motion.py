"""Marches of structures with mass: releases, impacts, energy, orders, starts that balance, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import ufl
from dolfinx import fem

from forms import KelvinVoigt, LinearElastic, VonMises
from forms.base import InputError
from geometry import sandwich
from tests.capabilities import COLUMNS
from tests.on_ranks import alone, on_ranks
from tests.refused import refused
from tests.vibrating_bars import SIDES, UNIFORM, WIDTH, bar
from thinlayer import ArcLength, Gap, Inertia, Structure, Surface, ThinLayer, Zoom, initial_state, march, modes, solve
from thinlayer.errors import LooseBody


def top(state) -> float:
    """The displacement of the top, where it is largest."""
    values = state.u.x.array
    return state.model.comm.allreduce(max(values.max(initial=0.0), -values.min(initial=0.0)), max)


def support_force(state) -> float:
    return float(state.reaction("BOTTOM").force[1])


OBSERVE = {"top": top, "R": support_force}


def steps(end, n):
    return end * np.arange(1, n + 1) / n


def test_mass_does_not_change_solve_and_a_release_is_a_wave():
    """The support bears the static load until the wave arrives."""
    model = bar(tractions={"TOP": (0, 1.0)})
    state, same = solve(model), solve(bar(tractions={"TOP": (0, 1.0)}, parts=[]))
    assert (state.u.x.array == same.u.x.array).all()
    history = march(replace(state, model=model.with_loads(tractions={"TOP": (0, 0.0)})), steps(0.3, 6), observe=OBSERVE)
    assert history.theta == 0.5
    assert history.table["R"] == pytest.approx(-WIDTH * np.ones(7), rel=1e-3)
    assert np.abs(history.table["imbalance"]).max() < 1e-12


def test_a_mode_vibrates():
    """From its shape, and from its velocities at rest: of second order, without loss of energy; theta = 1 loses it."""
    shapes = modes(bar(h=1 / 8), 1)
    omega, shape = shapes.omega[0], shapes.shapes[0]
    period, observe, forces = 2 * np.pi / omega, {**OBSERVE, "E": lambda s: s.audit.total}, []
    for n in (10, 20):
        table = march(shape, steps(period / 2, n), observe=observe, keep="last").table
        dt = period / 2 / n
        angle = 2 * n * np.arctan(omega * dt / 2)  # of the midpoint rule
        assert support_ratio(table) == pytest.approx(np.cos(angle), rel=1e-9)
        assert table["E"] == pytest.approx(omega**2 / 2 * np.ones(n + 1), rel=1e-11)
        forces.append(table["R"])
    assert (np.diff(forces[1]) > 0).all() == (forces[1][0] < 0)  # they would alternate without balanced accelerations
    damped = march(shape, steps(period / 2, 20), theta=1.0, observe=observe, keep="last").table
    assert damped["E"][-1] < 0.7 * damped["E"][0]
    same = march(initial_state(shapes.model, u=shape.u), steps(period / 2, 10), observe=observe, keep="last").table
    assert same["R"] == pytest.approx(forces[0], rel=1e-9)
    velocity = shape.u.copy()
    velocity.x.array[:] *= omega
    quarter = march(initial_state(shapes.model, velocity=velocity), steps(period / 4, 10), observe=OBSERVE, keep="last")
    angle = 20 * np.arctan(omega * period / 80)
    assert quarter.table["R"][-1] == pytest.approx(forces[0][0] * np.sin(angle), rel=1e-9)


def support_ratio(table) -> float:
    return table["R"][-1] / table["R"][0]


LAWS = {"KelvinVoigt": KelvinVoigt(0.0, 1 / 32, 0.0, 0.25), "yield": VonMises(0.0, 1 / 32, 0.02, 0.02)}


@pytest.mark.parametrize("name", LAWS)
def test_midpoint_steps_are_of_second_order(name):
    model = bar(law=LAWS[name], order=0, tractions={"TOP": lambda x, t: (0, t**2)}, h=1 / 8)
    tops = []
    for n in (10, 20, 40):
        history = march(model, steps(1.0, n), observe=OBSERVE, keep="last")
        tops.append(history.table["top"][-1])
        assert np.abs(history.table["imbalance"]).max() < 1e-11
    assert np.log2(np.diff(tops)[0] / np.diff(tops)[1]) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("name", ["KelvinVoigt", "elastic"])
def test_an_impact_through_a_layer(name):
    """The upper body falls onto the layer: forces of the first instant are those of the velocities."""
    law = LAWS.get(name, LinearElastic(0.0, 1 / 32))
    model = bar(law=law, h=1 / 8, parts=[Inertia(UNIFORM, velocity={"UPPER": (0, -1.0)})])
    history = march(model, steps(1.0, 20), observe={"R": support_force})
    assert history.states[0].energies()["inertia"] > 0
    forces = history.table["R"]
    assert np.abs(forces[:5]).max() < 2e-4  # the wave has not arrived
    assert forces[-1] > 1e-3


def test_tractions_on_s_are_those_of_the_bodies():
    """The law's mean traction differs from theirs by eps rho w''/12."""
    model = bar(tractions={"TOP": lambda x, t: (0, t**2)})
    state, surface = march(model, steps(1.0, 20)).last, Surface(model)
    reaction, law = (surface.integral(f(state)[1]) for f in (surface.reaction, surface.traction))
    acceleration = replace(state, u=state.memory["inertia"]["a"])
    inertia = surface.integral(surface.jump(acceleration)[1]) / 16 / 12
    assert abs(inertia) > 1e-3 * abs(law)
    assert reaction == pytest.approx(law + inertia, rel=1e-3)


@pytest.mark.filterwarnings("ignore:a shear wave crosses")
def test_a_zoom_has_the_inertia_of_the_layer():
    """Stresses differ at both faces by eps rho omega^2 times the displacement, as in the meshed layer."""
    stresses = []
    for kind in ("full", "interface"):
        lowest = modes(bar(kind=kind, h=1 / 8), 1)
        shape = lowest.shapes[0]
        stresses.append(np.sign(shape.u.x.array.sum()) * Zoom(shape).through((0.0, 0.0), 5)[1][:, 1, 1])
    meshed, zoomed = stresses
    assert meshed[0] - meshed[-1] > 0.07 * meshed[0]
    assert zoomed == pytest.approx(meshed, rel=1.5e-3)


def test_supports_that_move():
    """Velocities and accelerations at the start are those of the support; jumps are refused."""
    moving = {"supports": {"BOTTOM": {"y": lambda x, t: 0.1 * ufl.sin(3 * t)}, **SIDES}}
    coarse, fine = (march(bar(h=1 / 8, **moving), steps(0.4, n), observe=OBSERVE).table["R"] for n in (10, 20))
    assert np.abs(coarse - fine[::2]).max() < 0.1 * np.abs(fine).max()
    jumping = bar(supports={"BOTTOM": {"y": 0.1}, **SIDES})
    refused(InputError, "with mass they cannot jump", lambda: march(jumping, [0.1]))


KINDS = [("full", {}), ("interface", {"order": 1}), ("interface", {"order": 0})]


@pytest.mark.parametrize(("kind", "layer"), KINDS)
@pytest.mark.parametrize(
    "data",
    [{}, {"plane": "axisymmetric"}, pytest.param({"depth": 0.5}, marks=pytest.mark.long)],
    ids=["plane", "axis", "3D"],
)
def test_free_bodies_fall(kind, layer, data):
    """Without supports mass holds them; they fall freely, and the kinetic energy is that of bodies and layer."""
    joint = sandwich(1.0, 0.5, 0.5, 0.5, **{k: v for k, v in data.items() if k == "depth"})
    area = {"plane": 1.0, "axis": np.pi, "3D": 0.5}["axis" if "plane" in data else "3D" if data else "plane"]
    rho, g = {"LOWER": 2.0, "UPPER": 3.0, "S": 5.0}, {2: (0, -10.0), 3: (0, -10.0, 0)}[joint.dim]
    force = {name: tuple(density * c for c in g) for name, density in rho.items()}
    rest = {k: v for k, v in data.items() if k != "depth"}
    setup = Structure(joint, body=LinearElastic(1.0, 1.0), supports={}, body_force=force, parts=[Inertia(rho)], **rest)
    model = getattr(setup, kind)(ThinLayer(LinearElastic(1.0, 1.0), 0.1, **layer))
    last = march(model, steps(0.2, 2)).last
    assert last.u.x.array.min() == pytest.approx(-10 * 0.2**2 / 2, rel=1e-9)
    assert last.energies()["inertia"] == pytest.approx(area * (1.0 + 1.5 + 0.5) * 2.0**2 / 2, rel=1e-9)
    if kind == "full" and not data:
        refused(LooseBody, "can move", lambda: solve(model))


def run(out: Path | None, times, *, resume: bool = False) -> list[float]:
    model = bar(h=1 / 8, parts=[Inertia(UNIFORM, velocity={"UPPER": (0, -1.0)})])
    return [*march(model, times, observe={"top": top}, out=out, resume=resume).table["top"]]


def resumed(folder: Path) -> list[float]:
    """Begun on one rank, ended on all."""
    alone(lambda: run(folder, steps(1.0, 20)[:10]))
    return run(folder, steps(1.0, 20), resume=True)


@on_ranks(resumed, 2)
def test_resumed_on_two_ranks(there):
    assert there == pytest.approx(run(None, steps(1.0, 20)), rel=1e-10, abs=1e-12)


def test_refused():
    for density, words in (
        ({"LOWER": 1.0, "UPPER": 1.0}, "density of 'S' is None; allowed: >= 0"),
        ({**UNIFORM, "LOWER": 0.0}, "density of 'LOWER' is 0.0; allowed: > 0"),
        ({**UNIFORM, "T": 1.0}, "unknown body or layer 'T'"),
    ):
        refused(InputError, words, lambda density=density: bar(density=density))
    fast = Inertia(UNIFORM, velocity={"UPPER": (0, -1.0)})
    refused(InputError, "unlike velocities", lambda: bar(parts=[fast], kind="full"))
    refused(InputError, "give 2 numbers", lambda: bar(parts=[Inertia(UNIFORM, velocity={"UPPER": -1.0})]))
    refused(InputError, "has mass, and t is not a time", lambda: march(bar(), ArcLength(1.0, 0.1)))
    refused(InputError, "the model has no mass", lambda: initial_state(bar(parts=[])))
    model = bar(law=LAWS["yield"], order=0)
    refused(InputError, "has a memory or a pressure", lambda: initial_state(model, u=fem.Function(model.V)))
    refused(InputError, "give a function in model.V", lambda: initial_state(model, velocity=1.0))


NO_MASS = {"cell": "periodic cell under a mean strain", "softening": "has mass", "breaking": "has mass"}


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(COLUMNS.keys() - {"inertia", "twin", "march"}))
def test_mass_in_every_column(name):
    """Each kind of structure of the table of capabilities also moves, and its energy balances."""
    column = COLUMNS[name]()
    joint = column.joint()
    density = dict.fromkeys(joint.bodies, 2.0) | {seam: 1.0 for seam in joint.seams if not column.bonded}
    if isinstance(column.layers, dict):
        density = {k: rho for k, rho in density.items() if not isinstance(column.layers.get(k), Gap)}
    column.data = {**column.data, "parts": [*column.data.get("parts", []), Inertia(density)]}
    reason = "acts on a displacement" if name.startswith("heat") else NO_MASS.get(name)
    if reason:
        refused(InputError, reason, lambda: march(column.model, [0.2, 0.5]))
        return
    imbalances = np.array(march(column.model, [0.2, 0.5]).table["imbalance"], float)
    assert np.abs(imbalances[np.isfinite(imbalances)]).max(initial=0.0) < 1e-8
