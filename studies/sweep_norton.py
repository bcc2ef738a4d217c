"""Norton layer, a spring and a power-law dashpot, between two blocks: error O(eps) for p = 1.5 and p = 3."""

from __future__ import annotations

from collections.abc import Sequence

from forms import Norton
from studies.sweeping import Solution, draw_rates, sweep_in_time
from thinlayer import History, Surface
from thinlayer.running.record import Record

LAYERS = {"": Norton(lmbda=60.0, mu=40.0, eta=5.0, p=1.5), "p3": Norton(lmbda=60.0, mu=40.0, eta=2000.0, p=3.0)}
EARLY = 0.05
TIMES = (0.01, 0.02, 0.03, 0.04, EARLY, 0.1, 0.15, 0.2, 0.25)
SPECTRAL = {"traction": 0.56140781698, "jump": 7.0602412711e-4}  # norms on S, p = 1.5 at EARLY, with the same steps


def run(record: Record, *, eps: Sequence[float] = (1 / 8, 1 / 16, 1 / 32, 1 / 64), quick: bool = False) -> None:
    """Sweep the thickness with eta/eps^(p - 1) and the moduli over thickness held; both models take the same steps.

    table.csv has p = 1.5, table_p3.csv p = 3. At rest the tangent is infinite for p < 2, and zero for p > 2.

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high.
        quick: coarser mesh.
    """
    h = 1 / 8 if quick else 1 / 16
    titles = {case: f"Norton layer, p = {law.p:g}" for case, law in LAYERS.items()}
    table = sweep_in_time(record, LAYERS, dict.fromkeys(LAYERS, TIMES), eps, h, titles, early)[""]
    for name, value in SPECTRAL.items():
        error = abs(table[f"early_{name}"][-1] / value - 1)
        record.check(f"{name} at t = {EARLY:g}, from a spectral solution", error, high=5e-4 if quick else 1e-4)


def early(_: Solution, limit: Solution) -> dict[str, float]:
    """L2 norms on S of the interface law's traction and jump at the time EARLY."""
    assert isinstance(limit, History)
    state, surface = limit.at(EARLY), Surface(limit.model)
    return {
        "early_traction": surface.norm(surface.traction(state)),
        "early_jump": surface.norm(surface.jump(state)),
    }


def draw(record: Record) -> None:
    """Draw the rates from the tables."""
    cases = {"p = 1.5": "table.csv", "p = 3": "table_p3.csv"}
    draw_rates(record, title="Norton layer", cases=cases)
