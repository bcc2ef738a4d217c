"""Tractions where seams meet: T-junctions, crossings, corners, in 2D and 3D, on several ranks."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import ufl
from dolfinx import fem
from thinlayer.output.junction_tractions import JunctionTractions
from thinlayer.output.nodal_forces import reaction

from forms import Incompressible, LinearElastic, MohrCoulomb
from geometry import Joint, Seam, sandwich, wall
from tests.meshes import renumbered
from tests.network_cases import BED, HEAD, panel, pushed, springs, three_bricks
from tests.test_networks import cut_at, on
from thinlayer import ContactReport, Model, ModelError, State, Structure, Surface, ThinLayer, solve

pytestmark = pytest.mark.few(5)

LAYERS = {"BED": springs(2.0, 0.7), "HEAD": springs(1.2, 0.45, 0.007)}
STRONG = ThinLayer(
    MohrCoulomb(0.3, 0.45, cohesion=1e3, friction_angle=30.0), 0.007, at=1.0
)  # springs(1.2, 0.45) to its limit


def blocks(cell: str, cross: bool = False, depth: float = 0.5) -> Joint:
    """Two blocks of 1 x 0.5 on one, or four that cross, all of one region; in 3D 0.5 deep."""
    grid = wall(1, 2, (2.0, 0.5), 0.25, depth=None if cell in ("triangle", "quadrilateral") else depth, cell=cell)
    d = grid.dim
    upright = lambda x, n: on(0, 1.0)(x, n) & (cross | (x[:, 1] > 0.5))
    return cut_at(grid, {"BED": (on(1, 0.5), np.eye(d)[1]), "HEAD": (upright, np.eye(d)[0])})


def sheared(joint: Joint, element: str, supports=None, **layers) -> State:
    """Bodies on a bottom that is held, under their weight and a pull at the right and on top."""
    d = joint.dim
    structure = Structure(
        joint, body=LinearElastic.young(5.0, 0.2), supports={"BOTTOM": 0.0} if supports is None else supports,
        tractions={"RIGHT": (0.01, 0.004, 0.0)[:d], "TOP": (0.01, -0.02, 0.005)[:d]}, body_force=(0.01, -0.03, 0.02)[:d],
        element=element,
    )  # fmt: skip
    return solve(structure.interface(LAYERS | layers))


def left_over(state: State) -> np.ndarray:
    """Forces and moments on each brick, of the tractions on its seams and of loads, (bricks, 3 or 6)."""
    model, d, mesh = state.model, state.model.joint.dim, state.model.domain.mesh
    x, pieces = ufl.SpatialCoordinate(mesh), model.domain.on_cells(model.joint.splitting.pieces)
    brick, v = fem.Function(fem.functionspace(mesh, ("DG", 0))), fem.Function(model.space(1))
    seams = [(one := Surface(model, name), one.traction(state)) for name in model.joint.seams]
    out = []
    for number in range(model.joint.splitting.pieces.max() + 1):
        brick.x.array[:] = pieces == number
        row = []
        for shift, turn in motions(d):
            v.x.array[:] = 0.0
            v.interpolate(lambda y, a=shift, b=turn: a[:, None] + b @ y[:d], np.flatnonzero(pieces == number))
            way = ufl.as_vector(shift.tolist()) + ufl.as_matrix(turn.tolist()) * x
            total = state.integral(model.external_work(v, state.t))
            for surface, t in seams:
                above, below = surface.sides.upper(brick), surface.sides.lower(brick)
                total += surface.integral((below - above) * ufl.inner(t, way))
            row.append(total)
        out.append(row)
    return np.array(out)


def motions(d: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rigid motions: shifts (d,) and rotations (d, d)."""
    out = [(shift, np.zeros((d, d))) for shift in np.eye(d)]
    for a in range(d):
        for b in range(a):
            turn = np.zeros((d, d))
            turn[a, b], turn[b, a] = 1.0, -1.0
            out.append((np.zeros(d), turn))
    return out


def by_law(surface: Surface, state: State, K_N: float, K_T: float):
    """Tractions of springs at the jump."""
    w, n = surface.jump(state), surface.sides.n
    return K_T * w + (K_N - K_T) * ufl.dot(w, n) * n


def sizes(model: Model, state: State) -> list[float]:
    """Norms of tractions on seams, and their values along them."""
    found = []
    for name in model.joint.seams:
        surface = Surface(model, name)
        t = surface.traction(state)
        x, values = surface.profile(surface.frame(t))
        found += [surface.norm(t), *np.abs(values).sum(axis=0), float((np.arange(len(x)) * values[:, 0]).sum())]
    return found


def numbers() -> dict[str, list[float]]:
    states = {
        "panel": solve(panel("Q2", 0.125), 1.0),
        "panel, triangles": solve(panel("P2", 0.125), 1.0),
        "strong heads": solve(panel("Q2", 0.125, HEAD=STRONG), 1.0),
        "T, hexahedra": sheared(blocks("hexahedron"), "Q1"),
        "X, tetrahedra": sheared(blocks("tetrahedron", cross=True), "P1"),
        "contact": pushed(three_bricks(4, "triangle", cross=True), 0.6, {"BED": BED, "HEAD": HEAD}),
        "contact and mortar": pushed(three_bricks(4, "quadrilateral"), 0.6, {"BED": BED, "HEAD": LAYERS["HEAD"]}),
    }
    found: dict[str, list] = {name: sizes(state.model, state) for name, state in states.items()}
    found["left over"] = [float(np.abs(left_over(states["T, hexahedra"])[1:]).max() < 1e-13)]
    return found


SHIFTED = {"BOTTOM": 0.0, "TOP": {"x": 0.1, "y": -0.05}}
STIFF = {"BED": (2.0, 0.7), "HEAD": (1.2, 0.45)}


@cache
def panel_state(m: int, strong: bool = False):
    return solve(panel("Q2", 0.5 / m, **({"HEAD": STRONG} if strong else {})), 1.0)


def difference(state, name: str) -> float:
    """Difference between recovered tractions and the law's at the jump, relative."""
    surface = Surface(state.model, name)
    law = by_law(surface, state, *STIFF[name])
    return surface.norm(surface.traction(state) - law) / surface.norm(law)


def nodal_difference(state) -> float:
    """The same for the values at the nodes of all seams, not weighted."""
    model = state.model
    recovery, u = JunctionTractions(model, model.pairs), fem.Function(model.space(1))
    u.interpolate(state.u)
    by_laws = sum(recovery._by_law(one, u, 0.0).x.array * recovery._on(name) for name, one in model.layers.items())
    return float(np.linalg.norm(recovery.recovered(state).x.array - by_laws) / np.linalg.norm(by_laws))


# ---------------------------------------------------------------- a panel with T-junctions
def test_at_all_nodes_of_a_panel():
    """Errors of tractions of degree 1 fall faster than the cells' size, at junctions too."""
    found = [nodal_difference(panel_state(m)) for m in (4, 8, 16)]
    assert found == pytest.approx([9.3e-3, 3.8e-3, 1.5e-3], rel=0.03)
    assert min(np.log2(np.divide(found[:-1], found[1:]))) > 1.25


@pytest.mark.parametrize(("name", "largest"), [("BED", 2.1e-3), ("HEAD", 2.2e-2)])
def test_along_seams_of_a_panel(name, largest):
    coarse, fine = (difference(panel_state(m), name) for m in (4, 8))
    assert np.log2(coarse / fine) > 1.25
    assert fine < largest


def test_laws_that_an_expression_does_not_tell():
    """Of a Mohr-Coulomb law that stays elastic, by extrapolation around junctions and along supports."""
    for name, largest in (("BED", 1.9e-3), ("HEAD", 2.9e-2)):
        found = [difference(panel_state(m, strong=True), name) for m in (4, 8, 16)]
        assert np.log2(found[0] / found[2]) > 2 * 0.8
        assert found[2] < largest


def test_heads_that_end_at_a_support():
    """It holds both bricks: nothing jumps, so that tractions along an incompressible head are zero, not its pressure."""
    state = sheared(wall(2, 2, (1.0, 0.5), 0.125), "Q2", HEAD=ThinLayer(Incompressible(0.45), 0.007, at=1.0))
    heads = Surface(state.model, "HEAD")
    x, t = heads.profile(heads.frame(heads.traction(state)))
    (end,) = np.flatnonzero(x[:, 1] == 0)
    assert abs(t[end, 0]) < 1e-14 < 1e-4 < abs(t[end, 1])
    assert np.abs(left_over(state)[1:3]).max() < 1e-13


def test_reactions_are_met():
    """The forces of recovered tractions are the reactions, in every component that no support holds."""
    state = panel_state(8)
    recovery = JunctionTractions(state.model, state.model.pairs)
    B, r = recovery._forces, reaction(state).x.array
    t, forces = B.createVecs()
    t.array[:] = recovery.recovered(state).x.array
    B.mult(t, forces)
    free = recovery._body_areas > 0
    free[state.model.supports.held(recovery._trace)] = False
    assert np.abs(forces.array - r)[free].max() < 1e-13 * np.abs(r).max()


# ---------------------------------------------------------------- balance of each brick
@pytest.mark.parametrize("element", ["P1", "P2", "Q1", "Q2"])
@pytest.mark.parametrize("cross", [False, True])
def test_balance_of_blocks(element, cross):
    joint = blocks("triangle" if element[0] == "P" else "quadrilateral", cross)
    found, held = left_over(sheared(joint, element)), [0, 2] if cross else [0]
    assert np.abs(np.delete(found, held, axis=0)).max() < 1e-13
    assert np.abs(found[held]).max() > 0.01  # what the support carries


@pytest.mark.parametrize(("cell", "element"), [("hexahedron", "Q1"), ("tetrahedron", "P2")])
@pytest.mark.parametrize("cross", [False, True])
def test_balance_of_blocks_in_space(cell, element, cross):
    state = sheared(blocks(cell, cross), element)
    found, held = left_over(state), [0, 2] if cross else [0]
    assert np.abs(np.delete(found, held, axis=0)).max() < 1e-13
    if element == "Q1":  # the jump is of degree 1, and with it the traction
        assert max(difference(state, name) for name in STIFF) < 1e-12


def test_balance_of_a_wall_on_a_base():
    """Bricks of several regions under their weight; the lowest stand on a seam with a rigid base, where heads end."""
    joint = wall(2, 3, (1.0, 0.5), 0.25)
    facets = {name: rows for name, rows in joint.facets.items() if name != "BOTTOM"} | {
        "FOOTING": joint.facets["BOTTOM"]
    }
    joint = replace(joint, facets=facets, seams=dict(joint.seams) | {"FOOTING": Seam()})
    state = sheared(joint, "Q2", supports={}, FOOTING=springs(4.0, 2.0))
    assert np.abs(left_over(state)).max() < 1e-13
    surface = Surface(state.model, "FOOTING")
    law = by_law(surface, state, 4.0, 2.0)
    assert surface.norm(surface.traction(state) - law) < 0.05 * surface.norm(law)
    with pytest.raises(ModelError, match="name one of the seams"):
        Surface(state.model).traction(state)


def test_extruded():
    """A T-junction in plane strain, by two and by three coordinates."""
    flat, deep = (blocks(cell, depth=1.5) for cell in ("quadrilateral", "hexahedron"))
    found = []
    for joint, sides in ((flat, {}), (deep, {"BACK": {"z": 0.0}, "FRONT": {"z": 0.0}})):
        structure = Structure(joint, body=LinearElastic.young(5.0, 0.2), supports=SHIFTED | sides)
        state = solve(structure.interface(LAYERS))
        surfaces = [Surface(state.model, name) for name in STIFF]
        found.append([surface.norm(surface.traction(state)) for surface in surfaces])
        found[-1] += [difference(state, name) for name in STIFF]
    assert found[1][:2] == pytest.approx(np.sqrt(1.5) * np.array(found[0][:2]), rel=1e-10)
    assert found[1][2:] == pytest.approx(found[0][2:], rel=1e-8)


# ---------------------------------------------------------------- functions on S
def test_methods_of_a_surface():
    """A traction is continuous where its seam has one pair of bodies; projecting it changes nothing."""
    state = panel_state(4)
    for name in ("S", "BED", "HEAD"):
        surface = Surface(state.model, name)
        t = surface.traction(state)
        again = surface.sides.upper(surface.nodal(t))
        assert surface.norm(again - t) < 1e-12 * surface.norm(t)
        assert surface.norm(surface.frame(t)) == pytest.approx(surface.norm(t), rel=1e-13)
        form = fem.form(t[0] * surface.sides.measure, entity_maps=surface.entity_maps)
        assert fem.assemble_scalar(form) == pytest.approx(surface.integral(t[0]), rel=1e-13)
    whole, parts = Surface(state.model), [Surface(state.model, name) for name in STIFF]
    t = whole.traction(state)
    assert sum(one.norm(t) ** 2 for one in parts) == pytest.approx(whole.norm(t) ** 2, rel=1e-13)
    with pytest.raises(ModelError, match="field that jumps there"):
        whole.nodal(whole.nodal(t))


def test_profile_along_a_bed():
    """Two values where a head ends, in the order of the bricks; none of them from the head."""
    state = panel_state(4)
    surface = Surface(state.model, "BED")
    x, t = surface.profile(surface.traction(state))
    places = np.arange(0, 2.0001, 0.125)
    ends = [0.5, 1.0, 1.5]
    assert x[:, 0] == pytest.approx(np.sort([*places, *ends]))
    n = surface.sides.n
    _, law = surface.profile(by_law(surface, state, *STIFF["BED"]) + 0 * n)
    assert np.abs(t - law).max() < 0.03 * np.abs(law).max()
    at_end = np.flatnonzero(x[:, 0] == 1.0)
    _, jump = surface.profile(surface.jump(state))
    assert np.ptp(jump[at_end], axis=0).max() > 0.01 * np.abs(jump).max()


def test_one_name_for_a_network():
    """One seam that branches and has corners, and other numbers of cells: the same tractions."""
    two = blocks("quadrilateral")
    rows = np.concatenate([two.facets["BED"], two.facets["HEAD"]])
    facets = {name: rows for name, rows in two.facets.items() if name not in two.seams} | {"S": rows}
    one = replace(two, facets=facets, seams={"S": Seam(direction=(0.6, 1.0))})
    law, norms = springs(2.0, 0.7), []
    for joint in (two, one, renumbered(one)):
        state = solve(Structure(joint, body=LinearElastic.young(5.0, 0.2), supports=SHIFTED).interface(law))
        surface = Surface(state.model)
        norms.append(surface.norm(surface.traction(state)))
    assert norms == pytest.approx([norms[0]] * 3, rel=1e-12)


def test_a_brick_cut_out():
    """A corner of two seams where no third one meets: each has its traction up to the corner."""
    grid = wall(1, 2, (2.0, 0.5), 0.125)
    bed = lambda x, n: on(1, 0.5)(x, n) & (x[:, 0] > 1)
    head = lambda x, n: on(0, 1.0)(x, n) & (x[:, 1] > 0.5)
    state = sheared(cut_at(grid, {"BED": (bed, (0, 1)), "HEAD": (head, (1, 0))}), "Q2")
    assert np.abs(left_over(state)[1]).max() < 1e-13
    assert max(difference(state, name) for name in STIFF) < 0.05


def test_states_of_other_models():
    structure = Structure(blocks("quadrilateral"), body=LinearElastic.young(5.0, 0.2), supports=SHIFTED)
    surface, other = Surface(structure.interface(LAYERS)), solve(structure.interface(springs(3.0, 2.0)))
    own = Surface(other.model)
    assert surface.norm(surface.traction(other)) == pytest.approx(own.norm(own.traction(other)), rel=1e-13)
    assert surface.norm(surface.traction(other) - by_law(surface, other, 3.0, 2.0)) < 0.02 * surface.norm(
        surface.traction(other)
    )


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron"])
def test_bonded_blocks_under_their_weight(cell):
    """Between rollers at the sides: stresses are linear in y, and extrapolation to junctions is exact."""
    joint = blocks(cell)
    rollers = {"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    rollers |= {"BACK": {"z": 0.0}, "FRONT": {"z": 0.0}} if joint.dim == 3 else {}
    structure = Structure(
        joint, body=LinearElastic(2.0, 3.0), supports=rollers, body_force=(0.0, -1.0, 0.0)[: joint.dim]
    )
    surface, state = Surface(structure.interface(LAYERS)), solve(structure.bonded())
    depth = 1 - ufl.SpatialCoordinate(surface.model.domain.mesh)[1]
    n, t = surface.sides.n, surface.traction(state)
    exact = ufl.as_vector([(1.0 if k == 1 else 0.25) * -depth * n[k] for k in range(joint.dim)])  # 2 / (2 + 2 * 3)
    assert surface.norm(t - exact) < 1e-11 * surface.norm(exact)


def test_open_joints_and_tips():
    state = sheared(blocks("quadrilateral"), "Q2", HEAD=None)
    heads = Surface(state.model, "HEAD")
    assert heads.norm(heads.traction(state)) == 0.0
    assert np.abs(left_over(state)[1:]).max() < 1e-13
    grid = wall(1, 2, (2.0, 0.5), 0.125)
    head = lambda x, n: on(0, 1.0)(x, n) & (x[:, 1] > 0.5)
    bed = lambda x, n: on(1, 0.5)(x, n) & (x[:, 0] < 1.5)
    state = sheared(cut_at(grid, {"BED": (bed, (0, 1)), "HEAD": (head, (1, 0))}), "Q1")
    beds = Surface(state.model, "BED")
    x, t = beds.profile(beds.traction(state))
    assert x[-1] == pytest.approx([1.5, 0.5])
    assert np.abs(t[-1]).max() < 1e-14 * np.abs(t).max()
    assert difference(state, "BED") < 1e-12


# ---------------------------------------------------------------- contact
@pytest.mark.parametrize("cross", [False, True])
def test_contact(cross):
    """Each pair's traction is the law's."""
    state = pushed(three_bricks(4, "quadrilateral", cross), 0.6, {"BED": BED, "HEAD": HEAD})
    for name in STIFF:
        surface, report = Surface(state.model, name), ContactReport(state, name)
        t = surface.traction(state)
        assert [-surface.integral(t[k]) for k in (0, 1)] == pytest.approx(report.force.tolist(), rel=1e-12)
        _, values = surface.profile(surface.frame(t))
        assert (
            np.abs(values[:, 0]).max() <= (BED if name == "BED" else HEAD).friction * np.abs(values[:, 1]).max() + 1e-12
        )


def test_contact_beside_mortar():
    state = pushed(three_bricks(4, "quadrilateral"), 0.6, {"BED": BED, "HEAD": LAYERS["HEAD"]})
    assert np.abs(left_over(state)[1:, :2]).max() < 1e-11
    assert difference(state, "HEAD") < 1e-11


# ---------------------------------------------------------------- where seams do not meet
def test_no_pairs_where_seams_do_not_meet():
    grid = wall(1, 4, (2.0, 0.5), 0.25)
    joint = cut_at(grid, {"LOW": (on(1, 0.5), (0, 1)), "HIGH": (on(1, 1.5), (0, 1))})
    assert not joint.seams_meet
    assert blocks("quadrilateral").seams_meet
    model = Structure(joint, body=LinearElastic.young(5.0, 0.2), supports={"BOTTOM": 0.0}).interface(springs(2.0, 1.0))
    assert model.pairs is None
    assert Surface(model).entity_maps is None


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_bodies_of_one_law_under_their_weight(cell):
    """S carries the upper body, in both models; loads and laws are integrated over unlike sets of regions."""
    structure = Structure(
        sandwich(2.0, 1.0, 1.0, 0.25, cell=cell), body=LinearElastic(0.0, 3.0), supports={"BOTTOM": 0.0},
        body_force=(0.0, -1.0),
    )  # fmt: skip
    layer = ThinLayer(LinearElastic(0.0, 1.0), 0.1, at=1.0)
    surface = Surface(structure.interface(layer))
    for model in (surface.model, structure.full(layer)):
        assert surface.integral(surface.traction(solve(model))[1]) == pytest.approx(-2.0, rel=1e-11)
