"""A remedy in a refusal is a call that works: none sends to another refusal."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, ClassVar

import numpy as np
import pytest
import ufl

from forms import (
    Anisotropic,
    BulkLaw,
    Conduction,
    HolonomicCoulomb,
    Incompressible,
    KelvinVoigt,
    LinearElastic,
    Maxwell,
    NonMonotone,
    NonMonotoneUnrelaxed,
    Rubber,
    Stack,
)  # fmt: skip
from forms.base import InputError
from geometry import disc, fibre, periodic, ring, sandwich, wall
from tests.documents import CLONE
from tests.own_laws import Cubic, Damaging
from tests.refused import refused
from tests.test_tips import in_one_body, partly
from thinlayer import (
    Bond,
    Gap,
    PointLoad,
    Probe,
    Structure,
    ThinLayer,
    Zoom,
    estimate,
    goals,
    homogenised_stiffness,
    march,
    solve,
    solve_to,
    thin_enough,
)  # fmt: skip
from thinlayer.errors import RangeWarning


@dataclass(frozen=True)
class Cracked(BulkLaw):
    """A law that softens, and is cracked at rest."""

    mu: float
    softens: ClassVar = True

    def stress(self, step):
        return 2 * self.mu * (ufl.inner(step.mid, step.mid) - 0.01) * step.mid


class Sound(Cracked):
    """The same with the stiffness of the sound material."""

    def stiffness(self, n):
        return 2 * self.mu * np.eye(6)


SOFT, BODY, CHI = LinearElastic(3.0, 2.0), LinearElastic.young(400.0, 0.2), np.array([[0.0, 0.5], [0.5, 0.0]])
WELLS, SHEETS = NonMonotone(60.0, 40.0, 1.2, 0.02, CHI, mixing=0.5), NonMonotoneUnrelaxed(60.0, 40.0, 1.2, 0.02, CHI)
KELVIN, CREEP, FLUID = KelvinVoigt(3.0, 2.0, 1.0, 1.0), Maxwell(3.0, 2.0, t1=1.0), Maxwell(60.0, 1.0, t1=1.0)
CUBIC, STACK = Cubic(2.0, 3.0), Stack((0.4, SOFT), (0.6, BODY))
RUBBER, FLAWED = Rubber(60.0, 1.0), Damaging(3.0, 2.0, 0.5, 6.0)
COULOMB, SKEW = HolonomicCoulomb(200.0, 80.0, 0.5), np.diag([9.0, 8.0, 7.0, 3.0, 2.0, 1.0])
WATER, SOLID = Incompressible(1.0), Rubber.shear(1.0, 0.4999)
ONE: dict[str, Any] = {"order": 1}
FREE: dict[str, Any] = {"order": 1, "edges": "free"}
quads = partial(sandwich, 4.0, 1.0, 1.2, 0.5, cell="quadrilateral")
triangles = partial(sandwich, 4.0, 1.0, 1.2, 1.0)
short = partial(sandwich, 0.3, 1.0, 1.2, 0.1)
crack = lambda: in_one_body(partly(quads(), lambda x: np.abs(x[:, 0] - 2) < 1.2), (0.0, 1.0))
cell = lambda: periodic(fibre(0.3, (1.0, 1.2), 0.2), ("LEFT", "RIGHT"), ("BOTTOM", "TOP"))
ARC: dict[str, Any] = {
    "joint": partial(ring, 1.0, 2.0, 3.0, 0.5, angle=1.2, cell="quadrilateral"),
    "supports": {"INSIDE": 0.0}, "tractions": {"OUTSIDE": (0.1, 0.2)},
}  # fmt: skip
CURVED: dict[str, Any] = ARC | {"joint": partial(ring, 1.0, 2.0, 3.0, 0.5, angle=1.2), "bodies": "extended"}
bricks = partial(wall, 2, 2, (1.0, 0.5), 0.25, cell="triangle")
BEND: dict[str, Any] = ARC | {"joint": partial(ARC["joint"], angle=2.0)}  # too much to keep its bodies
ROLLERS: dict[str, Any] = {"supports": {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}}
CELL: dict[str, Any] = {"joint": cell, "supports": {}, "tractions": {}}
WALL: dict[str, Any] = {"joint": partial(wall, 2, 2, (1.0, 0.5), 0.25)}
TIED: dict[str, Any] = WALL | {"supports": {"BOTTOM": 0.0, "TOP": 0.0}, "body_force": (0.1, 0.3), "tractions": {}}
HELD: dict[str, Any] = {"supports": {"BOTTOM": 0.0, "LEFT/LAYER": 0.0}}
SIDE: dict[str, Any] = {"tractions": {"LEFT/LAYER": (0.1, 0.0)}}
ROUND: dict[str, Any] = {"joint": partial(disc, 2.0, 0.5, 0.6, 0.5), "tractions": {}}
TURNED: dict[str, Any] = {"joint": short, "plane": "axisymmetric"}


def glue(law=SOFT, eps=0.1, **data):
    return ThinLayer(law, eps, **data)


def made(joint=quads, **data):
    return Structure(joint(), **{"body": BODY, "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.1, -0.3)}} | data)


def law_of(layer, bodies="kept", **data):
    return made(**data).interface(layer, bodies=bodies)


def mesh_of(layer, bodies="kept", **data):
    return made(**data).full(layer, bodies=bodies)


def solved(layer, **data):
    return solve(law_of(layer, **data))


PAD = ThinLayer(Conduction(1.0), 0.05)
FOIL = ThinLayer(Stack((0.3, Conduction(0.01)), (0.2, Conduction(100.0)), (0.5, Conduction(0.01))), 0.05)
CELL = {"joint": lambda: periodic(quads(), ("BOTTOM", "TOP")), "supports": {}, "gradient": (0.0, 1.0)}


def heated(joint=None, **data):
    joint = joint() if joint else quads()
    return Structure(joint, **{"body": Conduction(1.0), "supports": {"BOTTOM": 0.0}} | data)


def open_seam(name, width=0.05):
    return {"BED": glue(), "HEAD": glue(), name: Gap(width)}


def ignored():
    """What a curved layer changes where its bodies are bonded instead: goals of both models, on the bonded one."""
    meshed, bonded = mesh_of(glue(), "extended", **ARC), law_of(Bond(), **ARC)
    with_layer, without = (goals.Compliance().value(solve(model), bonded) for model in (meshed, bonded))
    assert with_layer > without


glue_state = cache(lambda: march(law_of(glue()), [1.0]).last)
load = lambda **body: [PointLoad((0.0, 0.0), (0.0, 0.1), **body)]
mean_of = lambda density: goals.Functional("mean", lambda u, m: density(u) * m.ds(m.domain.values("TOP")))


def bounds(layer=None, goal=None, law=False, **data):
    """Bounds against the continuum."""
    return estimate(solved(layer or glue(), **data), goals=[goal or goals.Compliance()]).continuum(law=law)


# key or words of a refusal, what is refused, what it advises
CASES = [
    ("unknown", lambda: law_of(ThinLayer(Conduction(1.0), 0.05)), lambda: heated().interface(PAD)),
    ("foil", lambda: heated().interface(FOIL).applicability["S"].require("sublayers"), lambda: heated().full(FOIL)),
    ("mean gradient", lambda: heated(**CELL).interface(FOIL, bodies="extended"), lambda: heated(**CELL).full(FOIL)),
    ("no layer", lambda: law_of(0.3), lambda: law_of(glue()), lambda: law_of(COULOMB)),
    ("element", lambda: law_of(COULOMB, element="S2"), lambda: law_of(COULOMB, element="Q2")),
    ("element", lambda: law_of(glue(**ONE), element="Q1"), lambda: law_of(glue(**ONE), element="Q2")),
    ("element", lambda: law_of(glue(WATER), element="Q1"), lambda: law_of(glue(WATER), element="Q2")),
    ("pressure in a sheet", lambda: law_of(glue(RUBBER, **ONE), plane="stress"),
        lambda: law_of(glue(**ONE), plane="stress")),
    ("bent", lambda: law_of(glue(**ONE), **ARC), lambda: law_of(glue(**ONE), "extended", **ARC)),
    ("bent stack", lambda: law_of(glue(STACK, **ONE), "extended", **ARC), lambda: mesh_of(glue(STACK), "extended", **ARC)),
    ("locks", lambda: law_of(glue(FLUID, **ONE)), lambda: law_of(glue(FLUID)), lambda: mesh_of(glue(FLUID))),
    ("tip", lambda: law_of(glue(**ONE), joint=crack), lambda: law_of(glue(), joint=crack)),
    ("junction", lambda: law_of(glue(**ONE), **WALL), lambda: law_of(glue(), **WALL), lambda: mesh_of(glue(), **WALL)),
    ("softens", lambda: mesh_of(glue(WELLS)), lambda: mesh_of(glue(replace(WELLS, mixing=1.0))),
        lambda: mesh_of(glue(SHEETS))),
    ("sound", lambda: mesh_of(glue(Cracked(2.0))), lambda: mesh_of(glue(Sound(2.0)))),
    ("order 1", lambda: homogenised_stiffness(law_of(glue(**ONE), "extended", **CELL)),
        lambda: homogenised_stiffness(law_of(glue(), "extended", **CELL))),
    ("held alone", lambda: estimate(solved(glue(), **HELD)), lambda: estimate(solved(glue(), supports={"LEFT": 0.0})),
        lambda: solve(mesh_of(glue(), **HELD))),
    ("no thickness", lambda: estimate(solved(COULOMB)), lambda: estimate(solved(glue()))),
    ("order 0", lambda: law_of(glue(edges="free")), lambda: law_of(glue(**FREE))),
    ("eigenstrain", lambda: law_of(glue(**FREE, eigenstrain=0.1)), lambda: mesh_of(glue(eigenstrain=0.1))),
    ("apart", lambda: law_of(glue(**FREE), "extended"), lambda: law_of(glue(**FREE))),
    ("radius", lambda: law_of(glue(**FREE), **TURNED), lambda: mesh_of(glue(), **TURNED)),
    ("no constants", lambda: law_of(glue(KELVIN, **FREE)), lambda: mesh_of(glue(KELVIN))),
    ("short", lambda: law_of(glue(**FREE), joint=short), lambda: mesh_of(glue(), joint=short)),
    ("contrast", lambda: law_of(glue(**FREE), body=SOFT), lambda: mesh_of(glue(), body=SOFT)),
    ("curved end", lambda: law_of(glue(**FREE), **ROUND), lambda: mesh_of(glue(), **ROUND)),
    ("coarse", lambda: law_of(glue(RUBBER, **FREE)),
        lambda: law_of(glue(RUBBER, **FREE), joint=partial(quads, h_ends=0.1))),
    ("phases", lambda: estimate(solved(glue(SHEETS))), lambda: solve(mesh_of(glue(SHEETS)))),
    ("closed", lambda: estimate(solved(glue(WATER), **ROLLERS)), lambda: estimate(solved(glue(SOLID), **ROLLERS))),
    ("no stress", lambda: estimate(solved(glue(Anisotropic.springs(9.0, 4.0)))),
        lambda: solve(mesh_of(glue(Anisotropic.springs(9.0, 4.0))))),
    ("rate", lambda: Zoom(march(law_of(glue(KELVIN)), [1.0]).last), lambda: Zoom(march(mesh_of(glue(KELVIN)), [1.0]).last)),
    ("not linear", lambda: Zoom(solved(glue(CUBIC))).corners, lambda: solve(mesh_of(glue(CUBIC)))),
    ("not isotropic", lambda: Zoom(solved(glue(Anisotropic(SKEW)))).corners,
        lambda: solve(mesh_of(glue(Anisotropic(SKEW))))),
    ("loaded side", lambda: law_of(glue(**ONE, edges="plain"), **SIDE), lambda: law_of(glue(), **SIDE)),
    ("loaded side", lambda: Zoom(solved(glue(), **SIDE)).corners, lambda: solve(mesh_of(glue(), **SIDE))),
    ("beside", lambda: estimate(solved(open_seam("HEAD"), **WALL)), lambda: estimate(solved(glue(), **WALL)),
        lambda: solve(mesh_of(open_seam("HEAD"), **WALL))),
    ("beside", lambda: estimate(solved(open_seam("BED"), **TIED)), lambda: solve(mesh_of(open_seam("BED"), **TIED))),
    ("moved", lambda: estimate(solved(Bond(), **ARC), glue()), ignored),
    ("moved", lambda: thin_enough(made(**ARC), glue(), 0.05, bonded=True), ignored),
    ("moved", lambda: thin_enough(made(**ARC), glue(), 0.05, bonded=True, bodies="extended"), ignored),
    ("not linear", lambda: bounds(glue(CUBIC)), lambda: estimate(solved(glue(CUBIC))).energy),
    ("kinematics", lambda: bounds(**TURNED), lambda: estimate(solved(glue(), **TURNED)).with_finer_ends()),
    ("cells", lambda: bounds(element="S2"), lambda: bounds(element="Q2"),
        lambda: bounds(element="Q1", **ARC, bodies="extended")),
    ("parts", lambda: bounds(loads=load(body="UPPER")), bounds),
    ("eigenstrain", lambda: bounds(glue(eigenstrain=lambda x, t: 0.1 * x[0])), lambda: bounds(glue(eigenstrain=0.1))),
    ("moduli", lambda: bounds(body=LinearElastic(lambda x: 60.0 + x[0], 40.0)), bounds),
    ("memory", lambda: bounds(glue(CREEP)), bounds),
    ("curved", lambda: bounds(**CURVED | {"joint": partial(CURVED["joint"], degree=2)}), lambda: bounds(**CURVED)),
    ("inclined", lambda: bounds(**CURVED | {"supports": {"INSIDE": {"n": 0.0}, "START": 0.0}}),
        lambda: bounds(**CURVED | {"supports": {"INSIDE": {"x": 0.0, "y": 0.0}, "START": 0.0}})),
    ("periodic", lambda: bounds(joint=cell, supports={}, tractions={}, strain=0.1 * np.eye(2), bodies="extended"),
        bounds),
    ("seams", lambda: estimate(solved(glue(), joint=bricks), seam="BED").continuum(), lambda: bounds(joint=bricks)),
    ("point support", lambda: bounds(supports={"BOTTOM": {"y": 0.0}, (0.0, -1.0): {"x": 0.0}}), bounds),
    ("moving support", lambda: bounds(supports={"BOTTOM": {"x": 0.0, "y": lambda x, t: 0.1 * x[0]}}),
        lambda: bounds(supports={"BOTTOM": {"x": 0.0, "y": 0.1}})),
    ("density", lambda: bounds(tractions={"TOP": lambda x, t: (0.0, ufl.exp(x[0]))}),
        lambda: bounds(tractions={"TOP": lambda x, t: (0.0, x[0] ** 2)})),
    ("density", lambda: bounds(goal=mean_of(lambda u: ufl.div(u))), lambda: bounds(goal=mean_of(lambda u: u[0]))),
    ("goal", lambda: bounds(goal=goals.Displacement((4.0, 1.2), (0, 1))), lambda: bounds(goal=mean_of(lambda u: u[1]))),
    ("law alone", lambda: bounds(glue(**ONE), law=True), lambda: bounds(law=True)),
    ("law alone", lambda: bounds(glue(Rubber.shear(1.0, 0.4)), law=True), lambda: bounds(law=True)),
    ("law alone", lambda: estimate(solve(made().bonded()), layer=glue()).continuum(law=True), lambda: bounds(law=True)),
    ("law alone", lambda: bounds(**SIDE, law=True), lambda: bounds(law=True)),
    ("law alone", lambda: bounds(goal=mean_of(lambda u: u[0]), law=True), lambda: bounds(law=True)),
    ("volume", lambda: bounds(glue(WATER)), lambda: bounds(glue(Rubber.shear(1.0, 0.49)))),
    ("divided", lambda: solve_to(law_of(glue()), tolerance=0.5),
        lambda: solve_to(law_of(glue(), joint=triangles), tolerance=0.5)),
    ("bonded", lambda: solve_to(law_of(Bond(), joint=triangles)),
        lambda: solve_to(law_of(glue(), joint=triangles), tolerance=0.5)),
    ("march(model, times)", lambda: solved(glue(KELVIN)), lambda: march(law_of(glue(KELVIN)), [1.0])),
    ("march(model, times)", lambda: solved(glue(FLAWED)), lambda: march(law_of(glue(FLAWED)), [1.0])),
    ("method='newton'", lambda: solve(law_of(glue(CUBIC)), method="linear"),
        lambda: solve(law_of(glue(CUBIC)), method="newton")),
    ("bodies='kept'", lambda: law_of(glue(), "extended", **WALL), lambda: law_of(glue(), **WALL)),
    ("bodies='kept'", lambda: law_of(Bond(), "extended"), lambda: law_of(Bond())),
    ("bodies='extended'", lambda: mesh_of(glue(), **BEND), lambda: mesh_of(glue(), "extended", **BEND)),
    ("give layer=", lambda: estimate(solved(Bond())), lambda: estimate(solved(Bond()), layer=glue())),
    ("give the history", lambda: estimate(march(law_of(glue(CREEP)), [1.0]).last),
        lambda: estimate(march(law_of(glue(CREEP)), [1.0]))),
    ("frame='global'", lambda: solved(glue(), body=Anisotropic(SKEW, frame="layer")),
        lambda: solved(glue(), body=Anisotropic(SKEW))),
    ("give side=", lambda: Probe(glue_state()).displacement((1.0, 0.0)),
        lambda: Probe(glue_state()).displacement((1.0, 0.0), side="upper")),
    ("give body=", lambda: law_of(glue(), loads=load()), lambda: law_of(glue(), loads=load(body="UPPER"))),
    ("omit start= and out=", lambda: march(glue_state(), [2.0], start=1.0), lambda: march(glue_state(), [2.0])),
]  # fmt: skip
OTHERS = {"plain", "oblique", "overlap"}  # whose remedies, edges=None or a mesh, are tried under another key
OTHERS |= {"balance", "ranks"}  # in `test_continuum`


@pytest.mark.few(8)
@pytest.mark.parametrize(("words", "call", "remedies"), [(words, call, more) for words, call, *more in CASES])
def test_what_a_refusal_advises_works(words, call, remedies):
    with warnings.catch_warnings(action="ignore", category=RangeWarning):
        error = refused(InputError, "", call)
        assert words == getattr(error, "key", "") or words in str(error)
        for remedy in remedies:
            remedy()


def test_each_key_of_a_refusal_has_its_remedy_tried():
    sources = "".join(path.read_text() for path in (CLONE / "thinlayer").rglob("*.py"))
    keys = {*re.findall(r'(?:Violation|refusal)\(\s*"([^"]+)"', sources)}
    assert keys - {words for words, *_ in CASES} == OTHERS
