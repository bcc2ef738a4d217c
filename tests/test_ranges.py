"""What is told of models and results outside the range of their interface law, against closed forms; and what is not."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass

import numpy as np
import pytest
import ufl
from dolfinx import fem
from scipy.special import iv

from forms import Anisotropic, KelvinVoigt, Law, LinearElastic, Maxwell, MohrCoulombMonodirectional, Stack
from forms.tangent import average_lame, in_plane_modulus, tangent_at_rest
from geometry import block, disc, ring, sandwich
from studies.problems import FOURIER_LAYER, fourier
from tests.test_parallel import mpirun
from thinlayer import Model, ModelError, ThinLayer, march, solve
from thinlayer.failure import RangeWarning
from thinlayer.ranges import _Faces, _strata, free_rim, pressure_excess
from thinlayer.state import Report, State

STIFF = LinearElastic.young(1e5, 0.3)
MODULI = np.diag([7.0, 5, 9, 2, 3, 4])
MODULI[:3, :3] += np.array([[0, 1.2, 0.7], [1.2, 0, 1.9], [0.7, 1.9, 0]])
MODULI[0, 4] = MODULI[4, 0] = 0.8
MODULI[1, 3] = MODULI[3, 1] = -0.6


def told(action):
    """What it returns, and the messages of its RangeWarnings."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        result = action()
    return result, [str(w.message) for w in found if issubclass(w.category, RangeWarning)]


# ---------------------------------------------------------------- stiffness at rest
@dataclass(frozen=True)
class Unnamed(Law):
    """Anisotropic elasticity that says nothing of its stiffness, and is not linear."""

    law: Law

    def stress(self, step):
        return self.law.stress(step) * (1 + ufl.tr(step.e) ** 2)

    def parameters(self):
        return {}


@pytest.mark.parametrize(("frame", "n"), [("layer", (0.48, -0.64, 0.6)), ("global", (0.0, 1.0))])
def test_stiffness_by_differences(frame, n):
    law, n = Anisotropic(MODULI, frame), np.array(n)
    assert tangent_at_rest(Unnamed(law), n) == pytest.approx(law.stiffness(n), abs=1e-6)


def test_moduli():
    law, n = LinearElastic(6.0, 2.5), np.array([0.28, 0.96])
    voigt = np.diag([11.0, 11, 11, 2.5, 2.5, 2.5])
    voigt[:3, :3] += 6.0 * (1 - np.eye(3))
    for one in (law, Anisotropic(voigt, "layer"), KelvinVoigt(6.0, 2.5, 0.3, 0.7), Maxwell(6.0, 2.5, 0.4)):
        C = one.stiffness(n)
        assert average_lame(C) == pytest.approx((6.0, 2.5))
        assert in_plane_modulus(C, n) == pytest.approx(4 * 2.5 * 8.5 / 11)  # E/(1 - nu^2)
    springs = Anisotropic.springs(3.0, 5.0).stiffness(n)
    assert abs(in_plane_modulus(springs, n)) < 1e-12


@pytest.mark.parametrize("n", [(0.6, 0.8), (0.48, -0.64, 0.6)])
@pytest.mark.parametrize("plane", ["strain", "stress"])
def test_gradient_leaves_the_faces_without_traction(n, plane):
    law = LinearElastic(6.0, 2.5)
    law = law.plane_stress() if plane == "stress" else law
    given = np.zeros((3, 3))
    given[: len(n), : len(n)] = np.random.default_rng(5).normal(size=(len(n), len(n)))
    given += given.T
    form = law.gradient(ufl.as_matrix(given.tolist()), ufl.as_vector(n))
    found = np.array([[form((0.0,), component=(i, j)) for j in range(3)] for i in range(3)])
    stress = law.lmbda * np.trace(found) * np.eye(3) + 2 * law.mu * found
    normal = np.pad(n, (0, 3 - len(n)))
    assert stress @ normal == pytest.approx(np.zeros(3), abs=1e-12)
    along = np.eye(3) - np.outer(normal, normal)
    assert along @ found @ along == pytest.approx(along @ given @ along, abs=1e-12)


# ---------------------------------------------------------------- order 1 of laws that lock
def rubber(change):
    lmbda, mu = 12.0 * change * 40.0, 40.0
    voigt = np.diag([lmbda + 2 * mu] * 3 + [mu] * 3)
    voigt[:3, :3] += lmbda * (1 - np.eye(3))
    return {
        "KelvinVoigt": KelvinVoigt(lmbda, mu, 0.3, 0.4),
        "Maxwell": Maxwell(lmbda, mu, 0.7),
        "Anisotropic": Anisotropic(voigt, "layer"),
    }


@pytest.mark.parametrize("name", rubber(1.0))
def test_order_1_of_laws_that_lock(name):
    joint, setup = fourier(1 / 8, cell="quadrilateral")
    with pytest.raises(
        ModelError, match=r"lmbda/mu = 12\.12 at rest .nu = 0\.4619.*at most 12 .nu = 0\.4615.*use order=0"
    ):
        Model.interface(joint, layer=ThinLayer(rubber(1.01)[name], 0.1, order=1), **setup)
    Model.interface(joint, layer=ThinLayer(rubber(0.99)[name], 0.1, order=1), **setup)
    Model.interface(joint, layer=ThinLayer(rubber(1.01)[name], 0.1), **setup)


def test_order_1_in_plane_stress_does_not_lock():
    joint, setup = fourier(1 / 8, cell="quadrilateral")
    Model.interface(joint, layer=ThinLayer(rubber(100.0)["Anisotropic"], 0.1, order=1), plane="stress", **setup)


# ---------------------------------------------------------------- nearly incompressible layers
def opened(model, upper):
    """A state whose upper body (y > 0, or all of it on a rigid base) is moved as told, the other one at rest."""
    u = fem.Function(model.V)
    cells = np.flatnonzero(model.sides_of_cells > 0).astype(np.int32)
    u.interpolate(lambda x: np.array(upper(x)), cells0=cells)
    u.x.scatter_forward()
    return _Faces.of(State(model, u, 0.0, Report("none", 0, 0.0, 0.0)))


def excess(model, upper):
    (layer,) = _strata(model)
    return pressure_excess(opened(model, upper), layer)


def strip_excess(x):
    """Of a strip between rigid faces, x half-widths over the length of the pressure."""
    return 1 / (1 - np.tanh(x) / x) - 1


@pytest.mark.parametrize("nu", [0.45, 0.499, 0.4999])
@pytest.mark.parametrize(
    ("supports", "half_width"), [({}, 0.5), ({"LEFT": {"x": 0.0}}, 1.0), ({"LEFT/LAYER": 0.0}, 1.0)]
)
def test_strip(nu, supports, half_width):
    """Between rigid faces that move apart; a side that is held is a plane of symmetry."""
    joint = sandwich(1.0, 0.3, 0.3, 1 / 16, h_S=1 / 128, h_ends=1 / 256)
    law, eps = LinearElastic.shear(3.0, nu), 1 / 16
    model = Model.interface(
        joint, layer=ThinLayer(law, eps), body=STIFF, supports={"BOTTOM": 0.0, "TOP": 0.0, **supports}
    )
    x = half_width / (eps * np.sqrt(law.lmbda / law.mu / 12))
    assert excess(model, lambda x: (0 * x[0], 1e-3 + 0 * x[0])) == pytest.approx(strip_excess(x), rel=3e-3)


def test_strip_on_a_rigid_base_under_a_profile():
    """Thicker at one end than at the other, against finite volumes."""
    joint = block(1.0, 0.5, 1 / 64, structured=True)
    profile = lambda x: 1 + 0.5 * x[0]
    law, eps = LinearElastic.shear(3.0, 0.499), 1 / 16
    layer = ThinLayer(law, eps, profile=profile)
    model = Model.interface(joint, layer=layer, body=STIFF, supports={"TOP": 0.0})
    found = excess(model, lambda x: (0 * x[0], 1e-3 * (1 + x[0])))
    n = 1000
    x = (np.arange(n) + 0.5) / n
    e, w, faces = eps * profile([x]), 1e-3 * (1 + x), eps * profile([np.arange(1, n) / n])
    lmbda, mu = law.lmbda * eps, law.mu * eps
    flow = faces**3 / (12 * mu) * n**2
    ends = 2 * (eps * np.array([1.0, 1.5])) ** 3 / (12 * mu) * n**2
    diagonal = e / lmbda + np.append(flow, 0) + np.append(0, flow)
    diagonal[[0, -1]] += ends
    matrix = np.diag(diagonal) - np.diag(flow, 1) - np.diag(flow, -1)
    p = np.linalg.solve(matrix, w)
    assert found == pytest.approx(np.sum(lmbda * w**2 / e) / np.sum(p * w) - 1, rel=5e-3)


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_disc(cell):
    joint = disc(1.0, 0.4, 0.4, h=0.2, cell=cell)
    law, eps = LinearElastic.shear(3.0, 0.499), 0.08
    model = Model.interface(joint, layer=ThinLayer(law, eps), body=STIFF, supports={"BOTTOM": 0.0})
    x = 1 / (eps * np.sqrt(law.lmbda / law.mu / 12))
    wanted = 1 / (1 - 2 * iv(1, x) / (x * iv(0, x))) - 1
    assert excess(model, lambda x: (0 * x[0], 1e-3 + 0 * x[0], 0 * x[0])) == pytest.approx(wanted, rel=0.1)


def test_wave_between_rollers():
    """(k delta)^2, of the jump and of what the faces stretch; order 1 has the same."""
    joint, setup = fourier(1 / 32, cell="quadrilateral")
    law, eps = LinearElastic.shear(40.0, 0.499), 1 / 16
    for order in (0, 1):
        model = Model.interface(joint, layer=ThinLayer(law, eps, order=order), **setup)
        mode = lambda x: (0.3 * np.sin(np.pi * x[0]), np.cos(np.pi * x[0]))
        assert excess(model, mode) == pytest.approx(np.pi**2 * eps**2 * law.lmbda / law.mu / 12, rel=3e-3)


def test_ends():
    """Free: not held along S by a support of the layer's whole side. A closed S has no end."""
    joint = sandwich(1.0, 0.5, 0.5, 0.25)
    layer, data = ThinLayer(FOURIER_LAYER, 0.1), dict(body=STIFF)
    for supports, ends in (
        ({}, 2),
        ({"RIGHT": {"y": 0.0}}, 2),
        ({"RIGHT/LOWER": 0.0}, 2),
        ({"RIGHT": {"x": 0.0}}, 1),
        ({"LEFT": 0.0, "RIGHT/LAYER": 0.0}, 0),
    ):
        model = Model.interface(joint, layer=layer, supports={"BOTTOM": 0.0, "TOP": 0.0, **supports}, **data)
        assert len(free_rim(model).vertices) == ends
    turned = Model.interface(
        joint.rotated(np.pi / 2), layer=layer, supports={"BOTTOM": 0.0, "RIGHT": {"y": 0.0}}, **data
    )
    assert free_rim(turned).outward == pytest.approx(np.array([[0.0, -1.0]]))
    closed = Model.interface(ring(1.0, 1.5, 2.0, h=0.4), layer=layer, supports={"INSIDE": 0.0}, **data)
    assert len(free_rim(closed).vertices) == 0


def test_rubber_is_told_before_and_after():
    """The measured factors of a layer 8 times as long as thick to either side, between bodies that are nearly rigid."""
    joint = sandwich(1.0, 0.5, 0.5, 1 / 16, h_S=1 / 64, h_ends=1 / 200)
    setup = {"body": STIFF, "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.0, -1.0)}}
    eps = 1 / 16
    for nu, before, after in (
        (0.3, None, None),
        (0.45, "1.12", None),
        (0.49, "1.34", "1.34"),
        (0.4999, "20.7", "20.6"),
    ):
        layer = ThinLayer(LinearElastic.shear(1.0, nu).per_thickness(eps), eps)
        model = Model.interface(joint, layer=layer, **setup)
        _, found = told(lambda model=model: solve(model))
        if before is None:
            assert found == []
            continue
        assert len(found) == (2 if after else 1)
        assert f"about {before} times too stiff" in found[0]
        assert not after or f"the layer alone is {after} times too stiff" in found[1]
    _, found = told(lambda: march(model, [1.0, 2.0, 3.0]))
    assert len(found) == 2


def test_rubber_in_series():
    """Between shims a rubber sublayer is as long as the pressure in it; beside foam it matters to nothing."""
    joint = sandwich(1.0, 0.5, 0.5, 1 / 8)
    setup = {"body": STIFF, "supports": {"BOTTOM": 0.0}}
    soft, shim, foam = LinearElastic.shear(1.0, 0.4999), LinearElastic.young(1e6, 0.3), LinearElastic.young(0.1, 0.0)
    for other, messages in ((shim, 1), (foam, 0)):
        model = Model.interface(joint, layer=ThinLayer(Stack((0.8, soft), (0.2, other)), 0.05), **setup)
        _, found = told(lambda model=model: solve(model))
        assert sum("nearly incompressible" in message for message in found) == messages


# ---------------------------------------------------------------- thick, hard, overlapping
@pytest.mark.parametrize("rigid", [False, True])
def test_thicker_than_a_body(rigid):
    joint = block(2.0, 0.4, 0.2) if rigid else sandwich(2.0, 0.4, 0.7, 0.2)
    for eps, messages in ((0.39, 0), (0.41, 1)):
        model = Model.interface(joint, layer=ThinLayer(FOURIER_LAYER, eps), body=STIFF, supports={"TOP": 0.0})
        _, found = told(lambda model=model: solve(model))
        assert len(found) == messages
    assert "the layer is 0.41 thick, the thinner body 0.4 " in found[0]
    springs = ThinLayer(Anisotropic.springs(60.0, 40.0), 1.0)  # of jumps: there is no thickness in them
    assert told(lambda: solve(Model.interface(joint, layer=springs, body=STIFF, supports={"TOP": 0.0})))[1] == []


def test_harder_than_a_body():
    joint, setup = fourier(1 / 8, cell="quadrilateral")
    bodies = {"LOWER": LinearElastic.young(70.0, 0.3), "UPPER": LinearElastic.young(100.0, 0.3)}
    for factor, order, messages in ((0.99, 0, 0), (1.01, 0, 1), (1.01, 1, 0)):
        layer = ThinLayer(LinearElastic.young(70.0 * factor, 0.3).per_thickness(0.01), 0.01, order=order)
        _, found = told(lambda layer=layer: solve(Model.interface(joint, layer=layer, **(setup | {"body": bodies}))))
        assert len(found) == messages
        assert not found or "the layer is 1.01 times as hard as the softer body" in found[0]
        assert not found or "order=1" in found[0]


def test_bodies_that_overlap():
    """A layer pressed to more than twice its thickness, on average; in a march at a time in between."""
    joint = sandwich(2.0, 0.5, 0.5, 0.25)
    setup = {"body": STIFF, "supports": {"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": lambda x, t: -t * (1 + 0.5 * x[0])}}}
    law = MohrCoulombMonodirectional(1.0, 1.0, C=100.0, Omega=30.0)
    model = Model.interface(joint, layer=ThinLayer(law, 0.1), **setup)
    assert told(lambda: solve(model, t=0.13))[1] == []
    _, found = told(lambda: solve(model, t=0.14))
    assert len(found) == 1
    assert (
        "at t = 0.14 the layer closes by 2.1 times its thickness, on average over S (most near (2, 0), by 2.8"
        in found[0]
    )
    there_and_back = setup["supports"] | {"TOP": {"x": 0.0, "y": lambda x, t: -0.4 * t * (2 - t)}}
    model = Model.interface(joint, layer=ThinLayer(law, 0.1), **(setup | {"supports": there_and_back}))
    _, found = told(lambda: march(model, [0.5, 1.0, 2.0]))
    assert len(found) == 1
    assert "at t = 1 the layer closes by 4 times" in found[0]
    linear = Model.interface(joint, layer=ThinLayer(LinearElastic(1.0, 1.0), 0.1), **setup)
    assert told(lambda: solve(linear, t=1.0))[1] == []  # as good as a smaller one


ON_RANKS = """
from forms import LinearElastic
from geometry import sandwich
from thinlayer import Model, ThinLayer, solve

joint = sandwich(1.0, 0.5, 0.5, 0.25, h_S=0.125)
layer = ThinLayer(LinearElastic.shear(16.0, 0.499), 1 / 16)
setup = {"supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.0, -1.0)}}
solve(Model.interface(joint, layer=layer, body=LinearElastic.young(1e5, 0.3), **setup))
"""


def test_told_once_on_all_ranks():
    """Some of the ranks have no part of S."""
    done = [mpirun(ranks, "-c", ON_RANKS) for ranks in (1, 3)]
    for run in done:
        assert run.returncode == 0, run.stderr
        assert [run.stderr.count("RangeWarning: the layer is nearly incompressible" + end) for end in (":", " (")] == [
            1,
            1,
        ]
    one, three = (re.findall(r"RangeWarning: .*", run.stderr) for run in done)
    assert one == three
