"""Laws at one point with symbols for all their numbers: their tangents, their values, and what they depend on.

Tangents at rest, and after a time step, classify layers as soft, stiff or nearly incompressible.

`evaluate` computes each part of an expression once. UFL's own evaluation repeats this at each occurrence and component,
which takes seconds for rotated tensors.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import basix.ufl
import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms import expand_derivatives
from ufl.classes import (
    AndCondition,
    ComponentTensor,
    Conditional,
    ConstantValue,
    Division,
    Index,
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
from ufl.corealg.traversal import traverse_unique_terminals, unique_post_traversal

from forms.base import Array, InputError
from forms.kernel import KernelLaw
from forms.law import BulkLaw, Step
from forms.parameter_fields import ParameterValue
from forms.tensors import Expr, average_lame, isotropic_tensor, mandel_tensor, mandel_vectors
from forms.tensors import mandel_vector as in_mandel

_SYMBOL_MESH = ufl.Mesh(basix.ufl.element("Lagrange", "interval", 1, shape=(1,)))  # symbols need a mesh


class SymbolicLaw(NamedTuple):
    """A law and a time step at one point, with symbols for all parameters and inputs.

    Attributes:
        law: the law, with symbols for its parameters.
        step: the step, with symbols for its values.
        strain: strain (6,) at the end of the step, a UFL variable for differentiation.
        numbers: vector of all inputs: e (6), e_old (6), internal variables, n (3), dt, theta, parameters. Tensors are
            in Mandel's order.
    """

    law: BulkLaw
    step: Step
    strain: Expr
    numbers: Expr


def variable(e: Expr) -> Expr:
    """Wrap an expression like `ufl.variable`, but with a label that is the same in every process.

    UFL counts labels in each process, and FFCx would recompile a law at another count.
    """
    return Variable(e, Label(-1))


@cache
def _symbols(length: int) -> Expr:
    return ufl.Constant(_SYMBOL_MESH, shape=(length,))


def symbolic(law: BulkLaw, values: Array | None = None, d: int | None = 3) -> SymbolicLaw:
    """Symbols for all numbers of a law and of a time step at one point.

    Args:
        law: the law.
        values: numbers, in the order of `SymbolicLaw.numbers`, that replace the symbols; None: symbols.
        d: number of components, 2 or 3, of the layer's unit normal that the law gets; None: no normal.
    """
    shapes = {name: _shape(value) for name, value in law.parameters().items()}
    length = 6 + 6 + law.memory + 3 + 2 + sum(int(np.prod(shape)) for shape in shapes.values())
    numbers = _symbols(length) if values is None else ufl.as_vector([ufl.as_ufl(float(value)) for value in values])
    inputs = iter(numbers[i] for i in range(length))

    def read(shape: tuple[int, ...]) -> Expr:
        return ufl.as_tensor([read(shape[1:]) for _ in range(shape[0])]) if shape else next(inputs)

    new_e, old_e = variable(read((6,))), read((6,))
    q = {name: mandel_tensor(read((6,))) if shape == (3, 3) else read(shape) for name, shape in law.internal.items()}
    normal, dt, theta = read((3,)), read(()), read(())
    n = None if d is None else normal if d == 3 else ufl.as_vector([normal[0], normal[1]])
    step = Step(mandel_tensor(new_e), n, mandel_tensor(old_e), q, dt, theta, law.traits.rate)
    return SymbolicLaw(law.with_parameters({name: read(shape) for name, shape in shapes.items()}), step, new_e, numbers)


def _shape(value: ParameterValue) -> tuple[int, ...]:
    """Shape of a parameter that is a number, an array or a Constant."""
    return tuple(value.ufl_shape) if isinstance(value, Expr) else np.asarray(value).shape


def law_identity(law: BulkLaw) -> tuple[object, ...] | None:
    """Key that is equal for laws of this package with the same equations, whatever the values of their parameters.

    None for user-defined laws, whose methods may read other data.
    """
    if not all(kind.__module__.partition(".")[0] in ("forms", "builtins") for kind in type(law).__mro__):
        return None
    return (type(law), repr(law.choices()), *map(_shape, law.parameters().values()))


def reads_input(law: BulkLaw, name: str) -> bool:
    """Whether the stress or the new internal variables of a law depend on one input of the step.

    Args:
        law: a law in UFL.
        name: "n", the unit normal of the layer, or "dt", the length of the step.
    """
    point = symbolic(law)
    symbol = ufl.Constant(_SYMBOL_MESH, shape=getattr(point.step, name).ufl_shape)
    step = point.step._replace(**{name: symbol})
    outputs = [point.law.stress(point.law.own_step(step)), *point.law.advance(step).values()]
    return any(symbol is node for output in outputs for node in traverse_unique_terminals(ufl.as_ufl(output)))


def require_numbers_alone(law: BulkLaw, numbers: Expr, expressions: Iterable[Expr]) -> None:
    """Raise InputError if the equations of a law contain anything but numbers and the law's inputs.

    Args:
        law: the law, for messages.
        numbers: symbol of all inputs (`SymbolicLaw.numbers`).
        expressions: the equations, UFL.
    """
    for node in (node for expression in expressions for node in traverse_unique_terminals(expression)):
        if node is not numbers and not isinstance(node, (ConstantValue, MultiIndex, Label)):
            text = f"{type(law).__name__} contains {str(node)[:80]}, a {type(node).__name__}"
            raise InputError(f"{text}; a compiled law knows its parameters and step: declare one, or `varies` and `at`")


Values = npt.NDArray[Any]  # floats; of a condition booleans
ARITHMETIC: dict[type, Callable[..., Values]] = {Sum: np.add, Product: np.multiply, Division: np.divide}
LOGIC = {AndCondition: np.logical_and, OrCondition: np.logical_or, NotCondition: np.logical_not}
NUMPY_FUNCTIONS = ARITHMETIC | LOGIC | {Conditional: np.where}


def evaluate(expression: Expr, values: Mapping[Expr, Values] | None = None) -> Values:
    """Numerical values of a UFL expression without derivatives; NaN or infinite where a function is undefined.

    Args:
        expression: the expression, after `expand_derivatives`.
        values: symbol -> its numbers; None: there are no symbols.

    Raises:
        Exception: of any type, from UFL: a part of the expression, such as a coefficient, has no numerical value.
    """
    arrays: dict[Expr, Values] = dict(values or {})  # axes of each array: shape of the part, then its free indices
    with np.errstate(all="ignore"):
        for node in unique_post_traversal(expression):
            if node not in arrays:
                arrays[node] = _evaluate_node(node, [arrays[operand] for operand in node.ufl_operands])
    return np.asarray(arrays[expression])


def _evaluate_node(node: Expr, operands: list[Values]) -> Values:
    """Values of a node of an expression from the values of its operands.

    Their axes are the shape of the node, then one axis for each free index. A `MultiIndex` gives its indices, a `Label`
    nothing.
    """
    if isinstance(node, (MultiIndex, Label)):
        return node.indices() if isinstance(node, MultiIndex) else np.empty(0)
    if isinstance(node, Variable):
        return operands[0]
    if isinstance(node, (ScalarValue, Zero)) and not node.ufl_free_indices:
        return np.full(node.ufl_shape, _real(node.value()) if isinstance(node, ScalarValue) else 0.0)
    if isinstance(node, Terminal):
        components = np.ndindex(*node.ufl_shape)
        return np.reshape([_real(node((0.0,), component=component)) for component in components], node.ufl_shape)
    if isinstance(node, ListTensor):
        return np.stack(operands)
    if isinstance(node, (Indexed, ComponentTensor, IndexSum)):
        return _evaluate_indexing(node, *operands)
    if not isinstance(node, Sum):  # operands of a sum have the same free indices
        pairs, free_indices = zip(operands, node.ufl_operands, strict=True), [*node.ufl_free_indices]
        operands = [_broadcast(values, operand, len(node.ufl_shape), free_indices) for values, operand in pairs]
    function = NUMPY_FUNCTIONS.get(type(node)) or np.vectorize(lambda *values: _scalar_function(node, values))
    return np.asarray(function(*operands))


def _evaluate_indexing(node: Expr, values: Values, indices: Iterable[Expr]) -> Values:
    """Values of a UFL `Indexed`, `ComponentTensor` or `IndexSum`.

    Args:
        node: the node.
        values: values of its operand: axes of the shape, then of the free indices.
        indices: its indices.
    """
    free, operand_free = [*node.ufl_free_indices], [*node.ufl_operands[0].ufl_free_indices]
    named = [i.count() for i in indices if isinstance(i, Index)]
    if isinstance(node, Indexed):
        selection = tuple(slice(None) if isinstance(i, Index) else int(i) for i in indices)
        return _index_sum(values[selection], named + operand_free, free)
    if isinstance(node, ComponentTensor):
        return _index_sum(values, operand_free, named + free)
    shape = [-1 - k for k in range(len(node.ufl_shape))]
    return _index_sum(values, shape + operand_free, shape + free)


def _index_sum(values: Values, axes: list[int], kept: list[int]) -> Values:
    """Sum an array over all axes that are not kept, and order the others.

    Args:
        values: the array.
        axes: a number for each axis; axes with equal numbers form a diagonal.
        kept: numbers of the axes of the result.
    """
    axis_numbers = {name: k for k, name in enumerate(dict.fromkeys(axes))}
    return np.einsum(values, [axis_numbers[name] for name in axes], [axis_numbers[name] for name in kept])


def _broadcast(values: Values, operand: Expr, axes: int, free: list[int]) -> Values:
    """Reshape an operand's values so that they broadcast with those of other operands.

    Args:
        values: the values: axes of the operand's shape, then of its free indices.
        operand: the operand.
        axes: number of axes of the shape of the result.
        free: free indices of the result; those that the operand lacks become axes of length 1.
    """
    shape = operand.ufl_shape
    sizes = dict(zip(operand.ufl_free_indices, np.shape(values)[len(shape) :], strict=True))
    return np.reshape(values, [*[1] * (axes - len(shape)), *shape, *(sizes.get(name, 1) for name in free)])


def _scalar_function(node: Expr, values: tuple[float, ...]) -> float:
    """Value of a function of scalars, or of a comparison, at numbers; NaN where it is undefined.

    Args:
        node: UFL node of the function.
        values: its arguments.
    """
    try:
        value = node._ufl_expr_reconstruct_(*map(ufl.as_ufl, map(float, values))).evaluate((0.0,), {}, (), {})
        return bool(value) if isinstance(value, (bool, np.bool_)) else _real(value)
    except (ValueError, ZeroDivisionError, OverflowError):
        return math.nan


def _real(value: complex) -> float:
    return math.nan if isinstance(value, complex) else float(value)


PROBE_STRAIN = 1e-6 * np.array([1.0, -0.7, 0.4, 0.5, -0.3, 0.6])  # too small to yield; norms have no derivative at 0
COUPLING_TOLERANCE = 1e-9  # share of a traction, or component of a unit normal, below which it counts as zero
# a negative eigenvalue beyond this share of the tangent's largest entry is not a rounding error
EIGENVALUE_TOLERANCE = 1e-6
LONG_TIME_STEP = 1e30  # length of a time step in which rates are practically zero


def tangent_at_rest(law: BulkLaw, n: Array) -> Array | None:
    """Tangent d stress/d strain (6, 6) of a law for small strains from rest, in Mandel's order.

    For a law with internal variables it is the instantaneous tangent. For a law with a rate it is the tangent at zero
    rates. For an incompressible layer the stress excludes the pressure. If the law declares no stiffness, its stress is
    differentiated, which takes some milliseconds.

    Args:
        law: the law, with numbers for parameters.
        n: unit normal (d,) of the layer in d dimensions.

    Returns:
        The tangent; None if it cannot be evaluated.
    """
    if (C := law.in_space.stiffness(n)) is not None:
        return law.condensed(C)
    return _rest_tangent(law, n, LONG_TIME_STEP if law.traits.rate else 0.0)


def tangent_over(law: BulkLaw, n: Array, dt: float) -> Array | None:
    """Tangent d stress/d strain (6, 6) of a linear law at the end of one time step from rest, in Mandel's order.

    It is the effective stiffness of a law that creeps or relaxes, under loads that last for dt.

    Args:
        law: a compiled law, with numbers for parameters.
        n: unit normal (d,) of the layer in d dimensions.
        dt: length of the step, > 0.

    Returns:
        The tangent; None if the law is not linear or cannot be evaluated.
    """
    return _rest_tangent(law, n, dt) if law.traits.linear else None


def _rest_tangent(law: BulkLaw, n: Array, dt: float) -> Array | None:
    """Tangent (6, 6) at the end of a step of length dt from rest, as the mean over two small opposite strains.

    n (d,) is the unit normal of the layer. None if the tangent cannot be evaluated.
    """
    law_3d = law.in_space
    if not law_3d.traits.in_ufl:
        return None
    try:
        numeric_law = law_3d.mapped(lambda value, _: np.asarray(getattr(value, "value", value), float))
        point = symbolic(numeric_law, d=3 if law_3d.traits.compiled else len(n))
        stress = in_mandel(point.law.stress(point.law.own_step(point.step)))
        tangent: Expr = expand_derivatives(ufl.diff(stress, point.strain))
        with warnings.catch_warnings(action="ignore"):  # UFL warns of roots of negative numbers
            start = np.concatenate([np.zeros(6 + law_3d.memory), np.pad(n, (0, 3 - len(n))), [dt, 1.0]])
            inputs = [np.concatenate([e, start, numeric_law.parameter_values()]) for e in (PROBE_STRAIN, -PROBE_STRAIN)]
            C = np.mean([evaluate(tangent, {point.numbers: values}) for values in inputs], axis=0)
    except Exception:  # a part of the law has no numerical value; the model reports such errors
        return None
    return law.condensed(np.asarray(C)) if np.isfinite(C).all() else None


def needs_director(law: BulkLaw) -> bool:
    """Whether the stress of a law depends on the unit normal n of a layer; a `KernelLaw` declares it (`isotropic`)."""
    law_3d = law.in_space
    return not law_3d.isotropic if isinstance(law_3d, KernelLaw) else reads_input(law_3d, "n")


def depends_on_step_length(law: BulkLaw) -> bool:
    """Whether a law creeps or relaxes, so that its response depends on the length of the time step.

    For a `KernelLaw` the class says so (`rate`, `relaxes`).
    """
    law_3d = law.in_space
    return law_3d.traits.rate or (law_3d.relaxes if isinstance(law_3d, KernelLaw) else reads_input(law_3d, "dt"))


def is_checked_at_rest(law: BulkLaw) -> bool:
    """Whether the tangent of a layer's law at rest is computed by `tangent_at_rest` and must not be negative.

    It may be negative for laws that declare `softens`. It is not computed for laws with both internal variables and
    rate. For non-linear laws of jumps it is not computed either, because it is unknown which jumps are small.
    """
    at_jumps = law.traits.of_jumps and not law.traits.linear
    return not (law.traits.softens or (law.traits.rate and law.internal) or at_jumps)


def acoustic_tensor(C: Array, n: Array) -> Array:
    """Acoustic tensor n.C.n (d, d): the derivative of the traction by the jump over the thickness.

    Args:
        C: tangent (6, 6) in Mandel's order.
        n: unit normal (d,) of the layer in d dimensions.
    """
    N = np.array([symmetric_mandel((np.outer(v, n) + np.outer(n, v)) / 2) for v in np.eye(len(n))])
    return np.asarray(N @ C @ N.T)


def declared_or_computed_tangent(law: BulkLaw, n: Array) -> Array | None:
    """Tangent (6, 6) of a law at rest in Mandel's order; None if it is not known.

    If the law does not declare it (`BulkLaw.stiffness`), it is computed from the stress. This is not done for laws
    whose tangent at rest may be negative or is not defined (`is_checked_at_rest`).

    Args:
        law: the law, with numbers for parameters.
        n: unit normal (d,) of the layer in d dimensions.
    """
    return tangent_at_rest(law, n) if is_checked_at_rest(law) else law.stiffness(n)


def require_stable(law: BulkLaw, C: Array | None, n: Array | None = None, slots: Sequence[int] = ()) -> None:
    """Raise InputError if a tangent at rest has a negative eigenvalue; do nothing if it is unknown.

    The real parts of the eigenvalues of the tangent itself are tested, not those of its symmetric part. This part may
    be indefinite in a stable law that has no energy.

    Args:
        law: the law, for messages.
        C: its tangent, (6, 6) in Mandel's order; None: unknown.
        n: unit normal (d,) of a layer, whose acoustic tensor n.C.n is tested; None: a body, whose C is tested.
        slots: for a body, indices of the Mandel components that its strains have.
    """
    if C is None or not np.isfinite(C).all():
        return
    A, of = (C[np.ix_(slots, slots)], "(of C)") if n is None else (acoustic_tensor(C, n), "across the layer (of n.C.n)")
    lowest, size = float(np.linalg.eigvals(A).real.min()), float(np.abs(C).max())
    if lowest < -EIGENVALUE_TOLERANCE * size:
        details = f"the smallest eigenvalue {of} is {lowest:.4g}, the largest entry of C {size:.4g}; allowed: >= 0"
        raise InputError(f"{type(law).__name__}: the stiffness at rest is negative, {details}; check the signs")


def symmetric_mandel(a: Array) -> Array:
    """Mandel vector (6,) of a symmetric numeric tensor, (2, 2) or (3, 3)."""
    return mandel_vectors(np.pad(a, (0, 3 - len(a))))


def is_isotropic(C: Array) -> bool:
    """Whether a tangent (6, 6) in Mandel's order is isotropic, to the relative tolerance `COUPLING_TOLERANCE`."""
    return bool(np.abs(C - isotropic_tensor(*average_lame(C))).max() <= COUPLING_TOLERANCE * np.abs(C).max())


def in_plane_modulus(C: Array, n: Array) -> float:
    """Modulus of a sheet against strains in its plane while its faces are free; in 3D the mean over two directions.

    For an isotropic law it is E/(1 - nu^2).

    Args:
        C: tangent (6, 6) in Mandel's order.
        n: unit normal (d,) of the sheet in d dimensions.
    """
    normal = np.pad(n, (0, 3 - len(n)))
    frame = np.linalg.svd(normal[None])[2]  # first row: n
    axes = frame[1:] if len(n) == 3 else np.array([[n[1], -n[0], 0.0]])
    out = np.array([symmetric_mandel((np.outer(normal, a) + np.outer(a, normal)) / 2) for a in frame])
    reduced = C - (out @ C).T @ np.linalg.pinv(out @ C @ out.T) @ (out @ C)
    return float(np.mean([symmetric_mandel(np.outer(a, a)) @ reduced @ symmetric_mandel(np.outer(a, a)) for a in axes]))
