"""The better law of a layer, from which the error of its law of order 0 is estimated."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from forms.base import InputError
from forms.law import BulkLaw
from forms.trace import average_lame, is_isotropic
from geometry.seam import S
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import SeamLayer, ThinLayer
from thinlayer.discretisation.reduction import LEAST_CONTRAST, Reduction, softest_body
from thinlayer.discretisation.state import State
from thinlayer.errors import Refused
from thinlayer.estimating.on_surface import NEAR_ENDS
from thinlayer.output.surface import ELASTIC, Surface
from thinlayer.system.ranks import on_all

OFF = 0.5  # of the true error: estimates without edge terms are less off between bodies of E/mu below LEAST_CONTRAST
LEAST_HEIGHT = 4.0  # of a body, over the thickness, from which on estimates were found to be within 25 % of true errors
SAME = 1e-6  # part of a tangent, over its largest entry, that counts as none


@dataclass(frozen=True)
class BetterLaw:
    """What the better law of a layer is.

    Attributes:
        layer: the layer with it.
        name: of the law, in words.
        ends: whether S has free ends.
        lacks: what it leaves out, in words; "": nothing of its order.
        off: share of the true error by which estimates from it may be off; nan: they are none.
    """

    layer: ThinLayer
    name: str
    ends: bool
    lacks: str = ""
    off: float = 0.0

    def __str__(self) -> str:
        return f"{self.name}, {self.lacks}" if self.lacks else self.name


def relaxes(law: BulkLaw) -> bool:
    """Whether stresses of a law fall in time at a constant strain, or strains grow, without a bound of the stress."""
    return law.traits.remembers and not law.traits.bounded


def creeps(law: BulkLaw) -> bool:
    """Whether answers of a law to sudden loads change afterwards."""
    return law.traits.rate or relaxes(law)


def better_model(model: InterfaceModel, seam: str) -> tuple[InterfaceModel, dict[str, BetterLaw]]:
    """The model with better laws of a seam's layer, or of all ("S"), and name of a seam -> what its law is. Collective.

    Raises:
        InputError: there are none.
    """
    with on_all(model.comm):
        chosen = {name: reduction for name, reduction in model.reductions.items() if seam in (S, name)}
        for reduction in chosen.values():
            reduction.require("estimate", "estimate: ")
    try:
        layers = {name: reduction.better() for name, reduction in chosen.items()}
        better = model.with_layer(model.on_seams | layers)
    except InputError as error:
        raise InputError(f"estimate: the better law, of order 1, is not known here: {error}") from error
    found = {}
    for name in layers:
        reduction = better.reductions[name]
        ends, why = len(reduction.free.vertices) > 0, reduction.why_not("ends")
        with_ends = ", with its free ends" if ends and why is None else ""
        lacks, off = _lacks(reduction, why)
        found[name] = BetterLaw(
            layers[name], f"order 1 of {type(reduction.one.law).__name__}{with_ends}", ends, lacks, off
        )
    return better, found


def _lacks(reduction: Reduction, why: Refused | None) -> tuple[str, float]:
    """What the better law of a layer lacks, in words and by how much; `why` its ends are not known, None if they are."""
    one = reduction.one
    assert one.thin
    if why is not None and not all(_is_told_without_ends(sample) for sample in one.samples):
        return f"no estimate without edge terms ({why.reason})", math.nan
    height = float(min(one.sheet.heights)) / float(one.thin.eps)
    found = [f"without edge terms: off by up to a half ({why.reason})"] if why is not None else []
    if height < LEAST_HEIGHT * (1 - SAME):
        found += [
            f"a body is {height:.2g} thicknesses high, allowed: {LEAST_HEIGHT:g}: off by up to a half, goals by more"
        ]
    return "; ".join(found), OFF if found else 0.0


def _is_told_without_ends(sample: SeamLayer) -> bool:
    """Whether a layer has one isotropic law that does not relax, and bodies so soft that its free ends do not dominate."""
    (_, law, C), *others = sample.at_rest.sublayers
    if others or C is None or relaxes(law) or not is_isotropic(C):
        return False
    return softest_body(sample) < LEAST_CONTRAST * average_lame(C)[1]


def why_unknown(state: State) -> str:
    """Why the errors of the layers' laws cannot be told from a state of the better laws; "": they can. Collective.

    At a free end a layer that yields redistributes what the laws on S do not see; estimates there were found to be four
    times too low.
    """
    for name, one in state.model.layers.items():
        if not one.law.traits.bounded:
            continue
        assert one.thin
        surface = Surface(state.model, name)
        yields = surface.status(state)[:, 0] != ELASTIC
        if not yields.any():
            continue
        if not one.law.traits.symmetric:
            return f"{one} slides or yields with a dilatancy unlike its friction: no estimate is known"
        points, ends = state.model.joint.points, state.model.reductions[name].free
        centres = points[surface.corners[yields]].mean(axis=1)
        if np.any(ends.distance(points, centres) < NEAR_ENDS * one.thin.eps):
            return f"{one} yields at its free ends: no estimate (found up to 4 times too low)"
    return ""
