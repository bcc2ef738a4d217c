"""Meshes of DOLFINx, for all releases from 0.9 to 0.11, and Domain: a joint distributed over ranks, with its names.

Every rank can read the whole joint, which is stored once per machine, but has only a part of the mesh. Only `Domain`
relates the two: `original_cells`, `original_points`, `numbers` and `on_cells` transfer data of the joint to the cells,
points and facets of a rank.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import count

import basix.ufl
import dolfinx
import numpy as np
import numpy.typing as npt
import ufl
from mpi4py import MPI

from geometry.joint import Joint
from geometry.parallel import Comm, ResultType, default_comm, on_root
from geometry.partition import Partitioner, partitioner, rows_of_rank
from geometry.refusals import require_known
from geometry.seam import BASE, LAYER, FacetName, S
from geometry.sheet import continued_ridges
from geometry.topology import FloatArray, Indices, IntArray, Scalar, geometry_degree, local_facets, positions

MESHES_PER_COLLECTION = 100  # number of meshes after which Python's garbage collector frees meshes in reference cycles
_MESH_COUNT = count(1)
NAMES_PER_CODE = 30  # number of names after which combinations are renumbered, so that codes fit into int64


def first_accepted(*calls: Callable[[], ResultType]) -> ResultType:
    """Result of the first call whose signature exists (a wrong signature raises TypeError before any work is done)."""
    for call in calls[:-1]:
        with suppress(TypeError):
            return call()
    return calls[-1]()


def create_mesh(
    comm: MPI.Intracomm, points: FloatArray, cells: IntArray, cell_type: str, partitioner: Partitioner | None = None
) -> dolfinx.mesh.Mesh:
    """Create a mesh from points and cells; each rank passes some. Several ranks need a partitioner. Collective."""
    dim, degree = points.shape[1], geometry_degree(cell_type, cells.shape[1])
    element, x = basix.ufl.element("Lagrange", cell_type, degree, shape=(dim,)), np.ascontiguousarray(points)
    arguments = dict(comm=comm, cells=cells, x=x, partitioner=partitioner)

    def by_names() -> dolfinx.mesh.Mesh:
        """Pass arguments by name: without names the bindings first try to convert each cell to an array, slowly."""
        map_of_cells = dolfinx.fem.coordinate_element(element.basix_element)._cpp_object
        return dolfinx.mesh.Mesh(dolfinx.cpp.mesh.create_mesh(**arguments, element=map_of_cells), ufl.Mesh(element))

    return first_accepted(by_names, lambda: dolfinx.mesh.create_mesh(**arguments, e=element))


def cell_nodes(mesh: dolfinx.mesh.Mesh) -> Indices:
    """Geometry nodes (cells, nodes) of each cell of this rank."""
    maps = getattr(mesh.geometry, "dofmaps", None)
    return np.asarray(mesh.geometry.dofmap if maps is None or callable(maps) else maps[0])


def with_cell_points(mesh: dolfinx.mesh.Mesh, x: FloatArray) -> dolfinx.mesh.Mesh:
    """The same mesh topology with new places (cells, k, d) for the nodes of each cell. Collective.

    Each cell has its own nodes, so that neighbours may be apart. They still share one facet, which has a place on
    either side. Without a side ("+", "-") DOLFINx computes the geometry of this facet from one of the two cells.

    Args:
        mesh: the mesh.
        x: (cells, k, d) places of the nodes of this rank's cells, ghosts included, in the order of `cell_nodes`.
    """
    cells, k = mesh.topology.index_map(mesh.topology.dim), x.shape[1]
    ghosts = np.asarray(cells.ghosts, np.int64)[:, None] * k + np.arange(k)
    nodes = index_map(mesh.comm, cells.size_local * k, ghosts.ravel(), np.repeat(cells.owners, k))
    old = mesh._cpp_object.geometry
    of_cells = np.arange(x.shape[0] * k, dtype=np.int32).reshape(-1, k)
    from_file = np.asarray(mesh.geometry.input_global_indices, np.int64)[cell_nodes(mesh)].ravel()
    element = old.cmap if callable(old.cmaps) else old.cmaps[0]
    geometry = type(old)(nodes, of_cells, element, np.ascontiguousarray(x.reshape(-1, x.shape[2])), from_file)
    moved = type(mesh._cpp_object)(mesh.comm, mesh._cpp_object.topology, geometry)
    return dolfinx.mesh.Mesh(moved, ufl.Mesh(mesh.ufl_domain().ufl_coordinate_element()))


def index_map(comm: MPI.Intracomm, n: int, ghosts: IntArray, owners: Indices) -> dolfinx.cpp.common.IndexMap:
    """Index map of n owned indices, and of ghosts with their global numbers and owners. Collective."""
    arguments = (comm, n, np.asarray(ghosts, np.int64), np.asarray(owners, np.int32))
    create = dolfinx.cpp.common.IndexMap
    return first_accepted(lambda: create(*arguments), lambda: create(*arguments, 1801))


def create_connectivity(mesh: dolfinx.mesh.Mesh, dim: int) -> None:
    """Compute the connectivity from local cells to their entities of a dimension, and back."""
    mesh.topology.create_connectivity(dim, mesh.topology.dim)
    mesh.topology.create_connectivity(mesh.topology.dim, dim)


def cells_of_facets(mesh: dolfinx.mesh.Mesh, facets: Indices) -> tuple[Indices, IntArray]:
    """A local cell of each local facet (inside the mesh one of its two cells), and the facet's number in this cell."""
    topology, dim = mesh.topology, mesh.topology.dim
    create_connectivity(mesh, dim - 1)
    to_cells = topology.connectivity(dim - 1, dim)
    cells = to_cells.array[to_cells.offsets[facets]]
    return cells, (_facets_of_cells(mesh)[cells] == facets[:, None]).argmax(axis=1)


def _facets_of_cells(mesh: dolfinx.mesh.Mesh) -> Indices:
    """(cells, facets of a cell) local facets of each local cell; a rank may have no cells."""
    topology, dim = mesh.topology, mesh.topology.dim
    count = dolfinx.cpp.mesh.cell_num_entities(topology.cell_type, dim - 1)
    return np.asarray(topology.connectivity(dim, dim - 1).array.reshape(-1, count))


def vertices_of_facets(mesh: dolfinx.mesh.Mesh, cell_type: str, facets: Indices, corners: IntArray) -> IntArray:
    """(n, k) vertices of local facets, numbered as in `corners`.

    Args:
        mesh: the mesh.
        cell_type: type of its cells.
        facets: (n,) local facets.
        corners: (n_cells, m) vertices of the local cells.
    """
    cells, which = cells_of_facets(mesh, facets)
    return np.take_along_axis(corners[cells], local_facets(cell_type)[which], axis=1)


@dataclass(frozen=True)
class Domain:
    """A distributed mesh and the names of its parts.

    For a named set NAME of outer facets, "NAME/REGION" is its part on one region. "NAME/LAYER" are the side faces of
    the layer that continue it (no facets while S is a surface). "S" is all seams together.

    Attributes:
        joint: the joint that was distributed.
        mesh: the DOLFINx mesh (ghosts across shared facets).
        cell_tags: region numbers, counted from 1 in the order of `joint.regions`.
        facet_tags: one value per combination of names.
        facet_values: name -> its values in `facet_tags`.
        original_cells: for each local cell (ghosts included) its number in `joint.cells`.
        comm: communicator for all communication of these packages, other than the mesh's. If Python's garbage collector
            frees a mesh during a pickled collective, mpi4py 4.0 deadlocks if the mesh's communicator was ever used for
            a pickled collective.
    """

    joint: Joint
    mesh: dolfinx.mesh.Mesh
    cell_tags: dolfinx.mesh.MeshTags
    facet_tags: dolfinx.mesh.MeshTags
    facet_values: Mapping[str, tuple[int, ...]]
    original_cells: IntArray
    comm: MPI.Intracomm

    @classmethod
    def of(cls, joint: Joint, comm: Comm = None) -> Domain:
        """Distribute a joint. Collective."""
        comm = comm or default_comm()
        if comm.size > 1 or not next(_MESH_COUNT) % MESHES_PER_COLLECTION:
            gc.collect()  # DOLFINx compiles with pickled collectives on meshes' communicators: free old meshes now
        points = rows_of_rank(joint.points, comm.rank, comm.size)
        cells = rows_of_rank(joint.cells, comm.rank, comm.size)
        mesh = create_mesh(comm, points, cells, joint.cell_type, partitioner(joint, comm))
        original = np.asarray(mesh.topology.original_cell_index, np.int64)
        if joint.parted is not None:
            mesh = with_cell_points(mesh, joint.parted[original])
        numbers = np.arange(len(original), dtype=np.int32)
        cell_tags = dolfinx.mesh.meshtags(mesh, joint.dim, numbers, (joint.region[original] + 1).astype(np.int32))
        rows, combination, values = on_root(comm, lambda: _name_combinations(joint))
        facets, which = _local_facets(joint, mesh, original, rows)
        facet_tags = dolfinx.mesh.meshtags(mesh, joint.dim - 1, facets, combination[which])
        return cls(joint, mesh, cell_tags, facet_tags, values, original, comm)

    @property
    def original_points(self) -> IntArray:
        """(n,) number in `joint.points` of each local node of the mesh's geometry."""
        return np.asarray(self.mesh.geometry.input_global_indices, np.int64)

    def numbers(self, dim: int, entities: Indices) -> IntArray:
        """(n,) numbers in the joint of local cells (dim = joint.dim), else rows of `joint.table` of local facets."""
        joint = self.joint
        if dim == joint.dim:
            return self.original_cells[entities]
        return joint.table.index(vertices_of_facets(self.mesh, joint.cell_type, entities, self.on_cells(joint.corners)))

    def on_cells(self, values: npt.NDArray[Scalar]) -> npt.NDArray[Scalar]:
        """Values of the joint's cells, (n_cells, ...), at the local cells (ghosts included)."""
        return values[self.original_cells]

    def cell_values(self, *regions: str) -> tuple[int, ...]:
        """Values of `cell_tags` of regions."""
        for name in regions:
            require_known("region", name, self.joint.regions)
        return tuple(self.joint.regions.index(name) + 1 for name in regions)

    def values(self, name: str, *, layer_sides: bool = False) -> tuple[int, ...]:
        """Values of `facet_tags` for a name.

        Args:
            name: NAME, "NAME/REGION" or "NAME/LAYER".
            layer_sides: whether NAME includes the side faces of the layer that continue it.

        Raises:
            InputError: unknown name.
        """
        require_known("facet set", name, self.facet_values)
        values = self.facet_values[name]
        return values + self.facet_values.get(str(FacetName(name, LAYER)), ()) if layer_sides else values

    def is_outer(self, name: str) -> bool:
        """Whether all facets of a name lie on the outer boundary."""
        joint = self.joint
        matches = [candidate for candidate in (name, FacetName.parse(name).whole) if candidate in joint.facets]
        return not matches or bool((joint.table.cells[joint.table.index(joint.facets[matches[0]]), 1] < 0).all())

    def facets(self, name: str, *, layer_sides: bool = False) -> Indices:
        """Local facets (ghosts included) of a name; arguments and errors as in `values`."""
        return self.facet_tags.indices[np.isin(self.facet_tags.values, self.values(name, layer_sides=layer_sides))]

    def vertices(self, original: int) -> Indices:
        """Local vertices made from a vertex of the joint before inflating: one, or all copies of a vertex on S.

        Vertices that periodic sides identify with it are included.
        """
        joint, topology = self.joint, self.mesh.topology
        copies = np.flatnonzero(np.all(joint.reference == joint.reference[original], axis=1))
        if joint.periods:
            copies = np.flatnonzero(np.isin(joint.masters, joint.masters[copies]))
        topology.create_connectivity(0, joint.dim)
        local = np.arange(topology.index_map(0).size_local + topology.index_map(0).num_ghosts, dtype=np.int32)
        nodes = dolfinx.mesh.entities_to_geometry(self.mesh, 0, local).ravel()
        return local[np.isin(self.original_points[nodes], copies)]


def _local_facets(
    joint: Joint, mesh: dolfinx.mesh.Mesh, original: IntArray, rows: IntArray
) -> tuple[Indices, IntArray]:
    """Local facets (ghosts included), ascending, of some rows of joint.table, and the position of each in `rows`.

    A cell of the mesh has its vertices, and so its facets, in the order of the joint's cell.
    """
    create_connectivity(mesh, joint.dim - 1)
    cells, which = positions(original, len(joint.cells))[joint.table.cells[rows]], joint.table.local[rows]
    here = (cells >= 0) & (which >= 0)
    kept = np.flatnonzero(here.any(axis=1))
    side = here[kept].argmax(axis=1)
    facets = _facets_of_cells(mesh)[cells[kept, side], which[kept, side]]
    order = np.argsort(facets)
    return facets[order], kept[order]


def _named_sets(joint: Joint) -> Iterator[tuple[str, IntArray]]:
    """(name, rows of joint.table) of the facet sets, of their parts by region and of their parts on the layer."""
    seams = () if joint.band else joint.seams
    on_s = np.unique(joint.table.vertices[joint.surface_rows]) if seams else np.empty(0, np.int64)
    if seams and S not in seams:
        yield S, joint.surface_rows
    for name, facets in joint.facets.items():
        rows = joint.table.index(facets)
        yield name, rows
        if FacetName.parse(name).region or name in (*seams, BASE) or (joint.table.cells[rows, 1] >= 0).any():
            continue
        cells = joint.table.cells[rows, 0]
        for number, region in enumerate(joint.regions):
            if not joint.band or region not in joint.band.regions:
                yield str(FacetName(name, region)), rows[joint.region[cells] == number]
        if joint.band is None and np.isin(facets, on_s).any() and len(continued_ridges(joint, facets)):
            yield str(FacetName(name, LAYER)), rows[:0]


def _name_combinations(joint: Joint) -> tuple[IntArray, Indices, dict[str, tuple[int, ...]]]:
    """Rows of joint.table of named facets; number of the combination of names of each; name -> combinations."""
    sets = dict(_named_sets(joint))
    tagged = np.unique(np.concatenate([*sets.values()]))
    places = {name: np.searchsorted(tagged, rows) for name, rows in sets.items()}
    combination: IntArray = np.zeros(len(tagged), np.int64)
    for k, place in enumerate(places.values(), 1):
        combination *= 2
        combination[place] += 1
        if k % NAMES_PER_CODE == 0 or k == len(sets):
            combination = np.unique(combination, return_inverse=True)[1]
    values = {name: tuple(map(int, np.unique(combination[place]) + 1)) for name, place in places.items()}
    return tagged, (combination + 1).astype(np.int32), values
