"""Coefficient: a user's value of place and time for loads, supports, stiffnesses and strains, checked once."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from dataclasses import replace as changed
from functools import cached_property, reduce, wraps
from inspect import signature
from itertools import product
from typing import Any, Protocol, Self, TypeAlias, TypeVar, runtime_checkable
from weakref import WeakSet

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem, geometry
from dolfinx.mesh import Mesh
from ufl.algorithms.analysis import extract_coefficients, extract_constants
from ufl.conditional import Condition
from ufl.constantvalue import ComplexValue, RealValue
from ufl.corealg.traversal import unique_pre_traversal
from ufl.geometry import GeometricQuantity

from forms.base import Array, InputError, is_finite, is_number, require
from forms.tensors import Expr
from geometry.domain import Domain
from geometry.joint import Joint
from geometry.refusals import place_text as at_place
from geometry.refusals import require_known
from thinlayer.errors import FormerNames
from thinlayer.system.compat import interpolate, interpolation_points, ufl_replace
from thinlayer.system.ranks import communicator

T = TypeVar("T")
Value = float | Callable[[Expr, Expr], Expr]
LoadInput = Sequence[float] | Callable[[Expr, Expr], Sequence[Expr]]
Shape = tuple[int, ...]
ComponentArray = npt.NDArray[np.object_]  # numbers, or UFL scalars
NestedComponents: TypeAlias = "Expr | float | npt.NDArray[np.object_] | Sequence[NestedComponents]"  # or rows of them

SYMBOL_VALUE_TOLERANCE = 1e-9  # largest relative difference of a function's values for symbols and for numbers
INWARD_SHIFT = 1e-6  # shift of a place towards the middle of its cell, to one side of S, over its distance from there
NUMPY_DEGREE = 2  # degree of interpolants of numpy functions
COMPARISON_TIMES = (0.37, 0.0, 1.0, 2.0)  # times at which a function's values for symbols and for numbers are compared
NUMPY_HINT = (
    "x and t are symbols for all places and times, not numbers: use ufl.sin(t), ufl.conditional(ufl.gt(t, 1), a, b), "
    "..., and piecewise({time: value, ...}) for a table"
)


class Clock:
    """The time of a model, as a constant in UFL forms.

    The constant has a value only inside the context `at`, which sets a time. Otherwise it is NaN, so that no form reads
    an old time unnoticed. Forms that contain several times use `TimeLevel`.

    Attributes:
        symbol: the time, a UFL constant.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.symbol = TimeConstant(mesh)

    @contextmanager
    def at(self, t: float) -> Iterator[None]:
        """Return a context in which forms are assembled at the time t."""
        old_time = float(self.symbol)
        self._set_time(t)
        try:
            yield
        finally:
            self._set_time(old_time)

    def _set_time(self, t: float) -> None:
        for constant in self.symbol.time_constants:
            set_value(constant, constant.at(t))


class TimeDependent:
    """A constant or function in UFL forms whose values depend on the time of a clock, `symbol.time_constants` of it.

    Attributes:
        kinks: times at which the slope of its values changes, as far as they are known.
    """

    kinks: Collection[float] = frozenset()

    def at(self, t: float) -> float | Array:
        """Return the value, or the degrees of freedom on this rank, at the time t."""
        raise NotImplementedError

    def copy_at(self, t: float) -> fem.Constant | fem.Function:
        """Return a constant or function with the values at the time t."""
        raise NotImplementedError


class TimeConstant(fem.Constant, TimeDependent):  # in this order: FFCx follows the first bases
    """The time of a clock as a constant in UFL forms, or a constant that depends on this time alone.

    Attributes:
        mesh: the mesh.
        time_constants: all constants and functions of the same clock.
    """

    def __init__(self, mesh: Mesh, value: float | Array = math.nan) -> None:
        super().__init__(mesh, value)
        self.mesh, self.time_constants = mesh, WeakSet[TimeDependent]([self])

    def __eq__(self, other: object) -> bool:
        if is_number(other):  # UFL would return False, and the load would never see its time
            raise TypeError(f"t == {other!r} asks a symbol for its value")
        return bool(super().__eq__(other))

    __hash__ = fem.Constant.__hash__

    def at(self, t: float) -> float | Array:
        """Return the value at the time t."""
        return t

    def copy_at(self, t: float) -> fem.Constant:
        """Return a constant with the value at the time t."""
        return fem.Constant(self.mesh, np.array(self.at(t), float))


def time_constants(expression: Expr) -> list[TimeDependent]:
    """Return what an expression or a form has of clocks: constants and fields in time; none if it has no time."""
    return [
        c for c in (*extract_constants(expression), *extract_coefficients(expression)) if isinstance(c, TimeDependent)
    ]


def set_value(target: fem.Constant | fem.Function, value: float | Array) -> None:
    """Set the value of a constant, or the degrees of freedom of a function."""
    if isinstance(target, fem.Function):
        target.x.array[:] = value
    else:
        target.value = value


@dataclass(frozen=True)
class Coordinates(FormerNames):
    """Place and time as arguments of users' functions.

    For kept bodies the place is that in the joint as drawn, before S is opened to the layer's thickness.

    Attributes:
        domain: the distributed mesh, with its joint.
        x: (d,) UFL coordinates in d dimensions.
        clock: clock of the model, which holds the time.
        test_places: (n, d) coordinates of n vertices of the joint, extreme ones among them, where functions are tested.
        cache: coefficients made so far.
        planned_kinks: list with one set of times at which coefficients change their slope, as last read by a march. It
            is empty before the first march.
        in_layers: whether they are those in layers, on S or meshed.
    """

    former_names = {"given": "coefficient"}
    domain: Domain
    x: Expr
    clock: Clock
    test_places: Array
    cache: dict[tuple[object, ...], Coefficient] = field(default_factory=dict, repr=False, compare=False)
    planned_kinks: list[set[float]] = field(default_factory=list, repr=False, compare=False)
    in_layers: bool = False

    @classmethod
    def of_domain(cls, domain: Domain) -> Self:
        """Make the coordinates and the clock of a distributed mesh.

        Where kept bodies have moved apart to make room for a meshed layer, x is the place before this motion.
        """
        mesh, band = domain.mesh, domain.joint.band
        x, points = ufl.SpatialCoordinate(mesh), (band.drawn_joint if band else domain.joint).points
        sample_indices = {0, *(int(k) for c in points.T for k in (c.argmin(), c.argmax(), np.abs(c).argmin()))}
        if band is not None and band.bodies != "extended":
            joint, element = domain.joint, ("Lagrange", domain.joint.degree, (domain.joint.dim,))
            x -= domain.cellwise_function(element, (joint.points - joint.reference)[joint.cells])
        return cls(domain, x, Clock(mesh), points[sorted(sample_indices)])

    @property
    def mesh(self) -> Mesh:
        """The mesh."""
        return self.domain.mesh

    @property
    def t(self) -> TimeConstant:
        """Time as a UFL constant."""
        return self.clock.symbol

    @property
    def with_own_kinks(self) -> Self:
        """Copy for loads and supports that may be replaced later; it shares the clock but has its own `kinks`."""
        return changed(self, cache={}, planned_kinks=[])

    def with_place(self, x: Expr) -> Self:
        """Return a copy in which users' functions get the UFL coordinates `x` (d,) as their place."""
        return changed(self, x=x)

    def coefficient(self, value: object, what: str, *shapes: Shape, place_only: bool = False) -> Coefficient:
        """Return the coefficient of a user's value, made and checked once. Collective.

        Args:
            value: numbers, a table of components, a function (x, t), a UFL expression or a DOLFINx function.
            what: first words of error messages.
            shapes: allowed shapes in d dimensions: () for a number, (d,) for components, (d, d) for a table.
            place_only: whether a function as value has the argument x alone, not x and t.

        Raises:
            InputError: another shape, or numbers that are not finite; a function that fails; after a march has begun, a
                value that changes its slope at a time not known to the march.
        """
        key = (id(value), what, shapes, id(self.x))
        if key not in self.cache:
            self.cache[key] = coefficient = Coefficient(value, what, shapes, self, place_only=place_only)
            if self.planned_kinks and (late_breaks := sorted(coefficient.kinks - self.planned_kinks[0])):
                reason = f"changes its slope at t = {late_breaks[0]:g}, where no step ends"
                raise InputError(f"{what} is given after a march has begun, and {reason}; give it in check(model)")
        return self.cache[key]

    def load(self, load: LoadInput | Pressure | Value, what: str, n_components: int, n: Expr | None = None) -> Expr:
        """Return a load as a vector (c,) in UFL of the `n_components` that the unknown has.

        Args:
            load: c components, or for c = 1 a number, constant or a function (x, t); or a `Pressure` on facets.
            what: first words of error messages.
            n_components: number c of components.
            n: outward unit normal (d,) of facets; None: the load does not act on facets.

        Raises:
            InputError: the load does not have c finite components, or a function fails.
        """
        if isinstance(load, Pressure) and n is not None:
            require(n_components > 1, what, load, "a scalar field takes fluxes, numbers")
            return -self.coefficient(load.p, what, ()).expression * n
        if n_components > 1:
            return self.coefficient(load, what, (n_components,)).expression
        return ufl.as_vector([self.coefficient(load, what, ()).expression])

    @property
    def kinks(self) -> set[float]:
        """Times at which the coefficients made so far change their slope.

        Once a march has read them, coefficients with other such times are refused.
        """
        self.planned_kinks[:] = [set[float]().union(*(coefficient.kinks for coefficient in self.cache.values()))]
        return self.planned_kinks[0]


class HandedField(fem.Function):
    """A scalar field of another model on the mesh of this one; on a rigid base it is zero."""


@runtime_checkable
class HandsOver(Protocol):
    """A result that other models take as a value of place and time: a state or a history of a scalar field."""

    def field_on(self, at: Coordinates) -> Expr:
        """Return the result's scalar as UFL on the mesh of a model with the coordinates `at`. Collective."""


class Coefficient:
    """A user's value of place and time: numbers, a table, a function (x, t), a UFL expression or a DOLFINx function.

    It may also be a result of a scalar field, a state or a history.
    A function is called with UFL symbols for the place x and the time t. Python's == and `in` are always False for
    symbols. Therefore the function is tested at some places and times: it must give the same values for plain numbers.
    DOLFINx functions on other meshes, such as computed temperatures, are interpolated on this mesh.

    Args:
        value: value as the user wrote it.
        what: first words of errors, such as "traction on 'TOP'".
        shapes: allowed shapes in d dimensions: () for a number, (d,) for components, (d, d) for a table.
        at: coordinates and time.
        place_only: whether a function as value has the argument x alone, not x and t. If it fails for symbols, it is
            called with the coordinates (d, n) of n places, and interpolated in each cell with degree 2.

    Attributes:
        shape: shape of the value, one of `shapes`.
        components: (*shape) numbers, or UFL scalars.
        varies: False if all components are numbers.

    Raises:
        InputError: another shape; a component that is not a finite real number; a function that fails for symbols or
            compares them.
    """

    def __init__(self, value: object, what: str, shapes: Sequence[Shape], at: Coordinates, *, place_only: bool) -> None:
        self.at = at.with_own_kinks  # does not refer to this object: both are freed with their model
        value = value.field_on(self.at) if isinstance(value, HandsOver) else value
        self.value, self.what, self._shapes, self._place_only = value, what, shapes, place_only
        is_function = callable(value) and not isinstance(value, ufl.core.expr.Expr)
        self.components = self._interpolate_foreign(self._function_components() if is_function else self._read(value))
        self.varies = is_function or any(isinstance(c, ufl.core.expr.Expr) for c in self.components.flat)
        self.shape = self.components.shape

    # ---------------------------------------------------------------- reading
    def _call(self, x: Expr, t: Expr) -> NestedComponents:
        assert callable(self.value)
        return self.value(x) if self._place_only else self.value(x, t)

    def _function_components(self) -> ComponentArray:
        """Return the components, in UFL, that the user's function gives for symbols.

        Raises:
            InputError: the function fails, or gives other values for plain numbers.
        """
        try:
            content = self._call(self.at.x, self.at.t)
        except Exception as error:
            if self._place_only:
                return self._read(self._interpolant())
            raise self._function_error(f"{type(error).__name__}: {error}") from error
        components = self._read(content)
        on_mesh = isinstance(self.at.x, ufl.SpatialCoordinate)
        self._compare(components if on_mesh else self._read(self._call(ufl.SpatialCoordinate(self.at.mesh), self.at.t)))
        return components

    def _interpolant(self) -> fem.Function:
        """Return the interpolant, of degree 2 in each cell, of the user's numpy function of the place. Collective.

        The function gets the coordinates (d, n) of n places and returns n values.
        """
        f = fem.Function(fem.functionspace(self.at.mesh, ("DG", NUMPY_DEGREE)))
        x = interpolation_places(f.function_space, self.at.x).reshape(-1, self.at.mesh.geometry.dim)
        try:
            values = np.asarray(self._call(x.T, None), float)
        except Exception as error:
            raise InputError(f"{self.what} is not a function of x, in UFL or numpy: {error}") from error
        if values.shape not in ((), (len(x),)):
            raise InputError(f"{self.what} gives an array of shape {values.shape}; for x (d, n) it needs (n,)")
        f.x.array[np.asarray(f.function_space.dofmap.list).ravel()] = values
        return f

    def _function_error(self, why: str) -> InputError:
        return InputError(f"{self.what} is not a function (x, t) of UFL coordinates: {why}; {NUMPY_HINT}")

    def _components_error(self, content: NestedComponents, detail: str = "") -> InputError:
        shapes = [" x ".join(map(str, shape)) for shape in self._shapes]
        need = " or ".join(f"{shape} finite components" if shape else "a finite number" for shape in shapes)
        if callable(self.value):
            return InputError(f"{self.what} gives {content!s:.90}; it needs {need}{detail}")
        return InputError(f"{self.what} is {self.value!r:.90}; it needs {need}, or a function (x, t) that gives that")

    def _read(self, content: NestedComponents) -> ComponentArray:
        """Return the components of a number, a UFL expression, or nested sequences of them, in an array.

        Raises:
            InputError: the shape is not an allowed one, or a component is not a finite number or UFL scalar.
        """
        try:
            shape = _shape_of(content)
        except Exception:  # of any user's object
            shape = (-1,)
        if shape not in self._shapes:
            raise self._components_error(content)
        components = np.empty(shape, object)
        for index in np.ndindex(*shape):
            components[index] = self._checked_component(reduce(lambda rows, k: rows[k], index, content))
        return components

    def _checked_component(self, component: Expr) -> Expr:
        """Return a component as a finite number or a UFL scalar.

        Raises:
            InputError: it is neither.
        """
        if isinstance(component, np.ndarray):
            component = component[()]
        if is_finite(component):
            return float(component)
        is_scalar = isinstance(component, ufl.core.expr.Expr) and component.ufl_shape == ()
        if not is_scalar or isinstance(component, Condition) or not has_finite_numbers(component):
            raise self._components_error(component, f", of finite real numbers; {NUMPY_HINT}")
        return component

    def _interpolate_foreign(self, components: ComponentArray) -> ComponentArray:
        """Replace DOLFINx functions on other meshes, in UFL components, by their interpolants on this mesh.

        Collective if there are such functions.
        """
        functions = {f for c in components.flat for f in _functions_in(c) if isinstance(f, fem.Function)}
        foreign = sorted((f for f in functions if f.function_space.mesh is not self.at.mesh), key=lambda f: f.count())
        replacements = {f: sampled_function(f, self.at.mesh, self.at.x, self.what) for f in foreign}
        for index in np.ndindex(*components.shape):
            if _functions_in(components[index]):
                components[index] = ufl_replace(components[index], replacements)
        return components

    def _compare(self, components: ComponentArray) -> None:
        """Raise InputError if the user's function gives other values for plain numbers than for symbols.

        `components` are its components for symbols. They are evaluated at the places `at.test_places` and some times.
        """
        if any(map(_functions_in, components.flat)):
            return
        places, (first_time, *later_times) = self.at.test_places, COMPARISON_TIMES
        for place, t in [*product(places, [first_time]), *product(places[:1], later_times)]:
            try:
                by_numbers = self._read(self._call(ufl.as_vector([*map(float, place)]), ufl.as_ufl(t)))
            except Exception:  # the function accepts symbols only, as with ufl.grad
                continue
            a, b = (np.array([evaluate_component(c, t, place) for c in some.flat]) for some in (components, by_numbers))
            is_comparable = a.shape == b.shape and np.isfinite([a, b]).all()
            if is_comparable and np.abs(a - b).max() > SYMBOL_VALUE_TOLERANCE * np.abs([a, b]).max():
                text = f"{a.tolist()} for symbols and {b.tolist()} for numbers, as functions with ==, != and `in` do"
                raise self._function_error(f"at {at_place(place)}, t = {t:g} it gives {text}")

    # ---------------------------------------------------------------- values
    @cached_property
    def expression(self) -> Expr:
        """The value as a UFL expression of the shape `shape`.

        Numbers become Constants, so that forms are compiled once for all numbers.
        """
        if not self.varies:
            return fem.Constant(self.at.mesh, self.components.astype(float))
        return ufl.as_tensor(self.components.tolist()) if self.shape else ufl.as_ufl(self.components[()])

    def interpolant(self, V: fem.FunctionSpace) -> fem.Function:
        """Return the interpolant of this scalar value in a scalar space V. Collective."""
        f, expression = fem.Function(V), self.expression + fem.Constant(self.at.mesh, 0.0)
        interpolate(f, fem.Expression(expression, interpolation_points(V)))
        return f

    @cached_property
    def kinks(self) -> set[float]:
        """Times at which the slope of the value changes."""
        components = [c for c in self.components.flat if isinstance(c, ufl.core.expr.Expr)]
        return set[float]().union(*(constant.kinks for c in components for constant in time_constants(c)))

    def once(self, owner: str) -> Coefficient:
        """Return this coefficient if it does not depend on the place.

        Args:
            owner: words of the message for what needs a single value, such as "the whole cell".

        Raises:
            InputError: it depends on the place.
        """
        if any(depends_on_place(c) for c in self.components.flat if isinstance(c, ufl.core.expr.Expr)):
            raise InputError(f"{self.what} depends on the place x; it is one for {owner}")
        return self

    def at_time(self, t: float) -> Array:
        """Return the numbers (*shape) of this value at the time t; the value must not depend on the place.

        Raises:
            InputError: the numbers are not finite.
        """
        numbers = np.array([evaluate_component(c, t) for c in self.components.flat]).reshape(self.shape)
        if not np.isfinite(numbers).all():
            raise InputError(f"{self.what} is not finite at t = {t:g}: {numbers.tolist()}")
        return numbers


@dataclass(frozen=True)
class Pressure:
    """A pressure on any inclined or curved boundary: the traction -p n, where n is the outward unit normal.

    Attributes:
        p: pressure, a stress > 0 in compression; a number or a function (x, t).

    Example:
        >>> import ufl
        >>> from forms import LinearElastic
        >>> from geometry import sandwich
        >>> from thinlayer import Pressure, Structure, solve
        >>> plates = Structure(
        ...     sandwich(4, 1, 2, h=0.5, cell="quadrilateral"),
        ...     body=LinearElastic.young(E=210e3, nu=0.3),
        ...     supports={"BOTTOM": 0},
        ...     tractions={
        ...         "TOP": Pressure(lambda x, t: 2 + ufl.sin(x[0])),
        ...         "LEFT": Pressure(2),
        ...     },
        ... )
        >>> state = solve(plates.bonded())
        >>> print(state.reaction("BOTTOM").force.round(4))
        [-6.      9.6536]
    """

    p: Value

    def __rmul__(self, factor: float) -> Pressure:
        return Pressure(times(factor, self.p))


def times(factor: float, value: Any) -> Any:
    """Return a load, eigenstrain or parameter times a factor: a number, an array, a table, or a function of these."""
    if callable(value) and not isinstance(value, ufl.core.expr.Expr):

        @wraps(value, assigned=())  # with the times of `piecewise`
        def multiple(*place_and_time: Any) -> Any:
            return times(factor, value(*place_and_time))

        return multiple
    if isinstance(value, (list, tuple)):
        return type(value)(times(factor, component) for component in value)
    return factor * value


def values_by_body(values: T | Mapping[str, T], joint: Joint, what: str = "", more: Sequence[str] = ()) -> dict[str, T]:
    """Return a dictionary from the name of each body to its value, in the joint's order of bodies.

    Args:
        values: one value for all bodies, or a mapping from names to values. Bodies that it does not name have no value
            in the result.
        joint: the joint of the bodies.
        what: first words of error messages.
        more: other names that the mapping may have, such as names of seams; their values are not returned.

    Raises:
        InputError: a name that is neither a body nor in `more`.
    """
    by_body = values if isinstance(values, Mapping) else dict.fromkeys(joint.bodies, values)
    for name in (name for name in by_body if name not in more):
        require_known("body", name, dict.fromkeys((*joint.bodies, *more)), what)
    return {name: by_body[name] for name in joint.bodies if name in by_body}


# ---------------------------------------------------------------- content
def _shape_of(content: NestedComponents) -> Shape:
    """Return the shape of nested sequences of numbers and UFL expressions; it ends with -1 if rows differ in shape."""
    if isinstance(content, ufl.core.expr.Expr):
        return tuple(content.ufl_shape)
    if isinstance(content, np.ndarray):
        return content.shape
    if not isinstance(content, (list, tuple)):
        return ()
    row_shapes = {_shape_of(row) for row in content}
    return (len(content), *row_shapes.pop()) if len(row_shapes) == 1 else (len(content), -1)


def has_finite_numbers(expression: Expr) -> bool:
    """Return whether all numbers in a UFL expression are finite and real, so that it can be compiled."""
    numbers = (node for node in unique_pre_traversal(expression) if isinstance(node, ComplexValue | RealValue))
    return all(isinstance(number, RealValue) and math.isfinite(float(number)) for number in numbers)


def takes_place_only(value: object) -> bool:
    """Return whether a value is a function of the place alone, with one argument; not one of place and time."""
    try:
        return callable(value) and len(signature(value).parameters) == 1
    except (TypeError, ValueError):  # functions without a signature
        return False


def depends_on_place(expression: Expr) -> bool:
    """Return whether a UFL expression depends on the place, by a function on the mesh or by its geometry."""
    return any(isinstance(node, (ufl.Coefficient, GeometricQuantity)) for node in unique_pre_traversal(expression))


def _functions_in(component: Expr) -> list[fem.Function]:
    return extract_coefficients(component) if isinstance(component, ufl.core.expr.Expr) else []


def evaluate_component(component: Expr, t: float, place: Sequence[float] = ()) -> float:
    """Return the value of a number or UFL scalar at the time `t` and the place (d,); NaN where it is not defined."""
    if not isinstance(component, ufl.core.expr.Expr):
        return float(component)
    constant_values = {c: c.at(t) if isinstance(c, TimeConstant) else c.value for c in extract_constants(component)}
    try:
        return float(component(tuple(map(float, place)), constant_values))
    except (ArithmeticError, ValueError, TypeError):
        return math.nan


def sampled_function(f: fem.Function, mesh: Mesh, x: Expr, what: str) -> fem.Function:
    """Return the interpolant on a mesh of a function on another mesh. Collective.

    Args:
        f: the function on the other mesh.
        mesh: the mesh of the interpolant.
        x: (d,) UFL expression on `mesh`, the coordinates at which f is evaluated.
        what: first words of error messages.

    Returns:
        A function that is a polynomial in each cell. At its interpolation points it has the values of f, but for 1e-6
        of the change of f in a cell.

    Raises:
        InputError: a place lies outside the other mesh.
    """
    degree = min(2, f.function_space.element.basix_element.degree)
    interpolant = fem.Function(fem.functionspace(mesh, ("DG", degree, f.ufl_shape)))
    places = interpolation_places(interpolant.function_space, x)
    places = (places + INWARD_SHIFT * (places.mean(axis=1, keepdims=True) - places)).reshape(-1, mesh.geometry.dim)
    values = _evaluate_on_all_ranks(f, places)
    outside_places = np.concatenate(communicator(mesh).allgather(places[np.isnan(values).any(axis=1)][:1]))
    if len(outside_places):
        raise InputError(f"{what}: a function is unknown at {at_place(outside_places[0])}; its mesh must cover all")
    interpolant.x.array.reshape(values.shape)[np.asarray(interpolant.function_space.dofmap.list).ravel()] = values
    return interpolant


def interpolation_places(V: fem.FunctionSpace, x: Expr) -> Array:
    """Return the values (cells, n, d) of UFL coordinates x (d,) at the n interpolation points of V in local cells."""
    mesh, d = V.mesh, V.mesh.geometry.dim
    cells = np.arange(len(V.dofmap.list), dtype=np.int32)
    expression = fem.Expression(x + fem.Constant(mesh, np.zeros(d)), interpolation_points(V))
    return np.asarray(expression.eval(mesh, cells).reshape(len(cells), -1, d))


def _evaluate_on_all_ranks(f: fem.Function, x: Array) -> Array:
    """Return the values (n, m) of a function with m components at n places x (n, d); NaN outside its mesh. Collective.

    The values come from all ranks of the function's mesh. Every rank gets the places and values of all ranks, so that
    its memory grows with the total number of cells.
    """
    mesh = f.function_space.mesh
    comm = communicator(mesh)
    x_of_ranks = comm.allgather(np.pad(x, ((0, 0), (0, 3 - x.shape[1]))))
    places = np.concatenate(x_of_ranks)
    bb_tree = geometry.bb_tree(mesh, mesh.topology.dim)
    colliding = geometry.compute_colliding_cells(mesh, geometry.compute_collisions_points(bb_tree, places), places)
    starts, has_cell = colliding.offsets[:-1], np.diff(colliding.offsets) > 0
    values = np.full((len(places), int(np.prod(f.ufl_shape))), np.nan)
    if has_cell.any():
        values[has_cell] = f.eval(places[has_cell], colliding.array[starts[has_cell]]).reshape(-1, values.shape[1])
    start = sum(map(len, x_of_ranks[: comm.rank]))
    return np.asarray(np.fmax.reduce(comm.allgather(values))[start : start + len(x)])
