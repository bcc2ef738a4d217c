"""Fit of parameters to measurements, with intervals that contain the error of the interface law."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, reduce
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from forms.base import Array, InputError, is_finite, require
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.errors import ThinlayerError, warn
from thinlayer.estimating.derivative import LayerOfFactor, chosen_changes
from thinlayer.estimating.estimate import estimate
from thinlayer.estimating.goals import Displacement, Goal, MeanTraction, Reaction
from thinlayer.estimating.parameters import Parameters, require_independent
from thinlayer.estimating.sensitivity import sensitivity_by
from thinlayer.output.plotting.curves import LAW_COLOUR, MESHED_COLOUR, curves
from thinlayer.output.plotting.picture import AxesInput, Picture, finish_picture, make_panels
from thinlayer.solving.history import History, Solution, state_at
from thinlayer.solving.solve import solve
from thinlayer.system.progress import report
from thinlayer.system.table import Table
from thinlayer.system.units import percent

NORMAL_QUANTILE = 1.96  # half-width of an interval of 95 %, over the standard deviation
UNSEEN_DEVIATION = 1.0  # standard deviation of the logarithm of a parameter from which data do not see it
RANK_TOLERANCE = 1e-6  # singular value, over the largest, up to which data do not see a combination of parameters
UNSEEN_POWER = 0.05  # smallest power in an unseen product of a parameter that the data do not see, of a unit vector
COLUMNS = ("quantity", "place", "value", "deviation")
ALL_COLUMNS = (*COLUMNS, "direction", "t")


@dataclass(frozen=True)
class Measurement:
    """A measured value of a goal.

    Attributes:
        goal: what was measured.
        value: the value.
        deviation: its standard deviation, > 0.
        t: time of a march at which it was measured; None: the last.
        source: file and line from which it was read, for messages; "": none.
    """

    goal: Goal
    value: float
    deviation: float
    t: float | None = None
    source: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        require(isinstance(self.goal, Goal), "the goal of a measurement", self.goal, "give one of thinlayer.goals")
        require(is_finite(self.value), f"the measured {self.goal.name}", self.value, "it must be a finite number")
        is_valid = is_finite(self.deviation) and self.deviation > 0
        require(is_valid, f"the standard deviation of {self.goal.name}", self.deviation, "allowed: > 0")

    @contextmanager
    def named_in_errors(self) -> Iterator[None]:
        """Within a `with` block, put the source before the messages of errors."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self.source}: {error}" if self.source else str(error)) from error

    def value_in(self, solution: Solution) -> float:
        """Return the value of the goal in a solution, at the time of the measurement. Collective."""
        with self.named_in_errors():
            return self.goal.value_in(state_at(solution, self.t))


def read_measurements(path: str | Path) -> list[Measurement]:
    """Read measurements from a csv file.

    Its columns are

    - quantity: "displacement", "reaction" or "traction" (the mean traction on a seam); of a scalar field "value",
      "inflow" or "flux";
    - place: the point of a displacement or value, "4 2", with the side if it lies on S, "4 0 upper"; the support of a
      reaction or inflow; the seam of a traction or flux;
    - direction: a vector, "1 0"; of a scalar field empty or left out;
    - value and deviation (its standard deviation);
    - t, the time, which may be left out.

    Columns are separated by commas, or by semicolons or tabs, with which numbers may have decimal commas.

    Args:
        path: name of the file.

    Raises:
        InputError: a missing or unknown column, or an entry that cannot be read; the message has the line.
        OSError: the file cannot be read.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not in UTF-8; save it as csv in UTF-8") from error
    head = next((line for line in lines if line.strip()), "")
    separator = next((mark for mark in ";\t" if mark in head), ",")
    rows, names, measurements = csv.reader(lines, delimiter=separator), list[str](), list[Measurement]()
    for row in rows:
        source = f"{path}, line {rows.line_num}"
        entries = [entry.strip() if separator == "," else entry.strip().replace(",", ".") for entry in row]
        if not names and any(entries):
            names = [entry.lower() for entry in entries]
            wrong = [name for name in names if name not in ALL_COLUMNS or names.count(name) > 1]
            require(not wrong, f"{source}: column", ", ".join(wrong), f"allowed, each once: {', '.join(ALL_COLUMNS)}")
        elif any(entries):
            require(len(entries) <= len(names), f"{source}: the row", row, f"there are {len(names)} columns")
            measurements.append(_measurement_of(dict(zip(names, entries, strict=False)), source))
    if not measurements:
        raise InputError(f"{path}: no measurements")
    return measurements


def _measurement_of(row: Mapping[str, str], source: str) -> Measurement:
    try:
        if lacking := [name for name in COLUMNS if name not in row]:
            raise InputError(f"no {', '.join(lacking)}; there must be columns {', '.join(COLUMNS)}")
        quantity, place = row["quantity"], row["place"]
        direction = [*map(float, row.get("direction", "").split())] or None
        x, _, side = place.rpartition(" ") if place.endswith((" lower", " upper")) else (place, "", None)
        goals: dict[str, Callable[[], Goal]] = {
            "displacement": lambda: Displacement([*map(float, x.split())], direction, side=side),
            "reaction": lambda: Reaction(place, direction),
            "traction": lambda: MeanTraction(direction, seam=place or "S"),
        }
        goals |= {scalar: goals[name] for name, scalar in zip(goals, ("value", "inflow", "flux"), strict=True)}
        require(quantity in goals, "quantity", quantity, f"allowed: {', '.join(goals)}")
        t = float(row["t"]) if row.get("t") else None
        return Measurement(goals[quantity](), float(row["value"]), float(row["deviation"]), t, source)
    except ValueError as error:
        raise InputError(f"{source}: {error}") from error


@dataclass(frozen=True, repr=False)
class Fit:
    """Parameters fitted to measurements, the result of `fit`.

    Attributes:
        model: the fitted interface model, ready to solve.
        factors: name of each of the n parameters -> its fitted value over that of the given model.
        measurements: the m data.
        fitted: (m,) values of the fitted model for the data.
        jacobian: (m, n) derivatives of these values by the logarithms of the parameters.
        law_errors: (m,) changes of these values by meshing the layer, by `estimate`.
        solution: state or history of the fitted model.
        steps: number of models that were solved.
        converged: whether the steps have converged.
    """

    model: InterfaceModel
    factors: Mapping[str, float]
    measurements: Sequence[Measurement]
    fitted: Array
    jacobian: Array
    law_errors: Array
    solution: Solution
    steps: int
    converged: bool

    # ---------------------------------------------------------------- numbers
    @cached_property
    def _split(self) -> tuple[Array, Array, Array]:
        return split_directions(self.jacobian, _deviations(self.measurements))

    def _by_name(self, values: Array) -> dict[str, float]:
        """Return values of the n parameters by name; NaN for those that the data do not see."""
        is_seen = (np.abs(self._split[1]) <= UNSEEN_POWER).all(axis=0)
        return dict(zip(self.factors, np.where(is_seen, values, np.nan).tolist(), strict=True))

    @cached_property
    def values(self) -> dict[str, float]:
        """Name -> fitted value, or factor of a parameter that is no number; NaN: the data do not see it."""
        numbers = Parameters(self.model).values_in_model
        return self._by_name(np.array([numbers.get(name, factor) for name, factor in self.factors.items()]))

    @property
    def covariance(self) -> Array:
        """Covariance (n, n) of the logarithms of the parameters, from that of the data."""
        return self._split[2] * _deviations(self.measurements) ** 2 @ self._split[2].T

    @property
    def deviation(self) -> dict[str, float]:
        """Name -> standard deviation of the logarithm, from that of the data; NaN: the data do not see it."""
        return self._by_name(np.sqrt(np.diag(self.covariance)))

    @property
    def bias(self) -> dict[str, float]:
        """Name -> change of the logarithm, to first order, if the layer were meshed in the fit; NaN as in `deviation`."""
        return self._by_name(-self._split[2] @ self.law_errors)

    @property
    def unseen(self) -> list[dict[str, float]]:
        """Combinations that the data do not see, each {name: exponent}: a product of powers of parameters."""
        rows = [dict(zip(self.factors, v.tolist(), strict=True)) for v in self._split[1]]
        return [{name: power for name, power in row.items() if abs(power) > UNSEEN_POWER} for row in rows]

    @property
    def residuals(self) -> Array:
        """Differences (m,) of the data from the fitted values, over the standard deviations of the data."""
        return (np.array([m.value for m in self.measurements]) - self.fitted) / _deviations(self.measurements)

    @property
    def misfit(self) -> float:
        """Root of the sum of squared residuals, per datum beyond the number of parameters that are seen.

        It is about 1 if model and data agree. NaN: there are no more data than these parameters.
        """
        spare = len(self.fitted) - len(self.factors) + len(self.unseen)
        return float(np.linalg.norm(self.residuals) / np.sqrt(spare)) if spare > 0 else np.nan

    def interval(self, name: str) -> tuple[float, float]:
        """Return the interval of 95 % of a parameter, or of its factor if it is no number, with the error of the law.

        Both ends are NaN if the data do not see the parameter, see `unseen`.

        Raises:
            InputError: no such parameter.
        """
        require(name in self.factors, "interval", name, f"give one of {', '.join(self.factors)}")
        half_width = NORMAL_QUANTILE * self.deviation[name] + abs(self.bias[name])
        low, high = sorted(self.values[name] * np.exp((-half_width, half_width)))
        return float(low), float(high)

    def _rows(self) -> Iterator[tuple[str, float, float, float, float, float]]:
        for name, value in self.values.items():
            yield name, value, *self.interval(name), self.deviation[name], self.bias[name]

    # ---------------------------------------------------------------- texts, tables and pictures
    def __repr__(self) -> str:
        return f"Fit of {', '.join(self.factors)} to {len(self.measurements)} data, misfit {self.misfit:.3g}"

    def __str__(self) -> str:
        lines = []
        for name, value, low, high, _, bias in self._rows():
            factor = "" if name in Parameters(self.model).values_in_model else " times its start"
            text = f"{value:.4g}{factor}, {low:.4g} to {high:.4g} (95 %)"
            text += f"; with a meshed layer it would change by {percent(bias, '+')}"
            text = f"{value:.4g}{factor}, without an interval" if np.isnan(low) else text
            lines.append(f"{name}: the data do not see it" if np.isnan(value) else f"{name} = {text}")
        for powers in self.unseen:
            largest = max(powers.values(), key=abs)
            product = ", ".join(f"{name} by a^{power / largest:.2g}" for name, power in powers.items())
            lines.append(f"the data stay the same if, for any a, one multiplies {product}")
        verdict = (
            "model and data agree"
            if self.misfit < 1.5
            else "the model does not follow the data within their deviations"
        )
        verdict = "too few to compare" if np.isnan(self.misfit) else f"misfit {self.misfit:.3g}, {verdict}"
        end = "" if self.converged else f"; NOT CONVERGED after {self.steps} steps"
        return "\n".join([*lines, f"{len(self.measurements)} data, {verdict}{end}"])

    def table(self) -> Table:
        """Return a table with a row for each parameter: value, interval, standard deviation and bias of its logarithm."""
        columns = ("parameter", "value", "lower", "upper", "deviation", "bias")
        return Table(dict(zip(columns, row, strict=True)) for row in self._rows())

    def plot(self, *, save: str | Path | None = None, ax: AxesInput = None) -> Picture | None:
        """Draw data and model, the residuals, and the correlations of the parameters.

        Args:
            save: name of a file to save the picture to, .png, .svg or .pdf; None: it is not saved.
            ax: three axes of matplotlib to draw in; None: a new picture is made.

        Returns:
            The new picture; None if `ax` is given.
        """
        panels, data = make_panels(ax, (1, 3), 3, (10.0, 3.6)), np.array([m.value for m in self.measurements])
        kinds, deviations = [type(m.goal) for m in self.measurements], _deviations(self.measurements)
        scale = np.array([np.abs(data[[other is kind for other in kinds]]).max() or 1.0 for kind in kinds])
        k, meshed = np.arange(1, len(data) + 1), self.fitted + self.law_errors
        values = {"measured": (k, data / scale), "law": (k, self.fitted / scale), "layer meshed": (k, meshed / scale)}
        differences = {"measured": (k, self.residuals), "layer meshed": (k, self.law_errors / deviations)}
        lines = {"data and model": values, "differences from the law": differences}
        units = dict(zip(lines, ("value over the largest of its kind", "over the standard deviation"), strict=True))
        colours = {"measured": "0.4", "law": LAW_COLOUR, "layer meshed": MESHED_COLOUR}
        panels[0].errorbar(k, data / scale, deviations / scale, fmt="none", color="0.4")
        panels[1].axhspan(-NORMAL_QUANTILE, NORMAL_QUANTILE, color="0.95", zorder=0)
        curves(lines, "number of the measurement", units, styles=("o", "X", "P"), colours=colours, ax=panels[:2])
        names, d = [*self.factors], np.sqrt(np.diag(self.covariance))
        matrix = self.covariance / np.maximum(np.outer(d, d), np.finfo(float).tiny)
        panels[2].imshow(matrix, cmap="RdBu_r", vmin=-2, vmax=2)  # pale, below numbers
        panels[2].set_xticks(range(len(names)), names, rotation=30, ha="right")
        panels[2].set_yticks(range(len(names)), names)
        for (row, column), r in np.ndenumerate(matrix):
            panels[2].text(column, row, f"{r:.2f}", ha="center", va="center")
        panels[2].set_title("correlations", fontsize=11)
        return finish_picture(panels, save)


@report("fit")
def fit(
    model: InterfaceModel,
    measurements: Iterable[Measurement] | str | Path,
    parameters: Sequence[str],
    *,
    of: Mapping[str, LayerOfFactor] | None = None,
    run: Callable[[InterfaceModel], Solution] = solve,
    max_steps: int = 30,
) -> Fit:
    """Fit parameters of an interface model to measurements, by least squares of their logarithms. Collective.

    Steps are those of Gauss and Newton in a trust region, with Jacobians by `sensitivity`. Combinations of parameters
    that the data do not see at the start stay as they are.

    Args:
        model: the model, whose parameters are the start.
        measurements: the data, or name of a csv file with them, see `read_measurements`.
        parameters: names of the parameters, see `derivative`.
        of: parameters without a name, see `derivative`; one function at most.
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
    is_valid = bool(data) and all(isinstance(m, Measurement) for m in data)
    require(is_valid, "fit: measurements", data, "give Measurements")
    of, chosen = of or {}, chosen_changes(model, parameters, of or {})
    for m in data:
        with m.named_in_errors():
            m.goal.check(model)
    is_valid = 0 < len(chosen) == len(parameters) + len(of)
    require(is_valid, "fit: parameters", parameters, "give at least one name, each once, or of={...}")
    require_independent(parameters, of)
    functions = [name for name, layers in of.items() if callable(layers)]
    require(len(functions) < 2, "fit: of", functions, "give one function: its layers replace those of another one")
    names = [*functions, *(name for name in chosen if name not in functions)]  # first layers, then their parameters
    measured, deviations = np.array([m.value for m in data]), _deviations(data)

    def model_at(logs: Iterable[float]) -> InterfaceModel:
        pairs = zip(names, np.exp([*logs]).tolist(), strict=True)
        return reduce(lambda changed, pair: chosen[pair[0]](changed, pair[1]), pairs, model)

    @lru_cache(maxsize=1)
    def solve_at(logs: tuple[float, ...]) -> tuple[InterfaceModel, Solution, Array]:
        solution = run(fitted_model := model_at(logs))
        return fitted_model, solution, np.array([m.value_in(solution) for m in data])

    @lru_cache(maxsize=1)  # of the last step that was accepted
    def linearise_at(logs: tuple[float, ...]) -> tuple[InterfaceModel, Solution, Array, Array]:
        fitted_model, solution, fitted = solve_at(logs)
        # the user's function takes factors from the start
        of_user = {name: lambda _, factor: model_at((logs[0] + np.log(factor), *logs[1:])) for name in functions}
        slopes = sensitivity_by(solution, lambda _: {name: (chosen | of_user)[name] for name in names})
        return fitted_model, solution, fitted, np.array([[*slopes.of(m.goal, m.t).values()] for m in data])

    def residuals(logs: Array) -> Array:
        try:
            return np.asarray((solve_at(tuple(logs))[-1] - measured) / deviations)
        except ThinlayerError:  # a shorter step is tried
            return np.full(len(data), np.inf)

    latest = linearise_at((0.0,) * len(names))[-1]

    def jacobian(logs: Array) -> Array:
        nonlocal latest
        with suppress(InputError):  # a kink of a law there: the one before will do
            latest = linearise_at(tuple(logs))[-1]
        return latest

    seen, _, _ = split_directions(latest, deviations)
    if not seen.shape[1]:
        raise InputError(f"fit: the data do not see any of {', '.join(names)}")
    result = least_squares(
        lambda y: residuals(seen @ y), np.zeros(seen.shape[1]),
        lambda y: jacobian(seen @ y) / deviations[:, None] @ seen,
        max_nfev=max_steps, xtol=1e-5, ftol=1e-6, gtol=1e-10,
    )  # fmt: skip
    if not result.success:
        warn("fit", f"fit: not converged after {max_steps} steps; give max_steps=...", model.comm)
    logs = seen @ result.x
    fitted_model, solution, fitted = solve_at(tuple(logs))
    factors, errors = dict(zip(names, np.exp(logs).tolist(), strict=True)), _law_errors(solution, data)
    try:
        latest = linearise_at(tuple(logs))[-1]
    except InputError as error:
        warn("fit", f"fit: the intervals are those of a step before the last: {error}", model.comm)
    end = solution, int(result.nfev), bool(result.success)
    return Fit(fitted_model, factors, data, fitted, latest, errors, *end)


def split_directions(J: Array, deviations: Array) -> tuple[Array, Array, Array]:
    """Split the logarithms of n parameters into directions that m data see and those that they do not see.

    Args:
        J: (m, n) derivatives of the data by the logarithms.
        deviations: (m,) standard deviations of the data.

    Returns:
        (n, r) orthonormal directions that are seen, in columns; (n - r, n) those that are not, in rows; (n, m)
        derivatives of the logarithms by the data. Unseen directions have a standard deviation above 1, or a singular
        value that is rounding.
    """
    columns, sizes, rows = np.linalg.svd(J / deviations[:, None])
    is_seen = np.pad(sizes, (0, len(rows) - len(sizes))) > max(1 / UNSEEN_DEVIATION, RANK_TOLERANCE * sizes[0])
    k, unseen = np.flatnonzero(is_seen), rows[~is_seen]
    inverse = rows[k].T / sizes[k] @ columns[:, k].T / deviations
    return rows[k].T, unseen * np.sign(unseen.sum(axis=1, keepdims=True)), inverse


def _deviations(data: Sequence[Measurement]) -> Array:
    return np.array([m.deviation for m in data])


def _law_errors(solution: Solution, data: Sequence[Measurement]) -> Array:
    """Return the estimated changes (m,) of m data by meshing the layers."""
    errors = np.zeros(len(data))
    for t in dict.fromkeys(m.t for m in data):
        rows, part = [k for k, m in enumerate(data) if m.t == t], solution
        if t is not None and isinstance(solution, History):
            states = {k: state for k, state in solution.states.items() if state.t <= solution.at(t).t}
            part = replace(solution, table=Table(solution.table.rows[: max(states) + 1]), states=states)
        goals = {data[k].goal.name: data[k].goal for k in rows}
        try:
            result = estimate(part, goals=[*goals.values()])
        except ThinlayerError as error:  # the fit is not lost
            warn("fit", f"fit: no intervals, as the error of the law is not known: {error}", solution.model.comm)
            return np.full(len(data), np.nan)
        errors[rows] = [result.goals[data[k].goal.name].change for k in rows]
    return errors
