"""Columns: uniform strain in each body and in the layer, so that both models must agree to solver tolerance.

The load is a uniform traction t on top, the lower side is clamped. With the strains e = sym(a (x) n) that t causes, the
sides carry the tractions of these stresses, different ones on the bodies and on the side of the layer.
"""

from __future__ import annotations

from itertools import cycle

import numpy as np
import pytest

from forms import LinearElastic, MohrCoulombMonodirectional
from forms.elastic import VOIGT_PAIRS
from geometry import block, sandwich
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
    for p, (i, j) in enumerate(VOIGT_PAIRS):
        for q, (k, m) in enumerate(VOIGT_PAIRS):
            tensor[i, j, k, m] = tensor[j, i, k, m] = tensor[i, j, m, k] = tensor[j, i, m, k] = C[p, q]
    return tensor


def uniform(C: np.ndarray, t: np.ndarray, n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The a of the strain sym(a (x) n) whose traction on n is t, and its stress (d, d); C is the stiffness tensor."""
    d, n_3 = len(n), np.pad(n, (0, 3 - len(n)))
    a = np.linalg.solve(closed_forms.acoustic_tensor(C, n_3)[:d, :d], t)
    return a, np.einsum("ijkl,k,l->ij", C, np.pad(a, (0, 3 - d)), n_3)[:d, :d]


def check_column(joint, turn, bodies, eps, glue=GLUE, tensor=None, cells_through=4, **options) -> None:
    """Uniform strain in each part: both models and the closed form agree to solver tolerance.

    `tensor`: the glue's stiffness (3, 3, 3, 3) in global axes (default: of its moduli).
    """
    d = joint.dim
    n, t = turn[:, 1], turn @ TRACTION[:d]
    w, stress = uniform(tensor_of(isotropic_voigt(glue)) if tensor is None else tensor, t, n)
    stresses = {name: uniform(tensor_of(isotropic_voigt(law)), t, n)[1] for name, law in bodies.items()}
    tractions = {"TOP": tuple(t)}
    for name, axis, sign in (("LEFT", 0, -1), ("RIGHT", 0, 1), ("BACK", 2, -1), ("FRONT", 2, 1))[: 2 * d - 2]:
        for part, sigma in (stresses | {"LAYER": stress}).items():
            tractions[f"{name}/{part}"] = tuple(sign * sigma @ turn[:, axis])
    supports = {"BOTTOM": 0.0} if "BOTTOM" in joint.facets else {}
    structure = Structure(joint, body=bodies, supports=supports, tractions=tractions, **options)
    layer = ThinLayer(glue, eps, at=1.0)
    interface, full = solve(structure.interface(layer)), solve(structure.full(layer, cells_through=cells_through))
    surface = Surface(interface.model)
    jump, traction = (np.multiply.outer(vector, np.ones_like(surface.weights)) for vector in (w, t))
    for state in (interface, full):
        assert surface.norm(surface.jump(state) - jump) < EXACT * surface.norm(jump), state.model
        assert surface.norm(surface.traction(state) - traction) < EXACT * surface.norm(traction), state.model
    u, v = displacements_of(full, interface.model), interface.u
    assert np.abs(u.x.array - v.x.array).max() < EXACT * np.abs(v.x.array).max()


TWO_BODIES = [(*element, *layer) for element, layer in zip(ELEMENTS, cycle([(0.3, 1), (1e-2, 7), (1e-4, 4)]))]


@pytest.mark.few(1)
@pytest.mark.parametrize(("cell", "element", "angle", "eps", "cells_through"), TWO_BODIES)
def test_two_bodies(cell, element, angle, eps, cells_through):
    """In any direction, with any number of cells through the layer."""
    joint, choices = sandwich(1.0, 0.5, 0.7, 0.25, cell=cell).rotated(angle), {"cells_through": cells_through}
    check_column(joint, rotation(angle), {"LOWER": LOWER, "UPPER": UPPER}, eps, element=element, **choices)


def test_rigid_base():
    for cell, element, eps in (("triangle", "P1", 0.3), ("quadrilateral", "S2", 1e-3)):
        joint = block(1.0, 0.7, 0.25, cell=cell).rotated(ANGLE)
        check_column(joint, rotation(ANGLE), {"BODY": UPPER}, eps, element=element)


@pytest.mark.parametrize(("size", "swap"), [({}, False), ({}, True), ({"depth": 0.8, "cell": "hexahedron"}, False)])
@pytest.mark.parametrize(("pull", "share"), [(0.6, 0.4), (-0.6, 1.0)])
def test_sign(pull, share, size, swap):
    """Opening is [u].n > 0 with n from the lower to the upper body, in both models, whichever body is called lower.

    Of a law that knows closing from opening: where it is pulled a share of its stiffness is left.
    """
    joint, area = sandwich(1.0, 0.5, 0.7, 0.5, **size), size.get("depth", 1.0)
    joint = joint.swapped() if swap else joint
    rollers = {"LEFT": {"x": 0.0}, "RIGHT": {"x": 0.0}} | ({"BACK": {"z": 0.0}, "FRONT": {"z": 0.0}} if size else {})
    setup = {"supports": {"BOTTOM": 0.0} | rollers, "tractions": {"TOP": (0.0, pull, 0.0)[: joint.dim]}}
    structure = Structure(joint, body=UPPER, element="Q1" if size else "P2", **setup)
    layer = ThinLayer(MohrCoulombMonodirectional(15.0, 7.0, 9.0, 0.0, 0.4, unilateral=True), 0.05, at=1.0)
    limit = solve(structure.interface(layer))
    surface = Surface(limit.model)
    for state in (limit, solve(structure.full(layer))):
        opening, traction = (surface.frame(field(state))[joint.dim - 1] for field in (surface.jump, surface.traction))
        assert surface.integral(opening) == pytest.approx(area * pull / (share * 29.0), rel=1e-9)
        assert surface.integral(traction) == pytest.approx(area * pull, rel=1e-9)
