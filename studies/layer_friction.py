"""Friction of a Mohr-Coulomb layer at a point: sin(Omega), not tan(Omega), under lasting shear; path and dilatancy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from forms import BulkLaw, MohrCoulomb, MohrCoulombMonodirectional, formulas
from forms.base import Array
from studies.sweeping import Curves
from thinlayer import Table, plotting
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.pointwise.drive import PointHistory, drive
from thinlayer.running.record import Record

LMBDA, MU = 60.0, 40.0
NU = LMBDA / (2 * (LMBDA + MU))
OMEGA = 30.0
SIN_OMEGA, TAN_OMEGA = np.sin(np.radians(OMEGA)), np.tan(np.radians(OMEGA))  # friction coefficients; Coulomb's is tan
DILATANCY_ANGLES = (10.0, 20.0, 30.0)
PSI_LABELS = {psi: f"psi = {psi:g}" for psi in DILATANCY_ANGLES}
CLOSING_JUMP = -0.01  # constant normal jump; the constant normal stress is the elastic stress at this jump, -1.4
PATH_DIRECTION = 75.0  # direction of the proportional path, degrees from the normal
END_SHEAR = 5.0  # shear at the end of the curves: mu w_T over the pressure at the start
LOOSENED_SHARE = 0.6  # share of the closing by which the layer is opened to reduce the normal stress
LASTING_SHEAR = 60.0  # shear, as in END_SHEAR, at which friction has its lasting value

PRESSURE = -(LMBDA + 2 * MU) * CLOSING_JUMP
FIXED_STRESS, FIXED_JUMP = "normal stress held", "normal jump held"
HELD_VALUES = {FIXED_STRESS: {"t_N": -PRESSURE}, FIXED_JUMP: {"w_N": CLOSING_JUMP}}
RADIAL = f"w_T/|w_N| held, {PATH_DIRECTION:g}° off the normal"
UNLOADED = "sheared, unloaded across S, sheared"
PLANES = "slips parallel to S alone"
PATHS, FLOW = "paths, dilatancy angle psi = 0", "flow rules (psi in degrees), normal stress held"


def run(record: Record, *, quick: bool = False) -> None:
    """Compute the apparent friction t_T/|t_N| of a layer without cohesion as it is sheared.

    The study compares several paths of shear and normal loading, and several laws.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: longer steps.
    """
    steps, law = 100 if quick else 400, MohrCoulomb(LMBDA, MU, 0.0, OMEGA)
    curves = {name: drive(law, held_path(name, steps)) for name in HELD_VALUES}
    curves |= {RADIAL: drive(law, radial_path(steps)), UNLOADED: drive(law, unloaded_path(steps))}
    laws: dict[str, BulkLaw] = {PLANES: MohrCoulombMonodirectional(LMBDA, MU, 0.0, OMEGA)}
    laws |= {name: replace(law, dilatancy_angle=psi) for psi, name in PSI_LABELS.items()}
    for name, other_law in laws.items():
        curves[name] = drive(other_law, held_path(FIXED_STRESS, steps))
        curves[f"{name}, {FIXED_JUMP}"] = drive(other_law, held_path(FIXED_JUMP, steps))
    table = record.new_table("table.csv")
    for name, history in curves.items():
        shear, friction = MU * history.jumps[:, 0] / PRESSURE, apparent_friction(history)
        columns = {column: history.table[column] for column in history.table.columns}
        table.extend(Table.of({"path": name, "shear": shear, "friction": friction, **columns}))

    sheared = curves[FIXED_JUMP]
    exact = formulas.mohr_coulomb_fixed_opening(LMBDA, MU, 0.0, OMEGA, CLOSING_JUMP, sheared.jumps[:, 0])
    error, max_friction = np.abs(sheared.tractions - exact).max(), float(np.nanmax(apparent_friction(curves[UNLOADED])))
    record.check("largest error against the closed form, opening held", error, high=6 / steps)
    record.check_near("largest friction while the normal stress is taken away", max_friction, TAN_OMEGA, 1e-5)
    for name in HELD_VALUES:
        record.check_near(f"lasting friction, {name}", lasting_friction(law, name), SIN_OMEGA, 1e-6)
    for psi in DILATANCY_ANGLES[:2]:
        lasting = lasting_friction(replace(law, dilatancy_angle=psi), FIXED_STRESS)
        record.check_near(f"lasting friction, psi = {psi:g}", lasting, formulas.apparent_friction(OMEGA, psi), 5e-7)
    record.check_near(f"lasting friction, {PLANES}", apparent_friction(curves[PLANES])[-1], TAN_OMEGA, 1e-12)


def apparent_friction(history: PointHistory) -> Array:
    """Return the apparent friction (steps,) t_T/|t_N| at a point after each step of `history`; NaN without pressure."""
    t_T, t_N = history.tractions.T
    return np.where(t_N < 0, t_T / np.where(t_N < 0, -t_N, 1.0), np.nan)


def lasting_friction(law: MohrCoulomb, name: str) -> float:
    """Return the apparent friction after a large shear, at the constant stress or jump `name` of `HELD_VALUES`."""
    return float(apparent_friction(drive(law, held_path(name, 60, LASTING_SHEAR)))[-1])


# ---------------------------------------------------------------- paths
def tangential_jumps(steps: int, end: float) -> Array:
    """Return the tangential jumps w_T, divided by the thickness, after each of `steps` equal steps from zero.

    `end` is the shear after the last step: mu w_T divided by `PRESSURE`, with the shear modulus mu.
    """
    return np.linspace(0, end * PRESSURE / MU, steps + 1, dtype=np.float64)[1:]


def held_path(name: str, steps: int, end: float = END_SHEAR) -> list[dict[str, float]]:
    """Return a path with a constant normal stress or normal jump, which acts first, and a growing tangential jump.

    Args:
        name: name of what is constant, in `HELD_VALUES`.
        steps: number of steps of the tangential jump.
        end: shear at the end, over the pressure at the start.

    Returns:
        The prescribed components in each step.
    """
    return [{"w_T": w, **HELD_VALUES[name]} for w in (0.0, *tangential_jumps(steps, end))]


def radial_path(steps: int) -> list[dict[str, float]]:
    """Return a path on which closing and shear of a layer grow in proportion, in `steps` equal steps.

    Each step prescribes {"w_T": value, "w_N": value}: the tangential and the normal jump, divided by the thickness.
    """
    return [{"w_T": w, "w_N": -w / np.tan(np.radians(PATH_DIRECTION))} for w in tangential_jumps(steps, END_SHEAR)]


def unloaded_path(steps: int) -> list[dict[str, float]]:
    """Return a path on which a layer is sheared under a constant normal stress, opened, and sheared further.

    It is opened by the fraction `LOOSENED_SHARE` of its closing. Each of these three parts has steps/2 steps, after a
    first step of compression. A step prescribes the tangential jump "w_T" and either the normal jump "w_N" or the
    normal traction "t_N". Jumps are divided by the thickness.
    """
    first = held_path(FIXED_STRESS, steps // 2, END_SHEAR / 2)
    w_T, w_N = drive(MohrCoulomb(LMBDA, MU, 0.0, OMEGA), first).jumps[-1]
    opened = [{"w_T": w_T, "w_N": w} for w in np.linspace(w_N, (1 - LOOSENED_SHARE) * w_N, steps // 2 + 1)[1:]]
    last_w_N = opened[-1]["w_N"]
    return [*first, *opened, *({"w_T": w_T + w, "w_N": last_w_N} for w in tangential_jumps(steps // 2, END_SHEAR / 2))]


def draw(record: Record) -> None:
    """Draw the apparent friction over the shear, for several paths and for several laws, from table.csv of `record`."""
    curves = record.load("table.csv").split("path")
    shown = {PATHS: (UNLOADED, FIXED_STRESS, FIXED_JUMP, RADIAL), FLOW: (FIXED_STRESS, *PSI_LABELS.values(), PLANES)}
    first_yield = formulas.first_yield_ratio(NU, OMEGA)
    values = {"tan(Omega)": TAN_OMEGA, "sin(Omega)": SIN_OMEGA, "first yield": first_yield}
    lines: Curves = {name: (np.array([0.0, END_SHEAR]), np.full(2, value)) for name, value in values.items()}
    panels = {}
    for title, paths in shown.items():
        panels[title] = {path: (curves[path]["shear"], curves[path]["friction"]) for path in paths} | lines
    line_colours = *COLOURS[4:], "0.3", "black", "black", "0.5"
    colours = dict(zip((*PSI_LABELS.values(), PLANES, *lines), line_colours, strict=True))
    title = f"Mohr-Coulomb layer, Omega = {OMEGA:g}°: its lasting friction is sin(Omega), not tan(Omega)"
    labels = ("shear mu w_T over the pressure at the start", "apparent friction t_T / |t_N|")
    options = {"styles": dict(zip(lines, (":", "--", "-."), strict=True)), "colours": colours, "ylim": (0.0, 0.65)}
    plotting.curves(panels, *labels, title=title, save=record.path("friction.svg"), **options)
