"""Spaces with jumps or periodicity, and functions on a model's mesh from cells of the joint or from other meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import basix.ufl
import numpy as np
import ufl
from dolfinx import fem, geometry
from dolfinx.mesh import Mesh
from mpi4py import MPI

from forms.base import Array, InputError
from forms.law import BulkLaw
from forms.tensors import Expr
from forms.work import Interface
from geometry.domain import Domain, index_map
from geometry.inflating.inflation import offset_to_middle
from geometry.joint import InflatedBand, Joint, Profile
from geometry.refusals import place_text
from geometry.seam import S
from geometry.topology import Indices, IntArray, Splitting
from thinlayer.system.compat import interpolation_points, space_with_dofmap
from thinlayer.system.ranks import communicator, query

Element: TypeAlias = ufl.AbstractFiniteElement | tuple[str, int] | tuple[str, int, tuple[int, ...]]
EntityKeys = Sequence[IntArray | Indices]
INWARD_SHIFT = 1e-6  # shift of a place towards the middle of its cell, to one side of S, over its distance from there


def cellwise_function(domain: Domain, element: Element, values: Array) -> fem.Function:
    """Return a DOLFINx function from its degrees of freedom on each cell of the undistributed joint.

    Args:
        domain: the distributed mesh.
        element: element of the function's space.
        values: (n_cells, dofs per cell, components) degrees of freedom of the function.
    """
    f = fem.Function(fem.functionspace(domain.mesh, element))
    dofs = f.function_space.dofmap.list
    f.x.array.reshape(-1, values.shape[2])[dofs.ravel()] = domain.to_local(values).reshape(-1, values.shape[2])
    return f


def law_with_constants(law: BulkLaw, mesh: Mesh) -> BulkLaw:
    """Return a law whose parameters are DOLFINx Constants, so that forms are compiled once for all their values.

    A compiled law is returned unchanged. So is a law with parameters that are functions, as `checked_term` evaluates
    them.
    """
    if law.fields or law.traits.compiled:
        return law
    return law.mapped(lambda value, _: fem.Constant(mesh, np.asarray(value, float)))


def relative_thickness(domain: Domain, profile: Profile, name: str = S) -> fem.Function:
    """Return the thickness of a layer, divided by `ThinLayer.eps`, as a function of degree 1 on the mesh.

    Values away from the seam have no meaning.

    Args:
        domain: the distributed mesh.
        profile: function of the place, from the user, whose values at the vertices are taken.
        name: name of the seam; "S" for all seams.
    """
    joint = domain.joint
    return cellwise_function(domain, ("Lagrange", 1), joint.relative_thickness(profile, name)[joint.corners][..., None])


def band_of(joint: Joint) -> InflatedBand:
    """Return the regions and faces of the meshed layers of a joint, and how they were meshed.

    The joint must have meshed layers.
    """
    assert joint.band is not None
    return joint.band


def director(domain: Domain) -> Expr:
    """Return the unit normal (d,) of S, in UFL, from the lower to the upper body in the meshed layer's cells.

    It is not defined in the bodies.
    """
    joint, directors = domain.joint, band_of(domain.joint).director
    cell_directors = np.zeros((*joint.corners.shape, joint.dim))
    cell_directors[-len(directors) :] = directors
    n = cellwise_function(domain, ("DG", 1, (joint.dim,)), cell_directors)
    return n / ufl.sqrt(ufl.dot(n, n))


def inflation_motion(domain: Domain) -> fem.Function:
    """Return the displacement (d,) of each place of the mesh when S was opened to the layer's thickness.

    Kept bodies move as rigid bodies. Places in the layer come from the place on S from which the layer was made.
    """
    joint = domain.joint
    displacements = (joint.points - joint.reference)[joint.cells]
    return cellwise_function(domain, ("Lagrange", joint.degree, (joint.dim,)), displacements)


class MidSurface:
    """S midway between the faces of bodies that gave up room for the layer, which has no cells.

    Args:
        domain: the distributed mesh.

    Attributes:
        offset: (d,) UFL vector from places on the face of either body to S, in d dimensions.
    """

    def __init__(self, domain: Domain) -> None:
        joint = domain.joint
        self.offset = cellwise_function(domain, ("DG", joint.degree, (joint.dim,)), offset_to_middle(joint))

    def thickness(self, sides: Interface) -> Expr:
        """Return the thickness of the layer in UFL: the distance between the bodies' faces along the normal n of S."""
        return -2 * ufl.dot(sides.upper(self.offset), sides.n)

    def eps_gradient(self, sides: Interface) -> Expr:
        """Return the gradient (d,) of the thickness along S, in UFL."""
        gradient = -2 * ufl.dot(sides.n, sides.upper.gradient(self.offset))
        return gradient - ufl.dot(gradient, sides.director) * sides.n


def sampled_function(f: fem.Function, mesh: Mesh, x: Expr, what: str) -> fem.Function:
    """Return the interpolant on a mesh of a function on another mesh. Collective.

    Args:
        f: the function on the other mesh.
        mesh: the mesh of the interpolant.
        x: (d,) UFL expression on `mesh`, the coordinates at which f is evaluated.
        what: first words of error messages.

    Returns:
        A function that is a polynomial in each cell. At its interpolation points it has the values of f, but for 1e-6
        of the change of f in a cell.

    Raises:
        InputError: a place lies outside the other mesh.
    """
    degree = min(2, f.function_space.element.basix_element.degree)
    interpolant = fem.Function(fem.functionspace(mesh, ("DG", degree, f.ufl_shape)))
    places = interpolation_places(interpolant.function_space, x)
    places = (places + INWARD_SHIFT * (places.mean(axis=1, keepdims=True) - places)).reshape(-1, mesh.geometry.dim)
    values = _evaluate_on_all_ranks(f, places)
    outside_places = np.concatenate(communicator(mesh).allgather(places[np.isnan(values).any(axis=1)][:1]))
    if len(outside_places):
        raise InputError(f"{what}: a function is unknown at {place_text(outside_places[0])}; its mesh must cover all")
    interpolant.x.array.reshape(values.shape)[np.asarray(interpolant.function_space.dofmap.list).ravel()] = values
    return interpolant


def interpolation_places(V: fem.FunctionSpace, x: Expr) -> Array:
    """Return the values (cells, n, d) of UFL coordinates x (d,) at the n interpolation points of V in local cells."""
    mesh, d = V.mesh, V.mesh.geometry.dim
    cells = np.arange(len(V.dofmap.list), dtype=np.int32)
    expression = fem.Expression(x + fem.Constant(mesh, np.zeros(d)), interpolation_points(V))
    return np.asarray(expression.eval(mesh, cells).reshape(len(cells), -1, d))


def _evaluate_on_all_ranks(f: fem.Function, x: Array) -> Array:
    """Return the values (n, m) of a function with m components at n places x (n, d); NaN outside its mesh. Collective.

    The values come from all ranks of the function's mesh. Every rank gets the places and values of all ranks, so that
    its memory grows with the total number of cells.
    """
    mesh = f.function_space.mesh
    comm = communicator(mesh)
    x_of_ranks = comm.allgather(np.pad(x, ((0, 0), (0, 3 - x.shape[1]))))
    places = np.concatenate(x_of_ranks)
    bb_tree = geometry.bb_tree(mesh, mesh.topology.dim)
    colliding = geometry.compute_colliding_cells(mesh, geometry.compute_collisions_points(bb_tree, places), places)
    starts, has_cell = colliding.offsets[:-1], np.diff(colliding.offsets) > 0
    values = np.full((len(places), int(np.prod(f.ufl_shape))), np.nan)
    if has_cell.any():
        values[has_cell] = f.eval(places[has_cell], colliding.array[starts[has_cell]]).reshape(-1, values.shape[1])
    start = sum(map(len, x_of_ranks[: comm.rank]))
    return np.asarray(np.fmax.reduce(comm.allgather(values))[start : start + len(x)])


@dataclass(frozen=True)
class SharedDofs:
    """Numbering of the degrees of freedom (dofs) of a space in which only chosen cells share dofs.

    The dofs of local cells, ghosts included, have keys: dofs with the same key are one dof.

    Attributes:
        continuous_space: the continuous space with the same element.
        keys: (n,) distinct keys of the dofs of the local cells, the same on all ranks, in the order of the dofs of
            `continuous_space`.
        meeting_ranks: (n,) for each key the rank that decides which rank owns the dof, the same on all ranks.
        cell_dofs: (cells, dofs per cell) indices in `keys`.
    """

    continuous_space: fem.FunctionSpace
    keys: IntArray
    meeting_ranks: IntArray
    cell_dofs: IntArray

    @classmethod
    def of_components(cls, comm: MPI.Intracomm, mesh: Mesh, element: Element, components: EntityKeys) -> SharedDofs:
        """Return dofs for a mesh with cuts: cells share a dof only on the same side of the cuts around it. Collective.

        The cuts divide the cells around each vertex, edge or facet into one or several components. The dofs of the
        entity have a copy for each component. The owner of a dof in the continuous space is the meeting rank of its
        copies.

        Args:
            comm: the domain's communicator.
            mesh: the mesh, with ghost cells across shared facets.
            element: a basix.ufl element.
            components: for each dimension of entities below that of the mesh an array (local cells, entities of a
                cell), ghosts included. It has the number >= 0, the same on all ranks, of the cell's component around
                each entity.
        """
        space = fem.functionspace(mesh, element)
        index_map, dof_components = space.dofmap.index_map, _dof_values(space, components, 0)
        n_copies = comm.allreduce(int(dof_components.max(initial=0)) + 1, op=max)
        n_local = index_map.size_local + index_map.num_ghosts
        copies = np.asarray(space.dofmap.list, np.int64) * n_copies + dof_components
        is_used = np.zeros(n_local * n_copies, bool)
        is_used[copies] = True
        local_dof, copy_number = np.divmod(np.flatnonzero(is_used), n_copies)
        owner = np.concatenate([np.full(index_map.size_local, comm.rank), index_map.owners]).astype(np.int64)[:n_local]
        numbers = np.asarray(index_map.local_to_global(np.arange(n_local, dtype=np.int32)))
        return cls(space, numbers[local_dof] * n_copies + copy_number, owner[local_dof], (is_used.cumsum() - 1)[copies])

    @classmethod
    def of_entities(cls, comm: MPI.Intracomm, mesh: Mesh, element: Element, keys: EntityKeys) -> SharedDofs:
        """Return dofs for a mesh in which several entities count as one, as on two periodic sides. Collective.

        Args:
            comm: the domain's communicator.
            mesh: the mesh.
            element: a basix.ufl element, with at most one dof for each vertex, edge, facet or cell.
            keys: for each dimension of entities an array (local cells, entities of a cell) of numbers >= 0. Entities
                that count as one have the same number. Entities of different dimensions have different numbers.
        """
        space = fem.functionspace(mesh, element)
        distinct, key_indices = np.unique(_dof_values(space, keys, -1), return_inverse=True)
        first_dof = np.full(len(distinct), np.iinfo(np.int64).max)
        np.minimum.at(first_dof, key_indices.ravel(), np.asarray(space.dofmap.list, np.int64).ravel())
        order = np.lexsort((distinct, first_dof))
        distinct, key_indices = distinct[order], np.argsort(order)[key_indices.reshape(np.shape(space.dofmap.list))]
        meeting_ranks = distinct * comm.size // comm.allreduce(int(distinct.max(initial=0)) + 1, op=max)
        return cls(space, distinct, meeting_ranks, key_indices)


def _dof_values(space: fem.FunctionSpace, entity_values: EntityKeys, default: int) -> IntArray:
    """Return for each dof of each local cell the value of the vertex, edge, facet or cell to which the dof belongs.

    Args:
        space: the space of the dofs.
        entity_values: for each dimension of entities, from 0, their values (cells, entities of a cell).
        default: value of dofs on entities of other dimensions.

    Returns:
        Values (cells, dofs per cell).
    """
    out = np.full(np.shape(space.dofmap.list), default, np.int64)
    for dim, values in enumerate(entity_values):
        for entity in range(values.shape[1]):
            out[:, space.dofmap.dof_layout.entity_dofs(dim, entity)] = values[: len(out), [entity]]
    return out


def broken_space(comm: MPI.Intracomm, shared: SharedDofs) -> fem.FunctionSpace:
    """Return the function space with one degree of freedom for each key of `shared`. Collective."""
    rank, space, keys, meeting_ranks = comm.rank, shared.continuous_space, shared.keys, shared.meeting_ranks
    n_owned_cells = space.mesh.topology.index_map(space.mesh.topology.dim).size_local
    is_used = np.zeros(len(keys), np.int64)
    is_used[shared.cell_dofs[:n_owned_cells]] = 1
    owner = query(comm, meeting_ranks, np.column_stack([keys, is_used]), lambda q, src: _elect_owners(q, src, rank))
    is_owned = owner == rank
    n_own = int(is_owned.sum())
    first_number = comm.exscan(n_own) or 0
    number = np.full(len(keys), -1, np.int64)
    number[is_owned] = first_number + np.arange(n_own)
    order = np.argsort(keys[is_owned])
    owned_keys, numbers = keys[is_owned][order], number[is_owned][order]
    foreign = ~is_owned
    number[foreign] = query(comm, owner[foreign], keys[foreign], lambda q, _: numbers[np.searchsorted(owned_keys, q)])
    local = np.empty(len(keys), np.int32)
    local[is_owned] = np.arange(n_own)
    local[foreign] = n_own + np.arange(len(keys) - n_own)
    return space_with_dofmap(space, local[shared.cell_dofs], index_map(comm, n_own, number[foreign], owner[foreign]))


def _elect_owners(requests: IntArray, source_rank: IntArray, rank: int) -> IntArray:
    """Return the ranks that own the dofs about which other ranks ask this rank.

    This rank owns a dof if one of its local or ghost cells has it. Otherwise the owner is the lowest rank with an own
    cell that has it. Both sides of S then belong to one rank at nearly all places, as contact solvers need.

    Args:
        requests: (n, 2) key of each dof; and 1 if a cell that the asking rank owns has it, else 0.
        source_rank: (n,) the asking ranks.
        rank: this rank.

    Returns:
        Owner (n,) of each dof.
    """
    key, is_used = requests[:, 0], (requests[:, 1] == 1) | (source_rank == rank)
    used_keys, votes = key[is_used], np.where(source_rank[is_used] == rank, -1, source_rank[is_used])
    order = np.lexsort((votes, used_keys))
    distinct, start = np.unique(used_keys[order], return_index=True)
    winners = votes[order][start]
    winners[winners < 0] = rank
    return winners[np.searchsorted(distinct, key)]


def vector_space(domain: Domain, cut: Splitting, degree: int, family: str, n_components: int) -> fem.FunctionSpace:
    """Return a space of vector functions, which may jump across cuts. Collective.

    Args:
        domain: the distributed mesh.
        cut: the joint's mesh with cuts where the functions may jump.
        degree: polynomial degree.
        family: basix family.
        n_components: number of components of the functions, also a single one.
    """
    mesh, dim, comm = domain.mesh, domain.joint.dim, domain.comm
    element = basix.ufl.element(family, mesh.basix_cell(), degree, shape=(n_components,))
    if domain.joint.periods:
        entity_keys = [domain.to_local(of_dim) for of_dim in cut.entity_keys]
        return broken_space(comm, SharedDofs.of_entities(comm, mesh, element, entity_keys))
    used = [any(map(len, of_dim)) for of_dim in element.basix_element.entity_dofs]
    none = np.empty((0, 0), np.int64)
    components = [domain.to_local(cut.components(k) if k else cut.at_vertices) if used[k] else none for k in range(dim)]
    return broken_space(comm, SharedDofs.of_components(comm, mesh, element, components))


def mesh_cut_at_faces(joint: Joint) -> Splitting:
    """Return the joint's mesh cut along both faces of the meshed layers, or along S if there are none."""
    if joint.band is None:
        return joint.split_mesh
    facets = [joint.facets[name] for name in joint.band.faces]
    return joint.split_along(np.unique(joint.table.index(np.concatenate(facets))))
