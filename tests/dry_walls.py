"""Dry walls, pushed forth and back, and the balance of their bricks."""

from __future__ import annotations

import numpy as np
import ufl

from forms import HolonomicCoulomb, LinearElastic
from geometry import wall
from thinlayer import Structure
from thinlayer.discretisation.state import State
from thinlayer.output.nodal_forces import contact_forces, nodal_forces

DRY = {"BED": (200.0, 80.0, 0.5), "HEAD": (100.0, 40.0, 0.3)}  # K_N, K_T, friction


PUSH = lambda x, t: t


def dry_wall(
    push=PUSH, *, bricks=3, courses=4, stiffer=1.0, weight=0.0, kind=HolonomicCoulomb, cell="quadrilateral", **sizes
):
    """A wall under a pressure of 1, and the shear stress push(x, t) on its top; 14 bricks if not told.

    `weight` is that of a square of bricks.
    """
    joint = wall(bricks, courses, (1.0, 0.5), sizes.pop("h", 0.125), cell=cell, **sizes)
    loads = {"TOP": lambda x, t: (push(x, t), -1.0, *([0.0] * (joint.dim - 2)))}
    element, weights = "P1" if cell in ("triangle", "tetrahedron") else "Q1", (0.0, -weight, 0.0)[: joint.dim]
    data = {"supports": {"BOTTOM": 0.0}, "tractions": loads, "body_force": weights, "element": element}
    structure = Structure(joint, body=LinearElastic.young(50.0, 0.2), **data)
    laws = {name: kind(K_N=stiffer * K_N, K_T=stiffer * K_T, friction=f) for name, (K_N, K_T, f) in DRY.items()}
    return structure.interface(laws)


def imbalance(state: State) -> float:
    """Largest sum of the forces, or of their moments, on a brick that no support holds, over the sum of all loads."""
    model, d = state.model, state.model.joint.dim
    loads = nodal_forces(model.V, model.external_work(ufl.TestFunction(model.V), state.t))
    size = float(np.abs(loads.x.array).sum())
    forces = (loads.x.array + contact_forces(state).x.array).reshape(-1, d)
    x = model.V.tabulate_dof_coordinates()[:, :d]
    bricks = model.split_mesh.pieces
    of = np.zeros(len(x), np.int64)
    cells = np.asarray(model.V.dofmap.list)
    of[cells] = model.domain.to_local(bricks)[: len(cells), None]
    moments = [x[:, i] * forces[:, j] - x[:, j] * forces[:, i] for i in range(d) for j in range(i + 1, d)]
    sums = np.array([np.bincount(of, part) for part in (*forces.T, *moments)])
    supported = np.unique(of[model.supports.bc_dofs_in(model.V) // d])
    return float(np.abs(np.delete(sums, supported, axis=1)).max()) / size
