"""Tractions on a layer's own side in its interface law of order 1: errors against meshed layers, resultants, refusals."""

from __future__ import annotations

import numpy as np
import pytest
import ufl

from forms import LinearElastic
from forms.base import InputError
from forms.ends import free_end
from geometry import block, disc, sandwich
from tests.orders import observed_orders
from tests.refused import refused
from thinlayer import Pressure, Structure, ThinLayer, compare, solve
from thinlayer.discretisation import interface_model
from thinlayer.output.nodal_forces import nodal_forces

pytestmark = pytest.mark.few(5)

BODY, GLUE = LinearElastic.young(E=70.0, nu=0.2), LinearElastic.shear(3.0, 0.35)
THICKNESSES = (1 / 16, 1 / 32)
EPS = 0.05


def layer(law=GLUE, eps=0.1, edges=None):
    return ThinLayer(law, eps, order=1, edges=edges, at=1.0)


def stack(eps):
    return sandwich(1.0, 0.5, 0.5, h=1 / 8, h_S=1 / 32, h_ends=eps / 12, cell="quadrilateral"), {"BOTTOM": 0}


def based(eps):
    return block(1.0, 0.5, h=1 / 8, h_S=1 / 32, h_ends=eps / 12, cell="quadrilateral"), {}


def errors(joint_at, law, loads, monkeypatch):
    """Errors of traction and jump on the inner half of S, of the law and of one whose sides are not drawn in."""
    right, wrong, shares = [], [], interface_model._transfer_factors
    for eps in THICKNESSES:
        joint, supports = joint_at(eps)
        setup = Structure(joint, body=BODY, supports=supports, tractions=loads)
        full = solve(setup.full(ThinLayer(law, eps, at=1.0), cells_through=8))
        for rows, drawn in ((right, 1.0), (wrong, 0.0)):
            some = lambda *arguments, drawn=drawn: shares(*arguments) * [1.0, 1.0, 1.0, drawn, drawn]
            monkeypatch.setattr(interface_model, "_transfer_factors", some)
            limit = solve(setup.interface(layer(law, eps)))
            row = compare(full, limit, where=lambda x: abs(x[0] - 0.5) < 0.25)
            rows.append([row["error_traction"], row["error_jump"]])
            assert limit.applied().force == pytest.approx(full.applied().force, rel=1e-9, abs=1e-12)
            place = "S" if joint.base_seams else "BOTTOM"
            assert limit.reaction(place).force == pytest.approx(-limit.applied().force, rel=1e-7, abs=1e-10)
    return np.array(right), np.array(wrong)


ON_SIDES = [
    (stack, 8.0, 0.3, (0.7, 0.0)),
    (stack, 8.0, 0.3, (0.0, 0.7)),
    (based, 8.0, 0.4, Pressure(0.9)),
    (based, 8.0, 0.1, lambda x, t: (0.3 * x[0], -0.4 * t)),
]


@pytest.mark.parametrize(("joint_at", "mu", "nu", "load"), ON_SIDES)
def test_what_a_load_on_the_side_does(joint_at, mu, nu, load, monkeypatch):
    """Alone, its relative errors fall with the thickness; where the side is not drawn in they stay."""
    right, wrong = errors(joint_at, LinearElastic.shear(mu, nu), {"RIGHT/LAYER": load}, monkeypatch)
    assert right[-1].max() < 0.02
    assert np.all(right[-1] < 0.1 * wrong[-1])
    assert np.all(wrong[-1] > 0.8 * wrong[0])


def test_order_2_beside_other_loads(monkeypatch):
    loads = {"TOP": (0.3, -1.0), "LEFT/LAYER": (0.7, -0.4), "RIGHT/LAYER": Pressure(0.5)}
    right, wrong = errors(stack, LinearElastic.shear(20.0, 0.3), loads, monkeypatch)
    assert min(observed_orders(THICKNESSES, right[:, k])[-1] for k in range(2)) > 1.9
    assert max(observed_orders(THICKNESSES, wrong[:, k])[-1] for k in range(2)) < 1.3


@pytest.mark.parametrize("nu", [0.25, 0.45])
def test_how_far_an_end_is_drawn_in(nu):
    """Found on a meshed layer between stiff blocks that are moved apart, and along one another."""
    eps, end = 0.1, free_end(nu)
    joint = sandwich(2.0, 0.05, 0.05, h=1 / 8, h_S=1 / 16, h_ends=eps / 12, cell="quadrilateral")
    law = LinearElastic.shear(1e-9, nu)
    for component, drawn in (("y", -end.inward_displacement), ("x", -end.c_T)):
        bcs = {"BOTTOM": 0, "TOP": {"x": 0.0, "y": 0.0} | {component: 1.0}}
        state = solve(Structure(joint, body=BODY, supports=bcs).full(ThinLayer(law, eps, at=1.0), cells_through=12))
        side = state.model.ds(state.model.domain.values("RIGHT/LAYER"))
        moved = state.integral(state.u[0 if component == "y" else 1] * side) / eps
        assert moved == pytest.approx(drawn, rel=3e-2), component  # singular corners


def test_three_sides_of_a_box():
    """The strips overlap at corners of S, and every side has its force."""
    box = sandwich(1.3, 0.3, 0.4, 0.3, h_ends=0.15, depth=0.7)
    varies = lambda x, t: (0.3 * x[2], t, 0.1)
    loads = {"LEFT/LAYER": (0.7, -0.4, 0.5), "FRONT/LAYER": Pressure(0.8), "RIGHT/LAYER": varies}
    made = Structure(box, body=BODY, supports={"BOTTOM": 0}, tractions=loads)
    meshed, state = solve(made.full(ThinLayer(GLUE, EPS, at=1.0))), solve(made.interface(layer(eps=EPS)))
    assert state.applied().force == pytest.approx(meshed.applied().force, rel=1e-3)  # what varies along an edge
    assert state.reaction("BOTTOM").force == pytest.approx(-meshed.applied().force, rel=1e-3)


def test_a_plate_in_plane_strain_is_its_section():
    rollers, displacements = {"BACK": {"z": 0.0}, "FRONT": {"z": 0.0}}, []
    for depth, more, load in ({}, {}, (0.3, -1.0)), ({"depth": 0.1}, rollers, (0.3, -1.0, 0.0)):
        cell = "hexahedron" if depth else "quadrilateral"  # a grid of the same displacements
        joint = sandwich(1.0, 0.3, 0.3, 0.1, cell=cell, structured=True, **depth)
        setup = Structure(joint, body=BODY, supports={"BOTTOM": 0} | more, tractions={"RIGHT/LAYER": load})
        state = solve(setup.interface(layer()))
        top = state.model.ds(state.model.domain.values("TOP"))
        displacements.append([state.integral(state.u[k] * top) / depth.get("depth", 1.0) for k in range(2)])
    assert displacements[1] == pytest.approx(displacements[0], rel=1e-10)


def test_how_far_from_its_end_a_load_along_it_reaches_the_faces():
    """0.271 thicknesses, as tractions of a half strip are 4/(k pi) exp(-k pi d), k odd; here that is a cell."""
    k = np.pi * (2 * np.arange(10**5) + 1)
    mean = (4 / k**3).sum() / 0.5
    joint = sandwich(2.0, 0.3, 0.3, 0.1, depth=0.2, cell="hexahedron", structured=True)
    bcs = {"BOTTOM": 0, "FRONT": {"x": 0, "y": 0}, "BACK": {"x": 0, "y": 0}}
    setup = Structure(joint, body=BODY, supports=bcs, tractions={"RIGHT/LAYER": (0.0, 0.0, 0.7)})
    model = setup.interface(layer(eps=0.1 / mean))
    f = nodal_forces(model.V, model.external_work(ufl.TestFunction(model.V), 0.0)).x.array.reshape(-1, 3)
    x = model.V.tabulate_dof_coordinates()
    assert f.sum(axis=0) == pytest.approx([0, 0, 0.7 * 0.2 * 0.1 / mean], rel=1e-9, abs=1e-12)
    assert (2 - x[:, 0]) @ f[:, 2] / f[:, 2].sum() == pytest.approx(0.1, rel=1e-5)


def test_bodies_of_revolution():
    """The ring of a layer's side; the base has all of the force."""
    joint = block(1.0, 0.5, 0.25).moved((0.5, 0.0))
    setup = Structure(joint, body=BODY, supports={}, plane="axisymmetric", tractions={"RIGHT/LAYER": (0.7, -0.4)})
    state = solve(setup.interface(layer()))
    assert state.applied().force == pytest.approx([0.0, -0.4 * 0.1 * 2 * np.pi * 1.5], rel=1e-10)
    assert state.reaction("S").force == pytest.approx(-state.applied().force, rel=1e-8, abs=1e-10)


def test_loads_whose_way_to_the_faces_is_not_known_are_refused():
    """Zero is no load, and at order 0 none of them is."""
    load, plates = {"LEFT/LAYER": (1.0, 0.0)}, sandwich(1.0, 0.3, 0.4, 0.25)
    cylinders = disc(1.0, lower=0.3, upper=0.3, h=0.4)
    for joint, tractions, more, edges, words in (
        (plates, load, {}, "plain", "edges='plain' was asked for"),
        (plates, load, {"LEFT": {"x": 0}}, None, "a support holds the side"),
        (cylinders, {"SIDE/LAYER": Pressure(0.7)}, {}, None, "straight"),
    ):
        setup = Structure(joint, body=BODY, supports={"BOTTOM": 0} | more, tractions=tractions)
        refused(InputError, f"{words}.*use order=0", setup.interface, layer(edges=edges))
        assert solve(setup.interface(ThinLayer(GLUE, 0.1, at=1.0))).energies()["loads"] == pytest.approx(0.0, abs=1e-12)
    model = Structure(plates, body=BODY, supports={"BOTTOM": 0}, tractions=load).interface(layer())
    twice = model.with_loads(tractions={"LEFT/LAYER": lambda x, t: (t, 0)})
    assert solve(twice, 2.0).energies()["loads"] == pytest.approx(4 * solve(model).energies()["loads"], rel=1e-9)
    endless = model.with_loads(tractions={"LEFT/LAYER": lambda x, t: (1 / (t - 1), 0)})
    refused(InputError, r"not finite.*'LEFT/LAYER'", solve, endless, 1.0)
    assert model.with_loads(tractions={"LEFT/LAYER": (0.0, 0.0)}).with_layer(layer(edges="plain")).layers
