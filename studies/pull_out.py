"""Pull-out: a bar breaks loose from its base and then rubs on it, against a bar on springs.

The end of the bar is pulled, and the layer below it breaks from there. Under a pressure p its broken part bears the
friction f p. Where all is broken, the bar slides under the force f p l. For slips u the bar has E A u'' = t(u). Each slip
of the free end gives the slip and the force of the pulled end, by the method of Runge and Kutta.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from forms import CohesiveFriction, LinearElastic
from forms.base import Array
from geometry import block
from thinlayer import Structure, Table, march, plotting
from thinlayer.running.record import Record
from thinlayer.solving.history import History

LENGTH, HEIGHT, E = 8.0, 0.1, 1e4  # mm: of the bar, whose width is 1; its modulus, MPa
K, STRENGTH, TOUGHNESS = 100.0, 1.0, 0.05  # of the layer in shear: MPa/mm, MPa, N/mm
PRESSURE, FRICTION = 1.0, (0.0, 0.2)  # MPa
END = 0.15  # mm, largest displacement of the end
TIMES = [1e-9, 0.01, 0.02, 0.03, *np.linspace(0.036, 0.044, 9), 0.048, 0.054, *np.linspace(0.06, END, 10)]
BAR, ON_S = "bar on springs", "law on S"
RTOL = 5e-3  # largest distance from the bar on springs, relative


def bar(friction: float) -> Table:
    """Return displacements and forces of the pulled end of a bar on springs that break, as the slip grows everywhere."""
    onset, end = STRENGTH / K, 2 * TOUGHNESS / STRENGTH

    def slope(_: float, y: Array) -> Array:
        u, du = y.reshape(2, -1)
        damage = np.clip(end * (u - onset) / (np.maximum(u, onset) * (end - onset)), 0, 1)
        t = (1 - damage) * K * u + damage * np.minimum(K * u, friction * PRESSURE)
        return np.append(du, t / (E * HEIGHT))

    last = END - friction * PRESSURE * LENGTH**2 / (2 * E * HEIGHT)  # slip of the free end as all slides
    free = np.concatenate([np.geomspace(1e-6, onset, 500), np.linspace(onset, end, 500)[1:], [last]])
    u, du = solve_ivp(slope, (0, LENGTH), np.append(free, 0 * free), max_step=0.02).y[:, -1].reshape(2, -1)
    return Table.of({"displacement": np.append(0, u), "force": np.append(0, E * HEIGHT * du)})


def pull(friction: float) -> History:
    """Pull the bar with the law on S; the table of the history has the additional column "force"."""
    toughnesses = 20 * TOUGHNESS, TOUGHNESS
    law = CohesiveFriction(K, K, STRENGTH, STRENGTH, *toughnesses, friction=friction, closure="bilateral")
    bar, body = block(LENGTH, HEIGHT, HEIGHT, cell="quadrilateral", structured=True), LinearElastic.young(E, 0.0)
    supports, tractions = {"RIGHT": {"x": lambda x, t: t}}, {"TOP": (0.0, -PRESSURE)}
    structure = Structure(bar, body=body, supports=supports, tractions=tractions)
    observe = {"force": lambda state: state.reaction("RIGHT").force[0]}
    return march(structure.interface(law), TIMES, observe=observe)


def run(record: Record) -> None:
    """Pull the bar with and without friction, and compare it with a bar on springs.

    table.csv has for each friction rows for both: displacement and force of the pulled end.

    Args:
        record: record of the run, with its folder, tables and checks.
    """
    table = record.new_table("table.csv")
    for friction in FRICTION:
        rows, exact = record.add_report(pull(friction)).table, bar(friction)
        path = Table.of({"displacement": rows["t"], "force": rows["force"]})
        for name, curve in ((BAR, exact), (ON_S, path)):
            table.extend({"friction": friction, "curve": name, **row} for row in curve.rows)
        u, force, label = path["displacement"], path["force"], f"friction {friction:g}: "
        ratio = force.max() / exact["force"].max()
        record.check_near(f"{label}largest force over that of the bar on springs", ratio, 1.0, RTOL)
        distance = abs(force - np.interp(u, exact["displacement"], exact["force"])).max() / force.max()
        record.check(f"{label}largest distance of the force, over the largest force", distance, high=RTOL)
        sliding = friction * PRESSURE * LENGTH
        record.check(f"{label}force at the end less f p l, N/mm", abs(force[-1] - sliding), high=1e-9)
        work = float(np.trapezoid(exact["force"], exact["displacement"]))
        stored = sliding**2 * LENGTH / (6 * E * HEIGHT) + LENGTH * friction**2 * PRESSURE**2 / (2 * K)
        spent = rows["dissipated"].sum() / (work - stored)
        record.check_near(f"{label}dissipated energy over that of the bar on springs", spent, 1.0, RTOL)


def draw(record: Record) -> None:
    """Draw the force over the displacement, from table.csv in the folder of `record`."""
    paths = dict[str, Table]()
    for friction, rows in record.load("table.csv").split("friction").items():
        paths |= {f"{name}, friction {friction:g}": curve for name, curve in rows.split("curve").items()}
    axes, look = ("displacement of the end (mm)", "force per width (N/mm)"), {"styles": ("-", "o"), "xlim": (0.0, END)}
    plotting.load_displacement(paths, "displacement", "force", *axes, save=record.path("pull_out.svg"), **look)
