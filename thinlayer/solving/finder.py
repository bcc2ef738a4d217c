"""Protocol of the finders of a step's unknowns, their results, and the attempts at a step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from petsc4py import PETSc

from thinlayer.solving.options import OptionValue


@dataclass(frozen=True)
class Found:
    """Unknowns at the end of a step.

    Attributes:
        x: the unknowns; the vector belongs to the finder and is valid until the next `find` or `close`.
        iterations: number of iterations; of Newton's method, if the finder uses it.
        residual: norm of the residual relative to the forces.
    """

    x: PETSc.Vec
    iterations: int
    residual: float


class Finder(Protocol):
    """Finds the unknowns of the step that its equations have begun; keeps matrices and factors between steps.

    Attributes:
        eases: whether it finds equilibria of eased laws.
        reused: whether the last step used a solver of an earlier step, and so read no PETSc options.
    """

    eases: bool
    reused: bool

    def find(self, start: PETSc.Vec | None = None) -> Found:
        """The unknowns at the end of the step. Collective.

        Args:
            start: unknowns to begin from; None: those of the old state.

        Raises:
            SolveError: the unknowns were not found.
        """

    def forget(self) -> bool:
        """Drop what is kept between steps. True if the last step used it: then another try may succeed."""

    def close(self) -> None:
        """Free matrices, vectors and factors."""


@dataclass(frozen=True)
class Attempt:
    """One try of a step, as data.

    Attributes:
        name: for the log.
        linear: PETSc options of the linear solver, without prefix.
        options: PETSc options of Newton's method, without prefix.
        eased: whether eased laws are solved first, beginning with an elastic one.
    """

    name: str
    linear: Mapping[str, OptionValue] = field(default_factory=dict)
    options: Mapping[str, OptionValue] = field(default_factory=dict)
    eased: bool = False
