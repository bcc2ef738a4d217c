"""Strength criteria on tractions along S: closed forms of columns and of bars on a layer, load cases, intervals."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from forms import Breaking, LinearElastic
from forms.base import InputError
from geometry import block, ring, sandwich
from tests.on_ranks import on_ranks
from tests.own_laws import Cubic
from tests.refused import refused
from thinlayer import (
    MohrCoulombCriterion,
    QuadraticCriterion,
    StrengthCriterion,
    Structure,
    Surface,
    ThinLayer,
    goals,
    march,
    solve,
    strength,
)

LAW, GLUE, EPS = LinearElastic(60.0, 40.0), LinearElastic(15.0, 7.0), 0.1
BREAKING = Breaking(15.0, 7.0, 3.0, 2.0, 3.0, 4.0)
QUADRATIC, CONE = QuadraticCriterion(3.0, 2.0), MohrCoulombCriterion(2.0, 30.0, 1.5)


def column(t_T, t_N, angle=0.0, depth=0.0, law=GLUE, length=1.0, stress=1.0):
    """A block on its layer, moved on all sides such that the traction on S is uniform, in the given units."""
    joint = block(length, length, length / 2, **({"depth": length, "cell": "hexahedron"} if depth else {}))
    joint, turn = joint.rotated(angle), Rotation.from_euler("z", angle).as_matrix()
    t = np.array([t_T, t_N, 0.3 * depth]) * stress
    moduli = lambda law: np.array([law.mu, law.lmbda + 2 * law.mu, law.mu]) * stress
    gradient, w = turn @ (t / moduli(LAW)), turn @ (t * EPS * length / moduli(law))
    height = lambda x: turn[0, 1] * x[0] + turn[1, 1] * x[1]
    motions = {"xyz"[i]: lambda x, t, i=i: t * (w[i] + gradient[i] * height(x)) for i in range(joint.dim)}
    sides = ["TOP", "LEFT", "RIGHT", *(["BACK", "FRONT"] if depth else [])]
    scaled = lambda law: law.with_parameters({"lmbda": law.lmbda * stress, "mu": law.mu * stress})
    structure = Structure(joint, body=scaled(LAW), supports={side: motions for side in sides})
    return structure.interface(ThinLayer(scaled(law), EPS * length))


@pytest.mark.parametrize("options", [{}, {"angle": 0.4}, {"angle": 2.0, "depth": 1.0}, {"length": 1e-3, "stress": 1e6}])
@pytest.mark.parametrize("t_N", [1.2, -0.9])
def test_closed_forms_of_columns(options, t_N):
    """Oblique, in 3D and in other units; a shear to the other side changes nothing. A wrong twin lacks the brackets."""
    unit, t_T = options.get("stress", 1.0), math.hypot(0.8, 0.3 * options.get("depth", 0.0))
    quadratic, cone = QuadraticCriterion(3 * unit, 2 * unit), MohrCoulombCriterion(2 * unit, 30.0, 1.5 * unit)
    mine = lambda t_N, t_T: (np.maximum(t_N, 0.0) / (3 * unit)) + (t_T / (2 * unit)) ** 2
    a, b = (t_T / 2) ** 2, max(t_N, 0.0) / 3
    values = {quadratic: math.hypot(b, t_T / 2), cone: max((t_T + t_N / 3**0.5) / 2, t_N / 1.5), mine: a + b}
    factors = {mine: (math.sqrt(b * b + 4 * a) - b) / (2 * a)}
    states = [solve(column(s * 0.8, t_N, **options), 1.0) for s in (1, -1)]
    for criterion, value in values.items():
        for result in (strength(state, criterion) for state in states):
            assert result.values == pytest.approx(np.full_like(result.values, value), rel=1e-8)
            exact = value, factors.get(criterion, 1 / value), float(value > 1)
            assert (result.largest, result.safety_factor, result.share) == pytest.approx(exact, rel=1e-8)
    assert (abs(math.hypot(t_N / 3, t_T / 2) / values[quadratic] - 1) > 0.05) == (t_N < 0)


def test_what_no_factor_and_any_factor_breaks():
    """Pressure prevents sliding; compression alone does no damage; some criteria fail without loads."""
    criteria = CONE, lambda t_N, t_T: np.maximum(t_N, 0.0), lambda t_N, t_T: 2.0
    results = [strength(solve(column(0.1, -2.0), 1.0), criterion) for criterion in criteria]
    assert [(r.largest, r.safety_factor) for r in results] == [(0.0, math.inf), (0.0, math.inf), (2.0, 0.0)]


def test_laws_begin_to_break_at_the_safety_factor():
    factor = strength(solve(column(0.8, 1.2), 1.0), QUADRATIC).safety_factor
    history = march(column(0.8, 1.2, law=BREAKING), [0.999 * factor, 1.001 * factor])
    damage = [Surface(history.model).internal(state, "d").max() for state in history]
    assert damage[-2] == 0.0 < damage[-1]
    result = strength(history, QUADRATIC)
    assert (result.cases[0], "but not of loads" in str(result)) == ("state 1, t = 0", True)


# ---------------------------------------------------------------- bars on a layer
LENGTH, P, ALUMINIUM = 20.0, 50.0, LinearElastic.young(70e3, 0.0)
PLATES = sandwich(LENGTH, 1.0, 1.0, h=0.5, cell="quadrilateral", structured=True)


@cache
def bars(load=P, meshed=False, fixed="LEFT/LOWER", pulled="RIGHT/UPPER"):
    supports = {fixed: {"x": 0.0}, "TOP": {"y": 0.0}, "BOTTOM": {"y": 0.0}}
    structure = Structure(PLATES, body=ALUMINIUM, supports=supports, tractions={pulled: (load, 0.0)})
    layer = ThinLayer(LinearElastic(0.0, 100.0), 0.2)
    return solve(structure.full(layer, cells_through=4) if meshed else structure.interface(layer))


def volkersen(x):
    """Shear stress of bars that only stretch, on glue as soft as glue and bars in shear."""
    lag = math.sqrt(2 / 70e3 / (0.2 / 100 + 2 / (3 * 35e3)))
    return P * lag / 2 * np.cosh(lag * (x - LENGTH / 2)) / math.sinh(lag * LENGTH / 2)


def test_bars_of_volkersen():
    """Value, place, share and safety factor, away from the ends and with them; law and mesh."""
    shear = QuadraticCriterion(1e3, volkersen(3.0))  # above 1 within 3 of both ends
    for meshed, rel, at_ends in ((False, 2e-3, 0.015), (True, 8e-3, 0.15)):
        result, all_of_s = (strength(bars(meshed=meshed), shear, ends=ends) for ends in (1.0, 0.0))
        distance = min(result.place[0], LENGTH - result.place[0])
        exact = pytest.approx(volkersen(distance) / volkersen(3.0), rel=rel)
        assert result.largest == exact == 1 / result.safety_factor
        assert 1.0 <= distance == pytest.approx(result.table["to_ends"][0], abs=1e-9)
        assert (result.share, all_of_s.share) == pytest.approx((4 / 18, 6 / 20), abs=0.02)
        assert all_of_s.largest == pytest.approx(volkersen(0.0) / volkersen(3.0), rel=at_ends)
        assert ("give a distance ends=" in str(all_of_s), "ends=" in str(result)) == (True, False)


def test_envelope_of_load_cases():
    """The larger of two loads governs everywhere; of loads at both ends each governs half."""
    result = strength({"half": bars(P / 2), "whole": bars()}, QUADRATIC)
    assert ({*result.governing.ravel()}, " in whole, " in str(result)) == ({"whole"}, True)
    assert result.table["largest"] == pytest.approx(result.largest * np.array([0.5, 1.0, 1.0]))
    of_ends = strength([bars(fixed=f"{x}/LOWER", pulled=f"{x}/UPPER") for x in ("RIGHT", "LEFT")], QUADRATIC)
    assert (of_ends.governing == np.where(result.surface.x[0] < 10, "state 2", "state 1")).all()
    assert [entry.get_ylabel() for entry in result.plot().axes] == ["criterion"]


# ---------------------------------------------------------------- an interval of `estimate`
def numbers_of_bars():
    result = strength({"half": bars(P / 2), "whole": bars()}, CONE, ends=0.5)
    numbers = [result.largest, result.table["to_ends"][-1], result.share, result.safety_factor]
    return numbers, result.place[0], result.interval(4.0)


@on_ranks(numbers_of_bars, 2)
def test_an_interval_contains_the_criterion_of_the_meshed_layer(there):
    """The mean is that of the bodies' traction, with the weight 1 on the stretch, which falls to 0 beyond it."""
    numbers, middle, (lower, upper) = numbers_of_bars()
    near = lambda x: abs(x - middle) <= 2.0
    means = [goals.MeanTraction(direction, where=lambda x: near(x[0])) for direction in ((0, 1), (1, 0))]
    meshed, surface = bars(meshed=True), Surface(bars().model)
    mean = np.array([goal.value(meshed, surface.model) for goal in means])
    weight = surface.at_points(near(surface.places[:, 0]).astype(float))
    exact = surface.integral(surface.reaction(meshed) * weight) / surface.integral(weight)
    assert mean == pytest.approx(exact[::-1], abs=1e-8)
    assert lower <= CONE.value(mean[:1], np.abs(mean[1:]))[0] <= upper < 1.001 * lower
    assert np.append(there[0], there[2]) == pytest.approx(np.append(numbers, (lower, upper)), rel=1e-6, abs=1e-9)
    assert QUADRATIC.interval((-1.0, 1.5), (-0.4, 1.0)) == pytest.approx((0.0, math.hypot(0.5, 0.5)))


def test_an_interval_of_turned_columns_in_space():
    """It does not change with the axes, and both tangential components count: .57 without the second."""
    intervals = [strength(solve(column(0.8, 1.2, angle, 3.0), 1.0), QUADRATIC).interval(9.0) for angle in (0.0, 0.7)]
    assert intervals[0] == pytest.approx(intervals[1], rel=1e-6)
    assert intervals[0] == pytest.approx([math.hypot(1.2 / 3, math.hypot(0.8, 0.9) / 2)] * 2, rel=0.05)


CUBIC = Structure(block(1, 1, 0.5), body=LAW, supports={"TOP": {"y": 0.1}}).interface(ThinLayer(Cubic(2, 300), EPS))
BENT = Structure(ring(1.0, 1.5, 2.0, 0.5, angle=1.2), body=LAW, supports={"OUTSIDE": {"x": 1}, "INSIDE": 0})
judged = lambda criterion=QUADRATIC, **options: strength(bars(), criterion, **options)
stretch = lambda where: goals.MeanTraction((0, 1), where=where).value(bars(), bars().model)
BAD = [
    ("give at least one state", lambda: strength([], QUADRATIC)), ("a state is 3", lambda: strength(3, QUADRATIC)),
    ("ends is -1", lambda: judged(ends=-1)), ("at most 9", lambda: judged(ends=11)), ("seam", lambda: judged(seam="GLUE")),
    ("no numpy function of", lambda: judged(lambda a: a)), ("is nan", lambda: judged(lambda a, b: math.nan)),
    ("no numpy", lambda: judged(StrengthCriterion())), ("the criterion is 40", lambda: judged(40)),
    ("criterion is <class", lambda: judged(QuadraticCriterion)), ("complex128", lambda: judged(lambda a, b: a + 1j * b)),
    ("the lower one first", lambda: QUADRATIC.interval((2, 1))),  ("cutoff is -1", lambda: MohrCoulombCriterion(1, 30, -1)),
    ("joint", lambda: strength([bars(), solve(column(1, 1))], CONE)), ("t_T is 0", lambda: QuadraticCriterion(1, 0)),
    ("cohesion is 0", lambda: MohrCoulombCriterion(0, 30)), ("angle is 90", lambda: MohrCoulombCriterion(1, 90)),
    ("true at one of its nodes", lambda: judged().interval(1e-3)), ("length is 0", lambda: judged().interval(0)),
    ("length is 9", lambda: strength(solve(BENT.interface(ThinLayer(GLUE, EPS))), CONE).interval(9)),
    ("all laws must be linear", lambda: strength(solve(CUBIC, 1), CONE).interval(1)),
    ("where is no numpy", lambda: stretch(lambda: 1)),
]  # fmt: skip


def test_bad_input():
    for words, call in BAD:
        refused(InputError, words, call)
