"""The class `Domain`, a joint distributed over MPI ranks, and functions that hide differences of DOLFINx 0.9 to 0.11.

Every rank can read the whole joint, which is stored once per machine, but has only its part of the mesh. Only `Domain`
relates the two. Its `original_cells`, `original_points` and `numbers` give the numbers in the joint of a rank's cells,
points and facets. `Domain.to_local` picks the values of a rank's cells from values of all cells.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from typing import TypeAlias

import basix.ufl
import dolfinx
import numpy as np
import numpy.typing as npt
import ufl
from mpi4py import MPI

from geometry.joint import Joint
from geometry.parallel import Comm, ResultType, default_comm, on_root
from geometry.refusals import require_known
from geometry.seam import BASE, LAYER, FacetName, S
from geometry.sheet import continued_ridge_keys
from geometry.topology import FloatArray, Indices, IntArray, Scalar, facet_nodes, geometry_degree, positions, row_keys

Partitioner = Callable[..., dolfinx.cpp.graph.AdjacencyList_int32]

Element: TypeAlias = ufl.AbstractFiniteElement | tuple[str, int] | tuple[str, int, tuple[int, ...]]
MESHES_PER_COLLECTION = 100  # number of meshes after which Python's garbage collector frees meshes in reference cycles
_MESH_COUNT = count(1)


def call_first_accepted(*calls: Callable[[], ResultType]) -> ResultType:
    """Call functions in turn until one does not raise TypeError, and return its result.

    Each function does the same task with the arguments of another release of DOLFINx. A release rejects unknown
    arguments with a TypeError before it does any work. Errors of the last function are raised.

    Args:
        calls: functions without arguments, in the order in which they are called.
    """
    for call in calls[:-1]:
        with suppress(TypeError):
            return call()
    return calls[-1]()


def create_mesh(
    comm: MPI.Intracomm, points: FloatArray, cells: IntArray, cell_type: str, partitioner: Partitioner | None = None
) -> dolfinx.mesh.Mesh:
    """Create a distributed DOLFINx mesh from the points and cells that each rank passes. Collective.

    Args:
        comm: communicator of the mesh.
        points: (n, d) coordinates in d dimensions of the n points that this rank passes, lengths. Points are numbered
            globally, those of rank 0 first.
        cells: (m, k) global numbers of the k nodes of each of the m cells that this rank passes, in DOLFINx's order.
        cell_type: type of the cells, such as "triangle".
        partitioner: function that chooses the ranks of the cells, as in DOLFINx's `create_mesh`; None: for a single
            rank only.
    """
    dim, degree = points.shape[1], geometry_degree(cell_type, cells.shape[1])
    element, x = basix.ufl.element("Lagrange", cell_type, degree, shape=(dim,)), np.ascontiguousarray(points)
    arguments = dict(comm=comm, cells=cells, x=x, partitioner=partitioner)

    def create_by_keywords() -> dolfinx.mesh.Mesh:
        """Create the mesh with all arguments named; otherwise DOLFINx first tries to convert `cells`, which is slow."""
        cmap = dolfinx.fem.coordinate_element(element.basix_element)._cpp_object
        return dolfinx.mesh.Mesh(dolfinx.cpp.mesh.create_mesh(**arguments, element=cmap), ufl.Mesh(element))

    return call_first_accepted(create_by_keywords, lambda: dolfinx.mesh.create_mesh(**arguments, e=element))


def cell_nodes(mesh: dolfinx.mesh.Mesh) -> Indices:
    """Return (n, k) local numbers of the k geometry nodes of each of this rank's n cells, ghosts included."""
    maps = getattr(mesh.geometry, "dofmaps", None)
    return np.asarray(mesh.geometry.dofmap if maps is None or callable(maps) else maps[0])


def with_cell_points(mesh: dolfinx.mesh.Mesh, x: FloatArray) -> dolfinx.mesh.Mesh:
    """Return a mesh with the topology of `mesh`, in which each cell has nodes of its own at the places `x`. Collective.

    Neighbouring cells may therefore be apart, although they still share one facet. In integrals over such a facet, a
    coordinate or normal is unique only with a side ("+" or "-"). Without a side DOLFINx computes it from one of the two
    cells.

    Args:
        mesh: the mesh.
        x: (n, k, d) coordinates in d dimensions of the k nodes of each of this rank's n cells, lengths. Ghosts are
            included, and nodes have the order of `cell_nodes`.
    """
    cell_map, k = mesh.topology.index_map(mesh.topology.dim), x.shape[1]
    ghosts = np.asarray(cell_map.ghosts, np.int64)[:, None] * k + np.arange(k)
    node_map = index_map(mesh.comm, cell_map.size_local * k, ghosts.ravel(), np.repeat(cell_map.owners, k))
    old = mesh._cpp_object.geometry
    dofmap = np.arange(x.shape[0] * k, dtype=np.int32).reshape(-1, k)
    input_indices = np.asarray(mesh.geometry.input_global_indices, np.int64)[cell_nodes(mesh)].ravel()
    element = old.cmap if callable(old.cmaps) else old.cmaps[0]
    geometry = type(old)(node_map, dofmap, element, np.ascontiguousarray(x.reshape(-1, x.shape[2])), input_indices)
    cpp_mesh = type(mesh._cpp_object)(mesh.comm, mesh._cpp_object.topology, geometry)
    return dolfinx.mesh.Mesh(cpp_mesh, ufl.Mesh(mesh.ufl_domain().ufl_coordinate_element()))


def index_map(comm: MPI.Intracomm, n: int, ghosts: IntArray, owners: Indices) -> dolfinx.cpp.common.IndexMap:
    """Return a DOLFINx IndexMap of the indices that this rank owns and of its ghosts. Collective.

    Args:
        comm: communicator of the map.
        n: number of indices that this rank owns.
        ghosts: (m,) global numbers of the m ghosts of this rank.
        owners: (m,) ranks that own the ghosts.
    """
    arguments = (comm, n, np.asarray(ghosts, np.int64), np.asarray(owners, np.int32))
    create = dolfinx.cpp.common.IndexMap
    return call_first_accepted(lambda: create(*arguments), lambda: create(*arguments, 1801))


def create_connectivity(mesh: dolfinx.mesh.Mesh, dim: int) -> None:
    """Compute and store in `mesh` which entities of dimension `dim` its local cells have, and the inverse relation."""
    mesh.topology.create_connectivity(dim, mesh.topology.dim)
    mesh.topology.create_connectivity(mesh.topology.dim, dim)


def cells_of_facets(mesh: dolfinx.mesh.Mesh, facets: Indices) -> tuple[Indices, IntArray]:
    """Return for each local facet one local cell that it belongs to, and the facet's number within this cell.

    For a facet inside the mesh, the cell is the first of the two that DOLFINx lists.

    Args:
        mesh: the mesh.
        facets: (n,) local numbers of the facets.

    Returns:
        (n,) local numbers of the cells, and (n,) numbers of the facets within them, from 0.
    """
    topology, dim = mesh.topology, mesh.topology.dim
    create_connectivity(mesh, dim - 1)
    facet_cells = topology.connectivity(dim - 1, dim)
    cells = facet_cells.array[facet_cells.offsets[facets]]
    return cells, (_facets_of_cells(mesh)[cells] == facets[:, None]).argmax(axis=1)


def _facets_of_cells(mesh: dolfinx.mesh.Mesh) -> Indices:
    """Return the array (n, m): local numbers of the m facets of each of this rank's n cells; n may be 0."""
    topology, dim = mesh.topology, mesh.topology.dim
    count = dolfinx.cpp.mesh.cell_num_entities(topology.cell_type, dim - 1)
    return np.asarray(topology.connectivity(dim, dim - 1).array.reshape(-1, count))


@dataclass(frozen=True)
class Domain:
    """A distributed mesh with the names of its regions and facet sets.

    A facet set of the joint has a name, here called NAME. If all its facets are on the outer boundary, two further
    names refer to parts of it. "NAME/REGION" is the part on the cells of the region REGION. "NAME/LAYER" is the set of
    those outer facets of the meshed layer that continue NAME from the bodies over the layer's thickness. It is empty in
    a mesh without layers. "S" is the set of all facets of seams.

    Attributes:
        joint: the joint that was distributed.
        mesh: the DOLFINx mesh; ghosts are the neighbours across facets.
        cell_tags: tag of each local cell: the number of its region, counted from 1 in the order of `joint.regions`.
        facet_tags: tags of the facets that have names. Facets in exactly the same sets have the same tag.
        set_tags: name of a facet set -> all values in `facet_tags` whose facets belong to this set.
        original_cells: (n_cells,) for each local cell, ghosts included, its row in `joint.cells`.
        comm: communicator for all messages of this package; `mesh.comm` serves only DOLFINx's own. With mpi4py 4.0,
            pickled messages on `mesh.comm` can cause a deadlock: Python's garbage collector may free the mesh during a
            later one.
    """

    joint: Joint
    mesh: dolfinx.mesh.Mesh
    cell_tags: dolfinx.mesh.MeshTags
    facet_tags: dolfinx.mesh.MeshTags
    set_tags: Mapping[str, tuple[int, ...]]
    original_cells: IntArray
    comm: MPI.Intracomm

    @classmethod
    def of(cls, joint: Joint, comm: Comm = None) -> Domain:
        """Return the joint distributed over the ranks of a communicator. Collective.

        Args:
            joint: the joint, equal on all ranks.
            comm: the communicator; None: the default one.
        """
        comm = comm or default_comm()
        if comm.size > 1 or not next(_MESH_COUNT) % MESHES_PER_COLLECTION:
            gc.collect()  # DOLFINx compiles with pickled collectives on meshes' communicators: free old meshes now
        points = rows_of_rank(joint.points, comm.rank, comm.size)
        cells = rows_of_rank(joint.cells, comm.rank, comm.size)
        mesh = create_mesh(comm, points, cells, joint.cell_type, make_partitioner(joint, comm))
        originals = np.asarray(mesh.topology.original_cell_index, np.int64)
        if joint.parted is not None:
            mesh = with_cell_points(mesh, joint.parted[originals])
        local_cells = np.arange(len(originals), dtype=np.int32)
        cell_tags = dolfinx.mesh.meshtags(mesh, joint.dim, local_cells, (joint.region[originals] + 1).astype(np.int32))
        tagged_rows, row_tags, set_tags = on_root(comm, lambda: _tag_set_combinations(joint))
        facets, row_positions = _local_facets(joint, mesh, originals, tagged_rows)
        facet_tags = dolfinx.mesh.meshtags(mesh, joint.dim - 1, facets, row_tags[row_positions])
        return cls(joint, mesh, cell_tags, facet_tags, set_tags, originals, comm)

    @property
    def original_points(self) -> IntArray:
        """(n,) row in `joint.points` of each of the n local nodes of the mesh's geometry."""
        return np.asarray(self.mesh.geometry.input_global_indices, np.int64)

    @cached_property
    def local_cells(self) -> IntArray:
        """(n,) local number of each of the joint's n cells; -1 if it is not on this rank."""
        return positions(self.original_cells, len(self.joint.cells))

    @cached_property
    def centroids(self) -> dict[str, FloatArray]:
        """Centroids (d,) of facet sets computed so far, by name: each needs compiled integrals."""
        return {}

    def numbers(self, dim: int, entities: Indices) -> IntArray:
        """Return the numbers in the joint of cells or facets that are given by their local numbers.

        Args:
            dim: dimension of the entities, `joint.dim` for cells, `joint.dim` - 1 for facets.
            entities: (n,) local numbers of the cells or facets.

        Returns:
            (n,) row numbers, of cells in `joint.cells`, of facets in `joint.table`.
        """
        joint = self.joint
        if dim == joint.dim:
            return self.original_cells[entities]
        cells, local = cells_of_facets(self.mesh, entities)
        return joint.table.index(facet_nodes(joint.corners, joint.cell_type, self.original_cells[cells], local))

    def to_local(self, cell_values: npt.NDArray[Scalar]) -> npt.NDArray[Scalar]:
        """Return the values of this rank's cells, ghosts included, from values of all cells of the joint.

        Args:
            cell_values: array whose first axis has one entry for each cell of the joint.

        Returns:
            Array whose first axis has one entry for each local cell.
        """
        return cell_values[self.original_cells]

    def cellwise_function(self, element: Element, values: FloatArray) -> dolfinx.fem.Function:
        """Return a DOLFINx function from its degrees of freedom on each cell of the undistributed joint.

        Args:
            element: element of the function's space.
            values: (n_cells, dofs per cell, components) degrees of freedom of the function.
        """
        f = dolfinx.fem.Function(dolfinx.fem.functionspace(self.mesh, element))
        dofs, n = f.function_space.dofmap.list.ravel(), values.shape[2]
        f.x.array.reshape(-1, n)[dofs] = self.to_local(values).reshape(-1, n)
        return f

    def region_tags(self, *regions: str) -> tuple[int, ...]:
        """Return the tags in `cell_tags` of the named `regions`, in the same order.

        Raises:
            InputError: unknown name.
        """
        for name in regions:
            require_known("region", name, self.joint.regions)
        return tuple(self.joint.regions.index(name) + 1 for name in regions)

    def values(self, name: str, *, layer_sides: bool = False) -> tuple[int, ...]:
        """Return all values that `facet_tags` has on the facets of a facet set.

        Args:
            name: name of a facet set NAME, or "NAME/REGION" or "NAME/LAYER" for the parts that `Domain` describes.
            layer_sides: whether to add the values of "NAME/LAYER", the outer facets of the meshed layer that continue
                the set.

        Raises:
            InputError: unknown name.
        """
        require_known("facet set", name, self.set_tags)
        values = self.set_tags[name]
        return values + self.set_tags.get(str(FacetName(name, LAYER)), ()) if layer_sides else values

    def is_outer(self, name: str) -> bool:
        """Return whether all facets of the set `name` are on the outer boundary.

        For "NAME/REGION" and "NAME/LAYER" the result is that of the whole set NAME. It is True for names that the joint
        does not have.
        """
        joint = self.joint
        matches = [candidate for candidate in (name, FacetName.parse(name).set_name) if candidate in joint.facets]
        return not matches or bool((joint.table.cells[joint.table.index(joint.facets[matches[0]]), 1] < 0).all())

    def facets(self, name: str, *, layer_sides: bool = False) -> Indices:
        """Return the ascending local numbers of the facets in a facet set, ghosts included.

        Args:
            name: name of a facet set NAME, or "NAME/REGION" or "NAME/LAYER" for the parts that `Domain` describes.
            layer_sides: whether to add the facets of "NAME/LAYER", the outer facets of the meshed layer that continue
                the set.

        Raises:
            InputError: unknown name.
        """
        return self.facet_tags.indices[np.isin(self.facet_tags.values, self.values(name, layer_sides=layer_sides))]

    def sides(self, seam: str) -> tuple[Indices, IntArray]:
        """Return the cells on both sides of those n facets of a seam that this rank owns.

        The facets are in the order of their local numbers.

        Returns:
            Rows (n, 4) of local numbers: upper cell, number of the facet in this cell, lower cell, number of the facet
            in this cell; on a rigid base (n, 2), without the lower cell. And (n,) row numbers of the facets in
            `joint.table`.
        """
        joint, facets = self.joint, self.facets(seam)
        rows = self.numbers(joint.dim - 1, facets[facets < self.mesh.topology.index_map(joint.dim - 1).size_local])
        cells = joint.surface_cells[np.searchsorted(joint.surface_rows, rows)].T
        cells = cells[1:] if seam in joint.base_seams else cells[::-1]
        columns = [
            side for of_side in cells for side in (self.local_cells[of_side], joint.table.local_in(rows, of_side))
        ]
        return np.column_stack(columns).astype(np.int32), rows

    def vertices(self, drawn_vertex: int) -> Indices:
        """Return the numbers of this rank's vertices that come from one vertex of the joint as drawn.

        Where S is opened, several vertices come from a vertex on S: a copy on each body, and between them those of the
        meshed layer. Vertices that a periodic cell identifies with any of these are included.

        Args:
            drawn_vertex: number in `joint.points` of one of these vertices.
        """
        joint, topology = self.joint, self.mesh.topology
        is_copy = np.all(joint.reference == joint.reference[drawn_vertex], axis=1)
        copies = np.flatnonzero(np.isin(joint.masters, joint.masters[is_copy]))
        topology.create_connectivity(0, joint.dim)
        local_vertices = np.arange(topology.index_map(0).size_local + topology.index_map(0).num_ghosts, dtype=np.int32)
        nodes = dolfinx.mesh.entities_to_geometry(self.mesh, 0, local_vertices).ravel()
        return local_vertices[np.isin(self.original_points[nodes], copies)]


def _local_facets(
    joint: Joint, mesh: dolfinx.mesh.Mesh, originals: IntArray, rows: IntArray
) -> tuple[Indices, IntArray]:
    """Return which of the given facets of the joint this rank has, ghosts included, and their local numbers.

    The vertices and facets of a cell have the same order in the mesh and in the joint.

    Args:
        joint: the joint.
        mesh: the distributed mesh of the joint.
        originals: number in the joint of each local cell.
        rows: row numbers in `joint.table` of the given facets.

    Returns:
        (n,) local numbers of the n facets that this rank has, in ascending order. And, in the same order, (n,) the
        position of each of them in `rows`.
    """
    create_connectivity(mesh, joint.dim - 1)
    cells, local = positions(originals, len(joint.cells))[joint.table.cells[rows]], joint.table.local[rows]
    is_local = (cells >= 0) & (local >= 0)
    local_positions = np.flatnonzero(is_local.any(axis=1))
    cell_position = is_local[local_positions].argmax(axis=1)
    facets = _facets_of_cells(mesh)[cells[local_positions, cell_position], local[local_positions, cell_position]]
    order = np.argsort(facets)
    return facets[order], local_positions[order]


def _named_sets(joint: Joint) -> Iterator[tuple[str, IntArray]]:
    """Yield the name of each facet set of the joint and the row numbers of its facets in `joint.table`.

    The sets "NAME/REGION", "NAME/LAYER" and "S", which `Domain` describes, are included.
    """
    seams = () if joint.band else joint.seams
    if seams and S not in seams:
        yield S, joint.surface_rows
    for name, facets in joint.facets.items():
        rows = joint.table.index(facets)
        yield name, rows
        if FacetName.parse(name).part_name or name in (*seams, BASE) or (joint.table.cells[rows, 1] >= 0).any():
            continue
        cells = joint.table.cells[rows, 0]
        for region_no, region in enumerate(joint.regions):
            if not joint.band or region not in joint.band.regions:
                yield str(FacetName(name, region)), rows[joint.region[cells] == region_no]
        if joint.band is None and len(continued_ridge_keys(joint, facets)):
            yield str(FacetName(name, LAYER)), rows[:0]


def _tag_set_combinations(joint: Joint) -> tuple[IntArray, Indices, dict[str, tuple[int, ...]]]:
    """Return one integer tag for each facet of the joint, which stands for all facet sets that contain the facet.

    Returns:
        (n,) row numbers in `joint.table` of the n facets that are in any set; (n,) their tags, from 1, equal for facets
        in the same sets; and name of a set -> tags of its facets.
    """
    rows_by_name = dict(_named_sets(joint))
    tagged_rows = np.unique(np.concatenate([*rows_by_name.values()]))
    is_in_set = {name: np.isin(tagged_rows, rows) for name, rows in rows_by_name.items()}
    tags = 1 + np.unique(row_keys(np.stack([*is_in_set.values()], axis=1)), return_inverse=True)[1].astype(np.int32)
    return tagged_rows, tags, {name: tuple(map(int, np.unique(tags[rows]))) for name, rows in is_in_set.items()}


# ---------------------------------------------------------------- distribution over ranks
def bisect(x: FloatArray, n_groups: int) -> Indices:
    """Divide places into groups of nearly equal size by repeated cuts across their longest extent.

    Args:
        x: (n, d) coordinates of n places in d dimensions, in any unit.
        n_groups: number of groups, which are numbered from 0.

    Returns:
        (n,) number of the group of each place.
    """
    group_numbers, low = np.zeros(len(x), np.int32), n_groups // 2
    if low and len(x):
        order = np.argsort(x[:, np.ptp(x, axis=0).argmax()], kind="stable")
        first, second = np.split(order, [len(x) * low // n_groups])
        group_numbers[first] = bisect(x[first], low)
        group_numbers[second] = low + bisect(x[second], n_groups - low)
    return group_numbers


def column_numbers(joint: Joint) -> tuple[IntArray, FloatArray]:
    """Return the number of the column that contains each cell of the layers, and the centres of all columns.

    A column is the set of cells above each other through a layer's thickness, over one facet of S. Cells of a junction
    over the same part of S also form a column. In a joint without meshed layers, each facet of S is a column.

    Returns:
        (n_cells,) number of the column of each cell, -1 in bodies; without meshed layers, (n_facets,) number of the
        column of each facet in `Joint.table`, -1 outside S. And (n_columns, d) centres of the columns on S in the joint
        as drawn, lengths.
    """
    if joint.band is None:
        rows = joint.surface_rows
        return positions(rows, len(joint.table.vertices)), joint.points[joint.table.vertices[rows]].mean(axis=1)
    layer_cells = np.flatnonzero(np.isin(joint.region, [joint.regions.index(name) for name in joint.band.regions]))
    points, point = np.unique(joint.reference, axis=0, return_inverse=True)
    s_vertices = np.sort(point.ravel()[joint.corners[layer_cells]], axis=1)  # the facet's vertices, some of them twice
    s_vertices[:, 1:][s_vertices[:, 1:] == s_vertices[:, :-1]] = -1
    facets, column = np.unique(np.sort(s_vertices, axis=1), axis=0, return_inverse=True)
    cell_columns = np.full(len(joint.cells), -1, np.int64)
    cell_columns[layer_cells] = column.ravel()
    is_vertex = (facets >= 0)[:, :, None]
    return cell_columns, (points[facets] * is_vertex).sum(axis=1) / is_vertex.sum(axis=1)


def destination_ranks(joint: Joint, n_ranks: int) -> tuple[IntArray, Indices]:
    """Return the ranks that get each of the n cells of a joint: its owner, and the ranks that have it as a ghost.

    Args:
        joint: the joint.
        n_ranks: number of ranks.

    Returns:
        (n + 1,) position in the second array where the ranks of each cell begin; and these ranks for all cells, for
        each cell the owner first.
    """
    owner = bisect(sum(joint.points[corner] for corner in joint.corners.T), n_ranks)  # faster than means of short rows
    if joint.band is not None:  # columns of cells of layers stay whole, as laws may need their means
        cells = np.flatnonzero((column := column_numbers(joint)[0]) >= 0)
        owner[cells] = owner[cells[np.unique(column[cells], return_index=True)[1]]][column[cells]]
    first, second = joint.table.cells.T
    split_neighbours = joint.table.cells[(owner[first] != owner[second]) & (second >= 0)]
    ghosts = np.unique(np.column_stack([split_neighbours.ravel(), owner[split_neighbours[:, ::-1]].ravel()]), axis=0)
    n_copies = 1 + np.bincount(ghosts[:, 0], minlength=len(owner))
    return np.append(0, n_copies.cumsum()), np.insert(owner, ghosts[:, 0] + 1, ghosts[:, 1])


def rows_of_rank(rows: npt.NDArray[Scalar], rank: int, n_ranks: int) -> npt.NDArray[Scalar]:
    """Return the consecutive rows of an array that one of several ranks passes to DOLFINx.

    Args:
        rows: array with one row for each point, or for each cell.
        rank: number of the rank.
        n_ranks: number of ranks; each gets nearly the same number of rows.
    """
    return rows[len(rows) * rank // n_ranks : len(rows) * (rank + 1) // n_ranks]


def make_partitioner(joint: Joint, comm: MPI.Intracomm) -> Partitioner | None:
    """Return the function by which DOLFINx's `create_mesh` distributes a joint's cells; None for one rank. Collective.

    DOLFINx sends each cell to its owner, and as a ghost to the owners of its neighbours across facets.

    Args:
        joint: the joint, of which each rank gives DOLFINx the cells in `rows_of_rank`.
        comm: communicator of the mesh.
    """
    if comm.size == 1:
        return None
    starts, ranks = on_root(comm, lambda: destination_ranks(joint, comm.size))
    own_cells = rows_of_rank(np.arange(len(joint.cells)), comm.rank, comm.size)
    indptr = starts[own_cells[0] : own_cells[-1] + 2] if len(own_cells) else starts[:1]
    graph = dolfinx.cpp.graph.AdjacencyList_int32(ranks[indptr[0] : indptr[-1]], (indptr - indptr[0]).astype(np.int32))
    return lambda *_: graph
