"""Free ends of a layer in its interface law of order 1: energy, weights, orders of the errors, what is refused."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import ufl

from forms import LinearElastic, Rubber
from forms.ends import free_end
from forms.ends.weights import EndWeights
from forms.kinematics import Kinematics
from forms.law import Step
from forms.stations import Faces
from geometry import faults, sandwich
from geometry.sheet import Sheet, straight_ends
from studies import free_ends
from studies.problems import free_blocks
from tests.orders import observed_orders
from thinlayer import RigidPlate, Springs, Structure, Surface, ThinLayer, compare, estimate, solve
from thinlayer.discretisation import applicability
from thinlayer.discretisation.applicability import MIN_STIFFNESS_CONTRAST
from thinlayer.discretisation.layer import FacetWeights, SeamLayer
from thinlayer.running.record import Record

pytestmark = pytest.mark.few(5)

BODY = LinearElastic.young(E=100.0, nu=0.3)
EPS = (1 / 16, 1 / 32)


# ---------------------------------------------------------------- the energy
def vectors(dim: int) -> tuple[np.ndarray, np.ndarray]:
    """A unit normal n of S, and one m in S."""
    turn, _ = np.linalg.qr(np.random.default_rng(dim).normal(size=(dim, dim)))
    return turn[:, 0], turn[:, 1]


def written(law, eps, n, m, jump, gradient, a_N, a_T, f_N, f_T):
    """Energy per volume at two faces with the jump [u] and the same gradient of the mean displacements, by components."""
    dim, M = len(n), law.lmbda + 2 * law.mu
    along = np.eye(dim) - np.outer(n, n)
    in_s = gradient @ along
    e_S = along @ (in_s + in_s.T) @ along / 2
    tr, e_N, g, h = np.trace(e_S), jump @ n / eps, along @ jump / eps, in_s.T @ n
    rest = g + h - ((g + h) @ m) * m
    normal = M * (1 - a_N) * e_N**2 + 2 * law.lmbda * f_N * e_N * tr
    normal += (law.lmbda * tr**2 + 2 * law.mu * np.sum(e_S**2)) / (1 - a_N)
    shear = (1 - a_T) * (g @ m) ** 2 + 2 * f_T * (g @ m) * (h @ m) + (h @ m) ** 2 / (1 - a_T)
    return (normal + law.mu * (shear + rest @ rest)) / 2


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("nu", [0.0, 0.2, 0.45])
def test_the_stations_have_the_energy_of_an_end(dim, nu):
    law, eps, (n, m) = LinearElastic.shear(0.7, nu), 0.3, vectors(dim)
    rng = np.random.default_rng(7)
    jump, gradient, change = rng.normal(size=dim), rng.normal(size=(dim, dim)), rng.normal(size=(dim, dim))
    values = 0.31, 0.22, 0.4, 0.8
    kinematics, n_ufl = Kinematics(), ufl.as_vector(n.tolist())
    along = np.eye(dim) - np.outer(n, n)
    mean = kinematics.strain_along(ufl.as_matrix((gradient @ along).tolist()), ufl.as_vector(jump.tolist()))
    jumps, slopes = ufl.as_vector(jump.tolist()), ufl.as_matrix((change @ along).tolist())
    faces = Faces(n_ufl, eps, jumps, slopes, mean, kinematics.strain_across, kinematics.strain_along)
    weights = EndWeights(ufl.as_vector(m.tolist()), *map(ufl.as_ufl, values), ufl.as_ufl(1.0))

    def energy(stations):
        return sum(float((s.station_weight * s.law.energy(Step(s.strain(s.law, faces), n_ufl)))(())) for s in stations)

    at_end, plain = energy(law.stations_at_ends(weights)), energy(law.stations())
    infinite = written(law, eps, n, m, jump, gradient, 0, 0, 1, 1)
    assert at_end - plain == pytest.approx(written(law, eps, n, m, jump, gradient, *values) - infinite, rel=1e-10)
    none = EndWeights(ufl.as_vector(m.tolist()), *map(ufl.as_ufl, (0.0, 0.0, 1.0, 1.0, 1.0)))
    assert energy(law.stations_at_ends(none)) == pytest.approx(plain, rel=1e-12)
    # with a pressure: the part of shear, which has none, and the flow
    law = Rubber(3.0, 0.7)
    stations, infinite = law.stations_at_ends(weights._replace(flow_factor=ufl.as_ufl(0.6))), law.stations()
    only_shear = written(LinearElastic(0.0, 0.7), eps, n, m, jump, gradient, 0, 0.22, 1, 0.8)
    neither = written(LinearElastic(0.0, 0.7), eps, n, m, jump, gradient, 0, 0, 1, 1)
    assert energy(stations) - energy(infinite) == pytest.approx(only_shear - neither, rel=1e-10)
    pressed, *others = stations
    assert float(pressed.mobility(law)(())) == pytest.approx(0.6 / (12 * 0.7), rel=1e-12)
    volumes = [float(ufl.tr(s.strain(s.law, faces))(())) for s in (pressed, infinite[0])]
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-12)
    assert not any(s.law.traits.constrained or s.mobility(s.law) for s in others)


# ---------------------------------------------------------------- the weights
def weights_on(joint, eps, ends=None):
    sheet = Sheet(joint)
    ends = straight_ends(sheet.rim, sheet) if ends is None else ends
    area = sheet.facet_integrals(1.0)
    return FacetWeights.of_ends(ends, sheet, eps, free_end(0.3)), area, ends


@pytest.mark.parametrize("cell", ["triangle", "tetrahedron", "hexahedron"])
def test_weights_have_the_deficit_of_the_end(cell):
    """The integral of a is c eps per length of the end, whatever the cells; in 3D also of two ends that face each other."""
    depth = {} if cell == "triangle" else {"depth": 0.7, "cell": cell}
    joint, eps = sandwich(1.1, 0.2, 0.2, 0.17, **depth).rotated(0.2), 0.06
    _, _, ends = weights_on(joint, eps)
    assert len(ends) == (2 if cell == "triangle" else 4)
    c, s = math.cos(0.2), math.sin(0.2)
    opposite = [end for end in ends if abs(abs(end.m[:2] @ [c, s]) - 1) < 1e-9]
    weights, area, _ = weights_on(joint, eps, opposite)
    length, constants = 2 * depth.get("depth", 1.0), free_end(0.3)
    assert weights.a_N @ area == pytest.approx(constants.c_N * eps * length, rel=1e-12)
    assert weights.a_T @ area == pytest.approx(constants.c_T * eps * length, rel=1e-12)
    assert weights.flow_resistance @ area == pytest.approx((1 / constants.kappa - 1) * eps * length, rel=1e-12)
    assert np.linalg.norm(weights.m, axis=1) == pytest.approx(1.0)


# ---------------------------------------------------------------- errors
def errors(case, thicknesses, folder):
    """Errors of traction and jump on the inner half of S and of the compliance, of the law with and without correction."""
    with Record("free_ends", folder, {}) as record:
        rows = [free_ends._error_row(record, case, 12, eps) for eps in thicknesses]
    names = ([free_ends._column_name(what, kind) for what in free_ends.QUANTITIES] for kind in free_ends.EDGE_OPTIONS)
    return [np.array([[row[name] for name in columns] for row in rows]) for columns in names]


EQUAL, STIFF, UNEQUAL, BASED = free_ends.CASES
CONVERGING = [
    (STIFF, 1.9),
    (replace(EQUAL, law=LinearElastic.shear(40.0, 0.0)), 2.3),
    (replace(UNEQUAL, law=LinearElastic.shear(8.0, 0.3)), 2.0),
    (BASED, 1.9),
]


@pytest.mark.parametrize(("case", "low"), CONVERGING)
def test_order_2_away_from_free_ends(case, low, tmp_path):
    right, wrong = errors(case, EPS, tmp_path)
    assert min(observed_orders(EPS, right[:, k])[-1] for k in range(3)) > low
    assert np.all(right[-1] < 0.2 * wrong[-1])
    assert max(observed_orders(EPS, wrong[:, k])[-1] for k in range(3)) < 1.3


def at_middle(state):
    """Traction and jump, weighted by a bump on the inner half of S and by its moment about the middle; the compliance."""
    surface = Surface(state.model)
    x = surface.x[0] - 0.5
    bump = np.where(abs(x) < 0.25, np.cos(2 * np.pi * x) ** 4, 0.0)
    fields = surface.traction(state), surface.jump(state)
    moments = ([surface.integral(w * bump * c) for w in (1.0, x) for c in field] for field in fields)
    return [*map(np.array, moments), np.array(state.energies()["loads"])]


def test_cells_of_s_twice_as_long_as_the_layer_is_thick():
    """Constants are more exact than the layer's own cells there: of a full model, and of an estimate's better state."""
    eps = 1 / 64
    layer, coarse = ThinLayer(LinearElastic.shear(8.0, 0.3), eps, at=1.0), free_blocks(2 * eps, h_S=2 * eps)
    exact = at_middle(solve(free_blocks(eps / 40, h_S=eps).full(layer, cells_through=32)))
    states = {
        "free": solve(coarse.interface(replace(layer, order=1))),
        "better": estimate(solve(coarse.interface(layer))).better,
        "meshed": solve(coarse.full(layer, cells_through=8)),
    }
    norm = np.linalg.norm
    error = {k: [norm(a - b) / norm(b) for a, b in zip(at_middle(s), exact, strict=True)] for k, s in states.items()}
    assert np.all(error["free"] < [2e-5, 6e-5, 1.2e-4])  # better: 6e-4, 1.4e-3, 7e-4
    assert min(np.divide(error[k], error["free"]).min() for k in ("better", "meshed")) > 6


# ---------------------------------------------------------------- what is refused


def test_ends_are_corrected_where_they_may_be(caplog):
    plates = Structure(sandwich(1.0, 0.3, 0.3, 0.3), body=BODY, supports={"BOTTOM": 0}, tractions={"TOP": (0.3, -1)})
    layer = ThinLayer(LinearElastic.shear(1.0, 0.3), 0.1, order=1, at=1.0)
    with caplog.at_level(logging.INFO, logger="thinlayer.solve"):
        work = lambda edges: solve(plates.interface(replace(layer, edges=edges))).energies()["loads"]
        works = {edges: work(edges) for edges in (None, "free", "plain")}
    assert works[None] == works["free"] > 1.01 * works["plain"]
    said = [line.partition(": ")[2] for line in caplog.messages if line.startswith("free ends of the layer: ")]
    assert said == ["corrected", "corrected", "not corrected, as edges='plain' was asked for"]
    models = {edges: plates.interface(replace(layer, edges=edges)) for edges in works}
    assert models[None].identity() == models["free"].identity() != models["plain"].identity()
    assert models[None].with_layer(replace(layer, edges="plain")).free_ends("S").key == "plain"


# ---------------------------------------------------------------- what holds the side of a layer


def kinds(joint, supports, parts=(), **data):
    """What the layer's side is at the ridges of the rim, the one with the least x first."""
    all_supports = {"BOTTOM": 0.0} | supports
    layer = ThinLayer(LinearElastic.young(1.0, 0.35), 0.1)
    seam_layer = SeamLayer("S", layer, Structure(joint, body=BODY, supports=all_supports, parts=parts, **data))
    return seam_layer.side_kinds[joint.points[seam_layer.sheet.rim.vertices].mean(axis=1)[:, 0].argsort()].tolist()


def test_supports_of_the_side_of_a_layer():
    for tilt, supports, expected in [
        (0.0, {"LEFT": {"x": 0.0}}, "symmetric"),
        (0.0, {"LEFT": {"y": 0.0}}, "antisymmetric"),
        (0.0, {"LEFT": {"y": 0.0}, "LEFT/LAYER": {"x": 0.0}}, "held"),
        (0.5, {"LEFT": {"n": 0.0}}, "symmetric"),
        (0.0, {"LEFT/LOWER": 0.0}, "free"),
        (0.5, {"LEFT": {"x": 0.0}}, "oblique"),
        (0.02, {"LEFT": {"x": 0.0}}, "symmetric"),
        (0.0, {(0.0, 0.0): 0.0}, "free"),
    ]:
        assert kinds(sandwich(1.0, 0.5, 0.4, 0.25).rotated(tilt), supports) == [expected, "free"]


def test_what_else_holds_the_side_of_a_layer():
    """Plates do, springs do not, of a box in 3D what lies along the end does not matter."""
    joint = sandwich(1.0, 0.5, 0.4, 0.25)
    parts = [RigidPlate("LEFT", motion={"x": 0.0, "y": 0.0, "rotation": 0.0}), Springs("RIGHT", normal=1e9)]
    assert kinds(joint, {}, parts) == ["held", "free"]
    box = sandwich(1.0, 0.5, 0.4, 0.5, depth=0.5)
    assert set(kinds(box, {"LEFT": {"z": 0.0}})) == {"free"}
    assert sorted(set(kinds(box, {"LEFT": {"z": 0.0, "y": 0.0}}))) == ["antisymmetric", "free"]
    assert kinds(joint, {"RIGHT": {"y": 0.0}}, plane="axisymmetric") == ["held", "antisymmetric"]
    scarf = faults(1.0, 1.0, {"S": [(0.0, 0.3), (1.0, 0.7)]}, 0.25)  # the layer's side is square to S, others are not
    assert kinds(scarf, {"LEFT": {"n": 0.0}}) == ["oblique", "free"]


def test_sides_held_across_s_are_no_free_ends():
    """Under simple shear the law is exact at any order; a law with constants of ends there is not."""
    joint, eps = sandwich(1.0, 0.5, 0.4, 0.25, h_S=1 / 12, cell="quadrilateral"), 1 / 16
    law = LinearElastic.young(1.0, 0.35).scaled(1 / eps)
    across = {"BOTTOM": 0.0, "LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}}
    sheared = Structure(joint, body=BODY, supports=across, tractions={"TOP": (0.3, 0.0)})
    full = solve(sheared.full(ThinLayer(law, eps, at=1.0)))
    for order in (0, 1):
        error = compare(full, solve(sheared.interface(ThinLayer(law, eps, order=order, at=1.0))))
        assert max(error["error_traction"], error["error_jump"]) < 1e-9  # rounding of the layer's stiffness
    result = estimate(solve(sheared.interface(ThinLayer(law, eps, at=1.0))))
    assert max(result.traction, result.jump) < 1e-9


def test_rubber_between_plates_is_held():
    """A mould: pressed rubber that cannot leave it, as by supports; flowing out it would give way 1.5 times as far."""
    joint, eps = sandwich(1.0, 0.5, 0.5, 0.25, h_S=1 / 12, h_ends=0.02, cell="quadrilateral"), 1 / 16
    stiff = LinearElastic.young(1e5, 0.3)
    base = [Springs("BOTTOM", normal=1e7, tangential=1e7)]
    fixed = {"x": 0.0, "rotation": 0.0}
    mould = [*base, RigidPlate("LEFT", motion=fixed), RigidPlate("RIGHT", motion=fixed)]
    structure = Structure(joint, body=stiff, tractions={"TOP": (0.0, -1.0)}, supports={}, parts=mould)
    layer = ThinLayer(Rubber.shear(mu=0.4, nu=0.499), eps, order=1, at=1.0)
    full, limit = solve(structure.full(layer)), solve(structure.interface(layer))
    assert limit.load_work() == pytest.approx(full.load_work(), rel=1e-3)  # 1.5 times as much with p = 0 there


@pytest.mark.long
def test_the_least_stiffness_of_bodies_that_lets_ends_be_corrected(monkeypatch, tmp_path):
    """Above it no error grows by the correction, below it some double: of traction, jump and work."""
    monkeypatch.setattr(applicability, "MIN_STIFFNESS_CONTRAST", 0.0)
    allowed, refused = [], []
    # E of bodies over mu
    for nu, contrast in product((0.0, 0.45), (10.0, 20.0, MIN_STIFFNESS_CONTRAST, 80.0, 400.0)):
        case = replace(EQUAL, law=LinearElastic.shear(100.0 / contrast, nu).scaled(1 / EPS[0]))
        factor = np.divide(*errors(case, EPS[:1], tmp_path)).max()
        (allowed if contrast >= MIN_STIFFNESS_CONTRAST else refused).append(factor)
    assert max(allowed) <= 1
    assert max(refused) >= 2
