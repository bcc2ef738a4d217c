"""The command line: what each command prints and writes, and its exit status."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import pytest
from petsc4py import PETSc

from tests.pictures import assert_drawn
from thinlayer.running import cli

CLONE = Path(__file__).parent.parent
ELASTIC = ("run", "rates", "--law", "elastic")


def process(*arguments: object) -> subprocess.CompletedProcess:
    """A command as users start it."""
    command = [sys.executable, "-m", "thinlayer", *map(str, arguments)]
    return subprocess.run(command, cwd=CLONE, capture_output=True, text=True, timeout=240)


def thinlayer(*arguments: object) -> subprocess.CompletedProcess:
    """The same without the seconds that imports take: its PETSc options end with it, an error that it does not expect
    is the test's."""
    words = list(map(str, arguments))
    before = PETSc.Options().getAll()
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        try:
            status = cli.main(words)
        except SystemExit as stop:
            status = stop.code
        finally:
            for name in PETSc.Options().getAll().keys() - before:
                PETSc.Options().delValue(name)
    return subprocess.CompletedProcess(words, status, out.getvalue(), err.getvalue())


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_list_is_light_and_matches_the_readme():
    probe = "import sys; from thinlayer.running.cli import main; main(['list', '--markdown']); "
    probe += "print([m for m in sys.modules if '.' not in m])"
    done = subprocess.run([sys.executable, "-c", probe], cwd=CLONE, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    *listed, modules = done.stdout.splitlines()
    assert not {"dolfinx", "petsc4py", "numpy", "gmsh", "pyvista"} & set(eval(modules))
    assert listed
    assert "\n".join(listed) in (CLONE / "README.md").read_text()


def test_sweep_with_options(tmp_path):
    options = ("-thinlayer_ksp_type", "cg", "-thinlayer_pc_type", "jacobi", "-thinlayer_ksp_rtol", "1e-11")
    study = ("run", "rates", "--law", "extended", "--quick", "--eps", "0.03125", "0.0625")
    done = thinlayer(*study, "--out", tmp_path, *options)
    assert done.returncode == 0, done.stderr
    table = rows(tmp_path / "table_extended.csv")
    assert list(table[0])[:5] == ["eps", "error_traction", "error_jump", "order_traction", "order_jump"]
    assert [float(row["eps"]) for row in table] == [0.0625, 0.03125]
    assert (table[0]["order_jump"], table[0]["order_traction"]) == ("", "")
    run = json.loads((tmp_path / "run.json").read_text())
    assert run["format"] == 1
    assert min(solve["iterations"] for solve in run["solves"]) > 20
    assert run["parameters"]["extended"]["h"] == 1 / 8
    assert run["parameters"]["FIFTHS"] == [0.2, 0.4, 0.6, 0.8, 1.0]  # a constant of the module
    assert_drawn(tmp_path / "rates_extended.png")


def test_limits_and_drawing_again(tmp_path):
    done = thinlayer("run", "limits", "--quick", "--out", tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    assert_drawn(tmp_path / "bonded.png")
    (tmp_path / "bonded.png").unlink()
    table = (tmp_path / "table.csv").read_bytes()
    assert thinlayer("draw", "limits", "--out", tmp_path).returncode == 0
    assert_drawn(tmp_path / "bonded.png")
    assert (tmp_path / "table.csv").read_bytes() == table
    assert "run the study first" in thinlayer("draw", "limits", "--out", tmp_path / "nothing").stderr
    other = thinlayer("draw", "rates", "--out", tmp_path)
    assert other.returncode == 2
    assert f"the run in {tmp_path} is of the study limits, not rates" in other.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("run fig7", "invalid choice: 'fig7' (choose from"),
        ("run limits --eps 0.1", "unrecognized argument '--eps'; --help has all; PETSc options start with -thinlayer_"),
        ("run rates --law elastic --eps -0.1", "thickness eps is -0.1; allowed: > 0"),
        ("run rates --law elastic --eps 0.1 0.1", "different thicknesses"),
        ("run rates --law elastic --quick -thinlayer_ksp_typ cg", "not read by the linear solver: -thinlayer_ksp_typ"),
        ("run rates --law elastic --quick -thinlayer_pc_type no", "one of these options: -thinlayer_pc_type no"),
        ("run rates --law elastic --quick --eps 1e9", "thickness eps is 1e+09, the bodies measure 1"),
    ],
)
def test_bad_input_writes_nothing(tmp_path, words, message):
    out = ["--out", tmp_path / "out"] if words.startswith("run") else []
    done = thinlayer(*words.split(), *out)
    assert done.returncode == 2, done.stderr
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_failed_check(tmp_path, capsys):
    """Thick layers are far from their limit: the sweep's own check of the order says so."""
    assert cli.main([*ELASTIC, "--quick", "--eps", "2", "4", "--out", str(tmp_path)]) == 1
    assert "checks failed: last observed order" in capsys.readouterr().err
    assert len(rows(tmp_path / "table_elastic.csv")) == 2


@pytest.mark.long
def test_verbose(tmp_path):
    """What solves do is told on standard error, and only there."""
    told = process(*ELASTIC, "--quick", "--eps", "0.1", "--out", tmp_path, "-v")
    assert told.returncode == 0
    assert "eps = 0.1, t = 0: linear, " in told.stderr
    assert "thinlayer." not in told.stdout
