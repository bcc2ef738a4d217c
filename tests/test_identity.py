"""What results are made from: descriptions that are the same in another process, and differ where results may."""

from __future__ import annotations

import collections
import datetime
import decimal
import functools
import importlib
import json
import operator
import os
import re
import subprocess
import sys
import types
from dataclasses import dataclass, replace
from pathlib import Path

import numba
import numpy as np
import pytest
import ufl

from forms.laws import LinearElastic
from tests.viscous_joints import JOINT, SETUP, SLOW
from thinlayer import ModelError, Structure, ThinLayer, compare, identity, march, piecewise, solve, sweep
from thinlayer.identity import code_of, described, differences, told

LAYER = ThinLayer(SLOW, 0.1, at=1.0)
FACTOR = 2.0


def scaled(x):
    return FACTOR * x


@dataclass(frozen=True)
class Spring(LinearElastic):
    def stress(self, step):
        return scaled(1.0) * super().stress(step)


def test_functions_are_the_numbers_they_refer_to(monkeypatch):
    def load(F, k=1.0):
        return lambda x, t: (k * F, scaled(t))

    def same(F, k=1.0):
        return lambda x, t: (k * F, scaled(t))

    first, law = described(load(-60.0)), described(Spring(60.0, 40.0))
    assert described(load(np.float64(-60))) == described(load(-60)) == first != described(same(-60))
    assert described(Spring(60, np.int64(40))) == law != described(Spring(60.0, 41.0))
    others = load(-600.0), load(-60.0, 2.0), functools.partial(load(-60.0), t=1.0)
    assert len({json.dumps(described(one)) for one in (load(-60.0), *others)}) == 4
    assert described(piecewise({0: 1.0, 1: 2.0})) != described(piecewise({0: 1.0, 1: 3.0}))
    assert described(functools.partial(load, k=1.0)) != described(functools.partial(load, k=2.0))
    assert described(lambda x, F=1.0: F) != described(lambda x, F=2.0: F)
    monkeypatch.setitem(globals(), "FACTOR", 2.5)  # of a function that the function calls
    assert told([*differences(first, described(load(-60.0)))]) == "scaled.FACTOR: 2.0 there, 2.5 here"
    assert described(Spring(60.0, 40.0)) != law


FILES = {
    "loads.py": (
        "import units\nfrom helpers import twice\n\ndef load(x, t):\n    return (0.0, twice(t) * units.F)\n\n"
        "def late(x, t):\n    from helpers import twice\n    return (0.0, twice(t))\n"
    ),
    "helpers.py": "def twice(t):\n    return 2 * t\n",
    "units.py": "F = 0.5\n",
}


@pytest.fixture
def own(tmp_path, monkeypatch):
    """The functions of a user's file, as another process finds them once a file has been rewritten."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def read(**changed):
        for name, text in (FILES | {f"{one}.py": text for one, text in changed.items()}).items():
            (tmp_path / name).write_text(text)
            sys.modules.pop(name[:-3], None)
        importlib.invalidate_caches()
        return importlib.import_module("loads")

    yield read
    for name in FILES:
        sys.modules.pop(name[:-3], None)


@pytest.mark.parametrize(
    ("changed", "load", "late"),
    [("loads", True, True), ("helpers", True, True), ("units", False, False)],
)
def test_functions_are_the_files_of_ones_own_that_they_stand_in(own, changed, load, late):
    """A comment is enough; files that a function has nothing of are none of its."""
    before = own()
    one = [described(before.load), described(before.late)]
    after = own(**{changed: FILES[f"{changed}.py"] + "# more\n"})
    assert [described(after.load) != one[0], described(after.late) != one[1]] == [load, late]
    again = own()
    assert [described(again.load), described(again.late)] == one


def test_a_march_of_another_file_is_resumed_by_who_knows_better(own, tmp_path):
    def model(**changed):
        return Structure(JOINT, tractions={"TOP": own(**changed).load}, **SETUP).interface(LAYER)

    whole = march(model(), [0.1, 0.2], out=tmp_path / "m")
    other, comment = model(helpers="def twice(t):\n    return 3 * t\n"), FILES["loads.py"] + "# more\n"
    for changed, what in ((other, r"loads\..*'TOP'\.twice\.\(code\): helpers\.twice"), (model(loads=comment), "loads")):
        with pytest.raises(
            ModelError, match=rf"is of another march \({what}.* there, .* here\); .* or resume='anyway'"
        ):
            march(changed, [0.1, 0.2, 0.3], out=tmp_path / "m", resume=True)
    for times in ([0.1, 0.2, 0.3], [0.1, 0.2, 0.3, 0.4]):
        history = march(other, times, out=tmp_path / "m", resume="anyway")
        assert history.t == pytest.approx([0.0, *times])
        assert np.array_equal(history.at(0.2).u.x.array, whole.last.u.x.array)
    assert len(march(model(), times, out=tmp_path / "m", resume=True)) == 5  # the march that it was begun as


def test_anyway_does_not_take_what_does_not_fit(tmp_path):
    model = Structure(JOINT, **SETUP).interface(LAYER)
    march(model, [0.1], out=tmp_path / "m")
    with pytest.raises(ModelError, match=r"the march observes \[\], not \['one'\]"):
        march(model, [0.2], observe={"one": lambda state: 1.0}, out=tmp_path / "m", resume="anyway")
    finer = Structure(JOINT, element="P1", **SETUP).interface(LAYER)
    with pytest.raises(ModelError, match=r"is damaged, or of another version \(\d+ values where \d+ belong\)"):
        march(finer, [0.2], out=tmp_path / "m", resume="anyway")
    for resume in ("yes", 1, None):
        with pytest.raises(ModelError, match=f"resume is {resume!r}; allowed: True, False, and 'anyway'"):
            march(model, [0.2], out=tmp_path / "m", resume=resume)


class Times:
    """A class decorator: what it calls is the function, what it returns depends on more."""

    def __init__(self, function, factor):
        functools.update_wrapper(self, function)
        self.function, self.factor = function, factor

    def __call__(self, *place):
        return [self.factor * one for one in self.function(*place)]


class Length(float):
    def __new__(cls, value, unit):
        length = super().__new__(cls, value)
        length.unit = unit
        return length


class Chain(collections.deque):
    def __init__(self, values, scale):
        super().__init__(values)
        self.scale = scale


def with_attribute(value):
    def load(x, t):
        return (0.0, load.F * t)

    load.F = value
    return load


def executed(text):
    namespace = {"__name__": "__main__"}
    exec(text, namespace)
    return namespace["found"]


THINGS = {
    "attribute of a function": with_attribute,
    "executed text": lambda v: executed(f"def found(t): return {v} * t"),
    "class of python3 -c": lambda v: executed(f"class found:\n def F(self): return {v}")(),
    "class decorator": lambda v: Times(scaled, v),
    "vectorized": lambda v: np.vectorize(lambda a: v * a),
    "cached": lambda v: functools.cache(lambda a: v * a),
    "compiled": lambda v: numba.njit(lambda a: v * a),
    "class": lambda v: type("Made", (), {"F": v}),
    "default": lambda v: collections.defaultdict(functools.partial(float, v)),
    "names in an array": lambda v: np.array([(1.0, 2.0)], dtype=[(n, float) for n in ("FG" if v > 5 else "GF")]),
    "shape of texts": lambda v: np.array([*"abcdefghijklmnopqrstuvwxyzabcd"]).reshape((-1, int(v))),
    "large array": lambda v: np.linspace(0.0, v, 100),
    "long list": lambda v: [v] * 100,
    "own number": lambda v: Length(2.0, v),
    "order that counts": lambda v: collections.OrderedDict((n, 1.0) for n in ("FG" if v > 5 else "GF")),
    "numbers and texts as keys": lambda v: {1: v, "1": 2.0},
    "keys": lambda v: {(v, 1): 2.0},
    "set": lambda v: {"a", "b", v},
    "namespace": lambda v: types.SimpleNamespace(F=v),
    "range": lambda v: range(int(v)),
    "deque": lambda v: Chain([v], 1.0),
    "own attribute": lambda v: Chain([1.0], v),
    "decimal": decimal.Decimal,
    "time": lambda v: datetime.timedelta(seconds=v),
    "pattern": lambda v: re.compile(f"F={v}"),
    "getter": lambda v: operator.itemgetter(int(v)),
    "method": lambda v: [v].index,
    "masked": lambda v: np.ma.array([1.0, 2.0], mask=[v > 5, False]),
    "polynomial": lambda v: np.polynomial.Polynomial([0.0, v]),
    "expression": lambda v: ufl.as_ufl(v) * ufl.as_vector([1.0, 2.0]),
    "beyond the digits of floats": lambda v: 2**60 + int(v),
    "nan": lambda v: float("nan") if v > 5 else float("inf"),
    "ufunc": lambda v: np.sin if v > 5 else np.cos,
    "frozen": lambda v: importlib.import_module("scipy.stats").weibull_min(1.5, scale=v),
    "tree": lambda v: importlib.import_module("scipy.spatial").cKDTree(np.array([[0.0, 1.0], [2.0, v]])),
    "law": lambda v: Spring(60.0, v),
    "law of layers": lambda v: replace(LAYER, eps=v),
    "joint": lambda v: replace(JOINT, points=JOINT.points * v),
}  # fmt: skip


def holding(thing):
    return lambda x, t: thing


def descriptions():
    return {name: [described(holding(thing(v))) for v in (5.0, 6.0)] for name, thing in THINGS.items()}


def test_things_are_the_same_in_another_process_and_others_if_they_differ():
    found = descriptions()
    assert [name for name, (one, other) in found.items() if one == other] == []
    assert [name for name, both in descriptions().items() if both != found[name]] == []
    code = "import json; from tests.test_identity import *; print(json.dumps(descriptions()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True,
                          env=os.environ | {"PYTHONHASHSEED": "1"}, cwd=Path(__file__).parents[1])  # fmt: skip
    there = json.loads(done.stdout)
    assert [name for name in found if there[name] != found[name]] == []


def test_objects_within_themselves_are_described_once():
    around = {"law": SLOW, "path": Path("x")}
    around["itself"] = [around, around]
    found = described(around)
    assert found["itself"] == [{"(same as)": ""}] * 2
    assert described([JOINT, JOINT]) != described([JOINT, JOINT.swapped()])
    one, other = Times(scaled, 1.0), Times(scaled, 2.0)
    assert described([one, other, one]) != described([one, other, other])


class Gauge:
    def __init__(self, found):
        self.found = found

    def slip(self, state):
        self.found.append(state)
        return half(state)

    def gap(self, state):
        return half(state)


def half(state):
    return 0.5


def other_half(state):
    return 0.25


def test_observed_functions_are_all_code_that_they_call():
    """And the numbers that they refer to, but no values that they collect."""

    def observed(function):
        return code_of(described(function))

    for way in (
        functools.cache,
        numba.njit,
        functools.partial,
        lambda f: lambda state: f(state),
        lambda f: Times(f, 1),
    ):
        assert observed(way(half)) == observed(way(half)) != observed(way(other_half))
    assert observed(Gauge([]).slip) == observed(Gauge([1.0]).slip) != observed(Gauge([]).gap)
    assert observed(functools.partial(half, at=1.0)) != observed(functools.partial(half, at=2.0))
    assert observed(functools.partial(half, [])) == observed(functools.partial(half, [3.0]))
    one, other = (lambda state, F=F: F * state.t for F in (1.0, 2.0))
    assert observed(one) != observed(other)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (dict(tractions={"TOP": piecewise({0: (0.0, 1.0), 1: (0.0, 1.1)})}), "loads"),
        (dict(layer=ThinLayer(SLOW, 0.1, profile=lambda x: 1 + 0.2 * x[0], at=1.0)), "layers.S.profile"),
        (dict(supports=SETUP["supports"] | {"RIGHT": {"x": lambda x, t: 0.01 * t * (x[1] + 0.5)}}), "supports"),
        (dict(joint=replace(JOINT, facets=JOINT.facets | {"LEFT": JOINT.facets["RIGHT"], "RIGHT": JOINT.facets["LEFT"]})),
         "facets.LEFT"),
        (dict(joint=JOINT.swapped()), "seams.S"),
    ],
    ids=["piecewise", "profile", "moving support", "facets", "sides"],
)  # fmt: skip
def test_a_march_of_other_data_is_not_resumed(tmp_path, change, what):
    def pull(rate):
        return lambda x, t: rate * t * (x[1] + 0.5)

    layer = ThinLayer(SLOW, 0.1, profile=lambda x: 1 + 0.1 * x[0], at=1.0)
    data = SETUP | {
        "supports": SETUP["supports"] | {"RIGHT": {"x": pull(0.02)}},
        "tractions": {"TOP": piecewise({0: (0.0, 1.0), 1: (0.0, 2.0)})},
    }
    march(Structure(JOINT, **data).interface(layer), [0.1], out=tmp_path)
    other_layer = change.pop("layer", layer)
    other = Structure(change.pop("joint", JOINT), **data | change).interface(other_layer)
    with pytest.raises(ModelError, match=rf"is of another march \({what}.* there, .* here"):
        march(other, [0.1, 0.2], out=tmp_path, resume=True)
    assert len(march(Structure(JOINT, **data).interface(layer), [0.1, 0.2], out=tmp_path, resume=True)) == 3


def test_what_no_other_process_knows_is_not_resumed(tmp_path, monkeypatch):
    numbers = (k for k in range(3))

    def run(e):
        return {"eps": e, "error_traction": e, "error_jump": e + 0 * len([numbers])}

    def model():
        return Structure(JOINT, tractions={"TOP": lambda x, t: (0.0, t * len([numbers]))}, **SETUP).interface(LAYER)

    march(model(), [0.1], out=tmp_path / "m")
    sweep(run, [0.4], tmp_path / "t.csv")
    assert len(march(model(), [0.1, 0.2], out=tmp_path / "m", resume=True)) == 3
    monkeypatch.setattr(identity, "ALONE", ", known to process 2 alone")
    with pytest.raises(
        ModelError, match=r"is of another march \(loads.*builtins\.generator, known to process \w+ alone"
    ):
        march(model(), [0.1, 0.3], out=tmp_path / "m", resume=True)
    with pytest.raises(ModelError, match=r"another sweep \(numbers: builtins\.generator, known to process \w+ alone"):
        sweep(run, [0.4, 0.2], tmp_path / "t.csv", resume=True)
    assert len(sweep(run, [0.4, 0.2], tmp_path / "t.csv", resume="anyway")) == 2
    assert len(march(model(), [0.1, 0.3], out=tmp_path / "m", resume="anyway")) == 4


def test_models_are_what_they_were_built_with():
    load, scale = np.array([0.0, 1.0]), {"F": 1.0}
    data, spring = SETUP | {"tractions": {"TOP": load}}, ThinLayer(Spring(60.0, 40.0), 0.1, at=1.0)
    pulled = Structure(JOINT, **data)
    full, interface = pulled.full(spring), pulled.interface(spring)
    other = Structure(JOINT, **data | {"tractions": {"TOP": lambda x, t: (0.0, scale["F"])}}).interface(LAYER)
    before = [json.dumps(one.identity()) for one in (full, interface, other)]
    load[1], scale["F"] = 2.0, 2.0
    assert [json.dumps(one.identity()) for one in (full, interface, other)] == before
    assert 0 < compare(solve(full), solve(interface))["error_jump"] < 1
    with pytest.raises(ModelError, match=r"needs the same loads: .*1\.0 there, 2\.0 here"):
        compare(solve(full), solve(Structure(JOINT, **data).interface(spring)))
