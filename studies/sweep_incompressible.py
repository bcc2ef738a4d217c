"""Incompressible layer between two blocks, [u_N] = 0 on S: the interface law's error is O(eps)."""

from __future__ import annotations

from collections.abc import Sequence

from forms import Incompressible
from studies.problems import fourier
from studies.sweeping import Solution, Sweep, last
from thinlayer import Surface, ThinLayer, observed_orders, plotting
from thinlayer.running.record import Record

LAYER = Incompressible(mu=40.0)


def run(record: Record, *, eps: Sequence[float] = (1 / 32, 1 / 64, 1 / 128, 1 / 256), quick: bool = False) -> None:
    """Sweep the thickness with mu over thickness held; pressures in the meshed layer, a multiplier on S.

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high. Thicker than 1/32 the next term still shows in the orders.
        quick: coarser mesh.
    """
    h = 1 / 8 if quick else 1 / 32
    joint, setup = fourier(h, cell="quadrilateral")
    record.parameters = {"h": h, "layer": str(LAYER)}
    sweep = Sweep(record, joint, setup, lambda e: ThinLayer(LAYER, e, at=1.0), more=normal_jumps)
    table = sweep.run(eps, (0.93, 1.07), title="incompressible layer")
    record.check("largest [u_N]/[u] of the interface law, projected", table["normal_jump_interface"].max(), high=1e-10)
    if len(eps) > 1:
        order = observed_orders(table["eps"], table["normal_jump_full"])[-1]
        record.check("last observed order of the meshed layer's [u_N]", order or 0.0, low=0.93, high=1.07)


def normal_jumps(full: Solution, limit: Solution) -> dict[str, float]:
    """L2 norm on S of [u_N], projected to the multiplier's degree 1, over that of the interface model's [u]."""
    surface = Surface(last(limit).model)
    size = surface.norm(surface.jump(last(limit)))
    found = {}
    for name, solution in {"full": full, "interface": limit}.items():
        projected = surface.sides.upper(surface.nodal(surface.jump(last(solution))))
        found[f"normal_jump_{name}"] = surface.norm(surface.frame(projected)[1]) / size
    return found


def draw(record: Record) -> None:
    """Draw the errors and the meshed layer's normal jump from table.csv."""
    shown = plotting.ERRORS | {"[u_N]/[u] of the meshed layer": "normal_jump_full"}
    plotting.rates(record.path("table.csv"), save=record.path("rates.png"), title="incompressible layer", errors=shown)
