"""Elastic layer between two blocks: the interface law's error is O(eps)."""

from __future__ import annotations

from collections.abc import Sequence

from studies.problems import FOURIER_LAYER, fourier
from thinlayer import Model, Table, ThinLayer, compare, plotting, solve, sweep
from thinlayer.record import Record


def run(
    record: Record,
    *,
    eps: Sequence[float] = (1 / 8, 1 / 16, 1 / 32, 1 / 64),
    bodies: str = "kept",
    order: int = 0,
    quick: bool = False,
) -> None:
    """Sweep the thickness with the moduli over thickness held.

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high.
        bodies: "kept" or "extended".
        order: of the interface law, 0 or 1.
        quick: coarser mesh.
    """
    h = (1 / 8, 1 / 16)[order] if quick else 1 / 32
    joint, setup = fourier(h)
    record.parameters = {"h": h, "layer": str(FOURIER_LAYER), "bodies": bodies, "order": order}
    pictured = sorted(eps)[len(eps) // 2]

    def compare_at(e: float) -> dict[str, float]:
        layer = ThinLayer(FOURIER_LAYER, e, order=order)
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
            ends = (0.95, 1.05) if order == 0 else (1.9, 2.1)
            record.check(f"last observed order of the {name}", table[f"order_{name}"][-1], low=ends[0], high=ends[1])


def draw(record: Record) -> None:
    """Draw the rates from table.csv."""
    if not record.root:
        return
    table = Table.load(record.path("table.csv"))
    slope = 2.0 if table["order_traction"][-1] > 1.5 else 1.0
    title = "elastic layer between two blocks"
    plotting.rates(table, save=record.path("rates.png"), title=title, reference=slope)
