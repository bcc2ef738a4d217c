"""README's script runs as printed and prints the table that is printed; its pictures and studies exist."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from thinlayer.catalogue import studies

CLONE = Path(__file__).parent.parent
README = (CLONE / "README.md").read_text()


@pytest.mark.parametrize("number", [0, 1], ids=["lap", "creep"])
def test_script(tmp_path, number):
    scripts = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    tables = re.findall(r"^ +eps +error_traction.*?\n\n", README, re.DOTALL | re.MULTILINE)
    assert len(scripts) == len(tables) == 2
    (tmp_path / "script.py").write_text(scripts[number])
    done = subprocess.run([sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    wanted = [[float(x) for x in line.split()] for line in tables[number].splitlines()[1:] if line.strip()]
    found = [[float(x) for x in line.split()] for line in done.stdout.splitlines()[1:]]
    assert len(wanted) >= 3
    for a, b in zip(found, wanted, strict=True):
        assert a == pytest.approx(b, rel=2e-2)  # another gmsh may mesh a little differently
    assert {path.name for path in tmp_path.glob("*.png")} == ({"lap.png", "rates.png"} if number == 0 else set())


def test_scripts_are_short():
    first, second = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len([line for line in first.splitlines() if line.strip()]) <= 20
    law = second[second.index("@dataclass") : second.index("steel =")]
    assert len([line for line in law.splitlines() if line.strip()]) <= 17


def test_pictures_exist():
    for name in re.findall(r"\]\(([\w/]+\.(?:png|md|cff))\)", README):
        assert (CLONE / name).is_file(), name


def test_every_study_has_its_row():
    rows = re.findall(r"^\|.*\| `(\w+)` \| `\./fenicsx python3 -m thinlayer run (\w+)", README, re.MULTILINE)
    assert sorted(a for a, _ in rows) == sorted(studies())
    assert all(a == b for a, b in rows)
