"""Fields on S: traction, jump and displacements of both faces, for the full and the interface model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem

from forms.base import is_number
from forms.interface import Interface
from forms.kinematics import Expr, layer_frame, lift
from geometry.errors import unknown
from geometry.order import order_on_s
from geometry.seam import S
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.mixed import MixedModel
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.state import State, transfer
from thinlayer.errors import ModelError
from thinlayer.output.concentration import most_of, sums_on_facets, widened
from thinlayer.output.junction_tractions import JunctionTractions
from thinlayer.output.lines import Line, Plane, lines_on
from thinlayer.output.other_side import OtherSide
from thinlayer.output.seam_tractions import SeamTractions
from thinlayer.output.surface_expression import expression_on_s, integrated, short
from thinlayer.output.surface_nodes import SurfaceNodes


@dataclass(frozen=True, init=False)
class Surface:
    """Traction, jump and displacements on S, of states of an interface model or of a full model of the same joint.

    Those of a full model are transferred to the spaces of the interface model.

    Attributes:
        model: an interface model (of a mixed model given, its own one).
        seam: name of a seam of its joint; "S": all of them.

    Raises:
        ModelError: another kind of model; an unknown seam.
    """

    model: InterfaceModel
    seam: str = S

    def __init__(self, model: Model, seam: str = S) -> None:
        if isinstance(model, MixedModel):
            model = model.by_law
        if not isinstance(model, InterfaceModel):
            hint = ": give the state's model" if isinstance(model, State) else ""
            raise ModelError(f"Surface needs an interface model, not {short(model)}{hint}")
        if seam not in (S, *model.joint.seams):
            raise ModelError(unknown("seam", seam, model.joint.seams))
        object.__setattr__(self, "model", model)
        object.__setattr__(self, "seam", seam)

    def _require_same_joint(self, state: State) -> None:
        if not isinstance(state, State):
            raise ModelError(f"Surface takes a state, as solve returns it or history.last is, not {short(state)}")
        if state.model.joint is not self.model.joint:
            raise ModelError("this state's model has another joint than the surface; build both from the same one")

    def _expression(self, f: Any, *shapes: tuple[int, ...]) -> Expr:
        """`f` as a UFL expression on S of one of these shapes (none given: any); a condition becomes 1 or 0."""
        jumping = () if self._on_base else (self.model.V, self.trace_space, self._nodes.space)
        return expression_on_s(f, self.model, jumping, shapes)

    @property
    def sides(self) -> Interface:
        """The two sides of S, or of the seam."""
        return self.model.sides_of(self.seam)

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
    def trace_space(self) -> fem.FunctionSpace:
        """Degree-1 vector functions, broken across S."""
        return self.model.space(1)

    @cached_property
    def _nodes(self) -> SurfaceNodes:
        return SurfaceNodes(self.model, self.sides, self.trace_space)

    @cached_property
    def _junctions(self) -> JunctionTractions | None:
        return JunctionTractions(self.model, self.model.pairs) if self.model.pairs else None

    @cached_property
    def _tractions(self) -> SeamTractions:
        sides, trace = self.sides, self.trace_space
        return SeamTractions(self.model, self._seams, sides, trace, None if self._on_base else OtherSide(trace, sides))

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
        return self._tractions.recovered(state)

    def nodal(self, f: Expr) -> fem.Function:
        """L2 projection of a vector expression on S to degree 1, a function on the upper side's nodes. Collective.

        Where seams meet it has the nodes of tractions (`traction`), one for each pair of bodies around a vertex.
        """
        return self._nodes.project(self._expression(f, (self.model.joint.dim,)))

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
        numbers, x, values = self._nodes.values(self._expression(f, (self.model.joint.dim,), ()))
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
        numbers, _, values = self._nodes.values(self._expression(f, (self.model.joint.dim,), ()))
        of_rows = pairs.of_facets if pairs else joint.masters[joint.table.vertices[joint.surface_rows]]
        rows = {name: np.searchsorted(joint.surface_rows, joint.rows_of(name)) for name in self._seams}
        return lines_on(joint, {name: of_rows[at] for name, at in rows.items()}, numbers, values, plane)

    def integral(self, f: Expr) -> float:
        """Integral over S of a scalar expression. Collective."""
        form = self._expression(f, ()) * self.sides.factor * self.sides.measure
        form = integrated(form, partial(fem.form, entity_maps=self.entity_maps))
        return float(self.model.comm.allreduce(fem.assemble_scalar(form)))

    def norm(self, f: Expr, where: Expr = 1) -> float:
        """L2 norm over S of a vector expression, or of one of another shape, weighted with `where`. Collective."""
        f = self._expression(f)
        return float(np.sqrt(self.integral(self._expression(where, ()) * ufl.inner(f, f))))

    def most_of(self, f: Expr, all_but: float, *, margin: float = 0.0) -> npt.NDArray[np.bool_]:
        """(n_S,) the fewest facets of S that hold the integral of |f| but for a share, for `Structure.mixed`. Collective.

        Args:
            f: scalar expression on S, such as `Estimate.map` gives.
            all_but: the share that the others may hold, from 0 to less than 1.
            margin: length by which the part of S that is chosen is made wider.

        Raises:
            ModelError: a number out of range; an integral that is zero, or not finite; where seams meet.
        """
        if not is_number(margin) or not 0 <= margin < np.inf:
            raise ModelError(f"margin is {margin!r}; it must be a length >= 0")
        if self.model.pairs:
            raise ModelError("most_of needs seams that do not meet, as mixed models do")
        sums = sums_on_facets(self.model, self.sides, self._expression(f, ()))
        return widened(self.model, most_of(sums, all_but), margin)
