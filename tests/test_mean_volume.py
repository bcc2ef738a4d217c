"""Bodies whose flow keeps volumes: limit loads in axisymmetry and on quadrilaterals, and strains that are not small."""

import math
import warnings

import numpy as np
import pytest
import ufl
from dolfinx import fem

from forms import VonMises
from geometry import sandwich
from tests.refused import refused
from thinlayer import LimitLoad, RangeWarning, Structure, march, solve
from thinlayer.pointwise.compiled_term import CompiledTerm

pytestmark = pytest.mark.few(5)

A, B, HEIGHT, STRENGTH = 6.0, 18.0, 3.0, 100.0  # mm, MPa
LIMIT = 2 / math.sqrt(3) * STRENGTH * math.log(B / A)  # between ends that do not move along the axis
METAL = VonMises.young(E=70e3, nu=0.3, strength=STRENGTH)


class Pointwise(VonMises):
    """With the volume strains of the displacements, as bodies in forms have them."""

    isochoric = False


def tube(element, body=METAL, load=None):
    """A tube under pressure t from inside, or with the support `load` there: its section through the axis."""
    cell = "triangle" if element[0] == "P" else "quadrilateral"
    middle = (A + B) / 2
    wall = sandwich(HEIGHT, middle - A, B - middle, 2.0, cell=cell).rotated(-math.pi / 2).moved((middle, HEIGHT))
    supports = {"LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}} | (load or {})
    tractions = {} if load else {"BOTTOM": lambda x, t: (t, 0.0)}
    data = {"supports": supports, "tractions": tractions, "plane": "axisymmetric", "element": element}
    return Structure(wall, body=body, **data).bonded()


def test_bodies_that_keep_volumes_in_the_mean_are_not_told_to_lock():
    nearly = VonMises.young(E=70e3, nu=0.4995, strength=STRENGTH)
    with warnings.catch_warnings(action="error", category=RangeWarning):
        solve(tube("Q1", nearly), 1.0)


@pytest.mark.parametrize("element", ["S2", "P2", "Q2", "Q1"])
def test_a_tube_of_revolution_has_its_limit_load(element):
    error = refused(LimitLoad, "", march, tube(element), [100.0, 120.0, 124.0, 130.0], keep="last")
    assert error.t == pytest.approx(LIMIT, rel=0.02 if element == "Q1" else 0.01)


def test_without_projection_loads_beyond_the_limit_are_borne_and_told():
    wrong = Pointwise(METAL.lmbda, METAL.mu, STRENGTH)
    with pytest.warns(RangeWarning, match=r"strains of the body '\w+' are .* \(root mean square"):
        history = march(tube("Q2", wrong), [100.0, 120.0, 130.0], keep="last")
    assert history.last.t > 1.02 * LIMIT


def test_kept_stresses_do_the_work_of_the_projected_ones_and_energies_balance(tmp_path):
    """The kept stress in the unprojected strains of a UFL form balances the loads; so does the energy; a march resumes."""
    model = tube("Q2")
    history = march(model, [80.0, 110.0, 120.0], out=tmp_path)
    state, v = history.last, ufl.TestFunction(model.V)
    inner = fem.assemble_vector(model.form(state.work(state.bodies, v) - model.external_work(v, state.t))).array
    free = np.setdiff1d(np.arange(len(inner)), model.bc_dofs_in(model.V))
    size = np.abs(fem.assemble_vector(model.form(model.external_work(v, state.t))).array).max()
    assert np.abs(inner[free]).max() < 1e-7 * size
    assert all(abs(step.audit.imbalance) < 1e-7 for step in history)
    assert state.audit.dissipated > 0.1 * state.audit.supplied
    on = march(tube("Q2"), [80.0, 110.0, 120.0, 123.0], out=tmp_path, resume=True).last
    whole = march(model, [80.0, 110.0, 120.0, 123.0]).last
    assert on.u.x.array == pytest.approx(whole.u.x.array, abs=1e-9 * np.abs(whole.u.x.array).max())


def test_tangents_are_those_of_projected_strains():
    """Taylor's test where the tube yields: the error of the tangent is of second order; it is symmetric."""
    model = tube("Q2")
    points = CompiledTerm(model.V, model.bodies[0], model.origin)
    u, du = fem.Function(model.V), fem.Function(model.V)
    u.interpolate(lambda x: np.vstack([0.05 * A / x[0] * (1 + 0.02 * x[1]), 0.003 * x[1] * x[0]]))
    du.interpolate(lambda x: 1e-4 * np.vstack([np.cos(x[0] + 0.3 * x[1]), np.sin(0.2 * x[0] * x[1])]))

    def response(s):
        w = u.x.petsc_vec.copy()
        w.axpy(s, du.x.petsc_vec)
        e = points.strain(w)
        return points.respond(e, np.zeros_like(e), points.rest(), 1.0, 1.0)

    there = response(0.0)
    f0, K = points.forces(there.stress).array.copy(), points.stiffness(there.tangent)
    slope = K.createVecLeft()
    K.mult(du.x.petsc_vec, slope)
    steps = np.array([1.0, 0.5, 0.25])
    errors = [np.linalg.norm(points.forces(response(s).stress).array - f0 - s * slope.array) for s in steps]
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx(2.0, abs=0.15)
    assert K.isSymmetric(1e-9 * K.norm())
    values = points.values(ufl.as_vector([1.0 + 2 * points.term.kinematics.x[0] - 3 * points.term.kinematics.x[1]] * 4))
    assert points.projected(values) == pytest.approx(values, rel=1e-11)  # polynomials of degree 1 stay
