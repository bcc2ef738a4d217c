"""Next-order interface law of an elastic layer, and of three sublayers: its error is O(eps^2), beside order 0."""

from __future__ import annotations

from collections.abc import Sequence

from forms import BulkLaw, LinearElastic, Stack
from studies.problems import FOURIER_LAYER, fourier
from thinlayer import Structure, ThinLayer, compare, plotting, solve
from thinlayer.running.record import Record

EPS = (1 / 8, 1 / 16, 1 / 32, 1 / 64, 1 / 128)
SUBLAYERS = Stack((0.3, LinearElastic(400.0, 20.0)), (0.3, LinearElastic(20.0, 60.0)), (0.4, LinearElastic(60.0, 5.0)))
MIRRORED = Stack(*SUBLAYERS.sublayers[::-1])
TITLES = {"": "a layer of one law", "stack": "three sublayers"}
QUANTITIES = ("traction", "jump")


def run(record: Record, *, eps: Sequence[float] = EPS, quick: bool = False) -> None:
    """Sweep the thickness with the moduli over thickness held, with both interface laws against one meshed layer.

    table.csv has a layer of one law, table_stack.csv three sublayers, also with the law of order 1 of the sublayers in the
    opposite order, which is not theirs.

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high.
        quick: coarser mesh.
    """
    h = 1 / 16 if quick else 1 / 32
    joint, setup = fourier(h, cell="quadrilateral")
    structure = Structure(joint, **setup)
    record.parameters = {"h": h, "layer": str(FOURIER_LAYER), "sublayers": str(SUBLAYERS.sublayers)}

    def compared(e: float, layers: dict[str, ThinLayer], law: BulkLaw) -> dict[str, float]:
        full = record.solved(solve(structure.full(ThinLayer(law, e, at=1.0))))
        row: dict[str, float] = {}
        for name, layer in layers.items():
            found = compare(full, record.solved(solve(structure.interface(layer))))
            row |= {f"error_{one}{name}": found[f"error_{one}"] for one in QUANTITIES} if name else found
        return row

    def one_law(e: float) -> dict[str, float]:
        return compared(
            e,
            {"": ThinLayer(FOURIER_LAYER, e, 1, at=1.0), "_order0": ThinLayer(FOURIER_LAYER, e, at=1.0)},
            FOURIER_LAYER,
        )

    def sublayers(e: float) -> dict[str, float]:
        layers = {
            "": ThinLayer(SUBLAYERS, e, 1, at=1.0),
            "_order0": ThinLayer(SUBLAYERS, e, at=1.0),
            "_mirrored": ThinLayer(MIRRORED, e, 1, at=1.0),
        }
        return compared(e, layers, SUBLAYERS)

    for case, row in {"": one_law, "stack": sublayers}.items():
        table = record.sweep(row, eps, _table(case))
        record.say(table)
        if len(eps) > 1:
            for name in QUANTITIES:
                record.check(
                    f"last observed order of the {name}, {TITLES[case]}", table[f"order_{name}"][-1], low=1.9, high=2.1
                )


def _table(case: str) -> str:
    return f"table_{case}.csv" if case else "table.csv"


def draw(record: Record) -> None:
    """Draw the errors of the laws from the tables, a picture for each."""
    marks = {"traction": ("o-", "s-", "v:"), "jump": ("^-", "D-", "x:")}
    kinds = {"order 0": "_order0", "order 1": "", "order 1, mirrored": "_mirrored"}
    for case, title in TITLES.items():
        table = record.load(_table(case))
        eps, lines, styles = table["eps"], {}, {"slope 2": "--"}
        for name in QUANTITIES:
            for (kind, end), mark in zip(kinds.items(), marks[name], strict=True):
                if (values := f"error_{name}{end}") in table.columns:
                    lines[f"{name}, {kind}"] = eps, table[values]
                    styles[f"{name}, {kind}"] = mark
        lines["slope 2"] = eps, 0.5 * table["error_traction"][-1] * (eps / eps[-1]) ** 2
        plotting.curves(
            lines,
            xlabel="layer thickness eps",
            ylabel="relative difference on S, L2",
            title=f"interface laws of order 0 and 1: {title}",
            styles=styles,
            logarithmic=True,
            save=record.path(f"orders_{case}.png" if case else "orders.png"),
        )
