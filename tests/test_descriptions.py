"""Descriptions of structures: each key and each short form, and what is said where something is wrong; without a mesh."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from forms import Anisotropic, Incompressible, KelvinVoigt, LinearElastic, MohrCoulomb, Norton, Rubber, Stack, VonMises
from tests.refused import refused
from thinlayer.describing.description import Description
from thinlayer.describing.section import DescriptionError
from thinlayer.describing.source import Source, sorted_files
from thinlayer.running.arguments import command_line
from thinlayer.running.asked import Asked

CLONE = Path(__file__).parent.parent
LEAST = """
mesh = "joint.msh"
body = {E = 70e3, nu = 0.2}
layer = {E = 900, nu = 0.35, eps = 0.3}
tractions = {TOP = [3, -50]}
"""


def source(tmp_path, text):
    path = tmp_path / "joint.toml"
    path.write_text(text)
    return Source.read(path)


def described(tmp_path, text):
    return Description.of(source(tmp_path, text).section())


def words(*arguments):
    return Asked.of(command_line().parse_args(["estimate", *arguments])).description


def lame(E, nu):
    law = LinearElastic.young(E, nu)
    return {"lmbda": pytest.approx(law.lmbda), "mu": pytest.approx(law.mu)}


# ---------------------------------------------------------------- keys
def test_all_keys(tmp_path):
    found = described(
        tmp_path,
        """
        mesh = {path = "joint.msh", S = "GLUE", upper = ["A", "B"], lower = "C", scale = 1e3}
        units = "mm, MPa"
        plane = "stress"
        element = "S2"
        bodies = "extended"
        times = [0.5, 2]
        bonded = true
        body_force = {A = [0, -1e-5], GLUE = [1e-6, 0]}
        [body.A]
        E = 210e3
        nu = 0.3
        [body.B]
        law = "VonMises"
        G = 80e3
        K = 160e3
        strength = 240
        [layer]
        law = "Norton"
        E = 2e3
        nu = 0.4
        eta = 7
        p = 2
        eps = 0.2
        eigenstrain = -0.01
        [supports]
        LEFT = 0
        BOTTOM = {y = 0.5, n = 0}
        "(40, -0.5)" = {x = 1}
        [tractions]
        TOP = [3, -50]
        "RIGHT/A" = {pressure = 5}
        [[loads]]
        place = [1, 2]
        force = [0, -30]
        body = "A"
        [[loads]]
        first = "TOP"
        second = "FRONT"
        force = [1, 2, 3]
        [goals]
        compliance = true
        pull = {kind = "displacement", x = [80, 1], direction = [1, 0], side = "upper"}
        reaction = {place = "LEFT", direction = [0, 1]}
        shear = {kind = "mean_traction", direction = [1, 0], seam = "S"}
        """,
    )
    assert found.mesh.path == tmp_path / "joint.msh"
    assert found.mesh.arguments == {"S": "GLUE", "upper": ("A", "B"), "lower": "C", "scale": 1e3}
    assert (found.units, found.plane, found.element) == (("mm", "MPa"), "stress", "S2")
    assert (found.bodies, found.times, found.bonded) == ("extended", (0.5, 2.0), True)
    assert found.body_force == {"A": (0.0, -1e-5), "GLUE": (1e-6, 0.0)}
    assert found.body["A"].law.parameters() == lame(210e3, 0.3)
    assert isinstance(found.body["B"].law, VonMises)
    assert found.body["B"].law.lmbda == pytest.approx(160e3 - 2 * 80e3 / 3)
    layer = found.layer[None]
    assert isinstance(layer.law, Norton)
    assert (layer.law.eta, layer.law.p, layer.eps, layer.eigenstrain) == (7, 2, 0.2, -0.01)
    assert found.supports == {"LEFT": 0.0, "BOTTOM": {"y": 0.5, "n": 0.0}, (40.0, -0.5): {"x": 1.0}}
    assert found.tractions == {"TOP": (3.0, -50.0), "RIGHT/A": {"pressure": 5.0}}
    assert [one.arguments for one in found.loads] == [
        {"place": (1.0, 2.0), "force": (0.0, -30.0), "body": "A"},
        {"first": "TOP", "second": "FRONT", "force": (1.0, 2.0, 3.0)},
    ]
    assert {name: one.kind for name, one in found.goals.items()} == {
        "compliance": "compliance",
        "pull": "displacement",
        "reaction": "reaction",
        "shear": "mean_traction",
    }
    assert found.goals["pull"].arguments == {"x": (80.0, 1.0), "direction": (1.0, 0.0), "side": "upper"}


def test_least(tmp_path):
    found = described(tmp_path, LEAST)
    assert found.mesh.arguments == {}
    assert (found.bodies, found.times, found.goals, found.tolerance, found.bonded) == ("kept", (), {}, {}, False)
    assert described(tmp_path, LEAST + "tolerance = 0.07").tolerance == {"traction": 0.07}
    both = LEAST + "tolerance = {jump = 0.1, pull = 0.02}\ngoals = {pull = {kind = 'compliance'}}"
    assert described(tmp_path, both).tolerance == {"jump": 0.1, "pull": 0.02}
    assert described(tmp_path, LEAST + "body_force = [0, -2]").body_force == (0.0, -2.0)


@pytest.mark.parametrize("moduli", ["E = 26, nu = 0.3", "G = 10, nu = 0.3", "mu = 10, nu = 0.3", "lmbda = 15, mu = 10"])
def test_pairs_of_moduli(tmp_path, moduli):
    found = described(tmp_path, LEAST.replace("E = 900, nu = 0.35", moduli))
    assert found.layer[None].law.parameters() == lame(26, 0.3)


def test_other_laws(tmp_path):
    def law(text):
        return described(tmp_path, "times = [1]" + LEAST.replace("E = 900, nu = 0.35", text)).layer[None].law

    assert law('law = "Rubber", K = 100, G = 0.5') == Rubber(100 - 2 * 0.5 / 3, 0.5)
    assert law('law = "Incompressible", E = 6') == law('law = "Incompressible", mu = 2') == Incompressible(2.0)
    assert isinstance(law('law = "KelvinVoigt", E = 6, nu = 0.1, theta_lmbda = 1, theta_mu = 2'), KelvinVoigt)
    slip = law('law = "MohrCoulomb", E = 6, nu = 0.1, cohesion = 0.3, friction_angle = 30')
    assert isinstance(slip, MohrCoulomb)
    assert slip.cohesion == 0.3
    rows = ", ".join(str([2.0 * (i == j) for i in range(6)]) for j in range(6))
    springy = law(f'law = "Anisotropic", C = [{rows}], frame = "layer"')
    assert isinstance(springy, Anisotropic)
    assert np.array_equal(springy.C, 2 * np.eye(6))
    stack = law("sublayers = [{fraction = 0.4, E = 6, nu = 0.1}, {fraction = 0.6, G = 3, nu = 0.2}]")
    assert stack == Stack((0.4, LinearElastic.young(6, 0.1)), (0.6, LinearElastic.shear(3, 0.2)))


def test_histories(tmp_path):
    found = described(
        tmp_path,
        """
        times = [0.5, 2]
        supports = {LEFT = {x = {times = [0, 2], values = [0, 0.1]}, y = 0}}
        loads = [{place = [0, 1], force = {times = [0, 3.5], values = [[1, 2], [3, 4]]}}]
        """
        + LEAST.replace(
            "[3, -50]",
            "{times = [0, 2], values = [[0, 0], [3, -50]]}, "
            "END = {pressure = {times = [-1, 0.5, 2], values = [0, 5, 1]}}",
        ),
    )
    assert {".".join(path): dict(one.values) for path, one in found.histories.items()} == {
        "supports.LEFT.x": {0: 0, 2: 0.1},
        "tractions.TOP": {0: (0, 0), 2: (3, -50)},
        "tractions.END": {-1: 0, 0.5: 5, 2: 1},
        "loads.1.force": {0: (1, 2), 3.5: (3, 4)},
    }


# ---------------------------------------------------------------- refusals
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("tractions", "traction"), "unknown key 'traction', did you mean 'tractions'?; known: bodies, body, "),
        (('mesh = "joint.msh"', ""), "mesh is missing: the name of a mesh file"),
        (('"joint.msh"', "3"), "mesh: 3 is no table; it has path and arguments of read"),
        (('"joint.msh"', '{S = "GLUE"}'), "mesh: path is missing"),
        (('"joint.msh"', '{path = "a.msh", uper = "A"}'), "mesh: unknown key 'uper', did you mean 'upper'?"),
        (('"joint.msh"', '{path = "a.msh", scale = 0}'), "mesh.scale: 0 is not > 0"),
        (("body = {E = 70e3, nu = 0.2}", ""), "body is missing: the parameters of a law, such as E and nu, in a table"),
        (("E = 70e3, nu = 0.2", "E = 70e3, nu = 0.5"), "body.nu: nu is 0.5; allowed: -1 < nu < 0.5; laws with nu ="),
        (("E = 70e3, nu = 0.2", "E = 70e3"), "body: moduli are E; LinearElastic has a pair: E and nu"),
        (("E = 70e3, nu = 0.2", "E = -1, nu = 0.2"), "body.E: -1 is not > 0; it is a modulus"),
        (("E = 70e3, nu = 0.2", "E = 1, nu = 0.2, G = 3"), "body: moduli are E and nu and G; LinearElastic has a pair"),
        (("E = 70e3, nu = 0.2", "A = {E = 1, nu = 0}, E = 3"), "body: it has tables with names beside keys without"),
        (("eps = 0.3", "epsilon = 0.3"), "layer: unknown key of LinearElastic 'epsilon', did you mean 'eps'?"),
        ((", eps = 0.3", ""), "layer: eps is missing: the thickness of the layer, a length"),
        (("eps = 0.3", "eps = 0"), "layer.eps: 0 is not > 0; it is the thickness of the layer"),
        (("E = 900", 'law = "LinearElastik", E = 1'), "layer.law: unknown law 'LinearElastik', did you mean 'LinearEl"),
        (("E = 900", 'law = "Tresca", E = 1'), "layer.law: Tresca is no law of strains with a thickness; laws here:"),
        (("E = 900", 'law = "Norton", E = 1'), "layer: eta is missing; Norton has E and nu, G and nu, K and G, or"),
        (("E = 900", 'law = "Norton", E = 1, eta = "a", p = 1'), "layer.eta: 'a' is no finite number"),
        (("E = 900", 'law = "Norton", E = 1, eta = 3, p = 0.5'), "layer: Norton: p is 0.5; allowed: > 1"),
        (("E = 900, nu = 0.35", 'law = "Incompressible"'), "layer: moduli are missing; Incompressible has one: mu"),
        (("[3, -50]", "[3]"), "tractions.TOP: [3] is no vector; give 2 components, in 3D 3"),
        (("[3, -50]", "5"), "tractions.TOP: 5 is no vector; give its components, or {pressure = 5}"),
        (("[3, -50]", "{press = 5}"), "tractions.TOP: unknown key 'press', did you mean 'pressure'?"),
        (("[3, -50]", "{times = [0], values = [[1, 2]]}"), "tractions.TOP: a history is {times = [0, 1], values ="),
        (("[3, -50]", "{times = [1, 0], values = [1, 2]}"), "tractions.TOP: a history is {times = [0, 1], values ="),
        (("[3, -50]", "{times = [0, 1]}"), "tractions.TOP: values is missing: a history has times and values"),
        (("[3, -50]", "{times = [0, 1], values = [[1, 2], 3]}"), "tractions.TOP.values.2: 3 is no vector; give its"),
        (("[3, -50]", "{times = [0, 1], values = [[1, 2], [3, 4]]}"), "tractions.TOP: a history needs times, the ends"),
        (
            ("[3, -50]}", "{times = [0, 1], values = [[1, 2], [3, 4]]}}\ntimes = [2]"),
            "tractions.TOP: it is given from 0 to 1, and times go from 0 to 2",
        ),
        (("E = 900", 'law = "KelvinVoigt", theta_lmbda = 1, theta_mu = 1, E = 1'), "times is missing: KelvinVoigt"),
        (("[3, -50]", "[3, nan]"), "tractions.TOP: [3, nan] is no vector"),
        (("tractions = {TOP = [3, -50]}", ""), "nothing loads the structure; give tractions, body_force, loads, or s"),
    ],
)
def test_refused(tmp_path, change, message):
    with pytest.raises(DescriptionError) as error:
        described(tmp_path, LEAST.replace(*change))
    assert str(error.value).startswith(f"{tmp_path / 'joint.toml'}: {message}")


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ('units = "mm"', "units: 'mm' are not two units; give those of lengths and of stresses, such as 'mm, MPa'"),
        ('plane = "strian"', "plane: unknown choice 'strian', did you mean 'strain'?; known: axisymmetric, strain, st"),
        ('element = "P1"', "element: P1 is not of degree 2, which the better law needs; allowed: P2, Q2, S2"),
        ("bodies = true", "bodies: true is no text; allowed: kept, extended"),
        ("bonded = 1", "bonded: 1 is neither true nor false"),
        ("times = [1, 1]", "times: [1, 1] are no times; give numbers > 0 that grow"),
        ("tolerance = 0", "tolerance.traction: 0 is not > 0; it is the largest relative change that is allowed"),
        ("tolerance = {tration = 0.1}", "tolerance: unknown quantity 'tration', did you mean 'traction'?; known:"),
        ("body_force = 3", "body_force: 3 is no vector"),
        ("supports = {LEFT = true}", "supports.LEFT: True is no finite number"),
        ("supports = {LEFT = {u = 0}}", "supports.LEFT: unknown component 'u'; known: n, x, y, z"),
        ("supports = {LEFT = {}}", "supports.LEFT: no component is given, such as {x = 0}"),
        ('supports = {"(1, a)" = 0}', "supports.(1, a): a place is the name of a facet set, or the coordinates"),
        ('supports = {"(1, 2)" = {n = 0}}', "supports.(1, 2): unknown component 'n'; known: x, y, z"),
        ("loads = [{place = [1, 2]}]", "loads.1: force is missing: the vector of the force"),
        ('loads = [{first = "TOP", force = [1, 2]}]', "loads.1: second is missing: where the load acts"),
        ("loads = {place = [1, 2]}", "loads: {'place': [1, 2]} is no list of tables"),
        ("goals = {stiffness = true}", "goals.stiffness: what is asked for? give kind, one of compliance, reaction"),
        ("goals = {traction = true}", "goals.traction: this quantity is told of every layer"),
        ('goals = {reaction = {place = "LEFT"}}', "goals.reaction: direction is missing: reaction has place"),
        ("goals = {compliance = 3}", "goals.compliance: 3 is no table; it has arguments of a goal, or is true"),
        ("goals = {compliance = {x = [1, 2]}}", "goals.compliance: unknown key of compliance 'x'; known: kind"),
        (
            'goals = {displacement = {x = [1, 2], direction = [1, 0], side = "top"}}',
            "goals.displacement.side: unknown choice 'top'; known: lower, upper",
        ),
    ],
)
def test_more_refused(tmp_path, more, message):
    with pytest.raises(DescriptionError) as error:
        described(tmp_path, f"{LEAST}\n{more}")
    assert str(error.value).startswith(f"{tmp_path / 'joint.toml'}: {message}")


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(DescriptionError, match=r"joint\.toml is no TOML: .*\(at line 6, column \d+\)"):
        described(tmp_path, f"{LEAST}bonded = yes")
    refused(DescriptionError, r"no\.toml cannot be read: No such file", lambda: Source.read(tmp_path / "no.toml"))
    refused(DescriptionError, r"two mesh files are given, a\.msh and b.vtu", lambda: sorted_files(["a.msh", "b.vtu"]))
    refused(DescriptionError, r"two descriptions are given, a\.toml and b.py", lambda: sorted_files(["a.toml", "b.py"]))


# ---------------------------------------------------------------- words
def test_words_alone():
    """A structure in the words of the command line, with names that have blanks."""
    found = words(
        "lap.msh", "--S", "GLUE LINE", "--upper", "A,B B", "--direction=-1,2", "--scale", "1e3", "--units", "m,Pa",
        "--body", "A: E=1 nu=0.1", "--body", "B B: VonMises E=2 nu=0.2 strength=3", "--layer", "G=2 nu=0.4 eps=0.2",
        "--support", "LEFT SIDE=0", "--support", "RIGHT SIDE x=0.5 n=0", "--support", "(40, -1) y=0",
        "--support", "END: x=1",
        "--load", "TOP SIDE=-3,-50", "--load", "TOP/A pressure=5", "--load", "(1,2)=0,-30", "--load", "(1,3)=0,-3 body=B B",
        "--body-force", "A=0,-1", "--goal", "compliance", "--goal", "pull: displacement x=1,2 direction=0,1",
        "--goal", "reaction place='LEFT SIDE' direction=1,0", "--tolerance", "0.05", "--tolerance", "pull=0.1", "--bonded",
    )  # fmt: skip
    assert found.mesh.path == Path("lap.msh")
    sides = {"S": "GLUE LINE", "upper": ("A", "B B"), "direction": (-1.0, 2.0), "scale": 1e3}
    assert found.mesh.arguments == sides
    assert [*found.body] == ["A", "B B"]
    assert found.body["B B"].law.strength == 3
    assert found.layer[None].eps == 0.2
    shown = {"LEFT SIDE": 0.0, "RIGHT SIDE": {"x": 0.5, "n": 0.0}, (40.0, -1.0): {"y": 0.0}, "END": {"x": 1.0}}
    assert found.supports == shown
    assert found.tractions == {"TOP SIDE": (-3.0, -50.0), "TOP/A": {"pressure": 5.0}}
    assert [one.arguments for one in found.loads] == [
        {"place": (1.0, 2.0), "force": (0.0, -30.0)},
        {"place": (1.0, 3.0), "force": (0.0, -3.0), "body": "B B"},
    ]
    assert found.body_force == {"A": (0.0, -1.0)}
    assert [*found.goals] == ["compliance", "pull", "reaction"]
    assert found.goals["reaction"].arguments == {"place": "LEFT SIDE", "direction": (1.0, 0.0)}
    assert found.tolerance == {"traction": 0.05, "pull": 0.1}
    assert (found.units, found.bonded) == (("m", "Pa"), True)


def test_numbers_may_be_names():
    """Those of groups without names."""
    more = ("--body", "E=1 nu=0", "--layer", "E=1 nu=0 eps=1", "--load", "3=1,0", "--support", "4=0")
    found = words("a.vtu", "--S", "7", "--upper", "2", "--goal", "reaction place=4 direction=1,0", *more)
    assert found.mesh.arguments == {"S": "7", "upper": "2"}
    assert found.goals["reaction"].arguments["place"] == "4"


def test_words_beside_a_file(tmp_path):
    """Parameters change those of the file, a law that is named replaces the law; other entries are replaced or added."""
    (tmp_path / "a.toml").write_text(
        LEAST.replace("body = {", "body = {B = {E = 1, nu = 0}, A = {").replace("0.2}", "0.2}}") + "tolerance = 0.3"
    )
    path = str(tmp_path / "a.toml")
    (tmp_path / "b.toml").write_text(LEAST)
    assert words(path).mesh.path == tmp_path / "joint.msh"
    assert words(path, "b.msh").mesh.path == Path("b.msh")
    thinner = words(path, "--layer", "eps=0.1").layer[None]
    assert (thinner.eps, thinner.law) == (0.1, LinearElastic(*LinearElastic.young(900, 0.35).parameters().values()))
    other = words(path, "--layer", "Incompressible mu=3 eps=2").layer[None]
    assert (other.eps, other.law) == (2.0, Incompressible(3.0))
    several = words(path, "--layer", "BED: E=1 nu=0 eps=1", "--layer", "HEAD: E=2 nu=0 eps=1").layer
    assert [*several] == ["BED", "HEAD"]
    bodies = words(path, "--body", "A: E=5").body
    assert bodies["A"].law.parameters() == lame(5, 0.2)
    assert bodies["B"].law.parameters() == lame(1, 0)
    assert words(path, "--body", "E=7 nu=0.1").body[None].law.parameters() == lame(7, 0.1)
    assert words(path, "--load", "TOP=1,2", "--load", "END=3,4").tractions == {"TOP": (1.0, 2.0), "END": (3.0, 4.0)}
    assert words(path, "--tolerance", "jump=0.1").tolerance == {"traction": 0.3, "jump": 0.1}
    assert words(str(path).replace("a.toml", "b.toml"), "--times", "2").times == (2.0,)
    assert words(path, "--S", "GLUE").mesh.arguments == {"S": "GLUE"}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("--layer", "E=1 nu=0 eps=a"), "--layer 'E=1 nu=0 eps=a': eps: 'a' is no finite number"),
        (("--layer", "Linear Elastic E=1"), "'Linear' and 'Elastic' cannot be a law; --layer takes"),
        (("--layer", ""), "nothing cannot be a law; --layer takes"),
        (("--layer", "E=1 E=2"), "E is given twice; --layer takes"),
        (("--layer", "E="), "E= has no value; --layer takes"),
        (("--layer", "nuu=0.1"), "--layer 'nuu=0.1': unknown key of LinearElastic 'nuu', did you mean 'nu'?"),
        (("--body", "A: 'E=1"), "No closing quotation; --body takes"),
        (("--support", "LEFT"), "'LEFT' cannot be read; --support takes \"PLACE=VALUE\""),
        (("--support", "LEFT=a"), "--support 'LEFT=a': 'a' is no finite number"),
        (("--load", "TOP=5"), "--load 'TOP=5': 5 is no vector; give its components, or {pressure = 5}"),
        (("--load", "TOP=1,2 body=A"), "body= is for forces at points; --load takes"),
        (("--goal", "reaction LEFT"), "'reaction' and 'LEFT' cannot be a goal; --goal takes"),
        (("--goal", "compliance", "--goal", "compliance"), "--goal 'compliance': two goals are named 'compliance'"),
        (("--tolerance", "much"), "--tolerance 'much': 'much' is no finite number"),
        (("--times", "2,1"), "--times: [2.0, 1.0] are no times"),
        (("--times", "soon"), "--times: 'soon' are no times"),
        (("--plane", "flat"), "--plane: unknown choice 'flat'"),
    ],
)
def test_words_refused(tmp_path, given, message):
    (tmp_path / "a.toml").write_text(LEAST)
    with pytest.raises(DescriptionError) as error:
        words(str(tmp_path / "a.toml"), *given)
    assert str(error.value).startswith(message)


def test_words_beside_what_is_no_table(tmp_path):
    """What the file says is not dropped in silence."""
    (tmp_path / "a.toml").write_text(f"{LEAST}\nbody_force = [0, -1]\nsupports = 3")
    path = str(tmp_path / "a.toml")
    with pytest.raises(
        DescriptionError, match=r"a\.toml: body_force: \[0, -1\] is no table of names, to which --body-force"
    ):
        words(path, "--body-force", "A=0,-2")
    with pytest.raises(
        DescriptionError, match=r"a\.toml: supports: 3 is no table of names, to which --support 'LEFT=0'"
    ):
        words(path, "--support", "LEFT=0")


def test_bad_descriptions_are_refused_without_dolfinx(tmp_path):
    (tmp_path / "a.toml").write_text(LEAST.replace("nu = 0.35", "nuu = 0.35"))
    probe = (
        "import sys; from thinlayer.running.cli import main; status = main(['estimate', sys.argv[1]]); "
        "print(status, {'dolfinx', 'petsc4py', 'mpi4py'} & set(sys.modules))"
    )
    command = [sys.executable, "-c", probe, str(tmp_path / "a.toml")]
    done = subprocess.run(command, cwd=CLONE, capture_output=True, text=True, timeout=240)
    assert done.stdout == "2 set()\n"
    assert "a.toml: layer: unknown key of LinearElastic 'nuu', did you mean 'nu'?" in done.stderr
