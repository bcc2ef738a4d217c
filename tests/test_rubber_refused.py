"""Where the law with a pressure does not hold: refused before anything is computed, on all ranks, with a remedy."""

from __future__ import annotations

from forms import HolonomicCoulomb, LinearElastic, Rubber
from forms.base import InputError
from geometry import faults, sandwich
from tests.refused import refused
from thinlayer import Pressure, Structure, ThinLayer

BODY = LinearElastic.young(100.0, 0.3)
RUBBER = Rubber(90.0, 3.0)
JOINT = sandwich(1.0, 0.5, 0.5, 0.25)
HELD = {"body": BODY, "supports": {"BOTTOM": 0.0}}


def layer(law=RUBBER, order=1, **options):
    return ThinLayer(law, 0.1, order=order, at=1.0, **options)


def test_loads_on_the_side_of_the_layer():
    """A load on the side of the layer is of order eps, and would squeeze it; zero says that the side is free."""
    free = Structure(JOINT, **HELD).interface(layer())
    for load in (Pressure(0.3), (0.2, 0.0), lambda x, t: (t, 0.0)):
        words = r"'LEFT/LAYER' acts on the side of the layer.*mesh the layer"
        refused(InputError, words, free.with_loads, tractions={"LEFT/LAYER": load})
    for load in ((0.0, 0.0), Pressure(0.0)):
        free.with_loads(tractions={"LEFT/LAYER": load})


def test_contact_beside_rubber():
    """A pressure needs elements of degree 2, which contact takes, too."""
    joint = faults(3.0, 3.0, {"LOW": ((-1.0, 1.0), (4.0, 1.0)), "HIGH": ((-1.0, 2.0), (4.0, 2.0))}, 0.5)
    layers = {"LOW": layer(order=0), "HIGH": HolonomicCoulomb(9.0, 3.0, 0.4)}
    refused(InputError, "needs elements P2 or Q2", Structure(joint, element="P1", **HELD).interface, layers)
    assert set(Structure(joint, element="P2", **HELD).interface(layers).layers) == set(layers)
