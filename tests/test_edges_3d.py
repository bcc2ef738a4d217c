"""Free ends in three dimensions: straight edges along which loads vary, corners, re-entrant corners, holes, turned S."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import ufl

from forms import LinearElastic
from forms.base import Array, InputError
from forms.ends import free_end
from forms.tensors import Expr
from geometry import block
from geometry.joint import Joint
from studies.problems import FOURIER_BODY as BODY
from studies.sweeping import reaction_error
from tests.meshes import part_of
from tests.refused import refused
from tests.test_edges import weights_on
from thinlayer import Structure, ThinLayer, compare, solve

pytestmark = pytest.mark.few(5)

LAW = LinearElastic.shear(8.0, 0.3)


def graded_axis(length: float, first: float, last: float) -> Array:
    """Return coordinates (n,) from 0 to `length`, whose distances grow nearly geometrically from `first` to `last`."""
    count, sizes = 1, np.array([first])
    while sizes.sum() < length:
        count += 1
        sizes = first * (last / first) ** (np.arange(count) / (count - 1))
    return np.append(0.0, np.cumsum(sizes)) * length / sizes.sum()


def grid_joint(*coordinates: Array, cell: str = "hexahedron") -> Joint:
    """Return the joint of a block on a rigid base in 3D, meshed on a tensor grid.

    Args:
        coordinates: increasing coordinates of the grid's planes along x, along y and along z.
        cell: "hexahedron" or "tetrahedron".
    """
    nx, ny, nz = (len(nodes) - 1 for nodes in coordinates)
    joint = block(nx, ny, 1.0, depth=nz, cell=cell, structured=True)
    x = [np.interp(joint.points[:, k], np.arange(len(nodes)), nodes) for k, nodes in enumerate(coordinates)]
    return replace(joint, points=np.stack(x, axis=1))


def edge_3d(eps: float, cells: float, cell: str = "hexahedron") -> Structure:
    """Make a structure of a block on a rigid base in 3D, whose layer has one free edge, along x = 0.

    The loads on top vary along the edge. The other lateral sides are planes of symmetry.

    Args:
        eps: thickness of the layer.
        cells: number of cells per thickness near the edge.
        cell: "hexahedron" or "tetrahedron".
    """
    axes = graded_axis(1.0, eps / cells, 1 / 8), graded_axis(0.5, 2 * eps / cells, 1 / 8), np.arange(4) / 3
    joint, pi = grid_joint(*axes, cell=cell), ufl.pi

    def load(x: Expr, t: Expr) -> list[Expr]:
        wave = ufl.cos(pi * x[2])
        return [0.3 * (1 - x[0]) + 0.2 * wave, -1 + 0.6 * x[0] * wave, 0.5 * ufl.sin(pi * x[2])]

    supports = {"RIGHT": {"x": 0}, "FRONT": {"z": 0}, "BACK": {"z": 0}}
    return Structure(joint, body=BODY, supports=supports, tractions={"TOP": load})


def plate(shape, eps, cell="hexahedron"):
    """A plate on a base: an L of two squares by 0.5 and one more, a square with a hole or a notch of 0.3."""
    parts = {"L": (0.0, 0.5, 1.0)}.get(shape, (0.0, 0.35, 0.65, 1.0))
    x = np.unique(np.concatenate([a + (b - a) * np.linspace(0, 1, 5) for a, b in pairwise(parts)]))
    joint = grid_joint(x, graded_axis(0.3, eps, 0.15), x, cell=cell)
    centre = joint.points[joint.corners].mean(axis=1)[:, [0, 2]]
    amid = abs(centre - 0.5) < 0.15
    out = {"L": centre > 0.5, "hole": amid, "notch": np.column_stack([centre[:, 0] > 0.65, amid[:, 1]])}[shape]
    return part_of(joint, ~out.all(axis=1))


PLATES = [("L", 6, 4.0, "hexahedron"), ("hole", 8, 5.2, "tetrahedron"), ("notch", 8, 4.7, "hexahedron")]


@pytest.mark.few(1)
@pytest.mark.parametrize(("shape", "count", "length", "cell"), PLATES)
def test_ends_of_an_angular_plate(shape, count, length, cell):
    """Each side is an end, the two in line beside a notch, too; where strips overlap their weights add up, below 1."""
    eps = 0.05
    joint = plate(shape, eps, cell)
    weights, area, ends = weights_on(joint, eps)
    assert len(ends) == count
    assert sum(end.length for end in ends) == pytest.approx(length)
    for c, a in ((free_end(0.3).c_N, weights.a_N), (free_end(0.3).c_T, weights.a_T)):
        # triangles at the ends of a strip are in it or not, by their middles
        assert a @ area == pytest.approx(c * eps * length, rel=1e-9 if cell == "hexahedron" else 0.1)
    corner = np.abs(joint.points[joint.surface].mean(axis=1)[:, [0, 2]]).max(axis=1).argmin()
    largest = np.sort(weights.a_N)[-1]
    assert weights.a_N[corner] == pytest.approx(largest)
    assert largest < 1


def edge_errors(eps, cells, cell="hexahedron"):
    """Errors of traction and jump away from the edge, and of the work, of laws with and without its constants."""
    structure, inner, errors = edge_3d(eps, cells, cell), lambda x: x[0] > 0.5, {}
    meshed = solve(structure.full(ThinLayer(LAW, eps, at=1.0), cells_through=cells))
    for edges in ("free", "plain"):
        limit = solve(structure.interface(ThinLayer(LAW, eps, order=1, edges=edges, at=1.0)))
        work = limit.energies()["loads"] / meshed.energies()["loads"] - 1
        traction, jump = reaction_error(meshed, limit, inner), compare(meshed, limit, where=inner)
        errors[edges] = np.array([traction["error_reaction"], jump["error_jump"], abs(work)])
    return errors


def test_a_straight_edge_along_which_loads_vary():
    """It opens, and is sheared across and along the edge; without its constants errors are of order 1."""
    errors = edge_errors(1 / 16, 2, "tetrahedron")
    assert np.all(errors["free"] < 0.25 * errors["plain"])
    assert errors["free"].max() < 6e-4


@pytest.mark.long
def test_errors_at_a_straight_edge_are_of_order_2():
    """Those of traction, jump and work, with its constants; without them they are of order 1."""
    thick, thin = (edge_errors(eps, 8) for eps in (1 / 16, 1 / 32))
    orders = {edges: np.log2(thick[edges] / thin[edges]) for edges in thick}
    assert orders["free"].min() >= 1.85
    assert orders["plain"].max() <= 1.3


@pytest.mark.few(5)
@pytest.mark.parametrize("shape", ["L", "hole"])
def test_angular_plates(shape):
    """Weaker than an infinite layer by about its deficit along all ends; the same where the whole is turned in space."""
    eps, works = 0.03, {}
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    joint = plate(shape, eps, "tetrahedron")
    stiff = LinearElastic.young(E=1e5, nu=0.3)
    for name, R, edges in (("known", np.eye(3), "free"), ("turned", turn, "free"), ("plain", np.eye(3), "plain")):
        moved = replace(joint, points=joint.points @ R.T)
        structure = Structure(moved, body=stiff, supports={}, tractions={"TOP": tuple(R @ (0.0, -1.0, 0.0))})
        works[name] = solve(structure.interface(ThinLayer(LAW, eps, order=1, edges=edges, at=1.0))).energies()["loads"]
    assert works["turned"] == pytest.approx(works["known"], rel=1e-9)
    area, length = {"L": (0.75, 4.0), "hole": (0.91, 5.2)}[shape]
    weaker = 1 / (1 - free_end(0.3).c_N * eps * length / area)
    assert works["known"] / works["plain"] == pytest.approx(weaker, rel=1e-2)


def test_strips_that_lie_on_one_another_are_refused():
    """All of S, or where three ends of a tongue of 0.02 are nearer to one another than 0.56 thicknesses."""
    x = np.concatenate([[0.0, 0.25], np.linspace(0.5, 0.52, 5), [0.56, 0.6], np.linspace(0.605, 0.61, 2)])
    tongue = grid_joint(x, np.array([0.0, 0.1]), x, cell="hexahedron")
    centre = tongue.points[tongue.corners].mean(axis=1)[:, [0, 2]]
    tongue = part_of(tongue, (centre[:, 0] < 0.52) | (abs(centre[:, 1] - 0.51) < 0.01))
    hole = plate("hole", 0.1, "tetrahedron"), 0.1, 0.3, "S is short"
    for joint, eps, nu, words in (hole, (tongue, 0.04, 0.05, "lie on one another")):
        structure, law = Structure(joint, body=BODY, supports={}, tractions={}), LinearElastic.shear(8.0, nu)
        refused(InputError, words, structure.interface, ThinLayer(law, eps, order=1, edges="free", at=1.0))
