"""Plane stress at points: strains out of the plane found point by point, against closed forms of uniaxial stress."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import ufl
from mpi4py import MPI

from forms import (
    Anisotropic,
    BulkLaw,
    Incompressible,
    KelvinVoigt,
    LinearElastic,
    Maxwell,
    MohrCoulomb,
    MohrCoulombMonodirectional,
    NonMonotone,
    Norton,
    Stack,
)
from forms.base import InputError
from forms.elastic import lame_stress
from forms.kinematics import Kinematics
from forms.law import PlaneStressLaw
from forms.non_monotone import lamination_gain
from tests.own_laws import Stiffening
from tests.refused import refused
from thinlayer import SolveError, drive
from thinlayer.pointwise.compiled_law import CompiledLaw

L, M = 3.0, 1.7
NU = L / (2 * (L + M))
E = 2 * M * (1 + NU)
N = np.array([0.28, 0.96, 0.0])  # of the layer, where laws know it
SLOTS = Kinematics().strain_indices(2)  # 11, 22, sqrt2 12
ROUNDED = 1e-10
ROOT = np.random.default_rng(3).normal(size=(6, 6))
C6 = ROOT @ ROOT.T + 3 * np.eye(6)  # stiff against 13 and 23 strains that 11, 22 and 12 cause


class Point:
    """A law in plane stress at one point, from rest."""

    def __init__(self, law):
        self.material = CompiledLaw(MPI.COMM_SELF, law.plane_stress())
        self.e, self.q = np.zeros((1, 3)), np.zeros((1, self.material.memory_size))

    def respond(self, e, dt=0.1, theta=1.0):
        """Stress (3,), tangent (3, 3), memory, energies and the number of failed points."""
        stress, *others = self.material.update(SLOTS, np.reshape(e, (1, 3)), self.e, self.q, N[None], dt, theta)
        return stress[:, SLOTS], *others

    def advance(self, e, dt=0.1, theta=1.0):
        stress, _, memory, energies, failed = self.respond(e, dt, theta)
        assert not failed
        self.e, self.q = np.reshape(e, (1, 3)), memory
        return stress[0], energies[0]

    def settle(self, e, stress=(0.0, 0.0, 0.0), free=(1, 2), dt=0.1):
        """Advance to strains e, whose `free` components are changed until their stresses are the given ones."""
        free, e = np.array(free), np.array(e, float)
        for _ in range(60):
            sigma, C = (a[0] for a in self.respond(e, dt)[:2])
            left = (np.asarray(stress) - sigma)[free]
            if np.abs(left).max() < 1e-13:
                break
            e[free] += np.linalg.solve(C[np.ix_(free, free)], left)
        return self.advance(e, dt)[0]


@dataclass(frozen=True)
class Tilted(BulkLaw):
    """A spring C6 beside a dashpot, and a plastic-like internal strain that relaxes, coupled out of the plane."""

    tau: float
    rate: ClassVar = True
    internal: ClassVar = {"flow": (3, 3)}

    def advance(self, step):
        x, old = step.dt / self.tau, step.q["flow"]
        return {"flow": (old + x * (step.mid - (1 - step.theta) * old)) / (1 + step.theta * x)}

    def stress(self, step):
        spring = Anisotropic(C6)
        flow = step.between(step.q["flow"], self.advance(step)["flow"])
        elastic = step.mid - flow
        stiffens = 200 * ufl.inner(elastic, elastic) * elastic
        return spring.stress(step._replace(e=elastic, e_old=None)) + lame_stress(0.4, 0.3, step.rate) + stiffens


@dataclass(frozen=True)
class Pressed(BulkLaw):
    """The stress out of the plane is > 0 at every strain."""

    mu: float

    def stress(self, step):
        across = self.mu + 9 * self.mu * step.mid[2, 2] ** 2
        return 2 * self.mu * step.mid + ufl.as_matrix([[0, 0, 0], [0, 0, 0], [0, 0, across]])


LAWS = {
    "Kelvin-Voigt": KelvinVoigt(L, M, 0.7, 0.4),
    "Maxwell": Maxwell(L, M, 0.8, 2.5),
    "Norton 1.4": Norton(L, M, 0.9, 1.4),
    "dilatant": MohrCoulomb(L, M, 0.05, 30.0, 0.01, 20.0),
    "unilateral": MohrCoulombMonodirectional(L, M, 0.02, 30.0, 0.01, True),
    "series": Stack((0.3, Maxwell(L, M, 0.8)), (0.2, LinearElastic(L, M)), (0.5, MohrCoulomb(L, M, 0.05, 30.0, 0.01))),
    "tilted": Tilted(0.6),
    "stiffening": Stiffening(L, M, 400.0),
}


@pytest.mark.parametrize("name", LAWS)
def test_tangents_are_condensed_and_energies_balance(name):
    """Differences of stresses give the tangents; work of the stresses in the plane is stored, dissipated and the rest."""
    law, random = LAWS[name], np.random.default_rng(3)
    point, stored = Point(law), 0.0
    thetas = (1.0,) if law.traits.bounded else (1.0, 0.5)
    for _ in range(8):
        e = point.e[0] + 0.02 * random.normal(size=3)
        for theta in thetas:
            C, h = point.respond(e, theta=theta)[1][0], 1e-6
            up, down = ([point.respond(e + s * h * d, theta=theta)[0][0] for d in np.eye(3)] for s in (1, -1))
            assert np.abs((np.array(up) - np.array(down)).T / (2 * h) - C).max() < 2e-6 * np.abs(C).max()
            if law.traits.symmetric:
                assert np.abs(C - C.T).max() < 1e-9 * np.abs(C).max()
        change = e - point.e[0]
        stress, energies = point.advance(e)
        if law.traits.has_energy:
            balance = stress @ change - (energies[0] - stored) - energies[1] - energies[2]
            assert abs(balance) < 1e-12 * np.abs(energies).max()
            stored = energies[0]


@pytest.mark.parametrize("name", ["Kelvin-Voigt", "Maxwell", "tilted", "dilatant"])
@pytest.mark.parametrize("theta", [1.0, 0.5])
def test_no_stress_acts_out_of_the_plane_at_the_balanced_time(name, theta):
    """The law in space gives it for all strains, old and new, that are kept."""
    law, random = LAWS[name], np.random.default_rng(4)
    point, space = Point(law), CompiledLaw(MPI.COMM_SELF, law)
    whole, order = np.zeros((1, 6)), [2, 4, 5]
    for _ in range(4):
        old, memory = whole.copy(), point.q[:, : law.memory]
        point.advance(point.e[0] + 0.02 * random.normal(size=3), theta=theta)
        whole[:, SLOTS], whole[:, order] = point.e, point.q[:, law.memory :]
        stress = space.update(range(6), whole, old, memory, N[None], 0.1, theta)[0][0]
        assert np.abs(stress[order]).max() < 1e-12 * np.abs(stress).max()
    assert (np.abs(point.q[0, law.memory + 1 :]).max() > 1e-4) == (name == "tilted")


def test_a_maxwell_bar_relaxes_and_creeps_as_in_one_dimension():
    """Held strain: E e (1 + dt/t1)^-k; held stress: each step adds dt (1/(3 mu t1) + 1/(9 K t_v)) of it."""
    dt, law = 0.3, Maxwell(L, M, 0.8)
    point = Point(law)
    for k in range(4):
        stress = point.settle([0.01, point.e[0, 1], 0], dt=dt if k else 0.0)
        assert stress == pytest.approx([E * 0.01 * (1 + dt / law.t1) ** -k, 0, 0], rel=ROUNDED, abs=1e-12)
        assert point.q[0, -3] == pytest.approx(-NU * 0.01, rel=ROUNDED)  # the bar contracts alike in both directions
        assert point.e[0, 1] == pytest.approx(-NU * 0.01, rel=ROUNDED)
    law, sigma = Maxwell(L, M, 0.8, 2.5), 0.02
    point = Point(law)
    for k in range(4):
        point.settle(point.e[0], [sigma, 0, 0], (0, 1, 2), dt if k else 0.0)
        creep = k * dt * (1 / (3 * M * law.t1) + law._mean_relaxation_rate / (9 * law._bulk_modulus))
        assert point.e[0, 0] == pytest.approx(sigma * (1 / E + creep), rel=ROUNDED)


def test_laws_with_a_closed_form_are_the_same():
    """Elastic laws through the local solve against their own; plane strain is another one."""
    w = {"w_T": 0.01, "w_N": 0.02}
    for law in (LinearElastic(L, M), Anisotropic(C6)):
        ours, theirs, strained = (drive(variant, [w]) for variant in (PlaneStressLaw(law), law.plane_stress(), law))
        assert ours.tractions == pytest.approx(theirs.tractions, rel=ROUNDED)
        assert abs(strained.tractions[0, 1] / ours.tractions[0, 1] - 1) > 0.05
    law = LinearElastic(L, M)
    assert PlaneStressLaw(law).condensed(law.stiffness(N[:2])) == pytest.approx(law.plane_stress().stiffness(N[:2]))
    soft = drive(Incompressible(M).plane_stress(), [w])  # E/(1 - nu^2) with nu = 1/2
    assert soft.tractions[0] == pytest.approx([M * 0.01, 4 * M * 0.02], rel=ROUNDED)
    law = NonMonotone(L, M, 0.4, 0.05, np.array([[0.0, 0.0], [0.0, 1.0]]))
    assert lamination_gain(2 * L * M / (L + 2 * M), M, law.chi) == law.plane_stress().G
    assert drive(PlaneStressLaw(law), [w]).tractions[0, 0] == pytest.approx(M * 0.01, rel=ROUNDED)


def test_what_has_no_plane_stress():
    assert isinstance(PlaneStressLaw(LAWS["Maxwell"]).plane_stress(), PlaneStressLaw)
    refused(SolveError, "the law failed", lambda: drive(Pressed(M).plane_stress(), [{"w_T": 0.0, "w_N": 0.01}]))
    constrained = type("Constrained", (Incompressible,), {"plane_stress": BulkLaw.plane_stress})
    with pytest.raises(InputError, match="plane stress is not defined for Constrained, because its pressure"):
        constrained(M).plane_stress()
