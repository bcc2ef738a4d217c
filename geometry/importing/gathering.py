"""Joints from DOLFINx meshes with tags, gathered from all MPI ranks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from operator import index
from typing import NamedTuple

import dolfinx
import numpy as np
from mpi4py import MPI

from forms.base import InputError, require
from geometry.domain import cell_nodes, cells_of_facets
from geometry.importing.elements import joined
from geometry.importing.naming import FileCells, GroupMasks, NamedGroups, SeamSides
from geometry.joint import Joint
from geometry.parallel import Comm, default_comm, on_root
from geometry.topology import CELL_TYPES, FloatArray, Indices, IntArray, corner_count, facet_nodes, geometry_degree

BODY = "BODY"  # region of all cells if there are no cell tags
UNTAGGED = np.iinfo(np.int64).min  # in place of the tag of a cell that has none although others have
TagNames = Mapping[str, Sequence[int]]  # name -> dimension of the tagged entities, then their tags
Tags = dict[str, list[int]]  # name -> tags


def gather_joint(mesh: object, names: TagNames | None, scale: float, comm: Comm, sides: SeamSides) -> Joint:
    """Return the joint of a distributed DOLFINx mesh with tags, on every rank. Collective.

    Args:
        mesh: the mesh; or (mesh, cell tags, facet tags) with None for missing tags.
        names: name of a group -> (dimension of its entities, tag, ...) with one or several tags; None: each tag is a
            group, named by the tag as text.
        scale: factor on the coordinates.
        comm: communicator of the mesh; None: the default one.
        sides: choice of the facets of S and of the upper side of each seam.
    """
    comm = comm or default_comm()
    mesh, cell_tags, facet_tags = (*(mesh if isinstance(mesh, (tuple, list)) else [mesh]), None, None)[:3]
    own_mesh: _OwnMesh | Exception
    try:
        own_mesh = _OwnMesh.of(mesh, cell_tags, facet_tags, comm)
    except Exception as error:
        own_mesh = error  # the other ranks must not wait
    parts = comm.gather(own_mesh) or []
    return on_root(comm, partial(_assemble, parts, names, None if cell_tags is not None else {BODY: [0]}, scale, sides))


class _OwnMesh(NamedTuple):
    """The cells, nodes and tags of a distributed mesh that one rank has. Nodes are numbered globally.

    Attributes:
        type: type of the cells, such as "triangle".
        points: (n, 2 or 3) coordinates of the nodes that the rank owns.
        nodes: (n_cells, k) numbers of the k nodes of each cell that the rank owns.
        region_tags: (n_cells,) tag of each of these cells, or `UNTAGGED`. Without cell tags all have the tag 0.
        facets: (n_facets, m) numbers of the m vertices of each tagged facet on this rank, ghosts included.
        tags_of_facets: (n_facets,) tags of these facets.
    """

    type: str
    points: FloatArray
    nodes: IntArray
    region_tags: IntArray
    facets: IntArray
    tags_of_facets: IntArray

    @classmethod
    def of(cls, mesh: dolfinx.mesh.Mesh, cell_tags: object, facet_tags: object, comm: MPI.Intracomm) -> _OwnMesh:
        """Return the cells, nodes and tags that this rank has; raise InputError if mesh or tags cannot form a joint.

        Args:
            mesh: the mesh.
            cell_tags, facet_tags: DOLFINx's MeshTags of cells and of facets; None: no tags.
            comm: communicator with the ranks of the mesh.
        """
        require(isinstance(mesh, dolfinx.mesh.Mesh), "mesh", mesh, "give the name of a file, or a dolfinx.mesh.Mesh")
        if MPI.Comm.Compare(comm, mesh.comm) not in (MPI.IDENT, MPI.CONGRUENT):
            message = f"the mesh is distributed on {mesh.comm.size} ranks, comm has {comm.size}"
            raise InputError(f"{message}; give comm the communicator that the mesh was made with")
        topology, geometry = mesh.topology, mesh.geometry
        type_names = [dolfinx.mesh.to_string(cell_type) for cell_type in topology.entity_types[-1]]
        cell_type, dim, cells = type_names[0], topology.dim, cell_nodes(mesh)
        if len(type_names) > 1 or cell_type not in CELL_TYPES:
            raise InputError(f"cells are of type {', '.join(type_names)}; allowed: one of {', '.join(CELL_TYPES)}")
        geometry_degree(cell_type, cells.shape[1])
        n_owned = topology.index_map(dim).size_local
        region_tags = np.full(len(cells), 0 if cell_tags is None else UNTAGGED)
        tagged_cells, cell_values = _tags(mesh, cell_tags, dim, "cell_tags")
        region_tags[tagged_cells] = cell_values
        facets, tags = _tags(mesh, facet_tags, dim - 1, "facet_tags")
        global_nodes = np.reshape(geometry.index_map().local_to_global(cells.ravel()), cells.shape)
        points = np.asarray(geometry.x[: geometry.index_map().size_local, : geometry.dim], float)
        corners = global_nodes[:, : corner_count(cell_type)]
        vertices = facet_nodes(corners, cell_type, *cells_of_facets(mesh, facets))
        return cls(cell_type, points, global_nodes[:n_owned], region_tags[:n_owned], vertices, tags)


def _tags(mesh: dolfinx.mesh.Mesh, tags: dolfinx.mesh.MeshTags | None, dim: int, what: str) -> tuple[Indices, IntArray]:
    """Return the local numbers (n,) of the entities that have a tag, and (n,) their tags; both empty without `tags`.

    Args:
        mesh: the mesh.
        tags: DOLFINx's MeshTags; None: no entity has a tag.
        dim: dimension that the tagged entities must have.
        what: name of the argument, for messages.

    Raises:
        InputError: the tags are of another type, dimension or mesh.
    """
    if tags is None:
        return np.empty(0, np.int32), np.empty(0, np.int64)
    require(isinstance(tags, dolfinx.mesh.MeshTags), what, tags, "give dolfinx.mesh.MeshTags")
    if tags.dim != dim:
        raise InputError(f"{what} are of entities of dimension {tags.dim}; those of this mesh have dimension {dim}")
    if tags.topology is not mesh.topology and tags.topology is not mesh.topology._cpp_object:
        raise InputError(f"{what} are of another mesh")
    if tags.values.dtype.kind not in "iu":
        raise InputError(f"{what} have values of type {tags.values.dtype}; they must be integers")
    return np.asarray(tags.indices), np.asarray(tags.values, np.int64)


def _assemble(
    parts: list[_OwnMesh | Exception], names: TagNames | None, default_tags: Tags | None, scale: float, sides: SeamSides
) -> Joint:
    """Assemble the parts of a mesh from all ranks to a joint.

    Nodes of the joint are sorted by their coordinates, and cells by the numbers of their nodes.

    Args:
        parts: the part of each rank, or the error that was raised there, which is raised again.
        names: name of a group -> (dimension of its entities, tag, ...) with one or several tags; None: no names.
        default_tags: name of a region -> cell tags, used if `names` has no groups of cells; None: each cell tag is a
            region, named by the tag as text.
        scale: factor on the coordinates.
        sides: choice of the facets of S and of the upper side of each seam.
    """
    for part in parts:
        if isinstance(part, Exception):
            raise part
    (cell_type, *_), *arrays = zip(*parts, strict=True)
    points, nodes, region, rows, tags = map(np.concatenate, arrays)
    if not len(nodes):
        raise InputError("the mesh has no cells")
    node_order = np.lexsort(points.T[::-1])
    new_numbers = np.argsort(node_order)
    new_numbers = joined(points[node_order], new_numbers[nodes], sides.join)[new_numbers]
    nodes, rows = new_numbers[nodes], np.sort(new_numbers[rows], axis=1)
    cell_order = np.lexsort(np.sort(nodes[:, : corner_count(cell_type)], axis=1).T[::-1])
    cells = FileCells.of(scale * points[node_order], nodes[cell_order], cell_type)
    dim, tags_by_dim = cells.points.shape[1], _tags_by_dimension(names or {})
    region_masks = _group_masks(tags_by_dim.get(dim, default_tags), region[cell_order], "cell")
    if not region_masks:
        raise InputError("no cell has a tag")
    masks = _group_masks(tags_by_dim.get(dim - 1), tags, "facet")
    facets = {name: np.unique(np.searchsorted(cells.point_numbers, rows[mask]), axis=0) for name, mask in masks.items()}
    return NamedGroups(cells, region_masks, facets, "tags", sides).make_joint()


def _tags_by_dimension(names: TagNames) -> dict[int, Tags]:
    """Return `names` sorted by dimension, as dimension -> {name: tags}.

    Args:
        names: name -> (dimension of the tagged entities, tag, ...).

    Raises:
        InputError: `names` has another form.
    """
    tags_by_dim: dict[int, Tags] = {}
    try:
        for name, (dim, first, *more_tags) in names.items():
            if not isinstance(name, str):
                raise TypeError
            tags_by_dim.setdefault(index(dim), {})[name] = [*map(index, (first, *more_tags))]
    except (AttributeError, TypeError, ValueError):
        raise InputError(f"names is {names!r}; give {{name: (dimension, number of its tags)}}") from None
    return tags_by_dim


def _group_masks(names: Tags | None, values: IntArray, entity: str) -> GroupMasks:
    """Return the groups of entities as name -> (n,) whether each of the n entities is in the group.

    Args:
        names: name of a group -> tags of its entities; None: each tag is a group, named by the tag as text.
        values: (n,) tags of the entities, `UNTAGGED` for those without a tag.
        entity: noun for the entities, for messages.

    Raises:
        InputError: no entity has a tag in `names`.
    """
    tags = [*map(int, np.unique(values[values != UNTAGGED]))]
    names = {str(tag): [tag] for tag in tags} if names is None else names
    for name, tag in ((name, tag) for name, of in names.items() for tag in of if tag not in tags):
        tags_text = ", ".join(map(str, tags)) or "none"
        raise InputError(f"names: no {entity} has the tag {tag}, named {name!r}; tags: {tags_text}")
    return {name: np.isin(values, of) for name, of in names.items()}
