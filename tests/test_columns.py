"""Columns: uniform strain in each body and in the layer, so that both models must agree to solver tolerance.

The load is a uniform traction t on top, the lower side is clamped. With the strains e = sym(a (x) n) that t causes, the
sides carry the tractions of these stresses, different ones on the bodies and on the side of the layer.
"""

from __future__ import annotations

import numpy as np
import pytest
import ufl

from forms import Anisotropic, BulkLaw, LinearElastic, Stack
from forms.elastic import VOIGT
from geometry import block, sandwich
from geometry.joint import Joint
from tests import closed_forms
from thinlayer import Structure, Surface, ThinLayer, solve
from thinlayer.discretisation.state import displacements_of

pytestmark = pytest.mark.few(5)

TRACTION = np.array([0.3, -0.8, 0.2])  # tangential, normal, and along S in 3D
LOWER, UPPER = LinearElastic.young(210.0, 0.25), LinearElastic.young(70.0, 0.35)
GLUE = LinearElastic(lmbda=15.0, mu=7.0)
ANGLE = 0.4
EXACT = 1e-9  # relative: MUMPS on cells as flat as 1e-4
ELEMENTS = [  # cells, elements, and the angle of a column of them
    ("triangle", "P1", 0.0),
    ("triangle", "P2", ANGLE),
    ("quadrilateral", "Q1", np.pi / 2),
    ("quadrilateral", "Q2", 2.5),
    ("quadrilateral", "S2", np.pi),
]


def rotation(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def isotropic_voigt(law: LinearElastic) -> np.ndarray:
    C = np.zeros((6, 6))
    C[:3, :3] = law.lmbda
    return C + np.diag([2 * law.mu] * 3 + [law.mu] * 3)


def tensor_of(C: np.ndarray) -> np.ndarray:
    """Stiffness (3, 3, 3, 3) of Voigt's (6, 6)."""
    tensor = np.empty((3, 3, 3, 3))
    for p, (i, j) in enumerate(VOIGT):
        for q, (k, m) in enumerate(VOIGT):
            tensor[i, j, k, m] = tensor[j, i, k, m] = tensor[i, j, m, k] = tensor[j, i, m, k] = C[p, q]
    return tensor


def uniform(C: np.ndarray, t: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The a of the strain sym(a (x) n) whose traction on n is t, and its stress (d, d); C is the stiffness tensor."""
    d, n_3 = len(n), np.pad(n, (0, 3 - len(n)))
    a = np.linalg.solve(closed_forms.acoustic_tensor(C, n_3)[:d, :d], t)
    return a, np.einsum("ijkl,k,l->ij", C, np.pad(a, (0, 3 - d)), n_3)[:d, :d]


def check_column(
    joint: Joint,
    turn: np.ndarray,
    bodies: dict[str, LinearElastic],
    eps: float,
    glue: BulkLaw = GLUE,
    tensor: np.ndarray | None = None,
    cells_through: int = 4,
    **options,
) -> None:
    """Uniform strain in each part: both models and the closed form agree to solver tolerance.

    `tensor`: the glue's stiffness (3, 3, 3, 3) in global axes (default: of its moduli).
    """
    d = joint.dim
    n, t = turn[:, 1], turn @ TRACTION[:d]
    w, stress = uniform(tensor_of(isotropic_voigt(glue)) if tensor is None else tensor, t, n)
    stresses = {name: uniform(tensor_of(isotropic_voigt(law)), t, n)[1] for name, law in bodies.items()}
    tractions = {"TOP": tuple(t)}
    for name, axis, sign in (("LEFT", 0, -1), ("RIGHT", 0, 1), ("BACK", 2, -1), ("FRONT", 2, 1))[: 2 * d - 2]:
        for part, one in (stresses | {"LAYER": stress}).items():
            tractions[f"{name}/{part}"] = tuple(sign * one @ turn[:, axis])
    supports = {"BOTTOM": 0.0} if "BOTTOM" in joint.facets else {}
    structure = Structure(joint, body=bodies, supports=supports, tractions=tractions, **options)
    layer = ThinLayer(glue, eps, at=1.0)
    interface, full = solve(structure.interface(layer)), solve(structure.full(layer, cells_through=cells_through))
    surface = Surface(interface.model)
    jump, traction = (np.multiply.outer(one, np.ones_like(surface.weights)) for one in (w, t))
    for state in (interface, full):
        assert surface.norm(surface.jump(state) - jump) < EXACT * surface.norm(jump), state.model
        assert surface.norm(surface.traction(state) - traction) < EXACT * surface.norm(traction), state.model
    u, v = displacements_of(full, interface.model), interface.u
    assert np.abs(u.x.array - v.x.array).max() < EXACT * np.abs(v.x.array).max()


@pytest.mark.parametrize(("eps", "cells_through"), [(0.3, 1), (1e-2, 7), (1e-4, 4)])
@pytest.mark.parametrize(("cell", "element", "angle"), ELEMENTS)
def test_two_bodies(cell, element, angle, eps, cells_through):
    """In any direction, with any number of cells through the layer."""
    joint, choices = sandwich(1.0, 0.5, 0.7, 0.25, cell=cell).rotated(angle), {"cells_through": cells_through}
    check_column(joint, rotation(angle), {"LOWER": LOWER, "UPPER": UPPER}, eps, element=element, **choices)


@pytest.mark.parametrize("eps", [0.3, 1e-3])
@pytest.mark.parametrize(("cell", "element"), [("triangle", "P1"), ("quadrilateral", "S2")])
def test_rigid_base(cell, element, eps):
    joint = block(1.0, 0.7, 0.25, cell=cell).rotated(ANGLE)
    check_column(joint, rotation(ANGLE), {"BODY": UPPER}, eps, element=element)


class OneSided(LinearElastic):
    """Stiffer when it is compressed: a law that knows closing from opening."""

    linear = False
    powers = {"lmbda": 1, "mu": 1, "extra": 1}

    def __init__(self, lmbda: float, mu: float, extra: float) -> None:
        object.__setattr__(self, "extra", extra)
        super().__init__(lmbda, mu)

    def parameters(self):
        return {"lmbda": self.lmbda, "mu": self.mu, "extra": self.extra}

    def stress(self, step):
        closing = ufl.conditional(ufl.lt(ufl.tr(step.e), 0), self.extra, 0.0)
        return super().stress(step) + closing * ufl.tr(step.e) * ufl.Identity(3)

    def energy(self, step):
        return ufl.inner(self.stress(step), step.e) / 2


@pytest.mark.parametrize("size", [{}, {"depth": 0.8, "cell": "hexahedron"}], ids=["2D", "3D"])
@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize(("pull", "stiffness"), [(0.6, 15.0 + 14.0), (-0.6, 15.0 + 14.0 + 9.0)])
def test_sign(pull, stiffness, swap, size):
    """Opening is [u].n > 0 with n from the lower to the upper body, in both models, whichever body is called lower."""
    joint, area = sandwich(1.0, 0.5, 0.7, 0.5, **size), size.get("depth", 1.0)
    joint = joint.swapped() if swap else joint
    rollers = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}} | ({"BACK": {"z": 0.0}, "FRONT": {"z": 0.0}} if size else {})
    setup = {"supports": {"BOTTOM": 0.0} | rollers, "tractions": {"TOP": (0.0, pull, 0.0)[: joint.dim]}}
    structure = Structure(joint, body=UPPER, element="Q1" if size else "P2", **setup)
    layer = ThinLayer(OneSided(mu=7.0, lmbda=15.0, extra=9.0), 0.05, at=1.0)
    limit = solve(structure.interface(layer))
    surface = Surface(limit.model)
    for state in (limit, solve(structure.full(layer))):
        opening, traction = (surface.frame(one(state))[joint.dim - 1] for one in (surface.jump, surface.traction))
        assert surface.integral(opening) == pytest.approx(area * pull / stiffness, rel=1e-9)
        assert surface.integral(traction) == pytest.approx(area * pull, rel=1e-9)


def test_stratified_column():
    """Unequal Poisson ratios: harmonic means of mu and of lmbda + 2 mu; not of lmbda, not arithmetic ones."""
    lower, upper = LinearElastic.young(30.0, 0.1), LinearElastic.young(12.0, 0.42)
    a = 0.3
    glue = Stack((a, lower), (1 - a, upper))
    K_T = 1 / (a / lower.mu + (1 - a) / upper.mu)
    K_N = 1 / (a / (lower.lmbda + 2 * lower.mu) + (1 - a) / (upper.lmbda + 2 * upper.mu))
    joint = sandwich(1.0, 0.5, 0.7, 0.5)
    normal = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}}
    shear = {"LEFT": {"y": 0.0}, "RIGHT": {"y": 0.0}}
    for sides, t, component, stiffness in ((normal, (0.0, 0.6), 1, K_N), (shear, (0.6, 0.0), 0, K_T)):
        supports = {"BOTTOM": 0.0, "TOP": {"xy"[1 - component]: 0.0}} | sides
        setup = {"body": UPPER, "supports": supports, "tractions": {"TOP": t}}
        limit = solve(Structure(joint, **setup).interface(ThinLayer(glue, 0.05, at=1.0)))
        surface = Surface(limit.model)
        for state in (limit, solve(Structure(joint, **setup).full(ThinLayer(glue, 0.05, at=1.0)))):
            assert surface.integral(surface.jump(state)[component]) == pytest.approx(0.6 / stiffness, rel=1e-9), (
                state.model
            )
    stiffnesses = [closed_forms.elastic_stiffness(law.lmbda, law.mu, [0, 1]) for law in (lower, upper)]
    assert np.diag(closed_forms.stratified((a, 1 - a), stiffnesses)) == pytest.approx([K_T, K_N])
    harmonic_lmbda = 1 / (a / lower.lmbda + (1 - a) / upper.lmbda)
    assert pytest.approx(K_N, rel=1e-2) != harmonic_lmbda + 2 * K_T  # Eq. (52) as printed


def test_anisotropic_column():
    """A full stiffness tensor in the global frame: the acoustic tensor of the layer, in both models."""
    root = np.random.default_rng(3).normal(size=(6, 6))
    C = root @ root.T + 5 * np.eye(6)
    joint = block(1.0, 0.7, 0.25).rotated(ANGLE)
    check_column(joint, rotation(ANGLE), {"BODY": UPPER}, 0.03, Anisotropic(C), tensor_of(C))
