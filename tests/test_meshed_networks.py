"""Meshed networks of layers in 2D: areas and names, junctions, convergence to the interface model, what is refused."""

from dataclasses import replace

import numpy as np
import pytest
import ufl

from forms import Anisotropic, Incompressible, LinearElastic, Stack
from forms.base import InputError
from geometry import wall
from geometry.inflating.inflation import inflate
from geometry.joint import Joint
from geometry.seam import Seam
from geometry.topology import node_jacobians
from tests.meshed_cases import SHARES, jump_errors, mortar, panel, star
from tests.meshes import check_sound, grid, part_of, parted, volumes
from tests.network_cases import springs
from tests.refused import refused
from tests.test_networks import SQUARE, cut_at, on
from thinlayer import Gap, RangeWarning, Structure, Surface, ThinLayer, compare, solve

pytestmark = pytest.mark.few(5)

RATIOS = (1e-1, 1e-2, 1e-3, 1e-4)
BRICK = (1.0, 0.5)
CELLS = ("triangle", "quadrilateral")
WAYS = ("kept", "extended")


def lengths(joint: Joint) -> dict[str, float]:
    """Length of each seam."""
    length = lambda facets: float(np.linalg.norm(np.ptp(joint.points[facets], axis=1), axis=1).sum())
    return {name: length(joint.facets[name]) for name in joint.seams}


def areas(opened: Joint) -> dict[str, float]:
    """Area of each region of the layers."""
    cell_areas, numbers = volumes(opened), opened.region
    return {name: float(cell_areas[numbers == opened.regions.index(name)].sum()) for name in opened.band.regions}


def check(base: Joint, opened: Joint, least: float = 0.1) -> None:
    """No cell is folded, all outer facets have a name, each once, and body cells keep their numbers and their order."""
    check_sound(opened, opened.facets.keys() - set(opened.band.faces), base)
    n, size = len(base.cells), np.abs(node_jacobians(opened.points, opened.cells, opened.cell_type))
    assert (size[n:].min(axis=1) / size[n:].max(axis=1)).min() > least
    assert opened.reference[opened.cells[:n]] == pytest.approx(base.points[base.cells], abs=0)
    for name in opened.band.faces:
        assert (opened.table.cells[opened.table.index(opened.facets[name]), 1] >= 0).all()


# ---------------------------------------------------------------- geometry
@pytest.mark.parametrize(("cell", "bodies"), zip(CELLS, WAYS, strict=True))
def test_running_bond(cell, bodies):
    """The areas of the layers, less or more a triangle at each T, are exact; extended bodies keep the whole.

    Kept, the bricks of a course move one head apart, and the beds lean by half of it.
    """
    base = wall(2, 3, BRICK, 0.125, cell=cell)
    length, counts = lengths(base), set()
    n_T = int((base.split_mesh.component_counts == 3).sum())
    for ratio in RATIOS:
        bed, head = ratio * 0.5, 0.7 * ratio * 0.5
        opened = inflate(base, {"BED": bed, "HEAD": head}, bodies=bodies)
        check(base, opened)
        region_areas = areas(opened)
        triangles = n_T * bed * head / 2
        sign = 1 if bodies == "kept" else -1
        assert region_areas["LAYER/JUNCTIONS"] == pytest.approx(triangles, rel=1e-9)
        mortar = bed * length["BED"] + head * length["HEAD"] + sign * triangles
        assert sum(region_areas.values()) == pytest.approx(mortar, rel=1e-10)
        whole = volumes(opened).sum()
        if bodies == "kept":
            assert whole == pytest.approx(3.0 + mortar, rel=1e-12)
            moved = (opened.points - opened.reference)[opened.cells[: len(base.cells)]].mean(axis=1)
            x, y = base.points[base.corners].mean(axis=1).T
            of_bricks = [moved[(abs(y - 0.25) < 0.25) & (x > a) & (x < a + 1)] for a in (0, 1)]
            halves, high = ((0, 0.5), (0.5, 1.5), (1.5, 2)), abs(y - 0.75) < 0.25
            of_bricks += [moved[high & (x > a) & (x < b)] for a, b in halves]
            shift = np.array([some.mean(axis=0) for some in of_bricks])
            assert shift[2:] - shift[:2].mean(axis=0) == pytest.approx(np.array([[k * head, bed] for k in (-1, 0, 1)]))
            assert shift[1] - shift[0] == pytest.approx([head, 0.0], abs=1e-12)
        else:
            assert whole == pytest.approx(3.0, abs=1e-10)
        counts.add((len(opened.points), len(opened.cells)))
    assert len(counts) == 1
    assert opened.band.regions == ("LAYER/BED", "LAYER/HEAD", "LAYER/JUNCTIONS")
    assert opened.band.faces == ("BED/UPPER_FACE", "BED/LOWER_FACE", "HEAD/UPPER_FACE", "HEAD/LOWER_FACE")
    assert len(opened.facets["LEFT/LAYER"]) == 4 * 2  # two beds end there
    assert {f"{n}/LAYER" for n in ("LEFT", "RIGHT", "BOTTOM", "TOP")} < set(opened.facets)


STARS = {
    (0, 90, 180, 270): 1.0,
    (0, 90, 180): 0.5,
    (0, 60, 180, 240): 2 / np.sqrt(3),
    (0, 72, 144, 216, 288): 5 / 8 / np.sin(np.pi / 5) ** 2 * np.sin(2 * np.pi / 5),
}


@pytest.mark.parametrize("angles", [*STARS, (0, 30, 60), (10, 95, 150, 200, 310), (0, 100, 185)])
def test_stars(angles):
    """Polygons of any number of corners, for layers of one thickness and of several."""
    base = star(angles, "triangle" if len(angles) == 4 else "quadrilateral")
    for ratio in (RATIOS[0], RATIOS[3]):
        opened = inflate(base, ratio * 0.5, bodies="extended")
        check(base, opened)
        if angles in STARS:
            assert areas(opened)["LAYER/JUNCTIONS"] == pytest.approx(STARS[angles] * (ratio * 0.5) ** 2, rel=1e-7)
        if min(np.diff(angles)) < 45 and ratio == RATIOS[0]:
            continue  # the bodies between are too thin
        thick = {name: 0.5 * ratio * (1 + 0.5 * k / len(angles)) for k, name in enumerate(base.seams)}
        for a, seam in zip(angles, base.seams, strict=True):  # layers in line have one thickness
            for b, other in zip(angles, base.seams, strict=True):
                if (a - b) % 360 == 180:
                    thick[seam] = thick[other]
        check(base, inflate(base, thick, bodies="extended"))


def test_layers_that_meet_on_the_boundary():
    """Two seams end in one point of a straight side, 90 degrees apart: the boundary closes the triangle between them."""
    joint = star((-90, -45, 45, 90), "triangle")  # the half-disc on the left is taken away
    base = part_of(joint, joint.region != 3, seams={name: joint.seams[name] for name in ("L1", "L2")})
    facets = dict(base.facets)
    facets["SIDE"] = np.concatenate([facets.pop("L0"), facets.pop("L3")])
    base = replace(base, facets=facets)
    eps = 0.01
    opened = inflate(base, eps, bodies="extended")
    check(base, opened)
    truncated = replace(base, facets=base.facets | {"SIDE": facets["SIDE"][:4]})  # of B0 alone: it ends where S begins
    assert "SIDE/LAYER" not in inflate(truncated, eps, bodies="extended").facets
    assert areas(opened)["LAYER/JUNCTIONS"] == pytest.approx(eps**2 / 2, rel=1e-9)
    x = opened.points[opened.facets["SIDE/LAYER"]]
    assert x[..., 0] == pytest.approx(0.0, abs=1e-12)
    assert np.ptp(x[..., 1]) == pytest.approx(np.sqrt(2) * eps)
    check(base, inflate(base, eps))


def test_sublayers_and_profiles_away_from_junctions():
    """Three plates with two glue lines: each seam has its own sublayers and thickness."""
    base = cut_at(SQUARE, {"LOW": (on(1, -1.0), (0, 1)), "HIGH": (on(1, 2.0), (0, 1))})
    options = {"fractions": {"HIGH": (0.25, 0.75)}, "profile": {"LOW": lambda x: 1 + x[0] / 8}, "bodies": "extended"}
    opened = inflate(base, {"LOW": 0.1, "HIGH": 0.2}, **options)
    assert areas(opened) == pytest.approx({"LAYER/LOW": 0.1 * 12, "LAYER/HIGH/1": 0.05 * 8, "LAYER/HIGH/2": 0.15 * 8})
    assert volumes(opened).sum() == pytest.approx(64.0)
    assert volumes(inflate(base, {"LOW": 0.1, "HIGH": 0.2})).sum() == pytest.approx(64.0 + 8 * 0.3)


def test_cells_of_junctions_go_to_the_first_seam():
    base = star((0, 120, 240), "triangle")
    opened = inflate(base, 0.01, bodies="extended")
    assert opened.band.junctions == {"LAYER/JUNCTIONS": "L0"}
    assert opened.band.aligned_junctions == ()
    assert np.linalg.norm(opened.band.director, axis=2) == pytest.approx(1.0)
    assert inflate(base, 0.01, bodies="extended", junctions=["L2"]).band.junctions == {"LAYER/JUNCTIONS": "L2"}
    square = grid([np.arange(9.0), np.arange(-4.0, 5.0)], lambda x: x[:, 1] > 0, "quadrilateral")
    cut = {"FLAT": (on(1, 0.0), (0, 1)), "WEST": (on(0, 2.0), (1, 0)), "EAST": (on(0, 6.0), (1, 0))}
    named = inflate(cut_at(square, cut), 0.01, junctions=["WEST", "EAST"])
    assert named.band.junctions == {"LAYER/JUNCTIONS/WEST": "WEST", "LAYER/JUNCTIONS/EAST": "EAST"}
    assert areas(named)["LAYER/JUNCTIONS/WEST"] == pytest.approx(1e-4)


@pytest.mark.few(1)
@pytest.mark.parametrize(("cell", "bodies"), zip(CELLS, WAYS, strict=True))
def test_open_joints_are_gaps(cell, bodies):
    """Beds go on below and above open heads; heads end at open beds, where bricks would touch a fill at a corner only."""
    base = wall(2, 3, BRICK, 0.125, cell=cell)
    eps, length, free = {"BED": 0.02, "HEAD": 0.01}, lengths(base), {}
    n_T = int((base.split_mesh.component_counts == 3).sum())
    for gap in eps:
        opened = inflate(base, eps, bodies=bodies, gaps=[gap])
        region_areas = areas(opened)
        (layer,) = set(eps) - {gap}
        cut = eps["BED"] * eps["HEAD"] / 2 * n_T if bodies == "extended" else 0.0
        assert region_areas.pop(f"LAYER/{layer}") == pytest.approx(eps[layer] * length[layer] - cut, rel=1e-10)
        assert list(region_areas.values()) == pytest.approx([n_T * 0.02 * 0.01 / 2] if gap == "HEAD" else [])
        assert opened.band.regions_of_seam == {layer: (f"LAYER/{layer}",)}
        assert opened.band.faces == (f"{layer}/UPPER_FACE", f"{layer}/LOWER_FACE")
        assert np.array_equal(np.unique(opened.cells), np.arange(len(opened.points)))
        sides = opened.table.index(np.concatenate([opened.facets[f"{gap}/{face}_FACE"] for face in ("UPPER", "LOWER")]))
        assert (opened.table.cells[sides, 1] < 0).all()
        outer = np.flatnonzero(opened.table.cells[:, 1] < 0)
        free[gap] = len(np.setdiff1d(outer, opened.table.index(np.concatenate(list(opened.facets.values())))))
    assert free == dict.fromkeys(eps, 4 * n_T)  # across the end of a gap or a layer, 4 cells through the thickness


# ---------------------------------------------------------------- models
SIZES = (0.02, 0.01, 0.005)


@pytest.mark.parametrize(("element", "bodies"), [("P2", "extended"), ("Q2", "kept")])
def test_jumps_converge(element, bodies):
    """At rate 1 away from junctions and free ends, on all of S up to a logarithm."""
    errors = jump_errors(element, SIZES, bodies=bodies)
    orders = np.log2(errors[:-1] / errors[1:])
    assert ((orders[:, 1] > 0.9) & (orders[:, 1] < 1.1)).all()
    assert (orders[:, 0] > 0.8).all()
    assert errors[-1, 1] < 0.006


def test_jumps_converge_beside_gaps():
    """Open heads have a width in the meshed model, none in the interface model."""
    structure, errors = panel("Q2", 0.25), []
    assert structure.interface(mortar(0.01, HEAD=Gap(0.01))).layers.keys() == {"BED"}
    for eps in SIZES[1:]:
        limit = solve(structure.interface(mortar(eps, HEAD=None)), 1.0)
        full = solve(structure.full(mortar(eps, HEAD=Gap(SHARES["HEAD"] * eps))), 1.0)
        row, surface = compare(full, limit), Surface(limit.model)
        w = surface.jump(limit)
        errors.append([row["error_traction"], surface.norm(surface.jump(full) - w) / surface.norm(w)])
    orders = np.log2(np.array(errors[0]) / errors[1])
    assert ((orders > 0.8) & (orders < 1.1)).all()
    assert (np.array(errors[1]) < 0.01).all()
    other = solve(structure.interface(mortar(eps)), 1.0)
    refused(InputError, "compare needs the same open or bonded seams, not HEAD and none", compare, full, other)


def test_incompressible_layers_have_one_pressure():
    """Beds, heads and junctions keep their area together, and open as layers that are nearly incompressible."""
    structure, eps = panel("P2"), 0.05
    surface, rows = Surface(structure.interface(mortar(eps))), []
    for law in (Incompressible(0.5), LinearElastic(500.0, 0.5)):
        state = solve(structure.full({"BED": ThinLayer(law, eps, at=1.0), "HEAD": ThinLayer(law, eps, at=1.0)}), 1.0)
        w, model = surface.jump(state), state.model
        layers = model.dx(model.domain.region_tags(*model.domain.joint.band.regions))
        rows.append([state.integral(ufl.div(state.u) * layers), state.energies()["bodies"], surface.norm(w)])
    assert abs(rows[0][0]) < 1e-12 * rows[0][2]
    assert rows[0][1:] == pytest.approx(rows[1][1:], rel=0.02)


@pytest.mark.parametrize("depth", [{}, {"depth": 0.3}])
def test_a_roller_holds_the_layers_of_a_network_along_the_normal_of_its_side(depth):
    """Bodies that make room are shifted along beds by the heads, so that the sides of beds stand askew between them."""
    joint, mortar, stored = wall(2, 2, BRICK, 0.25, **depth), {"BED": springs(5.0, 2.1), "HEAD": springs(3.0, 1.3)}, []
    load = (0.3, -1.0, 0.1)[: joint.dim]
    for roller in ({"x": 0}, {"n": 0}):
        supports = {"BOTTOM": 0, "RIGHT": roller}
        made = Structure(joint, body=LinearElastic.young(20.0, 0.2), supports=supports, tractions={"TOP": load})
        state = solve(made.full(mortar, cells_through=2))
        stored.append([*state.energies().values(), *state.reaction("RIGHT").force])
    assert stored[1] == pytest.approx(stored[0], rel=1e-9, abs=1e-9)


def test_gaps_carry_no_loads(recwarn):
    """Kept bodies keep their loaded faces, extended ones give layers' sides their share; what gaps lose is told."""
    loads = {"supports": {"BOTTOM": 0.0}, "tractions": {"TOP": (0.3, -2.0), "LEFT": (0.5, 0.1)}}
    structure = Structure(wall(3, 4, BRICK, 0.25), body=LinearElastic.young(1.0, 0.2), **loads)
    layers = mortar(0.02, HEAD=Gap(0.03))
    kept, whole = solve(structure.full(layers)), solve(structure.full(mortar(0.02), bodies="extended"))
    assert not recwarn.list
    message = r"traction on 'TOP': the gap 'HEAD' ends there.* smaller than.*bodies='kept'"
    with pytest.warns(RangeWarning, match=message):
        extended = solve(structure.full(layers, bodies="extended"))
    for state, width in ((kept, 3.0), (whole, 3.0), (extended, 3.0 - 3 * 0.03)):
        resultant = state.integral(state.model.external_work(ufl.as_vector([0.0, 1.0]), 0.0))
        assert resultant == pytest.approx(-2.0 * width + 0.1 * 2, rel=1e-12)


# ---------------------------------------------------------------- what is refused
def test_refused_meshes():
    joint = wall(2, 2, BRICK, 0.25)
    both = {"BED": 0.01, "HEAD": 0.02}
    for arguments, message in (
        (dict(eps={"BED": 0.01}), "the seam 'HEAD' has no eps"),
        (dict(eps=both | {"BEDS": 0.01}), "eps: unknown seam 'BEDS', did you mean 'BED'"),
        (dict(eps=both | {"HEAD": -1.0}), "eps of 'HEAD' is -1.0; it must be > 0"),
        (dict(eps=both, gaps=["HAED"]), "gaps: unknown seam 'HAED', did you mean 'HEAD'"),
        (dict(eps=both, junctions=["HAED"]), "junctions: unknown seam 'HAED', did you mean 'HEAD'"),
        (dict(eps=both, cells_through=3), r"layers meet at \(.*, 0.5\) and need an even number"),
        (dict(eps=both, fractions={"HEAD": (0.5, 0.5)}), r"S branches at \(.*, 0.5\): .*sublayers .*no"),
        (dict(eps=both, profile={"BED": lambda x: 1 + x[0]}, bodies="extended"), r"S branches at \(.*uniform thicknes"),
        (dict(eps={"BED": 0.3, "HEAD": 1.2}, bodies="extended"), r"turn inside out, the first at \("),
    ):
        refused(InputError, message, inflate, joint, **arguments)
    facets, seams = joint.facets | {"JUNCTIONS": joint.facets["BED"]}, {"JUNCTIONS": Seam(direction=(0, 1))}
    refused(InputError, "'JUNCTIONS' cannot be a name", replace, joint, facets=facets, seams=seams)
    thick = {"L0": 0.01, "L1": 0.01, "L2": 0.02}
    words = r"different thickness, 0.005 and 0.01 .* nearly in line at \(0, 0\)"
    refused(InputError, words, inflate, star((0, 90, 180), "triangle"), thick, bodies="extended")
    check(star((0, 90, 175), "triangle"), inflate(star((0, 90, 175), "triangle"), thick, bodies="extended"))
    axis = np.linspace(0.0, 1.0, 4)
    inner = grid([axis, axis], lambda x: (np.abs(x - 0.5) < 0.2).all(axis=1), "quadrilateral")
    refused(InputError, r"S is not planar, as at .*use bodies='extended'", lambda: inflate(inner, 0.01))
    three = blocks(lambda x: np.where(x[:, 1] < 2, 0, np.where((x[:, 0] < 3) & (x[:, 1] < 4), 1, 2)))
    refused(InputError, "ask for motions that contradict one another: .*use bodies='extended'", inflate, three, 0.01)


SIX = np.arange(7.0)


def blocks(at, x=SIX, y=SIX) -> Joint:
    """A grid with a region for each value of a function of places, empty where it is negative, and S between regions."""
    square = grid([x, y], lambda x: x[:, 0] > 3, "quadrilateral", keep=lambda x: at(x) >= 0)
    return parted(square, at(square.points[square.corners].mean(axis=1)))


def test_refused_models():
    bricks, eps = panel("Q2", 0.25), 0.01
    elastic = springs(2.0, 0.7, eps)
    tilted = ThinLayer(Anisotropic(np.eye(6), "layer"), eps, at=1.0)
    stacked = ThinLayer(Stack((0.5, elastic.law), (0.5, springs(1.0, 0.7, eps).law)), eps, at=1.0)
    for head, bed, chosen, message in (
        (None, elastic, None, r"the seam 'HEAD' is open, and its width is not known: give it a Gap\(eps\)"),
        (Gap(eps), elastic, "HEAD", "junctions: unknown seam 'HEAD'"),
        (Gap(eps), Gap(eps), None, "all seams are gaps"),
        (elastic, tilted, None, "Anisotropic.* of the seam 'BED' depends on the normal of S.*give junctions="),
        (elastic, stacked, None, r"S branches at \(.*sublayers"),
    ):
        refused(InputError, message, bricks.full, {"BED": bed, "HEAD": head}, junctions=chosen)
    assert bricks.full({"BED": tilted, "HEAD": Gap(eps)}).domain.joint.band.aligned_junctions == ("LAYER/JUNCTIONS",)
    refused(InputError, r"the gap's width eps is 0.0; allowed: > 0", lambda: Gap(0.0))
    refused(InputError, "the seam 'HEAD' has no layer", lambda: bricks.full({"BED": elastic}))
    band = bricks.full({"BED": tilted, "HEAD": elastic}, junctions="HEAD").domain.joint.band
    assert band.junctions == {"LAYER/JUNCTIONS": "HEAD"}
