"""Which interface law stands for a layer, asked of data alone: the key of the first condition that does not hold."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from forms import (
    Anisotropic,
    HolonomicCoulomb,
    Incompressible,
    KelvinVoigt,
    LinearElastic,
    Maxwell,
    MohrCoulomb,
    NonMonotone,
    Rubber,
    Stack,
    VonMises,
)
from forms.base import InputError
from geometry import disc, ring, sandwich, wall
from tests.refused import refused
from tests.test_tips import partly
from thinlayer import Structure, ThinLayer
from thinlayer.discretisation.applicability import Applicability
from thinlayer.discretisation.layer import SeamLayer

BODY, GLUE = LinearElastic.young(E=100.0, nu=0.3), LinearElastic.shear(1.0, 0.3)
CONTACT = HolonomicCoulomb(50.0, 20.0, 0.5)
SOFTENING = NonMonotone(0.6, 0.4, alpha=1.0, transformation_energy=0.3, chi=[[0, 0.5], [0.5, 0]], mixing=0.5)
STACK = Stack((0.5, GLUE), (0.5, LinearElastic(1.0, 1.0)))
PLATES = sandwich(1.0, 0.3, 0.3, 0.3)
ROUND = ring(1.0, 1.5, 2.0, 0.3, degree=2)
SIDE = {"BOTTOM": 0.0, "LEFT": {"x": 0.0}}
varies = lambda x: 1 + x[0]


def thin(law=GLUE, order=1, **options):
    return ThinLayer(law, 0.1, **{"order": order, "at": 1.0} | options)


def elastic(ratio):
    """Anisotropic in name, with this lmbda/mu."""
    return Anisotropic(np.diag([2.0, 2, 2, 1, 1, 1]) + np.pad(np.full((3, 3), ratio), (0, 3)))


TABLE = {
    "interface law": [
        (None, thin(), {}),
        ("element", CONTACT, {"element": "S2", "joint": sandwich(4.0, 1.0, 1.0, 1.0, cell="quadrilateral")}),
        (None, CONTACT, {"element": "P1"}),
        ("element", thin(Incompressible(40.0), 0), {"element": "P1"}),
        ("element", thin(), {"element": "P1"}),
        ("pressure in a sheet", thin(Rubber(90.0, 3.0)), {"plane": "stress"}),
        ("bent", thin(profile=varies), {}),
        (None, thin(profile=varies), {"bodies": "extended"}),
        ("bent", thin(), {"joint": ROUND, "supports": {"INSIDE": 0.0}}),
        (None, thin(), {"joint": ROUND, "supports": {"INSIDE": 0.0}, "bodies": "extended"}),
        ("bent stack", thin(STACK, profile=varies), {"bodies": "extended"}),
        *(
            (key, thin(law), {})
            for x, key in ((12.1, "locks"), (11.9, None))
            for law in (Maxwell(x, 1.0, 0.7), KelvinVoigt(x, 1.0, 0.3, 0.4), elastic(x))
        ),
        (None, thin(elastic(1200.0)), {"plane": "stress"}),
        ("tip", thin(), {"joint": partly(PLATES, lambda x: x[:, 0] < 0.5)}),
        ("junction", thin(), {"joint": wall(2, 2, (1.0, 0.5), 0.25)}),
    ],
    "ends": [
        (None, thin(), {}),
        ("no thickness", CONTACT, {}),
        ("order 0", thin(order=0), {}),
        ("plain", thin(edges="plain"), {}),
        ("no constants", thin(Anisotropic(np.eye(6))), {}),
        ("no constants", thin(Rubber(varies, 1.0)), {}),
        ("no constants", thin(LinearElastic.young(1.0, -0.1)), {}),
        ("no constants", thin(LinearElastic.shear(1.0, 0.46)), {}),
        ("eigenstrain", thin(eigenstrain=0.01), {}),
        *(("contrast", thin(kind.shear(25.1, 0.3)), {}) for kind in (LinearElastic, Rubber)),
        (None, thin(LinearElastic.shear(24.9, 0.3)), {}),
        *(("contrast", thin(), {"body": {hard: BODY, soft: GLUE}}) for hard, soft in permutations(("LOWER", "UPPER"))),
        ("coarse", thin(Rubber(74.0, 1.0)), {}),
        (None, thin(Rubber(76.0, 1.0)), {}),  # its pressure falls over 0.2517, cells are 0.25 long
        ("apart", thin(), {"bodies": "extended"}),
        ("radius", thin(), {"plane": "axisymmetric", "joint": PLATES.moved((0.39, 0.0))}),
        (None, thin(), {"plane": "axisymmetric", "joint": PLATES.moved((0.41, 0.0))}),
        ("curved end", thin(), {"joint": disc(1.0, lower=0.3, upper=0.3, h=0.4)}),
        ("short", thin(), {"joint": sandwich(0.35, 0.3, 0.3, 0.15)}),
        ("oblique", thin(), {"joint": PLATES.rotated(0.5), "supports": SIDE}),
        (None, thin(STACK), {"supports": SIDE | {"RIGHT": {"x": 0.0}}}),  # there are no free ends
    ],
    "alone": [
        (None, thin(Incompressible(40.0)), {}),
        ("closed", thin(Incompressible(40.0)), {"supports": SIDE | {"RIGHT": {"x": 0.0}}}),
        (None, thin(MohrCoulomb(4.0, 3.0, cohesion=1.0, friction_angle=30.0), 0), {}),
        ("rate", thin(KelvinVoigt(4.0, 3.0, 0.2, 0.5), 0), {}),
    ],
    "corners": [
        ("not linear", thin(VonMises(4.0, 3.0, 1.0), 0), {}),
        (None, thin(STACK), {}),
        ("not isotropic", thin(LinearElastic.shear(varies, 0.3)), {}),
        ("radius", thin(), {"plane": "axisymmetric", "joint": PLATES.moved((0.41, 0.0))}),
        ("bent", thin(order=0, profile=varies), {}),
    ],
    "mesh": [
        (None, thin(elastic(13.0)), {"element": "P1"}),  # of any order
        ("no thickness", CONTACT, {}),
        ("softens", thin(SOFTENING, 0), {}),
    ],
    "estimate": [
        (None, thin(KelvinVoigt(4.0, 3.0, 0.2, 0.5), 0), {}),
        ("phases", thin(SOFTENING, 0), {}),
        ("held alone", thin(order=0), {"supports": {"BOTTOM": 0.0, "LEFT/LAYER": 0.0}}),
        (None, thin(order=0), {"supports": {"BOTTOM": 0.0, "LEFT": 0.0, "LEFT/LAYER": 0.0}}),
    ],
}


ROWS = [(question, *row) for question, rows in TABLE.items() for row in rows]


@pytest.mark.parametrize(("question", "key", "layer", "setup"), ROWS)
def test_the_first_condition_that_does_not_hold(question, key, layer, setup):
    setup = dict(setup)
    joint, bodies = setup.pop("joint", PLATES), setup.pop("bodies", "kept")
    structure = Structure(joint, **{"body": BODY, "supports": {"BOTTOM": 0.0}} | setup)
    applicability = Applicability(SeamLayer(next(iter(joint.seams)), layer, structure), bodies)
    why = applicability.why_not(question)
    assert (why and why.key) == key
    if why:
        assert refused(InputError, "; ", applicability.require, question).key == key


def test_models_ask():
    """What an interface law cannot do a meshed layer may."""
    wedge = Structure(PLATES, body=BODY, supports={"BOTTOM": 0.0})
    assert refused(InputError, "", wedge.full, "glue").key == "no layer"
    assert wedge.full(thin(elastic(13.0))).layers["S"].thin_layer.order == 1
    tapered = wedge.interface(thin(Rubber(74.0, 1.0), profile=varies), bodies="extended").applicability["S"]
    ends = PLATES.points[tapered.loose_rim.vertices[:, 0], 0]
    # in thicknesses of the place
    assert tapered.decay_lengths == pytest.approx(0.1 * (1 + ends) * np.sqrt(74.0 / 12))
