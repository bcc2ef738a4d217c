"""Sensitivities: states in which a parameter of an interface model differs a little, along a march if need be."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem

from forms.base import InputError, require
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import Configuration, State
from thinlayer.estimating.derivative import LayerOfFactor, changed_model, chosen_changes, equations_of, steps_of
from thinlayer.estimating.goals import Goal
from thinlayer.estimating.parameters import FACTORS, STEP, Change
from thinlayer.parts.compiled_part import KINK_MESSAGE, KINK_TOLERANCE
from thinlayer.parts.part import TimeStep
from thinlayer.solving.adjoint import Adjoint
from thinlayer.solving.equations import Equations
from thinlayer.solving.history import TIME_TOLERANCE, History
from thinlayer.solving.petsc import Options
from thinlayer.system.progress import report

SLOPE_ROUNDING = 1e-8  # residuals of changed models, over the forces, below which no kink is sought
StatePair = tuple[State, State]


@dataclass(frozen=True)
class Sensitivity:
    """Linearised states for a relative change of parameters, the result of `sensitivity`.

    Attributes:
        states: the states, one for each step; their last is the solution's last.
        pairs: name of a parameter -> for each step, the states for this parameter times 1 + h and 1 - h, h = 1e-4.
    """

    states: Sequence[State]
    pairs: Mapping[str, Sequence[StatePair]]

    def of(self, goal: Goal | Callable[[State], float], t: float | None = None) -> dict[str, float]:
        """Return the derivatives of a goal by relative changes of the parameters, by their names. Collective.

        Args:
            goal: the goal, or a function of a state.
            t: time of the state at which it is taken; None: the last.

        Raises:
            InputError: there is no state at the time.
        """
        k = self._position(t)

        def value(state: State) -> float:
            if isinstance(goal, Goal):
                assert isinstance(state.model, InterfaceModel)
                return goal.value(state, state.model)
            return goal(state)

        return {name: (value(pairs[k][0]) - value(pairs[k][1])) / (2 * STEP) for name, pairs in self.pairs.items()}

    def displacement(self, name: str, t: float | None = None) -> fem.Function:
        """Return the change of the displacements per relative change of a parameter, a function in the model's space.

        Args:
            name: the parameter.
            t: time of the state at which it is taken; None: the last.
        """
        require(name in self.pairs, "displacement", name, f"give one of {', '.join(self.pairs)}")
        plus, minus = self.pairs[name][self._position(t)]
        change = fem.Function(self.states[0].model.V)
        change.x.array[:] = (plus.u.x.array - minus.u.x.array) / (2 * STEP)
        return change

    def _position(self, t: float | None) -> int:
        if t is None:
            return len(self.states) - 1
        times = np.array([state.t for state in self.states])
        k = int(np.abs(times - t).argmin())
        if abs(times[k] - t) > TIME_TOLERANCE * max(abs(t), float(np.ptp(times))):
            known_times = ", ".join(f"{time:g}" for time in times)
            raise InputError(f"sensitivity: no state at t = {t:g}; there are states at {known_times}")
        return k


@report("sensitivity")
def sensitivity(
    solution: State | History,
    parameters: Sequence[str] | None = None,
    *,
    of: Mapping[str, LayerOfFactor] | None = None,
    options: Options | None = None,
) -> Sensitivity:
    """Compute how a state, or all states of a march, change with parameters. Collective.

    Each parameter costs a solve with the factor of the tangent and two residuals in each step. Use it for many results
    and few parameters, `derivative` for one result and many parameters.

    Args:
        solution, parameters, of, options: as in `derivative`.

    Raises:
        InputError: as in `derivative`.

    Example:
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, ThinLayer, goals, sensitivity, solve
        >>> steel = LinearElastic.young(E=210e3, nu=0.3)
        >>> glue = LinearElastic.young(E=2e3, nu=0.4)
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")
        >>> plates = Structure(
        ...     joint, body=steel, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10)}
        ... )
        >>> state = solve(plates.interface(ThinLayer(glue, eps=0.05)))
        >>> change = sensitivity(state, ["S.E", "S.eps"])
        >>> corner = goals.Displacement((4, 2), (0, 1))
        >>> {name: f"{slope:.3g}" for name, slope in change.of(corner).items()}
        {'S.E': '0.000221', 'S.eps': '-0.000221'}
    """
    model, _ = steps_of(solution)
    return sensitivity_by(solution, chosen_changes(model, parameters, of or {}), options)


def sensitivity_by(solution: State | History, changes: Mapping[str, Change], options: Options | None) -> Sensitivity:
    """Compute a sensitivity by the functions that change the parameters. Collective."""
    model, steps = steps_of(solution)
    pairs: dict[str, list[StatePair]] = {name: [] for name in changes}
    with ExitStack() as march:  # whose equations serve all its steps
        ends = {name: _pair_of_equations(march, model, change) for name, change in changes.items() if len(steps) > 1}
        for state, old in steps:
            with Adjoint(state, old, options) as tangent:
                for name, change in changes.items():
                    with ExitStack() as step:
                        plus, minus = ends.get(name) or _pair_of_equations(step, model, change)
                        pairs[name].append(_pair(tangent, plus, minus, pairs[name][-1] if pairs[name] else None))
    return Sensitivity([state for state, _ in steps], pairs)


def _pair_of_equations(stack: ExitStack, model: InterfaceModel, change: Change) -> list[Equations]:
    return [stack.enter_context(equations_of(changed_model(model, change, factor))) for factor in FACTORS]


def _pair(tangent: Adjoint, plus: Equations, minus: Equations, before: StatePair | None) -> StatePair:
    """Return the linearised states at the end of a step for a parameter times 1 + h and 1 - h. Collective.

    Args:
        tangent: the linearised step.
        plus, minus: equations for the parameter times 1 + h and 1 - h.
        before: the same states at the start of the step; None: the step begins at rest.
    """
    interval, bc_dofs = tangent.interval, tangent.equations.bc_dofs
    starts: Sequence[Configuration] = before or [end.rest_state(interval.old.t) for end in (plus, minus)]
    ends = []
    for equations, old in zip((plus, minus), starts, strict=True):
        equations.begin(TimeStep(old, interval.t, interval.dt, interval.theta))
        x, residual = equations.create_vector(), equations.create_vector()
        x.array[:] = tangent.unknowns.array_r
        x.array[bc_dofs] = equations.prescribed
        equations.residual(x, residual)
        ends.append((equations, x, residual))
    (_, x, residual), (_, other_x, other_residual) = ends
    moved, slope = x - other_x, other_residual - residual
    slope.array[bc_dofs] = 0.0
    dx, base_residual = tangent.solve(slope), tangent.equations.create_vector()
    tangent.equations.residual(tangent.unknowns, base_residual)
    dx.array[bc_dofs] = moved.array_r[bc_dofs]
    pair = []
    for sign, (equations, x, residual) in zip((0.5, -0.5), ends, strict=True):
        x.array[:] = tangent.unknowns.array_r + sign * dx.array_r
        x.array[bc_dofs] = equations.prescribed
        equations.residual(x, residual)
        error = tangent.equations.relative_norm(residual - base_residual)
        if error > KINK_TOLERANCE * max(tangent.equations.relative_norm(slope), SLOPE_ROUNDING):
            raise InputError(KINK_MESSAGE.format("a law", interval.t))
        work = equations.comm.allreduce(float(residual.array_r[bc_dofs] @ x.array_r[bc_dofs]))
        _, end = equations.end_parts(equations.u, interval.t)
        new = {name: getattr(end, name) for name in ("u", "fields", "memory", "stresses", "stored")}
        new |= {"model": equations.model, "reactions": equations.reactions(), "prescribed_work": work}
        pair.append(replace(tangent.state, **new))
    return pair[0], pair[1]
