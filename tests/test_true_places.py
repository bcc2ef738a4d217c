"""Bodies at their true places: order 1 on curved S, and of layers whose thickness varies."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import ufl
from dolfinx import fem

from forms import HolonomicCoulomb, Incompressible, LinearElastic, Rubber
from forms.base import InputError
from forms.work import energy
from geometry import block, bond_cell, ring, sandwich
from tests.cylinders import lame
from tests.orders import observed_orders
from tests.refused import refused
from tests.test_order1 import relative_errors
from thinlayer import Pressure, Probe, Structure, Surface, ThinLayer, compare, solve
from thinlayer.discretisation.interface_model import InterfaceModel

pytestmark = pytest.mark.few(5)

BODY = LinearElastic.young(100.0, 0.3)


def taper(x):
    """Thickness over eps, with zero slope on the axes."""
    return 1 + 0.4 * (x[0] ** 2 - x[1] ** 2) / (x[0] ** 2 + x[1] ** 2)


def quarter(h=0.2) -> Structure:
    """A quarter of two rings, held inside and drawn on from outside."""
    joint = ring(0.5, 1.0, 1.6, h=h, angle=np.pi / 2, cell="quadrilateral", degree=2)
    supports = {"INSIDE": 0.0, "START": {"y": 0.0}, "END": {"x": 0.0}}
    load = {"OUTSIDE": lambda x, t: (0.5 * x[0] * x[1], 1 + x[1])}
    return Structure(joint, body=BODY, supports=supports, tractions=load)


GLUE = LinearElastic(60.0, 40.0)  # per thickness
HELD = {"LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}}
A, R, B = 0.5, 1.0, 1.6  # radii: bore, S, rim


def tubes(inner=A, h=0.025):
    """A short piece of two tubes along the axis; S is straight in their section."""
    flat = sandwich(2 * h, R - inner, B - R, h, cell="quadrilateral", structured=True)
    return flat.rotated(-np.pi / 2).moved((R, 0.0))


def of_lame(eps: float) -> list[float]:
    """Mean traction on S, per area of S; jump; displacement of the bore."""
    radii = (A, R - eps / 2, R + eps / 2, B)
    exact = lame(radii, (BODY, GLUE.scaled(eps), BODY), (None, None), 1.0)
    t = sum(r * exact.stress(1, r) for r in radii[1:3]) / 2 / R
    return [t, exact.displacement(2, radii[2]) - exact.displacement(0, radii[1]), exact.displacement(0, A)]


def of_law(eps: float, relaxed: bool = True) -> list[float]:
    """The same of the law on S, of strain e0 + z e1: without its relaxed part e1 is that of straight lines through it."""
    inside, outside = stiffness(A, R - eps / 2), stiffness(R + eps / 2, B)
    law, jump, mean = GLUE.scaled(eps), np.array([-1, 1]), np.array([0.5, 0.5])
    stress, share = np.array([[law.lmbda + 2 * law.mu, law.lmbda], [law.lmbda, law.lmbda + 2 * law.mu]]), 0.0
    if relaxed:
        share = law.lmbda / (law.lmbda + 2 * law.mu) / R
    K = np.zeros((4, 4))
    K[:2, :2], K[2:, 2:] = inside, outside
    for z in (-(12**-0.5), 12**-0.5):
        e = np.array([jump / eps - z * share * jump, (mean + z * jump) / R])
        K[1:3, 1:3] += eps * R / 2 * e.T @ stress @ e
    u = np.linalg.solve(K, [A, 0.0, 0.0, 0.0])
    forces = (inside @ u[:2])[1], (outside @ u[2:])[0]
    return [(forces[0] - forces[1]) / 2 / R, u[2] - u[1], u[0]]


def stiffness(inner: float, outer: float) -> np.ndarray:
    """Outward forces per radian on the inner and the outer side of a tube, per displacement of these sides."""
    u = np.array([[inner, 1 / inner], [outer, 1 / outer]])
    a, b = 2 * (BODY.lmbda + BODY.mu), -2 * BODY.mu
    return np.array([[-inner * a, -b / inner], [outer * a, b / outer]]) @ np.linalg.inv(u)


def of_tubes(eps: float, order: int) -> list[float]:
    structure = Structure(tubes(), body=BODY, supports=HELD, tractions={"BOTTOM": (1.0, 0.0)}, plane="axisymmetric")
    model = structure.interface(ThinLayer(GLUE, eps, order=order, at=1.0), bodies="extended")
    state, surface = solve(model), Surface(model)
    area = surface.integral(1.0)
    assert area == pytest.approx(2 * np.pi * R * 0.05, rel=1e-12)
    means = [surface.integral(f[0]) / area for f in (surface.reaction(state), surface.jump(state))]
    return [*means, Probe(state).displacement((A, -0.025))[0]]


def test_tubes_under_inner_pressure():
    """Traction, jump and the bore's displacement against Lame's solution for three tubes."""
    eps = (1 / 16, 1 / 32, 1 / 64)
    cases = [[of_tubes(e, order) for e in eps] for order in (1, 0)]
    right, zero = (np.abs(np.array(case) / [of_lame(e) for e in eps] - 1).T for case in cases)
    for case, e in zip(cases[0], eps, strict=True):
        assert case == pytest.approx(of_law(e), rel=1e-6)  # of the cells
    lines = np.abs(np.array(of_law(1 / 64, relaxed=False)) / of_lame(1 / 64) - 1)
    assert lines == pytest.approx([3.4e-6, 1.7e-5, 7.7e-7], rel=0.02)  # of a program of its own
    for k in range(3):
        assert observed_orders(eps, right[k])[-1] == pytest.approx(2.0, abs=0.12)
        assert zero[k, 2] > 100 * right[k, 2]


# ---------------------------------------------------------------- a thickness that varies
def wavy(x):
    """Thickness over eps."""
    return 1 + 0.4 * np.cos(np.pi * x[0])


def errors_of(structure, eps, law=GLUE, profile=None, meshed=None, order=1, cells_through=4):
    """(traction and jump, loads' work; eps) relative errors against the meshed layer."""
    rows = []
    for e in eps:
        whole = ThinLayer(meshed or law, e, profile=profile, at=1.0)
        full = solve(structure.full(whole, bodies="extended", cells_through=cells_through))
        limit = solve(structure.interface(ThinLayer(law, e, order=order, profile=profile, at=1.0), bodies="extended"))
        works = [state.energies()["loads"] for state in (full, limit)]
        rows.append([*relative_errors(full, limit), abs(works[1] / works[0] - 1)])
    return np.array(rows).T


def flat(name: str) -> Structure:
    build = partial(sandwich, 1.0, 0.5, 0.5) if name == "both" else partial(block, 1.0, 0.5)
    supports = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}} | ({"BOTTOM": 0.0} if name == "both" else {})
    load = {"TOP": lambda x, t: (0.5 * ufl.sin(ufl.pi * x[0]), ufl.cos(ufl.pi * x[0]))}
    return Structure(build(1 / 16, cell="quadrilateral"), body=BODY, supports=supports, tractions=load)


def test_taper():
    """A body that gives up all of a thickness that varies, above a flat rigid base."""
    eps = (1 / 32, 1 / 64)
    for errors in errors_of(flat("one"), eps, profile=wavy):
        assert observed_orders(eps, errors)[-1] == pytest.approx(2.0, abs=0.1)


def test_rotations_cause_no_strain(monkeypatch):
    """Neither where a thickness varies nor on a curved S; without fibres they cause one of order eps."""
    of_model, energies = InterfaceModel.sides_of, {}
    for whole in (flat("both"), quarter()):
        layer = ThinLayer(GLUE, 1 / 8, order=1, profile=lambda x: 1 + 0.4 * x[0], at=1.0)
        energies[whole] = [_of_rotation(whole.interface(layer, bodies="extended"))]
        with monkeypatch.context() as changed:
            changed.setattr(InterfaceModel, "sides_of", lambda *at: replace(sides := of_model(*at), director=sides.n))
            energies[whole].append(_of_rotation(whole.interface(layer, bodies="extended")))
    straight, curved = energies.values()
    assert max(straight[0], curved[0]) < 1e-20
    assert curved[1] > 1e-9


def _of_rotation(model) -> float:
    """Energy of the layer in a rotation."""
    u = fem.Function(model.V)
    u.interpolate(lambda x: np.array([-x[1], x[0]]))
    return fem.assemble_scalar(fem.form(energy(model.layer_terms, u)))


# ---------------------------------------------------------------- a curved S
CURVED = {
    "elastic": (GLUE, GLUE, None),
    "elastic, thickness varies": (GLUE, GLUE, taper),
    "rubber": (Rubber(400.0, 4.0), LinearElastic(400.0, 4.0), None),
    "incompressible, thickness varies": (Incompressible(40.0), Incompressible(40.0), taper),
}


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of cavities: the loads are for errors alone
@pytest.mark.parametrize("name", CURVED)
def test_rings(name):
    """Curved cells: order 2 against meshed layers, of unsymmetric stacks and of laws with a pressure, too."""
    law, meshed, profile = CURVED[name]
    for errors in errors_of(quarter(h=0.1), (1 / 16, 1 / 32), law, profile, meshed, cells_through=4):
        assert observed_orders((1 / 16, 1 / 32), errors)[-1] == pytest.approx(2.0, abs=0.17)


# ---------------------------------------------------------------- the rest of the model


def test_places_of_bodies():
    """Probes, forces and volumes are those of the bodies of the meshed layer, not of S."""
    whole, layer = quarter(), ThinLayer(GLUE, 1 / 16, order=1, at=1.0)
    full, limit = (solve(make(layer, bodies="extended")) for make in (whole.full, whole.interface))
    for name in ("INNER", "OUTER"):
        cells = [state.model.dx(state.model.domain.region_tags(name)) for state in (full, limit)]
        volumes = [state.integral(1 * dx) for state, dx in zip((full, limit), cells, strict=True)]
        assert volumes[0] == pytest.approx(volumes[1], rel=1e-13)
    assert limit.applied().force == pytest.approx(full.applied().force, rel=1e-12)
    reactions, applied = limit.reactions_by_place((0.0, 0.0)).values(), limit.applied((0.0, 0.0))
    assert sum(r.force for r in reactions) == pytest.approx(-applied.force, rel=1e-10)
    assert sum(r.moment for r in reactions) == pytest.approx(-applied.moment, rel=1e-10)  # the thickness is an arm
    for r in (0.93, 1.07):  # next to the faces
        u, v = (Probe(state).displacement((0.6 * r, 0.8 * r)) for state in (full, limit))
        assert v == pytest.approx(u, abs=2e-3 * np.abs(u).max())
    refused(InputError, "places are in no cell", lambda: Probe(limit).displacement((0.6, 0.8)))


def test_refused():
    whole, layer = quarter(), ThinLayer(GLUE, 1 / 8, order=1, at=1.0)
    refused(InputError, "known: extended, kept", lambda: whole.interface(layer, bodies="moved"))
    dry = Structure(whole.joint, body=BODY, supports=whole.supports, element="Q1")
    refused(InputError, "'S' has no ThinLayer", dry.interface, HolonomicCoulomb(1.0, 1.0, 0.3), bodies="extended")
    bricks = Structure(bond_cell((1.0, 0.5), 0.25), body=BODY, supports={})
    words = "seams meet or branch, where S has no"
    refused(InputError, words, bricks.interface, replace(layer, order=0), bodies="extended")
    structure = flat("both")
    loaded = Structure(whole.joint, body=BODY, supports={"INSIDE": 0.0}, tractions={"START": Pressure(1.0)})
    refused(InputError, "traction on 'START': S ends there", lambda: loaded.interface(layer, bodies="extended"))
    states = solve(structure.full(layer, bodies="extended")), solve(structure.interface(layer))
    refused(InputError, "compare: bodies are extended in the full model and kept", lambda: compare(*states))
