"""Displacements that follow others: at the sides of a meshed layer where its interface law goes on, those of both faces."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from scipy.spatial import cKDTree

from geometry.domain import Domain
from geometry.errors import place
from geometry.seam import BASE, CUT, LOWER_FACE, UPPER_FACE
from thinlayer.discretisation.constraints import Followers
from thinlayer.discretisation.joint_fields import shift
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.errors import ModelError
from thinlayer.parallel.agreement import on_all

Array = npt.NDArray[np.float64]
SAME_PLACE = 1e-9  # distance before inflating, relative to the size of the joint, of nodes above one another


def at_cuts(domain: Domain, V: fem.FunctionSpace, layers: Mapping[str, SeamLayer]) -> Followers | None:
    """The nodes between both faces of a layer where its cells end and it goes on; None: it does nowhere.

    They move as the interface law of order 1 has it, by <u> + Phi [u] (`AtRest.through`).

    Args:
        domain: the mesh.
        V: displacements, of nodes.
        layers: name of a seam -> its layer.

    Raises:
        ModelError: a node of a cut that is above none of the faces. Collective.
    """
    if CUT not in domain.joint.facets:
        return None
    d, first = domain.joint.dim, V.dofmap.index_map.local_range[0]
    x, moved = V.tabulate_dof_coordinates()[:, :d], fem.Function(V)
    moved.interpolate(shift(domain))
    before = x - moved.x.array.reshape(x.shape)
    at_cut = _owned(domain, V, CUT)
    faces = [
        [
            _owned(domain, V, next(n for n in (f"{name}/{face}", face, BASE) if n in domain.joint.facets))
            for name in layers
        ]
        for face in (LOWER_FACE, UPPER_FACE)
    ]
    rows = np.setdiff1d(at_cut, np.concatenate([nodes for face in faces for nodes in face]))
    ends, size = [], float(np.ptp(domain.joint.points, axis=0).max())
    for face in faces:
        each = [np.intersect1d(at_cut, nodes) for nodes in face]
        own, seam = np.concatenate(each), np.arange(len(each)).repeat([*map(len, each)])
        table = np.column_stack([before[own], x[own], own + first, seam])
        everywhere = np.concatenate(domain.comm.allgather(table))
        distance, at = cKDTree(everywhere[:, :d]).query(before[rows])
        with on_all(domain.comm):
            if (distance > SAME_PLACE * size).any():
                raise ModelError(
                    f"a node at a cut has none of a face above or below it, {place(x[rows][distance.argmax()])}"
                )
        ends.append(everywhere[at, d:])
    apart, nodes = ends[1][:, :d] - ends[0][:, :d], [end[:, d].astype(np.int64) for end in ends]
    across = np.linalg.norm(apart, axis=1)
    share = np.linalg.norm(x[rows] - ends[0][:, :d], axis=1) / across
    n, upper = apart / across[:, None], np.zeros((len(rows), d, d))  # part of the upper face's displacements
    for number, one in enumerate(layers.values()):
        here = ends[0][:, -1] == number
        normal, tangential = (0.5 + phi[:, None, None] for phi in one.at_rest.through(share[here] - 0.5))
        upper[here] = tangential * np.eye(d) + (normal - tangential) * n[here][:, :, None] * n[here][:, None]
    every = np.arange(d)
    of = np.concatenate([(one[:, None] * d + every) for one in nodes], axis=1).repeat(d, axis=0)
    shares = np.concatenate([np.eye(d) - upper, upper], axis=2).reshape(-1, 2 * d)
    return Followers((rows[:, None] * d + every).ravel(), of, shares)


def _owned(domain: Domain, V: fem.FunctionSpace, *names: str) -> npt.NDArray[np.int64]:
    """Nodes of this rank on the facets of some names, by their local numbers. Collective."""
    facets = np.unique(np.concatenate([domain.facets(name) for name in names]))
    found = fem.locate_dofs_topological(V, V.mesh.topology.dim - 1, facets)
    return np.unique(found[found < V.dofmap.index_map.size_local]).astype(np.int64)
