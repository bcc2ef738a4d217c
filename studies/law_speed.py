"""Benchmark: points per second of compiled laws on one core, the return mapping of Mohr-Coulomb among them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from mpi4py import MPI

from forms import BulkLaw, LinearElastic, MohrCoulomb, MohrCoulombMonodirectional, Stack
from forms.kinematics import tensors
from studies.timing import seconds
from thinlayer import SolveError
from thinlayer.pointwise.material import Material
from thinlayer.running.record import Record

LMBDA, MU, C, OMEGA, PSI = 60.0, 40.0, 0.1, 30.0, 10.0
PLANE, SPACE = (0, 1, 3), tuple(range(6))  # Mandel components of strains in plane strain and in 3D
SIZE = 0.02  # size of the strains, at which elastic stresses are several times the cohesion
LEAST = 5e5  # least number of points per second for the return mapping


@dataclass(frozen=True)
class Case:
    """A law and the strains it is run over.

    Attributes:
        law: the law.
        slots: Mandel components of the strains.
        floor: points per second that it must reach, or None.
    """

    law: BulkLaw
    slots: tuple[int, ...] = PLANE
    floor: float | None = None


YIELDING, DILATANT = MohrCoulomb(LMBDA, MU, C, OMEGA), MohrCoulomb(LMBDA, MU, C, OMEGA, dilatancy_angle=PSI)
CASES = {
    "linear elastic": Case(LinearElastic(LMBDA, MU)),
    "monodirectional": Case(MohrCoulombMonodirectional(LMBDA, MU, C, OMEGA)),
    "Mohr-Coulomb, plane strain": Case(YIELDING, floor=LEAST),
    "Mohr-Coulomb, 3D": Case(YIELDING, SPACE, floor=LEAST),
    "Mohr-Coulomb, psi > 0, 3D": Case(DILATANT, SPACE, floor=LEAST),
    "two linear elastic sublayers": Case(Stack((0.4, LinearElastic(LMBDA, MU)), (0.6, LinearElastic(2 * LMBDA, MU)))),
    "elastic and Mohr-Coulomb sublayer": Case(Stack((0.4, LinearElastic(LMBDA, MU)), (0.6, YIELDING))),
}


def run(record: Record, *, quick: bool = False) -> None:
    """Stress, tangent, internal values and energies of random strains, from rest; the best of several repeats.

    Args:
        record: where to write.
        quick: fewer points and repeats.
    """
    points, repeats = (4_000, 2) if quick else (20_000, 7)
    table = record.rows("table.csv", CASES, lambda name: measure(name, points, repeats))
    for k, (name, case) in enumerate(CASES.items()):
        if case.floor:
            record.check(f"{name}: points per second", table["points_per_second"][k], low=case.floor)
            record.check(f"{name}: share of points that yield", table["yielding"][k], low=0.5)
            for part in ("edge", "apex"):
                record.check(f"{name}: share of points at an {part}", table[part][k], low=0.01)


def measure(name: str, points: int, repeats: int) -> dict[str, float | str]:
    """Least processor time of all points, in seconds, and the shares of points that yield, at edges and at the apex."""
    case = CASES[name]
    random, m = np.random.default_rng(1), len(case.slots)
    material = Material(MPI.COMM_SELF, case.law)
    e = SIZE * random.normal(size=(points, m))
    n = np.tile([0.0, 1.0, 0.0], (points, 1))
    rest, q = np.zeros_like(e), np.zeros((points, material.memory))
    update = partial(material.update, case.slots, e, rest, q, n, 1.0, 1.0)
    _, _, _, energies, failed = update()  # warms up
    spent = min(seconds(update) for _ in range(repeats))
    if failed:
        raise SolveError(f"{case.law}: {failed} points failed")
    whole = np.zeros((points, 6))
    whole[:, case.slots] = e
    stress = material.update(SPACE, whole, 0 * whole, q, n, 1.0, 1.0)[0]
    yields = energies[:, 1] > 0
    equal = np.abs(np.diff(np.linalg.eigvalsh(tensors(stress)), axis=1)) < 1e-9 * np.abs(stress).max()
    edge, apex = equal.sum(axis=1) == 1, equal.all(axis=1)
    speed: dict[str, float | str] = {"law": name, "points": points, "seconds": spent}
    speed["points_per_second"] = points / spent
    shares = {"yielding": yields, "edge": yields & edge, "apex": yields & apex}
    return speed | {what: float(where.mean()) for what, where in shares.items()}
