"""The better law of a layer, from which the error of its law of order 0 is estimated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from forms.base import InputError
from forms.next_order import for_next_order
from geometry.seam import LAYER
from thinlayer.discretisation.free_rim import free_rim
from thinlayer.discretisation.interface_model import InterfaceModel
from thinlayer.discretisation.layer import ThinLayer
from thinlayer.discretisation.seams import SeamLayer
from thinlayer.errors import ModelError
from thinlayer.parallel.agreement import on_all

WITHOUT_ENDS = "without edge terms: off by up to a half"


@dataclass(frozen=True)
class BetterLaw:
    """What the better law of a layer is.

    Attributes:
        layer: the layer with it.
        name: of the law, in words.
        ends: whether S has free ends.
        lacks: what it leaves out, in words; "": nothing of its order.
    """

    layer: ThinLayer
    name: str
    ends: bool
    lacks: str = ""

    def __str__(self) -> str:
        return f"{self.name}, {self.lacks}" if self.lacks else self.name


def better_layers(layers: Mapping[str, SeamLayer]) -> dict[str, ThinLayer]:
    """Name of a seam -> its layer with the better law.

    Raises:
        ModelError: there is none.
    """
    if not layers:
        raise ModelError("estimate: there is no layer whose mesh could be dropped")
    return {name: _better(one) for name, one in layers.items()}


def _better(one: SeamLayer) -> ThinLayer:
    thin, law = one.thin, one.law
    if thin is None:
        raise ModelError(
            f"estimate: {one} has a law on S, {type(law).__name__}, without a thickness: there is no mesh that it replaces"
        )
    places = [str(place) for place in one.structure.supports]
    if held := [
        place for place in places if place.endswith(f"/{LAYER}") and place.removesuffix(f"/{LAYER}") not in places
    ]:
        raise ModelError(
            f"estimate: the support on {held[0]!r} holds the side of the layer alone, of which no law on S knows: mesh the "
            "layer (structure.full, structure.mixed)"
        )
    if thin.order == 1:
        raise ModelError(f"estimate: {one} has order=1 already, and an estimate needs a better law; give it order=0")
    if law.traits.phases or law.traits.softens:
        raise ModelError(
            f"estimate: {type(law).__name__} has phases, or a stress that falls as strains grow; no estimate of its error "
            "is known: mesh the layer (structure.full)"
        )
    in_sheet = one.structure.plane == "stress"  # no pressure builds up there
    return replace(thin, law=thin.law if in_sheet else for_next_order(thin.law), order=1)


def better_model(model: InterfaceModel) -> tuple[InterfaceModel, dict[str, BetterLaw]]:
    """The model with better laws of its layers, and name of a seam -> what its law is. Collective.

    Raises:
        ModelError: there are none.
    """
    with on_all(model.comm):
        layers = better_layers(model.layers)
    try:
        better = model.with_layer({**dict.fromkeys(model.joint.seams), **layers})
    except InputError as error:
        raise ModelError(f"estimate: the better law, of order 1, is not known here: {error}") from error
    found = {}
    for name, one in better.layers.items():
        ends, why = len(free_rim(better, one.sheet).vertices) > 0, better.free_ends(name)
        with_ends = ", with its free ends" if ends and why is None else ""
        lacks = f"{WITHOUT_ENDS} ({why})" if why is not None else ""
        found[name] = BetterLaw(layers[name], f"order 1 of {type(one.law).__name__}{with_ends}", ends, lacks)
    return better, found
