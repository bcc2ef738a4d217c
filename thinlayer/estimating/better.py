"""The better law of a layer, from which the error of its law of order 0 is estimated."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from forms.base import InputError
from forms.law import BulkLaw
from forms.next_order import for_next_order
from forms.tangent import average_lame
from thinlayer.discretisation.free_ends import LEAST_CONTRAST, softest_body
from thinlayer.discretisation.free_rim import free_rim, loose_rim, why_alone
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import ThinLayer
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.errors import ModelError
from thinlayer.parallel.agreement import on_all
from thinlayer.ranges.sublayers import VOLUME

WITHOUT_ENDS = "without edge terms: off by up to a half"
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


def better_layers(model: InterfaceModel) -> dict[str, ThinLayer]:
    """Name of a seam -> its layer with the better law.

    Raises:
        ModelError: there is none.
    """
    if not model.layers:
        raise ModelError("estimate: there is no layer whose mesh could be dropped")
    return {name: _better(model, one) for name, one in model.layers.items()}


def _better(model: InterfaceModel, one: SeamLayer) -> ThinLayer:
    thin, law = one.thin, one.law
    if thin is None:
        raise ModelError(
            f"estimate: {one} has a law on S, {type(law).__name__}, without a thickness: there is no mesh that it replaces"
        )
    if thin.order == 1:
        raise ModelError(f"estimate: {one} has order=1 already, and an estimate needs a better law; give it order=0")
    if law.traits.phases or law.traits.softens:
        raise ModelError(
            f"estimate: {type(law).__name__} has phases, or a stress that falls as strains grow; no estimate of its error "
            "is known: mesh the layer (structure.full)"
        )
    in_sheet = one.structure.plane == "stress"  # no pressure builds up there
    ends = len(loose_rim(model, one.sheet).vertices) > 0
    return replace(thin, law=thin.law if in_sheet else for_next_order(thin.law, ends), order=1)


def better_model(model: InterfaceModel) -> tuple[InterfaceModel, dict[str, BetterLaw]]:
    """The model with better laws of its layers, and name of a seam -> what its law is. Collective.

    Raises:
        ModelError: there are none.
    """
    with on_all(model.comm):
        for one in model.layers.values():
            if reason := why_alone(model, one):
                raise ModelError(f"estimate: {reason}: mesh the layer (structure.full, structure.mixed)")
        layers = better_layers(model)
    try:
        better = model.with_layer({**dict.fromkeys(model.joint.seams), **layers})
    except InputError as error:
        raise ModelError(f"estimate: the better law, of order 1, is not known here: {error}") from error
    found = {}
    for name, one in better.layers.items():
        ends, why = len(free_rim(better, one.sheet).vertices) > 0, better.free_ends(name)
        with_ends = ", with its free ends" if ends and why is None else ""
        lacks, off = _lacks(one, why)
        found[name] = BetterLaw(layers[name], f"order 1 of {type(one.law).__name__}{with_ends}", ends, lacks, off)
    return better, found


def _lacks(one: SeamLayer, why: str | None) -> tuple[str, float]:
    """What the better law of a layer lacks, in words and by how much; `why` its ends are not known, None if they are."""
    assert one.thin
    if why is not None and not _is_told_without_ends(one):
        return f"no estimate without edge terms ({why})", math.nan
    height = float(min(one.sheet.heights)) / float(one.thin.eps)
    found = [f"{WITHOUT_ENDS} ({why})"] if why is not None else []
    if height < LEAST_HEIGHT * (1 - SAME):
        found += [
            f"a body is {height:.2g} thicknesses high, allowed: {LEAST_HEIGHT:g}: off by up to a half, goals by more"
        ]
    return "; ".join(found), OFF if found else 0.0


def _is_told_without_ends(one: SeamLayer) -> bool:
    """Whether a layer has one isotropic law that does not relax, and bodies so soft that its free ends do not dominate."""
    for sample in one.samples:
        (_, law, C), *others = sample.at_rest.sublayers
        if others or C is None or relaxes(law):
            return False
        lmbda, mu = average_lame(C)
        if np.abs(C - lmbda * np.outer(VOLUME, VOLUME) - 2 * mu * np.eye(6)).max() > SAME * np.abs(C).max():
            return False
        if softest_body(sample) >= LEAST_CONTRAST * mu:
            return False
    return True
