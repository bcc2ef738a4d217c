"""Bounds of goals against the continuum: the errors of interface laws and of all cells in a single interval.

Let U be displacements of bodies and layers that are continuous and fit the supports, e(U) their strains, C the
stiffness, and s a stress in equilibrium with the loads. Let g be the energy norm of d = s - C e(U), and Z, d_z and g_z
the same for the adjoint problem of a goal Q. The goal of the continuum is within (Prager and Synge 1947)

    Q(U) + f . Z - a(U, Z) + <d, d_z>/2 -+ g g_z/2.

Here f are the loads, a(U, Z) is the work of the stresses of U in the strains of Z, and <d, d_z> is the integral of
d : C^-1 : d_z. U is an iterate of `GlobalLocal` in the bodies, and in the layers what its face displacements cause. The
stress s is made from the bodies' stress, and from that of the layers under the iterate's face forces; both are in
equilibrium at all nodes. Tractions that balance each cell follow from them, and then a stress in equilibrium in each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from dolfinx import fem

from forms.base import Array
from geometry.joint import Joint
from thinlayer.bounding.loops import TractionImprovement
from thinlayer.bounding.stresses import Stresses
from thinlayer.bounding.structure_cells import StructureCells, refusal
from thinlayer.bounding.subcells import Subcells
from thinlayer.bounding.tractions import CellLoads, TractionBalance
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.estimating.global_local import BodyEquilibrium
from thinlayer.estimating.goals import Compliance, Functional, Goal, Reaction
from thinlayer.solving.layer_subproblem import LayerSubproblem
from thinlayer.system.units import percent

MAX_IMBALANCE = 1e-7  # largest unbalanced force on a node of a cell, over the largest force on a node
IMBALANCE_FACTOR = 10  # bounds are widened by this times the imbalance and the geometric mean of both energies
DEFAULT_STEPS = 8  # number of conjugate-gradient steps on tractions
MAX_FACTORED_CELLS = 20_000  # number of cells in 2D up to which a factor of all tractions replaces most of these steps


def relative_errors_between(value: float, lower: float, upper: float) -> tuple[float, float]:
    """Return the smallest and the largest relative error |Q - value|/|Q| for Q between two bounds."""
    errors = [abs(q - value) / abs(q) if q else math.inf for q in (lower, upper)]
    least = 0.0 if lower <= value <= upper else min(errors)
    return least, math.inf if lower < 0 < upper else max(errors)


@dataclass(frozen=True, repr=False)
class ContinuumBounds:
    """Bounds of a goal of the continuum, with layers of their real thickness, whatever the cells are.

    The continuum has the shape of the straight cells.

    Attributes:
        value: the goal with the interface laws, in the state passed to `estimate`.
        lower, upper: bounds of the goal of the continuum.
        bodies, layer, law: shares of the interval, with the sum 1: from the cells of the bodies, from those of the
            layers, and from the difference between interface laws and meshed layers.
        by_cell: (nc,) parts of `upper - lower` from the nc cells of `joint`: refine where they are large.
        imbalance: largest unbalanced force on a node of a cell, over the largest force on a node: rounding.
        joint: bodies and meshed layers, with all cells.
        of_law: bounds of Q_0/Q - 1, without the error of any mesh: Q_0 is the goal with interface laws on bodies that
            are a continuum, too. None: they were not asked for.
    """

    value: float
    lower: float
    upper: float
    bodies: float
    layer: float
    law: float
    by_cell: Array = field(compare=False)
    imbalance: float
    joint: Joint = field(compare=False)
    of_law: tuple[float, float] | None = None

    @property
    def between(self) -> tuple[float, float]:
        """Smallest and largest relative error of the goal with the interface laws that the bounds allow."""
        return relative_errors_between(self.value, self.lower, self.upper)

    def __str__(self) -> str:
        bodies, layer, law = (f"{100 * share:.0f} %" for share in (self.bodies, self.layer, self.law))
        shares = f"{bodies} of the interval from the bodies' cells, {layer} from the layer's, {law} from the law"
        text = f"between {' and '.join(map(percent, self.between))} for any mesh; {shares}"
        law_errors = [] if self.of_law is None else [f"{100 * error:+.4g} %" for error in self.of_law]
        return f"{text}; the law alone, without any mesh: {' to '.join(law_errors)}" if law_errors else text

    def __repr__(self) -> str:
        return f"ContinuumBounds({self.lower:.6g} to {self.upper:.6g}; {self})"


class _ConstitutiveError(NamedTuple):
    """Error in the constitutive relation between displacements and a stress in equilibrium, with its squared norms.

    Attributes:
        U: (nc, n, d) displacements of the cells' nodes.
        loads: the loads.
        difference: stress in equilibrium minus stress of the displacements.
        squares: (nc,) squared energy norms of the difference in each cell.
        law_square: squared energy norm of the stress of the layers under face forces, minus that under face
            displacements.
        imbalance: see `ContinuumBounds`.
    """

    U: Array
    loads: CellLoads
    difference: Array
    squares: Array
    law_square: float
    imbalance: float


class Continuum:
    """Bounds of goals against the continuum, from the iterates and adjoint solutions of an estimate.

    Args:
        model: the interface model.
        layers: its layers, meshed by themselves and linearised.
        t: time of loads and supports.
        steps: number of conjugate-gradient steps that improve tractions; more steps give narrower bounds.

    Raises:
        InputError: the structure has no such bounds; the error's `key` names the condition.
    """

    def __init__(self, model: InterfaceModel, layers: LayerSubproblem, t: float, steps: int = DEFAULT_STEPS) -> None:
        if not (model.linear and model.symmetric):
            raise refusal("not linear", "laws are not linear, or not symmetric", "use estimate(...).energy")
        self._model, self._layers, self._steps = model, layers, steps
        self.structure = StructureCells(model, layers, t)
        self._subcells = Subcells(self.structure.cells, self.structure.is_free)
        self._stresses = Stresses(self._subcells.cells)
        self._balance = TractionBalance(self.structure.cells, self.structure.is_free)

    @cached_property
    def _improvement(self) -> TractionImprovement:
        subcells = self._subcells
        is_layer, d = np.repeat(self.structure.is_layer, subcells.count), subcells.cells.d
        coupled = np.ones_like(is_layer) if d == 2 and len(is_layer) <= MAX_FACTORED_CELLS else is_layer
        return TractionImprovement(self._stresses, subcells.is_free, coupled)

    def constitutive_error(self, iterate: BodyEquilibrium, loads: CellLoads) -> _ConstitutiveError:
        """Return the error between displacements that fit the supports and a stress in equilibrium with the loads.

        Args:
            iterate: an iterate, or the adjoint solution of a goal.
            loads: the loads, or the goal's weights.

        Raises:
            InputError: the iterate is not in equilibrium at all nodes.
        """
        layers, stresses, subcells = self._layers, self._stresses, self._subcells
        w = layers.dirichlet_displacements(iterate.face_u, iterate.load, iterate.side_u)
        r = iterate.F - layers.dirichlet_reactions(iterate.face_u, iterate.load, iterate.side_u)
        w_of_forces = w + layers.neumann_displacements(layers.free_face_values(r))
        U, U_of_forces = (self.structure.displacements(iterate.u, layer) for layer in (w, w_of_forces))
        stress = self.structure.stress(iterate.u, w_of_forces) - loads.eigenstress[:, None]
        moments, imbalance = self._balance.moments(stress, loads, U)
        _require_balance(imbalance, "use a thicker layer, or less contrast")
        of_faces = subcells.stress(self.structure.stress(iterate.u, w) - loads.eigenstress[:, None], U)
        stress, U, loads = subcells.stress(stress, U_of_forces), subcells.displacements(U), subcells.loads(loads)
        moments = subcells.moments(moments, stress, loads)
        seed, of_U = stresses.of(stress), stresses.of(stresses.cells.stress(U) - loads.eigenstress[:, None])
        difference = self._improvement.improved(loads, moments, seed, self._steps) - of_U
        of_law = seed - stresses.of(of_faces)  # whose pressures differ from those of U by the mesh
        law_square = float(stresses.product(of_law, of_law).sum())
        return _ConstitutiveError(U, loads, difference, stresses.product(difference, difference), law_square, imbalance)

    def loads_of(self, goal: Goal) -> CellLoads:
        """Return the weights of a goal as loads.

        Raises:
            InputError: a goal that has no finite weights in the continuum, or one that depends on the mesh.
        """
        structure = self.structure
        if isinstance(goal, Compliance):
            return replace(structure.loads, eigenstress=structure.no_loads.eigenstress)
        loads = structure.no_loads
        if isinstance(goal, Functional) and goal.is_linear(self._model):
            form = goal.derivative(fem.Function(self._model.V), self._model)
            structure.add_densities(loads, form, self._model)
        elif not isinstance(goal, Reaction):
            remedy = "take goals.Functional, the mean over a facet set or region"
            raise refusal("goal", f"{goal.name} has no bounds in the continuum, which has no single points", remedy)
        return loads

    def law_bounds(self, state: State) -> tuple[float, float]:
        """Return bounds of the compliance of the bodies with interface laws of order 0, whatever the cells are.

        `state` is a state of the interface model.

        Raises:
            InputError: as `StructureCells.with_law`, or forces on nodes are not in balance.
        """
        assert isinstance(state.model, InterfaceModel)
        cells, U, loads = self.structure.with_law(state.model, state.u.x.array)
        subcells, stress = Subcells(cells, loads.is_free), cells.stress(U)
        moments, imbalance = TractionBalance(cells, loads.is_free).moments(stress, loads, U)
        _require_balance(imbalance, "use order=0, and laws without memory")
        stress, U, loads = subcells.stress(stress, U), subcells.displacements(U), subcells.loads(loads)
        stresses = Stresses(subcells.cells)
        moments, seed = subcells.moments(moments, stress, loads), stresses.of(stress)
        improvement = TractionImprovement(stresses, loads.is_free, np.zeros(len(U), bool))
        difference = improvement.improved(loads, moments, seed, self._steps) - seed
        value, square = loads.work(subcells.cells, U), float(stresses.product(difference, difference).sum())
        rounding = IMBALANCE_FACTOR * imbalance * value
        return value - rounding, value + square + rounding

    def bounds(self, value: float, at_rest: float, a: _ConstitutiveError, z: _ConstitutiveError) -> ContinuumBounds:
        """Return the bounds of a goal.

        Args:
            value: the goal with the interface laws.
            at_rest: the goal at zero displacements.
            a: constitutive error of the iterate, under the loads.
            z: constitutive error of the adjoint solution, under the goal's weights.
        """
        stresses, cells = self._stresses, self._stresses.cells
        g, g_z = (math.sqrt(part.squares.sum()) for part in (a, z))
        energies = [
            float((cells.nodal_forces(cells.stress(U)) * V).sum()) for U, V in ((a.U, z.U), (a.U, a.U), (z.U, z.U))
        ]
        middle = at_rest + z.loads.work(cells, a.U) + a.loads.work(cells, z.U) - energies[0]
        middle += float(stresses.product(a.difference, z.difference).sum()) / 2
        imbalance = max(a.imbalance, z.imbalance)
        half = g * g_z / 2 + IMBALANCE_FACTOR * imbalance * math.sqrt(abs(energies[1] * energies[2]))
        by_cell = (a.squares * _ratio(g_z, g) + z.squares * _ratio(g, g_z)) / 2
        by_cell = by_cell.reshape(-1, self._subcells.count).sum(axis=1)
        total = max(float(by_cell.sum()), 1e-300)
        law = min((a.law_square * _ratio(g_z, g) + z.law_square * _ratio(g, g_z)) / 2 / total, 1.0)
        bodies = float(by_cell[~self.structure.is_layer].sum()) / total
        layer = max(1 - bodies - law, 0.0)
        law, joint = 1 - bodies - layer, self._layers.model.inflated_joint
        return ContinuumBounds(value, middle - half, middle + half, bodies, layer, law, by_cell, imbalance, joint)


def _require_balance(imbalance: float, remedy: str) -> None:
    """Raise InputError if forces on nodes of cells are not in balance up to rounding, so that bounds would not hold."""
    if not imbalance <= MAX_IMBALANCE:
        reason = f"forces on nodes of cells are not in balance: {imbalance:.1g} of them is left"
        raise refusal("balance", f"{reason}, allowed: {MAX_IMBALANCE:g}", remedy)


def _ratio(a: float, b: float) -> float:
    return a / b if b else 0.0


def continuum_bounds(
    continuum: Continuum,
    state: State,
    values: Mapping[str, float],
    goals: Mapping[str, Goal],
    iterate: BodyEquilibrium,
    adjoint_solutions: Mapping[str, BodyEquilibrium],
) -> dict[str, ContinuumBounds]:
    """Return the bounds of goals of the continuum by the goals' names.

    Args:
        continuum: the cells of the structure.
        state: a state of the interface model, which has the time.
        values: name of a goal -> its value with the interface laws.
        goals: name -> goal.
        iterate: iterate of `GlobalLocal`.
        adjoint_solutions: name of a goal -> its adjoint solution.
    """
    weights = {name: continuum.loads_of(goal) for name, goal in goals.items()}
    primal, bounds = continuum.constitutive_error(iterate, continuum.structure.loads), {}
    for name, goal in goals.items():
        z = adjoint_solutions[name]
        is_primal = isinstance(goal, Compliance) and iterate.is_near(z)
        dual = primal if is_primal else continuum.constitutive_error(z, weights[name])
        assert isinstance(state.model, InterfaceModel)
        bounds[name] = continuum.bounds(values[name], goal.at_rest(state, state.model), primal, dual)
    return bounds


def with_law_alone(
    continuum: Continuum, state: State, goals: Mapping[str, Goal], bounds: Mapping[str, ContinuumBounds]
) -> dict[str, ContinuumBounds]:
    """Return bounds of the compliance that also tell the error of the interface laws alone, see `ContinuumBounds`.

    Raises:
        InputError: a goal other than the compliance, or laws without such bounds.
    """
    if other := [name for name, goal in goals.items() if not isinstance(goal, Compliance)]:
        raise refusal("law alone", f"{other[0]} is not the compliance", "ask for the compliance alone by names=")
    lower, upper = continuum.law_bounds(state)
    return {name: replace(b, of_law=(lower / b.upper - 1, upper / b.lower - 1)) for name, b in bounds.items()}
