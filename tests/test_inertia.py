"""Inertia, a part of one's own: a bar under a sudden load, with a layer and without; resumed, and wrong without `rate`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from forms import LinearElastic
from forms.base import InputError
from geometry import sandwich
from geometry.parallel import default_comm
from tests.on_ranks import alone, on_ranks
from tests.own_scripts.inertia import Inertia, Newmark
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, march, solve
from thinlayer.discretisation.part_definition import PartDefinition

LAYER = ThinLayer(LinearElastic(0.0, 0.02), 0.01)  # with a quarter of the compliance of the bar: 1 for E = rho = L = 1
STATIC = {"bonded": 1.0, "interface": 1.25}  # shortening under the pressure 1
COARSE = np.arange(1, 41) / 40


def bar(kind: str, part: Inertia | None, h: float = 0.02):
    """A model of a bar of the length 1 that stands, without lateral strains, under the pressure 1 on its top."""
    data = {"body": LinearElastic(0.0, 0.5), "tractions": {"TOP": (0, -1)}, "parts": [part] if part else []}
    joint, supports = sandwich(h, 0.5, 0.5, h, cell="quadrilateral"), {"BOTTOM": {"y": 0}, "LEFT": {"x": 0}}
    structure = Structure(joint, supports=supports, **data)
    return structure.bonded() if kind == "bonded" else structure.interface(LAYER)


def shortening(state) -> float:
    return default_comm().allreduce(-float(state.u.x.array.min(initial=0.0)), max)


LARGEST = [("interface", 1.962, 2.175), pytest.param("bonded", 1.992, 2.015, marks=pytest.mark.long)]


@pytest.mark.parametrize(("kind", "largest", "when"), LARGEST)
def test_a_sudden_load_shortens_a_bar_nearly_twice_as_much(kind, largest, when):
    """At t = 2 L/c by 2 times the static shortening; 300 modes give 1.994 without a layer, 1.955 to 1.968 with one."""
    history = march(bar(kind, Inertia(1.0)), np.arange(1, 451) / 200, observe={"w": shortening}, keep="last")
    w = history.table["w"] / STATIC[kind]
    assert (w[0], w.max()) == (0.0, pytest.approx(largest, abs=1e-3))
    assert history.t[w.argmax()] == pytest.approx(when, abs=0.011)
    assert np.abs(history.table["imbalance"]).max() < 1e-10
    assert solve(bar(kind, None)).u.x.array.min() == pytest.approx(-STATIC[kind], rel=1e-9)


def test_reactions_on_s_contain_the_forces_of_inertia():
    """They are those of the law, stiffness 4 times the jump."""
    model = bar("interface", Inertia(1.0), h=0.1)
    state, surface = march(model, COARSE[:30], keep="last").last, Surface(model)
    traction, jump = (surface.integral(f[1]) for f in (surface.reaction(state), surface.jump(state)))
    assert traction == pytest.approx(4 * jump, rel=1e-9)


def test_misspelt_and_missing_methods_of_a_part_are_refused():
    refused(InputError, "did you mean 'failure'", lambda: type("Own", (Newmark,), {"faillure": lambda self: ""}))
    refused(
        InputError,
        "without 'switch_phases'; define both",
        lambda: type("Own", (Newmark,), {"phase_gain": lambda self: 0.0}),
    )
    assert type("Own", (Newmark,), {"reset": lambda self: None}).failure is Newmark.failure


def run(out: Path | None, times, *, resume: bool = False) -> list[float]:
    """Shortenings of a bar; velocities and accelerations are of degree 2, as displacements are."""
    model = bar("interface", Inertia(1.0), h=0.1)
    return [*march(model, times, observe={"w": shortening}, out=out, resume=resume).table["w"]]


def resumed(folder: Path) -> list[float]:
    """Begun on one rank, ended on all."""
    alone(lambda: run(folder, COARSE[:20]))
    return run(folder, COARSE, resume=True)


@on_ranks(resumed, 2)
def test_resumed_on_two_ranks(there):
    assert there == pytest.approx(run(None, COARSE), rel=1e-10, abs=1e-12)


@dataclass(frozen=True)
class WithoutWork(PartDefinition):
    key: str = "inertia"

    def part(self, model):
        return Newmark(Inertia(1.0), model)


@dataclass(frozen=True)
class Forgetful(Inertia):
    def part(self, model):
        part = Newmark(self, model)
        commit = part.commit
        part.commit = lambda: replace(commit(), memory=None)
        return part


def test_refused():
    silent = bar("interface", WithoutWork(), h=0.1)
    state = march(silent, [0.1]).last
    refused(InputError, "forces of the part 'inertia': write work_in", lambda: Surface(silent).reaction(state))
    forgetful = bar("bonded", Forgetful(1.0), h=0.1)
    refused(InputError, "'inertia' remembers; let its commit return", lambda: march(forgetful, [0.1]))
    model = bar("bonded", Inertia(1.0), h=0.1)
    refused(InputError, "inertia balances forces at the ends of steps", lambda: march(model, [0.1, 0.2], theta=0.5))
