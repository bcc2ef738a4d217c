"""Structures with free ends of a layer, and laws whose strips along the ends have lengths of choice; for `free_ends`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl

from forms import LinearElastic
from forms.ends.weights import Strip, Strips
from forms.kinematics import Expr
from forms.law import choice
from geometry import block, sandwich
from geometry.joint import Joint
from thinlayer import Structure

BODY = LinearElastic.young(E=100.0, nu=0.3)
H, H_S = 1 / 8, 1 / 32  # cell sizes
Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class OfLength(LinearElastic):
    """A law whose strips along free ends have one length, instead of the lengths of their first moments.

    Attributes:
        length: over the thickness.
    """

    length: float = choice(1.0)

    def end_strips(self) -> Strips | None:
        """As of `LinearElastic`, but for the lengths."""
        strips = super().end_strips()
        if strips is None:
            return None
        opening, shear = (Strip(strip.c, self.length) for strip in (strips.opening, strips.shear))
        return replace(strips, opening=opening, shear=shear)


@dataclass(frozen=True)
class EndCase:
    """A structure with free ends.

    Attributes:
        name: of it.
        structure: of a thickness, and how many cells there are along it near the ends of S.
        law: of the layer.
        inner: whether a place lies far from the ends.
    """

    name: str
    structure: Callable[[float, float], Structure]
    law: LinearElastic
    inner: Callable[[Expr], Expr] = lambda x: abs(x[0] - 0.5) < 0.25

    @property
    def file(self) -> str:
        """Name of the table of its errors."""
        return f"{self.name.replace(', ', '_').replace(' ', '_')}.csv"


def _equal(eps: float, cells: float, **more: Any) -> Structure:
    joint = sandwich(1.0, 0.5, 0.5, h=H, h_S=H_S, h_ends=eps / cells, cell="quadrilateral")
    loads = {"TOP": (0.3, -1.0)} | more
    return Structure(joint, body=BODY, supports={"BOTTOM": 0}, tractions=loads)


def _loaded(eps: float, cells: float) -> Structure:
    return _equal(eps, cells, **{"LEFT/LAYER": (0.7, -0.4)})


def _unequal(eps: float, cells: float) -> Structure:
    joint = sandwich(1.0, 0.3, 0.6, h=H, h_S=H_S, h_ends=eps / cells, cell="quadrilateral")
    body = {"LOWER": LinearElastic.young(E=20.0, nu=0.2), "UPPER": BODY}
    loads = {"TOP": lambda x, t: (-0.6, 1 + x[0])}
    return Structure(joint, body=body, supports={"BOTTOM": 0}, tractions=loads)


def _based(eps: float, cells: float) -> Structure:
    joint = block(1.0, 0.5, h=H, h_S=H_S, h_ends=eps / cells, cell="quadrilateral")
    return Structure(joint, body=BODY, supports={}, tractions={"TOP": (1.0, -0.2)})


CASES = (
    EndCase("equal blocks", _equal, LinearElastic.shear(40.0, 0.3)),
    EndCase("equal blocks, nu = 0.45", _equal, LinearElastic.shear(8.0, 0.45)),
    EndCase("unequal blocks, nu = 0.45", _unequal, LinearElastic.shear(1.6, 0.45)),
    EndCase("rigid base, sheared", _based, LinearElastic.shear(8.0, 0.3)),
    EndCase("loaded side", _loaded, LinearElastic.shear(40.0, 0.3)),
)


# ---------------------------------------------------------------- three dimensions
def graded(length: float, first: float, last: float) -> Array:
    """Places from 0 to a length, whose distances grow from the first to the last, about."""
    count, sizes = 1, np.array([first])
    while sizes.sum() < length:
        count += 1
        sizes = first * (last / first) ** (np.arange(count) / (count - 1))
    return np.append(0.0, np.cumsum(sizes)) * length / sizes.sum()


def grid(*places: Array, cell: str = "hexahedron") -> Joint:
    """A block of hexahedra or tetrahedra on a rigid base, with vertices at the products of places along x, y and z."""
    nx, ny, nz = (len(one) - 1 for one in places)
    joint = block(nx, ny, 1.0, depth=nz, cell=cell, structured=True)
    x = [np.interp(joint.points[:, k], np.arange(len(one)), one) for k, one in enumerate(places)]
    return replace(joint, points=np.stack(x, axis=1))


def edge(eps: float, cells: float, cell: str = "hexahedron") -> Structure:
    """A free edge at x = 0, along which loads vary; the other sides are planes of symmetry."""
    places = graded(1.0, eps / cells, H), graded(0.5, 2 * eps / cells, H), np.arange(4) / 3
    joint, pi = grid(*places, cell=cell), ufl.pi

    def load(x: Expr, t: Expr) -> list[Expr]:
        wave = ufl.cos(pi * x[2])
        return [0.3 * (1 - x[0]) + 0.2 * wave, -1 + 0.6 * x[0] * wave, 0.5 * ufl.sin(pi * x[2])]

    held = {"RIGHT": {"x": 0}, "FRONT": {"z": 0}, "BACK": {"z": 0}}
    return Structure(joint, body=BODY, supports=held, tractions={"TOP": load})


EDGE = EndCase("edge in 3D", edge, LinearElastic.shear(8.0, 0.3), inner=lambda x: x[0] > 0.5)
