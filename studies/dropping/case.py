"""A structure with thin layers that may be left out of the mesh, and numbers that are asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import ufl

from forms.kinematics import Expr
from thinlayer import Probe, State, Structure, Surface, ThinLayer

Place = Callable[[Expr], Expr]
Layers = ThinLayer | dict[str, ThinLayer]


@dataclass(frozen=True)
class Goal:
    """A number that is asked for.

    Attributes:
        name: of the number.
        value: its value, of a state of either model; the surface is that of the interface model.
    """

    name: str
    value: Callable[[Surface, State], float]


COMPLIANCE = Goal("compliance", lambda _, state: state.energies()["loads"])


def displacement(x: tuple[float, ...], direction: tuple[float, ...]) -> Goal:
    """The displacement along a direction at a place of a body; places are those before the layer is given room."""

    def along(surface: Surface, state: State) -> float:
        shown = replace(state, model=surface.model, u=surface.displacement(state))
        return float(Probe(shown).displacement(x) @ direction)

    return Goal("displacement", along)


def reaction(place: str, direction: tuple[float, ...]) -> Goal:
    """The force along a direction that a place gives to the structure."""
    return Goal("reaction", lambda _, state: float(state.reaction(place).force @ direction))


def mean_traction(where: Place, direction: tuple[float, ...]) -> Goal:
    """The mean traction along a direction on the part of S where a UFL condition holds."""

    def mean(surface: Surface, state: State) -> float:
        part = ufl.conditional(where(ufl.SpatialCoordinate(surface.model.domain.mesh)), 1.0, 0.0)
        return surface.integral(ufl.dot(surface.traction(state), ufl.as_vector(direction)) * part) / surface.integral(
            part
        )

    return Goal("mean traction", mean)


@dataclass(frozen=True)
class Case:
    """A structure with thin layers.

    Attributes:
        name: of the case, a few words.
        structure: thickness -> the structure, with a mesh that is fine enough for a layer of this thickness.
        layers: thickness -> the layers, order 0.
        distance: coordinates -> distance from the nearest free end of S, UFL; None: S has no free end.
        bodies: "kept" or "extended", of both models.
        step: length of the one step in time that is taken from rest; 0: none, a static solve.
        goals: numbers beside traction and jump.
        known: thickness -> effectivities of traction, jump and compliance that another program found; None for one that
            says nothing here.
        inner: whether these are of the inner half of S, |x - 1/2| < 1/4, instead of all places 3 eps from free ends.
        solid: whether it is in three dimensions.
    """

    name: str
    structure: Callable[[float], Structure]
    layers: Callable[[float], Layers]
    distance: Place | None = None
    bodies: str = "kept"
    step: float = 0.0
    goals: tuple[Goal, ...] = (COMPLIANCE,)
    known: Mapping[float, tuple[float | None, ...]] = field(default_factory=dict)
    inner: bool = False
    solid: bool = False
