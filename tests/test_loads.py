"""Loads, supports and temperatures: what functions of place and time may do, tables of values, what is no number."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

from forms import LinearElastic, Maxwell, NonMonotone, Stack, Tabulated
from forms.base import InputError
from geometry import block, disc, sandwich
from tests.refused import refused
from tests.viscous_joints import JOINT
from thinlayer import Adaptive, ArcLength, Pressure, Structure, ThinLayer, drive, march, piecewise, solve
from thinlayer.parts.compiled_part import CompiledPart
from thinlayer.solving.equations import Equations

GLUE = LinearElastic(lmbda=60.0, mu=40.0)
SIDES = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
CHI = [[0.0, 0.5], [0.5, 1.0]]


def model(load=(0.0, 1.0), law=GLUE, kind=Structure.interface, **change):
    setup = {"body": LinearElastic.young(100.0, 0.3), "supports": SIDES, "tractions": {"TOP": load}}
    return kind(Structure(JOINT, **setup | change), ThinLayer(law, 0.1, at=1.0))


def pulled(model, *times):
    """Resultants of the loads along y at some times."""
    equations, out = Equations(model), []
    for t in times:
        out.append(float(equations.loads_at(t).array_r[1::2].sum()))
    return out


# ---------------------------------------------------------------- functions of x and t
USED = [
    lambda x, t: float(t),
    lambda x, t: math.sin(t),
    lambda x, t: np.interp(t, [0, 1], [0, 2]),
    lambda x, t: 1.0 if t == 1.23 else 2.0,
    lambda x, t: 1.0 if t in (1, 2) else 2.0,
    lambda x, t: max(t, 1.0),
    lambda x, t: 2.0 * (x[1] != 0),
    lambda x, t: np.sin(x[0]),
]


@pytest.mark.parametrize("used", USED)
def test_x_and_t_are_no_numbers(used):
    """Each would be found once, when the model is built, and stay as it is."""
    remedy = r"(is not a function \(x, t\)|gives nan).*ufl\.conditional\(.*piecewise\(\{time: value"
    refused(InputError, f"traction on 'TOP' {remedy}", lambda: model(lambda x, t: (0.0, used(x, t))))
    refused(InputError, f"component y {remedy}", lambda: model(tractions={}, supports={"TOP": {"y": used}}))


def test_what_ufl_does_with_x_and_t_is_right():
    """Comparisons of expressions with each other, of conditions, and what numpy hands on to them; x and t mean no more."""
    load = lambda x, t: np.array([0 * x[0], np.abs(-t) * ufl.conditional(ufl.And(ufl.ne(t, 1), t > x[0]), 1.0, 3.0)])
    assert pulled(model(load), 1.0, 2.0) == pytest.approx([3.0, 2.0], rel=1e-12)
    x = ufl.SpatialCoordinate(model().domain.mesh)
    assert (x[0] == 0) is False  # UFL is left as it was
    assert bool(x[0])


def test_comparisons_that_symbols_do_not_know_are_refused_with_the_place_and_both_values():
    message = r"at \(1, .*\), t = 0\.37 it gives \[0\.0, 1\.0\] for symbols and \[0\.0, 2\.0\] for numbers"
    refused(InputError, message, lambda: model(lambda x, t: (0.0, 2.0 if x[0] == 1 else 1.0)))
    assert pulled(model(lambda x, t: (0.0, 2.0 if x[0] == 0.123 else 1.0)), 1.0) == pytest.approx([1.0])  # nowhere


def test_what_is_given_on_a_mesh_of_its_own():
    """Fields, alone or in functions, as loads: the same as a function."""
    plate = mesh.create_rectangle(MPI.COMM_SELF, [(-0.1, -1.0), (1.1, 1.0)], [8, 8])
    pairs = fem.Function(fem.functionspace(plate, ("Lagrange", 1, (2,))))
    pairs.interpolate(lambda x: np.array([0 * x[0], 1 + x[0]]))
    numbers = fem.Function(fem.functionspace(plate, ("Lagrange", 1)))
    numbers.interpolate(lambda x: 1 + x[0])
    for load in (lambda x, t: (0.0, 1 + x[0]), pairs, lambda x, t: (0.0, t * numbers), Pressure(numbers)):
        assert np.abs(pulled(model(load), 1.0)) == pytest.approx([1.5], rel=1e-6)


# ---------------------------------------------------------------- tables
def test_tables_of_any_length():
    """The same form for all of them, looked up as time goes on; in a function, for another argument, of the place too."""
    times = np.linspace(0.0, 2.0, 20_001)
    table = piecewise(dict(zip(times, np.sin(3 * times), strict=True)))
    short = piecewise({0.0: 0.0, 0.5: 2.0, 2.0: -1.0})
    loads = {
        "alone": (piecewise({0.0: (0.0, 0.0), 0.5: (0.0, 2.0), 2.0: (0.0, -1.0)}), 1.0),
        "in a function": (lambda x, t: (0.0, 3 * short(x, t)), 3.0),
        "in minutes": (lambda x, t: (0.0, short(x, (120 * t - 60) / 60 / 2 + 0.5)), 1.0),
        "of the place": (lambda x, t: (0.0, short(x, t + 0 * x[0])), 1.0),
    }
    for load, factor in loads.values():
        expected = factor * np.interp([0.3, 1.7], [0.0, 0.5, 2.0], [0.0, 2.0, -1.0])
        assert pulled(model(load), 0.3, 1.7) == pytest.approx(expected, rel=1e-12)
    long = model(lambda x, t: (0.0, table(x, t)))
    assert pulled(long, 0.3, 1.7) == pytest.approx(np.sin([0.9, 5.1]), abs=1e-8)
    assert len(long.break_times) == 20_001
    wave = model(lambda x, t: (0.0, short(x, ufl.min_value(t + x[0], 2.0))))  # it runs along S
    assert pulled(wave, 1.0) == pytest.approx([0.0], abs=1e-12)
    assert table(None, 0.5) == pytest.approx(math.sin(1.5), abs=1e-8)
    assert piecewise({0: (1, 2), 1: (3, 5)})(None, 0.5) == [2.0, 3.5]


def test_breaks_are_where_slopes_change():
    table = piecewise({0: 0.0, 1: 2.0, 2: 4.0, 3: 5.0, 6: 8.0, 9: 0.0})
    assert model(lambda x, t: (0.0, table(x, t))).break_times == {0.0, 2.0, 6.0, 9.0}
    assert model(lambda x, t: (0.0, table(x, 3 * t - 3))).break_times == {1.0, 5 / 3, 3.0, 4.0}
    assert model(supports=SIDES | {"TOP": {"y": table}}, tractions={}).break_times == {0.0, 2.0, 6.0, 9.0}
    for argument in (lambda t: t * t, lambda t: ufl.conditional(ufl.gt(t, 100), 2 * t, t), lambda t: 1 / t):
        assert model(lambda x, t, f=argument: (0.0, table(x, f(t)))).break_times == set()


def test_tables_have_ends():
    """With an error beyond them, but for the rounding of a sum of steps."""
    loaded_model = model(piecewise({0.1: (0.0, 1.0), 0.3: (0.0, 2.0)}))
    assert pulled(loaded_model, 0.1 + 0.1 + 0.1) == pytest.approx([2.0])
    for t in (0.099, 0.301):
        refused(InputError, rf"not finite at t = {t}: traction on 'TOP'", pulled, loaded_model, t)


def test_a_temperature_from_a_table():
    """Linear between its times, in a layer that forgets; steps end where it breaks."""
    alpha, T = Tabulated([(0.0, 0.5), (100.0, 1.5)]), piecewise({0: 0.0, 0.4: 100.0, 1: 50.0})
    law = NonMonotone(60.0, 40.0, alpha, 0.15, CHI, T=T)
    (laws,) = (part.points for part in Equations(model(law=law)).of_kind(CompiledPart))
    for t, expected in ((0.2, 1.0), (0.7, 1.25)):
        laws.set_time(t)
        assert laws.material.parameters[:, 2] == pytest.approx(expected, rel=1e-12)
    assert model(law=law).break_times == model(law=Stack((0.5, GLUE), (0.5, law))).break_times == {0.0, 0.4, 1.0}
    refused(InputError, "T is nan", lambda: laws.set_time(1.1))


# ---------------------------------------------------------------- temperatures and supports
@pytest.mark.parametrize(("bodies", "across"), [("kept", 0.0), ("extended", 0.05)])
def test_temperatures_are_asked_for_in_the_joint_before_inflating(bodies, across):
    """Kept bodies are moved apart to make room: all the layer is at the height of S. Others give up half of it each."""
    seen = []

    def T(x, t):
        seen.append(x)
        return 20 + 100 * x[1]

    law = NonMonotone(60.0, 40.0, Tabulated([(0.0, 0.5), (100.0, 1.5)]), 0.15, CHI, T=T)
    for part in Equations(model(law=law, kind=partial(Structure.full, bodies=bodies))).parts:
        part.set_time(0.0)
    assert np.abs(seen[-1][1]).max() == pytest.approx(across, rel=0.2, abs=1e-12)
    assert np.ptp(seen[-1][0]) > 0.8


def test_a_rigid_base_does_not_move_with_a_side():
    """Where the side of the layer meets the base two supports overlap."""
    sides = {"LEFT": {"x": 0.01, "y": 0.02}, "RIGHT": {"x": 0.0}}
    setup = {"body": LinearElastic.young(100.0, 0.3), "supports": sides, "tractions": {"TOP": (0.0, -1.0)}}
    full = Structure(block(1.0, 0.5, 0.25), **setup).full(ThinLayer(GLUE, 0.1, at=1.0))
    x, u = full.V.tabulate_dof_coordinates(), solve(full).u.x.array.reshape(-1, 2)
    base, left = np.isclose(x[:, 1], x[:, 1].min()), np.isclose(x[:, 0], 0.0)
    assert (base & left).sum() == 1
    assert not u[base].any()
    assert u[left & ~base] == pytest.approx(np.tile([0.01, 0.02], (np.count_nonzero(left & ~base), 1)), rel=1e-12)


# ---------------------------------------------------------------- what is no number
MARCHED = Maxwell(60.0, 40.0, t1=0.7)


def test_booleans_and_complex_numbers_are_refused():
    """True would be 1: a displacement of 1 where a support was meant to hold."""
    for wrong, message in [
        (lambda: model((True, 0.0)), "needs 2 finite components"),
        (lambda: model(lambda x, t: (1j * t, 0.0)), "of finite real numbers"),
        (lambda: model(supports=SIDES | {"BOTTOM": True}), "component x is True; it needs a finite number"),
        (lambda: model(supports=SIDES | {"BOTTOM": {"y": lambda x, t: t > 1}}), "it needs a finite number"),
        (lambda: piecewise({0: True, 1: 2.0}), "True or False"),
        (lambda: piecewise({False: 1.0, True: 2.0}), "piecewise needs"),
        (lambda: ThinLayer(GLUE, True), "eps is True"),
        (lambda: ThinLayer(GLUE, 0.1, order=True, at=1.0), "order of the interface law is True"),
        (lambda: ThinLayer(GLUE, 0.1, at=True), "at, is True"),
        (lambda: model(law=GLUE, kind=partial(Structure.full, cells_through=True)), "cells_through is True"),
        (lambda: sandwich(1.0, 0.5, 0.5, h=True), "h is True"),
        (lambda: disc(1.0, 1.0, 1.0, degree=True), "degree is True"),
        (lambda: march(model(law=MARCHED), [2.0], theta=True), "theta is True"),
        (lambda: Adaptive(2.0, 0.1, at=[True]), "at is"),
        (lambda: ArcLength(1.0, True), "first is True"),
        (lambda: solve(model(), True), "t is True"),
        (lambda: drive(GLUE, [{"w_T": 0.1, "w_N": 0.0}], dt=[True]), "dt is"),
    ]:
        refused(InputError, message, wrong)


def test_numbers_within_expressions_are_finite():
    """Others cannot be compiled."""
    nested = lambda x, t: ufl.sin(ufl.max_value(t, -np.inf))
    compared = lambda x, t: (ufl.conditional(ufl.gt(x[0], math.nan), 1.0, 0.0), 0.0)
    for data in ({"body_force": compared}, {"supports": SIDES | {"BOTTOM": {"y": nested}}}):
        refused(InputError, "of finite real numbers", model, **data)
    state = solve(model())
    refused(InputError, "has a number that is not finite", lambda: state.integral(math.nan * state.u[0] * ufl.dx))


def test_places_are_names_or_points():
    words = r"a place is \(1\.0, 0\.5\); it must be the name of a facet set.*BOTTOM, LEFT, RIGHT, TOP"
    refused(InputError, words, lambda: model(tractions={(1.0, 0.5): (1.0, 0.0)}))
    refused(InputError, r"tractions is .*give \{name: traction\}", lambda: model(tractions=[(1.0, 0.0)]))
    for place in (5, None, (1.0,), (1.0, "a"), (True, 0.0)):
        refused(InputError, "2 coordinates|the mesh has 2", lambda place=place: model(supports=SIDES | {place: 0.0}))
