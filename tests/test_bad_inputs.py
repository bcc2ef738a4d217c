"""Bad inputs through every door: each has a clear error and its exit status; nothing is written, changed or executed."""

from __future__ import annotations

import pickle
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import forms
import geometry
import thinlayer
from forms.base import InputError
from tests.meshes import NAMES, squares
from tests.refused import refused
from tests.test_cli import thinlayer as command
from tests.viscous_joints import interface
from thinlayer.errors import LooseBody
from thinlayer.running.description import Description
from thinlayer.running.record import Record
from thinlayer.system.folder import append_sealed, read_sealed_lines

TABLE = tomllib.loads(Path(__file__).with_name("bad_inputs.toml").read_text(encoding="utf-8"))
LEAST = """
mesh = {path = "a.msh", upper = "UP"}  # two squares below two others
body = {E = 70e3, nu = 0.2}
layer = {E = 900, nu = 0.35, eps = 0.01}
supports = {BED = 0}
tractions = {TOP = [3, -50]}
"""
GLUE = forms.LinearElastic(3.0, 2.0)


def structure(**changed):
    data = {"body": forms.LinearElastic.young(90.0, 0.3), "supports": {"BOTTOM": 0}, "tractions": {"TOP": (1, 2)}}
    return thinlayer.Structure(geometry.sandwich(2.0, 1.0, 1.0, 1.0), **data | changed)


def model(**changed):
    return structure(**changed).interface(thinlayer.ThinLayer(GLUE, 0.1, at=1.0))


SCRIPT = {**vars(forms), **vars(geometry), **{name: getattr(thinlayer, name) for name in thinlayer.__all__}}
SCRIPT |= {"HUGE": 10**400, "NAN": float("nan"), "INF": float("inf"), "FLOAT32": np.float32}
SCRIPT |= {"goals": thinlayer.goals, "GLUE": GLUE, "structure": structure, "model": model}
of = lambda kind, *names: pytest.mark.parametrize(names, TABLE[kind])
pytestmark = pytest.mark.few(5)


@pytest.fixture
def sound(tmp_path):
    """A description and its mesh file."""
    squares(tmp_path / "a.msh", more=[("line", [[0, 1], [1, 2]], 3)], names=NAMES | {"BED": (3, 1)})
    (tmp_path / "a.toml").write_text(LEAST)
    return tmp_path / "a.toml"


content = lambda folder: {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def changed(file, old, new):
    """Change a file of characters of one byte each, where something stands first."""
    text, count = re.subn(old, new, file.read_text(), count=1, flags=re.DOTALL)
    assert count
    file.write_bytes(text.encode("latin-1"))


def assert_refused(words, file, *options):
    """The command ends with the status 2, and its message has all words; nothing is written or changed."""
    before = content(file.parent)
    done = command("estimate", file, "--out", file.parent / "out", *options)
    assert (done.returncode, [word for word in words if word not in done.stderr]) == (2, []), done.stderr
    assert not re.search("InputError|DescriptionError|Traceback", done.stderr)
    assert content(file.parent) == before
    return done.stderr


@of("settings", "setting", "words")
def test_settings(sound, setting, words):
    said = assert_refused((f"--set {setting!r}", words), sound, "--set", setting)
    assert str(sound) in said or said.startswith(f"thinlayer: --set {setting!r}")  # an option that cannot be read


@of("quantities", "settings", "words")
def test_quantities(sound, settings, words):
    refused(InputError, re.escape(words), Description.read, sound, settings.split("; "))


@of("files", "name", "old", "new", "words")
def test_files(sound, name, old, new, words):
    sound.write_text(LEAST.replace("a.msh", name if name != sound.name else "a.msh"))
    if name != sound.name:
        sound.with_name("a.msh").rename(sound.with_name(name))
    changed(sound.with_name(name), old, {"LONG": "9" * 400, "DEEP": "[" * 3000}.get(new, new))
    assert_refused((str(sound), name, words), sound)


@of("options", "options", "words")
def test_options(sound, options, words):
    assert_refused([words], sound, *options.split())


@of("python", "expression", "words")
def test_scripts(expression, words):
    refused(InputError, re.escape(words), eval, expression, SCRIPT)


def test_what_a_caller_changes_later():
    """It does not change the law."""
    C = np.diag([3.0, 3.0, 3.0, 1.0, 1.0, 1.0])
    law = forms.Anisotropic(C)
    C[:] = -1.0
    assert law.C.trace() == 12.0


def test_errors_of_other_processes():
    """A pool of processes waits for ever for an error that cannot be read."""
    error = LooseBody("the reason", "the motion", "the advice")
    error.history = structure
    loaded = pickle.loads(pickle.dumps(error))
    assert (type(loaded), str(loaded), loaded.motion, loaded.history) == (LooseBody, str(error), "the motion", None)


@of("runs", "old", "new")
def test_runs_that_were_changed(tmp_path, old, new):
    with Record("rates", tmp_path, {"law": "elastic"}) as record:
        record.sweep(lambda e: {"eps": e, "error_traction": e, "error_jump": e}, [0.1], "table_elastic.csv")
    changed(tmp_path / "run.json", old, new)
    before = content(tmp_path)
    for words in ("draw rates", "run rates --law elastic --quick", "run rates --law elastic --quick --resume"):
        done = command(*words.split(), "--out", tmp_path)
        assert (done.returncode, "run.json cannot be read (" in done.stderr) == (2, True), done.stderr
    assert content(tmp_path) == before


def test_checkpoints_of_another_version(tmp_path):
    thinlayer.march(interface(), [0.1], out=tmp_path)
    first, *_ = read_sealed_lines(tmp_path / "march.json")
    first["mark"]["format"] += 1
    (tmp_path / "march.json").unlink()
    append_sealed(tmp_path / "march.json", first)
    before = content(tmp_path)
    for resume in (True, False, "anyway"):
        words = r"march\.json' cannot be read \(it has the format 4 of another version, this one reads 3"
        refused(InputError, words, thinlayer.march, interface(), [0.1, 0.2], out=tmp_path, resume=resume)
    assert content(tmp_path) == before
