"""Laws at one point, with symbols for all their numbers: their tangents, their values, and the inputs they depend on.

Tangents for small strains from the unstrained state ("at rest"), and after a time step, show whether a layer is soft,
stiff or nearly incompressible.

`evaluate` computes the numbers of a UFL expression, each part of it once. UFL's own evaluation computes a part anew
wherever it occurs, and for each component. That takes seconds for rotated tensors.
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
from forms.law import BulkLaw, Law, Step
from forms.parameter_fields import ParameterValue
from forms.tensors import VALUE_INDEX, Expr, average_lame, isotropic_tensor, mandel_tensor, mandel_vectors
from forms.tensors import mandel_vector as in_mandel

_SYMBOL_MESH = ufl.Mesh(basix.ufl.element("Lagrange", "interval", 1, shape=(1,)))  # symbols need a mesh


class SymbolicLaw(NamedTuple):
    """A law and a time step at one point, with symbols in place of all parameters and inputs.

    Attributes:
        law: the law, with symbols for its parameters.
        step: the step, with symbols for its values.
        strain: strain (6,) at the end of the step, a UFL variable for differentiation.
        symbols: vector of all symbols: strain at the end (6) and at the beginning (6) of the step, internal variables,
            normal (3), dt, theta, parameters. Symmetric tensors are Mandel vectors.
    """

    law: BulkLaw
    step: Step
    strain: Expr
    symbols: Expr


def variable(e: Expr) -> Expr:
    """Return `e` as a UFL variable, as `ufl.variable` does, but with a label that is the same in every process.

    UFL counts labels anew in each process. With another label the compiler FFCx would compile the same law again.
    """
    return Variable(e, Label(-1))


@cache
def _symbols(length: int) -> Expr:
    return ufl.Constant(_SYMBOL_MESH, shape=(length,))


def symbolic_law(law: BulkLaw, values: Array | None = None) -> SymbolicLaw:
    """Return a law and a time step at one point with symbols in place of all their numbers.

    Args:
        law: the law.
        values: numbers, in the order of `SymbolicLaw.symbols`, to use instead of symbols; None: symbols.
    """
    shapes = {name: _parameter_shape(value) for name, value in law.parameters().items()}
    n_symbols = 6 + 6 + law.memory + 3 + 2 + sum(int(np.prod(shape)) for shape in shapes.values())
    symbols = _symbols(n_symbols) if values is None else ufl.as_vector([ufl.as_ufl(float(value)) for value in values])
    unread_symbols = iter(symbols[i] for i in range(n_symbols))

    def read(shape: tuple[int, ...]) -> Expr:
        return ufl.as_tensor([read(shape[1:]) for _ in range(shape[0])]) if shape else next(unread_symbols)

    new_e, old_e = variable(read((6,))), read((6,))
    q = {name: mandel_tensor(read((6,))) if shape == (3, 3) else read(shape) for name, shape in law.internal.items()}
    normal, dt, theta = read((3,)), read(()), read(())
    step = Step(mandel_tensor(new_e), normal, mandel_tensor(old_e), q, dt, theta, law.traits.rate)
    return SymbolicLaw(law.with_parameters({name: read(shape) for name, shape in shapes.items()}), step, new_e, symbols)


def _parameter_shape(value: ParameterValue) -> tuple[int, ...]:
    """Return the shape of a parameter, which is a number, an array or a DOLFINx Constant."""
    return tuple(value.ufl_shape) if isinstance(value, Expr) else np.asarray(value).shape


def equations_key(law: BulkLaw) -> tuple[object, ...] | None:
    """Return a key that is equal for two laws of this package that have the same equations.

    The values of their parameters may differ. None for user-defined laws, whose methods may depend on other data.
    """
    if not all(kind.__module__.partition(".")[0] in ("forms", "builtins") for kind in type(law).__mro__):
        return None
    return (type(law), repr(law.choices()), *map(_parameter_shape, law.parameters().values()))


def reads_input(law: BulkLaw, name: str) -> bool:
    """Return whether the stress or the new internal variables of a law depend on the normal, or on the step length.

    Args:
        law: a law in UFL.
        name: the input in question: "n", the unit normal of the layer, or "dt", the length of the step.
    """
    symbolic = symbolic_law(law)
    symbol = ufl.Constant(_SYMBOL_MESH, shape=getattr(symbolic.step, name).ufl_shape)
    step = symbolic.step._replace(**{name: symbol})
    outputs = [symbolic.law.stress(symbolic.law.law_step(step)), *symbolic.law.advance(step).values()]
    return any(symbol is node for output in outputs for node in traverse_unique_terminals(ufl.as_ufl(output)))


def require_known_symbols(law: BulkLaw, known_symbols: Expr, expressions: Iterable[Expr]) -> None:
    """Raise InputError if the equations of a law contain other symbols than those of its parameters and of the step.

    Compiled code has no values for anything else, such as a coordinate or a function on the mesh.

    Args:
        law: the law, for messages.
        known_symbols: vector of all allowed symbols (`SymbolicLaw.symbols`).
        expressions: the equations, UFL.
    """
    for node in (node for expression in expressions for node in traverse_unique_terminals(expression)):
        if node is not known_symbols and not isinstance(node, (ConstantValue, MultiIndex, Label)):
            text = f"{type(law).__name__} contains {str(node)[:80]}, a {type(node).__name__}"
            raise InputError(f"{text}; a compiled law knows its parameters and step: declare one, or `varies` and `at`")


Values = npt.NDArray[Any]  # floats; of a condition booleans
NUMPY_ARITHMETIC: dict[type, Callable[..., Values]] = {Sum: np.add, Product: np.multiply, Division: np.divide}
NUMPY_LOGIC = {AndCondition: np.logical_and, OrCondition: np.logical_or, NotCondition: np.logical_not}
NUMPY_FUNCTIONS = NUMPY_ARITHMETIC | NUMPY_LOGIC | {Conditional: np.where}


def evaluate(expression: Expr, values: Mapping[Expr, Values] | None = None) -> Values:
    """Return the numerical values of a UFL expression as an array; NaN or infinite where a function is undefined.

    Args:
        expression: the expression, without derivatives (after `expand_derivatives`).
        values: symbol in the expression -> array of its numbers; None: there are no symbols.

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
    """Return the values of one node of a UFL expression, given the values of its `operands`.

    The axes of all these arrays are those of the node's shape, then one for each free index. For a `MultiIndex` the
    result is the tuple of its indices, for a `Label` an empty array.
    """
    if isinstance(node, (MultiIndex, Label)):
        return node.indices() if isinstance(node, MultiIndex) else np.empty(0)
    if isinstance(node, Variable):
        return operands[0]
    if isinstance(node, (ScalarValue, Zero)) and not node.ufl_free_indices:
        return np.full(node.ufl_shape, _real_or_nan(node.value()) if isinstance(node, ScalarValue) else 0.0)
    if isinstance(node, Terminal):
        components = np.ndindex(*node.ufl_shape)
        return np.reshape([_real_or_nan(node((0.0,), component=component)) for component in components], node.ufl_shape)
    if isinstance(node, ListTensor):
        return np.stack(operands)
    if isinstance(node, (Indexed, ComponentTensor, IndexSum)):
        return _evaluate_indexing(node, *operands)
    if not isinstance(node, Sum):  # operands of a sum have the same free indices
        operand_pairs, free_indices = zip(operands, node.ufl_operands, strict=True), [*node.ufl_free_indices]
        operands = [_broadcast(values, operand, len(node.ufl_shape), free_indices) for values, operand in operand_pairs]
    function = NUMPY_FUNCTIONS.get(type(node)) or np.vectorize(lambda *values: _evaluate_scalar(node, values))
    return np.asarray(function(*operands))


def _evaluate_indexing(node: Expr, values: Values, indices: Iterable[Expr]) -> Values:
    """Return the values of a node that picks or sums components: a UFL `Indexed`, `ComponentTensor` or `IndexSum`.

    Args:
        node: the node.
        values: values of its operand; the axes are those of the operand's shape, then one for each free index.
        indices: indices, fixed or free, that the node applies to the operand.
    """
    free_indices, operand_indices = [*node.ufl_free_indices], [*node.ufl_operands[0].ufl_free_indices]
    applied_indices = [i.count() for i in indices if isinstance(i, Index)]
    if isinstance(node, Indexed):
        selection = tuple(slice(None) if isinstance(i, Index) else int(i) for i in indices)
        return _einsum(values[selection], applied_indices + operand_indices, free_indices)
    if isinstance(node, ComponentTensor):
        return _einsum(values, operand_indices, applied_indices + free_indices)
    shape_labels = [-1 - k for k in range(len(node.ufl_shape))]
    return _einsum(values, shape_labels + operand_indices, shape_labels + free_indices)


def _einsum(values: Values, axes: list[int], kept: list[int]) -> Values:
    """Return a sum over some axes of an array, as `numpy.einsum` does.

    Args:
        values: the array.
        axes: number that names each axis of the array. Axes with equal numbers are replaced by their diagonal.
        kept: numbers of the result's axes, in its order; the sum is over all others.
    """
    einsum_labels = {name: k for k, name in enumerate(dict.fromkeys(axes))}
    return np.einsum(values, [einsum_labels[name] for name in axes], [einsum_labels[name] for name in kept])


def _broadcast(values: Values, operand: Expr, n_axes: int, free_indices: list[int]) -> Values:
    """Return an operand's values, reshaped so that numpy can combine them with those of the node's other operands.

    Args:
        values: the values; the axes are those of the operand's shape, then one for each of its free indices.
        operand: UFL expression of the operand.
        n_axes: number of dimensions that the shape of the node has.
        free_indices: free indices of the node. An index that the operand does not have becomes an axis of length 1.
    """
    shape = operand.ufl_shape
    sizes = dict(zip(operand.ufl_free_indices, np.shape(values)[len(shape) :], strict=True))
    return np.reshape(values, [*[1] * (n_axes - len(shape)), *shape, *(sizes.get(name, 1) for name in free_indices)])


def _evaluate_scalar(node: Expr, values: tuple[float, ...]) -> float:
    """Return the value of a scalar function or comparison for numeric arguments; NaN where it is undefined.

    Args:
        node: UFL node of the function.
        values: its arguments.
    """
    try:
        value = node._ufl_expr_reconstruct_(*map(ufl.as_ufl, map(float, values))).evaluate((0.0,), {}, (), {})
        return bool(value) if isinstance(value, (bool, np.bool_)) else _real_or_nan(value)
    except (ValueError, ZeroDivisionError, OverflowError):
        return math.nan


def _real_or_nan(value: complex) -> float:
    return math.nan if isinstance(value, complex) else float(value)


PROBE_STRAIN = 1e-6 * np.array([1.0, -0.7, 0.4, 0.5, -0.3, 0.6])  # too small to yield; norms have no derivative at 0
SMALL_COMPONENT = 1e-9  # share of a traction, or component of a unit normal, below which it counts as zero
# a negative eigenvalue beyond this share of the tangent's largest entry is not a rounding error
EIGENVALUE_TOLERANCE = 1e-6
LONG_TIME_STEP = 1e30  # length of a time step in which rates are practically zero


def tangent_at_rest(law: BulkLaw, n: Array, value: float = 0.0) -> Array | None:
    """Return the tangent d stress/d strain (6, 6) of a law for small strains from the unstrained state.

    The tangent is in Mandel's order. For a law with internal variables it is the instantaneous tangent. For a law that
    depends on strain rates it is the tangent at zero rates. For an incompressible layer the stress excludes the
    pressure. If the law does not declare its stiffness, its stress is differentiated, which takes some milliseconds.

    Args:
        law: the law, with numbers for parameters.
        n: unit normal (d,) of the layer in d dimensions.
        value: value of a scalar field, at whose zero a law may have no tangent.

    Returns:
        The tangent, stress; None if it cannot be evaluated.
    """
    if (C := law.law_3d.stiffness(n)) is not None:
        return law.condensed(C)
    return _first_step_tangent(law, n, LONG_TIME_STEP if law.traits.rate else 0.0, value)


def tangent_after(law: BulkLaw, n: Array, dt: float) -> Array | None:
    """Return the tangent d stress/d strain (6, 6) of a linear law at the end of a first time step of length `dt`.

    It is the effective stiffness, in Mandel's order, of a law that creeps or relaxes under loads that last for dt.

    Args:
        law: a compiled law, with numbers for parameters.
        n: unit normal (d,) of the layer in d dimensions.
        dt: length of the step, > 0.

    Returns:
        The tangent, stress; None if the law is not linear or the tangent cannot be evaluated.
    """
    return _first_step_tangent(law, n, dt) if law.traits.linear else None


def _first_step_tangent(law: BulkLaw, n: Array, dt: float, value: float = 0.0) -> Array | None:
    """Return the tangent (6, 6) of a law at the end of a first step of length `dt`, for small strains.

    It is the mean of the tangents at two opposite small strains. `n` (d,) is the unit normal of the layer; `value` is
    that of a scalar field. None: the tangent cannot be evaluated.
    """
    law_3d = law.law_3d
    if not law_3d.traits.in_ufl:
        return None
    try:
        numeric_law = law_3d.mapped(lambda value, _: np.asarray(getattr(value, "value", value), float))
        symbolic = symbolic_law(numeric_law)
        stress = in_mandel(symbolic.law.stress(symbolic.law.law_step(symbolic.step)))
        tangent: Expr = expand_derivatives(ufl.diff(stress, symbolic.strain))
        with warnings.catch_warnings(action="ignore"):  # UFL warns of roots of negative numbers
            e_0 = value * np.eye(6)[VALUE_INDEX]
            fixed = np.concatenate([e_0, np.zeros(law_3d.memory), np.pad(n, (0, 3 - len(n))), [dt, 1.0]])
            inputs = [
                np.concatenate([e, fixed, numeric_law.parameter_values()])
                for e in (e_0 + PROBE_STRAIN, e_0 - PROBE_STRAIN)
            ]
            C = np.mean([evaluate(tangent, {symbolic.symbols: values}) for values in inputs], axis=0)
    except Exception:  # a part of the law has no numerical value; the model reports such errors
        return None
    return law.condensed(np.asarray(C)) if np.isfinite(C).all() else None


def depends_on_normal(law: BulkLaw) -> bool:
    """Return whether the stress of a law depends on the unit normal n of a layer.

    A `KernelLaw` declares this itself (`isotropic`).
    """
    law_3d = law.law_3d
    return not law_3d.isotropic if isinstance(law_3d, KernelLaw) else reads_input(law_3d, "n")


def depends_on_step_length(law: BulkLaw) -> bool:
    """Return whether a law creeps or relaxes, so that its response depends on the length of the time step.

    A `KernelLaw` declares this itself (`rate`, `relaxes`).
    """
    law_3d = law.law_3d
    return law_3d.traits.rate or (law_3d.relaxes if isinstance(law_3d, KernelLaw) else reads_input(law_3d, "dt"))


def is_checked_at_rest(law: BulkLaw) -> bool:
    """Return whether a layer's law has a tangent for small strains that can be computed and must not be negative.

    The tangent may be negative for a law that declares `softens`. It is not computed for a law with internal variables
    and a rate. Nor is it computed for a non-linear law of jumps, for which no jump is known to be small, or of a scalar
    field, which need not be near zero.
    """
    has_no_rest = not law.traits.linear and (law.traits.of_jumps or law.unknown != Law.unknown)
    return not (law.traits.softens or (law.traits.rate and law.internal) or has_no_rest)


def acoustic_tensor(C: Array, n: Array) -> Array:
    """Return the acoustic tensor n.C.n (d, d), stress: the derivative of the traction by jump over thickness.

    Args:
        C: tangent (6, 6) in Mandel's order.
        n: unit normal (d,) of the layer in d dimensions.
    """
    N = np.array([symmetric_mandel((np.outer(v, n) + np.outer(n, v)) / 2) for v in np.eye(len(n))])
    return np.asarray(N @ C @ N.T)


def declared_or_computed_tangent(law: BulkLaw, n: Array) -> Array | None:
    """Return the tangent (6, 6) of a law for small strains, in Mandel's order; None if it is not known.

    It is the one that the law declares (`BulkLaw.stiffness`). If the law declares none and `is_checked_at_rest` is True
    for it, the tangent is computed from the stress. For other laws it may be negative or undefined.

    Args:
        law: the law, with numbers for parameters.
        n: unit normal (d,) of the layer in d dimensions, on which the stress of some laws depends. It has components
            along the axes of the joint, as the tangent has.
    """
    return tangent_at_rest(law, n) if is_checked_at_rest(law) else law.stiffness(n)


def require_stable(law: BulkLaw, C: Array | None, n: Array | None = None, slots: Sequence[int] = ()) -> None:
    """Raise InputError if the tangent of a law for small strains has a negative eigenvalue.

    Eigenvalues may be complex; their real parts are tested. Those of the symmetric part of the tangent are not tested,
    since a stable law without an energy may have negative ones.

    Args:
        law: the law, for messages.
        C: its tangent (6, 6) in Mandel's order; None: it is not known, and nothing is tested.
        n: for a layer its unit normal (d,); then the acoustic tensor n.C.n is tested. None: a body, and C is tested.
        slots: for a body, indices of the Mandel components that strains of the model have; only these components of C
            are tested.
    """
    if C is None or not np.isfinite(C).all():
        return
    A, of = (C[np.ix_(slots, slots)], "(of C)") if n is None else (acoustic_tensor(C, n), "across the layer (of n.C.n)")
    eig_min, largest = float(np.linalg.eigvals(A).real.min()), float(np.abs(C).max())
    if eig_min < -EIGENVALUE_TOLERANCE * largest:
        details = f"the smallest eigenvalue {of} is {eig_min:.4g}, the largest entry of C {largest:.4g}; allowed: >= 0"
        raise InputError(f"{type(law).__name__}: the stiffness at rest is negative, {details}; check the signs")


def symmetric_mandel(a: Array) -> Array:
    """Return the Mandel vector (6,) of a symmetric numeric tensor, (2, 2) or (3, 3)."""
    return mandel_vectors(np.pad(a, (0, 3 - len(a))))


def is_isotropic(C: Array) -> bool:
    """Return whether a tangent (6, 6) in Mandel's order is isotropic, up to the relative error `SMALL_COMPONENT`."""
    return bool(np.abs(C - isotropic_tensor(*average_lame(C))).max() <= SMALL_COMPONENT * np.abs(C).max())


def in_plane_modulus(C: Array, n: Array) -> float:
    """Return the stress per strain of a sheet that is stretched in one direction of its plane, with free faces.

    Strains in the other direction of the plane are zero. For an isotropic law the modulus is E/(1 - nu^2). In 3D it is
    the mean over two directions.

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
