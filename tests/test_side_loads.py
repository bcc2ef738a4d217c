"""Tractions on a layer's own side in its interface law of order 1: errors against meshed layers, resultants, ranks."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import ufl

from forms import Anisotropic, LinearElastic
from forms.base import InputError
from forms.ends import free_end
from geometry import block, disc, sandwich
from tests.orders import observed_orders
from tests.side_loads_run import BODY, EPS, GLUE, SIDES, box, loaded
from thinlayer import Pressure, Structure, ThinLayer, compare, solve
from thinlayer.errors import RangeWarning
from thinlayer.output.nodal_forces import nodal_forces

pytestmark = pytest.mark.few(5)

HALVES = pytest.mark.filterwarnings("ignore:traction on:thinlayer.errors.RangeWarning")
THICKNESSES = (1 / 16, 1 / 32)


def stack(eps):
    return sandwich(1.0, 0.5, 0.5, h=1 / 8, h_S=1 / 32, h_ends=eps / 12, cell="quadrilateral"), {"BOTTOM": 0}


def based(eps):
    return block(1.0, 0.5, h=1 / 8, h_S=1 / 32, h_ends=eps / 12, cell="quadrilateral"), {}


@lru_cache(maxsize=len(THICKNESSES))  # for the wrong law after the right one
def solved_full(joint_at, law, load, eps):
    joint, supports = joint_at(eps)
    setup = Structure(joint, body=BODY, supports=supports, tractions={"RIGHT/LAYER": load})
    return setup, solve(setup.full(ThinLayer(law, eps, at=1.0), cells_through=8))


def errors(joint_at, law, load, edges):
    """Errors of inner traction and jump, over their norms, without a load on top; forces are those of the meshed layer."""
    found = []
    for eps in THICKNESSES:
        setup, full = solved_full(joint_at, law, load, eps)
        limit = solve(setup.interface(ThinLayer(law, eps, order=1, edges=edges, at=1.0)))
        row = compare(full, limit, where=lambda x: abs(x[0] - 0.5) < 0.25)
        found.append([row["error_traction"], row["error_jump"]])
        assert limit.applied().force == pytest.approx(full.applied().force, rel=1e-9, abs=1e-12)
        place = "S" if setup.joint.base_seams else "BOTTOM"
        assert limit.reaction(place).force == pytest.approx(-limit.applied().force, rel=1e-7, abs=1e-10)
    return np.array(found)


@pytest.mark.parametrize(
    ("joint_at", "mu", "nu", "load"),
    [
        (stack, 8.0, 0.3, (0.7, 0.0)),
        (stack, 8.0, 0.3, (0.0, 0.7)),
        (based, 8.0, 0.4, Pressure(0.9)),
        (based, 8.0, 0.1, lambda x, t: (0.3 * x[0], -0.4 * t)),
    ],
)
@HALVES
def test_what_a_load_on_the_side_does(joint_at, mu, nu, load):
    """Alone, its relative errors fall with the thickness; with halves of the force on either face they stay."""
    law = LinearElastic.shear(mu, nu)
    right, wrong = (errors(joint_at, law, load, edges) for edges in ("free", "plain"))
    assert right[-1].max() < 0.02
    assert np.all(right[-1] < 0.1 * wrong[-1])
    assert np.all(wrong[-1] > 0.05)
    assert np.all(wrong[-1] > 0.8 * wrong[0])


@HALVES
def test_order_2_beside_other_loads():
    law, found = LinearElastic.shear(20.0, 0.3), []
    for eps in THICKNESSES:
        joint, supports = stack(eps)
        loads = {"TOP": (0.3, -1.0), "LEFT/LAYER": (0.7, -0.4), "RIGHT/LAYER": Pressure(0.5)}
        setup = Structure(joint, body=BODY, supports=supports, tractions=loads)
        meshed = solve(setup.full(ThinLayer(law, eps, at=1.0), cells_through=8))
        rows = []
        for edges in ("free", "plain"):
            limit = solve(setup.interface(ThinLayer(law, eps, order=1, edges=edges, at=1.0)))
            row = compare(meshed, limit, where=lambda x: abs(x[0] - 0.5) < 0.25)
            work = limit.energies()["loads"] / meshed.energies()["loads"] - 1
            rows.append([row["error_traction"], row["error_jump"], abs(work)])
        found.append(rows)
    right, wrong = np.array(found).swapaxes(0, 1)
    assert min(observed_orders(THICKNESSES, right[:, k])[-1] for k in range(2)) > 1.9
    assert max(observed_orders(THICKNESSES, wrong[:, k])[-1] for k in range(2)) < 1.3


@pytest.mark.parametrize("nu", [0.25, 0.45])
def test_how_far_an_end_is_drawn_in(nu):
    """Found on a meshed layer between stiff blocks that are moved apart, and along one another."""
    eps, end = 0.1, free_end(nu)
    joint = sandwich(2.0, 0.05, 0.05, h=1 / 8, h_S=1 / 16, h_ends=eps / 12, cell="quadrilateral")
    law = LinearElastic.shear(1e-9, nu)
    for component, drawn in (("y", -end.drawn_in), ("x", -end.c_T)):
        held = {"BOTTOM": 0, "TOP": {"x": 0.0, "y": 0.0} | {component: 1.0}}
        state = solve(Structure(joint, body=BODY, supports=held).full(ThinLayer(law, eps, at=1.0), cells_through=12))
        model = state.model
        side = model.ds(model.domain.values("RIGHT/LAYER"))
        moved = state.integral(state.u[0 if component == "y" else 1] * side) / eps
        assert moved == pytest.approx(drawn, rel=3e-2), component  # singular corners


# ---------------------------------------------------------------- resultants
def resultants(state):
    applied = state.applied(np.zeros(state.model.joint.dim))
    return np.append(applied.force, applied.moment)


def sheared(joint):
    """Oblique sides."""
    points = joint.points.copy()
    points[:, 0] += 0.3 * points[:, 1]
    return replace(joint, points=points)


@pytest.mark.parametrize("depth", [{}, {"depth": 0.6}])
@pytest.mark.parametrize("load", [(0.7, -0.4, 0.5), Pressure(0.8), lambda x, t: (0.2 * t, x[0] - 0.4, 0.3)[: len(x)]])
@HALVES
def test_apart_bodies_have_the_force_and_the_moment(depth, load):
    """Of a thickness that varies, too, and on oblique sides."""
    joint = sheared(sandwich(1.0, 0.3, 0.4, 0.25, structured=True, **depth))
    load = load[: joint.dim] if isinstance(load, tuple) else load
    setup = Structure(joint, body=BODY, supports={"BOTTOM": 0}, tractions={"LEFT/LAYER": load})
    layer = ThinLayer(GLUE, 0.1, order=1, profile=lambda x: 1 + 0.5 * x[-1], at=1.0)
    models = (build(layer, bodies="extended") for build in (setup.full, setup.interface))
    meshed, limit = (resultants(solve(model)) for model in models)
    kept = slice(joint.dim if callable(load) else None)  # the moment of what varies over the height is of order eps^3
    assert limit[kept] == pytest.approx(meshed[kept], rel=1e-9, abs=1e-12)


@HALVES
def test_bodies_of_revolution_and_bases():
    """The ring of a layer's side; half of the force goes to the base by itself, and the base has all of it."""
    load, layer = (0.7, -0.4), ThinLayer(GLUE, 0.1, order=1, at=1.0)
    joint = block(1.0, 0.5, 0.25).moved((0.5, 0.0))
    for bodies in ("kept", "extended"):
        setup = Structure(joint, body=BODY, supports={}, plane="axisymmetric", tractions={"RIGHT/LAYER": load})
        state = solve(setup.interface(layer, bodies=bodies))
        assert state.applied().force == pytest.approx([0.0, -0.4 * 0.1 * 2 * np.pi * 1.5], rel=1e-10)
        assert state.reaction("S").force == pytest.approx(-state.applied().force, rel=1e-8, abs=1e-10)


@pytest.mark.few(5)
@pytest.mark.parametrize("edges", ["free", "plain"])
@HALVES
def test_three_sides_of_a_box(edges):
    """The strips overlap at corners of S, and every side has its force."""
    meshed = solve(
        Structure(box(), body=BODY, supports={"BOTTOM": 0}, tractions=SIDES).full(ThinLayer(GLUE, EPS, at=1.0))
    )
    state = loaded(edges)
    assert state.applied().force == pytest.approx(meshed.applied().force, rel=1e-3)  # what varies along an edge
    assert state.reaction("BOTTOM").force == pytest.approx(-meshed.applied().force, rel=1e-3)


def test_a_plate_in_plane_strain_is_its_section():
    held, found = {"BACK": {"z": 0.0}, "FRONT": {"z": 0.0}}, []
    for depth, more, load in ({}, {}, (0.3, -1.0)), ({"depth": 0.1}, held, (0.3, -1.0, 0.0)):
        cell = "hexahedron" if depth else "quadrilateral"  # a grid of the same displacements
        joint = sandwich(1.0, 0.3, 0.3, 0.1, cell=cell, structured=True, **depth)
        setup = Structure(joint, body=BODY, supports={"BOTTOM": 0} | more, tractions={"RIGHT/LAYER": load})
        state = solve(setup.interface(ThinLayer(GLUE, 0.1, order=1, edges="free", at=1.0)))
        top = state.model.ds(state.model.domain.values("TOP"))
        found.append([state.integral(state.u[k] * top) / depth.get("depth", 1.0) for k in range(2)])
    assert found[1] == pytest.approx(found[0], rel=1e-10)


def test_how_far_from_its_end_a_load_along_it_reaches_the_faces():
    """0.271 thicknesses, as tractions of a half strip are 4/(k pi) exp(-k pi d), k odd; here that is half a cell."""
    k = np.pi * (2 * np.arange(10**5) + 1)
    mean = (4 / k**3).sum() / 0.5
    joint = sandwich(2.0, 0.3, 0.3, 0.2, depth=0.2, cell="hexahedron", structured=True)
    held = {"BOTTOM": 0, "FRONT": {"x": 0, "y": 0}, "BACK": {"x": 0, "y": 0}}
    setup = Structure(joint, body=BODY, supports=held, tractions={"RIGHT/LAYER": (0.0, 0.0, 0.7)})
    model = setup.interface(ThinLayer(GLUE, 0.1 / mean, order=1, edges="free", at=1.0))
    f = nodal_forces(model.V, model.external_work(ufl.TestFunction(model.V), 0.0)).x.array.reshape(-1, 3)
    x = model.V.tabulate_dof_coordinates()
    assert f.sum(axis=0) == pytest.approx([0, 0, 0.7 * 0.2 * 0.1 / mean], rel=1e-9, abs=1e-12)
    assert (2 - x[:, 0]) @ f[:, 2] / f[:, 2].sum() == pytest.approx(0.1, rel=1e-5)


@HALVES
def test_a_curved_rim():
    cylinders = disc(1.0, lower=0.3, upper=0.3, h=0.4)
    for load in (Pressure(0.7), lambda x, t: (0.2, 0.0, 0.7 + 0.7 * x[0])):  # with a moment about y
        setup = Structure(cylinders, body=BODY, supports={"BOTTOM": 0}, tractions={"SIDE/LAYER": load})
        layer = ThinLayer(Anisotropic(GLUE.stiffness((0, 0, 1))), 0.1, order=1, at=1.0)
        meshed, limit = solve(setup.full(ThinLayer(GLUE, 0.1, at=1.0))), solve(setup.interface(layer))
        assert resultants(limit) == pytest.approx(resultants(meshed), rel=1e-9, abs=1e-12)


@HALVES
def test_held_sides_and_zeros():
    """A side that a support holds is no free end; zero is no load; at order 0 these loads vanish."""
    joint = sandwich(1.0, 0.3, 0.4, 0.25)
    held = {"BOTTOM": 0, "LEFT": {"x": 0}}

    def force(load, **layer):
        setup = Structure(joint, body=BODY, supports=held, tractions={"LEFT/LAYER": load})
        return solve(setup.interface(ThinLayer(GLUE, 0.1, at=1.0, **layer))).applied().force

    assert force((0.0, 0.5), order=1, edges="free") == pytest.approx([0.0, 0.05])
    assert force((0.0, 0.0), order=1, edges="free") == pytest.approx([0.0, 0.0])
    assert force((0.0, 0.5)) == pytest.approx([0.0, 0.0])


def test_halves_are_told():
    setup = Structure(
        sandwich(1.0, 0.3, 0.4, 0.25), body=BODY, supports={"BOTTOM": 0}, tractions={"LEFT/LAYER": (1.0, 0)}
    )
    with pytest.warns(RangeWarning, match=r"'LEFT/LAYER': each face of the layer gets half"):
        setup.interface(ThinLayer(GLUE, 0.1, order=1, edges="plain", at=1.0))


def test_other_loads_of_the_same_model():
    setup = Structure(
        sandwich(1.0, 0.3, 0.4, 0.25), body=BODY, supports={"BOTTOM": 0}, tractions={"LEFT/LAYER": (1.0, 0)}
    )
    model = setup.interface(ThinLayer(GLUE, 0.1, order=1, edges="free", at=1.0))
    twice = model.with_loads(tractions={"LEFT/LAYER": lambda x, t: (t, 0)})
    assert solve(twice, 2.0).energies()["loads"] == pytest.approx(4 * solve(model).energies()["loads"], rel=1e-9)
    with pytest.raises(InputError, match=r"not finite.*'LEFT/LAYER'"):
        solve(model.with_loads(tractions={"LEFT/LAYER": lambda x, t: (1 / (t - 1), 0)}), 1.0)
