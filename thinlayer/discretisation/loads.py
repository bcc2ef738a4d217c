"""Values of loads and supports: checks of the users' data, and their translation to UFL."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from ufl.conditional import Condition
from ufl.constantvalue import ComplexValue, RealValue
from ufl.corealg.traversal import unique_pre_traversal

from forms.base import is_number
from forms.kinematics import Expr
from forms.temperature import real
from geometry.domain import Domain
from geometry.joint import Joint
from geometry.seam import LAYER, S
from thinlayer.discretisation.joint_fields import shift
from thinlayer.discretisation.load_curves import LoadCurve, Moment, Time, symbols
from thinlayer.errors import ModelError

AXES = "xyz"
Value = float | Callable[[Expr, Expr], Expr]
Load = Sequence[float] | Callable[[Expr, Expr], Sequence[Expr]]


@dataclass(frozen=True)
class Coordinates:
    """Arguments of loads: the place in the joint before inflating (kept bodies) and the time.

    Attributes:
        mesh: the mesh.
        x: (d,) UFL coordinates.
        t: the time, a UFL symbol.
    """

    mesh: Mesh
    x: Expr
    t: Time

    @classmethod
    def of(cls, domain: Domain) -> Coordinates:
        """Coordinates on a domain; for kept bodies without the rigid shifts by inflating."""
        mesh, band = domain.mesh, domain.joint.band
        x, t = ufl.SpatialCoordinate(mesh), Time(mesh)
        if band is None or band.bodies == "extended":
            return cls(mesh, x, t)
        return cls(mesh, x - shift(domain), t)

    def moment(self, t: float) -> Moment:
        """The moment at which expressions of the time get their values."""
        return Moment(self.t, t)


@dataclass(frozen=True)
class Pressure:
    """A traction -p n along the inner normal of facets, on any inclined or curved boundary.

    Attributes:
        p: stress, > 0 where it presses; a number or a function (x, t).
    """

    p: Value

    def value(self, at: Coordinates, what: str) -> Expr:
        """p as a UFL scalar; raises ModelError if it is no number."""
        if not callable(self.p) and not (is_number(self.p) and math.isfinite(self.p)):
            raise ModelError(f"{what}: the pressure is {self.p!r}; it must be a finite number or a function (x, t)")
        return scalar(called(self.p, at, what), what) if callable(self.p) else fem.Constant(at.mesh, float(self.p))

    def traction(self, at: Coordinates, what: str) -> Expr:
        """The traction as a UFL vector (d,); raises ModelError if p is no number."""
        return -self.value(at, what) * ufl.FacetNormal(at.mesh)


def vector(load: Load, at: Coordinates, dim: int, what: str) -> Expr:
    """A traction or body force as a UFL vector (d,); raises ModelError if it is not a vector of d finite components."""
    if not callable(load):
        try:
            values = real(load)
        except (TypeError, ValueError):
            values = np.full(0, np.nan)
        if values.shape != (dim,) or not np.isfinite(values).all():
            raise ModelError(f"{what} is {load!r}; it needs {dim} finite components")
        return fem.Constant(at.mesh, values)
    components = called(load, at, what)
    try:
        vector = ufl.as_vector([ufl.as_ufl(c) for c in components])
    except Exception as error:
        raise ModelError(f"{what} gives {components!r}; it needs {dim} components: {error}") from error
    if vector.ufl_shape != (dim,) or any(isinstance(c, Condition) for c in components):
        raise ModelError(
            f"{what} gives {components!r}; it needs {dim} components, ufl.conditional(c, 1, 0) for a condition c"
        )
    if not all(_is_finite(c) for c in components):
        given = ", ".join(map(str, components))
        raise ModelError(f"{what} gives ({given}); it needs {dim} finite components, of finite real numbers")
    return vector


def _is_finite(value: Any) -> bool:
    """Whether all numbers in a UFL scalar are finite and real; booleans are not numbers."""
    return not isinstance(value, (bool, np.bool_)) and has_finite_numbers(ufl.as_ufl(value))


def has_finite_numbers(expression: Expr) -> bool:
    """Whether all numbers in a UFL expression are finite and real, so that it can be compiled."""
    for node in unique_pre_traversal(expression):
        if isinstance(node, ComplexValue) or (isinstance(node, RealValue) and not math.isfinite(float(node))):
            return False
    return True


def piecewise(values: Mapping[float, float | Sequence[float]]) -> Callable[[Expr, Expr], Any]:
    """A load or prescribed displacement that is linear in time between given values, and undefined before and after.

    Tables of thousands of values are fine, `piecewise(dict(zip(times, forces)))`. The table may be used in a function,
    `lambda x, t: (0, x[0] * table(x, t))`, at another time than t, `table(x, t / 3600)`, and as a law's temperature. Steps
    of a layer with memory end at its break times.

    Args:
        values: time -> the value then: components of a load, or the number of a prescribed displacement; at least two.

    Returns:
        A function (x, t) for the data of a model; it returns numbers if t is a number.

    Raises:
        ModelError: less than two times, values that are no numbers or of different lengths.
    """
    try:
        if not all(is_number(t) for t in values):
            raise TypeError("times are numbers")
        times = sorted(values)
        rows = real([values[t] for t in times])
        whole = np.isfinite(rows).all() and np.isfinite(np.array(times, float)).all()
    except (TypeError, ValueError, LookupError) as error:
        raise ModelError(f"piecewise needs {{time: number or components}}: {error}") from error
    if len(times) < 2 or rows.ndim > 2 or not whole:
        raise ModelError(f"piecewise needs two times or more, each with a number or components, not {values!r}")
    curve = LoadCurve(np.array(times, float), rows)

    def at(_: Any, t: Any) -> Any:
        return curve(t)

    at.times = curve.breaks  # type: ignore[attr-defined]
    return at


def scalar(value: Any, what: str) -> Expr:
    """What a user's function gives as a UFL scalar; raises ModelError if it is no finite number."""
    try:
        found = ufl.as_ufl(value)
    except Exception as error:
        raise ModelError(f"{what}: a component gives {value!r}; it must be a number: {error}") from error
    if found.ufl_shape:
        raise ModelError(f"{what}: a component gives a tensor of shape {found.ufl_shape}; it must be a number")
    if isinstance(found, Condition) or not _is_finite(value):
        raise ModelError(f"{what}: a component gives {value}; it must be a finite number, of finite real numbers")
    return found


def called(function: Callable[[Expr, Any], Any], at: Coordinates, what: str, t: Any = None) -> Any:
    """What a user's function gives at the coordinates, and at the symbol of the time or at a number t."""
    try:
        with symbols():
            return function(at.x, at.t if t is None else t)
    except Exception as error:
        raise ModelError(
            f"{what} is no function (x, t) of UFL coordinates: {error.__cause__ or error}; use ufl.sin(t), "
            "ufl.conditional(ufl.gt(t, 1), a, b), ..., and piecewise({time: value, ...}) for a table"
        ) from error


def refuse_periodic(joint: Joint, name: str, what: str) -> None:
    """Raise ModelError if a name is that of a periodic side: inside the periodic structure there is no boundary."""
    if joint.periods and name.split("/")[0] in joint.periods.names:
        raise ModelError(
            f"{what} on {name!r}: this side is identified with another one, the structure goes on there; a periodic cell "
            "is loaded by a mean strain, Structure(..., strain=...)"
        )


def require_facets(domain: Domain, name: str, what: str) -> None:
    """Raise ModelError if a facet set is empty, as the side of a layer is while S is a surface."""
    if not domain.values(name):
        why = ", as the layer is a surface here: mesh it (structure.full)" * name.endswith(f"/{LAYER}")
        raise ModelError(f"{what}: this facet set is empty{why}")


def refuse_seam(joint: Joint, name: str, message: str) -> None:
    """Raise ModelError if a name is S or that of a seam: what acts there is the layer."""
    if name in joint.seams or name.split("/")[0] == S:
        raise ModelError(message)
