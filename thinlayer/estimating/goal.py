"""Goal: a number that a user wants of a structure; the base of all goals."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from forms.base import Array, InputError
from forms.temperature import finite
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.state import State
from thinlayer.solving.adjoint import Adjoint
from thinlayer.solving.layer_alone import HeldLayers


class Goal(ABC):
    """A number Q of the displacements of a structure, the same for all of its models.

    Attributes:
        name: of the goal, in tables and sentences.
    """

    name: str

    def check(self, model: InterfaceModel) -> None:
        """Raise InputError unless the goal suits the model. Not collective."""

    def is_linear(self, model: InterfaceModel) -> bool:
        """Whether Q is linear in the displacements and reactions."""
        return True

    @abstractmethod
    def value(self, state: State, model: InterfaceModel) -> float:
        """Q in a state; of another model its displacements are taken to the interface model. Collective."""

    @abstractmethod
    def scale(self, state: State, model: InterfaceModel) -> float:
        """What Q is zero beside where it is only rounding, >= 0. Collective."""

    def at_rest(self, state: State, model: InterfaceModel) -> float:
        """Q without displacements, where it is linear: what given strains and loads do. Collective."""
        return self.value(replace(state, u=fem.Function(model.V)), model)

    def in_layers(self, layers: HeldLayers) -> tuple[Array, Array]:
        """The same of the meshed layers: weights at their unknowns, and motions of their sides; by default none."""
        return np.zeros_like(layers.load), np.zeros_like(layers.load)

    @abstractmethod
    def dual(self, adjoint: Adjoint) -> tuple[PETSc.Vec, PETSc.Vec]:
        """Nodal weights q and motions g of supports for which Q = q . u - g . r + `at_rest`, see `Adjoint`. Collective.

        Raises:
            InputError: there are none.
        """


def unit(direction: Sequence[float], dim: int, goal: str) -> Array:
    """A direction (d,) of unit length.

    Raises:
        InputError: it is none.
    """
    if (found := finite(direction, (dim,))) is None or not found.any():
        raise InputError(f"{goal}: the direction is {direction!r}; give {dim} numbers, not all zero")
    return np.asarray(found / np.linalg.norm(found))


def written(vector: Any) -> str:
    """A vector in the name of a goal; as it is if it is none, which `check` refuses."""
    try:
        return f"({', '.join(f'{c:.4g}' for c in vector)})"
    except (TypeError, ValueError):
        return repr(vector)
