"""Plane waves through a thin layer: reflection and transmission against transfer matrices, and the law on S in closed form.

No dashpots are needed: standing waves under as many loads as waves can arrive tell how each of them is scattered.
"""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from scipy.linalg import expm

from forms import LinearElastic
from geometry import sandwich
from thinlayer import Inertia, Probe, Structure, ThinLayer, harmonic

MATERIALS = {"LOWER": (56.0, 26.0, 2.7), "S": (4.2, 1.4, 1.2), "UPPER": (112.0, 81.0, 7.8)}  # GPa, GPa, g/cm^3
BODIES = {"LOWER": -1, "UPPER": 1}
EPS, HEIGHTS = 0.1, (0.13, 0.38, 0.66, 0.92)  # mm, with bodies of 1 mm; times are in microseconds
PHASES = np.array([0.05, 0.15, 0.5])


def plane_waves(name, omega, k, kinds):
    """Displacements and tractions (4, 2n) at y = 0 of waves exp(i (omega t - kx - py)), upwards then downwards, and p."""
    lmbda, mu, rho = MATERIALS[name]
    columns, wave_numbers = [], []
    for sign in (1, -1):
        for kind in kinds:
            slowness = np.sqrt(rho / (mu if kind == "S" else lmbda + 2 * mu))
            p = sign * np.sqrt((omega * slowness) ** 2 - k**2)
            x, y = np.array([k, p] if kind == "P" else [p, -k]) / (omega * slowness)
            columns.append([x, y, -1j * mu * (p * x + k * y), -1j * ((lmbda + 2 * mu) * p * y + lmbda * k * x)])
            wave_numbers.append(p)
    return np.array(columns).T, np.array(wave_numbers)


def scattered(below, above, omega, k, kinds):
    """Sizes (2n, 2n) of the waves that leave the layer below, then above, for each that arrives below, then above.

    Conditions are that `below` times the displacements and tractions of the lower body are `above` times the upper ones.
    """
    n = len(kinds)
    lower, upper = (plane_waves(name, omega, k, kinds)[0] for name in BODIES)
    leave = np.hstack([below @ lower[:, n:], -above @ upper[:, :n]])
    arrive = np.hstack([-below @ lower[:, :n], above @ upper[:, n:]])
    return abs(np.linalg.lstsq(leave, arrive, rcond=None)[0])


def by_layer(omega, k=0.0, kinds="PS"):
    lmbda, mu, rho = MATERIALS["S"]
    M, inertia = lmbda + 2 * mu, rho * omega**2
    rates = np.zeros((4, 4), complex)
    rates[:2] = [0, 1j * k, 1 / mu, 0], [1j * k * lmbda / M, 0, 0, 1 / M]
    rates[2:] = [k**2 * (M - lmbda**2 / M) - inertia, 0, 0, 1j * k * lmbda / M], [0, -inertia, 1j * k, 0]
    return scattered(expm(EPS * rates), np.eye(4), omega, k, kinds)


def by_law(omega, kind):
    """At normal incidence: the mean traction is K (1 - x^2/3) times the jump, its jump -4 K x^2 times the mean."""
    lmbda, mu, rho = MATERIALS["S"]
    modulus = lmbda + 2 * mu if kind == "P" else mu
    K, square = modulus / EPS, rho * (omega * EPS) ** 2 / modulus / 4
    i = 1 if kind == "P" else 0
    above, below = np.zeros((2, 4)), np.zeros((2, 4))
    above[:, [i, i + 2]] = [[K * (1 - square / 3), -0.5], [2 * K * square, 1.0]]
    below[:, [i, i + 2]] = [[K * (1 - square / 3), 0.5], [-2 * K * square, 1.0]]
    return scattered(below, above, omega, 0.0, kind)


def computed(kind, omegas, k=0.0, kinds="PS", h=1 / 8, density=None):
    """The same sizes (n_omegas, 2n, 2n) from harmonic responses of a strip of half a wave, between symmetry lines."""
    width = np.pi / k if k else 0.1
    joint = sandwich(width, 1.0, 1.0, h, cell="quadrilateral", structured=True)
    side = {"x": 0} if "P" in kinds else {"y": 0}
    laws = {name: LinearElastic(*moduli) for name, (*moduli, _) in MATERIALS.items()}
    mass = Inertia({name: rho for name, (*_, rho) in MATERIALS.items()} | (density or {}))
    bodies = {name: laws[name] for name in BODIES}
    structure = Structure(joint, body=bodies, supports={"LEFT": side, "RIGHT": side}, parts=[mass])
    model = getattr(structure, kind)(ThinLayer(laws["S"], EPS, order=1))
    axes = {"P": "y", "S": "x"}.get(kinds, "xy")
    places = [(name, "xy".index(axis), sign * y) for name, sign in BODIES.items() for axis in axes for y in HEIGHTS]
    points, last = [(width / 2 if k and i == 0 else 0.0, y) for _, i, y in places], {}

    def displacements(state):
        if last.get("state") is not state:
            last.update(state=state, u=Probe(state).displacement(points))
        return last["u"]

    observe = {n: lambda state, n=n, i=i: displacements(state)[n, i] for n, (_, i, _) in enumerate(places)}
    arriving, leaving = [], []
    for place in ("TOP", "BOTTOM"):
        for axis in axes:
            loaded = model.with_loads(tractions={place: load(axis, k)})
            values = harmonic(loaded, omegas, observe).values
            for m, omega in enumerate(omegas):
                ends = []
                for name in BODIES:
                    waves, p = plane_waves(name, omega, k, kinds)
                    rows = [(n, i, y) for n, (body, i, y) in enumerate(places) if body == name]
                    # on x = pi/2k, where u_x is largest, exp(-ikx) is -i
                    A = [waves[i] * np.exp(-1j * p * y) * (-1j if k and i == 0 else 1) for _, i, y in rows]
                    b = [values[n][m] for n, _, _ in rows]
                    ends.append(np.split(np.linalg.lstsq(np.array(A), np.array(b), rcond=None)[0], 2))
                arriving.append(np.concatenate([ends[0][0], ends[1][1]]))
                leaving.append(np.concatenate([ends[0][1], ends[1][0]]))
    n = len(omegas)
    pairs = [(np.array(leaving[m::n]).T, np.array(arriving[m::n]).T) for m in range(n)]
    return np.array([abs(out @ np.linalg.inv(into)) for out, into in pairs])


def load(axis, k):
    if not k:
        return (float(axis == "x"), float(axis == "y"))
    if axis == "x":
        return lambda x, t: (ufl.sin(k * x[0]), 0.0)
    return lambda x, t: (0.0, ufl.cos(k * x[0]))


def angular_frequency(phase):
    """At which a shear wave crosses the layer in so many radians."""
    _, mu, rho = MATERIALS["S"]
    return phase / (EPS * np.sqrt(rho / mu))


def largest(errors):
    return abs(errors).max(axis=(1, 2))


# errors of a mesh, of the law, and of the twin without mass on S
RANGES = [("full", {}, 0.0, 2e-4), ("interface", {}, 2e-4, 8e-4), ("interface", {"S": 0.0}, 2e-2, 1.0)]
LAW, TWIN = {"P": 6e-5, "S": 8e-4}, {"P": 1.2e-2, "S": 2.7e-2}  # errors at the phase 0.5, with mass and without


@pytest.mark.parametrize("kind", ["P", "S"])
def test_waves_across_the_layer(kind):
    """Errors of the law grow with the fourth power of the phase, those of the twin without mass with its square."""
    omegas = angular_frequency(PHASES)
    layer = np.array([by_layer(omega, kinds=kind) for omega in omegas])
    law = np.array([by_law(omega, kind) for omega in omegas])
    assert computed("full", omegas, kinds=kind) == pytest.approx(layer, abs=4e-6)
    assert computed("interface", omegas, kinds=kind) == pytest.approx(law, abs=1e-5)
    assert largest(law - layer)[-1] == pytest.approx(LAW[kind], rel=0.1)
    twin = largest(computed("interface", omegas, kinds=kind, density={"S": 0.0}) - layer)
    assert twin[-1] == pytest.approx(TWIN[kind], rel=0.1)
    assert (twin > 30 * largest(law - layer)).all()


def test_oblique_waves():
    """P and S waves become each other, as in an independent code at 15 degrees."""
    lmbda, mu, rho = MATERIALS["LOWER"]
    slowness = np.sin(np.radians(15)) / np.sqrt((lmbda + 2 * mu) / rho)
    published = [0.459223121, 0.277428758, 0.524502630, 0.039120886]
    assert by_layer(1.2, 1.2 * slowness)[:, 0] == pytest.approx(published, abs=1e-9)
    omega = float(angular_frequency(0.4))
    layer = by_layer(omega, omega * slowness)
    for kind, density, least, most in RANGES:
        sizes = computed(kind, [omega], omega * slowness, h=1 / 4, density=density)
        assert least < largest(sizes - layer)[0] < most, kind
