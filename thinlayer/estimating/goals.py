"""Goals: quantities of interest of a structure, whose change by meshing its layers is estimated; base class `Goal`."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, cast
from weakref import WeakKeyDictionary

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, la
from dolfinx.mesh import Mesh
from petsc4py import PETSc

from forms import work as forms
from forms.base import Array, InputError, require
from forms.temperature import finite_values
from forms.tensors import Expr
from geometry.refusals import require_known
from geometry.seam import BASE, S
from geometry.topology import BoolArray, IntArray
from thinlayer.discretisation.contact_nodes import nodes_of_sides
from thinlayer.discretisation.form_compilation import checked_user_form, compiled
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.model import Model
from thinlayer.discretisation.part_definition import PartDefinition
from thinlayer.discretisation.rigid_motions import load_resultants, resultant_mask
from thinlayer.discretisation.state import State, displacements_of
from thinlayer.discretisation.supports import Place, is_same_or_part
from thinlayer.output.nodal_forces import nodal_forces
from thinlayer.output.probe import cells_at, displacements_at
from thinlayer.output.surface import Surface
from thinlayer.solving.adjoint import Adjoint
from thinlayer.solving.layer_subproblem import DirichletLayers
from thinlayer.surface.locating import LocatedPoints
from thinlayer.surface.surface_mesh import SurfaceMesh
from thinlayer.system.compat import expand_derivatives

# mesh -> (coordinates, side, seam) -> cells at the point of a goal: a search among all cells is slow, and often repeated
_CELLS_AT: WeakKeyDictionary[Mesh, dict[tuple[object, ...], LocatedPoints]] = WeakKeyDictionary()


class Goal(ABC):
    """Quantity of interest Q: a number that depends on a structure's displacements.

    Its definition is the same for full and interface models of the structure.

    Attributes:
        name: name of the goal, in tables and sentences.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, estimate, goals, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> top, end = goals.Displacement((4, 2), (0, 1)), goals.Reaction("BOTTOM", (1, 0))
        >>> result = estimate(state, goals=[top, end])
        >>> for name, goal in result.goals.items():
        ...     print(f"{name}: {goal.value:.3g} with the law, {goal.better:.3g} meshed")
        displacement at (4, 2) along (0, 1): -0.000459 with the law, -0.000465 meshed
        reaction BOTTOM along (1, 0): -12 with the law, -12 meshed
    """

    name: str

    def check(self, model: InterfaceModel) -> None:
        """Raise InputError if `model` cannot have the goal, for example if its point is outside. Not collective."""

    def is_linear(self, model: InterfaceModel) -> bool:
        """Return whether Q is a linear function of the displacements and reactions of `model`, plus a constant."""
        return True

    @abstractmethod
    def value(self, state: State, model: InterfaceModel) -> float:
        """Return Q in `state`, a state of the interface model `model` or of a full model. Collective.

        Displacements of a full model are first transferred to `model`.
        """

    @abstractmethod
    def scale(self, state: State, model: InterfaceModel) -> float:
        """Return a reference magnitude of Q in `state`, >= 0, with which rounding errors of Q are compared. Collective.

        `model` is the interface model.
        """

    def value_in(self, state: State) -> float:
        """Return Q in a state of an interface model. Collective."""
        remedy = "with the layer meshed, take goal.value(state, an interface model of the structure)"
        require(isinstance(state.model, InterfaceModel), f"{self.name}: the model", state.model, remedy)
        return self.value(state, cast(InterfaceModel, state.model))

    def at_rest(self, state: State, model: InterfaceModel) -> float:
        """Return a linear goal's value at zero displacements, from prescribed strains and loads alone. Collective.

        The strains and loads are those at the time of `state`; `model` is the interface model.
        """
        return self.value(replace(state, u=fem.Function(model.V)), model)

    def layer_weights(self, layers: DirichletLayers) -> tuple[Array, Array]:
        """Return what the layers contribute to Q, if they are meshed by themselves: zero for most goals.

        The contribution is q . w - g . r. Here w are the unknowns of the layers, and r the reactions of supports at
        their lateral sides.

        Args:
            layers: the meshed layers, with n unknowns.

        Returns:
            The weights q and the motions g, both (n,).
        """
        return np.zeros_like(layers.load), np.zeros_like(layers.load)

    @abstractmethod
    def dual(self, adjoint: Adjoint) -> tuple[PETSc.Vec, PETSc.Vec]:
        """Return weights q and motions g of supports, such that Q = q . u - g . r plus a constant. Collective.

        Here u are the nodal displacements, and r the reactions at prescribed ones; the constant is `at_rest`. If Q is
        not linear, it is linearised.

        Args:
            adjoint: linearised interface model, at the state where Q is linearised.

        Returns:
            q and g, vectors at the displacements of the interface model.

        Raises:
            InputError: Q has no such weights.
        """


class DirectedGoal(Goal):
    """Component of a vector quantity along a direction, as a goal.

    Attributes:
        direction: (d,) the direction in d dimensions, not zero; its length does not matter. None: that of a scalar
            field, whose goals have none.
    """

    direction: Sequence[float] | None

    @property
    def _direction_text(self) -> str:
        return "" if self.direction is None else f" along {vector_text(self.direction)}"

    def check(self, model: InterfaceModel) -> None:
        self.unit(model)

    def unit(self, model: Model) -> Array:
        """Return the unit vector (d,) along the direction, in the d dimensions of `model`, or (1.0,) for a scalar field.

        Raises:
            InputError: the direction has not d finite components, or is zero; or a scalar field has one.
        """
        d = model.n_components
        if d == 1:
            require(self.direction is None, f"{self.name}: the direction", self.direction, "a scalar field has none")
            return np.ones(1)
        direction = finite_values(self.direction, (d,))
        if direction is None or not direction.any():
            raise InputError(f"{self.name}: the direction is {self.direction!r:.200}; give {d} numbers, not all zero")
        return np.asarray(direction / np.linalg.norm(direction))


def vector_text(vector: Iterable[float]) -> str:
    """Return the components of a vector as text for the name of a goal.

    If `vector` is no vector of numbers the result is its `repr`: `Goal.check` raises an error later.
    """
    try:
        return f"({', '.join(f'{c:.4g}' for c in vector)})"
    except (TypeError, ValueError, OverflowError):
        return repr(vector)


@dataclass(frozen=True)
class Compliance(Goal):
    """Work of the loads in the displacements, minus the work of moving supports, as a goal; an energy.

    The supports' work is that of their forces in their prescribed displacements. For linear models the compliance is -2
    times the potential energy.
    """

    name: ClassVar[str] = "compliance"  # type: ignore[misc]

    def value(self, state: State, model: InterfaceModel) -> float:
        plate_motions = [value(state.t) for mpc in model.constraints.mpcs for value in mpc.motion.values()]
        if not (model.supports.moving_places or any(plate_motions)):
            return state.load_work()
        if math.isnan(state.prescribed_work):
            raise InputError("compliance of supports that move: the state was read from a file, and lacks their work")
        return state.load_work() - state.prescribed_work

    def scale(self, state: State, model: InterfaceModel) -> float:
        return float(np.nansum(np.abs([*state.energies().values()])))  # a law need not declare its energy

    def dual(self, adjoint: Adjoint) -> tuple[PETSc.Vec, PETSc.Vec]:
        for part in adjoint.model.parts:  # such as JouleHeat
            if type(part).load_work is not PartDefinition.load_work:
                raise InputError(f"compliance: the weights of the load {part!r:.60} are not known; give other goals")
        return adjoint.load_weights(), adjoint.prescribed_displacements()

    def at_rest(self, state: State, model: InterfaceModel) -> float:
        return 0.0  # the reactions contain it

    def layer_weights(self, layers: DirichletLayers) -> tuple[Array, Array]:
        return layers.nodal_loads, layers.side_u


def _rms_traction(surface: Surface, state: State) -> float:
    """Return the root mean square of the tractions on `surface` in `state`."""
    return surface.norm(surface.traction(state)) / math.sqrt(surface.integral(1.0))


@dataclass(frozen=True)
class Reaction(DirectedGoal):
    """Force that supports and springs at a place exert on the structure, along a direction, as a goal.

    For a scalar field see `Inflow`.

    Attributes:
        place: where the supports are: name of a facet set; NAME/REGION, the part of the facet set NAME on one body, or
            on a meshed layer's own side; or the coordinates of a vertex.
        direction: (d,) the direction in d dimensions, not zero; its length does not matter.
    """

    place: Place
    direction: Sequence[float] | None = None

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the goal, made of its place and direction."""
        return f"{'inflow' if self.direction is None else 'reaction'} {self.place}{self._direction_text}"

    def unit(self, model: Model) -> Array:
        """Return the unit vector (d,) along the direction; in axisymmetry its radial component is set to zero.

        The reason is that radial forces around the axis add up to zero. `model` is a model of the structure.

        Raises:
            InputError: the direction is zero, not of d components or, in axisymmetry, radial.
        """
        axial: Array = super().unit(model) * resultant_mask(model.kinematics, model.joint.dim)[: model.n_components]
        allowed = "give one with a part along the axis: forces along radii add up to zero"
        require(axial.any(), f"{self.name}: the direction", self.direction, allowed)
        return axial

    def value(self, state: State, model: InterfaceModel) -> float:
        return float(state.reaction(self.place).components @ self.unit(model))

    def scale(self, state: State, model: InterfaceModel) -> float:
        forces = [reaction.components for reaction in state.reactions_by_place().values()]
        force_sum = float(sum(np.linalg.norm(force) for force in [*forces, state.applied().components]))
        surfaces = [Surface(model, name) for name in model.layers]  # under pure moments all resultants are zero
        seam_forces = (_rms_traction(surface, state) * float(surface.integral(1.0)) for surface in surfaces)
        return max(force_sum, sum(seam_forces))

    def dual(self, adjoint: Adjoint) -> tuple[PETSc.Vec, PETSc.Vec]:
        model, direction = adjoint.model, self.unit(adjoint.model)
        if self.place in (S, BASE, *model.joint.base_seams):
            raise InputError(f"{self.name}: a rigid base holds it, and has no weights; ask for another place")
        du, q = ufl.TestFunction(model.V), adjoint.zero_vector()
        for part in model.parts:
            if any(is_same_or_part(place, self.place) for place, _ in part.reaction(model, adjoint.state.u)):
                q.axpy(-1.0, adjoint.form_weights(part.work(model, du, ufl.as_vector(direction.tolist()))))
        return q, adjoint.support_force_weights(self.place, direction)

    def at_rest(self, state: State, model: InterfaceModel) -> float:
        by_supports = model.constraints.prescribed_resultant(model.held_indices(self.place), self.unit(model), state.t)
        loads = load_resultants(model, state.t, model.forces.work_of_parts)  # such as those of a film's surroundings
        at_place = (load for place, load in loads.items() if is_same_or_part(place, self.place))
        return by_supports + float(sum(load.components @ self.unit(model) for load in at_place))

    def layer_weights(self, layers: DirichletLayers) -> tuple[Array, Array]:
        return np.zeros_like(layers.load), layers.support_force_weights(self.place, self.unit(layers.model))


@dataclass(frozen=True)
class MeanTraction(DirectedGoal):
    """Mean traction on a seam along a direction, as a goal; for a scalar field see `MeanFlux`.

    It is the resultant of the bodies' nodal forces on the seam, divided by its area. Where supports or plates constrain
    nodes, nodal forces contain the forces of supports and plates. The forces at other nodes replace them.

    Attributes:
        direction: (d,) the direction in d dimensions, not zero; its length does not matter.
        seam: name of the seam; "S": all seams together.
        where: function of coordinates x (d, m) of m nodes of S that is true on a stretch of the seam; None: on all of
            it. The mean has the weight 1 there, and falls to 0 over the adjacent facets. The function's own name is part
            of the goal's name.
    """

    direction: Sequence[float] | None = None
    seam: str = S
    where: Callable[[Array], npt.ArrayLike] | None = None

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the goal, made of its seam, stretch and direction."""
        seam_text = "" if self.seam == S else f" {self.seam}"
        where_text = "" if self.where is None else f" where {getattr(self.where, '__name__', self.where)}"
        quantity = "flux" if self.direction is None else "traction"
        return f"mean {quantity}{seam_text}{where_text}{self._direction_text}"

    def check(self, model: InterfaceModel) -> None:
        self.unit(model)
        require_known("layer", self.seam, {S, *model.layers}, self.name)

    def value(self, state: State, model: InterfaceModel) -> float:
        if any(term.law.traits.compiled for term in model.bodies) and state.model is not model:
            raise InputError(f"{self.name} of bonded bodies: their laws are not linear")
        v, u = self._virtual_displacements(model), displacements_of(state, model)
        bodies = replace(state, model=model, u=u).bodies  # with the strains that are prescribed at its time
        work_forms = [state.work(bodies, v)] if state.model.V is model.V else [forms.work(bodies, u, v)]
        work_forms += [-model.external_work(v, state.t), model.work_of_parts(u, v)]
        assembled = (fem.assemble_scalar(compiled(W)) for W in work_forms if W.integrals())
        return float(sum(state.model.comm.allreduce(value) for value in assembled))

    def scale(self, state: State, model: InterfaceModel) -> float:
        return _rms_traction(Surface(model, self.seam), state)

    def dual(self, adjoint: Adjoint) -> tuple[PETSc.Vec, PETSc.Vec]:
        model = adjoint.model
        linear = all(term.law.traits.linear and not term.law.traits.compiled for term in model.bodies)
        if not linear or not all(part.is_linear(model) for part in model.parts):
            reason = "a law of the bodies, or a part, is not linear or has a rate, so its weights are not known"
            raise InputError(f"{self.name}: {reason}; take sensitivity(solution).of(goal), or another goal")
        u, du, v = fem.Function(model.V), ufl.TestFunction(model.V), self._virtual_displacements(model)
        work_form = forms.work([replace(term, prescribed_strain=None) for term in model.bodies], du, v)
        if (parts_work := model.work_of_parts(u, v)).integrals():
            work_form += ufl.derivative(parts_work, u, du)
        return adjoint.form_weights(work_form), adjoint.zero_vector()

    def _virtual_displacements(self, model: InterfaceModel) -> fem.Function:
        """Return virtual displacements in which the work of the bodies' nodal forces on the seam is the mean traction.

        Each side of S contributes half of the work. If a node of one side is constrained, or lies on another seam, too,
        its nodal force contains other forces. Then the opposite node of the other side contributes all. If this holds
        for the nodes of both sides, other nodes of the same facet replace them.
        """
        e, W, v = self.unit(model), model.space(1), fem.Function(model.V)
        sides = {name: nodes_of_sides(W, model.domain.sides(name)[0])[0] for name in model.layers}
        is_fixed, total = fem.Function(W), 0.0
        is_fixed.x.array[model.bc_dofs_in(W)] = 1.0
        for name in [self.seam] if self.seam in model.layers else [*model.layers]:
            others = [nodes for other, nodes in sides.items() if other != name]
            n_others = nodal_sums(W, others, [np.ones(len(e))] * len(others)) + is_fixed.x.array.reshape(-1, len(e))
            w, v_on_S, surface = fem.Function(W), fem.Function(model.V), SurfaceMesh(model, name)
            at_nodes = self._in_stretch(W.tabulate_dof_coordinates()[:, : model.joint.dim])
            w.x.array[:] = (_reaction_factors(W, sides[name], n_others > 0) * at_nodes[:, None] * e).ravel()
            v_on_S.interpolate(w)
            lower, upper = surface.side_values(v_on_S, model, surface.quadrature)
            area, jump = float(surface.areas @ self._in_stretch(surface.places)), surface.integral(lower - upper) @ e
            if area and not jump > 0:
                raise InputError(f"{self.name}: supports, plates or other seams hold all of its nodes, on both sides")
            v.x.array[:] += (area / jump if area else 0.0) * v_on_S.x.array
            total += area
        wanted = "S must have a layer, and `where` be true at one of its nodes"
        require(total, f"{self.name}: the area of S that counts", total, wanted)
        v.x.array[:] /= total
        return v

    def _in_stretch(self, x: Array) -> Array:
        """Return whether nodes at places `x` (m, d) are on the stretch, as numbers (m,) 1 or 0."""
        try:
            inside = True if self.where is None else np.asarray(self.where(x.T))
            return np.broadcast_to(inside, len(x)).astype(bool).astype(float)
        except Exception as error:
            raise InputError(f"{self.name}: where is no numpy function of coordinates x (d, m): {error}") from error


def _reaction_factors(W: fem.FunctionSpace, sides: IntArray, mixed: BoolArray) -> Array:
    """Return the factors (nodes, d) of the bodies' nodal forces in the mean traction on a seam, in d dimensions.

    A factor is 1/2 where the forces on both sides of S are usable, and 1 where one of them is. It is 0 where a force is
    not usable. It is larger where it replaces those of other corners of a facet, and negative on the upper side.

    Args:
        W: vector space of degree 1 on the mesh of the model.
        sides: (2, facets, k) numbers of the k nodes of each facet of S on the upper side, and of the nodes that face
            them on the lower side; (1, facets, k) on a rigid base.
        mixed: (nodes, d) mask of nodal forces that contain other forces, and are therefore not usable.
    """

    def opposite_sums(values: Array | BoolArray) -> Array:
        """Return at each node on S the sum of `values` at the nodes that face it on the other side, (nodes, d).

        A node counts once for each of its facets.
        """
        return nodal_sums(W, facing, [values[nodes] for nodes in facing[::-1]])

    facing = sides if len(sides) == 2 else sides[:0]  # on a rigid base no nodes face each other
    ones = np.ones((*sides.shape, mixed.shape[1]))
    above, below = (nodal_sums(W, sides[k : k + 1], ones[k : k + 1]) > 0 for k in (0, 1))
    is_usable = (above != below) & ~mixed  # where a seam meets itself nodes may be on both sides
    counts_fully = is_usable & (opposite_sums(is_usable) < opposite_sums(np.ones_like(is_usable)))
    factors = np.where(counts_fully, 1.0, 0.5 * (is_usable & (opposite_sums(counts_fully) == 0)))
    # other corners of a facet replace its corners where no reaction is usable
    nonzero = np.sum([factors[nodes] for nodes in sides], axis=0) > 0
    weight = np.broadcast_to(nonzero.shape[1] / np.maximum(nonzero.sum(axis=1, keepdims=True), 1), nonzero.shape)
    n_facets = nodal_sums(W, sides, ones)
    factors *= nodal_sums(W, sides, [weight] * len(sides)) / np.maximum(n_facets, 1.0)
    return np.where(above, -factors, factors)


def nodal_sums(
    W: fem.FunctionSpace, nodes: Sequence[IntArray] | IntArray, values: Sequence[Array | BoolArray] | Array
) -> Array:
    """Sum given values at the nodes of a vector space, over all ranks. Collective.

    Args:
        W: vector space in d dimensions.
        nodes: arrays of local numbers of nodes, of any shape; a node may occur several times.
        values: for each of these arrays, the values at its nodes, an array with one more axis, of length d.

    Returns:
        (nodes, d) sums at all local nodes of the space.
    """
    f, d = fem.Function(W), W.dofmap.bs
    for node_array, node_values in zip(nodes, values, strict=True):
        np.add.at(f.x.array.reshape(-1, d), node_array, node_values)
    f.x.scatter_reverse(la.InsertMode.add)
    f.x.scatter_forward()
    return np.asarray(f.x.array.reshape(-1, d))


@dataclass(frozen=True)
class Displacement(DirectedGoal):
    """Displacement of a point along a direction, as a goal; for a scalar field see `PointValue`.

    Attributes:
        x: (d,) coordinates of the point, in the undeformed mesh of the interface model in d dimensions.
        direction: (d,) the direction, not zero; its length does not matter.
        side: for a point on S, whose displacement has a jump there: "lower" or "upper" side of S; None elsewhere.
        seam: name of the seam on which the point lies; "S": any seam.
    """

    x: Sequence[float]
    direction: Sequence[float] | None = None
    side: str | None = None
    seam: str = S

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the goal, made of its point, side and direction."""
        side = f" {self.side}" if self.side else ""
        quantity = "value" if self.direction is None else "displacement"
        return f"{quantity} at {vector_text(self.x)}{side}{self._direction_text}"

    def check(self, model: InterfaceModel) -> None:
        self.unit(model)
        self._cells(model)

    def _cells(self, model: InterfaceModel) -> LocatedPoints:
        """Return the cells that contain the point; they are searched once for all models on a mesh."""
        cells, point = _CELLS_AT.setdefault(model.domain.mesh, {}), finite_values(self.x, (model.joint.dim,))
        key = None if point is None else (*point,), self.side, self.seam
        if key not in cells:
            cells[key] = cells_at(model, [self.x], self.side, self.seam)
        return cells[key]

    def value(self, state: State, model: InterfaceModel) -> float:
        # on the interface model, as bodies of full models are at other places
        u = displacements_of(state, model)
        return float(displacements_at(u, model, self._cells(model), self.side)[0] @ self.unit(model))

    def scale(self, state: State, model: InterfaceModel) -> float:
        return float(state.u.x.petsc_vec.norm(PETSc.NormType.INFINITY))

    def dual(self, adjoint: Adjoint) -> tuple[PETSc.Vec, PETSc.Vec]:
        model, c = adjoint.model, adjoint.model.n_components
        located = self._cells(model)
        e, V = self.unit(model), model.V
        original = model.domain.original_cells[: model.domain.mesh.topology.index_map(model.joint.dim).size_local]
        local_cell = np.flatnonzero(original == located.entity[0])[:1]  # none on the other ranks
        dofs = (V.dofmap.list[local_cell].ravel()[:, None] * c + np.arange(c)).ravel().astype(np.int64)
        values = (V.ufl_element().basix_element.tabulate(0, located.X[:1])[0, 0, :, 0][:, None] * e).ravel()
        return adjoint.nodal_weights(dofs, values[: len(dofs)]), adjoint.zero_vector()


class PointValue(Displacement):
    """Value of a scalar field at a point, such as a temperature, as a goal.

    Args:
        x: (d,) coordinates of the point, in the undeformed mesh of the interface model in d dimensions.
        side: for a point on S the side, "lower" or "upper"; None elsewhere.
        seam: for a point on S the name of the seam.

    Example:
        >>> from forms import Conduction
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, estimate, goals, solve
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=Conduction(0.05), supports={"BOTTOM": 20, "LEFT/UPPER": 80}
        ... )
        >>> state = solve(plates.interface(ThinLayer(Conduction(2e-4), eps=0.1)))
        >>> hot, inflow = goals.PointValue((2, 1.5)), goals.Inflow("BOTTOM")
        >>> result = estimate(state, goals=[hot, inflow, goals.MeanFlux()])
        >>> [round(goal.value, 3) for goal in result.goals.values()]
        [74.485, -0.411, 0.103]
    """

    def __init__(self, x: Sequence[float], side: str | None = None, seam: str = S) -> None:
        super().__init__(x, None, side, seam)


class Inflow(Reaction):
    """Flow that enters the structure where supports or a film hold a scalar field, as a goal.

    Args:
        place: name of a facet set, or NAME/REGION, its part on one body; or the coordinates of a vertex.

    An example is that of `PointValue`.
    """

    def __init__(self, place: Place) -> None:
        super().__init__(place)


class MeanFlux(MeanTraction):
    """Mean flux of a scalar field along the normal of a seam, as a goal.

    Args:
        seam: name of the seam; "S": all seams with layers.
        where: function of coordinates x (d, m) of m nodes of S that is true on a stretch of the seam; None: all of it.

    An example is that of `PointValue`.
    """

    def __init__(self, seam: str = S, where: Callable[[Array], npt.ArrayLike] | None = None) -> None:
        super().__init__(None, seam, where)


@dataclass(frozen=True)
class Functional(Goal):
    """Functional of the displacements that the user defines as a UFL form, as a goal.

    Attributes:
        name: name of the goal.
        of: function (u, model) of the displacements and the interface model that returns a form without test functions,
            on the model's measures `model.dx(model.domain.region_tags(name))`, `model.ds(model.domain.values(name))`,
            ... In axisymmetry the goal is the integral over the whole revolution, with the factor 2 pi r.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, estimate, goals, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> def top(u, model):
        ...     return u[1] * model.ds(model.domain.values("TOP"))
        >>> result = estimate(state, goals=[goals.Functional("top", top)])
        >>> f"{result.goals['top'].relative:.2g}"  # change by meshing the layer
        '0.0064'
    """

    name: str
    of: Callable[[fem.Function, InterfaceModel], Expr]

    def check(self, model: InterfaceModel) -> None:
        self._form(fem.Function(model.V), model)

    def _form(self, u: fem.Function, model: InterfaceModel) -> Expr:
        require(callable(self.of), f"the goal {self.name!r}", self.of, "it must be a function (u, model) -> UFL form")
        try:
            form = self.of(u, model)
        except Exception as error:
            raise InputError(f"the goal {self.name!r}: its function (u, model) fails: {error}") from error
        is_valid = isinstance(form, ufl.Form) and not form.arguments()
        require(is_valid, f"the goal {self.name!r}", form, "it must be a UFL form without test functions")
        return checked_user_form(form, model.domain, model.kinematics, f"the goal {self.name!r}")

    def value(self, state: State, model: InterfaceModel) -> float:
        form = self._form(displacements_of(state, model), model)
        return float(model.comm.allreduce(fem.assemble_scalar(compiled(form))))

    def scale(self, state: State, model: InterfaceModel) -> float:
        u = displacements_of(state, model)
        weights = nodal_forces(model.V, self.derivative(u, model))
        return float(model.comm.allreduce(float(np.abs(weights.x.petsc_vec.array_r * u.x.petsc_vec.array_r).sum())))

    def is_linear(self, model: InterfaceModel) -> bool:
        u = fem.Function(model.V)
        hessian = ufl.derivative(self.derivative(u, model), u, ufl.TrialFunction(model.V))
        return bool(expand_derivatives(hessian).empty())

    def derivative(self, u: fem.Function, model: InterfaceModel) -> Expr:
        """Return the derivative at displacements `u`, a UFL form with one test function."""
        v = ufl.TestFunction(model.V)
        derivative = expand_derivatives(ufl.derivative(self._form(u, model), u, v))
        zero_form = ufl.inner(fem.Constant(model.domain.mesh, np.zeros(model.n_components)), v) * model.dx
        return zero_form if derivative.empty() else derivative

    def dual(self, adjoint: Adjoint) -> tuple[PETSc.Vec, PETSc.Vec]:
        return adjoint.form_weights(self.derivative(adjoint.state.u, adjoint.model)), adjoint.zero_vector()
