"""Supports, tractions and body forces: checks of the users' data, and their translation to DOLFINx and UFL."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from dolfinx.mesh import Mesh, entities_to_geometry
from mpi4py import MPI
from ufl.conditional import Condition
from ufl.constantvalue import ComplexValue, RealValue
from ufl.corealg.traversal import unique_pre_traversal

from forms.base import is_number
from forms.kinematics import Expr
from forms.planes import Kinematics
from forms.temperature import real
from forms.work import LIFTED
from geometry.domain import Domain
from geometry.errors import unknown
from geometry.joint import Joint
from geometry.seam import LAYER, S
from thinlayer.compiling.compat import interpolation_points
from thinlayer.discretisation.axis import on_axis
from thinlayer.discretisation.joint_fields import shift
from thinlayer.discretisation.load_curves import LoadCurve, Moment, Time, symbols
from thinlayer.errors import ModelError

AXES = "xyz"
ROUNDING = 1e-12  # displacement of the axis of revolution, over the largest one, that is zero
Place = str | tuple[float, ...]
Value = float | Callable[[Expr, Expr], Expr]
Support = float | Mapping[str, Value]
Given = Mapping[str, Support] | Mapping[tuple[float, ...], Support] | Mapping[Place, Support]
Load = Sequence[float] | Callable[[Expr, Expr], Sequence[Expr]]


@dataclass(frozen=True)
class Coordinates:
    """Arguments of loads: the place in the joint before inflating (kept bodies) and the time.

    Attributes:
        mesh: the mesh.
        x: (d,) UFL coordinates.
        t: the time, a UFL symbol.
    """

    mesh: Mesh
    x: Expr
    t: Time

    @classmethod
    def of(cls, domain: Domain) -> Coordinates:
        """Coordinates on a domain; for kept bodies without the rigid shifts by inflating."""
        mesh, band = domain.mesh, domain.joint.band
        x, t = ufl.SpatialCoordinate(mesh), Time(mesh)
        if band is None or band.bodies == "extended":
            return cls(mesh, x, t)
        return cls(mesh, x - shift(domain), t)

    def moment(self, t: float) -> Moment:
        """The moment at which expressions of the time get their values."""
        return Moment(self.t, t)


def vector(load: Load, at: Coordinates, dim: int, what: str) -> Expr:
    """A traction or body force as a UFL vector (d,); raises ModelError if it is not a vector of d finite components."""
    if not callable(load):
        try:
            values = real(load)
        except (TypeError, ValueError):
            values = np.full(0, np.nan)
        if values.shape != (dim,) or not np.isfinite(values).all():
            raise ModelError(f"{what} is {load!r}; it needs {dim} finite components")
        return fem.Constant(at.mesh, values)
    components = called(load, at, what)
    try:
        vector = ufl.as_vector([ufl.as_ufl(c) for c in components])
    except Exception as error:
        raise ModelError(f"{what} gives {components!r}; it needs {dim} components: {error}") from error
    if vector.ufl_shape != (dim,) or any(isinstance(c, Condition) for c in components):
        raise ModelError(
            f"{what} gives {components!r}; it needs {dim} components, ufl.conditional(c, 1, 0) for a condition c"
        )
    if not all(_is_finite(c) for c in components):
        given = ", ".join(map(str, components))
        raise ModelError(f"{what} gives ({given}); it needs {dim} finite components, of finite real numbers")
    return vector


def _is_finite(value: Any) -> bool:
    """Whether all numbers in a UFL scalar are finite and real; booleans are not numbers."""
    return not isinstance(value, (bool, np.bool_)) and has_finite_numbers(ufl.as_ufl(value))


def has_finite_numbers(expression: Expr) -> bool:
    """Whether all numbers in a UFL expression are finite and real, so that it can be compiled."""
    for node in unique_pre_traversal(expression):
        if isinstance(node, ComplexValue) or (isinstance(node, RealValue) and not math.isfinite(float(node))):
            return False
    return True


def piecewise(values: Mapping[float, float | Sequence[float]]) -> Callable[[Expr, Expr], Any]:
    """A load or prescribed displacement that is linear in time between given values, and undefined before and after.

    Tables of thousands of values are fine, `piecewise(dict(zip(times, forces)))`. The table may be used in a function,
    `lambda x, t: (0, x[0] * table(x, t))`, at another time than t, `table(x, t / 3600)`, and as a law's temperature. Steps
    of a layer with memory end at its break times.

    Args:
        values: time -> the value then: components of a load, or the number of a prescribed displacement; at least two.

    Returns:
        A function (x, t) for the data of a model; it returns numbers if t is a number.

    Raises:
        ModelError: less than two times, values that are no numbers or of different lengths.
    """
    try:
        if not all(is_number(t) for t in values):
            raise TypeError("times are numbers")
        times = sorted(values)
        rows = real([values[t] for t in times])
        whole = np.isfinite(rows).all() and np.isfinite(np.array(times, float)).all()
    except (TypeError, ValueError, LookupError) as error:
        raise ModelError(f"piecewise needs {{time: number or components}}: {error}") from error
    if len(times) < 2 or rows.ndim > 2 or not whole:
        raise ModelError(f"piecewise needs two times or more, each with a number or components, not {values!r}")
    curve = LoadCurve(np.array(times, float), rows)

    def at(_: Any, t: Any) -> Any:
        return curve(t)

    at.times = curve.breaks  # type: ignore[attr-defined]
    return at


def _scalar(value: Any, what: str) -> Expr:
    try:
        found = ufl.as_ufl(value)
    except Exception as error:
        raise ModelError(f"{what}: a component gives {value!r}; it must be a number: {error}") from error
    if found.ufl_shape:
        raise ModelError(f"{what}: a component gives a tensor of shape {found.ufl_shape}; it must be a number")
    if isinstance(found, Condition) or not _is_finite(value):
        raise ModelError(f"{what}: a component gives {value}; it must be a finite number, of finite real numbers")
    return found


def called(function: Callable[[Expr, Any], Any], at: Coordinates, what: str, t: Any = None) -> Any:
    """What a user's function gives at the coordinates, and at the symbol of the time or at a number t."""
    try:
        with symbols():
            return function(at.x, at.t if t is None else t)
    except Exception as error:
        raise ModelError(
            f"{what} is no function (x, t) of UFL coordinates: {error.__cause__ or error}; use ufl.sin(t), "
            "ufl.conditional(ufl.gt(t, 1), a, b), ..., and piecewise({time: value, ...}) for a table"
        ) from error


def refuse_periodic(joint: Joint, name: str, what: str) -> None:
    """Raise ModelError if a name is that of a periodic side: inside the periodic structure there is no boundary."""
    if joint.periods and name.split("/")[0] in joint.periods.names:
        raise ModelError(
            f"{what} on {name!r}: this side is identified with another one, the structure goes on there; a periodic cell "
            "is loaded by a mean strain, Structure(..., strain=...)"
        )


def refuse_seam(joint: Joint, name: str, message: str) -> None:
    """Raise ModelError if a name is S or that of a seam: what acts there is the layer."""
    if name in joint.seams or name.split("/")[0] == S:
        raise ModelError(message)


class Supports:
    """Prescribed displacements, for any space on the domain.

    Args:
        domain: the domain.
        given: place -> prescribed components. A place is a facet name (its continuation over the layer's side included;
            NAME/REGION and NAME/LAYER narrow it) or the coordinates of a mesh vertex before inflating (on S: both
            sides). Components are {"x": value, ...}, or one number for all of them; a value is a number or a function
            (x, t) of UFL coordinates. Where two places overlap, the later entry decides.
        at: coordinates for these functions.
        clamped: facet names where nothing moves.
        kinematics: on an axis of revolution the component x is zero.

    Attributes:
        given: (place, components) as given; `entries` has the clamped ones too.
        vectors: values of each entry, (d,) numbers or a UFL vector; 0 for free components.
        anchored: components that one vertex of a periodic joint does not move along, because nothing else would prevent
            that translation; no force acts there.

        on_axis: (n,) which points of the joint lie on an axis of revolution.

    Raises:
        GeometryError: unknown facet name, no vertex at a point. ModelError: unknown component, a value that is no number.
    """

    def __init__(
        self,
        domain: Domain,
        given: Given,
        at: Coordinates,
        clamped: Sequence[str] = (),
        kinematics: Kinematics = LIFTED,
    ) -> None:
        if not isinstance(given, Mapping):
            raise ModelError(f"supports is {given!r}; it must be {{place: {{component: value}}}}")
        self.domain, self.at = domain, at
        self.axes = AXES[: domain.joint.dim]
        self.entries: list[tuple[Place, dict[str, Value]]] = []
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
            self.entries.append((place, self._components(place, support)))
        self.given = tuple(self.entries)
        self.entries += [(place, dict.fromkeys(self.axes, 0.0)) for place in clamped]
        self.vectors = [self._vector(place, components) for place, components in self.entries]
        self.anchored: tuple[str, ...] = ()
        self.on_axis = on_axis(kinematics, domain.joint)

    def _require_point(self, place: Any) -> None:
        d = len(self.axes)
        if not isinstance(place, tuple) or len(place) != d or not all(is_number(c) for c in place):
            raise ModelError(
                f"support on {place!r}; a place is the name of a facet set, or the {d} coordinates of a vertex"
            )

    def _components(self, place: Place, support: Support) -> dict[str, Value]:
        if callable(support) or support is None:
            raise ModelError(
                f"support on {place!r} is {support!r}; allowed: a number, or {{component: number or function}}"
            )
        given = support if isinstance(support, Mapping) else dict.fromkeys(self.axes, support)
        components: dict[str, Value] = dict(given)
        for axis, value in components.items():
            if axis not in self.axes:
                raise ModelError(f"support on {place!r}: {unknown('component', axis, self.axes)}")
            if not callable(value) and not (is_number(value) and np.isfinite(float(value))):
                raise ModelError(
                    f"support on {place!r}: component {axis} is {value!r}; allowed: a finite number or a function (x, t)"
                    + ", 0 where it is held" * isinstance(value, (bool, np.bool_))
                )
        return components

    def _vector(self, place: Place, components: dict[str, Value]) -> npt.NDArray[np.float64] | Expr:
        """The values of an entry."""
        values = [components.get(axis, 0.0) for axis in self.axes]
        if not any(callable(value) for value in values):
            return np.array(values, float)
        what = f"support on {place!r}"
        found = [_scalar(called(value, self.at, what) if callable(value) else value, what) for value in values]
        on_mesh = fem.Constant(self.domain.mesh, np.zeros(len(found)))  # a function may give plain numbers
        return ufl.as_vector(found) + on_mesh

    def dofs(self, V: fem.FunctionSpace, place: Place, axis: str) -> npt.NDArray[np.int32]:
        """Local degrees of freedom (unrolled, ghosts included) of one component on one place. Collective."""
        component = V.sub(self.axes.index(axis))
        if isinstance(place, str):
            facets = self.domain.facets(place, layer_sides=True)
            return fem.locate_dofs_topological(component, self.domain.joint.dim - 1, facets)
        vertices = self.domain.vertices(self.domain.joint.nearest_point(place))
        return vertex_dofs(V, vertices, self.axes.index(axis))

    def held(
        self, V: fem.FunctionSpace, entries: Sequence[tuple[Place, Mapping[str, Value]]] | None = None
    ) -> npt.NDArray[np.int32]:
        """All supported degrees of freedom of a space, or those of some entries (local, unrolled, ghosts included).

        Collective.
        """
        anchors = self.anchors(V) if entries is None else np.empty(0, np.int32)
        entries = self.entries if entries is None else entries
        found = [
            anchors,
            self.axis(V),
            *(self.dofs(V, place, axis) for place, components in entries for axis in components),
        ]
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

    def on(self, V: fem.FunctionSpace) -> Prescribed:
        """The prescribed displacements in a space. Collective."""
        return Prescribed(self, V)


class Prescribed:
    """Degrees of freedom of a space that supports prescribe.

    Attributes:
        held: (n,) their local numbers on this rank, increasing.
    """

    def __init__(self, supports: Supports, V: fem.FunctionSpace) -> None:
        self._moment = supports.at.moment(0.0)
        self._varying: list[tuple[fem.Function, fem.Expression]] = []
        self._entries: list[tuple[npt.NDArray[np.int32], fem.Function]] = []
        for (place, components), vector in zip(supports.entries, supports.vectors, strict=True):
            dofs = [supports.dofs(V, place, axis) for axis in components]
            self._entries.append((np.concatenate([np.empty(0, np.int32), *dofs]), self._value(V, vector)))
        self._entries.append((supports.anchors(V), fem.Function(V)))
        self._axis, self._comm = supports.axis(V), supports.domain.comm
        held = np.unique(np.concatenate([np.empty(0, np.int32), self._axis, *(dofs for dofs, _ in self._entries)]))
        self.held = held[held < V.dofmap.index_map.size_local * V.dofmap.index_map_bs].astype(np.int32)
        self._values = fem.Function(V).x.array
        self._has_axis = bool(supports.on_axis.any())

    def _value(self, V: fem.FunctionSpace, vector: npt.NDArray[np.float64] | Expr) -> fem.Function:
        value = fem.Function(V)
        if not isinstance(vector, np.ndarray):
            self._varying.append((value, fem.Expression(self._moment.of(vector), interpolation_points(V))))
        elif vector.any():
            value.interpolate(lambda x: np.repeat(vector[:, None], x.shape[1], axis=1))
        return value

    def at(self, t: float) -> npt.NDArray[np.float64]:
        """Prescribed values (n,) at a time, possibly not finite. Collective."""
        self._moment.set(t)
        for value, expression in self._varying:
            value.interpolate(expression)
            value.x.scatter_forward()
        for dofs, value in self._entries:
            self._values[dofs] = value.x.array[dofs]
        self._require_axis()
        return np.asarray(self._values[self.held])

    def _require_axis(self) -> None:
        """Take the component x as zero on the axis; raise ModelError if a support moves the axis. Collective."""
        sizes = np.array([np.abs(self._values[part]).max(initial=0.0) for part in (self._axis, slice(None))])
        moved, largest = self._comm.allreduce(sizes, MPI.MAX) if self._has_axis else sizes
        self._values[self._axis] = 0.0
        if moved > ROUNDING * largest:
            raise ModelError(
                f"a support prescribes x = {moved:g} on the axis of revolution, where it is 0; give a function such as "
                "lambda x, t: 0.1 * x[0], or another place"
            )


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
