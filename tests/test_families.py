"""Models of a family, made by with_layer and with_loads, have the results of models made by themselves."""

from __future__ import annotations

import numpy as np
import pytest

from forms import HolonomicCoulomb, Incompressible, LinearElastic
from forms.base import InputError
from geometry import sandwich
from tests.refused import refused
from thinlayer import Springs, Structure, ThinLayer, solve

JOINT = sandwich(width=2.0, lower=0.5, upper=0.7, h=0.25, structured=True)
STEEL = LinearElastic.young(E=900.0, nu=0.3)
SUPPORTS = {"BOTTOM": 0, "TOP": {"x": 0.003}}
PULL, OTHER = {"TOP": (0.0, -0.8)}, {"TOP": (0.0, 0.5), "RIGHT": (0.2, 0.1)}
GLUE, SOFT = ThinLayer(LinearElastic(60.0, 40.0), 0.01, at=1.0), ThinLayer(LinearElastic(20.0, 30.0), 0.03, at=1.0)


def joined(tractions=PULL, **data) -> Structure:
    return Structure(JOINT, body=STEEL, tractions=tractions, **{"supports": SUPPORTS} | data)


def difference(state, other) -> float:
    return float(np.abs(state.u.x.array - other.u.x.array).max() / np.abs(other.u.x.array).max())


OF_ORDER_1 = ThinLayer(LinearElastic(60.0, 40.0), 0.01, order=1, at=1.0)
OTHERS = [SOFT, OF_ORDER_1, {"S": ThinLayer(Incompressible(mu=40.0), 0.01, at=1.0)}]


@pytest.mark.filterwarnings("ignore::thinlayer.errors.RangeWarning")  # of free ends of an incompressible layer
@pytest.mark.parametrize("layer", OTHERS)
def test_another_layer_is_as_in_a_model_of_its_own(layer):
    first = joined().interface(GLUE)
    solve(first)
    reference = joined().interface(layer)
    for _ in range(2):  # the second time with what the family keeps
        derived = first.with_layer(layer)
        assert derived.description == reference.description
        assert derived.V is first.V
        assert difference(solve(derived), solve(reference)) < 1e-10
    assert difference(solve(first), solve(joined().interface(GLUE))) < 1e-12  # the first one is what it was


@pytest.mark.parametrize("kind", ["interface", "full", "bonded"])
def test_other_loads_are_as_in_a_model_of_its_own(kind):
    layer = () if kind == "bonded" else (GLUE,)
    supports = {"BOTTOM": 0, "TOP": {"x": lambda x, t: -0.001 * x[0]}}
    springs = (Springs("RIGHT", normal=3.0, tangential=1.0),)
    first = getattr(joined(parts=springs), kind)(*layer)
    reference = getattr(joined(OTHER, supports=supports, body_force=(0.1, -0.2), parts=springs), kind)(*layer)
    for _ in range(2):
        derived = first.with_loads(tractions=OTHER, supports=supports).with_loads(body_force=(0.1, -0.2))
        assert derived.description == reference.description
        assert difference(solve(derived), solve(reference)) < 1e-11
    assert difference(solve(first.with_loads(tractions=PULL)), solve(first)) < 1e-12


def test_a_meshed_layer_keeps_its_shape():
    first = joined().full(GLUE)
    same = ThinLayer(LinearElastic(20.0, 30.0), 0.01, at=1.0)
    assert difference(solve(first.with_layer(same)), solve(joined().full(same))) < 1e-11
    words = r"made room for a layer 'S' of .* \(0\.01, None, \(\)\), not \(0\.03, None, \(\)\)"
    refused(InputError, words, first.with_layer, SOFT)
    with pytest.raises(InputError, match="is a law on S, without a thickness"):
        first.with_layer(HolonomicCoulomb(60.0, 40.0, friction=0.3))


def test_supports_keep_their_places():
    first = joined().interface(GLUE)
    with pytest.raises(InputError, match=r"supports hold .*those of the model .*build another structure"):
        first.with_loads(supports={"BOTTOM": 0, "TOP": {"y": 0.003}})
    refused(InputError, "traction on 'TOP' is", lambda: first.with_loads(tractions={"TOP": (1.0,)}))
