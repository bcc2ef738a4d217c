"""Rubber bearings, one disc or three between stiff plates: meshed, by a law with a pressure on S, and by one without."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from forms import Incompressible, LinearElastic, Rubber, limits
from geometry import faults, sandwich
from geometry.joint import Joint
from thinlayer import Model, Structure, Surface, ThinLayer, plotting, solve
from thinlayer.files.progress import track
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
    record.parameters = {"radius_mm": RADIUS, "opening_mm": OPENING, "mu_MPa": MU, "plates": str(PLATES)}
    table = record.table("table.csv")
    for shape in shapes:
        structure = _structure(shape, quick=quick)
        for ratio in track(ratios, "bearing", f"shape factor {shape:g}, nu = {{:g}}"):
            table.append(_row(record, structure, shape, ratio))
    record.say(table)
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
    structure = _held(joint)
    table = record.table("laminated.csv")
    for nu in track((0.499,) if quick else (0.49, 0.499, 0.4999, 0.5), "bearing", "three layers, nu = {:g}"):
        table.append(_row(record, structure, shape, nu))
    record.say(table)
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
    return Structure(
        joint,
        body=PLATES,
        supports={"BOTTOM": {"x": 0.0, "y": 0.0}, "TOP": {"x": 0.0, "y": OPENING}},
        plane="axisymmetric",
    )


def _model(structure: Structure, name: str, eps: float, nu: float) -> Model:
    if name == "order_0":
        return structure.interface(ThinLayer(LinearElastic(_modulus(nu), MU), eps))
    law = Incompressible(MU) if nu == 0.5 else Rubber(_modulus(nu), MU)
    if (
        name == "rubber"
    ):  # closed forms are those of a pressure that knows nothing of its ends but that it is zero there
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
    table = record.table("tractions.csv")
    for k in np.argsort(r):
        tractions = {name: float(profile[k, 1] / closed.max()) for name, (_, profile) in found.items()}
        table.append({"radius_mm": float(r[k]), "closed": float(closed[k] / closed.max()), **tractions})
    inside = table["radius_mm"] < RADIUS - eps
    for name, high in (("rubber", 0.005), ("meshed", 0.03)):
        error = float(np.abs(table[name] - table["closed"])[inside].max())
        record.check(f"largest error of the traction, further than eps from the end, {MODELS[name]}", error, high=high)


def draw(record: Record) -> None:
    """Draw stiffnesses over those in closed form against nu, and tractions along the radius, from the tables."""
    table, parts = record.load("table.csv"), {}
    for shape in np.unique(table["shape"]):
        at = (table["shape"] == shape) & (table["nu"] < 0.5)
        x = np.log10(2 * table["nu"][at] / (1 - 2 * table["nu"][at]))
        lines = {label: (x, (table[name] / table["closed"])[at]) for name, label in MODELS.items()}
        parts[f"radius {2 * shape:g} eps"] = lines
    labels = list(MODELS.values())
    plotting.panels(
        parts,
        xlabel="log10(lmbda/mu); 3.7: nu = 0.4999",
        ylabels=dict.fromkeys(parts, "stiffness over closed form"),
        styles=dict(zip(labels, ("o", "-", "^-"), strict=True)),
        colours=dict(zip(labels, ("black", "tab:blue", "tab:red"), strict=True)),
        ylims=dict.fromkeys(parts, (0.95, 1.3)),
        save=record.path("stiffness.png"),
    )
    along = record.load("tractions.csv")
    columns = {"closed": "closed form, rigid plates", **MODELS}
    plotting.curves(
        {label: (along["radius_mm"], along[name]) for name, label in columns.items()},
        xlabel="radius (mm)",
        ylabel="normal traction over the largest in closed form",
        title=f"rubber of nu = {DRAWN['nu']:g}, radius {2 * DRAWN['shape']:g} eps",
        styles=dict(zip(columns.values(), ("-", ".", "--", ":"), strict=True)),
        ylim=(0.0, 2.8),
        save=record.path("tractions.png"),
    )
