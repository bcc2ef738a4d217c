"""Things that loads and laws refer to: what a resumed march or sweep tells apart, and what it cannot."""

from __future__ import annotations

import argparse
import array
import collections
import datetime
import decimal
import importlib
import json
import operator
import subprocess
import sys
import types
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import ufl

from forms import KelvinVoigt
from tests.test_identity import Spring
from tests.viscous_joints import JOINT, SETUP, SLOW
from thinlayer import ModelError, Structure, ThinLayer, compare, march, solve, sweep
from thinlayer.identity import known
from thinlayer.identity.described import described

LAYER = ThinLayer(SLOW, 0.1, at=1.0)


class Chain(collections.deque):
    def __init__(self, values, scale):
        super().__init__(values)
        self.scale = scale


class Named(dict):
    unit = "mm"


THINGS = {
    "namespace": lambda v: types.SimpleNamespace(F=v),
    "arguments": lambda v: argparse.Namespace(F=v),
    "range": lambda v: range(int(v)),
    "deque": lambda v: collections.deque([v]),
    "own deque": lambda v: Chain([v], 1.0),
    "own attribute": lambda v: Chain([1.0], v),
    "own mapping": lambda v: Named(F=v),
    "decimal": decimal.Decimal,
    "time": lambda v: datetime.timedelta(seconds=v),
    "array": lambda v: array.array("d", [v]),
    "memory": lambda v: memoryview(np.array([v])),
    "values": lambda v: {"F": v}.values(),
    "items": lambda v: {"F": v}.items(),
    "getter": lambda v: operator.itemgetter(int(v)),
    "method": lambda v: [v].index,
    "masked": lambda v: np.ma.array([1.0, 2.0], mask=[v > 5, False]),
    "polynomial": lambda v: np.polynomial.Polynomial([0.0, v]),
    "expression": lambda v: ufl.as_ufl(v) * ufl.as_vector([1.0, 2.0]),
    "large": lambda v: 10**400 + int(v),
    "beyond the digits of floats": lambda v: 2**60 + int(v),
    "keys": lambda v: {(v, 1): 2.0},
    "ufunc": lambda v: np.sin if v > 5 else np.cos,
}


def holding(thing):
    return lambda x, t: thing


def descriptions():
    return {name: [described(holding(thing(v))) for v in (5.0, 6.0)] for name, thing in THINGS.items()}


def test_things_are_the_same_in_another_process_and_others_if_they_differ():
    found = descriptions()
    assert [name for name, (one, other) in found.items() if one == other] == []
    code = "import json; from tests.test_described_things import *; print(json.dumps(descriptions()))"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=Path(__file__).parents[1]
    )
    assert json.loads(done.stdout) == found


def test_modules_of_the_user_are_what_the_code_reads_of_them(tmp_path, monkeypatch):
    module = types.ModuleType("settings_of_a_test")
    module.F, module.other, module.np = 5.0, 1.0, np

    def load(x, t):
        return module.F * t

    def passed_on(x, t):
        return dict(vars(module))["F"] * t

    def imported(x, t):
        from settings_in_a_file import F

        return F * t

    file = tmp_path / "settings_in_a_file.py"
    monkeypatch.syspath_prepend(tmp_path)
    file.write_text("F = 5.0\n")
    before = [described(one) for one in (load, passed_on, imported)]
    module.other = 2.0
    assert described(load) == before[0]
    assert described(passed_on) != before[1]
    module.F = 6.0
    file.write_text("F = 6.00\n")
    importlib.reload(sys.modules["settings_in_a_file"])
    for one, was in zip((load, passed_on, imported), before, strict=True):
        assert described(one) != was


def test_what_no_other_process_knows_is_not_resumed(tmp_path, monkeypatch):
    numbers = (k for k in range(3))

    def run(e):
        return {"eps": e, "error_traction": e, "error_jump": e + 0 * len([numbers])}

    def load(x, t):
        return (0.0, t * len([numbers]))

    model = Structure(JOINT, tractions={"TOP": load}, **SETUP).interface(LAYER)
    march(model, [0.1], out=tmp_path / "m")
    sweep(run, [0.4], tmp_path / "t.csv")
    assert len(march(model, [0.1, 0.2], out=tmp_path / "m", resume=True)) == 3
    monkeypatch.setattr(known, "PROCESS", "another")
    with pytest.raises(
        ModelError, match=r"is of another march \(loads: .*builtins\.generator, which no other process knows"
    ):
        march(
            Structure(JOINT, tractions={"TOP": load}, **SETUP).interface(LAYER),
            [0.1, 0.3],
            out=tmp_path / "m",
            resume=True,
        )
    with pytest.raises(ModelError, match=r"another sweep \(numbers: builtins\.generator, which no other process knows"):
        sweep(run, [0.4, 0.2], tmp_path / "t.csv", resume=True)


def test_objects_with_an_identity_of_their_own(tmp_path):
    """numpy's polynomials have a function of this name; the package asks its own types alone."""
    line = np.polynomial.Polynomial([0.0, 2.0])
    tractions = {"TOP": lambda x, t: (0.0, line(t))}
    model = Structure(JOINT, tractions=tractions, **SETUP).interface(LAYER)
    assert march(model, [0.1], out=tmp_path).t == pytest.approx([0.0, 0.1])


READ = []


@dataclass(frozen=True)
class Logged(KelvinVoigt):
    def stress(self, step):
        READ.append("stress")
        return super().stress(step)


def test_laws_that_change_what_they_refer_to_as_they_are_read(tmp_path):
    model = Structure(JOINT, **SETUP).interface(ThinLayer(Logged(60.0, 40.0, 0.3, 0.5), 0.1, at=1.0))
    for _ in range(2):
        assert march(model, [0.1, 0.2], out=tmp_path).t == pytest.approx([0.0, 0.1, 0.2])
    READ.clear()
    with pytest.raises(ModelError, match="what the model's law refers to has changed"):
        march(model, [0.1])


def test_models_are_what_they_were_built_with(tmp_path, monkeypatch):
    load, scale = np.array([0.0, 1.0]), {"F": 1.0}
    data, spring = SETUP | {"tractions": {"TOP": load}}, ThinLayer(Spring(60.0, 40.0), 0.1, at=1.0)
    pulled = Structure(JOINT, **data)
    full, interface = pulled.full(spring), pulled.interface(spring)
    other = Structure(JOINT, **data | {"tractions": {"TOP": lambda x, t: (0.0, scale["F"])}}).interface(LAYER)
    before = [json.dumps(one.identity()) for one in (full, interface, other)]
    load[1], scale["F"] = 2.0, 2.0
    assert [json.dumps(one.identity()) for one in (full, interface, other)] == before
    assert 0 < compare(solve(full), solve(interface))["error_jump"] < 1
    with pytest.raises(ModelError, match="needs the same loads"):
        compare(solve(full), solve(Structure(JOINT, **data).interface(spring)))
    monkeypatch.setattr(Spring, "RATIO", 0.6)
    for find in (solve, lambda model: march(model, [0.1], out=tmp_path)):
        with pytest.raises(ModelError, match="what the model's law refers to has changed since the model was built"):
            find(interface)
    assert not [*tmp_path.iterdir()]
