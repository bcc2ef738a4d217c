"""Mohr-Coulomb laws and what tests of them at points share: elastic and principal stresses, the yield function, strains."""

from __future__ import annotations

import numpy as np

from forms import MohrCoulomb, MohrCoulombMonodirectional, VonMises
from tests.at_points import E2, tensor

LMBDA, MU, C, OMEGA = 60.0, 40.0, 0.1, 30.0  # nu = 0.3
ONE = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
THETAS = [1.0, 0.7, 0.5]


COHESIVE = {"hardening": 20.0, "saturation": 0.2, "saturation_strain": 0.01}
Y = 0.3
METALS = {
    "ideal": VonMises(LMBDA, MU, Y),
    "isotropic": VonMises(LMBDA, MU, Y, hardening=25.0),
    "kinematic": VonMises(LMBDA, MU, Y, kinematic=25.0),
    "saturating": VonMises(LMBDA, MU, Y, 5.0, 10.0, saturation=0.4, saturation_strain=0.004),
}
SOILS = {
    "hardening": MohrCoulomb(LMBDA, MU, C, OMEGA, **COHESIVE),
    "hardening, dilatant": MohrCoulomb(LMBDA, MU, C, OMEGA, 0.1, 12.0, **COHESIVE),
    "hardening, associated": MohrCoulomb(LMBDA, MU, C, OMEGA, dilatancy_angle=OMEGA, **COHESIVE),
    "hardening, Tresca": MohrCoulomb(LMBDA, MU, C, 0.0, **COHESIVE),
    "hardening, monodirectional": MohrCoulombMonodirectional(LMBDA, MU, C, OMEGA, **COHESIVE),
    "hardening, unilateral": MohrCoulombMonodirectional(LMBDA, MU, C, OMEGA, unilateral=True, **COHESIVE),
}
LAW = MohrCoulomb(LMBDA, MU, C, OMEGA)
MONO = MohrCoulombMonodirectional(LMBDA, MU, C, OMEGA)
LAWS = {
    "psi = 0": LAW,
    "psi = 12": MohrCoulomb(LMBDA, MU, C, OMEGA, dilatancy_angle=12.0),
    "psi = Omega": MohrCoulomb(LMBDA, MU, C, OMEGA, dilatancy_angle=OMEGA),
    "elastic fraction": MohrCoulomb(LMBDA, MU, C, OMEGA, 0.2, 12.0),
    "monodirectional": MONO,
    "unilateral": MohrCoulombMonodirectional(LMBDA, MU, C, OMEGA, unilateral=True),
    "unilateral, elastic fraction": MohrCoulombMonodirectional(LMBDA, MU, C, OMEGA, 0.2, unilateral=True),
}


def elastic(e, lmbda=LMBDA, mu=MU):
    """Stress (..., 6) of Mandel strains."""
    return lmbda * e[..., :3].sum(-1)[..., None] * ONE + 2 * mu * e


def compliance(s, lmbda=LMBDA, mu=MU):
    return s / (2 * mu) - lmbda / (2 * mu * (3 * lmbda + 2 * mu)) * s[..., :3].sum(-1)[..., None] * ONE


def principal(s):
    """Descending principal stresses (..., 3)."""
    return np.linalg.eigvalsh(tensor(s))[..., ::-1]


def reached(law, q):
    """The cohesion after the plastic strain that points remember."""
    p = q[:, 6]
    gained = law.saturation * p / (law.saturation_strain + p) if law.saturation else 0.0
    return law.cohesion + law.hardening * p + gained


def excess(s, C=C, Omega=OMEGA):
    """(s_1 - s_3)/2 + (s_1 + s_3)/2 sin(Omega) - C cos(Omega)."""
    p, angle = principal(s), np.radians(Omega)
    return (p[..., 0] - p[..., 2]) / 2 + (p[..., 0] + p[..., 2]) / 2 * np.sin(angle) - C * np.cos(angle)


def strains(random, points, size=0.02, plane=False):
    e = size * random.normal(size=(points, 6))
    e[:, 0:3] -= size / 2
    if plane:
        e[:, [2, 4, 5]] = 0
    return e


def normals(points):
    return np.tile(E2, (points, 1))
