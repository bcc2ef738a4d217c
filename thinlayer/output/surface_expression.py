"""Expressions on S that users give: what is checked of them before they are integrated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import ufl
from dolfinx import fem
from ufl.classes import Condition, Restricted
from ufl.domain import extract_domains

from forms.kinematics import Expr
from thinlayer.discretisation.given import has_finite_numbers
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.errors import ModelError


def expression_on_s(
    f: Any, model: InterfaceModel, jumping: Sequence[fem.FunctionSpace], shapes: Sequence[tuple[int, ...]] = ()
) -> Expr:
    """What a user gives as an expression on S, in UFL; a condition becomes 1 or 0.

    Args:
        f: as given.
        model: whose S it is.
        jumping: spaces of functions that have a value on either side of S; an expression must say on which.
        shapes: allowed ones; none: any.

    Raises:
        ModelError: no expression, of another shape or mesh, without a side, or with numbers that are not finite.
    """
    try:
        found = ufl.as_ufl(f)
    except Exception as error:
        raise ModelError(f"{short(f)} is no UFL expression on S, as surface.jump(state) is one") from error
    if not has_finite_numbers(found):
        raise ModelError(f"an expression on S has a number that is not finite, or not real: {str(found)[:80]}")
    if isinstance(found, Condition):
        found = ufl.conditional(found, 1.0, 0.0)
    if shapes and found.ufl_shape not in shapes:
        allowed = " or ".join("of a scalar, ()" if shape == () else f"of a vector, {shape}" for shape in shapes)
        raise ModelError(f"an expression on S has the shape {found.ufl_shape}; allowed: that {allowed}")
    meshes = [model.domain.mesh, *([model.pairs.mesh] if model.pairs else [])]
    known = [mesh.ufl_domain() for mesh in meshes]
    if not all(any(domain is one for one in known) for domain in extract_domains(found)):
        raise ModelError(
            "an expression on S is of another model's mesh; bring states here by surface.displacement(state)"
        )
    if _lacks_side(found, jumping):
        raise ModelError(
            "an expression on S has a field that jumps there; say on which side, as surface.sides.upper(u) or "
            "surface.sides.lower(u), or take surface.jump(state)"
        )
    return found


def integrated(form: Expr, make: Callable[[Expr], Any]) -> Any:
    """Result of `make` for an integral over S; raises ModelError if UFL cannot integrate it."""
    try:
        return make(form)
    except ValueError as error:  # UFL's
        raise ModelError(f"an expression cannot be integrated over S: {error}") from error


def _lacks_side(f: Expr, spaces: Sequence[fem.FunctionSpace]) -> bool:
    """Whether an expression has a field of one of these spaces without a restriction to a side."""
    left, seen = [f], set()
    while left:
        part = left.pop()
        if part in seen or isinstance(part, Restricted):
            continue
        if isinstance(part, fem.Function) and part.function_space in spaces:
            return True
        seen.add(part)
        left += part.ufl_operands
    return False


def short(thing: object) -> str:
    """Text of an object for a message."""
    text = repr(thing)
    return text if len(text) <= 80 else f"{text[:80]}..."
