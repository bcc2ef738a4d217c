"""A masonry wall that cracks: its capacity as it is pulled along its courses, for mortar of several toughnesses.

A crack along the mortar is toothed: it runs through the head of a brick, then along half a brick in the bed, through the
next head, and so on. If all mortar along it bore its strength at the same time, the wall would carry the plastic
capacity. Brittle mortar breaks at one place before it bears its strength at others.
The sound wall has no weakest crack: several grow at the same time.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from forms import Breaking
from forms.base import Array
from geometry import wall
from studies.sweeping import Curves
from studies.wall import BRICK_SIZE, CLAY, EPS, MORTAR_E, MORTAR_NU
from thinlayer import ArcLength, Structure, Table, ThinLayer, march, plotting
from thinlayer.discretisation.supports import Support
from thinlayer.running.record import Record
from thinlayer.solving.history import History
from thinlayer.system.progress import track

BRICKS, COURSES = 3, 4  # of the wall
STRENGTHS = {"BED": (0.2, 0.3), "HEAD": (0.1, 0.15)}  # MPa, in opening and shear
TOUGHNESSES = {"BED": (0.01, 0.05), "HEAD": (0.005, 0.025)}  # N/mm, in opening and shear
ENDS = {0.3: 0.12, 1.0: 0.4, 3.0: 0.5, 10.0: 0.5}  # factor of the toughnesses -> mm, last displacement of the right end
SOUND, OPEN = "heads with mortar", "open heads along a crack"
OPEN_HEADS = (250.0, 375.0)  # mm, along the wall: in odd and in even courses
HEIGHT, TEETH = COURSES * BRICK_SIZE[1], (COURSES - 1) * BRICK_SIZE[0] / 2  # mm: of the wall; length of beds in a crack
PLASTIC = {OPEN: STRENGTHS["BED"][1] * TEETH / HEIGHT}  # MPa, mean stress
PLASTIC[SOUND] = PLASTIC[OPEN] + STRENGTHS["HEAD"][0]
END = 0.4  # mm, largest displacement that is drawn
CELLS = (3, 6)  # over the height of a brick, with --quick and without


def open_heads(x: Array) -> Array:
    """Return the damage of heads at places x (d, n): 1 along one crack, 0 elsewhere."""
    return 1.0 * ((abs(x[0] - OPEN_HEADS[0]) < 1.0) | (abs(x[0] - OPEN_HEADS[1]) < 1.0))


def pull(cells: int, factor: float, *, cracked: float | Callable[[Array], Array]) -> History:
    """Pull the right end of the wall by arc length; the table has the additional column "stress", the mean at this end.

    Args:
        cells: number of cells over the height of a brick.
        factor: factor of the toughnesses.
        cracked: damage of the heads at the start.
    """
    bricks = wall(BRICKS, COURSES, BRICK_SIZE, BRICK_SIZE[1] / cells, cell="quadrilateral")
    supports: dict[str, Support] = {"LEFT": {"x": 0.0}, "RIGHT": {"x": lambda x, t: t}, "BOTTOM": {"y": 0.0}}
    layers = {}
    for seam, (G_I, G_II) in TOUGHNESSES.items():
        toughness, damage = (factor * G_I, factor * G_II), {"cracked": cracked if seam == "HEAD" else 0.0}
        law = Breaking.glue(MORTAR_E, MORTAR_NU, STRENGTHS[seam], toughness, bond_line=EPS, **damage)
        layers[seam] = ThinLayer(law, EPS)
    model = Structure(bricks, body=CLAY, supports=supports, element="Q1").interface(layers)
    observe = {"stress": lambda state: state.reaction("RIGHT").force[0] / HEIGHT}
    return march(model, ArcLength(end=ENDS[factor], first=0.01, back=-0.01), observe=observe, keep="last")


def run(record: Record, *, quick: bool = False) -> None:
    """Pull a sound wall and one with open heads along a toothed crack, for several toughnesses of the mortar.

    table.csv has for both walls and each factor of the toughness the capacity, over the plastic one, and the dissipated
    energy. table_response.csv has mean stress and displacement of the right end.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: cells of a third of a brick's height, not of a sixth.
    """
    table, response = record.new_table("table.csv"), record.new_table("table_response.csv")
    cases = [(name, cracked, factor) for name, cracked in ((SOUND, 0.0), (OPEN, open_heads)) for factor in ENDS]
    for name, cracked, factor in track(cases, "masonry_crack", "{0[0]}, toughness times {0[2]:g}"):
        rows = record.add_report(pull(CELLS[0 if quick else 1], factor, cracked=cracked)).table
        capacity = rows["stress"].max() / PLASTIC[name]
        table.append({"wall": name, "factor": factor, "capacity": capacity, "dissipated": rows["dissipated"].sum()})
        response.extend(Table.of({"wall": name, "factor": factor, "t": rows["t"], "stress": rows["stress"]}))
    for name, rows in table.split("wall").items():
        capacity = rows["capacity"]
        record.check(f"{name}: capacity over the plastic one, brittle", capacity[0], high=0.95)
        record.check(f"{name}: capacity over the plastic one, tough", capacity[-1], low=0.95, high=1.0)
        record.check(f"{name}: least gain of capacity with the toughness", np.diff(capacity).min(), low=0.0)
    sound, cracked = (rows["dissipated"][rows["factor"] == 1][0] for rows in table.split("wall").values())
    sliding = TEETH * TOUGHNESSES["BED"][1]
    record.check_near("energy of a crack along open heads over that of beds that slide", cracked / sliding, 1.0, 0.02)
    record.check("dissipated energy of the sound wall over it, at the same displacement", sound / cracked, low=1.0)
    other = pull(CELLS[1 if quick else 0], 1.0, cracked=0.0).table["stress"].max() / PLASTIC[SOUND]
    distance = abs(other / table.split("wall")[SOUND]["capacity"][list(ENDS).index(1.0)] - 1)
    record.check("relative distance of the capacity with other cells", distance, high=0.01)


def draw(record: Record) -> None:
    """Draw the mean stress over the displacement, from table_response.csv in the folder of `record`."""
    panels = dict[str, Curves]()
    for name, rows in record.load("table_response.csv").split("wall").items():
        parts = {f"toughness times {factor:g}": part for factor, part in rows.split("factor").items()}
        panels[name] = {label: (part["t"], part["stress"]) for label, part in parts.items()}
        panels[name]["plastic capacity"] = (0.0, END), (PLASTIC[name], PLASTIC[name])
    axes, title = ("displacement of the end (mm)", "mean stress (MPa)"), "a masonry wall is pulled along its courses"
    look = {"xlim": (0.0, END), "ylim": (0.0, 0.55), "colours": {"plastic capacity": "0.5"}}
    plotting.curves(panels, *axes, title=title, save=record.path("masonry_crack.svg"), **look)
