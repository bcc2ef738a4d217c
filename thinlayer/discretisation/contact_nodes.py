"""Nodes of S under a contact law: displacements on both sides, areas and local axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh, entities_to_geometry
from mpi4py import MPI
from petsc4py import PETSc

from forms.base import Array, InputError
from forms.kinematics import PLANE_STRAIN, Kinematics
from geometry.domain import cells_of_facets
from geometry.joint import Joint
from geometry.topology import Indices, IntArray, sum_by_number
from thinlayer.discretisation.layer import seam_entities
from thinlayer.discretisation.model import Model
from thinlayer.system.ranks import destroy, errors_on_all, send

NO_DOFS = np.empty(0, np.int32)


def body_pairs(joint: Joint, seam: str, node_ids: IntArray) -> tuple[IntArray, IntArray]:
    """Return the pairs of bodies, one below and one above S, that meet at the nodes of a seam.

    A node at a vertex has one pair, that of the vertex. A node inside an edge or a facet has those of all vertices of
    the edge or facet.

    Args:
        joint: the joint.
        seam: name of the seam.
        node_ids: (n,) numbers that identify the n nodes, see `ContactNodes`.

    Returns:
        Two arrays (m,) with an entry for each node and vertex: the index of the node, and the number of the pair of
        bodies at the vertex.
    """
    is_in_seam = joint.seam_numbers == list(joint.seams).index(seam)
    facet_numbers, pair_numbers = joint.surface_rows[is_in_seam], joint.pairs[is_in_seam]
    k = pair_numbers.shape[1]
    node_indices, corners = np.nonzero((node_ids[:, None] >> np.arange(k)) & 1)
    return node_indices, np.asarray(pair_numbers[np.searchsorted(facet_numbers, node_ids[node_indices] >> k), corners])


@dataclass(frozen=True, eq=False)
class ContactSurface:
    """Facets of S under a contact law that this rank owns, and the cells on their two sides.

    Attributes:
        V: displacement space, broken across S, with elements P1, Q1, Q2 or, in 2D, P2.
        comm: communicator for messages.
        facets: (n,) local numbers of the facets, ascending.
        upper_cells: (n,) local number of the cell on the upper side of each facet.
        lower_cells: (n,) local number of the cell on the lower side; None on a rigid base.
        facet_numbers: (n,) numbers of the facets in the joint, for files; empty without a joint.
        kinematics: kinematics of the mesh, for areas.
    """

    V: fem.FunctionSpace
    comm: MPI.Intracomm
    facets: Indices
    upper_cells: Indices
    lower_cells: Indices | None
    facet_numbers: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    kinematics: Kinematics = PLANE_STRAIN

    @classmethod
    def for_seam(cls, model: Model, name: str) -> ContactSurface:
        """Return the facets of the seam `name` of an interface model, and the cells on their two sides."""
        domain, mesh, d = model.domain, model.domain.mesh, model.joint.dim
        facets = domain.facets(name)
        facets = np.sort(facets[facets < mesh.topology.index_map(d - 1).size_local])
        on_base = name in model.joint.base_seams
        upper, lower = (cells_of_facets(mesh, facets)[0], None) if on_base else seam_entities(domain, name)[:, [0, 2]].T
        return cls(model.V, model.comm, facets, upper, lower, domain.numbers(d - 1, facets), model.kinematics)


@dataclass(eq=False)
class NodePairs:
    """Nodes of S, each with an upper and a lower displacement, its area, local axes and initial gap.

    A rank has the nodes whose upper displacement it owns.

    Attributes:
        surface: facets that the nodes belong to; if the nodes are of several seams, the facets of one of them.
        upper: (n,) local number of the node of V on the upper side.
        lower_nodes: (n,) global number of the node of V on the lower side; -1 on a rigid base.
        x: (n, d) coordinates of the nodes in d dimensions.
        weights: (n,) areas of S around the nodes (lengths in 2D).
        frames: (n, d, d) local axes of the nodes, as rows: unit tangents of S, then its unit normal.
        gap: (n,) initial gap between the sides, a length; < 0: the sides overlap before loading.
    """

    surface: ContactSurface
    upper: Indices
    lower_nodes: IntArray
    x: Array
    weights: Array
    frames: Array
    gap: Array

    def __post_init__(self) -> None:
        self.comm, self.dim, imap = self.surface.comm, self.surface.V.mesh.topology.dim, self.surface.V.dofmap.index_map
        self._first_node, self._n_owned_nodes = imap.local_range[0], imap.size_local

    @staticmethod
    def join_seams(by_seam: Sequence[NodePairs]) -> NodePairs:
        """Return the nodes of several seams as one object, in the order of `by_seam`."""
        surface = next((s.surface for s in by_seam if s.surface.lower_cells is not None), by_seam[0].surface)
        arrays = ((s.upper, s.lower_nodes, s.x, s.weights, s.frames, s.gap) for s in by_seam)
        return NodePairs(surface, *map(np.concatenate, zip(*arrays, strict=True)))

    @property
    def global_pairs(self) -> IntArray:
        """Global numbers (n, 2) of the nodes of V on the upper and on the lower side of S.

        On a rigid base -1 stands for the lower node.
        """
        return np.column_stack([self._first_node + self.upper.astype(np.int64), self.lower_nodes])

    def shared(self) -> IntArray:
        """Return the local numbers of this rank's nodes that are lower nodes in pairs of other ranks. Collective."""
        lower = self.lower_nodes[self.lower_nodes >= 0]
        owners = np.searchsorted(self.comm.allgather(self._first_node), lower, "right") - 1
        foreign = owners != self.comm.rank
        return np.unique(send(self.comm, owners[foreign], lower[foreign])) - self._first_node

    # ---------------------------------------------------------------- displacements, jumps and forces
    def new_vector(self) -> PETSc.Vec:
        """Make a vector of the displacements of all nodes of V, filled with zeros."""
        return PETSc.Vec().createMPI((self._n_owned_nodes * self.dim, None), bsize=self.dim, comm=self.comm)

    @cached_property
    def dofs(self) -> Indices:
        """Local numbers (n, d) of the displacement components of the upper nodes, in d dimensions."""
        return self.upper[:, None] * np.int32(self.dim) + np.arange(self.dim, dtype=np.int32)

    @cached_property
    def lower_matrix(self) -> PETSc.Mat | None:
        """Matrix (n d, N) from all N displacements to those of the n lower nodes; None on a rigid base."""
        if self.surface.lower_cells is None:
            return None
        n, d, has_lower = len(self.upper), self.dim, self.lower_nodes >= 0
        columns = (self.lower_nodes[has_lower, None] * d + np.arange(d)).ravel().astype(PETSc.IntType)
        indptr = np.append(0, np.cumsum(has_lower.repeat(d))).astype(PETSc.IntType)
        csr, n_local = (indptr, columns, np.ones(len(columns))), self._n_owned_nodes * d
        return PETSc.Mat().createAIJ(((n * d, None), (n_local, None)), csr=csr, comm=self.comm)

    def lower_side(self, u: PETSc.Vec) -> Array:
        """Return the displacements (n, d) of the lower nodes along x, y and z; they are zero on a rigid base."""
        if self.lower_matrix is None:
            return np.zeros((len(self.upper), self.dim))
        vector = self.lower_matrix.createVecLeft()
        self.lower_matrix.mult(u, vector)
        values = vector.array_r.reshape(-1, self.dim).copy()
        vector.destroy()
        return values

    def jump(self, u: PETSc.Vec) -> Array:
        """Return the jumps (n, d) of displacements `u`, as components along the nodes' local axes."""
        return np.einsum("nij,nj->ni", self.frames, u.array_r.reshape(-1, self.dim)[self.upper] - self.lower_side(u))

    def separation(self, u: PETSc.Vec) -> Array:
        """Return the vectors (n, d) between the two sides under displacements `u`, along the nodes' local axes.

        They are the jumps, plus the initial gap in the normal component.
        """
        w = self.jump(u)
        w[:, -1] += self.gap
        return w

    def add_forces(self, t: Array, out: PETSc.Vec) -> None:
        """Add to `out` the nodal forces that do the virtual work of tractions t (n, d) in the jumps.

        The tractions are components along the nodes' local axes; the upper side exerts t on the lower side. The nodal
        forces are internal forces, opposite to those that the sides exert on each other. They are along t on the upper
        nodes and along -t on the lower ones.
        """
        forces = np.einsum("nji,nj->ni", self.frames, t * self.weights[:, None])
        np.add.at(out.array.reshape(-1, self.dim), self.upper, forces)  # where S branches, nodes share an upper side
        if self.lower_matrix is not None:
            lower_forces, all_forces = self.lower_matrix.createVecLeft(), out.duplicate()
            lower_forces.array[:] = -forces.ravel()
            self.lower_matrix.multTranspose(lower_forces, all_forces)
            out.axpy(1.0, all_forces)
            destroy(lower_forces, all_forces)

    def stiffness(self, tangent: Array) -> PETSc.Mat:
        """Return the stiffness matrix, over all displacements, of forces that depend on the jumps.

        `tangent` (n, d, d) has the derivatives of the tractions by the jumps, both along the nodes' local axes.
        """
        d, n_local = self.dim, self._n_owned_nodes * self.dim
        nodes = self.global_pairs[:, :1] if self.lower_matrix is None else self.global_pairs
        dofs = (nodes[:, :, None] * d + np.arange(d)).reshape(-1, nodes.shape[1] * d).astype(PETSc.IntType)
        signs = np.array([1.0, -1.0])[: nodes.shape[1]].repeat(d)
        blocks = np.einsum("n,nki,nkl,nlj->nij", self.weights, self.frames, tangent, self.frames)
        entries = np.tile(blocks, (1, nodes.shape[1], nodes.shape[1])) * np.outer(signs, signs)
        indptr = np.arange(0, entries.size + 1, dofs.shape[1], dtype=PETSc.IntType)
        columns = dofs.repeat(dofs.shape[1], axis=0).ravel()
        out = PETSc.Mat().createAIJ(((n_local, None), (n_local, None)), comm=self.comm)
        out.setUp()
        out.setValuesIJV(indptr, columns, entries.ravel(), addv=PETSc.InsertMode.ADD, rowmap=dofs.ravel())
        out.assemble()
        return out

    def destroy(self) -> None:
        """Free the PETSc matrix `lower_matrix`."""
        destroy(vars(self).get("lower_matrix"))


class ContactNodes(NodePairs):
    """Nodes of S under the contact law of one seam, with their areas and mean normals. Collective.

    Integrals over S are sums over nodes, by the trapezoidal rule, or by Simpson's rule for elements of degree 2. Both
    transmit a uniform pressure exactly.

    Attributes:
        node_ids: (n,) unique number of each node, also where several nodes share a vertex; the same on any number
            of ranks. Its highest bits are the number in the joint of a facet that has the node. Its lowest k bits stand
            for the k vertices of this facet, sorted by number. A bit is 1 if the node is this vertex, or lies inside an
            edge or facet that has this vertex.
        is_fixed: (n, d) mask of the components of the jump, along x, y and z, that supports prescribe.
        is_fixed_upper: (n, d) mask of the components of the upper side's displacement that supports prescribe.
    """

    def __init__(self, surface: ContactSurface, bc_dofs: Indices = NO_DOFS, *, gap: Callable[[Array], Array]) -> None:
        """Make the nodes of a contact surface.

        Args:
            surface: the facets.
            bc_dofs: local numbers of this rank's displacement components that supports prescribe.
            gap: function of the coordinates (d, n) of n places that returns the initial gaps (n,), lengths.
        """
        V, comm, d = surface.V, surface.comm, surface.V.mesh.topology.dim
        imap, rows = V.dofmap.index_map, _facet_node_rows(surface)
        owners = np.concatenate([np.full(imap.size_local, comm.rank), imap.owners])
        received = send(comm, owners[rows[:, 0].astype(int)], np.column_stack([_to_global(V, rows[:, 0]), rows[:, 1:]]))
        pairs, pair_index = np.unique(received[:, :2], axis=0, return_inverse=True)
        pair_index = pair_index.ravel()
        sums = sum_by_number(pair_index, received[:, 2 : 3 + d], len(pairs))
        weights, area_vectors = sums[:, 0].copy(), sums[:, 1:]  # contiguous, as compiled code reads it
        upper = (pairs[:, 0] - imap.local_range[0]).astype(np.int32)
        self._ids_of_facet_nodes = received[:, 3 + d].astype(np.int64), pair_index
        self.node_ids = np.full(len(pairs), np.iinfo(np.int64).max)
        np.minimum.at(self.node_ids, pair_index, self._ids_of_facet_nodes[0])
        x = V.tabulate_dof_coordinates()[upper, :d]
        if not comm.allreduce(len(upper)):
            raise InputError("contact: S has no node where the bodies can part; it is one cell long, or has no facets")
        vector_lengths = np.linalg.norm(area_vectors, axis=1)
        if comm.allreduce(int((vector_lengths <= 0).any())):
            raise InputError("contact: a node of S has no normal, its facets fold back; use a finer mesh there")
        frames = np.ascontiguousarray(normal_frames(area_vectors / vector_lengths[:, None]))
        with errors_on_all(comm):
            gaps = gap(np.ascontiguousarray(x.T))
        super().__init__(surface, upper, pairs[:, 1].astype(np.int64), x, weights, frames, gaps)
        fixed_vector = self.new_vector()
        fixed_vector.array[bc_dofs] = 1.0
        self.is_fixed_upper = fixed_vector.array_r.reshape(-1, self.dim)[self.upper] > 0
        self.is_fixed = self.is_fixed_upper & (self.lower_matrix is None or self.lower_side(fixed_vector) > 0)
        fixed_vector.destroy()

    @property
    def links(self) -> IntArray:
        """Pairs of this rank's nodes that are neighbours along S, as indices (m, 2); empty in three dimensions."""
        node_ids, nodes = self._ids_of_facet_nodes
        positions = np.array([0, 0, 2, 1])[node_ids & 3]  # first end, second end, middle
        order = np.lexsort((positions, node_ids >> 2))[: len(node_ids) if self.dim == 2 else 0]
        return nodes[order][np.flatnonzero(np.diff(node_ids[order] >> 2) == 0)[:, None] + [0, 1]]


def _to_global(V: fem.FunctionSpace, local: Array | Indices) -> Array:
    """Return the global numbers of nodes with the local numbers `local`, as floats to be sent together with areas."""
    return V.dofmap.index_map.local_to_global(local.astype(np.int32)).astype(float)


def _facet_node_rows(surface: ContactSurface) -> Array:
    """Return a row of numbers for each node of each facet of S that this rank owns.

    The first column is the local number of the node on the upper side. The second is the global number of that on the
    lower side, or -1 on a rigid base. Then come the part of the facet's area that belongs to the node, and this area
    times the unit normal (d columns). The last column is the number in `ContactNodes.node_ids`.
    """
    V, facets, upper, lower = surface.V, surface.facets, surface.upper_cells, surface.lower_cells
    mesh, topology, d = V.mesh, V.mesh.topology, V.mesh.topology.dim
    uses_simpson = V.ufl_element().degree == 2
    for a, b in ((d, 0), (d - 1, 0), (0, d), *([(d, d - 1), (d, 1), (2, 1), (1, 0)] if uses_simpson else [])):
        topology.create_connectivity(a, b)
    vertices = _incident(mesh, d - 1, 0)[facets]
    # DOLFINx does not accept an empty list
    x_dofs = entities_to_geometry(mesh, 0, vertices.ravel()).reshape(vertices.shape) if vertices.size else vertices
    corners = mesh.geometry.x[x_dofs][..., :d]
    areas, normals = _vertex_areas(corners)
    node_points = V.tabulate_dof_coordinates()[np.asarray(V.dofmap.list)[upper]]
    to_upper_cells = node_points[..., :d].mean(axis=1) - corners.mean(axis=1)
    normals[np.einsum("fk,fk->f", normals, to_upper_cells) < 0] *= -1  # n points from the lower to the upper side
    vertex_numbers, kinematics = np.asarray(mesh.geometry.input_global_indices, np.int64)[x_dofs], surface.kinematics
    bits, rows = 1 << vertex_numbers.argsort(axis=1).argsort(axis=1), list[Array]()
    for e in range(d if uses_simpson else 1):  # nodes at vertices, edges and facets
        entities = vertices if e == 0 else facets[:, None] if e == d - 1 else _incident(mesh, d - 1, e)[facets]
        ends = vertices[:, None] if e == d - 1 else _incident(mesh, e, 0)[entities] if e else vertices[..., None]
        is_end = (ends[..., None] == vertices[:, None, None]).any(axis=2)  # (n, nodes, k)
        shares = is_end / is_end.sum(axis=2, keepdims=True)
        node_areas = kinematics.corner_areas(corners, areas)
        if uses_simpson:
            factors = 4**e / 3 ** (d - 1) * kinematics.factors_at(shares @ corners)
            node_areas = factors * np.einsum("fak,fk->fa", shares, areas)
        above = _nodes_in(V, upper, entities, e).ravel()
        below = np.full(above.size, -1.0) if lower is None else _to_global(V, _nodes_in(V, lower, entities, e).ravel())
        area_vectors = (node_areas[:, :, None] * normals[:, None]).reshape(-1, d)
        node_ids = (is_end * bits[:, None]).sum(axis=2)
        if len(surface.facet_numbers):
            node_ids += surface.facet_numbers[:, None] << vertices.shape[1]
        has_jump = (below != _to_global(V, above)) & (node_areas.ravel() > 0)  # at a tip of S there is no jump
        rows.append(np.column_stack([above, below, node_areas.ravel(), area_vectors, node_ids.ravel()])[has_jump])
    return np.concatenate(rows)


def _incident(mesh: Mesh, a: int, b: int) -> Indices:
    """Return the local numbers (n, m) of the m entities of dimension b of each local entity of dimension a."""
    connectivity = mesh.topology.connectivity(a, b)
    return np.asarray(connectivity.array.reshape(connectivity.num_nodes, -1))


def _nodes_in(V: fem.FunctionSpace, cells: Indices, entities: Indices, e: int) -> Indices:
    """Return the local numbers (n, k) of the nodes of V inside k vertices, edges or facets of each of n cells.

    Args:
        V: the space, with one node in each of these entities.
        cells: (n,) local numbers of the cells.
        entities: (n, k) local numbers of the entities.
        e: dimension of the entities, 0 for vertices.
    """
    cell_entities = _incident(V.mesh, V.mesh.topology.dim, e)[cells]
    local_index = (cell_entities[:, None, :] == entities[:, :, None]).argmax(axis=2)
    layout_dofs = np.array([V.dofmap.dof_layout.entity_dofs(e, k)[0] for k in range(cell_entities.shape[1])])
    return np.asarray(np.take_along_axis(np.asarray(V.dofmap.list)[cells], layout_dofs[local_index], axis=1), np.int32)


def _vertex_areas(corners: Array) -> tuple[Array, Array]:
    """Divide the areas of n facets among their k vertices, and return these parts and the facets' unit normals.

    Args:
        corners: (n, k, d) coordinates of the vertices in d dimensions.

    Returns:
        Areas (n, k), lengths in 2D, which add up to the area of each facet; and normals (n, d), of either sign.
    """
    if corners.shape[2] == 2:
        edge = corners[:, 1] - corners[:, 0]
        length = np.linalg.norm(edge, axis=1)
        return np.repeat(length[:, None] / 2, 2, axis=1), np.column_stack([edge[:, 1], -edge[:, 0]]) / length[:, None]
    triangle, quadrilateral = ([(1, 2), (2, 0), (0, 1)], 6), ([(1, 2), (3, 0), (0, 3), (2, 1)], 4)
    neighbours, divisor = triangle if corners.shape[1] == 3 else quadrilateral
    edge_pairs = [(corners[:, a] - corners[:, k], corners[:, b] - corners[:, k]) for k, (a, b) in enumerate(neighbours)]
    area_vectors = np.stack([np.cross(a, b) for a, b in edge_pairs], axis=1)
    mean_vector = area_vectors.mean(axis=1)
    return np.linalg.norm(area_vectors, axis=2) / divisor, mean_vector / np.linalg.norm(mean_vector, axis=1)[:, None]


def normal_frames(n: Array) -> Array:
    """Return local axes (n, d, d) of S at n unit normals `n` (n, d), as rows: unit tangents, then the normal.

    They are equal to the axes of `forms.tensors.layer_frame`.
    """
    if n.shape[1] == 2:
        return np.stack([np.column_stack([n[:, 1], -n[:, 0]]), n], axis=1)
    e = np.eye(3)
    is_down = n[:, 1] < -1 + 1e-12
    factors = n[:, [0, 2]] / np.where(is_down, 1.0, 1 + n[:, 1])[:, None]
    tangents = e[[0, 2]] - factors[:, :, None] * (n + e[1])[:, None]
    tangents[is_down] = -e[0], e[2]
    return np.concatenate([tangents, n[:, None]], axis=1)
