"""What results are made from: descriptions that are the same in another process, and differ where results may."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from forms.laws import LinearElastic
from tests.test_marching import JOINT, SETUP, SLOW
from thinlayer import Model, ModelError, ThinLayer, march, piecewise
from thinlayer.identity import code_of, described, referred

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
    assert referred(row).keys() == {"code", "scaled"}
    assert len(repr(JOINT)) < 200


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (dict(tractions={"TOP": piecewise({0: (0.0, 1.0), 1: (0.0, 1.1)})}), "loads"),
        (dict(layer=ThinLayer(SLOW, 0.1, profile=lambda x: 1 + 0.2 * x[0])), "profile"),
        (dict(supports=SETUP["supports"] | {"RIGHT": {"x": lambda x, t: 0.01 * t}}), "supports"),
        (dict(joint=replace(JOINT, facets=JOINT.facets | {"LEFT": JOINT.facets["RIGHT"], "RIGHT": JOINT.facets["LEFT"]})),
         "facets"),
        (dict(joint=JOINT.swapped()), "regions"),
    ],
    ids=["piecewise", "profile", "moving support", "facets", "sides"],
)  # fmt: skip
def test_a_march_of_other_data_is_not_resumed(tmp_path, change, what):
    data = SETUP | {
        "layer": ThinLayer(SLOW, 0.1, profile=lambda x: 1 + 0.1 * x[0]),
        "supports": SETUP["supports"] | {"RIGHT": {"x": lambda x, t: 0.02 * t}},
        "tractions": {"TOP": piecewise({0: (0.0, 1.0), 1: (0.0, 2.0)})},
    }
    march(Model.interface(JOINT, **data), [0.1], out=tmp_path)
    other = Model.interface(change.pop("joint", JOINT), **(data | change))
    with pytest.raises(ModelError, match=rf"is of another march \(.*{what}: "):
        march(other, [0.1, 0.2], out=tmp_path, resume=True)
    assert len(march(Model.interface(JOINT, **data), [0.1, 0.2], out=tmp_path, resume=True)) == 3
