"""Layers that are not soft (moduli held as eps -> 0): the next-order law stays valid, traction order up to 3.

The order comes to 3 from below, as eps E_layer/E_body becomes small beside the width of the blocks.
"""

from __future__ import annotations

from collections.abc import Sequence

from forms import LinearElastic
from studies.problems import FOURIER_BODY, fourier
from thinlayer import Structure, ThinLayer, compare, plotting, solve
from thinlayer.running.record import Record

EPS = (1 / 16, 1 / 32, 1 / 64, 1 / 128, 1 / 256)
LAYERS = {"harder": LinearElastic(lmbda=600.0, mu=400.0), "softer": LinearElastic(lmbda=6.0, mu=4.0)}  # bodies: E = 100


def run(record: Record, *, eps: Sequence[float] = EPS, quick: bool = False) -> None:
    """Sweep the thickness with the moduli held, for a layer ten times harder and one ten times softer than the bodies.

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high.
        quick: coarser mesh.
    """
    h = 1 / 16 if quick else 1 / 32
    joint, setup = fourier(h, cell="quadrilateral")
    record.parameters = {"h": h, **{name: str(law) for name, law in LAYERS.items()}}
    for name, law in LAYERS.items():

        def compare_at(e: float, law: LinearElastic = law) -> dict[str, float]:
            layer = ThinLayer(law, e, order=1)
            full = record.solved(solve(Structure(joint, **setup).full(layer)))
            return compare(full, record.solved(solve(Structure(joint, **setup).interface(layer))))

        table = record.sweep(compare_at, eps, "table.csv" if name == "harder" else f"{name}.csv")
        record.say(f"{name} layer, {law}\n{table}")
        if len(eps) > 1:
            low = 2.5 if eps[-1] * law.mu / FOURIER_BODY.mu < 0.05 else 2.0
            record.check(f"last observed order of the traction, {name} layer", table["order_traction"][-1], low=low)


def draw(record: Record) -> None:
    """Draw the errors in the traction from the tables."""
    tables = {"harder": record.load("table.csv"), "softer": record.load("softer.csv")}
    lines = {f"{name}: {LAYERS[name]}": (t["eps"], t["error_traction"]) for name, t in tables.items()}
    eps, lowest = tables["harder"]["eps"], tables["harder"]["error_traction"][-1]
    lines["slope 3"] = (eps, 0.4 * lowest * (eps / eps[-1]) ** 3)
    styles = dict(zip(lines, ("o-", "s-", "--"), strict=True))
    plotting.curves(
        lines,
        xlabel="layer thickness eps",
        ylabel="relative difference of the traction on S, L2",
        title="next-order law, moduli held",
        styles=styles,
        logarithmic=True,
        save=record.path("orders.png"),
    )
