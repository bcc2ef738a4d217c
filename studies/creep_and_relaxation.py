"""Creep and relaxation of columns: both models against closed forms, and rates of convergence of time schemes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from forms import BulkLaw, KelvinVoigt, Maxwell, Norton, Stack
from forms.base import Array
from geometry import sandwich
from studies.problems import FOURIER_BODY as BODY
from thinlayer import Structure, Surface, Table, ThinLayer, march, plotting
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.supports import Support
from thinlayer.output.plotting.curves import COLOURS
from thinlayer.running.record import Record
from thinlayer.system.progress import track

LMBDA, MU = 60.0, 40.0
EPS = 0.1  # thickness; if the bodies are kept, results do not depend on it
THETA_LMBDA, THETA_MU, T1 = 0.3, 0.5, 0.7
TIME_STEP, END_TIME = 0.1, 2.0  # step and end of the curves
ERROR_TIME = 1.0  # time at which errors are measured
TIME_STEPS = (0.05, 0.025, 0.0125)
# Relative error that counts as rounding: schemes are exact where the jump of a Maxwell layer grows linearly.
ROUNDING_RTOL = 1e-9
SCHEMES = {"Euler": (1.0, 1), "midpoint": (0.5, 2)}  # theta, order
INTERFACE, FULL, CLOSED_FORM = "interface law", "meshed layer", "closed form"


@dataclass(frozen=True)
class ColumnLoad:
    """A load on a column, along S or across S; `LOADS` has one of each.

    Attributes:
        name: "sheared" or "pulled".
        axis: component of the load: 0 along S (shear), 1 across S.
        stress: traction on top in creep tests, applied at t = 0 and then constant.
        top_displacement: displacement of the top in relaxation tests, applied at t = 0 and then constant.
        unit_strain_square: squared norm of the strain sym([u] (x) n), divided by |[u]|^2: 1/2 for shear, 1 across S.
    """

    name: str
    axis: int
    stress: float
    top_displacement: float
    unit_strain_square: float

    def modulus(self, lmbda: float, mu: float) -> float:
        """Return the modulus that resists this load: `mu` under shear, `lmbda` + 2 `mu` across S.

        `lmbda` and `mu` are Lamé's moduli, and the result is stress over strain. If they are viscosities, it is stress
        over strain rate.
        """
        return lmbda + 2 * mu if self.axis else mu


LOADS = (ColumnLoad("sheared", 0, 0.5, 0.05, 0.5), ColumnLoad("pulled", 1, 1.0, 0.02, 1.0))


@dataclass(frozen=True)
class CreepCase:
    """A creep or relaxation test of one layer, with its closed form.

    Attributes:
        law: the layer's law.
        exact: function of the load and of times t > 0 that returns the quantity measured at these times in closed form.
        relaxes: True: the displacement of the top is prescribed, and the traction on S is measured. False: the traction
            on top is prescribed, and the jump is measured.
    """

    law: BulkLaw
    exact: Callable[[ColumnLoad, Array], Array]
    relaxes: bool = False


def kelvin_voigt_jump(load: ColumnLoad, t: Array) -> Array:
    """Closed form of the jump of a Kelvin-Voigt layer under a constant traction.

    `load` is the load, and `t` (n,) are times after its application. The result (n,) is the jump along the load,
    divided by the height of the column.
    """
    K, G = load.modulus(LMBDA, MU), load.modulus(LMBDA * THETA_LMBDA, MU * THETA_MU)
    return load.stress / K * (1 - np.exp(-K / G * t))


def maxwell_jump(load: ColumnLoad, t: Array) -> Array:
    """Closed form of the jump of a Maxwell layer under a constant traction.

    `load` is the load, and `t` (n,) are times after its application. The result (n,) is the jump along the load,
    divided by the height of the column.
    """
    return load.stress / load.modulus(LMBDA, MU) * (1 + t / T1)


def relaxing_traction(load: ColumnLoad, t: Array) -> Array:
    """Closed form of the traction on a Maxwell layer between elastic bodies, under a constant displacement of the top.

    `load` is the load, and `t` (n,) are times after its application. The result (n,) is the traction along the load.
    """
    K = load.modulus(LMBDA, MU)
    stiffness_ratio = 1 + K / load.modulus(BODY.lmbda, BODY.mu)  # the bodies are 1 high together
    return load.top_displacement * K / stiffness_ratio * np.exp(-t / (T1 * stiffness_ratio))


def norton_jump(law: Norton, load: ColumnLoad, t: Array) -> Array:
    """Closed form of the jump of a Norton layer under a constant traction.

    For exponents p > 2 the creep ends at a finite time.

    Args:
        law: the layer's law.
        load: the load.
        t: (n,) times after its application.

    Returns:
        (n,) jumps along the load, divided by the height of the column.
    """
    K, q = load.modulus(LMBDA, MU), 1 / (law.p - 1)
    rate = (law.eta * load.unit_strain_square ** (law.p / 2)) ** -q
    dashpot_stress = np.maximum(load.stress ** (1 - q) - (1 - q) * K * rate * t, 0.0) ** (1 / (1 - q))
    return (load.stress - dashpot_stress) / K


def stack_jump(load: ColumnLoad, t: Array) -> Array:
    """Closed form of the jump under a constant traction of a layer of two sublayers, one Maxwell, one Kelvin-Voigt.

    Each is half as thick as the layer. `load` is the load, and `t` (n,) are times after its application. The result
    (n,) is the jump along the load, divided by the height of the column.
    """
    return (maxwell_jump(load, t) + kelvin_voigt_jump(load, t)) / 2


VOIGT, MAXWELL = KelvinVoigt(LMBDA, MU, THETA_LMBDA, THETA_MU), Maxwell(LMBDA, MU, T1)
NORTON_1_5, NORTON_3 = Norton(LMBDA, MU, eta=5.0, p=1.5), Norton(LMBDA, MU, eta=8000.0, p=3.0)
CASES = {
    "Kelvin-Voigt, creep": CreepCase(VOIGT, kelvin_voigt_jump),
    "Maxwell, creep": CreepCase(MAXWELL, maxwell_jump),
    "Maxwell, relaxation": CreepCase(MAXWELL, relaxing_traction, relaxes=True),
    "Norton p = 1.5, creep": CreepCase(NORTON_1_5, partial(norton_jump, NORTON_1_5)),
    "Norton p = 3, creep": CreepCase(NORTON_3, partial(norton_jump, NORTON_3)),
    "Maxwell + Kelvin-Voigt, creep": CreepCase(Stack((0.5, MAXWELL), (0.5, VOIGT)), stack_jump),
}


def run(record: Record, *, quick: bool = False) -> None:
    """Shear and pull columns by a sudden constant load, and compare both models with closed forms.

    The curves over time are computed by the midpoint rule. Rates of convergence of the time schemes come from errors of
    the interface law at t = 1, for decreasing time steps.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: longer and fewer steps.
    """
    steps = TIME_STEPS[:2] if quick else TIME_STEPS
    times = step_ends(END_TIME, 2 * TIME_STEP if quick else TIME_STEP)
    curves, max_difference = {"t": np.array(times)}, 0.0
    orders = record.new_table("orders.csv")
    for title, load in track([(title, load) for title in CASES for load in LOADS], "columns", "{0[0]}"):
        column = LayeredColumn(record, CASES[title], load)
        responses = {model_name: column.response(model, times) for model_name, model in column.models.items()}
        max_difference = max(max_difference, float(np.abs(responses[FULL] / responses[INTERFACE] - 1).max()))
        responses[CLOSED_FORM] = column.case.exact(load, curves["t"])
        curves |= {f"{title}: {model_name}, {load.name}": values for model_name, values in responses.items()}
        orders.append({"case": title, "load": load.name} | column.error_row(steps))
    record.write("table.csv", Table.of(curves))
    record.check("largest relative difference of both models", max_difference, high=1e-8)
    for scheme, (_, order) in SCHEMES.items():
        observed = orders[f"{scheme} order"]
        record.check(f"lowest observed order, {scheme}", np.nanmin(observed), low=0.9 * order)
        record.check(f"highest observed order, {scheme}", np.nanmax(observed), high=1.1 * order)
    record.check("largest error of the midpoint rule", orders[f"midpoint {steps[-1]:g}"].max(), high=2e-4)
    check_printed_equations(record, curves)


def check_printed_equations(record: Record, curves: dict[str, Array]) -> None:
    """Check how much jumps by Eqs. (19) and (23) as printed in the paper differ from those of the meshed layer.

    Eq. (19), Maxwell's law, has half of the right tangential compliance, and a negative normal compliance. In Eq. (23),
    Norton's law, the norm is that of the jump's rate v, not of its strain rate. In shear this is another viscosity, as
    |v (x)_s n| = |v|/sqrt(2).

    Args:
        record: record of the run, which receives the checks.
        curves: columns of table.csv: "t", and "CASE: MODEL, LOAD" -> values at these times.
    """
    (sheared, pulled), E, nu = LOADS, MU * (3 * LMBDA + 2 * MU) / (LMBDA + MU), LMBDA / (2 * (LMBDA + MU))
    printed_jumps = {("Maxwell, creep", sheared): sheared.stress * (1 + nu) / E * (1 + ERROR_TIME / T1)}
    printed_jumps["Maxwell, creep", pulled] = -pulled.stress * (1 - nu) / (E * nu) * (1 + ERROR_TIME / T1)
    printed_law = replace(NORTON_3, eta=NORTON_3.eta * 2 ** (NORTON_3.p / 2 - 1))
    printed_jumps["Norton p = 3, creep", sheared] = float(norton_jump(printed_law, sheared, np.array(ERROR_TIME)))
    for (title, load), jump in printed_jumps.items():
        meshed = float(np.interp(ERROR_TIME, curves["t"], curves[f"{title}: {FULL}, {load.name}"]))
        expected_ratio = jump / float(CASES[title].exact(load, np.array(ERROR_TIME)))
        record.check_near(f"{title}, {load.name}: jump, printed over computed", jump / meshed, expected_ratio, 0.01)


def step_ends(end: float, dt: float) -> list[float]:
    """Return the ends dt, 2 dt, ..., `end` of equal time steps."""
    return [(k + 1) * dt for k in range(round(end / dt))]


class LayeredColumn:
    """A column of two bodies with a layer between them, under one load.

    Attributes:
        record: record of the run, which keeps the solver's reports.
        case: law of the layer, and whether the test is creep or relaxation.
        column_load: the load.
        models: "interface law" and "meshed layer" -> model.
    """

    def __init__(self, record: Record, case: CreepCase, load: ColumnLoad) -> None:
        self.record, self.case, self.column_load = record, case, load
        joint = sandwich(1.0, 0.5, 0.5, 0.5, cell="quadrilateral", structured=True)
        loaded_axis, fixed_axis = ("xy"[load.axis], "yx"[load.axis])
        supports: dict[str, Support] = {"BOTTOM": 0.0, "LEFT": {fixed_axis: 0.0}, "RIGHT": {fixed_axis: 0.0}}
        supports |= {"TOP": {loaded_axis: load.top_displacement}} if case.relaxes else {}
        tractions = {} if case.relaxes else {"TOP": load.stress * np.eye(2)[load.axis]}
        structure = Structure(joint, body=BODY, supports=supports, tractions=tractions)
        layer = ThinLayer(case.law, EPS, at=1.0)
        self.models: dict[str, Model] = {INTERFACE: structure.interface(layer), FULL: structure.full(layer)}

    def response(self, model: Model, times: Sequence[float], theta: float = 0.5) -> Array:
        """March a model from rest, and return the measured component along the load at the end of each step.

        Args:
            model: the model.
            times: (n,) ends of the time steps.
            theta: fraction of a time step after which forces balance; 1/2 is the midpoint rule, 1 backward Euler.

        Returns:
            (n,) mean jump on S in creep, mean traction on S in relaxation.
        """
        history, surface = self.record.add_report(march(model, times, theta=theta)), Surface(self.models[INTERFACE])
        field = surface.traction if self.case.relaxes else surface.jump
        return np.array([surface.integral(surface.frame(field(history.at(t)))[self.column_load.axis]) for t in times])

    def error_row(self, steps: Sequence[float]) -> dict[str, float | None]:
        """Measure the relative errors of the interface law at t = 1 for decreasing time steps, by both time schemes.

        Args:
            steps: decreasing lengths of the time steps.

        Returns:
            Table row, in which "exact" is the closed form at t = 1. For the schemes "Euler" and "midpoint", "SCHEME DT"
            is the relative error with the step DT, and "SCHEME order" the last rate of convergence. The rate is None if
            the last error is only rounding.
        """
        exact = float(self.case.exact(self.column_load, np.array(ERROR_TIME)))
        row: dict[str, float | None] = {"exact": exact}
        for scheme, (theta, _) in SCHEMES.items():
            end_values = [self.response(self.models[INTERFACE], step_ends(ERROR_TIME, dt), theta)[-1] for dt in steps]
            errors = np.abs(np.divide(end_values, exact) - 1)
            row |= {f"{scheme} {dt:g}": float(error) for dt, error in zip(steps, errors, strict=True)}
            orders = Table.of({"dt": steps, "error": errors}).orders("error", of="dt")
            row[f"{scheme} order"] = orders[-1] if errors[-1] > ROUNDING_RTOL else None
        return row


def draw(record: Record) -> None:
    """Draw jumps (creep) and tractions (relaxation) of both models and of the closed forms over time.

    The curves are read from table.csv in the folder of `record`.
    """
    table, times = record.load("table.csv"), np.append(np.linspace(0.0, END_TIME, 201), np.nan)
    panels: dict[str, dict[str, tuple[Array, Array]]] = {title: {} for title in CASES}
    styles, colours = {CLOSED_FORM: "--"}, {CLOSED_FORM: "black"}
    for title, case in CASES.items():
        for kind, style, sampling in ((INTERFACE, "-", slice(None)), (FULL, "o", slice(1, None, 2))):
            for load, colour in zip(LOADS, COLOURS, strict=False):
                label = f"{kind}, {load.name}"
                styles[label], colours[label] = style, colour
                panels[title][label] = table["t"][sampling], table[f"{title}: {label}"][sampling]
        # both in one line, with a gap
        panels[title][CLOSED_FORM] = np.tile(times, 2), np.concatenate([case.exact(load, times) for load in LOADS])
    units = "jump across S over height", "traction on S over E/100"
    ylabels, save = {title: units[case.relaxes] for title, case in CASES.items()}, record.path(f"{record.study}.svg")
    plotting.curves(panels, "time, as of the laws", ylabels, styles=styles, colours=colours, save=save)
