"""Fit of parameters to measurements, with intervals that contain the error of the interface law."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from forms.base import Array, InputError, is_finite, require
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.errors import ThinlayerError, warn
from thinlayer.estimating.derivative import LayerOfFactor, chosen_changes
from thinlayer.estimating.estimate import estimate
from thinlayer.estimating.goals import Displacement, Goal, MeanTraction, Reaction
from thinlayer.estimating.parameters import Change, Parameters
from thinlayer.estimating.sensitivity import Sensitivity, sensitivity_by
from thinlayer.output.plotting.curves import LAW_COLOUR, MESHED_COLOUR
from thinlayer.output.plotting.picture import GivenAxes, Picture, finish_picture, make_panels
from thinlayer.solving.history import History
from thinlayer.solving.solve import solve
from thinlayer.system.progress import report
from thinlayer.system.table import Table

NORMAL_QUANTILE = 1.96  # half-width of an interval of 95 %, over the standard deviation
UNSEEN_DEVIATION = 1.0  # standard deviation of the logarithm of a parameter from which data do not see it
RANK_TOLERANCE = 1e-6  # singular value, over the largest, up to which data do not see a combination of parameters
UNSEEN_POWER = 0.05  # smallest power in an unseen product of a parameter that the data do not see, of a unit vector
COLUMNS = ("quantity", "place", "direction", "value", "deviation")
QUANTITIES = ("displacement", "reaction", "traction")
Run = Callable[[InterfaceModel], State | History]


@dataclass(frozen=True)
class Measurement:
    """A measured value of a goal.

    Attributes:
        goal: what was measured.
        value: the value.
        deviation: its standard deviation, > 0.
        t: time of a march at which it was measured; None: the last.
    """

    goal: Goal
    value: float
    deviation: float
    t: float | None = None

    def __post_init__(self) -> None:
        require(isinstance(self.goal, Goal), "the goal of a measurement", self.goal, "give one of thinlayer.goals")
        require(is_finite(self.value), f"the measured {self.goal.name}", self.value, "it must be a finite number")
        is_valid = is_finite(self.deviation) and self.deviation > 0
        require(is_valid, f"the standard deviation of {self.goal.name}", self.deviation, "allowed: > 0")


def read_measurements(path: str | Path) -> list[Measurement]:
    """Read measurements from a csv file.

    Its columns are

    - quantity: "displacement", "reaction" or "traction" (the mean traction on a seam);
    - place: the point of a displacement, "4 2", with the side if it lies on S, "4 0 upper"; the support of a reaction;
      the seam of a traction;
    - direction: a vector, "1 0";
    - value and deviation (its standard deviation);
    - t, the time, which may be left out.

    Args:
        path: name of the file.

    Raises:
        InputError: a missing column, or an entry that cannot be read; the message has the line.
        OSError: the file cannot be read.
    """
    with Path(path).open(encoding="utf-8-sig", newline="") as file:
        rows = csv.DictReader(file)
        if lacking := [name for name in COLUMNS if name not in (rows.fieldnames or ())]:
            columns = ", ".join(rows.fieldnames or ()) or "none"
            raise InputError(f"{path}: no column {', '.join(lacking)}; it has {columns}")
        measurements = []
        for row in rows:
            try:
                if empty := [name for name in COLUMNS if row[name] is None]:
                    raise InputError(f"no {', '.join(empty)}")
                t = float(row["t"]) if row.get("t") else None
                measurements.append(Measurement(_goal_of(row), float(row["value"]), float(row["deviation"]), t))
            except ValueError as error:
                raise InputError(f"{path}, line {rows.line_num}: {error}") from error
    if not measurements:
        raise InputError(f"{path}: no measurements")
    return measurements


def _goal_of(row: Mapping[str, str]) -> Goal:
    quantity, place = row["quantity"].strip(), row["place"].strip()
    direction = [float(c) for c in row["direction"].split()]
    if quantity == "displacement":
        words = place.split()
        side = words.pop() if words and words[-1] in ("lower", "upper") else None
        return Displacement([float(c) for c in words], direction, side=side)
    require(quantity in QUANTITIES, "quantity", quantity, f"allowed: {', '.join(QUANTITIES)}")
    return Reaction(place, direction) if quantity == "reaction" else MeanTraction(direction, seam=place or "S")


@dataclass(frozen=True, repr=False)
class Fit:
    """Parameters fitted to measurements, the result of `fit`.

    Attributes:
        factors: name of a parameter -> its fitted value over that of the model.
        start: name -> value in the model; NaN: it has no single number.
        deviation: name -> standard deviation of its logarithm, from that of the data.
        bias: name -> change of its logarithm if the layer were meshed in the fit, to first order by `estimate`.
        covariance: (n, n) covariance of the logarithms of the n parameters, from that of the data.
        unseen: combinations that the data do not see, each {name: exponent}: a product of powers of parameters.
        misfit: root of the sum of squared residuals, over their standard deviations, per datum beyond the number of
            parameters that are seen; about 1 if model and data agree. NaN: there are no more data than these.
        measurements: the data.
        fitted: (m,) values of the model for the m data.
        law_errors: (m,) their estimated changes by meshing the layer.
        solution: state or history of the fitted model.
        steps: number of steps of the least-squares method.
    """

    factors: Mapping[str, float]
    start: Mapping[str, float]
    deviation: Mapping[str, float]
    bias: Mapping[str, float]
    covariance: Array
    unseen: Sequence[Mapping[str, float]]
    misfit: float
    measurements: Sequence[Measurement]
    fitted: Array
    law_errors: Array
    solution: State | History
    steps: int

    def is_seen(self, name: str) -> bool:
        """Return whether the data determine a parameter."""
        return not any(name in powers for powers in self.unseen)

    @property
    def values(self) -> dict[str, float]:
        """Name of a parameter -> its fitted value; NaN if the data do not see it, or it has no single number."""
        return {name: f * self.start[name] if self.is_seen(name) else np.nan for name, f in self.factors.items()}

    def interval(self, name: str) -> tuple[float, float]:
        """Return the interval of 95 % of a parameter, or of its factor if it is no number, with the error of the law.

        Raises:
            InputError: no such parameter, or the data do not see it.
        """
        require(name in self.factors, "interval", name, f"give one of {', '.join(self.factors)}")
        if not self.is_seen(name):
            raise InputError(f"interval: the data do not see {name!r}, only products: {self._unseen_text()}")
        half_width = NORMAL_QUANTILE * self.deviation[name] + abs(self.bias[name])
        start = self.start[name] if np.isfinite(self.start[name]) else 1.0
        low, high = sorted(start * self.factors[name] * np.exp((-half_width, half_width)))
        return float(low), float(high)

    def _unseen_text(self) -> str:
        return "; ".join(" ".join(f"{name}^{power:.2g}" for name, power in powers.items()) for powers in self.unseen)

    def __repr__(self) -> str:
        return f"Fit of {', '.join(self.factors)} to {len(self.measurements)} data, misfit {self.misfit:.3g}"

    def __str__(self) -> str:
        lines = []
        for name in self.factors:
            if self.is_seen(name):
                value, (low, high) = self.values[name], self.interval(name)
                value = value if np.isfinite(value) else self.factors[name]
                shift = f"; with a meshed layer it would change by {100 * self.bias[name]:+.2g} %"
                lines.append(f"{name} = {value:.4g}, {low:.4g} to {high:.4g} (95 %){shift}")
            else:
                lines.append(f"{name}: the data do not see it")
        if self.unseen:
            lines.append(f"the data do not change with the products {self._unseen_text()}")
        verdict = "model and data agree" if self.misfit < 1.5 else "the model cannot follow the data"
        verdict = "too few to compare" if np.isnan(self.misfit) else f"misfit {self.misfit:.3g}, {verdict}"
        lines.append(f"{len(self.measurements)} data, {verdict}")
        return "\n".join(lines)

    def table(self) -> Table:
        """Return a table with a row for each parameter: value, interval, standard deviation and bias of its logarithm."""
        rows = []
        for name, value in self.values.items():
            row = {"parameter": name, "value": value} | dict.fromkeys(("lower", "upper", "deviation", "bias"), np.nan)
            if self.is_seen(name):
                low, high = self.interval(name)
                row |= {"lower": low, "upper": high, "deviation": self.deviation[name], "bias": self.bias[name]}
            rows.append(row)
        return Table(rows)

    def plot(self, *, save: str | Path | None = None, ax: GivenAxes = None) -> Picture | None:
        """Draw data and model, the residuals, and the correlations of the parameters.

        Args:
            save: name of a file to save the picture to, .png, .svg or .pdf; None: it is not saved.
            ax: three axes of matplotlib to draw in; None: a new picture is made.

        Returns:
            The new picture; None if `ax` is given.
        """
        data, residual, correlation = panels = make_panels(ax, (1, 3), 3, (11.0, 3.6))
        numbers, deviations = np.arange(1, len(self.measurements) + 1), self._deviations
        scale = np.abs([m.value for m in self.measurements]).max() or 1.0
        measured = np.array([m.value for m in self.measurements])
        data.errorbar(
            numbers, measured / scale, deviations / scale, fmt="o", mfc="none", ms=4, color="0.4", label="data"
        )
        data.plot(numbers, self.fitted / scale, "x", ms=5, color=LAW_COLOUR, label="law")
        data.plot(
            numbers, (self.fitted + self.law_errors) / scale, "+", ms=6, color=MESHED_COLOUR, label="layer meshed"
        )
        data.set(xlabel="number of the measurement", ylabel="value over the largest")
        data.legend(frameon=False)
        residual.axhspan(-NORMAL_QUANTILE, NORMAL_QUANTILE, color="0.93")
        residual.plot(numbers, (measured - self.fitted) / deviations, "o", mfc="none", ms=4, color=LAW_COLOUR)
        residual.set(xlabel="number of the measurement", ylabel="residual over standard deviation")
        names, d = [*self.factors], np.sqrt(np.diag(self.covariance))
        matrix = self.covariance / np.where(np.outer(d, d) > 0, np.outer(d, d), 1.0)
        correlation.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
        correlation.set_xticks(range(len(names)), names, rotation=30, ha="right")
        correlation.set_yticks(range(len(names)), names)
        for (row, column), number in np.ndenumerate(matrix):
            white = abs(number) > 0.6
            correlation.text(
                column, row, f"{number:.2f}", ha="center", va="center", color="white" if white else "black"
            )
        correlation.set_title("correlation", fontsize=10)
        return finish_picture(panels, save)

    @property
    def _deviations(self) -> Array:
        return np.array([m.deviation for m in self.measurements])


@report("fit")
def fit(
    model: InterfaceModel,
    measurements: Iterable[Measurement] | str | Path,
    parameters: Sequence[str],
    *,
    of: Mapping[str, LayerOfFactor] | None = None,
    run: Run = solve,
    max_steps: int = 30,
) -> Fit:
    """Fit parameters of an interface model to measurements, by least squares of their logarithms. Collective.

    Steps are those of Gauss and Newton in a trust region, with Jacobians by `sensitivity`. Combinations of parameters
    that the data do not see at the start stay as they are.

    Args:
        model: the model, whose parameters are the start.
        measurements: the data, or name of a csv file with them, see `read_measurements`.
        parameters: names of the parameters, see `derivative`.
        of: parameters without a name, see `derivative`.
        run: function that solves a model: `solve`, or, for laws with memory and data at several times, one such as
            `lambda model: march(model, [0.1, 0.2])`.
        max_steps: largest number of steps.

    Raises:
        InputError: no data, no such parameter, or a model that `derivative` refuses.
        SolveError: the model cannot be solved at the start.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Measurement, Structure, ThinLayer, fit, goals
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=3e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> slip = goals.Displacement((4, 2), (1, 0))
        >>> data = [Measurement(slip, 5.2e-4, deviation=5e-6)]
        >>> model = plates.interface(ThinLayer(glue, eps=0.05, order=1))
        >>> result = fit(model, data, ["S.E"])
        >>> print(result)
        S.E = 2678, 2559 to 2802 (95 %); with a meshed layer it would change by -0.44 %
        1 data, too few to compare
    """
    data = read_measurements(measurements) if isinstance(measurements, (str, Path)) else list(measurements)
    require(
        bool(data) and all(isinstance(m, Measurement) for m in data), "fit: measurements", data, "give Measurements"
    )
    for m in data:
        m.goal.check(model)
    changes = chosen_changes(model, parameters, of or {})
    require(bool(changes), "fit: parameters", parameters, "give at least one name, or of={...}")
    require(len(changes) == len(parameters) + len(of or {}), "fit: parameters", parameters, "each name once")
    numbers = Parameters(model).values_in_model
    start = {name: numbers.get(name, np.nan) for name in changes}
    problem = _LeastSquares(model, data, changes, run)
    problem.at(np.zeros(len(changes)))
    seen, _ = split_directions(problem.jacobian)
    if not seen.shape[1]:
        raise InputError(f"fit: the data do not see any of {', '.join(changes)}")
    result = least_squares(
        lambda y: problem.at(seen @ y), np.zeros(seen.shape[1]), lambda y: problem.jacobian_at(seen @ y) @ seen,
        max_nfev=max_steps, x_scale="jac", xtol=1e-5, ftol=1e-6, gtol=1e-10,
    )  # fmt: skip
    logs = seen @ result.x
    residuals, J = problem.at(logs), problem.jacobian_at(logs)
    if not result.success:
        warn("fit", f"fit: not converged after {max_steps} steps; give max_steps=...", model.comm)
    seen, unseen = split_directions(J)
    inverse = seen @ np.linalg.pinv(J @ seen)
    covariance = inverse @ inverse.T
    law_errors = problem.law_errors()
    bias = inverse @ (-law_errors / problem.deviations)
    names = [*changes]

    def by_name(values: Array) -> dict[str, float]:
        return dict(zip(names, map(float, values), strict=True))

    products = [
        {name: float(power) for name, power in zip(names, v, strict=True) if abs(power) > UNSEEN_POWER}
        for v in unseen.T * np.sign(unseen.sum(axis=0))[:, None]
    ]
    spare = len(data) - seen.shape[1]
    misfit = float(np.sqrt(residuals @ residuals / spare)) if spare > 0 else np.nan
    fitted = np.array([m.value for m in data]) + residuals * problem.deviations
    return Fit(
        by_name(np.exp(logs)), start, by_name(np.sqrt(np.diag(covariance))), by_name(bias), covariance, products,
        misfit, data, fitted, law_errors, problem.solution, int(result.nfev),
    )  # fmt: skip


def split_directions(J: Array) -> tuple[Array, Array]:
    """Split the logarithms of parameters into directions that data see and those that they do not see.

    Args:
        J: (m, n) derivatives of the m data, over their standard deviations, by the n logarithms.

    Returns:
        (n, r) and (n, n - r) orthonormal directions. Unseen ones have a standard deviation above 1, or a singular value
        that is rounding.
    """
    _, sizes, rows = np.linalg.svd(J)
    sizes = np.pad(sizes, (0, len(rows) - len(sizes)))
    is_seen = sizes > max(1 / UNSEEN_DEVIATION, RANK_TOLERANCE * sizes[0])
    return rows[is_seen].T, rows[~is_seen].T


def _interface_model(state: State) -> InterfaceModel:
    assert isinstance(state.model, InterfaceModel)
    return state.model


class _LeastSquares:
    """Residuals of data over their standard deviations, and their Jacobian, for logarithms of factors of parameters.

    Attributes:
        deviations: (m,) standard deviations.
        solution: the last solution.
    """

    solution: State | History

    def __init__(
        self, model: InterfaceModel, data: Sequence[Measurement], changes: Mapping[str, Change], run: Run
    ) -> None:
        self._model, self._data, self._changes, self._run = model, data, changes, run
        self.deviations = np.array([m.deviation for m in data])
        self._logs: Array | None = None
        self._sensitivity: Sensitivity | None = None
        self._is_first = True

    def at(self, logs: Array) -> Array:
        """Return the residuals (m,); infinity if the model cannot be solved."""
        if self._logs is None or not np.array_equal(logs, self._logs):
            try:
                self.solution = self._run(self._model_at(logs))
            except ThinlayerError:
                if self._is_first:
                    raise
                return np.full(len(self._data), np.inf)
            self._logs, self._sensitivity = logs.copy(), None
            self._is_first = False
        pairs = zip(self._data, self._states(), strict=True)
        differences = np.array([m.goal.value(state, _interface_model(state)) - m.value for m, state in pairs])
        return np.asarray(differences / self.deviations)

    def _model_at(self, logs: Array) -> InterfaceModel:
        model = self._model
        for change, factor in zip(self._changes.values(), np.exp(logs), strict=True):
            model = change(model, float(factor))
        return model

    def _states(self) -> list[State]:
        if isinstance(self.solution, State):
            if times := [m.t for m in self._data if m.t not in (None, self.solution.t)]:
                raise InputError(
                    f"fit: a measurement at t = {times[0]:g}, but the model is solved without steps; give run="
                )
            return [self.solution] * len(self._data)
        return [self.solution.last if m.t is None else self.solution.at(m.t) for m in self._data]

    @property
    def jacobian(self) -> Array:
        """Derivatives (m, n) of the residuals at the last logarithms."""
        if self._sensitivity is None:
            changes = {name: self._change(k) for k, name in enumerate(self._changes)}
            self._sensitivity = sensitivity_by(self.solution, lambda _: changes)
        rows = [[*self._sensitivity.of(m.goal, m.t).values()] for m in self._data]
        return np.asarray(np.array(rows) / self.deviations[:, None])

    def _change(self, k: int) -> Change:
        """Return the change of parameter k from its last value; `of` gives layers for factors from the start."""
        logs, unit = self._logs, np.eye(len(self._changes))[k]
        return lambda _, factor: self._model_at(logs + np.log(factor) * unit)

    def jacobian_at(self, logs: Array) -> Array:
        """Derivatives (m, n) of the residuals at some logarithms."""
        self.at(logs)
        return self.jacobian

    def law_errors(self) -> Array:
        """Return the estimated changes (m,) of the data by meshing the layers."""
        changes = np.zeros(len(self._data))
        for t in dict.fromkeys(m.t for m in self._data):
            chosen = [k for k, m in enumerate(self._data) if m.t == t]
            unique = {m.goal.name: m.goal for k, m in enumerate(self._data) if k in chosen}
            result = estimate(self._part_until(t), goals=[*unique.values()])
            changes[chosen] = [result.goals[self._data[k].goal.name].change for k in chosen]
        return changes

    def _part_until(self, t: float | None) -> State | History:
        if t is None or isinstance(self.solution, State):
            return self.solution
        rows = [k for k, state in self.solution.states.items() if state.t <= t * (1 + 1e-9)]
        history = self.solution
        table = Table(history.table.rows[: max(rows) + 1])
        return History(history.model, table, {k: history.states[k] for k in rows}, history.theta)
