"""Functions on S with one value for each pair of bodies that a seam joins around a vertex."""

from __future__ import annotations

import basix.ufl
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from geometry.compat import cell_nodes
from geometry.domain import Domain
from geometry.joint import Joint
from geometry.seam import S
from thinlayer.compiling.compat import create_submesh
from thinlayer.discretisation.broken import Keys, broken_space
from thinlayer.parallel.exchange import carry

IntArray = npt.NDArray[np.int64]


def component_at(joint: Joint, cells: IntArray, vertices: IntArray) -> IntArray:
    """(n, k) component, around vertices (n, k), of the cells (n,) that have them; -1 for cells < 0."""
    corner = (joint.corners[cells][:, None, :] == vertices[:, :, None]).argmax(axis=2)
    found = np.take_along_axis(joint.splitting.of_nodes[cells], corner, axis=1)
    return np.where(cells[:, None] < 0, -1, found)


def pair_numbers(joint: Joint) -> IntArray:
    """(n_S, k) number of the pair of bodies at each vertex of each facet of S: of the vertex, its seam and components."""
    vertices = joint.table.vertices[joint.surface_rows]
    below, above = (component_at(joint, cells, vertices) for cells in joint.surface_cells.T)
    count = int(max(below.max(), above.max())) + 2
    codes = (joint.seam_numbers[:, None] * count + above) * count + below + 1
    return np.asarray(joint.masters[vertices] * (codes.max() + 1) + codes, np.int64)


class Pairs:
    """Vector functions of degree 1 on a mesh of the facets of S. Collective, as all methods are.

    At a vertex there is one value for each seam and each pair of components of the cells above and below it. So functions
    are continuous along a seam, except where it comes to other bodies: at a T-junction there are three values, at a
    crossing four, at a corner of a body one for each of its seams.

    Args:
        domain: the mesh of an interface model.

    Attributes:
        mesh: the facets of S, of all seams.
        maps: how they lie in the model's mesh, for `fem.form`.
        parent: local facet of the model's mesh that is each cell of `mesh` (ghosts included).
        vertices: (n, k) vertices in the joint of each cell of `mesh`.
        rows: for each cell of `mesh` (ghosts included) the position of its facet in `joint.surface_rows`.
        space: the functions.
        of_facets: (n_S, k) number of the pair at each vertex of the joint's facets of S, the same on all ranks.
        numbers: (n,) number of the pair at each local node of `space`.
        at_vertices: (n,) its vertex; in a periodic cell the one that stands for all that are identified.
        seam: (n,) position of its seam in `joint.seams`.
        tip: (n,) whether a seam ends inside a body there: nothing jumps.
        shared: (n,) whether there are several pairs at its vertex.
    """

    def __init__(self, domain: Domain) -> None:
        joint, d = domain.joint, domain.joint.dim
        self._domain, facets = domain, domain.facets(S)
        self.mesh, self.maps, self.parent = create_submesh(domain.mesh, d - 1, facets)
        self.rows = np.searchsorted(joint.surface_rows, domain.numbers(d - 1, self.parent))

        vertices = joint.table.vertices[joint.surface_rows]
        below, above = (component_at(joint, cells, vertices) for cells in joint.surface_cells.T)
        masters, self.of_facets = joint.masters[vertices], pair_numbers(joint)
        _, first, number = np.unique(self.of_facets, return_index=True, return_inverse=True)
        _, times = np.unique(masters.ravel()[first], return_counts=True)
        shared = np.repeat(times > 1, times)[number.ravel()].reshape(vertices.shape)

        # vertices of the cells of `mesh`, in their own order, among those of the joint's facets
        points = np.asarray(self.mesh.geometry.input_global_indices, np.int64)
        self.vertices = points[cell_nodes(self.mesh)[:, : vertices.shape[1]]]
        self._place = (vertices[self.rows][:, None, :] == self.vertices[:, :, None]).argmax(axis=2)
        element = basix.ufl.element("Lagrange", self.mesh.basix_cell(), 1, shape=(d,))
        keys = self._here(number.reshape(vertices.shape))
        self.space = broken_space(domain.comm, Keys.of_entities(domain.comm, self.mesh, element, [keys]))
        self.numbers, self.at_vertices = self._at_nodes(self.of_facets), self._at_nodes(masters)
        self.seam = self._at_nodes(np.broadcast_to(joint.seam_numbers[:, None], vertices.shape))
        self.tip, self.shared = self._at_nodes(above == below), self._at_nodes(shared)

    def _here(self, values: npt.NDArray) -> npt.NDArray:
        """Values (n_S, k) at the vertices of the joint's facets, at those of the cells of `mesh`."""
        return np.take_along_axis(values[self.rows], self._place, axis=1)

    def _at_nodes(self, values: npt.NDArray) -> npt.NDArray:
        """Values (n_S, k) at the vertices of the joint's facets, at the local nodes of `space`."""
        imap = self.space.dofmap.index_map
        out = np.zeros(imap.size_local + imap.num_ghosts, values.dtype)
        out[self.space.dofmap.list] = self._here(values)
        return out

    def from_other(self, f: fem.Function, other: Pairs) -> fem.Function:
        """A function of another model's pairs, of the same joint, in `space`."""
        cells = np.asarray(other.space.dofmap.list)
        own = cells[: other.mesh.topology.index_map(other.mesh.topology.dim).size_local]
        values = np.zeros((*own.shape, f.function_space.dofmap.bs))
        sent = f.x.array.reshape(-1, values.shape[2])[own]
        np.put_along_axis(values, other._place[: len(own), :, None], sent, axis=1)
        there = carry(self._domain.comm, other.rows[: len(own)], values.reshape(len(own), -1), self.rows)
        out = fem.Function(self.space)
        received = there.reshape(len(self.rows), *values.shape[1:])
        out.x.array.reshape(-1, values.shape[2])[self.space.dofmap.list] = np.take_along_axis(
            received, self._place[:, :, None], axis=1
        )
        return out
