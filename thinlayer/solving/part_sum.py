"""The sum of the parts of a balance of forces."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import reduce
from operator import or_
from typing import Any, TypeVar

import numpy as np
from dolfinx import fem
from petsc4py import PETSc

from thinlayer.discretisation.state import Configuration
from thinlayer.errors import ModelError
from thinlayer.parts.part import Array, Block, FieldPart, Interval, Memory, Outcome, Part, PartTraits

Kind = TypeVar("Kind", bound=Part)


class PartSum:
    """Parts of a balance of forces, added up. All methods are collective.

    Attributes:
        parts: the parts.
        traits: the traits of all parts together.
        with_own: the parts with own unknowns.
        depends_on_dt: whether the tangent depends on the length of the step.
        failed: number of points where parts failed in the last evaluation.
    """

    def __init__(self, parts: Iterable[Part]) -> None:
        self.parts = list(parts)
        self.traits = reduce(or_, (part.traits for part in self.parts), PartTraits())
        self.with_own = [part for part in self.parts if isinstance(part, FieldPart)]
        for part in self.parts:
            if hasattr(part, "field") and not isinstance(part, FieldPart):
                raise ModelError(f"the part {part.key!r} has a field of its own; derive it from FieldPart")
        timed = (part.traits.rate or (part.traits.remembers and not part.traits.switches) for part in self.parts)
        self.depends_on_dt, self.failed = any(timed), 0

    def of_kind(self, kind: type[Kind]) -> list[Kind]:
        """The parts of a kind."""
        return [part for part in self.parts if isinstance(part, kind)]

    def having(self, trait: str) -> list[str]:
        """Names of the laws, and of parts that are none, that have a trait."""
        return [name for part in self.parts for name, traits in part.named().items() if getattr(traits, trait)]

    def refuse(self, reasons: Mapping[str, str]) -> None:
        """Raise ModelError if a part has one of these traits, with the reason, in which {} is the part's name."""
        for trait, reason in reasons.items():
            for name in self.having(trait):
                raise ModelError(reason.format(name))

    def ask(self, name: str, *arguments: Any) -> list[Any]:
        """What an optional method or attribute gives in each of the parts that have it, see `Part`."""
        answers = [getattr(part, name) for part in self.parts if hasattr(part, name)]
        return [answer(*arguments) if callable(answer) else answer for answer in answers]

    # ---------------------------------------------------------------- a step
    @property
    def memory_at_rest(self) -> dict[str, Memory]:
        """Memory at rest of the parts that have one, by key."""
        return {part.key: rest for part in self.parts if (rest := part.rest()) is not None}

    @property
    def stresses_at_rest(self) -> dict[str, Array]:
        """Stresses at rest, zero, of the parts whose stresses states keep, by key."""
        return {
            part.key: np.zeros((len(rest), width))
            for part in self.parts
            if (width := getattr(part, "stress_width", 0)) and (rest := part.rest()) is not None
        }

    def begin_parts(self, interval: Interval) -> None:
        """Begin a step in all parts."""
        for part in self.parts:
            part.begin(interval)

    def forces(self, u: fem.Function, mid: fem.Function, out: PETSc.Vec, each: PETSc.Vec | None = None) -> list[float]:
        """Evaluate all parts and write the sum of their nodal forces.

        Returns:
            The norms that the force scale shall know; given a vector `each` to work with, the norms of all parts' forces.
        """
        out.set(0.0)
        sizes = []
        for part in self.parts:
            part.evaluate(u, mid)
            if each is None:
                sizes.append(part.add_forces(out))
            else:
                each.set(0.0)
                part.add_forces(each)
                sizes.append(float(each.norm()))
                out.axpy(1.0, each)
        self.failed = sum(part.failed for part in self.parts)
        return sizes

    def failure(self) -> str:
        """Text that says which part failed in the last evaluation and where; "" if none did."""
        return next(filter(None, self.ask("failure")), "")

    def blocks(self, relative_residual: float = 0.0, *, rigid: bool = False) -> list[Block]:
        """Blocks of the tangent at the last evaluation; `rigid`: of the parts alone that resist rigid motions."""
        parts = [part for part in self.parts if not (rigid and part.traits.inner)]
        return [block for part in parts for block in part.tangents(relative_residual)]

    @property
    def excess(self) -> float:
        """Largest gain of energy if a column changed its phase; <= 0: no column gains."""
        return max([-np.inf, *self.ask("excess")])

    def switch(self) -> bool:
        """Change columns to the phases of lowest energy in the last evaluation. True if any column changes."""
        return any(self.ask("switch"))

    def end_parts(self, u: fem.Function, t: float) -> tuple[dict[str, Outcome], Configuration]:
        """End the step in all parts, at displacements u of the last evaluation: energies by key, new configuration."""
        found = {part.key: part.commit() for part in self.parts}
        memory = {key: one.memory for key, one in found.items() if one.memory is not None}
        if lost := [part.key for part in self.parts if part.traits.remembers and part.key not in memory]:
            raise ModelError(f"the part {lost[0]!r} remembers, and its commit returned an Outcome without memory=...")
        fields = {part.key: part.own_result() for part in self.with_own}
        stored = {key: one.after for key, one in found.items() if one.kept}
        stresses = {key: one.stress for key, one in found.items() if one.stress is not None}
        return found, Configuration(u.copy(), t, memory, fields, stored, stresses=stresses)
