"""Boundary of the bodies: axis of revolution, facet sets for loads and supports, and normals at nodes."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from scipy.spatial import cKDTree

from forms.base import Array, InputError, require
from forms.kinematics import Kinematics
from geometry.domain import Domain, cell_nodes, cells_of_facets
from geometry.joint import Joint
from geometry.refusals import refuse, require_known
from geometry.seam import LAYER, FacetName, S
from geometry.topology import BoolArray, Indices, IntArray, components, facet_nodes, sum_by_number, unit_normals
from thinlayer.system.ranks import send

AXIS_NAMES = "xyz"  # names of components and of motions
AXIS_TOLERANCE = 1e-10  # distance from the axis, over the size of the joint, that counts as zero
RADIAL_NORMAL_TOLERANCE = 1e-9  # largest radial component of a unit normal of an S across the axis of revolution
CORNER_ANGLE_DEGREES = 30.0  # degrees; facets whose normals differ by less at a node are one smooth surface there
NORMAL_COMPONENT_TOLERANCE = 1e-12  # a component of a unit normal that counts as rounding


def nodes_on_axis(kinematics: Kinematics, joint: Joint) -> BoolArray:
    """Return the mask (n,) of the n points of a joint on the axis of revolution; all False if there is no axis."""
    return np.asarray(np.abs(kinematics.axis_distances(joint.points)) <= AXIS_TOLERANCE * joint.size)


def require_revolution(kinematics: Kinematics, joint: Joint) -> None:
    """Raise InputError if a joint cannot be revolved about the axis x = 0.

    Not allowed are points with x < 0, seams on the axis, and a periodicity in another direction than that of the axis.
    If the kinematics are not axisymmetric, any joint passes.
    """
    r, on_axis = kinematics.axis_distances(joint.points), nodes_on_axis(kinematics, joint)
    message = f"plane={kinematics.name!r}: x is the distance from the axis of revolution, and {{bad}} points have x < 0"
    refuse((r < 0) & ~on_axis, joint.points, f"{message}, the first at {{at}}; allowed: x >= 0")
    for name in joint.seams if joint.band is None else ():
        if on_axis[joint.table.vertices[joint.rows_of(name)]].all(axis=1).any():
            reason = f"the seam {name!r} lies on the axis, where it has no area"
            raise InputError(
                f"plane={kinematics.name!r}: {reason}; move the joint to x > 0, or draw it without this seam"
            )
    if joint.periods:
        radial = np.delete(joint.periods.vectors(joint.points), kinematics.translation_axes(joint.dim), axis=1)
        if np.abs(radial).max(initial=0.0) > AXIS_TOLERANCE * joint.size:
            reason = "a structure repeats along the axis alone"
            raise InputError(f"plane={kinematics.name!r}: {reason}; make it periodic along y")


def can_shift_along(kinematics: Kinematics, normals: Array) -> bool:
    """Return whether bodies can move along each of n unit normals (n, d) of S without strain; d is the dimension.

    In axisymmetry they can only move along the axis, so that S must lie across it. Otherwise the result is True.
    """
    radial = np.delete(normals, kinematics.translation_axes(normals.shape[1]), axis=1)
    return bool(np.abs(radial).max(initial=0.0) <= RADIAL_NORMAL_TOLERANCE)


def require_normal_shifts(kinematics: Kinematics, joint: Joint) -> None:
    """Raise InputError unless bodies can move apart along the normals of S without strain.

    Bodies that keep their shape do so to make room for a meshed layer. In axisymmetry S must then lie across the axis.
    """
    if not can_shift_along(kinematics, joint.interface_normals.reshape(-1, joint.dim)):
        reason = "bodies='kept' moves them along the normal of S; a body of revolution cannot move away from its axis"
        raise InputError(f"plane={kinematics.name!r}: {reason}; use bodies='extended', or an S across the axis")


def boundary_tags(
    domain: Domain, kinematics: Kinematics, name: str, what: str, *, inside: bool = False, layer_side: bool = False
) -> tuple[int, ...]:
    """Return the tags, in `domain.facet_tags`, of a named facet set on the outer boundary.

    Args:
        domain: the distributed mesh, with the joint's names.
        kinematics: kinematics of the mesh.
        name: name of the facet set as the user wrote it.
        what: first words of error messages.
        inside: whether facets inside the bodies or on the axis of revolution are allowed too; facets on S never are.
        layer_side: whether "NAME/LAYER", the part of the facet set NAME on the meshed layer's own side, is allowed also
            where the layer is not meshed. This part has no facets then, and the result is ().

    Raises:
        InputError: no facet set has this name, it has no facets, or its facets are not allowed here.
    """
    joint = domain.joint
    drawn_joint = joint.band.drawn_joint if joint.band else joint
    all_names = ", ".join(sorted(drawn_joint.facets.keys() - {S}))
    require(isinstance(name, str), f"{what}: a place", name, f"it must be the name of a facet set; known: {all_names}")
    facet_name = FacetName.parse(name)
    refuse_periodic(joint, name, what)
    if name in drawn_joint.seams or facet_name.set_name == S or not (inside or domain.is_outer(name)):
        raise InputError(f"{what}: its facets lie inside, or below a layer; take a facet set on the outer boundary")
    facets = joint.facets.get(name, joint.facets.get(facet_name.set_name))
    if not inside and facets is not None and len(facets) and nodes_on_axis(kinematics, joint)[facets].all():
        raise InputError(f"{what}: these facets are the axis of revolution, which is not a boundary")
    require_known("facet set", name, domain.set_tags, what)
    if not domain.values(name) and not (layer_side and facet_name.part_name == LAYER):
        why = ", as the layer is a surface here: mesh it (structure.full)" * (facet_name.part_name == LAYER)
        raise InputError(f"{what}: this facet set is empty{why}")
    return domain.values(name)


def refuse_periodic(joint: Joint, name: str, what: str) -> None:
    """Raise InputError if a facet set lies on a periodic side of the joint, where the structure continues.

    Args:
        joint: the joint.
        name: name of the facet set.
        what: first words of the message.
    """
    if joint.periods and FacetName.parse(name).set_name in joint.periods.side_names:
        remedy = "a periodic cell is loaded by a mean strain, Structure(..., strain=...)"
        raise InputError(f"{what}: this side is identified with another one, the structure goes on there; {remedy}")


def node_normals(domain: Domain, V: fem.FunctionSpace, place: str) -> tuple[IntArray, Array]:
    """Return the nodes of a facet set, each with the weighted outer normals of the facets around it. Collective.

    The sum of the weighted normals at a node has the direction of the mean normal there. The weight at a vertex is
    sin(angle)/(product of lengths) of the facet's two edges there, in 2D 1/length; at other nodes it is 1. At vertices
    on circles and spheres the sum then has the exact direction, however the side is divided into triangles. Reference:
    Max 1999, Weights for computing vertex normals from facet normals.

    Where bodies gave up room for a meshed layer, facets of the layer's side may be oblique. They get the normals of the
    bodies' side that they continue.

    Args:
        domain: the distributed mesh.
        V: a space of nodal displacements.
        place: name of a facet set on the outer boundary; facets of ghost cells are left out.

    Returns:
        Local numbers (n,) of nodes (blocks of V) that this rank owns, and weighted normals (n, d) in d dimensions. A
        node occurs once for each facet around it.
    """
    mesh, d, kind = domain.mesh, domain.joint.dim, domain.joint.cell_type
    facets = domain.facets(place, layer_sides=True)
    cells, in_cell = cells_of_facets(mesh, facets)
    is_owned = cells < mesh.topology.index_map(d).size_local
    cells, in_cell, continued = cells[is_owned], in_cell[is_owned], _continued_normals(domain, place, facets[is_owned])
    nodes = facet_nodes(np.asarray(V.dofmap.list, np.int64), kind, cells, in_cell)
    x = mesh.geometry.x[facet_nodes(cell_nodes(mesh), kind, cells, in_cell), :d]
    to_cells = mesh.geometry.x[cell_nodes(mesh)[cells], :d].mean(axis=1) - x.mean(axis=1)
    n, n_corners = unit_normals(x, kind, V.ufl_element().degree, -to_cells), domain.joint.table.vertices.shape[1]
    n = np.where(np.isnan(continued)[:, None], n, continued[:, None])
    for k in range(n_corners):
        n[:, k] *= _corner_weights(x[:, :n_corners], k)[:, None]
    return _send_to_owners(domain, V, nodes.ravel(), n.reshape(-1, d))


def side_normals(joint: Joint, name: str, ridges: IntArray) -> Array:
    """Return the mean outer unit normals of the facets of a named set that meet at each of n ridges.

    Args:
        joint: the joint, in d dimensions.
        name: name of the facet set.
        ridges: (n, k) numbers in the joint of the k vertices of each ridge; a number may occur twice.

    Returns:
        Normals (n, d); NaN at ridges where no facet of the set lies.
    """
    facets, cell_type = joint.facets[name], {2: "triangle", 3: "tetrahedron"}[joint.dim]
    cells = joint.table.cells[joint.table.index(facets), 0]
    to_cells = joint.points[joint.corners[cells]].mean(axis=1) - joint.points[facets].mean(axis=1)
    normals = unit_normals(joint.points[facets[:, : joint.dim]], cell_type, 1, -to_cells)[:, 0]
    out = np.full((len(ridges), joint.dim), np.nan)
    for k, ridge in enumerate(ridges):
        normal_sum = normals[np.isin(facets, ridge).sum(axis=1) == len(np.unique(ridge))].sum(axis=0)
        if length := np.linalg.norm(normal_sum):
            out[k] = normal_sum / length
    return out


def _continued_normals(domain: Domain, place: str, facets: Indices) -> Array:
    """Return, for facets of a layer's side, the outer normals of the bodies' side that they continue.

    The normals are those in the joint as drawn, before S is opened to the layer's thickness. The layer's side is its
    own boundary at an end of S.

    Args:
        domain: the distributed mesh, in d dimensions.
        place: name of the facet set.
        facets: (n,) local numbers of facets of this set.

    Returns:
        Unit normals (n, d); NaN for facets that are not on a layer's side.
    """
    joint, band, name = domain.joint, domain.joint.band, FacetName.parse(place).set_name
    out = np.full((len(facets), joint.dim), np.nan)
    if band is None or name not in band.drawn_joint.facets or not len(facets):
        return out
    facet_numbers = domain.numbers(joint.dim - 1, facets)
    region_names = np.array(joint.regions)[joint.region[joint.table.cells[facet_numbers, 0]]]
    side_indices = np.flatnonzero(np.isin(region_names, band.regions))
    drawn_points = band.reference[joint.table.vertices[facet_numbers[side_indices]]]
    _, drawn_vertices = cKDTree(band.drawn_joint.points).query(drawn_points)
    ridges, ridge_indices = np.unique(np.sort(drawn_vertices, axis=1), axis=0, return_inverse=True)
    out[side_indices] = side_normals(band.drawn_joint, name, ridges)[ridge_indices.ravel()]
    return out


def _corner_weights(x: Array, k: int) -> Array:
    """Return the weights (n,) of the normals of n facets at their corner number `k`, as `node_normals` defines them.

    `x` (n, m, d) has the coordinates of all m corners of each facet.
    """
    adjacent_corners = [k ^ 1, k ^ 2] if x.shape[1] == 4 else [j for j in range(x.shape[1]) if j != k]
    edges = x[:, adjacent_corners] - x[:, k : k + 1]
    squared_lengths = (edges**2).sum(axis=2)
    if len(adjacent_corners) == 1:
        return np.asarray(1 / np.sqrt(squared_lengths[:, 0]))
    return np.asarray(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / squared_lengths.prod(axis=1))


def _send_to_owners(domain: Domain, V: fem.FunctionSpace, nodes: IntArray, rows: Array) -> tuple[IntArray, Array]:
    """Send a row of m numbers for each of n nodes to the rank that owns the node. Collective.

    Args:
        domain: the distributed mesh.
        V: the space of the nodes.
        nodes: (n,) local numbers of the nodes (blocks of V); they may repeat.
        rows: (n, m) the numbers.

    Returns:
        Local numbers of nodes that this rank owns, and the rows that it receives for them.
    """
    imap = V.dofmap.index_map
    owners = np.concatenate([np.full(imap.size_local, domain.comm.rank), imap.owners])[nodes]
    global_nodes = imap.local_to_global(nodes.astype(np.int32)).astype(float)
    received = send(domain.comm, owners, np.column_stack([global_nodes, rows]))
    return received[:, 0].astype(np.int64) - imap.local_range[0], received[:, 1:]


def group_facets(normals: Array) -> tuple[IntArray, Array]:
    """Group n facets around a node into smooth surfaces.

    Facets whose normals differ by less than `CORNER_ANGLE_DEGREES` belong to one surface. Different surfaces meet in a
    corner.

    Args:
        normals: (n, d) normals of the facets, with their weights as lengths.

    Returns:
        Number (n,) of each facet's surface, from 0, and unit mean normals (k, d) of the k surfaces.
    """
    unit_normals = normals / np.linalg.norm(normals, axis=1)[:, None]
    facets, other_facets = np.nonzero(unit_normals @ unit_normals.T > np.cos(np.deg2rad(CORNER_ANGLE_DEGREES)))
    _, surface_numbers = np.unique(components(facets, other_facets, len(unit_normals)), return_inverse=True)
    mean_normals = sum_by_number(surface_numbers.ravel(), normals, surface_numbers.max() + 1)
    mean_normals /= np.linalg.norm(mean_normals, axis=1)[:, None]
    mean_normals[np.abs(mean_normals) < NORMAL_COMPONENT_TOLERANCE] = 0.0
    return surface_numbers.ravel().astype(np.int64), mean_normals / np.linalg.norm(mean_normals, axis=1)[:, None]
