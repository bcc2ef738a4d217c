"""A brick wall, pressed and sheared to its limit, with and without mortar in heads; a panel with meshed joints."""

from __future__ import annotations

from functools import partial
from math import radians, tan

import numpy as np

from forms import LinearElastic, MohrCoulomb, MohrCoulombMonodirectional
from geometry import wall
from studies.problems import mean_on_side
from thinlayer import LimitLoad, Structure, Surface, Table, ThinLayer, march, plotting
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Support
from thinlayer.running.record import Record
from thinlayer.solving.history import History

BRICK_SIZE = (250.0, 75.0)  # mm, with the mortar
CLAY = LinearElastic.young(E=12e3, nu=0.2)  # MPa
EPS = 10.0  # mm, thickness of the joints
MORTAR_E, MORTAR_NU = 2e3, 0.2  # MPa
MORTAR = LinearElastic.young(MORTAR_E, MORTAR_NU)
OMEGA = 30.0  # degrees
COHESIONS = {"BED": 0.1, "HEAD": 0.03}  # MPa
PRESSURE = 0.5  # MPa, on the top
STRENGTH = COHESIONS["BED"] + tan(radians(OMEGA)) * PRESSURE  # of a bed along which all bricks above slide
WALL_NAMES = ("heads with mortar", "open heads")
LIMIT_SHARE = 0.9  # share of the strength of a bed at which walls are compared and drawn
PANEL_SIZE = (2, 3)  # bricks and courses of the panel that is meshed
TOP_SHIFTS = (0.02, 0.04, 0.06, 0.08, 0.1, 0.15, 0.2, 0.3)  # mm, of its top
THICKNESSES = (10.0, 5.0, 2.5)  # mm, of its meshed joints
ELASTIC_FRACTION = 0.01  # of the panel's mortar: without it nothing supports the free ends of joints
JOINT_COLUMNS = ("seam", "size", "elastic", "sliding", "crushed", "torn", "open")  # columns of joints.csv


def run(record: Record, *, quick: bool = False) -> None:
    """Push the top of walls along with growing shear stress, until no equilibrium exists.

    The limit is at most the strength of a bed joint along which all bricks above slide: C + tan(Omega) p, per length of
    the wall, with the cohesion C, friction angle Omega and pressure p.

    table.csv has the shear stress on the top and the mean displacement of the top. joints.csv has the fractions of each
    seam's area that are elastic, slide or are open. They are given at 0.9 of the strength of a bed joint and at the
    limit. panel.csv is of a panel of five bricks with Mohr-Coulomb mortar, whose top is moved along the wall. It has
    the shear stress with the interface law and with meshed joints of several thicknesses.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: fewer bricks, longer steps, one thickness of the panel's joints.
    """
    push_panel(record, THICKNESSES[:1] if quick else THICKNESSES)
    push_walls(record, *((3, 3, 2, 0.08) if quick else (4, 5, 3, 0.03)))


def push_walls(record: Record, bricks: int, courses: int, cells: int, step: float) -> None:
    """Push two walls to the limit, with mortar in their head joints and without, and check the limit.

    Args:
        record: record of the run, which gets table.csv, joints.csv and pictures.
        bricks: number of bricks along each wall.
        courses: number of courses.
        cells: number of cells over the height of a brick.
        step: increment of the shear stress on the top, MPa.
    """
    table, joints = record.new_table("table.csv"), record.new_table("joints.csv")
    near, at_limit, shifts = dict[str, State](), dict[str, State](), []
    for name in WALL_NAMES:
        model = wall_model(bricks, courses, BRICK_SIZE[1] / cells, heads=name == WALL_NAMES[0])
        history, limit_stress = march_to_limit(model, step, 1.5 * STRENGTH)
        top_shifts = [mean_on_side(state, "TOP", state.u[0]) for state in history]
        iterations = [state.report.iterations for state in history]
        table.extend(Table.of({"wall": name, "shear_MPa": history.t, "shift_mm": top_shifts, "iterations": iterations}))
        record.check(f"{name}: limit over that of a bed that slides", limit_stress / STRENGTH, low=0.995, high=1.0)
        shifts.append(np.interp(LIMIT_SHARE * STRENGTH, history.t, top_shifts))
        near[name] = max((state for state in history if state.t <= LIMIT_SHARE * STRENGTH), key=lambda state: state.t)
        at_limit[name] = record.add_report(history.last)
        for state in (near[name], at_limit[name]):
            for row in Surface(state.model).table(state):
                joints.append({"wall": name, "shear_MPa": state.t} | {key: row.get(key, 0.0) for key in JOINT_COLUMNS})
    record.check("shift at 0.9 of the limit, open heads over heads with mortar", shifts[1] / shifts[0], low=1.1)
    for states, file in ((near, "joints.png"), (at_limit, "limit.png")):
        labelled = {f"{name}, sheared by {state.t:.3g} MPa": state for name, state in states.items()}
        plotting.on_surface(labelled, Surface.status, save=record.path(file))


def push_panel(record: Record, thicknesses: tuple[float, ...]) -> None:
    """Move the top of a panel with mortar of the law `MohrCoulomb`, and compare the forces in both kinds of model.

    `thicknesses` are those of the meshed joints, mm. `record` writes the forces to panel.csv.
    """
    supports: dict[str, Support] = {"BOTTOM": 0.0, "TOP": {"x": lambda x, t: t}}
    panel, tractions = wall(*PANEL_SIZE, BRICK_SIZE, BRICK_SIZE[1] / 6, cell="quadrilateral"), {"TOP": (0.0, -PRESSURE)}
    structure = Structure(panel, body=CLAY, supports=supports, tractions=tractions, element="Q1")

    def mortar_layers(eps: float) -> dict[str, ThinLayer]:
        law = partial(MohrCoulomb, MORTAR.lmbda, MORTAR.mu, friction_angle=OMEGA, elastic_fraction=ELASTIC_FRACTION)
        return {name: ThinLayer(law(cohesion=cohesion), eps, at=EPS) for name, cohesion in COHESIONS.items()}

    models: dict[str, Model] = {"interface law": structure.interface(mortar_layers(EPS))}
    for eps in thicknesses:
        models[f"meshed, {eps:g} mm"] = structure.full(mortar_layers(eps), cells_through=2, bodies="extended")
    bed_surface, table, forces = Surface(models["interface law"], "BED"), record.new_table("panel.csv"), {}
    bed_length = bed_surface.integral(1.0)
    for name, model in models.items():
        history = record.add_report(march(model, list(TOP_SHIFTS)))
        # failed steps were subdivided: the models are compared at the times that they share
        forces[name] = [bed_surface.integral(bed_surface.reaction(history.at(t))[0]) / bed_length for t in TOP_SHIFTS]
        table.extend(Table.of({"model": name, "shift_mm": TOP_SHIFTS, "shear_MPa": forces[name]}))
    law_force, *meshed_forces = (np.array(curve) for curve in forces.values())
    errors = [float(np.abs(curve - law_force).max() / law_force.max()) for curve in meshed_forces]
    for eps, error in zip(thicknesses, errors, strict=True):
        record.check(f"force of the panel, joints of {eps:g} mm, meshed and not", error, high=0.003 * eps)
    if len(errors) > 1:
        record.check("observed order of these", float(np.log2(errors[0] / errors[-1])) / (len(errors) - 1), low=0.8)


def wall_model(bricks: int, courses: int, h: float, *, heads: bool) -> InterfaceModel:
    """Make the interface model of a wall, clamped at the bottom, pressed, and sheared on its top.

    The shear stress in MPa is equal to the time t.

    Args:
        bricks: number of bricks along the wall.
        courses: number of courses.
        h: cell size, mm.
        heads: whether there is mortar in the head joints.
    """
    law = partial(MohrCoulombMonodirectional, MORTAR.lmbda, MORTAR.mu, friction_angle=OMEGA)
    layers = {name: ThinLayer(law(cohesion=C, unilateral=name == "BED"), EPS) for name, C in COHESIONS.items()}
    joint, loads = wall(bricks, courses, BRICK_SIZE, h), {"TOP": lambda x, t: (t, -PRESSURE)}
    structure = Structure(joint, body=CLAY, supports={"BOTTOM": 0.0}, tractions=loads)
    return structure.interface(layers if heads else layers | {"HEAD": None})


def march_to_limit(model: InterfaceModel, step: float, end: float) -> tuple[History, float]:
    """March a wall with growing shear stress up to its limit load.

    Args:
        model: model of the wall.
        step: increment of the shear stress, MPa.
        end: shear stress above the limit, at which the march would end, MPa.

    Returns:
        The history up to the limit, and the shear stress at the limit, MPa.
    """
    try:
        march(model, [float(t) for t in np.arange(step, end, step)])
    except LimitLoad as limit:
        return limit.history, limit.t
    raise AssertionError("the wall has no limit")


def draw(record: Record) -> None:
    """Draw the shear stress over the displacement of the top, for the walls and for the panel.

    The values are read from table.csv and panel.csv in the folder of `record`.
    """
    for file, column, picture, title in (
        ("table.csv", "wall", "shear.svg", "a wall, pushed"),
        ("panel.csv", "model", "panel.svg", "a panel, its top moved along"),
    ):
        tables, columns = record.load(file).split(column), ("shift_mm", "shear_MPa")
        lines = {name: tuple(np.insert(rows[key], 0, 0) for key in columns) for name, rows in tables.items()}
        look = {"title": f"{title}, under a pressure of {PRESSURE:g} MPa", "styles": ("o-", "s-", "^--", "v--", "d--")}
        plotting.curves(lines, "shift of the top (mm)", "shear stress (MPa)", save=record.path(picture), **look)
