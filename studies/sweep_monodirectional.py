"""Layer that slips on planes parallel to S: error O(eps), pulled or opening, alone or beside an elastic sublayer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from forms import BulkLaw, LinearElastic, MohrCoulombMonodirectional, Stack
from studies.problems import pressed
from studies.sweeping import Sweep, draw_rates
from thinlayer import ThinLayer
from thinlayer.running.record import Record

SLIPPING = MohrCoulombMonodirectional(lmbda=60.0, mu=40.0, cohesion=0.05, friction_angle=25.0)
FRACTION, LESS = 0.01, 1e-4  # elastic fractions: pulled layers have no strength in shear, open ones none along n
OPENING = replace(SLIPPING, elastic_fraction=FRACTION, unilateral=True)
STACK = Stack((0.4, LinearElastic(lmbda=90.0, mu=30.0)), (0.6, SLIPPING))
PUSHED = {0: (0.0, 0.0, 0.0), 1: (0.3, 0.35, 0.0), 2: (0.3, 1.0, 1.5), 3: (0.3, 0.0, -0.9)}
PULLED = {0: (0.0, 0.0, 0.0), 1: (0.28, 1.0, 0.0), 2: (0.28, 1.0, 1.5), 3: (0.28, 0.0, -1.0)}
TIMES = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
CASES: dict[str, tuple[BulkLaw, dict[int, tuple[float, float, float]], str]] = {
    "": (SLIPPING, PUSHED, "bilateral"),
    "unilateral": (OPENING, PULLED, "unilateral, h = 0.01"),
    "stack": (STACK, PUSHED, "elastic, bilateral"),
    "pulled": (replace(SLIPPING, elastic_fraction=FRACTION), PULLED, "pulled, h = 0.01"),
    "pulled_less": (replace(SLIPPING, elastic_fraction=LESS), PULLED, "pulled, h = 1e-4"),
}


def run(record: Record, *, eps: Sequence[float] = (1 / 16, 1 / 32, 1 / 64, 1 / 128), quick: bool = False) -> None:
    """Sweep the thickness, C and Omega held. Both models are compressed, sheared and sheared back in the same steps.

    table.csv: bilateral, as Eqs. (37)-(38), h = 0. One part of S slips, first forth, then back, another one sticks; the
    tension at one end stays below C cot(Omega). table_unilateral.csv: the same law opens at that end under larger loads,
    and closes again in part. An open layer has no stiffness along n for what is inside it, so it needs an elastic fraction
    h, in both models. table_stack.csv: Eqs. (54)-(55), an elastic sublayer below the first layer.

    table_pulled.csv: bilateral, under the loads of the unilateral layer. Where its tension is beyond C cot(Omega) nothing
    resists shear but the fraction h, and the layer contracts along S where it is pulled along n: its strains along S are
    not small against those along n, as the interface law has them, unless eps is small against sqrt(h) times the length of
    S (an estimate). In table_pulled_less.csv, with h = 1e-4, the error is several times as large and hardly falls.

    Args:
        record: where to write.
        eps: thicknesses; the blocks are 0.5 high.
        quick: coarser mesh, and only the first case is drawn deformed.
    """
    h, times = (1 / 8, TIMES[1::2]) if quick else (1 / 16, TIMES)
    record.parameters = {"h": h, "times": times, "layers": {name: str(law) for name, (law, *_) in CASES.items()}}
    tables = {}
    for case, (law, path, title) in CASES.items():
        joint, setup = pressed(h, path)
        sweep = Sweep(record, joint, setup, partial(ThinLayer, law, at=1.0), cells_through=2, times=times, case=case)
        order = None if case == "pulled_less" else (0.9, 1.1)
        pictured = None if quick and case else max
        tables[case] = sweep.run(eps, order, pictured=pictured, title=f"slips parallel to S, {title}")
    for name in ("traction", "jump"):
        less, more = (tables[case][f"error_{name}"][-1] for case in ("pulled_less", "pulled"))
        record.check(
            f"pulled, h = {LESS:g} against h = {FRACTION:g}: last error of the {name}, ratio", less / more, low=2.5
        )


def draw(record: Record) -> None:
    """Draw the rates from the tables, of the traction and of the jump."""
    cases = {title: f"table_{case}.csv" if case else "table.csv" for case, (*_, title) in CASES.items()}
    draw_rates(record, title="layer that slips parallel to S", cases=cases, apart=True)
