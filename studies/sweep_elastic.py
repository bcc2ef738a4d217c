"""Elastic layer between two blocks: the interface law's error is O(eps)."""

from __future__ import annotations

from collections.abc import Sequence

from studies.problems import FOURIER_LAYER, fourier
from thinlayer import Model, ThinLayer, compare, plotting, solve, sweep
from thinlayer.record import Record


def run(
    record: Record, *, eps: Sequence[float] = (1 / 8, 1 / 16, 1 / 32, 1 / 64), bodies: str = "kept", quick: bool = False
) -> None:
    """Sweep the thickness with the moduli over thickness held.

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high.
        bodies: "kept" or "extended".
        quick: coarser mesh.
    """
    joint, setup = fourier(h=1 / 8 if quick else 1 / 32)
    record.parameters = {"h": 1 / 8 if quick else 1 / 32, "layer": str(FOURIER_LAYER), "bodies": bodies}
    pictured = sorted(eps)[len(eps) // 2]

    def compare_at(e: float) -> dict[str, float]:
        layer = ThinLayer(FOURIER_LAYER, e)
        full = record.solved(solve(Model.full(joint, layer=layer, bodies=bodies, **setup)))
        limit = record.solved(solve(Model.interface(joint, layer=layer, **setup)))
        row = compare(full, limit)
        if e == pictured:
            states = {f"meshed layer, eps = {e:g}": full, "interface law": limit}
            plotting.deformed(states, save=record.path("deformed.png"))
        return row

    table = sweep(compare_at, eps, record.path("table.csv"))
    draw(record)
    record.say(table)
    if len(eps) > 1:
        for name in ("traction", "jump"):
            record.check(f"last observed order of the {name}", table[f"order_{name}"][-1], low=0.95, high=1.05)


def draw(record: Record) -> None:
    """Draw the rates from table.csv."""
    if record.root:
        plotting.rates(
            record.path("table.csv"), save=record.path("rates.png"), title="elastic layer between two blocks"
        )
