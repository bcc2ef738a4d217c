"""Prints norms of several structures; run by test_parallel.py on 1, 2 and 3 ranks."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import ufl
from mpi4py import MPI

from forms import Anisotropic, LinearElastic, Stack
from geometry import block, ring, sandwich
from geometry.seam import Seam
from studies.problems import FOURIER_LAYER, fourier
from thinlayer import Structure, Surface, ThinLayer, compare, solve


def structures_in_space() -> dict[str, tuple]:
    """Tetrahedra and hexahedra, both ways to make room."""
    body, glue = LinearElastic.young(30.0, 0.1), LinearElastic.young(3.0, 0.4)
    setup = {
        "body": body,
        "supports": {"BOTTOM": {"y": 0.0}, "BACK": {"z": 0.0}, "LEFT": {"x": lambda x, t: 0.01 * ufl.sin(3 * x[1])}},
        "tractions": {"TOP": lambda x, t: (0.3, -1.0, 0.1 * x[0])},
    }
    tetrahedra = sandwich(1.0, 0.4, 0.5, 0.3, depth=0.8)
    base = {"body": body, "supports": {}, "tractions": {"TOP": (0.3, -1.0, 0.2)}}
    hexahedra = block(1.0, 0.5, 0.25, depth=0.7, cell="hexahedron")
    return {
        "tetrahedra P2": (tetrahedra, setup, glue, {}),
        "hexahedra Q1 extended wedge": (
            hexahedra,
            base,
            glue,
            {"element": "Q1", "bodies": "extended", "profile": lambda x: 1 + 0.5 * x[0] * x[2]},
        ),
    }


def structures_with_curved_layers() -> dict[str, tuple]:
    """Curved cells with a law that has a material frame; a wedge."""
    body = LinearElastic.young(30.0, 0.1)
    setup = {"body": body, "supports": {"INSIDE": 0.0}, "tractions": {"OUTSIDE": (0.3, -0.2)}}
    return {
        "curved ring": (
            ring(1.0, 1.5, 2.0, 0.3, degree=2),
            setup,
            Anisotropic.springs(K_N=9.0, K_T=2.0),
            {"bodies": "extended"},
        ),
        "wedge": (*fourier(1 / 8), FOURIER_LAYER, {"bodies": "extended", "profile": lambda x: 0.5 + x[0]}),
    }


def crack() -> dict[str, float]:
    """S that ends inside."""
    whole = sandwich(1.0, 0.5, 0.5, 0.125)
    centres = whole.points[whole.facets["S"]].mean(axis=1)
    joint = replace(whole, facets={**whole.facets, "S": whole.facets["S"][centres[:, 0] < 0.5]})
    body, glue = LinearElastic.young(30.0, 0.1), LinearElastic.young(3.0, 0.4)
    layer = ThinLayer(glue, 0.04)
    state = solve(Structure(joint, body=body, supports={"BOTTOM": 0.0}, tractions={"TOP": (0.1, 1.0)}).interface(layer))
    surface = Surface(state.model)
    return {
        "crack jump": surface.norm(surface.jump(state)),
        "crack traction": surface.norm(surface.traction(state)),
        "crack u": state.integral(ufl.inner(state.u, state.u) * ufl.dx),
    }


def network() -> dict[str, float]:
    """Blocks that meet at junctions, in the plane and in space; two seams with a layer each."""
    found = {}
    body, glue = LinearElastic.young(30.0, 0.1), LinearElastic.young(3.0, 0.3)
    layers = {"BED": ThinLayer(glue, 0.04), "HEAD": ThinLayer(Stack((0.3, glue), (0.7, LinearElastic(1.0, 2.0))), 0.02)}
    for depth in (None, 0.8):
        whole = sandwich(1.0, 0.5, 0.5, 0.25 if depth else 0.125, depth=depth, structured=True)
        centres = whole.points[whole.table.vertices].mean(axis=1)
        upright = np.ptp(whole.points[whole.table.vertices][..., 0], axis=1) < 1e-9
        head = upright & (abs(centres[:, 0] - 0.5) < 1e-9) & (centres[:, 1] > 0)
        outer = dict(whole.facets)
        bed = outer.pop("S")
        joint = replace(
            whole,
            region=0 * whole.region,
            regions=("WALL",),
            facets={**outer, "BED": bed, "HEAD": whole.table.vertices[head]},
            seams={
                "BED": Seam(direction=(0.0, 1.0, 0.0)[: whole.dim]),
                "HEAD": Seam(direction=(1.0, 0.0, 0.0)[: whole.dim]),
            },
        )
        assert joint.branch is not None
        load = (0.4, 1.0, 0.2)[: joint.dim]
        structure = Structure(joint, body=body, supports={"BOTTOM": 0.0}, tractions={"TOP": load, "RIGHT": load})
        state = solve(structure.interface(layers))
        for name in ("BED", "HEAD", "S"):
            surface = Surface(state.model, name)
            jump = surface.jump(state)
            found[f"network {joint.dim} {name} jump"] = surface.norm(jump)
            found[f"network {joint.dim} {name} traction"] = surface.norm(surface.traction(state))
            found[f"network {joint.dim} {name} profile"] = float(np.linalg.norm(surface.profile(jump)[1]))
        found[f"network {joint.dim} energy"] = state.energies()["layer"]
    return found


def norms() -> dict[str, float]:
    """Norms of both models of all structures."""
    found = {}
    soft, hard = LinearElastic.young(30.0, 0.1), LinearElastic.young(12.0, 0.4)
    rotated = sandwich(1.0, 0.5, 0.7, 0.15, h_S=0.05).rotated(0.4)
    pinned = {"BOTTOM": {"x": 0.0}, tuple(rotated.points[rotated.facets["S"][0, 0]]): {"x": 0.0}}
    pinned |= {"RIGHT/UPPER": {"y": 0.01}, "RIGHT/LOWER": {"y": 0.02}}
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
                "supports": {
                    "BOTTOM": {"x": 0.0, "y": lambda x, t: 0.02 + 0.01 * x[0] ** 2},
                    "LEFT/UPPER": {"x": 0.01},
                    "RIGHT/LOWER": {"y": 0.03},
                },
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
    structures |= structures_in_space() | structures_with_curved_layers()
    for name, (joint, setup, law, options) in structures.items():
        layer = ThinLayer(law, 0.04, profile=options.pop("profile", None))
        bodies = options.pop("bodies", "kept")
        structure = Structure(joint, **setup, **options)
        limit, full = solve(structure.interface(layer)), solve(structure.full(layer, bodies=bodies))
        for key, value in compare(full, limit).items():
            found[f"{name} {key}"] = value
        for state in (full, limit):
            kind, V = state.model.name, state.model.V
            of_own_cells = np.unique(V.dofmap.list[: V.mesh.topology.index_map(V.mesh.topology.dim).size_local])
            lost = np.setdiff1d(np.arange(V.dofmap.index_map.size_local), of_own_cells)
            found[f"{name} {kind} unknowns of other ranks' cells alone"] = float(V.mesh.comm.allreduce(len(lost)))
            found[f"{name} {kind} u"] = state.integral(ufl.inner(state.u, state.u) * ufl.dx)
            found[f"{name} {kind} layer"] = state.energies()["layer"]
        surface = Surface(limit.model)
        _, values = surface.profile(surface.frame(surface.traction(full)))
        found[f"{name} profile"] = float(abs(values).sum())
    newton = solve(limit.model, method="newton")
    found["newton u"] = newton.integral(ufl.inner(newton.u, newton.u) * ufl.dx)
    return found | crack() | network()


if __name__ == "__main__":
    found = norms()
    if MPI.COMM_WORLD.rank == 0:
        json.dump(found, sys.stdout)
