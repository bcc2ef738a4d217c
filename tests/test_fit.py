"""Parameters fitted to measurements: intervals with the law's error, what data do not see, csv files, marches."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from forms import LinearElastic, Maxwell
from forms.base import InputError
from geometry import sandwich
from tests.pictures import assert_drawn
from tests.refused import refused
from thinlayer import Measurement, Structure, ThinLayer, fit, goals, march, read_measurements, solve

pytestmark = pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")

EPS, TRUE, START = 0.4, LinearElastic.young(E=2.0, nu=0.38), LinearElastic.young(E=2.7, nu=0.35)
JOINT = sandwich(4.0, 1.0, 1.5, 0.75, h_S=0.5)
PLACES = [goals.Displacement((x, 1.5), direction) for x in (0.4, 2.0, 3.6) for direction in ((1, 0), (0, 1))]


def structure(way=lambda t: 1.0):
    load = {"TOP": lambda x, t: (way(t) * (x[0] - 1.0), 0.5 * way(t))}
    return Structure(JOINT, body=LinearElastic.young(E=200.0, nu=0.3), supports={"BOTTOM": 0}, tractions=load)


@cache
def measured():
    """Displacements of the meshed layer, with a noise of 1 % of the largest."""
    model, full = structure().interface(ThinLayer(TRUE, EPS)), solve(structure().full(ThinLayer(TRUE, EPS)))
    values = np.array([goal.value(full, model) for goal in PLACES])
    deviation = 0.01 * np.abs(values).max()
    noise = deviation * np.random.default_rng(1).standard_normal(len(values))
    return [Measurement(goal, value, deviation) for goal, value in zip(PLACES, values + noise, strict=True)]


@cache
def fitted(order):
    return fit(structure().interface(ThinLayer(START, EPS, order=order)), measured(), ["S.mu", "S.lmbda"])


@pytest.mark.parametrize("order", [0, 1])
def test_intervals_contain_the_truth(order):
    """At order 0 only with the error of the law."""
    result, truth = fitted(order), {"S.mu": TRUE.mu, "S.lmbda": TRUE.lmbda}
    for name, value in truth.items():
        low, high = result.interval(name)
        assert low < value < high
        without_bias = abs(np.log(value / result.values[name])) < 1.96 * result.deviation[name]
        assert without_bias == (order == 1), name
    assert 0.4 < result.misfit < 1.5
    assert result.values["S.mu"] == pytest.approx(TRUE.mu, rel=0.02 if order else 0.15)
    meshed = solve(
        structure().full(ThinLayer(START.with_parameters({k[2:]: v for k, v in result.values.items()}), EPS))
    )
    changes = [goal.value(meshed, result.solution.model) for goal in PLACES] - result.fitted
    assert np.linalg.norm(result.law_errors - changes) < 0.5 * np.linalg.norm(changes)


def test_what_is_said_and_drawn(tmp_path):
    result = fitted(1)
    assert "model and data agree" in str(result)
    assert str(result).startswith(f"S.mu = {result.values['S.mu']:.4g}, ")
    assert result.table()["lower"].tolist() == [result.interval(name)[0] for name in result.factors]
    assert result.covariance[0, 1] != 0
    result.plot(save=tmp_path / "fit.png")
    assert_drawn(tmp_path / "fit.png")


def test_what_data_do_not_see():
    """At order 0 they are changed by moduli over the thickness alone."""
    model = structure().interface(ThinLayer(START, EPS))
    result = fit(model, measured(), ["S.mu", "S.lmbda", "S.eps"])
    (powers,) = result.unseen
    assert np.abs([*powers.values()]) == pytest.approx([3**-0.5] * 3, rel=1e-4)
    assert np.isnan([*result.values.values()]).all()
    assert "S.eps: the data do not see it" in str(result)
    refused(InputError, "do not see 'S.mu', only products: S.mu", result.interval, "S.mu")
    rough = [Measurement(goals.Reaction("BOTTOM", (1, 0)), -4.0, 1e3)]
    refused(InputError, "do not see any of load TOP", fit, model, rough, ["load TOP"])


def test_a_parameter_without_a_name():
    model, data = structure().interface(ThinLayer(START, EPS)), measured()[:2]
    stiffer = {"stiffness": lambda f: ThinLayer(LinearElastic.young(E=2.7 * f, nu=0.35), EPS)}
    named, unnamed = fit(model, data, ["S.E"]), fit(model, data, [], of=stiffer)
    assert unnamed.factors["stiffness"] == pytest.approx(named.factors["S.E"], rel=1e-6)
    assert unnamed.interval("stiffness") == pytest.approx(np.array(named.interval("S.E")) / 2.7, rel=1e-5)
    assert np.isnan(unnamed.values["stiffness"])


# ---------------------------------------------------------------- marches
def test_a_march_is_fitted_to_data_at_several_times():
    run, top = lambda model: march(model, [0.2, 0.5, 1.0]), goals.Displacement((2.0, 1.5), (0.3, 1))
    of = lambda law: structure(lambda t: t).interface(ThinLayer(law, EPS))
    history = run(of(Maxwell(3.0, 2.0, 0.6, 0.9)))
    data = [Measurement(top, top.value(history.at(t), history.model), 1e-4, t) for t in (0.2, 0.5, 1.0)]
    result = fit(of(Maxwell(3.0, 2.3, 0.5, 0.9)), data, ["S.mu", "S.t1"], run=run)
    assert result.values == pytest.approx({"S.mu": 2.0, "S.t1": 0.6}, rel=1e-4)
    assert result.misfit < 1e-3
    assert np.abs(np.diff(result.law_errors)).min() > 0


# ---------------------------------------------------------------- files
HEAD = "quantity,place,direction,value,deviation,t\n"
GOOD = """displacement,4 2,1 0,0.01,0.001,
displacement,1 0 upper,0 1,-0.02,0.002,0.5
reaction,BOTTOM,0 1,3,0.1,
traction,,1 0,0.7,0.05,1
"""


def test_measurements_of_a_file(tmp_path):
    path = tmp_path / "data.csv"
    path.write_text("\ufeff" + HEAD + GOOD, encoding="utf-8")
    assert read_measurements(path) == [
        Measurement(goals.Displacement([4.0, 2.0], [1.0, 0.0]), 0.01, 0.001),
        Measurement(goals.Displacement([1.0, 0.0], [0.0, 1.0], side="upper"), -0.02, 0.002, 0.5),
        Measurement(goals.Reaction("BOTTOM", [0.0, 1.0]), 3.0, 0.1),
        Measurement(goals.MeanTraction([1.0, 0.0]), 0.7, 0.05, 1.0),
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("quantity,value\n", "no column place, direction, deviation; it has quantity, value"),
        ("", "no column .*; it has none"),
        (HEAD + "force,BOTTOM,0 1,3,0.1,\n", "line 2: quantity is 'force'; allowed: displacement, reaction, traction"),
        (HEAD + GOOD + "reaction,BOTTOM,0 1,three,0.1,\n", "line 6: could not convert string to float: 'three'"),
        (HEAD + "reaction,BOTTOM,0 1,3,0,\n", "line 2: the standard deviation of reaction BOTTOM .* is 0.0"),
        (HEAD + "reaction,BOTTOM,0 1,3\n", "line 2: no deviation"),
        (HEAD + "reaction\n", "line 2: no place, direction, value, deviation"),
        (HEAD + "displacement,4 2 middle,0 1,3,0.1,\n", "line 2: could not convert"),
        (HEAD, "no measurements"),
    ],
)
def test_files_that_are_refused(text, message, tmp_path):
    path = tmp_path / "data.csv"
    path.write_text(text)
    refused(InputError, message, read_measurements, path)


def test_what_cannot_be_fitted():
    model, goal = structure().interface(ThinLayer(START, EPS)), goals.Reaction("BOTTOM", (0, 1))
    for call, message in [
        (lambda: fit(model, [], ["S.mu"]), "measurements is"),
        (lambda: fit(model, [3.0], ["S.mu"]), "give Measurements"),
        (lambda: fit(model, [Measurement(goal, 1.0, 0.1)], []), "at least one name"),
        (lambda: fit(model, [Measurement(goal, 1.0, 0.1)], ["S.my"]), "did you mean 'S.mu'"),
        (lambda: fit(model, [Measurement(goal, 1.0, 0.1)], ["S.mu", "S.mu"]), "each name once"),
        (lambda: fit(model, [Measurement(goal, 1.0, 0.1, t=0.5)], ["S.mu"]), "solved without steps; give run="),
        (lambda: Measurement(3, 1.0, 0.1), "the goal of a measurement is 3"),
        (lambda: Measurement(goal, float("nan"), 0.1), "must be a finite number"),
    ]:
        refused(InputError, message, call)
