"""Three dimensions: columns, the Fourier box, extended bodies, solvers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import ufl
from scipy.spatial.transform import Rotation

from forms import Anisotropic, LinearElastic
from geometry import block, sandwich
from geometry.joint import Joint
from tests import reference
from tests.refused import refused
from tests.test_columns import LOWER, UPPER, check_column, tensor_of
from tests.test_fourier import ABOVE, BELOW
from thinlayer import SolveError, Structure, Surface, ThinLayer, estimate, solve
from thinlayer.solving import linear_solvers

pytestmark = pytest.mark.few(5)

TURN = Rotation.from_rotvec([0.7, -0.4, 0.5]).as_matrix()
ELEMENTS = [("tetrahedron", "P1"), ("tetrahedron", "P2"), *(("hexahedron", name) for name in ("Q1", "Q2", "S2"))]
EPS = (0.3, 1e-4, 1e-2, 1e-4, 0.3)


def turned(joint: Joint) -> Joint:
    return replace(joint, points=joint.points @ TURN.T)


@pytest.mark.parametrize(("cell", "element", "eps"), [(*pair, eps) for pair, eps in zip(ELEMENTS, EPS, strict=True)])
def test_column_of_two_bodies(cell, element, eps):
    joint = sandwich(1.0, 0.5, 0.7, 0.5, depth=0.8, cell=cell)
    check_column(turned(joint), TURN, {"LOWER": LOWER, "UPPER": UPPER}, eps, element=element)


@pytest.mark.few(1)
def test_an_estimate_with_serendipity_elements():
    """They have no nodes inside faces; that with those of Lagrange is nearly the same."""
    joint, errors = sandwich(2.0, 1.0, 1.0, 1.0, depth=1.0, cell="hexahedron"), []
    for element in ("S2", "Q2"):
        structure = Structure(
            joint, body=UPPER, supports={"BOTTOM": 0}, tractions={"TOP": (3, -10, 1)}, element=element
        )
        errors.append(estimate(solve(structure.interface(ThinLayer(LOWER, 0.05)))).goals["compliance"].better)
    assert errors[0] == pytest.approx(errors[1], rel=0.02)


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
        t = np.array([mu * w[0], (lmbda + 2 * mu) * w[1], mu * w[2]])
        pairs = [(lower, mode(x, BELOW[:2])), (upper, mode(x, ABOVE[:2])), (t, mode(x, BELOW[2:]))]
        errors.append([surface.norm(field - wanted) / surface.norm(wanted) for field, wanted in pairs])
    assert max(errors[1]) < 2e-3
    assert np.log2(np.array(errors[0]) / errors[1]).min() > 2.9


# ------------------------------------------------------------------------------------------------ solvers
def test_multigrid_is_the_default_of_large_models(monkeypatch):
    joint, setup = fourier_box(3, "hexahedron")
    model = Structure(joint, **setup).interface(ThinLayer(LinearElastic(*reference.LAYER), 0.1, at=1.0))
    direct = solve(model)
    monkeypatch.setitem(linear_solvers.MIN_MULTIGRID_UNKNOWNS, 3, 1000)
    iterative = solve(model)
    assert direct.report.iterations == 1
    assert 10 < iterative.report.iterations < 80
    assert np.abs(direct.u.x.array - iterative.u.x.array).max() < 1e-7 * np.abs(direct.u.x.array).max()


def test_stiff_layers_fall_back_on_factorising(monkeypatch):
    """A layer so stiff that multigrid stalls is factorised; who chose multigrid hears of it instead."""
    joint, setup = fourier_box(3, "hexahedron")
    model = Structure(joint, **setup).full(ThinLayer(LinearElastic(lmbda=1.5e9, mu=1e9), 0.1, at=1.0))
    monkeypatch.setitem(linear_solvers.MIN_MULTIGRID_UNKNOWNS, 3, 1000)
    monkeypatch.setitem(linear_solvers.MULTIGRID_OPTIONS, "ksp_max_it", 30)
    assert solve(model).report.iterations == 1
    refused(SolveError, "DIVERGED", lambda: solve(model, options={"pc_type": "gamg", "ksp_type": "cg"}))
