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
from forms.tensors import Expr
from forms.work import Interface
from geometry.domain import Domain, index_map
from geometry.inflating.inflation import offset_to_middle
from geometry.joint import InflatedBand, Joint, Profile
from geometry.refusals import place_text
from geometry.seam import S
from geometry.topology import Indices, IntArray, Splitting
from thinlayer.system.compat import interpolation_points, space_with_dofmap
from thinlayer.system.ranks import ask, communicator

Element: TypeAlias = ufl.AbstractFiniteElement | tuple[str, int] | tuple[str, int, tuple[int, ...]]
EntityKeys = Sequence[IntArray | Indices]
INWARD_SHARE = 1e-6  # shift of a place towards the middle of its cell, to one side of S, over its distance from there


def cellwise_function(domain: Domain, element: Element, values: Array) -> fem.Function:
    """Make a function from its dofs on each cell of the joint, (n_cells, dofs per cell, components)."""
    f = fem.Function(fem.functionspace(domain.mesh, element))
    dofs = f.function_space.dofmap.list
    f.x.array.reshape(-1, values.shape[2])[dofs.ravel()] = domain.on_cells(values).reshape(-1, values.shape[2])
    return f


def relative_thickness(domain: Domain, profile: Profile, name: str = S) -> fem.Function:
    """Thickness profile on a seam, or on S, as a function of degree 1; its values elsewhere have no meaning."""
    joint = domain.joint
    return cellwise_function(domain, ("Lagrange", 1), joint.relative_thickness(profile, name)[joint.corners][..., None])


def band_of(joint: Joint) -> InflatedBand:
    """How layers were meshed in an inflated joint."""
    assert joint.band is not None
    return joint.band


def director(domain: Domain) -> Expr:
    """Unit normal (d,) of S in the cells of the meshed layer, from the lower to the upper body; undefined in bodies."""
    joint, directors = domain.joint, band_of(domain.joint).director
    values = np.zeros((*joint.corners.shape, joint.dim))
    values[-len(directors) :] = directors
    n = cellwise_function(domain, ("DG", 1, (joint.dim,)), values)
    return n / ufl.sqrt(ufl.dot(n, n))


def inflation_shift(domain: Domain) -> fem.Function:
    """Displacement (d,) of each place by inflating: rigid for the bodies, away from S for the layer."""
    joint = domain.joint
    shifts = (joint.points - joint.reference)[joint.cells]
    return cellwise_function(domain, ("Lagrange", joint.degree, (joint.dim,)), shifts)


class MidSurface:
    """S as the mid-surface between the faces of extended bodies.

    Args:
        domain: the mesh.

    Attributes:
        offset: (d,) vector to S from the facets of the mesh on either side.
    """

    def __init__(self, domain: Domain) -> None:
        joint = domain.joint
        self.offset = cellwise_function(domain, ("DG", joint.degree, (joint.dim,)), offset_to_middle(joint))

    def thickness(self, sides: Interface) -> Expr:
        """Distance of the bodies along n, with S in the middle."""
        return -2 * ufl.dot(sides.upper(self.offset), sides.n)

    def slope(self, sides: Interface) -> Expr:
        """(d,) gradient of the thickness along S."""
        slope = -2 * ufl.dot(sides.n, sides.upper.gradient(self.offset))
        return slope - ufl.dot(slope, sides.director) * sides.n


def sampled_function(f: fem.Function, mesh: Mesh, x: Expr, what: str) -> fem.Function:
    """Interpolate on this mesh a function on another mesh, from its values at UFL places x (d,). Collective.

    Values are accurate to 1e-6 of the function's change in a cell.

    Raises:
        InputError: a place lies outside the other mesh; the message begins with `what`.
    """
    degree = min(2, f.function_space.element.basix_element.degree)
    interpolant = fem.Function(fem.functionspace(mesh, ("DG", degree, f.ufl_shape)))
    places = places_in_cells(interpolant.function_space, x)
    places = (places + INWARD_SHARE * (places.mean(axis=1, keepdims=True) - places)).reshape(-1, mesh.geometry.dim)
    values = _values(f, places)
    missing = np.concatenate(communicator(mesh).allgather(places[np.isnan(values).any(axis=1)][:1]))
    if len(missing):
        raise InputError(f"{what}: a function is unknown at {place_text(missing[0])}; its mesh must cover all")
    interpolant.x.array.reshape(values.shape)[np.asarray(interpolant.function_space.dofmap.list).ravel()] = values
    return interpolant


def places_in_cells(V: fem.FunctionSpace, x: Expr) -> Array:
    """Values (cells, n, d) of UFL places x (d,) at the interpolation points of a space in the cells of this rank."""
    mesh, d = V.mesh, V.mesh.geometry.dim
    cells = np.arange(len(V.dofmap.list), dtype=np.int32)
    points = fem.Expression(x + fem.Constant(mesh, np.zeros(d)), interpolation_points(V))
    return np.asarray(points.eval(mesh, cells).reshape(len(cells), -1, d))


def _values(f: fem.Function, x: Array) -> Array:
    """Values (n, m) of a function of m components at places (n, d), from all ranks of its mesh; NaN outside it.

    Every rank gets the places and values of all ranks, so its memory grows with the total number of cells.
    """
    mesh = f.function_space.mesh
    comm = communicator(mesh)
    every = comm.allgather(np.pad(x, ((0, 0), (0, 3 - x.shape[1]))))
    places = np.concatenate(every)
    tree = geometry.bb_tree(mesh, mesh.topology.dim)
    cells = geometry.compute_colliding_cells(mesh, geometry.compute_collisions_points(tree, places), places)
    first, inside = cells.offsets[:-1], np.diff(cells.offsets) > 0
    values = np.full((len(places), int(np.prod(f.ufl_shape))), np.nan)
    if inside.any():
        values[inside] = f.eval(places[inside], cells.array[first[inside]]).reshape(-1, values.shape[1])
    start = sum(map(len, every[: comm.rank]))
    return np.asarray(np.fmax.reduce(comm.allgather(values))[start : start + len(x)])


@dataclass(frozen=True)
class SharedDofs:
    """Identification of dofs of the local cells, ghosts included: dofs with the same key are one dof.

    Attributes:
        whole: the ordinary continuous space.
        keys: (n,) keys of the dofs, the same on all ranks, in the order of the dofs of `whole`.
        meeting: (n,) rank that collects which ranks use the key, the same on all ranks.
        of_cells: (cells, dofs per cell) positions in `keys`.
    """

    whole: fem.FunctionSpace
    keys: IntArray
    meeting: IntArray
    of_cells: IntArray

    @classmethod
    def of_components(cls, comm: MPI.Intracomm, mesh: Mesh, element: Element, components: EntityKeys) -> SharedDofs:
        """Make keys from dofs of the continuous space and components; the dof's owner is the meeting rank. Collective.

        Args:
            comm: the domain's communicator.
            mesh: the mesh, with ghost cells across shared facets.
            element: a basix.ufl element.
            components: for each dimension below that of the mesh, (local cells, entities of a cell), ghosts included:
                number >= 0 of the cell's component around each of its entities, the same on all ranks.
        """
        whole = fem.functionspace(mesh, element)
        base_map, component = whole.dofmap.index_map, _of_unknowns(whole, components, 0)
        count = comm.allreduce(int(component.max(initial=0)) + 1, op=max)
        n_base = base_map.size_local + base_map.num_ghosts
        copies = np.asarray(whole.dofmap.list, np.int64) * count + component
        used = np.zeros(n_base * count, bool)
        used[copies] = True
        place, number = np.divmod(np.flatnonzero(used), count)
        owner = np.concatenate([np.full(base_map.size_local, comm.rank), base_map.owners]).astype(np.int64)[:n_base]
        numbers = np.asarray(base_map.local_to_global(np.arange(n_base, dtype=np.int32)))
        return cls(whole, numbers[place] * count + number, owner[place], (used.cumsum() - 1)[copies])

    @classmethod
    def of_entities(cls, comm: MPI.Intracomm, mesh: Mesh, element: Element, keys: EntityKeys) -> SharedDofs:
        """Make keys from numbers of entities of local cells, for elements with at most one dof per entity. Collective.

        Args:
            comm, mesh, element: as in `of_components`.
            keys: for each dimension, (local cells, entities of a cell) numbers >= 0, different in each dimension.
        """
        whole = fem.functionspace(mesh, element)
        distinct, positions = np.unique(_of_unknowns(whole, keys, -1), return_inverse=True)
        place = np.full(len(distinct), np.iinfo(np.int64).max)
        np.minimum.at(place, positions.ravel(), np.asarray(whole.dofmap.list, np.int64).ravel())
        order = np.lexsort((distinct, place))
        distinct, positions = distinct[order], np.argsort(order)[positions.reshape(np.shape(whole.dofmap.list))]
        meeting = distinct * comm.size // comm.allreduce(int(distinct.max(initial=0)) + 1, op=max)
        return cls(whole, distinct, meeting, positions)


def _of_unknowns(whole: fem.FunctionSpace, of_entities: EntityKeys, otherwise: int) -> IntArray:
    """Values (cells, dofs per cell) of the entities to which the dofs of each local cell belong."""
    out = np.full(np.shape(whole.dofmap.list), otherwise, np.int64)
    for dim, values in enumerate(of_entities):
        for entity in range(values.shape[1]):
            out[:, whole.dofmap.dof_layout.entity_dofs(dim, entity)] = values[: len(out), [entity]]
    return out


def broken_space(comm: MPI.Intracomm, unknowns: SharedDofs) -> fem.FunctionSpace:
    """Make a function space with one dof for each key. Collective."""
    rank, whole, keys, meeting = comm.rank, unknowns.whole, unknowns.keys, unknowns.meeting
    n_cells = whole.mesh.topology.index_map(whole.mesh.topology.dim).size_local
    used = np.zeros(len(keys), np.int64)
    used[unknowns.of_cells[:n_cells]] = 1
    owner = ask(comm, meeting, np.column_stack([keys, used]), lambda q, src: _elect_owners(q, src, rank))
    owned = owner == rank
    n_own = int(owned.sum())
    first = comm.exscan(n_own) or 0
    number = np.full(len(keys), -1, np.int64)
    number[owned] = first + np.arange(n_own)
    order = np.argsort(keys[owned])
    owned_keys, numbers = keys[owned][order], number[owned][order]
    foreign = ~owned
    number[foreign] = ask(comm, owner[foreign], keys[foreign], lambda q, _: numbers[np.searchsorted(owned_keys, q)])
    local = np.empty(len(keys), np.int32)
    local[owned] = np.arange(n_own)
    local[foreign] = n_own + np.arange(len(keys) - n_own)
    return space_with_dofmap(whole, local[unknowns.of_cells], index_map(comm, n_own, number[foreign], owner[foreign]))


def _elect_owners(questions: IntArray, source: IntArray, rank: int) -> IntArray:
    """Owner of each key that meets here: this rank if a local or ghost cell has it, else the lowest rank that uses it.

    Both sides of S then belong to one rank at nearly all places, as contact solvers need.
    """
    key, used = questions[:, 0], (questions[:, 1] == 1) | (source == rank)
    candidate, votes = key[used], np.where(source[used] == rank, -1, source[used])
    order = np.lexsort((votes, candidate))
    distinct, start = np.unique(candidate[order], return_index=True)
    winner = votes[order][start]
    winner[winner < 0] = rank
    return winner[np.searchsorted(distinct, key)]


def vector_space(domain: Domain, cut: Splitting, degree: int, family: str) -> fem.FunctionSpace:
    """Make a space of vector functions (d,) on a domain. Collective.

    Args:
        domain: the domain.
        cut: where its mesh is cut.
        degree: polynomial degree.
        family: basix family.
    """
    mesh, dim, comm = domain.mesh, domain.joint.dim, domain.comm
    element = basix.ufl.element(family, mesh.basix_cell(), degree, shape=(dim,))
    if domain.joint.periods:
        of_entities = [domain.on_cells(of_dim) for of_dim in cut.keys]
        return broken_space(comm, SharedDofs.of_entities(comm, mesh, element, of_entities))
    used = [any(map(len, of_dim)) for of_dim in element.basix_element.entity_dofs]
    none = np.empty((0, 0), np.int64)
    components = [domain.on_cells(cut.components(k) if k else cut.of_vertices) if used[k] else none for k in range(dim)]
    return broken_space(comm, SharedDofs.of_components(comm, mesh, element, components))


def cut_at_faces(joint: Joint) -> Splitting:
    """The joint's mesh, cut along S, or at both faces of the meshed layer."""
    if joint.band is None:
        return joint.split_mesh
    facets = [joint.facets[name] for name in joint.band.faces]
    return joint.split_along(np.unique(joint.table.index(np.concatenate(facets))))
