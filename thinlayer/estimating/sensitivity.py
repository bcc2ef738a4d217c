"""Sensitivities: states in which a parameter of an interface model differs a little, along a march if need be."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial

from dolfinx import fem

from forms.base import InputError, require
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import Configuration, State
from thinlayer.estimating.derivative import (
    LayerOfFactor,
    changed_model,
    chosen_changes,
    equations_of,
    residual_at,
    steps_of,
)
from thinlayer.estimating.goals import Goal
from thinlayer.estimating.parameters import BEND_MESSAGE, BEND_TOLERANCE, FACTORS, SLOPE_ROUNDING, STEP, Change
from thinlayer.parts.part import TimeStep
from thinlayer.solving.adjoint import Adjoint
from thinlayer.solving.equations import Equations
from thinlayer.solving.history import History, Solution, state_at
from thinlayer.solving.petsc import Options
from thinlayer.system.progress import report

StatePair = tuple[State, State]


@dataclass(frozen=True)
class Sensitivity:
    """Linearised states for a relative change of parameters, the result of `sensitivity`.

    Attributes:
        solution: the state, or the history of a march.
        pairs: name of a parameter -> time -> states for this parameter times 1 + h and 1 - h, h = 1e-4. States at rest
            have none, as they do not change.
    """

    solution: Solution
    pairs: Mapping[str, Mapping[float, StatePair]]

    def of(self, goal: Goal | Callable[[State], float], t: float | None = None) -> dict[str, float]:
        """Return the derivatives of a goal by relative changes of the parameters, by their names. Collective.

        Args:
            goal: the goal, or a function of a state.
            t: time of the state at which it is taken; None: the last.

        Raises:
            InputError: there is no state at the time.
        """
        value = goal.value_in if isinstance(goal, Goal) else goal
        pairs = {name: self._pair(name, t) for name in self.pairs}
        return {name: (value(plus) - value(minus)) / (2 * STEP) for name, (plus, minus) in pairs.items()}

    def displacement(self, name: str, t: float | None = None) -> fem.Function:
        """Return the change of the displacements per relative change of a parameter, a function in the model's space.

        Args:
            name: the parameter.
            t: time of the state at which it is taken; None: the last.
        """
        require(name in self.pairs, "displacement", name, f"give one of {', '.join(self.pairs)}")
        plus, minus = self._pair(name, t)
        change = plus.u.copy()
        change.x.array[:] = (plus.u.x.array - minus.u.x.array) / (2 * STEP)
        return change

    def _pair(self, name: str, t: float | None) -> StatePair:
        state = state_at(self.solution, t)
        return self.pairs[name].get(state.t, (state, state))


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
    and few parameters, `derivative` for one result and many parameters. Errors are those of `derivative`, but up to 1e-4
    in marches of laws with powers of stresses that pass through zero, as `Norton`.

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
    return sensitivity_by(solution, partial(chosen_changes, names=parameters, of=of or {}), options)


def sensitivity_by(
    solution: Solution, choose: Callable[[InterfaceModel], Mapping[str, Change]], options: Options | None = None
) -> Sensitivity:
    """Compute a sensitivity by functions that change parameters, which `choose` returns for the model. Collective."""
    model, steps = steps_of(solution)
    changes, ends = choose(model), dict[str, list[Equations]]()
    pairs: dict[str, dict[float, StatePair]] = {name: {} for name in changes}
    with ExitStack() as stack:  # equations serve all steps of a march
        for state, old in steps:
            with Adjoint(state, old, options) as tangent:
                for name, change in changes.items():
                    if name not in ends:
                        models = [changed_model(model, change, factor) for factor in FACTORS]
                        ends[name] = [stack.enter_context(equations_of(changed)) for changed in models]
                    pairs[name][state.t] = _pair(tangent, ends[name], [None, *pairs[name].values()][-1])
                    if len(steps) == 1:
                        stack.close()
    return Sensitivity(solution, pairs)


def _pair(tangent: Adjoint, ends: Sequence[Equations], before: StatePair | None) -> StatePair:
    """Return the linearised states at the end of a step for a parameter times 1 + h and 1 - h. Collective.

    Args:
        tangent: the linearised step.
        ends: equations for the parameter times 1 + h and 1 - h.
        before: the same states at the start of the step; None: the step begins at rest.
    """
    interval, bc_dofs = tangent.interval, tangent.equations.bc_dofs
    starts: Sequence[Configuration] = before or [equations.rest_state(interval.old.t) for equations in ends]
    for equations, old in zip(ends, starts, strict=True):
        equations.begin(TimeStep(old, interval.t, interval.dt, interval.theta))
    residuals = [residual_at(equations, tangent.unknowns.copy()) for equations in ends]
    slope, base_residual = residuals[1] - residuals[0], residual_at(tangent.equations, tangent.unknowns.copy())
    slope.array[bc_dofs] = 0.0
    dx, pair = tangent.solve(slope), list[State]()
    dx.array[bc_dofs] = ends[0].prescribed - ends[1].prescribed
    for sign, equations in zip((0.5, -0.5), ends, strict=True):
        x = tangent.unknowns + sign * dx
        residual = residual_at(equations, x)
        error = tangent.equations.relative_norm(residual - base_residual)
        if error > BEND_TOLERANCE * max(tangent.equations.relative_norm(slope), SLOPE_ROUNDING):
            raise InputError(BEND_MESSAGE.format(interval.t))
        work = equations.comm.allreduce(float(residual.array_r[bc_dofs] @ x.array_r[bc_dofs]))
        _, end = equations.end_parts(equations.u, interval.t)
        new = {name: getattr(end, name) for name in ("u", "fields", "memory", "stresses", "stored")}
        new |= {"model": equations.model, "reactions": equations.reactions(), "prescribed_work": work}
        pair.append(replace(tangent.state, **new))
    return pair[0], pair[1]
