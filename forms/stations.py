"""Stations: heights through a layer's thickness at which the interface law of order 1 evaluates the layer's law."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import ufl

from forms.tensors import Expr, jump_strain, three_dimensional

if TYPE_CHECKING:
    from forms.rubber import PressureLaw

LawType = TypeVar("LawType")  # a law of strains, `forms.law.BulkLaw`
GAUSS_HEIGHTS = (-(12**-0.5), 12**-0.5)  # Gauss points of the interval from -1/2 to 1/2, through the thickness
# lmbda/mu at which linear displacements through the layer raise the jump's error of order 1 by a third
LOCKING_RATIO = 12.0


class Faces(NamedTuple):
    """Displacements of the two faces of a layer at a place of S, UFL; d is the number of dimensions.

    Attributes:
        n: unit normal of S, from the lower to the upper face, (d,).
        eps: thickness.
        jump: [u], displacement of the upper minus that of the lower face, (d,).
        gradient: gradient (d, d) of [u] along S.
        mean: strain (3, 3) that is uniform through the layer: that of the mean displacement <u> along S, or a
            prescribed one.
        along: gradient along S (d, d) and value (d,) of displacements -> strain (3, 3) along S (`Kinematics.along`).
        slope: gradient (d,) of the thickness along S; None: the thickness is uniform.
    """

    n: Expr
    eps: Expr
    jump: Expr
    gradient: Expr
    mean: Expr
    along: Callable[[Expr, Expr], Expr]
    slope: Expr | None = None

    def across(self, z: float = 0.0) -> Expr:
        """Strain (3, 3) of the jump at the height z eps above the middle, sym([u] (x) (n - z grad_S eps))/eps.

        Where the thickness varies, a surface of constant z has the slope z grad_S eps.

        Args:
            z: height over the thickness, from -1/2 to 1/2.
        """
        n = self.n if self.slope is None or z == 0 else self.n - z * self.slope
        return jump_strain(self.jump, n) / self.eps

    @property
    def difference(self) -> Expr:
        """Strain (3, 3) along S of [u], sym(grad_S [u])."""
        return self.along(self.gradient, self.jump)

    @property
    def change(self) -> Expr:
        """Strain (3, 3) at the upper minus strain at the lower face, for displacements linear through the layer.

        It equals `difference` or, where the thickness varies, eps sym(grad_S ([u]/eps)).
        """
        return self.difference + self.across(0.5) - self.across(-0.5) if self.slope is not None else self.difference

    @property
    def normal(self) -> Expr:
        """Tensor n (x) n, (3, 3), of the normal n."""
        return ufl.outer(three_dimensional(self.n), three_dimensional(self.n))

    def in_s(self, e: Expr) -> Expr:
        """In-plane part P e P of a strain (3, 3), with P = I - n (x) n."""
        along = ufl.Identity(3) - self.normal
        return along * e * along

    def split(self, normal: Expr, tangential: Expr) -> Faces:
        """The same faces with the component of the jump along n multiplied by `normal`, the others by `tangential`."""
        n = self.n
        jump = tangential * self.jump + (normal - tangential) * ufl.dot(n, self.jump) * n
        gradient = tangential * self.gradient + (normal - tangential) * ufl.outer(n, ufl.dot(n, self.gradient))
        return self._replace(jump=jump, gradient=gradient)


@dataclass(frozen=True)
class Station(Generic[LawType]):
    """A height through the thickness at which the interface law of order 1 evaluates a law.

    All stations together represent the energy of the layer. The strain of one station may differ from the layer's
    strain at a height.

    Attributes:
        law: the law.
        share: weight of the station in integrals over the thickness, which is 1.
        strain: function that returns the strain (3, 3), linear in the displacements and in prescribed strains. Its
            arguments are the law, with parameters that are UFL expressions on S, and the displaced faces.
        flow: function of the same law that returns the flux along S per gradient of the pressure and per eps^3; 0
            without a pressure.
        largest_ratio: lmbda/mu at rest beyond which this strain makes the layer lock.
    """

    law: LawType
    share: float
    strain: Callable[[LawType, Faces], Expr]
    flow: Callable[[LawType], Expr] = lambda law: 0
    largest_ratio: float = math.inf


AnyStation = Station[Any]  # of a law of any class; a list of stations may have laws of several


def gauss_stations(law: LawType, difference: Callable[[LawType, Faces], Expr] | None = None) -> list[Station[LawType]]:
    """Two stations at the Gauss points through the thickness, for a strain that changes linearly from face to face.

    Args:
        law: the law.
        difference: function that returns the strain (3, 3) at the upper minus the strain at the lower face. Its
            arguments are the law and the displaced faces, as those of `Station.strain`. None: displacements are linear
            through the layer (`Faces.change`), which locks for lmbda/mu > `LOCKING_RATIO`.
    """
    change = difference or (lambda law, faces: faces.change)

    def at(z: float) -> Callable[[LawType, Faces], Expr]:
        return lambda law, faces: faces.across() + faces.mean + z * change(law, faces)

    return [Station(law, 1 / 2, at(z), largest_ratio=math.inf if difference else LOCKING_RATIO) for z in GAUSS_HEIGHTS]


def pressure_stations(law: PressureLaw) -> list[AnyStation]:
    """Two stations for a law with the shear modulus mu and a pressure field on S.

    The first station has the mean strain, and a gradient of the pressure lets the layer flow along S. The second has
    the difference of the strains at the faces. This difference causes no traction, so its law there is that of plane
    stress.
    """
    return [
        Station(law, 1, lambda law, faces: faces.across() + faces.mean, lambda law: 1 / (12 * law.mu)),
        Station(law.plane_stress(), 1 / 12, lambda law, faces: faces.in_s(faces.change)),
    ]
