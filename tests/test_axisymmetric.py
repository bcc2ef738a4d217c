"""Axisymmetric structures: uniform states, tubes against Lame, contact, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
import ufl

from forms import Anisotropic, HolonomicCoulomb, Incompressible, LinearElastic, Maxwell, MohrCoulomb, Stack
from forms.base import InputError
from geometry import block, periodic, sandwich
from studies import problems
from tests.cylinders import lame
from tests.refused import refused
from thinlayer import Springs, Structure, Surface, ThinLayer, UflPart, compare, goals, march, solve
from thinlayer.errors import LooseBody
from thinlayer.output.homogenised import homogenised_stiffness

BODY = LinearElastic(80.0, 50.0)
GLUE = LinearElastic(3.0, 2.0)  # per thickness
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
def test_rods_in_uniform_tension():
    """Forces, energies, tractions and areas are those of the whole revolution, to rounding; the axis is held by itself."""
    loads = {"tractions": {"TOP": (0.0, P)}, "element": "S2"}
    joint = rods(cell="quadrilateral", structured=True)
    model = structure(joint, {"BOTTOM": {"y": 0.0}}, **loads).interface(ThinLayer(GLUE, EPS, at=1.0))
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
    model_with = lambda part: structure(rods(), supports, tractions=loads, parts=[part]).interface(
        ThinLayer(GLUE, EPS, at=1.0)
    )
    by_part, state = solve(model_with(Springs("RIGHT", normal=30.0))), solve(model_with(springs))
    assert state.u.x.array == pytest.approx(by_part.u.x.array, abs=EXACT * abs(by_part.u.x.array).max())
    stiffens = UflPart(energy=lambda u, model: (15.0 * u[0] ** 2 + 1e5 * u[0] ** 4) * on(model, "RIGHT"))
    bent = solve(model_with(stiffens))
    assert bent.energies()["own form"] == pytest.approx(bent.integral(stiffens.energy(bent.u, bent.model)), rel=EXACT)
    work = lambda u, model: P * u[1] * on(model, "TOP")
    loads = by_part.energies()["loads"]
    assert state.integral(work(state.u, state.model)) == pytest.approx(loads, rel=EXACT)
    assert goals.Functional("work", work).value(state, state.model) == pytest.approx(loads, rel=EXACT)
    u, model = state.u[1], state.model
    for form, message in (
        (u * model.dx(999), r"dx\(999\), which is nothing here"),
        (ufl.avg(u) * model.dS(999), r"dS\(999\), which is nothing here; tags: dS\(k \+ 1\)"),
        (u * on(model, "S"), "which is nothing here"),  # inside
        (ufl.jump(u) * model.dS, "all inner facets; seams: dS"),  # with arbitrary sides
        (3.0, "it must be a UFL form"),
        (math.nan * u * ufl.dx, "not finite"),
    ):
        refused(InputError, message, state.integral, form)


@pytest.mark.parametrize("order", [0, 1])
def test_order_1_knows_the_hoops(order):
    """Widened rods: the layer's traction has 2 lmbda eps a, of radial strains and of hoops; order 0 leaves them out."""
    a = 0.02
    supports = {"BOTTOM": {"y": 0.0}, "RIGHT": {"x": a * R}, "TOP": {"y": 0.03}}
    layer, whole = ThinLayer(GLUE, EPS, order=order, at=1.0), structure(rods(), supports)
    full, limit = solve(whole.full(layer)), solve(whole.interface(layer))
    row = compare(full, limit)
    if order == 1:
        assert max(row["error_traction"], row["error_jump"]) < 1e-8
    else:
        assert row["error_traction"] > 1e-3
    surface = Surface(limit.model)
    t, w = (surface.integral(f[1]) / (np.pi * R**2) for f in (surface.traction(limit), surface.jump(limit)))
    assert t == pytest.approx((GLUE.lmbda + 2 * GLUE.mu) * w + order * 2 * GLUE.lmbda * EPS * a, rel=1e-8)


@pytest.mark.parametrize("name", ["Mohr-Coulomb", "Stack"])
def test_meshed_layers_of_compiled_laws_see_all_four_strains(name):
    """A widened layer yields as the law does in space, with equal strains 11 and 33."""
    a, rise = 0.02, -0.03
    soft = MohrCoulomb(GLUE.lmbda, GLUE.mu, 0.002, 30.0, 0.01)
    law = soft if name == "Mohr-Coulomb" else Stack((0.4, soft), (0.6, soft))
    supports = {"BOTTOM": {"y": 0.0}, "RIGHT": {"x": lambda x, t: t * a * R}, "TOP": {"y": lambda x, t: t * rise}}
    state = march(structure(rods(), supports).full(ThinLayer(law, EPS, at=1.0)), [0.5, 1.0]).last
    stress = np.array(state.mean_stress())
    axial = (stress[1, 1] - 2 * BODY.lmbda * a) / (BODY.lmbda + 2 * BODY.mu)  # of the rods
    layer_height = (rise - 1.1 * axial) / EPS
    assert stress[1, 1] == pytest.approx(_of_point(soft, a, layer_height), rel=2e-3)


def _of_point(law, a, axial):
    """Stress 22 of the law at a point of the layer, in two steps."""
    from tests.at_points import respond

    real, n = law.scaled(EPS), np.array([[0.0, 1.0, 0.0]])
    e = np.array([[a, axial, a, 0, 0, 0]])
    q, old = np.zeros((1, law.memory)), np.zeros((1, 6))
    for share in (0.5, 1.0):
        answer = respond(real, share * e, old, q, n)
        q, old = answer.q, share * e
    return answer.stress[0, 1]


# ---------------------------------------------------------------- rods in space
@pytest.mark.long
def test_rods_in_space_are_their_section():
    """Bending opens one half of S as much as it closes the other: means are those of tension alone, which a section has."""
    (joint, setup), layer, R = problems.rods((6.0, 4.0)), ThinLayer(problems.GLUE, 0.4), problems.ROD_RADIUS
    cut = sandwich(R, problems.ROD_HEIGHT, problems.ROD_HEIGHT, 2.0, h_S=0.8, h_ends=0.3)
    pulled = {"TOP": (0.0, problems.ROD_STRESS)}
    section = Structure(cut, body=problems.STEEL, supports={"BOTTOM": 0.0}, tractions=pulled, plane="axisymmetric")

    def means(whole, build):
        state, surface = solve(build(whole, layer)), Surface(whole.interface(layer))
        rise = state.integral(state.u[1] * state.model.ds(state.model.domain.values("TOP")))
        weight = 1 - (surface.x[::2] ** 2).sum(axis=0) / R**2  # equilibrium alone gives the plain mean
        normal = surface.frame(surface.traction(state))[-1]
        return rise / (np.pi * R**2), surface.integral(weight * normal) / surface.integral(weight)

    for build in (Structure.full, Structure.interface):
        assert means(Structure(joint, **setup), build) == pytest.approx(means(section, build), rel=0.01)


# ---------------------------------------------------------------- tubes
def test_bonded_tubes_are_those_of_lame():
    joint, layer = tubes(cell="quadrilateral", structured=True), ThinLayer(GLUE, EPS, at=1.0)
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
    force = surface.integral(surface.frame(surface.traction(full))[1]) / (2 * np.pi * 0.4)
    forces = [meshed.stress(1, r) * r for r in (3 - EPS / 2, 3.0, 3 + EPS / 2)]  # the mean through the layer, on S
    assert force == pytest.approx(np.dot((1, 4, 1), forces) / 6, rel=1e-4)


BETWEEN_TUBES = [Maxwell(3.0, 2.0, 0.8, 2.5), Incompressible(2.0), MohrCoulomb(3.0, 2.0, 0.02, 30.0, 0.05)]


@pytest.mark.parametrize("law", BETWEEN_TUBES)
def test_the_layer_between_tubes_tends_to_its_law_at_rate_1(law):
    """Also that of the jump, which is zero across an incompressible layer on S."""
    whole, rows = structure(tubes(cell="quadrilateral", structured=True), HELD, tractions={"BOTTOM": (P, 0.0)}), []
    for eps in (0.08, 0.04):
        layer = ThinLayer(law, eps, at=1.0)
        models = whole.full(layer, bodies="extended"), whole.interface(layer)
        full, limit = (march(model, [0.2, 0.6]).last for model in models)
        rows.append(compare(full, limit))
    traction, jump = (np.log2(rows[0][name] / rows[1][name]) for name in ("error_traction", "error_jump"))
    assert 0.9 < traction < 1.16  # 1.153 of Mohr-Coulomb, whose next term shows; 1.134 by the bodies' reactions
    assert isinstance(law, Incompressible) or 0.9 < jump < 1.15


# ---------------------------------------------------------------- contact
def test_a_pressed_disc_has_one_pressure_at_all_nodes():
    """Which holds only if each node has the area of revolution that its function of degree 1 has."""
    setup = {"body": LinearElastic.young(90.0, 0.0), "tractions": {"TOP": (0.0, -0.7)}, "element": "P1"}
    disc = Structure(block(1.3, 0.6, 0.2), **setup, supports={}, plane="axisymmetric")
    state = solve(disc.interface(HolonomicCoulomb(250.0, 80.0, friction=0.3)))
    report = Surface(state.model).contact(state)
    assert report.p == pytest.approx(0.7, rel=1e-9)
    assert report.areas.sum() == pytest.approx(np.pi * 1.3**2, rel=1e-12)


# ---------------------------------------------------------------- supports, periods, refusals


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
    assert solve(springs.bonded()).energies()["springs BOTTOM"] == pytest.approx(P**2 / 8 * np.pi * R**2, rel=0.2)


def _tubes(**options):
    return structure(tubes(), HELD, **options)


def _ring():
    joint = periodic(tubes(cell="quadrilateral", structured=True, height=1.0), ("LEFT", "RIGHT"))
    return structure(joint, {}).interface(ThinLayer(GLUE, EPS, at=1.0))


def _rods(**options):
    return structure(rods(), {"BOTTOM": 0}, **options)


def test_what_cannot_be_turned():
    for build, message in [
        (lambda: structure(rods().moved((-0.1, 0.0)), {}), r"x is the distance from the axis of revolution, and \d+ p"),
        (lambda: structure(tubes(r_S=0.0), {}), "allowed: x >= 0"),
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
    ]:  # fmt: skip
        refused(InputError, message, build)
