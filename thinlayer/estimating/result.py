"""Class `Estimate`, the result of `estimate`: errors in numbers and sentences, bounds, and densities on S."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from typing import NamedTuple

from forms.base import Array, require
from geometry.refusals import require_known
from thinlayer.discretisation.full_model import LayerModel
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import ThinLayer
from thinlayer.discretisation.state import State
from thinlayer.errors import warn
from thinlayer.estimating.continuum import (
    DEFAULT_STEPS,
    Continuum,
    ContinuumBounds,
    continuum_bounds,
    relative_errors_between,
    with_law_alone,
)
from thinlayer.estimating.global_local import DEFAULT_WIDTH, BodyEquilibrium, GlobalLocal, GoalBounds
from thinlayer.estimating.goals import Goal
from thinlayer.estimating.surface_errors import change_density
from thinlayer.output.surface import Surface
from thinlayer.solving.adjoint import Adjoint
from thinlayer.solving.layer_subproblem import DirichletLayers, LayerSubproblem
from thinlayer.solving.petsc import Options
from thinlayer.system.table import Table
from thinlayer.system.units import percent

ESTIMATED_FIELDS = ("traction", "flux", "jump")  # quantities that estimates have, besides goals
ZERO_GOAL_TOLERANCE = 1e-6  # goal over its scale that counts as zero
DENSITY_TOLERANCE = 0.2  # relative error of the integral of a density above which there is a warning
FIXED_GOAL_TOLERANCE = 1e-10  # change of a goal, over its scale, that is only rounding: equilibrium determines the goal


class GoalError(NamedTuple):
    """Value of a goal Q with the interface law, and estimate and bounds of its value with the layer meshed.

    u_0 is the state passed to `estimate`, u_1 the estimated state with the layer meshed.

    Attributes:
        value: Q(u_0).
        better: Q(u_1).
        scale: reference magnitude for rounding errors of both, see `Goal.scale`.
        lower, upper: bounds of Q with the layer meshed; nan: there are none.
    """

    value: float
    better: float
    scale: float
    lower: float = math.nan
    upper: float = math.nan

    @property
    def bounded(self) -> bool:
        """Whether the goal has bounds."""
        return math.isfinite(self.lower)

    @property
    def between(self) -> tuple[float, float]:
        """Smallest and largest relative error of the goal that its bounds allow.

        The error is |Q - Q_0|/|Q|, for a value Q within the bounds and the value Q_0 with the interface law.
        """
        return relative_errors_between(self.value, self.lower, self.upper)

    @property
    def change(self) -> float:
        """Estimated change of the goal if the layer is meshed, in the goal's unit."""
        return self.better - self.value

    @property
    def relative(self) -> float:
        """Estimated |change| of the goal over its |value| with the layer meshed; nan if the goal is zero."""
        if self.zero:
            return math.nan
        return 0.0 if self.fixed else abs(self.change / self.better) if self.better else math.inf

    @property
    def zero(self) -> bool:
        """Whether the goal is zero up to rounding, with the interface law and with the layer meshed."""
        return max(abs(self.value), abs(self.better)) <= ZERO_GOAL_TOLERANCE * self.scale

    @property
    def at_most(self) -> float:
        """Upper bound of the relative error of the goal; the estimated error if there are no bounds."""
        return self.between[1] if self.bounded and not self.fixed else self.relative

    @property
    def fixed(self) -> bool:
        """Whether meshing the layer does not change the goal (up to rounding), as equilibrium alone determines it."""
        return abs(self.change) <= FIXED_GOAL_TOLERANCE * self.scale


class LayerError(NamedTuple):
    """Estimated errors of the traction t, or of a scalar field's flux, and the jump [u] on the seam of one layer.

    u_0 is the state passed to `estimate`, u_1 the estimated state with the layer meshed.

    Attributes:
        layer: the layer that was meshed.
        traction: |t(u_1) - t(u_0)|/|t(u_0)| in the L2 norm on the seam; nan if the layer bears no traction.
        jump: |[u_1] - [u_0]|/|[u_0]| in the L2 norm on the seam; nan for bonded bodies.
    """

    layer: ThinLayer
    traction: float
    jump: float


@dataclass(frozen=True, repr=False)
class Estimate:
    """Estimated error of dropping the mesh of a layer, the result of `estimate`.

    Attributes:
        state: u_0, the state passed to `estimate`, or the last one of the history.
        better: u_1, a state of the same interface model, whose bodies are in equilibrium with the meshed layers.
        layers: name of a seam -> errors of traction and jump there.
        goals: name of a goal -> its error.
        traction: relative error of the traction, or of a scalar field's flux, in the L2 norm on all seams of the
            estimate together, see `LayerError`.
        jump: the same of the jump.
        seconds: wall time of the estimate, in seconds.
        inside: state of the meshed layers, with u_1 on their faces: for `Probe`, pictures, files.
        energy: bounds of the potential energy of u_0, with the layers meshed, above its minimum. The upper bound also
            holds for half the squared energy norm of the error in the bodies. None for linear laws, whose goals have
            bounds, or if not known.
    """

    state: State
    better: State
    layers: Mapping[str, LayerError]
    goals: Mapping[str, GoalError]
    traction: float
    jump: float
    seconds: float
    inside: State
    energy: GoalBounds | None
    _subproblem: LayerSubproblem
    _initial: State  # state from which steps led to `better`
    _previous: State | None  # previous state of `state`, or of the state solved in place of bonds; None: rest
    _iterate: BodyEquilibrium  # the last iterate
    _adjoint_solutions: Mapping[str, BodyEquilibrium]  # adjoint solutions of the goals
    _goals: Mapping[str, Goal]
    _options: Options | None

    @property
    def cost(self) -> float:
        """Wall time of the estimate, divided by the time of solving for `state`."""
        return self.seconds / self.state.report.seconds

    @property
    def dropped(self) -> str:
        """Text that says which laws or bonds replace the layers in `state`, for example "order 0"."""
        bonds, layers = self.state.model.bonds, self.state.model.layers
        orders = sorted({layer.thin_layer.order for layer in layers.values() if layer.thin_layer})
        laws = [f"order {' and '.join(map(str, orders))}"] if layers else []
        bonded = " of " + ", ".join(bonds) if layers else ""
        return ", ".join([f"perfect bond{bonded}", *laws] if bonds else laws)

    # ---------------------------------------------------------------- where
    def density(self, goal: str = "compliance") -> Array:
        """Return the density on S, per area, of the estimated change of a goal by meshing the layer. Collective.

        It shows where the change arises. Its integral over S is the change: exactly if model and goal are linear,
        otherwise to first order in the change. A warning is issued if the integral is off by more than a fifth.

        Args:
            goal: name of the goal.

        Returns:
            (m,) values at the m nodes of `Surface(estimate.better.model)`, whose methods `integral` and `along` take
            them.

        Raises:
            InputError: no such goal.
        """
        require_known("goal", goal, self._goals, "estimate")
        with Adjoint(self._initial if self.state.model.bonds else self.state, self._previous, self._options) as adjoint:
            iteration = GlobalLocal(adjoint, self._subproblem)
            density = change_density(iteration, self.state, self.better, self._adjoint_solutions[goal])
            linear = iteration.model.linear and self._goals[goal].is_linear(iteration.model)
        total, error = Surface(self.better.model).integral(density), self.goals[goal]
        if abs(total - error.change) > DENSITY_TOLERANCE * abs(error.change) + ZERO_GOAL_TOLERANCE * error.scale:
            text = f"the density of the change of {goal} adds up to {total:.3g}, not to {error.change:.3g}"
            why = "a support holds one side of a bond's end" if linear else "laws or the goal are not linear"
            warn("density", f"{text}, as {why}; it only shows where changes come from", self.better.model.comm)
        return density

    def by_seam(self, goal: str = "compliance") -> dict[str, float]:
        """Return the parts of a goal's change that come from the layers of single seams. Collective.

        Args:
            goal: name of the goal.

        Returns:
            Name of a seam -> its part of the change; the parts add up to the integral of `density`.

        Raises:
            InputError: no such goal.
        """
        surface = Surface(self.better.model)
        changes = surface.at_points(self.density(goal)) * surface.weights
        return {name: float(changes[surface.seams == name].sum()) for name in self.layers}

    def with_finer_ends(self, goal: str = "compliance", at_ends: float = 1 / 16) -> float:
        """Return the value of a goal with a layer that is meshed more finely at free ends and junctions. Collective.

        Its difference from `GoalError.better` is, to second order, the error that the layer's own coarser cells cause
        there. The bodies' cells stay the same.

        Args:
            goal: name of the goal.
            at_ends: largest extent of the layer's cells at free ends and junctions, over the thickness, > 0.

        Raises:
            InputError: no such goal, or a goal without bounds; `at_ends` is no number > 0, or too small.
        """
        bounded_goals = [name for name, error in self.goals.items() if error.bounded]
        require_known("goal with bounds", goal, bounded_goals, "estimate, of linear laws")
        coarse, z, model = self._subproblem, self._adjoint_solutions[goal], self.better.model
        assert isinstance(model, InterfaceModel)
        layers = {name: error.layer for name, error in self.layers.items()}
        fine = DirichletLayers(LayerModel(model, layers, coarse.cells_through, at_ends), self.state.t)
        coarse_w = coarse.dirichlet_displacements(coarse.to_layers(self.better.u.x.array), coarse.load, coarse.side_u)
        coarse_w_z, goal_values = coarse.dirichlet_displacements(z.face_u, z.load, z.side_u), []
        fine_vectors = coarse.interpolate_to_refined(coarse_w, fine), coarse.interpolate_to_refined(coarse_w_z, fine)
        for subproblem, w, w_z in ((coarse, coarse_w, coarse_w_z), (fine, *fine_vectors)):
            load_z, side_u_z = self._goals[goal].layer_weights(subproblem)
            w = subproblem.dirichlet_displacements(w, subproblem.load, subproblem.side_u)
            w_z = subproblem.dirichlet_displacements(w_z, load_z, side_u_z)
            goal_values.append(load_z @ w - w_z @ (subproblem.K @ w - subproblem.load))
        return float(self.goals[goal].better + goal_values[1] - goal_values[0])

    def continuum(
        self, names: Sequence[str] | None = None, *, steps: int = DEFAULT_STEPS, law: bool = False
    ) -> dict[str, ContinuumBounds]:
        """Return bounds of the goals of the continuum, which hold for any mesh: errors of the laws and of all cells.

        The structure must be of straight triangles, quadrilaterals or tetrahedra, with linear laws. Goals must be the
        compliance, reactions, or integrals of displacements. The whole structure is not solved again.

        Args:
            names: names of the goals; None: all goals of the estimate.
            steps: number of steps that improve tractions between cells; more steps give narrower bounds.
            law: whether to bound the error of the interface laws alone, too, see `ContinuumBounds.of_law`: of the
                compliance, for laws of order 0, loads on the bodies, and supports that do not move.

        Returns:
            Name of a goal -> its bounds; their text says which cells cause the width of the interval.

        Raises:
            InputError: a structure or goal without such bounds, with a key and a remedy.

        Example:
            >>> from forms import LinearElastic
            >>> from geometry import sandwich
            >>> from thinlayer import Structure, ThinLayer, estimate, solve
            >>> steel = LinearElastic.young(E=210e3, nu=0.3)
            >>> glue = LinearElastic.young(E=2e3, nu=0.4)
            >>> plates = Structure(
            ...     sandwich(4, 1, 2, h=0.5),
            ...     body=steel,
            ...     supports={"BOTTOM": 0},
            ...     tractions={"TOP": (3, -10)},
            ... )
            >>> result = estimate(solve(plates.interface(ThinLayer(glue, eps=0.05))))
            >>> bounds = result.continuum()["compliance"]
            >>> f"{bounds.lower:.4g} to {bounds.upper:.4g} for any mesh"
            '0.0163 to 0.01668 for any mesh'
        """
        require(isinstance(steps, int) and steps >= 0, "continuum: steps", steps, "allowed: whole numbers >= 0")
        goals = self._goals if names is None else {name: self._goals[name] for name in self._known_goals(names)}
        model = self.better.model
        assert isinstance(model, InterfaceModel)
        continuum = Continuum(model, self._subproblem, self.state.t, steps)
        values = {name: error.value for name, error in self.goals.items()}
        bounds = continuum_bounds(continuum, self._initial, values, goals, self._iterate, self._adjoint_solutions)
        return with_law_alone(continuum, self.state, goals, bounds) if law else bounds

    def _known_goals(self, names: Sequence[str]) -> Sequence[str]:
        require(not isinstance(names, str), "continuum: names", names, "give a list of names")
        for name in names:
            require_known("goal", name, self._goals, "estimate")
        return names

    # ---------------------------------------------------------------- words
    @property
    def table(self) -> Table:
        """Table with a row for each traction, jump and goal, and for the energy if it has bounds.

        Its columns are "quantity" (name), "value" (with interface laws), "better" (with the layer meshed), "error"
        (relative), and the bounds "lower" and "upper"; nan stands for numbers that do not exist.
        """
        nan, rows, traction = math.nan, [], self._traction_name
        for name, error in self.layers.items():
            seam = f" {name}" if len(self.layers) > 1 else ""
            field_errors = (traction, error.traction), ("jump", error.jump)
            rows += [(f"{quantity}{seam}", nan, nan, value, nan, nan) for quantity, value in field_errors]
        for name, goal in self.goals.items():
            rows.append((name, goal.value, goal.better, goal.relative, goal.lower, goal.upper))
        if energy := self.energy:
            rows.append(("energy above the least", energy.estimate, 0.0, nan, energy.lower, energy.upper))
        columns = ("quantity", "value", "better", "error", "lower", "upper")
        return Table([dict(zip(columns, row, strict=True)) for row in rows])

    @property
    def caveats(self) -> list[str]:
        """Sentences on the limits of the estimate, for example that goals have no bounds; [] if there are none."""
        caveats = []
        laws = [term.law for term in self.better.model.terms]
        if self.state.sudden and any(law.traits.remembers and not law.traits.bounded for law in laws):
            caveats.append("at t = 0+, just after sudden loads; for later times march, and give the history")
        if self.energy:
            bounds_text = f"{self.energy.lower:.3g} to {self.energy.upper:.3g}"
            caveats.append(f"laws are not linear: goals have no bounds, the energy is {bounds_text} above the least")
        elif not all(goal.bounded for goal in self.goals.values()):
            caveats.append("goals without bounds")
        return caveats

    @cached_property
    def sentences(self) -> list[str]:
        """The errors, the cells for which they hold, and the caveats, as a list of sentences."""
        errors = self._fields_text(self) + [_goal_text(name, goal) for name, goal in self.goals.items()]
        sentences = [f"{self.dropped}: {', '.join(errors)}"]
        for name, error in self.layers.items():
            seam_text = f" {name}" if len(self.layers) > 1 else ""
            if math.isnan(error.traction):
                sentences.append(f"the layer{seam_text} bears no {self._traction_name}")
            elif seam_text:
                sentences.append(f"{name}: {', '.join(self._fields_text(error))}")
        through = self._subproblem.cells_through
        numbers = [through] if isinstance(through, int) else sorted({len(levels) - 1 for levels in through.values()})
        cells_text = f"for these cells of the bodies, and {' or '.join(map(str, numbers))} cells through the layer"
        return [*sentences, cells_text, *self.caveats]

    @property
    def _traction_name(self) -> str:
        return self.state.model.kinematics.quantities.traction

    def _fields_text(self, errors: Estimate | LayerError) -> list[str]:
        named_errors = ((self._traction_name, errors.traction), ("jump", errors.jump))
        return [f"{percent(error)} in {name}" for name, error in named_errors if math.isfinite(error)]

    def __str__(self) -> str:
        return "; ".join(self.sentences)

    def __repr__(self) -> str:
        return f"Estimate({self})"

    def _repr_html_(self) -> str:
        """Return sentences and table as HTML, which notebooks display."""
        return "<br>".join(map(escape, self.sentences)) + self.table._repr_html_().replace(">nan<", "><")


def _goal_text(name: str, goal: GoalError) -> str:
    if goal.zero or goal.fixed:
        return f"{name} is zero" if goal.zero else f"no change in {name}"
    if goal.bounded and goal.upper - goal.lower > DEFAULT_WIDTH * abs(goal.change):
        return f"between {' and '.join(map(percent, goal.between))} in {name}"
    return f"{percent(goal.relative)} in {name}"
