"""Base classes of constitutive laws, which give stresses for strains. They know no thickness, mesh or time loop."""

from __future__ import annotations

import copy
import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, TypeVar

import numpy as np
import ufl

from forms.base import Array, InputError, require
from forms.layer_results import LayerResults
from forms.parameter_fields import (
    MAX_CHECKED_PLACES,
    ParameterField,
    ParameterRangeError,
    ParameterValue,
    as_parameter_field,
    extreme_places,
    failure_text,
    parameter_numbers,
    place_text,
)
from forms.stations import AnyStation, gauss_stations
from forms.tensors import Expr, average_lame, condensed_tangent, isotropic_tensor
from forms.traits import VARIABLE_SIZES, Traits, accept_renamed, require_declarations, reset_inherited

if TYPE_CHECKING:
    from forms.ends.weights import EndStrips, EndWeights


MISSING_VALUE = object()
NUMBER_ANNOTATION = re.compile(r"\b(float|int)\b")
ARRAY_ANNOTATION = re.compile("array|list|tuple|sequence|callable", re.IGNORECASE)
ORDER_0_REMEDY = "use order=0, or mesh the layer (structure.full)"
ChoiceType = TypeVar("ChoiceType")
ChangeParameter = Callable[[ParameterValue, float], ParameterValue]  # of a parameter and its power of eps


class Step(NamedTuple):
    """Input of a law at one point, over a time step from t to t + dt.

    Forces balance at t + theta dt, and the law's stress is that at this time.

    Attributes:
        e: strain at the end of the step, (3, 3). For the stress of laws without rate and internal variables it is the
            strain at t + theta dt. This applies in a body, in a meshed layer, on S and in a `Stack`.
        n: director of the layer: unit vector from the lower to the upper body; None inside a body. Compiled laws
            (`Traits.compiled`) get (3,), in 2D with a zero; laws whose stress is part of a form get (d,) in d
            dimensions. `forms.tensors.three_dimensional(n)` is (3,) in both cases.
        e_old: strain at the beginning, (3, 3); None in problems without time, and for laws without rate and internal
            variables.
        q: internal variables at the beginning, by name.
        dt: length of the step; 0 at a sudden load; None in problems without time.
        theta: fraction of the step after which forces balance; from 1 (backward Euler) down to 1/2 (midpoint).
        rates: whether the law declares `rate`, so that it may use the strain rate.
    """

    e: Expr
    n: Expr | None = None
    e_old: Expr | None = None
    q: Mapping[str, Expr] = {}
    dt: Expr | None = None
    theta: Expr = 1.0
    rates: bool = True

    @property
    def mid(self) -> Expr:
        """Strain (3, 3) at t + theta dt, the time of the stress."""
        return self.e if self.e_old is None else self.theta * self.e + (1 - self.theta) * self.e_old

    @property
    def rate(self) -> Expr:
        """Strain rate (3, 3) of the step, (e - e_old)/dt.

        Raises:
            InputError: the law does not declare `rate`, or the step has no length.
        """
        if self.dt is None or not self.rates:
            raise InputError("a law that uses step.rate must declare rate = True")
        return (self.e - self.e_old) / self.dt

    def between(self, old: Expr, new: Expr) -> Expr:
        """Value at t + theta dt of a quantity that is `old` at the beginning and `new` at the end of the step."""
        return self.theta * new + (1 - self.theta) * old


def choice(default: ChoiceType) -> ChoiceType:
    """Declare a field of a law that selects between equations and is not a parameter.

    The law is compiled separately for each value of the field.

    Args:
        default: value of the field if none is given.
    """
    return field(default=default, metadata={"choice": True})


@dataclass(frozen=True, eq=False)  # compared by identity, unless a law defines ==
class Law(LayerResults):
    """Base of the three kinds of laws: a frozen dataclass whose fields are its parameters.

    Laws derive from `BulkLaw` (of strains), `TractionLaw` (of jumps) or `ContactLaw` (of nodes). A class declares its
    traits (`Traits`) as attributes, such as `linear = True`.

    Attributes:
        powers: name of a parameter -> power of the thickness eps to which it is proportional in a family of layers;
            only a `BulkLaw` has powers.
        internal: internal variables, name -> shape: (), (3,) or (3, 3), symmetric. They start from zero.
        functions: names of parameters that may be functions other than those of `takes_fields`, such as functions of a
            temperature. `parameters` gives NaN for such a function, `at` gives its values.
        ignored: names of methods that are never called, because other methods replace them.
        takes_fields: whether scalar parameters may be numpy functions of places (d, n) in the joint that return (n,).
    """

    takes_fields: ClassVar[bool] = False
    powers: ClassVar[Mapping[str, float]] = {}
    internal: ClassVar[Mapping[str, tuple[int, ...]]] = {}
    functions: ClassVar[tuple[str, ...]] = ()
    ignored: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        accept_renamed(cls, {"eased": "homotopy"})
        reset_inherited(cls)

    def __post_init__(self) -> None:
        for f in fields(self):
            reserved = any(f.name in vars(base) for base in type(self).__mro__ if base.__module__ == __name__)
            self.require(not reserved, f"the parameter {f.name!r}", "another one", "a name that all laws use")
            allowed = "a number" + (", a function in numpy" if f.name in self.functions else "")
            self.require(not isinstance(getattr(self, f.name), ufl.core.expr.Expr), f.name, allowed, "a UFL expression")
        scalars = scalar_fields(type(self))
        for f in fields(self):
            scalar = f.name in scalars
            if scalar and f.name not in self.functions and self.takes_fields:
                object.__setattr__(self, f.name, as_parameter_field(getattr(self, f.name)))
            self._check_number(f.name, getattr(self, f.name), f.default is None, scalar)
        for name in self.fields:
            self.require(type(self).at is Law.at, name, "a number, as `at` gives what varies", "a function of places")
        if not self.fields:  # parameters that are functions need places, see `check_at`
            self.check()
        _ = self.traits  # raises InputError for wrong declarations of the class
        require_declarations(self)

    def _check_number(self, name: str, value: object, may_be_none: bool, scalar: bool) -> None:
        function = isinstance(value, ParameterField) or (callable(value) and name in self.functions)
        if function or (value is None and may_be_none) or name not in self.parameters():
            return
        try:
            array = np.asarray(value)
        except ValueError:  # ragged
            array = np.asarray("")
        numeric = array.dtype.kind in "iuf" and not (scalar and array.ndim)
        require(numeric, f"{type(self).__name__}: {name}", value, f"allowed: {'a number' if scalar else 'numbers'}")

    def check(self) -> None:
        """Raise InputError if a parameter is out of its range."""

    def require(self, condition: bool, name: str, allowed: str, value: object = MISSING_VALUE) -> None:
        """Raise InputError "Law: name is value; allowed: ..." unless a condition is true.

        Args:
            condition: the condition.
            name: name of the parameter, or of what is wrong.
            allowed: text of the allowed values.
            value: value to report; default: the law's attribute `name`.
        """
        if not condition:
            value = getattr(self, name) if value is MISSING_VALUE else value
            raise InputError(f"{type(self).__name__}: {name} is {value}; allowed: {allowed}")

    def check_dimension(self, d: int) -> None:
        """Raise InputError if the law cannot be used in a model of d dimensions, 2 or 3."""

    @cached_property
    def traits(self) -> Traits:
        """Properties of the law by which models and solvers choose their methods.

        They are computed from the original parameters. Copies in which other numbers or symbols replace these keep the
        traits.
        """
        traits = Traits.of(self, **self._traits_of_methods())
        return replace(traits, varies=True) if self.fields and traits.compiled else traits

    def for_points(self) -> Self:
        """A copy of the law that is compiled and evaluated at quadrature points.

        Its parameters may then be functions of the place, which they may not be in a law whose stress is part of a UFL
        form.
        """
        law = self.with_parameters({})
        object.__setattr__(law, "traits", replace(self.traits, compiled=True, varies=bool(self.fields)))
        return law

    def _traits_of_methods(self) -> dict[str, bool]:
        """Traits, by name, that follow from the methods and internal variables of the class."""
        return {"remembers": bool(self.internal)}

    def as_bulk_law(self) -> BulkLaw:
        """The same law as a function of strains, as terms of the weak form and compiled code need it.

        Raises:
            InputError: the law acts at nodes.
        """
        raise InputError(f"{type(self).__name__} has neither strains nor jumps; derive it from BulkLaw or TractionLaw")

    @property
    def own_times(self) -> tuple[float, ...]:
        """Creep or relaxation times of a law whose parameters are numbers; () if there are none or they are unknown."""
        return ()

    @property
    def sublayers(self) -> tuple[tuple[float, Any], ...]:
        """Fraction of the thickness and law of each sublayer, from the lower to the upper face.

        A law other than a `Stack` has one sublayer, itself.
        """
        return ((1.0, self),)

    def at(self, x: Array, t: float) -> dict[str, Array]:
        """Values (n,), by name, of the parameters that vary, at n places and one time.

        The parameters of `self` are already scaled to the thickness of its layer, so the values must be multiples of
        them.

        Args:
            x: places (d, n) in the joint as drawn, before S is opened to the layer's thickness.
            t: time. For the stress of a step it is the time at which forces balance, for the stored energy the end of
                the step.
        """
        return {}

    @property
    def break_times(self) -> set[float]:
        """Times at which the slope of a parameter made with `thinlayer.piecewise` changes."""
        return set().union(*(getattr(getattr(self, name), "times", ()) for name in self.functions))

    def parameters(self) -> dict[str, ParameterValue]:
        """Values (numbers, arrays, functions or UFL) of all parameters, by name; a `choice` is not a parameter."""
        return {f.name: getattr(self, f.name) for f in fields(self) if "choice" not in f.metadata}

    def choices(self) -> tuple[tuple[str, object], ...]:
        """Name and value of every field that is not a parameter."""
        parameters = self.parameters()
        return tuple((f.name, getattr(self, f.name)) for f in fields(self) if f.name not in parameters)

    def parameter_values(self) -> Array:
        """All numbers of all parameters, one after the other, (k,); NaN for functions."""
        values = [np.ravel(parameter_numbers(value)) for value in self.parameters().values()]
        return np.concatenate([np.empty(0), *values])

    def with_parameters(self, values: Mapping[str, object]) -> Self:
        """A copy with other values of some parameters, numbers or UFL by name; their ranges are not checked."""
        law = copy.copy(self)
        vars(law).update({"traits": self.traits, **values})
        return law

    def mapped(self, change: ChangeParameter) -> Self:
        """A copy in which each parameter is replaced by change(value, power); the new values are not checked.

        Args:
            change: function of a parameter's value and of its power of eps in `powers`, 0 if it has none.
        """
        changed = {name: change(value, self.powers.get(name, 0)) for name, value in self.parameters().items()}
        return self.with_parameters(changed)

    # ---------------------------------------------------------------- parameters that are functions of the place
    @property
    def fields(self) -> dict[str, ParameterField]:
        """Parameters that are functions of the place, by name."""
        return {name: value for name, value in vars(self).items() if isinstance(value, ParameterField)}

    def fields_at(self, x: Array) -> dict[str, Array]:
        """Values (n,), by name, of the parameters that are functions of the place.

        Args:
            x: places (d, n) in the joint as drawn, before S is opened to the layer's thickness.

        Raises:
            InputError: a function fails, does not return n finite real numbers, or is out of range at a place.
        """
        return {name: self._field_at(name, parameter, x) for name, parameter in self.fields.items()}

    def _field_at(self, name: str, parameter: ParameterField, x: Array) -> Array:
        try:
            return parameter(x)
        except ParameterRangeError as error:
            reason = str(error) if str(error)[:1].isalpha() and " is " in str(error) else f"{name} is {error}"
            raise InputError(f"{type(self).__name__}: {reason}, at {place_text(x, error.k)}") from None
        except Exception as error:
            what, wanted = f"{type(self).__name__}: {name}(x)", "it must be a numpy function of places (d, n)"
            raise InputError(f"{failure_text(what, x, error)}; {wanted} in the joint that gives n numbers") from error

    def at_places(self, x: Array) -> Iterator[Self]:
        """Yield the law with the numbers that its parameters have at each of the places x (d, n), without checks."""
        values = self.fields_at(x)
        for k in range(x.shape[1]):
            yield self.with_parameters({name: float(value[k]) for name, value in values.items()})

    def check_at(self, x: Array) -> None:
        """Raise InputError if a parameter is out of its range at one of the places x (d, n).

        Of many places only some are checked. These are the places where a parameter, or a difference or ratio of two,
        is smallest or largest, and one to two thousand others.
        """
        if not self.fields:
            return
        values, n = list(self.fields_at(x).values()), x.shape[1]
        at = sorted({*extreme_places(values, differences=True), *range(0, n, max(n // MAX_CHECKED_PLACES, 1))})
        for k, law in zip(at, self.at_places(x[:, at]), strict=True):
            try:
                law.check()
            except InputError as error:
                raise InputError(f"{error}, at {place_text(x, k)}") from None

    def samples(self, x: Array) -> list[Self]:
        """Laws with numbers for parameters, as they are at the extreme ones of the places x (d, n).

        These are the places where a parameter, or the ratio of two, is smallest or largest. Without parameters that are
        functions of the place the result is the law itself.

        Raises:
            InputError: a parameter is out of its range at one of these places.
        """
        if not self.fields:
            return [self]
        extreme_x = x[:, extreme_places(list(self.fields_at(x).values()))]
        self.check_at(extreme_x)
        return list(self.at_places(extreme_x))


class BulkLaw(Law):
    """A law of strains, for the material of a layer or of a body.

    Its parameters are material parameters. A `ThinLayer` may be one of a family of layers, whose parameters depend on
    the thickness eps. Then a parameter is value * (eps/at)**power: `at` is the thickness for which the value is given
    (`ThinLayer.at`), and the power is declared here (0 by default).

    A law must define `stress(step)`, and `advance(step)` if it has internal variables; all other methods are optional.
    Strains, stresses and tensors are (3, 3), UFL, in a body, in the meshed layer, on S and in a `Stack`.

    Attributes:
        powers: name of a parameter -> power of eps with which the interface law stays finite and not zero as eps -> 0.
        volume_compliance: tr e/p of a law with a pressure p (trait `constrained`); 0: incompressible.
        methods: names of the methods that compute the stress and the new internal variables, for messages.
        switching_variables: for laws that switch between phases, names of the internal variables that are the arguments
            of `excess` and `switched`. The phase is the first.
    """

    takes_fields: ClassVar = True
    volume_compliance: ClassVar[Expr] = 0.0
    methods: ClassVar[tuple[str, str]] = ("stress", "advance")
    switching_variables: ClassVar[tuple[str, ...]] = ("phase", "drive", "bound")

    def _traits_of_methods(self) -> dict[str, bool]:
        cls, declared = type(self), Traits.of(self)
        return super()._traits_of_methods() | {
            "has_energy": cls.energy is not BulkLaw.energy,
            "has_homotopy": cls.homotopy is not BulkLaw.homotopy,
            "in_series": not (declared.constrained or declared.switches),
            "in_ufl": True,
            "compiled": declared.rate or bool(self.internal) or declared.varies,
        }

    def as_bulk_law(self) -> BulkLaw:
        return self

    # ---------------------------------------------------------------- equations, UFL
    def stress(self, step: Step) -> Expr:
        """Stress at t + theta dt, (3, 3), symmetric, UFL."""
        raise InputError(f"{type(self).__name__} has no stress; a law needs a method stress(step)")

    def advance(self, step: Step) -> dict[str, Expr]:
        """Internal variables at the end of the step, UFL by name; {} if there are none."""
        return {}

    def energy(self, step: Step) -> Expr:
        """Stored energy per unit volume of the strain step.e and the internal variables step.q, UFL."""
        raise InputError(f"{type(self).__name__} declares no energy; a law needs a method energy(step) for it")

    def dissipation(self, step: Step) -> Expr:
        """Dissipated power per unit volume, UFL, whose product with dt is the energy dissipated in the step."""
        return ufl.as_ufl(0.0)

    def dissipated(self, step: Step) -> Expr:
        """Dissipated energy per unit volume in the step, UFL; laws without rate define it in place of `dissipation`."""
        return step.dt * self.dissipation(step)

    def end_strips(self) -> EndStrips | None:
        """Strips along a free end in which the interface law of order 1 is less stiff than elsewhere.

        None: they are not known for this law.
        """
        return None

    def stations_at_ends(self, weights: EndWeights) -> list[AnyStation]:
        """Stations of the interface law of order 1 near free ends of the layer; only for laws with `end_strips`.

        Args:
            weights: reductions of the stiffness near free ends, UFL on S.

        Raises:
            InputError: the law does not define them.
        """
        raise InputError(f"{type(self).__name__} has no stations at free ends")

    def stations(self) -> list[AnyStation]:
        """Stations of the interface law of order 1: heights through the layer, and the strains of the law there.

        The default is two Gauss points through the thickness, with displacements linear from face to face.

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
        """Lame's moduli lmbda and mu of an isotropic linear elastic law.

        Raises:
            InputError: the law is not isotropic linear elastic.
        """
        what = f"order=1 of a Stack with the sublayer {type(self).__name__}"
        raise InputError(f"{what}: all must be isotropic elastic (LinearElastic); {ORDER_0_REMEDY}")

    def own_step(self, step: Step) -> Step:
        """Step that the law's methods get, from the step of a point.

        Laws without rate and internal variables get only the strain at t + theta dt and n.
        """
        return step if self.traits.rate or self.internal else Step(step.mid, step.n)

    def remainder(self, step: Step) -> Expr:
        """Error of the time scheme in the energy balance of a step, UFL, per volume.

        It is stress : (e - e_old) minus the increase of the stored energy, minus the dissipated energy. For a quadratic
        energy E it is (2 theta - 1) E(increments), which is >= 0, and zero for the midpoint rule. Where parameters
        vary, the model computes the difference without this method.
        """
        new = self.advance(step)
        if self.traits.quadratic:
            increments = {name: new[name] - step.q[name] for name in new}
            return (2 * step.theta - 1) * self.energy(Step(step.e - step.e_old, step.n, q=increments))
        stored = self.energy(Step(step.e, step.n, q=new)) - self.energy(Step(step.e_old, step.n, q=step.q))
        return ufl.inner(self.stress(self.own_step(step)), step.e - step.e_old) - stored - self.dissipated(step)

    # ---------------------------------------------------------------- numbers
    @property
    def memory(self) -> int:
        """Number of scalar internal variables at a point."""
        return sum(VARIABLE_SIZES[shape] for shape in self.internal.values())

    def stiffness(self, n: Array) -> Array | None:
        """Tangent d stress/d strain (6, 6) at rest, in Mandel's order, for a unit normal n (d,) of the layer.

        The law's parameters are numbers. None: the class does not define it, and `forms.law_tangents` differentiates
        the stress.
        """
        return None

    # ---------------------------------------------------------------- other laws of the same kind
    def homotopy(self, parameter: float) -> BulkLaw:
        """Homotopy law for continuation: this law, or one whose equilibrium is easier to compute.

        Args:
            parameter: 0: this law; up to 1: the law with the easiest equilibrium.
        """
        return self

    def plane_stress(self) -> BulkLaw:
        """The law of in-plane strains with zero out-of-plane stresses; by default `PlaneStressLaw`.

        Raises:
            InputError: the law has a pressure field or phases that switch, and does not override plane_stress.
        """
        if self.traits.constrained or self.traits.switches:
            lack = "its pressure needs" if self.traits.constrained else "its phases need"
            why = f"{type(self).__name__}, because {lack} more than a strain out of the plane"
            raise InputError(f"plane stress is not defined for {why}; use plane='strain', or write plane_stress(self)")
        return PlaneStressLaw(self)

    @property
    def in_space(self) -> BulkLaw:
        """The three-dimensional law from which this law was made, as for plane stress; by default the law itself."""
        return self

    def condensed(self, C: Array) -> Array:
        """Tangent (6, 6) of this law from the tangent C (6, 6) of the three-dimensional law `in_space`."""
        return C

    def scaled(self, ratio: float) -> Self:
        """The law that gives the same interface law in a layer `ratio` times as thick.

        Each parameter is multiplied by ratio**power, with its power of eps in `powers`.
        """
        return self.mapped(lambda value, power: (value if callable(value) else np.asarray(value, float)) * ratio**power)


def _delegated(name: str) -> Any:
    """Property of a `WrappedLaw` that returns the attribute or method `name` of the wrapped law."""
    return property(attrgetter(f"law.{name}"))


@dataclass(frozen=True, eq=False)
class WrappedLaw(BulkLaw):
    """Base of laws that rewrite another law, with the parameters and internal variables of the wrapped law.

    Attributes:
        law: the wrapped law.
    """

    law: Any  # BulkLaw or TractionLaw, as subclasses say

    def __post_init__(self) -> None:
        """Check nothing: the wrapped law has been checked."""

    powers, internal, break_times, fields = map(_delegated, ("powers", "internal", "break_times", "fields"))
    fields_at, at, parameters = map(_delegated, ("fields_at", "at", "parameters"))
    check, check_dimension = map(_delegated, ("check", "check_dimension"))
    statuses, status_at, plastic_strain = map(_delegated, ("statuses", "status_at", "plastic_strain"))
    share_columns, shares, mean_shares = map(_delegated, ("share_columns", "shares", "mean_shares"))

    def choices(self) -> tuple[tuple[str, object], ...]:
        return ("law", type(self.law)), *self.law.choices()

    def with_parameters(self, values: Mapping[str, object]) -> Self:
        return self._of(self.law.with_parameters(values))

    def mapped(self, change: ChangeParameter) -> Self:
        return self._of(self.law.mapped(change))

    def _of(self, law: Law) -> Self:
        """The same wrapper around another law, such as the wrapped law with other parameters; not checked."""
        return super().with_parameters({"law": law})

    def plane_stress(self) -> Self:
        return self


OUT_OF_PLANE_VARIABLE = "out_of_plane"  # internal variable: Mandel components 33, 13 and 23 of the strain
IN_PLANE_MANDEL, OUT_OF_PLANE_MANDEL = [0, 1, 3], [2, 4, 5]  # indices of Mandel components


class PlaneStressLaw(WrappedLaw):
    """Plane-stress form of a 3D law: its out-of-plane strains make the out-of-plane stresses zero at t + theta dt.

    Forces balance at this time of a step from t to t + dt. Compiled code (`thinlayer/pointwise/response.c`) solves for
    the out-of-plane strains at each point by Newton's method. They are stored after the internal variables of the 3D
    law, which gets all strains, old and new. The tangent is condensed (Schur complement); the energies are the 3D
    law's. If no such strains are found at a point, the point fails, and the solver takes a smaller step.

    Attributes:
        law: the law in three dimensions.
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
    def in_space(self) -> BulkLaw:
        return self.law

    def homotopy(self, parameter: float) -> Self:
        return self._of(self.law.homotopy(parameter))

    def condensed(self, C: Array) -> Array:
        """Tangent (6, 6) of plane stress from the tangent C (6, 6) of the 3D law, by a Schur complement.

        The rows and columns of out-of-plane strains are those of the isotropic tensor nearest to C, with lmbda of plane
        stress.
        """
        lmbda, mu = average_lame(C)
        lmbda *= 2 * mu / (lmbda + 2 * mu) if lmbda + 2 * mu > 0 else 0.0
        tangent = isotropic_tensor(lmbda, mu)
        tangent[np.ix_(IN_PLANE_MANDEL, IN_PLANE_MANDEL)] = condensed_tangent(C, IN_PLANE_MANDEL, OUT_OF_PLANE_MANDEL)
        return tangent


def scalar_fields(cls: type[Law]) -> set[str]:
    """Names of the dataclass fields of a law class whose values are single numbers.

    These are fields annotated as float or int, or as a union of these with None or functions. The annotation is matched
    as text.
    """
    annotations = {f.name: str(f.type) for f in fields(cls)}
    number_fields = {name for name, text in annotations.items() if NUMBER_ANNOTATION.search(text)}
    return {name for name in number_fields if not ARRAY_ANNOTATION.search(annotations[name])}


@contextmanager
def explained_errors(law: Law, method: str) -> Iterator[None]:
    """Context that turns errors of a law's method into InputError with the law's name and rules for writing laws."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"{type(law).__name__}.{method}: {type(error).__name__}: {error!s:.200}. Laws are UFL, of tensors (3, 3): "
            "ufl.exp, ufl.conditional(ufl.lt(a, b), c, d); step.dt, e_old and rate need rate = True or internal variables; "
            f"step.n is (d,), three_dimensional(step.n) is (3,); step.q has {sorted(law.internal) or 'nothing'}"
        ) from error


def require_shape(law: Law, output: str, value: Expr, shape: tuple[int, ...]) -> Expr:
    """Return the value of a law's method as UFL, or raise InputError if it is no UFL or number of the given shape.

    Args:
        law: the law, for messages.
        output: name of the value, for messages.
        value: the value.
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
    """Stress (3, 3) of a law in a step.

    Raises:
        InputError: the law's method fails or returns another shape.
    """
    with explained_errors(law, law.methods[0]):
        return require_shape(law, law.methods[0], law.stress(step), (3, 3))


def require_positive(law: Law, *names: str) -> None:
    """Raise InputError unless the parameters of the law with these names are finite and > 0."""
    for name in names:
        law.require(0 < getattr(law, name) < math.inf, name, "> 0")


def require_nonnegative(law: Law, *names: str) -> None:
    """Raise InputError unless the parameters of the law with these names are finite and >= 0."""
    for name in names:
        law.require(0 <= getattr(law, name) < math.inf, name, ">= 0, finite")
