"""Parameters that are functions of the place, and bodies of several materials: closed forms, files, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_square
from mpi4py import MPI

from forms import Anisotropic, LinearElastic, Maxwell, MohrCoulomb, NonMonotone, Stack, VonMises, work
from forms.base import InputError
from forms.parameter_fields import as_parameter_field
from geometry import sandwich
from studies.problems import fourier
from tests.columns_in_time import column
from tests.columns_in_time import joint as one_cell
from tests.own_laws import Cubic, Slipping
from tests.refused import refused
from tests.test_order1 import relative_errors
from thinlayer import RangeWarning, StepProblem, Structure, Surface, ThinLayer, drive, march, solve

pytestmark = pytest.mark.few(5)

JOINT = sandwich(1.0, 0.5, 0.5, 0.25, structured=True)
SUPPORTS = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
LOADS = {"TOP": lambda x, t: (0.3 * t, t * (1 + x[0]))}
BODY, GLUE = LinearElastic.young(100.0, 0.3), LinearElastic.young(90.0, 0.3)
METAL = VonMises(60.0, 40.0, strength=1.0, hardening=20.0)


def constant(value):
    return lambda x: np.full(x.shape[1], value)


def structure(body=BODY, **data):
    return Structure(JOINT, **{"body": body, "supports": SUPPORTS, "tractions": LOADS} | data)


def kinds(structure, layer, **options):
    return structure.full(layer, **options), structure.interface(layer)


PAIRS = {
    "body": (dict(body=BODY), dict(body=LinearElastic.young(constant(100.0), 0.3)), GLUE, GLUE),
    "layer": ({}, {}, GLUE, LinearElastic.young(90.0, constant(0.3))),
    "yielding": (dict(body=METAL), dict(body=replace(METAL, strength=constant(1.0))), GLUE, GLUE),
    "user": ({}, {}, Cubic(60.0, 1e3), Cubic(constant(60.0), constant(1e3))),
    "plane stress": (dict(plane="stress"), dict(plane="stress", body=LinearElastic(constant(57.0), 38.0)), GLUE, GLUE),
}  # fmt: skip
PAIRS["plane stress"][0]["body"] = LinearElastic(57.0, 38.0)


@pytest.mark.parametrize("name", PAIRS)
def test_a_constant_function_is_its_number(name):
    first, second, law, other = PAIRS[name]
    for k in (0, 1):
        pair = ((first, law), (second, other))
        models = [kinds(structure(**data), ThinLayer(layer_law, 0.1, at=1.0))[k] for data, layer_law in pair]
        a, b = (march(model, [0.5, 1.0]).last for model in models)
        assert a.report.method == b.report.method
        assert np.abs(b.u.x.array - a.u.x.array).max() < 1e-8 * np.abs(a.u.x.array).max()
        assert b.energies() == pytest.approx(a.energies(), rel=1e-8, nan_ok=True)


def test_a_graded_column():
    """Compliance that is linear in the height: u_top = t (h/K_0 + a h^2/2)/..., exact for elements of degree 2."""
    modulus = lambda x: 100.0 / (1 + 0.8 * (x[1] + 0.5))
    data = column("normal", load=2.0) | {"body": VonMises(modulus, lambda x: 0.5 * modulus(x), strength=100.0)}
    layer = ThinLayer(LinearElastic(60.0, 40.0), 0.1, at=1.0)
    for model in kinds(Structure(one_cell(), **data), layer, cells_through=1):
        top = np.abs(solve(model).u.x.array).max()
        assert top == pytest.approx(2.0 * ((1 + 0.8 / 2) / 200.0 + 1 / 140.0), rel=1e-10)


def test_a_layer_that_is_graded_along_S():
    """Between bodies that are as good as rigid it carries the mean of its stiffness."""
    rigid, w = LinearElastic.young(1e7, 0.3), 0.02
    law = LinearElastic(lambda x: 60 * (1 + x[0] ** 2), lambda x: 40 * (1 + x[0] ** 2))
    supports = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}, "TOP": {"x": 0.0, "y": w}}
    for layer_law in (law, Stack((0.3, law), (0.7, law)), MohrCoulomb(law.lmbda, law.mu, 50.0, 30.0)):
        model = structure(rigid, supports=supports, tractions=None).interface(ThinLayer(layer_law, 0.1, at=1.0))
        state, surface = solve(model), Surface(model)
        assert surface.integral(surface.traction(state)[1]) == pytest.approx(140 * w * 4 / 3, rel=1e-3)
        full = solve(structure(rigid, supports=supports, tractions=None).full(ThinLayer(layer_law, 0.1, at=1.0)))
        assert surface.integral(surface.traction(full)[1]) == pytest.approx(140 * w * 4 / 3, rel=1e-3)
        assert full.energies()["layer"] == pytest.approx(140 * w**2 / 2 * 4 / 3, rel=1e-3)


@pytest.mark.parametrize(("order", "ratio"), [(0, (1.8, 2.2)), (1, (3.5, 4.5))])
def test_the_error_of_a_graded_layer_falls_with_the_thickness(order, ratio):
    joint, setup = fourier(1 / 8, cell="quadrilateral")
    law = LinearElastic.young(lambda x: 104 * (1 + 0.5 * np.sin(np.pi * x[0]) ** 2), 0.3)
    errors = []
    for eps in (1 / 16, 1 / 32):
        full, limit = kinds(Structure(joint, **setup), ThinLayer(law, eps, order=order, at=1.0))
        errors.append(relative_errors(solve(full), solve(limit)))
    for thick, thin in np.transpose(errors):
        assert ratio[0] < thick / thin < ratio[1]


def test_a_body_of_several_materials():
    """Two halves of the upper body, side by side or on top of each other: stiffnesses or compliances add up."""
    stiff, soft = LinearElastic(60.0, 40.0), LinearElastic(30.0, 20.0)
    layer = ThinLayer(LinearElastic(60.0, 40.0), 0.1, at=1.0)
    centres = JOINT.points[JOINT.corners].mean(axis=1)
    upper = JOINT.region == JOINT.regions.index("UPPER")
    region = np.where(upper & (centres[:, 1] > 0.25), len(JOINT.regions), JOINT.region)
    patched = replace(JOINT, regions=(*JOINT.regions, "PATCH"), region=region)
    remember = {"UPPER": VonMises(60.0, 40.0, 9.0), "PATCH": Maxwell(30.0, 20.0, 1e9)}
    for laws in ({"UPPER": stiff, "PATCH": soft}, remember):
        data = column("normal", load=2.0) | {"body": {"LOWER": stiff, **laws}}
        for model in kinds(Structure(patched, **data), layer):
            state = solve(model)
            assert np.abs(state.u.x.array).max() == pytest.approx(2.0 * (0.75 / 140 + 0.25 / 70 + 1 / 140), rel=1e-9)
            assert {key for key in state.memory if "PATCH" in key} <= {"body PATCH"}


def test_values_out_of_range():
    for law, message in [
        (lambda: LinearElastic.young(lambda x: 100 - 300 * x[0], 0.3), r"E is -?[\d.]+; allowed: > 0, at x = \(.*\)"),
        (lambda: LinearElastic.young(100.0, lambda x: 0.3 + x[0] / 4), r"nu is 0\.5\d*; allowed: -1 < nu < 0.5, at x = \("),
        (lambda: LinearElastic(lambda x: -50 + 0 * x[0], 40.0), r"lmbda is -50.0; allowed: > -2 mu/3 = .*, at x = \("),
        (lambda: replace(METAL, strength=lambda x: x[0] - 0.5), r"strength is -.*; allowed: > 0, finite, at x = \("),
        (lambda: LinearElastic(lambda x: np.zeros(3), 40.0), r"lmbda\(x\) fails .*the shape \(3,\) .*n numbers"),
        (lambda: LinearElastic(lambda x: 1 / 0, 40.0), r"lmbda\(x\) fails .*ZeroDivisionError"),
    ]:  # fmt: skip
        refused(InputError, message, lambda law=law: structure(law()).interface(ThinLayer(GLUE, 0.1, at=1.0)))
        refused(InputError, message, lambda law=law: structure().full(ThinLayer(law(), 0.1, at=1.0)))


def test_what_takes_no_functions():
    function = lambda x: x[0]
    for build in (lambda: Slipping(function, 30.0, 12.0, 90.0), lambda: Anisotropic(function)):
        refused(InputError, r"allowed: (a number|numbers)", build)
    with pytest.raises(InputError, match=r"lmbda is a function of places; allowed: a number, as `at` gives"):
        NonMonotone(function, 40.0, 0.2, 0.02, np.eye(2))
    message = "lmbda is a function of the place, or of time; a point needs numbers"
    refused(InputError, message, lambda: drive(LinearElastic(function, 40.0), [{"w_T": 0.1}]))


def test_ranges_are_those_of_fields():
    hard = LinearElastic.young(lambda x: 3e4 * (0.01 + x[0]), 0.3)
    with pytest.warns(RangeWarning, match="order 0 leaves out jumps"):
        solve(structure().interface(ThinLayer(hard, 0.1, at=1.0)), 1.0)
    locking = LinearElastic.young(90.0, lambda x: 0.3 + 0.199 * x[0])
    assert np.isfinite(solve(structure().interface(ThinLayer(locking, 0.01, order=1, at=1.0))).energies()["layer"])


def test_numbers_and_functions_combine_in_their_order():
    x, k = np.array([[4.0, 8.0], [0.0, 0.0]]), as_parameter_field(lambda x: x[0])
    assert [(1 - k)(x).tolist(), (2 / k)(x).tolist()] == [[-3.0, -7.0], [0.5, 0.25]]
    assert (k * np.array(3))(x).tolist() == [12.0, 24.0]
    refused(TypeError, "Field", lambda: k * np.array(True))


def test_a_range_is_missed_nowhere():
    """One place of many where a ratio is out of range."""
    x = np.linspace(0.0, 1.0, 100_001)[None].repeat(2, axis=0)
    law = LinearElastic(lambda x: np.where(abs(x[0] - 0.00777) < 1e-9, -39.0, -20.0), lambda x: 58.0 + 1e-3 * x[0])
    refused(InputError, r"lmbda is -39.0; allowed: > -2 mu/3 = -38.6667, at x = \(0.00777", lambda: law.check_at(x))


def test_a_script_of_ones_own():
    """Terms of `forms.work` in a `StepProblem`: evaluated at points, and checked there."""
    mesh = create_unit_square(MPI.COMM_WORLD, 2, 2)
    V = fem.functionspace(mesh, ("Lagrange", 1, (2,)))
    u, v = fem.Function(V), ufl.TestFunction(V)
    nothing, energies = fem.Constant(mesh, 0.0) * ufl.inner(u, v) * ufl.dx, []
    for law in (LinearElastic.young(lambda x: 100 + 0 * x[0], 0.3), BODY):
        problem = StepProblem(nothing, u, terms=[work.body(law, ufl.dx(domain=mesh))])
        u.interpolate(lambda x: (0.01 * x[0], 0.02 * x[1] * x[0]))
        x, out = u.x.petsc_vec, u.x.petsc_vec.duplicate()
        problem.begin(0.0)
        problem.residual(None, x, out)
        energies.append(x.dot(out))
        problem.destroy()
    assert energies[0] == pytest.approx(energies[1], rel=1e-12)
    wrong = work.body(LinearElastic.young(lambda x: 100 - 200 * x[0], 0.3), ufl.dx(domain=mesh))
    refused(InputError, r"E is .* at x", lambda: StepProblem(nothing, u, terms=[wrong]))


def test_parameters_between_parted_bodies_are_those_on_s():
    """S, at y = 0, is halfway between faces of bodies that have given way."""
    laws = LinearElastic(60.0, 40.0), LinearElastic(60.0, lambda x: 40.0 + 900.0 * x[1])
    models = [structure().interface(ThinLayer(law, 0.05), bodies="extended") for law in laws]
    assert max(relative_errors(*(solve(model, 1.0) for model in models))) < 1e-9
