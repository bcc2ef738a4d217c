"""Springs per area on a boundary: against closed forms in a solve, in a march and along a path; energies, files, ranks."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem

from forms import LinearElastic, Maxwell
from forms.base import InputError
from geometry import sandwich
from tests.refused import refused
from tests.softening_bars import Trilinear
from thinlayer import ArcLength, Structure, ThinLayer, march, solve
from thinlayer.parts.springs import Springs

E, HEIGHT, EPS = 100.0, 0.5, 0.1
ANGLE = 0.4
BODY = LinearElastic.young(E, 0.0)
GLUE = LinearElastic(lmbda=0.0, mu=4.0)  # per thickness
CREEP = Maxwell(lmbda=0.0, mu=4.0, t1=0.5)
BED = Springs("BOTTOM", normal=20.0, tangential=7.0)
P, PULL = 0.3, (0.2, -0.1)  # pressure on top; tractions at the bottom, along it
DIM = {2: {}, 3: {"depth": 0.5}}


def axes(dim: int) -> np.ndarray:
    """Rows: the turned axes along the bottom, then across it, upwards."""
    c, s = np.cos(ANGLE), np.sin(ANGLE)
    return np.array([[c, s], [-s, c]] if dim == 2 else [[c, s, 0], [0, 0, 1], [-s, c, 0]])


def turned(dim: int = 2, kind: str = "interface", parts=(BED,), **change):
    """Two turned blocks, a layer between them, on springs alone: pressed from above, and pulled along at the bottom."""
    joint = sandwich(1.0, HEIGHT, HEIGHT, 0.25, structured=True, **DIM[dim]).rotated(ANGLE)
    along, n = np.array(PULL[: dim - 1]) @ axes(dim)[:-1], axes(dim)[-1]
    loads = {"TOP": tuple(-P * n), "BOTTOM": tuple(along)}
    setup = {"body": BODY, "supports": {}, "tractions": loads, "element": "P1" if dim == 3 else None} | change
    return getattr(Structure(joint, parts=list(parts), **setup), kind)(ThinLayer(GLUE, EPS, at=1.0))


def mean(state, place):
    """Mean displacement of a boundary, in the turned axes."""
    model = state.model
    there = model.ds(model.domain.values(place))
    u = [state.integral(state.u[k] * there) for k in range(model.joint.dim)]
    return axes(model.joint.dim) @ np.array(u) / state.integral(fem.Constant(model.domain.mesh, 1.0) * there)


def relaxing(kind: str = "interface", closing: float = 0.02):
    """A column on springs, with a layer that creeps; its top is moved down once, and held."""
    joint = sandwich(1.0, HEIGHT, HEIGHT, 0.25, structured=True)
    supports = {"TOP": {"x": 0.0, "y": -closing}}
    return getattr(Structure(joint, body=BODY, supports=supports, parts=[BED]), kind)(ThinLayer(CREEP, EPS, at=1.0))


KINDS = ["full", "interface"]
CASES = [(dim, kind) for dim in (2, 3) for kind in KINDS]


# ---------------------------------------------------------------- one solve
@pytest.mark.parametrize(("dim", "kind"), CASES)
def test_turned_blocks_on_springs(dim, kind):
    """Springs alone hold them: the bottom moves by traction over stiffness, the column above is pressed together."""
    state = solve(turned(dim, kind))
    bottom, top = mean(state, "BOTTOM"), mean(state, "TOP")
    expected = np.array([*(np.array(PULL[: dim - 1]) / BED.tangential), -P / BED.normal])
    assert bottom == pytest.approx(expected, rel=1e-9)
    expected[-1] -= P * (2 * HEIGHT / E + 1 / (2 * GLUE.mu))
    assert top == pytest.approx(expected, rel=1e-9)
    energies = state.energies()
    area = 1.0 if dim == 2 else 0.5
    pulled = np.array(PULL[: dim - 1])
    expected = area * (P**2 / BED.normal + pulled @ pulled / BED.tangential) / 2
    assert energies["springs BOTTOM"] == pytest.approx(expected, rel=1e-9)
    stored = sum(value for name, value in energies.items() if name != "loads")
    assert (stored, state.audit.total) == pytest.approx((energies["loads"] / 2, stored), rel=1e-9)
    assert abs(state.audit.imbalance) < 1e-9


@pytest.mark.parametrize("normal", [lambda x: 3.0 + x[0] ** 2, lambda x: 3.0 + np.square(x[0])], ids=["ufl", "numpy"])
def test_a_rigid_block_on_uneven_springs(normal):
    """Closed form: a bed k = 3 + x^2 under a stiff beam of length 2 that may sink and turn, pressed at one end."""
    joint = sandwich(2.0, 0.3, 0.3, 0.15, structured=True)
    moment = np.array([[3 * 2 + 8 / 3, 6 + 4], [6 + 4, 8 + 32 / 5]])
    supports = {(0.0, 0.3): {"x": 0.0}}
    data = {"tractions": {"TOP": (0.0, -0.4)}, "parts": [Springs("BOTTOM", normal=normal, tangential=0.0)]}
    state = solve(Structure(joint, body=LinearElastic.young(1e8, 0.0), supports=supports, **data).bonded())
    sinks, turns = np.linalg.solve(moment, [0.4 * 2, 0.4 * 2])
    x, y = state.model.V.tabulate_dof_coordinates()[:, 0], state.u.x.array[1::2]
    assert y == pytest.approx(-(sinks + turns * x), rel=1e-5)
    bed = state.reaction("BOTTOM", about=(0.0, 0.0))
    assert bed.force == pytest.approx([0.0, 0.8], abs=1e-6)  # bodies are 3e7 times as stiff as their bed
    assert bed.moment == pytest.approx(0.8, rel=1e-6)


def test_stiffnesses_that_are_refused():
    joint = sandwich(1.0, HEIGHT, HEIGHT, 0.25, structured=True)
    refused(InputError, "have no stiffness", Springs, "BOTTOM")
    for k, message in (
        (-1.0, "normal is -1 at"),
        ("stiff", "it needs a finite number"),
        (lambda x: x[0] - 0.3, r"normal is -0.3 at \(.*, -0.5\); allowed: finite, >= 0"),
        (lambda x: x[:, :3], r"gives an array of shape \(2, 3\)"),
        (lambda x: True, "it needs a finite number"),
    ):
        structure = Structure(joint, body=BODY, supports={}, parts=[Springs("BOTTOM", normal=k, tangential=1.0)])
        refused(InputError, message, structure.bonded)


# ---------------------------------------------------------------- marches
def force(steps, dt, theta):
    """Force of the creeping column after steps: F' (1 + c K) = -F/t1, with c = 1/k + 2 H/E and K = 2 mu."""
    c, K = 1 / BED.normal + 2 * HEIGHT / E, 2 * CREEP.mu
    tau = CREEP.t1 * (1 + c * K)
    first = 0.02 / (c + 1 / K)
    return first * ((1 - (1 - theta) * dt / tau) / (1 + theta * dt / tau)) ** np.arange(steps + 1), first, tau


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("theta", [1.0, 0.5])
def test_a_column_relaxes_on_springs(kind, theta):
    """The layer creeps as bodies and springs go back: an exponential, as the time scheme has it."""
    history = march(relaxing(kind), np.linspace(0.1, 0.8, 8), theta=theta)
    expected = force(8, 0.1, theta)[0]
    energies = np.array([state.energies()["springs BOTTOM"] for state in history])[-9:]
    assert np.sqrt(2 * BED.normal * energies) == pytest.approx(expected, rel=1e-8)
    assert np.abs(history.table["imbalance"]).max() < 1e-9
    stored = sum(value for name, value in history.last.energies().items() if name != "loads")
    assert history.last.audit.total == pytest.approx(stored, rel=1e-9)


# ---------------------------------------------------------------- a path
def test_a_softening_interface_in_series_with_springs():
    """t = w + sigma(w) (2 H/E + 1/k): the path turns back and forth, as the law alone with these bodies would not."""
    law = Trilinear(k=20.0, fall=6.0, w_1=0.02, w_2=0.06, k_T=1.9)
    joint = sandwich(1.0, HEIGHT, HEIGHT, 1.0, cell="quadrilateral", structured=True)
    supports = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}, "TOP": {"y": lambda x, t: t}}
    bed = Springs("BOTTOM", normal=4.0)
    structure = Structure(joint, body=BODY, supports=supports, parts=[bed], element="Q1")
    history = march(structure.interface(law), ArcLength(end=0.3, first=0.01))
    sigma = np.sqrt([2 * bed.normal * state.energies()["springs BOTTOM"] for state in history])
    c = 2 * HEIGHT / E + 1 / bed.normal
    assert sigma == pytest.approx(law.sigma(history.t - c * sigma, lambda a, b, x, y: np.where(a < b, x, y)), abs=1e-9)
    assert c * law.fall > 1 > 2 * HEIGHT / E * law.fall
    assert np.count_nonzero(np.diff(np.sign(np.diff(history.t)))) == 2
    assert np.abs(history.table["imbalance"]).max() < 1e-9


# ---------------------------------------------------------------- what holds a structure, and what cannot be
def test_springs_hold_a_structure():
    """Across the bottom they do not hold it along; together with those across a side they do."""
    with pytest.raises(InputError, match="no support against rigid motion of the structure"):
        turned(parts=[Springs("BOTTOM", normal=1.0)])
    solve(turned(parts=[Springs("BOTTOM", normal=1.0), Springs("LEFT", normal=1.0)]))


def test_places_that_are_none():
    refused(InputError, "did you mean 'BOTTOM'", lambda: turned(parts=[Springs("BOTTEM", normal=1.0)]))
    with pytest.raises(InputError, match="facet set is empty, as the layer is a surface here"):
        turned(parts=[BED, Springs("LEFT/LAYER", normal=1.0)])
    refused(InputError, "two parts are called 'springs BOTTOM'", turned, parts=[BED, Springs("BOTTOM", normal=1.0)])
