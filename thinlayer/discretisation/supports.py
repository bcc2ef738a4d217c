"""Supports: prescribed displacements at places of the boundary, and their conditions at the nodes of a space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse
import ufl
from dolfinx import fem, la
from dolfinx.mesh import entities_to_geometry
from petsc4py import PETSc

from forms.base import Array, InputError, require
from forms.kinematics import Kinematics
from geometry.domain import Domain
from geometry.refusals import require_known
from geometry.seam import FacetName
from geometry.topology import Indices
from thinlayer.discretisation.boundary import boundary_tags, group_facets, node_normals, nodes_on_axis
from thinlayer.discretisation.coefficient import Coefficient, Coordinates, Value
from thinlayer.system.compat import interpolate, interpolation_points

LOAD_SUM_TOLERANCE = 1e-10  # sum of the loads along an axis, over the sum of their sizes, that counts as rounding
RELATIVE_LENGTH_TOLERANCE = 1e-13  # a difference that counts as rounding, over the size of the structure
NORMAL_COMPONENT = "n"  # the component along the normal of the boundary
Place = str | tuple[float, ...]
Support = float | Mapping[str, Value]
SupportsByPlace = Mapping[str, Support] | Mapping[tuple[float, ...], Support] | Mapping[Place, Support]
AxisValues = dict[str, Value]


def is_same_or_part(place: Place, of: Place) -> bool:
    """Return whether a place is the place `of` or a part of it, as the facet set "NAME/REGION" is a part of "NAME"."""
    return place == of or (isinstance(place, str) and FacetName.parse(place).set_name == of)


class Supports:
    """Displacements that a user prescribes, for any space on a distributed mesh.

    Args:
        domain: the distributed mesh, with the joint's names.
        supports: place -> prescribed components. A place is the name of a facet set, which includes the side of a layer
            that continues it. "NAME/REGION" is the part of the set NAME on one region, "NAME/LAYER" its part on the
            layer's own side. A place may also be the coordinates of a vertex in the joint as drawn, before S is opened
            to the layer's thickness (on S: the nodes on both sides). Components are {"x": value, ...}, or one number
            for all of them; a value is a number or a function (x, t) of UFL coordinates. {"n": value} prescribes the
            displacement along the outer normal alone, on any inclined or curved facets: see `SupportConditions`. Where
            places overlap, values must agree.
        at: place and time as arguments of these functions.
        clamped: names of facet sets that do not move; conditions of other supports at their nodes are dropped.
        kinematics: kinematics of the mesh; on an axis of revolution the component x is fixed.

    Attributes:
        values: (index in `entries`, component) -> its `Coefficient`; clamped facets have none.
        moving_places: places where a component is a function, or a number that is not 0.
        user_entries: (place, components) of each support of the user; `entries` also has clamped facets.
        anchor_axes: components that are fixed at one vertex of a periodic joint, because nothing else prevents the
            translation; the reactions there are zero.
        on_axis: mask (n,) of the points of the joint that lie on an axis of revolution.

    Raises:
        InputError: unknown facet name, no vertex at a point; unknown component, a value that is not a number.
    """

    def __init__(
        self, domain: Domain, supports: SupportsByPlace, at: Coordinates, clamped: Sequence[str], kinematics: Kinematics
    ) -> None:
        require(isinstance(supports, Mapping), "supports", supports, "it must be {place: {component: value}}")
        self.domain, self.at, self.clamped = domain, at, tuple(clamped)
        self.axes = kinematics.components(domain.joint.dim)
        entries: list[tuple[Place, AxisValues]] = []
        for place, support in supports.items():
            if isinstance(place, str):
                boundary_tags(domain, kinematics, place, f"support on {place!r}", inside=True, layer_side=True)
            else:
                domain.joint.nearest_point(place)
            entries.append((place, self._components(place, support)))
        self.user_entries = tuple(entries)
        self.values, self.moving_places = dict[tuple[int, str], Coefficient](), list[Place]()
        for entry, (place, components) in enumerate(entries):
            for axis, value in components.items():
                self.values[entry, axis] = coeff = at.coefficient(value, f"support on {place!r}: component {axis}", ())
                self.moving_places += [place] if coeff.varies or coeff.value != 0 else []
        self.anchor_axes: tuple[str, ...] = ()
        self.on_axis = nodes_on_axis(kinematics, domain.joint) & kinematics.is_fixed_on_axis

    @property
    def entries(self) -> tuple[tuple[Place, AxisValues], ...]:
        """All supports as pairs of a place and its components with their values; clamped facets come last."""
        zeros: AxisValues = dict.fromkeys(self.axes, 0.0)
        return (*self.user_entries, *((place, zeros) for place in self.clamped))

    def _components(self, place: Place, support: Support) -> AxisValues:
        is_value = support is not None and (not callable(support) or len(self.axes) == 1)
        require(is_value, f"support on {place!r}", support, "give {axis: value}")
        components: AxisValues = dict(support if isinstance(support, Mapping) else dict.fromkeys(self.axes, support))
        has_normal = isinstance(place, str) and len(self.axes) > 1  # unlike a vertex, or a scalar field
        allowed = (*self.axes, NORMAL_COMPONENT) if has_normal else self.axes
        for axis in components:
            require_known("component", axis, allowed, f"support on {place!r}")
        return components

    def dofs_at_place(self, V: fem.FunctionSpace, place: Place, axis: str) -> Indices:
        """Return the local degrees of freedom in V, ghosts included, of one displacement component at a place.

        For the component "n", along the normal, these are the degrees of freedom of all components. Collective.

        Args:
            V: the space.
            place: name of a facet set, or coordinates of a vertex.
            axis: the component: "x", "y", "z" or "n".
        """
        if axis == NORMAL_COMPONENT:
            return np.concatenate([self.dofs_at_place(V, place, component) for component in self.axes])
        if isinstance(place, str):
            facets = self.domain.facets(place, layer_sides=True)
            component = V.sub(self.axes.index(axis)) if V.dofmap.bs > 1 else V
            return fem.locate_dofs_topological(component, self.domain.joint.dim - 1, facets)
        return vertex_dofs(V, self.domain.vertices(self.domain.joint.nearest_point(place)), self.axes.index(axis))

    def bc_dofs_in(self, V: fem.FunctionSpace, *, clamped: bool = True) -> Indices:
        """Return the local degrees of freedom of V, ghosts included, on which supports act. Collective.

        Args:
            V: the space.
            clamped: whether to include clamped facets, and the vertex at which a periodic joint is fixed.
        """
        entries, anchors = (self.entries, [self.anchor_dofs(V)]) if clamped else (self.user_entries, [])
        dofs = [self.dofs_at_place(V, place, axis) for place, components in entries for axis in components]
        return np.unique(np.concatenate([*dofs, *anchors, self.revolution_axis_dofs(V)]))

    def anchor_dofs(self, V: fem.FunctionSpace) -> Indices:
        """Return the local degrees of freedom of V, ghosts included, at the vertex at which a periodic joint is fixed.

        They are those of the components `anchor_axes`. Collective.
        """
        if not self.anchor_axes:
            return np.empty(0, np.int32)
        n_owned = self.domain.mesh.topology.index_map(self.domain.joint.dim).size_local
        cells = np.flatnonzero(self.domain.original_cells[:n_owned] == 0)
        corner_nodes = np.asarray(V.dofmap.list)[cells][:, V.dofmap.dof_layout.entity_dofs(0, 0)].ravel()
        marked = fem.Function(V)
        for axis in self.anchor_axes:
            marked.x.array[corner_nodes * V.dofmap.bs + self.axes.index(axis)] = 1.0
        marked.x.scatter_reverse(la.InsertMode.add)  # another rank may own the corner of this rank's cell
        marked.x.scatter_forward()
        return np.flatnonzero(marked.x.array).astype(np.int32)

    def require_balanced_loads(self, b: PETSc.Vec, t: float) -> None:
        """Raise InputError if loads have a resultant along a component that is only fixed at one vertex. Collective.

        These are the components `anchor_axes` of a periodic joint.

        Args:
            b: nodal forces of the loads.
            t: their time, for the message.
        """
        sums = self.domain.comm.allreduce(b.array_r.reshape(-1, len(self.axes)).sum(axis=0))
        for axis in self.anchor_axes:
            if abs(force := float(sums[self.axes.index(axis)])) > LOAD_SUM_TOLERANCE * b.norm(PETSc.NormType.NORM_1):
                text = f"the loads of the periodic joint add up to {force:g} along {axis} at t = {t:g}"
                raise InputError(f"{text}, and nothing balances them; add supports, or loads whose sum is zero")

    def revolution_axis_dofs(self, V: fem.FunctionSpace) -> Indices:
        """Return the local degrees of freedom of V, ghosts included, of the component x on an axis of revolution.

        Collective.
        """
        if not self.on_axis.any():
            return np.empty(0, np.int32)
        domain, topology = self.domain, self.domain.mesh.topology
        points, d = domain.original_points, domain.joint.dim
        for dim in (0, d - 1):
            topology.create_connectivity(dim, d)
        entities = [np.arange(m.size_local + m.num_ghosts, dtype=np.int32) for m in map(topology.index_map, (0, d - 1))]
        vertices = entities[0][self.on_axis[points[entities_to_geometry(domain.mesh, 0, entities[0]).ravel()]]]
        facets = entities[1][self.on_axis[domain.joint.table.vertices[domain.numbers(d - 1, entities[1])]].all(axis=1)]
        facet_dofs = fem.locate_dofs_topological(V.sub(0), d - 1, facets)
        return np.union1d(facet_dofs, vertex_dofs(V, vertices, 0)).astype(np.int32)


def vertex_dofs(V: fem.FunctionSpace, vertices: Indices, component: int) -> Indices:
    """Return the local degrees of freedom in V of one displacement component at some vertices.

    A vertex of S has several nodes, and all of them are included.

    Args:
        V: the space.
        vertices: local numbers of the vertices.
        component: 0, 1 or 2 for x, y or z.
    """
    dofmap, connectivity = V.dofmap, V.mesh.topology.connectivity(V.mesh.topology.dim, 0)
    cell_vertices = connectivity.array.reshape(connectivity.num_nodes, -1)
    layout_dofs = [dofmap.dof_layout.entity_dofs(0, k)[0] for k in range(cell_vertices.shape[1])]
    nodes = np.asarray(dofmap.list)[:, layout_dofs][np.isin(cell_vertices, vertices)]
    return np.unique(nodes * dofmap.bs + component).astype(np.int32)


@dataclass(frozen=True)
class _ValueSource:
    """Values of one component of a support: a function in the displacement space, and an expression if it varies.

    Attributes:
        entry_index: index of the support in `Supports.entries`.
        place: place of the support.
        axis: the component, such as "x", or "n" for the normal.
        value: the function with the values.
        expression: expression that is interpolated into this function for each time; None: the value is constant.
    """

    entry_index: int
    place: Place
    axis: str
    value: fem.Function
    expression: fem.Expression | None = None


class SupportConditions:
    """Conditions of supports on the displacements in a space: direction . u = value at a node.

    Supports along the normal: facets whose normals at a node differ by less than 30 degrees are one smooth surface with
    their mean normal. Other facets meet in a corner, where displacements along the normals of both are prescribed. In
    2D the corner is then fixed, in 3D it moves along the edge. Straight facets of a curved side in 3D have different
    normals: use curved cells (degree 2) where such a side should slide freely.

    Args:
        supports: the supports.
        V: the space, with displacements at nodes as unknowns if a component is along the normal.

    Attributes:
        d, size: number of components at a node, and number of displacements of this rank.
        extent: largest extent of the structure along an axis, a length.
        entry: (k,) for each of the k conditions of this rank the index of its support in `supports.entries`. -1: the
            condition is that of the vertex at which a periodic joint is fixed, or of the axis of revolution.
        condition_nodes: (k,) local numbers of the nodes of the conditions.
        directions: (k, d) unit directions of the conditions.
        condition_rows: (k, size) sparse matrix of the conditions on the displacements of this rank.
        varies: whether the value of a condition, on any rank, is a function of place or time.
    """

    def __init__(self, supports: Supports, V: fem.FunctionSpace) -> None:
        self.supports, self.V, self.comm = supports, V, supports.domain.comm
        self.d = V.dofmap.bs
        self.size = V.dofmap.index_map.size_local * V.dofmap.index_map_bs
        self.extent = supports.domain.joint.size
        entries = ((k, place, axis) for k, (place, components) in enumerate(supports.entries) for axis in components)
        self._sources = [self._make_source(*entry) for entry in entries]
        self.varies = any(source.expression is not None for source in self._sources)
        self._has_nodal_dofs = bool(V.ufl_element().basix_element.interpolation_is_identity)
        if any(source.axis == NORMAL_COMPONENT for source in self._sources) and not self._has_nodal_dofs:
            raise InputError("supports along normals need nodal displacements, not elements S2; use Q2 or P2")
        self._find_conditions()

    # ---------------------------------------------------------------- conditions
    def _make_source(self, entry: int, place: Place, axis: str) -> _ValueSource:
        value, coefficient = fem.Function(self.V), self.supports.values.get((entry, axis))
        if coefficient is not None and coefficient.varies:
            zero = fem.Constant(self.V.mesh, np.zeros(self.d))  # as functions may return plain numbers
            expression = ufl.as_vector([coefficient.expression] * self.d) + zero
            return _ValueSource(entry, place, axis, value, fem.Expression(expression, interpolation_points(self.V)))
        if coefficient is not None and coefficient.value:
            interpolate(value, lambda x: np.full((self.d, x.shape[1]), float(coefficient.components[()])))
        return _ValueSource(entry, place, axis, value)

    def _find_conditions(self) -> None:
        """Set `entry`, `directions`, `condition_nodes` and `condition_rows` for the conditions on this rank.

        For each condition also store the index of the `_ValueSource` whose function has its value, and the degree of
        freedom of this function that is the value.
        """
        supports, V, d = self.supports, self.V, self.d
        along_axes = ((k, c) for k, c in enumerate(self._sources) if c.axis != NORMAL_COMPONENT)
        source_dofs = [(k, supports.dofs_at_place(V, c.place, c.axis)) for k, c in along_axes]
        conditions: list[tuple[np.ndarray, np.ndarray, Array]] = []
        for source_index, dofs in (*source_dofs, (-1, supports.anchor_dofs(V)), (-1, supports.revolution_axis_dofs(V))):
            owned = np.unique(dofs[dofs < self.size])
            conditions.append((np.full(len(owned), source_index), owned, np.eye(d)[owned % d]))
        conditions.append(self._normal_conditions())
        source_indices, value_dofs, directions = (np.concatenate(column) for column in zip(*conditions, strict=True))
        entry_indices = np.array([*(value_source.entry_index for value_source in self._sources), -1])[source_indices]
        by_clamping = entry_indices >= len(supports.user_entries)  # other conditions are dropped at a base
        is_clamped = np.zeros(self.size, bool)
        is_clamped[value_dofs[by_clamping]] = True
        is_kept = by_clamping | ~((np.abs(directions) > 0) & is_clamped.reshape(-1, d)[value_dofs // d]).any(axis=1)
        self.entry, self._source_indices = entry_indices[is_kept], source_indices[is_kept]
        self._value_dofs, self.directions = value_dofs[is_kept], directions[is_kept]
        self.condition_nodes = self._value_dofs // d
        bsr_arrays = self.directions[:, None], self.condition_nodes, np.arange(len(self.entry) + 1)
        self.condition_rows = scipy.sparse.bsr_matrix(bsr_arrays, (len(self.entry), self.size)).tocsr()
        self.condition_rows.eliminate_zeros()

    def _normal_conditions(self) -> tuple[np.ndarray, np.ndarray, Array]:
        """Return the m conditions along normals at nodes of this rank.

        Returns:
            Indices (m,) of the sources of their values, first degrees of freedom (m,) of their nodes, unit directions
            (m, d).
        """
        d, domain = self.d, self.supports.domain
        tables: list[Array] = [np.empty((0, d + 2))]  # source, block, normal
        for source_index, value_source in enumerate(self._sources):
            if value_source.axis == NORMAL_COMPONENT:
                nodes, n = node_normals(domain, self.V, str(value_source.place))
                tables.append(np.column_stack([np.full(len(nodes), source_index), nodes, n]))
        table, rows = np.concatenate(tables), [np.empty((0, d + 2))]
        table = table[np.argsort(table[:, 1], kind="stable")]
        for node_rows in np.split(table, np.flatnonzero(np.diff(table[:, 1])) + 1) if len(table) else []:
            surface_numbers, unit_normals = group_facets(node_rows[:, 2:])
            source_surfaces = np.unique(np.column_stack([node_rows[:, 0], surface_numbers]), axis=0).astype(int)
            rows += [np.array([[source, node_rows[0, 1] * d, *unit_normals[k]]]) for source, k in source_surfaces]
        conditions = np.concatenate(rows)
        return conditions[:, 0].astype(int), conditions[:, 1].astype(int), conditions[:, 2:]

    # ---------------------------------------------------------------- values
    def values_at(self, t: float) -> Array:
        """Return the values (k,) of the k conditions at the time t, which may not be finite. Collective."""
        values = np.zeros(len(self.entry))
        with self.supports.at.clock.at(t):
            for source_index, source in enumerate(self._sources):
                if source.expression is not None:
                    interpolate(source.value, source.expression)
                mask = self._source_indices == source_index
                values[mask] = source.value.x.array[self._value_dofs[mask]]
        return values

    def condition_text(self, row: int, value: float) -> str:
        """Return words for error messages on the condition number `row` and its value."""
        if self._source_indices[row] < 0:
            return "on the axis of revolution x = 0"
        source = self._sources[self._source_indices[row]]
        return f"{source.place!r} prescribes {source.axis} = {value:.6g}"

    def point_of_condition(self, row: int) -> Array | None:
        """Return the coordinates (d,) of the node of the condition number `row`.

        Return None if the degrees of freedom of the space are not values at nodes.
        """
        if not self._has_nodal_dofs:
            return None
        x = self.V.tabulate_dof_coordinates()[self.condition_nodes[row], : self.supports.domain.joint.dim]
        return np.where(np.abs(x) > RELATIVE_LENGTH_TOLERANCE * self.extent, x, 0.0)
