"""Running laws over points without a mesh: answers to strains, and Mandel vectors, tensors, jumps and tractions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from mpi4py import MPI

from forms import BulkLaw
from forms.tensors import mandel_tensors as tensor
from forms.tensors import mandel_vectors as vector
from thinlayer.pointwise.compiled_law import CompiledLaw

DT = 0.1
E2 = np.array([0.0, 1.0, 0.0])


@cache
def material(law: BulkLaw) -> CompiledLaw:
    return CompiledLaw(MPI.COMM_SELF, law.as_bulk_law())


@dataclass(frozen=True)
class Answer:
    stress: np.ndarray
    tangent: np.ndarray
    q: np.ndarray
    energies: np.ndarray
    failed: int

    @property
    def stored(self):
        return self.energies[:, 0]

    @property
    def dissipated(self):
        return self.energies[:, 1]

    @property
    def remainder(self):
        return self.energies[:, 2]


def at_rest(law, points: int) -> np.ndarray:
    """What points at rest remember."""
    return np.zeros((points, material(law).memory_size))


def respond(law, e, e_old, q, n, dt=DT, theta=1.0, slots=range(6)) -> Answer:
    return Answer(*material(law).update(slots, e, e_old, q, n, dt, theta))


@dataclass(frozen=True)
class Situation:
    """Points in the middle of a history: the step that is to come goes from e_old to e."""

    e: np.ndarray
    e_old: np.ndarray
    q: np.ndarray
    n: np.ndarray
    stored: np.ndarray

    def respond(self, law, theta, e=None) -> Answer:
        return respond(law, self.e if e is None else e, self.e_old, self.q, self.n, DT, theta)


def situation(
    law: BulkLaw, theta: float, points: int = 20, steps: int = 3, size: float = 0.1, pressed: float = 0.0
) -> Situation:
    random = np.random.default_rng(7)
    n = random.normal(size=(points, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    e, q, stored = np.zeros((points, 6)), at_rest(law, points), np.zeros(points)
    step = lambda: size * random.normal(size=e.shape) - pressed * np.repeat([1.0, 0.0], 3)
    for _ in range(steps - 1):
        old, e = e, e + step()
        answer = respond(law, e, old, q, n, DT, theta)
        assert answer.failed == 0
        q, stored = answer.q, answer.stored
    return Situation(e + step(), e, q, n, stored)


def jump_strain(w: np.ndarray, n: np.ndarray) -> np.ndarray:
    outer = w[..., :, None] * n[..., None, :]
    return vector((outer + np.swapaxes(outer, -1, -2)) / 2)


def traction(stress: np.ndarray, n: np.ndarray) -> np.ndarray:
    return np.einsum("kij,kj->ki", tensor(stress), n)
