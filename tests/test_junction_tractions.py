"""Tractions where seams meet: of laws and of the bodies' reactions, in 2D and 3D, on several ranks."""

from functools import cache

import numpy as np
import pytest
from dolfinx import fem

from forms import LinearElastic
from geometry import wall
from geometry.joint import Joint
from tests.meshed_cases import mortar, panel
from tests.network_cases import BED, HEAD, pushed, springs, three_bricks
from tests.test_networks import cut_at, on
from thinlayer import Structure, Surface, solve
from thinlayer.discretisation.state import State

pytestmark = pytest.mark.few(5)

STIFF = {"BED": (2.0, 0.7), "HEAD": (1.2, 0.45)}  # K_N, K_T
LAYERS = {"BED": springs(*STIFF["BED"]), "HEAD": springs(*STIFF["HEAD"], 0.007)}
EXACT = 1e-12  # relative, of sums over S


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


def left_over(state: State, surface: Surface, t: np.ndarray) -> np.ndarray:
    """Forces and moments on each brick, of tractions on S and of loads, (bricks, 3 or 6)."""
    model, d, out = state.model, state.model.joint.dim, []
    pieces, v = model.joint.split_mesh.pieces, fem.Function(state.model.space(1))
    turns = [np.outer(a, b) - np.outer(b, a) for k, a in enumerate(np.eye(d)) for b in np.eye(d)[:k]]
    for number in range(pieces.max() + 1):
        below, above = ((surface.cells >= 0) & (pieces[surface.cells] == number)).T[..., None].astype(float)
        cells = np.flatnonzero(model.domain.to_local(pieces) == number)
        out.append([])
        for shift, turn in [(mode, 0 * turns[0]) for mode in np.eye(d)] + [(np.zeros(d), mode) for mode in turns]:
            v.x.array[:] = 0.0
            v.interpolate(lambda y, a=shift, b=turn: a[:, None] + b @ y[:d], cells)
            way = shift[:, None, None] + np.tensordot(turn, surface.x, 1)
            work = surface.integral((below - above) * (t * way).sum(axis=0))
            out[-1].append(work + state.integral(model.external_work(v, state.t)))
    return np.array(out)


def differences(state: State, names=STIFF) -> np.ndarray:
    """(seams, 2) differences of the traction and of the bodies' reaction from springs at the jump, relative."""
    out = []
    for name in names:
        surface, (K_N, K_T) = Surface(state.model, name), STIFF[name]
        w, n = surface.jump(state), surface.n
        law = surface.at_points(surface.nodal(K_T * w + (K_N - K_T) * (w * n).sum(axis=0) * n))
        tractions = surface.traction(state), surface.reaction(state)
        out.append([surface.norm(traction - law) / surface.norm(law) for traction in tractions])
    return np.array(out)


@cache
def panel_state(m: int) -> State:
    return solve(panel("Q2", 0.5 / m).interface(mortar(0.01)), 1.0)


# ---------------------------------------------------------------- numbers on ranks
def numbers() -> dict[str, list[float]]:
    states = {
        "panel": panel_state(4),
        "T, hexahedra": sheared(blocks("hexahedron"), "Q1"),
        "X, tetrahedra": sheared(blocks("tetrahedron", cross=True), "P1"),
        "contact": pushed(three_bricks(4, "triangle", cross=True), 0.6, {"BED": BED, "HEAD": HEAD}),
        "contact and mortar": pushed(three_bricks(4, "quadrilateral"), 0.6, {"BED": BED, "HEAD": LAYERS["HEAD"]}),
    }
    sums = {}
    for name, state in states.items():
        surface = Surface(state.model)
        both = [abs(surface.nodal(field(state))) for field in (surface.traction, surface.reaction)]
        sums[name] = [float(x) for t in both for x in (*t.sum(axis=0), *(np.arange(len(t)) @ t))]
    return sums


# ---------------------------------------------------------------- a panel with T-junctions
def test_along_the_seams_of_a_panel():
    """Tractions are those of the law; what reactions do not tell at junctions is off by as much as cells are large."""
    errors = np.array([differences(panel_state(m)) for m in (4, 8, 16)])
    assert errors[:, :, 0].max() < EXACT
    assert errors[2, :, 1] == pytest.approx([4.3e-3, 6.4e-2], rel=0.03)
    assert np.log2(errors[0] / errors[2])[:, 1] / 2 == pytest.approx([0.95, 0.93], abs=0.05)


# ---------------------------------------------------------------- balance of each brick
def check_balance(state: State, supported) -> None:
    """Of bricks that no support holds, by the law's traction and by the reactions."""
    surface = Surface(state.model)
    for t in (surface.traction(state), surface.reaction(state)):
        resultants = left_over(state, surface, t)
        assert np.abs(np.delete(resultants, supported, axis=0)).max() < 1e-13
        assert not supported or np.abs(resultants[supported]).max() > 0.01  # what the support carries


@pytest.mark.parametrize("element", ["P1", "Q2", "P2 in space", "Q1 in space"])
@pytest.mark.parametrize("cross", [False, True])
def test_balance_of_blocks(element, cross):
    flat, solid = {"P": ("triangle", "tetrahedron"), "Q": ("quadrilateral", "hexahedron")}[element[0]]
    state = sheared(blocks(solid if "space" in element else flat, cross), element[:2])
    check_balance(state, [0, 2] if cross else [0])
    assert differences(state)[:, 0].max() < EXACT


# ---------------------------------------------------------------- functions on S


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle", "hexahedron"])
def test_bonded_blocks_under_their_weight(cell):
    """Between rollers at the sides: stresses are linear in y; at the junction reactions do not tell all of them."""
    joint = blocks(cell)
    rollers = {"BOTTOM": {"y": 0.0}, "LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    rollers |= {"BACK": {"z": 0.0}, "FRONT": {"z": 0.0}} if joint.dim == 3 else {}
    weight = (0.0, -1.0, 0.0)[: joint.dim]
    state = solve(Structure(joint, body=LinearElastic(2.0, 3.0), supports=rollers, body_force=weight).bonded())
    surface = Surface(state.model)
    sides = np.where(np.arange(joint.dim) == 1, 1.0, 0.25)[:, None, None]  # 2 / (2 + 2 * 3)
    exact = sides * (surface.x[1] - 1) * surface.n
    error = surface.norm(surface.traction(state) - exact) / surface.norm(exact)
    assert error == pytest.approx(0.0113, rel=0.01)  # and of half the size 0.0042
