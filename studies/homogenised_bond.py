"""Stiffness of a wall in running bond as a whole: stiff bricks are rigid up to O(k a/E)."""

from __future__ import annotations

import numpy as np

from forms import LinearElastic
from geometry import bond_cell
from thinlayer import Structure, ThinLayer, homogenised_stiffness, plotting
from thinlayer.running.record import Record
from thinlayer.system.progress import track

WIDTH, HEIGHT = 2.0, 1.0  # of a brick
BED, HEAD = (5.0, 2.1), (3.0, 1.3)  # normal and tangential stiffness of the mortar, stress per length
NU = 0.2
YOUNG = (1e2, 1e3, 1e4, 1e6)
ENTRIES = {"A_1111": (0, 0), "A_2222": (1, 1), "A_1212": (2, 2)}
# (A/rigid - 1) E as E grows: A_2222 in closed form, the others found by an independent program
CONSTANTS = {"A_1111": -8.432, "A_2222": -BED[0] * HEIGHT * (1 - NU**2), "A_1212": -5.039}
CUTS = ((0.125, 0.25), (0.625, 0.75))  # other places of the cell in the wall


def run(record: Record, *, quick: bool = False) -> None:
    """Homogenise a periodic cell of the wall, for bricks of growing stiffness, against the closed forms for rigid bricks.

    Args:
        record: where to write.
        quick: coarser mesh, and fewer places of the cell in the wall.
    """
    h = HEIGHT / 4 if quick else HEIGHT / 16
    rigid = of_rigid_bricks()
    table = record.table("table.csv")
    for E in track(YOUNG, "homogenised_bond", "E = {:g}"):
        A = stiffness(E, h)
        row = {"E": E, **{name: float(A[at]) for name, at in ENTRIES.items()}, "A_1122": float(A[0, 1])}
        table.append(row | {f"error_{name}": 1 - row[name] / rigid[name] for name in ENTRIES})
        record.check(f"asymmetry at E = {E:g}, over E", np.abs(A - A.T).max() / E, high=1e-12)
    for name, constant in CONSTANTS.items():
        found = -table[f"error_{name}"][-1] * YOUNG[-1]
        record.check_near(f"({name}/rigid - 1) E at the largest E", found, constant, 2e-2 if name != "A_2222" else 1e-3)

    E = YOUNG[1]
    here = stiffness(E, h)
    for cut in CUTS[: 1 if quick else None]:
        apart = np.abs(stiffness(E, h, cut) - here).max() / np.abs(here).max()
        record.check(f"difference of a cell cut at {cut}, relative", float(apart), high=1e-9)


def stiffness(E: float, h: float, cut: tuple[float, float] = (0.25, 0.5)) -> np.ndarray:
    """Stiffness (3, 3) of the wall for a Young's modulus of the bricks, by a periodic cell cut at a place in a brick."""
    joint = bond_cell((WIDTH, HEIGHT), h, cut=cut)
    laws = {name: LinearElastic(K_N - 2 * K_T, K_T) for name, (K_N, K_T) in (("BED", BED), ("HEAD", HEAD))}
    mortar = {name: ThinLayer(law, 0.01, at=1.0) for name, law in laws.items()}
    structure = Structure(joint, body=LinearElastic.young(E, NU), supports={})
    return homogenised_stiffness(structure.interface(mortar))


def of_rigid_bricks() -> dict[str, float]:
    """Stiffness of the wall if bricks are rigid: each moves with the mean strain, and turns under a shear."""
    b, a = WIDTH, HEIGHT
    X, Y = HEAD[1] * b + BED[0] * b**2 / (4 * a), BED[1] * a
    return {"A_1111": HEAD[0] * b + BED[1] * b**2 / (4 * a), "A_2222": BED[0] * a, "A_1212": X * Y / (X + Y)}


def draw(record: Record) -> None:
    """Draw the errors of rigid bricks from table.csv."""
    table = record.load("table.csv")
    lines = {name: (table["E"], table[f"error_{name}"]) for name in ENTRIES}
    lines |= {"slope -1": (table["E"], 20 / table["E"])}
    labels, title = ("Young's modulus of the bricks", "1 - A/A of rigid bricks"), "a wall in running bond as a whole"
    styles = dict(zip(ENTRIES, ("o-", "s-", "^-"), strict=True)) | {"slope -1": "--"}
    save = record.path("rigid_bricks.png")
    plotting.curves(lines, *labels, title=title, styles=styles, log="xy", save=save)
