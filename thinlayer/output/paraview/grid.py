"""VTK cells of a state and their displacements, gathered on rank 0 in an order independent of the number of ranks."""

from __future__ import annotations

from dataclasses import dataclass

import dolfinx
import numpy as np
import numpy.typing as npt
from dolfinx import fem

from forms.base import Array, InputError, require
from geometry.joint import Joint
from geometry.seam import BASE
from geometry.topology import FACET_TYPES, BoolArray, IntArray, geometry_degree
from thinlayer.discretisation.state import State
from thinlayer.discretisation.supports import NORMAL_COMPONENT
from thinlayer.system.compat import interpolate

# nodes of a mirrored tetrahedron of degree 2, in VTK's order; the first four: degree 1
MIRRORED_TET_NODES = (1, 0, 2, 3, 4, 6, 5, 8, 7, 9)

PLACE_DECIMALS = 9  # decimals of coordinates, over the structure's size, that distinguish nodes

# VTK's numbers of cells of degree 1, and of any degree
LINEAR_CODES = {"interval": 3, "triangle": 5, "quadrilateral": 9, "tetrahedron": 10, "hexahedron": 12}
LAGRANGE_CODES = {"interval": 68, "triangle": 69, "quadrilateral": 70, "tetrahedron": 71, "hexahedron": 72}


def vtk_code(cell_type: str, n_nodes: int) -> int:
    """Return VTK's code for cells of the type `cell_type`, such as "triangle", with `n_nodes` nodes."""
    return (LINEAR_CODES if geometry_degree(cell_type, n_nodes) == 1 else LAGRANGE_CODES)[cell_type]


def vtk_perm(cell_type: str, n_nodes: int) -> IntArray:
    """Return the permutation p (n_nodes,) of a cell's nodes from DOLFINx's to VTK's order: nodes[p] has VTK's order.

    Args:
        cell_type: type of the cell, such as "triangle".
        n_nodes: number of its nodes.
    """
    return np.argsort(np.asarray(dolfinx.cpp.io.perm_vtk(dolfinx.mesh.to_type(cell_type), n_nodes), np.int64))


@dataclass(frozen=True)
class VtkGrid:
    """A displacement or scalar field on the n nodes of VTK cells; each side of S has its own nodes.

    Attributes:
        dim: number of dimensions, 2 or 3; in 2D all third components are zero.
        points: (n, 3) coordinates of the nodes before deformation.
        u: (n, 3) displacements; zero with a scalar field.
        loads: (n, 3) nodal forces of the loads; zero with a scalar field.
        n_supported: (n,) number of components of the unknown that supports prescribe at each node.
        cells: VTK's list of cells: for each cell the number of its nodes, then the nodes.
        cell_codes: (n_cells,) VTK's codes for the types of the cells.
        region: (n_cells,) number of the region of the bodies, from 0; regions of meshed layers have -1, -2, ...
        base_x: (facets, k, 3) coordinates of the k nodes, in VTK's order, of each facet where the joint lies on a
            rigid base. An empty array if there is a body on both sides of S.
        base_code: VTK's code for the type of these facets.
        symbol: symbol of the unknown.
        value: (n,) values of a scalar field; None: the unknown is the displacement.
    """

    dim: int
    points: Array
    u: Array
    loads: Array
    n_supported: Array
    cells: IntArray
    cell_codes: npt.NDArray[np.uint8]
    region: IntArray
    base_x: Array
    base_code: int
    symbol: str
    value: Array | None = None

    @property
    def is_fixed(self) -> BoolArray:
        """Mask (n,) of the nodes at which supports prescribe all components of the unknown."""
        return self.n_supported >= (self.dim if self.value is None else 1)

    def component(self, name: str) -> Array:
        """Return a component (n,) of the displacements at the nodes, or their norm; or the values of a scalar field.

        Args:
            name: "x", "y" or "z"; "size" for the norm.

        Raises:
            InputError: another name, or "z" in 2D.
        """
        if self.value is not None:
            require(name == "size", "component", name, "a scalar field has none; leave it out")
            return self.value
        if name == "size":
            return np.linalg.norm(self.u, axis=1)
        if name not in tuple("xyz"[: self.dim]):
            raise InputError(f"unknown component {name!r}; allowed: size, {', '.join('xyz'[: self.dim])}")
        return self.u[:, "xyz".index(name)]

    @property
    def nodes_of_cells(self) -> IntArray:
        """Nodes of the cells, (n_cells, k)."""
        return self.cells.reshape(len(self.cell_codes), -1)[:, 1:]

    def is_coincident(self) -> npt.NDArray[np.bool_]:
        """Return a mask (n,) of the nodes that coincide with others before deformation, as on both sides of S."""
        # the factor pi avoids coordinates half-way between two decimals, which rounding errors would separate
        rounded_points = np.round(np.pi / np.ptp(self.points) * self.points, PLACE_DECIMALS)
        _, place_of_node, counts = np.unique(rounded_points, axis=0, return_inverse=True, return_counts=True)
        return counts[place_of_node.ravel()] > 1


def nodal_displacement(state: State) -> fem.Function:
    """Return the displacement as a function all of whose degrees of freedom are values at nodes.

    This is a copy for most elements. Element "S2" has other degrees of freedom, so that its displacement is
    interpolated to a Lagrange element of degree 2.
    """
    is_nodal = not state.model.element.startswith("S")
    u = fem.Function(state.u.function_space if is_nodal else state.model.space(2), name="u")
    interpolate(u, state.u)
    u.x.scatter_forward()
    return u


def _loads_and_supports(state: State, V: fem.FunctionSpace) -> Array:
    """Return for each node of V, ghosts included, the nodal force (c,) of the loads and the number of supported axes.

    Collective.

    Returns:
        (n, c + 1) array.
    """
    model, c = state.model, state.model.n_components
    force = fem.Function(V)
    b = model.forces.nodal_forces_at(V, state.t)
    force.x.array[: b.getLocalSize()] = b.array_r
    b.destroy()
    force.x.scatter_forward()
    nodes: dict[object, IntArray] = {None: np.empty(0, np.int64)}
    for place, components in model.supports.user_entries:
        for axis in components:  # those of several places count once, but for normals of several directions
            key = axis, place if axis == NORMAL_COMPONENT else None
            nodes[key] = np.union1d(nodes.get(key, nodes[None]), model.supports.dofs_at_place(V, place, axis) // c)
    n_supported = np.bincount(np.concatenate([*nodes.values()]), minlength=len(force.x.array) // c)
    return np.column_stack([force.x.array.reshape(-1, c), n_supported])


def gather_grid(state: State) -> VtkGrid | None:
    """Gather the displacements, loads and supports of a state on rank 0; other ranks return None. Collective.

    Cells have the order of the model's joint, and nodes the order in which they first occur in these cells. The result
    is therefore the same on any number of ranks. Where nodes of both sides of S coincide, they stay distinct. So do
    nodes on opposite periodic sides of a cell.
    """
    model, joint = state.model, state.model.domain.joint
    u = nodal_displacement(state)
    V, d, c = u.function_space, joint.dim, model.n_components
    W = fem.functionspace(model.domain.mesh, ("Lagrange", V.ufl_element().degree)) if joint.periods else V
    n = model.domain.mesh.topology.index_map(d).size_local
    perm = vtk_perm(joint.cell_type, V.dofmap.list.shape[1])
    u_nodes, x_nodes = (np.asarray(space.dofmap.list)[:n, perm] for space in (V, W))
    maps_and_nodes = ((V.dofmap.index_map, u_nodes), (W.dofmap.index_map, x_nodes))
    global_nodes = [imap.local_to_global(np.ravel(nodes)).reshape(nodes.shape) for imap, nodes in maps_and_nodes]
    # coordinates of each cell, as a node on periodic sides has two positions
    x_space = fem.functionspace(V.mesh, ("DG", V.ufl_element().degree)) if joint.periods else V
    x = x_space.tabulate_dof_coordinates()[x_space.dofmap.list[:n]][:, perm]
    values = np.column_stack([u.x.array.reshape(-1, c), _loads_and_supports(state, V)])[u_nodes]
    pieces = model.comm.gather((model.domain.original_cells[:n], *global_nodes, x, values), root=0)
    if pieces is None:
        return None
    cell_numbers, *global_nodes, x, values = (np.concatenate(arrays) for arrays in zip(*pieces, strict=True))
    *global_nodes, x, values = (array[np.argsort(cell_numbers)] for array in (*global_nodes, x, values))
    node_pairs = np.stack(global_nodes, axis=-1).reshape(-1, 2)
    _, first_rows, pair_numbers = np.unique(node_pairs, axis=0, return_index=True, return_inverse=True)
    pair_order = np.argsort(first_rows)
    cell_nodes = np.argsort(pair_order)[pair_numbers.ravel()].reshape(global_nodes[0].shape)
    node_rows = first_rows[pair_order]
    points, values = x.reshape(-1, 3)[node_rows], values.reshape(-1, 2 * c + 1)[node_rows]
    displacements, loads = (np.pad(vectors, ((0, 0), (0, 3 - c))) for vectors in (values[:, :c], values[:, c:-1]))
    value = displacements[:, 0] if c == 1 else None
    if value is not None:
        displacements, loads = np.zeros((2, *points.shape))
    if joint.cell_type == "tetrahedron":  # VTK mistakes inner faces of left-handed cells for outer faces
        corners = points[cell_nodes[:, :4]]
        is_left_handed = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
        cell_nodes[is_left_handed] = cell_nodes[is_left_handed][:, MIRRORED_TET_NODES[: cell_nodes.shape[1]]]
    cells = np.column_stack([np.full(len(cell_nodes), cell_nodes.shape[1]), cell_nodes]).ravel()
    first_layer_region = len(joint.regions) - len(joint.band.regions if joint.band else ())
    region = np.where(joint.region >= first_layer_region, first_layer_region - joint.region - 1, joint.region)
    cell_codes = np.full(len(cell_nodes), vtk_code(joint.cell_type, cell_nodes.shape[1]), np.uint8)
    base = _base_points_and_code(joint)
    symbol = model.kinematics.quantities.symbol
    return VtkGrid(d, points, displacements, loads, values[:, -1], cells, cell_codes, region, *base, symbol, value)


def _base_points_and_code(joint: Joint) -> tuple[Array, int]:
    """Return the nodes of the facets of a joint that lie on a rigid base, and VTK's code for these facets.

    Returns:
        (facets, k, 3) coordinates of the k nodes of each facet, in VTK's order, empty if there is no rigid base; VTK's
        code for the type of these facets.
    """
    facet_type = FACET_TYPES[joint.cell_type]
    set_names = joint.base_seams if joint.band is None else (BASE,) if BASE in joint.facets else ()
    if not set_names:
        return np.empty((0, joint.dim, 3)), LINEAR_CODES[facet_type]
    facet_numbers = np.unique(joint.table.index(np.concatenate([joint.facets[name] for name in set_names])))
    nodes = joint.table.nodes(facet_numbers, joint.cells, joint.cell_type)
    facet_points = joint.points[nodes[:, vtk_perm(facet_type, nodes.shape[1])]]
    return np.pad(facet_points, ((0, 0), (0, 0), (0, 3 - joint.dim))), vtk_code(facet_type, nodes.shape[1])
