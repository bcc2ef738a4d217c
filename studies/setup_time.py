"""Benchmark: what is done before a solve, against a plain DOLFINx script without an interface; time, ratio and memory."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import basix.ufl
import dolfinx
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from forms import LinearElastic
from geometry import sandwich
from geometry.domain import create_mesh
from geometry.joint import Joint
from studies.timing import in_turn, peak, seconds
from thinlayer import Structure, ThinLayer
from thinlayer.running.record import Record
from thinlayer.solving.solvers import Solver
from thinlayer.system.progress import track
from thinlayer.system.table import Row

BODY, LAYER = LinearElastic.young(E=100.0, nu=0.3), ThinLayer(LinearElastic(lmbda=60.0, mu=40.0), 0.01, at=1.0)
SIZES = {"2D": 700, "3D": 40}  # cells along each side, for 984,204 and 211,806 unknowns
QUICK = {"2D": 100, "3D": 8}
LIMIT = 1.5  # time of a model over that of the plain script


def run(record: Record, *, quick: bool = False) -> None:
    """Alternate the stages of our set-up and the plain script in one process, warm, and keep the least time of each.

    Two blocks under a traction, displacements of degree 1. The plain script has the same cells, the bodies as tags and as
    subdomains of a form, the sides as tags, supports and a load, and a continuous space. Times are of the processor.

    Args:
        record: where to write.
        quick: small meshes.
    """
    repeats = 3
    table = record.table("table.csv")
    for name, n in track(list((QUICK if quick else SIZES).items()), "setup_time", "{0[0]}"):
        table.extend(compare(name, n, repeats))
    for row in () if quick else table.rows:
        if row["work"] == "model":
            ratio = float(row["ratio"] or 0)
            record.check(f"{row['dim']}D: time of a model over the plain script's", ratio, high=LIMIT)


def compare(name: str, n: int, repeats: int) -> list[Row]:
    """Rows of the table: the stages of our set-up and the plain script."""
    depth = 1.0 if name == "3D" else None

    def build() -> Joint:
        return sandwich(1.0, 0.5, 0.5, 1 / n, depth=depth, structured=True)

    joint = build()
    supports: dict[Any, Any] = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    load = {"TOP": (0.5, 1.0, 0.0)[: joint.dim]}

    def structure() -> Structure:
        return Structure(joint, body=BODY, supports=supports, tractions=load, element="P1")

    model = structure().interface(LAYER)
    stages: dict[str, Callable[[], Any]] = {
        "joint": build,
        "structure": structure,
        "model": lambda: structure().interface(LAYER),
        "stiffness": lambda: Solver(model).close(),
        "plain script": lambda: plain(joint, load["TOP"]),
    }
    peaks = {work: peak(stage) for work, stage in stages.items()}  # which also warms up
    times = in_turn({work: partial(seconds, stage) for work, stage in stages.items()}, repeats)
    row = {"dim": joint.dim, "dofs": model.unknowns, "cells_along": n}
    return [
        {"work": work} | row
        | {"seconds": times[work], "ratio": times[work] / times["plain script"], "peak_mb": peaks[work]}
        for work in stages
    ]  # fmt: skip


def plain(joint: Joint, load: tuple[float, ...]) -> tuple[fem.Form, fem.Form, list[fem.DirichletBC]]:
    """The set-up of a script in plain DOLFINx: mesh, tags, space, supports and compiled forms."""
    dim, cell = joint.dim, joint.cell_type
    mesh = create_mesh(MPI.COMM_SELF, joint.points, joint.cells, cell)
    original = mesh.topology.original_cell_index
    numbers = np.arange(len(original), dtype=np.int32)
    cell_tags = dolfinx.mesh.meshtags(mesh, dim, numbers, (joint.region[original] + 1).astype(np.int32))
    places = {"BOTTOM": (1, -0.5), "TOP": (1, 0.5), "LEFT": (0, 0.0), "RIGHT": (0, 1.0)}
    sides = {
        name: dolfinx.mesh.locate_entities_boundary(mesh, dim - 1, lambda x, k=k, at=at: np.isclose(x[k], at))
        for name, (k, at) in places.items()
    }
    facet_tags = dolfinx.mesh.meshtags(mesh, dim - 1, np.sort(sides["TOP"]), 1)
    V = fem.functionspace(mesh, basix.ufl.element("Lagrange", cell, 1, shape=(dim,)))
    zero = dolfinx.default_scalar_type(0.0)
    supports = [fem.dirichletbc(np.zeros(dim), fem.locate_dofs_topological(V, dim - 1, sides["BOTTOM"]), V)]
    supports += [
        fem.dirichletbc(zero, fem.locate_dofs_topological(V.sub(0), dim - 1, sides[name]), V.sub(0))
        for name in ("LEFT", "RIGHT")
    ]
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    dx = ufl.Measure("dx", domain=mesh, subdomain_data=cell_tags)
    ds = ufl.Measure("ds", domain=mesh, subdomain_data=facet_tags)
    e, d = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))
    work = (BODY.lmbda * ufl.tr(e) * ufl.tr(d) + 2 * BODY.mu * ufl.inner(e, d)) * dx((1, 2))
    return fem.form(work), fem.form(ufl.inner(fem.Constant(mesh, np.array(load)), v) * ds(1)), supports
