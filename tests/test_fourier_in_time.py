"""The Fourier problem in time: orders of every law's limit, numbers from other codes, and the same laws written by a user.

Q2 at h = 1/8 is fine enough: the errors of the layer differ by less than 3e-4 of themselves from those of transfer
matrices (`test_against_transfer_matrices`), at the smallest thickness too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np
import pytest
import ufl

from forms import KelvinVoigt, Maxwell, Norton, Stack, TractionLaw
from studies.problems import FOURIER_LAYER, fourier
from tests import reference
from tests.orders import observed_orders
from thinlayer import Structure, Surface, ThinLayer, compare, march

pytestmark = pytest.mark.few(5)

H = 1 / 8
EPS = (1 / 64, 1 / 128)
LMBDA, MU = reference.LAYER
K_N, K_T = LMBDA + 2 * MU, MU

KELVIN_VOIGT = KelvinVoigt(LMBDA, MU, theta_lmbda=0.3, theta_mu=0.5)
MAXWELL = Maxwell(LMBDA, MU, t1=0.7)
TWO_TIMES = Maxwell(LMBDA, MU, t1=0.7, t2=3.0)
THINNING = Norton(LMBDA, MU, eta=5.0, p=1.5)
THICKENING = Norton(LMBDA, MU, eta=2000.0, p=3.0)
VISCOUS_STACK = Stack((0.4, Maxwell(50.0, 40.0, 0.7, 1.2)), (0.6, KelvinVoigt(60.0, 30.0, 0.3, 0.5)))
NORTON_STACK = Stack((0.5, FOURIER_LAYER), (0.5, THINNING))


problem = cache(fourier)


@cache
def marched(build, law, e, times, theta=1.0, cell="quadrilateral", bodies="kept"):
    """History of a model; several tests ask for the same."""
    joint, setup = problem(H, cell=cell)
    choice = {"bodies": bodies} if build == Structure.full else {}
    layer = law if isinstance(law, TractionLaw) else ThinLayer(law, e, at=1.0)
    return march(build(Structure(joint, **setup), layer, **choice), times, theta=theta)


def errors(law_at, times, *, limits=(None,), eps=EPS, cell="quadrilateral", theta=1.0, bodies="kept"):
    """Relative errors of traction and jump at the last time, (thicknesses, 2), beside each of the laws for S.

    None stands for the layer's own law; `law_at` is that law, or a function of the thickness.
    """
    rows, choices = [], (tuple(times), theta, cell)
    for e in eps:
        law = law_at(e) if callable(law_at) else law_at
        full = marched(Structure.full, law, e, *choices, bodies)
        for limit in limits:
            row = compare(full, marched(Structure.interface, limit or law, e, *choices))
            rows.append((row["error_traction"], row["error_jump"]))
    return np.array(rows).reshape(len(eps), len(limits), 2).swapaxes(0, 1)


def steps(dt: float, n: int = 5) -> list[float]:
    return [dt * k for k in range(1, n + 1)]


def last_orders(errors, eps=EPS):
    return [observed_orders(eps, column)[-1] for column in errors.T]


# ---------------------------------------------------------------- orders
ORDER_ONE = [
    (KELVIN_VOIGT, 0.1, {"theta": 0.5}),
    (KELVIN_VOIGT, 0.1, {"bodies": "extended"}),
    (MAXWELL, 0.1, {"theta": 0.5}),
    (TWO_TIMES, 0.3, {"bodies": "extended"}),
    (THINNING, 0.05, {"cell": "triangle"}),
    (THICKENING, 0.05, {"theta": 0.5}),
    (VISCOUS_STACK, 0.1, {}),
    (NORTON_STACK, 0.01, {"bodies": "extended"}),
]


@pytest.mark.parametrize(("law", "dt", "options"), ORDER_ONE, ids=str)
def test_order_one(law, dt, options):
    (law_errors,) = errors(law, steps(dt, 3), **options)
    assert last_orders(law_errors) == pytest.approx([1.0, 1.0], abs=0.07)


# ---------------------------------------------------------------- numbers of other codes


def amplitudes(surface: Surface, state) -> list[float]:
    """First Fourier amplitudes of jump and traction: U, V, S, T."""
    s, c = np.sin(np.pi * surface.x[0]), np.cos(np.pi * surface.x[0])
    w, t = surface.jump(state), surface.traction(state)
    return [2 * surface.integral(f) for f in (w[0] * s, w[1] * c, t[0] * s, t[1] * c)]


IN_SERIES = [(0.4, reference.maxwell(50.0, 40.0, 0.7, 1.2)), (0.6, reference.kelvin_voigt(60.0, 30.0, 0.3, 0.5))]
LINEAR = {
    "Kelvin-Voigt": (KELVIN_VOIGT, [(1.0, reference.kelvin_voigt(LMBDA, MU, 0.3, 0.5))], 1.0),
    "Maxwell": (MAXWELL, [(1.0, reference.maxwell(LMBDA, MU, 0.7, 0.7))], 1.0),
    "Maxwell, midpoint": (MAXWELL, [(1.0, reference.maxwell(LMBDA, MU, 0.7, 0.7))], 0.5),
    "two times": (TWO_TIMES, [(1.0, reference.maxwell(LMBDA, MU, 0.7, 3.0))], 1.0),
    "stack": (VISCOUS_STACK, IN_SERIES, 1.0),
}


@pytest.mark.parametrize("name", LINEAR)
def test_against_transfer_matrices(name):
    """Amplitudes of both models after five steps of a load sin 2t, and their errors, which agree ten times better."""
    law, layer, theta = LINEAR[name]
    joint, setup = fourier(H, cell="quadrilateral")
    factor = lambda t: ufl.sin(2 * t)
    wave = lambda x, t: (0.5 * factor(t) * ufl.sin(ufl.pi * x[0]), factor(t) * ufl.cos(ufl.pi * x[0]))
    setup["tractions"] = {"TOP": wave}
    dt = 0.1
    loads = np.sin(2 * dt * np.arange(6))
    for eps in (1 / 8, 1 / 128):
        builds = (Structure.full, Structure.interface)
        models = [build(Structure(joint, **setup), ThinLayer(law, eps, at=1.0)) for build in builds]
        states = [march(model, steps(dt), theta=theta).last for model in models]
        surface = Surface(states[1].model)
        for state, thickness in zip(states, (eps, None), strict=True):
            exact = reference.marched(layer, loads, dt, theta, thickness)[-1]
            assert amplitudes(surface, state) == pytest.approx(exact, rel=1e-3), thickness
        row = compare(*states)
        exact = reference.marched_errors(layer, loads, dt, theta, eps)
        assert (row["error_traction"], row["error_jump"]) == pytest.approx(exact, rel=3e-4)


# ---------------------------------------------------------------- laws of one's own
def parts(v, n):
    normal = ufl.dot(v, n)
    return normal, v - normal * n


@dataclass(frozen=True)
class Relaxing(TractionLaw):
    """A differential equation of first order, dt/dt + t/time = K d[u]/dt, for either part of the traction."""

    K_T: float
    K_N: float
    time_T: float
    time_N: float
    linear: ClassVar = True
    internal: ClassVar = {"t": (3,)}

    def evolve(self, step):
        old, change = parts(step.q["t"], step.n), parts(step.w - step.w_old, step.n)

        def new(K, time, old, change):
            x = step.dt / time
            return ((1 - (1 - step.theta) * x) * old + K * change) / (1 + step.theta * x)

        normal = new(self.K_N, self.time_N, old[0], change[0])
        return {"t": normal * step.n + new(self.K_T, self.time_T, old[1], change[1])}

    def traction(self, step):
        return step.theta * self.evolve(step)["t"] + (1 - step.theta) * step.q["t"]


@dataclass(frozen=True)
class Dashpot(TractionLaw):
    """Eqs. (22)-(24) with a number for the 1/2 of the tangential part; without it there is no potential."""

    eta: float
    p: float
    half: float
    symmetric: ClassVar = False
    rate: ClassVar = True

    def traction(self, step):
        (normal, tangential), (v_N, v_T) = parts(step.mid, step.n), parts(step.rate, step.n)
        viscosity = self.eta * (v_N**2 + ufl.inner(v_T, v_T) / 2 + 1e-24) ** (self.p / 2 - 1)
        return (K_N * normal + viscosity * v_N) * step.n + K_T * tangential + self.half * viscosity * v_T


TRACTION_LAWS = [
    (MAXWELL, Relaxing(K_T, K_N, 0.7, 0.7), 0.1),
    (THINNING, Dashpot(5.0, 1.5, 0.5), 0.05),
    (THICKENING, Dashpot(2000.0, 3.0, 0.5), 0.05),
]


@pytest.mark.few(5)
@pytest.mark.parametrize(("law", "limit", "dt"), TRACTION_LAWS, ids=str)
def test_right_traction_laws_are_the_layers_law(law, limit, dt):
    """Written as equations between jumps and tractions: errors of the law to rounding, of order 1."""
    limit_errors, right = errors(law, steps(dt, 3), limits=(limit, None))
    assert limit_errors == pytest.approx(right, rel=1e-6)
    assert last_orders(right) == pytest.approx([1.0, 1.0], abs=0.07)


WRONG = [  # E/(1 + nu) = 2 mu stands in (19)
    pytest.param(MAXWELL, 0.1, Relaxing(2 * MU, K_N, 0.7, 0.7), (0.12, 0.11), id="(19), its shear alone"),
    pytest.param(THINNING, 0.05, Dashpot(5.0, 1.5, 1.0), (0.08, 0.3), id="Norton without 1/2"),
]


@pytest.mark.parametrize(("law", "dt", "wrong", "floors"), WRONG)
def test_printed_laws_leave_an_error(law, dt, wrong, floors):
    """As `docs/laws/maxwell.md` says: errors beside a wrong law stay, those of the right one go to zero with order 1."""
    wrong_errors, right = errors(law, steps(dt), limits=(wrong, None))
    assert last_orders(right) == pytest.approx([1.0, 1.0], abs=0.07)
    assert max(last_orders(wrong_errors)) < 0.2
    assert (wrong_errors[-1] > floors).all()
