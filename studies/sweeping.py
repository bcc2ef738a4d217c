"""What several studies do: the meshed layer against the interface law over decreasing thickness."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from forms.kinematics import Expr
from geometry import Joint
from thinlayer import Model, State, Table, ThinLayer, compare, plotting, solve, sweep
from thinlayer.record import Record


@dataclass(frozen=True)
class Sweep:
    """One structure, solved with its layer meshed and with the interface law.

    Attributes:
        record: where to write.
        joint: the joint.
        setup: data of its models other than the layer and the bodies' way to make room for it.
        layer: thickness -> the layer.
        bodies: "kept" or "extended".
        where: part of S to measure on, see `thinlayer.compare`.
    """

    record: Record
    joint: Joint
    setup: dict[str, Any]
    layer: Callable[[float], ThinLayer]
    bodies: str = "kept"
    where: Callable[[Expr], Expr] | None = None

    def solved(self, eps: float) -> tuple[State, State]:
        """The full and the interface model's state for a thickness."""
        layer = self.layer(eps)
        full = Model.full(self.joint, layer=layer, bodies=self.bodies, **self.setup)
        limit = Model.interface(self.joint, layer=layer, **self.setup)
        return self.record.solved(solve(full)), self.record.solved(solve(limit))

    def run(
        self,
        eps: Sequence[float],
        order: tuple[float, float | None],
        pictured: float,
        *,
        title: str = "",
        unit: str = "",
    ) -> Table:
        """Sweep, print the table, draw one thickness, check the last observed orders.

        Args:
            eps: thicknesses, lengths.
            order: range that the last observed orders of traction and jump must lie in; None for an open end.
            pictured: the thickness to draw the deformed structures of.
            title, unit: of that picture.
        """

        def compare_at(e: float) -> dict[str, float]:
            full, limit = self.solved(e)
            if e == pictured:
                states = {f"meshed layer, eps = {e:g} {unit}".rstrip(): full, "interface law": limit}
                plotting.deformed(states, save=self.record.path("deformed.png"), title=title, unit=unit)
            return compare(full, limit, where=self.where)

        table = sweep(compare_at, eps, self.record.path("table.csv"))
        self.record.say(table)
        if len(eps) > 1:
            for name in ("traction", "jump"):
                value = table[f"order_{name}"][-1]
                self.record.check(f"last observed order of the {name}", value, low=order[0], high=order[1])
        return table
