"""Benchmark: points per second of compiled laws on one core, the return mapping of Mohr-Coulomb among them."""

from __future__ import annotations

from functools import partial

import numpy as np
from mpi4py import MPI

from forms import BulkLaw, LinearElastic, MohrCoulomb, MohrCoulombMonodirectional, Stack
from studies.timing import timed
from thinlayer import SolveError
from thinlayer.pointwise.compiled_law import CompiledLaw
from thinlayer.running.record import Record

LMBDA, MU, C, OMEGA, PSI = 60.0, 40.0, 0.1, 30.0, 10.0
PLANE, SPACE = (0, 1, 3), tuple(range(6))  # Mandel components of strains in plane strain and in 3D
SIZE = 0.02  # size of the strains, at which elastic stresses are several times the cohesion
LEAST = 5e5  # least number of points per second for the return mapping


YIELDING, DILATANT = MohrCoulomb(LMBDA, MU, C, OMEGA), MohrCoulomb(LMBDA, MU, C, OMEGA, dilatancy_angle=PSI)
ELASTIC, HARDER = LinearElastic(LMBDA, MU), LinearElastic(2 * LMBDA, MU)
CASES: dict[str, tuple[BulkLaw, tuple[int, ...]]] = {  # law; Mandel components of its strains
    "linear elastic": (ELASTIC, PLANE),
    "monodirectional": (MohrCoulombMonodirectional(LMBDA, MU, C, OMEGA), PLANE),
    "Mohr-Coulomb, plane strain": (YIELDING, PLANE),
    "Mohr-Coulomb, 3D": (YIELDING, SPACE),
    "Mohr-Coulomb, psi > 0, 3D": (DILATANT, SPACE),
    "two linear elastic sublayers": (Stack((0.4, ELASTIC), (0.6, HARDER)), PLANE),
    "elastic and Mohr-Coulomb sublayer": (Stack((0.4, ELASTIC), (0.6, YIELDING)), PLANE),
}


def run(record: Record, *, quick: bool = False) -> None:
    """Time stress, tangent, internal variables and energies of random strains, from rest; the best of several repeats.

    Args:
        record: where to write.
        quick: fewer points and repeats.
    """
    points, repeats = (4_000, 2) if quick else (20_000, 7)
    table = record.rows("table.csv", CASES, lambda name: measure(name, points, repeats))
    for k, (name, (law, _)) in enumerate(CASES.items()):
        if isinstance(law, MohrCoulomb):
            record.check(f"{name}: points per second", table["points_per_second"][k], low=LEAST)
            record.check(f"{name}: share of points that yield", table["yielding"][k], low=0.5)


def measure(name: str, points: int, repeats: int) -> dict[str, float | str]:
    """Row with the least processor time of all points, in seconds, and the share of points that yield."""
    law, slots = CASES[name]
    random, m = np.random.default_rng(1), len(slots)
    material = CompiledLaw(MPI.COMM_SELF, law)
    e = SIZE * random.normal(size=(points, m))
    n = np.tile([0.0, 1.0, 0.0], (points, 1))
    rest, q = np.zeros_like(e), np.zeros((points, material.memory_size))
    update = partial(material.update, slots, e, rest, q, n, 1.0, 1.0)
    _, _, _, energies, failed = update()  # warms up
    spent = min(timed(update)[0] for _ in range(repeats))
    if failed:
        raise SolveError(f"{law}: {failed} points failed")
    row: dict[str, float | str] = {"law": name, "points": points, "seconds": spent}
    return row | {"points_per_second": points / spent, "yielding": float((energies[:, 1] > 0).mean())}
