"""Displacements that follow others: at the sides of a meshed layer where its interface law goes on, those of both faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from scipy.spatial import cKDTree

from geometry.domain import Domain
from geometry.errors import place
from geometry.seam import BASE, CUT, LOWER_FACE, UPPER_FACE
from thinlayer.discretisation.joint_fields import shift
from thinlayer.errors import ModelError
from thinlayer.parallel.agreement import on_all

Array = npt.NDArray[np.float64]
SAME_PLACE = 1e-9  # distance before inflating, relative to the size of the joint, of nodes above one another


@dataclass(frozen=True)
class Followers:
    """Displacements that are means of two others, which follow none.

    Attributes:
        rows: (n,) displacements of this rank, unrolled, that follow.
        of: (n, 2) global numbers of those that they follow.
        shares: (n, 2) of these, with sum 1.
    """

    rows: npt.NDArray[np.int64]
    of: npt.NDArray[np.int64]
    shares: Array

    @classmethod
    def at_cuts(cls, domain: Domain, V: fem.FunctionSpace) -> Followers | None:
        """The nodes between both faces of a layer where its cells end and it goes on; None: it does nowhere.

        They move as the interface law of order 1 has it, linearly from face to face.

        Args:
            domain: the mesh.
            V: displacements, of nodes.

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
            _owned(domain, V, *(name for name in domain.joint.facets if name.split("/")[-1] in face))
            for face in ((LOWER_FACE, BASE), (UPPER_FACE,))
        ]
        rows = np.setdiff1d(at_cut, np.union1d(*faces))
        ends, size = [], float(np.ptp(domain.joint.points, axis=0).max())
        for face in faces:
            own = np.intersect1d(at_cut, face)
            everywhere = np.concatenate(domain.comm.allgather(np.column_stack([before[own], x[own], own + first])))
            distance, at = cKDTree(everywhere[:, :d]).query(before[rows])
            with on_all(domain.comm):
                if (distance > SAME_PLACE * size).any():
                    raise ModelError(
                        f"a node at a cut has none of a face above or below it, {place(x[rows][distance.argmax()])}"
                    )
            ends.append(everywhere[at, d:])
        lower, upper = (end[:, :d] for end in ends)
        share = np.linalg.norm(x[rows] - lower, axis=1) / np.linalg.norm(upper - lower, axis=1)
        every = np.arange(d)
        of = np.stack([(end[:, d].astype(np.int64)[:, None] * d + every).ravel() for end in ends], axis=1)
        return cls((rows[:, None] * d + every).ravel(), of, np.column_stack([1 - share, share]).repeat(d, axis=0))


def _owned(domain: Domain, V: fem.FunctionSpace, *names: str) -> npt.NDArray[np.int64]:
    """Nodes of this rank on the facets of some names, by their local numbers. Collective."""
    facets = np.unique(np.concatenate([domain.facets(name) for name in names]))
    found = fem.locate_dofs_topological(V, V.mesh.topology.dim - 1, facets)
    return np.unique(found[found < V.dofmap.index_map.size_local]).astype(np.int64)
