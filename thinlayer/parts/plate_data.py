"""What is given for a rigid plate: forces or motions, as numbers or functions of the time, and their checks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import ufl
from ufl.corealg.traversal import unique_pre_traversal

from forms.base import is_number
from forms.kinematics import Expr
from forms.temperature import real
from geometry.errors import unknown
from thinlayer.discretisation.addition import Host
from thinlayer.discretisation.loads import AXES, Coordinates, called, refuse_periodic, refuse_seam, require_facets
from thinlayer.discretisation.reactions import Array, balanced_motions, centroid, count, on_centre, require_point
from thinlayer.errors import ModelError

Number = float | Callable[[Expr, Any], Any]
Vector = Sequence[float] | Callable[[Expr, Any], Sequence[Any]]
ROTATIONS = {2: ("rotation",), 3: ("rotation x", "rotation y", "rotation z")}


def motion_names(d: int) -> list[str]:
    """Names of the motions of a plate."""
    return [*AXES[:d], *ROTATIONS[d]]


@dataclass(frozen=True)
class PlateData:
    """What is given for a rigid plate; see `thinlayer.parts.plates.RigidPlate`."""

    place: str
    force: Vector | None = None
    moment: Number | Vector | None = None
    motion: Mapping[str, Number] = field(default_factory=dict)
    about: Sequence[float] | None = None
    key: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "key", f"plate {self.place}")

    @property
    def what(self) -> str:
        """The plate in messages."""
        return f"plate on {self.place!r}"

    def check(self, model: Host) -> None:
        """As in `Addition`."""
        if not isinstance(self.place, str):
            raise ModelError(f"{self.what}: a place is the name of a facet set")
        inside = f"{self.what}: its facets lie inside, or below a layer; plates lie on the outer boundary"
        refuse_seam(model.joint, self.place, inside)
        refuse_periodic(model.joint, self.place, "rigid plate")
        require_facets(model.domain, self.place, self.what)
        if not model.domain.is_outer(self.place):
            raise ModelError(inside)
        d = model.joint.dim
        names = motion_names(d)
        if not isinstance(self.motion, Mapping):
            raise ModelError(f"{self.what}: motion is {self.motion!r}; it must be {{{names[0]!r}: value, ...}}")
        for name in self.motion:
            if name not in names:
                raise ModelError(f"{self.what}: {unknown('motion', name, names)}")
            if names.index(name) in self._prevented(model):
                raise ModelError(
                    f"{self.what}: a rigid plate of revolution has no motion {name!r}; it moves along the axis"
                )
        if self.about is not None:
            require_point(self.about, d)
        for given, _ in self._given(d):
            if callable(given):
                self._once(given, model.coordinates)
        if not any(callable(given) for given, _ in self._given(d)):
            self.resultants(model, 0.0)
            self.motions(model, 0.0)

    def _given(self, d: int) -> list[tuple[Any, tuple[int, ...]]]:
        """All data with the shapes of their values."""
        found: list[tuple[Any, tuple[int, ...]]] = [(self.force, (d,)), (self.moment, () if d == 2 else (3,))]
        return [one for one in found if one[0] is not None] + [(value, ()) for value in self.motion.values()]

    def _once(self, given: Callable[..., Any], at: Coordinates) -> None:
        """Call a function with the symbol of the time, whose breaks it tells; it may not depend on the place."""
        found = called(given, at, self.what)
        for one in found if isinstance(found, Sequence | np.ndarray) else [found]:
            for node in unique_pre_traversal(ufl.as_ufl(one)):
                if isinstance(node, ufl.SpatialCoordinate):
                    raise ModelError(f"{self.what}: a value depends on the place x; it is one for the whole plate")

    def _value(self, given: Any, shape: tuple[int, ...], at: Coordinates, t: float) -> Array:
        """A value (shape) at a time."""
        if not callable(given) and shape == () and not is_number(given):
            raise ModelError(f"{self.what}: a value is {given!r}; it must be a number or a function (x, t)")
        found = called(given, at, self.what, t) if callable(given) else given
        try:
            value = np.array(found, float) if callable(given) and not np.iscomplexobj(found) else real(found)
        except (TypeError, ValueError):
            value = np.array([np.nan])
        if value.shape != shape or not np.isfinite(value).all():
            need = f"{shape[0]} finite components" if shape else "a finite number"
            raise ModelError(f"{self.what}: a value at t = {t:g} is {found!r}; it must be {need}")
        return value

    def motions(self, model: Host, t: float) -> dict[int, float]:
        """Number of a prescribed motion -> its value at a time; a plate of revolution moves along its axis alone."""
        names, found = motion_names(model.joint.dim), dict.fromkeys(self._prevented(model), 0.0)
        return found | {
            names.index(name): float(self._value(value, (), model.coordinates, t))
            for name, value in self.motion.items()
        }

    @staticmethod
    def _prevented(model: Host) -> list[int]:
        """Numbers of the motions that kinematics do not have."""
        return [int(k) for k in np.flatnonzero(balanced_motions(model.kinematics, model.joint.dim) == 0)]

    def resultants(self, model: Host, t: float) -> Array:
        """Force and moment (k,) at a time; raises ModelError if one of them is along a prescribed motion."""
        d, at = model.joint.dim, model.coordinates
        out = np.zeros(count(d))
        if self.force is not None:
            out[:d] = self._value(self.force, (d,), at, t)
        if self.moment is not None:
            out[d:] = self._value(self.moment, () if d == 2 else (3,), at, t)
        for k in self.motions_held(model):
            if out[k]:
                raise ModelError(
                    f"{self.what}: the motion {motion_names(d)[k]!r} is prescribed, and {out[k]:g} is given for its force "
                    "or moment; one of them follows from the other"
                )
        return out

    def point(self, model: Host) -> Array:
        """The point (d,) to which motions and moments refer. Collective."""
        if self.about is not None:
            return require_point(self.about, model.joint.dim)
        return on_centre(model.kinematics, centroid(model.domain, self.place))

    def motions_held(self, model: Host) -> list[int]:
        """Numbers of the prescribed motions."""
        return sorted({*self._prevented(model), *(motion_names(model.joint.dim).index(name) for name in self.motion)})

    def size(self, model: Host) -> float:
        """Largest extent of the structure, by which rotations are multiplied to be lengths."""
        return float(np.ptp(model.domain.joint.points, axis=0).max())
