"""Fields on S: traction, jump and displacements of both faces, for the full and the interface model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.classes import Condition, Restricted
from ufl.domain import extract_domains

from forms.kinematics import Expr, layer_frame, lift
from forms.work import Interface
from geometry.errors import unknown
from geometry.order import order_on_s
from geometry.seam import S
from geometry.topology import IntArray
from thinlayer.discretisation.kinds import InterfaceModel
from thinlayer.discretisation.loads import has_finite_numbers
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State, transfer
from thinlayer.errors import ModelError
from thinlayer.output.junction_tractions import JunctionTractions
from thinlayer.output.lines import Line, Plane, lines_on
from thinlayer.output.surface_mass import SurfaceMass, assembled, contact_forces, nodal_forces, reaction

Array = npt.NDArray[np.float64]
NO_JUMP = 1e-12  # jump, relative to the largest displacement, that counts as zero


@dataclass(frozen=True, init=False)
class Surface:
    """Traction, jump and displacements on S, of states of an interface model or of a full model of the same joint.

    Those of a full model are transferred to the spaces of the interface model.

    Attributes:
        model: an interface model.
        seam: name of a seam of its joint; "S": all of them.

    Raises:
        ModelError: another kind of model; an unknown seam.
    """

    model: InterfaceModel
    seam: str = S

    def __init__(self, model: Model, seam: str = S) -> None:
        if not isinstance(model, InterfaceModel):
            hint = ": give the state's model" if isinstance(model, State) else ""
            raise ModelError(f"Surface needs an interface model, not {_short(model)}{hint}")
        if seam not in (S, *model.joint.seams):
            raise ModelError(unknown("seam", seam, model.joint.seams))
        object.__setattr__(self, "model", model)
        object.__setattr__(self, "seam", seam)

    def _require_same_joint(self, state: State) -> None:
        if not isinstance(state, State):
            raise ModelError(f"Surface takes a state, as solve returns it or history.last is, not {_short(state)}")
        if state.model.joint is not self.model.joint:
            raise ModelError("this state's model has another joint than the surface; build both from the same one")

    def _expression(self, f: Any, *shapes: tuple[int, ...]) -> Expr:
        """`f` as a UFL expression on S of one of these shapes (none given: any); a condition becomes 1 or 0."""
        try:
            found = ufl.as_ufl(f)
        except Exception as error:
            raise ModelError(f"{_short(f)} is no UFL expression on S, as surface.jump(state) is one") from error
        if not has_finite_numbers(found):
            raise ModelError(f"an expression on S has a number that is not finite, or not real: {str(found)[:80]}")
        if isinstance(found, Condition):
            found = ufl.conditional(found, 1.0, 0.0)
        if shapes and found.ufl_shape not in shapes:
            allowed = " or ".join("of a scalar, ()" if shape == () else f"of a vector, {shape}" for shape in shapes)
            raise ModelError(f"an expression on S has the shape {found.ufl_shape}; allowed: that {allowed}")
        meshes = [self.model.domain.mesh, *([self.model.pairs.mesh] if self.model.pairs else [])]
        known = [mesh.ufl_domain() for mesh in meshes]
        if not all(any(domain is one for one in known) for domain in extract_domains(found)):
            raise ModelError(
                "an expression on S is of another model's mesh; bring states here by surface.displacement(state)"
            )
        if not self._on_base and _lacks_side(found, (self.model.V, self.trace_space, self._nodal_space)):
            raise ModelError(
                "an expression on S has a field that jumps there; say on which side, as surface.sides.upper(u) or "
                "surface.sides.lower(u), or take surface.jump(state)"
            )
        return found

    def _compiled(self, f: Expr, make: Callable[[Any], Any]) -> Any:
        """Result of `make` for the integral over S of a scalar expression."""
        try:
            return make(f * self._factor * self.sides.measure)
        except ValueError as error:  # UFL's
            raise ModelError(f"an expression cannot be integrated over S: {error}") from error

    @property
    def sides(self) -> Interface:
        """The two sides of S, or of the seam."""
        return self.model.sides_of(self.seam)

    @property
    def _factor(self) -> Any:
        """Factor of the measure of S."""
        return self.model.kinematics.factor

    @property
    def _on_base(self) -> bool:
        """Whether the surface stands on a rigid base."""
        return bool(set(self._seams) & set(self.model.joint.base_seams))

    @property
    def _seams(self) -> tuple[str, ...]:
        return tuple(self.model.joint.seams) if self.seam == S else (self.seam,)

    @property
    def entity_maps(self) -> Any:
        """How the mesh of the facets of S lies in the model's, for `fem.form`; None where seams do not meet."""
        return self.model.pairs.maps if self.model.pairs else None

    @cached_property
    def _junctions(self) -> JunctionTractions | None:
        return JunctionTractions(self.model, self.model.pairs) if self.model.pairs else None

    @property
    def _nodal_space(self) -> fem.FunctionSpace:
        """Space of the projections of `nodal`."""
        return self.model.pairs.space if self.model.pairs else self.trace_space

    @cached_property
    def _zero(self) -> tuple[npt.NDArray[np.bool_], bool]:
        """See `SeamLayer.zero_tractions`; of all seams."""
        moving = any(callable(value) for _, given in self.model.supports.entries for value in given.values())
        found = [self.model.layers[name].zero_tractions(moving) for name in self._seams]
        return np.all([along for along, _ in found], axis=0), all(whole for _, whole in found)

    @cached_property
    def trace_space(self) -> fem.FunctionSpace:
        """Degree-1 vector functions, broken across S."""
        return self.model.space(1)

    def displacement(self, state: State) -> fem.Function:
        """Displacement of a state (of either model) in the interface model's space. Collective.

        Raises:
            ModelError: not a state, of another joint, of another element.
        """
        self._require_same_joint(state)
        if state.model is self.model:
            return state.u
        if state.model.element != self.model.element:
            raise ModelError(
                f"the state has elements {state.model.element}, the surface's model {self.model.element}: displacements "
                "need the same"
            )
        return transfer(state.u, state.model, self.model.V, self.model)

    def jump(self, state: State) -> Expr:
        """[u] = u(upper face) - u(lower face), a UFL expression on S. Collective."""
        return self.sides.jump(self.displacement(state))

    def traction(self, state: State) -> Expr:
        """Traction t = stress n on S, (d,), a UFL expression of degree 1 on S. Collective.

        It is the mean of the bodies' reactions on both faces. Where a support holds a component of one body, the reaction
        of this body contains that of the support, and the reaction of the other body alone is taken. Where supports hold
        a component of both bodies (on a rigid base: of the body), the traction does not follow from reactions:

        - under contact it is that of the law;
        - where supports hold the bodies together it is zero, if this follows from the interface law
          (`SeamLayer.zero_tractions`; a meshed layer about as hard as the bodies is strained there: take a surface
          of order 1);
        - elsewhere it is extrapolated linearly from the nodes around, two nodes deep (zero where supports hold all of
          these, too). This is exact for uniform and linear tractions.

        Where seams meet, a body's corner feels the tractions of several: see `JunctionTractions`. The traction has one
        value there for each pair of bodies that a seam joins, and jumps where a seam changes from one pair to another.
        It is then a function on a mesh of the facets of S; DOLFINx needs to be told how that lies in the model's mesh:
        `fem.form(t[0] * surface.sides.measure, entity_maps=surface.entity_maps)`.

        At nodes where S ends inside the bodies the traction is zero, because nothing jumps there.
        """
        self._require_same_joint(state)
        if self._junctions:
            return self.sides.upper(self._junctions.recovered(state))
        r = reaction(state)
        held, u = fem.Function(r.function_space), fem.Function(r.function_space)
        held.x.array[state.model.held_in(r.function_space)] = 1.0
        held.x.scatter_forward()
        u.interpolate(state.u)
        r, held, u = (transfer(f, state.model, self.trace_space, self.model) for f in (r, held, u))
        unknown = self._take_from_other_side(r, held.x.array > 0)
        if state.model.contact:
            by_law = transfer(contact_forces(state), state.model, self.trace_space, self.model)
            r.x.array[unknown] = by_law.x.array[unknown]
        zero = self._zero_tractions(unknown & ~self._jumps(u))
        axis = self.model.supports.axis(self.trace_space)
        zero[axis] = unknown[axis]
        if not state.model.contact and self.model.comm.allreduce(int((unknown & ~zero).any())):
            self._mass.extrapolate(r, unknown, unknown & ~zero)
        t = self._mass.divide_by_areas(r) if self.model.contact else self._mass.divide(r, zero)
        if self._on_base:
            return -self.sides.upper(t)
        return (self.sides.lower(t) - self.sides.upper(t)) / 2

    def nodal(self, f: Expr) -> fem.Function:
        """L2 projection of a vector expression on S to degree 1, a function on the upper side's nodes. Collective.

        Where seams meet it has the nodes of tractions (`traction`), one for each pair of bodies around a vertex.
        """
        f, V = self._expression(f, (self.model.joint.dim,)), self._nodal_space
        v = ufl.TestFunction(V)
        r = self._compiled(ufl.inner(f, self.sides.upper(v)), partial(nodal_forces, V, maps=self.entity_maps))
        return self._projection.divide(r, np.zeros(len(r.x.array), bool))

    def frame(self, f: Expr) -> Expr:
        """A vector expression on S in the frame of S: tangential components, then the normal one, (d,).

        The tangents are those of `forms.kinematics.layer_frame`: (n_2, -n_1) in 2D, its first and third axis in 3D.
        """
        f, n = self._expression(f, (self.model.joint.dim,)), self.sides.n
        axes = layer_frame(n)
        tangential = [ufl.dot(lift(f), axes[:, column]) for column in (0, 2)[: len(n) - 1]]
        return ufl.as_vector([*tangential, ufl.dot(f, n)])

    def profile(self, f: Expr) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Places (n, d) and values of an expression, projected to degree 1, at the vertices of S. Collective.

        In order along S in 2D, piece after piece, else by the coordinates; the same on every rank. Where seams meet, there
        is a value for each pair of bodies around a vertex, and each piece of S has one pair at each vertex.

        Args:
            f: vector expression on S, values (n, d), or a scalar one, values (n,).
        """
        numbers, x, values = self._at_nodes(f)
        of_facets = self.model.pairs.of_facets if self.model.pairs else None
        order = order_on_s(self.model.joint, numbers, x, self.seam, of_facets)
        return x[order], values[order]

    def along(self, f: Expr, *, plane: Plane | None = None) -> list[Line]:
        """Values of an expression, projected to degree 1, along the lines of S, by arc length. Collective.

        In 2D a line is a piece of a seam: it ends where the seam ends, branches or crosses itself. In 3D it is where a
        plane cuts a seam. Lines are ordered by seam, then by the place at which they start, the lower one of their ends by
        the first coordinate, then by the next ones; a closed line starts at its lowest place and goes towards the lower of
        its neighbours. Where another seam meets a line and values jump, there are two rows of one s.

        Args:
            f: vector expression on S, values (n, d), or a scalar one, values (n,).
            plane: in 3D a point of the plane and its normal, ((x, y, z), (n_x, n_y, n_z)).

        Raises:
            ModelError: a plane in 2D, none in 3D, one that does not cut S; expressions that are none on S.
        """
        joint, pairs = self.model.joint, self.model.pairs
        numbers, _, values = self._at_nodes(f)
        of_rows = pairs.of_facets if pairs else joint.masters[joint.table.vertices[joint.surface_rows]]
        rows = {name: np.searchsorted(joint.surface_rows, joint.rows_of(name)) for name in self._seams}
        return lines_on(joint, {name: of_rows[at] for name, at in rows.items()}, numbers, values, plane)

    def _at_nodes(self, f: Expr) -> tuple[IntArray, Array, Array]:
        """Numbers, places (n, d) and values of an expression's projection at the nodes of all ranks. Collective.

        Numbers are those of vertices, or of pairs of bodies at vertices (`Pairs`).
        """
        V, d, pairs = self._nodal_space, self.model.joint.dim, self.model.pairs
        f = self._expression(f, (d,), ())
        at = np.flatnonzero(self._upper_nodes[: V.dofmap.index_map.size_local])
        values = self.nodal(f if f.ufl_shape else ufl.as_vector([f] + [0.0] * (d - 1))).x.array.reshape(-1, d)
        vertices = pairs.at_vertices[at] if pairs else self.model.domain.joint.masters[self._vertices[at]]
        numbers = pairs.numbers[at] if pairs else vertices
        rows = np.column_stack([numbers, self.model.domain.joint.points[vertices], values[at]])
        rows = np.concatenate(self.model.comm.allgather(rows))
        found = rows[:, 1 + d :] if f.ufl_shape else rows[:, 1 + d]
        return rows[:, 0].astype(np.int64), rows[:, 1 : 1 + d], found

    @cached_property
    def _vertices(self) -> npt.NDArray[np.int64]:
        """The vertex of the joint at each local node of the trace space."""
        domain, cells = self.model.domain, self.trace_space.dofmap.list
        numbers = np.zeros(len(self.trace_space.tabulate_dof_coordinates()), np.int64)
        numbers[cells] = domain.on_cells(domain.joint.cells)[: len(cells), : cells.shape[1]]
        return numbers

    @cached_property
    def _upper_nodes(self) -> npt.NDArray[np.bool_]:
        """Which local nodes of `nodal` lie on the upper side of S."""
        v = ufl.TestFunction(self._nodal_space)
        ones = fem.Constant(self.model.domain.mesh, np.ones(self.model.joint.dim))
        areas = nodal_forces(
            self._nodal_space, ufl.inner(ones, self.sides.upper(v)) * self.sides.measure, self.entity_maps
        )
        return np.asarray(areas.x.array.reshape(-1, self.model.joint.dim)[:, 0] > 0)

    @property
    def _all_sides(self) -> tuple[Callable[[Expr], Expr], ...]:
        """The sides of S that are bodies: on a rigid base the upper one, else both."""
        return (self.sides.upper,) if self._on_base else (self.sides.upper, self.sides.lower)

    def integral(self, f: Expr) -> float:
        """Integral over S of a scalar expression. Collective."""
        form = self._compiled(self._expression(f, ()), partial(fem.form, entity_maps=self.entity_maps))
        return float(self.model.comm.allreduce(fem.assemble_scalar(form)))

    def norm(self, f: Expr, where: Expr = 1) -> float:
        """L2 norm over S of a vector expression, or of one of another shape, weighted with `where`. Collective."""
        f = self._expression(f)
        return float(np.sqrt(self.integral(self._expression(where, ()) * ufl.inner(f, f))))

    def _take_from_other_side(self, r: fem.Function, held: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Replace nodal forces at held components by minus those of the other side; return where both sides are held.

        At a node where S ends inside the bodies both sides have the same displacement; nothing is replaced there.
        """
        if self._on_base:
            return held
        there = fem.Function(self.trace_space)
        there.x.array[:] = held
        unknown = held & (self._of_other_side(there) > 0.5)
        replaced = held & ~unknown & self._areas_at_corners.astype(bool)
        r.x.array[replaced] = -self._of_other_side(r)[replaced]
        return unknown

    def _zero_tractions(self, together: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """The components whose traction is zero, among those in which supports hold the bodies together."""
        if not self.model.comm.allreduce(int(together.any())):
            return together
        along, whole = self._zero
        nodes = together.reshape(-1, len(along))
        return np.asarray((nodes & (along | (whole & nodes.all(axis=1, keepdims=True)))).ravel())

    def _jumps(self, u: fem.Function) -> npt.NDArray[np.bool_]:
        """Where a function of the trace space differs from side to side (on a rigid base: from zero)."""
        largest = self.model.comm.allreduce(float(np.abs(u.x.array).max(initial=0.0)), MPI.MAX)
        other = 0.0 if self._on_base else self._of_other_side(u)
        return np.asarray(np.abs(u.x.array - other) > NO_JUMP * largest)

    def _of_other_side(self, f: fem.Function) -> npt.NDArray[np.float64]:
        """Values of a function of the trace space at the same places on the other side of S; zero elsewhere."""
        area = self._areas_at_corners
        return np.divide(self._exchanged(f), area, out=np.zeros_like(area), where=area > 0)

    @cached_property
    def _areas_at_corners(self) -> npt.NDArray[np.float64]:
        """The weights of the values in `_exchanged`: areas of S around the nodes, by the rule that takes corners alone."""
        ones = fem.Function(self.trace_space)
        ones.x.array[:] = 1.0
        return self._exchanged(ones)

    def _exchanged(self, f: fem.Function) -> npt.NDArray[np.float64]:
        """Integrals over S of the other side's values, by the quadrature rule whose points are the corners of facets.

        With this rule the integral at a node has only the value at the same place on the other side.
        """
        values, form = self._exchange
        values.x.array[:] = f.x.array
        return np.asarray(assembled(self.trace_space, form).x.array)

    @cached_property
    def _exchange(self) -> tuple[fem.Function, fem.Form]:
        """A function of the trace space, and the form of its values that `_exchanged` assembles."""
        f, v = fem.Function(self.trace_space), ufl.TestFunction(self.trace_space)
        measure = self.sides.measure(metadata={"quadrature_rule": "vertex", "quadrature_degree": 1})
        return f, fem.form((ufl.inner(f("+"), v("-")) + ufl.inner(f("-"), v("+"))) * measure)

    @cached_property
    def _mass(self) -> SurfaceMass:
        """Mass matrix of both sides of S."""
        return self._mass_of(self.trace_space, *self._all_sides)

    @cached_property
    def _projection(self) -> SurfaceMass:
        """Mass matrix of the nodes of `nodal`."""
        return self._mass_of(self._nodal_space, self.sides.upper)

    def _mass_of(self, V: fem.FunctionSpace, *sides: Callable[[Expr], Expr]) -> SurfaceMass:
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        form = sum(ufl.inner(side(u), side(v)) for side in sides) * self._factor * self.sides.measure
        return SurfaceMass(self.model, V, form, self.entity_maps)


def _lacks_side(f: Expr, spaces: Sequence[fem.FunctionSpace]) -> bool:
    """Whether an expression has a field of one of these spaces without a restriction to a side."""
    left, seen = [f], set()
    while left:
        part = left.pop()
        if part in seen or isinstance(part, Restricted):
            continue
        if isinstance(part, fem.Function) and part.function_space in spaces:
            return True
        seen.add(part)
        left += part.ufl_operands
    return False


def _short(thing: object) -> str:
    """Text of an object for a message."""
    text = repr(thing)
    return text if len(text) <= 80 else f"{text[:80]}..."
