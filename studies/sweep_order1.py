"""Next-order interface law of an elastic layer: its error is O(eps^2), beside order 0."""

from __future__ import annotations

from collections.abc import Sequence

from studies.problems import FOURIER_LAYER, fourier
from thinlayer import Structure, ThinLayer, compare, plotting, solve
from thinlayer.running.record import Record

EPS = (1 / 8, 1 / 16, 1 / 32, 1 / 64, 1 / 128)


def run(record: Record, *, eps: Sequence[float] = EPS, quick: bool = False) -> None:
    """Sweep the thickness with the moduli over thickness held, with both interface laws against one meshed layer.

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high.
        quick: coarser mesh.
    """
    h = 1 / 16 if quick else 1 / 32
    joint, setup = fourier(h, cell="quadrilateral")
    record.parameters = {"h": h, "layer": str(FOURIER_LAYER)}

    def compare_at(e: float) -> dict[str, float]:
        layers = [ThinLayer(FOURIER_LAYER, e, order=order) for order in (0, 1)]
        full = record.solved(solve(Structure(joint, **setup).full(layers[0])))
        first, second = (
            compare(full, record.solved(solve(Structure(joint, **setup).interface(layer)))) for layer in layers
        )
        return second | {f"error_{name}_order0": first[f"error_{name}"] for name in ("traction", "jump")}

    table = record.sweep(compare_at, eps)
    record.say(table)
    if len(eps) > 1:
        for name in ("traction", "jump"):
            record.check(f"last observed order of the {name}", table[f"order_{name}"][-1], low=1.9, high=2.1)


def draw(record: Record) -> None:
    """Draw the errors of both laws from table.csv."""
    table = record.load("table.csv")
    eps = table["eps"]
    lines = {
        "traction, order 0": (eps, table["error_traction_order0"]),
        "traction, order 1": (eps, table["error_traction"]),
        "jump, order 0": (eps, table["error_jump_order0"]),
        "jump, order 1": (eps, table["error_jump"]),
        "slope 2": (eps, 0.5 * table["error_traction"][-1] * (eps / eps[-1]) ** 2),
    }
    styles = {"traction, order 0": "o-", "traction, order 1": "s-", "jump, order 0": "^-", "jump, order 1": "D-"}
    plotting.curves(
        lines,
        xlabel="layer thickness eps",
        ylabel="relative difference on S, L2",
        title="interface laws of order 0 and 1",
        styles=styles | {"slope 2": "--"},
        logarithmic=True,
        save=record.path("orders.png"),
    )
