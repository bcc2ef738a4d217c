"""Traced laws: called once with symbols in place of all numbers, and identified by a key of the result.

Compiled code and results of checks are stored under this key. The class of a law would not do as a key, because its methods
may read globals, attributes and other functions, which may change.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any

import basix.ufl
import numpy as np
import ufl
from ufl.classes import Constant, ConstantValue, Index, Label, MultiIndex, ScalarValue, Variable, Zero
from ufl.core.expr import Expr as Node
from ufl.corealg.traversal import traverse_unique_terminals

from forms.declarations import SIZES
from forms.kinematics import Expr, from_mandel
from forms.law import BulkLaw, LawError, Step, explained, shaped

_DOMAIN = ufl.Mesh(basix.ufl.element("Lagrange", "interval", 1, shape=(1,)))  # symbols need a mesh
_KNOWN: dict[tuple[Any, ...], int] = {}  # known parts of expressions -> their numbers
_STRESSES: dict[tuple[Any, int | None], int] = {}  # laws of this package -> their keys


@dataclass(frozen=True)
class Symbolic:
    """A law whose parameters are symbols, and a step of symbols.

    Attributes:
        law: the law.
        step: the step of symbols.
        strain: the strain at the end of the step, (6,), a variable.
        numbers: all inputs: e (6), e_old (6), internal values, n (3), dt, theta, parameters; in Mandel's order.
    """

    law: BulkLaw
    step: Step
    strain: Expr
    numbers: Expr


def variable(e: Expr) -> Expr:
    """`ufl.variable` with a label of its own. UFL counts labels in a process, and FFCx knows no law under another count."""
    return Variable(e, Label(-1))


@cache
def _symbols(length: int) -> Expr:
    return ufl.Constant(_DOMAIN, shape=(length,))


def symbolic(law: BulkLaw) -> Symbolic:
    """A law at a point, in a step."""
    shapes = {name: _shape(value) for name, value in law.parameters().items()}
    length = 6 + 6 + law.memory + 3 + 2 + sum(int(np.prod(shape)) for shape in shapes.values())
    numbers = _symbols(length)
    inputs = iter(numbers[i] for i in range(length))

    def take(shape: tuple[int, ...]) -> Expr:
        if shape == ():
            return next(inputs)
        return ufl.as_tensor([take(shape[1:]) for _ in range(shape[0])])

    end, old = variable(take((6,))), take((6,))
    q = {name: _unpacked(take((SIZES[shape],)), shape) for name, shape in law.internal.items()}
    n, dt, theta = take((3,)), take(()), take(())
    step = Step(from_mandel(end), n, from_mandel(old), q, dt, theta)
    step = step if law.traits.rate else step.without_rate()
    return Symbolic(law.with_parameters({name: take(shape) for name, shape in shapes.items()}), step, end, numbers)


def _shape(value: Any) -> tuple[int, ...]:
    """Shape of a parameter: a number, an array or a Constant."""
    return tuple(value.ufl_shape) if isinstance(value, Node) else np.shape(value)


def named(law: BulkLaw) -> tuple[Any, ...] | None:
    """Identity of a law of this package apart from its numbers; None for users' laws, whose code may read changing data."""
    if not all(kind.__module__.partition(".")[0] in ("forms", "builtins") for kind in type(law).__mro__):
        return None
    return (type(law), repr(law.choices()), *map(_shape, law.parameters().values()))


def stress_key(law: BulkLaw, d: int | None) -> int:
    """Key of the stress, and of the energy if there is one, of a law whose stress is a part of a form.

    Args:
        law: the law.
        d: number of components of its director; None in a body.

    Raises:
        LawError: the law fails, compares numbers in Python, or has no stress at all.
    """
    known = named(law)
    if known is None:
        return _stress_key(law, d)
    if (known, d) not in _STRESSES:
        _STRESSES[known, d] = _stress_key(law, d)
    return _STRESSES[known, d]


def _stress_key(law: BulkLaw, d: int | None) -> int:
    point = symbolic(law)
    director: Expr = point.step.n
    n = None if d is None else ufl.as_vector([director[i] for i in range(d)])
    step = Step(point.step.e, n)
    with explained(law, "stress"), undecided(law, "stress"):
        stress = shaped(law, "stress", point.law.stress(step), (3, 3))
    if isinstance(stress, Zero):
        raise LawError(
            f"{type(law).__name__}.stress is zero, whatever the strain; a law of this kind needs a stiffness"
        )
    if not law.traits.has_energy:
        return key([stress])
    with explained(law, "energy"), undecided(law, "energy"):
        return key([stress, shaped(law, "energy", point.law.energy(step), ())])


def traces_director(law: BulkLaw) -> bool:
    """Whether the director appears in the stress of a law in UFL, or in its internal variables after a step."""
    point, n = symbolic(law), ufl.Constant(_DOMAIN, shape=(3,))
    step = point.step._replace(n=n)
    found = [point.law.stress(point.law.own_step(step)), *point.law.advance(step).values()]
    return any(n is part for one in found for part in traverse_unique_terminals(ufl.as_ufl(one)))


def _unpacked(values: Expr, shape: tuple[int, ...]) -> Expr:
    return {(): lambda: values[0], (3,): lambda: values, (3, 3): lambda: from_mandel(values)}[shape]()


# ---------------------------------------------------------------- decisions
def asked_by_ufl() -> bool:
    """Whether UFL called the caller of this function. UFL compares expressions, since 2025 also with numbers."""
    return sys._getframe(2).f_globals.get("__name__", "").partition(".")[0] == "ufl"


@contextmanager
def undecided(law: BulkLaw, method: str) -> Iterator[None]:
    """Raise LawError where a law's code uses ==, != or the truth of symbols. UFL may still compare expressions.

    Python would compare symbols instead of numbers, always with the result False: the branch would never be taken.
    """
    message = (
        f"{type(law).__name__}.{method}: a parameter, or a value computed from it, is compared or used as a condition "
        "in Python; laws are traced once for all numbers: write ufl.conditional(ufl.eq(a, b), c, d)"
    )

    def guarded(original: Callable[..., Any]) -> Callable[..., Any]:
        def asked(*arguments: Any) -> Any:
            if not asked_by_ufl():
                raise LawError(message)
            return original(*arguments)

        return asked

    kept = {name: getattr(Node, name) for name in ("__eq__", "__ne__", "__bool__")}
    try:
        for name, original in kept.items():
            setattr(Node, name, guarded(original))
        yield
    finally:
        for name, original in kept.items():
            setattr(Node, name, original)


# ---------------------------------------------------------------- keys
def key(expressions: Iterable[Expr]) -> int:
    """A number that identifies expressions: equal for expressions of the same structure, whatever their symbols' names."""
    names: dict[tuple[type, int], int] = {}  # symbols and free indices -> order of appearance
    found: dict[int, int] = {}  # parts by id, so that shared parts are visited once
    whole = list(expressions)
    stack = list(whole)
    while stack:
        node = stack[-1]
        left = [part for part in node.ufl_operands if id(part) not in found]
        if left:
            stack += left
            continue
        stack.pop()
        if id(node) not in found:
            kind = type(node)
            own = _terminal(node, names) if node._ufl_is_terminal_ else tuple(found[id(p)] for p in node.ufl_operands)
            found[id(node)] = _KNOWN.setdefault((kind, *own), len(_KNOWN))
    return _KNOWN.setdefault(("all", *(found[id(node)] for node in whole)), len(_KNOWN))


def _terminal(node: Any, names: dict[tuple[type, int], int]) -> tuple[Any, ...]:
    def number(counted: Any) -> int:
        return names.setdefault((type(counted), counted.count()), len(names))

    if isinstance(node, MultiIndex):
        return tuple(("free", number(i)) if isinstance(i, Index) else int(i) for i in node.indices())
    if isinstance(node, Label):
        return (number(node),)
    if isinstance(node, Constant):
        return (number(node), node.ufl_shape)
    return (repr(node.value()) if isinstance(node, ScalarValue) else repr(node),)


def require_numbers_alone(law: BulkLaw, numbers: Expr, expressions: Iterable[Expr]) -> None:
    """Raise LawError if expressions contain anything but the inputs of the law."""
    seen: set[int] = set()
    stack = list(expressions)
    while stack:
        node = stack.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        stack += node.ufl_operands
        if node._ufl_is_terminal_ and node is not numbers and not isinstance(node, (ConstantValue, MultiIndex, Label)):
            raise LawError(
                f"{type(law).__name__} contains {str(node)[:80]}, a {type(node).__name__}; a compiled law knows "
                "only its parameters and its step: declare a parameter, or `varies` and `at`"
            )
