"""A structure with thin layers that may be left out of the mesh, and numbers that are asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from thinlayer import Structure, ThinLayer, goals

Layers = ThinLayer | dict[str, ThinLayer]


@dataclass(frozen=True)
class Case:
    """A structure with thin layers.

    Attributes:
        name: of the case, a few words.
        structure: thickness -> the structure, with a mesh that is fine enough for a layer of this thickness.
        layers: thickness -> the layers, order 0.
        bodies: "kept" or "extended", of both models.
        step: length of the one step in time that is taken from rest; 0: none, a static solve.
        asked: numbers beside traction and jump.
        known: thickness -> effectivities of traction, jump and the first of these numbers that another program found; None
            for one that says nothing here.
        inner: whether these are of the inner half of S, |x - 1/2| < 1/4.
        solid: whether it is in three dimensions.
    """

    name: str
    structure: Callable[[float], Structure]
    layers: Callable[[float], Layers]
    bodies: str = "kept"
    step: float = 0.0
    asked: tuple[goals.Goal, ...] = (goals.Compliance(),)
    known: Mapping[float, tuple[float | None, ...]] = field(default_factory=dict)
    inner: bool = False
    solid: bool = False
