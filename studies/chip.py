"""A chip on copper with a thermal pad between: temperature, stress by unequal expansion, and whether the pad matters.

The half of the chip to the right of its middle is modelled. The chip is bonded hot, without stress; in use it is cooler
than that, and hot in its middle. Temperatures on each side of the pad are the eigenstrain of mechanics.
"""

from __future__ import annotations

import ufl

from forms import Conduction, LinearElastic
from geometry import sandwich
from thinlayer import Film, Structure, Surface, ThermalExpansion, ThinLayer, compare, estimate, plotting, solve
from thinlayer.discretisation.supports import Place, Support
from thinlayer.running.record import Record

EPS, WIDTH = 0.05, 5.0  # mm
COPPER, CHIP = "LOWER", "UPPER"
BODIES, PAD_CONDUCTIVITY = {COPPER: Conduction(k=0.4), CHIP: Conduction(k=0.12)}, 4e-3  # W/(mm K)
EXPANSIONS, PAD_EXPANSION = {COPPER: 17e-6, CHIP: 2.6e-6}, 80e-6  # 1/K
ELASTIC = {COPPER: LinearElastic.young(E=120e3, nu=0.34), CHIP: LinearElastic.young(E=165e3, nu=0.22)}  # MPa
PAD = LinearElastic.young(E=500.0, nu=0.4)
BONDED_AT, AIR = 150.0, 25.0  # degrees Celsius


def run(record: Record, *, quick: bool = False) -> None:
    """Compute temperature and stress of a chip on a thermal pad, meshed and on S, and estimate the cost of dropping it.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: cells twice as long.
    """
    h = 0.35 if quick else 0.175
    joint = sandwich(WIDTH, 2, 0.7, h=h, h_S=h / 2, cell="quadrilateral")
    power = {"TOP": lambda x, t: ufl.conditional(ufl.lt(x[0], 2.0), 1.0, 0.0)}  # W/mm2
    heated = Structure(joint, body=BODIES, fluxes=power, parts=[Film("BOTTOM", h=5e-3, T=AIR)], supports={})
    pad = ThinLayer(Conduction(PAD_CONDUCTIVITY), EPS)
    states = {name: record.add_report(solve(getattr(heated, name)(pad))) for name in ("full", "interface")}
    bonded = solve(heated.bonded())
    surface, table = Surface(bonded.model), record.new_table("table.csv")
    cooled, peaks = {}, {}
    for name, warm in {**states, "bond": bonded}.items():
        strains = {body: ThermalExpansion(a, warm, reference=BONDED_AT) for body, a in EXPANSIONS.items()}
        glue = ThinLayer(PAD, EPS, order=1, eigenstrain=ThermalExpansion(PAD_EXPANSION, warm, reference=BONDED_AT))
        rollers: dict[Place, Support] = {"LEFT": {"x": 0}, (0, -2.0): {"y": 0}}
        chip = Structure(joint, body=ELASTIC, supports=rollers, eigenstrain=strains)
        model = chip.full(glue) if name == "full" else chip.interface(glue)
        cooled[name] = record.add_report(solve(model))
        peaks[name] = surface.displacements(warm)[1].max()
        x, shear = surface.profile(surface.traction(cooled[name])[0])
        sides = [surface.nodal(T) for T in surface.displacements(warm)[:, 0]]
        columns = ("x", "shear", "lower", "upper")
        table.extend(
            {"model": name, **dict(zip(columns, row, strict=True))} for row in zip(x[:, 0], shear, *sides, strict=True)
        )
    errors = {
        name: compare(some["full"], some["interface"]) for name, some in {"heat": states, "stress": cooled}.items()
    }
    record.check("flux on S: error of the law", errors["heat"]["error_flux"], high=1e-4)
    record.check("traction on S: error of the law", errors["stress"]["error_traction"], high=0.02)
    record.check_near(
        "peak temperature above the pad without the pad over that with it", peaks["bond"] / peaks["full"], 0.922, 2e-3
    )
    compliance, truth = estimate(bonded, layer=pad).goals["compliance"], states["full"].load_work()
    dropped = (compliance.better - compliance.value) / (truth - compliance.value)
    record.check_near("estimate of what dropping the pad costs, over the truth", dropped, 1.0, 0.01)


def draw(record: Record) -> None:
    """Draw temperatures of both sides of the pad and its shear stress, from table.csv in the folder of `record`."""
    tables, names = (
        record.load("table.csv").split("model"),
        {"full": "meshed pad", "interface": "law on S", "bond": "heat without pad"},
    )
    columns = {"lower": "copper's side of the pad", "upper": "chip's side", "shear": "shear stress"}
    lines = {
        title: {names[model]: (rows["x"], rows[column]) for model, rows in tables.items()}
        for column, title in columns.items()
    }
    labels = {title: "MPa" if column == "shear" else "degrees Celsius" for column, title in columns.items()}
    look = {"title": "a chip on a thermal pad", "styles": {"meshed pad": "."}}
    plotting.curves(lines, "x from the middle (mm)", labels, save=record.path("chip.svg"), **look)
