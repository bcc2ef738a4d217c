"""From a data sheet to a failure load: a glued lap joint breaks, for several thicknesses of the glue.

Data sheets give moduli, strengths and toughness per area, which are taken to be the same for all thicknesses here. The
law of the layer has toughness per volume. So each thickness, or bond line, needs a law of its own. The law that was made
for another bond line has a wrong toughness. A criterion of strength has none: it compares the largest traction of an
elastic layer with the strength.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from forms import Breaking, LinearElastic
from geometry import sandwich
from studies.dropped import ignore_range_warnings
from studies.problems import ALUMINIUM
from thinlayer import ArcLength, QuadraticCriterion, Structure, Table, ThinLayer, march, plotting, strength
from thinlayer.discretisation.supports import Place, Support
from thinlayer.output.plotting.curves import LAW_COLOUR, MESHED_COLOUR
from thinlayer.running.record import Record
from thinlayer.solving.history import History
from thinlayer.system.progress import track

OVERLAP, PLATE = 25.0, 2.0  # mm: length of the glue, height of both plates
E, NU, STRENGTHS, TOUGHNESS = 2e3, 0.4, (40.0, 30.0), (0.4, 1.6)  # of the glue: MPa; in opening and shear: MPa, N/mm
data_sheet = partial(Breaking.glue, E=E, nu=NU, strength=STRENGTHS, toughness=TOUGHNESS, eta=2.0)
BOND_LINE = 0.2  # mm, of the tests that gave the toughness, and of the joint whose forces are drawn
BOND_LINES, QUICK_BOND_LINES = (0.05, 0.1, 0.2, 0.3, 0.5), (0.1, 0.2, 0.5)  # mm
END = 0.4  # mm, largest displacement of the grip
ON_S, MESHED, WRONG, ELASTIC = "law on S", "meshed layer", f"law of {BOND_LINE:g} mm", "strength of an elastic layer"
YIELDS = "shear strength everywhere"
COLOURS = {ON_S: LAW_COLOUR, MESHED: MESHED_COLOUR, WRONG: "#009E73", ELASTIC: "0.5", YIELDS: "black"}
STYLES = {ON_S: "o-", MESHED: "s--", WRONG: "^-.", ELASTIC: "v:", YIELDS: "-"}


def lap(h_S: float) -> Structure:
    """Make two plates whose ends overlap; the upper one is pulled by t at its left end. Cells along S are h_S."""
    joint = sandwich(OVERLAP, PLATE, PLATE, PLATE / 2, h_S=h_S, cell="quadrilateral", structured=True)
    supports: dict[Place, Support] = {"RIGHT/LOWER": 0.0, "LEFT/UPPER": {"y": 0.0, "x": lambda x, t: -t}}
    return Structure(joint, body=ALUMINIUM, supports=supports)


def pull(structure: Structure, eps: float, *, kind: str) -> History:
    """Pull the joint apart by arc length; the table has the additional column "force", per width.

    Args:
        structure: the plates.
        eps: thickness of the glue.
        kind: whether the layer is on S or meshed, or on S with the law for the wrong bond line.
    """
    layer = ThinLayer(data_sheet(bond_line=BOND_LINE if kind == WRONG else eps), eps)
    # where all is broken, the path leads to larger and to smaller displacements: `back` ends both
    model = structure.full(layer, cells_through=1) if kind == MESHED else structure.interface(layer)
    observe = {"force": lambda state: -state.reaction("LEFT/UPPER").force[0]}
    return march(model, ArcLength(end=END, first=0.01, largest=2, back=-0.01), observe=observe, keep="last")


def elastic_strength(structure: Structure, eps: float) -> float:
    """Return the force per width at which the largest traction of an elastic layer fulfils the criterion of strength."""
    state = march(structure.interface(ThinLayer(LinearElastic.young(E, NU), eps)), [END]).last
    return float(-state.reaction("LEFT/UPPER").force[0]) / strength(state, QuadraticCriterion(*STRENGTHS)).largest


def run(record: Record, *, quick: bool = False) -> None:
    """Pull lap joints with several thicknesses of the glue until they break.

    table.csv has for each thickness and model the largest force and the dissipated energy, per width, and the share of
    the glue that is broken at the end. table_response.csv has forces and displacements of the grip for the bond line of
    the data sheet.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: larger cells, three of the five thicknesses.
    """
    bond_lines, structure = QUICK_BOND_LINES if quick else BOND_LINES, lap(1.0 if quick else 0.5)
    table, response = record.new_table("table.csv"), record.new_table("table_response.csv")
    cases = [(eps, kind) for eps in bond_lines for kind in (ON_S, MESHED, WRONG) if (eps, kind) != (BOND_LINE, WRONG)]
    with ignore_range_warnings():  # of the wrong law
        for eps, kind in track(cases, "lap_failure", "{0[1]}, eps = {0[0]:g}"):
            rows = record.add_report(pull(structure, eps, kind=kind)).table
            row = {"eps": eps, "model": kind, "failure": rows["force"].max(), "broken": rows["broken"][-1]}
            table.append(row | {"dissipated": rows["dissipated"].sum()})
            if (eps, kind) == (BOND_LINE, ON_S):  # both laws are the same
                table.append(row | {"model": WRONG, "dissipated": rows["dissipated"].sum()})
            if eps == BOND_LINE:
                response.extend(Table.of({"model": kind, "t": rows["t"], "force": rows["force"]}))
        for eps in bond_lines:
            row = {"eps": eps, "model": ELASTIC, "failure": elastic_strength(structure, eps)}
            table.append(row | {"broken": 0.0, "dissipated": 0.0})
    check_failure(record, table.split("model"))


def check_failure(record: Record, models: Mapping[str, Table]) -> None:
    """Check failure loads and energies against bounds, against each other, and those of wrong laws."""
    right, meshed, wrong, elastic = (models[name] for name in (ON_S, MESHED, WRONG, ELASTIC))
    eps, loads = right["eps"], right["failure"]
    broken = min(models[name]["broken"].min() for name in (ON_S, MESHED, WRONG))
    record.check("share of the glue that is broken at the end, smallest", broken, low=1 - 1e-9)
    bound = STRENGTHS[1] * OVERLAP
    record.check("largest failure load over that of the shear strength everywhere", loads.max() / bound, high=1.0)
    energies = right["dissipated"] / (TOUGHNESS[1] * OVERLAP)
    record.check("dissipated energy over the toughness in shear, largest", energies.max(), high=1.0)
    record.check("the same, smallest", energies.min(), low=0.95)
    record.check("change of the failure load with the bond line", np.ptp(loads) / loads.mean(), high=0.03)
    distances = (1 - meshed["failure"] / loads) / eps  # per mm
    record.check("meshed layer: failure load below that of the law on S, over eps, 1/mm", distances.max(), high=0.05)
    record.check("the same, smallest", distances.min(), low=0.0)
    ratios = wrong["failure"] / np.interp(wrong["eps"], eps, loads)
    record.check(f"law of {BOND_LINE:g} mm: failure load over the right one, thinner glue", ratios[0], high=0.9)
    record.check(f"law of {BOND_LINE:g} mm: failure load over the right one, thicker glue", ratios[-1], low=1.05)
    share = elastic["failure"].max() / loads.min()
    record.check("strength of an elastic layer: load over the failure load, largest", share, high=0.8)


def draw(record: Record) -> None:
    """Draw failure loads over the bond line, and forces at one bond line, from the tables in the folder of `record`."""
    models, response = record.load("table.csv").split("model"), record.load("table_response.csv").split("model")
    loads = {model: (rows["eps"], rows["failure"]) for model, rows in models.items()}
    eps = models[ON_S]["eps"]
    loads[YIELDS] = eps[[0, -1]], np.full(2, STRENGTHS[1] * OVERLAP)
    axes, look = ("thickness of the glue (mm)", "failure load (N/mm)"), {"colours": COLOURS, "styles": STYLES}
    plotting.curves(loads, *axes, ylim=(0.0, 800.0), save=record.path("failure.svg"), **look)
    axes, save = ("displacement of the grip (mm)", "force (N/mm)"), record.path("response.svg")
    plotting.load_displacement(response, "t", "force", *axes, xlim=(0.0, 0.15), save=save, **look)
