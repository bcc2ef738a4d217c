"""./fenicsx: arguments, folder, exit status, settings; what it refuses, and its environments (made-up ones here)."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.documents import CLONE

LAUNCHER = CLONE / "fenicsx"
SET_BY_AN_OUTER_ONE = {"OMPI_MCA_shmem", "OMPI_MCA_mpi_yield_when_idle", "PYTHONPATH"}


def fenicsx(*command, cwd: Path, launcher: Path = LAUNCHER, **environment) -> subprocess.CompletedProcess:
    inherited = {name: value for name, value in os.environ.items() if name not in SET_BY_AN_OUTER_ONE}
    env = inherited | {name: str(value) for name, value in environment.items()}
    words = list(map(str, [launcher, *command]))
    return subprocess.run(words, cwd=cwd, env=env, capture_output=True, text=True, timeout=240, check=False)


def test_a_script_of_any_folder_finds_the_packages(tmp_path):
    folder = tmp_path / "a folder"
    folder.mkdir()
    (folder / "script.py").write_text("import forms, geometry, sys, os; print(sys.argv[1:], os.getcwd()); exit(7)")
    done = fenicsx("python3", "script.py", "two words", cwd=folder)
    assert done.returncode == 7, done.stderr
    assert done.stdout.strip() == f"['two words'] {folder}"


def test_help_and_bad_settings(tmp_path):
    done = fenicsx(cwd=tmp_path)
    assert done.returncode == 2
    assert "THINLAYER_CACHE" in done.stderr
    assert "THINLAYER_CACHE" in fenicsx("-h", cwd=tmp_path).stdout
    assert "unknown option --quick" in fenicsx("--quick", cwd=tmp_path).stderr
    assert "allowed: auto, host, root, wheels" in fenicsx("true", cwd=tmp_path, THINLAYER_ENV="conda").stderr


def test_a_copy_and_a_colon_are_refused(tmp_path):
    done = fenicsx("true", cwd=tmp_path, launcher=shutil.copy(LAUNCHER, tmp_path))
    assert done.returncode == 1
    assert "run fenicsx from its clone, or through a symbolic link" in done.stderr
    (tmp_path / "link").symlink_to(LAUNCHER)
    assert fenicsx("true", cwd=tmp_path, launcher=tmp_path / "link").returncode == 0
    done = fenicsx("true", cwd=tmp_path, THINLAYER_CACHE=tmp_path / "a:b")
    assert done.returncode == 1
    assert "has a colon in its name" in done.stderr


# ---------------------------------------------------------------- a private tree: a made-up one, entered by a stand-in
@pytest.fixture
def tree(tmp_path, monkeypatch):
    names = r"/^debian_packages=(/,/)$/p;/^key_of()/p;/^tree_name()/p"
    script = f'eval "$(sed -n {names!r} fenicsx)"; packages=.ci/packages.lock; tree_name trixie'
    name = subprocess.run(["bash", "-c", script], cwd=CLONE, check=True, stdout=subprocess.PIPE, text=True).stdout
    tree = tmp_path / "cache" / name.strip()
    needed = "usr/bin/env usr/lib/python3/a usr/local/venv/bin/python3 usr/bin/mpirun etc/ld.so.cache"
    for file in needed.split():
        (tree / file).parent.mkdir(parents=True, exist_ok=True)
        (tree / file).touch()
    (tree / "var").mkdir()
    (tmp_path / "bin").mkdir()
    stand_in = tmp_path / "bin" / "unshare"
    stand_in.write_text('#!/bin/bash\nuntil [ "$1" = /usr/bin/env ]; do shift || exit 0; done\nexec "$@"')
    stand_in.chmod(0o755)
    monkeypatch.setenv("PATH", f"{stand_in.parent}:{os.environ['PATH']}")
    monkeypatch.setenv("THINLAYER_CACHE", str(tree.parent))
    monkeypatch.setenv("THINLAYER_ENV", "root")
    monkeypatch.delenv("THINLAYER_SUITE", raising=False)
    return tree


def test_paths_that_the_tree_hides_are_refused(tree, tmp_path):
    (tmp_path / "link").symlink_to("/usr/lib")
    for word in ("/usr/lib/new", "--out=/usr/share/new", "link/new", "/no-such-folder"):
        done = fenicsx("echo", word, cwd=tmp_path)
        assert done.returncode == 1, word
        assert "use another folder" in done.stderr
        assert not done.stdout
    for word in ("/usr/bin/env", "/tmp/new", "new/file", "s/a/b/", "/no-such-folder/file", "/"):
        assert fenicsx("echo", word, cwd=tmp_path).stdout.strip() == word
