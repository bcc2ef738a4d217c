"""Three dimensions: columns, the Fourier box, extended bodies, solvers."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import ufl
from scipy.spatial.transform import Rotation

from forms import Anisotropic, LinearElastic
from geometry import block, sandwich
from geometry.joint import Joint
from tests import reference
from tests.orders import observed_orders
from tests.refused import refused
from tests.test_columns import GLUE, LOWER, UPPER, check_column, tensor_of
from tests.test_fourier import ABOVE, BELOW
from thinlayer import SolveError, Structure, Surface, ThinLayer, compare, solve
from thinlayer.solving import linear_solvers

pytestmark = pytest.mark.few(5)

TURN = Rotation.from_rotvec([0.7, -0.4, 0.5]).as_matrix()
ELEMENTS = [
    ("tetrahedron", "P1"),
    ("tetrahedron", "P2"),
    ("hexahedron", "Q1"),
    ("hexahedron", "Q2"),
    ("hexahedron", "S2"),
]


def turned(joint: Joint) -> Joint:
    return replace(joint, points=joint.points @ TURN.T)


@pytest.mark.parametrize("eps", [0.3, 1e-2, 1e-4])
@pytest.mark.parametrize(("cell", "element"), ELEMENTS)
def test_column_of_two_bodies(cell, element, eps):
    joint = sandwich(1.0, 0.5, 0.7, 0.5, depth=0.8, cell=cell)
    check_column(turned(joint), TURN, {"LOWER": LOWER, "UPPER": UPPER}, eps, element=element)


@pytest.mark.parametrize(("cell", "element"), [("tetrahedron", "P2"), ("hexahedron", "Q1")])
def test_column_on_rigid_base(cell, element):
    check_column(turned(block(1.0, 0.7, 0.5, depth=0.8, cell=cell)), TURN, {"BODY": UPPER}, 1e-3, element=element)


@pytest.mark.parametrize("frame", ["global", "layer"])
def test_anisotropic_column(frame):
    """A full stiffness tensor: the acoustic tensor of the layer; in the layer's frame its second axis is n."""
    root = np.random.default_rng(3).normal(size=(6, 6))
    C = root @ root.T + 5 * np.eye(6)
    tensor = tensor_of(C)
    if frame == "layer":
        n = TURN @ [0.0, 1.0, 0.0]
        axis = np.cross([0.0, 1.0, 0.0], n)  # the smallest rotation from e_2 to n
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.arccos(n[1])).as_matrix()
        tensor = np.einsum("ia,jb,kc,ld,abcd->ijkl", turn, turn, turn, turn, tensor)
    joint = turned(block(1.0, 0.7, 0.5, depth=0.8, cell="hexahedron"))
    check_column(joint, TURN, {"BODY": UPPER}, 0.03, Anisotropic(C, frame), tensor, element="Q1")


@pytest.mark.parametrize(("cell", "element"), ELEMENTS)
def test_patch(cell, element):
    """A linear displacement of bonded bodies is reproduced on any cells."""
    joint = turned(sandwich(1.0, 0.5, 0.7, 0.5, depth=0.8, cell=cell))
    gradient = np.array([[0.1, 0.3, -0.2], [0.05, -0.2, 0.4], [0.25, 0.15, 0.3]])
    sides = ("LEFT", "RIGHT", "TOP", "BOTTOM", "FRONT", "BACK")
    rows = {
        axis: (lambda x, t, row=row: sum(float(c) * x[k] for k, c in enumerate(row)))
        for axis, row in zip("xyz", gradient, strict=True)
    }
    state = solve(Structure(joint, body=LOWER, supports=dict.fromkeys(sides, rows), element=element).bonded())
    exact = ufl.dot(ufl.as_matrix(gradient.tolist()), ufl.SpatialCoordinate(state.model.domain.mesh))
    assert np.sqrt(state.integral(ufl.inner(state.u - exact, state.u - exact) * ufl.dx)) < 1e-12


# ------------------------------------------------------------------------------------------------ the Fourier box
K1, K3 = 0.6 * np.pi, 0.8 * np.pi  # k = pi, so that the numbers are those of the plane problem


def fourier_box(n: int, cell: str) -> tuple[Joint, dict]:
    joint = sandwich(np.pi / K1, 0.5, 0.5, 1 / n, depth=np.pi / K3, cell=cell, structured=True)
    k = np.hypot(K1, K3)

    def top(x, t):
        s1, c1, s3, c3 = ufl.sin(K1 * x[0]), ufl.cos(K1 * x[0]), ufl.sin(K3 * x[2]), ufl.cos(K3 * x[2])
        return (0.5 * K1 / k * s1 * c3, c1 * c3, 0.5 * K3 / k * c1 * s3)

    rollers = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}, "BACK": {"z": 0.0}, "FRONT": {"z": 0.0}}
    body = LinearElastic(*reference.BODY)
    return joint, {"body": body, "supports": {"BOTTOM": 0.0, **rollers}, "tractions": {"TOP": top}}


def mode(x, z: tuple[float, ...]):
    """Displacement (or traction) with the amplitudes (U, V) of the plane problem."""
    k = np.hypot(K1, K3)
    s1, c1, s3, c3 = np.sin(K1 * x[0]), np.cos(K1 * x[0]), np.sin(K3 * x[2]), np.cos(K3 * x[2])
    return np.array([K1 / k * z[0] * s1 * c3, z[1] * c1 * c3, K3 / k * z[0] * c1 * s3])


@pytest.mark.long
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_fourier_box(cell):
    """Errors of u-, u+ and K [u] against the plane problem's amplitudes fall with order 3 (faster on coarse meshes)."""
    lmbda, mu = reference.LAYER
    errors = []
    for n in (4, 8):
        joint, setup = fourier_box(n, cell)
        state = solve(Structure(joint, **setup).interface(ThinLayer(LinearElastic(lmbda, mu), 0.1, at=1.0)))
        surface = Surface(state.model)
        x, w, (lower, upper) = surface.x, surface.jump(state), surface.displacements(state)
        pairs = [
            (lower, mode(x, BELOW[:2])),
            (upper, mode(x, ABOVE[:2])),
            (np.array([mu * w[0], (lmbda + 2 * mu) * w[1], mu * w[2]]), mode(x, BELOW[2:])),
        ]
        errors.append([surface.norm(found - wanted) / surface.norm(wanted) for found, wanted in pairs])
    assert max(errors[1]) < 2e-3
    assert np.log2(np.array(errors[0]) / errors[1]).min() > 2.9


box_problem = cache(fourier_box)


@cache
def box(build, eps: float, order: int = 0, bodies: str = "kept"):
    """State of a model of the box; several tests ask for the same."""
    joint, setup = box_problem(6, "hexahedron")
    layer = ThinLayer(LinearElastic(*reference.LAYER), eps, order=order, at=1.0)
    choice = {"bodies": bodies} if build == Structure.full else {}
    return solve(build(Structure(joint, **setup), layer, **choice))


@pytest.mark.long
@pytest.mark.parametrize("bodies", ["kept", "extended"])
def test_sweep_of_the_fourier_box(bodies):
    """Errors of the interface law as the transfer matrices have them, to 1 %, and of first order in eps."""
    eps, rows = (1 / 16, 1 / 32), []
    for e in eps:
        row = compare(box(Structure.full, e, bodies=bodies), box(Structure.interface, e))
        assert (row["error_traction"], row["error_jump"]) == pytest.approx(reference.sweep_errors(e, bodies), rel=1e-2)
        rows.append(row)
    for name in ("error_traction", "error_jump"):
        assert observed_orders(eps, [row[name] for row in rows])[-1] == pytest.approx(1.0, abs=0.05)


@pytest.mark.long
def test_order_1_on_the_fourier_box():
    eps = (1 / 8, 1 / 16)
    errors = []
    for e in eps:
        full, state = box(Structure.full, e), box(Structure.interface, e, order=1)
        surface = Surface(state.model)
        t = surface.reaction(state)
        errors.append(surface.norm(surface.reaction(full) - t) / surface.norm(t))
    plane = [reference.next_order_errors(*reference.LAYER, e)[0] for e in eps]  # the plane problem's
    assert errors == pytest.approx(plane, rel=1e-2)
    assert observed_orders(eps, errors)[-1] == pytest.approx(1.87, abs=0.1)


def test_profile_is_sorted():
    """By x, then y, then z, whatever the rounding of the coordinates."""
    joint = turned(sandwich(1.0, 0.5, 0.5, 0.25, depth=1.0, cell="hexahedron"))
    for one in (joint, sandwich(1.0, 0.5, 0.5, 0.25, depth=1.0, cell="hexahedron")):
        model = Structure(one, body=LOWER, supports={"BOTTOM": 0.0}).interface(ThinLayer(GLUE, 0.1, at=1.0))
        surface = Surface(model)
        places, _ = surface.profile(surface.n)
        rounded = [tuple(x) for x in np.round(places, 6) + 0.0]
        assert len(places) == 25
        assert rounded == sorted(rounded)


# ------------------------------------------------------------------------------------------------ solvers
def test_multigrid_is_the_default_of_large_models(monkeypatch):
    joint, setup = fourier_box(4, "hexahedron")
    model = Structure(joint, **setup).interface(ThinLayer(LinearElastic(*reference.LAYER), 0.1, at=1.0))
    direct = solve(model)
    monkeypatch.setitem(linear_solvers.MULTIGRID_FROM, 3, 1000)
    iterative = solve(model)
    assert direct.report.iterations == 1
    assert 10 < iterative.report.iterations < 80
    difference = np.abs(direct.u.x.array - iterative.u.x.array).max()
    assert difference < 1e-7 * np.abs(direct.u.x.array).max()


def test_stiff_layers_fall_back_on_factorising(monkeypatch):
    """A layer so stiff that multigrid stalls is factorised; who chose multigrid hears of it instead."""
    joint, setup = fourier_box(4, "hexahedron")
    layer = ThinLayer(LinearElastic(lmbda=1.5e9, mu=1e9), 0.1, at=1.0)
    model = Structure(joint, **setup).full(layer)
    monkeypatch.setitem(linear_solvers.MULTIGRID_FROM, 3, 1000)
    monkeypatch.setitem(linear_solvers.MULTIGRID, "ksp_max_it", 30)
    assert solve(model).report.iterations == 1
    refused(SolveError, "DIVERGED", lambda: solve(model, options={"pc_type": "gamg", "ksp_type": "cg"}))
