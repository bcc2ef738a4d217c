"""Prints norms of several structures; run by test_parallel on 1, 2 and 3 ranks."""

from __future__ import annotations

import json
import sys

import ufl
from mpi4py import MPI

from forms import LinearElastic, Stack
from geometry import block, sandwich
from studies.problems import FOURIER_LAYER, fourier
from thinlayer import Model, Surface, ThinLayer, compare, solve


def norms() -> dict[str, float]:
    """Norms of both models of four structures."""
    found = {}
    soft, hard = LinearElastic.young(30.0, 0.1), LinearElastic.young(12.0, 0.4)
    rotated = sandwich(1.0, 0.5, 0.7, 0.15, h_S=0.05).rotated(0.4)
    pinned = {"BOTTOM": 0.0, tuple(rotated.points[rotated.facets["S"][0, 0]]): {"x": 0.0}}
    push = {"TOP": lambda x, t: (0.5 * x[0], -1.0), "LEFT/UPPER": (0.2, 0.0)}
    structures = {
        "fourier P2": (*fourier(1 / 8), FOURIER_LAYER, {}),
        "fourier S2 extended": (
            *fourier(1 / 8, cell="quadrilateral"),
            FOURIER_LAYER,
            {"element": "S2", "bodies": "extended"},
        ),
        "stack P1": (
            rotated,
            {"body": {"LOWER": soft, "UPPER": hard}, "supports": pinned, "tractions": push, "body_force": (0.0, -0.3)},
            Stack((0.3, soft), (0.7, hard)),
            {"element": "P1"},
        ),
        "fewer cells than ranks": (
            sandwich(1.0, 1.0, 1.0, 1.0, cell="quadrilateral"),
            {
                "body": hard,
                "supports": {"BOTTOM": {"x": 0.0, "y": lambda x, t: 0.02 + 0.01 * x[0] ** 2}},
                "tractions": {"TOP": (1.0, 2.0)},
            },
            soft,
            {"element": "Q1"},
        ),
        "block Q2": (
            block(2.0, 1.0, 0.3, h_S=0.1, cell="quadrilateral"),
            {"body": hard, "supports": {"RIGHT": {"x": 0.0}}, "tractions": {"LEFT": (1.0, 0.0)}},
            soft,
            {"plane": "stress"},
        ),
    }
    for name, (joint, setup, law, options) in structures.items():
        layer = ThinLayer(law, 0.04)
        limit = solve(Model.interface(joint, layer=layer, **setup, **options))
        full = solve(Model.full(joint, layer=layer, **setup, **options))
        for key, value in compare(full, limit).items():
            found[f"{name} {key}"] = value
        for state in (full, limit):
            kind = state.model.kind
            found[f"{name} {kind} u"] = state.integral(ufl.inner(state.u, state.u) * ufl.dx)
            found[f"{name} {kind} layer"] = state.energies()["layer"]
        surface = Surface(limit.model)
        _, values = surface.profile(surface.frame(surface.traction(full)))
        found[f"{name} profile"] = float(abs(values).sum())
    newton = solve(limit.model, method="newton")
    found["newton u"] = newton.integral(ufl.inner(newton.u, newton.u) * ufl.dx)
    return found


if __name__ == "__main__":
    found = norms()
    if MPI.COMM_WORLD.rank == 0:
        json.dump(found, sys.stdout)
