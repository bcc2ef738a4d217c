"""Moduli of a glue from a shear test of thick plates: intervals with and without the error of the interface law.

Data are made with a meshed layer and noise. Interface laws of order 0 and 1 are fitted to them. An interval of 95 %
must contain the true modulus in 95 % of repeated tests. The first test is fitted by `fit`. Each other one takes a single
step of Gauss's and Newton's method from there, with the Jacobian of the first fit. So logarithms of moduli are linear
in the data, and a test costs a product with a matrix. The test that is farthest from the first one is also fitted by
`fit`, which shows the error of the step.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from forms import LinearElastic
from forms.base import Array
from geometry import sandwich
from studies.dropped import ignore_range_warnings
from studies.problems import ALUMINIUM
from thinlayer import Fit, Measurement, Structure, Table, ThinLayer, fit, goals, plotting, solve
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import Place, Support
from thinlayer.estimating.fit import NORMAL_QUANTILE
from thinlayer.running.record import Record
from thinlayer.system.progress import track

LENGTH, HEIGHT, EPS = 10.0, 6.0, 0.5  # mm: of both plates; of each plate; thickness of the glue
GLUE, START = LinearElastic.young(E=2e3, nu=0.42), LinearElastic.young(E=3e3, nu=0.35)  # MPa: true; first guess
TRUE = {"S.mu": GLUE.mu, "S.lmbda": GLUE.lmbda}
SHIFT, TURN = 0.02, 0.002  # of the upper grip: mm along the glue; slope to which it turns about 0.3 of the length
GAUGES = [(x * LENGTH, y * HEIGHT) for x in (0.0, 0.25, 0.5, 0.75, 1.0) for y in (-0.5, 0.5)]  # mm
AXES = ((1.0, 0.0), (0.0, 1.0))
KINDS = [[goals.Displacement(x, e) for x in GAUGES for e in AXES], [goals.Reaction("TOP", e) for e in AXES]]  # of data
NOISE = 0.01  # standard deviation of data, over the largest of their kind
TESTS, MIN_HOLDING = 1000, 930  # tests; those in which an interval of 95 % holds: 950 less three standard deviations
DRAWN_TESTS = 200


def run(record: Record, *, quick: bool = False) -> None:
    """Fit both moduli of a glue to displacements and forces of 1,000 tests, by the laws of order 0 and 1.

    table.csv has for each order and modulus: the true value; the fitted one of the first test with the standard
    deviation and the bias of its logarithm; and the number of tests in which the interval holds, with the bias and
    without it. tests.csv has the moduli of all tests, over the true ones.

    Args:
        record: record of the run, with its folder, tables and checks.
        quick: a coarser mesh.
    """
    h_S, h_ends = (0.5, 0.12) if quick else (0.25, 0.06)
    joint = sandwich(LENGTH, HEIGHT, HEIGHT, 2.0, h_S=h_S, h_ends=h_ends, cell="quadrilateral")
    grips: dict[Place, Support] = {"BOTTOM": 0.0, "TOP": {"x": SHIFT, "y": lambda x, t: TURN * (x[0] - 0.3 * LENGTH)}}
    plates = Structure(joint, body=ALUMINIUM, supports=grips)
    meshed, table, tests = solve(plates.full(ThinLayer(GLUE, EPS))), record.new_table("table.csv"), list[Table]()
    for order in track([0, 1], "lap_shear_fit", "order {}"):
        with ignore_range_warnings():
            first, errors, distance = repeat(meshed, plates.interface(ThinLayer(START, EPS, order=order)))
        tests.append(Table.of({"order": order} | {name: np.exp(error) for name, error in errors.items()}))
        for name, true in TRUE.items():
            bias, half_width = first.bias[name], NORMAL_QUANTILE * first.deviation[name]
            row = {"true": true, "fitted": first.values[name], "deviation": first.deviation[name], "bias": bias}
            holding = {"with": abs(errors[name]) <= half_width + abs(bias), "without": abs(errors[name]) <= half_width}
            row |= {key: float(np.sum(is_in)) for key, is_in in holding.items()}
            table.append({"order": order, "modulus": name} | row)
        record.check(f"order {order}: error of the linear step, over the standard deviation", distance, high=0.3)
        what, holding_tests = "fewest tests in which an interval with the law's error holds", table["with"][-2:]
        record.check(f"order {order}: {what}", holding_tests.min(), low=MIN_HOLDING)
    fewest = [table["without"][k : k + 2].min() for k in (0, 2)]
    record.check("order 0: fewest tests in which an interval without the law's error holds", fewest[0], high=500)
    record.check("order 1: the same", fewest[1], low=MIN_HOLDING)
    record.write("tests.csv", Table([row for part in tests for row in part]))


def repeat(meshed: State, model: InterfaceModel) -> tuple[Fit, Mapping[str, Array], float]:
    """Fit the moduli to many tests, whose data are those of a state and noise.

    Args:
        meshed: the state with a meshed layer.
        model: the model that is fitted, with the first guess.

    Returns:
        The fit of the first test; name of a modulus -> errors of the logarithm in all tests; error of the linear step
        in the test that is farthest from the first, over the standard deviation.
    """
    measured, exact, deviations = [goal for kind in KINDS for goal in kind], list[float](), list[float]()
    for kind in KINDS:
        values = [goal.value(meshed, model) for goal in kind]
        exact += values
        deviations += [NOISE * max(map(abs, values))] * len(kind)
    data = exact + np.array(deviations) * np.random.default_rng(3).standard_normal((TESTS, len(exact)))

    def fit_test(model: InterfaceModel, values: Array) -> Fit:
        return fit(model, map(Measurement, measured, values, deviations), [*TRUE])

    first = fit_test(model, data[0])
    steps = (data - first.fitted) / deviations @ np.linalg.pinv(first.jacobian / np.array(deviations)[:, None]).T
    logs = np.log([*first.values.values()]) + steps
    sizes = np.array([*first.deviation.values()])
    k = int(np.argmax(np.abs(steps / sizes).max(axis=1)))
    again = np.log([*fit_test(first.model, data[k]).values.values()])
    errors = dict(zip(TRUE, (logs - np.log([*TRUE.values()])).T, strict=True))
    return first, errors, float(np.max(np.abs(again - logs[k]) / sizes))


def draw(record: Record) -> None:
    """Draw the fitted moduli of some tests, over the true ones, from tests.csv in the folder of `record`."""
    panels = {}
    for order, tests in record.load("tests.csv").split("order").items():
        points = {"fitted": (tests["S.mu"][:DRAWN_TESTS], tests["S.lmbda"][:DRAWN_TESTS]), "true": ([1.0], [1.0])}
        panels[f"law of order {order:g}"] = points
    options = {"xlim": (0.9, 1.1), "ylim": (0.7, 1.3), "styles": (".", "X"), "save": record.path("moduli.svg")}
    title = "moduli from shear tests of glued plates with 1 % of noise"
    plotting.curves(panels, "mu over the true one", "lambda over the true one", title=title, **options)
