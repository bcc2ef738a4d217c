"""Plane stress: a lap joint cut from a sheet, meshed in three dimensions, against its plane; thinner and thinner sheets."""

from __future__ import annotations

from collections.abc import Sequence

from forms import BulkLaw, LinearElastic, Maxwell
from geometry import sandwich
from thinlayer import Structure, ThinLayer, plotting, solve
from thinlayer.running.record import Record
from thinlayer.system.progress import track

DEPTHS = (8.0, 4.0, 2.0, 1.0, 0.5)  # mm, of the sheet
EPS = 2.0  # mm, of the layer
WIDTH, LOWER, UPPER = 24.0, 4.0, 6.0  # mm
PULL = 5.0  # MPa
PLATES = LinearElastic.young(E=2e3, nu=0.35)  # MPa
GLUE = LinearElastic.young(E=100.0, nu=0.45)  # MPa
TIMES = (0.5, 1.0, 2.0)  # hours
LAWS: dict[str, BulkLaw] = {"elastic": GLUE, "Maxwell": Maxwell(GLUE.lmbda, GLUE.mu, t1=1.5, t2=4.0)}
SAME = 0.01  # relative difference of the thinnest sheet from plane stress


def run(record: Record, *, depths: Sequence[float] = DEPTHS, quick: bool = False) -> None:
    """The work of the load per depth in three dimensions over that in plane stress and in plane strain.

    Plane stress is that of a sheet thinner than the layer: in a thicker one the plates hold the layer across the sheet.

    Args:
        record: where to write.
        depths: of the sheet (mm), growing thinner.
        quick: coarser mesh, the first and the last depth.
    """
    h = 3.0 if quick else 1.5
    depths = (max(depths), min(depths)) if quick else tuple(depths)
    for name, law in LAWS.items():
        planes = {plane: _compliance(record, law, h, plane=plane) for plane in ("stress", "strain")}
        table = record.table(f"table_{name}.csv")
        for depth in track(depths, "plane_stress", name + ", depth = {:g} mm"):
            found = _compliance(record, law, h, depth=depth)
            table.append({"depth": depth, **{f"over_{plane}": found / value for plane, value in planes.items()}})
        record.check_near(f"thinnest sheet over plane stress, {name}", table["over_stress"][-1], 1.0, SAME)
        record.check(f"thinnest sheet over plane strain, {name}", table["over_strain"][-1], low=1 + 3 * SAME)


def _compliance(record: Record, law: BulkLaw, h: float, *, plane: str = "strain", depth: float | None = None) -> float:
    """Work of the load over the depth of the sheet, its faces free; half of the sheet is meshed."""
    half = None if depth is None else depth / 2
    cell = "quadrilateral" if half is None else "hexahedron"
    joint = sandwich(WIDTH, LOWER, UPPER, h, h_S=h / 2, depth=half, cell=cell)
    pull = (-PULL, 0.0, 0.0)[: joint.dim]
    supports: dict[str, dict[str, float]] = {"RIGHT/LOWER": {"x": 0.0, "y": 0.0}, "LEFT/UPPER": {"y": 0.0}}
    supports |= {"BACK": {"z": 0.0}} if half else {}
    structure = Structure(joint, body=PLATES, supports=supports, tractions={"LEFT/UPPER": pull}, plane=plane)
    model = structure.full(ThinLayer(law, EPS), cells_through=6)
    if law.traits.remembers:
        state = record.march(model, TIMES, plane if depth is None else f"depth_{depth:g}").last
    else:
        state = record.solved(solve(model))
    return state.energies()["loads"] / (half or 1.0)


def draw(record: Record) -> None:
    """Draw the ratios against the depth."""
    lines = {}
    for name in LAWS:
        table = record.load(f"table_{name}.csv")
        for plane in ("stress", "strain"):
            lines[f"{name}, over plane {plane}"] = (table["depth"], table[f"over_{plane}"])
    title, save = "lap joint, layer of 2 mm", record.path("depth.png")
    ylabel = "work of the load, over that in the plane"
    plotting.curves(lines, "depth of the sheet (mm)", ylabel, save=save, title=title, ylim=(0.97, 1.13))
