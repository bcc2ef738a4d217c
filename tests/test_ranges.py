"""Layers that are thick, hard or overlapping are told, once on all ranks; slip that opens nothing is not."""

from __future__ import annotations

import re

import numpy as np
import pytest
import ufl

from forms import Anisotropic, Incompressible, LinearElastic, MohrCoulomb, MohrCoulombMonodirectional, Stack, VonMises
from geometry import block, ring, sandwich
from studies.problems import FOURIER_LAYER
from tests.ranges_told import STIFF, excess, strip_excess, times_too_stiff, with_warnings
from tests.refused import refused
from thinlayer import SolveError, Structure, Surface, ThinLayer, compare, estimate, march, solve
from thinlayer.surface.pressure_excess import jump_stiffness


# ---------------------------------------------------------------- jumps that are no openings
def test_slip_alone():
    """Openings that are rounding, or the mesh's noise, do not count; the whole layer is as stiff as it should be."""
    rubber = LinearElastic.shear(16.0, 0.499)
    turned = {"supports": {"OUTSIDE": 0.0}, "tractions": {"INSIDE": lambda x, t: (-x[1], x[0])}}
    along = {"supports": {"BOTTOM": 0.0, "TOP": {"x": 0.01, "y": 0.0}}}
    move = {"x": 0.7, "y": -0.2}  # both bodies: jumps are rounding
    alike = {"supports": {"BOTTOM": move, "TOP": move, "LEFT": {"x": 0.7}, "RIGHT": {"x": 0.7}}}
    for joint, law, data in (
        (ring(1.0, 1.5, 2.0, h=0.3, degree=2), rubber, turned),
        (sandwich(8.0, 0.3, 0.3, 1 / 8, cell="quadrilateral"), rubber, along),
        (sandwich(2.0, 0.3, 0.5, 1 / 8, cell="quadrilateral"), LinearElastic.shear(16.0, 0.4999999), alike),
    ):
        model = Structure(joint, body=STIFF, **data).interface(ThinLayer(law, 1 / 64, at=1.0))
        assert with_warnings(lambda model=model: solve(model))[1] == []


def test_slip_on_straight_facets():
    """Of a curved S: they open and close as they slide, and the law resists, to more than twice what the layer does."""
    supports, tractions = {"OUTSIDE": 0.0}, {"INSIDE": lambda x, t: (-x[1], x[0])}
    layer = ThinLayer(LinearElastic.shear(16.0, 0.499), 0.05, at=1.0)
    model = Structure(ring(1.0, 1.5, 2.0, h=0.3), body=STIFF, supports=supports, tractions=tractions).interface(layer)
    per_area = layer.law.lmbda + 2 * layer.law.mu, layer.law.mu  # of a law per thickness
    assert jump_stiffness(model.layers["S"]) == pytest.approx(per_area, rel=1e-12)
    _, (message,) = with_warnings(lambda: solve(model))
    assert times_too_stiff(message) > 2
    assert "its facets are straight, 3.3 degrees off its normal" in message


@pytest.mark.parametrize("degree", [1, 2])
def test_slip_that_nothing_resists_but_facets(degree):
    """A shaft that a moment turns in a bearing without friction; on curved cells there is no solution."""
    springs, glue = Anisotropic.springs(7.0, 0.0), LinearElastic.shear(0.3, 0.4)
    twist = {"INSIDE": lambda x, t: (-0.2 * x[1], 0.2 * x[0])}
    data = {"body": STIFF, "supports": {"OUTSIDE": 0.0}, "tractions": twist}
    joint = ring(1.0, 1.5, 2.0, h=0.2, degree=degree)
    for law in (springs, Stack((0.4, glue), (0.6, springs))):
        model = Structure(joint, **data).interface(ThinLayer(law, 0.05, at=1.0))
        if degree == 1:
            assert "which resists by the mesh alone" in with_warnings(lambda model=model: solve(model))[1][0]
        else:
            refused(SolveError, r"can turn|can move freely", solve, model)
    assert with_warnings(lambda: solve(Structure(joint, **data).interface(ThinLayer(glue, 0.05, at=1.0))))[1] == []


@pytest.mark.parametrize("slip", [0.0, 2e-3])
def test_slip_beside_opening(slip):
    """The error of openings is that of a strip; slip takes a part of the traction."""
    law, eps = LinearElastic.shear(3.0, 0.499), 1 / 16
    joint = sandwich(1.0, 0.3, 0.3, 1 / 16, h_S=1 / 128, h_ends=1 / 256)
    model = Structure(joint, body=STIFF, supports={"BOTTOM": 0.0, "TOP": 0.0}).interface(ThinLayer(law, eps, at=1.0))
    error, _ = excess(model, lambda x: (slip + 0 * x[0], 1e-3 + 0 * x[0]))
    assert error == pytest.approx(strip_excess(0.5 / (eps * np.sqrt(law.lmbda / law.mu / 12))), rel=0.01)


# ---------------------------------------------------------------- thick, hard, overlapping
@pytest.mark.parametrize("rigid", [False, True])
def test_thicker_than_a_body(rigid):
    joint = block(2.0, 0.4, 0.2) if rigid else sandwich(2.0, 0.4, 0.7, 0.2)
    for eps, messages in ((0.39, 0), (0.41, 1)):
        model = Structure(joint, body=STIFF, supports={"TOP": 0.0}).interface(ThinLayer(FOURIER_LAYER, eps, at=1.0))
        _, reported = with_warnings(lambda model=model: solve(model))
        assert len(reported) == messages
    assert "thick: the layer is 0.41 thick, the thinner body 0.4 " in reported[0]
    springs = ThinLayer(Anisotropic.springs(60.0, 40.0), 1.0)  # of jumps: there is no thickness in them
    assert with_warnings(lambda: solve(Structure(joint, body=STIFF, supports={"TOP": 0.0}).interface(springs)))[1] == []


@pytest.mark.parametrize("law", [MohrCoulomb, MohrCoulombMonodirectional])
def test_springs_that_hide_a_limit_load(law):
    """Their share of the work, which is that of the force where the layer is sheared alone: 3 % at first, then told."""
    eps, h, shift = 0.05, 0.03, lambda x, t: 0.02 * (t - t**2 / 10)
    mortar = law(0.0, 7.0, cohesion=0.4, friction_angle=25.0, elastic_fraction=h)
    supports = {"BOTTOM": 0.0, "TOP": {"x": shift, "y": 0.0}, "LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}}
    structure = Structure(sandwich(2.0, 0.3, 0.4, 0.5), body=STIFF, supports=supports)
    model = structure.interface(ThinLayer(mortar, eps))
    history, messages = with_warnings(lambda: march(model, [0.1, 3.0, 5.0, 9.0]))
    surface = Surface(model)
    wanted = []
    for state in history:
        w, force = (surface.integral(field(state)) for field in (surface.jump, surface.traction))
        springs = h * 7.0 / eps * w[0]
        wanted.append(springs / max(springs + abs(force[0] - springs), 1e-300))
    assert history.table["elastic share"] == pytest.approx(wanted, rel=1e-3)
    assert (wanted[1], wanted[2] > 0.2, wanted[-1] < 0.2) == (pytest.approx(h, rel=1e-3), True, True)
    assert [message.partition(" springs")[0] for message in messages] == ["elastic share: at t = 5"]
    assert with_warnings(lambda: solve(model, 0.1))[1] == []
    assert solve(structure.full(ThinLayer(mortar, eps)), 0.1).elastic_share == pytest.approx(h, rel=1e-3)


def test_plates_that_bend():
    """Laminated glass: order 0 leaves out a part of the lever, as is told; not if the layer lets the plates slip."""
    for mu, order, size in ((9.0, 0, 1), (9.0, 1, 0), (0.05, 0, 0)):
        supports = {"LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}, (0.0, -5.0): {"x": 0.0}}
        joint = sandwich(300.0, 5.0, 5.0, 2.5, cell="quadrilateral")
        setup = {"supports": supports, "tractions": {"TOP": lambda x, t: (0.0, -2e-3 * ufl.sin(np.pi * x[0] / 300))}}
        glass, layer = Structure(joint, body=LinearElastic.young(70e3, 0.23), **setup), LinearElastic.shear(mu, 0.45)
        glue = ThinLayer(layer, 0.7, order=order)
        limit, messages = with_warnings(lambda s=glass, glue=glue: solve(s.interface(glue)))
        plates = [message for message in messages if message.startswith("plates: ")]
        assert len(plates) == size
        if plates:
            exact = solve(glass.full(ThinLayer(layer, 0.7))).energies()["loads"]
            error = float(re.search("about (.*) too much", plates[0])[1])
            assert error == pytest.approx(limit.energies()["loads"] / exact - 1, rel=0.1)


WAVE = {"TOP": lambda x, t: (0.3, ufl.cos(ufl.pi * x[0]))}
ROLLERS = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
YOUNG = LinearElastic.young
LEFT_OUT = {  # law and thickness of a layer, supports and loads of bodies with E = 1, how far the number may be off
    "waves": (YOUNG(0.5, 0.3), 0.01, ROLLERS, WAVE, 0.15),
    "a quarter of the modulus": (YOUNG(0.25, 0.3), 0.02, {"BOTTOM": 0.0}, {"TOP": (1.0, 1.0)}, 0.15),
    "a lap": (YOUNG(0.02, 0.3), 0.025, {"LEFT/LOWER": 0.0}, {"RIGHT/UPPER": (1.0, 0.0)}, 0.15),
    "wide": (YOUNG(0.25, 0.45), 0.025, {"BOTTOM": 0.0}, {"TOP": (0.0, 1.0)}, 0.3),
    "squeezed": (Incompressible(3e-5), 0.015, ROLLERS, WAVE, 0.3),
    "squeezed, soft bodies": (Incompressible(3e-7), 0.005, ROLLERS, WAVE, 0.3),
    "soft": (YOUNG(0.02, 0.3), 0.01, {"BOTTOM": 0.0}, {"TOP": (1.0, 0.0)}, None),
    "hardly squeezed": (Incompressible(3e-4), 0.01, ROLLERS, WAVE, None),
}


@pytest.mark.parametrize("case", LEFT_OUT)
def test_what_order_0_leaves_out(case):
    """The number is the larger error of jump and traction, against the meshed layer; without it they are below 5 %."""
    law, eps, supports, tractions, tolerance = LEFT_OUT[case]
    joint = sandwich(2.0, 0.5, 0.5, 1 / 8, h_S=1 / 16, h_ends=eps, cell="quadrilateral")
    structure = Structure(joint, body=YOUNG(1.0, 0.3), supports=supports, tractions=tractions)
    state, messages = with_warnings(lambda: solve(structure.interface(ThinLayer(law, eps))))
    row = compare(solve(structure.full(ThinLayer(law, eps), cells_through=2)), state)
    error, numbers = (
        max(row["error_jump"], row["error_traction"]),
        re.findall("that are (.*) of its own", str(messages)),
    )
    if tolerance is None:
        assert (numbers, error < 0.05) == ([], True)
    else:
        assert [float(number) for number in numbers] == [pytest.approx(error, rel=tolerance)]
        assert error > 0.1


def test_bodies_that_overlap():
    """A layer pressed to more than twice its thickness, on average; in a march at a time in between."""
    joint = sandwich(2.0, 0.5, 0.5, 0.25)
    setup = {"body": STIFF, "supports": {"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": lambda x, t: -t * (1 + 0.5 * x[0])}}}
    law = MohrCoulombMonodirectional(1.0, 1.0, cohesion=100.0, friction_angle=30.0)
    model = Structure(joint, **setup).interface(ThinLayer(law, 0.1, at=1.0))
    assert with_warnings(lambda: solve(model, t=0.1325))[1] == []  # 1.99 times
    _, texts = with_warnings(lambda: solve(model, t=0.134))
    assert len(texts) == 1
    assert "at t = 0.134 the layer closes by 2.01 times its thickness, on average over S (most near (2, 0)" in texts[0]
    wedge = Structure(joint, **setup).interface(ThinLayer(law, 0.1, profile=lambda x: 1 + 0.5 * x[0], at=1.0))
    assert "closes by 2.1 times its thickness, on average" in with_warnings(lambda: solve(wedge, t=0.21))[1][0]
    there_and_back = setup["supports"] | {"TOP": {"x": 0.0, "y": lambda x, t: -0.4 * t * (2 - t)}}
    model = Structure(joint, **setup | {"supports": there_and_back}).interface(ThinLayer(law, 0.1, at=1.0))
    _, texts = with_warnings(lambda: march(model, [0.5, 1.0, 2.0]))
    assert len(texts) == 1
    assert "overlap: at t = 1 the layer closes by 4 times" in texts[0]


def test_what_was_said_of_a_state_is_not_said_by_its_estimate():
    """Of a thick layer that closes too far: once of a model, once of each time; of another thickness, or model, anew."""
    joint, law = sandwich(2.0, 0.4, 0.7, 0.2), VonMises(1.0, 1.0, strength=100.0)
    supports = {"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": lambda x, t: -t + 0 * x[0]}}
    structure = Structure(joint, body=STIFF, supports=supports)
    model, keys = structure.interface(ThinLayer(law, 0.45, at=1.0)), ["thick", "overlap"]

    def said(action):
        result, messages = with_warnings(action)
        return result, [message.partition(":")[0] for message in messages]

    state, reported = said(lambda: solve(model, 1.0))
    assert reported == keys
    assert said(lambda: estimate(state))[1] == []
    history, reported = said(lambda: march(model, [0.5, 1.2]))
    assert reported == keys[1:]
    assert said(lambda: estimate(history))[1] == []
    for other in (model.with_layer(ThinLayer(law, 0.42, at=1.0)), structure.interface(ThinLayer(law, 0.45, at=1.0))):
        assert said(lambda other=other: solve(other, 1.0))[1] == keys
