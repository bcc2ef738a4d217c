"""Mohr-Coulomb layer: error O(eps) of its interface law, and the floor that Coulomb's law with tan(Omega) leaves."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import ufl

from forms import MohrCoulomb, MohrCoulombMonodirectional
from forms.plastic import Plastic
from geometry import Joint
from studies.fig3_mohr_coulomb import GLUE, OMEGA, READINGS, SIDE, STEEL, glue, meshed
from studies.problems import fourier
from studies.sweeping import Sweep, draw_rates
from thinlayer import ThinLayer, plotting
from thinlayer.running.record import Record

LAYERS = {
    "": MohrCoulomb(60.0, 40.0, cohesion=0.05, friction_angle=30.0, elastic_fraction=0.02),
    "dilatant": MohrCoulomb(
        60.0, 40.0, cohesion=0.05, friction_angle=30.0, elastic_fraction=0.02, dilatancy_angle=10.0
    ),
}
COULOMB = MohrCoulombMonodirectional(
    60.0, 40.0, cohesion=0.05, friction_angle=30.0, elastic_fraction=0.02
)  # slips on S, as Coulomb's law does
FLOOR = {
    "traction": (0.14, 0.18),
    "jump": (0.26, 0.31),
}  # ranges of the relative errors that COULOMB leaves as eps -> 0
SHEAR = 5.0  # largest shear on the upper side, over the pressure there
TIMES = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
BARS: dict[str, Plastic] = {
    "bar": glue(0.02),
    "bar_less_elastic": glue(0.01),
    "bar_monodirectional": MohrCoulombMonodirectional(
        GLUE.lmbda, GLUE.mu, cohesion=0.0, friction_angle=OMEGA, elastic_fraction=0.01
    ),
}
MM = 32.0  # thickness of the bar's layer, mm, over that of the blocks'


def run(record: Record, *, eps: Sequence[float] = (1 / 16, 1 / 32, 1 / 64, 1 / 128), quick: bool = False) -> None:
    """Sweep the thickness, C and the angles held; both models take the same steps and have the same elastic fraction h.

    table.csv: two blocks under pressure, sheared and sheared back in steps. table_dilatant.csv: the same with psi > 0.
    table_coulomb.csv: the first again, with Coulomb's law on S: |t_T| <= C - tan(Omega) t_N is not the limit.
    table_bar*.csv: the bar of Fig. 2 without cohesion under the loads R1 of `fig3_mohr_coulomb`, 5 mm off the ends of S.

    Args:
        record: where to write.
        eps: thicknesses of the layer between blocks that are 0.5 high; the bar's are 32 times as much, in mm.
        quick: coarser meshes, fewer steps and pictures, and one of the bar's laws.
    """
    h, times = (1 / 8, TIMES[1::2]) if quick else (1 / 16, TIMES)
    joint, setup = sheared_blocks(h)
    bar, bar_setup, inside = bar_r1(quick)
    laws = {name: str(law) for name, law in (LAYERS | BARS).items()}
    record.parameters = {"h_blocks": h, "times": times, "layers": laws, "coulomb": str(COULOMB)}
    tables = {}
    for case, law in LAYERS.items():
        sweep = Sweep(record, joint, setup, partial(ThinLayer, law, at=1.0), times=times, case=case)
        pictured = None if quick and case else max
        tables[case] = sweep.run(
            eps, (0.9, 1.3), pictured=pictured, title="Mohr-Coulomb layer, sheared and sheared back"
        )
    right = partial(ThinLayer, LAYERS[""], at=1.0)
    sweep = Sweep(record, joint, setup, right, times=times, case="coulomb", instead=COULOMB)
    pictured = None if quick else max
    coulomb = sweep.run(eps, None, pictured=pictured, title="Mohr-Coulomb layer, Coulomb's law on S")
    for name in ("traction", "jump"):
        ratio = coulomb[f"error_{name}"][-1] / tables[""][f"error_{name}"][-1]
        record.check(f"error of the {name} at the smallest eps, Coulomb's law over the right one", ratio, low=4.0)
        low, high = FLOOR[name]
        record.check(f"error of the {name} that Coulomb's law leaves", coulomb[f"error_{name}"][-1], low=low, high=high)
    for case, one in list(BARS.items())[: 1 if quick else None]:
        thicknesses = [MM * e for e in eps]
        sweep = Sweep(record, bar, bar_setup, partial(ThinLayer, one, at=1.0), where=inside, case=case)
        sweep.run(thicknesses, (0.9, 1.3), title="bar of Fig. 2, loads R1", unit="mm")


def sheared_blocks(h: float) -> tuple[Joint, dict[str, Any]]:
    """The blocks of `fourier` under pressure, sheared up to t = 1 and back after it; joint and data of its models."""
    joint, setup = fourier(h, cell="quadrilateral")

    def load(x: Any, t: Any) -> tuple[Any, Any]:
        shear = SHEAR * ufl.conditional(ufl.lt(t, 1), t, 2 - t)
        return shear * ufl.sin(ufl.pi * x[0]), -1 + 0.3 * ufl.cos(ufl.pi * x[0])

    return joint, setup | {"tractions": {"TOP": load}}


def bar_r1(quick: bool) -> tuple[Joint, dict[str, Any], Any]:
    """The bar of Fig. 2 under the loads R1, in mm and MPa; joint, data of its models, the part of S to measure on."""
    sizes = (8.0, 4.0, 0.4) if quick else (6.0, 3.0, 0.2)
    loads = READINGS["R1"]
    setup = {"body": STEEL, "supports": loads.supports, "tractions": loads.tractions, "element": "S2"}
    return meshed(sizes), setup, lambda x: abs(x[0] - SIDE / 2) < 0.45 * SIDE


def draw(record: Record) -> None:
    """Draw the rates from the tables."""
    cases = {"psi = 0": "table.csv", "psi = 10°": "table_dilatant.csv", "tan(Omega) on S": "table_coulomb.csv"}
    draw_rates(record, title="Mohr-Coulomb layer", cases=cases)
    names = {"bar": "h = 0.02", "bar_less_elastic": "h = 0.01", "bar_monodirectional": "monodirectional, h = 0.01"}
    bars = {label: f"table_{name}.csv" for name, label in names.items()}
    found = {label: record.path(name) for label, name in bars.items() if record.has(name)}
    plotting.rates(found, save=record.path("rates_bar.png"), title="bar of Fig. 2, no cohesion, eps in mm")
