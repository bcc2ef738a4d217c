"""What is given for a rigid plate: forces or motions, as numbers or functions of the time, and their checks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from forms.kinematics import Expr
from geometry.errors import unknown
from thinlayer.discretisation.addition import Host
from thinlayer.discretisation.axis import AXES, refuse_periodic, refuse_seam, require_facets
from thinlayer.discretisation.given import Given
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
        values = [*self._resultants(model).values(), *self._motions(model).values()]
        if not any(value.varies for value in values):
            self.resultants(model, 0.0)

    def _resultants(self, model: Host) -> dict[str, Given]:
        """The force and the moment, those that are given."""
        shapes: dict[str, tuple[int, ...]] = {
            "force": (model.joint.dim,),
            "moment": () if model.joint.dim == 2 else (3,),
        }
        given = {name: getattr(self, name) for name in shapes}
        return {k: self._value(model, k, value, shapes[k]) for k, value in given.items() if value is not None}

    def _motions(self, model: Host) -> dict[int, Given]:
        """Number of a motion that is given -> its value."""
        names = motion_names(model.joint.dim)
        return {names.index(k): self._value(model, f"motion {k!r}", value, ()) for k, value in self.motion.items()}

    def _value(self, model: Host, name: str, value: Any, shape: tuple[int, ...]) -> Given:
        """A value that is one for the whole plate."""
        return model.coordinates.given(value, f"{self.what}: {name}", shape).once("the whole plate")

    def motions(self, model: Host, t: float) -> dict[int, float]:
        """Number of a prescribed motion -> its value at a time; a plate of revolution moves along its axis alone."""
        prevented = dict.fromkeys(self._prevented(model), 0.0)
        return prevented | {k: float(value.at_time(t)) for k, value in self._motions(model).items()}

    @staticmethod
    def _prevented(model: Host) -> list[int]:
        """Numbers of the motions that kinematics do not have."""
        return [int(k) for k in np.flatnonzero(balanced_motions(model.kinematics, model.joint.dim) == 0)]

    def resultants(self, model: Host, t: float) -> Array:
        """Force and moment (k,) at a time; raises ModelError if one of them is along a prescribed motion."""
        d = model.joint.dim
        out, given = np.zeros(count(d)), self._resultants(model)
        if "force" in given:
            out[:d] = given["force"].at_time(t)
        if "moment" in given:
            out[d:] = given["moment"].at_time(t)
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
