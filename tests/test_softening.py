"""Softening that a law in forms does not say is told when its stress falls; meshed layers of laws that say it."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
import ufl

from forms import BulkLaw, LinearElastic
from forms.base import InputError
from forms.tensors import three_dimensional
from geometry import block, sandwich, wall
from tests import ranges_told
from tests.on_ranks import on_ranks
from tests.own_laws import Damaging
from tests.refused import refused
from thinlayer import Structure, ThinLayer, estimate, march, solve

pytestmark = pytest.mark.few(5)

EPS = 0.05
STIFF = LinearElastic.young(1e6, 0.3)


@dataclass(frozen=True)
class Falling(BulkLaw):
    """k e exp(-e:e/s^2), which falls beyond e = s/sqrt 2."""

    k: float
    s: float
    powers: ClassVar = {"k": 1, "s": -1}

    def stress(self, step):
        return self.k * step.mid * ufl.exp(-ufl.inner(step.mid, step.mid) / self.s**2)


@dataclass(frozen=True)
class WeakInShear(BulkLaw):
    """From an energy: as the layer opens by e_N = c, nothing resists its slip; across S it never softens."""

    k: float
    c: float
    powers: ClassVar = {"k": 1, "c": -1}

    def stress(self, step):
        e, n = ufl.variable(step.e), three_dimensional(step.n)
        e_N = ufl.dot(e * n, n)
        slip = ufl.inner(e * n, e * n) - e_N**2
        return ufl.sym(ufl.diff(self.k * (e_N**2 + e_N**4 + (1 - e_N / self.c) * slip), e))


def range_warnings(joint, law, kind, times):
    """RangeWarnings of a march, or of a solve at one time, in which the layer opens by t times its thickness."""
    supports = {"BOTTOM": 0.0, "TOP": {"y": lambda x, t: EPS * t}}
    sides = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}} if joint.dim == 2 else {}
    model = kind(Structure(joint, body=STIFF, supports=supports | sides), ThinLayer(law, EPS))
    return ranges_told.with_warnings(lambda: march(model, times) if isinstance(times, list) else solve(model, times))[1]


@pytest.mark.parametrize("kind", [Structure.interface, Structure.full])
@pytest.mark.parametrize(("law", "onset"), [(Falling(3.0, 0.4), 0.4 / math.sqrt(2)), (WeakInShear(3.0, 0.3), 0.3)])
def test_where_stresses_fall(law, onset, kind):
    """Wherever the unit of stress; a march tells it once, at the first step beyond, a solve only beyond."""
    joint = sandwich(2.0, 1.0, 1.0, 1.0, cell="quadrilateral")
    before, after = 0.97 * onset, 1.03 * onset
    (message,) = range_warnings(joint, law, kind, [before, after, 1.1 * onset])
    name = type(law).__name__
    assert re.search(rf"at t = {after:g} the stress of {name} falls at \d+ points of the layer as", message)
    assert "write softens = True" in message
    assert range_warnings(joint, law, kind, before) == []
    assert len(range_warnings(joint, law, kind, after)) == 1


# ---------------------------------------------------------------- meshed layers whose law says that it softens
SOLID = LinearElastic.young(100.0, 0.3)
GLUE = Damaging(60.0, 40.0, 1 / 280, 6.0)  # of a layer of unit thickness
TIMES = [0.004, 0.008, 0.015, 0.022, 0.03]


def block_of(cell, h=1 / 8, **options):
    """A block on a base, between rollers, whose top is lifted and pushed unevenly."""
    top = {"x": lambda x, t: t * ufl.sin(math.pi * x[0]) / 2, "y": lambda x, t: t * (0.8 + ufl.cos(math.pi * x[0]))}
    setup = {"body": SOLID, "supports": {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}, "TOP": top}} | options
    return Structure(block(1.0, 0.25, h, cell=cell, structured=True), **setup)


@pytest.mark.parametrize("through", [1, 2])
@pytest.mark.parametrize(("moved", "fixed", "modulus"), [("y", "x", 140.0), ("x", "y", 40.0)])
@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_a_meshed_bar_breaks_as_the_closed_form_says(cell, moved, fixed, modulus, through):
    """Uniaxial strain, shear: t = w + T(w) H/E; T falls to zero at k times the jump at the strength; G = eps k onset."""
    eps, compliance = 0.03, 0.25 / (900.0 if moved == "y" else 450.0)
    w_0 = math.sqrt(2 * GLUE.onset / modulus) * eps
    w = np.array([0.7, 1.0, 2.3, 4.9, 6.6]) * w_0
    T = modulus / eps * np.minimum(w, np.clip((6 * w_0 - w) / 5, 0.0, None))
    supports = {"LEFT": {fixed: 0.0}, "RIGHT": {fixed: 0.0}, "TOP": {moved: lambda x, t: t, fixed: 0.0}}
    structure = block_of(cell, body=LinearElastic.young(900.0, 0.0), supports=supports)
    history = march(structure.full(ThinLayer(GLUE, eps), cells_through=through), [*(w + T * compliance)])
    assert [history.at(t).prescribed_work / t for t in w + T * compliance] == pytest.approx(T, abs=1e-9 * T.max())
    assert history.table["dissipated"].sum() == pytest.approx(eps * GLUE.k * GLUE.onset, rel=1e-9)


def energies(model, **files):
    history = march(model, TIMES, **files)
    return np.array([history.last.prescribed_work, history.table["dissipated"].sum(), history.last.stored["layer"]])


@pytest.mark.parametrize(("cell", "through"), [("quadrilateral", 1), ("quadrilateral", 2), ("triangle", 1)])
def test_a_meshed_layer_softens_as_the_law_on_s(cell, through):
    """Work, energy dissipated and stored converge with eps, at the rate 1, where the layer opens and slips unevenly."""
    structure = block_of(cell)
    on_s = energies(structure.interface(ThinLayer(GLUE, 0.1, at=1.0)))
    layers = [ThinLayer(GLUE, eps, at=1.0) for eps in (1 / 16, 1 / 32)]
    errors = [energies(structure.full(layer, cells_through=through)) / on_s - 1 for layer in layers]
    assert (np.abs(errors) < 0.05).all()
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1.1, abs=0.3)


@pytest.mark.parametrize("joint", [wall(2, 2, (1.0, 0.5), 0.5), sandwich(1.3, 0.7, 0.9, 0.9, depth=0.5)])
def test_a_meshed_layer_that_does_not_soften_yet_is_the_elastic_one(joint):
    top = {"x": lambda x, t: 0.3 * t, "y": lambda x, t: t * (1 + 0.7 * x[0])}
    structure = Structure(joint, body=SOLID, supports={"BOTTOM": 0.0, "TOP": top})
    laws = LinearElastic(60.0, 40.0), replace(GLUE, onset=1e9)
    soft, sound = (march(structure.full(ThinLayer(law, 0.05), cells_through=2), [0.1]).last.u.x.array for law in laws)
    assert sound == pytest.approx(soft, abs=1e-11 * np.abs(soft).max())


def test_remedies_of_layers_that_soften():
    """`estimate` says: mesh the layer; order 1: order 0."""
    layer = ThinLayer(GLUE, 0.05)
    state = march(block_of("quadrilateral", h=1 / 4).interface(layer), TIMES[:1]).last
    refused(InputError, r"mesh the layer \(structure.full\)", estimate, state)
    refused(InputError, "soften one by one; use order=0", replace, layer, order=1)


def resumed(folder):
    """Energies of a march that goes on from files, of triangles: columns have several cells, and stay on one rank."""
    model = block_of("triangle").full(ThinLayer(GLUE, 0.05))
    march(model, TIMES[:3], out=folder)
    return energies(model, out=folder, resume=True).tolist()


@on_ranks(resumed, 2)
def test_a_meshed_layer_that_softens_on_several_ranks(there):
    assert there == pytest.approx(energies(block_of("triangle").full(ThinLayer(GLUE, 0.05))), rel=1e-9)
