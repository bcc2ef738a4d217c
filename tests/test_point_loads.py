"""Loads at points and along edges, pressures, and the weight of layers: closed forms, both models, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import ufl

from forms import LinearElastic
from forms.base import InputError
from forms.contact import HolonomicCoulomb
from geometry import block, ring, sandwich
from tests.refused import refused
from tests.supports_run import BODY, CREEP, EPS, GLUE, KINDS, model, out_of_balance
from thinlayer import (
    Gap,
    LineLoad,
    PointLoad,
    Pressure,
    Structure,
    Surface,
    ThinLayer,
    compare,
    march,
    piecewise,
    solve,
)
from thinlayer.output.nodal_forces import nodal_forces

pytestmark = pytest.mark.few(5)

HELD = {"body": BODY, "supports": {"BOTTOM": 0.0}}
ELEMENTS = {"tetrahedron": ("P1", "P2"), "hexahedron": ("Q1", "Q2", "S2")}


def nodal(made, t=0.0):
    """Nodal forces of a model's loads, (n, d), and the places of the nodes."""
    f = nodal_forces(made.V, made.external_work(ufl.TestFunction(made.V), t))
    return f.x.array.reshape(-1, made.joint.dim), made.V.tabulate_dof_coordinates()[:, : made.joint.dim]


# ---------------------------------------------------------------- points
@pytest.mark.few(1)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("element", ["P1", "P2"])
def test_a_force_at_one_node(kind, element):
    """Nothing else is loaded, whatever the element; functions have the place before inflating."""
    loads = [PointLoad((2.0, 0.6), lambda x, t: (t * x[0], x[1] + piecewise({0: 0.0, 4: 8.0})(x, t)))]
    structure = Structure(sandwich(2.0, 0.5, 0.6, 0.5), body=BODY, supports={"BOTTOM": 0}, loads=loads, element=element)
    made = model(structure, kind)
    f, x = nodal(made, 2.0)
    here = np.linalg.norm(x - x.max(axis=0), axis=1) < 1e-9
    assert here.sum() == 1
    assert f[here][0] == pytest.approx([4.0, 4.6], rel=1e-12)
    assert np.abs(f[~here]).max() < 1e-12
    assert 4.0 in made.break_times


FLAT, SOLID = sandwich(2.0, 0.5, 0.6, 0.5), sandwich(1.0, 0.5, 0.6, 0.5, depth=0.8)
REFUSED = (
    (FLAT, PointLoad((2.0, 0.0), (0.3, 0.1)), "a node there; give body=..., one of 'LOWER', 'UPPER'"),
    (FLAT, PointLoad((2.0, 0.0), (0.3, 0.1), body="UPER"), "did you mean 'UPPER'"),
    (FLAT, PointLoad((2.0, 0.6), (0.3, 0.1), body="LOWER"), "'LOWER' does not reach this place; around it: UPPER"),
    (FLAT, PointLoad((2.1, 0.6), (0.3, 0.1)), "the nearest is"),
    (FLAT, LineLoad("TOP", "LEFT", (0.3, 0.1)), "lines are edges of solids"),
    (FLAT, (2.0, 0.6), "allowed: PointLoad, LineLoad"),
    (SOLID, LineLoad("TOP", "BOTTOM", (0.0, 0.0, 1.0)), "they have no edge in common"),
    (SOLID, LineLoad("TOP", "TOP", (0.0, 0.0, 1.0)), "both have the same facets"),
    (SOLID, LineLoad("TOP", "RIHGT", (0.0, 0.0, 1.0)), "did you mean 'RIGHT'"),
)


def test_loads_at_places_that_are_none():
    for joint, load, words in REFUSED:
        refused(InputError, words, lambda at=joint, load=load: Structure(at, **HELD, loads=[load]).bonded())
    heavy = Structure(FLAT, body_force={"S": (0.0, -3.0)}, **HELD | {"element": "P1"})
    for layer in (HolonomicCoulomb(5.0, 2.0, 0.3), {"S": Gap(0.1)}):
        refused(InputError, "body force in the layer 'S': it has no layer with a thickness", heavy.interface, layer)
    refused(InputError, "did you mean 'UPPER'", lambda: Structure(FLAT, body_force={"UPER": (0, 0)}, **HELD).bonded())


@pytest.mark.parametrize("kind", ["full", "interface"])
def test_a_node_of_one_body(kind):
    """S has a node of each body: the load says whose, and that body's moves."""
    for body, sense in (("UPPER", 1), ("LOWER", -1)):
        state = solve(model(Structure(FLAT, **HELD, loads=[PointLoad((2.0, 0.0), (0.3, 0.1), body=body)]), kind))
        assert out_of_balance(state) < 1e-10
        resultant = state.applied(about=(0.0, 0.0))
        height = sense * EPS / 2 if kind == "full" else 0.0
        assert resultant.force == pytest.approx([0.3, 0.1], rel=1e-12)
        assert resultant.moment == pytest.approx(2 * 0.1 - height * 0.3, rel=1e-12)
        assert sense * (state.energies()["layer"] - 0.002) > 0  # the layer carries what loads the upper body


# ---------------------------------------------------------------- lines
@pytest.mark.parametrize(("cell", "element"), [(cell, element) for cell, of in ELEMENTS.items() for element in of])
def test_a_line_load_is_integrated_exactly(cell, element):
    """Force and moments of a cubic load along an edge; its nodes alone are loaded, as its trace says."""
    joint = sandwich(1.0, 0.5, 0.6, 0.5, depth=0.8, cell=cell)
    far, near = joint.points[:, 2].max(), joint.points[:, 2].min()
    cubic, even = lambda x, t: (t * x[2] ** 3, -2.0, x[2]), (0.0, 0.5, 0.0)
    loads = [LineLoad("TOP", "RIGHT", cubic), LineLoad("TOP", "LEFT", even)]
    made = model(Structure(joint, loads=loads, element=element, **HELD), "interface")
    state = solve(made, t=3.0)
    total = state.applied(about=(0.0, 0.0, 0.0))
    z = {k: (far**k - near**k) / k for k in (1, 2, 3, 4, 5)}
    assert total.force == pytest.approx([3 * z[4], -1.5 * z[1], z[2]], rel=1e-10, abs=1e-12)
    expected = [0.6 * z[2] + 2 * z[2] - 0.5 * z[2], 3 * z[5] - z[2], -2 * z[1] - 0.6 * 3 * z[4]]
    assert total.moment == pytest.approx(expected, rel=1e-10, abs=1e-12)
    assert out_of_balance(state) < 1e-10
    if element != "S2":
        f, x = nodal(made, 3.0)
        off = (np.abs(x[:, 1] - 0.6) > 1e-9) | ((np.abs(x[:, 0] - 1.0) > 1e-9) & (np.abs(x[:, 0]) > 1e-9))
        assert np.abs(f[off]).max() < 1e-12
    if element == "Q2":  # Simpson's rule, of a constant load: 1, 4, 2, 4, 1 sixths of that of a cell
        on_line = ~off & (np.abs(x[:, 0]) < 1e-9)
        there = f[on_line, 1][x[on_line, 2].argsort()]
        count = len(there) // 2
        assert there * 6 * count / (0.5 * z[1]) == pytest.approx([1, *[4, 2] * (count - 1), 4, 1], rel=1e-9)


def test_lines_on_curved_edges():
    """The length of an arc, by curved cells: order 4 and more of the cell's angle."""
    joint = ring(1.0, 1.5, 2.0, h=0.5, degree=2, depth=1.0)
    ends = [name for name in joint.facets if name not in ("INSIDE", "OUTSIDE", "S")]
    loads = [LineLoad("OUTSIDE", ends[0], (0.0, 0.0, 1.0))]
    force = solve(Structure(joint, body=BODY, supports={ends[1]: 0.0}, loads=loads).bonded()).applied().force
    assert force[2] == pytest.approx(4 * np.pi, rel=1e-4)
    assert np.abs(force[:2]).max() < 1e-10


def test_a_line_around_a_face_has_no_chords():
    """A cell that has a corner of the face may have an edge across it, whose ends are on both sets."""
    joint = sandwich(1.0, 0.5, 0.6, 0.5, depth=0.8, structured=True)
    sides = np.concatenate([joint.facets[name] for name in ("LEFT", "RIGHT", "FRONT", "BACK")])
    joint = replace(joint, facets=joint.facets | {"SIDES": sides})
    load = [LineLoad("TOP", "SIDES", (0.0, 0.0, 1.0))]
    f, _ = nodal(Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, loads=load, element="P1").bonded())
    assert f.sum(axis=0) == pytest.approx([0, 0, 2 * (1.0 + 0.8)], rel=1e-12)


# ---------------------------------------------------------------- pressures
BUILT = [("full", "kept"), ("full", "extended"), ("interface", ""), ("bonded", "")]


@pytest.mark.few(1)
@pytest.mark.parametrize(("kind", "bodies"), BUILT)
def test_a_pressure_all_around_is_hydrostatic(kind, bodies):
    """On all sides, that of the layer too: no resultant, and the stress is -p everywhere in bodies without supports."""
    joint = sandwich(2.0, 0.5, 0.6, 0.5)
    around = {name: Pressure(0.7) for name in ("LEFT", "RIGHT", "BOTTOM", "TOP")}
    if bodies == "kept":
        around |= {"LEFT/LAYER": Pressure(0.7), "RIGHT/LAYER": Pressure(0.7)}
    structure = Structure(joint, body=BODY, supports={(0.0, -0.5): 0.0, (2.0, -0.5): {"y": 0.0}}, tractions=around)
    law = LinearElastic(3.0, 2.0)
    made = structure.full(ThinLayer(law, EPS, at=1.0), bodies=bodies) if kind == "full" else model(structure, kind, law)
    state = solve(made)
    assert np.abs(state.applied().force).max() < 1e-12
    assert state.applied().moment == pytest.approx(0.0, abs=1e-12)
    assert max(np.abs(reaction.force).max() for reaction in state.reactions_by_place().values()) < 1e-10


def test_pressures_in_time_and_refused():
    joint = ring(1.0, 1.5, 2.0, h=0.5, degree=2)
    bush = lambda **data: Structure(joint, body=BODY, supports={"OUTSIDE": 0.0}, **data).bonded()
    state = solve(bush(tractions={"INSIDE": Pressure(lambda x, t: t * (1 + x[0]))}), t=2.0)
    assert state.applied().force == pytest.approx([2 * np.pi, 0.0], rel=1e-3, abs=1e-9)  # from x to the outside
    assert out_of_balance(state) < 1e-9
    for p in (float("nan"), "high", lambda x, t: x):
        refused(InputError, "'INSIDE'.*finite number", lambda p=p: bush(tractions={"INSIDE": Pressure(p)}))
    refused(InputError, "no normal inside a body", lambda: bush(body_force={"INNER": Pressure(1.0)}))


# ---------------------------------------------------------------- the weight of layers
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("profile", [None, lambda x: 1 + x[0] / 4])
def test_the_weight_of_a_layer(dim, profile):
    """The same total in both models; on S each body has half of it."""
    weight = {"S": (0.0, -3.0, 0.5)[:dim]}
    joint = sandwich(2.0, 0.5, 0.6, 0.5, **{2: {}, 3: {"depth": 1.0}}[dim])
    bodies = "kept" if profile is None else "extended"
    structure = Structure(joint, body=BODY, supports={"BOTTOM": 0.0}, body_force=weight, element="P1")
    layer = ThinLayer(GLUE, EPS, profile=profile, at=1.0)
    expected = -3.0 * EPS * 2.0 * (1 if profile is None else 1.25)
    for made in (structure.full(layer, bodies=bodies), structure.interface(layer)):
        state = solve(made)
        assert state.applied().force[1] == pytest.approx(expected, rel=1e-10)
        assert state.reaction("BOTTOM").force[1] == pytest.approx(-expected, rel=1e-9)
    f, x = nodal(made)
    assert (np.isclose(x[:, 1], 0.0) & (np.abs(f[:, 1]) > 0)).any()
    assert solve(structure.bonded()).applied().force[1] == 0.0


@pytest.mark.parametrize("eps", [0.2, 0.05])
def test_columns_with_heavy_layers(eps):
    """Half on each side is exact in columns, for every thickness; left out it changes the jump by order eps."""
    joint, sides = sandwich(2.0, 0.5, 0.6, 0.5), {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}, "BOTTOM": {"y": 0.0}}
    data = {"body": BODY, "supports": sides, "tractions": {"TOP": (0.0, -0.3)}}
    heavy, layer = Structure(joint, body_force={"S": (0.0, -3.0)}, **data), ThinLayer(GLUE, eps, at=1.0)
    models = heavy.full(layer), heavy.interface(layer), Structure(joint, **data).interface(layer)
    full, limit, light = map(solve, models)
    row = compare(full, limit)
    assert max(row["error_jump"], row["error_traction"]) < 1e-9
    surface = Surface(limit.model)
    jump, weightless = (surface.integral(surface.jump(state)[1]) for state in (limit, light))
    assert jump / weightless == pytest.approx(1 + 3.0 * eps / 2 / 0.3, rel=1e-9)


@pytest.mark.parametrize("plane", ["strain", "axisymmetric"])
def test_the_weight_on_a_rigid_base(plane):
    """Half of it goes to the base directly: the loads and the reaction of the base are those of the meshed layer."""
    g = lambda x, t: (0.0, -3.0 * t * (1 + x[0]))
    supports = {"LEFT": {"x": 0.0}} if plane == "strain" else {}
    data = dict(body=BODY, supports=supports, body_force={"S": g, "BODY": (0.0, -1.0)}, plane=plane)
    structure = Structure(block(2.0, 0.6, 0.5), **data)
    area, moment = {"strain": (2.0, 4.0), "axisymmetric": (4 * np.pi, 4 * np.pi + 16 * np.pi / 3)}[plane]
    weight, body_weight = 3.0 * 0.4 * EPS * moment, 0.6 * area
    for made in (structure.interface, structure.full):
        state = march(made(ThinLayer(CREEP, EPS, at=1.0)), [0.2, 0.4], theta=0.5).last
        assert state.applied().force[1] == pytest.approx(-body_weight - weight, rel=1e-9)
        assert state.reaction("S").force[1] == pytest.approx(body_weight + weight, rel=1e-9)
        assert out_of_balance(state) < 1e-9
        if plane == "strain":  # 3 t eps int x (1 + x), and the middle of the body
            there = state.applied(about=(0.0, 0.0)).moment
            assert there == pytest.approx(-body_weight - 3.0 * 0.4 * EPS * (2 + 8 / 3), rel=1e-9)


@pytest.mark.parametrize(("place", "weighed"), [((2.0, 0.6), ("LOWER",)), ((2.0, -0.5), ("LOWER", "UPPER"))])
def test_a_load_at_a_point_beside_weights(place, weighed):
    """Integrals over some cells with unlike rules: each load is there once, in reactions and in `applied`."""
    plates = sandwich(width=2.0, lower=0.5, upper=0.6, h=0.3)
    weights, heights = {"LOWER": (0.04, -0.3), "UPPER": (0.01, -0.2)}, {"LOWER": (-0.5, 0.0), "UPPER": (0.0, 0.6)}
    force = (0.03, -0.4)
    loads = {"body_force": {name: weights[name] for name in weighed}, "loads": [PointLoad(place, force)]}
    structure = Structure(plates, body=LinearElastic.young(E=90.0, nu=0.3), supports={"BOTTOM": 0}, **loads)
    state = solve(structure.interface(ThinLayer(LinearElastic(60.0, 40.0), 0.01, at=1.0)))
    total, moment = np.array(force), place[0] * force[1] - place[1] * force[0]
    for name in weighed:
        low, high = heights[name]
        weight = 2.0 * (high - low) * np.array(weights[name])
        total, moment = total + weight, moment + weight[1] - (low + high) / 2 * weight[0]
    resultant, reaction = state.applied(about=(0, 0)), state.reaction("BOTTOM", about=(0, 0))
    np.testing.assert_allclose([*resultant.force, resultant.moment], [*total, moment], rtol=1e-12)
    np.testing.assert_allclose([*reaction.force, reaction.moment], [*-total, -moment], rtol=1e-10)
    above = np.array([0.0, 0.0]) if place[1] < 0 else np.array(force)
    above = above + (2.0 * 0.6 * np.array(weights["UPPER"]) if "UPPER" in weighed else 0.0)
    surface = Surface(state.model)
    assert surface.integral(surface.traction(state)) == pytest.approx(above, rel=1e-9, abs=1e-12)
