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


def test_script(tmp_path):
    (script,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len([line for line in script.splitlines() if line.strip()]) <= 20
    (tmp_path / "lap.py").write_text(script)
    environment_runs_anywhere = subprocess.run(
        [sys.executable, "lap.py"], cwd=tmp_path, capture_output=True, text=True, timeout=240
    )
    assert environment_runs_anywhere.returncode == 0, environment_runs_anywhere.stderr
    printed = re.search(r"^ +eps +error_traction.*?\n\n", README, re.DOTALL | re.MULTILINE)
    assert printed is not None
    wanted = [[float(x) for x in line.split()] for line in printed.group().splitlines()[1:] if line.strip()]
    found = [[float(x) for x in line.split()] for line in environment_runs_anywhere.stdout.splitlines()[1:]]
    assert len(wanted) == 4
    for a, b in zip(found, wanted, strict=True):
        assert a == pytest.approx(b, rel=2e-2)  # another gmsh may mesh a little differently
    assert {path.name for path in tmp_path.glob("*.png")} == {"lap.png", "rates.png"}


def test_pictures_exist():
    for name in re.findall(r"\]\(([\w/]+\.(?:png|md|cff))\)", README):
        assert (CLONE / name).is_file(), name


def test_every_study_has_its_row():
    rows = re.findall(r"^\|.*\| `(\w+)` \| `\./fenicsx python3 -m thinlayer run (\w+)", README, re.MULTILINE)
    assert sorted(a for a, _ in rows) == sorted(studies())
    assert all(a == b for a, b in rows)
