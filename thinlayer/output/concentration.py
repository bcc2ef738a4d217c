"""The facets of S on which a density lies: the fewest that hold most of its integral."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from scipy.spatial import cKDTree
from ufl.classes import Zero

from forms.base import is_number
from forms.interface import Interface
from forms.kinematics import Expr
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.errors import ModelError
from thinlayer.output.surface_expression import integrated
from thinlayer.output.surface_mass import nodal_forces

ROUNDING = 1e-12  # of sums, relative


def sums_on_facets(model: InterfaceModel, sides: Interface, f: Expr) -> npt.NDArray[np.float64]:
    """(n_S,) integrals of |f| over the facets of S, the same on all ranks; two facets of one upper cell have their sum.

    Args:
        model: the model.
        sides: the sides of S, or of a seam; elsewhere integrals are zero.
        f: scalar expression on S.
    """
    if isinstance(f, Zero):
        return np.zeros(len(model.joint.surface_rows))
    W = fem.functionspace(model.domain.mesh, ("DG", 0))
    form = abs(f) * sides.upper(ufl.TestFunction(W)) * sides.factor * sides.measure
    found = integrated(form, partial(nodal_forces, W))
    joint, owned = model.joint, W.dofmap.index_map.size_local
    of_cells = np.zeros(len(joint.cells))
    of_cells[model.domain.original_cells[:owned]] = found.x.array[np.asarray(W.dofmap.list)[:owned, 0]]
    return np.asarray(model.comm.allreduce(of_cells)[joint.surface_cells[:, 1]])


def most_of(sums: npt.NDArray[np.float64], all_but: float) -> npt.NDArray[np.bool_]:
    """The fewest values >= 0 whose sum is that of all but for a share.

    Raises:
        ModelError: a share out of range; values that are not finite, or all zero.
    """
    if not is_number(all_but) or not 0 <= all_but < 1:
        raise ModelError(f"all_but is {all_but!r}, a share of an integral; allowed: from 0 to less than 1")
    total = float(sums.sum())
    if not (np.isfinite(total) and total > 0):
        raise ModelError(f"the integral over S is {total:g}; nothing tells one part of S from another")
    order = np.argsort(-sums, kind="stable")
    left = total - np.cumsum(sums[order])
    chosen = np.zeros(len(sums), bool)
    chosen[order[: int(np.argmax(left <= (all_but + ROUNDING) * total)) + 1]] = True
    return chosen


def widened(model: InterfaceModel, chosen: npt.NDArray[np.bool_], length: float) -> npt.NDArray[np.bool_]:
    """Facets of S (n_S,) whose centres are within a length of a vertex of a chosen one, and these."""
    joint = model.joint
    vertices = joint.table.vertices[joint.surface_rows]
    centres = joint.points[vertices].mean(axis=1)
    near, _ = cKDTree(joint.points[np.unique(vertices[chosen])]).query(centres)
    return np.asarray(chosen | (near < length))
