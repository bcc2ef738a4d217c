"""Traits of laws, by which models and solvers choose their methods; checks of law classes; warnings."""

from __future__ import annotations

import inspect
import logging
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np

from forms.base import PACKAGES, InputError, is_finite, require

if TYPE_CHECKING:
    from forms.law import Law

# modules of the base classes, whose attributes are the defaults of all laws
LAW_BASE_MODULES = tuple(f"forms.{name}" for name in ("law", "traction", "flux", "kernel", "contact", "series"))
RESPONSE_ATTRIBUTES = ("stress", "traction", "flux", "sink", "source")  # they give the stress or traction of a law
UPDATE_METHODS = ("advance", "evolve")  # methods that compute the new internal variables
ORDER_1_METHODS = ("stations", "stations_at_ends", "end_constants", "elastic_moduli")
STRESS_ATTRIBUTES = (*ORDER_1_METHODS, "stiffness", "plane_stress", "energetic")  # attributes valid for one stress only
ENERGY_METHODS = ("energy", "potential", "loss", "dissipation", "dissipated")
VARIABLE_SIZES = {(): 1, (3,): 3, (3, 3): 6}  # shape of an internal variable -> its number of components


class RangeWarning(UserWarning):
    """Warning that a law, a model or a result is outside its range of accuracy.

    The message tells the value in question, and a remedy.

    Attributes:
        key: identifier of the violated condition; "" if it has none.
    """

    def __init__(self, message: str, key: str = "") -> None:
        super().__init__(message)
        self.key = key


def warn_of_range(key: str, message: str) -> None:
    """Issue a RangeWarning that points to the line outside these packages from which they were called.

    Args:
        key: identifier of the violated condition.
        message: the text.
    """
    warn_caller(RangeWarning(message, key))


def warn_caller(warning: Warning) -> None:
    """Issue a warning that points to the line outside these packages from which they were called.

    Python shows it once for each such line. Packages that call functions of these packages, such as scipy, are skipped.
    """
    restore_warnings()
    level, frame = 1, sys._getframe()
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] in (*PACKAGES, "contextlib", "scipy"):
        level, frame = level + 1, frame.f_back
    warnings.warn(warning, stacklevel=level)


def restore_warnings() -> None:
    """Make Python show warnings again, in case an import of FFCx has redirected them to a log that nobody reads."""
    handlers = [*logging.getLogger("py.warnings").handlers, *logging.getLogger().handlers]
    if all(isinstance(handler, logging.NullHandler) for handler in handlers):
        logging.captureWarnings(False)


def accept_renamed(cls: type, new_names: Mapping[str, str]) -> None:
    """Copy attributes that a class defines under their names of version 1.0 to their present names.

    Issue a DeprecationWarning for each of them.

    Args:
        cls: the class.
        new_names: name in version 1.0 -> present name.
    """
    for old, new in new_names.items():
        if old in vars(cls):
            warn_caller(DeprecationWarning(f"{cls.__name__}.{old} is deprecated since thinlayer 1.1; call it {new}"))
            setattr(cls, new, vars(cls)[old])


def reset_inherited_attributes(cls: type[Law]) -> None:
    """Reset those inherited attributes of a new law class that belong to the stress of its base class.

    If a class defines another stress than its base, an inherited stiffness, for example, would be wrong. It is replaced
    by the default of all laws. The following attributes stay:

    - those that the class itself defines, also by `plane_stress = Parent.plane_stress`;
    - traits that are checked or that only select solvers (`linear`, `symmetric`, ...);
    - attributes that depend on parameters only (`powers`, `at`);
    - an energy, if it is checked against the stress, or if the class itself defines one of `ENERGY_METHODS`.
    """
    for name in STRESS_ATTRIBUTES:
        if _is_for_another_stress(cls, name, RESPONSE_ATTRIBUTES + UPDATE_METHODS):
            _reset(cls, name)
    energy_methods = [name for name in ENERGY_METHODS if _is_custom(cls, name)]
    energy_unchecked = getattr(cls, "rate", False) or cls.internal or not getattr(cls, "symmetric", True)
    if energy_unchecked and all(_is_for_another_stress(cls, name, RESPONSE_ATTRIBUTES) for name in energy_methods):
        for name in energy_methods:
            _reset(cls, name)
    if _is_custom(cls, "has_quadratic_energy") and _mro_index(cls, "energy") < _mro_index(cls, "has_quadratic_energy"):
        _reset(cls, "has_quadratic_energy", False)


def _is_for_another_stress(cls: type, name: str, responses: tuple[str, ...]) -> bool:
    """Return whether a class inherits an attribute from a class that has another stress or traction.

    An attribute of a base class without a stress belongs to the first stress that a subclass defines. Adding internal
    variables does not count as another stress.

    Args:
        cls: the class.
        name: name of the attribute.
        responses: names of the methods and attributes that give the stress or traction, or new internal variables.
    """
    if not _is_custom(cls, name):
        return False
    bases = reversed(cls.__mro__[: _mro_index(cls, name) + 1])
    current = _custom_responses(cls, responses)
    earlier = next((attributes for base in bases if (attributes := _custom_responses(base, responses))), current)
    compared = (key for key in responses if key in earlier or key not in UPDATE_METHODS)
    return any(earlier.get(key) is not current.get(key) for key in compared)


def _custom_responses(cls: type, names: tuple[str, ...]) -> dict[str, object]:
    """Return those attributes of a class among `names`, by name, that differ from the defaults of all laws."""
    return {name: inspect.getattr_static(cls, name) for name in names if _is_custom(cls, name)}


def _mro_index(cls: type, name: str) -> int:
    """Return the index, in a class's method resolution order, of the first class that defines `name`.

    0 is the class itself. If none defines it, the result is the number of classes in this order.
    """
    return next((k for k, base in enumerate(cls.__mro__) if name in vars(base)), len(cls.__mro__))


def _reset(cls: type, name: str, default: object = None) -> None:
    """Set the attribute `name` of a class to the default of all laws, or to `default` if there is no such default."""
    defaults = (vars(base)[name] for base in cls.__mro__ if base.__module__ in LAW_BASE_MODULES and name in vars(base))
    setattr(cls, name, next(defaults, default))


def require_valid_declarations(law: Law) -> None:
    """Raise InputError unless what a law's class declares fits its parameters and methods.

    Checked are the powers of eps, the internal variables, and whether all methods are used.
    """
    cls, name, parameters = type(law), type(law).__name__, law.parameters()
    declared = [field_name for field_name, note in inspect.get_annotations(cls).items() if "ClassVar" not in str(note)]
    if declared and "__dataclass_params__" not in vars(cls):  # its constructor does not take them
        raise InputError(f"{name} is not a dataclass: write @dataclass(frozen=True) above the class")
    for parameter, power in law.powers.items():
        if parameter not in parameters:
            raise InputError(f"{name}: powers has {parameter!r}; parameters: {', '.join(parameters) or 'none'}")
        require(is_finite(power), f"{name}: the power of {parameter}", power, "allowed: a finite number")
    for variable, shape in law.internal.items():
        allowed = f"allowed: {', '.join(map(str, VARIABLE_SIZES))}"
        require(shape in VARIABLE_SIZES, f"{name}: shape of the internal variable {variable!r}", shape, allowed)
    _require_used_methods(law)


def _require_used_methods(law: Law) -> None:
    """Raise InputError if the class of a law has methods or attributes that would never be used."""
    cls, name = type(law), type(law).__name__
    defining_index = min(_mro_index(cls, attribute) for attribute in ("source", "ignored"))
    for method in cls.ignored:
        if _is_custom(cls, method) and _mro_index(cls, method) < defining_index:
            remedy = f"change the source, sublayers, traction or flux of {cls.__mro__[defining_index].__name__}"
            remedy = f"write {cls.renamed[method]}(step)" if method in cls.renamed else remedy
            raise InputError(f"{name} has a method {method} that is never called: {remedy}, or write a BulkLaw")
    updates = [method for method in UPDATE_METHODS if _is_custom(cls, method)]
    if updates and not law.internal:
        raise InputError(f"{name} has a method {updates[0]} but no internal variables: internal = {{name: shape}}")
    if (_is_custom(cls, "dissipation") or _is_custom(cls, "dissipated")) and not law.traits.has_energy:
        raise InputError(f"{name} declares a dissipation but no energy; write a method energy(step) too")
    if _is_custom(cls, "at") and (not _is_custom(cls, "varies") or inspect.getattr_static(cls, "varies") is False):
        raise InputError(f"{name} has a method at, but no parameters vary; write varies = True in the class")


def _is_custom(cls: type, name: str) -> bool:
    """Return whether a class has an attribute, its own or inherited, that is not the default of all laws."""
    definer = next((base for base in cls.__mro__ if name in vars(base)), None)
    module = getattr(vars(definer)[name], "__module__", None) if definer else None  # also where `_reset` restored it
    return definer is not None and not {definer.__module__, module} & {*LAW_BASE_MODULES}


def trait_field(fold: Callable[[Iterable[bool]], bool], default: bool = False) -> bool:
    """Declare a field of `Traits`, with a rule for the trait of a Stack.

    Args:
        fold: function from the values of this trait in all sublayers to its value for the Stack, such as `all` or
            `any`.
        default: value of the trait if a law does not declare it.
    """
    return field(default=default, metadata={"fold": fold})


@dataclass(frozen=True)
class Traits:
    """Properties of a law by which models and solvers choose their methods.

    All traits are True or False. A class of laws declares a trait as an attribute, such as `linear = True`, or as a
    property.

    A Stack has a trait if all of its sublayers have it, or if any of them has it; each field declares which.

    Attributes:
        linear: the stress is affine in the strain at the end of a step.
        symmetric: the tangent is symmetric, as for every law with an energy.
        has_quadratic_energy: the stored energy is a quadratic function of strain and internal variables.
        rate: the stress depends on the strain rate, so strains cannot jump in time. Without this trait a law responds
            to a sudden load at once.
        constrained: the pressure p is a separate unknown field; the volumetric strain is p times the law's
            `volume_compliance`, which can be 0.
        bounded: in some direction of strain the stress cannot grow beyond a bound, so there may be a limit load.
        singular: the tangent may be singular for some strains; Newton's method adds a Levenberg-Marquardt term.
        isochoric: inelastic flow preserves the volume, so that elements need a method against locking.
        softens: the stress falls as strains grow. In a meshed layer, as on S, the law gets the mean strain over the
            thickness.
        plateau: strains across the layer may grow at constant stress, so that they may vary through the thickness.
        varies: parameters vary along the layer or in time; the law's `at` gives their values.
        phases: the law has an internal variable "phase" in [-1, 1], the fraction of the material in phase 1, or minus
            the fraction in phase -1.
        switches: each column of the layer (a facet of S, or the cells above each other through the thickness) is in one
            phase. The phase is fixed during a solve and may switch after it.

    Traits that follow from the methods of a law:
        has_energy: stored energy and dissipation are declared.
        has_homotopy: `homotopy` gives laws whose equilibrium is easier to find, for continuation.
        stackable: the law can be a sublayer of a Stack.
        remembers: the law has internal variables.
        in_ufl: the equations are written in UFL.
        of_jumps: the law is a function of jumps, not of strains, and has no thickness.
        nodal: the law acts at the nodes of S.
        proportional: the stress is proportional to the strain: there are no rates, internal variables, stresses at rest.
        compiled: the law is compiled and evaluated on arrays of points; others are proportional, and parts of UFL forms.
    """

    linear: bool = trait_field(all)
    symmetric: bool = trait_field(all, default=True)
    has_quadratic_energy: bool = trait_field(all)
    rate: bool = trait_field(any)
    constrained: bool = trait_field(any)
    bounded: bool = trait_field(any)
    singular: bool = trait_field(any)
    isochoric: bool = trait_field(any)
    softens: bool = trait_field(any)
    plateau: bool = trait_field(any)
    varies: bool = trait_field(any)
    phases: bool = trait_field(any)
    switches: bool = trait_field(any)
    has_energy: bool = trait_field(all)
    has_homotopy: bool = trait_field(any)
    stackable: bool = trait_field(all)
    remembers: bool = trait_field(any)
    in_ufl: bool = trait_field(all)
    of_jumps: bool = trait_field(any)
    nodal: bool = trait_field(any)
    proportional: bool = trait_field(all)
    compiled: bool = trait_field(lambda _: True)  # every Stack is compiled

    @property
    def may_soften(self) -> bool:
        """Whether the stress might fall as jumps grow: no declared trait of the law says so, and none excludes it."""
        return self.symmetric and not (self.softens or self.linear or self.rate or self.bounded or self.switches)

    @classmethod
    def of_law(cls, law: object, **method_traits: bool) -> Traits:
        """Return the traits of a law: those that its class declares, and those that follow from its methods.

        Args:
            law: the law.
            method_traits: values, by name, of the traits that follow from its methods.

        Raises:
            InputError: a declaration that is neither True nor False.
        """
        declared = {f.name: getattr(law, f.name, f.default) for f in fields(cls) if f.name not in method_traits}
        for name, value in declared.items():
            subject = f"{type(law).__name__}: {name}"
            require(isinstance(value, bool | np.bool_), subject, value, "a trait is True or False")
        return cls(**{name: bool(value) for name, value in (declared | method_traits).items()})

    @classmethod
    def of_series(cls, sublayers: Iterable[Traits]) -> Traits:
        """Return the traits of a Stack, given the traits of each of its sublayers."""
        members = list(sublayers)
        return cls(**{f.name: f.metadata["fold"](getattr(traits, f.name) for traits in members) for f in fields(cls)})
