"""Displacements that follow others: at the sides of a meshed layer where its interface law goes on, those of both faces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from scipy.spatial import cKDTree

from geometry.domain import Domain
from geometry.errors import place
from geometry.seam import CUT, LOWER_FACE, UPPER_FACE
from thinlayer.errors import ModelError
from thinlayer.parallel.agreement import on_all

Array = npt.NDArray[np.float64]
SAME_PLACE = 1e-9  # distance along S, relative to the size of the joint, of nodes above one another


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
    def at_cuts(cls, domain: Domain, V: fem.FunctionSpace, n: Array) -> Followers | None:
        """The nodes between both faces of a planar layer where its cells end and it goes on; None: it does nowhere.

        They move as the interface law of order 1 has it, linearly from face to face.

        Args:
            domain: the mesh.
            V: displacements, of nodes.
            n: (d,) unit normal of S.

        Raises:
            ModelError: nodes that are not above one another. Collective.
        """
        if CUT not in domain.joint.facets:
            return None
        d, imap = domain.joint.dim, V.dofmap.index_map
        x = V.tabulate_dof_coordinates()[:, :d]
        found = {name: _owned(V, domain.facets(name)) for name in (CUT, LOWER_FACE, UPPER_FACE)}
        first = imap.local_range[0]
        height, along = x @ n, x - np.outer(x @ n, n)
        size = float(np.ptp(domain.joint.points, axis=0).max())
        rows = np.setdiff1d(found[CUT], np.union1d(found[LOWER_FACE], found[UPPER_FACE]))
        ends = []
        for name in (LOWER_FACE, UPPER_FACE):
            own = np.intersect1d(found[CUT], found[name])
            table = np.column_stack([along[own], height[own], own + first])
            everywhere = np.concatenate(domain.comm.allgather(table))
            distance, at = cKDTree(everywhere[:, :d]).query(along[rows])
            with on_all(domain.comm):
                if (distance > SAME_PLACE * size).any():
                    lost = x[rows[distance.argmax()]]
                    raise ModelError(
                        f"no node of {name} stands straight below or above that of the cut at {place(lost)}"
                    )
            ends.append(everywhere[at, d:])
        (low, lower), (high, upper) = (end.T for end in ends)
        share = (height[rows] - low) / (high - low)
        every = np.arange(d)
        of = np.stack([(end.astype(np.int64)[:, None] * d + every).ravel() for end in (lower, upper)], axis=1)
        shares = np.column_stack([1 - share, share]).repeat(d, axis=0)
        return cls((rows[:, None] * d + every).ravel(), of, shares)


def _owned(V: fem.FunctionSpace, facets: npt.NDArray[np.int32]) -> npt.NDArray[np.int64]:
    """Nodes of this rank on facets, by their local numbers. Collective."""
    found = fem.locate_dofs_topological(V, V.mesh.topology.dim - 1, facets)
    return np.unique(found[found < V.dofmap.index_map.size_local]).astype(np.int64)
