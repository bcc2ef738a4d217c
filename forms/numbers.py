"""Numbers of UFL expressions: each part is evaluated once.

UFL's own evaluation does that again at each occurrence and component, which takes seconds for turned tensors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.classes import (
    AndCondition,
    ComponentTensor,
    Conditional,
    Division,
    Indexed,
    IndexSum,
    Label,
    ListTensor,
    MultiIndex,
    NotCondition,
    OrCondition,
    Product,
    ScalarValue,
    Sum,
    Terminal,
    Variable,
    Zero,
)
from ufl.core.multiindex import Index
from ufl.corealg.traversal import unique_post_traversal

from forms.kinematics import Expr

Values = npt.NDArray[Any]
FUNCTIONS: dict[type, Any] = {
    Sum: np.add,
    Product: np.multiply,
    Division: np.divide,
    Conditional: np.where,
    AndCondition: np.logical_and,
    OrCondition: np.logical_or,
    NotCondition: np.logical_not,
}


def numbers(expression: Expr, values: Mapping[Expr, Values] | None = None) -> Values:
    """The numbers of an expression after `expand_derivatives`; NaN or infinite where a function has none.

    Args:
        expression: the expression.
        values: numbers of its symbols.

    Raises:
        Exception: of any type, from UFL: a part, such as a coefficient, has no number.
    """
    known: dict[Any, Any] = dict(values or {})  # axes of each array: those of the part's shape, then its free indices
    with np.errstate(all="ignore"):
        for part in unique_post_traversal(expression):
            if part not in known:
                known[part] = _numbers(part, [known[operand] for operand in part.ufl_operands])
    return np.asarray(known[expression])


def _numbers(part: Any, operands: list[Any]) -> Any:
    if isinstance(part, MultiIndex):
        return part.indices()
    if isinstance(part, Label):
        return None
    if isinstance(part, Variable):
        return operands[0]
    if isinstance(part, (ScalarValue, Zero)) and not part.ufl_free_indices:
        return np.full(part.ufl_shape, _real(part.value()) if isinstance(part, ScalarValue) else 0.0)
    if isinstance(part, Terminal):
        places = np.ndindex(*part.ufl_shape)
        return np.reshape([_real(part((0.0,), component=place)) for place in places], part.ufl_shape)
    if isinstance(part, ListTensor):
        return np.stack(operands)
    free = [*part.ufl_free_indices]
    if isinstance(part, (Indexed, ComponentTensor, IndexSum)):
        values, indices = operands
        inner, named = [*part.ufl_operands[0].ufl_free_indices], [i.count() for i in indices if isinstance(i, Index)]
        if isinstance(part, Indexed):
            place = tuple(slice(None) if isinstance(i, Index) else int(i) for i in indices)
            return _summed(values[place], named + inner, free)
        if isinstance(part, ComponentTensor):
            return _summed(values, inner, named + free)
        shape = [-1 - k for k in range(len(part.ufl_shape))]
        return _summed(values, shape + inner, shape + free)
    if not isinstance(part, Sum):  # whose operands have the same indices
        operands = [
            _spread(values, of, len(part.ufl_shape), free)
            for values, of in zip(operands, part.ufl_operands, strict=True)
        ]
    function = FUNCTIONS.get(type(part)) or np.vectorize(lambda *values: _scalar(part, values))
    return function(*operands)


def _summed(values: Values, axes: list[int], kept: list[int]) -> Values:
    """Values whose axes are named, summed over those that are not kept."""
    places = {name: k for k, name in enumerate(dict.fromkeys(axes))}
    return np.einsum(values, [places[name] for name in axes], [places[name] for name in kept])


def _spread(values: Any, operand: Any, axes: int, free: list[int]) -> Values:
    """Values with so many axes of their shape, and one for each free index, also for those they do not depend on."""
    shape = operand.ufl_shape
    own = dict(zip(operand.ufl_free_indices, np.shape(values)[len(shape) :], strict=True))
    return np.reshape(values, [*[1] * (axes - len(shape)), *shape, *(own.get(name, 1) for name in free)])


def _scalar(part: Any, values: tuple[Any, ...]) -> Any:
    """A function of scalars, or a comparison, at numbers; NaN where it has none."""
    try:
        found = part._ufl_expr_reconstruct_(*map(ufl.as_ufl, map(float, values)))
        value = found.evaluate((0.0,), {}, (), {})
        return value if isinstance(value, (bool, np.bool_)) else _real(value)
    except (ValueError, ZeroDivisionError, OverflowError):
        return math.nan


def _real(value: Any) -> float:
    return math.nan if isinstance(value, complex) else float(value)
