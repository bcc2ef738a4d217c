"""Forms and kernels are compiled once per law: not again for other thicknesses, parameters, steps or meshes."""

from __future__ import annotations

import signal
import subprocess
import sys

import dolfinx.jit
import pytest
import ufl

from forms import Incompressible, LinearElastic, Maxwell, Norton, Stack
from forms.base import InputError
from geometry import faults
from studies.problems import fourier
from tests.documents import CLONE
from tests.own_laws import Cubic
from tests.refused import refused
from thinlayer import Structure, Surface, ThinLayer, compare, drive, march
from thinlayer.pointwise import compiled_law
from thinlayer.system import progress
from thinlayer.system.compilation import lock_library

pytestmark = pytest.mark.few(5)

NORTON = Norton(60.0, 40.0, 5.0, 1.5)


@pytest.fixture
def modules(monkeypatch):
    """Names of the compiled modules, one for each time that the compiler was asked."""
    names = []
    compiled = dolfinx.jit.ffcx_jit

    def recorded(*arguments, **options):
        result = compiled(*arguments, **options)
        names.append(result[1].__name__)
        return result

    monkeypatch.setattr(dolfinx.jit, "ffcx_jit", recorded)
    return names


def run(law, eps: float, times, h: float = 1 / 4, theta: float = 1.0, factor: float = 1.0) -> None:
    """Both models marched, and compared."""
    joint, setup = fourier(h, cell="quadrilateral")
    setup["tractions"] = {"TOP": lambda x, t: (0.1 * t, ufl.cos(ufl.pi * x[0]))}
    setup["body"] = LinearElastic.young(100.0 * factor, 0.3)
    layer = ThinLayer(law, eps, at=1.0)
    models = (build(Structure(joint, **setup), layer) for build in (Structure.full, Structure.interface))
    compare(*(march(model, times, theta=theta) for model in models))


PAIRS = [
    (Maxwell(60.0, 40.0, 0.7), Maxwell(50.0, 30.0, 0.5, 2.0)),
    (Incompressible(40.0), Incompressible(30.0)),
    (
        Stack((0.5, LinearElastic(60.0, 40.0)), (0.5, LinearElastic(30.0, 20.0))),
        Stack((0.2, LinearElastic(50.0, 40.0)), (0.8, LinearElastic(30.0, 10.0))),
    ),
]


@pytest.mark.parametrize(("law", "other"), PAIRS)
def test_compiled_once(law, other, modules):
    run(law, 0.1, [0.1])
    first = set(modules)
    assert len(first) > 5
    finer = dict(law=law, eps=0.05, times=[0.1, 0.2, 0.5], h=1 / 8)
    for change in (finer, dict(law=other, eps=0.1, times=[0.1, 0.2], theta=0.5, factor=2.0)):
        run(**change)
        assert set(modules) == first, change


@pytest.mark.parametrize("law", [LinearElastic(60.0, 40.0), NORTON, Cubic(30.0, 2.0)])
def test_compiled_once_for_all_seams(law, modules):
    """Three seams ask for the code of one."""
    module_sets = []
    for heights in ([0.4], [0.25, 0.5, 0.75]):
        modules.clear()
        joint = faults(1.3, 1.0, {f"S {y}": ((0.0, y), (1.3, y)) for y in heights}, 0.3)
        data = {"body": LinearElastic.young(100.0, 0.3), "tractions": {"TOP": (0.1, 0.2)}, "supports": {"BOTTOM": 0}}
        state = march(Structure(joint, **data).interface(ThinLayer(law, 0.01, at=1.0)), [0.1]).last
        Surface(state.model).traction(state)
        module_sets.append({*modules})
    assert module_sets[1] <= module_sets[0]


@pytest.mark.parametrize(("build", "law"), [(Structure.full, Incompressible(40.0)), (Structure.interface, NORTON)])
def test_steps_ask_for_nothing(build, law, modules):
    """After the first state of a march nothing is asked of the compiler, not even what it has on the disk."""
    joint, setup = fourier(1 / 4, cell="quadrilateral")
    asked = []
    observe = {"asked": lambda state: asked.append(len(modules)) or 0.0}
    march(build(Structure(joint, **setup), ThinLayer(law, 0.1, at=1.0)), [0.1, 0.2, 0.3], observe=observe)
    assert [len(asked), len(set(asked))] == [4, 1]
    assert asked[0] > 0


def test_what_was_made_before_does_not_matter(modules, monkeypatch):
    """UFL counts variables in a process; a law has the same name in the cache under any count."""
    for _ in range(2):
        monkeypatch.setattr(compiled_law, "_COMPILED_BY_NAME", {})
        drive(NORTON, [{"w_T": 0.01, "w_N": 0.02}], dt=0.1)
        ufl.variable(ufl.as_ufl(1.0))
    assert len(modules) == 2
    assert len(set(modules)) == 1


# ---------------------------------------------------------------- the folder of compiled forms
FORM = """
import os, signal, sys, time
from pathlib import Path
import thinlayer.system.compilation
import cffi, ufl
from dolfinx import fem, mesh
from mpi4py import MPI

def compiled(folder):
    domain = mesh.create_unit_interval(MPI.COMM_SELF, 2)
    return fem.form(ufl.SpatialCoordinate(domain)[0] ** 2 * ufl.dx, jit_options=dict(cache_dir=folder, timeout=0))
"""
KILLED = FORM + "cffi.FFI.compile = lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL)\ncompiled(sys.argv[1])"
SLOWLY = "lambda *a, **k: (os.write(1, b'#\\n'), time.sleep(0.5), build(*a, **k))[2]"
SLOW = f"{FORM}build = cffi.FFI.compile\ncffi.FFI.compile = {SLOWLY}\ncompiled(sys.argv[1])"


@pytest.fixture
def compiled():
    names: dict = {}
    exec(FORM, names)
    return names["compiled"]


def kept(folder):
    return sorted("".join(file.suffixes[-2:]) for file in folder.iterdir() if file.name.startswith("libffcx"))


def test_a_cache_that_cannot_be_written(tmp_path):
    (tmp_path / "file").touch()
    words = "compiled forms cannot be kept in .*: Not a directory; set XDG_"
    refused(InputError, words, lock_library, tmp_path / "file/a", "b")


def test_a_killed_compilation_is_repeated(tmp_path, compiled):
    done = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], cwd=CLONE, timeout=240)
    assert done.returncode == -signal.SIGKILL
    assert kept(tmp_path) == []
    assert any(file.is_dir() for file in tmp_path.iterdir())
    assert compiled(tmp_path).module
    assert len(kept(tmp_path)) == 3
    assert not any(file.is_dir() for file in tmp_path.iterdir())
    # what FFCx itself leaves behind when it is killed; a half-written library
    for lost in (("*.so", "*.cached"), ("*.so",), ("*.c",), ()):
        for pattern in lost:
            next(tmp_path.glob(pattern)).unlink()
        if not lost:
            library = next(tmp_path.glob("*.so"))
            library.unlink()  # it is loaded: its content must stay
            library.touch()
        assert compiled(tmp_path).module
        assert len(kept(tmp_path)) == 3, lost


def test_a_long_compilation_is_told_and_waited_for_by_another_process(tmp_path, compiled, capfd, monkeypatch):
    """Off a terminal too, and longer than FFCx's timeout (here none); what it made is used, of which nothing is told."""
    slow = "from thinlayer.system import progress\nprogress.FIRST_REPORT_SECONDS['terminal'] = 0.2\n" + SLOW
    words, pipes = [sys.executable, "-c", slow, str(tmp_path)], {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(words, cwd=CLONE, text=True, **pipes) as other:
        other.stdout.readline()
        form = compiled(tmp_path)
        assert kept(tmp_path)
        assert form.code == (None, None)  # nothing was compiled here
        assert other.stderr.read() == "compiling a form, kept for later runs, 0:00:00 so far\n"
        assert other.wait(240) == 0
    monkeypatch.setitem(progress.FIRST_REPORT_SECONDS, "terminal", 0.0)
    capfd.readouterr()
    assert compiled(tmp_path).module
    assert capfd.readouterr().err == ""
