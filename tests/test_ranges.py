"""What is told of models and results outside the range of their interface law, against closed forms; and what is not."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, replace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from scipy.special import iv

from forms import Anisotropic, BulkLaw, KelvinVoigt, LinearElastic, Maxwell, MohrCoulombMonodirectional, Norton, Stack
from forms.tangent import average_lame, in_plane_modulus, tangent_at_rest
from geometry import block, disc, ring, sandwich
from studies.problems import FOURIER_LAYER, fourier
from tests.test_parallel import mpirun
from thinlayer import ModelError, SolveError, Structure, Surface, ThinLayer, march, solve
from thinlayer.discretisation.state import Report, State
from thinlayer.errors import RangeWarning
from thinlayer.solving.ranges import Stratum, _Faces, _strata, free_rim, pressure_excess, pressure_length, warn_of_model

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
class Unnamed(BulkLaw):
    """Anisotropic elasticity that says nothing of its stiffness, and is not linear."""

    law: BulkLaw

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
        Structure(joint, **setup).interface(ThinLayer(rubber(1.01)[name], 0.1, order=1))
    Structure(joint, **setup).interface(ThinLayer(rubber(0.99)[name], 0.1, order=1))
    Structure(joint, **setup).interface(ThinLayer(rubber(1.01)[name], 0.1))


def test_order_1_in_plane_stress_does_not_lock():
    joint, setup = fourier(1 / 8, cell="quadrilateral")
    Structure(joint, plane="stress", **setup).interface(ThinLayer(rubber(100.0)["Anisotropic"], 0.1, order=1))


# ---------------------------------------------------------------- nearly incompressible layers
def opened(model, upper):
    """A state whose upper body (y > 0, or all of it on a rigid base) is moved as told, the other one at rest."""
    u = fem.Function(model.V)
    cells = np.flatnonzero(model.sides_of_cells > 0).astype(np.int32)
    u.interpolate(lambda x: np.array(upper(x)), cells0=cells)
    u.x.scatter_forward()
    return _Faces.of(State(model, u, 0.0, Report("none", 0, 0.0, 0.0)), model.thin_layer)


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
    model = Structure(joint, body=STIFF, supports={"BOTTOM": 0.0, "TOP": 0.0, **supports}).interface(
        ThinLayer(law, eps)
    )
    x = half_width / (eps * np.sqrt(law.lmbda / law.mu / 12))
    assert excess(model, lambda x: (0 * x[0], 1e-3 + 0 * x[0])) == pytest.approx(strip_excess(x), rel=3e-3)


def test_strip_on_a_rigid_base_under_a_profile():
    """Thicker at one end than at the other, against finite volumes."""
    joint = block(1.0, 0.5, 1 / 64, structured=True)
    profile = lambda x: 1 + 0.5 * x[0]
    law, eps = LinearElastic.shear(3.0, 0.499), 1 / 16
    layer = ThinLayer(law, eps, profile=profile)
    model = Structure(joint, body=STIFF, supports={"TOP": 0.0}).interface(layer)
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
    model = Structure(joint, body=STIFF, supports={"BOTTOM": 0.0}).interface(ThinLayer(law, eps))
    x = 1 / (eps * np.sqrt(law.lmbda / law.mu / 12))
    wanted = 1 / (1 - 2 * iv(1, x) / (x * iv(0, x))) - 1
    assert excess(model, lambda x: (0 * x[0], 1e-3 + 0 * x[0], 0 * x[0])) == pytest.approx(wanted, rel=0.1)


def test_wave_between_rollers():
    """(k delta)^2, of the jump and of what the faces stretch; order 1 has the same."""
    joint, setup = fourier(1 / 32, cell="quadrilateral")
    law, eps = LinearElastic.shear(40.0, 0.499), 1 / 16
    for order in (0, 1):
        model = Structure(joint, **setup).interface(ThinLayer(law, eps, order=order))
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
        model = Structure(joint, supports={"BOTTOM": 0.0, "TOP": 0.0, **supports}, **data).interface(layer)
        assert len(free_rim(model).vertices) == ends
    turned = Structure(joint.rotated(np.pi / 2), supports={"BOTTOM": 0.0, "RIGHT": {"y": 0.0}}, **data).interface(layer)
    assert free_rim(turned).outward == pytest.approx(np.array([[0.0, -1.0]]))
    closed = Structure(ring(1.0, 1.5, 2.0, h=0.4), supports={"INSIDE": 0.0}, **data).interface(layer)
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
        model = Structure(joint, **setup).interface(layer)
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
        model = Structure(joint, **setup).interface(ThinLayer(Stack((0.8, soft), (0.2, other)), 0.05))
        _, found = told(lambda model=model: solve(model))
        assert sum("nearly incompressible" in message for message in found) == messages


def test_length_of_the_pressure_in_series():
    """delta^2 = B/c with B int 1/mu the variance of int_0^z dz, over what is nearly incompressible, weighted with 1/mu."""
    eps_over_width = 0.03
    rubber, soft = Stratum(0.7, 9e3, 9.0, 36.0), Stratum(0.3, 3.0, 2.0, 4.4)
    found = pressure_length([rubber, soft], 1 / eps_over_width)
    fluidity = 0.7 / 9 + 0.3 / 2
    mean, square = (0.7**2 / 18 + 0.7 * 0.15) / fluidity, (0.7**3 / 27 + 0.7**2 * 0.15) / fluidity
    B, c = fluidity * (square - mean**2), rubber.compliance + soft.compliance
    assert found == pytest.approx((B / c) ** 0.5, rel=2e-3)  # the soft one is hardly stretched
    assert pressure_length([rubber], 10.0) == pytest.approx(rubber.length)
    halves = [Stratum(0.35, 9e3, 9.0, 36.0)] * 2
    assert pressure_length(halves, 10.0) == pytest.approx(rubber.length)
    shim = Stratum(0.3, 1e8, 1e8, 3e8)  # does not stretch: each half flows by itself
    assert pressure_length([halves[0], shim, halves[1]], 10.0) == pytest.approx(rubber.length / 2, rel=1e-3)


def test_rubber_beside_a_soft_sublayer():
    """It lets the rubber flow: told is what the meshed layer shows, and nothing where the rubber is thin."""
    joint = sandwich(1.0, 0.3, 0.3, 1 / 16, cell="quadrilateral")
    setup = {"body": STIFF, "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.0, -1.0)}}
    rubber, soft = LinearElastic.shear(16.0, 0.499), LinearElastic.shear(16.0, 0.3)
    for share, told_once in ((0.9, True), (0.1, False)):
        plates, layer = Structure(joint, **setup), ThinLayer(Stack((share, rubber), (1 - share, soft)), 1 / 16)
        model = plates.interface(layer)
        state, found = told(lambda model=model: solve(model))
        surface = Surface(model)
        meshed, law = (surface.integral(surface.jump(s)[1]) for s in (solve(plates.full(layer)), state))
        assert len(found) == told_once
        if told_once:
            assert factor(found[0]) == pytest.approx(meshed / law, rel=0.03)  # 1.25 of rigid bodies, 1.228
        else:
            assert meshed / law < 1.02


def factor(message):
    """How many times the law is too stiff."""
    return float(re.search(r"([0-9.e+]+) times too stiff", message)[1])


# ---------------------------------------------------------------- layers that become nearly incompressible
BULK = 3 * 0.28 / 1.28  # t2/t1 of a Maxwell law with nu = 0.28 whose mean stress does not relax


@pytest.mark.parametrize(
    ("law", "end", "lasting", "ratio"),
    [
        (Maxwell(28.0, 22.0, 0.05, 0.05 * BULK * (1 + 1e-12)), 10.0, "10", 201 * (28 / 22 + 2 / 3) - 2 / 3),
        (KelvinVoigt(28.0, 22.0, 50.0, 0.1), 0.05, "0.01", 28 * 5001 / (22 * 11)),
    ],
    ids=["Maxwell", "KelvinVoigt"],
)
def test_becomes_nearly_incompressible(law, end, lasting, ratio):
    """Told with the moduli that lasting loads meet (stress over strain of one step) is what the meshed layer shows."""
    joint, eps = sandwich(1.0, 0.3, 0.3, 1 / 16, cell="quadrilateral"), 1 / 32
    setup = {"body": STIFF, "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.0, -1.0)}}
    layer, times = ThinLayer(law, eps), np.linspace(0, end, 6)[1:]
    model = Structure(joint, **setup).interface(layer)
    history, found = told(lambda: march(model, times))
    y = np.sqrt(ratio / 12) * eps / 0.5
    assert len(found) == 2
    assert f"nearly incompressible under loads that last {lasting}:" in found[0]
    assert factor(found[0]) == pytest.approx(1 / (1 - np.tanh(1 / y) * y), rel=5e-3)  # three digits are told
    assert f"under loads that last {end:g} (lmbda/mu" in found[1]
    surface, full = Surface(model), march(Structure(joint, **setup).full(layer), times)
    meshed, jumps = ([surface.integral(surface.jump(h.at(t))[1]) for t in times] for h in (full, history))
    ratios = np.divide(meshed, jumps)
    assert factor(found[0]) == pytest.approx(max(ratios), rel=0.1)  # exp(-t) is no 1/(1 + t)
    assert factor(found[1]) == pytest.approx(ratios[-1], rel=0.1)


@pytest.mark.parametrize(
    "law",
    [
        Maxwell(28.0, 22.0, 0.05),
        KelvinVoigt(28.0, 22.0, 0.7, 0.7),
        KelvinVoigt(28.0, 22.0, 0.6, 0.2),
        Norton(28.0, 22.0, 3.0, 1.5),
    ],
    ids=["Maxwell", "alike", "unlike", "Norton"],
)
def test_ordinary_viscous_layers(law):
    """Both parts relax alike, or nearly so; Norton's dashpot resists changes of volume, too."""
    joint, eps = sandwich(1.0, 0.3, 0.3, 1 / 8, cell="quadrilateral"), 1 / 32
    layer = ThinLayer(law.per_thickness(eps), eps)
    model = Structure(joint, body=STIFF, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.0, -1.0)}).interface(layer)
    for end in (1e-3, 1e3):
        assert told(lambda end=end: march(model, [end / 3, end]))[1] == []


def test_a_viscous_layer_is_not_yet_what_it_is_at_rest():
    """A rubbery spring beside a dashpot that resists shear alone: told in long marches, not in short ones."""
    joint, eps = sandwich(1.0, 0.3, 0.3, 1 / 8, cell="quadrilateral"), 1 / 32
    spring = LinearElastic.shear(16.0, 0.499)
    layer = ThinLayer(KelvinVoigt(spring.lmbda, spring.mu, 0.0, 10.0), eps)
    model = Structure(joint, body=STIFF, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.0, -1.0)}).interface(layer)
    assert told(lambda: march(model, [0.1, 0.2]))[1] == []
    assert len(told(lambda: march(model, [100.0, 200.0]))[1]) == 2


def test_relaxing_behind_a_closed_surface():
    """No free end: told after the march is a bush that is pushed aside, not one that is turned."""
    joint = ring(1.0, 1.5, 2.0, h=0.3, degree=2)
    layer = ThinLayer(Maxwell(28.0, 22.0, 0.05, 0.05 * BULK * (1 + 1e-12)).per_thickness(0.1), 0.1)
    for load, messages in (((1.0, 0.0), 1), (lambda x, t: (-x[1], x[0]), 0)):
        model = Structure(joint, body=STIFF, supports={"OUTSIDE": 0.0}, tractions={"INSIDE": load}).interface(layer)
        _, found = told(lambda model=model: march(model, [100.0, 200.0]))
        assert len(found) == messages
        assert not found or "under loads that last 200 (lmbda/mu" in found[0]


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
        model = Structure(joint, body=STIFF, **data).interface(ThinLayer(law, 1 / 64))
        assert told(lambda model=model: solve(model))[1] == []


def test_slip_on_straight_facets():
    """Of a curved S: they open and close as they slide, and the law resists, to more than twice what the layer does."""
    supports, tractions = {"OUTSIDE": 0.0}, {"INSIDE": lambda x, t: (-x[1], x[0])}
    layer = ThinLayer(LinearElastic.shear(16.0, 0.499), 0.05)
    joint = ring(1.0, 1.5, 2.0, h=0.3)
    model = Structure(joint, body=STIFF, supports=supports, tractions=tractions).interface(layer)
    _, (before, after) = told(lambda: solve(model))
    assert factor(before) == pytest.approx(factor(after), rel=0.02)
    assert factor(after) > 2
    assert "its facets are straight, 3.3 degrees off its normal" in before


@pytest.mark.parametrize("degree", [1, 2])
def test_slip_that_nothing_resists_but_facets(degree):
    """A shaft that a moment turns in a bearing without friction; on curved cells there is no solution."""
    springs, glue = Anisotropic.springs(7.0, 0.0), LinearElastic.shear(0.3, 0.4)
    data = {
        "body": STIFF,
        "supports": {"OUTSIDE": 0.0},
        "tractions": {"INSIDE": lambda x, t: (-0.2 * x[1], 0.2 * x[0])},
    }
    joint = ring(1.0, 1.5, 2.0, h=0.2, degree=degree)
    for law in (springs, Stack((0.4, glue), (0.6, springs))):
        model = Structure(joint, **data).interface(ThinLayer(law, 0.05))
        if degree == 1:
            assert "which resists by the mesh alone" in told(lambda model=model: solve(model))[1][0]
        else:
            with pytest.raises(SolveError, match=r"can turn|can move freely"):
                solve(model)
    stuck = Structure(joint, **data).interface(ThinLayer(glue, 0.05))
    assert told(lambda: solve(stuck))[1] == []


def test_corners_are_no_facets_of_a_curve():
    """S in the shape of a roof; with a hundredth of its slope the corner may be a curve."""
    flat = sandwich(1.0, 0.5, 0.5, 0.25, structured=True)
    for slope, messages in ((0.7, 0), (0.007, 0), (0.2, 1)):
        shift = slope * np.abs(flat.points[:, :1] - 0.5) * np.array([0.0, 1.0])
        joint = replace(flat, points=flat.points - shift)
        layer = ThinLayer(Anisotropic.springs(700.0, 2.0), 0.05)
        model = Structure(joint, body=STIFF, supports={"BOTTOM": 0.0}).interface(layer)
        assert len(told(lambda model=model: warn_of_model(model))[1]) == messages, slope


@pytest.mark.parametrize("slip", [0.0, 2e-3])
def test_slip_beside_opening(slip):
    """The work of shear, mu/eps |w_T|^2, is asked for by both, the law and the layer."""
    law, eps = LinearElastic.shear(3.0, 0.499), 1 / 16
    joint = sandwich(1.0, 0.3, 0.3, 1 / 16, h_S=1 / 128, h_ends=1 / 256)
    model = Structure(joint, body=STIFF, supports={"BOTTOM": 0.0, "TOP": 0.0}).interface(ThinLayer(law, eps))
    found = excess(model, lambda x: (slip + 0 * x[0], 1e-3 + 0 * x[0]))
    pure = strip_excess(0.5 / (eps * np.sqrt(law.lmbda / law.mu / 12)))
    work = law.lmbda * 1e-6 / (1 + pure)
    assert found == pytest.approx(pure * work / (work + law.mu * slip**2), rel=3e-3)


# ---------------------------------------------------------------- thick, hard, overlapping
@pytest.mark.parametrize("rigid", [False, True])
def test_thicker_than_a_body(rigid):
    joint = block(2.0, 0.4, 0.2) if rigid else sandwich(2.0, 0.4, 0.7, 0.2)
    for eps, messages in ((0.39, 0), (0.41, 1)):
        model = Structure(joint, body=STIFF, supports={"TOP": 0.0}).interface(ThinLayer(FOURIER_LAYER, eps))
        _, found = told(lambda model=model: solve(model))
        assert len(found) == messages
    assert "the layer is 0.41 thick, the thinner body 0.4 " in found[0]
    springs = ThinLayer(Anisotropic.springs(60.0, 40.0), 1.0)  # of jumps: there is no thickness in them
    assert told(lambda: solve(Structure(joint, body=STIFF, supports={"TOP": 0.0}).interface(springs)))[1] == []


def test_harder_than_a_body():
    joint, setup = fourier(1 / 8, cell="quadrilateral")
    bodies = {"LOWER": LinearElastic.young(70.0, 0.3), "UPPER": LinearElastic.young(100.0, 0.3)}
    for factor, order, messages in ((0.99, 0, 0), (1.01, 0, 1), (1.01, 1, 0)):
        layer = ThinLayer(LinearElastic.young(70.0 * factor, 0.3).per_thickness(0.01), 0.01, order=order)
        _, found = told(lambda layer=layer: solve(Structure(joint, **setup | {"body": bodies}).interface(layer)))
        assert len(found) == messages
        assert not found or "the layer is 1.01 times as hard as the softer body" in found[0]
        assert not found or "order=1" in found[0]


def test_bodies_that_overlap():
    """A layer pressed to more than twice its thickness, on average; in a march at a time in between."""
    joint = sandwich(2.0, 0.5, 0.5, 0.25)
    setup = {"body": STIFF, "supports": {"BOTTOM": 0.0, "TOP": {"x": 0.0, "y": lambda x, t: -t * (1 + 0.5 * x[0])}}}
    law = MohrCoulombMonodirectional(1.0, 1.0, cohesion=100.0, friction_angle=30.0)
    model = Structure(joint, **setup).interface(ThinLayer(law, 0.1))
    assert told(lambda: solve(model, t=0.13))[1] == []
    _, found = told(lambda: solve(model, t=0.14))
    assert len(found) == 1
    assert (
        "at t = 0.14 the layer closes by 2.1 times its thickness, on average over S (most near (2, 0), by 2.8"
        in found[0]
    )
    there_and_back = setup["supports"] | {"TOP": {"x": 0.0, "y": lambda x, t: -0.4 * t * (2 - t)}}
    model = Structure(joint, **setup | {"supports": there_and_back}).interface(ThinLayer(law, 0.1))
    _, found = told(lambda: march(model, [0.5, 1.0, 2.0]))
    assert len(found) == 1
    assert "at t = 1 the layer closes by 4 times" in found[0]
    linear = Structure(joint, **setup).interface(ThinLayer(LinearElastic(1.0, 1.0), 0.1))
    assert told(lambda: solve(linear, t=1.0))[1] == []  # as good as a smaller one


ON_RANKS = """
from forms import LinearElastic
from geometry import sandwich
from thinlayer import Structure, ThinLayer, solve

joint = sandwich(1.0, 0.5, 0.5, 0.25, h_S=0.125)
layer = ThinLayer(LinearElastic.shear(16.0, 0.499), 1 / 16)
setup = {"supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.0, -1.0)}}
solve(Structure(joint, body=LinearElastic.young(1e5, 0.3), **setup).interface(layer))
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
