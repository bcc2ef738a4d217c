"""Layers that are, or become, nearly incompressible are told with the factor of closed forms and of meshed layers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import iv

from forms import KelvinVoigt, LinearElastic, Maxwell, Stack
from geometry import block, sandwich
from tests.ranges_told import STIFF, excess, strip_excess, times_too_stiff, with_warnings
from thinlayer import Structure, Surface, ThinLayer, march, solve
from thinlayer.surface.pressure_excess import SublayerModuli, pressure_decay_length

pytestmark = pytest.mark.few(5)


@pytest.mark.parametrize("nu", [0.45, 0.499, 0.4999])
@pytest.mark.parametrize(("supports", "half_width"), [({}, 0.5), ({"LEFT": {"x": 0}}, 1.0), ({"LEFT/LAYER": 0.0}, 1.0)])
def test_strip(nu, supports, half_width):
    """Between rigid faces that move apart; a side that is held is a plane of symmetry."""
    joint = sandwich(1.0, 0.3, 0.3, 1 / 16, h_S=1 / 128, h_ends=1 / 256)
    law, eps = LinearElastic.shear(3.0, nu), 1 / 16
    structure = Structure(joint, body=STIFF, supports={"BOTTOM": 0.0, "TOP": 0.0, **supports})
    model = structure.interface(ThinLayer(law, eps, at=1.0))
    x = half_width / (eps * np.sqrt(law.lmbda / law.mu / 12))
    assert excess(model, lambda x: (0 * x[0], 1e-3 + 0 * x[0]))[0] == pytest.approx(strip_excess(x), rel=0.02)


def test_strip_on_a_rigid_base_under_a_profile():
    """Thicker at one end than at the other, against finite volumes."""
    joint = block(1.0, 0.5, 1 / 64, structured=True)
    profile = lambda x: 1 + 0.5 * x[0]
    law, eps = LinearElastic.shear(3.0, 0.499), 1 / 16
    model = Structure(joint, body=STIFF, supports={"TOP": 0.0}).interface(ThinLayer(law, eps, profile=profile, at=1.0))
    error, _ = excess(model, lambda x: (0 * x[0], 1e-3 * (1 + x[0])))
    n = 1000
    x = (np.arange(n) + 0.5) / n
    e, w, faces = eps * profile([x]), 1e-3 * (1 + x), eps * profile([np.arange(1, n) / n])
    lmbda, mu = law.lmbda * eps, law.mu * eps
    flow = faces**3 / (12 * mu) * n**2
    ends = 2 * (eps * np.array([1.0, 1.5])) ** 3 / (12 * mu) * n**2
    diagonal = e / lmbda + np.append(flow, 0) + np.append(0, flow)
    diagonal[[0, -1]] += ends
    p = np.linalg.solve(np.diag(diagonal) - np.diag(flow, 1) - np.diag(flow, -1), w)
    assert error == pytest.approx(np.sum(lmbda * w**2 / e) / np.sum(p * w) - 1, rel=0.02)


def disc_share(x):
    """Share of the law's load that a disc carries, its radius x lengths of the pressure."""
    return 1 - 2 * iv(1, x) / (x * iv(0, x))


def test_disc_of_revolution():
    """Faces that move apart, and one that is stretched along S, hoops included."""
    R, eps, law = 0.8, 0.08, LinearElastic.shear(3.0, 0.499)
    joint = sandwich(R, 0.3, 0.3, 1 / 16, h_S=1 / 64, h_ends=1 / 256)
    setup = {"body": STIFF, "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.0, -1.0)}, "plane": "axisymmetric"}
    model = Structure(joint, **setup).interface(ThinLayer(law, eps, at=1.0))
    share = disc_share(R / (eps * np.sqrt(law.lmbda / law.mu / 12)))
    assert excess(model, lambda x: (0 * x[0], 1e-3 + 0 * x[0]))[0] == pytest.approx(1 / share - 1, rel=0.02)
    rough = Structure(sandwich(R, 0.3, 0.3, 0.2), **setup).interface(
        ThinLayer(law, eps / 8, at=1.0)
    )  # cells of 3 delta
    thin = disc_share(8 * R / (eps * np.sqrt(law.lmbda / law.mu / 12)))
    assert excess(rough, lambda x: (0 * x[0], 1e-3 + 0 * x[0]))[0] == pytest.approx(1 / thin - 1, rel=0.03)
    assert excess(model, lambda x: (1e-3 * x[0], 0 * x[0]))[0] == pytest.approx(1 / share - 1, rel=0.02)
    stack = Stack((0.5, law), (0.5, LinearElastic.shear(3.1, 0.499)))
    halves = Structure(joint, **setup).interface(ThinLayer(stack, eps, at=1.0))
    assert times_too_stiff(with_warnings(lambda: solve(halves))[1][0]) == pytest.approx(1 / share, rel=0.02)


def test_rubber_is_told_once():
    """The measured factors of a layer 8 times as long as thick to either side, between bodies that are nearly rigid."""
    joint = sandwich(1.0, 0.5, 0.5, 1 / 16, h_S=1 / 64, h_ends=1 / 200)
    setup = {"body": STIFF, "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.0, -1.0)}}
    eps = 1 / 16
    for nu, factor in ((0.3, None), (0.45, 1.121), (0.49, 1.337), (0.4999, 20.55)):
        model = Structure(joint, **setup).interface(ThinLayer(LinearElastic.shear(1.0, nu), eps))
        _, messages = with_warnings(lambda model=model: solve(model))
        assert len(messages) == (factor is not None)
        assert not messages or times_too_stiff(messages[0]) == pytest.approx(factor, rel=0.02)
    _, messages = with_warnings(lambda: march(model, [1.0, 2.0, 3.0]))
    assert len(messages) == 1


def test_length_of_the_pressure_in_series():
    """delta^2 = B/c with B int 1/mu the variance of int_0^z dz, over what is nearly incompressible, weighted with 1/mu."""
    eps_over_width = 0.03
    rubber, soft = SublayerModuli(0.7, 9e3, 9.0, 36.0), SublayerModuli(0.3, 3.0, 2.0, 4.4)
    length = pressure_decay_length([rubber, soft], 1 / eps_over_width)
    fluidity = 0.7 / 9 + 0.3 / 2
    mean, square = (0.7**2 / 18 + 0.7 * 0.15) / fluidity, (0.7**3 / 27 + 0.7**2 * 0.15) / fluidity
    B, c = fluidity * (square - mean**2), rubber.compliance + soft.compliance
    assert length == pytest.approx((B / c) ** 0.5, rel=2e-3)  # the soft one is hardly stretched
    assert pressure_decay_length([rubber], 10.0) == pytest.approx(rubber.decay_length)
    halves = [SublayerModuli(0.35, 9e3, 9.0, 36.0)] * 2
    assert pressure_decay_length(halves, 10.0) == pytest.approx(rubber.decay_length)
    shim = SublayerModuli(0.3, 1e8, 1e8, 3e8)  # does not stretch: each half flows by itself
    assert pressure_decay_length([halves[0], shim, halves[1]], 10.0) == pytest.approx(rubber.decay_length / 2, rel=1e-3)
    # does not shear; the flow of each half stretches it
    sheet, h, width = SublayerModuli(0.3, 1.0, 1e8, 5e3), 0.35, 10.0
    resistance = 2 * 9 / h + 0.3 * sheet.E_plane * width / (width**3 / 3)  # moves in proportion to the distance: works
    B = 9e3 / 9018 * (h**3 / (6 * 9) + h**2 / resistance)
    length = pressure_decay_length([halves[0], sheet, halves[1]], width)
    assert length == pytest.approx((B / (2 * halves[0].compliance + sheet.compliance)) ** 0.5, rel=1e-6)


BULK = 3 * 0.28 / 1.28  # t2/t1 of a Maxwell law with nu = 0.28 whose mean stress does not relax


LASTING = [
    (Maxwell(28.0, 22.0, 0.05, 0.05 * BULK * (1 + 1e-12)), 10.0, "10", 201 * (28 / 22 + 2 / 3) - 2 / 3),
    (KelvinVoigt(28.0, 22.0, 50.0, 0.1), 0.05, "0.01", 28 * 5001 / (22 * 11)),
]


@pytest.mark.few(1)
@pytest.mark.parametrize(("law", "end", "lasting", "ratio"), LASTING)
def test_becomes_nearly_incompressible(law, end, lasting, ratio):
    """Told with the moduli that lasting loads meet (stress over strain of one step) is what the meshed layer shows."""
    joint, eps = sandwich(1.0, 0.3, 0.3, 1 / 16, cell="quadrilateral"), 1 / 32
    setup = {"body": STIFF, "supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.0, -1.0)}}
    layer, times = ThinLayer(law, eps, at=1.0), np.linspace(0, end, 6)[1:]
    model = Structure(joint, **setup).interface(layer)
    history, (text,) = with_warnings(lambda: march(model, times))
    y = np.sqrt(ratio / 12) * eps / 0.5
    assert f"at t = {lasting} the layer has lmbda/mu" in text
    assert times_too_stiff(text) == pytest.approx(1 / (1 - np.tanh(1 / y) * y), rel=0.02)
    surface, full = Surface(model), march(Structure(joint, **setup).full(layer), times)
    meshed, jumps = ([surface.integral(surface.jump(h.at(t))[1]) for t in times] for h in (full, history))
    ratios = np.divide(meshed, jumps)
    assert times_too_stiff(text) == pytest.approx(max(ratios), rel=0.1)  # exp(-t) is no 1/(1 + t)


def test_a_viscous_layer_is_not_yet_what_it_is_at_rest():
    """A rubbery spring beside a dashpot that resists shear alone: told in long marches, not in short ones."""
    joint, eps = sandwich(1.0, 0.3, 0.3, 1 / 8, cell="quadrilateral"), 1 / 32
    spring = LinearElastic.shear(16.0, 0.499)
    layer = ThinLayer(KelvinVoigt(spring.lmbda, spring.mu, 0.0, 10.0), eps, at=1.0)
    model = Structure(joint, body=STIFF, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.0, -1.0)}).interface(layer)
    short, long = (with_warnings(lambda times=times: march(model, times))[1] for times in ([0.1, 0.2], [100.0, 200.0]))
    assert [sum("times too stiff" in message for message in messages) for messages in (short, long)] == [0, 1]
