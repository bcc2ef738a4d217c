"""All that is told of structures whose traits are drawn at random is as it was.

The numbers and words are no truths, as in `test_golden`. `python3 -m tests.test_mixtures` writes them anew.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.mixtures import Mixture
from tests.on_ranks import on_ranks

NUMBERS = Path(__file__).with_name("mixtures.json")
COUNT, ON_RANKS = 63, (4, 21, 27)
CLOSE = 1e-4  # relative to a number, or to a thousandth of the largest of its answer: iterations end by tolerances
ROUNDING = 1e-9


def differences(answers: dict[str, list[Any]], golden: dict[str, list[Any]]) -> dict[str, Any]:
    """Answers that differ, computed and golden."""
    return {
        name: (answers.get(name), golden.get(name))
        for name in {**golden, **answers}
        if not is_same(answers.get(name, [name]), golden.get(name, []))
    }


def is_same(answer: list[Any], golden: list[Any]) -> bool:
    """Whether words are the same, and numbers close."""
    a, b = ([value if isinstance(value, str) else 0.0 for value in entries] for entries in (answer, golden))
    if a != b:
        return False
    x, y = (np.array([value for value in entries if not isinstance(value, str)], float) for entries in (answer, golden))
    least = CLOSE * 1e-3 * np.abs(y[np.isfinite(y)]).max(initial=0.0) + ROUNDING
    return np.allclose(x, y, rtol=CLOSE, atol=least, equal_nan=True)


def golden() -> dict[str, dict[str, list[Any]]]:
    return json.loads(NUMBERS.read_text(encoding="utf-8"))


@pytest.mark.few(12)
@pytest.mark.parametrize("seed", range(COUNT))
def test_mixture(seed: int, tmp_path: Path) -> None:
    assert not differences(Mixture(seed).all(tmp_path), golden()[str(seed)])


def on_two_ranks(folder: Path) -> dict[str, Any]:
    return {str(seed): Mixture(seed).all(folder / str(seed)) for seed in ON_RANKS}


@pytest.mark.long
@on_ranks(on_two_ranks, 2)
def test_mixtures_on_two_ranks(there: dict[str, Any]) -> None:
    for seed, answers in there.items():
        assert not differences(answers, golden()[seed])


if __name__ == "__main__":
    golden_answers = golden() if len(sys.argv) > 1 else {}
    for seed in sys.argv[1:] or map(str, range(COUNT)):
        with tempfile.TemporaryDirectory() as folder:
            golden_answers[seed] = Mixture(int(seed)).all(Path(folder))
    short = lambda value: float(f"{value:.6g}") if isinstance(value, float) else value
    for answers in golden_answers.values():
        answers.update({name: [*map(short, answer)] for name, answer in answers.items()})
    rows = [f'"{seed}": {json.dumps(golden_answers[seed])}' for seed in sorted(golden_answers, key=int)]
    NUMBERS.write_text("{" + ",\n".join(rows) + "}\n", encoding="utf-8")
