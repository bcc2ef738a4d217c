"""./fenicsx: arguments, folder, exit status, settings; what it refuses, and its environments (made-up ones here)."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

CLONE = Path(__file__).parent.parent
LAUNCHER = CLONE / "fenicsx"
SET_BY_AN_OUTER_ONE = {"OMPI_MCA_shmem", "OMPI_MCA_mpi_yield_when_idle", "PYTHONPATH"}


def fenicsx(
    *command: object, cwd: Path, launcher: Path = LAUNCHER, **environment: object
) -> subprocess.CompletedProcess:
    inherited = {name: value for name, value in os.environ.items() if name not in SET_BY_AN_OUTER_ONE}
    return subprocess.run(
        list(map(str, [launcher, *command])),
        cwd=cwd,
        env=inherited | {name: str(value) for name, value in environment.items()},
        capture_output=True,
        text=True,
        timeout=240,
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
    for option in ("--help", "-h"):
        done = fenicsx(option, cwd=tmp_path)
        assert done.returncode == 0
        assert "THINLAYER_CACHE" in done.stdout
    done = fenicsx("--quick", cwd=tmp_path)
    assert done.returncode == 2
    assert "unknown option --quick" in done.stderr
    done = fenicsx("true", cwd=tmp_path, THINLAYER_ENV="conda")
    assert done.returncode == 1
    assert "allowed: auto, host, root" in done.stderr


def test_a_copy_and_a_colon_are_refused(tmp_path):
    done = fenicsx("true", cwd=tmp_path, launcher=shutil.copy(LAUNCHER, tmp_path))
    assert done.returncode == 1
    assert "run fenicsx from its clone, or through a symbolic link" in done.stderr
    (tmp_path / "link").symlink_to(LAUNCHER)
    assert fenicsx("true", cwd=tmp_path, launcher=tmp_path / "link").returncode == 0
    done = fenicsx("true", cwd=tmp_path, THINLAYER_CACHE=tmp_path / "a:b")
    assert done.returncode == 1
    assert "has a colon in its name" in done.stderr


def test_variables_of_the_caller_come_through(tmp_path, monkeypatch):
    """Those, too, that have the names of the launcher's own."""
    monkeypatch.setenv("HOST", "cluster 7")
    monkeypatch.setenv("TREE", "oak")
    monkeypatch.delenv("HERE", raising=False)
    show = "import os; print([os.environ.get(name) for name in ('HOST', 'TREE', 'HERE')])"
    assert fenicsx("python3", "-c", show, cwd=tmp_path).stdout.strip() == "['cluster 7', 'oak', None]"


def test_no_shared_memory_is_left(tmp_path):
    """Open MPI would leave 16 MB in /dev/shm for each process that is not run by mpirun."""
    show = "from mpi4py import MPI; print([line for line in open('/proc/self/maps') if '/dev/shm' in line])"
    done = fenicsx("python3", "-c", show, cwd=tmp_path)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core")
def test_ranks_that_wait_leave_their_core_where_there_are_fewer_cores(tmp_path):
    mpirun = tmp_path / "mpirun"
    mpirun.write_text('#!/bin/sh\necho "$OMPI_MCA_mpi_yield_when_idle"')
    mpirun.chmod(0o755)
    for words, yields in (("-n 1", ""), ("--np 999", "1"), ("-n 1 a : -np 999 b", "1")):
        assert fenicsx(mpirun, *words.split(), "true", cwd=tmp_path).stdout.strip() == yields, words
    done = subprocess.run(
        ["taskset", "-c", str(min(os.sched_getaffinity(0))), LAUNCHER, mpirun], stdout=subprocess.PIPE
    )
    assert done.stdout == b"1\n"


# ---------------------------------------------------------------- what lies in the working folder
def test_files_of_the_same_name_are_told(tmp_path):
    (tmp_path / "forms.py").touch()
    (tmp_path / "script.py").write_text("import thinlayer")
    done = fenicsx("python3", "script.py", cwd=tmp_path)
    assert done.returncode == 1
    assert f"{tmp_path / 'forms.py'} hides the package forms of thinlayer, in {CLONE / 'forms'}" in done.stderr
    (tmp_path / "studies").mkdir()
    (tmp_path / "studies" / "__init__.py").touch()
    done = fenicsx("python3", "-m", "thinlayer", "list", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "rates" in done.stdout


@pytest.mark.long
def test_the_working_folder_decides_nothing(tmp_path):
    """Of a study that the command line runs: neither options of PETSc nor where and how forms are compiled."""
    (tmp_path / "petscrc").write_text("-options_view\n")
    (tmp_path / "dolfinx_jit_options.json").write_text('{"cache_dir": "elsewhere"}')
    (tmp_path / "ffcx_options.json").write_text('{"scalar_type": "float32"}')
    # refused after PETSc has started
    study = ["run", "rates", "--law", "elastic", "--quick", "--eps", "1e9", "--out", "a"]
    done = fenicsx("python3", "-m", "thinlayer", *study, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "options_view" not in done.stdout + done.stderr
    script = (
        "from thinlayer.running.process import ignore_working_folder\n"
        "ignore_working_folder()\n"
        "import dolfinx.jit, ffcx\n"
        "print(dolfinx.jit.get_options()['cache_dir'], ffcx.get_options()['scalar_type'])"
    )
    done = fenicsx("python3", "-c", script, cwd=tmp_path, XDG_CACHE_HOME=tmp_path / "b")
    assert done.stdout.split()[0] == str(tmp_path / "b" / "fenics"), done.stdout + done.stderr
    assert "float64" in done.stdout
    assert "options_view" not in done.stdout


# ---------------------------------------------------------------- a private tree: a made-up one, entered by a stand-in
@pytest.fixture
def tree(tmp_path, monkeypatch):
    names = r"/^DEBIAN_PACKAGES=(/,/)$/p;/^key_of()/p;/^tree_name()/p"
    script = f'eval "$(sed -n {names!r} fenicsx)"; PACKAGES_KEY=$(<.ci/packages.lock); tree_name trixie'
    name = subprocess.run(["bash", "-c", script], cwd=CLONE, check=True, stdout=subprocess.PIPE, text=True).stdout
    tree = tmp_path / "cache" / name.strip()
    for file in (
        ".files",
        "usr/bin/env",
        "usr/lib/python3/a",
        "usr/local/venv/bin/python3",
        "usr/bin/mpirun",
        "etc/ld.so.cache",
    ):
        (tree / file).parent.mkdir(parents=True, exist_ok=True)
        (tree / file).touch()
    (tree / "var").mkdir()
    (tree / ".files").write_text("5")
    (tmp_path / "bin").mkdir()
    stand_in = tmp_path / "bin" / "bwrap"
    stand_in.write_text('#!/bin/bash\nuntil [ "$1" = /usr/bin/env ]; do shift; done\nexec "$@"')
    stand_in.chmod(0o755)
    monkeypatch.setenv("PATH", f"{stand_in.parent}:{os.environ['PATH']}")
    monkeypatch.setenv("THINLAYER_CACHE", str(tree.parent))
    monkeypatch.setenv("THINLAYER_ENV", "root")
    monkeypatch.setenv("THINLAYER_ENTER", "bwrap")
    monkeypatch.delenv("THINLAYER_SUITE", raising=False)
    return tree


def test_paths_that_the_tree_hides_are_refused(tree, tmp_path):
    (tmp_path / "link").symlink_to("/usr/lib")
    for word in ("/usr/lib/new", "--out=/usr/share/new", "link/new", "/no-such-folder"):
        done = fenicsx("echo", word, cwd=tmp_path)
        assert done.returncode == 1, word
        assert "use another folder" in done.stderr
        assert not done.stdout
    for word in (
        "/usr/bin/env",
        "/run/new",
        "/tmp/new",
        "/proc/self",
        "new/file",
        "s/a/b/",
        "/no-such-folder/file",
        "/",
    ):
        assert fenicsx("echo", word, cwd=tmp_path).stdout.strip() == word


def test_lost_files_are_told_after_a_failure(tree, tmp_path):
    assert not fenicsx("false", cwd=tmp_path).stderr
    (tree / "usr/lib/python3/a").unlink()
    assert not fenicsx("true", cwd=tmp_path).stderr
    done = fenicsx("false", cwd=tmp_path)
    assert done.returncode == 1
    assert "has lost files: it has 4 of 5" in done.stderr
    assert "the next start builds it anew" in done.stderr
    assert not (tree / ".files").exists()


def test_a_killed_launcher_leaves_nothing_running(tree, tmp_path):
    words = [LAUNCHER, "bash", "-c", "setsid sleep 50 & echo $!; wait"]
    with subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.PIPE, text=True) as launcher:
        assert launcher.stdout is not None
        process = Path("/proc", launcher.stdout.readline().strip())
        assert process.name
        assert process.exists()
        launcher.kill()
    for _ in range(1000):
        time.sleep(0.05)
        if not process.exists():
            return
    os.kill(int(process.name), signal.SIGKILL)
    pytest.fail("a process of the command is left")


def test_unused_environments_are_deleted(tree, tmp_path):
    old, used = (tree.parent / f"trixie-{digit * 12}" for digit in "01")
    for folder in (old, used):
        folder.mkdir()
    with subprocess.Popen(["sleep", "50"], env={"A": f"{used}/usr", "PATH": os.environ["PATH"]}) as user:
        done = fenicsx("--clean", cwd=tmp_path)
        user.kill()
    assert done.returncode == 0
    assert f"process {user.pid} runs there: {used}" in done.stderr
    assert used.exists()
    assert tree.exists()
    assert not old.exists()
