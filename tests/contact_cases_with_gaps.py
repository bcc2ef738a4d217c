"""mpirun -n N python3 -m tests.contact_cases_with_gaps: a crowned block, pressed and pushed along its base."""

from __future__ import annotations

import json

import numpy as np
import ufl
from mpi4py import MPI

from forms import HolonomicCoulomb, LinearElastic
from geometry import sandwich
from thinlayer import ContactReport, Structure, solve

LOWER, UPPER = LinearElastic.young(30.0, 0.3), LinearElastic.young(50.0, 0.2)


def CURVED(x):
    """A crown of radius 20."""
    return (x[0] - 1.1) ** 2 / 40


def curved(kind=HolonomicCoulomb, gap=CURVED):
    joint = sandwich(2.0, 0.5, 0.75, 0.125, structured=True)
    supports = {"BOTTOM": 0.0, "TOP": {"x": lambda x, t: 0.008 * t, "y": lambda x, t: -0.01 * t}}
    structure = Structure(joint, body={"LOWER": LOWER, "UPPER": UPPER}, supports=supports, element="P1")
    return structure.interface(kind(K_N=400.0, K_T=150.0, friction=0.3, gap=gap))


def norms() -> dict[str, float]:
    state = solve(curved(), 1.0)
    report = ContactReport(state)
    return {
        "u": state.integral(ufl.inner(state.u, state.u) * ufl.dx),
        "normal force": report.normal_force,
        "friction": float(np.abs(report.friction_force).max()),
        "closed": float((report.p > 0).sum()),
    }


if __name__ == "__main__":
    found = norms()
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))
