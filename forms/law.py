"""Base classes of constitutive laws: stresses for strains, independent of the thickness, the mesh and the time loop."""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from operator import attrgetter
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import numpy as np
import ufl
from ufl.classes import Zero

from forms.base import Array, InputError, require
from forms.ends.constants import FreeEnd
from forms.ends.weights import EndWeights
from forms.layer_results import LayerResults
from forms.parameter_fields import (
    MAX_CHECKED_PLACES,
    ParameterField,
    ParameterRangeError,
    ParameterValue,
    as_parameter_field,
    extreme_indices,
    failure_text,
    parameter_numbers,
    place_text,
)
from forms.stations import AnyStation, gauss_stations
from forms.tensors import Expr, average_lame, condensed_tangent, isotropic_tensor
from forms.traits import VARIABLE_SIZES, Traits, accept_renamed, require_valid_declarations, reset_inherited_attributes

MISSING_VALUE = object()
NUMBER_ANNOTATION = re.compile(r"\b(float|int)\b")
ARRAY_ANNOTATION = re.compile("array|list|tuple|sequence|callable", re.IGNORECASE)
ORDER_0_REMEDY = "use order=0, or mesh the layer (structure.full)"
ChoiceType = TypeVar("ChoiceType")
ChangeParameter = Callable[[ParameterValue, float], ParameterValue]  # of a parameter and its power of eps


class Step(NamedTuple):
    """Input of a law at one point, over a time step from t to t + dt.

    Forces balance at t + theta dt, and the law returns the stress at this time.

    Attributes:
        e: strain at the end of the step, (3, 3). A law without rate and internal variables gets the strain at t + theta
            dt instead, when its stress is computed.
        n: unit normal (3,) of the layer, from the lower to the upper body; None inside a body. In 2D its last component
            is zero.
        e_old: strain at the beginning, (3, 3). None in problems without time, and for laws without rate and internal
            variables.
        q: internal variables at the beginning, by name.
        dt: length of the step; 0 at a sudden load; None in problems without time.
        theta: fraction of the step after which forces balance; from 1 (backward Euler) down to 1/2 (midpoint).
        allows_rate: whether the law declares `rate`, so that it may use the strain rate.
    """

    e: Expr
    n: Expr | None = None
    e_old: Expr | None = None
    q: Mapping[str, Expr] = {}
    dt: Expr | None = None
    theta: Expr = 1.0
    allows_rate: bool = True

    @property
    def mid(self) -> Expr:
        """Strain (3, 3) at t + theta dt, the time at which forces balance."""
        return self.e if self.e_old is None else self.theta * self.e + (1 - self.theta) * self.e_old

    @property
    def rate(self) -> Expr:
        """Strain rate (3, 3) of the step, (e - e_old)/dt.

        Raises:
            InputError: the law does not declare `rate`, or the problem has no time.
        """
        if self.dt is None or not self.allows_rate:
            raise InputError("step.rate needs a law with rate = True, and a time step: march, or drive the law")
        return (self.e - self.e_old) / self.dt

    def between(self, old: Expr, new: Expr) -> Expr:
        """Return the value at t + theta dt of a quantity that is `old` at the beginning and `new` at the end."""
        return self.theta * new + (1 - self.theta) * old


def choice(default: ChoiceType) -> ChoiceType:
    """Declare a dataclass field of a law whose value selects among equations, in place of being a material parameter.

    The law is compiled separately for each value of the field.

    Args:
        default: value of the field if the user gives none.
    """
    return field(default=default, metadata={"choice": True})


@dataclass(frozen=True, eq=False)  # compared by identity, unless a law defines ==
class Law(LayerResults):
    """Base of all laws: frozen dataclasses whose fields are the parameters.

    A law derives from one of three classes: `BulkLaw` (stress for strain), `TractionLaw` (traction for jump) or
    `ContactLaw` (contact at nodes). Its class declares traits (`Traits`) as attributes, such as `linear = True`.

    Attributes:
        unknown: name of the unknown that the law is a law of: displacements, or a scalar field (`FluxLaw`).
        powers: name of a parameter -> power of the thickness eps to which this parameter is proportional in a family of
            layers; only a `BulkLaw` has powers.
        internal: name of an internal variable -> its shape: (), (3,), or (3, 3) if it is a symmetric tensor. Internal
            variables start from zero.
        functions: names of parameters that may be functions of other quantities than the place, such as a temperature.
            `parameter_values` gives NaN for such a function, `at` gives its values.
        ignored: names of methods of other laws that are not called for this one, so that a subclass must not define
            them.
        renamed: those of them that are called by another name -> this name.
        takes_fields: whether a parameter that is a single number may instead be a function of the place. This is a
            numpy function of the coordinates (d, n) of n places in the joint that returns n values.
    """

    unknown: ClassVar[str] = "displacement"
    takes_fields: ClassVar[bool] = False
    powers: ClassVar[Mapping[str, float]] = {}
    internal: ClassVar[Mapping[str, tuple[int, ...]]] = {}
    functions: ClassVar[tuple[str, ...]] = ()
    ignored: ClassVar[tuple[str, ...]] = ()
    renamed: ClassVar[Mapping[str, str]] = {}

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        accept_renamed(cls, {"eased": "homotopy", "quadratic": "has_quadratic_energy"})
        reset_inherited_attributes(cls)

    def __post_init__(self) -> None:
        for f in fields(self):
            is_reserved = any(f.name in vars(base) for base in type(self).__mro__ if base.__module__ == __name__)
            self.require(not is_reserved, f"the parameter {f.name!r}", "another one", "a name that all laws use")
            allowed = "a number" + (", a function in numpy" if f.name in self.functions else "")
            self.require(not isinstance(getattr(self, f.name), ufl.core.expr.Expr), f.name, allowed, "a UFL expression")
        scalar_names = scalar_field_names(type(self))
        for f in fields(self):
            is_scalar = f.name in scalar_names
            if is_scalar and f.name not in self.functions and self.takes_fields:
                object.__setattr__(self, f.name, as_parameter_field(getattr(self, f.name)))
            self._check_number(f.name, getattr(self, f.name), f.default is None, is_scalar)
        for name in self.fields:
            self.require(type(self).at is Law.at, name, "a number, as `at` gives what varies", "a function of places")
        if not self.fields:  # parameters that are functions need places, see `check_at`
            self.check()
        _ = self.traits  # raises InputError for wrong declarations of the class
        require_valid_declarations(self)

    def _check_number(self, name: str, value: object, may_be_none: bool, scalar: bool) -> None:
        is_function = isinstance(value, ParameterField) or (callable(value) and name in self.functions)
        if is_function or (value is None and may_be_none) or name not in self.parameters():
            return
        try:
            array = np.asarray(value)
        except ValueError:  # ragged
            array = np.asarray("")
        is_numeric = array.dtype.kind in "iuf" and not (scalar and array.ndim)
        require(is_numeric, f"{type(self).__name__}: {name}", value, f"allowed: {'a number' if scalar else 'numbers'}")

    def check(self) -> None:
        """Raise InputError if a parameter is out of its range."""

    def require(self, condition: bool, name: str, allowed: str, value: object = MISSING_VALUE) -> None:
        """Raise InputError unless `condition` is true.

        The message is "{class}: {name} is {value}; allowed: {allowed}".

        Args:
            condition: result of a check.
            name: name of the parameter, or of another checked quantity.
            allowed: text that says which values are allowed.
            value: value that the message shows; by default the law's attribute `name`.
        """
        if not condition:
            value = getattr(self, name) if value is MISSING_VALUE else value
            raise InputError(f"{type(self).__name__}: {name} is {value}; allowed: {allowed}")

    def check_dimension(self, d: int) -> None:
        """Raise InputError if the law cannot be used in a model of `d` dimensions, 2 or 3."""

    @cached_property
    def traits(self) -> Traits:
        """Properties of the law by which models and solvers choose their methods.

        The traits of a new law follow from its class and its parameters. A copy in which other numbers or symbols
        replace parameters keeps them.
        """
        traits = Traits.of_law(self, **self._traits_of_methods())
        return replace(traits, varies=True) if self.fields and traits.compiled else traits

    def compiled_copy(self) -> Self:
        """Return a copy of the law that is compiled and evaluated at quadrature points, not made part of a UFL form.

        The parameters of such a copy may be functions of the place.
        """
        law = self.with_parameters({})
        object.__setattr__(law, "traits", replace(self.traits, compiled=True, varies=bool(self.fields)))
        return law

    def _traits_of_methods(self) -> dict[str, bool]:
        """Return the traits that follow from the methods and internal variables of the class, name -> value."""
        return {"remembers": bool(self.internal), "proportional": False}

    def as_bulk_law(self) -> BulkLaw:
        """Return the same law as a function of strains, which weak forms and compiled code need.

        Raises:
            InputError: the law acts at nodes, and has no such form.
        """
        raise InputError(f"{type(self).__name__} has neither strains nor jumps; derive it from BulkLaw or TractionLaw")

    @property
    def relaxation_times(self) -> tuple[float, ...]:
        """Creep and relaxation times of the law; () if it has none, or if they are not known.

        The parameters of the law must be numbers.
        """
        return ()

    @property
    def sublayers(self) -> tuple[tuple[float, Any], ...]:
        """Sublayers of a layer with this law, from the lower to the upper face: pairs of thickness fraction and law.

        Only a `Stack` has several; any other law is its own single sublayer.
        """
        return ((1.0, self),)

    def at(self, x: Array, t: float) -> dict[str, Array]:
        """Return the values (n,) at n places and one time, by name, of the parameters that depend on place or time.

        A law that overrides this method must return multiples of its parameters: these have been scaled to the
        thickness of the layer.

        Args:
            x: coordinates (d, n) of the places in the joint as drawn, before S is opened to the layer's thickness.
            t: time. For the stress of a step this is the time at which forces balance, for the stored energy the end of
                the step.
        """
        return {}

    @property
    def break_times(self) -> set[float]:
        """Times at which the slope of a parameter made with `thinlayer.piecewise` changes."""
        return set().union(*(getattr(getattr(self, name), "times", ()) for name in self.functions))

    def parameters(self) -> dict[str, ParameterValue]:
        """Return all parameters by name, as numbers, arrays, functions or UFL. A `choice` is not a parameter."""
        return {f.name: getattr(self, f.name) for f in fields(self) if "choice" not in f.metadata}

    def choices(self) -> tuple[tuple[str, object], ...]:
        """Return pairs of name and value for the fields that are not parameters (see `choice`)."""
        parameters = self.parameters()
        return tuple((f.name, getattr(self, f.name)) for f in fields(self) if f.name not in parameters)

    def parameter_values(self) -> Array:
        """Return the numbers of all parameters, one after the other, as a flat array; NaN stands for a function."""
        values = [np.ravel(parameter_numbers(value)) for value in self.parameters().values()]
        return np.concatenate([np.empty(0), *values])

    def with_parameters(self, values: Mapping[str, object]) -> Self:
        """Return a copy in which `values`, numbers or UFL by name, replace parameters; ranges are not checked."""
        law = copy.copy(self)
        vars(law).update({"traits": self.traits, **values})
        return law

    def mapped(self, change: ChangeParameter) -> Self:
        """Return a copy in which change(value, power) replaces each parameter; the new values are not checked.

        Args:
            change: function of a parameter's value and of its power of eps in `powers`, 0 if it has none.
        """
        new_values = {name: change(value, self.powers.get(name, 0)) for name, value in self.parameters().items()}
        return self.with_parameters(new_values)

    # ---------------------------------------------------------------- parameters that are functions of the place
    @property
    def fields(self) -> dict[str, ParameterField]:
        """Parameters that are functions of the place, by name."""
        return {name: value for name, value in vars(self).items() if isinstance(value, ParameterField)}

    def fields_at(self, x: Array) -> dict[str, Array]:
        """Return the values (n,) at n places, by name, of the parameters that are functions of the place.

        Args:
            x: coordinates (d, n) of the places in the joint as drawn, before S is opened to the layer's thickness.

        Raises:
            InputError: a function fails, does not return n finite real numbers, or is out of range at a place.
        """
        return {name: self._field_values(name, parameter, x) for name, parameter in self.fields.items()}

    def _field_values(self, name: str, parameter: ParameterField, x: Array) -> Array:
        try:
            return parameter(x)
        except ParameterRangeError as error:
            reason = str(error) if str(error)[:1].isalpha() and " is " in str(error) else f"{name} is {error}"
            raise InputError(f"{type(self).__name__}: {reason}, at {place_text(x, error.k)}") from None
        except Exception as error:
            call, wanted = f"{type(self).__name__}: {name}(x)", "it must be a numpy function of places (d, n)"
            raise InputError(f"{failure_text(call, x, error)}; {wanted} in the joint that gives n numbers") from error

    def at_places(self, x: Array) -> Iterator[Self]:
        """Yield, for each of n places with the coordinates `x` (d, n), the law with the parameters that it has there.

        The parameters are numbers, whose ranges are not checked.
        """
        values = self.fields_at(x)
        for k in range(x.shape[1]):
            yield self.with_parameters({name: float(value[k]) for name, value in values.items()})

    def check_at(self, x: Array) -> None:
        """Raise InputError if a parameter that is a function is out of its range at one of n places `x` (d, n).

        If there are many places, some are not checked. Checked are the places where a parameter, or the difference or
        ratio of two parameters, is smallest or largest. One to two thousand others are checked, too.
        """
        if not self.fields:
            return
        values, n = list(self.fields_at(x).values()), x.shape[1]
        at = sorted({*extreme_indices(values, with_differences=True), *range(0, n, max(n // MAX_CHECKED_PLACES, 1))})
        for k, law in zip(at, self.at_places(x[:, at]), strict=True):
            try:
                law.check()
            except InputError as error:
                raise InputError(f"{error}, at {place_text(x, k)}") from None

    def laws_at_extremes(self, x: Array) -> list[Self]:
        """Return the law with the numbers that its parameters have at extreme ones of n places `x` (d, n).

        A place is extreme if a parameter, or the ratio of two, is smallest or largest there. The result has one law for
        each. If no parameter is a function of the place, it has only the law itself.

        Raises:
            InputError: a parameter is out of its range at an extreme place.
        """
        if not self.fields:
            return [self]
        extreme_x = x[:, extreme_indices(list(self.fields_at(x).values()))]
        self.check_at(extreme_x)
        return list(self.at_places(extreme_x))


class BulkLaw(Law):
    """A law that gives stresses for strains, for the material of a layer or of a body.

    A `ThinLayer` may be one of a family of layers with different thicknesses eps. In such a family a parameter is value
    * (eps/at)**power. `at` is the thickness to which the value belongs (`ThinLayer.at`). The power is declared in
    `powers`, and is otherwise 0.

    A law must define `stress(step)`, and `advance(step)` if it has internal variables; all other methods are optional.
    Strains, stresses and tensors are (3, 3), UFL, in 2D as well as in 3D.

    Attributes:
        powers: name of a parameter -> power of eps with which the interface law has a finite limit other than zero for
            eps -> 0.
        volume_compliance: for a law with a separate pressure field p (trait `constrained`), the volumetric strain
            divided by p; 0: incompressible.
        default_order: order of a layer's interface law if the user chooses none.
        methods: names of the method that computes the stress and of the one that computes the new internal variables,
            for messages.
        switching_variables: for laws whose phase switches, names of three internal variables: phase, driving force and
            transformation energy. They are the arguments of the law's methods `excess` and `switched`.
    """

    takes_fields: ClassVar = True
    volume_compliance: ClassVar[Expr] = 0.0
    default_order: ClassVar[int] = 0
    methods: ClassVar[tuple[str, str]] = ("stress", "advance")
    switching_variables: ClassVar[tuple[str, ...]] = ("phase", "drive", "bound")

    def _traits_of_methods(self) -> dict[str, bool]:
        cls, declared_traits = type(self), Traits.of_law(self)
        is_instantaneous = not (declared_traits.rate or self.internal)
        is_proportional = declared_traits.linear and is_instantaneous and self._stress_starts_at_zero()
        return super()._traits_of_methods() | {
            "has_energy": cls.energy is not BulkLaw.energy,
            "has_homotopy": cls.homotopy is not BulkLaw.homotopy,
            "stackable": not (declared_traits.constrained or declared_traits.switches),
            "in_ufl": True,
            "proportional": is_proportional,
            "compiled": declared_traits.varies or not is_proportional,
        }

    def _stress_starts_at_zero(self) -> bool:
        """Return whether the stress is zero without strain, as far as UFL sees it."""
        law = copy.copy(self)
        vars(law).update(dict.fromkeys(self.fields, 1.0))
        try:
            return isinstance(law.stress(Step(ufl.zero(3, 3), ufl.as_vector([0.0, 1.0, 0.0]))), Zero)
        except Exception:  # `forms.check` explains it
            return False

    def as_bulk_law(self) -> BulkLaw:
        return self

    # ---------------------------------------------------------------- equations, UFL
    def stress(self, step: Step) -> Expr:
        """Return the stress (3, 3), symmetric, UFL, at t + theta dt, the time in the step at which forces balance."""
        raise InputError(f"{type(self).__name__} has no stress; a law needs a method stress(step)")

    def advance(self, step: Step) -> dict[str, Expr]:
        """Return the internal variables at the end of the step, UFL by name; {} if there are none."""
        return {}

    def energy(self, step: Step) -> Expr:
        """Return the stored energy per unit volume, UFL, at the strain step.e and the internal variables step.q."""
        raise InputError(f"{type(self).__name__} declares no energy; a law needs a method energy(step) for it")

    def dissipation(self, step: Step) -> Expr:
        """Return the mean dissipated power per unit volume over the step, UFL: the dissipated energy divided by dt."""
        return ufl.as_ufl(0.0)

    def dissipated(self, step: Step) -> Expr:
        """Return the energy per unit volume that is dissipated in the step, UFL.

        A law without rate defines this method in place of `dissipation`.
        """
        return step.dt * self.dissipation(step)

    def end_constants(self) -> FreeEnd | None:
        """Return the constants of a free end with which the interface law of order 1 is corrected there.

        None: they are not known for this law.
        """
        return None

    def stations_at_ends(self, weights: EndWeights) -> list[AnyStation]:
        """Return the stations that the interface law of order 1 has near free ends of the layer.

        Only laws with `end_constants` define them.

        Args:
            weights: reductions of the stiffness near free ends, UFL on S.

        Raises:
            InputError: the law does not define stations near free ends.
        """
        raise InputError(f"{type(self).__name__} has no stations at free ends")

    def stations(self) -> list[AnyStation]:
        """Return the stations of the interface law of order 1: heights in the layer at which this law is evaluated.

        Each station also has its weight and the strain there. By default there are two, at the Gauss points through the
        thickness, for displacements linear from face to face.

        Raises:
            InputError: the law has no interface law of order 1.
        """
        if self.traits.switches or self.traits.softens:
            why = "its phases are of jumps" if self.traits.switches else "two stations would soften one by one"
            raise InputError(f"order=1 of {type(self).__name__}: {why}; use order=0")
        if self.traits.plateau:
            why = "phases may mix in sheets parallel to S, with strains that are not uniform through the layer"
            raise InputError(f"order=1 of {self!r}: {why}; use order=0")
        return gauss_stations(self)

    def elastic_moduli(self) -> tuple[float, float]:
        """Return Lame's moduli lmbda and mu, stresses, of an isotropic linear elastic law.

        Raises:
            InputError: the law is not isotropic linear elastic.
        """
        subject = f"order=1 of a Stack with the sublayer {type(self).__name__}"
        raise InputError(f"{subject}: all must be isotropic elastic (LinearElastic); {ORDER_0_REMEDY}")

    def law_step(self, step: Step) -> Step:
        """Return the step with which the law's methods are called, from the full `step` of a point.

        For a law without rate and internal variables it has only the strain at t + theta dt and the normal.
        """
        return step if self.traits.rate or self.internal else Step(step.mid, step.n)

    def remainder(self, step: Step) -> Expr:
        """Return the error of the time scheme in the energy balance of a step, UFL, per unit volume.

        It is stress : (e - e_old) minus the increase of the stored energy, minus the dissipated energy. If the energy
        is quadratic, the error is (2 theta - 1) times the energy of the increments of strain and internal variables. It
        is then >= 0, and zero for the midpoint rule. Where parameters depend on time, the model computes the error
        without this method.
        """
        new = self.advance(step)
        if self.traits.has_quadratic_energy:
            increments = {name: new[name] - step.q[name] for name in new}
            return (2 * step.theta - 1) * self.energy(Step(step.e - step.e_old, step.n, q=increments))
        stored_gain = self.energy(Step(step.e, step.n, q=new)) - self.energy(Step(step.e_old, step.n, q=step.q))
        return ufl.inner(self.stress(self.law_step(step)), step.e - step.e_old) - stored_gain - self.dissipated(step)

    # ---------------------------------------------------------------- numbers
    @property
    def memory(self) -> int:
        """Number of scalar internal variables at a point."""
        return sum(VARIABLE_SIZES[shape] for shape in self.internal.values())

    def stiffness(self, n: Array) -> Array | None:
        """Return the tangent d stress/d strain (6, 6) for small strains from the unstrained state, in Mandel's order.

        The parameters of the law must be numbers. `n` (d,) is the unit normal of the layer. None: the class does not
        define the tangent; `forms.law_tangents` computes it from the stress.
        """
        return None

    # ---------------------------------------------------------------- other laws of the same kind
    def homotopy(self, parameter: float) -> BulkLaw:
        """Return a law for homotopy continuation: this law, or one whose equilibrium is easier to compute.

        Args:
            parameter: from 0 (this law) to 1 (the law whose equilibrium is easiest to compute).
        """
        return self

    def plane_stress(self) -> BulkLaw:
        """Return the law of plane stress: in-plane stresses for in-plane strains; by default a `PlaneStressLaw`.

        Raises:
            InputError: the law has a pressure field or phases that switch, and its class does not override this method.
        """
        if self.traits.constrained or self.traits.switches:
            need = "its pressure needs" if self.traits.constrained else "its phases need"
            why = f"{type(self).__name__}, because {need} more than a strain out of the plane"
            raise InputError(f"plane stress is not defined for {why}; use plane='strain', or write plane_stress(self)")
        return PlaneStressLaw(self)

    @property
    def law_3d(self) -> BulkLaw:
        """Three-dimensional law from which this law was made, for example for plane stress; by default itself."""
        return self

    def condensed(self, C: Array) -> Array:
        """Return the tangent (6, 6) of this law, given the tangent `C` (6, 6) of its three-dimensional law `law_3d`.

        A law of plane stress condenses out the strains out of the plane, whose stresses vanish. Other laws return `C`.
        """
        return C

    def scaled(self, ratio: float) -> Self:
        """Return the law of a layer that is `ratio` times as thick, in the family of layers to which this law belongs.

        Each parameter is multiplied by ratio**power, with its power of eps in `powers`. Moduli, with the power 1, then
        give the same traction for a jump.
        """
        return self.mapped(lambda value, power: (value if callable(value) else np.asarray(value, float)) * ratio**power)


def _law_property(name: str) -> Any:
    """Return a property, for the class `WrappedLaw`, that reads the attribute or method `name` of the wrapped law."""
    return property(attrgetter(f"law.{name}"))


@dataclass(frozen=True, eq=False)
class WrappedLaw(BulkLaw):
    """Base of laws that change the equations of another law, and keep its parameters and internal variables.

    Attributes:
        law: the other law.
    """

    law: Any  # BulkLaw or TractionLaw, as subclasses say

    def __post_init__(self) -> None:
        """Check nothing, since the wrapped law has been checked when it was made."""

    powers, internal, break_times, fields = map(_law_property, ("powers", "internal", "break_times", "fields"))
    unknown = _law_property("unknown")
    fields_at, at, parameters = map(_law_property, ("fields_at", "at", "parameters"))
    check, check_dimension = map(_law_property, ("check", "check_dimension"))
    statuses, status_at, plastic_strain = map(_law_property, ("statuses", "status_at", "plastic_strain"))
    share_columns, shares, mean_shares = map(_law_property, ("share_columns", "shares", "mean_shares"))

    def choices(self) -> tuple[tuple[str, object], ...]:
        return ("law", type(self.law)), *self.law.choices()

    def with_parameters(self, values: Mapping[str, object]) -> Self:
        return self._with_law(self.law.with_parameters(values))

    def mapped(self, change: ChangeParameter) -> Self:
        return self._with_law(self.law.mapped(change))

    def _with_law(self, law: Law) -> Self:
        """Return a copy that wraps `law`, for example the wrapped law with other parameters; nothing is checked."""
        return super().with_parameters({"law": law})

    def plane_stress(self) -> Self:
        return self


OUT_OF_PLANE_VARIABLE = "out_of_plane"  # internal variable: Mandel components 33, 13 and 23 of the strain
IN_PLANE_MANDEL, OUT_OF_PLANE_MANDEL = [0, 1, 3], [2, 4, 5]  # indices of Mandel components


class PlaneStressLaw(WrappedLaw):
    """Plane-stress form of a three-dimensional law: its out-of-plane strains make the out-of-plane stresses zero.

    These stresses vanish at t + theta dt, the time of the step at which forces balance. At each point compiled code
    (`thinlayer/pointwise/response.c`) computes the out-of-plane strains by Newton's method. They are stored after the
    internal variables of the three-dimensional law, which gets all strains, old and new. The tangent is condensed by a
    Schur complement. The energies are those of the three-dimensional law. If no such strains are found at a point, the
    point fails, and the solver takes a smaller step.

    Attributes:
        law: the three-dimensional law.
    """

    ignored: ClassVar = ("stress", "advance", "energy", "dissipation", "dissipated")

    @cached_property
    def traits(self) -> Traits:
        varies = self.law.traits.varies or bool(self.law.fields)  # not isochoric: in-plane areas may change in any flow
        return replace(self.law.traits, compiled=True, varies=varies, isochoric=False)

    @property
    def internal(self) -> Mapping[str, tuple[int, ...]]:  # type: ignore[override]
        return {**self.law.internal, OUT_OF_PLANE_VARIABLE: (3,)}

    @property
    def memory(self) -> int:
        return self.law.memory + 3

    @property
    def law_3d(self) -> BulkLaw:
        return self.law

    def homotopy(self, parameter: float) -> Self:
        return self._with_law(self.law.homotopy(parameter))

    def condensed(self, C: Array) -> Array:
        """Return the tangent (6, 6) of plane stress, given the tangent `C` (6, 6) of the three-dimensional law.

        The strains out of the plane are condensed out, as their stresses vanish: the in-plane components are a Schur
        complement of C. The other components are those of the isotropic tensor nearest to C, with the modulus lmbda of
        plane stress.
        """
        lmbda, mu = average_lame(C)
        lmbda *= 2 * mu / (lmbda + 2 * mu) if lmbda + 2 * mu > 0 else 0.0
        tangent = isotropic_tensor(lmbda, mu)
        tangent[np.ix_(IN_PLANE_MANDEL, IN_PLANE_MANDEL)] = condensed_tangent(C, IN_PLANE_MANDEL, OUT_OF_PLANE_MANDEL)
        return tangent


def scalar_field_names(cls: type[Law]) -> set[str]:
    """Return the names of those dataclass fields of a law class whose values are single numbers.

    Such a field is annotated as float or int, or as a union of these with None or functions. The text of the annotation
    decides.
    """
    annotations = {f.name: str(f.type) for f in fields(cls)}
    number_names = {name for name, text in annotations.items() if NUMBER_ANNOTATION.search(text)}
    return {name for name in number_names if not ARRAY_ANNOTATION.search(annotations[name])}


@contextmanager
def explained_errors(law: Law, method: str) -> Iterator[None]:
    """Turn errors of a law's method in this context into InputErrors that tell the law and the rules for writing laws.

    Args:
        law: the law.
        method: name of the method that is called in the context.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"{type(law).__name__}.{method}: {type(error).__name__}: {error!s:.200}. Laws are UFL, of tensors (3, 3): "
            "ufl.exp, ufl.conditional(ufl.lt(a, b), c, d); step.rate needs rate = True, step.dt and e_old that or internal "
            f"variables; step.n is (3,); step.q has {sorted(law.internal) or 'nothing'}"
        ) from error


def require_shape(law: Law, output: str, value: Expr, shape: tuple[int, ...]) -> Expr:
    """Return the value of a law's method as UFL, or raise InputError if it does not have the shape `shape`.

    Args:
        law: the law, for messages.
        output: name of the value, for messages.
        value: the value, UFL or a number.
        shape: the shape that it must have.
    """
    try:
        expression = ufl.as_ufl(value)
    except Exception as error:
        raise InputError(f"{type(law).__name__}.{output} is {value!r}; it must be UFL of shape {shape}") from error
    if expression.ufl_shape != shape:
        raise InputError(f"{type(law).__name__}.{output} has the shape {expression.ufl_shape}; it must have {shape}")
    return expression


def checked_stress(law: BulkLaw, step: Step) -> Expr:
    """Return the stress (3, 3), UFL, that a law computes for a step.

    Raises:
        InputError: the law's method fails, or its result has another shape.
    """
    with explained_errors(law, law.methods[0]):
        return require_shape(law, law.methods[0], law.stress(step), (3, 3))


def require_positive(law: Law, *names: str) -> None:
    """Raise InputError unless the parameters `names` of the law are finite and > 0."""
    for name in names:
        law.require(0 < getattr(law, name) < math.inf, name, "> 0, finite")


def require_nonnegative(law: Law, *names: str) -> None:
    """Raise InputError unless the parameters `names` of the law are finite and >= 0."""
    for name in names:
        law.require(0 <= getattr(law, name) < math.inf, name, ">= 0, finite")
