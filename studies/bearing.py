"""Rubber bearings, discs between stiff plates: meshed, and by interface laws with and without a pressure on S."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from forms import Incompressible, LinearElastic, Rubber, formulas
from geometry import sandwich
from thinlayer import Structure, ThinLayer, plotting, solve
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.supports import Place, Support
from thinlayer.running.record import Record

RADIUS, PLATE = 30.0, 10.0  # mm: of the disc; height of a plate
PLATE_LAW = LinearElastic.young(E=1e7, nu=0.3)  # MPa
MU = 1.2  # MPa: shear modulus of the rubber
SHAPE_FACTORS = (2.5, 5.0, 10.0)  # shape factors: loaded over free area, radius/(2 eps)
POISSON_RATIOS = (0.3, 0.4, 0.45, 0.48, 0.49, 0.495, 0.499, 0.4995, 0.4999, 0.5)  # Poisson's ratios
LIFT = 0.01  # mm, displacement of the upper plate
MODEL_LABELS = {"meshed": "meshed layer", "rubber": "law Rubber, order 1", "order_0": "LinearElastic, order 0"}


def run(record: Record, *, nu: Sequence[float] = POISSON_RATIOS, quick: bool = False) -> None:
    """Pull the upper plate by 0.01 mm, and compare the force in three models with a closed form for rigid plates.

    The models are the meshed rubber, the law `Rubber` of order 1, and `LinearElastic` of order 0.

    Args:
        record: record of the run, with its folder, tables and checks.
        nu: Poisson's ratios of the rubber, in (0, 1/2].
        quick: every other ratio, fewer cells, and two of the three shape factors.
    """
    shape_factors, nus = (SHAPE_FACTORS[:2], sorted({*nu[::2], *nu[-2:]})) if quick else (SHAPE_FACTORS, nu)
    h_S, eps_of = RADIUS / (30 if quick else 60), {shape: RADIUS / (2 * shape) for shape in shape_factors}
    structures = {shape: plated_disc(PLATE_LAW, eps, h_S) for shape, eps in eps_of.items()}
    cases = [(structures[shape], shape, one_nu) for shape in shape_factors for one_nu in nus]
    table = record.rows("table.csv", cases, partial(_stiffness_row, record), "shape factor {0[1]:g}, nu = {0[2]:g}")
    exact, is_wide = table["closed"], table["shape"] >= 5
    errors = {name: np.abs(table[name] / exact - 1) for name in ("meshed", "rubber")}
    record.check("largest error of the law with a pressure", errors["rubber"].max(), high=2e-3)
    check_name = "largest distance of meshed layers from the closed form"
    record.check(f"{check_name}, shape factors from 5 on", errors["meshed"][is_wide].max(), high=0.013)
    record.check(f"{check_name}, all shape factors", errors["meshed"].max(), high=0.03)
    record.check("least excess of the law of order 0", (table["order_0"] / exact).min() - 1, low=0.01)


def _stiffness_row(record: Record, structure: Structure, shape_factor: float, nu: float) -> dict[str, float]:
    eps = RADIUS / (2 * shape_factor)
    row = {"shape": shape_factor, "nu": nu, "closed": formulas.disc_stiffness(_lmbda(nu), MU, eps, RADIUS)}
    for name in MODEL_LABELS:
        if nu == 0.5 and name == "order_0":
            row[name] = math.inf  # the plates cannot separate
            continue
        state = record.add_report(solve(_model(structure, name, eps, nu)))
        row[name] = state.reaction("TOP").force[1] / (math.pi * RADIUS**2 * LIFT)
    return row


def _lmbda(nu: float) -> float:
    return math.inf if nu == 0.5 else LinearElastic.shear(MU, nu).lmbda


def plated_disc(plates: LinearElastic, eps: float, h_S: float) -> Structure:
    """Make a disc between two plates, of which the upper one is lifted by 0.01 mm.

    Args:
        plates: law of the plates, MPa.
        eps: thickness of the disc, mm; cells at the free end of S are 15 times smaller.
        h_S: cell size on S, mm.
    """
    joint = sandwich(RADIUS, PLATE, PLATE, RADIUS / 8, h_S=h_S, h_ends=eps / 15, cell="quadrilateral")
    supports: dict[Place, Support] = {"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": LIFT}}
    return Structure(joint, body=plates, supports=supports, plane="axisymmetric")


def _model(structure: Structure, name: str, eps: float, nu: float) -> Model:
    if name == "order_0":
        return structure.interface(ThinLayer(LinearElastic(_lmbda(nu), MU), eps))
    law = Incompressible(MU) if nu == 0.5 else Rubber(_lmbda(nu), MU)
    if name == "rubber":  # the closed form has zero pressure at the ends and no correction there
        return structure.interface(ThinLayer(law, eps, order=1, edges="plain"))
    return structure.full(ThinLayer(law, eps), cells_through=6)


def draw(record: Record) -> None:
    """Draw the stiffness of each model, divided by that of the closed form, over lambda/mu of the rubber.

    The stiffnesses are read from table.csv in the folder of `record`; the picture is stiffness.svg.
    """
    panels = {}
    for shape, part in record.load("table.csv").split("shape").items():
        is_finite = part["nu"] < 0.5
        x = 2 * part["nu"][is_finite] / (1 - 2 * part["nu"][is_finite])
        stiffnesses = {label: (x, (part[name] / part["closed"])[is_finite]) for name, label in MODEL_LABELS.items()}
        panels[f"rubber disc, radius {2 * shape:g} eps"] = stiffnesses
    options = {"styles": ("o", "-", "^--"), "log": "x", "ylim": (0.95, 1.3), "save": record.path("stiffness.svg")}
    plotting.curves(panels, "lambda/mu (5000: nu = 0.4999)", "stiffness over closed form", **options)
