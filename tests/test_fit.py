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
from thinlayer import Measurement, Structure, ThinLayer, derivative, fit, goals, march, read_measurements, solve
from thinlayer.errors import RangeWarning

pytestmark = pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")

EPS, TRUE, START = 0.4, LinearElastic.young(E=2.0, nu=0.38), LinearElastic.young(E=2.7, nu=0.35)
JOINT = sandwich(4.0, 1.0, 1.5, 1.0, h_S=0.5)
PLACES = [goals.Displacement((x, 1.5), direction) for x in (0.4, 2.0, 3.6) for direction in ((1, 0), (0, 1))]
MODULI = ["S.mu", "S.lmbda"]


def structure(way=lambda t: 1.0):
    load = {"TOP": lambda x, t: (way(t) * (x[0] - 1.0), 0.5 * way(t))}
    return Structure(JOINT, body=LinearElastic.young(E=200.0, nu=0.3), supports={"BOTTOM": 0}, tractions=load)


def start(order=0):
    return structure().interface(ThinLayer(START, EPS, order=order))


@cache
def measured():
    """Displacements of the meshed layer, with a noise of 1 % of the largest."""
    model, full = start(), solve(structure().full(ThinLayer(TRUE, EPS)))
    values = np.array([goal.value(full, model) for goal in PLACES])
    deviation = 0.01 * np.abs(values).max()
    noise = deviation * np.random.default_rng(1).standard_normal(len(values))
    return [Measurement(goal, value, deviation) for goal, value in zip(PLACES, values + noise, strict=True)]


@cache
def fitted(order):
    return fit(start(order), measured(), MODULI)


@pytest.mark.parametrize("order", [0, pytest.param(1, marks=pytest.mark.long)])
def test_intervals_contain_the_truth(order):
    """At order 0 only with the error of the law."""
    result = fitted(order)
    for name, true in zip(MODULI, (TRUE.mu, TRUE.lmbda), strict=True):
        low, high = result.interval(name)
        assert low < true < high
        assert (abs(np.log(true / result.values[name])) < 1.96 * result.deviation[name]) == (order == 1), name
    assert 0.4 < result.misfit < 1.5
    assert result.steps <= 6
    assert result.values["S.mu"] == pytest.approx(TRUE.mu, rel=0.02 if order else 0.15)
    meshed = solve(structure().full(ThinLayer(result.model.layers["S"].layer.law, EPS)))
    changes = [goal.value(meshed, result.model) for goal in PLACES] - result.fitted
    assert np.linalg.norm(result.law_errors - changes) < 0.5 * np.linalg.norm(changes)


def test_the_fitted_model_gives_the_fitted_values_and_their_slopes():
    result = fitted(0)
    state = solve(result.model)
    assert [goal.value_in(state) for goal in PLACES] == pytest.approx(result.fitted, rel=1e-10)
    slopes = [[*derivative(state, goal, MODULI).by.values()] for goal in PLACES[:2]]
    assert result.jacobian[:2] == pytest.approx(np.array(slopes), rel=1e-6)


def test_what_is_said_and_drawn(tmp_path):
    result = fitted(0)
    assert "model and data agree" in str(result)
    assert str(result).startswith(f"S.mu = {result.values['S.mu']:.4g}, ")
    assert result.table()["lower"].tolist() == [result.interval(name)[0] for name in result.factors]
    result.plot(save=tmp_path / "fit.png")
    assert_drawn(tmp_path / "fit.png")


def test_what_data_do_not_see():
    """At order 0 they are changed by moduli over the thickness alone."""
    result = fit(start(), measured(), [*MODULI, "S.eps"])
    (powers,) = result.unseen
    assert np.abs([*powers.values()]) == pytest.approx([3**-0.5] * 3, rel=1e-4)
    assert np.isnan([*result.values.values(), *result.interval("S.mu")]).all()
    assert "S.eps: the data do not see it" in str(result)
    rough = [Measurement(goals.Reaction("BOTTOM", (1, 0)), -4.0, 1e3)]
    refused(InputError, "do not see any of load TOP", fit, start(), rough, ["load TOP"])


def test_a_parameter_without_a_name():
    """Its layers are those that named parameters multiply."""
    stiffer = {"stiffness": lambda f: ThinLayer(LinearElastic.young(E=2.7 * f, nu=0.35), EPS)}
    result = fit(start(), measured(), ["S.nu"], of=stiffer)
    law = result.model.layers["S"].layer.law
    assert fitted(0).values == pytest.approx({"S.mu": law.mu, "S.lmbda": law.lmbda}, rel=1e-5)
    assert result.interval("stiffness")[0] < result.values["stiffness"] == result.factors["stiffness"]
    refused(InputError, "give one function", fit, start(), measured(), [], of=dict.fromkeys("ab", stiffer["stiffness"]))


def test_parameters_that_change_together():
    """Moduli of both in place of E, and thickness: the data do not see their ratio."""
    of = {"moduli": ["S.mu", "S.lmbda"]}
    result, expected = fit(start(), measured(), ["S.nu"], of=of), fitted(0).values
    law = result.model.layers["S"].layer.law
    assert {"S.mu": law.mu, "S.lmbda": law.lmbda} == pytest.approx(expected, rel=1e-5)
    assert f"moduli = {result.factors['moduli']:.4g} times its start" in str(result)
    assert len(fit(start(), measured(), ["S.eps"], of=of).unseen) == 1


def test_a_fit_that_does_not_converge():
    with pytest.warns(RangeWarning, match="not converged after 2 steps; give max_steps"):
        result = fit(start(), measured(), MODULI, max_steps=2)
    assert "NOT CONVERGED after 2 steps" in str(result)


# ---------------------------------------------------------------- marches
def test_a_march_is_fitted_to_data_at_several_times():
    times, top = (0.2, 1.0), goals.Displacement((2.0, 1.5), (0.3, 1))
    run, of = lambda model: march(model, times), lambda law: structure(lambda t: t).interface(ThinLayer(law, EPS))
    history = run(of(Maxwell(3.0, 2.0, 0.6, 0.9)))
    data = [Measurement(top, top.value_in(history.at(t)), 1e-4, t) for t in times]
    result = fit(of(Maxwell(3.0, 2.05, 0.58, 0.9)), data, ["S.mu", "S.t1"], run=run)
    assert result.values == pytest.approx({"S.mu": 2.0, "S.t1": 0.6}, rel=1e-4)
    assert np.abs(result.residuals).max() < 1e-3
    assert np.diff(result.law_errors) != 0


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


def test_a_file_of_a_spreadsheet(tmp_path):
    """Semicolons and decimal commas, capitals, an empty line before the head."""
    for name, text in {
        "plain": HEAD + GOOD,
        "sheet": "\n" + (HEAD.title() + GOOD).replace(",", ";").replace(".", ","),
    }.items():
        (tmp_path / name).write_text(text)
    assert read_measurements(tmp_path / "sheet") == read_measurements(tmp_path / "plain")
    (tmp_path / "sheet").write_text(HEAD + "reaction,B\u00d6DEN,0 1,3,0.1,\n", encoding="latin-1")
    refused(InputError, "sheet is not in UTF-8", read_measurements, tmp_path / "sheet")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("quantity,value\n", "no measurements"),
        ("quantity;value\n1;2\n", "line 2: no place, deviation; there must be columns"),
        (HEAD.replace("t\n", "t [s]\n") + GOOD, "line 1: column is 't .s.'; allowed, each once: quantity, .*, t"),
        (HEAD.replace("t\n", "value\n") + GOOD, "line 1: column is 'value, value'; allowed, each once"),
        (HEAD + "reaction,BOTTOM,0 1,-0,01189,0,00012\n", "line 2: the row is .*; there are 6 columns"),
        (HEAD + "force,BOTTOM,0 1,3,0.1,\n", "line 2: quantity is 'force'; allowed: displacement, reaction, traction"),
        (HEAD + GOOD + "reaction,BOTTOM,0 1,three,0.1,\n", "line 6: could not convert string to float: 'three'"),
        (HEAD + "reaction,BOTTOM,0 1,3,0,\n", "line 2: the standard deviation of reaction BOTTOM .* is 0.0"),
        (HEAD + "reaction,BOTTOM,0 1,3\n", "line 2: no deviation"),
        (HEAD + "displacement,4 2 middle,0 1,3,0.1,\n", "line 2: could not convert"),
        (HEAD + "displacement,4 1,0 1,3,0.1,\ndisplacement,9 9,1 0,1,1,\n", "line 3: 1 of 1 places are in no cell"),
        (HEAD + "displacement,1 0,1 0,1,1,\n", "line 2: displacements jump at"),
        (HEAD + "reaction,LEFT,0 1,3,0.1,\n", "line 2: nothing holds 'LEFT'"),
        (HEAD + "traction,T,0 1,3,0.1,\n", "line 2: .*unknown layer 'T'"),
        (HEAD + "reaction,BOTTOM,0 1,3,0.1,0.5\n", "line 2: a state is of t = 0, not of t = 0.5; give the history"),
    ],
)
def test_files_that_are_refused(text, message, tmp_path):
    """With the name of the file; also for places that the model does not have."""
    path = tmp_path / "data.csv"
    path.write_text(text)
    refused(InputError, rf"data.csv.*{message}", fit, start(), path, ["S.mu"])


def test_what_cannot_be_fitted():
    goal = goals.Reaction("BOTTOM", (0, 1))
    model, data = start(), [Measurement(goal, 1.0, 0.1)]
    for measurements, names, message in [
        ([], ["S.mu"], "measurements is"),
        ([3.0], ["S.mu"], "give Measurements"),
        (data, [], "at least one name"),
        (data, ["S.my"], "did you mean 'S.mu'"),
        (data, ["S.mu", "S.mu"], "each once"),
        (data, ["S.mu", "S.nu"], "parameters of S is .*; S.E and S.nu, or S.lmbda and S.mu"),
    ]:
        refused(InputError, message, fit, model, measurements, names)
    refused(InputError, "the goal of a measurement is 3", Measurement, 3, 1.0, 0.1)
    refused(InputError, "must be a finite number", Measurement, goal, float("nan"), 0.1)
