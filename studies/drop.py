"""Glass glued to an aluminium plate falls onto pads: forces in time with a law on S, a meshed layer, and no mass on S."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import ufl

from forms import LinearElastic
from geometry import sandwich
from thinlayer import Inertia, Springs, Structure, Surface, Table, ThinLayer, march, plotting
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.running.record import Record

ALUMINIUM = (70e3, 0.33, 2.7e-9)  # MPa, Poisson's ratio, t/mm^3
GLASS = (70e3, 0.23, 2.5e-9)
GLUE = (4.0, 0.45, 1.8e-9)
HALF_LENGTH, HEIGHTS, EPS = 40.0, (2.0, 1.0), 0.5  # mm
PAD_LENGTH, PAD_STIFFNESS = 6.0, 8.0  # mm; MPa/mm, of a pad under each end
SPEED = 3e3  # mm/s, of a fall from 0.46 m
END = 1.7e-4  # s, when the plates leave the pads
MODELS = {"meshed layer": ("full", 1), "law on S": ("interface", 1), "no mass on S": ("interface", 0)}


def run(record: Record, *, quick: bool = False) -> None:
    """March glued plates that fall onto pads at their ends, until they leave them; table.csv has forces and energies.

    Models are a meshed layer, a law of order 1 on S, and the same law without the mass of the layer.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: 60 steps, not 120.
    """
    table, n = record.new_table("table.csv"), 60 if quick else 120
    for name, (kind, with_mass) in MODELS.items():
        model = half_plates(kind, GLUE[2] * with_mass)
        history = march(model, [END * k / n for k in range(1, n + 1)], observe=quantities(model), keep="last")
        rows = history.table
        record.check(f"{name}: change of the energy", np.ptp(rows["energy"]) / rows["energy"][0], high=1e-8)
        for k, t in enumerate(rows["t"]):
            table.append({"model": name, "ms": 1e3 * t} | {key: rows[key][k] for key in quantities(model)})
    _check(record, table)


def _check(record: Record, table: Table) -> None:
    models = table.split("model")
    for column, name in (
        ("pad", "force of a pad"),
        ("shear", "shear force of the glue"),
        ("kinetic", "kinetic energy"),
    ):
        exact = models["meshed layer"][column]
        for model, limits in (("law on S", {"high": 4e-3}), ("no mass on S", {"low": 0.02})):
            difference = abs(models[model][column] - exact).max() / abs(exact).max()
            record.check(f"{name}, {model}: largest difference over the largest value", difference, **limits)


def half_plates(kind: str, rho: float) -> Model:
    """Make the left half of the plates, on its pad; `kind` is "full" or "interface", `rho` the density of the glue."""
    joint = sandwich(HALF_LENGTH, *HEIGHTS, 2.0, cell="quadrilateral", structured=True)
    fall = (0.0, -SPEED)
    density = {"LOWER": ALUMINIUM[2], "UPPER": GLASS[2], "S": rho}
    mass = Inertia(density, velocity={"LOWER": fall, "UPPER": fall})
    pad = Springs("BOTTOM", normal=lambda x: ufl.conditional(ufl.lt(x[0], PAD_LENGTH), PAD_STIFFNESS, 0.0))
    body = {"LOWER": LinearElastic.young(*ALUMINIUM[:2]), "UPPER": LinearElastic.young(*GLASS[:2])}
    structure = Structure(joint, body=body, supports={"RIGHT": {"x": 0}}, parts=[mass, pad])
    layer = ThinLayer(LinearElastic.young(*GLUE[:2]), EPS, order=1)
    return structure.full(layer) if kind == "full" else structure.interface(layer)


def quantities(model: Model) -> dict[str, Callable[[State], float]]:
    """Return functions to observe: force of the pad and shear force of the glue, N/mm; kinetic and total energy, N."""
    surface = Surface(model)

    def shear(state: State) -> float:
        return float(surface.integral(surface.traction(state)[0]))

    return {
        "pad": lambda state: float(state.reaction("BOTTOM").force[1]),
        "shear": shear,
        "kinetic": lambda state: state.energies()["inertia"],
        "energy": lambda state: state.audit.total,
    }


def draw(record: Record) -> None:
    """Draw forces and energies over time, from table.csv in the folder of `record`."""
    models = record.load("table.csv").split("model")
    panels = {
        title: {name: (rows["ms"], sign * rows[column]) for name, rows in models.items()}
        for title, column, sign in (
            ("force of a pad (N/mm)", "pad", 1),
            ("shear force of the glue (N/mm)", "shear", -1),
            ("kinetic energy (N)", "kinetic", 1),
        )
    }
    title = "glass glued to aluminium falls onto pads"
    plotting.curves(panels, "time (ms)", title=title, save=record.path("drop.svg"))
