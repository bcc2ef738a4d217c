"""Two models, each with results of the other, are solved in turn until they agree."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from forms.base import Array, InputError, require
from thinlayer.errors import SolveError

MAX_UNSTABLE_STEPS = 5  # number of successive steps with s > 1 after which the equilibrium counts as unstable
MIN_INDEPENDENT_SHARE = 0.05  # least part of a change that newer ones do not span, over its norm, for it to be used


class Coupled(NamedTuple):
    """Solutions of two models that agree with each other.

    Attributes:
        first, second: what the two functions returned: states or histories.
        value: the exchanged values, which both solutions have in common.
        s: measured derivative d(out)/d(in) of the values that come out of a step by those that go in; of several values
            the real part of an eigenvalue: one above 1 if there is one, otherwise the largest in modulus. NaN: a single
            solution of each model was sufficient.
        steps: number of steps, each with one solution of both models.
    """

    first: Any
    second: Any
    value: Array
    s: float
    steps: int


def coupled(
    first: Callable[[Array], Any],
    second: Callable[[Any], Any],
    exchange: Callable[[Any], npt.ArrayLike],
    begin: npt.ArrayLike,
    *,
    rtol: float = 1e-6,
    max_steps: int = 40,
) -> Coupled:
    """Solve two models in turn until the values agree that one takes from the other. Collective.

    A step is `exchange(second(first(values)))`. Earlier steps tell how the values that come out depend on those that
    go in: s = d(out)/d(in). The next values are those at which both would be equal: for a single value the change is
    multiplied by 1/(1 - s). So solutions are found also for s < -1, where solving in turn alone diverges. An
    equilibrium with s > 1 is unstable, and the values run away from it: the result is another equilibrium, or an error
    with s in its message.

    Marches are coupled as a whole: both functions march with the same times, and the values are those at all times,
    such as `[surface.jump(state)[1] for state in history]`.

    Args:
        first: function of the exchanged values that solves the first model and returns its state or history.
        second: function of this state or history that solves the second model and returns its own.
        exchange: function of the second state or history that returns the values, a number or an array.
        begin: values of the first step, a number or an array.
        rtol: largest distance of values from those at which both would be equal, over the norm of these.
        max_steps: largest number of steps.

    Raises:
        InputError: an argument of the wrong kind; values that are not finite, or change their shape.
        SolveError: no agreement after `max_steps`; or the equilibrium is unstable, s > 1.

    Example:
        >>> import numpy as np
        >>> from forms import Conductance, Conduction, LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Structure, Surface, ThermalExpansion, ThinLayer
        >>> from thinlayer import coupled, solve
        >>> joint = sandwich(4, 1, 2, h=0.5, cell="quadrilateral")  # mm
        >>> plates = Structure(
        ...     joint, body=Conduction(k=0.05), supports={"BOTTOM": 20, "TOP": 80}
        ... )
        >>> clamps = {"BOTTOM": 0, "TOP": 0}
        >>> surface = Surface(plates.bonded())
        >>> def heat(opening):  # gas of 0.03e-3 W/(mm K) in a gap
        ...     h = surface.function(0.03e-3 / (0.01 + np.maximum(opening, 0)))
        ...     return solve(plates.interface(Conductance(h)))
        >>> def mechanics(heat_state):
        ...     cooled = ThermalExpansion(12e-6, heat_state, reference=80)
        ...     steel = LinearElastic.young(E=210e3, nu=0.3)
        ...     bars = Structure(joint, body=steel, supports=clamps, eigenstrain=cooled)
        ...     return solve(bars.interface(ThinLayer(LinearElastic(1.0, 1.0), eps=0.01)))
        >>> pair = coupled(heat, mechanics, lambda state: surface.jump(state)[1], begin=0)
        >>> f"{pair.first.reaction('TOP').flow:.3f} W/mm, {pair.steps} steps"
        '0.554 W/mm, 4 steps'
    """
    for name, function in (("first", first), ("second", second), ("exchange", exchange)):
        require(callable(function), f"coupled: {name}", function, "give a function")
    values = _checked(begin, None)
    inputs, outputs, unstable, s = list[Array](), list[Array](), 0, math.nan
    for step in range(1, max_steps + 1):
        solution = first(values)
        other = second(solution)
        out = _checked(exchange(other), None if values.ndim == 0 else values.shape)
        inputs, outputs = [*inputs, np.broadcast_to(values, out.shape).ravel()], [*outputs, out.ravel()]
        slopes, values = _next_values(inputs, outputs)
        s = float(max(slopes.real, key=lambda slope: math.inf if slope > 1 else abs(slope), default=s))
        unstable = unstable + 1 if s > 1 else 0
        agree = np.linalg.norm(values - inputs[-1]) <= rtol * np.linalg.norm(values)
        if unstable > MAX_UNSTABLE_STEPS or (agree and unstable):
            reason = f"coupled: s = {s:.3g} > 1 after {step} steps: the values run away from an unstable equilibrium"
            raise SolveError(reason, advice="begin near a stable one, if there is one")
        if agree:
            return Coupled(solution, other, out, s, step)
        if unstable:  # away from this equilibrium, to another one
            values, inputs, outputs = outputs[-1], inputs[-1:], outputs[-1:]
        values = values.reshape(out.shape)
    raise SolveError(f"coupled: no agreement after {max_steps} steps, with s = {s:.3g}; begin nearer to a solution")


def _checked(values: npt.ArrayLike, shape: tuple[int, ...] | None) -> Array:
    """Return exchanged values as an array, or raise InputError if they are not finite or not of the shape."""
    try:
        array = np.array(values, float)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"coupled: exchanged values are {values!r:.80}; give numbers, or arrays of one shape"
        ) from error
    require(np.isfinite(array).all(), "coupled: exchanged values", array, "they must be finite")
    require(shape in (None, array.shape), "coupled: shape of exchanged values", array.shape, f"before it was {shape}")
    return array


def _next_values(inputs: list[Array], outputs: list[Array]) -> tuple[Array, Array]:
    """Return the measured eigenvalues of d(out)/d(in), and the values at which both would be equal (Anderson mixing).

    Args:
        inputs, outputs: values (n,) that went in and came out in the steps before; the last ones are the newest.
    """
    basis, columns = np.zeros((len(inputs[-1]), 0)), list[tuple[Array, Array]]()
    for x, y in zip(inputs[-2::-1], outputs[-2::-1], strict=True):  # newest first: they tell best how it is now
        dx, dy = x - inputs[-1], y - outputs[-1]
        rest = dx - basis @ (basis.T @ dx)
        if np.linalg.norm(rest) > MIN_INDEPENDENT_SHARE * np.linalg.norm(dx):
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
            columns.append((dx, dy))
    change = outputs[-1] - inputs[-1]
    if not columns:
        return np.empty(0), outputs[-1]
    dx, dy = (np.column_stack(part) for part in zip(*columns, strict=True))
    slopes = np.linalg.eigvals(np.linalg.lstsq(dx, dy, rcond=None)[0])
    weights = np.linalg.lstsq(dy - dx, -change, rcond=None)[0]
    return slopes, outputs[-1] + dy @ weights
