"""Nodes of S under a contact law: displacements on both sides, areas and local axes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import basix
import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from mpi4py import MPI
from petsc4py import PETSc

from forms.base import Array, InputError
from forms.kinematics import PLANE_STRAIN, Kinematics
from geometry.domain import cell_nodes
from geometry.joint import Joint
from geometry.topology import (
    FACET_TYPES,
    Indices,
    IntArray,
    corner_count,
    facet_nodes,
    nodal_normal_vectors,
    sum_by_number,
    turned_towards,
    vertex_weights,
)
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
    facets = joint.facets_of(seam)
    k = joint.pairs.shape[1]
    pair_numbers = np.take_along_axis(joint.pairs, joint.surface[:, :k].argsort(axis=1), axis=1)[facets]
    node_indices, corners = np.nonzero((node_ids[:, None] >> np.arange(k)) & 1)
    at = np.searchsorted(joint.surface_rows[facets], node_ids[node_indices] >> k)
    return node_indices, np.asarray(pair_numbers[at, corners])


def nodes_of_sides(V: fem.FunctionSpace, sides: Indices) -> tuple[IntArray, IntArray]:
    """Return the nodes of a space on both sides of facets of S; nodes that face each other have the same position.

    Args:
        V: the space, with Lagrange elements of degree 1 or 2, or serendipity elements of degree 2.
        sides: the n facets of this rank, as from `Domain.sides`.

    Returns:
        Local numbers (2, n, m) of the m nodes of each facet on its upper and on its lower side; (1, n, m) on a rigid
        base. And keys (n, m). The lowest bits of a key stand for the vertices of the facet, sorted by number. A bit is
        1 if the node is this vertex, or lies inside an edge or facet that has this vertex.
    """
    cell_type, cell_nodes_of_V = V.mesh.topology.cell_name(), np.asarray(V.dofmap.list, np.int64)
    has_vertex = vertex_weights(FACET_TYPES[cell_type], 1 + (cell_nodes_of_V.shape[1] > corner_count(cell_type))) > 0
    nodes, keys, vertex_numbers = [], [], np.asarray(V.mesh.geometry.input_global_indices, np.int64)
    for cells, local in zip(sides.T[::2], sides.T[1::2], strict=True):
        bits = 1 << vertex_numbers[_vertex_points(V.mesh, cells, local)].argsort(axis=1).argsort(axis=1)
        nodes_of_facets = facet_nodes(cell_nodes_of_V, cell_type, cells, local)
        keys.append(bits @ has_vertex[: nodes_of_facets.shape[1]].T.astype(np.int64))
        facing = np.take_along_axis(keys[-1].argsort(axis=1), keys[0].argsort(axis=1).argsort(axis=1), axis=1)
        nodes.append(np.take_along_axis(nodes_of_facets, facing, axis=1))
    return np.stack(nodes), keys[0]


def _vertex_points(mesh: Mesh, cells: Indices, local: Indices) -> Indices:
    """Return the local numbers (n, k), in the geometry of a mesh, of the k vertices of facet `local` of n cells."""
    cell_type = mesh.topology.cell_name()
    return facet_nodes(cell_nodes(mesh)[:, : corner_count(cell_type)], cell_type, cells, local)


@dataclass(frozen=True, eq=False)
class ContactSurface:
    """Facets of S under a contact law that this rank owns, and the cells on their two sides.

    Attributes:
        V: displacement space, broken across S, with elements P1, Q1, Q2 or, in 2D, P2.
        comm: communicator for messages.
        sides: the n facets, as rows (n, 4) of local numbers: upper cell, number of the facet in this cell, lower cell,
            number of the facet in this cell; on a rigid base (n, 2), without the lower cell.
        facet_numbers: (n,) numbers of the facets in the joint, for files; empty without a joint.
        kinematics: kinematics of the mesh, for areas.
    """

    V: fem.FunctionSpace
    comm: MPI.Intracomm
    sides: Indices
    facet_numbers: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    kinematics: Kinematics = PLANE_STRAIN

    @property
    def on_base(self) -> bool:
        """Whether S stands on a rigid base here, without lower cells."""
        return self.sides.shape[1] == 2


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
        surface = next((s.surface for s in by_seam if not s.surface.on_base), by_seam[0].surface)
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
        if self.surface.on_base:
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
    return V.dofmap.index_map.local_to_global(local.astype(np.int32).ravel()).astype(float).reshape(local.shape)


def _facet_node_rows(surface: ContactSurface) -> Array:
    """Return a row of numbers for each node of each facet of S that this rank owns.

    The first column is the local number of the node on the upper side. The second is the global number of that on the
    lower side, or -1 on a rigid base. Then come the part of the facet's area that belongs to the node, and this area
    times the unit normal (d columns). The last column is the number in `ContactNodes.node_ids`.
    """
    V, sides, kinematics = surface.V, surface.sides, surface.kinematics
    mesh, d, facet_type = V.mesh, V.mesh.topology.dim, FACET_TYPES[V.mesh.topology.cell_name()]
    corners = mesh.geometry.x[_vertex_points(mesh, *sides.T[:2]), :d]
    normals = nodal_normal_vectors(corners, mesh.topology.cell_name(), 1)
    areas = np.linalg.norm(normals, axis=2) * basix.cell.volume(basix.CellType[facet_type]) / corners.shape[1]
    to_upper_cells = mesh.geometry.x[cell_nodes(mesh)[sides[:, 0]], :d].mean(axis=1) - corners.mean(axis=1)
    n = turned_towards(normals.mean(axis=1), to_upper_cells)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    (above, *below), node_ids = nodes_of_sides(V, sides)
    node_areas = kinematics.corner_areas(corners, areas)
    if V.ufl_element().degree == 2:  # Simpson's rule: weights 1, 4 inside edges and 16 inside quadrilaterals
        shares = vertex_weights(facet_type, 2)
        factors = np.count_nonzero(shares, axis=1) ** 2 / 3 ** (d - 1) * kinematics.factors_at(shares @ corners)
        node_areas = factors * (areas @ shares.T)
    if len(surface.facet_numbers):
        node_ids += surface.facet_numbers[:, None] << corners.shape[1]
    lower = _to_global(V, below[0]) if below else np.full(above.shape, -1.0)
    columns = (above, lower, node_areas, *(node_areas * n_i[:, None] for n_i in n.T), node_ids)
    has_jump = (lower != _to_global(V, above)) & (node_areas > 0)  # at a tip of S there is no jump
    return np.stack(columns, axis=-1)[has_jump]


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
