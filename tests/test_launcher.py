"""./fenicsx where FEniCSx already is (the suite runs there): arguments, folder and exit status pass through."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

LAUNCHER = Path(__file__).parent.parent / "fenicsx"


def fenicsx(*command: str, cwd: Path, **environment: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [str(LAUNCHER), *command],
        cwd=cwd,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_a_script_of_any_folder_finds_the_packages(tmp_path):
    folder = tmp_path / "a folder"
    folder.mkdir()
    (folder / "script.py").write_text("import forms, geometry, sys, os; print(sys.argv[1:], os.getcwd())")
    done = fenicsx("python3", "script.py", "two words", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == f"['two words'] {folder}"


def test_exit_status(tmp_path):
    assert fenicsx("python3", "-c", "raise SystemExit(7)", cwd=tmp_path).returncode == 7


def test_help_and_bad_settings(tmp_path):
    done = fenicsx(cwd=tmp_path)
    assert done.returncode == 2
    assert "THINLAYER_CACHE" in done.stderr
    done = fenicsx("true", cwd=tmp_path, THINLAYER_ENV="conda")
    assert done.returncode == 1
    assert "allowed: auto, host, root" in done.stderr
