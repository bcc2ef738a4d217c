"""Check of a law that a user has written: `check`, which is called for each law that a model or `drive` gets."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives
from ufl.classes import Zero
from ufl.indexed import Indexed

from forms.base import Array, InputError, require
from forms.law import BulkLaw, Law, Step, checked_stress, explained_errors, require_shape
from forms.law_tangents import equations_key, evaluate, symbolic_law
from forms.parameter_fields import ParameterField, ParameterValue
from forms.tensors import Expr, mandel_vector

STRAIN_SIZES = (0.01, 0.3)  # sizes of the strains at which laws are evaluated
ROUNDING_TOLERANCE = 1e-8  # relative difference that counts as rounding
MIN_ACCURATE_NUMBER = 1e-290  # magnitude below which products of numbers have lost digits
ASYMMETRY_MESSAGE = "{}: the tangent is not symmetric (by {:.1e} of its size); declare symmetric = False, or correct it"
_CHECKED_LAWS: set[tuple[object, ...]] = set()  # laws that have passed, with their parameter values


def check(law: Law) -> None:
    """Raise InputError unless a law, with its parameter values, agrees with the declarations of its class.

    Models and `drive` call this once for each law and its parameter values. Contact laws and laws of this package are
    not checked. A law in UFL must

    - return a stress (3, 3), and internal variables and energies of the declared shapes; all tensors must be symmetric;
    - return the same values whether its parameters are numbers or the symbols used for compilation, so that no Python
      condition may depend on parameters;
    - have the same tangent at all strains if its class declares `linear`;
    - have a symmetric tangent unless its class declares `symmetric = False`;
    - return the derivative of its energy as stress, if its tangent is symmetric and it has neither internal variables
      nor a rate.

    A user-defined `KernelLaw` is checked when it is compiled.

    Args:
        law: the law.

    Example:
        >>> from forms import LinearElastic, check
        >>> check(LinearElastic(lmbda=800.0, mu=400.0))
    """
    if isinstance(law, type):
        raise InputError(f"{law.__name__} is a class; give a law, with its numbers")
    require(isinstance(law, Law), "law", law, "it must be a law")
    if law.traits.nodal:
        return
    for _, sublayer in law.as_bulk_law().sublayers:
        law_3d: BulkLaw = sublayer.law_3d
        value_bytes = [np.asarray(_numeric_value(value)).tobytes() for value in law_3d.parameters().values()]
        key = (type(law_3d), repr(law_3d.choices()), *value_bytes)
        if equations_key(law_3d) is None and key not in _CHECKED_LAWS:
            require_consistent(law_3d)
            _CHECKED_LAWS.add(key)


def require_consistent(law: BulkLaw) -> None:
    """Check a law as `check` does, even if the same law has passed the check before.

    Nothing is checked if the law is not written in UFL.

    Args:
        law: the law.

    Raises:
        InputError: the law does not agree with the declarations of its class.
    """
    if not law.traits.in_ufl:
        return
    numeric_law, name, method = law.mapped(_numeric_value), type(law).__name__, law.methods[0]
    symbolic = symbolic_law(numeric_law)
    expressions = _method_expressions(symbolic.law, symbolic.step)
    if isinstance(expressions[method], Zero) and not (law.traits.rate or law.internal):
        raise InputError(f"{name}.{method} is zero, whatever the strain; a law of this kind needs a stiffness")
    stress_vector = mandel_vector(expressions[method])
    all_expressions: dict[str, Expr] = {**expressions, "tangent": ufl.diff(stress_vector, symbolic.strain)}
    if law.traits.has_energy and law.traits.symmetric and not (law.traits.rate or law.internal):
        all_expressions["error"] = ufl.diff(expressions["energy"], symbolic.strain) - stress_vector
    with explained_errors(law, method):
        all_expressions = {key: expand_derivatives(expression) for key, expression in all_expressions.items()}

    def value_at(key: str, inputs: Array) -> Array | None:
        return _evaluated(all_expressions[key], {symbolic.symbols: inputs})

    for strain_size in STRAIN_SIZES:
        e, sample = _random_inputs(numeric_law, strain_size)
        _require_no_branches(law, sample, value_at)
        for key in expressions:
            tensor = value_at(key, sample)
            if tensor is not None and tensor.ndim == 2 and (skew := _relative_difference(tensor, tensor.T)):
                text = f"{name}.{key} is not symmetric: by {skew:.1e} of its size"
                raise InputError(f"{text}; use ufl.sym, or a vector (3,)")
        input_samples = [np.concatenate([strain, sample[6:]]) for strain in (e, -e, 3 * e[::-1])]
        tangents = [C for inputs in input_samples if (C := value_at("tangent", inputs)) is not None]
        for C in tangents:
            if law.traits.linear and _relative_difference(C, tangents[0]):
                text = f"{name} declares linear = True, but its stress is not affine in the strain"
                raise InputError(f"{text}; write linear = False in the class, or correct the stress")
            if law.traits.symmetric and (skew := _relative_difference(C, C.T)):
                note = f". The memory was random numbers: {', '.join(law.internal)}" * bool(law.internal)
                raise InputError(ASYMMETRY_MESSAGE.format(name, skew) + note)
        error, stress = (value_at(key, sample) if "error" in all_expressions else None for key in ("error", method))
        if error is not None and stress is not None and np.abs(error).max() > ROUNDING_TOLERANCE * np.abs(stress).max():
            difference_text = f"it is {np.abs(error).max() / (np.abs(stress).max() or 1.0):.1e} of the stress away"
            text = f"{name}: the derivative of the energy by the strain is not the stress, {difference_text}"
            raise InputError(f"{text}; correct one of them, or write symmetric = False if the stress has no energy")


def _method_expressions(law: BulkLaw, step: Step) -> dict[str, Expr]:
    """Return the UFL expressions of a law's stress, new internal variables and energies in a step.

    The keys are the names of the law's methods, such as "stress"; an internal variable has a key like "advance['p']".

    Raises:
        InputError: a method fails, or returns a wrong shape or the wrong internal variables.
    """
    name, (stress_method, update_method) = type(law).__name__, law.methods
    expressions = {stress_method: checked_stress(law, law.law_step(step))}
    with explained_errors(law, update_method):
        new = law.advance(step)
    if not isinstance(new, dict) or set(new) != set(law.internal):
        returned = sorted(new) if isinstance(new, dict) else repr(new)
        raise InputError(f"{name}.{update_method} gives {returned}; it must give {sorted(law.internal)}")
    for variable, shape in law.internal.items():
        key = f"{update_method}[{variable!r}]"
        expressions[key] = require_shape(law, key, new[variable], shape)
    if law.traits.has_energy:
        with explained_errors(law, "energy or dissipation"):
            expressions["energy"] = require_shape(law, "energy", law.energy(Step(step.e, step.n, q=new)), ())
            expressions["dissipation"] = require_shape(law, "dissipation", law.dissipated(step), ())
    return expressions


def _random_inputs(law: BulkLaw, strain_size: float) -> tuple[Array, Array]:
    """Return a random strain, a Mandel vector (6,), and a random vector of all inputs of `law` with this strain.

    The vector contains, in this order: strain, strain at the beginning of the step, internal variables, unit normal
    (3,), dt = 0.1, theta = 1, parameters. `SymbolicLaw.symbols` has the same order. The strain components are normally
    distributed with standard deviation `strain_size`.
    """
    rng = np.random.default_rng(3)
    e, n = strain_size * rng.normal(size=6), rng.normal(size=3)
    old_state = 0.1 * strain_size * rng.normal(size=6), strain_size * rng.random(law.memory)
    return e, np.concatenate([e, *old_state, n / np.linalg.norm(n), [0.1, 1.0], law.parameter_values()])


def _require_no_branches(law: BulkLaw, sample: Array, value_at: Callable[..., Array | None]) -> None:
    """Raise InputError if a law gives other values for numeric parameters than for symbols in their place.

    This happens if a Python condition in the law depends on a parameter.

    Args:
        law: the law.
        sample: vector of all inputs of the law, in the order of `SymbolicLaw.symbols`.
        value_at: function of a method's name and a vector of inputs. It evaluates the method of the law with symbols,
            and returns None where this is impossible.
    """
    normal_offset, stress = 12 + law.memory, value_at(law.methods[0], sample)
    energy_scale = 0.0 if stress is None else float(np.abs(stress).max() * np.abs(sample[:6]).max())
    scales = {"energy": energy_scale, "dissipation": energy_scale}  # scale of rounding errors where an energy is zero
    for dt, theta, field_value in ((0.1, 1.0, 1.0), (0.0, 0.5, 0.0)):
        numeric_law = law.mapped(partial(_numeric_value, field_value=field_value))
        inputs = np.concatenate([sample[: normal_offset + 3], [dt, theta], numeric_law.parameter_values()])
        try:
            symbolic = symbolic_law(numeric_law, inputs)
            expressions = _method_expressions(symbolic.law, symbolic.step)
        except Exception:  # for example a division by zero
            continue
        for key, expression in expressions.items():
            direct, traced = _evaluated(expression), value_at(key, inputs)
            if direct is not None and traced is not None and _relative_difference(direct, traced, scales.get(key, 0.0)):
                text = f"{type(law).__name__}.{key}: a parameter, or a value computed from it, is in a Python condition"
                raise InputError(f"{text}, which runs once for all numbers; write ufl.conditional(ufl.eq(a, b), c, d)")


def _relative_difference(a: Array, b: Array, scale: float = 0.0) -> float:
    """Return the largest difference of `a` and `b` relative to their size; 0 if it is only rounding.

    The difference is divided by the largest of all |a|, |b| and `scale`.
    """
    difference, largest = np.abs(a - b).max(), max(np.abs(a).max(), np.abs(b).max(), scale, MIN_ACCURATE_NUMBER)
    return float(difference / largest) if difference > ROUNDING_TOLERANCE * largest else 0.0


def _evaluated(expression: Expr, values: dict[Expr, Array] | None = None) -> Array | None:
    """Return the numerical values of a UFL expression; None if a part has no value or a value is not finite.

    Args:
        expression: the expression.
        values: symbol in the expression -> array of its numbers.
    """
    try:
        with warnings.catch_warnings(action="ignore"):  # UFL warns of parts without a value
            numbers = evaluate(expand_derivatives(expression), values)
    except Exception:  # parts without a value, such as a coordinate: the compiler will report errors
        return None
    return numbers if np.isfinite(numbers).all() else None


def _numeric_value(value: ParameterValue, _power: float = 0.0, field_value: float = 1.0) -> ParameterValue:
    """Return a parameter's value as a float or an array, for example that of a DOLFINx Constant.

    A function of the place, or a NaN, is replaced by `field_value`. A UFL expression is returned unchanged. `_power`,
    the power of eps, is not used: `Law.mapped` gives it.
    """
    if isinstance(value, (ParameterField, Indexed)):  # a function of the place, or values at quadrature points
        return field_value
    try:
        array = np.asarray(getattr(value, "value", value), float)
    except (TypeError, ValueError):
        return value
    return array if array.ndim else float(array) if np.isfinite(array) else field_value
