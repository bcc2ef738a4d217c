"""What finds the unknowns of a step, and the tries of one."""

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
        x: the unknowns; they belong to the finder, and stay as they are until it finds others or is closed.
        iterations: steps that it took, of Newton's method if there are any.
        residual: what is left out of balance, over the forces.
    """

    x: PETSc.Vec
    iterations: int
    residual: float


class Finder(Protocol):
    """Finds the unknowns of the step that its equations have begun; keeps what it can from one step to the next.

    Attributes:
        reused: whether the last step went on with what an earlier one had kept, and so read no PETSc options for it.
    """

    reused: bool

    def find(self, start: PETSc.Vec | None = None) -> Found:
        """The unknowns, from the old state or from a start near them. Collective.

        Raises:
            SolveError: they were not found.
        """

    def forget(self) -> bool:
        """Drop what is kept between steps; whether the last one used it, so that another try may go otherwise."""

    def close(self) -> None:
        """Free matrices, vectors and factors."""


@dataclass(frozen=True)
class Attempt:
    """One try of a step, as data.

    Attributes:
        name: for the log.
        linear: PETSc options of the linear solver, without prefix.
        options: those of Newton's method.
        eased: whether the way leads through easier laws, from an elastic one.
    """

    name: str
    linear: Mapping[str, OptionValue] = field(default_factory=dict)
    options: Mapping[str, OptionValue] = field(default_factory=dict)
    eased: bool = False
