"""Axisymmetric structures: uniform states, tubes against Lame, contact, and what is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem

from forms import Anisotropic, HolonomicCoulomb, Incompressible, LinearElastic, Maxwell, MohrCoulomb, Stack
from forms.base import InputError
from geometry import block, periodic, sandwich
from studies.tubes import lame
from tests.contact_bars import contact
from tests.refused import refused
from thinlayer import Springs, Structure, Surface, ThinLayer, UflPart, compare, goals, march, solve
from thinlayer.errors import LooseBody
from thinlayer.output.homogenised import homogenised_stiffness
from thinlayer.output.surface import YIELDS

BODY = LinearElastic(80.0, 50.0)
GLUE = LinearElastic(3.0, 2.0)  # per thickness
YIELDING = MohrCoulomb(3.0, 2.0, 0.02, 30.0, 0.05)
R, EPS, P = 1.3, 0.05, 0.7
EXACT = 1e-9


def rods(radius=R, inner=0.0, **options):
    """Two rods end to end, S across the axis."""
    return sandwich(radius - inner, 0.6, 0.5, 0.4, **options).moved((inner, 0.0))


def structure(joint, supports, **options):
    return Structure(joint, body=BODY, supports=supports, plane="axisymmetric", **options)


def tubes(r_S=3.0, inner=1.5, outer=1.0, height=0.4, **options):
    """Two tubes, one in the other; S along the axis, its normal outwards; "BOTTOM" is the inner side, "TOP" the outer."""
    return sandwich(height, inner, outer, 0.25, h_S=0.2, **options).rotated(-np.pi / 2).moved((r_S, 0.0))


HELD = {"LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}}


# ---------------------------------------------------------------- uniform states
@pytest.mark.parametrize(("cell", "element"), [("triangle", "P1"), ("quadrilateral", "S2")])
def test_rods_in_uniform_tension(cell, element):
    """Forces, energies, tractions and areas are those of the whole revolution, to rounding; the axis is held by itself."""
    joint = rods(cell=cell, structured=True)
    model = structure(joint, {"BOTTOM": {"y": 0.0}}, tractions={"TOP": (0.0, P)}, element=element).interface(
        ThinLayer(GLUE, EPS, at=1.0)
    )
    state, surface = solve(model), Surface(model)
    area, E = np.pi * R**2, 2 * BODY.mu * (1 + BODY.lmbda / (2 * (BODY.lmbda + BODY.mu)))
    jump = P / (GLUE.lmbda + 2 * GLUE.mu)
    energies = state.energies()
    assert energies["bodies"] == pytest.approx(P**2 / (2 * E) * area * 1.1, rel=EXACT)
    assert energies["layer"] == pytest.approx(P * jump * area / 2, rel=EXACT)
    assert energies["loads"] == pytest.approx(2 * (energies["bodies"] + energies["layer"]), rel=EXACT)
    assert surface.integral(1.0) == pytest.approx(area, rel=EXACT)
    for f, value in ((surface.traction(state), P), (surface.jump(state), jump)):
        assert surface.profile(f)[1] == pytest.approx(np.array([[0.0, value]] * 4), rel=EXACT, abs=EXACT * value)
        assert surface.norm(f) == pytest.approx(value * np.sqrt(area), rel=EXACT)
    assert np.diag(state.mean_stress()) == pytest.approx([0.0, P], abs=EXACT)


def test_integrals_of_users_are_over_the_whole_revolution():
    """Springs as a form are the part `Springs`; integrals and goals are the work of the loads."""
    on = lambda model, name: model.ds(model.domain.values(name))
    springs = UflPart(energy=lambda u, model: 15.0 * u[0] ** 2 * on(model, "RIGHT"))
    supports, loads = {"BOTTOM": {"y": 0.0}}, {"TOP": (0.0, P)}
    by_part, state = (
        solve(structure(rods(), supports, tractions=loads, parts=[part]).interface(ThinLayer(GLUE, EPS, at=1.0)))
        for part in (Springs("RIGHT", normal=30.0), springs)
    )
    assert state.u.x.array == pytest.approx(by_part.u.x.array, abs=EXACT * abs(by_part.u.x.array).max())
    work = lambda u, model: P * u[1] * on(model, "TOP")
    loads = by_part.energies()["loads"]
    assert state.integral(work(state.u, state.model)) == pytest.approx(loads, rel=EXACT)
    assert goals.Functional("work", work).value(state, state.model) == pytest.approx(loads, rel=EXACT)
    u, model = state.u[1], state.model
    for form, message in (
        (u * ufl.ds(999), r"ds\(999\), which is nothing here"),
        (u * model.dx(999), r"dx\(999\), which is nothing here"),
        (ufl.avg(u) * model.dS(999), r"dS\(999\), which is nothing here; tags: dS\(k \+ 1\)"),
        (u * on(model, "S"), "which is nothing here"),  # inside
        (3.0, "it must be a UFL form"),
        (math.nan * u * ufl.dx, "not finite"),
        (fem.Constant(model.domain.mesh, math.nan) * ufl.dx, "not finite"),
    ):
        refused(InputError, message, state.integral, form)


@pytest.mark.parametrize("order", [0, 1])
def test_order_1_knows_the_hoops(order):
    """Widened rods: the layer's traction has 2 lmbda eps a, of radial strains and of hoops; order 0 leaves them out."""
    a = 0.02
    supports = {"BOTTOM": {"y": 0.0}, "RIGHT": {"x": a * R}, "TOP": {"y": 0.03}}
    layer, whole = ThinLayer(GLUE, EPS, order=order, at=1.0), structure(rods(), supports)
    full, limit = solve(whole.full(layer)), solve(whole.interface(layer))
    found = compare(full, limit)
    if order == 1:
        assert max(found["error_traction"], found["error_jump"]) < 1e-8
    else:
        assert found["error_traction"] > 1e-3
    surface = Surface(limit.model)
    t, w = (surface.integral(f[1]) / (np.pi * R**2) for f in (surface.traction(limit), surface.jump(limit)))
    assert t == pytest.approx((GLUE.lmbda + 2 * GLUE.mu) * w + order * 2 * GLUE.lmbda * EPS * a, rel=1e-8)


@pytest.mark.parametrize("name", ["Mohr-Coulomb", "Stack"])
def test_meshed_layers_of_compiled_laws_see_all_four_strains(name):
    """A widened layer yields as the law does in space, with equal strains 11 and 33; without the latter it does not."""
    a, rise = 0.02, -0.03
    soft = MohrCoulomb(GLUE.lmbda, GLUE.mu, 0.002, 30.0, 0.01)
    law = soft if name == "Mohr-Coulomb" else Stack((0.4, soft), (0.6, soft))
    supports = {"BOTTOM": {"y": 0.0}, "RIGHT": {"x": lambda x, t: t * a * R}, "TOP": {"y": lambda x, t: t * rise}}
    model = structure(rods(), supports).full(ThinLayer(law, EPS, at=1.0))
    state = march(model, [0.5, 1.0]).last
    stress = np.array(state.mean_stress())
    layer_height = (rise - 1.1 * _axial(stress[1, 1], a)) / EPS
    assert stress[1, 1] == pytest.approx(_of_point(soft, a, layer_height), rel=2e-3)
    assert abs(_of_point(soft, a, layer_height, hoops=0.0) / stress[1, 1] - 1) > 0.03


def _axial(sigma, a):
    """Axial strain of the rods under a stress along the axis and a lateral strain a."""
    return (sigma - 2 * BODY.lmbda * a) / (BODY.lmbda + 2 * BODY.mu)


def _of_point(law, a, axial, hoops=None):
    """Stress 22 of the law at a point of the layer, in two steps."""
    from tests.at_points import respond

    real, n = law.scaled(EPS), np.array([[0.0, 1.0, 0.0]])
    e, q, old = (
        np.array([[a, axial, a if hoops is None else hoops, 0, 0, 0]]),
        np.zeros((1, law.memory)),
        np.zeros((1, 6)),
    )
    for share in (0.5, 1.0):
        answer = respond(real, share * e, old, q, n)
        q, old = answer.q, share * e
    return answer.stress[0, 1]


# ---------------------------------------------------------------- tubes
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_bonded_tubes_are_those_of_lame(cell):
    joint, layer = tubes(cell=cell, structured=True), ThinLayer(GLUE, EPS, at=1.0)
    whole = structure(joint, HELD, tractions={"BOTTOM": (P, 0.0)})
    limit, full = solve(whole.interface(layer)), solve(whole.full(layer, bodies="extended"))
    real = GLUE.scaled(EPS)
    by_law = lame((1.5, 3.0, 4.0), (BODY, BODY), (GLUE.lmbda + 2 * GLUE.mu,), P)
    meshed = lame((1.5, 3 - EPS / 2, 3 + EPS / 2, 4.0), (BODY, real, BODY), (None, None), P)
    work = 2 * np.pi * 1.5 * 0.4 * P
    assert limit.energies()["loads"] == pytest.approx(work * by_law.displacement(0, 1.5), rel=2e-5)
    assert full.energies()["loads"] == pytest.approx(work * meshed.displacement(0, 1.5), rel=2e-5)
    surface = Surface(limit.model)
    t = surface.profile(surface.frame(surface.traction(limit)))[1]
    assert t == pytest.approx(np.array([[0.0, by_law.stress(0, 3.0)]] * len(t)), rel=1e-3, abs=1e-4)
    wrong = lame((1.5, 3.0, 4.0), (BODY, BODY), (GLUE.lmbda + GLUE.mu,), P)  # springs of another stiffness
    assert abs(wrong.displacement(0, 1.5) / by_law.displacement(0, 1.5) - 1) > 1e-3


def rates(law, eps, run=solve, **options):
    joint, errors = tubes(cell="quadrilateral", structured=True), []
    whole = structure(joint, HELD, tractions={"BOTTOM": (P, 0.0)}, **options)
    for e in eps:
        layer = ThinLayer(law, e, at=1.0)
        errors.append(compare(run(whole.full(layer, bodies="extended")), run(whole.interface(layer))))
    return [np.log2(errors[0][k] / errors[1][k]) for k in ("error_traction", "error_jump")]


@pytest.mark.parametrize(
    "law",
    [Maxwell(3.0, 2.0, 0.8, 2.5), Incompressible(2.0), YIELDING],
    ids=["Maxwell", "Incompressible", "Mohr-Coulomb"],
)
def test_the_layer_between_tubes_tends_to_its_law_at_rate_1(law):
    """Also that of the jump, which is zero across an incompressible layer on S."""

    def run(model):
        return march(model, [0.2, 0.6]).last

    traction, jump = rates(law, (0.08, 0.04), run)
    assert 0.9 < traction < 1.16  # 1.153 of Mohr-Coulomb, whose next term shows; 1.134 by the bodies' reactions
    assert isinstance(law, Incompressible) or 0.9 < jump < 1.15


def test_shares_of_s_are_those_of_areas():
    """Rods pressed in the middle: what slides or yields there counts with 2 pi r."""
    pressed = _rods(tractions={"TOP": (0.0, -0.1 * P)}).interface(ThinLayer(YIELDING, EPS, at=1.0))
    (row,) = Surface(pressed).table(march(pressed, [1.0]).last).rows
    assert row["size"] == pytest.approx(np.pi * R**2, rel=EXACT)
    assert sum(row[name] for name in YIELDS) == pytest.approx(1.0)


# ---------------------------------------------------------------- contact
def test_contact_of_rods_is_exact_under_uniform_pressure():
    """Areas of nodes are integrals over the revolution: a uniform pressure is one at all nodes, the axis included."""
    law = HolonomicCoulomb(K_N=9.0, K_T=3.0, friction=0.4)
    model = structure(rods(), {"BOTTOM": {"y": 0.0}}, tractions={"TOP": (0.0, -P)}, element="P1").interface(law)
    state = solve(model)
    report = Surface(state.model).contact(state)
    assert report.normal_force == pytest.approx(P * np.pi * R**2, rel=1e-8)
    surface = Surface(model)
    assert surface.profile(surface.traction(state))[1][:, 1] == pytest.approx(-P, rel=1e-8)
    assert surface.profile(surface.jump(state))[1][:, 1] == pytest.approx(-P / 9.0, rel=1e-8)


def test_contact_of_tubes_under_pressure():
    model = structure(
        tubes(cell="quadrilateral", structured=True), HELD, tractions={"BOTTOM": (P, 0.0)}, element="Q1"
    ).interface(HolonomicCoulomb(K_N=9.0, K_T=3.0, friction=0.4))
    by_law = lame((1.5, 3.0, 4.0), (BODY, BODY), (9.0,), P)
    report = contact(solve(model))
    assert report.normal_force == pytest.approx(-by_law.stress(0, 3.0) * 2 * np.pi * 3.0 * 0.4, rel=5e-3)


# ---------------------------------------------------------------- supports, periods, refusals
def test_a_tube_repeats_along_its_axis():
    joint = periodic(tubes(cell="quadrilateral", structured=True, height=1.0), ("LEFT", "RIGHT"))
    state = solve(structure(joint, {}, tractions={"BOTTOM": (P, 0.0)}).interface(ThinLayer(GLUE, EPS, at=1.0)))
    by_law = lame((1.5, 3.0, 4.0), (BODY, BODY), (GLUE.lmbda + 2 * GLUE.mu,), P)
    assert state.energies()["loads"] == pytest.approx(2 * np.pi * 1.5 * P * by_law.displacement(0, 1.5), rel=1e-4)


def test_only_motions_along_the_axis_are_rigid():
    """Without friction between them a tube slides out of the other; against the axis it needs no support."""
    layer = ThinLayer(GLUE, EPS, at=1.0)
    solve(structure(tubes(), {"LEFT/LOWER": {"y": 0.0}}, tractions={"BOTTOM": (P, 0.0)}).interface(layer))
    slippery = ThinLayer(Anisotropic.springs(K_N=9.0, K_T=0.0), EPS, at=1.0)
    loose = structure(tubes(), {"LEFT/LOWER": {"y": 0.0}}, tractions={"BOTTOM": (P, 0.0)}).interface(slippery)
    refused(LooseBody, r"can move along \(0, 1\)", solve, loose)
    with pytest.raises(InputError, match=r"no support against rigid motion of the structure \(translation y\)"):
        structure(rods(), {"RIGHT": {"x": 0.0}}).bonded()
    springs = structure(rods(), {}, tractions={"TOP": (0.0, P)}, parts=[Springs("BOTTOM", normal=4.0)])
    state = solve(springs.bonded())
    assert state.energies()["springs BOTTOM"] == pytest.approx(P**2 / 8 * np.pi * R**2, rel=0.2)


def _tubes(**options):
    return structure(tubes(), HELD, **options)


def _ring():
    joint = periodic(tubes(cell="quadrilateral", structured=True, height=1.0), ("LEFT", "RIGHT"))
    return structure(joint, {}).interface(ThinLayer(GLUE, EPS, at=1.0))


def _base_and_axis():
    joint = block(1.0, 1.0, 0.5)
    return replace(joint, facets={"S": np.concatenate([joint.facets["S"], joint.facets["LEFT"]])})


def _rods(**options):
    return structure(rods(), {"BOTTOM": 0}, **options)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: structure(rods().moved((-0.1, 0.0)), {}), r"x is the distance from the axis of revolution, and \d+ p"),
        (lambda: structure(tubes(r_S=0.0), {}), "allowed: x >= 0"),
        (lambda: structure(tubes(r_S=0.0, inner=1.5).moved((-1.0, 0.0)), {}), "allowed: x >= 0"),
        (lambda: structure(sandwich(1, 1, 1, 0.5, depth=0.5), {}), "plane='axisymmetric' needs a two-dimensional joint"),
        (lambda: _tubes().full(ThinLayer(GLUE, EPS, at=1.0)), r"cannot move away from its axis; use bodies='extended'"),
        (lambda: _tubes().interface(ThinLayer(GLUE, EPS, order=1, at=1.0)), "order=1 on an S that is not across the axis"),
        (lambda: solve(structure(rods(), {"LEFT": {"x": 0.1}, "BOTTOM": 0}).bonded()), "on the axis of revolution x = 0"),
        (lambda: _rods(tractions={"LEFT": (1.0, 0.0)}).bonded(), "are the axis of revolution"),
        (lambda: _rods(parts=[Springs("LEFT", normal=1.0)]).bonded(), "springs on 'LEFT': these facets are the axis"),
        (lambda: _tubes(strain=((0, 0), (0, 1))), "a mean strain or stress is for periodic cells"),
        (lambda: structure(periodic(rods(inner=0.5, radius=2.0), ("LEFT", "RIGHT")), {}), "repeats along the axis"),
        (lambda: homogenised_stiffness(_ring()), "plane='axisymmetric': a body of revolution has no mean strain"),
        (lambda: structure(block(1.0, 1.0, 0.5).rotated(-np.pi / 2), {}), "'S' lies on the axis, where it has no area"),
        (lambda: structure(_base_and_axis(), {}), "'S' lies on the axis, where it has no area"),
    ],
)  # fmt: skip
def test_what_cannot_be_turned(build, message):
    refused(InputError, message, build)
