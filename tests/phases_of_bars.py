"""Bars with a layer of two phases by brute force, Eq. (44) alone: energies of phases, equilibria, the least of them."""

from __future__ import annotations

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from forms import formulas

BAR = formulas.Bar(l=1, K=2, kbar=3, alpha=1.2, cbar=0.9, eps=0.1)
LONG = formulas.Bar(l=1.7, K=2.3, kbar=3.1, alpha=1.3, cbar=0.8, eps=0.3)  # no parameter is 1, none equals another
SLOW = settings(max_examples=60)
DELTAS = np.array([-4.1, -3.0, -0.2, 0.0, 0.4, 2.6, 2.9, 3.4, 4.8])  # of LONG: all phases, and mixtures


def body(bar, delta, elongation):
    """Stress and energy of the body ]eps l, l[."""
    length = bar.l * (1 - bar.eps)
    strain = (delta - elongation) / length
    return bar.K * strain, length * bar.K / 2 * strain**2


def density(bar, e, z):
    """Energy density of phase z of the layer."""
    return bar.eps * bar.kbar / 2 * e**2 - bar.alpha * z * e + bar.cbar / bar.eps * np.abs(z)


def equilibrium(bar, delta, z):
    """Strains of equal elements with phases z held, and the energy with these phases."""
    z = np.asarray(z, float)
    h, length = bar.eps * bar.l / len(z), bar.l * (1 - bar.eps)
    matrix = bar.eps * bar.kbar * np.eye(len(z)) + bar.K * h / length * np.ones((len(z), len(z)))
    e = np.linalg.solve(matrix, bar.alpha * z + bar.K * delta / length)
    return e, h * np.sum(density(bar, e, z)) + body(bar, delta, h * np.sum(e))[1]


positive = st.floats(0.2, 5.0)


def lowest_phase_by_drive(bar, e):
    return np.where(np.abs(bar.alpha * e) > bar.cbar / bar.eps, np.sign(e), 0)
