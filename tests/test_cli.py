"""The command line: what each command prints and writes, and its exit status."""

from __future__ import annotations

import csv
import json
import os
import pkgutil
import subprocess
import sys
import tomllib
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import dolfinx
import pytest
from petsc4py import PETSc

from tests.documents import CLONE
from thinlayer.running import cli
from thinlayer.running.catalogue import STUDY_GROUPS, duration_text
from thinlayer.system.version import VERSION

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


@pytest.fixture
def quiet(caplog):
    """Lets messages through again after the test."""
    caplog.set_level("NOTSET", "thinlayer")


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_list_is_light():
    probe = "import sys; from thinlayer.running.cli import main; main(['list']); "
    probe += "print([m for m in sys.modules if '.' not in m])"
    done = subprocess.run([sys.executable, "-c", probe], cwd=CLONE, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    *listed, modules = done.stdout.splitlines()
    assert not {"dolfinx", "petsc4py", "numpy", "gmsh", "pyvista"} & set(eval(modules))
    assert listed[0] == "The paper"
    assert max(map(len, listed)) <= 80
    assert "Benchmarks" not in listed


def test_every_study_is_in_a_group_once():
    """With its times; and in words these are short."""
    listed = [name for members in STUDY_GROUPS.values() for name in members]
    scripts = [
        path.stem
        for path in [*(CLONE / "studies").glob("*.py"), *(CLONE / ".ci/benchmarks").glob("*.py")]
        if "\ndef run(" in path.read_text()
    ]
    assert sorted(listed) == sorted(scripts)
    assert [duration_text(seconds) for seconds in (7.4, 82, 95, 1320, 9000)] == [
        "7 s",
        "80 s",
        "2 min",
        "20 min",
        "2 h",
    ]


def test_version_help_and_name(monkeypatch):
    assert thinlayer("-V").stdout == f"thinlayer {VERSION} (DOLFINx {dolfinx.__version__})\n"
    bare = thinlayer()
    assert (bare.returncode, bare.stderr) == (2, "")
    assert bare.stdout.startswith("usage: python3 -m thinlayer [-h] [-V] COMMAND")
    script = tomllib.loads((CLONE / "pyproject.toml").read_text())["project"]["scripts"]["thinlayer"]
    monkeypatch.setattr(sys, "argv", ["/usr/bin/thinlayer", "-V"])
    with redirect_stdout(StringIO()) as out:
        assert pkgutil.resolve_name(script)() == 0
    assert out.getvalue().startswith(f"thinlayer {VERSION}")


def test_answers_as_json():
    listed = json.loads(thinlayer("list", "--json").stdout)
    assert (listed["fig4_bar"]["group"], listed["law_speed"]["drawn"]) == ("The paper", False)
    assert [listed["wall"][of] for of in ("quick", "full")] == [*STUDY_GROUPS["Structures"]["wall"]]
    assert json.loads(thinlayer("info", "--json").stdout)["fenics-dolfinx"] == dolfinx.__version__


@pytest.mark.parametrize("words", ["run fig6", "run rates --res", "estimate studies/data/lap.t"])
def test_words_are_completed(words, tmp_path):
    pytest.importorskip("argcomplete")
    line = f"thinlayer {words}"
    asked = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_IFS": "\n"}
    asked |= {"_ARGCOMPLETE_STDOUT_FILENAME": str(tmp_path / "words")}
    subprocess.run([sys.executable, "-m", "thinlayer"], cwd=CLONE, env=os.environ | asked, check=True, timeout=240)
    assert (tmp_path / "words").read_text().strip() in ("fig6_stratified", "--resume", "studies/data/lap.toml")


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
    assert "slope 1" in (tmp_path / "rates_extended.svg").read_text()


def test_limits_and_drawing_again(tmp_path, quiet):
    """Quiet and without words where all checks hold."""
    done = thinlayer("run", "limits", "--quick", "-q", "--out", tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    drawn = (tmp_path / "bonded.svg").read_bytes()
    (tmp_path / "bonded.svg").unlink()
    table = (tmp_path / "table.csv").read_bytes()
    assert thinlayer("draw", "limits", "--out", tmp_path).returncode == 0
    assert (tmp_path / "bonded.svg").read_bytes() == drawn  # the same picture is the same file
    assert (tmp_path / "table.csv").read_bytes() == table
    assert (
        "run it first: python3 -m thinlayer run limits"
        in thinlayer("draw", "limits", "--out", tmp_path / "nothing").stderr
    )
    other = thinlayer("draw", "rates", "--out", tmp_path)
    assert other.returncode == 2
    assert f"the run in {tmp_path} is of the study limits, not rates" in other.stderr


def test_bad_input_writes_nothing(tmp_path):
    for words, message in [
        ("rnu limits", "unknown command 'rnu', did you mean 'run'?; known: draw, estimate, info, list, reproduce, "),
        ("run fig7", "thinlayer run: error: unknown study 'fig7'; known: bearing, "),
        ("run fig6", "unknown study 'fig6', did you mean 'fig6_stratified'?; known: "),
        ("run rates --law monodirectonal", "run rates: error: unknown law 'monodirectonal', did you mean 'monodirect"),
        ("run limits --qick", "limits: error: unknown option '--qick', did you mean '--quick'?; known: --help, --out"),
        ("run limits --quick 0.1", "run limits: error: unrecognized argument '0.1'; --help has all\n"),
        ("run limits -ksp_rtol 0.1", "argument '-ksp_rtol'; --help has all; PETSc options start with -thinlayer_\n"),
        ("run", "run: error: name a study:\nThe paper\n  fig3_mohr_coulomb"),
        ("estimate studies/data/lap.msh", "thinlayer estimate studies/data/lap.msh --new > lap.toml"),
        ("estimate studies/data/lap.toml --check --eps 0", "--set 'layer.eps=0'"),
        ("estimate studies/data/lap.toml --check --tolerance=-1", "--set 'tolerance=-1'"),
        ("estimate a.msh --new --set a=1", "estimate: error: --new reads a mesh file, which has no keys to --set"),
        ("run limits fig7", "unknown study 'fig7'; known: bearing, "),
        ("run --all -thinlayer_ksp_view", "PETSc options are those of one study"),
        ("reproduce -j 0", "studies at a time, -j is 0; allowed: 1 or more"),
        ("run limits -q -v", "argument -v/--verbose: not allowed with argument -q/--quiet"),
        ("run rates --law elastic --eps -0.1", "thickness eps is -0.1; allowed: > 0"),
        ("run rates --law elastic --eps 0.1 0.1", "different thicknesses"),
        ("run rates --law elastic --quick -thinlayer_ksp_typ cg", "not read by the linear solver: -thinlayer_ksp_typ"),
        ("run rates --law elastic --quick -thinlayer_pc_type no", "one of these options: -thinlayer_pc_type no"),
        ("run rates --law elastic --quick --eps 1e9", "thickness eps is 1e+09, the bodies measure 1"),
    ]:
        out = ["--out", tmp_path / "out"] if words.startswith("run ") else []
        done = thinlayer(*words.split(), *out)
        assert done.returncode == 2, done.stderr
        assert message in done.stderr
        assert "Error" not in done.stderr  # classes and tracebacks are for others
        assert not (tmp_path / "out").exists()


def test_failed_check(tmp_path, quiet):
    """Thick layers are far from their limit: the sweep's own check of the order says so, even if it is quiet."""
    done = thinlayer(*ELASTIC, "--quick", "-q", "--eps", "2", "4", "--out", tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    assert "checks failed: last observed order" in done.stderr
    assert len(rows(tmp_path / "table_elastic.csv")) == 2


@pytest.mark.long
def test_verbose(tmp_path):
    """What solves do is told on standard error, and only there."""
    completed = process(*ELASTIC, "--quick", "--eps", "0.1", "--out", tmp_path, "-v")
    assert completed.returncode == 0
    assert "eps = 0.1, t = 0: linear, " in completed.stderr
    assert "thinlayer." not in completed.stdout
