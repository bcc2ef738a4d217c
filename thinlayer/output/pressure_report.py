"""PressureReport: how many times too stiff the interface laws of isotropic layers are where pressures even out along S."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from geometry.errors import unknown
from geometry.seam import S
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.discretisation.state import State
from thinlayer.errors import ModelError
from thinlayer.files.table import Table
from thinlayer.ranges.excess import Faces, pressure_excess, why_unknown
from thinlayer.ranges.sublayers import sublayers_of


@dataclass(frozen=True)
class PressureReport:
    """How much too stiff the laws of orders 0 and 1 of isotropic elastic layers are, the same on all ranks. Collective.

    These laws let no material flow along S: their pressure p_0 = lmbda ([u_N]/eps + div_S <u>) follows the opening at
    each place. That of the layer, p, evens out over the length delta = eps sqrt(lmbda/(12 mu)), and is zero at free ends.
    For the displacements of the state p is computed on S, and the works of both are compared:

        eta = int (p_0 - p) wb/int p wb,   wb = [u_N] + eps div_S <u>

    The layer alone is 1 + eta times too stiff against these openings, whatever it is sheared; the structure is off by less
    where its bodies are soft. Beyond 1.1 use `Rubber` with order=1, whose pressure flows, or mesh the layer. For a Fourier
    mode of wave number k eta = (k delta)^2. Eta is zero of a layer that nothing opens, and of a law with a pressure that
    flows (order 1 of `Rubber` and `Incompressible`).

    Args:
        state: state of an interface model.
        seam: name of a seam; "S": all those of which the report can say something.

    Raises:
        ModelError: a state of another model; an unknown seam, or one whose law has no such number: it is not one linear
            elastic isotropic material with numbers for parameters and lmbda >= 0, or it has an eigenstrain.
    """

    state: State
    seam: str = S

    def __post_init__(self) -> None:
        if not isinstance(self.state, State) or not isinstance(self.state.model, InterfaceModel):
            given = self.state.model if isinstance(self.state, State) else self.state
            raise ModelError(f"a pressure report needs a state of an interface model, not {given!r:.80}")
        joint, layers = self.state.model.joint, self.state.model.layers
        if self.seam not in (S, *joint.seams):
            raise ModelError(unknown("seam", self.seam, joint.seams))
        reasons = {name: why_unknown(one) for name, one in layers.items() if self.seam in (S, name)}
        if not self._layers:
            why = "; ".join(f"{layers[name]}: {reason}" for name, reason in reasons.items()) or "no layer is there"
            raise ModelError(f"a pressure report is for linear elastic isotropic layers ({why})")
        _ = self.too_stiff

    @cached_property
    def _layers(self) -> dict[str, SeamLayer]:
        layers = self.state.model.layers
        return {name: one for name, one in layers.items() if self.seam in (S, name) and why_unknown(one) is None}

    @cached_property
    def too_stiff(self) -> dict[str, float]:
        """1 + eta of each seam, by its name."""
        return {name: 1 + self._excess(one) for name, one in self._layers.items()}

    @property
    def lengths(self) -> dict[str, float]:
        """Length delta over which the pressure of each seam's layer evens out."""
        found = {}
        for name, one in self._layers.items():
            assert one.thin
            found[name] = float(one.thin.eps) * sublayers_of(one)[0].length
        return found

    @property
    def table(self) -> Table:
        """A row for each seam: its thickness, lmbda/mu, delta and 1 + eta."""
        rows = []
        for name, one in self._layers.items():
            assert one.thin
            (layer,) = sublayers_of(one)
            row = {"seam": name, "eps": float(one.thin.eps), "lmbda/mu": layer.lmbda / layer.mu}
            rows.append(row | {"delta": self.lengths[name], "too_stiff": self.too_stiff[name]})
        return Table(rows)

    def __str__(self) -> str:
        layers = self._layers
        return "; ".join(
            f"{layers[name]} alone is {x:.4g} times too stiff against openings" for name, x in self.too_stiff.items()
        )

    def _excess(self, one: SeamLayer) -> float:
        return 0.0 if one.flows else pressure_excess(Faces.of(self.state, one), sublayers_of(one)[0]).opening


def columns_of_pressure(state: State, seam: str) -> dict[str, float]:
    """Column "too_stiff" of each layer that has one, "too_stiff NAME" if the joint has several seams. Collective."""
    layers = state.model.layers
    names = [name for name, one in layers.items() if seam in (S, name) and why_unknown(one) is None and not one.flows]
    several = len(state.model.joint.seams) > 1
    found = PressureReport(state, seam).too_stiff if names else {}
    return {f"too_stiff {name}" if several else "too_stiff": factor for name, factor in found.items()}
