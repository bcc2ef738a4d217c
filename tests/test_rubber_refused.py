"""Where the law with a pressure does not hold: refused before anything is computed, on all ranks, with a remedy."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from forms import HolonomicCoulomb, LinearElastic, Rubber
from forms.base import InputError
from geometry import faults, sandwich
from tests.on_ranks import on_ranks
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
    loads = [
        {"LEFT/LAYER": one} for one in (Pressure(0.3), (0.2, 0.0), lambda x, t: (t, 0.0), (0.0, 0.0), Pressure(0.0))
    ]
    free = Structure(JOINT, **HELD).interface(layer())
    for load in loads[:3]:
        with pytest.raises(InputError, match=r"'LEFT/LAYER' acts on the side of the layer.*mesh the layer"):
            Structure(JOINT, tractions=load, **HELD).interface(layer())
        Structure(JOINT, tractions=load, **HELD).full(layer())
    for load in loads[3:]:
        Structure(JOINT, tractions=load, **HELD).interface(layer())
    refused(InputError, "acts on the side of the layer", lambda: free.with_loads(tractions=loads[0]))


def test_contact_beside_rubber():
    """Contact needs elements of degree 1, a pressure those of degree 2."""
    cuts = {"LOW": ((-1.0, 1.0), (4.0, 1.0)), "HIGH": ((-1.0, 2.0), (4.0, 2.0))}
    joint = faults(3.0, 3.0, cuts, 0.5)
    layers = {"LOW": layer(order=0), "HIGH": HolonomicCoulomb(9.0, 3.0, 0.4)}
    for element, said in (("P1", "needs elements P2 or Q2"), ("P2", "a contact law .* element='P1'")):
        with pytest.raises(InputError, match=said):
            Structure(joint, element=element, **HELD).interface(layers)


def test_rubber_as_a_body():
    with pytest.raises(InputError, match=r"Rubber is for layers.*nu = 0.4999"):
        Structure(JOINT, body=RUBBER, supports={"BOTTOM": 0.0}).interface(layer())


def half_negative() -> list[list[str]]:
    """What each rank is told of a modulus that is negative near one end of S."""
    joint, law = sandwich(1.0, 0.5, 0.5, 0.25), Rubber(lambda x: 90.0 - 100.0 * x[0], 3.0)
    structure, said = Structure(joint, body=LinearElastic(2.0, 1.0), supports={"BOTTOM": 0.0}), []
    for build in (structure.full, structure.interface):
        with pytest.raises(InputError) as found:
            build(ThinLayer(law, 0.1, order=1, at=1.0))
        said.append(str(found.value))
    return MPI.COMM_WORLD.allgather(said)


@pytest.mark.long
@on_ranks(half_negative, 2)
def test_a_modulus_that_is_negative_on_one_rank_is_an_error_on_all(there):
    one, two = there
    assert one == two
    for said in one:
        assert "Rubber: lmbda is -" in said
        assert ", at x = (" in said
