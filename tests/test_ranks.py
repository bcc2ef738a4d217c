"""Golden numbers on two ranks are in every run; all of them, and a few more, on several ranks in `.ci/run --long`."""

from __future__ import annotations

import json
from importlib import import_module
from typing import Any

import numpy as np
import pytest

from tests import test_golden
from tests.on_ranks import Asked, on_ranks

# a function in a module of the tests: the largest relative difference of its numbers
CASES = {"test_junction_tractions:numbers": 1e-10, "test_lines:numbers": 1e-9, "test_reactions:numbers": 1e-8}


# Cases that are in every run, or for one rank.
ALONE = (*test_golden.ON_RANKS, "contact")


def golden() -> dict[str, list[float]]:
    return {name: test_golden.numbers(name) for name in test_golden.CASES if name not in ALONE}


@pytest.mark.long
@on_ranks(golden, 2)
@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")
def test_all_golden_numbers(there: dict[str, list[float]]) -> None:
    for name, values in there.items():
        test_golden.assert_golden(name, values)


def assert_same(actual: Any, expected: Any, tolerance: float, name: str) -> None:
    if isinstance(expected, dict):
        assert list(actual) == list(expected), name
        for key, value in expected.items():
            assert_same(actual[key], value, tolerance, f"{name}, {key}")
    elif isinstance(expected, list) and any(isinstance(entry, dict | list) for entry in expected):
        for k, (entry, other) in enumerate(zip(actual, expected, strict=True)):
            assert_same(entry, other, tolerance, f"{name}, {k}")
    else:
        least = max(0.01 * tolerance * np.abs(expected).max(initial=0.0), 1e-3 * tolerance, 1e-12)
        assert actual == pytest.approx(expected, rel=tolerance, abs=least), name


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")
@pytest.mark.parametrize("there", [Asked(f"tests.{case}", n) for case in CASES for n in (2, 3)], ids=str, indirect=True)
def test_the_same_numbers(there: Any, request: pytest.FixtureRequest) -> None:
    module, name = request.node.callspec.params["there"].case.split(":")
    alone = json.loads(json.dumps(getattr(import_module(module), name)()))
    assert_same(there, alone, CASES[f"{module.removeprefix('tests.')}:{name}"], name)
