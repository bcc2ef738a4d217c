"""Descriptions of structures: each key, in a file and set anew, and what is said where it is wrong; without a mesh."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest

from forms import Anisotropic, Incompressible, LinearElastic, Norton, Rubber, Stack, VonMises
from tests.documents import CLONE
from tests.json_schema import is_valid
from tests.refused import refused
from thinlayer.running.description import Description
from thinlayer.running.toml_table import DescriptionError, read_input_file

LEAST = """
mesh = "joint.msh"
body = {E = 70e3, nu = 0.2}
layer = {E = 900, nu = 0.35, eps = 0.3}
tractions = {TOP = [3, -50]}
"""


def described(tmp_path, text, *settings):
    """The content of a description; what is read has the JSON schema."""
    (tmp_path / "joint.toml").write_text(text)
    description = Description.read(tmp_path / "joint.toml", settings)
    assert is_valid(read_input_file(tmp_path / "joint.toml", settings).values)
    return description


def lame(E, nu):
    law = LinearElastic.young(E, nu)
    return {"lmbda": pytest.approx(law.lmbda), "mu": pytest.approx(law.mu)}


# ---------------------------------------------------------------- keys
def test_all_keys(tmp_path):
    parsed = described(
        tmp_path,
        """
        mesh = {path = "joint.msh", S = "GLUE", upper = ["A", "B"], lower = "C", direction = [-1, 2], scale = 1e3}
        units = "mm, MPa"
        plane = "stress"
        element = "S2"
        bodies = "extended"
        times = [0.5, 2]
        bonded = true
        body_force = {A = [0, -1e-5], GLUE = [1e-6, 0]}
        body = {A = {E = 210e3, nu = 0.3}, B = {law = "VonMises", G = 80e3, K = 160e3, strength = 240}}
        layer = {law = "Norton", E = 2e3, nu = 0.4, eta = 7, p = 2, eps = 0.2, eigenstrain = -0.01}
        supports = {LEFT = 0, BOTTOM = {y = 0.5, n = 0}, "(40, -0.5)" = {x = 1}}
        tractions = {TOP = [3, -50], "RIGHT/A" = {pressure = 5}}
        loads = [{place = [1, 2], force = [0, -30], body = "A"}, {first = "TOP", second = "FRONT", force = [1, 2, 3]}]
        [goals]
        compliance = true
        pull = {kind = "displacement", x = [80, 1], direction = [1, 0], side = "upper"}
        reaction = {place = "LEFT", direction = [0, 1]}
        shear = {kind = "mean_traction", direction = [1, 0], seam = "S"}
        """,
    )
    sides = {"S": "GLUE", "upper": ["A", "B"], "lower": "C", "direction": (-1.0, 2.0), "scale": 1e3}
    assert parsed.mesh == {"path": str(tmp_path / "joint.msh"), **sides}
    assert (parsed.units, parsed.plane, parsed.element) == (("mm", "MPa"), "stress", "S2")
    assert (parsed.bodies, parsed.times, parsed.bonded) == ("extended", (0.5, 2.0), True)
    assert parsed.body_force == {"A": (0.0, -1e-5), "GLUE": (1e-6, 0.0)}
    assert parsed.body["A"].law.parameters() == lame(210e3, 0.3)
    assert isinstance(parsed.body["B"].law, VonMises)
    assert parsed.body["B"].law.lmbda == pytest.approx(160e3 - 2 * 80e3 / 3)
    layer = parsed.layer[None]
    assert isinstance(layer.law, Norton)
    assert (layer.law.eta, layer.law.p, layer.eps, layer.eigenstrain) == (7, 2, 0.2, -0.01)
    assert parsed.supports == {"LEFT": 0.0, "BOTTOM": {"y": 0.5, "n": 0.0}, (40.0, -0.5): {"x": 1.0}}
    assert parsed.tractions == {"TOP": (3.0, -50.0), "RIGHT/A": {"pressure": 5.0}}
    assert parsed.loads == (
        {"place": (1.0, 2.0), "force": (0.0, -30.0), "body": "A"},
        {"first": "TOP", "second": "FRONT", "force": (1.0, 2.0, 3.0)},
    )
    assert parsed.goals == {
        "compliance": {"kind": "compliance"},
        "pull": {"kind": "displacement", "x": (80.0, 1.0), "direction": (1.0, 0.0), "side": "upper"},
        "reaction": {"kind": "reaction", "place": "LEFT", "direction": (0.0, 1.0)},
        "shear": {"kind": "mean_traction", "direction": (1.0, 0.0), "seam": "S"},
    }


def test_least(tmp_path):
    parsed = described(tmp_path, LEAST)
    assert parsed.mesh == {"path": str(tmp_path / "joint.msh")}
    assert (parsed.bodies, parsed.times, parsed.goals, parsed.tolerance, parsed.bonded) == ("kept", (), {}, {}, False)
    assert described(tmp_path, LEAST + "tolerance = 0.07").tolerance == {"traction": 0.07}
    both = LEAST + "tolerance = {jump = 0.1, pull = 0.02}\ngoals = {pull = {kind = 'compliance'}}"
    assert described(tmp_path, both).tolerance == {"jump": 0.1, "pull": 0.02}
    assert described(tmp_path, LEAST + "body_force = [0, -2]").body_force == (0.0, -2.0)


@pytest.mark.parametrize("moduli", ["E = 26, nu = 0.3", "G = 10, nu = 0.3", "mu = 10, nu = 0.3", "lmbda = 15, mu = 10"])
def test_pairs_of_moduli(tmp_path, moduli):
    parsed = described(tmp_path, LEAST.replace("E = 900, nu = 0.35", moduli))
    assert parsed.layer[None].law.parameters() == lame(26, 0.3)


def test_other_laws(tmp_path):
    def law(text):
        return described(tmp_path, "times = [1]" + LEAST.replace("E = 900, nu = 0.35", text)).layer[None].law

    assert law('law = "Rubber", K = 100, G = 0.5') == Rubber(100 - 2 * 0.5 / 3, 0.5)
    assert law('law = "Incompressible", E = 6') == law('law = "Incompressible", mu = 2') == Incompressible(2.0)
    rows = ", ".join(str([2.0 * (i == j) for i in range(6)]) for j in range(6))
    springy = law(f'law = "Anisotropic", C = [{rows}], frame = "layer"')
    assert isinstance(springy, Anisotropic)
    assert np.array_equal(springy.C, 2 * np.eye(6))
    stack = law("sublayers = [{fraction = 0.4, E = 6, nu = 0.1}, {fraction = 0.6, G = 3, nu = 0.2}]")
    assert stack == Stack((0.4, LinearElastic.young(6, 0.1)), (0.6, LinearElastic.shear(3, 0.2)))


def test_histories(tmp_path):
    parsed = described(
        tmp_path,
        """
        times = [0.5, 2]
        supports = {LEFT = {x = {times = [0, 2], values = [0, 0.1]}, y = 0}}
        loads = [{place = [0, 1], force = {times = [0, 3.5], values = [[1, 2], [3, 4]]}}]
        """
        + LEAST,
        "tractions.TOP={times = [0, 2], values = [[0, 0], [3, -50]]}",
        "tractions.END={pressure = {times = [-1, 0.5, 2], values = [0, 5, 1]}}",
    )
    assert {".".join(history.key_path): dict(history.values) for history in parsed.file_table.time_series} == {
        "supports.LEFT.x": {0: 0, 2: 0.1},
        "tractions.TOP": {0: (0, 0), 2: (3, -50)},
        "tractions.END.pressure": {-1: 0, 0.5: 5, 2: 1},
        "loads.1.force": {0: (1, 2), 3.5: (3, 4)},
    }


# ---------------------------------------------------------------- refusals
def test_refused(tmp_path):
    for change, message in [
        (("tractions", "traction"), "unknown key 'traction', did you mean 'tractions'?; known: bodies, body, "),
        (('mesh = "joint.msh"', ""), "mesh is missing: the name of a mesh file"),
        (("E = 70e3, nu = 0.2", "E = 70e3, nu = 0.5"), "body: nu is 0.5; allowed: -1 < nu < 0.5"),
        (("E = 70e3, nu = 0.2", "A = {E = 1, nu = 0}, E = 3"), "body: it has tables with names beside keys without"),
        (("eps = 0.3", "epsilon = 0.3"), "layer: unknown key of LinearElastic 'epsilon', did you mean 'eps'?"),
        ((", eps = 0.3", ""), "layer: eps is missing: the thickness of the layer, a length"),
        (("E = 900", 'law = "Rubbr", E = 1'), "layer.law: unknown law of strains 'Rubbr', did you mean 'Rubber'?"),
        (("E = 900", 'law = "Norton", E = 1'), "layer: eta is missing: Norton has E and nu, G and nu, K and G, or"),
        (("[3, -50]", "5"), "tractions.TOP: 5 is not a vector; give 2 components"),
        (("[3, -50]", "{times = [1, 0], values = [1, 2]}"), "tractions.TOP: a time series is {times = [0, 1]"),
        (("[3, -50]", "{times = [0, 1], values = [[1, 2], [3, 4]]}"), "tractions.TOP: a time series needs times"),
        (
            ("[3, -50]}", "{times = [0, 1], values = [[0, 1], [0, 2]]}}\ntimes = [2]"),
            "tractions.TOP: the time series is from 0 to 1",
        ),
        (("tractions = {TOP = [3, -50]}", ""), "nothing loads the structure; give tractions, body_force, loads, or s"),
    ]:
        words = "^" + re.escape(f"{tmp_path / 'joint.toml'}: {message}")
        refused(DescriptionError, words, described, tmp_path, LEAST.replace(*change))


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(DescriptionError, match=r"joint\.toml is not TOML: .*\(at line 6, column \d+\)"):
        described(tmp_path, f"{LEAST}bonded = yes")
    refused(DescriptionError, r"no\.toml cannot be read: No such file", lambda: Description.read(tmp_path / "no.toml"))


# ---------------------------------------------------------------- keys set anew
PLACED = "loads = [{place = [1, 2], force = [0, 3]}]\nsupports = {'(40, 0)' = {y = 0}}\n"


def test_a_setting_says_what_a_file_may(tmp_path):
    for setting, key, value in [
        ("units = m, Pa", "units", ("m", "Pa")),
        ("times=[0.5, 2]", "times", (0.5, 2.0)),
        ("tractions.'B B'.pressure=4", "tractions", {"TOP": (3.0, -50.0), "B B": {"pressure": 4.0}}),
        ("tractions.TOP.2=9", "tractions", {"TOP": (3.0, 9.0)}),
        ("supports.'(40, 0)'.x=2", "supports", {(40.0, 0.0): {"y": 0.0, "x": 2.0}}),
        ("loads.1.force=[4, 5]", "loads", ({"place": (1.0, 2.0), "force": (4.0, 5.0)},)),
    ]:
        assert getattr(described(tmp_path, PLACED + LEAST, setting), key) == value


def test_settings_of_laws_and_meshes(tmp_path):
    """One parameter, a law with what it needs, the last one of a key; meshes of the command line are where it is."""
    parsed = described(tmp_path, LEAST, "layer.E=1", "layer.E=2e3", "layer.eps=0.1", "body.nu=0", "mesh.scale=1e3")
    assert (parsed.layer[None].law.parameters(), parsed.layer[None].eps) == (lame(2e3, 0.35), 0.1)
    assert parsed.body[None].law.parameters() == lame(70e3, 0)
    assert parsed.mesh == {"path": str(tmp_path / "joint.msh"), "scale": 1e3}
    other = described(tmp_path, LEAST, "layer.law=VonMises", "layer.strength=7", "mesh=b.msh")
    assert (other.layer[None].law.strength, other.mesh) == (7, {"path": "b.msh"})
    stack = "layer={eps = 1, sublayers = [{fraction = 0.4, E = 6, nu = 0.1}, {fraction = 0.6, G = 3, nu = 0.2}]}"
    (_, lower), (_, upper) = described(tmp_path, LEAST, stack, "layer.sublayers.2.G=5").layer[None].law.sublayers
    assert (lower, upper) == (LinearElastic.young(6, 0.1), LinearElastic.shear(5, 0.2))


def test_settings_refused(tmp_path):
    """With the option and the keys of the entry."""
    for setting, message in (
        ("times=1\nbonded=true", "times: '1\\nbonded=true' are not times"),
        ("times=[1, 1]", "times: [1, 1] are not times; give numbers > 0 that grow"),
        ("goals.traction=true", "goals.traction: every estimate has this quantity; give"),
        ("goals={reaction = {place = 'LEFT'}}", "goals.reaction: direction is missing: reaction has place"),
    ):
        refused(DescriptionError, re.escape(f"--set {setting!r}: {message}"), described, tmp_path, LEAST, setting)


def test_options_are_named_beside_the_file(tmp_path):
    """An option that cannot be read is told with its form."""
    for settings, message in (
        (["tolerance=0.1", "tolerance.jump=0.2"], "^--set 'tolerance.jump=0.2': 0.1 has no 'jump'"),
        (["layer={A = {E = 1, nu = 0, eps = 1}}", "tolerance=0.1"], "tolerance: a tolerance needs one layer for"),
        (["layer.E"], "^--set 'layer.E' cannot be read; give KEY=VALUE in TOML, such as layer.E=2e3"),
    ):
        refused(DescriptionError, message, lambda settings=settings: described(tmp_path, LEAST, *settings))


def test_bad_descriptions_are_refused_without_dolfinx(tmp_path):
    (tmp_path / "a.toml").write_text(LEAST.replace("nu = 0.35", "nuu = 0.35"))
    probe = (
        "import sys; from thinlayer.running.cli import main; status = main(['estimate', sys.argv[1]]); "
        "print(status, {'dolfinx', 'petsc4py'} & set(sys.modules))"
    )
    command = [sys.executable, "-c", probe, str(tmp_path / "a.toml")]
    done = subprocess.run(command, cwd=CLONE, capture_output=True, text=True, timeout=240)
    assert done.stdout == "2 set()\n"
    assert "a.toml: layer: unknown key of LinearElastic 'nuu', did you mean 'nu'?" in done.stderr
