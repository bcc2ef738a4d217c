"""What a constitutive law is: declared parameters, and a stress for a strain. No law knows eps, a mesh or a time loop."""

from __future__ import annotations

import copy
import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple, Self

from forms.kinematics import Expr


class LawError(ValueError):
    """A parameter out of range, or a law used where it is not defined; says what, where and what is allowed."""


class Step(NamedTuple):
    """What a law is told at one point of the layer.

    Attributes:
        e: strain at the end of the step, (3, 3).
        n: director of the layer, (d,): unit, from the lower to the upper body. None inside a body.
    """

    e: Expr
    n: Expr | None = None


@dataclass(frozen=True)
class Law:
    """Base of the laws: a frozen dataclass whose fields are its parameters.

    A law is written for real moduli. Its parameters in a layer are given *per thickness*: the real value of a parameter
    in a layer of thickness eps is value * eps**power, with the power declared here (0 if not named).

    Attributes:
        powers: parameter -> power of eps that keeps the interface law finite and not zero as eps -> 0.
        linear: whether the stress is linear in the strain.
        symmetric: whether the tangent is symmetric (there is an energy).
    """

    powers: ClassVar[Mapping[str, float]] = {}
    linear: ClassVar[bool] = False
    symmetric: ClassVar[bool] = True

    def __new__(cls, *_: Any, **named: Any) -> Self:
        known = [name for name in inspect.signature(cls.__init__).parameters if name != "self"]
        for name in named:
            if name not in known:
                raise LawError(f"{cls.__name__} has no parameter {name!r}; known: {', '.join(known)}")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        self.check()

    def check(self) -> None:
        """Raise LawError if a parameter is out of its range."""

    def stress(self, step: Step) -> Expr:
        """Stress (3, 3), UFL."""
        raise NotImplementedError

    def energy(self, step: Step) -> Expr:
        """Stored energy per unit volume, UFL."""
        raise NotImplementedError(f"{type(self).__name__} declares no energy")

    def plane_stress(self) -> Law:
        """The law of in-plane strains whose out-of-plane stresses are zero."""
        raise LawError(f"plane stress is not defined for {type(self).__name__}; use plane='strain'")

    def parameters(self) -> dict[str, Any]:
        """Name -> value of every parameter."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def with_parameters(self, values: Mapping[str, Any]) -> Self:
        """The same law with other values (numbers or UFL), unchecked."""
        law = copy.copy(self)
        for name, value in values.items():
            object.__setattr__(law, name, value)
        return law

    def mapped(self, change: Callable[[Any, float], Any]) -> Self:
        """The same law with each parameter replaced by change(value, power), unchecked."""
        changed = {name: change(value, self.powers.get(name, 0)) for name, value in self.parameters().items()}
        return self.with_parameters(changed)

    def per_thickness(self, eps: float) -> Self:
        """The law whose real parameters, in a layer of thickness eps (a length > 0), are this law's."""
        if not (math.isfinite(eps) and eps > 0):
            raise LawError(f"eps is {eps}; the thickness must be > 0")
        return self.mapped(lambda value, power: value * eps**-power)


def require(condition: bool, law: Law, name: str, value: object, allowed: str) -> None:
    """Raise LawError "Law: name is value; allowed: ..." unless the condition holds."""
    if not condition:
        raise LawError(f"{type(law).__name__}: {name} is {value}; allowed: {allowed}")
