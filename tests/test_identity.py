"""What results are made from: descriptions that are the same in another process, and differ where results may."""

from __future__ import annotations

import argparse
import enum
import functools
import json
import os
import re
import subprocess
import sys
import threading
from collections import OrderedDict, defaultdict
from dataclasses import dataclass, replace
from pathlib import Path

import numba
import numpy as np
import pytest

from forms.laws import LinearElastic
from tests.viscous_joints import JOINT, SETUP, SLOW
from thinlayer import ModelError, Structure, ThinLayer, march, piecewise
from thinlayer.identity.codes import code_of
from thinlayer.identity.described import described, referred

FACTOR = 2.0
SCALE = {"a": [1.0, 2.0]}


def scaled(x):
    return FACTOR * x


@dataclass(frozen=True)
class Spring(LinearElastic):
    RATIO = 0.5

    def stress(self, step):
        return self.RATIO * scaled(1.0) * super().stress(step)


def row(e):
    return {"eps": e, "error_traction": scaled(e), "error_jump": 3 * e}


def test_functions_are_what_they_do_and_what_they_refer_to(monkeypatch):
    def load(F, k=1.0):
        return lambda x, t: (k * F, scaled(t) + np.sin(SCALE["a"][0]))  # a comment

    def same(F, k=1.0):
        return lambda x, t: (k * F, scaled(t) + np.sin(SCALE["a"][0]))

    first = described(load(-60.0))
    assert described(load(np.float64(-60))) == described(same(-60)) == first
    assert described(load(-600.0)) != first
    assert described(load(-60.0, 2.0)) != first
    assert described(lambda x, t: (0.0, 1.0)) != described(lambda x, t: (0.0, 2.0))
    # the same code of other built-in functions, and of other members
    assert described(lambda x, t: (0.0, min(x[0], t))) != described(lambda x, t: (0.0, max(x[0], t)))
    assert described(lambda step: step.new.strain) != described(lambda step: step.old.strain)
    assert described(piecewise({0: 1.0, 1: 2.0})) != described(piecewise({0: 1.0, 1: 3.0}))
    assert code_of(load(-60.0)) == code_of(load(-600.0))
    law = described(Spring(60.0, 40.0))
    assert law == described(Spring(60, 40))
    with monkeypatch.context() as patch:  # of a function that the function calls
        patch.setitem(globals(), "FACTOR", 2.5)
        assert described(load(-60.0)) != first
        assert described(Spring(60.0, 40.0)) != law
    with monkeypatch.context() as patch:
        patch.setattr(Spring, "RATIO", 0.6)
        assert described(Spring(60.0, 40.0)) != law
    monkeypatch.setitem(SCALE, "a", [1.5, 2.0])
    assert described(load(-60.0)) != first


def test_descriptions_are_json_and_end():
    around = {"law": SLOW, "joint": JOINT, "places": np.linspace(0.0, 1.0, 100), "names": {"b", "a"}, "path": Path("x")}
    around["itself"] = around
    found = described(around)
    assert json.loads(json.dumps(found)) == found
    moved = replace(JOINT, points=JOINT.points * 1.1)
    assert described(moved) != described(JOINT)
    assert referred(row).keys() == {"(code)", "scaled"}
    assert referred(row)["scaled"]["FACTOR"] == FACTOR
    assert len(repr(JOINT)) < 200


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


def uniform(x, t):
    return (0.0, 1.5)


def with_attribute(value):
    def load(x, t):
        return (0.0, load.F * t)

    load.F = value
    return load


def executed(text, name="found"):
    namespace = {"__name__": "__main__", "enum": enum}
    exec(text, namespace)
    return namespace[name]


def nameless(text):
    namespace = {}
    exec(text, namespace)
    return namespace["found"]


def made(value):
    """Functions and objects that differ in a value alone."""
    names = ["F", "G"] if value > 5 else ["G", "F"]
    yield "attribute of a function", with_attribute(value)
    yield "executed text", nameless(f"def found(t): return {value} * t")
    yield "class of an executed text", nameless(f"class found:\n def F(self): return {value}")
    yield "class of python3 -c", executed(f"class found:\n def F(self): return {value}")()
    yield "own text", executed(f"class E(enum.StrEnum):\n A = 'a'\n def F(self): return {value}\nfound = E.A")
    yield "class decorator", Times(uniform, value)
    yield "vectorized", np.vectorize(lambda a: value * a)
    yield "default", defaultdict(functools.partial(float, value))
    yield "names in an array", np.array([(1.0, 2.0)], dtype=[(name, float) for name in names])
    yield "entry of an array", np.array([(1.0, 2.0)], dtype=[(name, float) for name in names])[0]
    yield "shape of texts", np.array(["a", "b", "c", "d", "e", "f"]).reshape((-1, int(value)))
    yield "own number", Length(2.0, value)
    yield "order that counts", OrderedDict((name, 1.0) for name in names)
    yield "numbers and texts as keys", {1: value, "1": 2.0}
    yield "namespace of a file", executed(f"class found:\n class G:\n  def F(self): return {value}").G


def test_nothing_is_dropped_from_descriptions():
    one, same, other = (dict(made(value)) for value in (3.0, 3.0, 6.0))
    for name in one:
        assert described(lambda x, t, it=one[name]: it) == described(lambda x, t, it=same[name]: it), name
        assert described(one[name]) != described(other[name]), name
    assert described({1: 2.0, "1": 3.0}) != described({1: 7.0, "1": 3.0})


@dataclass
class Moduli:
    E: dict

    @functools.cached_property
    def mean(self):
        return sum(self.E.values()) / len(self.E)


PATTERN = re.compile("F=(.)")
NUMBERS = [0.5 * k for k in range(40)]


def met():
    """What another process makes in another order, or computes anew."""
    from scipy.spatial import cKDTree
    from scipy.stats import norm, weibull_min

    moduli = Moduli({name: 2.0 for name in {"foam", "glue", "wood", "cork", "mortar"}})
    frozen = weibull_min(1.5, scale=3.0)
    tree = cKDTree(np.array([[0.0, 1.0], [2.0, 3.5]]))
    lock = threading.Lock()
    return [moduli, {("a", 1), ("b", 2)}, PATTERN, norm, frozen, tree, lock, sys.stderr, NUMBERS]


def test_descriptions_are_the_same_in_another_process():
    there = met()
    assert there[0].mean == 2.0  # now it is cached
    program = "from tests.test_identity import *; print(json.dumps(described(met())))"
    for seed in "1":
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True,
                              env=os.environ | {"PYTHONHASHSEED": seed}, cwd=Path(__file__).parents[1])  # fmt: skip
        assert json.loads(done.stdout) == described(there)
    assert described(PATTERN) != described(re.compile("F=(..)"))


def test_of_namespaces_what_is_read_counts():
    arguments = argparse.Namespace(E=60.0, resume=False)

    def read(e):
        return arguments.E * e

    def passed_on(e):
        return vars(arguments)["E"] * e

    before = [described(one) for one in (read, passed_on)]
    arguments.resume = True
    assert described(read) == before[0]
    assert described(passed_on) != before[1]
    arguments.E = 120.0
    assert described(read) != before[0]


def test_chains_too_long_to_follow():
    class Link:
        def __init__(self, behind):
            self.behind = behind

    chain = functools.reduce(lambda behind, _: Link(behind), range(2000), None)
    with pytest.raises(ModelError, match="refers to things that refer to one another in a chain of hundreds"):
        described(lambda x, t: chain)


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


def through(function):
    @functools.wraps(function)
    def inner(state):
        return function(state)

    return inner


def test_observed_functions_are_all_code_that_they_call(monkeypatch):
    """And no values that they collect."""
    ways = (
        through,
        functools.cache,
        numba.njit,
        functools.partial,
        lambda f: lambda state: f(state),
        lambda f: Times(f, 1.0),
    )
    for way in ways:
        assert code_of(way(half)) == code_of(way(half))
        assert code_of(way(half)) != code_of(way(other_half))
    assert code_of(Gauge([]).slip) == code_of(Gauge([1.0]).slip)
    assert code_of(Gauge([]).slip) != code_of(Gauge([]).gap)
    assert code_of(functools.partial(half, at=1.0)) != code_of(functools.partial(half, at=2.0))
    assert code_of(functools.partial(half, [])) == code_of(functools.partial(half, [3.0]))
    before = code_of(Gauge([]).slip)
    monkeypatch.setitem(globals(), "half", other_half)
    assert code_of(Gauge([]).slip) != before


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (dict(tractions={"TOP": piecewise({0: (0.0, 1.0), 1: (0.0, 1.1)})}), "loads"),
        (dict(layer=ThinLayer(SLOW, 0.1, profile=lambda x: 1 + 0.2 * x[0], at=1.0)), "profile"),
        (dict(supports=SETUP["supports"] | {"RIGHT": {"x": lambda x, t: 0.01 * t * (x[1] + 0.5)}}), "supports"),
        (dict(joint=replace(JOINT, facets=JOINT.facets | {"LEFT": JOINT.facets["RIGHT"], "RIGHT": JOINT.facets["LEFT"]})),
         "facets"),
        (dict(joint=JOINT.swapped()), "seams"),
    ],
    ids=["piecewise", "profile", "moving support", "facets", "sides"],
)  # fmt: skip
def test_a_march_of_other_data_is_not_resumed(tmp_path, change, what):
    layer = ThinLayer(SLOW, 0.1, profile=lambda x: 1 + 0.1 * x[0], at=1.0)
    data = SETUP | {
        "supports": SETUP["supports"] | {"RIGHT": {"x": lambda x, t: 0.02 * t * (x[1] + 0.5)}},
        "tractions": {"TOP": piecewise({0: (0.0, 1.0), 1: (0.0, 2.0)})},
    }
    march(Structure(JOINT, **data).interface(layer), [0.1], out=tmp_path)
    other_layer = change.pop("layer", layer)
    other = Structure(change.pop("joint", JOINT), **data | change).interface(other_layer)
    with pytest.raises(ModelError, match=rf"is of another march \(.*{what}: "):
        march(other, [0.1, 0.2], out=tmp_path, resume=True)
    assert len(march(Structure(JOINT, **data).interface(layer), [0.1, 0.2], out=tmp_path, resume=True)) == 3
