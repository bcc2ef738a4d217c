"""Rubber bearings, one disc or three between stiff plates: meshed, by a law with a pressure on S, and by one without."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from forms import Incompressible, LinearElastic, Rubber, limits
from geometry import faults, sandwich
from geometry.joint import Joint
from thinlayer import Structure, Surface, Table, ThinLayer, plotting, solve
from thinlayer.discretisation.model import Model
from thinlayer.running.record import Record

RADIUS, PLATE = 30.0, 10.0  # mm: of the disc; height of a plate
PLATES = LinearElastic.young(E=1e7, nu=0.3)  # MPa
MU = 1.2  # MPa: shear modulus of the rubber
SHAPES = (2.5, 5.0, 10.0)  # shape factors: loaded over free area, radius/(2 eps)
RATIOS = (0.3, 0.4, 0.45, 0.48, 0.49, 0.495, 0.499, 0.4995, 0.4999, 0.5)  # Poisson's
OPENING = 0.01  # mm
MODELS = {"meshed": "meshed layer", "rubber": "law Rubber, order 1", "order_0": "LinearElastic, order 0"}
DRAWN = {"nu": 0.499, "shape": 5.0}  # whose tractions are drawn along the radius


def run(record: Record, *, nu: Sequence[float] = RATIOS, quick: bool = False) -> None:
    """Pull the upper plate by 0.01 mm, and compare the force with that of rigid plates in closed form.

    Args:
        record: where to write.
        nu: Poisson's ratios of the rubber, in (0, 1/2].
        quick: every other ratio, fewer cells, and two shape factors.
    """
    shapes, ratios = (SHAPES[:2], sorted({*nu[::2], *nu[-2:]})) if quick else (SHAPES, nu)
    structures = {shape: _structure(shape, quick=quick) for shape in shapes}
    cases = [(structure, shape, ratio) for shape, structure in structures.items() for ratio in ratios]
    table = record.rows("table.csv", cases, partial(_row, record), "shape factor {0[1]:g}, nu = {0[2]:g}")
    closed, wide = table["closed"], table["shape"] >= 5
    errors = {name: np.abs(table[name] / closed - 1) for name in ("meshed", "rubber")}
    record.check("largest error of the law with a pressure", errors["rubber"].max(), high=2e-3)
    of = "largest distance of meshed layers from the closed form"
    record.check(f"{of}, shape factors from 5 on", errors["meshed"][wide].max(), high=0.013)
    record.check(f"{of}, all shape factors", errors["meshed"].max(), high=0.03)
    record.check("least excess of the law of order 0", (table["order_0"] / closed).min() - 1, low=0.01)
    below = table["nu"] < 0.5
    eps, lmbda = RADIUS / (2 * table["shape"][below]), np.array([_modulus(nu) for nu in table["nu"][below]])
    pressures = lmbda / (closed[below] * eps - 2 * MU)  # of order 0 over that of the closed form
    distance = np.abs(table["too_stiff"][below] / pressures - 1).max()
    record.check("largest distance of what is told of order 0 from closed forms", distance, high=0.01)
    _laminated(record, quick=quick)
    _tractions(record, quick=quick)


def _laminated(record: Record, *, quick: bool) -> None:
    """Three layers between shims, which are springs in series."""
    shape = DRAWN["shape"]
    cuts = {name: ((-1.0, PLATE * k), (RADIUS + 1.0, PLATE * k)) for k, name in enumerate(("LOW", "MIDDLE", "HIGH"), 1)}
    eps, fine = RADIUS / (2 * shape), 1 if quick else 2
    joint = faults(RADIUS, 4 * PLATE, cuts, RADIUS / 8, h_S=RADIUS / (20 * fine), h_ends=eps / (15 * fine))
    row, ratios = partial(_row, record, _held(joint), shape), (0.499,) if quick else (0.49, 0.499, 0.4999, 0.5)
    table = record.rows("laminated.csv", ratios, row, "three layers, nu = {:g}")
    for name, high in (("rubber", 2e-3), ("meshed", 0.015)):
        error = float(np.abs(table[name] / table["closed"] - 1).max())
        record.check(f"three layers: largest distance from springs in series, {MODELS[name]}", error, high=high)
    excess = (table["order_0"] / table["closed"]).min() - 1
    record.check("three layers: least excess of the law of order 0", excess, low=0.1)


def _row(record: Record, structure: Structure, shape: float, nu: float) -> dict[str, float]:
    eps = RADIUS / (2 * shape)
    seams = structure.joint.seams
    row = {"shape": shape, "nu": nu, "closed": limits.rubber_disc(_modulus(nu), MU, eps, RADIUS) / len(seams)}
    area = math.pi * RADIUS**2
    for name in MODELS:
        if nu == 0.5 and name == "order_0":
            row |= {name: math.inf, "too_stiff": math.inf}  # it lets the plates part by nothing
            continue
        state = record.solved(solve(_model(structure, name, eps, nu)))
        row[name] = state.reaction("TOP").force[1] / (area * OPENING)
        if name == "order_0":
            row["too_stiff"] = Surface(state.model).table(state)["too_stiff"].max()
    return row


def _modulus(nu: float) -> float:
    return math.inf if nu == 0.5 else LinearElastic.shear(MU, nu).lmbda


def _structure(shape: float, *, quick: bool) -> Structure:
    cells, eps = 30 if quick else 60, RADIUS / (2 * shape)
    joint = sandwich(RADIUS, PLATE, PLATE, RADIUS / 8, h_S=RADIUS / cells, h_ends=eps / 15, cell="quadrilateral")
    return _held(joint)


def _held(joint: Joint) -> Structure:
    supports = {"BOTTOM": {"x": 0.0, "y": 0.0}, "TOP": {"x": 0.0, "y": OPENING}}
    return Structure(joint, body=PLATES, supports=supports, plane="axisymmetric")


def _model(structure: Structure, name: str, eps: float, nu: float) -> Model:
    if name == "order_0":
        return structure.interface(ThinLayer(LinearElastic(_modulus(nu), MU), eps))
    law = Incompressible(MU) if nu == 0.5 else Rubber(_modulus(nu), MU)
    if name == "rubber":  # in closed forms a pressure knows nothing of its ends but that it is zero there
        return structure.interface(ThinLayer(law, eps, order=1, edges="plain"))
    return structure.full(ThinLayer(law, eps), cells_through=6)


def _tractions(record: Record, *, quick: bool) -> None:
    """Write the normal tractions of one bearing along the radius, over the largest one in closed form."""
    shape, nu = DRAWN["shape"], DRAWN["nu"]
    eps, lmbda = RADIUS / (2 * shape), _modulus(nu)
    structure = _structure(shape, quick=quick)
    states = {name: record.solved(solve(_model(structure, name, eps, nu))) for name in MODELS}
    surface = Surface(states["rubber"].model)
    found = {name: surface.profile(surface.traction(state)) for name, state in states.items()}
    r = found["rubber"][0][:, 0]
    closed = OPENING * (limits.rubber_disc_pressure(lmbda, MU, eps, RADIUS, r) + 2 * MU / eps)
    order = np.argsort(r)
    tractions = {name: profile[order, 1] / closed.max() for name, (_, profile) in found.items()}
    table = Table.of({"radius_mm": r[order], "closed": closed[order] / closed.max(), **tractions})
    record.write("tractions.csv", table)
    inside = table["radius_mm"] < RADIUS - eps
    for name, high in (("rubber", 0.005), ("meshed", 0.03)):
        error = float(np.abs(table[name] - table["closed"])[inside].max())
        record.check(f"largest error of the traction, further than eps from the end, {MODELS[name]}", error, high=high)


def draw(record: Record) -> None:
    """Draw stiffnesses over those in closed form against nu, and tractions along the radius, from the tables."""
    parts = {}
    for shape, part in record.load("table.csv").split("shape").items():
        at = part["nu"] < 0.5
        x = np.log10(2 * part["nu"][at] / (1 - 2 * part["nu"][at]))
        stiffnesses = {label: (x, (part[name] / part["closed"])[at]) for name, label in MODELS.items()}
        parts[f"radius {2 * shape:g} eps"] = stiffnesses
    ratio, share, styles = "log10(lmbda/mu); 3.7: nu = 0.4999", "stiffness over closed form", ("o", "-", "^-")
    plotting.curves(parts, ratio, share, styles=styles, ylim=(0.95, 1.3), save=record.path("stiffness.png"))
    along = record.load("tractions.csv")
    columns = {"closed": "closed form, rigid plates", **MODELS}
    lines = {label: (along["radius_mm"], along[name]) for name, label in columns.items()}
    title, save = f"rubber of nu = {DRAWN['nu']:g}, radius {2 * DRAWN['shape']:g} eps", record.path("tractions.png")
    share, dashes = "normal traction over the largest in closed form", ("-", ".", "--", ":")
    plotting.curves(lines, "radius (mm)", share, title=title, styles=dashes, ylim=(0.0, 2.8), save=save)
