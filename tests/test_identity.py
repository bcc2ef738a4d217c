"""What results are made from: descriptions that are the same in another process, and differ where results may."""

from __future__ import annotations

import collections
import functools
import importlib
import json
import os
import subprocess
import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import scipy.spatial
import scipy.stats
import ufl
from dolfinx import fem

from forms import LinearElastic
from forms.base import InputError
from tests.refused import refused
from tests.viscous_joints import JOINT, SETUP, SLOW
from thinlayer import Structure, ThinLayer, compare, march, piecewise, solve
from thinlayer.system import fingerprint
from thinlayer.system.fingerprint import code_part, describe, differences, differences_text, random_states

LAYER = ThinLayer(SLOW, 0.1, at=1.0)
FACTOR = 2.0


def scaled(x):
    return FACTOR * x


def same(x):
    return x


@dataclass(frozen=True)
class Spring(LinearElastic):
    def stress(self, step):
        return scaled(1.0) * super().stress(step)


def test_functions_are_the_numbers_they_refer_to(monkeypatch):
    def load(F, k=1.0):
        return lambda x, t: (k * F, scaled(t))

    first, law = describe(load(-60.0)), describe(Spring(60.0, 40.0))
    assert describe(load(np.float64(-60))) == describe(load(-60)) == first
    assert describe([Spring(60, np.int64(40)), Spring(60.0, 40.0)]) == describe([Spring(60.0, 40.0)] * 2)
    monkeypatch.setitem(globals(), "FACTOR", 2.5)  # of a function that the function calls
    assert differences_text([*differences(first, describe(load(-60.0)))]) == "scaled.FACTOR: 2.0 there, 2.5 here"
    assert describe(Spring(60.0, 40.0)) != law


# ---------------------------------------------------------------- files
FILES = {
    "loads": "from helpers import twice\nfrom units import F\n\ndef load(x, t):\n    return (0.0, twice(t) * F)\n\n"
    "def late(x, t):\n    from helpers import twice\n    return (0.0, twice(t))\n",
    "helpers": "def twice(t):\n    return 2 * t\n",
    "units": "F = 0.5\n",
}


@pytest.fixture
def user_module(tmp_path, monkeypatch):
    """The functions of a user's file, as another process finds them once a file has been rewritten."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def read(**changed):
        for name, text in (FILES | changed).items():
            (tmp_path / f"{name}.py").write_text(text)
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        return importlib.import_module("loads")

    yield read
    for name in FILES:
        sys.modules.pop(name, None)


def test_functions_are_the_files_of_ones_own_that_they_stand_in(user_module):
    """A comment is enough; of what a function reads elsewhere the numbers count."""
    for changed, others in [
        (dict(loads=FILES["loads"] + "# more\n"), ["load", "late"]),
        (dict(helpers=FILES["helpers"] + "# more\n"), ["load", "late"]),
        (dict(units="F = 0.75\n"), ["load"]),
        (dict(units="F = 1 / 2\n"), []),
    ]:
        of = lambda files: {name: describe(vars(user_module(**files))[name]) for name in ("load", "late")}
        before, after = of({}), of(changed)
        assert [name for name in before if before[name] != after[name]] == others
        assert differences_text([*differences(before, after)]).count("(file): ") in (0, 1)  # it is named once


def test_a_march_of_another_file_is_resumed_by_who_knows_better(user_module, tmp_path):
    def model(**changed):
        return Structure(JOINT, tractions={"TOP": user_module(**changed).load}, **SETUP).interface(LAYER)

    whole, times = march(model(), [0.1, 0.2], out=tmp_path), [0.1, 0.2, 0.3]
    other = model(helpers="def twice(t):\n    return 3 * t\n")
    words = r"another march \(loads\..*twice\.\(file\): helpers\.py .* or resume='anyway'"
    refused(InputError, words, march, other, times, out=tmp_path, resume=True)
    for end in (3, 4):
        history = march(other, [*times, 0.4][:end], out=tmp_path, resume="anyway")
        assert history.t == pytest.approx([0.0, *times, 0.4][: end + 1])
        assert np.array_equal(history.at(0.2).u.x.array, whole.last.u.x.array)
    assert len(march(model(), [*times, 0.4], out=tmp_path, resume=True)) == 5  # it is the march that was begun
    with pytest.raises(InputError, match=r"the march observes \[\], not \['one'\]"):
        march(other, [0.5], observe={"one": lambda state: 1.0}, out=tmp_path, resume="anyway")
    coarser = Structure(JOINT, element="P1", **SETUP).interface(LAYER)
    refused(InputError, "is of a march with other unknowns", march, coarser, [0.5], out=tmp_path, resume="anyway")
    refused(InputError, "resume is 'yes'; allowed: True, False", march, other, [0.5], out=tmp_path, resume="yes")


# ---------------------------------------------------------------- things
class Times:
    """A class decorator: what it calls is the function, what it returns depends on more."""

    def __init__(self, function, factor):
        functools.update_wrapper(self, function)
        self.function, self.factor = function, factor

    def __call__(self, *place):
        return [self.factor * value for value in self.function(*place)]


def executed(text):
    namespace = {"__name__": "__main__"}
    exec(text, namespace)
    return namespace["found"]


THINGS = {
    "function of no file": lambda v: executed(f"def found(t): return {v} * t"),
    "class of no file": lambda v: executed(f"class found:\n def F(self): return {v}")(),
    "class decorator": lambda v: Times(scaled, v),
    "partial": lambda v: partial(scaled, x=v),
    "deque": lambda v: collections.deque([v]),
    "method": lambda v: [v].index,
    "expression": lambda v: ufl.as_ufl(v) * ufl.as_vector([1.0, 2.0]),
    "frozen": lambda v: scipy.stats.weibull_min(1.5, scale=v),
    "piecewise": lambda v: piecewise({0: 1.0, 1: v}),
    "law of a layer": lambda v: replace(LAYER, law=Spring(60.0, v)),
    "law of a place": lambda v: LinearElastic(lambda x: v + x[0], 40.0),
    "long array": lambda v: np.append(np.ones(100), v),
    "joint": lambda v: replace(JOINT, points=JOINT.points * v),
    "twice": lambda v: (lambda first, other: [first, other, first if v > 5 else other])(
        Times(scaled, 1.0), Times(scaled, 2.0)
    ),
}


def descriptions():
    return {name: [describe(thing(v)) for v in (5.0, 6.0)] for name, thing in THINGS.items()}


def test_things_are_the_same_in_another_process_and_others_if_they_differ():
    pairs = descriptions()
    assert [name for name, (first, other) in pairs.items() if first == other] == []
    code = "import json, thinlayer; from tests.test_identity import *; print(json.dumps(descriptions()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True,
                          env=os.environ | {"PYTHONHASHSEED": "1"}, cwd=Path(__file__).parents[1])  # fmt: skip
    there = json.loads(done.stdout)
    assert [name for name in pairs if there[name] != pairs[name]] == []


def frozen():
    variable = scipy.stats.norm()
    variable.random_state = np.random.default_rng(1)
    return variable


STATES = {
    "generator": (lambda: [np.random.default_rng(1)], lambda generators: generators[0].random()),
    "method": (lambda: np.random.default_rng(1).random, lambda draw: draw()),
    "legacy": (lambda: np.random.RandomState(1), lambda generator: generator.random()),
    "iterator": (lambda: iter([1.0, 2.0]), next),
    "sequence": (lambda: scipy.stats.qmc.Halton(1, seed=1), lambda points: points.random(1)),
    "frozen": (frozen, lambda variable: variable.rvs()),
}


@pytest.mark.parametrize("name", STATES)
def test_what_gives_other_numbers_each_time_has_a_state(name):
    make, draw = STATES[name]
    first, other = make(), make()
    states = [random_states(partial(scaled, generator))[0] for generator in (first, other)]
    assert states[0] == states[1] != []
    draw(first)
    assert random_states(partial(scaled, first))[0] != states[1]


def test_observed_functions_are_all_code_that_they_call():
    """And the numbers that they refer to, but no values that they collect."""

    def observed(function):
        return code_part(describe(function))

    for way in (functools.cache, partial, lambda f: lambda state: f(state), lambda f: Times(f, 1)):
        assert observed(way(scaled)) == observed(way(scaled)) != observed(way(same))
    first, again, other = (partial(same, collected, at=at) for collected, at in (([], 1), ([3.0], 1), ([], 2)))
    assert observed(first) == observed(again) != observed(other)


def test_what_no_other_process_knows_is_not_resumed(tmp_path, monkeypatch):
    numbers = (k for k in range(3))

    def model():
        return Structure(JOINT, tractions={"TOP": lambda x, t: (0.0, t * len([numbers]))}, **SETUP).interface(LAYER)

    march(model(), [0.1], out=tmp_path)
    monkeypatch.setattr(fingerprint, "PROCESS_LABEL", ", known to process 2 alone")
    words = r"is of another march \(loads.*builtins\.generator, known to process \w+ alone"
    refused(InputError, words, march, model(), [0.1, 0.3], out=tmp_path, resume=True)


def test_two_functions_on_one_mesh_are_two():
    V = Structure(JOINT, **SETUP).bonded().V
    u, other = fem.Function(V), fem.Function(V)
    assert describe(u) == describe(u) != describe(other)


def test_models_are_what_they_were_built_with():
    load, spring = np.array([0.0, 1.0]), ThinLayer(Spring(60.0, 40.0), 0.1, at=1.0)
    pulled = Structure(JOINT, **SETUP, tractions={"TOP": load})
    full, interface = pulled.full(spring), pulled.interface(spring)
    before = [json.dumps(model.identity()) for model in (full, interface)]
    load[1] = 2.0
    assert [json.dumps(model.identity()) for model in (full, interface)] == before
    assert 0 < compare(solve(full), solve(interface))["error_jump"] < 1
    read = Structure(JOINT, **SETUP, tractions={"TOP": lambda x, t: (load[0], load[1])})
    first, load[1] = read.full(spring), 3.0
    refused(InputError, r"same loads: .*2\.0 there, 3\.0 here", compare, solve(first), solve(read.interface(spring)))
