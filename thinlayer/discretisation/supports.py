"""Supports: displacements that are prescribed at places of the boundary, and the degrees of freedom that they hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from dolfinx.mesh import entities_to_geometry

from forms.base import is_number
from forms.planes import LIFTED, Kinematics
from geometry.domain import Domain
from geometry.errors import unknown
from geometry.seam import LAYER, S
from thinlayer.discretisation.axis import AXES, on_axis, refuse_periodic, refuse_seam
from thinlayer.discretisation.given import Coordinates, Value
from thinlayer.errors import ModelError

NORMAL = "n"  # the component along the normal of the boundary
Place = str | tuple[float, ...]
Support = float | Mapping[str, Value]
ByPlace = Mapping[str, Support] | Mapping[tuple[float, ...], Support] | Mapping[Place, Support]
Components = dict[str, Value]


class Supports:
    """Prescribed displacements, for any space on the domain.

    Args:
        domain: the domain.
        given: place -> prescribed components. A place is a facet name (its continuation over the layer's side included;
            NAME/REGION and NAME/LAYER narrow it) or the coordinates of a mesh vertex before inflating (on S: both
            sides). Components are {"x": value, ...}, or one number for all of them; a value is a number or a function
            (x, t) of UFL coordinates. {"n": value} prescribes the displacement along the outer normal alone, on any
            inclined or curved facets: see `Prescribed`. Where places overlap, their values must agree.
        at: coordinates for these functions.
        clamped: facet names where nothing moves, whatever supports say that end there.
        kinematics: on an axis of revolution the component x is zero.

    Attributes:
        functions: (number of the entry, component) -> a function as a UFL vector (d,) of equal entries.
        moving: places where a component is a function, or a number that is not 0.
        given: (place, components) as given; `entries` has the clamped ones too.
        anchored: components that one vertex of a periodic joint does not move along, because nothing else would prevent
            that translation; no force acts there.
        on_axis: (n,) which points of the joint lie on an axis of revolution.

    Raises:
        GeometryError: unknown facet name, no vertex at a point. ModelError: unknown component, a value that is no number.
    """

    def __init__(
        self,
        domain: Domain,
        given: ByPlace,
        at: Coordinates,
        clamped: Sequence[str] = (),
        kinematics: Kinematics = LIFTED,
    ) -> None:
        if not isinstance(given, Mapping):
            raise ModelError(f"supports is {given!r}; it must be {{place: {{component: value}}}}")
        self.domain, self.at, self.clamped = domain, at, tuple(clamped)
        self.axes = AXES[: domain.joint.dim]
        entries: list[tuple[Place, Components]] = []
        for place, support in given.items():
            if isinstance(place, str):
                refuse_periodic(domain.joint, place, "support")
                what = S if place.split("/")[0] == S else repr(place)
                refuse_seam(
                    domain.joint, place, f"a support on {what} would replace the layer; support another facet set"
                )
                if not domain.values(place) and not place.endswith(f"/{LAYER}"):
                    raise ModelError(f"support on {place!r}: this facet set is empty")
            else:
                self._require_point(place)
                domain.joint.nearest_point(place)
            entries.append((place, self._components(place, support)))
        self.given = tuple(entries)
        values = {
            (number, axis): at.given(value, f"support on {place!r}: component {axis}", ())
            for number, (place, components) in enumerate(entries)
            for axis, value in components.items()
        }
        on_mesh = fem.Constant(domain.mesh, np.zeros(len(self.axes)))  # a function may give plain numbers
        self.functions = {
            key: ufl.as_vector([value.expression] * len(self.axes)) + on_mesh
            for key, value in values.items()
            if value.varies
        }
        self.moving = [
            entries[k][0] for (k, _), component in values.items() if component.varies or component.value != 0
        ]
        self.anchored: tuple[str, ...] = ()
        self.on_axis = on_axis(kinematics, domain.joint)

    @property
    def entries(self) -> tuple[tuple[Place, Components], ...]:
        """(place, components) of all supports, those of clamped facets last."""
        nothing: Components = dict.fromkeys(self.axes, 0.0)
        return (*self.given, *((place, nothing) for place in self.clamped))

    def _require_point(self, place: Any) -> None:
        d = len(self.axes)
        if not isinstance(place, tuple) or len(place) != d or not all(is_number(c) for c in place):
            raise ModelError(
                f"support on {place!r}; a place is the name of a facet set, or the {d} coordinates of a vertex"
            )

    def _components(self, place: Place, support: Support) -> Components:
        if callable(support) or support is None:
            raise ModelError(
                f"support on {place!r} is {support!r}; allowed: a number, or {{component: number or function}}"
            )
        given = support if isinstance(support, Mapping) else dict.fromkeys(self.axes, support)
        components: Components = dict(given)
        for axis, value in components.items():
            if axis == NORMAL and isinstance(place, tuple):
                raise ModelError(f"support on {place!r}: a vertex has no normal; name a facet set, or give components")
            if axis not in (*self.axes, NORMAL):
                raise ModelError(f"support on {place!r}: {unknown('component', axis, (*self.axes, NORMAL))}")
            if isinstance(value, (bool, np.bool_)):
                raise ModelError(f"support on {place!r}: component {axis} is {value!r}; give 0 where it is held")
        return components

    def dofs(self, V: fem.FunctionSpace, place: Place, axis: str) -> npt.NDArray[np.int32]:
        """Local degrees of freedom (unrolled, ghosts included) of one component on one place. Collective.

        Of the normal component all that it may hold: all components.
        """
        if axis == NORMAL:
            return np.concatenate([self.dofs(V, place, one) for one in self.axes])
        component = V.sub(self.axes.index(axis))
        if isinstance(place, str):
            facets = self.domain.facets(place, layer_sides=True)
            return fem.locate_dofs_topological(component, self.domain.joint.dim - 1, facets)
        vertices = self.domain.vertices(self.domain.joint.nearest_point(place))
        return vertex_dofs(V, vertices, self.axes.index(axis))

    def clamps(self, V: fem.FunctionSpace, name: str) -> bool:
        """Whether every displacement of a facet set is prescribed, so that no load on it moves anything. Collective."""
        along_axes = [(place, {a: g for a, g in given.items() if a != NORMAL}) for place, given in self.entries]
        held = self.held(V, along_axes)
        free = sum(len(np.setdiff1d(self.dofs(V, name, axis), held)) for axis in self.axes)
        return self.domain.comm.allreduce(free) == 0

    def held(
        self, V: fem.FunctionSpace, entries: Sequence[tuple[Place, Mapping[str, Value]]] | None = None
    ) -> npt.NDArray[np.int32]:
        """All degrees of freedom of a space that supports act on, or some entries (local, unrolled, ghosts included).

        Collective.
        """
        anchors = self.anchors(V) if entries is None else np.empty(0, np.int32)
        entries = self.entries if entries is None else entries
        found = [self.dofs(V, place, axis) for place, components in entries for axis in components]
        found += [anchors, self.axis(V)]
        return np.unique(np.concatenate([np.empty(0, np.int32), *found]))

    def anchors(self, V: fem.FunctionSpace) -> npt.NDArray[np.int32]:
        """Local degrees of freedom (unrolled, ghosts included) of the anchored components, at one corner. Collective."""
        if not self.anchored:
            return np.empty(0, np.int32)
        owned = self.domain.mesh.topology.index_map(self.domain.joint.dim).size_local
        cells = np.flatnonzero(self.domain.original_cells[:owned] == 0)
        corner = np.asarray(V.dofmap.list)[cells][:, V.dofmap.dof_layout.entity_dofs(0, 0)].ravel()
        mark = fem.Function(V)
        for axis in self.anchored:
            mark.x.array[corner * V.dofmap.bs + self.axes.index(axis)] = 1.0
        mark.x.scatter_reverse(la.InsertMode.add)  # this rank may have the cell, and another one own its corner
        mark.x.scatter_forward()
        return np.flatnonzero(mark.x.array).astype(np.int32)

    def axis(self, V: fem.FunctionSpace) -> npt.NDArray[np.int32]:
        """Local degrees of freedom (unrolled, ghosts included) of the component x on an axis of revolution. Collective."""
        if not self.on_axis.any():
            return np.empty(0, np.int32)
        domain, topology = self.domain, self.domain.mesh.topology
        points, d = domain.original_points, domain.joint.dim
        for dim in (0, d - 1):
            topology.create_connectivity(dim, d)
        local = [np.arange(m.size_local + m.num_ghosts, dtype=np.int32) for m in map(topology.index_map, (0, d - 1))]
        vertices = local[0][self.on_axis[points[entities_to_geometry(domain.mesh, 0, local[0]).ravel()]]]
        facets = local[1][self.on_axis[domain.joint.table.vertices[domain.numbers(d - 1, local[1])]].all(axis=1)]
        along = fem.locate_dofs_topological(V.sub(0), d - 1, facets)
        return np.union1d(along, vertex_dofs(V, vertices, 0)).astype(np.int32)


def vertex_dofs(V: fem.FunctionSpace, vertices: npt.NDArray[np.int32], component: int) -> npt.NDArray[np.int32]:
    """Local degrees of freedom (unrolled) of one component at local vertices, in every cell that has the vertex."""
    topology, dofmap = V.mesh.topology, V.dofmap
    topology.create_connectivity(0, topology.dim)
    to_cells, to_vertices = topology.connectivity(0, topology.dim), topology.connectivity(topology.dim, 0)
    found = []
    for vertex in vertices:
        for cell in to_cells.links(vertex):
            corner = int(np.flatnonzero(to_vertices.links(cell) == vertex)[0])
            block = dofmap.cell_dofs(cell)[dofmap.dof_layout.entity_dofs(0, corner)]
            found.append(block * dofmap.bs + component)
    return np.unique(np.concatenate([np.empty(0, np.int32), *found])).astype(np.int32)
